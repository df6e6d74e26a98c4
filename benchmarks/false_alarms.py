"""
Measures how often chance passes for a difference, and how often a real one is found.

Of a baseline and of systems, by themselves and in suites. Puts the rates into docs/scoring.md and
docs/definitions.md, with --check only tells whether they are up to date; exits with 1 where they
are not, or where a target is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations
import json
import math
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from vio_eval_ros.comparison.family import adjusted
from vio_eval_ros.comparison.matrix import Cell, CellRun, Matrix
from vio_eval_ros.comparison.paired import compare_errors
from vio_eval_ros.comparison.repeated import compare, FAMILY_P, MetricComparison, Rule
from vio_eval_ros.comparison.signed_ranks import compare_over_sequences
from vio_eval_ros.comparison.verdicts import SHARE_OVER_SEQUENCES, suite_verdict
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.rotation import from_rotation_vector, multiply
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import Drift, simulate

PROJECT = Path(__file__).resolve().parents[1]
SCORING, DEFINITIONS = (PROJECT / 'docs' / f'{name}.md' for name in ('scoring', 'definitions'))
BEGIN = '<!-- benchmarks/false_alarms.py{}: begin -->\n\n'
END = '\n<!-- benchmarks/false_alarms.py{}: end -->\n'

COMPARISONS = 2000
RUNS = 5
SPREAD = 0.1
WORSE = 1.3
MOST_FALSE, LEAST_CAUGHT = 0.02, 0.9
RULE = Rule('ate_trans_rmse_m')
MEDIAN_M = 0.08
SEQUENCES, SECONDS = 500, 5.0
#: of a suite, of systems and of single runs
SUITE_SEQUENCES, SUITES, CHANGED_SUITES, SUITES_OF_SYSTEMS = 11, 600, 120, 600
SUITE_METRICS = ('ate_trans_rmse_m', 'ate_rot_rmse_deg', 'rpe_1s_trans_rmse_m')
MOST_FALSE_SUITES = 0.02
SUITE_RUN_S, SUITE_MEMORY_S = 60, 0.5
SIMULATED_RUNS, RATE_HZ, RUN_S = 400, 20, 180
LEAST_HELD, MOST_HELD = 0.93, 0.97
SCORE = [sys.executable, '-m', 'vio_eval_ros', 'score']

#: targets
MISSED: list[str] = []

Draw = Callable[[np.random.Generator, float, int], np.ndarray]


def normal(random: np.random.Generator, spread: float, runs: int) -> np.ndarray:
    """Return runs around 1 with a standard deviation."""
    return 1 + spread * random.standard_normal(runs)


def lognormal(random: np.random.Generator, spread: float, runs: int) -> np.ndarray:
    """Return runs with a median of 1 that are skewed towards large errors."""
    return np.exp(spread * random.standard_normal(runs))


def heavy_tailed(random: np.random.Generator, spread: float, runs: int) -> np.ndarray:
    """Return runs of Student's t distribution with 3 degrees of freedom: some are outliers."""
    return np.maximum(1 + spread / math.sqrt(3) * random.standard_t(3, runs), 0.1)


def with_outliers(random: np.random.Generator, spread: float, runs: int) -> np.ndarray:
    """Return runs of which one in ten has twice its error."""
    return lognormal(random, spread, runs) * np.where(random.random(runs) < 0.1, 2.0, 1.0)


def after_a_failure(random: np.random.Generator, spread: float, runs: int) -> np.ndarray:
    """Return runs of which the first is an outlier."""
    return lognormal(random, spread, runs) * np.where(np.arange(runs) == 0, 10.0, 1.0)


STACKS: dict[str, Draw] = {
    'normal': normal,
    'lognormal': lognormal,
    "heavy-tailed (Student's t, 3 degrees of freedom)": heavy_tailed,
}


