"""
Healthy runs that repeat themselves, as simulators fly them: laps, figures of eight, lawnmowers.

Every one may be explained in more ways than one: late by a lap, seen from the other side. The
tests ask that none of it is called a fault.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from itertools import product
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.simulation import Drift
from vio_eval_ros.simulation.drift import estimate
from vio_eval_ros.simulation.flight import FIRST_STAMP_NS

#: of the motion, before either side samples it
STEP_S = 0.005
#: an estimator without errors, and two with some
DRIFTS = (
    Drift(0.0, 0.0, 1.0, 0.0, 0.0),
    Drift(scale=1.0),
    Drift(position_walk=0.03, yaw_walk=0.002, scale=0.985, position_noise=0.01),
)
SHAPES = ('circle', 'ellipse', 'eight', 'lawnmower', 'helix', 'square')
ATTITUDES = ('along the path', 'fixed', 'banked', 'looking at the centre', 'spinning')


class PeriodicRun(NamedTuple):
    """
    A run in laps, of which nothing is wrong.

    :param name: what it is, for messages.
    :param estimate: in its own world.
    :param truth: in that of the simulator.
    """

    name: str
    estimate: Trajectory
    truth: Trajectory


def periodic_runs() -> Iterator[PeriodicRun]:
    """Yield runs of every shape and attitude, with the rest drawn at random."""
    for seed, (shape, attitude) in enumerate(product(SHAPES, ATTITUDES)):
        yield periodic_run(shape, attitude, seed)


def periodic_run(shape: str, attitude: str, seed: int) -> PeriodicRun:
    """Return a run of a shape and an attitude; speed, rates, overlap and errors by the seed."""
    source = np.random.default_rng(seed)
    lap_s, laps = source.uniform(6, 40), source.uniform(2, 5)
    size_m, unevenness = source.choice([1.0, 3.0, 20.0]), source.choice([0.0, 0.0, 0.3])
    seconds = np.arange(0, lap_s * laps, STEP_S)
    phase = seconds / lap_s + unevenness / math.tau * np.sin(math.tau * seconds / lap_s)
    points = size_m * _path(shape, phase)
    stamps_ns = FIRST_STAMP_NS + np.round(seconds * 1e9).astype(np.int64)
    motion = Trajectory(stamps_ns, points, _attitude(attitude, points, phase))

    every, true_every = source.choice([7, 10, 20, 50]), source.choice([1, 2, 10, 25])
    drift = DRIFTS[source.integers(len(DRIFTS))]
    begin_s, end_s = source.choice([0, 0.5, 0.1 * lap_s * laps]), source.choice([0, 2.0])
    inside = (seconds >= begin_s) & (seconds < seconds[-1] - end_s)
    truth = motion[::true_every]
    poses = estimate(motion[inside][3::every], drift, source)
    name = (
        f'{shape} {attitude} {seed}: {lap_s:.0f} s x {laps:.1f}, {size_m:g} m, uneven '
        f'{unevenness:g}, {0.005 * every:g} and {0.005 * true_every:g} s, begins {begin_s:.1f}, '
        f'ends {end_s:g} s, noise {drift.position_noise:g} m'
    )
    return PeriodicRun(name, poses, truth)


def _path(shape: str, phase: np.ndarray) -> np.ndarray:
    """Return (N, 3) positions of a shape about 2 wide; the phase grows by 1 each lap."""
    angle = math.tau * phase
    flat = np.zeros(len(phase))
    if shape == 'circle':
        return np.stack([np.cos(angle), np.sin(angle), flat], -1)
    if shape == 'ellipse':
        return np.stack([np.cos(angle), 0.5 * np.sin(angle), 0.2 * np.sin(angle)], -1)
    if shape == 'eight':
        return np.stack([np.sin(angle), 0.5 * np.sin(2 * angle), 0.1 * np.cos(angle)], -1)
    if shape == 'helix':
        return np.stack([np.cos(angle), np.sin(angle), 0.3 * phase], -1)
    if shape == 'square':  # with rounded corners
        corner = angle + math.pi / 4
        radius = (np.cos(corner) ** 8 + np.sin(corner) ** 8) ** -0.125
        return np.stack([radius * np.cos(corner), radius * np.sin(corner), flat], -1)
    # a lawnmower: along x and back, one lane further at every turn
    lane = np.floor(2 * phase)
    within = 2 * phase - lane
    turning = np.clip((within - 0.8) / 0.2, 0, 1)
    forward = np.where(lane % 2 == 0, 1.0, -1.0)
    x = forward * (2 * np.clip(within / 0.8, 0, 1) - 1 + 0.3 * np.sin(math.pi * turning))
    return np.stack([x, 0.4 * lane + 0.2 * (1 - np.cos(math.pi * turning)), flat], -1)


def _attitude(attitude: str, points: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return (N, 4) orientations on a path."""
    flat = np.zeros(len(points))
    speed = np.gradient(points, axis=0)
    heading = np.unwrap(np.arctan2(speed[:, 1], speed[:, 0]))
    angles = {
        'along the path': (heading, flat, flat),
        'fixed': (flat, flat, flat),
        'banked': (heading, 0.1 * np.sin(math.tau * phase), 0.2 + 0.1 * np.cos(math.tau * phase)),
        'looking at the centre': (
            np.unwrap(np.arctan2(-points[:, 1], -points[:, 0])), flat + 0.3, flat,
        ),
        'spinning': (0.3 * math.tau * phase, 0.05 * np.sin(math.tau * phase), flat),
    }[attitude]  # fmt: skip
    return reduce(
        rotation.multiply,
        (
            rotation.from_rotation_vector(angle[:, None] * axis)
            for angle, axis in zip(angles, np.eye(3)[[2, 1, 0]], strict=True)
        ),
    )
