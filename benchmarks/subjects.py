"""The processes under test: the evaluator and bare nodes, all of which hear the same load."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
import subprocess
import sys
import time
from typing import Any, NamedTuple

from load import ESTIMATE_PERIOD_NS, Load
from processes import cpu_s, interrupted, resident_bytes, started

WARM_UP_S = 1.0
LATE_S = 2.0  # who has not received a message so long after the last one was sent, has it late
HURRY = 12  # times the load, to become old soon; about what the evaluator can take
TOPICS = ('/estimate', '/ground_truth')
# stale later: the result that is published then takes time and memory of its own
SETTINGS = (
    'stale_after_s:=1e3',
    *(f'qos_overrides.{topic}.subscription.reliability:=reliable' for topic in TOPICS),
)


@dataclass(frozen=True)
class Subject:
    """
    A process under test.

    :param since: how many messages had been sent when it came.
    :param received: tells how many messages it has received, without those that came too late.
    :param diagnostics: what an evaluator said last.
    """

    name: str
    process: subprocess.Popen
    since: int
    received: Callable[[], int]
    diagnostics: dict[str, str]

    def missing(self, load: Load) -> int:
        """Return how many messages it lacks."""
        return load.sent - self.since - self.received()

    @property
    def pairs(self) -> int:
        """How many pairs an evaluator has found."""
        return int(self.diagnostics.get('pairs', 0))

    def memory(self) -> Memory:
        """Return how much memory an evaluator takes now."""
        return Memory(self.pairs, resident_bytes(self.process.pid))


class Memory(NamedTuple):
    """What an evaluator takes for so many pairs."""

    pairs: int
    resident_bytes: int


class Usage(NamedTuple):
    """
    What a process made of the load.

    :param messages: how many were sent while its CPU time was taken, and ``took_s`` how long.
    :param sent: how many were sent in all, and ``missing`` how many of these it lacks.
    """

    messages: int
    took_s: float
    cpu_s: float
    sent: int
    missing: int

    @property
    def received(self) -> int:
        """How many of them it has received."""
        return self.sent - self.missing

    @property
    def cpu_us(self) -> float:
        """The CPU time of a message."""
        return 1e6 * self.cpu_s / self.messages

    @property
    def cpu_percent(self) -> float:
        """How busy the process was."""
        return 100 * self.cpu_s / self.took_s


class Subjects:
    """
    Starts the processes, and puts load on them.

    :param stack: at its end they end.
    :param folder: where bare nodes keep count.
    """

    def __init__(self, load: Load, stack: ExitStack, folder: Path) -> None:
        self._load = load
        self._stack = stack
        self._folder = folder
        self._subjects: list[Subject] = []

    def evaluator(self, name: str, *settings: str, profile: Path | None = None) -> Subject:
        """Start an evaluator with these parameters beside SETTINGS."""
        how = ['-m', 'cProfile', '-o', profile] if profile else []
        topic = f'/{name}/diagnostics'
        remapped = ['-r', f'__node:={name}', '-r', f'/diagnostics:={topic}']
        parameters = [word for item in (*SETTINGS, *settings) for word in ('-p', item)]
        values = self._load.diagnostics(topic)

        def received() -> int:
            arrived, late = (
                sum(int(values.get(f'{topic[1:]}_{what}', 0)) for topic in TOPICS)
                for what in ('received', 'late')
            )
            return arrived - late

        command = [*how, '-m', 'vio_eval_ros', 'evaluator', '--ros-args', *remapped, *parameters]
        return self._start(name, command, received, values)

    def bare(self, kind: str) -> Subject:
        """Start a bare node, of a kind that ``bare.py`` knows."""
        count = self._folder / kind
        count.write_bytes(bytes(8))
        return self._start(
            kind,
            [Path(__file__).with_name('bare.py'), kind, count],
            lambda: int.from_bytes(count.read_bytes(), sys.byteorder),
            {},
        )

    def end(self, subject: Subject, patience_s: float = 60.0) -> bool:
        """End a process; return whether Ctrl-C was enough."""
        self._subjects.remove(subject)
        obeyed = interrupted(subject.process, patience_s)
        if obeyed:  # else it is killed behind all, and it takes 20 s until the graph notices
            self._load.wait_for(len(self._subjects))
        return obeyed

    def remember(self, evaluator: Subject, pairs: int) -> None:
        """
        Publish quickly until an evaluator has found so many pairs, or some more.

        :raises ChildProcessError: it has ended before.
        """
        while evaluator.pairs < pairs:
            if evaluator.process.poll() is not None:
                raise ChildProcessError(f'the {evaluator.name} evaluator has ended')
            messages = self._load.paced(0.5, HURRY, truth_period_ns=ESTIMATE_PERIOD_NS)
            self._load.publish(messages)
            self._load.listen(0.01)
        self._settle()

    def measure(
        self, seconds: float, times: float = 1.0, warm_up_s: float = WARM_UP_S
    ) -> dict[str, Usage]:
        """Return what each process makes of some seconds of so many times the load."""
        load, subjects = self._load, self._subjects
        missing = [subject.missing(load) for subject in subjects]
        sent_before = load.sent
        load.publish(load.paced(warm_up_s))
        messages = load.paced(seconds, times)
        begin_s = [cpu_s(subject.process.pid) for subject in subjects]
        took_s = load.publish(messages)
        used_s = [cpu_s(s.process.pid) - begin for s, begin in zip(subjects, begin_s, strict=True)]
        self._settle()
        sent = load.sent - sent_before
        return {
            subject.name: Usage(len(messages), took_s, used, sent, subject.missing(load) - before)
            for subject, used, before in zip(subjects, used_s, missing, strict=True)
        }

    def _start(
        self,
        name: str,
        command: Sequence[Any],
        received: Callable[[], int],
        diagnostics: dict[str, str],
    ) -> Subject:
        process = self._stack.enter_context(started([sys.executable, *command]))
        self._load.wait_for(len(self._subjects) + 1)
        subject = Subject(name, process, self._load.sent, received, diagnostics)
        self._subjects.append(subject)
        return subject

    def _settle(self) -> None:
        """Wait until all has been received, or is late."""
        end_s = time.monotonic() + LATE_S
        while any(s.missing(self._load) > 0 for s in self._subjects):
            if time.monotonic() > end_s:
                break
            self._load.listen(0.1)
