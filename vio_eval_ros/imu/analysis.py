"""What a record of an IMU at rest says of its noise, and whether it was at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vio_eval_ros.imu.allan import allan_curve, Curve
from vio_eval_ros.imu.fit import Fit, fit_noise, MOST_MISSING, NAMES
from vio_eval_ros.imu.record import AXES, NO_NUMBERS, Signal
from vio_eval_ros.imu.rest import second_samples, Seconds, seconds, vibration

#: What samples may be in, and how large one is in rad/s or m/s².
UNITS = {
    'gyro': {'rad/s': 1.0, 'deg/s': np.pi / 180},
    'accel': {'m/s2': 1.0, 'g': 9.80665},
}
# As rad/s no gyroscope is as noisy as this; as deg/s, those in use are noisier, but for the best.
NOISY_AT_1_S = 1.5e-3
FASTEST_BIAS = 0.2  # rad/s
GRAVITY, GRAVITY_ERROR = 9.81, 0.5  # m/s²
MANY = 0.01
NAMED = 5  # times at most


class Unit(NamedTuple):
    """What samples are in, and how that is known: stated, by magnitude, or by default."""

    name: str
    known: str


@dataclass(frozen=True, eq=False)
class Axis:
    """
    One axis, in rad/s or m/s².

    :param mean: of all samples: the bias, with gravity.
    """

    mean: float
    curve: Curve
    fit: Fit


@dataclass(frozen=True, eq=False)
class Analysis:
    """
    The noise of an IMU.

    :param source: where the samples are from.
    :param signal: those samples.
    :param units: of 'gyro' and 'accel', as recorded.
    :param axes: each axis of ``AXES``.
    :param warnings: what makes the figures doubtful.
    """

    source: str
    signal: Signal
    units: dict[str, Unit]
    axes: dict[str, Axis]
    warnings: list[str]


def analyse(source: str, signal: Signal, stated: dict[str, str]) -> Analysis:
    """
    Return the noise of a signal.

    :param source: what to call it.
    :param stated: the unit of 'gyro' and of 'accel', where it is known.
    """
    means, curves, parts, shaken = [], [], [], {}
    for index, name in enumerate(AXES):
        segments = list(signal.axis(index))
        means.append(
            float(np.average([s.mean() for s in segments], weights=list(map(len, segments))))
        )
        curves.append(allan_curve(segments, signal.mean_rate_hz))
        parts.append(seconds(segments, signal.mean_rate_hz, signal.averaged))
        shaken[name] = vibration(segments, curves[-1])
    units = {
        'gyro': _unit('gyro', stated, 'deg/s', _is_in_degrees(curves[:3])),
        'accel': _unit('accel', stated, 'g', abs(float(np.linalg.norm(means[3:])) - 1) < 0.2),
    }
    axes = {}
    for name, mean, curve in zip(AXES, means, curves, strict=True):
        kind = name.partition('_')[0]
        size = UNITS[kind][units[kind].name]
        scaled = replace(curve, deviations=curve.deviations * size)
        axes[name] = Axis(mean * size, scaled, fit_noise(scaled, signal.missing))
    warnings = [
        f'the {kind} is taken to be in {unit.name}, after its magnitude; if it is not, say so '
        f'with --{kind}-unit'
        for kind, unit in units.items()
        if unit.known == 'by magnitude'
    ]
    times_s = signal.times_s(second_samples(signal.mean_rate_hz))
    each = dict(zip(AXES, parts, strict=True))
    warnings += [
        *_of_record(signal),
        *_of_unrest(each, times_s),
        *_of_means(axes),
        *_of_values(each, times_s, units),
        *(
            f'{name}: a vibration of {found[0]:.3g} Hz raises its density by '
            f'{100 * found[1]:.0f} %'
            for name, found in shaken.items()
            if found
        ),
        *_of_fits(axes),
    ]
    return Analysis(source, signal, units, axes, warnings)


def _unit(kind: str, stated: dict[str, str], other: str, is_other: bool) -> Unit:
    if kind in stated:
        return Unit(stated[kind], 'stated')
    return Unit(other, 'by magnitude') if is_other else Unit(next(iter(UNITS[kind])), 'by default')


def _is_in_degrees(curves: list[Curve]) -> bool:
    levels = []
    for curve in curves:
        if len(curve.taus_s):
            # of a shorter record, the white noise line at 1 s
            tau_s = min(1.0, curve.taus_s[-1])
            level = np.interp(np.log(tau_s), np.log(curve.taus_s), curve.deviations)
            levels.append(level * np.sqrt(tau_s))
    return bool(levels) and float(np.median(levels)) > NOISY_AT_1_S


def _of_record(signal: Signal) -> list[str]:
    """Return warnings of how the record was made."""
    counts = signal.counts
    found = []
    if signal.missing > MANY:
        told = (
            'too many to tell any noise'
            if signal.missing > MOST_MISSING
            else 'the density is what it would be of all of them'
        )
        found.append(
            f'{100 * signal.missing:.1f} % of the samples are missing here and there: {told}'
        )
    if counts.gaps:
        found.append(
            f'the record is cut into {len(signal.segments):,} segments; gaps: {counts.gaps:,}, '
            f'samples lost in them: {counts.lost:,}'
        )
    if counts.equal_stamps > MANY * counts.samples:
        found.append(
            f'{counts.equal_stamps:,} samples have the stamp of the one before: the stamps are '
            'not those of the sensor; its order and its mean rate are used'
        )
    for count, what in (
        (counts.late, 'too late to be sorted'),
        (counts.not_finite, NO_NUMBERS),
    ):
        if count:
            found.append(f'left out: {count:,} of {counts.samples:,} samples, {what}')
    return found


def _of_unrest(parts: dict[str, Seconds], times_s: np.ndarray) -> list[str]:
    """Return a warning of movement, with its times."""
    unrest = np.array([part.unrest() for part in parts.values()])
    if not unrest.any():
        return []
    which = ', '.join(name for name, one in zip(parts, unrest, strict=True) if one.any())
    when = _when(np.any(unrest, axis=0), times_s)
    return [
        f'the sensor was not at rest: {which} changes {when}: use what lies before, between '
        'or after'
    ]


def _of_values(
    parts: dict[str, Seconds], times_s: np.ndarray, units: dict[str, Unit]
) -> Iterator[str]:
    """Yield warnings of values that are not those of a noise."""
    for name, part in parts.items():
        if part.step:
            unit = units[name.partition('_')[0]].name
            yield (
                f'{name}: its resolution, {part.step:.3g} {unit}, is coarser than its noise, of '
                'which neither density nor walk can be trusted'
            )
        elif part.still.any() and not part.still.all():
            yield f'{name}: its value stands still {_when(part.still, times_s)}'


def _when(which: np.ndarray, times_s: np.ndarray) -> str:
    """Return how many seconds there are, and when each run of them begins."""
    begins = times_s[which & ~np.concatenate([[False], which[:-1]])]
    named = ', '.join(f'{time_s:,.0f}' for time_s in begins[:NAMED])
    more = f' and {len(begins) - NAMED:,} times more' if len(begins) > NAMED else ''
    return (
        f'in {which.sum():,} of {len(which):,} seconds, beginning {named} s after the start{more}'
    )


def _of_means(axes: dict[str, Axis]) -> list[str]:
    """Return warnings of means that no sensor at rest has."""
    found = []
    rate = np.linalg.norm([axes[name].mean for name in AXES[:3]])
    if rate > FASTEST_BIAS:
        found.append(f'its mean angular rate is {rate:.3g} rad/s: it turns, or the unit is wrong')
    force = np.linalg.norm([axes[name].mean for name in AXES[3:]])
    if abs(force - GRAVITY) > GRAVITY_ERROR:
        found.append(
            f'its mean acceleration is {force:.4g} m/s², at rest it should be {GRAVITY}: gravity '
            'was taken out, or the unit is wrong'
        )
    return found


def _of_fits(axes: dict[str, Axis]) -> list[str]:
    """Return warnings of curves that end too soon, or are not those of the model."""
    short = []
    for attribute, label in NAMES.items():
        names = [name for name, axis in axes.items() if getattr(axis.fit, attribute).too_short]
        if names:
            which = 'any axis' if len(names) == len(axes) else ', '.join(names)
            short.append(f'the {label.replace("_", " ")} of {which}')
    found = [f'the record is too short to tell {"; ".join(short)}'] if short else []
    for name, axis in axes.items():
        if axis.fit.misfit:
            excess, tau_s = axis.fit.misfit
            found.append(
                f'{name}: at τ = {tau_s:.3g} s the curve is {100 * abs(excess):.0f} % '
                f'{"above" if excess > 0 else "below"} the fit: there is more than the three '
                'noises, such as vibration, a filter or a change of temperature'
            )
        if axis.fit.ramp:
            found.append(
                f'{name}: the curve rises as under a steady drift, such as warming up; the random '
                'walk contains it'
            )
    return found
