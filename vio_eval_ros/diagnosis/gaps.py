"""Where tracking was lost: intervals without poses, and poses missing one by one."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.steps import distances, step_lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.limits import DiagnosisLimits

#: longest interval that still counts as usual, in usual intervals
USUAL_RATIO = 1.5
#: interval above which tracking was lost, in usual intervals
GAP_RATIO = 5.0
#: motion of the truth in a gap of an irregular stream, over that between other poses, at least ...
GAP_PATH_RATIO = 3.0
#: ... and in metres
GAP_PATH_M = 0.5
#: recordings of two sides are stopped at most so far apart
STOPPED_APART_S = 5.0
#: smallest share of usual intervals in a stream that has a rate
USUAL_SHARE = 0.45
#: fewest long intervals by which single poses are missing
FEWEST_LONG_INTERVALS = 5
#: speed in long intervals, over that in the others, below which the body is slower there ...
SPEED_SHARE = 0.75
#: ... if the difference also exceeds this many standard deviations of the speed
CHANCE_DEVIATIONS = 3.0


@dataclass(frozen=True)
class Gap:
    """An interval without estimate, though there is truth; by the clock of the truth."""

    begin_ns: int
    end_ns: int

    @property
    def seconds(self) -> float:
        """How long it is."""
        return (self.end_ns - self.begin_ns) / 1e9


def missing_s(estimate: Trajectory, truth: Interpolator, gaps: list[Gap]) -> float:
    """
    Return for how long poses are missing outside those gaps, one or some at a time.

    A stream that loses poses still has many intervals of its rate. A stream of keyframes has long
    intervals where the camera moves and rotates slowly, since keyframes are chosen by that; where
    poses were lost, the body is as fast in the long intervals as in the others, or faster.
    """
    stamps_ns = estimate.stamps_ns
    inside = truth.inside(stamps_ns)
    between = inside[:-1] & inside[1:]
    between &= ~np.isin(stamps_ns[:-1], [gap.begin_ns for gap in gaps])
    intervals = np.diff(stamps_ns)[between]
    if not len(intervals):
        return 0.0
    usual = float(np.median(intervals[intervals <= USUAL_RATIO * np.quantile(intervals, 0.05)]))
    long = intervals > USUAL_RATIO * usual
    if long.mean() > 1 - USUAL_SHARE or np.count_nonzero(long) < FEWEST_LONG_INTERVALS:
        return 0.0
    poses = truth.at(stamps_ns)
    motions = [step_lengths(poses.positions)]
    rotations = estimate.rotations if poses.rotations is None else poses.rotations
    if rotations is not None:
        motions.append(rotation.angle_between(rotations[1:], rotations[:-1]))
    if any(_is_slower(motion[between], intervals, long) for motion in motions):
        return 0.0
    return float(np.sum(intervals[long] - usual)) / 1e9


def _is_slower(motion: np.ndarray, intervals: np.ndarray, long: np.ndarray) -> bool:
    """Return whether the body is clearly slower in the long intervals than in the others."""
    within, elsewhere = (motion[rows].sum() / intervals[rows].sum() for rows in (long, ~long))
    deviation = float(np.std(motion[long] / intervals[long])) / math.sqrt(len(intervals[long]))
    limit = max((1 - SPEED_SHARE) * elsewhere, CHANCE_DEVIATIONS * deviation)
    return bool(elsewhere - within > limit)


def find_gaps(
    estimate: Trajectory, truth: Trajectory, max_gap_s: float, limits: DiagnosisLimits
) -> list[Gap]:
    """
    Return the intervals in which tracking was lost.

    Keyframes come when the camera has moved on: of an irregular stream an interval counts where
    it is much longer than nearly all others and the truth moved much further in it. At the end of
    the run an interval also has to be more than stopping two recordings one after the other
    leaves. An estimate that begins late has taken its time to initialise, and has lost nothing.
    """
    stamps_ns, known_ns = estimate.stamps_ns, truth.stamps_ns
    intervals = np.diff(stamps_ns)
    usual = float(np.median(intervals))
    path = distances(truth.positions)
    at = np.interp(stamps_ns.astype(float), known_ns.astype(float), path)
    regular = float(np.quantile(intervals, 0.9)) <= USUAL_RATIO * usual
    if not regular:
        usual = float(np.quantile(intervals, 0.98))
    limit_m = max(GAP_PATH_RATIO * float(np.quantile(np.diff(at), 0.95)), GAP_PATH_M)
    limit_ns = max(nanoseconds(max_gap_s), GAP_RATIO * usual)
    lost = (intervals > limit_ns) & (regular | (np.diff(at) > limit_m))
    gaps = [Gap(int(stamps_ns[k]), int(stamps_ns[k + 1])) for k in np.flatnonzero(lost)]
    duration_ns = int(known_ns[-1] - known_ns[0])
    end_ns = limits.early_end_percent / 100 * duration_ns
    end_ns = max(limit_ns, min(end_ns, STOPPED_APART_S * 1e9) if regular else end_ns)
    if known_ns[-1] - stamps_ns[-1] > end_ns and path[-1] - at[-1] > limit_m:
        gaps.append(Gap(int(stamps_ns[-1]), int(known_ns[-1])))
    return _where_there_is_truth(gaps, int(known_ns[0]), int(known_ns[-1]))


def _where_there_is_truth(gaps: list[Gap], first_ns: int, last_ns: int) -> list[Gap]:
    return [
        Gap(max(gap.begin_ns, first_ns), min(gap.end_ns, last_ns))
        for gap in gaps
        if gap.end_ns > first_ns and gap.begin_ns < last_ns
    ]
