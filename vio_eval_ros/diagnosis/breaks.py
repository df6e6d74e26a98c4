"""Where a run breaks: poses that are off and return, jumps that stay, intervals that are lost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.steps import distances, jump_limit, step_lengths
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.diagnosis.fitting import horizon, robust_similarity

REACH = 5
# of a large displacement, what is taken for one
MOVES = 0.2
# A VIO corrects itself by centimetres from frame to frame; what is named is clearly more.
OUTLIER_M, OUTLIER_TIMES = 0.2, 15.0
JUMP_M, JUMP_TIMES, JUMP_OVER_NEIGHBOURS = 0.12, 10.0, 3.0
JUMP_RAD = math.radians(3.0)
# no estimator takes back so much from one frame to the next
CLEAR_M, CLEAR_RAD = 0.3, math.radians(10.0)
# how nearly a later jump takes back another, and within which share of the run
RETURNS, EXCURSION = 0.25, 0.1
DIVERGED_EXTENTS, DIVERGED_M = 1.0, 1.0
# the last shares of a run that are compared with the drift over as long elsewhere in it
LAST, DIVERGED_TIMES = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4), 5.0
GAP_INTERVALS = 5.0
REGULAR = 1.5
# of a stream with a rate, so many intervals are the shortest; and as fast does the body move in
# its long intervals, at least, or as chance has it, where it is not by its motion that poses are
# chosen
HAS_RATE, AS_FAST, CHANCE, FEWEST_HOLES = 0.45, 0.75, 3.0, 5
GAP_PATH_TIMES, GAP_PATH_M = 3.0, 0.5
LATE_START, EARLY_END = 0.25, 0.1


@dataclass(frozen=True)
class Jump:
    """
    A pose from which on all are turned about its position and displaced.

    :param step: metres in the estimate's world.
    :param turn: quaternion x y z w, likewise.
    :param clear: whether it is so large against what is around that healthy runs have no such.
    :param of_truth: whether it is the truth that steps.
    """

    stamp_ns: int
    step: tuple[float, float, float]
    turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    clear: bool = False
    of_truth: bool = False

    @property
    def size_m(self) -> float:
        """The length of the step."""
        return math.hypot(*self.step)

    @property
    def turn_rad(self) -> float:
        """The angle of the turn."""
        return float(rotation.angle(np.array(self.turn)))

    def undo(
        self, stamps_ns: np.ndarray, positions: np.ndarray, rotations: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return positions and rotations of poses as if it had not been."""
        first = int(np.searchsorted(stamps_ns, self.stamp_ns))
        before, after = positions[:first], positions[first:]
        if self.turn_rad:
            back = rotation.conjugate(np.array(self.turn))
            after = rotation.rotate(back, after - after[:1]) + after[:1]
            if rotations is not None:
                turned = rotation.multiply(back, rotations[first:])
                rotations = np.concatenate([rotations[:first], turned])
        return np.concatenate([before, after - np.array(self.step)]), rotations


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
    :param truth_is_off: whether it is the truth that is off there.
    :param jumps: in order.
    :param diverged_ns: from which stamp on the estimate has flown away; None where it has not.
    :param scale: metres of the truth to one of the estimate.
    """

    outliers_ns: np.ndarray
    outlier_m: float
    truth_is_off: bool
    jumps: tuple[Jump, ...]
    diverged_ns: int | None
    scale: float = 1.0


def find_breaks(pairs: Pairs, received_ns: np.ndarray, sensor: np.ndarray) -> Breaks:
    """
    Return the outliers and jumps of paired poses, whatever their scale and worlds.

    :param received_ns: (N,) the stamps that the estimates came with, by which they are named.
    :param sensor: (4,) rotation of the body in the tracked frame.
    """
    stamps_ns = pairs.estimate.stamps_ns
    nothing = Breaks(np.empty(0, np.int64), math.nan, False, (), None)
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9 if len(pairs) > 1 else math.nan
    if len(pairs) < 4 * REACH:
        return nothing
    begin, end = horizon(stamps_ns, max(1.0, 2 * interval_s))
    if len(begin) < 2 * REACH:
        return nothing
    turns = _turns(pairs, received_ns, sensor)
    positions = pairs.estimate.positions
    for jump in turns.values():
        positions, _ = jump.undo(received_ns, positions, None)
    truth = pairs.ground_truth.positions
    moved = truth[end] - truth[begin]
    size = lengths(moved)  # at rest there is only noise, which has another scale
    moves = size >= MOVES * np.quantile(size, 0.95)
    begin, end, moved = begin[moves], end[moves], moved[moves]
    turn, scale, _ = robust_similarity(positions[end] - positions[begin], moved, True)
    aligned = scale * positions @ turn.T
    errors = aligned - truth
    errors -= np.median(errors, axis=0)

    off, off_alone, truth_off = (
        lengths(each - _running_median(each)) for each in (errors, aligned, truth)
    )
    outliers = off > max(OUTLIER_M, OUTLIER_TIMES * float(np.median(off)))
    kept = np.flatnonzero(~outliers)
    steps = _jumps(errors[kept], stamps_ns[kept])
    for there, back in _excursions(steps, len(pairs)):
        away = kept[there.row + 1 : back.row + 1]
        outliers[away], off[away] = True, float(np.linalg.norm(there.step))
        steps = [step for step in steps if step not in (there, back)]
    jumps, stepping = dict(turns), errors.copy()
    for step in steps:
        first = int(kept[step.row + 1])
        errors[first:] -= step.step
        x, y, z = (step.step @ turn) / scale
        also = jumps.get(first, Jump(int(received_ns[first]), (0.0, 0.0, 0.0)))
        moved = float(x), float(y), float(z)
        went, truly = (np.linalg.norm(each[first] - each[first - 1]) for each in (aligned, truth))
        jumps[first] = replace(
            also, step=moved, clear=also.clear or step.clear, of_truth=bool(truly > went)
        )
    kept = np.flatnonzero(~outliers)
    # what is gone without its steps, and with them, which may take it back
    gone = [_diverged(each[kept], truth[kept]) for each in (errors, stepping)]
    return Breaks(
        received_ns[outliers],
        float(np.median(off[outliers])) if outliers.any() else math.nan,
        bool(outliers.any() and np.median((truth_off - off_alone)[outliers]) > 0),
        tuple(jumps[first] for first in sorted(jumps)),
        None if gone[0] is None or gone[1] is None else int(received_ns[kept[gone[0]]]),
        scale,
    )


def _turns(pairs: Pairs, received_ns: np.ndarray, sensor: np.ndarray) -> dict[int, Jump]:
    """Return the jumps of the orientations by their samples, as turns of the estimate's world."""
    if pairs.rotations is None:
        return {}
    assert pairs.estimate.rotations is not None
    assert pairs.ground_truth.rotations is not None
    body = rotation.multiply(pairs.estimate.rotations, sensor)
    worlds = rotation.multiply(pairs.ground_truth.rotations, rotation.conjugate(body))
    steps = rotation.to_rotation_vector(
        rotation.multiply(worlds[1:], rotation.conjugate(worlds[:-1]))
    )
    intervals = np.diff(pairs.estimate.stamps_ns)
    size = lengths(steps) / np.sqrt(np.maximum(intervals / np.median(intervals), 1))
    found = {}
    far = size > jump_limit(size, JUMP_RAD, JUMP_TIMES, 0.9)
    for k in np.flatnonzero(_inner(far)).tolist():
        back = rotation.conjugate(worlds[k])
        before, after = (
            np.median(rotation.to_rotation_vector(rotation.multiply(side, back)), axis=0)
            for side in (worlds[k - REACH + 1 : k + 1], worlds[k + 1 : k + 1 + REACH])
        )
        lasting = after - before
        if lasting @ steps[k] > 0.5 * size[k] ** 2:
            turn = rotation.from_rotation_vector(-rotation.rotate(back, lasting))
            worlds[k + 1 :] = rotation.multiply(worlds[k + 1 :], turn)
            x, y, z, w = turn.tolist()
            clear = bool(size[k] > CLEAR_RAD)
            found[k + 1] = Jump(int(received_ns[k + 1]), (0.0, 0.0, 0.0), (x, y, z, w), clear)
    return found


