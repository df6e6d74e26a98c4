"""
Harms real runs in known ways and counts what the diagnosis calls it.

Writes the section Diagnosis of docs/benchmarks.md, with --quick only prints, of one run; exits
with 1 where a target is missed. A fault counts only where undoing it makes some error at least
5 % smaller.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
import json
import math
import os
from pathlib import Path
from statistics import median
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import document
from document import machine, ranged, Target, targets_table
import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun, improvement
from vio_eval_ros.diagnosis.diagnosis import diagnose, diagnose_run
from vio_eval_ros.diagnosis.report import Diagnosis
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.simulation import simulate, SimulatedRun, write_recording
from vio_eval_ros.simulation.faults import inject

PROJECT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get('VIO_EVAL_ROS_DATA', PROJECT.parent / 'shared' / 'data'))
SEQUENCES = ('V1_02', 'MH_01', 'MH_05')
MORE = (('V1_02', 'evo_test_data/V102.txt', 'gt_euroc/open_vins_tum/V1_02_medium.txt'),)
COUNTS = 0.05
SEED = 20
TITLE = 'Diagnosis'
QUICK = 'V102.txt'
EUROC_S, MOST_S, ROUNDS = 180.0, 2.0, 5


@dataclass(frozen=True, eq=False)
class Subject:
    """A real run and its name."""

    name: str
    estimate: Trajectory
    truth: Trajectory


@dataclass(frozen=True)
class Harm:
    """A fault and its sizes; called with poses, it puts itself into them."""

    name: str
    sizes: tuple[float, ...] = ()

    def __call__(self, poses: Trajectory, source: np.random.Generator) -> Trajectory:
        """Return the harmed poses."""
        run = SimulatedRun(estimate=poses)
        return inject(run, self.name, self.sizes, source).estimate


SIZES: dict[str, tuple[tuple[float, ...], ...]] = {
    'time_offset': ((0.01,), (-0.02,), (0.05,), (-0.1,), (0.2,)),
    'scale': ((0.9,), (0.95,), (1.05,), (1.1,)),
    'sensor_rotation': ((2,), (5,), (15,), (45,), (90,)),
    'lever_arm': ((0.05,), (0.1,), (0.2,), (0.3,)),
    'gravity_tilt': ((2,), (5,), (10,)),
    'jump': ((0.2,), (0.5,), (1,), (2,)),
    'outliers': ((0.005, 0.5), (0.005, 5), (0.01, 1), (0.05, 0.5), (0.05, 5)),
    'lost_tracking': ((0.05,), (0.1,), (0.2,), (0.5,)),
    'quaternion_order': ((1,), (-1,)),
    'quaternion_conjugated': ((),),
    'pose_inverted': ((),),
    'axes_swapped': ((),),
}
HARMS = {name: [Harm(name, each) for each in sizes] for name, sizes in SIZES.items()}
TWO = {
    'time_offset': (0.05,),
    'scale': (1.1,),
    'sensor_rotation': (10,),
    'lever_arm': (0.2,),
    'gravity_tilt': (5,),
    'jump': (1,),
    'outliers': (0.01, 2),
    'lost_tracking': (0.2,),
    'quaternion_conjugated': (),
}


def subjects() -> Iterator[Subject]:
    """Yield the real runs, each file once."""
    golden = json.loads((DATA / 'golden.json').read_text())
    listed = [
        (one['sequence'], one['estimate'], one['ground_truth'])
        for one in golden
        if one['sequence'] in SEQUENCES and not one['estimate'].endswith('vins_tum.txt')
    ]
    for sequence, *specs in (*listed, *MORE):
        read = read_sources([f'{DATA}/{spec}' for spec in specs])
        estimate, truth = (clean(source.poses, Cleaning()) for source in read)
        parts = specs[0].partition('?')[0].split('/')
        yield Subject(f'{sequence} {parts[1]} {parts[-1]}', estimate, truth)


def healthy(subject: Subject) -> tuple[Subject, Diagnosis]:
    """Return a run without what is really wrong with it, and the diagnosis of the published."""
    found = diagnose(subject.estimate, subject.truth, EvaluationConfig())
    return replace(subject, estimate=found.corrected), found


def as_live(estimate: Trajectory, truth: Trajectory) -> DiagnosedRun:
    """Return the run as the node has it, which keeps pairs alone."""
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_ground_truth(truth)
    evaluation.add_estimate(estimate)
    evaluation.flush()
    pairs = evaluation.summary().pairs
    return DiagnosedRun(pairs.estimate, pairs.ground_truth, EvaluationConfig())


def matters(before: Subject, after: Trajectory, name: str) -> bool:
    """Return whether undoing a harm makes any error smaller by 5 %."""
    if name == 'lost_tracking':
        return True
    errors = []
    for estimate in (after, before.estimate):
        run = DiagnosedRun(estimate, before.truth, EvaluationConfig())
        errors.append(run.errors(Correction(run.middle_ns)))
    _, as_harmed, undone = improvement(errors[0], errors[1])
    return undone <= (1 - COUNTS) * as_harmed


def differences(
    harm: Harm,
    subject: Subject,
    harmed: Trajectory,
    natural: Diagnosis,
    found: Diagnosis,
) -> dict[str, float]:
    """Return by how much what was recovered of a harm is off, by its name and unit."""
    before, after = natural.findings, found.findings
    name, size = harm.name, harm.sizes[0] if harm.sizes else math.nan
    value = after[name]['value'] if name in after else math.nan
    old, new = subject.estimate.rotations[0], harmed.rotations[0]
    if name == 'time_offset':
        # not relative to what the run had before: absolutely
        covered = abs(value - size) <= after[name]['uncertainty']
        return {'time offset [ms]': 1e3 * (value - size), 'its interval misses': 1.0 - covered}
    if name == 'scale':
        return {'scale [%]': 100 * (value / (before[name]['value'] * size) - 1)}
    if name == 'sensor_rotation':
        turn = rotation.multiply(rotation.conjugate(old), new)
        expected = rotation.multiply(
            rotation.conjugate(turn), np.array(before['sensor_rotation_xyzw'])
        )
        apart = rotation.angle_between(np.array(after['sensor_rotation_xyzw']), expected)
        return {'sensor rotation [deg]': math.degrees(apart)}
    if name == 'lever_arm':
        moved = harmed.positions[0] - subject.estimate.positions[0]
        expected = np.array(before['lever_arm_m']) - rotation.rotate(
            rotation.conjugate(old), moved
        )
        return {
            'lever arm [cm]': 100
            * float(np.linalg.norm(np.array(after['lever_arm_m']) - expected))
        }
    if name == 'gravity_tilt':
        up = rotation.multiply(new, rotation.conjugate(old))
        expected = rotation.rotate(up, _up(before))
        return {'tilt [deg]': math.degrees(math.acos(min(1.0, float(_up(after) @ expected))))}
    if name == 'jump':
        first = int(
            np.flatnonzero((harmed.positions != subject.estimate.positions).any(axis=1))[0]
        )
        jumps = [jump for jump in after['jumps'] if jump['harmful']]
        largest = max(jumps, key=lambda jump: jump['size_m'])
        samples = int(np.searchsorted(harmed.stamps_ns, largest['stamp_ns'])) - first
        return {
            'jump stamp [samples]': samples,
            'jump size [cm]': 100 * (largest['size_m'] - size),
        }
    return {}


def _up(findings: dict[str, Any]) -> np.ndarray:
    """Return the vertical in the estimate's world."""
    level = np.array(findings['level_xyzw'])
    return rotation.rotate(rotation.conjugate(level), np.array([0.0, 0.0, 1.0]))