class Rates(NamedTuple):
    """The share of comparisons that failed without a change, and with one."""

    false: float
    caught: float

    @property
    def met(self) -> bool:
        """Whether both meet their targets."""
        return self.false <= MOST_FALSE and self.caught >= LEAST_CAUGHT

    def cells(self) -> str:
        """Return the rates as two cells of a table."""
        return f'{percent(self.false, 1)} | {percent(self.caught, 1)}'


def percent(share: float, digits: int = 0) -> str:
    """Return a share in percent."""
    return f'{100 * share:.{digits}f} %'


class Side(NamedTuple):
    """The number of runs of one side, their spread and distribution."""

    runs: int = RUNS
    spread: float = SPREAD
    draw: Draw = normal


def rates(before: Side, after: Side) -> Rates:
    """Return how often the default rule fails an unchanged stack, and a worse one."""
    random = np.random.default_rng(1)

    def share(factor: float) -> float:
        failed = 0
        for _ in range(COMPARISONS):
            old, new = (side.draw(random, side.spread, side.runs) for side in (before, after))
            failed += compare(RULE, MEDIAN_M * old, MEDIAN_M * factor * new).worse
        return failed / COMPARISONS

    return Rates(share(1.0), share(WORSE))


def end_to_end() -> Rates:
    """Return the same from files on disk, through ``score`` as its users call it."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        for stack, factor in (('before', 1.0), ('same', 1.0), ('worse', WORSE)):
            write_suite(folder, stack, factor)
        score(folder / 'before.yaml', '--record-baseline', folder / 'baseline.json')
        return Rates(*(share_of_worse(folder, stack) for stack in ('same', 'worse')))


def write_suite(folder: Path, stack: str, factor: float) -> None:
    """Write the runs of a stack on every sequence, and the suite that scores them."""
    random = np.random.default_rng(list(map(ord, stack)))
    entries = []
    for k in range(SEQUENCES):
        runs = folder / stack / str(k)
        runs.mkdir(parents=True)
        for n, error in enumerate(factor * lognormal(random, SPREAD, RUNS)):
            flight = simulate(SECONDS, seed=k, drift=scaled(error))
            (runs / f'{n}.tum').write_text(tum(replace(flight.estimate, covariances=None)))
        truth = folder / f'{k}.tum'
        if not truth.exists():
            truth.write_text(tum(flight.ground_truth))
        entries.append({'name': f'S{k}', 'estimate': f'{stack}/{k}/*', 'ground_truth': truth.name})
    alone = {RULE.metric: {'p_adjusted': 1}}
    (folder / f'{stack}.yaml').write_text(json.dumps({'compare': alone, 'sequences': entries}))


def scaled(error: float) -> Drift:
    """Return a drift whose errors, and so the ATE, are a multiple of the default's."""
    usual = Drift()
    return Drift(
        error * usual.position_walk,
        error * usual.yaw_walk,
        1 + error * (usual.scale - 1),
        error * usual.position_noise,
        error * usual.orientation_noise,
    )


def share_of_worse(folder: Path, stack: str) -> float:
    """Return the share of sequences that are worse than the baseline."""
    result = json.loads(
        score(folder / f'{stack}.yaml', '--baseline', folder / 'baseline.json', '--json')
    )
    worse = [one['baseline'][RULE.metric]['worse'] for one in result['sequences']]
    return sum(worse) / len(worse)


