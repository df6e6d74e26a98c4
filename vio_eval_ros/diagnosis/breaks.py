"""Where a run breaks: poses that are off and return, jumps that stay, intervals that are lost."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core.association import nanoseconds
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.diagnosis.fitting import horizon, robust_similarity

REACH = 5
# A VIO corrects itself by centimetres from frame to frame; what is named is clearly more.
OUTLIER_M, OUTLIER_TIMES = 0.2, 10.0
JUMP_M, JUMP_TIMES, JUMP_OVER_NEIGHBOURS = 0.12, 10.0, 3.0
DIVERGED_EXTENTS = 1.0
GAP_INTERVALS = 5.0
REGULAR = 1.5
GAP_PATH_TIMES, GAP_PATH_M = 3.0, 0.5
LATE_START, EARLY_END = 0.25, 0.1


@dataclass(frozen=True)
class Jump:
    """A pose from which on all are displaced, by (3,) metres in the estimate's world."""

    stamp_ns: int
    step: tuple[float, float, float]

    @property
    def size_m(self) -> float:
        """The length of the step."""
        return math.hypot(*self.step)


@dataclass(frozen=True)
class Gap:
    """An interval without estimate, though there is truth; by the clock of the truth."""

    begin_ns: int
    end_ns: int

    @property
    def seconds(self) -> float:
        """How long it is."""
        return (self.end_ns - self.begin_ns) / 1e9


@dataclass(frozen=True, eq=False)
class Breaks:
    """
    What stands out of the errors of the positions.

    :param outliers_ns: stamps of poses that are off while their neighbours are not.
    :param outlier_m: how far those are off, in the median; in metres of the truth.
    :param jumps: in order.
    :param diverged_ns: from which stamp on the estimate has flown away; None where it has not.
    """

    outliers_ns: np.ndarray
    outlier_m: float
    jumps: tuple[Jump, ...]
    diverged_ns: int | None


def find_breaks(pairs: Pairs, received_ns: np.ndarray) -> Breaks:
    """
    Return the outliers and jumps of paired positions, whatever their scale and worlds.

    :param received_ns: (N,) the stamps that the estimates came with, by which they are named.
    """
    stamps_ns = pairs.estimate.stamps_ns
    nothing = Breaks(np.empty(0, np.int64), math.nan, (), None)
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9 if len(pairs) > 1 else math.nan
    if len(pairs) < 4 * REACH:
        return nothing
    begin, end = horizon(stamps_ns, max(1.0, 2 * interval_s))
    if len(begin) < 2 * REACH:
        return nothing
    moved, truly = (
        side.positions[end] - side.positions[begin]
        for side in (pairs.estimate, pairs.ground_truth)
    )
    turn, scale, _ = robust_similarity(moved, truly, True)
    errors = scale * pairs.estimate.positions @ turn.T - pairs.ground_truth.positions
    errors -= np.median(errors, axis=0)

    off = lengths(errors - _running_median(errors))
    outliers = off > max(OUTLIER_M, OUTLIER_TIMES * float(np.quantile(off, 0.9)))
    kept = np.flatnonzero(~outliers)
    jumps = []
    for k, step in _jumps(errors[kept], stamps_ns[kept]):
        errors[kept[k + 1] :] -= step
        x, y, z = (step @ turn) / scale
        jumps.append(Jump(int(received_ns[kept[k + 1]]), (float(x), float(y), float(z))))
    return Breaks(
        received_ns[outliers],
        float(np.median(off[outliers])) if outliers.any() else math.nan,
        tuple(jumps),
        _diverged(errors, pairs.ground_truth.positions, received_ns),
    )


def _running_median(errors: np.ndarray) -> np.ndarray:
    """Return (N, 3) medians of each sample and REACH on either side."""
    ends = np.repeat(errors[:1], REACH, axis=0), np.repeat(errors[-1:], REACH, axis=0)
    padded = np.concatenate([ends[0], errors, ends[1]])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * REACH + 1, axis=0)
    return np.asarray(np.median(windows, axis=-1))


