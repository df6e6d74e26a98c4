"""What makes a record of an IMU, or the noise found in it, doubtful: each in one sentence."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from vio_eval_ros.imu.fit import Fit, PARAMETERS
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.imu.movement import Seconds
from vio_eval_ros.imu.record import AXES, GRAVITY_M_S2, NOT_NUMBERS, Signal
from vio_eval_ros.imu.vibration import Vibration

LISTED_TIMES = 5
SENSORS = {'gyro': 'gyroscope', 'accel': 'accelerometer'}


class Unit(NamedTuple):
    """What samples are in, and how that is known: stated, by magnitude, or by default."""

    name: str
    known: str


def of_units(units: Mapping[str, Unit]) -> Iterator[str]:
    """Yield warnings of units that were inferred."""
    for kind, unit in units.items():
        if unit.known == 'by magnitude':
            yield (
                f'the {kind} is taken to be in {unit.name}, judging by its magnitude; if that is '
                f'wrong, state the unit with --{kind}-unit'
            )


def of_absence(absent: Collection[str]) -> Iterator[str]:
    """Yield warnings of sensors whose values never change."""
    for kind in absent:
        yield (
            f'the {SENSORS[kind]} never changes, as where each sensor has a topic of its own: '
            'choose its topic with --topic to measure it'
        )


def of_losses(signal: Signal, limits: ImuNoiseLimits) -> Iterator[str]:
    """Yield warnings of samples and stamps that are not as the sensor made them."""
    counts = signal.counts
    if signal.missing > limits.missing_ratio:
        consequence = (
            'too many to determine any noise'
            if signal.missing > limits.max_missing_ratio
            else 'the density is that of a full record'
        )
        yield (
            f'{100 * signal.missing:.1f} % of the samples are missing, scattered over the '
            f'record: {consequence}'
        )
    if counts.gaps:
        yield (
            f'the record is cut into {len(signal.segments):,} segments; gaps: {counts.gaps:,}, '
            f'samples lost in them: {counts.lost:,}'
        )
    if counts.equal_stamps > limits.equal_stamps_ratio * counts.samples:
        yield (
            f'{counts.equal_stamps:,} samples have the stamp of the previous one: the stamps are '
            'not those of the sensor; its order and its mean rate are used'
        )
    for count, what in (
        (counts.late, 'too late to be sorted'),
        (counts.not_finite, NOT_NUMBERS),
    ):
        if count:
            yield f'left out: {count:,} of {counts.samples:,} samples, {what}'


def of_movement(
    parts: Mapping[str, Seconds], times_s: np.ndarray, limits: ImuNoiseLimits
) -> Iterator[str]:
    """Yield a warning of movement, with its times."""
    moving = np.array([part.moving(limits) for part in parts.values()])
    if moving.any():
        which = ', '.join(name for name, one in zip(parts, moving, strict=True) if one.any())
        yield (
            f'the sensor was not at rest: {which} changes '
            f'{_when(np.any(moving, axis=0), times_s)}: use the record before, between or after'
        )


def of_values(
    parts: Mapping[str, Seconds], times_s: np.ndarray, units: Mapping[str, Unit]
) -> Iterator[str]:
    """Yield warnings of values that do not show the noise."""
    for name, part in parts.items():
        if part.resolution:
            unit = units[name.partition('_')[0]].name
            yield (
                f'{name}: its resolution, {part.resolution:.3g} {unit}, is coarser than its '
                'noise: neither density nor random walk can be trusted'
            )
        elif part.still.any() and not part.still.all():
            yield f'{name}: its value is constant {_when(part.still, times_s)}'


def of_means(
    means: Mapping[str, float], limits: ImuNoiseLimits, absent: Collection[str]
) -> Iterator[str]:
    """Yield warnings of means, rad/s and m/s² by axis, that no sensor at rest has."""
    rate = np.linalg.norm([means[name] for name in AXES[:3]])
    if rate > limits.max_rate_rad_s:
        yield f'its mean angular rate is {rate:.3g} rad/s: it rotates, or the unit is wrong'
    force = np.linalg.norm([means[name] for name in AXES[3:]])
    if 'accel' not in absent and abs(force - GRAVITY_M_S2) > limits.gravity_error_m_s2:
        yield (
            f'its mean acceleration is {force:.4g} m/s², expected {GRAVITY_M_S2} at rest: gravity '
            'was removed, or the unit is wrong'
        )


def of_vibrations(vibrations: Mapping[str, Vibration | None]) -> Iterator[str]:
    """Yield warnings of vibrations."""
    for name, found in vibrations.items():
        if found:
            yield (
                f'{name}: a vibration of {found.frequency_hz:.3g} Hz raises its density by '
                f'{100 * found.density_rise:.0f} %'
            )


def of_fits(fits: Mapping[str, Fit]) -> Iterator[str]:
    """Yield warnings of curves that end too early, or do not follow the model."""
    short = []
    for attribute, quantity in PARAMETERS.items():
        names = [name for name, fit in fits.items() if getattr(fit, attribute).too_short]
        if names:
            which = 'any axis' if len(names) == len(fits) else ', '.join(names)
            short.append(f'the {quantity.label} of {which}')
    if short:
        yield f'the record is too short to determine {"; ".join(short)}'
    for name, fit in fits.items():
        if fit.residual:
            excess, tau_s = fit.residual
            yield (
                f'{name}: at τ = {tau_s:.3g} s the curve is {100 * abs(excess):.0f} % '
                f'{"above" if excess > 0 else "below"} the fit: something beside the three '
                'noises is present, such as vibration, a filter or a change of temperature'
            )
        if fit.ramp:
            yield (
                f'{name}: the curve rises as under a steady drift, such as warming up; the random '
                'walk contains it'
            )


def _when(which: np.ndarray, times_s: np.ndarray) -> str:
    """Return the number of seconds selected, and when each run of them begins."""
    begins = times_s[which & ~np.concatenate([[False], which[:-1]])]
    listed = ', '.join(f'{time_s:,.0f}' for time_s in begins[:LISTED_TIMES])
    rest = len(begins) - LISTED_TIMES
    more = f' and {rest:,} times more' if rest > 0 else ''
    return (
        f'in {which.sum():,} of {len(which):,} seconds, beginning {listed} s after the start{more}'
    )