def score(*arguments: object) -> str:
    """Return what ``score`` prints; exit if it could not score."""
    done = subprocess.run(
        [*SCORE, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=os.environ | {'PYTHONPATH': str(PROJECT)},
        check=False,
    )
    if done.returncode not in (0, 1):
        sys.exit(done.stderr)
    return done.stdout


def section(main: dict[str, Rates], through: Rates) -> Iterator[str]:
    """Yield the lines that the document has between its markers."""
    head = f'no change: failed | {percent(WORSE - 1)} worse: caught |'
    yield f'| runs of a stack are | {head}'
    yield '|---|---:|---:|'
    for title, found in main.items():
        yield f'| {title} | {found.cells()} |'
    yield f'| through `score`, with simulated trajectories (lognormal) | {through.cells()} |'
    yield ''
    yield (
        f'The default rule with {RUNS} runs in the baseline and {RUNS} new ones, '
        f'{percent(SPREAD)} standard deviation, {COMPARISONS:,} comparisons each, {SEQUENCES} '
        f'sequences through `score`. Targets: at most {percent(MOST_FALSE)} failed, at least '
        f'{percent(LEAST_CAUGHT)} caught. How much depends on the number of runs and their '
        'spread (normal; the last four lognormal):'
    )
    yield ''
    yield f'| runs | spread | {head}'
    yield '|---|---:|---:|---:|'
    others = [(runs, SPREAD) for runs in (1, 3, 5, 10, 20)] + [(5, 0.05), (5, 0.2), (10, 0.2)]
    for runs, spread in others:
        cells = rates(*[Side(runs, spread)] * 2).cells()
        yield f'| {runs} + {runs} | {percent(spread)} | {cells} |'
    for runs in (1, 3):
        cells = rates(Side(), Side(runs)).cells()
        yield f'| {RUNS} + {runs} | {percent(SPREAD)} | {cells} |'
    cells = rates(*[Side(draw=with_outliers)] * 2).cells()
    yield f'| {RUNS} + {RUNS}, one in ten twice as bad | {percent(SPREAD)} | {cells} |'
    cells = rates(Side(draw=after_a_failure), Side()).cells()
    yield f'| {RUNS} + {RUNS}, one before ten times as bad | {percent(SPREAD)} | {cells} |'
    for old, new in ((0.02, 0.2), (0.2, 0.02)):
        cells = rates(Side(RUNS, old, lognormal), Side(RUNS, new, lognormal)).cells()
        yield f'| {RUNS} + {RUNS} | {percent(old)} before, {percent(new)} now | {cells} |'


def of_suite(
    random: np.random.Generator, spreads: np.ndarray, runs: int, factors: np.ndarray
) -> list[list[MetricComparison]]:
    """
    Return the comparisons of a suite, whose metrics depend on each other.

    :param spreads: of the runs of each sequence.
    :param factors: (sequences, metrics) by which errors have grown.
    """
    groups = []
    for spread, worse in zip(spreads, factors, strict=True):
        shared = random.standard_normal((2, runs))
        group = []
        for metric, factor in zip(SUITE_METRICS, worse, strict=True):
            own = random.standard_normal((2, runs))
            old, new = np.exp(spread * (shared + own) / math.sqrt(2))
            group.append(compare(Rule(metric), old, factor * new))
        groups.append(group)
    return groups


def is_caught(groups: Iterable[Iterable[MetricComparison]], factors: np.ndarray) -> bool:
    """Return whether any comparison that has grown is worse; any at all where none has."""
    grown = factors > 1 if (factors > 1).any() else factors > 0
    worse = [[one.worse for one in group] for group in groups]
    return bool((np.array(worse) & grown).any())


def sampling(share: float, count: int) -> float:
    """Return two standard deviations of a share of so many."""
    return 2 * math.sqrt(share * (1 - share) / count)


def suites() -> Iterator[str]:
    """Yield the lines on whole suites, against a baseline."""
    none = np.ones((SUITE_SEQUENCES, len(SUITE_METRICS)))
    metric, sequence, everything = none.copy(), none.copy(), WORSE * none
    metric[5, 0] = sequence[5] = WORSE
    yield (
        '| runs | spread | each by itself: failed | failed | one metric worse: caught | '
        'one sequence worse: caught | all worse: caught |'
    )
    yield '|---|---|---:|---:|---:|---:|---:|'
    alike = [(runs, f'{percent(spread)}', np.full(SUITE_SEQUENCES, spread))
             for runs, spread in ((3, 0.1), (5, 0.1), (10, 0.1), (5, 0.2), (10, 0.2))]  # fmt: skip
    mixed = (5, '2 % to 25 %', np.geomspace(0.02, 0.25, SUITE_SEQUENCES))
    for runs, told, spreads in [*alike, mixed]:
        random = np.random.default_rng(2)
        found = [of_suite(random, spreads, runs, none) for _ in range(SUITES)]
        by_itself = np.mean([is_caught(one, none) for one in found])
        false = np.mean([is_caught(adjusted(one), none) for one in found])
        if runs >= RUNS and false > MOST_FALSE_SUITES + sampling(MOST_FALSE_SUITES, SUITES):
            MISSED.append(f'false alarms of suites with {runs} runs that spread by {told}')
        caught = [
            np.mean([is_caught(adjusted(of_suite(random, spreads, runs, factors)), factors)
                     for _ in range(CHANGED_SUITES)])
            for factors in (metric, sequence, everything)
        ]  # fmt: skip
        cells = ' | '.join(percent(float(share), 1) for share in (by_itself, false, *caught))
        yield f'| {runs} + {runs} | {told} | {cells} |'
    yield ''
    yield (
        f'{SUITE_SEQUENCES} sequences with {len(SUITE_METRICS)} metrics (correlation 0.5), '
        f'lognormal, {SUITES} suites without a change and {CHANGED_SUITES} with each. Target: at '
        f'most {percent(MOST_FALSE_SUITES)} failed with 5 + 5 runs or more.'
    )


def remembering(random: np.random.Generator, count: int, memory: float) -> np.ndarray:
    """Return (N, 3) values of an Ornstein-Uhlenbeck process with a memory in samples."""
    noise = random.standard_normal((count, 3))
    decay = math.exp(-1 / memory) if memory else 0.0
    noise[1:] *= math.sqrt(1 - decay**2)
    return np.asarray(lfilter([1], [1, -decay], noise, axis=0))


def drifting(random: np.random.Generator, count: int) -> np.ndarray:
    """Return (N, 3) positions of a random walk after their mean was aligned."""
    walk = np.cumsum(random.standard_normal((count, 3)), axis=0) / math.sqrt(count)
    return np.asarray(walk - walk.mean(axis=0))


KINDS: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    'white': lambda random, count: remembering(random, count, 0),
    **{
        f'memory of {seconds:g} s': partial(
            lambda random, count, memory: remembering(random, count, memory),
            memory=seconds * RATE_HZ,
        )
        for seconds in (0.1, 0.5, 1, 2, 5, 20)
    },
    'memory of 2 s, 0.1 s and white': lambda random, count: (
        remembering(random, count, 2 * RATE_HZ)
        + 0.5 * remembering(random, count, 0.1 * RATE_HZ)
        + 0.3 * remembering(random, count, 0)
    ),
    'drift (random walk)': drifting,
}


