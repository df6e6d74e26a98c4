"""Where a run breaks: poses that are off and return, jumps that stay, and where it diverges."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Pairs
from vio_eval_ros.diagnosis.divergence import diverged_from
from vio_eval_ros.diagnosis.fitting import horizon, robust_similarity
from vio_eval_ros.diagnosis.jumps import (
    excursions,
    orientation_jumps,
    PoseJump,
    position_jumps,
    PositionJump,
)
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.windows import NEIGHBOURS, running_median

#: a displacement counts as motion from this share of a large one on
MOTION_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class Breaks:
    """
    What stands out of the errors of the positions.

    :param outliers_ns: stamps of poses that are off while their neighbours are not.
    :param outlier_m: how far those are off, in the median; in metres of the truth.
    :param truth_is_off: whether it is the truth that is off there.
    :param jumps: in order.
    :param diverged_ns: the stamp from which on the estimate has left; None where it has not.
    :param scale: metres of the truth to one of the estimate.
    """

    outliers_ns: np.ndarray
    outlier_m: float
    truth_is_off: bool
    jumps: tuple[PoseJump, ...]
    diverged_ns: int | None
    scale: float = 1.0

    @classmethod
    def none(cls) -> Breaks:
        """Return that nothing stands out."""
        return cls(np.empty(0, np.int64), math.nan, False, (), None)


@dataclass(frozen=True, eq=False)
class _Aligned:
    """
    Positions of an estimate in the world and the scale of the truth.

    :param positions: (N, 3).
    :param truth: (N, 3).
    :param rotation: (3, 3) that was applied.
    :param scale: that was applied.
    """

    positions: np.ndarray
    truth: np.ndarray
    rotation: np.ndarray
    scale: float

    @property
    def errors(self) -> np.ndarray:
        """The (N, 3) errors, about their median."""
        errors = self.positions - self.truth
        return np.asarray(errors - np.median(errors, axis=0))

    def to_estimate(self, step: np.ndarray) -> tuple[float, float, float]:
        """Return a step in metres of the estimate."""
        x, y, z = (step @ self.rotation) / self.scale
        return float(x), float(y), float(z)

    def is_of_truth(self, row: int) -> bool:
        """Return whether the truth moves further to a sample than the estimate does."""
        estimated, true = (
            np.linalg.norm(side[row] - side[row - 1]) for side in (self.positions, self.truth)
        )
        return bool(true > estimated)


def find_breaks(
    pairs: Pairs, received_ns: np.ndarray, sensor: np.ndarray, limits: DiagnosisLimits
) -> Breaks:
    """
    Return outliers, jumps and divergence of paired poses, whatever their scale and worlds.

    :param received_ns: (N,) the stamps that the estimates came with, by which they are named.
    :param sensor: (4,) rotation of the body in the tracked frame.
    """
    stamps_ns = pairs.estimate.stamps_ns
    if len(pairs) < 4 * NEIGHBOURS:
        return Breaks.none()
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9
    rows = horizon(stamps_ns, max(1.0, 2 * interval_s))
    if len(rows[0]) < 2 * NEIGHBOURS:
        return Breaks.none()
    of_orientation = orientation_jumps(pairs, received_ns, sensor, limits)
    aligned = _align(pairs, received_ns, of_orientation, rows)
    errors = aligned.errors

    off, off_alone, truth_off = (
        lengths(each - running_median(each)) for each in (errors, aligned.positions, aligned.truth)
    )
    outliers = off > max(limits.outlier_m, limits.outlier_ratio * float(np.median(off)))
    kept = np.flatnonzero(~outliers)
    steps = position_jumps(errors[kept], stamps_ns[kept], limits)
    for there, back in excursions(steps, len(pairs)):
        away = kept[there.row + 1 : back.row + 1]
        outliers[away], off[away] = True, float(np.linalg.norm(there.step))
        steps = [step for step in steps if step not in (there, back)]
    rows_of_steps = [int(kept[step.row + 1]) for step in steps]
    jumps = _joined(of_orientation, dict(zip(rows_of_steps, steps, strict=True)), aligned,
                    received_ns)  # fmt: skip
    kept = np.flatnonzero(~outliers)
    first = _diverged(aligned, dict(zip(rows_of_steps, steps, strict=True)), kept, limits)
    return Breaks(
        outliers_ns=received_ns[outliers],
        outlier_m=float(np.median(off[outliers])) if outliers.any() else math.nan,
        truth_is_off=bool(outliers.any() and np.median((truth_off - off_alone)[outliers]) > 0),
        jumps=jumps,
        diverged_ns=None if first is None else int(received_ns[first]),
        scale=aligned.scale,
    )


def _align(
    pairs: Pairs,
    received_ns: np.ndarray,
    of_orientation: dict[int, PoseJump],
    rows: tuple[np.ndarray, np.ndarray],
) -> _Aligned:
    """Return the positions, without jumps of the orientation, as displacements align best."""
    positions = pairs.estimate.positions
    for jump in of_orientation.values():
        positions, _ = jump.undo(received_ns, positions, None)
    truth = pairs.ground_truth.positions
    begin, end = rows
    displacements = truth[end] - truth[begin]
    size = lengths(displacements)  # at rest there is only noise, which has another scale
    moving = size >= MOTION_SHARE * np.quantile(size, 0.95)
    begin, end = begin[moving], end[moving]
    fitted = robust_similarity(
        positions[end] - positions[begin], displacements[moving], scaled=True
    )
    return _Aligned(
        positions=fitted.scale * positions @ fitted.rotation.T,
        truth=truth,
        rotation=fitted.rotation,
        scale=fitted.scale,
    )


def _joined(
    of_orientation: dict[int, PoseJump],
    of_position: dict[int, PositionJump],
    aligned: _Aligned,
    received_ns: np.ndarray,
) -> tuple[PoseJump, ...]:
    """Return the jumps of orientation and of position as one, in order."""
    jumps = dict(of_orientation)
    for row, jump in of_position.items():
        same = jumps.get(row, PoseJump(int(received_ns[row]), (0.0, 0.0, 0.0)))
        jumps[row] = replace(
            same,
            step=aligned.to_estimate(jump.step),
            is_reset=same.is_reset or jump.is_reset,
            of_truth=aligned.is_of_truth(row),
        )
    return tuple(jumps[row] for row in sorted(jumps))


def _diverged(
    aligned: _Aligned, jumps: dict[int, PositionJump], kept: np.ndarray, limits: DiagnosisLimits
) -> int | None:
    """
    Return the sample from which on the estimate has left, without outliers.

    It has left without its jumps, and with them, which may take it back.
    """
    jumping, smooth = aligned.errors, aligned.errors
    for row, jump in jumps.items():
        smooth[row:] -= jump.step
    first, with_jumps = (
        diverged_from(errors[kept], aligned.truth[kept], limits.diverged_m)
        for errors in (smooth, jumping)
    )
    return None if first is None or with_jumps is None else int(kept[first])
