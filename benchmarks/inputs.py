"""Writes the trajectories that are timed: a smooth flight and a drifting estimate of it."""

from __future__ import annotations

from pathlib import Path
import sys
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory

FIRST_STAMP_NS = 1_403_636_579_763_555_584
ESTIMATE_DELAY_NS = 1_300_000
BLOCK_ROWS = 10_000


class Size(NamedTuple):
    """How many poses, and how far apart they are."""

    truths: int
    truth_period_ns: int
    estimates: int
    estimate_period_ns: int


# At 20 Hz 100,000 poses are already much longer than the longest segments of the KITTI metric, so
# that ten times the poses are ten times the work.
SIZES = {
    'euroc': Size(36_000, 5_000_000, 3_600, 50_000_000),
    'hundred': Size(100, 50_000_000, 100, 50_000_000),
    'hundred_thousand': Size(100_000, 50_000_000, 100_000, 50_000_000),
    'million': Size(1_000_000, 50_000_000, 1_000_000, 50_000_000),
}


def fly(stamps_ns: np.ndarray) -> Trajectory:
    """Return the true poses: some 10 m across, at about 2 m/s, never twice the same."""
    seconds = (stamps_ns - FIRST_STAMP_NS)[:, None] / 1e9
    positions = 4.0 * np.sin(seconds * [0.31, 0.37, 0.23]) + 0.5 * np.sin(
        seconds * [1.1, 1.3, 0.7] + 1.0
    )
    turns = np.sin(seconds * [0.41, 0.29, 0.17]) * [0.4, 0.4, 2.5]
    return Trajectory(stamps_ns, positions, rotation.from_rotation_vector(turns))


def estimate(truth: Trajectory, source: np.random.Generator) -> Trajectory:
    """Return the poses with slow drift and white noise, in a world of their own."""
    assert truth.rotations is not None
    seconds = (truth.stamps_ns - FIRST_STAMP_NS)[:, None] / 1e9
    drift = 0.1 * np.sin(seconds * [0.013, 0.017, 0.011])
    noise = source.normal(0.0, 0.003, (2, len(truth), 3))
    turn = rotation.from_rotation_vector(np.array([0.0, 0.0, 0.7]))
    origin = np.array([1.0, -2.0, 0.5])
    wobble = rotation.from_rotation_vector(noise[1])
    return Trajectory(
        truth.stamps_ns,
        origin + rotation.rotate(turn, truth.positions + drift + noise[0]),
        rotation.multiply(turn, rotation.multiply(wobble, truth.rotations)),
    )


def write_tum(path: Path, poses: Trajectory) -> None:
    """Write a TUM file with 9 decimals; stamps keep all their digits."""
    assert poses.rotations is not None
    seconds, rest = np.divmod(poses.stamps_ns, 10**9)
    numbers = np.column_stack([poses.positions, poses.rotations])
    with path.open('w', encoding='ascii') as file:
        for k in range(0, len(poses), BLOCK_ROWS):
            block = slice(k, k + BLOCK_ROWS)
            file.writelines(
                '%d.%09d %.9f %.9f %.9f %.9f %.9f %.9f %.9f\n' % (s, r, *row)  # noqa: UP031
                for s, r, row in zip(
                    seconds[block].tolist(),
                    rest[block].tolist(),
                    numbers[block].tolist(),
                    strict=True,
                )
            )


def write(folder: Path, name: str) -> None:
    """Write ``NAME_truth.txt`` and ``NAME_estimate.txt``, the same ones every time."""
    size = SIZES[name]
    truth_ns = FIRST_STAMP_NS + size.truth_period_ns * np.arange(size.truths)
    estimate_ns = (
        FIRST_STAMP_NS + ESTIMATE_DELAY_NS + size.estimate_period_ns * np.arange(size.estimates)
    )
    write_tum(folder / f'{name}_truth.txt', fly(truth_ns))
    write_tum(
        folder / f'{name}_estimate.txt', estimate(fly(estimate_ns), np.random.default_rng(1))
    )


if __name__ == '__main__':
    for wanted in sys.argv[2:]:
        write(Path(sys.argv[1]), wanted)