def intervals() -> Iterator[str]:
    """Yield the lines on single runs, and note what misses its target."""
    yield (
        '| errors | independent pieces | interval given | holds, where given | misses, of all | '
        'alike: tells | 30 % apart: tells |'
    )
    yield '|---|---:|---:|---:|---:|---:|---:|'
    count = RATE_HZ * RUN_S
    for title, draw in KINDS.items():
        random = np.random.default_rng(3)
        given, held, false, caught, pieces = [], [], [], [], []
        for _ in range(SIMULATED_RUNS):
            one, other = (np.linalg.norm(draw(random, count), axis=1) for _ in range(2))
            alike = compare_errors(one, other)
            low, high = alike.interval
            pieces.append(alike.pieces)
            given.append(not math.isnan(low))
            held.append(low <= 0 <= high)
            false.append(alike.p_value <= FAMILY_P)
            if len(caught) < SIMULATED_RUNS / 4:
                caught.append(compare_errors(one, WORSE * other).p_value <= FAMILY_P)
        holds = np.sum(held) / max(np.sum(given), 1)
        misses = np.mean(np.array(given) & ~np.array(held))
        shares = [np.mean(given), holds, misses, np.mean(false), np.mean(caught)]
        cells = [percent(float(share), 1) for share in shares]
        if np.mean(given) < 0.5:
            cells[1] = '-'
        elif not LEAST_HELD <= round(float(shares[1]), 3) <= MOST_HELD:
            MISSED.append(f'intervals of errors with {title}')
        yield f'| {title} | {np.median(pieces):.0f} | {" | ".join(cells)} |'
    yield ''
    yield (
        f'{SIMULATED_RUNS} pairs of runs of {RUN_S} s at {RATE_HZ} Hz each, RMSE of errors in '
        f'three axes; to tell is p <= {FAMILY_P:g}. Target: intervals hold in '
        f'{percent(LEAST_HELD)} to {percent(MOST_HELD)}, or are not given.'
    )