def _inner(far: np.ndarray) -> np.ndarray:
    """Return which steps are far that have enough poses on either side to tell if they stay."""
    far[: REACH - 1] = far[len(far) - REACH + 1 :] = False
    return far


def _running_median(errors: np.ndarray) -> np.ndarray:
    """Return (N, 3) medians of each sample and REACH on either side, the ends repeated."""
    padded = np.pad(errors, ((REACH, REACH), (0, 0)), 'edge')
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * REACH + 1, axis=0)
    return np.asarray(np.median(windows, axis=-1))


class _Step(NamedTuple):
    """Behind a sample the error steps aside for good."""

    row: int
    step: np.ndarray
    clear: bool


def _jumps(errors: np.ndarray, stamps_ns: np.ndarray) -> list[_Step]:
    """Return where the error steps aside for good, and by how much."""
    steps = np.diff(errors, axis=0)
    intervals = np.diff(stamps_ns)
    size = lengths(steps)
    # the error of a random walk grows with the square root of the time
    size = size / np.sqrt(np.maximum(intervals / np.median(intervals), 1))
    limit = jump_limit(size, JUMP_M, JUMP_TIMES, 0.9)
    found = []
    for k in np.flatnonzero(_inner(size > min(limit, CLEAR_M))).tolist():
        before, after = slice(k - REACH + 1, k + 1), slice(k + 1, k + 1 + REACH)
        around = np.concatenate([size[max(k - REACH, 0) : k], size[k + 1 : k + 1 + REACH]])
        lasting = np.median(errors[after], axis=0) - np.median(errors[before], axis=0)
        usual = float(np.median(around))
        clear = bool(size[k] > max(CLEAR_M, JUMP_TIMES * usual))
        if (
            (clear or size[k] > max(limit, JUMP_OVER_NEIGHBOURS * usual))
            and lasting @ steps[k] > 0.5 * size[k] ** 2
        ):  # fmt: skip
            step = steps[k] - np.median(steps[_around(k, len(steps))], axis=0)
            found.append(_Step(k, step, clear))
    return found


