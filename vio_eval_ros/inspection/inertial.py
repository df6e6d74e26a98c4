"""What an IMU measured: rest and gravity, units, and whether it was moved enough."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np

from vio_eval_ros.core.sensor_stream import runs, SensorStream
from vio_eval_ros.inspection.consistency import consistency
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.glitches import Glitches, glitches
from vio_eval_ros.inspection.imu_axes import still_limits
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.measured_stream import Inertial, Timing

# The spread at rest is that of windows of this length
STILL_WINDOW_S = 0.25
#: gravity in other units (1000 mg, 981 cm/s2), and the relative difference up to which a mean is
#: taken for it
GRAVITY_IN = {'g': 1.0, 'mg or cm/s2': 990.0}
UNIT_TOLERANCE = 0.2
# Acceleration is that of means over this time, as VINS-Mono has it between two images
ACCELERATION_WINDOW_S = 0.1


def inertial(
    stream: SensorStream, timing: Timing, limits: InspectionLimits
) -> tuple[Inertial | None, list[Finding]]:
    """Return the figures of an IMU, and what is wrong with its samples; None of too few."""
    assert stream.numbers is not None
    found = glitches(stream, timing.period_s, limits)
    which = np.flatnonzero(~np.isnan(found.known).any(axis=1))
    samples = stream.numbers[which]
    if len(samples) < 3 or not math.isfinite(timing.period_s):
        return None, found.findings
    figures = _figures(samples, found, timing.period_s, limits)
    findings = [*found.findings, *_units(stream, samples, figures, limits)]
    findings += _motion(stream, figures, limits)
    has_both = samples[:, :3].any() and samples[:, 3:].any()
    if has_both and 'units' not in {one.name for one in findings}:
        findings += consistency(stream, which, timing.period_s, limits)
    return figures, findings


def _figures(
    samples: np.ndarray, found: Glitches, period_s: float, limits: InspectionLimits
) -> Inertial:
    """Return the figures of (N, 6) samples that are measurements."""
    has_gyroscope, has_accelerometer = samples[:, :3].any(), samples[:, 3:].any()
    moving = samples[:, :3] - np.median(samples[:, :3], axis=0)
    rms = np.sqrt(np.maximum(np.linalg.eigvalsh(moving.T @ moving / len(moving))[::-1], 0))
    averages = _averages(samples[:, 3:], ACCELERATION_WINDOW_S / period_s)
    is_still = _still(samples, period_s, limits)
    begins, ends = runs(is_still)
    at_begin = ends[0] if len(begins) and begins[0] == 0 else 0
    rest = samples[is_still, 3:]
    force = np.median(rest, axis=0) if has_accelerometer and len(rest) else np.full(3, math.nan)
    up, up_off_deg = upwards(force)
    acceleration = float(np.linalg.norm(averages, axis=1).std())
    return Inertial(
        rotation_rms_rad_s=(float(rms[0]), float(rms[1]), float(rms[2]))
        if has_gyroscope
        else (math.nan,) * 3,
        acceleration_m_s2=acceleration if has_accelerometer else math.nan,
        still_s=float(is_still.sum() * period_s),
        still_at_begin_s=float(at_begin * period_s),
        force_m_s2=(float(force[0]), float(force[1]), float(force[2])),
        gravity_m_s2=float(np.linalg.norm(force)),
        up=up,
        up_off_deg=up_off_deg,
        stuck=found.stuck,
        spikes=found.spikes,
        saturated=found.saturated,
        not_finite=found.not_finite,
    )


def _averages(samples: np.ndarray, window: float) -> np.ndarray:
    """Return the means of (N, 3) samples over windows that follow each other."""
    size = min(max(round(window), 1), len(samples))
    count = len(samples) // size
    return samples[: count * size].reshape(count, size, -1).mean(axis=1)


def _still(samples: np.ndarray, period_s: float, limits: InspectionLimits) -> np.ndarray:
    """
    Return (N,) whether the sensor stood still, for at least ``still_s``.

    A constant rate is its bias, as far as it can know.
    """
    size = min(max(round(STILL_WINDOW_S / period_s), 2), len(samples))
    count = len(samples) // size
    parts = samples[: count * size].reshape(count, size, 6)
    most = still_limits(limits)
    is_quiet = (parts.std(axis=1) < most).all(axis=1)
    # and the window before it had the same mean: nothing rotated slowly, or fell
    means = parts.mean(axis=1)
    is_same = (np.abs(np.diff(means, axis=0)) < most).all(axis=1)
    is_still = is_quiet & (np.append(is_same, False) | np.append(False, is_same))
    begins, ends = runs(is_still)
    for begin, end in zip(begins, ends, strict=True):
        is_still[begin:end] = end - begin >= limits.still_s / STILL_WINDOW_S
    return np.append(np.repeat(is_still, size), np.zeros(len(samples) - count * size, bool))


def upwards(force: np.ndarray) -> tuple[str, float]:
    """Return the axis along which (3,) specific force is felt at rest, and how far it is off."""
    norm = float(np.linalg.norm(force))
    if not norm > 0:
        return '', math.nan
    axis = int(np.argmax(np.abs(force)))
    cosine = min(abs(float(force[axis])) / norm, 1.0)
    return '+-'[int(force[axis] < 0)] + 'xyz'[axis], math.degrees(math.acos(cosine))


def _units(
    stream: SensorStream, samples: np.ndarray, figures: Inertial, limits: InspectionLimits
) -> Iterator[Finding]:
    """Yield what says that samples are not in rad/s and m/s²."""
    force = float(np.median(np.linalg.norm(samples[:, 3:], axis=1)))
    rate = float(np.median(np.linalg.norm(samples[:, :3], axis=1)))
    gravity = limits.gravity_m_s2
    units = FINDINGS['units']
    other = next((u for u, g in GRAVITY_IN.items() if abs(force / g - 1) < UNIT_TOLERANCE), None)
    if other is not None:
        yield units.found(stream, 'acceleration', units=other, value=force)
    elif abs(rate / gravity - 1) < UNIT_TOLERANCE and force < gravity / 2:
        yield units.found(stream, 'exchanged', rate=rate, value=force, unit='m/s2')
    elif abs(figures.gravity_m_s2 - gravity) > limits.gravity_tolerance_m_s2:
        yield FINDINGS['gravity'].found(stream, gravity=gravity, value=figures.gravity_m_s2)
    if rate > limits.degrees_rate_rad_s:
        yield units.found(stream, 'rate', value=rate, unit='rad/s')


def _motion(
    stream: SensorStream, figures: Inertial, limits: InspectionLimits
) -> Iterator[Finding]:
    """Yield what an estimator lacks for its initialisation: motion, or rest."""
    first, second, _ = figures.rotation_rms_rad_s
    acceleration = figures.acceleration_m_s2
    least_rate, least_acceleration = (
        limits.excitation_rate_rad_s,
        limits.excitation_acceleration_m_s2,
    )
    if second < least_rate or acceleration < least_acceleration:
        has_gyroscope, has_accelerometer = math.isfinite(second), math.isfinite(acceleration)
        both = has_gyroscope and has_accelerometer
        yield FINDINGS['low_excitation'].found(
            stream,
            'both' if both else 'gyroscope' if has_gyroscope else 'accelerometer',
            first=first,
            least_rate=least_rate,
            acceleration=acceleration,
            least_acceleration=least_acceleration,
            value=second if has_gyroscope else acceleration,
            unit='rad/s' if has_gyroscope else 'm/s2',
        )
    if figures.still_at_begin_s < limits.still_s:
        yield FINDINGS['no_still_time'].found(
            stream, least=limits.still_s, in_all=figures.still_s, value=figures.still_at_begin_s
        )