def systems() -> Iterator[str]:
    """Yield the lines on two and more systems over a suite."""
    yield '| systems | sequences | alike: any tells | 10 % better: tells | 20 % better: tells |'
    yield '|---|---:|---:|---:|---:|'
    for count, sequences in ((2, 7), (2, 11), (2, 20), (4, 11)):
        pairs = list(combinations(range(count), 2))
        cells = []
        for factor in (1.0, 0.9, 0.8):
            random = np.random.default_rng(4)
            told = 0
            for _ in range(SUITES_OF_SYSTEMS):
                hard = random.lognormal(0, 1, (len(SUITE_METRICS), sequences))
                values = hard * random.lognormal(0, 0.15, (count, len(SUITE_METRICS), sequences))
                values[0] *= factor
                tested = pairs if factor == 1 else [(0, 1)]
                told += any(
                    len(pairs) * found.p_adjusted <= FAMILY_P * SHARE_OVER_SEQUENCES
                    for i, j in tested
                    for found in compare_over_sequences(values[i], values[j])
                )
            cells.append(percent(told / SUITES_OF_SYSTEMS, 1))
        yield f'| {count} | {sequences} | {" | ".join(cells)} |'
    yield ''
    yield (
        f'{SUITES_OF_SYSTEMS} suites with {len(SUITE_METRICS)} independent metrics, the errors of '
        'a system on a sequence vary by 15 %; of several systems, one is better than another in '
        'any metric.'
    )


