"""Whatever a verb could not do is one line on stderr and status 2, in a process of its own too."""

import argparse
import resource
import sys

import pytest

from verbs import run, shell, transcript
from vio_eval_ros.cli.shell import Parser
from vio_eval_ros.cli.shell import run as run_verb
from vio_eval_ros.errors import ConfigError, UNABLE

PROGRAM = 'import sys; from vio_eval_ros.cli.shell import run; sys.exit(run("score", {}))'
FAILING = PROGRAM.format('lambda: 1 / 0')
GREEDY = PROGRAM.format('lambda: len(bytearray(1 << 40))')


@pytest.mark.parametrize(
    ('error', 'message'),
    [
        (ConfigError('no such\noption'), 'score: no such option\n'),
        (OSError('disk full'), 'score: disk full\n'),
        (KeyboardInterrupt(), 'score: interrupted\n'),
        (MemoryError(), 'score: there is not enough memory\n'),
        (BrokenPipeError(), ''),
    ],
)
def test_every_error_is_at_most_one_line(error, message, capsys, monkeypatch):
    def fail() -> int:
        raise error

    monkeypatch.setattr(sys, 'stdout', sys.stdout)  # a broken pipe takes it away
    assert run_verb('score', fail) == UNABLE
    assert capsys.readouterr().err == message


def test_a_bug_is_one_line_and_in_development_mode_a_traceback():
    done = run([sys.executable, '-c', FAILING])
    assert done.returncode == UNABLE, transcript(done)
    assert done.stderr.startswith('score: this is a bug, please report it: ZeroDivisionError')
    assert done.stderr.count('\n') == 1
    done = run([sys.executable, '-X', 'dev', '-c', FAILING])
    assert done.returncode == 1, transcript(done)
    assert 'Traceback' in done.stderr


def test_a_process_that_runs_out_of_memory_says_so():
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (1 << 32, 1 << 32))

    done = run([sys.executable, '-c', GREEDY], preexec_fn=limit)
    assert (done.returncode, done.stderr) == (UNABLE, 'score: there is not enough memory\n')


def test_help_imports_no_numpy_before_a_verb_is_named():
    done = shell(f'{sys.executable} -X importtime -m vio_eval_ros --help 2>&1 | grep -c numpy')
    assert done.stdout.strip() == '0', transcript(done)


@pytest.mark.parametrize('text', ['-1', '-.5', '-1e-5', '-inf'])
def test_a_negative_number_in_any_form_is_a_value(text):
    parser = Parser('verb', 'what it does', 'examples')
    parser.add_argument('--offset', type=float)
    assert parser.parse_args(['--offset', text]).offset == float(text)


def test_argparse_still_has_the_private_attribute_that_distinguishes_numbers_from_flags():
    assert argparse.ArgumentParser()._negative_number_matcher.match('-1')
