"""The noise of an IMU from a record of it at rest, and what makes it doubtful."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.errors import ReadError
from vio_eval_ros.imu.allan import allan_curve, CONFIDENCE, Curve, interval
from vio_eval_ros.imu.fit import Fit, fit_noise, Parameter, PARAMETERS, SI
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.imu.movement import second_samples, Seconds, seconds
from vio_eval_ros.imu.record import AXES, Signal
from vio_eval_ros.imu.record_warnings import (
    of_absence,
    of_fits,
    of_losses,
    of_means,
    of_movement,
    of_units,
    of_values,
    of_vibrations,
    Unit,
)
from vio_eval_ros.imu.vibration import vibration
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.imu_noise/1'
#: What samples may be in, and the size of that unit in rad/s or m/s².
UNITS = {
    'gyro': {'rad/s': 1.0, 'deg/s': np.pi / 180},
    'accel': {'m/s2': 1.0, 'g': 9.80665},
}
#: The keys of Kalibr's ``imu.yaml``: the sensor and the parameter of each.
KALIBR = {
    'accelerometer_noise_density': ('accel', 'density'),
    'accelerometer_random_walk': ('accel', 'walk'),
    'gyroscope_noise_density': ('gyro', 'density'),
    'gyroscope_random_walk': ('gyro', 'walk'),
}


@dataclass(frozen=True, eq=False)
class Axis:
    """
    One axis, in rad/s or m/s².

    :param mean: of all samples: the bias, with gravity.
    """

    mean: float
    curve: Curve
    fit: Fit

    @cached_property
    def band(self) -> tuple[np.ndarray, np.ndarray]:
        """The 95 % confidence interval of each deviation, (T,) each; NaN without a fit."""
        if np.isnan(self.fit.scatter).any():
            nothing = np.full(len(self.curve.deviations), np.nan)
            return nothing, nothing
        pairs = [
            interval(deviation, 1 / (2 * scatter**2))
            for deviation, scatter in zip(self.curve.deviations, self.fit.scatter, strict=True)
        ]
        low, high = np.array(pairs).T
        return low, high

    def to_dict(self, kind: str) -> dict[str, Any]:
        """Return all that is known of an axis of a 'gyro' or 'accel'; NaN where it is not."""
        curve, fit, (low, high) = self.curve, self.fit, self.band
        lowest = int(np.argmin(curve.deviations)) if len(curve.deviations) else None
        return {
            'unit': SI[kind],
            'mean': self.mean,
            'parameters': {
                quantity.name: {
                    **vars(getattr(fit, attribute)),
                    'unit': quantity.units[kind],
                    'read_at_tau_s': quantity.read_at_tau_s,
                }
                for attribute, quantity in PARAMETERS.items()
            },
            'fit_range_s': fit.range_s,
            'lowest': None
            if lowest is None
            else {
                'deviation': float(curve.deviations[lowest]),
                'tau_s': float(curve.taus_s[lowest]),
            },
            'misfit': fit.residual and dict(zip(('ratio', 'tau_s'), fit.residual, strict=True)),
            'ramp': fit.ramp,
            'curve': {
                'tau_s': curve.taus_s.tolist(),
                'deviation': curve.deviations.tolist(),
                'low': low.tolist(),
                'high': high.tolist(),
                'fit': fit.deviations.tolist(),
                'terms': curve.terms.tolist(),
            },
        }


@dataclass(frozen=True, eq=False)
class Analysis:
    """
    The noise of an IMU.

    :param source: where the samples are from.
    :param topic: of the IMU; None in a file that has none.
    :param signal: those samples.
    :param units: of 'gyro' and 'accel', as recorded.
    :param axes: each axis of ``AXES``.
    :param warnings: what makes the figures doubtful.
    :param profile: the platform whose limits were used, as they are in ``limits``.
    """

    source: str
    topic: str | None
    signal: Signal
    units: Mapping[str, Unit]
    axes: Mapping[str, Axis]
    warnings: tuple[str, ...]
    profile: str
    limits: ImuNoiseLimits

    def parameters(self, kind: str, attribute: str) -> Iterator[Parameter]:
        """Yield one parameter of each axis of a 'gyro' or 'accel'."""
        for name, axis in self.axes.items():
            if name.startswith(kind):
                yield getattr(axis.fit, attribute)

    def largest(self, kind: str, attribute: str) -> float | None:
        """Return the largest known value of the three axes, None where none is known."""
        values = [parameter.value for parameter in self.parameters(kind, attribute)]
        return max((value for value in values if not math.isnan(value)), default=None)

    def to_dict(self) -> dict[str, Any]:
        """Return all that was found, in schema ``vio_eval_ros.imu_noise/1``, None for NaN."""
        signal = self.signal
        document = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'input': {
                'source': self.source,
                'first_stamp_ns': signal.first_ns,
                'duration_s': signal.duration_s,
                'rate_hz': signal.rate_hz * signal.averaged,
                'averaged': signal.averaged,
                'segments': len(signal.segments),
                'counts': vars(signal.counts),
                'units': {kind: unit._asdict() for kind, unit in self.units.items()},
            },
            'profile': self.profile,
            'limits': self.limits.to_dict(),
            'confidence': CONFIDENCE,
            'axes': {
                name: axis.to_dict(name.partition('_')[0]) for name, axis in self.axes.items()
            },
            'kalibr': {key: self.largest(*what) for key, what in KALIBR.items()},
            'warnings': list(self.warnings),
        }
        found: dict[str, Any] = without_nan(document)
        return found


def analyse(
    source: str,
    signal: Signal,
    *,
    stated: Mapping[str, str] | None = None,
    topic: str | None = None,
    limits: ImuNoiseLimits | None = None,
    profile: str = PROFILES[0],
) -> Analysis:
    """
    Return the noise of a signal.

    :param source: what to call it.
    :param stated: the unit of 'gyro' and of 'accel', where it is known.
    :param limits: those of the profile where None.
    :raises ConfigError: there is no such profile.
    :raises ReadError: the sensor was in motion.
    """
    limits = limits or ImuNoiseLimits.of(profile)
    means, curves, parts, vibrations = [], [], {}, {}
    for index, name in enumerate(AXES):
        segments = list(signal.axis(index))
        lengths = [len(values) for values in segments]
        means.append(float(np.average([values.mean() for values in segments], weights=lengths)))
        curves.append(allan_curve(segments, signal.mean_rate_hz))
        parts[name] = seconds(segments, signal.mean_rate_hz, signal.averaged, limits)
        vibrations[name] = vibration(segments, curves[-1], limits)
    units = _units(means, curves, stated or {}, limits, topic is not None)
    absent = [kind for kind in UNITS if all(parts[name].still.all() for name in _axes(kind))]
    _refuse_motion(source, parts, units, limits)
    axes = {}
    for name, mean, curve in zip(AXES, means, curves, strict=True):
        kind = name.partition('_')[0]
        size = UNITS[kind][units[kind].name]
        scaled = replace(curve, deviations=curve.deviations * size)
        axes[name] = Axis(mean * size, scaled, fit_noise(scaled, signal.missing, limits))
    times_s = signal.times_s(second_samples(signal.mean_rate_hz))
    warnings = (
        *of_absence(absent),
        *of_units({kind: unit for kind, unit in units.items() if kind not in absent}),
        *_unlikely_unit(curves, units, limits, topic is not None),
        *of_losses(signal, limits),
        *of_movement(parts, times_s, limits),
        *of_means({name: axis.mean for name, axis in axes.items()}, limits, absent),
        *of_values(parts, times_s, units),
        *of_vibrations(vibrations),
        *of_fits({name: axis.fit for name, axis in axes.items()}),
    )
    return Analysis(
        source=source,
        topic=topic,
        signal=signal,
        units=units,
        axes=axes,
        warnings=warnings,
        profile=profile,
        limits=limits,
    )


def _axes(kind: str) -> list[str]:
    """Return the names of the axes of a 'gyro' or 'accel'."""
    return [name for name in AXES if name.startswith(kind)]


def _refuse_motion(
    source: str, parts: Mapping[str, Seconds], units: Mapping[str, Unit], limits: ImuNoiseLimits
) -> None:
    """Refuse a record of a sensor in motion, of which only the motion would be measured."""
    rest = {'gyro': limits.rest_rate_rad_s, 'accel': limits.rest_force_m_s2}
    turning = [
        parts[name].turning(rest[kind] / UNITS[kind][units[kind].name])
        for kind in UNITS
        for name in _axes(kind)
    ]
    moving = np.any(turning, axis=0)
    if moving.size and moving.mean() > limits.max_handled_ratio:
        raise ReadError(
            source,
            f'the sensor was moved or flown in {moving.sum():,} of {len(moving):,} seconds, so '
            'that its noise cannot be told from its motion; record it lying still, for hours '
            '(--limits with a larger max_handled_ratio measures it all the same)',
        )


def _units(
    means: list[float],
    curves: list[Curve],
    stated: Mapping[str, str],
    limits: ImuNoiseLimits,
    of_message: bool,
) -> dict[str, Unit]:
    """
    Return the units of the samples: as stated, else by their magnitude, else SI.

    A message has rad/s by its definition, however noisy they are; an accelerometer at rest that
    shows 1 is in g all the same.
    """
    is_in_degrees = not of_message and _white_noise(curves[:3]) > limits.degrees_density
    is_in_g = abs(float(np.linalg.norm(means[3:])) - 1) < limits.g_error
    return {
        'gyro': _unit('gyro', stated, 'deg/s', is_in_degrees),
        'accel': _unit('accel', stated, 'g', is_in_g),
    }


def _unlikely_unit(
    curves: list[Curve], units: Mapping[str, Unit], limits: ImuNoiseLimits, of_message: bool
) -> Iterator[str]:
    """Yield a warning of a gyroscope that is very noisy for the unit of its message."""
    by_default = units['gyro'].known == 'by default'
    if of_message and by_default and _white_noise(curves[:3]) > limits.degrees_density:
        yield (
            'the gyroscope is very noisy for rad/s, which its message defines; if the driver '
            'publishes deg/s, state --gyro-unit deg/s'
        )


def _unit(kind: str, stated: Mapping[str, str], other: str, is_other: bool) -> Unit:
    if kind in stated:
        return Unit(stated[kind], 'stated')
    return Unit(other, 'by magnitude') if is_other else Unit(next(iter(UNITS[kind])), 'by default')


def _white_noise(curves: list[Curve]) -> float:
    """Return the median Allan deviation at 1 s, by the white noise line of a shorter record."""
    levels = []
    for curve in curves:
        if len(curve.taus_s):
            tau_s = min(1.0, curve.taus_s[-1])
            level = np.interp(np.log(tau_s), np.log(curve.taus_s), curve.deviations)
            levels.append(level * np.sqrt(tau_s))
    return float(np.median(levels)) if levels else 0.0