def whole_suites() -> Iterator[str]:
    """Yield the lines on the one verdict over all metrics and sequences, and note its misses."""
    yield (
        '| systems | runs | alike: tells | one of them 10 % better everywhere: tells | '
        '20 % better: tells | 50 % better on one sequence: tells |'
    )
    yield '|---|---:|---:|---:|---:|---:|'
    everywhere = np.ones(SUITE_SEQUENCES)
    on_one = np.where(np.arange(SUITE_SEQUENCES) == 5, 0.5, 1.0)
    changes = (everywhere, 0.9 * everywhere, 0.8 * everywhere, on_one)
    alike = ((2, 1, SUITES), (4, 1, SUITES // 2), (2, RUNS, SUITES // 4))
    for count, runs, suites_alike in alike:
        cells = []
        for k, factors in enumerate(changes):
            random = np.random.default_rng([5, count, runs])
            drawn = SUITES // 10 if k else suites_alike
            told = [suite_of_systems(random, count, runs, factors) for _ in range(drawn)]
            share = float(np.mean(told))
            cells.append(percent(share, 1))
            limit = MOST_FALSE_SUITES + sampling(MOST_FALSE_SUITES, drawn)
            if not k and share > limit:
                MISSED.append(f'one verdict on {count} systems with {runs} runs')
        yield f'| {count} | {runs} | {" | ".join(cells)} |'
    yield ''
    yield (
        f'{SUITE_SEQUENCES} sequences with {len(SUITE_METRICS)} metrics, scored as `score` does: '
        f'errors of {SUITE_RUN_S} s at {RATE_HZ} Hz that remember {SUITE_MEMORY_S:g} s. '
        f'{", ".join(str(suites_alike) for *_, suites_alike in alike)} suites of systems that are '
        f'alike, {SUITES // 10} of each change. Target: at most {percent(MOST_FALSE_SUITES)} of '
        'those that are alike.'
    )


def suite_of_systems(
    random: np.random.Generator, systems: int, runs: int, factors: np.ndarray
) -> bool:
    """
    Return whether any system is told from another in a suite.

    :param factors: of the errors of the first system, by sequence.
    """
    names, sequences = 'ABCD'[:systems], [f'S{k}' for k in range(SUITE_SEQUENCES)]
    cells = {
        (sequence, name): Cell(
            tuple(
                CellRun('', scored(random, hard * (factor if name == 'A' else 1.0)))
                for _ in range(runs)
            )
        )
        for sequence, factor, hard in zip(
            sequences, factors, random.lognormal(0, 0.5, SUITE_SEQUENCES), strict=True
        )
        for name in names
    }
    verdict = suite_verdict(Matrix(tuple(sequences), tuple(names), SUITE_METRICS, cells))
    return verdict is not None and verdict.tells


def scored(random: np.random.Generator, size: float) -> Result:
    """Return the result of a run whose errors have a size."""
    truth = flown()
    count = len(truth.stamps_ns)
    offsets, turns = (
        remembering(random, count, SUITE_MEMORY_S * RATE_HZ) * size * scale
        for scale in (0.05, math.radians(0.5))
    )
    estimate = Trajectory(
        truth.stamps_ns,
        truth.positions + offsets,
        multiply(truth.rotations, from_rotation_vector(turns)),
    )
    config = EvaluationConfig(alignment='none', rpe_deltas=('1s',))
    sides = (Source(name, 'tum', (), poses) for name, poses in (('', estimate), ('', truth)))
    return score_run(*sides, config, hashed=False)


@cache
def flown() -> Trajectory:
    """Return what all runs of a suite follow."""
    dense = simulate(SUITE_RUN_S, seed=1).ground_truth
    return dense[:: round(dense.stamps_ns.size / (SUITE_RUN_S * RATE_HZ))]


def comparisons() -> Iterator[str]:
    """Yield the lines on comparisons with a baseline, each by itself."""
    found = {title: rates(*[Side(draw=draw)] * 2) for title, draw in STACKS.items()}
    through = end_to_end()
    MISSED.extend('comparisons by themselves' for one in (*found.values(), through) if not one.met)
    yield from section(found, through)


SECTIONS: dict[str, tuple[Path, Callable[[], Iterator[str]]]] = {
    'comparisons': (SCORING, comparisons),
    'suites': (SCORING, suites),
    'intervals': (DEFINITIONS, intervals),
    'systems': (DEFINITIONS, systems),
    'whole suites': (SCORING, whole_suites),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and write or check; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--check', action='store_true', help='write nothing')
    parser.add_argument('--only', nargs='+', choices=SECTIONS, default=list(SECTIONS))
    chosen = parser.parse_args(arguments)
    good = True
    for name in chosen.only:
        document, lines = SECTIONS[name]
        table = '\n'.join(lines()) + '\n'
        print(table, flush=True)
        begin, end = (mark.format(f' {name}') for mark in (BEGIN, END))
        text = document.read_text(encoding='utf-8')
        head, opened, rest = text.partition(begin)
        _, closed, tail = rest.partition(end)
        if not (opened and closed):  # or the rest of the document would be lost
            raise SystemExit(f'{document} has no {begin} ... {end}')
        written = f'{head}{begin}{table}{end}{tail}'
        if chosen.check and text != written:
            print(f'{document} is out of date: run benchmarks/false_alarms.py', file=sys.stderr)
            good = False
        if not chosen.check:
            document.write_text(written, encoding='utf-8')
    for target in MISSED:
        print(f'missed: {target}', file=sys.stderr)
    return 0 if good and not MISSED else 1


if __name__ == '__main__':
    sys.exit(main())
