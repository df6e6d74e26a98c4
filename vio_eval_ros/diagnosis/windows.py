"""Samples among their neighbours on either side."""

from __future__ import annotations

import numpy as np

#: on either side
NEIGHBOURS = 5


def running_median(values: np.ndarray) -> np.ndarray:
    """Return (N, 3) medians of each sample and its neighbours, the ends repeated."""
    padded = np.pad(values, ((NEIGHBOURS, NEIGHBOURS), (0, 0)), 'edge')
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1, axis=0)
    return np.asarray(np.median(windows, axis=-1))


def without_ends(steps: np.ndarray) -> np.ndarray:
    """Return (N - 1,) flags of steps, without those with too few poses on one side; in place."""
    steps[: NEIGHBOURS - 1] = steps[len(steps) - NEIGHBOURS + 1 :] = False
    return steps


def neighbours_of(k: int, count: int) -> np.ndarray:
    """Return the indices of the neighbours of the k-th of so many samples, without itself."""
    near = np.arange(max(k - NEIGHBOURS, 0), min(k + NEIGHBOURS + 1, count))
    return np.asarray(near[near != k])
