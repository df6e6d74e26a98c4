"""Statistics of errors are those of numpy, and NaN where there is nothing to summarise."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core.statistics import median, STATISTICS, statistics


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=30))
def test_statistics_are_those_of_numpy(errors):
    errors = np.array(errors)
    expected = {
        'rmse': np.sqrt(np.mean(errors**2)),
        'mean': errors.mean(),
        'median': np.median(errors),
        'std': errors.std(),
        'min': errors.min(),
        'max': errors.max(),
        'p95': np.percentile(errors, 95),
    }
    found = statistics(errors)
    assert tuple(found) == STATISTICS
    assert median(errors) == found['median']
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-9, abs=1e-9 * errors.max()), name


@pytest.mark.parametrize('errors', [[], [np.nan], [1.0, np.nan]])
def test_statistics_are_nan_without_errors_or_with_nan_among_them(errors):
    assert all(math.isnan(value) for value in statistics(np.array(errors)).values())
    assert math.isnan(median(np.array(errors)))
