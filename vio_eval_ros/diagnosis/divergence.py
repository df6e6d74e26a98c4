"""Where an estimate leaves and never comes back."""

from __future__ import annotations

import numpy as np

from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.diagnosis.windows import NEIGHBOURS

#: the last shares of a run that are compared with the drift over as long elsewhere in it
LAST_SHARES = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
#: how many times as large as elsewhere the drift over such a share is
DRIFT_RATIO = 5.0
#: an estimate that is so many times as far away as the truth is large has blown up
BLOWN_UP_RATIO = 1e5
#: ... and has left where it is so many times as far away
AWAY_RATIO = 3.0


def blown_up_from(estimate: np.ndarray, truth: np.ndarray) -> int | None:
    """
    Return from which pose on an estimate that ends out of all proportion stays away.

    Beside such poses nothing else can be measured. One that is out of proportion from the first
    pose on has another unit and has not left.

    :param estimate: (N, 3) positions.
    :param truth: (M, 3) positions.
    """
    begin = np.median(estimate[:NEIGHBOURS], axis=0)
    extent = max(float(lengths(truth - truth.mean(axis=0)).max()), 1.0)
    away = lengths(estimate - begin)
    if not away[-NEIGHBOURS:].min() > BLOWN_UP_RATIO * extent:
        return None
    near = np.flatnonzero(away < AWAY_RATIO * extent)
    return int(near[-1]) + 1 if len(near) else None


def diverged_from(errors: np.ndarray, truth: np.ndarray, least_m: float) -> int | None:
    """
    Return the first sample of an estimate that has left, if it never comes back.

    :param errors: (N, 3) of the positions.
    :param truth: (N, 3) positions.
    :param least_m: what is nearer has not left.
    """
    beginnings = (_beyond_extent(errors, truth, least_m), _fast_drift(errors, least_m))
    return min((first for first in beginnings if first is not None), default=None)


def _beyond_extent(errors: np.ndarray, truth: np.ndarray, least_m: float) -> int | None:
    """Return the first sample from which the error stays larger than the truth's extent."""
    extent = float(lengths(truth - truth.mean(axis=0)).max())
    far = lengths(errors - np.median(errors[: max(len(errors) // 3, 1)], axis=0)) > max(
        extent, least_m
    )
    if not far[-1] or far.all():
        return None
    first = int(np.flatnonzero(~far)[-1]) + 1
    return first if len(far) - first >= NEIGHBOURS else None


def _fast_drift(errors: np.ndarray, least_m: float) -> int | None:
    """Return the first sample from which the error changes as never before over as long."""
    best, found = DRIFT_RATIO, None
    for share in LAST_SHARES:
        count = int(share * len(errors))
        if count < 2 * NEIGHBOURS:
            continue
        changes = lengths(errors[count:] - errors[:-count])
        usual = float(changes[: len(errors) - 2 * count].max())
        # from where it was all the time before: else it has come back
        away = float(lengths(errors[:-count] - errors[-1]).min())
        if min(changes[-1], away) > max(best * usual, least_m):
            best = float(changes[-1]) / usual
            near = lengths(errors[-count:] - errors[-count - 1]) <= usual
            found = len(errors) - count + int(np.flatnonzero(near)[-1] + 1 if near.any() else 0)
    return found
