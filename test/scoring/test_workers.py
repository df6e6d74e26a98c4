"""Calls in other processes: each has its value; one that kills its process is the only loss."""

from multiprocessing import active_children
import os
from pathlib import Path
import signal

import pytest

from vio_eval_ros.scoring.workers import Died, in_processes

KILLED = Died(str(signal.strsignal(signal.SIGKILL)))


@pytest.mark.parametrize('processes', [1, 3])
def test_every_call_has_its_value(processes):
    calls = [(k, 3) for k in range(7)]
    assert dict(in_processes(divmod, calls, processes)) == {k: divmod(k, 3) for k in range(7)}


@pytest.mark.parametrize('processes', [1, 2])
def test_a_call_that_kills_its_process_is_the_only_loss(processes):
    programs = ['1 + 1', '__import__("os")._exit(3)', '__import__("os").kill(__import__("os").'
                f'getpid(), {signal.SIGKILL:d})', '2 + 2']  # fmt: skip
    found = dict(in_processes(eval, [(program,) for program in programs], processes))
    assert found == {0: 2, 1: Died('exit status 3'), 2: KILLED, 3: 4}


def test_calls_are_made_in_the_working_directory_of_now(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert dict(in_processes(os.getcwd, [()], 1)) == {0: str(Path.cwd())}


def test_no_process_is_left_when_the_rest_is_not_wanted():
    values = in_processes(divmod, [(k, 3) for k in range(9)], 2)
    next(values)
    values.close()
    assert active_children() == []
