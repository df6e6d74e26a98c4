"""
Measures what the evaluator costs while it runs, beside a bare rclpy node.

Writes the section Live of docs/benchmarks.md, with --quick or --profile only prints; exits with 1
where a target is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
import os
from pathlib import Path
import pstats
from statistics import median
import sys
from tempfile import TemporaryDirectory
from typing import NamedTuple

import document
from document import machine, ranged, Target, targets_table
from processes import private_graph, PROJECT, thread_cpu_s

os.environ.update(private_graph())
sys.path.insert(1, str(PROJECT))  # the package need not be installed
try:
    import rclpy  # noqa: F401
except ImportError as missing:
    print(f'The live node is not measured, its figures stay: {missing}; pip install -e ".[ros]"')
    sys.exit()
from load import Load
from subjects import Memory, Subject, Subjects, Usage

BARE, YOUNG, OLD, BOUNDED = 'single', 'young', 'old', 'bounded'
WAYS = {
    BARE: '`SingleThreadedExecutor`',
    'multi': '`MultiThreadedExecutor`',
    'polled': 'no executor: all waiting messages, 20 times per second',
    'events': '`experimental.EventsExecutor`',  # the last, since it disturbs and does not end
}
YOUNG_S = 3.0  # in which there come more than 1,000 pairs
TIMES = (4, 8, 16, 24)  # the load, to see how much is too much
SLUGGISH_S = 3.0  # a process that takes longer to end does not obey Ctrl-C


@dataclass(frozen=True)
class Size:
    """
    How much is measured.

    :param rounds_s: how long each round is.
    :param pairs: how many pairs the old evaluator has found before the rounds.
    :param early_pairs: after how many of them its memory is read for the first time.
    :param max_pairs: how many of them the bounded evaluator keeps.
    :param short_s: how long all else is measured.
    """

    rounds_s: tuple[float, ...]
    pairs: int
    early_pairs: int
    max_pairs: int
    short_s: float


FULL = Size((60.0, 15.0, 15.0), 1_000_000, 100_000, 50_000, 4.0)
QUICK = Size((4.0, 4.0, 4.0), 100_000, 20_000, 10_000, 2.0)


class Growth(NamedTuple):
    """The memory of an evaluator, early and later."""

    early: Memory
    later: Memory

    @property
    def bytes_a_pair(self) -> float:
        """What each of the pairs between took."""
        return (self.later.resident_bytes - self.early.resident_bytes) / (
            self.later.pairs - self.early.pairs
        )


@dataclass
class Measured:
    """
    All that was found out.

    :param growth: of the memory, without and with a bound.
    :param rounds: what each process made of the load.
    :param limits: what evaluator and bare node made of TIMES the load, until one got lost.
    :param ways: of each in WAYS, what a bare node made of the load, and whether Ctrl-C ended it.
    """

    growth: dict[str, Growth]
    rounds: list[dict[str, Usage]]
    limits: dict[str, list[Usage]]
    ways: dict[str, tuple[Usage, bool]]

    def times(self, name: str, other: str) -> list[float]:
        """Return the CPU time of a process over that of another, of each round."""
        return [usages[name].cpu_us / usages[other].cpu_us for usages in self.rounds]


@contextmanager
def stage() -> Iterator[Subjects]:
    """Give what starts processes and loads them; behind it, none is left."""
    with TemporaryDirectory() as folder, Load() as load, ExitStack() as stack:
        yield Subjects(load, stack, Path(folder))


def measure(size: Size) -> Measured:
    """Measure everything, in one run."""
    with stage() as subjects:
        say(f'memory: {size.pairs:,} pairs')
        old = subjects.evaluator(OLD, f'max_pairs:={2 * size.pairs}')
        bounded = subjects.evaluator(BOUNDED, f'max_pairs:={size.max_pairs}')
        growth = grown(subjects, [old, bounded], size)
        subjects.end(bounded)
        rounds = [compared(subjects, seconds) for seconds in size.rounds_s]
        subjects.end(old)
        limits = {
            name: list(limit(subjects, start, name, size.short_s))
            for name, start in ((BARE, subjects.bare), (YOUNG, subjects.evaluator))
        }
        ways = {}
        for kind in WAYS:
            say(f'another way to take messages: {kind}')
            bare = subjects.bare(kind)
            usage = subjects.measure(size.short_s)[kind]
            ways[kind] = usage, subjects.end(bare, SLUGGISH_S)
    return Measured(growth, rounds, limits, ways)


def grown(subjects: Subjects, evaluators: Sequence[Subject], size: Size) -> dict[str, Growth]:
    """Return how the memory of evaluators grows with the pairs, which are found quickly."""
    readings = []
    for pairs in (size.early_pairs, size.pairs):
        subjects.remember(evaluators[0], pairs)
        readings.append([evaluator.memory() for evaluator in evaluators])
    return {
        evaluator.name: Growth(early, later)
        for evaluator, early, later in zip(evaluators, *readings, strict=True)
    }


def compared(subjects: Subjects, seconds: float) -> dict[str, Usage]:
    """Return what a new evaluator, a new bare node and all that are there make of the load."""
    say(f'1,000 Hz of estimates and 400 Hz of ground truth for {seconds:g} s')
    young, bare = subjects.evaluator(YOUNG), subjects.bare(BARE)
    usages = subjects.measure(seconds, warm_up_s=YOUNG_S)
    for subject in (young, bare):
        subjects.end(subject)
    return usages


def limit(
    subjects: Subjects, start: Callable[[str], Subject], name: str, seconds: float
) -> Iterator[Usage]:
    """Yield what a process makes of more and more load, until something is lost or late."""
    subject = start(name)
    for times in TIMES:
        say(f'{times} times the load: {name}')
        usage = subjects.measure(seconds, times)[name]
        yield usage
        if usage.missing:
            break
    subjects.end(subject)


def targets(measured: Measured, size: Size) -> list[Target]:
    """Return what is promised of the evaluator."""
    beside_bare, of_age = measured.times(YOUNG, BARE), measured.times(OLD, YOUNG)
    longest = max(measured.rounds, key=lambda usages: usages[YOUNG].took_s)[YOUNG]
    old, bounded = (measured.growth[name].bytes_a_pair for name in (OLD, BOUNDED))
    pairs, early, most = (f'{n:,}' for n in (size.pairs, size.early_pairs, size.max_pairs))
    return [
        Target(
            'CPU time per message: at most 1.25 times that of a bare rclpy node',
            ranged(beside_bare, 2),
            median(beside_bare) <= 1.25,
        ),
        Target(
            f'CPU time per message after {pairs} pairs: at most 1.1 times that after 1,000',
            ranged(of_age, 2),
            median(of_age) <= 1.1,
        ),
        Target(
            f'1,000 Hz of Odometry and 400 Hz of TransformStamped for {longest.took_s:.0f} s: '
            'nothing lost or late',
            f'{longest.missing:,} of {longest.sent:,}',
            not longest.missing,
        ),
        Target(
            f'Memory: at most 200 bytes per pair, between {early} and {pairs} of them',
            f'{old:.0f}',
            old <= 200,
        ),
        Target(
            f'Memory with `max_pairs` of {most}: at most 20 bytes per pair, between {early} and '
            f'{pairs}',
            f'{bounded:.0f}',
            bounded <= 20,
        ),
    ]


def rounds_table(measured: Measured, size: Size) -> Iterator[str]:
    """Yield what the processes made of the load."""
    names = {
        BARE: 'bare rclpy node',
        YOUNG: 'evaluator, after 1,000 pairs',
        OLD: f'evaluator, after {size.pairs:,} pairs',
    }
    yield '| process | CPU time per message [µs] | CPU [%] | lost or late |'
    yield '|---|---:|---:|---:|'
    for name, title in names.items():
        usages = [usages[name] for usages in measured.rounds]
        missing, sent = (sum(getattr(u, what) for u in usages) for what in ('missing', 'sent'))
        yield (
            f'| {title} | {ranged([u.cpu_us for u in usages], 0)} '
            f'| {ranged([u.cpu_percent for u in usages], 1)} | {missing:,} of {sent:,} |'
        )


def limits_table(measured: Measured) -> Iterator[str]:
    """Yield how much is too much."""
    yield '| messages per second | bare rclpy node: lost | CPU [%] | evaluator: lost | CPU [%] |'
    yield '|---:|---:|---:|---:|---:|'
    bare, evaluator = measured.limits[BARE], measured.limits[YOUNG]
    for k in range(max(len(bare), len(evaluator))):
        cells = [
            f'{usages[k].missing:,} of {usages[k].sent:,} | {usages[k].cpu_percent:.0f}'
            if k < len(usages)
            else '| '
            for usages in (bare, evaluator)
        ]
        usage = (bare if k < len(bare) else evaluator)[k]
        yield f'| {usage.messages / usage.took_s:,.0f} | {" | ".join(cells)} |'


def ways_table(measured: Measured) -> Iterator[str]:
    """Yield what the ways to take messages cost."""
    yield '| a bare node takes messages with | received | CPU [%] | ends at Ctrl-C |'
    yield '|---|---:|---:|---|'
    for kind, (usage, ends) in measured.ways.items():
        yield (
            f'| {WAYS[kind]} | {usage.received:,} of {usage.sent:,} '
            f'| {usage.cpu_percent:.0f} | {"yes" if ends else "**no**"} |'
        )


def section(measured: Measured, size: Size, promised: Sequence[Target]) -> list[str]:
    """Return the figures as Markdown."""
    return [
        '`evaluator` while it runs, beside a bare rclpy node. Measured by `benchmarks/live.py`.',
        '',
        *targets_table(promised),
        '',
        *rounds_table(measured, size),
        '',
        f'All three receive the same messages at the same time, in {len(size.rounds_s)} rounds of '
        f'{", ".join(f"{s:g}" for s in size.rounds_s)} s: 1,000 Hz of Odometry with covariances '
        'and 400 Hz of TransformStamped, each published on schedule. Subscriptions are reliable, '
        'with a depth of 5,000. The bare node has both subscriptions, with a callback that only '
        'counts, in a spinning `SingleThreadedExecutor`. CPU time is the user and system time of '
        'all threads of the process during the round. Ratios are taken within each round. The '
        'bare node and the first evaluator are started anew for each round; the second evaluator '
        'was fed its earlier pairs at twelve times real time. A message is lost or late if it '
        'had not been received two seconds after the round, or if the evaluator dropped it as '
        'too late for a pair.',
        '',
        'Memory is the private memory of the process (`RssAnon`), at two moments of that feeding.',
        '',
        'Increasing load on a single process, until it loses messages:',
        '',
        *limits_table(measured),
        '',
        'The evaluator takes all waiting messages 20 times per second and decodes them in '
        'columns. An executor wakes up for each message and makes a Python object of it. That '
        'makes the difference, not the kind of executor:',
        '',
        *ways_table(measured),
        '',
        machine('numpy', 'ros-rclpy', 'ros-rmw-fastrtps-cpp'),
    ]


def profile(seconds: float) -> None:
    """Print in which functions and threads the time of the evaluator goes."""
    with stage() as subjects, TemporaryDirectory() as folder:
        file = Path(folder) / 'profile'
        evaluator = subjects.evaluator(YOUNG, profile=file)
        before_s = thread_cpu_s(evaluator.process.pid)
        usage = subjects.measure(seconds)[YOUNG]
        after_s = thread_cpu_s(evaluator.process.pid)
        subjects.end(evaluator)
        print(f'{usage.cpu_us:.0f} µs a message, the profiler included; CPU time of threads [s]:')
        for thread, used_s in after_s.items():
            print(f'{thread:>16} {used_s - before_s.get(thread, 0):6.2f}')
        pstats.Stats(str(file)).sort_stats('tottime').print_stats(30)


def say(line: str) -> None:
    print(f'live: {line}', flush=True)


def main() -> int:
    """Measure and write; return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        '--quick', action='store_true', help='measure less, and leave docs/benchmarks.md as it is'
    )
    parser.add_argument(
        '--profile', action='store_true', help='only print where the time of the evaluator goes'
    )
    options = parser.parse_args()
    if options.profile:
        profile(20.0)
        return 0
    size = QUICK if options.quick else FULL
    measured = measure(size)
    promised = targets(measured, size)
    lines = section(measured, size, promised)
    print('\n'.join(lines))
    if not options.quick:
        document.write('Live', lines)
    return 0 if all(target.met for target in promised) else 1


if __name__ == '__main__':
    sys.exit(main())
