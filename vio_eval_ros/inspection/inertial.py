"""What an IMU measured: rest and gravity, units, and whether it was moved enough."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core.sensor_stream import runs, SensorStream
from vio_eval_ros.inspection.consistency import consistency
from vio_eval_ros.inspection.findings import Finding
from vio_eval_ros.inspection.glitches import glitches, STILL_LIMITS
from vio_eval_ros.inspection.timing import Timing

GRAVITY = 9.80665
# Still: over windows samples spread no more than at rest
STILL_WINDOW_S, STILL_S = 0.25, 1.0
# Gravity is known to better than 0.5 %; calibrated accelerometers to about 1 %
GRAVITY_OFF = 0.5
# What gravity is in other units, mostly called mg and cm/s2, and about that
G_IN = {'g': 1.0, 'mg or cm/s2': 990.0}
ABOUT = 0.2
# Turning about a second axis, rms; accelerations as VINS-Mono demands before it initialises
LEAST_TURNING, LEAST_ACCELERATION, ACCELERATION_WINDOW_S = 0.05, 0.25, 0.1


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
    :param stuck: samples that repeat one in all axes, in three, or in one that is stuck.
    :param spikes: samples that stand out from those around.
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
    spikes: int
    saturated: int
    not_finite: int


def inertial(stream: SensorStream, timing: Timing) -> tuple[Inertial | None, list[Finding]]:
    """Return the figures of an IMU, and what is wrong with its samples; None of too few."""
    assert stream.numbers is not None
    found = glitches(stream, timing.period_s)
    which = np.flatnonzero(~np.isnan(found.known).any(axis=1))
    samples = stream.numbers[which]
    if len(samples) < 3 or not math.isfinite(timing.period_s):
        return None, found.findings
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
    felt = Inertial(
        (float(rms[0]), float(rms[1]), float(rms[2])) if turns else (math.nan,) * 3,
        float(np.linalg.norm(averages, axis=1).std()) if feels else math.nan,
        float(is_still.sum() * timing.period_s),
        float(at_begin * timing.period_s),
        (float(force[0]), float(force[1]), float(force[2])),
        float(np.linalg.norm(force)),
        up,
        off,
        found.stuck,
        found.spikes,
        found.saturated,
        found.not_finite,
    )
    findings = [*found.findings, *_physics(stream, samples, felt)]
    if turns and feels and 'units' not in {one.name for one in findings}:
        findings += consistency(stream, which, timing.period_s)
    return felt, findings


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


def _physics(stream: SensorStream, samples: np.ndarray, found: Inertial) -> Iterator[Finding]:
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
