"""
Times score on a hundred runs of EuRoC size against evo, which is called once per run.

Writes the section Suites of docs/benchmarks.md (only prints with --quick); exits with 1 if the
target is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
import json
import os
from pathlib import Path
import re
from statistics import median
import sys
from tempfile import TemporaryDirectory
import time

from compare import Bench, EVO, MAX_DIFFERENCE
import document
from document import machine, ranged, Target, targets_table
from inputs import estimate, ESTIMATE_DELAY_NS, FIRST_STAMP_NS, fly, SIZES, write_tum
import numpy as np

SCORE = [sys.executable, '-m', 'vio_eval_ros', 'score']
RUNS, ROUNDS = 100, 5
TIMES_FASTER = 10


def write_runs(folder: Path, count: int) -> Path:
    """Write the ground truth, as many estimates of it, and the suite that scores them."""
    size = SIZES['euroc']
    write_tum(
        folder / 'truth.txt', fly(FIRST_STAMP_NS + size.truth_period_ns * np.arange(size.truths))
    )
    stamps_ns = FIRST_STAMP_NS + ESTIMATE_DELAY_NS
    seen = fly(stamps_ns + size.estimate_period_ns * np.arange(size.estimates))
    for k in range(count):
        write_tum(folder / f'run_{k:03}.txt', estimate(seen, np.random.default_rng(k)))
    suite = folder / 'suite.yaml'
    suite.write_text(
        f'options: {{max_difference_s: {MAX_DIFFERENCE}}}\n'
        'sequences: [{name: flight, estimate: run_*.txt, ground_truth: truth.txt}]\n'
    )
    return suite


def of_evo(bench: Bench, folder: Path, count: int) -> tuple[dict[str, float], list[float]]:
    """Return how long each command of evo took for all runs, and the errors that it found."""
    seconds, errors = dict.fromkeys(EVO, 0.0), []
    for k in range(count):
        pair = [str(folder / 'truth.txt'), str(folder / f'run_{k:03}.txt')]
        for name, command in EVO.items():
            align = ['-a'] if name == 'evo_ape' else []
            words = [*command, 'tum', *pair, '--t_max_diff', MAX_DIFFERENCE, *align]
            begin = time.perf_counter()
            text = bench.output(words)
            seconds[name] += time.perf_counter() - begin
            if name == 'evo_ape':
                errors.append(float(re.findall(r'rmse\s+(\S+)', text)[0]))
    return seconds, errors


def check(found: str, errors: Sequence[float]) -> None:
    """Exit unless score found the errors that evo found, to the six decimals that evo prints."""
    (sequence,) = json.loads(found)['sequences']
    for run, error in zip(sequence['runs'], errors, strict=True):
        if not abs(run['metrics']['ate_trans_rmse_m'] - error) < 1e-6:
            sys.exit(f'{run["estimate"]}: evo does not find the same')


def section(
    promised: Target, ours: dict[str, list[float]], theirs: dict[str, float], count: int
) -> Iterator[str]:
    """Yield the measurements as Markdown."""
    total = sum(theirs.values())
    yield (
        f'`score` on {count} runs beside `evo_ape` and `evo_rpe`, called {count} times each, one '
        'after the other, on the same files. Measured by `benchmarks/suite.py`.'
    )
    yield ''
    yield from targets_table([promised])
    yield ''
    yield '| | time [s] | × `score` |'
    yield '|---|---:|---:|'
    usual = median(next(iter(ours.values())))
    for name, seconds in ours.items():
        yield f'| `{name}` | {ranged(seconds, 2)} | {median(seconds) / usual:.1f} |'
    for name, taken in [*theirs.items(), (' + '.join(theirs), total)]:
        yield f'| `{name}` | {taken:.1f} | {taken / usual:.1f} |'
    yield ''
    yield (
        f'{SIZES["euroc"].truths:,} true poses and {SIZES["euroc"].estimates:,} estimates per '
        f'run, all of one sequence. `score` runs in {ROUNDS} rounds, before and after evo. Both '
        'find the same errors, to the six decimals that evo prints. `score` uses all '
        f'{os.cpu_count()} cores, and gives what `replay` gives for each run, and the verdict.'
    )
    yield ''
    yield machine('numpy', 'evo')


def main() -> int:
    """Measure and write; return 1 where the target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        '--quick', action='store_true', help='ten runs only, and do not write docs/benchmarks.md'
    )
    quick = parser.parse_args().quick
    count = 10 if quick else RUNS
    with TemporaryDirectory(prefix='vio_eval_ros_') as name:
        folder = Path(name)
        suite, bench = write_runs(folder, count), Bench(folder)
        words = [*SCORE, str(suite)]
        found = bench.output([*words, '--json'])  # the first run of each warms up
        for command in EVO.values():
            bench.run([*command, '--help'])
        print(f'suite: {count} runs', flush=True)
        ours: dict[str, list[float]] = {'score': [], 'score --jobs 1': []}
        theirs: dict[str, float] = {}
        for k in range(ROUNDS):
            if k == ROUNDS // 2:
                theirs, errors = of_evo(bench, folder, count)
                check(found, errors)
            ours['score'].append(bench.run(words).seconds)
            ours['score --jobs 1'].append(bench.run([*words, '--jobs', '1']).seconds)
    ratios = [sum(theirs.values()) / seconds for seconds in ours['score']]
    promised = Target(
        f'{count} runs of EuRoC size: at least {TIMES_FASTER} times as fast as `evo_ape` and '
        '`evo_rpe` for each',
        ranged(ratios, 1),
        median(ratios) >= TIMES_FASTER,
    )
    lines = list(section(promised, ours, theirs, count))
    print('\n'.join(lines))
    if not quick:
        document.write('Suites', lines)
    return 0 if promised.met else 1


if __name__ == '__main__':
    sys.exit(main())
