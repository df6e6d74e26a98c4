"""What an IMU measured: stuck and saturated samples, gravity, and whether it was moved enough."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core.stream import LARGEST, runs, Stream
from vio_eval_ros.inspection.findings import Finding
from vio_eval_ros.inspection.timing import Timing

AXES = ('gyroscope x', 'gyroscope y', 'gyroscope z',
        'accelerometer x', 'accelerometer y', 'accelerometer z')  # fmt: skip
ALL, GYRO, ACCEL = slice(0, 6), slice(0, 3), slice(3, 6)
GRAVITY = 9.80665
# Samples in a row that are the same: of all six axes, of three of them, of one that ends so. More
# where samples just before or behind repeat as well, as those of coarse sensors do at rest
STUCK_SAMPLES, STUCK_HALF, STUCK_AXIS, AROUND, BY_CHANCE = 5, 10, 50, 50, 1e-3
REPEATED = 0.1
# An axis is cut off where its extreme comes this often, and that many times in a row, and more
# often than all values within 2 % of the range, and some levels, below it; of a coarse axis that
# says nothing
CUT_OFF, CUT_OFF_IN_A_ROW, BELOW, LEVELS_BELOW, COARSE = 5, 3, 0.02, 6, 50
# Still: means over windows spread less than this
STILL_WINDOW_S, STILL_GYRO, STILL_ACCEL, STILL_S = 0.25, 0.02, 0.15, 1.0
STILL_LIMITS = np.array([STILL_GYRO] * 3 + [STILL_ACCEL] * 3)
# Gravity is known to better than 0.5 %; calibrated accelerometers to about 1 %
GRAVITY_OFF = 0.5
# What gravity is in other units, mostly called mg and cm/s2, and about that
G_IN = {'g': 1.0, 'mg or cm/s2': 990.0}
ABOUT = 0.2
# Turning about a second axis, rms; accelerations as VINS-Mono demands before it initialises
LEAST_TURNING, LEAST_ACCELERATION, ACCELERATION_WINDOW_S = 0.05, 0.25, 0.1

# axes, where each run of samples begins, and the index behind its end
Stuck = tuple[slice, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Inertial:
    """
    Figures of the samples of an IMU; NaN where they cannot be told.

    :param rotation_rms_rad_s: of the angular rate about its principal axes, largest first.
    :param acceleration_m_s2: the standard deviation of the length of the specific force, averaged
        over 0.1 s: turning does not change it, accelerating across the vertical hardly.
    :param still_s: how long it stands still in all, and ``still_at_begin_s`` at the beginning.
    :param force_m_s2: specific force while still, its median, and ``gravity_m_s2``, its length.
    :param up: the axis that points up then, such as ``+z``; empty where it never stands still.
    :param up_off_deg: the angle between that axis and the vertical.
    :param stuck: samples that repeat one in all axes or in three, or in one until the end.
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
    stuck = _stuck(stream.numbers)
    is_stuck = np.zeros_like(is_finite)
    known = stream.numbers.copy()  # without what is stuck, which is no second and third fault
    for axes, begins, ends in stuck:
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            is_stuck[begin:end] = True
            known[begin + 1 : end, axes] = math.nan
    saturated = [_cut_off(known[:, k]) for k in range(6)]
    samples = known[is_finite & ~np.isnan(known).any(axis=1)]
    if len(samples) < 3:
        return None, [*_not_finite(stream, is_finite), *_stuck_findings(stream, stuck)]
    turns, feels = samples[:, :3].any(), samples[:, 3:].any()
    moving = samples[:, :3] - np.median(samples[:, :3], axis=0)
    rms = np.sqrt(np.maximum(np.linalg.eigvalsh(moving.T @ moving / len(moving))[::-1], 0))
    averages = _averages(samples[:, 3:], ACCELERATION_WINDOW_S / timing.period_s)
    is_still = _still(samples, STILL_WINDOW_S / timing.period_s)
    begins, ends = runs(is_still)
    at_begin = ends[0] if len(begins) and begins[0] == 0 else 0
    rest = samples[is_still, 3:]
    force = np.median(rest, axis=0) if feels and len(rest) else np.full(3, math.nan)
    up, off = upwards(force)
    found = Inertial(
        (float(rms[0]), float(rms[1]), float(rms[2])) if turns else (math.nan,) * 3,
        float(np.linalg.norm(averages, axis=1).std()) if feels else math.nan,
        float(is_still.sum() * timing.period_s),
        float(at_begin * timing.period_s),
        (float(force[0]), float(force[1]), float(force[2])),
        float(np.linalg.norm(force)),
        up,
        off,
        int(is_stuck.sum()),
        sum(int(is_cut.sum()) for is_cut in saturated),
        int(np.sum(~is_finite)),
    )
    return found, [
        *_not_finite(stream, is_finite),
        *_stuck_findings(stream, stuck),
        *_saturation(stream, saturated),
        *_physics(stream, samples, found),
    ]


