"""What an IMU measured: stuck and saturated samples, gravity, and whether it was moved enough."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.inspection.findings import Finding
from vio_eval_ros.inspection.streams import LARGEST, runs, Stream
from vio_eval_ros.inspection.timing import Timing

AXES = ('gyroscope x', 'gyroscope y', 'gyroscope z',
        'accelerometer x', 'accelerometer y', 'accelerometer z')  # fmt: skip
GRAVITY = 9.80665
STUCK_SAMPLES = 3
# An axis is cut off where its extreme comes this often, and that many times in a row, and more
# often than all values within 2 % of the range below it; of a coarse axis that says nothing
CUT_OFF, CUT_OFF_IN_A_ROW, BELOW, COARSE = 5, 3, 0.02, 50
# Still: means over windows spread less than this
STILL_WINDOW_S, STILL_GYRO, STILL_ACCEL, STILL_S = 0.25, 0.02, 0.15, 1.0
# Gravity is known to better than 0.5 %; calibrated accelerometers to about 1 %
GRAVITY_OFF = 0.5
# Turning about a second axis, rms; accelerations as VINS-Mono demands before it initialises
LEAST_TURNING, LEAST_ACCELERATION, ACCELERATION_WINDOW_S = 0.05, 0.25, 0.1


@dataclass(frozen=True)
class Inertial:
    """
    Figures of the samples of an IMU; NaN where they cannot be told.

    :param rotation_rms_rad_s: of the angular rate about its principal axes, largest first.
    :param acceleration_m_s2: root mean square of what the specific force, averaged over 0.1 s,
        differs from its mean.
    :param still_s: how long it stands still in all, and ``still_at_begin_s`` at the beginning.
    :param force_m_s2: specific force while still, its median, and ``gravity_m_s2``, its length.
    :param up: the axis that points up then, such as ``+z``; empty where it never stands still.
    :param up_off_deg: the angle between that axis and the vertical.
    """

    rotation_rms_rad_s: tuple[float, float, float]
    acceleration_m_s2: float
    still_s: float
    still_at_begin_s: float
    force_m_s2: tuple[float, float, float]
    gravity_m_s2: float
    up: str
    up_off_deg: float
    stuck: int
    saturated: int
    not_finite: int


def inertial(stream: Stream, timing: Timing) -> tuple[Inertial | None, list[Finding]]:
    """Return the figures of an IMU, and what is wrong with its samples; None of too few."""
    assert stream.numbers is not None
    is_finite = stream.is_usable
    if is_finite.sum() < 3 or not math.isfinite(timing.period_s):
        return None, list(_not_finite(stream, is_finite))
    samples = stream.numbers[is_finite]
    stuck = _stuck(stream)
    saturated = [_cut_off(stream.numbers[:, k]) for k in range(6)]
    moving = samples[:, :3] - np.median(samples[:, :3], axis=0)
    rms = np.sqrt(np.maximum(np.linalg.eigvalsh(moving.T @ moving / len(moving))[::-1], 0))
    averages = _averages(samples[:, 3:], ACCELERATION_WINDOW_S / timing.period_s)
    changes = averages - averages.mean(axis=0)
    is_still = _still(samples, STILL_WINDOW_S / timing.period_s)
    begins, ends = runs(is_still)
    at_begin = ends[0] if len(begins) and begins[0] == 0 else 0
    rest = samples[is_still, 3:]
    force = np.median(rest, axis=0) if len(rest) else np.full(3, math.nan)
    up, off = upwards(force)
    found = Inertial(
        (float(rms[0]), float(rms[1]), float(rms[2])),
        float(np.sqrt(np.mean(np.sum(changes**2, axis=1)))),
        float(is_still.sum() * timing.period_s),
        float(at_begin * timing.period_s),
        (float(force[0]), float(force[1]), float(force[2])),
        float(np.linalg.norm(force)),
        up,
        off,
        int(np.sum(stuck[1] - stuck[0])),
        sum(int(is_cut.sum()) for is_cut in saturated),
        int(np.sum(~is_finite)),
    )
    return found, [
        *_not_finite(stream, is_finite),
        *_stuck_finding(stream, stuck),
        *_saturation(stream, saturated),
        *_physics(stream, samples, found),
    ]


def _stuck(stream: Stream) -> tuple[np.ndarray, np.ndarray]:
    """Return where runs of samples that repeat one begin, and the index behind their end."""
    numbers = stream.numbers
    assert numbers is not None
    begins, ends = runs((numbers[1:] == numbers[:-1]).all(axis=1))
    long = ends + 1 - begins >= STUCK_SAMPLES
    return begins[long], ends[long] + 1


def _cut_off(values: np.ndarray) -> np.ndarray:
    """Return which of (N,) values are at a limit of what the axis can measure."""
    is_cut = np.zeros(len(values), bool)
    known = values[np.abs(values) < LARGEST]
    if len(np.unique(known)) < COARSE:
        return is_cut
    width = BELOW * float(np.ptp(known))
    for side in (1, -1):
        extreme = (side * known).max()
        is_at = side * values == extreme
        below = np.count_nonzero(side * known >= extreme - width) - is_at.sum()
        begins, ends = runs(is_at)
        if (
            is_at.sum() >= max(CUT_OFF, below)
            and (ends - begins).max(initial=0) >= CUT_OFF_IN_A_ROW
        ):
            is_cut |= is_at
    return is_cut


def _averages(samples: np.ndarray, window: float) -> np.ndarray:
    """Return the means of (N, 3) samples over windows that follow each other."""
    size = min(max(round(window), 1), len(samples))
    count = len(samples) // size
    return samples[: count * size].reshape(count, size, -1).mean(axis=1)


def _still(samples: np.ndarray, window: float) -> np.ndarray:
    """
    Return (N,) whether the sensor stood still, for at least a second.

    A constant rate is its bias, as far as it can know.
    """
    size = min(max(round(window), 2), len(samples))
    count = len(samples) // size
    parts = samples[: count * size].reshape(count, size, 6)
    limits = np.array([STILL_GYRO] * 3 + [STILL_ACCEL] * 3)
    is_quiet = (parts.std(axis=1) < limits).all(axis=1)
    # and the window before it had the same mean: nothing turned slowly, or fell
    means = parts.mean(axis=1)
    is_same = (np.abs(np.diff(means, axis=0)) < limits).all(axis=1)
    is_still = is_quiet & (np.append(is_same, False) | np.append(False, is_same))
    begins, ends = runs(is_still)
    for begin, end in zip(begins, ends, strict=True):
        is_still[begin:end] = end - begin >= STILL_S / STILL_WINDOW_S
    return np.append(np.repeat(is_still, size), np.zeros(len(samples) - count * size, bool))


def upwards(force: np.ndarray) -> tuple[str, float]:
    """Return the axis along which (3,) specific force is felt at rest, and how far it is off."""
    norm = float(np.linalg.norm(force))
    if not norm > 0:
        return '', math.nan
    axis = int(np.argmax(np.abs(force)))
    cosine = min(abs(float(force[axis])) / norm, 1.0)
    return '+-'[int(force[axis] < 0)] + 'xyz'[axis], math.degrees(math.acos(cosine))


def _not_finite(stream: Stream, is_finite: np.ndarray) -> Iterator[Finding]:
    if not is_finite.all():
        which = np.flatnonzero(~is_finite)
        yield Finding(
            'not_finite', stream.topic, 'fail', f'{len(which)} samples are not finite numbers',
            len(which), moments=stream.moments(which, which),
        )  # fmt: skip


def _stuck_finding(stream: Stream, stuck: tuple[np.ndarray, np.ndarray]) -> Iterator[Finding]:
    begins, ends = stuck
    if len(begins):
        count, longest = int(np.sum(ends - begins)), int((ends - begins).max())
        yield Finding(
            'stuck', stream.topic, 'fail',
            f'{count} samples repeat the one before in all six axes, up to {longest} in a row',
            count, longest, 'samples', stream.moments(begins, ends - 1),
        )  # fmt: skip


def _saturation(stream: Stream, saturated: list[np.ndarray]) -> Iterator[Finding]:
    assert stream.numbers is not None
    is_cut = np.any(saturated, axis=0)
    if not is_cut.any():
        return
    begins, ends = runs(is_cut)
    limits = {
        AXES[k]: float(np.abs(stream.numbers[which, k]).max())
        for k, which in enumerate(saturated)
        if which.any()
    }
    shown = ', '.join(
        f'{axis} at {limit:.4g} {"rad/s" if axis.startswith("gyro") else "m/s2"}'
        for axis, limit in limits.items()
    )
    yield Finding(
        'saturation', stream.topic, 'fail',
        f'{int(is_cut.sum())} samples are cut off at a limit: {shown}',
        int(is_cut.sum()), max(limits.values()), '', stream.moments(begins, ends - 1),
    )  # fmt: skip


def _physics(stream: Stream, samples: np.ndarray, found: Inertial) -> Iterator[Finding]:
    force = float(np.median(np.linalg.norm(samples[:, 3:], axis=1)))
    rate = float(np.median(np.linalg.norm(samples[:, :3], axis=1)))
    topic = stream.topic
    if 0.8 < force < 1.2:
        yield Finding(
            'units', topic, 'fail', f'accelerations are about {force:.3g}: in g, not in m/s2',
            value=force,
        )  # fmt: skip
    elif abs(found.gravity_m_s2 - GRAVITY) > GRAVITY_OFF:
        yield Finding(
            'gravity', topic, 'warn',
            f'while still, it feels {found.gravity_m_s2:.4g} m/s2, not {GRAVITY:.4g}',
            value=found.gravity_m_s2, unit='m/s2',
        )  # fmt: skip
    if rate > 10:
        yield Finding(
            'units', topic, 'fail',
            f'half of the time it turns at {rate:.3g} rad/s or more: in degrees?',
            value=rate, unit='rad/s',
        )  # fmt: skip
    second = found.rotation_rms_rad_s[1]
    if second < LEAST_TURNING or found.acceleration_m_s2 < LEAST_ACCELERATION:
        yield Finding(
            'low_excitation', topic, 'info',
            f'it turns at {found.rotation_rms_rad_s[0]:.2g} rad/s (rms) about one axis and '
            f'{second:.2g} about a second ({LEAST_TURNING} are wanted), and accelerates by '
            f'{found.acceleration_m_s2:.2g} m/s2 ({LEAST_ACCELERATION} are wanted)',
            value=second, unit='rad/s',
        )  # fmt: skip
    if found.still_at_begin_s < STILL_S:
        yield Finding(
            'no_still_time', topic, 'info',
            f'it begins with {found.still_at_begin_s:.2g} s at rest ({STILL_S:g} s are wanted), '
            f'and stands still for {found.still_s:.3g} s in all',
            value=found.still_at_begin_s, unit='s',
        )  # fmt: skip
