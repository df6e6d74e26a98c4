"""
Diagnoses runs that have nothing wrong, and says what is named all the same.

Simulated flights of several lengths, drifts and seeds; cars, wheeled robots and what is carried
by hand, against truth with noise of its own; the first seconds of published runs, as
the live node sees them; published runs on other data than benchmarks/confusion.py takes, which may
have something wrong; and how long it takes. Prints Markdown tables.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial, reduce
import json
import math
import os
from pathlib import Path
import time

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

from confusion import as_live
import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.diagnosis import diagnose, diagnose_run
from vio_eval_ros.diagnosis.report import Diagnosis
from vio_eval_ros.errors import NoPairs
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.simulation import Drift, simulate
from vio_eval_ros.simulation.drift import estimate
from vio_eval_ros.simulation.flight import FIRST_STAMP_NS

PROJECT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get('VIO_EVAL_ROS_DATA', PROJECT.parent / 'shared' / 'data'))
CONFIG = EvaluationConfig()
LENGTHS_S, SEEDS = (20.0, 60.0, 180.0), range(1000, 1020)
DRIFTS = (0.3, 1.0, 2.0, 4.0)
# a car drives too far for a VIO to stay within a hand's breadth
MOTIONS = {
    'flight': Drift(),
    'hand': Drift(),
    'floor': Drift(),
    'car': Drift(position_walk=0.05, position_noise=0.01),
}
STEP_S, TRUTH_NOISE = 0.0025, 1e-3
PREFIXES_S = (10, 20, 30, 45, 60)
SIZES = (1_200, 6_000, 20_000)
KITTI = 'evo_test_data/KITTI_00'
OTHERS = [
    ('evo_test_data/freiburg1_xyz-rgbdslam.txt', 'evo_test_data/freiburg1_xyz-groundtruth.txt'),
    ('evo_test_data/freiburg1_xyz-ORB_kf_mono.txt', 'evo_test_data/freiburg1_xyz-groundtruth.txt'),
    (
        'est_orbslam3/shanpenghui_tumvi/room4/raw/f_dataset-room4_512_mono.txt?stamps=ns',
        'gt_tumvi/open_vins/dataset-room4_512_16.txt',
    ),
    (
        'est_kimera/V1_01/traj_vio.csv?quaternion=wxyz',
        'gt_euroc/open_vins_tum/V1_01_easy.txt',
    ),
    ('est_vins_kavehsgh/vins_tum.txt', 'est_vins_kavehsgh/ground_truth.tum'),
    (f'{KITTI}_ORB.txt', f'{KITTI}_gt.txt'),
]


def main() -> None:
    """Print all tables."""
    table('drift', ((f'{times:g} times', partial(simulated, times)) for times in DRIFTS))
    table('motion', ((kind, partial(moving, kind)) for kind in MOTIONS))
    table('motion', ((kind, partial(intervals, kind)) for kind in MOTIONS))
    if DATA.is_dir():
        beginnings()
        others()
    durations()


def table(head: str, rows: Iterable[tuple[str, Callable[[float], str]]]) -> None:
    """Print a table with a column for each length; a row's cells are made by its function."""
    print(f'\n| {head} | ' + ' | '.join(f'{length:g} s' for length in LENGTHS_S) + ' |')
    print('|---|' + '---|' * len(LENGTHS_S))
    for name, cell in rows:
        print(f'| {name} | ' + ' | '.join(map(cell, LENGTHS_S)) + ' |')


def simulated(times: float, length_s: float) -> str:
    """Return what is named of flights whose drift is some times the usual."""
    usual = Drift()
    drift = Drift(
        times * usual.position_walk,
        times * usual.yaw_walk,
        1 + times * (usual.scale - 1),
        times * usual.position_noise,
        times * usual.orientation_noise,
    )
    flights = (simulate(length_s, seed=seed, drift=drift) for seed in SEEDS)
    return counted([diagnose(one.estimate, one.ground_truth, CONFIG) for one in flights])


def moving(kind: str, length_s: float) -> str:
    """Return what is named of a motion, against a truth that is noisy."""
    drift = MOTIONS[kind]
    return counted([diagnose(*moved(kind, seed, length_s, drift), CONFIG) for seed in SEEDS])


def intervals(kind: str, length_s: float) -> str:
    """Return how often 95 % intervals hold: of the scale, and of the offset by positions alone."""
    drift = MOTIONS[kind]
    held: Counter[str] = Counter()
    for seed in SEEDS:
        poses, truth = moved(kind, seed, length_s, drift)
        scale = diagnose(poses, truth, CONFIG).findings['scale']
        held['scale'] += abs(scale['value'] - drift.scale) <= scale['uncertainty']
        found = diagnose(poses, replace(truth, rotations=None), CONFIG).findings
        offset = found['time_offset']
        held['offset'] += abs(offset['value']) <= offset['uncertainty']
    return ', '.join(f'{name} {count} of {len(SEEDS)}' for name, count in held.items())


def moved(
    kind: str, seed: int, length_s: float, drift: Drift
) -> tuple[Trajectory, Trajectory]:  # fmt: skip
    """Return an estimate at 20 Hz and a truth at 200 Hz whose noise is 1 mm and 2 mrad."""
    source = np.random.default_rng(seed)
    if kind == 'flight':
        run = simulate(length_s, seed=seed, drift=drift)
        estimated, truth = run.estimate, run.ground_truth
    else:
        poses = ridden(kind, source, round(length_s / STEP_S))
        estimated, truth = estimate(poses[1::20], drift, source), poses[::2]
    assert truth.rotations is not None
    noise = source.normal(0, TRUTH_NOISE, (2, len(truth), 3))
    turns = rotation.from_rotation_vector(2 * noise[1])
    return estimated, replace(
        truth,
        positions=truth.positions + noise[0],
        rotations=rotation.multiply(truth.rotations, turns),
    )


