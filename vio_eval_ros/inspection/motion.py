"""Whether a stream of poses moves as something real does: speeds, jumps, frozen poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vio_eval_ros.core import rotation
from vio_eval_ros.core.sensor_stream import runs, SensorStream, spread
from vio_eval_ros.core.steps import step_lengths
from vio_eval_ros.inspection.findings import are, Finding
from vio_eval_ros.inspection.timing import Timing

FROZEN_POSES = 5
# A jump: faster than its neighbourhood by far, and far
JUMP_M, JUMP_SPREADS, JUMP_TIMES, NEIGHBOURS = 0.05, 10.0, 3.0, 11
# A turn of the head: the same of rotations
JUMP_RAD = 0.2
# Faster than cars on a motorway, and than drones that race tumble
FASTEST_M_S, FASTEST_RAD_S = 60.0, 25.0
UNIT = 0.01


@dataclass(frozen=True)
class Motion:
    """
    Figures of a stream of poses; NaN where they cannot be told.

    :param path_m: length of the path through all positions.
    :param jumps: how often the position steps aside, and ``turns``, the orientation.
    :param frozen: poses that repeat the one before, in runs of five and more.
    """

    path_m: float
    speed_median_m_s: float
    speed_p99_m_s: float
    rotation_p99_rad_s: float
    jumps: int
    turns: int
    frozen: int
    not_finite: int


def motion(stream: SensorStream, timing: Timing) -> tuple[Motion | None, list[Finding]]:
    """Return the figures of a stream of poses, and what is wrong with them; None of too few."""
    numbers = stream.numbers
    assert numbers is not None
    order = np.argsort(stream.times_ns, kind='stable')
    is_good = stream.is_usable
    order = order[is_good[order]]
    order = order[np.concatenate([[True], np.diff(stream.times_ns[order]) > 0])[: len(order)]]
    findings = list(_numbers(stream, is_good))
    if len(order) < 3 or not math.isfinite(timing.period_s):
        return None, findings
    poses, times = numbers[order], stream.times_ns[order]
    # stamps nearer to each other than half a period would make any noise a speed
    seconds = np.maximum(np.diff(times) / 1e9, timing.period_s / 2)
    steps = step_lengths(poses[:, :3])
    speeds = steps / seconds
    turns = np.full(len(speeds), math.nan)
    if poses.shape[1] == 7 and poses[:, 3:].any(axis=1).all():
        q = rotation.normalize(poses[:, 3:])
        turns = rotation.angle_between(q[:-1], q[1:]) / seconds
    jumps = _jumps(speeds, seconds, JUMP_M)
    leaps = _jumps(turns, seconds, JUMP_RAD)
    begins, ends = _frozen(poses)
    found = Motion(
        float(steps.sum()),
        float(np.median(speeds)),
        float(np.quantile(speeds, 0.99)),
        float(np.quantile(turns, 0.99)),
        len(jumps),
        len(leaps),
        int(np.sum(ends - begins)),
        int(np.sum(~is_good)),
    )
    findings += _jump(stream, order, steps, jumps, 'm')
    findings += _jump(stream, order, turns * seconds, leaps, 'rad')
    findings += _frozen_finding(stream, order, steps, begins, ends)
    findings += _speeds(stream, found)
    return found, findings


def _jumps(speeds: np.ndarray, seconds: np.ndarray, least: float) -> np.ndarray:
    """Return the steps that are much faster than those around them, and than nearly all."""
    if len(speeds) < NEIGHBOURS or np.isnan(speeds).any():
        return np.empty(0, int)
    padded = np.pad(speeds, NEIGHBOURS // 2, mode='reflect')
    excess = speeds - np.median(sliding_window_view(padded, NEIGHBOURS), axis=1)
    limit = np.maximum(least / seconds, JUMP_SPREADS * spread(excess))
    return np.flatnonzero((excess > limit) & (speeds > JUMP_TIMES * np.quantile(speeds, 0.95)))


def _frozen(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where runs of poses that repeat one begin, and the index behind their end."""
    begins, ends = runs((poses[1:] == poses[:-1]).all(axis=1))
    long = ends + 1 - begins >= FROZEN_POSES
    return begins[long], ends[long] + 1


def _numbers(stream: SensorStream, is_good: np.ndarray) -> Iterator[Finding]:
    numbers = stream.numbers
    assert numbers is not None
    if not is_good.all():
        which = np.flatnonzero(~is_good)
        yield Finding(
            'not_finite', stream.topic, 'warn', f'{are(len(which), "pose")} not finite',
            len(which), moments=stream.moments(which, which),
        )  # fmt: skip
    if numbers.shape[1] == 7:
        off = np.abs(np.linalg.norm(np.where(is_good[:, None], numbers[:, 3:], 0.5), axis=1) - 1)
        which = np.flatnonzero(off > UNIT)
        if len(which):
            yield Finding(
                'quaternion_norm', stream.topic, 'warn',
                f'{are(len(which), "quaternion")} not of length 1, by up to {off.max():.3g}',
                len(which), float(off.max()), '', stream.moments(which, which),
            )  # fmt: skip


def _jump(
    stream: SensorStream, order: np.ndarray, steps: np.ndarray, jumps: np.ndarray, unit: str
) -> Iterator[Finding]:
    if len(jumps):
        largest = float(steps[jumps].max())
        yield Finding(
            'jump', stream.topic, 'warn',
            f'{are(len(jumps), "step")} far faster than the motion around, the largest of '
            f'{largest:.3g} {unit}',
            len(jumps), largest, unit, stream.moments(order[jumps], order[jumps + 1]),
        )  # fmt: skip


def _frozen_finding(
    stream: SensorStream,
    order: np.ndarray,
    steps: np.ndarray,
    begins: np.ndarray,
    ends: np.ndarray,
) -> Iterator[Finding]:
    """Yield the runs of equal poses: frozen where the motion went on behind them, else at rest."""
    if not len(begins):
        return
    moving = steps[steps > 0]
    usual = float(np.median(moving)) if len(moving) else math.inf
    before = np.append(0.0, steps)[begins]
    after = np.append(steps, 0.0)[ends - 1]
    # what catches up with the truth leaps, what begins to move does not
    is_abrupt = (after > 2 * usual) | ((ends == len(order)) & (before > 0.5 * usual))
    for abrupt, level, words in (
        (True, 'warn', 'though it moved on meanwhile'),
        (False, 'info', 'as if at rest'),
    ):
        which = is_abrupt == abrupt
        if which.any():
            count = int(np.sum((ends - begins)[which]))
            longest = (stream.times_ns[order[ends - 1]] - stream.times_ns[order[begins]])[which]
            yield Finding(
                'frozen', stream.topic, level,
                f'{count} poses repeat the one before to the last bit, for up to '
                f'{longest.max() / 1e9:.3g} s, {words}',
                count, float(longest.max() / 1e9), 's',
                stream.moments(order[begins[which]], order[ends[which] - 1]),
            )  # fmt: skip


def _speeds(stream: SensorStream, found: Motion) -> Iterator[Finding]:
    figures = (
        (found.speed_p99_m_s, FASTEST_M_S, 'm/s'),
        (found.rotation_p99_rad_s, FASTEST_RAD_S, 'rad/s'),
    )
    for value, fastest, unit in figures:
        if value > fastest:
            yield Finding(
                'implausible_motion', stream.topic, 'warn',
                f'1 % of the poses move at more than {value:.3g} {unit}',
                value=value, unit=unit,
            )  # fmt: skip
