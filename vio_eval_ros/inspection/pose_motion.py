"""Whether a stream of poses moves as something real does: speeds, jumps, frozen poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vio_eval_ros.core import rotation
from vio_eval_ros.core.orientations import why_positions_only
from vio_eval_ros.core.sensor_stream import runs, SensorStream, spread
from vio_eval_ros.core.steps import step_lengths
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.inspection.finding import are, Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.measured_stream import PoseMotion, Timing

#: steps around a jump of which the median is the usual speed
JUMP_NEIGHBOURS = 11
#: excess of a jump over that speed, in spreads of the excess of all steps
JUMP_SPREADS = 10.0
#: speed of a jump, over the 95th percentile of all
JUMP_FACTOR = 3.0
#: step after frozen poses, over the usual one: they catch up
CATCHING_UP = 2.0
#: step before poses that are frozen until the end of the recording, over the usual one
MOVING = 0.5


def pose_motion(
    stream: SensorStream, timing: Timing, limits: InspectionLimits
) -> tuple[PoseMotion | None, list[Finding]]:
    """Return the figures of a stream of poses, and what is wrong with them; None of too few."""
    findings = []
    if why := _why_positions_only(stream):
        findings.append(FINDINGS['positions_only'].found(stream, why=why, count=len(stream)))
        assert stream.numbers is not None
        stream = replace(stream, numbers=stream.numbers[:, :3])
    numbers = stream.numbers
    assert numbers is not None
    order = np.argsort(stream.times_ns, kind='stable')
    is_good = stream.is_usable
    order = order[is_good[order]]
    order = order[np.concatenate([[True], np.diff(stream.times_ns[order]) > 0])[: len(order)]]
    findings += _numbers(stream, is_good, limits)
    if len(order) < 3 or not math.isfinite(timing.period_s):
        return None, findings
    poses, times = numbers[order], stream.times_ns[order]
    # stamps nearer to each other than half a period would make any noise a speed
    seconds = np.maximum(np.diff(times) / 1e9, timing.period_s / 2)
    steps = step_lengths(poses[:, :3])
    speeds = steps / seconds
    rates = np.full(len(speeds), math.nan)
    if poses.shape[1] == 7 and poses[:, 3:].any(axis=1).all():
        q = rotation.normalize(poses[:, 3:])
        rates = rotation.angle_between(q[:-1], q[1:]) / seconds
    jumps = _jumps(speeds, seconds, limits.jump_m)
    turns = _jumps(rates, seconds, limits.jump_rad)
    begins, ends = _frozen(poses, limits)
    found = PoseMotion(
        path_m=float(steps.sum()),
        speed_median_m_s=float(np.median(speeds)),
        speed_p99_m_s=float(np.quantile(speeds, 0.99)),
        rotation_p99_rad_s=float(np.quantile(rates, 0.99)),
        jumps=len(jumps),
        turns=len(turns),
        frozen=int(np.sum(ends - begins)),
        not_finite=int(np.sum(~is_good)),
    )
    findings += _jump(stream, order, steps, jumps, 'm')
    findings += _jump(stream, order, rates * seconds, turns, 'rad')
    findings += _frozen_findings(stream, order, steps, begins, ends)
    findings += _speeds(stream, found, limits)
    return found, findings


def _why_positions_only(stream: SensorStream) -> str:
    """Return why the orientations of a stream of poses say nothing; empty where they do."""
    numbers = stream.numbers
    assert numbers is not None
    if numbers.shape[1] != 7:
        return ''
    return why_positions_only(Poses(stream.times_ns, numbers[:, :3], numbers[:, 3:]))


def _jumps(speeds: np.ndarray, seconds: np.ndarray, least: float) -> np.ndarray:
    """Return the steps that are much faster than those around them, and than nearly all."""
    if len(speeds) < JUMP_NEIGHBOURS or np.isnan(speeds).any():
        return np.empty(0, int)
    padded = np.pad(speeds, JUMP_NEIGHBOURS // 2, mode='reflect')
    excess = speeds - np.median(sliding_window_view(padded, JUMP_NEIGHBOURS), axis=1)
    limit = np.maximum(least / seconds, JUMP_SPREADS * spread(excess))
    return np.flatnonzero((excess > limit) & (speeds > JUMP_FACTOR * np.quantile(speeds, 0.95)))


def _frozen(poses: np.ndarray, limits: InspectionLimits) -> tuple[np.ndarray, np.ndarray]:
    """Return where runs of poses that repeat one begin, and the index after their end."""
    begins, ends = runs((poses[1:] == poses[:-1]).all(axis=1))
    long = ends + 1 - begins >= limits.frozen_poses
    return begins[long], ends[long] + 1


def _numbers(
    stream: SensorStream, is_good: np.ndarray, limits: InspectionLimits
) -> Iterator[Finding]:
    """Yield poses that are not finite, and quaternions that are not of length 1."""
    numbers = stream.numbers
    assert numbers is not None
    which = np.flatnonzero(~is_good)
    if len(which):
        yield FINDINGS['not_finite'].found(
            stream,
            samples=are(len(which), 'pose'),
            count=len(which),
            moments=stream.moments(which, which),
        )
    if numbers.shape[1] == 7:
        off = np.abs(np.linalg.norm(np.where(is_good[:, None], numbers[:, 3:], 0.5), axis=1) - 1)
        which = np.flatnonzero(off > limits.quaternion_norm_tolerance)
        if len(which):
            yield FINDINGS['quaternion_norm'].found(
                stream,
                quaternions=are(len(which), 'quaternion'),
                count=len(which),
                value=float(off.max()),
                moments=stream.moments(which, which),
            )


def _jump(
    stream: SensorStream, order: np.ndarray, steps: np.ndarray, jumps: np.ndarray, unit: str
) -> Iterator[Finding]:
    if len(jumps):
        yield FINDINGS['jump'].found(
            stream,
            steps=are(len(jumps), 'step'),
            count=len(jumps),
            value=float(steps[jumps].max()),
            unit=unit,
            moments=stream.moments(order[jumps], order[jumps + 1]),
        )


def _frozen_findings(
    stream: SensorStream,
    order: np.ndarray,
    steps: np.ndarray,
    begins: np.ndarray,
    ends: np.ndarray,
) -> Iterator[Finding]:
    """Yield the runs of equal poses: frozen where the motion went on after them, else at rest."""
    if not len(begins):
        return
    moving = steps[steps > 0]
    usual = float(np.median(moving)) if len(moving) else math.inf
    before = np.append(0.0, steps)[begins]
    after = np.append(steps, 0.0)[ends - 1]
    is_abrupt = (after > CATCHING_UP * usual) | ((ends == len(order)) & (before > MOVING * usual))
    for abrupt, then in ((True, 'though it moved on meanwhile'), (False, 'as if at rest')):
        which = is_abrupt == abrupt
        if which.any():
            lasting_ns = stream.times_ns[order[ends - 1]] - stream.times_ns[order[begins]]
            yield FINDINGS['frozen'].found(
                stream,
                minor=not abrupt,
                then=then,
                count=int(np.sum((ends - begins - 1)[which])),  # the first repeats nothing
                value=float(lasting_ns[which].max() / 1e9),
                moments=stream.moments(order[begins[which]], order[ends[which] - 1]),
            )


def _speeds(
    stream: SensorStream, found: PoseMotion, limits: InspectionLimits
) -> Iterator[Finding]:
    for value, most, unit in (
        (found.speed_p99_m_s, limits.max_speed_m_s, 'm/s'),
        (found.rotation_p99_rad_s, limits.max_rotation_rad_s, 'rad/s'),
    ):
        if value > most:
            yield FINDINGS['implausible_motion'].found(stream, value=value, unit=unit)
