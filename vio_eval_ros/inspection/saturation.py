"""Axes of an IMU that are cut off at the limit of what they can measure."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vio_eval_ros.core.sensor_stream import LARGEST_MEASUREMENT, runs, SensorStream
from vio_eval_ros.inspection.finding import are, Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.imu_axes import shown
from vio_eval_ros.inspection.limits import InspectionLimits

#: an axis is cut off where its extreme comes more often than all values just below it: those
#: within this share of the range ...
BELOW_RANGE = 0.02
#: ... and within this many levels
BELOW_LEVELS = 6
#: an axis with fewer levels is coarse: its extreme comes often anyway
COARSE_LEVELS = 50


def cut_off(values: np.ndarray, limits: InspectionLimits) -> np.ndarray:
    """Return which of (N,) values are at a limit of what the axis can measure."""
    is_cut = np.zeros(len(values), bool)
    known = values[np.abs(values) < LARGEST_MEASUREMENT]
    values_there = np.unique(known)
    if len(values_there) < COARSE_LEVELS:
        return is_cut
    # the crest of a smooth motion fills the levels below as well, however coarse they are
    level = float(np.median(np.diff(values_there)))
    width = max(BELOW_RANGE * float(np.ptp(known)), BELOW_LEVELS * level)
    is_fine = len(values_there) > len(known) / 2  # then not even a crest is twice the same
    for side in (1, -1):
        extreme = (side * known).max()
        is_at = side * values == extreme
        below = np.count_nonzero(side * known >= extreme - width) - is_at.sum()
        begins, ends = runs(is_at)
        least = limits.saturation_samples if is_fine else max(limits.saturation_samples, below)
        in_a_row = (ends - begins).max(initial=0)
        if is_at.sum() >= least and in_a_row >= limits.saturation_run_samples:
            is_cut |= is_at
    return is_cut


def cut_off_nearby(values: np.ndarray, limits: InspectionLimits) -> np.ndarray:
    """Return which of (N,) values are cut off at a limit that others come near to."""
    is_cut = cut_off(values, limits)
    for limit in np.unique(values[is_cut]):
        off = np.abs(values - limit)
        if not ((off > 0) & (off < BELOW_RANGE * np.nanmax(off))).any():
            is_cut &= values != limit
    return is_cut


def saturation_findings(stream: SensorStream, saturated: np.ndarray) -> Iterator[Finding]:
    assert stream.numbers is not None
    is_cut = np.asarray(saturated.any(axis=1))
    if not is_cut.any():
        return
    begins, ends = runs(is_cut)
    at = np.array(
        [np.abs(stream.numbers[which, k]).max(initial=0) for k, which in enumerate(saturated.T)]
    )
    count = int(is_cut.sum())
    yield FINDINGS['saturation'].found(
        stream,
        samples=are(count, 'sample'),
        axes=shown(at, 'at'),
        count=count,
        value=float(at.max()),
        moments=stream.moments(begins, ends - 1),
    )