def _jumps(errors: np.ndarray, stamps_ns: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Return the samples behind which the error steps aside for good, and the (3,) steps."""
    steps = np.diff(errors, axis=0)
    intervals = np.diff(stamps_ns)
    size = lengths(steps)
    # the error of a random walk grows with the square root of the time
    size = size / np.sqrt(np.maximum(intervals / np.median(intervals), 1))
    limit = max(JUMP_M, JUMP_TIMES * float(np.quantile(size, 0.9)))
    found = []
    for k in np.flatnonzero(size > limit).tolist():
        before = slice(max(k - REACH + 1, 0), k + 1)
        after = slice(k + 1, min(k + 1 + REACH, len(errors)))
        around = np.concatenate([size[max(k - REACH, 0) : k], size[k + 1 : k + 1 + REACH]])
        lasting = np.median(errors[after], axis=0) - np.median(errors[before], axis=0)
        if (
            size[k] > JUMP_OVER_NEIGHBOURS * np.median(around)
            and lasting @ steps[k] > 0.5 * size[k] ** 2
        ):
            found.append((k, steps[k] - np.median(steps[_around(k, len(steps))], axis=0)))
    return found


def _around(k: int, count: int) -> np.ndarray:
    near = np.arange(max(k - REACH, 0), min(k + REACH + 1, count))
    return np.asarray(near[near != k])


def _diverged(errors: np.ndarray, truth: np.ndarray, stamps_ns: np.ndarray) -> int | None:
    """Return from when on the error is larger than the truth's extent and never comes back."""
    extent = float(lengths(truth - truth.mean(axis=0)).max())
    far = lengths(errors - np.median(errors[: max(len(errors) // 3, 1)], axis=0)) > max(
        DIVERGED_EXTENTS * extent, 1.0
    )
    if not far[-1] or far.all():
        return None
    first = int(np.flatnonzero(~far)[-1]) + 1
    return int(stamps_ns[first]) if len(far) - first >= REACH else None


def find_gaps(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> list[Gap]:
    """
    Return the intervals in which tracking was lost.

    Keyframes come when the camera has moved on: of an irregular stream an interval counts where
    it is much longer than nearly all others and the truth moved much further in it, and at the
    end of the run a tenth of it. An estimate that begins late has taken its time to initialise:
    that counts beyond a quarter of the run.
    """
    stamps_ns, known_ns = estimate.stamps_ns, truth.stamps_ns
    intervals = np.diff(stamps_ns)
    usual = float(np.median(intervals))
    path = np.concatenate([[0.0], np.cumsum(lengths(np.diff(truth.positions, axis=0)))])
    at = np.interp(stamps_ns.astype(float), known_ns.astype(float), path)
    regular = float(np.quantile(intervals, 0.9)) <= REGULAR * usual
    if not regular:
        usual = float(np.quantile(intervals, 0.98))
    limit_m = max(GAP_PATH_TIMES * float(np.quantile(np.diff(at), 0.95)), GAP_PATH_M)
    limit_ns = max(nanoseconds(max_gap_s), GAP_INTERVALS * usual)
    lost = (intervals > limit_ns) & (regular | (np.diff(at) > limit_m))
    gaps = [Gap(int(stamps_ns[k]), int(stamps_ns[k + 1])) for k in np.flatnonzero(lost)]
    duration_ns = int(known_ns[-1] - known_ns[0])
    end_ns = limit_ns if regular else max(limit_ns, EARLY_END * duration_ns)
    if known_ns[-1] - stamps_ns[-1] > end_ns and path[-1] - at[-1] > limit_m:
        gaps.append(Gap(int(stamps_ns[-1]), int(known_ns[-1])))
    if stamps_ns[0] - known_ns[0] > LATE_START * duration_ns:
        gaps.insert(0, Gap(int(known_ns[0]), int(stamps_ns[0])))
    # only where there is truth to tell
    return [gap for gap in gaps if gap.end_ns > known_ns[0] and gap.begin_ns < known_ns[-1]]
