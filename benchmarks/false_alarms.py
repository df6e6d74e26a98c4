"""
Measures how often a baseline fails a stack that has not changed, and misses one that got worse.

Puts the rates into docs/scoring.md, with --check only tells whether they are up to date; exits
with 1 where they are not, or where a target is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
import json
import math
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from vio_eval_ros.comparison.repeated import compare, Rule
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import Drift, simulate

PROJECT = Path(__file__).resolve().parents[1]
DOCUMENT = PROJECT / 'docs' / 'scoring.md'
BEGIN = '<!-- benchmarks/false_alarms.py: begin -->\n\n'
END = '\n<!-- benchmarks/false_alarms.py: end -->\n'

COMPARISONS = 2000
RUNS = 5
SPREAD = 0.1
WORSE = 1.3
MOST_FALSE, LEAST_CAUGHT = 0.02, 0.9
RULE = Rule('ate_trans_rmse_m')
MEDIAN_M = 0.08
SEQUENCES, SECONDS = 500, 5.0
SCORE = [sys.executable, '-m', 'vio_eval_ros', 'score']

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
    (folder / f'{stack}.yaml').write_text(json.dumps({'sequences': entries}))


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and write or check; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--check', action='store_true', help='write nothing')
    check = parser.parse_args(arguments).check
    found = {title: rates(*[Side(draw=draw)] * 2) for title, draw in STACKS.items()}
    through = end_to_end()
    table = '\n'.join(section(found, through)) + '\n'
    print(table, end='')
    text = DOCUMENT.read_text(encoding='utf-8')
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    written = f'{head}{BEGIN}{table}{END}{tail}'
    if check and text != written:
        print('docs/scoring.md is out of date: run benchmarks/false_alarms.py', file=sys.stderr)
        return 1
    if not check:
        DOCUMENT.write_text(written, encoding='utf-8')
    return 0 if all(one.met for one in (*found.values(), through)) else 1


if __name__ == '__main__':
    sys.exit(main())
