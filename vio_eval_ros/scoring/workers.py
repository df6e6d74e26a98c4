"""Calls a function in several processes; a call that kills its process is the only one lost."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
import os
import signal
from typing import Any, Generic, TypeVar

Value = TypeVar('Value')


@dataclass(frozen=True)
class Died:
    """A process died in a call; ``how`` is the signal or the exit status."""

    how: str


def in_processes(
    function: Callable[..., Value], calls: Sequence[tuple[Any, ...]], processes: int
) -> Generator[tuple[int, Value | Died], None, None]:
    """
    Yield the number and the value of each call, as they are finished.

    A pool of :mod:`concurrent.futures` would lose all other calls with a process that died.

    :param function: a function at the top level of a module, and what it returns can be pickled.
    :param calls: its arguments, which can be pickled, too.
    """
    context = _context(function.__module__)
    waiting = iter(range(len(calls)))
    workers: list[_Worker[Value]] = []
    try:
        while True:
            while len(workers) < processes and (k := next(waiting, None)) is not None:
                workers.append(_Worker(context, function))
                workers[-1].begin(k, calls[k])
            if not workers:
                return
            ready = wait([worker.pipe for worker in workers])
            for worker in [worker for worker in workers if worker.pipe in ready]:
                yield worker.number, worker.value()
                if worker.process.is_alive() and (k := next(waiting, None)) is not None:
                    worker.begin(k, calls[k])
                else:
                    worker.pipe.close()
                    workers.remove(worker)
    finally:
        for worker in workers:
            worker.process.kill()
            worker.process.join()


def _context(module: str) -> BaseContext:
    """Return how processes are started: by a server that imported the module once, if possible."""
    if 'forkserver' not in get_all_start_methods():
        return get_context('spawn')
    context = get_context('forkserver')
    context.set_forkserver_preload(['__main__', module])
    return context


class _Worker(Generic[Value]):
    """A process that makes one call after the other."""

    def __init__(self, context: BaseContext, function: Callable[..., Value]) -> None:
        self.pipe, end = context.Pipe()
        # BaseContext has no Process for mypy, though every context has one
        self.process = context.Process(  # type: ignore[attr-defined]
            target=_serve, args=(function, end, os.getcwd()), daemon=True
        )
        self.process.start()
        end.close()
        self.number = -1

    def begin(self, number: int, arguments: tuple[Any, ...]) -> None:
        """Begin a call."""
        self.number = number
        with suppress(BrokenPipeError):  # value() finds out whether the process is alive
            self.pipe.send(arguments)

    def value(self) -> Value | Died:
        """Return what the call gave, when there is something in the pipe."""
        try:
            value: Value = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode or 0
            known = signal.strsignal(-code) if code < 0 else None
            return Died(known or f'exit status {code}')
        return value


def _serve(function: Callable[..., Any], pipe: Connection, folder: str) -> None:
    """Make the calls whose arguments come through a pipe, until its other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    os.chdir(folder)  # a process begins in the folder in which the first of all was started
    with suppress(EOFError):
        while True:
            pipe.send(function(*pipe.recv()))
