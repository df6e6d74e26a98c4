"""Which way a metric is worse, and its unit, by its name."""

from __future__ import annotations

#: units of metrics, by the ends of their names; the longer before the shorter
UNITS = {'_deg_per_m': 'deg/m', '_percent': '%', '_deg': 'deg', '_mb': 'MB', '_m': 'm', '_s': 's'}
HIGHER_IS_BETTER = ('coverage_ratio', 'tracked_ratio', 'matched_ratio', 'success_rate')
LOWER_IS_BETTER = (
    '_m',
    '_deg',
    '_percent',
    '_deg_per_m',
    'ate_extent_ratio',
    'loop_closure_gain',
    'initialisation_s',
    'latency_median_s',
    'latency_p99_s',
    '_mb',
)
#: in spite of their unit, neither more nor less of these is worse
NEITHER = ('path_length_m',)


def worse_sign(metric: str) -> int:
    """Return 1 where a higher value is worse, -1 where a lower one is, 0 where neither is."""
    if metric in HIGHER_IS_BETTER:
        return -1
    return int(metric.endswith(LOWER_IS_BETTER) and metric not in NEITHER)


def unit_of(metric: str) -> str:
    """Return the unit of a metric; empty where it has none."""
    return next((unit for end, unit in UNITS.items() if metric.endswith(end)), '')