def offsets(subject: Subject, source: np.random.Generator) -> Iterator[tuple[float, bool]]:
    """Yield the error [ms] of offsets against truth of several rates, and if it is covered."""
    for rate_hz in (10, 20, 50, 100, 200):
        stamps_s = (subject.truth.stamps_ns - subject.truth.stamps_ns[0]) / 1e9
        _, first = np.unique(np.floor(stamps_s * rate_hz + 1e-6), return_index=True)
        offset_s = float(source.uniform(-0.2, 0.2))
        late = Harm('time_offset', (offset_s,))(subject.estimate, source)
        found = diagnose(late, subject.truth[first], EvaluationConfig()).findings['time_offset']
        error_s = found['value'] - round(offset_s * 1e9) / 1e9
        yield 1e3 * error_s, abs(error_s) <= found['uncertainty']


@dataclass(eq=False)
class Counts:
    """
    What the diagnosis called what.

    :param matrix: how often each first cause was named, by what was put in.
    :param too_small: faults that do not count, by name.
    :param both: whether both of two faults were named.
    :param same_live: whether the first cause is the same from the pairs alone.
    :param recovered: by how much what was measured is off, by its name and unit.
    """

    matrix: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    too_small: Counter[str] = field(default_factory=Counter)
    both: list[bool] = field(default_factory=list)
    same_live: list[bool] = field(default_factory=list)
    recovered: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    failures: list[str] = field(default_factory=list)

    def add(self, subject: Subject, source: np.random.Generator) -> None:
        """Put every fault into a run, and two at once."""
        natural = self._unharmed(subject)
        for harms in HARMS.values():
            for harm in harms:
                self._harmed(subject, natural, harm, source)
        for error_ms, covered in offsets(subject, source):
            self.recovered['offset, truth of 10 to 200 Hz [ms]'].append(error_ms)
            self.recovered['its interval misses, 10 to 200 Hz'].append(1.0 - covered)
        kinds = list(TWO)
        for _ in range(6):
            pair = [kinds[k] for k in sorted(source.choice(len(kinds), 2, replace=False))]
            harmed = subject.estimate
            for name in pair:
                harmed = Harm(name, TWO[name])(harmed, source)
            named = _named(diagnose(harmed, subject.truth, EvaluationConfig()))
            self.both.append(set(named) >= set(pair))
            if not self.both[-1]:
                self.failures.append(f'{subject.name} {pair}: {named}')

    def _unharmed(self, subject: Subject) -> Diagnosis:
        found = diagnose(subject.estimate, subject.truth, EvaluationConfig())
        named = _named(found)
        self.matrix['unharmed'][named[0] if named else 'nothing'] += 1
        if named:
            self.failures.append(f'{subject.name} unharmed: {named}')
        return found

    def _harmed(
        self, subject: Subject, natural: Diagnosis, harm: Harm, source: np.random.Generator
    ) -> None:
        harmed = harm(subject.estimate, source)
        if not matters(subject, harmed, harm.name):
            self.too_small[harm.name] += 1
            return
        found = diagnose(harmed, subject.truth, EvaluationConfig())
        named = _named(found)
        self.matrix[harm.name][named[0] if named else 'nothing'] += 1
        live = _named(diagnose_run(as_live(harmed, subject.truth)))
        self.same_live.append(named[:1] == live[:1])
        if not self.same_live[-1]:
            self.failures.append(f'{subject.name} {harm.name} {harm.sizes}: {named}, live {live}')
        if not named or named[0] != harm.name:
            about = found.findings.get(harm.name)
            self.failures.append(f'{subject.name} {harm.name} {harm.sizes}: {named} {about}')
            return
        off = differences(harm, subject, harmed, natural, found)
        for label, value in off.items():
            self.recovered[label].append(value)

    def targets(self) -> Iterator[Target]:
        """Yield what is promised of the names."""
        right = sum(row[name] for name, row in self.matrix.items())
        faults = sum(sum(row.values()) for row in self.matrix.values())
        runs = sum(self.matrix['unharmed'].values())
        alarms = runs - self.matrix['unharmed']['nothing']
        faults -= runs
        for promise, count, total, met in (
            ('first cause right: at least 95 %', right, faults, right >= 0.95 * faults),
            ('false alarms: at most 2 %', alarms, runs, alarms <= 0.02 * runs),
            (
                'two faults, both named: at least 80 %',
                sum(self.both),
                len(self.both),
                sum(self.both) >= 0.8 * len(self.both),
            ),
            (
                'the same first cause live, from pairs alone: at least 95 %',
                sum(self.same_live),
                len(self.same_live),
                sum(self.same_live) >= 0.95 * len(self.same_live),
            ),
        ):
            yield Target(promise, f'{count} of {total} ({100 * count / total:.1f} %)', met)

    def tables(self) -> Iterator[str]:
        """Yield the confusion matrix and the recovered values as Markdown."""
        named = (name for row in self.matrix.values() for name in row)
        columns = list(dict.fromkeys(['nothing', *HARMS, *named]))
        yield '| harmed by | ' + ' | '.join(columns) + ' | too small |'
        yield '|---' * (len(columns) + 2) + '|'
        for name, row in self.matrix.items():
            cells = [str(row[column] or '') for column in columns]
            yield f'| {name} | ' + ' | '.join(cells) + f' | {self.too_small[name] or ""} |'
        yield ''
        yield '| recovered | cases | median | p95 | worst | mean |'
        yield '|---|---:|---:|---:|---:|---:|'
        for label, errors in self.recovered.items():
            off = np.abs(errors)
            figures = (np.median(off), np.quantile(off, 0.95), off.max(), off.mean())
            yield f'| {label} | {len(off)} | ' + ' | '.join(f'{v:.2g}' for v in figures) + ' |'


