"""
Harms real runs in known ways and counts what the diagnosis calls it.

Prints the confusion matrix and the recovered values as Markdown tables; ``--failures`` lists every
miss. A fault counts only where undoing it makes some error at least 5 % smaller.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import json
import math
import os
from pathlib import Path
import sys
from typing import Any

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import clean, Cleaning, Trajectory
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosis import diagnose, Diagnosis
from vio_eval_ros.diagnosis.run import improvement, Run
from vio_eval_ros.recordings.sources import read_sources

PROJECT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get('VIO_EVAL_ROS_DATA', PROJECT.parent / 'shared' / 'data'))
SEQUENCES = ('V1_02', 'MH_01', 'MH_05')
MORE = (('V1_02', 'evo_test_data/V102.txt', 'gt_euroc/open_vins_tum/V1_02_medium.txt'),)
COUNTS = 0.05
SEED = 20


@dataclass(frozen=True, eq=False)
class Subject:
    """A real run and its name."""

    name: str
    estimate: Trajectory
    truth: Trajectory


Harm = Callable[[Trajectory, np.random.Generator], Trajectory]


def _vector(source: np.random.Generator, length: float) -> np.ndarray:
    direction = source.normal(size=3)
    return np.asarray(length * direction / np.linalg.norm(direction))


def shifted(seconds: float) -> Harm:
    """Return a harm that makes stamps late."""
    return lambda poses, source: replace(poses, stamps_ns=poses.stamps_ns + round(seconds * 1e9))


def scaled(factor: float) -> Harm:
    """Return a harm that makes the run larger."""
    return lambda poses, source: replace(poses, positions=factor * poses.positions)


def turned(degrees: float) -> Harm:
    """Return a harm that turns the sensor."""

    def harm(poses: Trajectory, source: np.random.Generator) -> Trajectory:
        turn = rotation.from_rotation_vector(_vector(source, math.radians(degrees)))
        return replace(poses, rotations=rotation.multiply(poses.rotations, turn))

    return harm


def displaced(metres: float) -> Harm:
    """Return a harm that moves the sensor."""

    def harm(poses: Trajectory, source: np.random.Generator) -> Trajectory:
        lever = rotation.rotate(poses.rotations, _vector(source, metres))
        return replace(poses, positions=poses.positions + lever)

    return harm


def tilted(degrees: float) -> Harm:
    """Return a harm that tilts the world."""

    def harm(poses: Trajectory, source: np.random.Generator) -> Trajectory:
        heading = source.uniform(0, 2 * math.pi)
        axis = np.array([math.cos(heading), math.sin(heading), 0.0])
        turn = rotation.from_rotation_vector(axis * math.radians(degrees))
        return replace(
            poses,
            positions=rotation.rotate(turn, poses.positions),
            rotations=rotation.multiply(turn, poses.rotations),
        )

    return harm


def jumped(metres: float) -> Harm:
    """Return a harm that displaces all poses from one on."""

    def harm(poses: Trajectory, source: np.random.Generator) -> Trajectory:
        first = int(source.uniform(0.15, 0.85) * len(poses))
        positions = poses.positions.copy()
        positions[first:] += _vector(source, metres)
        return replace(poses, positions=positions)

    return harm


def scattered(share: float, metres: float) -> Harm:
    """Return a harm that displaces single poses."""

    def harm(poses: Trajectory, source: np.random.Generator) -> Trajectory:
        count = max(1, round(share * len(poses)))
        positions = poses.positions.copy()
        for k in source.choice(len(poses), count, replace=False):
            positions[k] += _vector(source, metres)
        return replace(poses, positions=positions)

    return harm


def cut(share: float) -> Harm:
    """Return a harm that leaves an interval out, or the end."""

    def harm(poses: Trajectory, source: np.random.Generator) -> Trajectory:
        duration_ns = poses.stamps_ns[-1] - poses.stamps_ns[0]
        begin = poses.stamps_ns[0] + source.uniform(0.1, 1.0 - share) * duration_ns
        return poses[(poses.stamps_ns < begin) | (poses.stamps_ns > begin + share * duration_ns)]

    return harm


def reordered(order: list[int]) -> Harm:
    """Return a harm that mistakes the order of the quaternion."""
    return lambda poses, source: replace(poses, rotations=poses.rotations[:, order])


def conjugated(poses: Trajectory, source: np.random.Generator) -> Trajectory:
    """Return the poses with inverse rotations."""
    return replace(poses, rotations=rotation.conjugate(poses.rotations))


def inverted(poses: Trajectory, source: np.random.Generator) -> Trajectory:
    """Return the inverse poses."""
    back = rotation.conjugate(poses.rotations)
    return replace(poses, positions=-rotation.rotate(back, poses.positions), rotations=back)


def swapped(poses: Trajectory, source: np.random.Generator) -> Trajectory:
    """Return the poses with two axes of their positions swapped."""
    return replace(poses, positions=poses.positions[:, [1, 0, 2]])


HARMS: dict[str, list[tuple[float, Harm]]] = {
    'time_offset': [(s, shifted(s)) for s in (0.01, -0.02, 0.05, -0.1, 0.2)],
    'scale': [(s, scaled(s)) for s in (0.9, 0.95, 1.05, 1.1)],
    'sensor_rotation': [(a, turned(a)) for a in (2, 5, 15, 45, 90)],
    'lever_arm': [(m, displaced(m)) for m in (0.05, 0.1, 0.2, 0.3)],
    'gravity_tilt': [(a, tilted(a)) for a in (2, 5, 10)],
    'jump': [(m, jumped(m)) for m in (0.2, 0.5, 1, 2)],
    'outliers': [
        (share, scattered(share, metres))
        for share, metres in ((0.005, 0.5), (0.005, 5), (0.01, 1), (0.05, 0.5), (0.05, 5))
    ],
    'lost_tracking': [(share, cut(share)) for share in (0.05, 0.1, 0.2, 0.5)],
    'quaternion_order': [(0, reordered([3, 0, 1, 2])), (1, reordered([1, 2, 3, 0]))],
    'quaternion_conjugated': [(0, conjugated)],
    'pose_inverted': [(0, inverted)],
    'axes_swapped': [(0, swapped)],
}
TWO = {
    'time_offset': shifted(0.05),
    'scale': scaled(1.1),
    'sensor_rotation': turned(10),
    'lever_arm': displaced(0.2),
    'gravity_tilt': tilted(5),
    'jump': jumped(1),
    'outliers': scattered(0.01, 2),
    'lost_tracking': cut(0.2),
    'quaternion_conjugated': conjugated,
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
        estimate, truth = (
            clean(source.poses, Cleaning(), zero_stamps=source.zero_stamps) for source in read
        )
        parts = specs[0].partition('?')[0].split('/')
        yield Subject(f'{sequence} {parts[1]} {parts[-1]}', estimate, truth)


def healthy(subject: Subject) -> tuple[Subject, Diagnosis]:
    """Return a run without what is really wrong with it, and the diagnosis of the published."""
    found = diagnose(subject.estimate, subject.truth, EvaluationConfig())
    return replace(subject, estimate=found.corrected), found


def matters(before: Subject, after: Trajectory, name: str) -> bool:
    """Return whether undoing a harm makes any error smaller by 5 %."""
    if name == 'lost_tracking':
        return True
    errors = []
    for estimate in (after, before.estimate):
        run = Run(estimate, before.truth, EvaluationConfig())
        errors.append(run.errors(Correction(run.middle_ns)))
    _, as_harmed, undone = improvement(errors[0], errors[1])
    return undone <= (1 - COUNTS) * as_harmed


def differences(
    name: str,
    size: float,
    subject: Subject,
    harmed: Trajectory,
    natural: Diagnosis,
    found: Diagnosis,
) -> dict[str, float]:
    """Return by how much what was recovered of a harm is off, by its name and unit."""
    before, after = natural.findings, found.findings
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
        late = shifted(offset_s)(subject.estimate, source)
        found = diagnose(late, subject.truth[first], EvaluationConfig()).findings['time_offset']
        error_s = found['value'] - round(offset_s * 1e9) / 1e9
        yield 1e3 * error_s, abs(error_s) <= found['uncertainty']


def main() -> int:
    """Run all; return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--failures', action='store_true', help='list every miss')
    parser.add_argument('--only', help='runs whose name contains this')
    arguments = parser.parse_args()
    source = np.random.default_rng(SEED)
    matrix: dict[str, Counter[str]] = defaultdict(Counter)
    skipped: Counter[str] = Counter()
    failures, recovered = [], defaultdict(list)
    both = [0, 0]
    for published in subjects():
        if arguments.only and arguments.only not in published.name:
            continue
        subject, first = healthy(published)
        if first.causes:
            print('as published:', published.name, [c.name for c in first.causes], file=sys.stderr)
        natural = diagnose(subject.estimate, subject.truth, EvaluationConfig())
        named = natural.causes[0].name if natural.causes else 'nothing'
        matrix['unharmed'][named] += 1
        if natural.causes:
            failures.append(f'{subject.name} unharmed: {[c.name for c in natural.causes]}')
        for name, sizes in HARMS.items():
            for size, harm in sizes:
                harmed = harm(subject.estimate, source)
                if not matters(subject, harmed, name):
                    skipped[name] += 1
                    continue
                found = diagnose(harmed, subject.truth, EvaluationConfig())
                names = [cause.name for cause in found.causes]
                matrix[name][names[0] if names else 'nothing'] += 1
                if not names or names[0] != name:
                    about = found.findings.get(name)
                    failures.append(f'{subject.name} {name} {size}: {names} {about}')
                else:
                    off = differences(name, size, subject, harmed, natural, found)
                    for label, value in off.items():
                        recovered[label].append(value)
        for error_ms, covered in offsets(subject, source):
            recovered['offset, truth of 10 to 200 Hz [ms]'].append(error_ms)
            recovered['its interval misses, 10 to 200 Hz'].append(1.0 - covered)
        kinds = list(TWO)
        for _ in range(6):
            pair = [kinds[k] for k in sorted(source.choice(len(kinds), 2, replace=False))]
            harmed = subject.estimate
            for name in pair:
                harmed = TWO[name](harmed, source)
            found = diagnose(harmed, subject.truth, EvaluationConfig())
            names = {cause.name for cause in found.causes}
            both[0] += names >= set(pair)
            both[1] += 1
            if not names >= set(pair):
                failures.append(f'{subject.name} {pair}: {[c.name for c in found.causes]}')
    columns = [*dict.fromkeys(['nothing', *HARMS, *(n for row in matrix.values() for n in row)])]
    print('| harmed by | ' + ' | '.join(columns) + ' | too small |')
    print('|---' * (len(columns) + 2) + '|')
    for name, row in matrix.items():
        cells = [str(row[column] or '') for column in columns]
        print(f'| {name} | ' + ' | '.join(cells) + f' | {skipped[name] or ""} |')
    right = sum(row[name] for name, row in matrix.items())
    total = sum(sum(row.values()) for name, row in matrix.items() if name != 'unharmed')
    print(f'\nright first cause {right} of {total} ({100 * right / total:.1f} %)')
    alarms = sum(matrix['unharmed'].values()) - matrix['unharmed']['nothing']
    print(f'false alarms {alarms} of {sum(matrix["unharmed"].values())}')
    print(f'two faults both named {both[0]} of {both[1]}')
    print('\n| recovered | cases | median | p95 | worst | mean |')
    print('|---|---:|---:|---:|---:|---:|')
    for label, errors in recovered.items():
        off = np.abs(errors)
        columns = (np.median(off), np.quantile(off, 0.95), off.max(), off.mean())
        print(f'| {label} | {len(off)} | ' + ' | '.join(f'{v:.2g}' for v in columns) + ' |')
    if arguments.failures:
        print('\n'.join(failures))
    return int(right < 0.95 * total or alarms > 0.02 * len(matrix) or both[0] < 0.8 * both[1])


if __name__ == '__main__':
    sys.exit(main())
