"""Whether the noise of an IMU that a calibration file states can be right."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import math

from vio_eval_ros.inspection.calibration_files import CalibrationFile, NOISE, RATES
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import InspectionLimits

#: random walk over density above which the two were exchanged; the walk of accelerometers is often
#: enlarged for a filter
WALK_TO_DENSITY = {'gyroscope': 1.0, 'accelerometer': 3.0}


def noise_findings(
    file: CalibrationFile, recorded_hz: Sequence[float], limits: InspectionLimits
) -> Iterator[Finding]:
    """
    Yield figures of noise that no IMU has, that are missing, or that the recorded IMU has not.

    :param recorded_hz: the rates of the IMUs in the recording.
    """
    for name, figures in file.noise.items():
        where = f'{file.source}:{name}'
        yield from _out_of_range(where, figures)
        lacking = [key for key in NOISE if key not in figures]
        if len(lacking) < len(NOISE) and lacking:
            keys = f'{" and ".join(lacking)} {"is" if len(lacking) == 1 else "are"}'
            yield FINDINGS['imu_noise'].found(where, 'lacking', keys=keys)
        yield from _exchanged(where, figures)
        yield from _other_rate(where, figures, recorded_hz, limits)


def _out_of_range(where: str, figures: Mapping[str, float]) -> Iterator[Finding]:
    for key, (unit, least, most) in (NOISE | RATES).items():
        value = figures.get(key, math.nan)
        if not math.isnan(value) and not least <= value <= most:
            yield FINDINGS['imu_noise'].found(
                where,
                'range',
                severe=not value > 0,
                key=key,
                least=least,
                most=most,
                value=value,
                unit=unit,
            )


def _exchanged(where: str, figures: Mapping[str, float]) -> Iterator[Finding]:
    """Yield random walks that are larger than densities can explain."""
    for sensor, times in WALK_TO_DENSITY.items():
        density, walk = f'{sensor}_noise_density', f'{sensor}_random_walk'
        small, large = figures.get(density, math.nan), figures.get(walk, math.nan)
        if _is_known(density, small) and _is_known(walk, large) and large > times * small:
            yield FINDINGS['imu_noise'].found(
                where,
                'exchanged',
                walk=walk,
                large=large,
                density=density,
                small=small,
                value=large / small,
                unit='ratio',
            )


def _is_known(key: str, value: float) -> bool:
    """Return whether a figure is one that some IMU has."""
    _, least, most = NOISE[key]
    return least <= value <= most


def _other_rate(
    where: str,
    figures: Mapping[str, float],
    recorded_hz: Sequence[float],
    limits: InspectionLimits,
) -> Iterator[Finding]:
    tolerance = limits.imu_rate_tolerance_percent / 100
    for key, (_, least, most) in RATES.items():
        rate_hz = figures.get(key, math.nan)
        differs = all(abs(one - rate_hz) > tolerance * one for one in recorded_hz)
        if recorded_hz and differs and least <= rate_hz <= most:
            recorded = ' and '.join(f'{one:.4g}' for one in recorded_hz)
            yield FINDINGS['imu_noise'].found(
                where, 'rate', key=key, recorded=recorded, value=rate_hz, unit='Hz'
            )


def noise_sentences(file: CalibrationFile) -> Iterator[str]:
    """Yield what is stated of the noise of each IMU."""
    units = {key: unit for key, (unit, _, _) in (NOISE | RATES).items()}
    for name, figures in file.noise.items():
        if figures:
            shown = (f'{key} {value:g} {units[key]}' for key, value in figures.items())
            yield f'{name}: {", ".join(shown)}'