def _stuck(numbers: np.ndarray) -> list[Stuck]:
    """
    Return where samples repeat the one before: in all axes, in three, or in one until the end.

    Three axes, or one, can be at rest; they are stuck where the others move meanwhile.
    """
    found: list[Stuck] = []
    # a sensor that measures nothing at all is not stuck
    measures = {half.start: bool(numbers[:, half].any()) for half in (GYRO, ACCEL)}
    for axes, least in ((ALL, STUCK_SAMPLES), (GYRO, STUCK_HALF), (ACCEL, STUCK_HALF)):
        others = None if axes is ALL else ACCEL if axes is GYRO else GYRO
        if axes is not ALL and not measures[axes.start]:
            continue
        begins, ends = _repeats(numbers, axes, least, others)
        new = [not any(_within(begin, one) for one in found) for begin in begins.tolist()]
        found.append((axes, begins[new], ends[new]))
    for axis in (axis for axis in range(6) if measures[axis // 3 * 3]):
        axes = slice(axis, axis + 1)
        begins, ends = _repeats(numbers, axes, STUCK_AXIS, ALL)
        new = [
            end == len(numbers) and not any(_within(begin, one) for one in found)
            for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
        ]
        found.append((axes, begins[new], ends[new]))
    return [one for one in found if len(one[1])]


def _within(begin: int, stuck: Stuck) -> bool:
    """Return whether a run begins in another one, which says it already."""
    return bool(((stuck[1] <= begin) & (begin < stuck[2])).any())


def _repeats(
    numbers: np.ndarray, axes: slice, least: int, others: slice | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return runs of samples that are the same in some axes, by more than chance."""
    is_same = (numbers[1:, axes] == numbers[:-1, axes]).all(axis=1)
    begins, ends = runs(is_same)
    long = ends + 1 - begins >= least
    kept = []
    for begin, end in zip(begins[long].tolist(), ends[long].tolist(), strict=True):
        before = is_same[max(begin - AROUND, 0) : max(begin - 1, 0)]
        behind = is_same[end + 1 : end + AROUND]
        often = max((float(part.mean()) for part in (before, behind) if len(part)), default=0.0)
        if 0 < often < 1 and (end - begin) * math.log(often) > math.log(BY_CHANCE / len(numbers)):
            continue
        if often < 1 and (others is None or _moves(numbers[begin : end + 1], others)):
            kept.append((begin, end + 1))
    found = np.array(kept, int).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _moves(samples: np.ndarray, axes: slice) -> bool:
    """Return whether some axes change by more than they would at rest."""
    return bool((samples.std(axis=0) > STILL_LIMITS)[axes].any())


def _cut_off(values: np.ndarray) -> np.ndarray:
    """Return which of (N,) values are at a limit of what the axis can measure."""
    is_cut = np.zeros(len(values), bool)
    known = values[np.abs(values) < LARGEST]
    values_there = np.unique(known)
    if len(values_there) < COARSE:
        return is_cut
    # the crest of a smooth motion fills the levels below as well, however coarse they are
    width = max(
        BELOW * float(np.ptp(known)), LEVELS_BELOW * float(np.median(np.diff(values_there)))
    )
    is_fine = len(values_there) > len(known) / 2  # then not even a crest is twice the same
    for side in (1, -1):
        extreme = (side * known).max()
        is_at = side * values == extreme
        below = np.count_nonzero(side * known >= extreme - width) - is_at.sum()
        begins, ends = runs(is_at)
        if (
            is_at.sum() >= (CUT_OFF if is_fine else max(CUT_OFF, below))
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
    is_quiet = (parts.std(axis=1) < STILL_LIMITS).all(axis=1)
    # and the window before it had the same mean: nothing turned slowly, or fell
    means = parts.mean(axis=1)
    is_same = (np.abs(np.diff(means, axis=0)) < STILL_LIMITS).all(axis=1)
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


def _named(axes: slice) -> str:
    names = AXES[axes]
    return {1: names[0], 3: f'the {names[0].split()[0]}', 6: 'all six axes'}[len(names)]


def _stuck_findings(stream: Stream, stuck: list[Stuck]) -> Iterator[Finding]:
    for axes, begins, ends in stuck:
        count, longest = int(np.sum(ends - begins)), int((ends - begins).max())
        yield Finding(
            'stuck', stream.topic, 'fail',
            f'{count} samples repeat the one before in {_named(axes)}, up to {longest} in a row',
            count, longest, 'samples', stream.moments(begins, ends - 1),
        )  # fmt: skip
    assert stream.numbers is not None
    is_same = (np.diff(stream.numbers, axis=0) == 0).all(axis=1)
    for axes, begins, ends in stuck:
        if axes is ALL:
            for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
                is_same[begin:end] = False
    if is_same.mean() > REPEATED:
        which = np.flatnonzero(is_same)
        yield Finding(
            'stuck', stream.topic, 'warn',
            f'{len(which)} of {len(stream)} samples are those before: a slower sensor, sent again',
            len(which), float(is_same.mean()), 'ratio', stream.moments(which, which + 1),
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
    unit = next((unit for unit, g in G_IN.items() if abs(force / g - 1) < ABOUT), None)
    if unit is not None:
        yield Finding(
            'units', topic, 'fail', f'accelerations are about {force:.3g}: in {unit}, not in m/s2',
            value=force,
        )  # fmt: skip
    elif abs(rate / GRAVITY - 1) < ABOUT and force < GRAVITY / 2:
        yield Finding(
            'units', topic, 'fail',
            f'it turns at {rate:.3g} rad/s and feels {force:.3g} m/s2: are gyroscope and '
            'accelerometer exchanged?',
            value=force, unit='m/s2',
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
