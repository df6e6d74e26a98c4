"""How tests call the verbs: in this process, or in one of their own where only that will do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
import io
import json
import os
from pathlib import Path
import signal
import subprocess
from subprocess import CompletedProcess
import sys
from typing import Any, NoReturn
from unittest.mock import patch
import warnings

from vio_eval_ros.__main__ import main

ROOT = Path(__file__).resolve().parents[1]
COMMAND = [sys.executable, '-m', 'vio_eval_ros']
LIMIT_S = 120
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def call(verb: str, *arguments: object, cwd: Path | None = None) -> CompletedProcess[str]:
    """
    Run a verb in this process and return its output, messages and exit status.

    Its stdout and stderr are pipes as far as it can tell, warnings are errors, and afterwards
    working directory, environment and signal handlers are as they were. An unexpected error is
    one line, as for users; ``python -X dev -m pytest`` shows where it was raised.
    """
    words, out, err = [verb, *map(str, arguments)], _pipe(), _pipe()
    with redirect_stdout(out), redirect_stderr(err), _restored(cwd), warnings.catch_warnings():
        warnings.simplefilter('error')
        try:
            status = main(words)
        except SystemExit as end:  # how argparse ends --help and wrong usage
            status = int(end.code or 0)
    return CompletedProcess(words, status, _written(out), _written(err))


def start(verb: str, *arguments: object, **options: Any) -> CompletedProcess[str]:
    """
    Run a verb in an interpreter of its own.

    :param options: of ``subprocess.run``; ``env`` is added to the environment of the tests.
    """
    return run([*COMMAND, verb, *map(str, arguments)], **options)


def run(words: list[str], **options: Any) -> CompletedProcess[str]:
    """Run a command that finds the package, and to which warnings are errors."""
    environment = {'PYTHONPATH': str(ROOT), 'PYTHONWARNINGS': 'error'}
    environment = os.environ | environment | options.pop('env', {})
    defaults = {'capture_output': True, 'text': True, 'check': False, 'timeout': LIMIT_S}
    return subprocess.run(words, env=environment, **defaults | options)


def shell(script: str, **options: Any) -> CompletedProcess[str]:
    """Run a script of bash, in which ``vio_eval VERB`` is a verb in an interpreter of its own."""
    return run(['bash', '-c', f'vio_eval() {{ {" ".join(COMMAND)} "$@"; }}\n{script}'], **options)


def document(verb: str, *arguments: object, status: int = 0, **options: Any) -> dict[str, Any]:
    """Return what ``--json`` prints: one JSON document and nothing else."""
    done = call(verb, *arguments, '--json', **options)
    assert done.returncode == status, transcript(done)
    assert done.stderr == '', transcript(done)
    found: dict[str, Any] = json.loads(done.stdout, parse_constant=_refuse)
    return found


def complaint(verb: str, *arguments: object, **options: Any) -> str:
    """Return the one line on stderr of a call that could not be done."""
    done = call(verb, *arguments, **options)
    assert done.returncode == 2, transcript(done)
    assert done.stdout == '', transcript(done)
    assert done.stderr.startswith(f'{verb}: '), transcript(done)
    assert done.stderr.count('\n') == 1, transcript(done)
    assert 'Traceback' not in done.stderr, transcript(done)
    assert 'this is a bug' not in done.stderr, transcript(done)
    return done.stderr


def transcript(done: CompletedProcess[str]) -> str:
    """Return all there is to see of a call, for the message of an assertion."""
    return f'{done.args}: exit status {done.returncode}\n{done.stdout}\n{done.stderr}'


def _pipe() -> io.TextIOWrapper:
    return io.TextIOWrapper(io.BytesIO(), encoding='utf-8')


def _written(pipe: io.TextIOWrapper) -> str:
    pipe.flush()
    pipe.seek(0)
    return pipe.read()


def _refuse(word: str) -> NoReturn:
    raise AssertionError(f'{word} is not JSON')


@contextmanager
def _restored(cwd: Path | None) -> Iterator[None]:
    """Work in a folder, and put back what a verb may change of the process."""
    before = Path.cwd()
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    with patch.dict(os.environ):
        try:
            os.chdir(cwd or before)
            yield
        finally:
            os.chdir(before)
            for number, handler in handlers.items():
                signal.signal(number, handler)