def _named(found: Diagnosis) -> list[str]:
    return [cause.name for cause in found.causes]


def seconds_of_a_run(rounds: int) -> list[float]:
    """Return how long `diagnose` takes for a run of EuRoC size with two faults."""
    seconds = []
    with TemporaryDirectory() as folder:
        path = Path(folder, 'run.mcap')
        run = simulate(duration_s=EUROC_S)
        for name in ('time_offset', 'scale'):
            run = inject(run, name, TWO[name], np.random.default_rng(SEED))
        write_recording(run, path)
        for _ in range(rounds):
            begin = time.perf_counter()
            subprocess.run(
                [sys.executable, '-m', 'vio_eval_ros', 'diagnose', path],
                stdout=subprocess.DEVNULL,
                cwd=PROJECT,
                check=True,
            )
            seconds.append(time.perf_counter() - begin)
    return seconds


def main() -> int:
    """Run all, print and write; return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help=f'of {QUICK} only; writes nothing')
    parser.add_argument('--failures', action='store_true', help='list every miss')
    parser.add_argument('--only', help='runs whose name contains this; writes nothing')
    arguments = parser.parse_args()
    if not DATA.is_dir():
        print(f'{DATA}: there are no published runs to harm', file=sys.stderr)
        return 0
    only = QUICK if arguments.quick else arguments.only or ''
    source = np.random.default_rng(SEED)
    counts, number = Counts(), 0
    for published in subjects():
        if only not in published.name:
            continue
        subject, first = healthy(published)
        if first.causes:
            print('as published:', published.name, _named(first), file=sys.stderr)
        counts.add(subject, source)
        number += 1
    seconds = seconds_of_a_run(1 if only else ROUNDS)
    took = Target(
        f'A run of {EUROC_S:g} s, 36,000 true poses and 3,600 estimates: at most {MOST_S:g} s',
        f'{ranged(seconds, 2)} s',
        median(seconds) <= MOST_S,
    )
    promised = [*counts.targets(), took]
    lines = [
        f'Faults injected into {number} published runs, and what `diagnose` names them. '
        'Measured by `benchmarks/confusion.py`.',
        '',
        *targets_table(promised),
        '',
        *counts.tables(),
        '',
        'Rows are injected faults, columns the first cause named. A fault is too small if '
        'undoing it makes no error smaller by 5 %. Failures are explained in '
        '[diagnose](diagnose.md). Time is that of the whole process, reading an mcap file '
        'included.',
        '',
        machine('numpy', 'mcap'),
    ]
    print('\n'.join(lines))
    if arguments.failures:
        print('\n'.join(counts.failures))
    if not only:
        document.write(TITLE, lines)
    return 0 if all(target.met for target in promised) else 1


if __name__ == '__main__':
    sys.exit(main())
