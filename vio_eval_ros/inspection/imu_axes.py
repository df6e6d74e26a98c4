"""The six axes of an IMU, and limits of its two sensors on each of them."""

from __future__ import annotations

import numpy as np

from vio_eval_ros.inspection.limits import InspectionLimits

AXES = ('gyroscope x', 'gyroscope y', 'gyroscope z',
        'accelerometer x', 'accelerometer y', 'accelerometer z')  # fmt: skip
ALL, GYRO, ACCEL = slice(0, 6), slice(0, 3), slice(3, 6)


def on_axes(gyroscope: float, accelerometer: float) -> np.ndarray:
    """Return (6,) a limit of each sensor on its three axes."""
    return np.repeat([gyroscope, accelerometer], 3)


def still_limits(limits: InspectionLimits) -> np.ndarray:
    """Return (6,) the spread of samples at rest, rad/s and m/s²."""
    return on_axes(limits.still_rate_rad_s, limits.still_acceleration_m_s2)


def named(axes: slice) -> str:
    """Return the name of one axis, of the three of a sensor, or of all six."""
    names = AXES[axes]
    return {1: names[0], 3: f'the {names[0].split()[0]}', 6: 'all six axes'}[len(names)]


def shown(figures: np.ndarray, words: str) -> str:
    """Return the figures of those of the six axes where there is one."""
    return ', '.join(
        f'{axis} {words} {figure:.4g} {"rad/s" if axis.startswith("gyro") else "m/s2"}'
        for axis, figure in zip(AXES, figures.tolist(), strict=True)
        if figure
    )
