"""Limits of a record of an IMU at rest: beyond them its noise is doubtful, or not determined."""

from __future__ import annotations

from dataclasses import dataclass

from vio_eval_ros.core.limits import limit, Limits

SIMULATED = 'chosen on simulated records'


@dataclass(frozen=True)
class ImuNoiseLimits(Limits):
    """When `imu_noise` warns or gives null; no platform changes them, since all are at rest."""

    max_lost_samples: float = limit(
        10.0, '', 'samples lost in a row that are bridged; more cut the record', SIMULATED
    )
    missing_ratio: float = limit(
        0.01, '', 'share of samples missing above which there is a warning', 'chosen'
    )
    max_missing_ratio: float = limit(
        0.15,
        '',
        'share of samples missing above which every parameter is null',
        'chosen: the rate of a sensor that loses half of its samples cannot be determined',
    )
    equal_stamps_ratio: float = limit(
        0.01,
        '',
        'share of samples with the stamp of the previous one above which there is a warning',
        'chosen',
    )
    scatter_ratio: float = limit(
        4.0,
        '',
        'scatter within a second, over its median, above which the sensor moves',
        SIMULATED,
    )
    mean_change_sigmas: float = limit(
        6.5,
        'σ',
        'change of the mean over 1 s or 10 s, in standard deviations of the usual change, '
        'above which the sensor moves',
        'chance exceeds it once in 100,000 records of 6 h',
    )
    rest_rate_rad_s: float = limit(
        0.05,
        'rad/s',
        'change of the mean rate from one second to the next, above which the sensor is handled '
        'or flown',
        'chosen: 3 deg/s; by hand and in flight it is several times that most of the time',
    )
    rest_force_m_s2: float = limit(
        0.5, 'm/s²', 'the same of the mean acceleration', 'chosen: 3 deg of tilt'
    )
    max_handled_ratio: float = limit(
        0.25,
        '',
        'share of such seconds above which the record is refused: it shows the motion',
        'chosen',
    )
    resolution_sigmas: float = limit(
        1.4,
        'σ',
        'distance of neighbouring values, over the scatter within a second, above which the '
        'resolution is too coarse',
        '1.5 times the noise of a sample, where rounding changes the density by 10 %',
    )
    vibration_ratio: float = limit(
        0.1,
        '',
        'rise of the density due to lines of the spectrum above which there is a warning',
        'chosen',
    )
    residual_ratio: float = limit(
        0.1,
        '',
        'distance of the curve from the fit, beyond what chance explains, above which there is a '
        'warning',
        'chosen',
    )
    max_rate_rad_s: float = limit(
        0.2, 'rad/s', 'largest mean angular rate of a sensor at rest', 'chosen: 11 deg/s'
    )
    gravity_error_m_s2: float = limit(
        0.5,
        'm/s²',
        'largest difference of the mean acceleration from 9.81 m/s² at rest',
        'chosen: gravity on Earth is 9.78 to 9.83 m/s², the rest is bias',
    )
    degrees_density: float = limit(
        1.5e-3,
        '/s/√Hz',
        'white noise of a gyroscope above which its samples are taken to be in deg/s',
        'chosen: in rad/s no gyroscope is as noisy, in deg/s only the best are not',
    )
    g_error: float = limit(
        0.2,
        '',
        'difference of the mean acceleration from 1 up to which samples are taken to be in g',
        'chosen',
    )
    min_averaging_times: float = limit(
        8.0, '', 'averaging times to fit; fewer cannot separate three terms', SIMULATED
    )
    detection_sigmas: float = limit(
        3.0,
        'σ',
        'how far a term, or a steady drift, must exceed what chance explains to be fitted',
        SIMULATED,
    )
    certainty_sigmas: float = limit(
        2.0,
        'σ',
        'how far the square of a fitted term must be from zero for a value to be given',
        SIMULATED,
    )