def _excursions(steps: list[_Step], count: int) -> list[tuple[_Step, _Step]]:
    """Return the neighbouring pairs of steps of which the second takes back the first."""
    found: list[tuple[_Step, _Step]] = []
    for there, back in pairwise(steps):
        left = float(np.linalg.norm(there.step + back.step))
        if (
            left < RETURNS * float(np.linalg.norm(there.step))
            and back.row - there.row <= EXCURSION * count
            and not (found and found[-1][1] is there)
        ):
            found.append((there, back))
    return found


def _around(k: int, count: int) -> np.ndarray:
    near = np.arange(max(k - REACH, 0), min(k + REACH + 1, count))
    return np.asarray(near[near != k])


def _diverged(errors: np.ndarray, truth: np.ndarray) -> int | None:
    """Return from which sample on the estimate has flown away, if it never comes back."""
    firsts = [first for first in (_gone(errors, truth), _flying(errors)) if first is not None]
    return min(firsts, default=None)


def _gone(errors: np.ndarray, truth: np.ndarray) -> int | None:
    """Return from which sample on the error is larger than the truth's extent."""
    extent = float(lengths(truth - truth.mean(axis=0)).max())
    far = lengths(errors - np.median(errors[: max(len(errors) // 3, 1)], axis=0)) > max(
        DIVERGED_EXTENTS * extent, DIVERGED_M
    )
    if not far[-1] or far.all():
        return None
    first = int(np.flatnonzero(~far)[-1]) + 1
    return first if len(far) - first >= REACH else None


def _flying(errors: np.ndarray) -> int | None:
    """Return from which sample on the error changes as it never did over as long before."""
    best, found = DIVERGED_TIMES, None
    for share in LAST:
        count = int(share * len(errors))
        if count < 2 * REACH:
            continue
        changes = lengths(errors[count:] - errors[:-count])
        usual = float(changes[: len(errors) - 2 * count].max())
        # from where it was all the time before: else it has come back
        away = float(lengths(errors[:-count] - errors[-1]).min())
        if min(changes[-1], away) > max(best * usual, DIVERGED_M):
            best = float(changes[-1]) / usual
            near = lengths(errors[-count:] - errors[-count - 1]) <= usual
            found = len(errors) - count + int(np.flatnonzero(near)[-1] + 1 if near.any() else 0)
    return found


def missing_s(estimate: Trajectory, truth: Interpolator, gaps: list[Gap]) -> float:
    """
    Return for how long poses are missing between those gaps, one or some at a time.

    A stream has a rate that it falls short of where many of its intervals are the shortest.
    Keyframes are chosen by how far the camera has moved or turned, so that it does so slowly in
    their long intervals; whether a pose is lost does not depend on that, or it moves faster then.
    """
    stamps_ns = estimate.stamps_ns
    inside = truth.inside(stamps_ns)
    between = inside[:-1] & inside[1:]
    between &= ~np.isin(stamps_ns[:-1], [gap.begin_ns for gap in gaps])
    intervals = np.diff(stamps_ns)[between]
    if not len(intervals):
        return 0.0
    usual = float(np.median(intervals[intervals <= REGULAR * np.quantile(intervals, 0.05)]))
    hole = intervals > REGULAR * usual
    if hole.mean() > 1 - HAS_RATE or np.count_nonzero(hole) < FEWEST_HOLES:
        return 0.0
    poses = truth.at(stamps_ns)
    moved = [step_lengths(poses.positions)]
    if poses.rotations is not None:
        moved.append(rotation.angle_between(poses.rotations[1:], poses.rotations[:-1]))
    for way in moved:
        way = way[between]
        within, elsewhere = (way[rows].sum() / intervals[rows].sum() for rows in (hole, ~hole))
        by_chance = float(np.std(way[hole] / intervals[hole])) / math.sqrt(len(intervals[hole]))
        if elsewhere - within > max((1 - AS_FAST) * elsewhere, CHANCE * by_chance):
            return 0.0
    return float(np.sum(intervals[hole] - usual)) / 1e9


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
    path = distances(truth.positions)
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
    first_ns, last_ns = int(known_ns[0]), int(known_ns[-1])
    return [
        Gap(max(gap.begin_ns, first_ns), min(gap.end_ns, last_ns))
        for gap in gaps
        if gap.end_ns > first_ns and gap.begin_ns < last_ns
    ]
