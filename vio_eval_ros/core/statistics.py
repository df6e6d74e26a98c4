"""Statistics of errors."""

from __future__ import annotations

import math

import numpy as np

STATISTICS = ('rmse', 'mean', 'median', 'std', 'min', 'max', 'p95')


def root_mean_square(errors: np.ndarray) -> float:
    """Return the root of the mean square; NaN of nothing."""
    return math.sqrt(float(errors @ errors) / len(errors)) if len(errors) else math.nan


def statistics(errors: np.ndarray) -> dict[str, float]:
    """
    Return rmse, mean, median, std, min, max and p95 of N errors; all NaN where any is or N is 0.

    The standard deviation is that of the population, p95 is interpolated linearly.
    """
    mean = float(errors.mean()) if len(errors) else math.nan
    if math.isnan(mean):
        return dict.fromkeys(STATISTICS, math.nan)
    median, p95 = np.quantile(errors, (0.5, 0.95))
    return {
        'rmse': root_mean_square(errors),
        'mean': mean,
        'median': float(median),
        'std': root_mean_square(errors - mean),
        'min': float(errors.min()),
        'max': float(errors.max()),
        'p95': float(p95),
    }
