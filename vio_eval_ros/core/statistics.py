"""Statistics of errors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

#: half of the 95 % interval of a normal distribution, in standard deviations
NORMAL_95 = 1.96
STATISTICS = ('rmse', 'mean', 'median', 'std', 'min', 'max', 'p95')


def root_mean_square(errors: np.ndarray) -> float:
    """Return the root of the mean square; NaN of no errors."""
    return math.sqrt(float(errors @ errors) / len(errors)) if len(errors) else math.nan


def statistics(errors: np.ndarray) -> dict[str, float]:
    """
    Return rmse, mean, median, std, min, max and p95 of N errors; all NaN where any is or N is 0.

    The standard deviation is that of the population, p95 is interpolated linearly.
    """
    mean = float(errors.mean()) if len(errors) else math.nan
    if math.isnan(mean):
        return dict.fromkeys(STATISTICS, math.nan)
    middle, p95 = _quantiles(errors, (0.5, 0.95))
    return {
        'rmse': root_mean_square(errors),
        'mean': mean,
        'median': middle,
        'std': root_mean_square(errors - mean),
        'min': float(errors.min()),
        'max': float(errors.max()),
        'p95': p95,
    }


def median(values: np.ndarray) -> float:
    """Return the median of N values, as np.median; NaN where one is NaN or N is 0."""
    if not len(values) or np.isnan(values).any():
        return math.nan
    return _quantiles(values, (0.5,))[0]


def _quantiles(errors: np.ndarray, fractions: tuple[float, ...]) -> list[float]:
    """Return what np.quantile gives, which takes longer to import than this to compute."""
    places = [fraction * (len(errors) - 1) for fraction in fractions]
    lower = [int(place) for place in places]
    upper = [min(index + 1, len(errors) - 1) for index in lower]
    ordered = np.partition(errors, sorted({*lower, *upper}))
    return [
        float(ordered[i] + (ordered[j] - ordered[i]) * (place - i))
        for place, i, j in zip(places, lower, upper, strict=True)
    ]


def without_nan(value: Any) -> Any:
    """Return a value for JSON, with None in place of numbers that are not finite."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: without_nan(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return value