def ridden(kind: str, source: np.random.Generator, count: int) -> Trajectory:
    """Return poses of a car, of a robot on a flat floor, or of what is carried by hand."""

    def smooth(over_s: float) -> np.ndarray:
        """Return (N,) noise of variance 1 that changes within so many seconds."""
        padded = count + round(20 * over_s / STEP_S)
        frequencies = np.fft.rfftfreq(padded, STEP_S)
        kept = np.exp(-0.5 * (2 * math.pi * frequencies * over_s) ** 2)
        values = np.fft.irfft(kept * np.fft.rfft(source.standard_normal(padded)), padded)[:count]
        return np.asarray(values / values.std())

    flat = np.zeros(count)
    if kind == 'hand':
        yaw, tips = 1.2 * smooth(1.5), [0.3 * smooth(0.5), 0.3 * smooth(0.5)]
        positions = np.stack([1.5 * smooth(3), 1.5 * smooth(3), 0.3 * smooth(1)], -1)
    else:
        speed = np.clip(8 + 3 * smooth(6), 0, None) if kind == 'car' else 0.5 + 0.3 * smooth(2)
        rate = 0.25 * smooth(2.5) * speed / 8 if kind == 'car' else 0.5 * smooth(1.5)
        yaw = np.cumsum(rate) * STEP_S
        height = 0.3 * smooth(8) if kind == 'car' else flat
        tips = [0.015 * smooth(0.3), 0.015 * smooth(0.3)] if kind == 'car' else [flat, flat]
        along = STEP_S * np.cumsum([speed * np.cos(yaw), speed * np.sin(yaw)], axis=1)
        positions = np.stack([*along, height], -1)
    turns = (
        rotation.from_rotation_vector(angle[:, None] * axis)
        for angle, axis in zip((yaw, *tips), np.eye(3)[[2, 1, 0]], strict=True)
    )
    stamps_ns = FIRST_STAMP_NS + round(1e9 * STEP_S) * np.arange(count)
    return Trajectory(stamps_ns, positions, reduce(rotation.multiply, turns))


def counted(found: list[Diagnosis]) -> str:
    """Return of how many runs something is named, and what."""
    names = Counter(cause.name for one in found for cause in one.causes)
    what = ', '.join(f'{count} {name}' for name, count in names.most_common())
    return f'{sum(bool(one.causes) for one in found)} of {len(found)}' + (f': {what}' * bool(what))


def beginnings() -> None:
    """Print what is named of the beginnings of runs and not of the whole, from pairs alone."""
    runs = [as_live(*poses_of(*specs)) for specs in published()]
    whole = [named(run) for run in runs]
    print('\n| first | runs | named, and not of the whole |\n|---|---:|---|')
    for seconds in PREFIXES_S:
        more: Counter[str] = Counter()
        count = 0
        for run, known in zip(runs, whole, strict=True):
            stamps_ns = run.estimate.stamps_ns
            rows = stamps_ns < stamps_ns[0] + seconds * 10**9
            try:
                more.update(named(run.of(run.estimate[rows], run.truth[rows])) - known)
            except NoPairs:
                continue
            count += 1
        what = ', '.join(f'{n} {name}' for name, n in more.most_common())
        print(f'| {seconds} s | {count} | {what or "nothing"} |')


def published() -> Iterator[tuple[str, str]]:
    """Yield the pairs of files of EuRoC runs."""
    for one in json.loads((DATA / 'golden.json').read_text()):
        if one['sequence'] in ('V1_02', 'MH_01', 'MH_05'):
            yield one['estimate'], one['ground_truth']


def poses_of(*specs: str) -> tuple[Trajectory, Trajectory]:
    """Return an estimate and its truth."""
    times = DATA / f'{KITTI}_gt_times.txt' if KITTI in specs[0] else None
    estimated, truth = (
        clean(source.poses, Cleaning())
        for source in read_sources([f'{DATA}/{spec}' for spec in specs], None, times)
    )
    return estimated, truth


def named(run: DiagnosedRun) -> set[str]:
    """Return the causes that are named of a run."""
    return {cause.name for cause in diagnose_run(run).causes}


def others() -> None:
    """Print what is named of runs on other data."""
    print('\n| run | named |\n|---|---|')
    for specs in OTHERS:
        found = diagnose(*poses_of(*specs), CONFIG)
        causes = [
            f'{cause.name} {cause.value:.3g}'
            + (f' ± {cause.uncertainty:.2g}' if math.isfinite(cause.uncertainty) else '')
            + f' {cause.unit}'
            for cause in found.causes
        ]
        name = specs[0].partition('?')[0].rpartition('/')[2]
        print(f'| {name} | {", ".join(causes) or "nothing"} |')


def durations() -> None:
    """Print how long a diagnosis takes."""
    print('\n| poses of estimate, truth | s |\n|---|---:|')
    for size in SIZES:
        run = simulate(size / 20)
        print(
            f'| {size:,}, {len(run.ground_truth):,} | {best_s(run.estimate, run.ground_truth)} |'
        )
        live = as_live(run.estimate, run.ground_truth)
        print(f'| {size:,}, as many (live) | {best_s(live.estimate, live.truth)} |')


def best_s(estimate: Trajectory, truth: Trajectory) -> str:
    """Return the shortest of three tries."""
    took = []
    for _ in range(3):
        began = time.perf_counter()
        diagnose(estimate, truth, CONFIG)
        took.append(time.perf_counter() - began)
    return f'{min(took):.2f}'


if __name__ == '__main__':
    main()
