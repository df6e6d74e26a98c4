"""A run as it is drawn: positions and errors over time, with gaps and jumps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any, NamedTuple, TypeVar

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.core.config import plain
from vio_eval_ros.core.intervals import longest_tracked
from vio_eval_ros.core.metrics import position_errors, rotation_errors
from vio_eval_ros.core.steps import jump_limit, step_errors
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.figures import extremes, Figure, numbers

MOST_POINTS = 2000
#: a jump is a step from one pair to the next whose error exceeds both this, and this many times
#: the 95th percentile of the errors of all steps
MIN_JUMP_M = 0.05
JUMP_OVER_P95 = 5.0
#: coordinates that exceed the extent of the run by this factor are drawn from an origin near it:
#: graphics cards have single precision
FAR_AWAY = 100.0


class Curve(NamedTuple):
    """Points of a line, NaN where it is interrupted: (N,) and (N, ...)."""

    x: np.ndarray
    y: np.ndarray

    def thinned(self, most_points: int) -> Curve:
        """Return a line of (N,) values with fewer points; it keeps outline and interruptions."""
        known = np.isfinite(self.y)
        x, y = self.x[known], self.y[known]
        chosen = extremes(y, most_points)
        holes = np.flatnonzero(np.diff(np.cumsum(~known)[known][chosen])) + 1
        return _interrupted(x[chosen], y[chosen], holes)


Drawn = TypeVar('Drawn', bound='DrawnPairs')


@dataclass(frozen=True, eq=False, kw_only=True)
class DrawnPairs:
    """
    Pairs as they are drawn: positions and errors over time.

    :param seconds: (N,) since the first ground truth.
    :param end: of the ground truth, on the same clock.
    :param estimate: (N, 3) metres, aligned.
    :param truth: (N, 3) metres.
    :param errors: (N,) of position, metres.
    :param angles: (N,) of rotation, degrees; NaN where unknown.
    :param longest_s: longer intervals without pairs are gaps.
    :param most_points: drawn of each line.
    :param whole: the ground truth including what has no pairs, if it is known.
    """

    seconds: np.ndarray
    end: float
    estimate: np.ndarray
    truth: np.ndarray
    errors: np.ndarray
    angles: np.ndarray
    longest_s: float
    most_points: int = MOST_POINTS
    whole: Trajectory | None = None

    @classmethod
    def of_pairs(
        cls: type[Drawn],
        pairs: Pairs,
        alignment: Alignment,
        span_ns: tuple[int, int],
        max_gap_s: float,
        **more: Any,
    ) -> Drawn:
        """
        Return how pairs are drawn.

        :param span_ns: the first and the last stamp of the ground truth.
        """
        first_ns, last_ns = span_ns
        seconds = (pairs.estimate.stamps_ns - first_ns) / 1e9
        usual = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
        return cls(
            seconds=seconds,
            end=(last_ns - first_ns) / 1e9,
            estimate=alignment.positions(pairs.estimate.positions),
            truth=pairs.ground_truth.positions,
            errors=position_errors(pairs, alignment),
            angles=rotation_errors(pairs, alignment),
            longest_s=longest_tracked(max_gap_s, usual),
            **more,
        )

    @cached_property
    def gaps(self) -> list[tuple[float, float]]:
        """Intervals of the ground truth without pairs: begin and end [s]."""
        bounds = np.concatenate([[min(0.0, self.seconds[0])], self.seconds, [self.end]])
        found = np.flatnonzero(np.diff(bounds) > self.longest_s)
        return [(float(bounds[k]), float(bounds[k + 1])) for k in found]

    @cached_property
    def jumps(self) -> list[tuple[int, float]]:
        """The pairs to which the estimate jumped, and how far [m], the largest first."""
        found = np.flatnonzero(self.steps > self.least_jump)
        sizes = ((int(k) + 1, float(self.steps[k])) for k in found)
        return sorted(sizes, key=lambda jump: -jump[1])

    @cached_property
    def least_jump(self) -> float:
        """The error of a step [m] above which it is a jump."""
        if not len(self.steps):
            return MIN_JUMP_M
        return jump_limit(self.steps, MIN_JUMP_M, JUMP_OVER_P95, 0.95)

    @cached_property
    def steps(self) -> np.ndarray:
        """(N - 1,) metres: the errors of the steps from one pair to the next."""
        return step_errors(self.estimate, self.truth)

    @cached_property
    def hottest(self) -> float:
        """The error with the last colour of the ramp: the 95th percentile [m]."""
        return max(float(np.quantile(self.errors, 0.95)), 1e-9)

    @cached_property
    def labels(self) -> list[str]:
        """The titles of the axes x, y and z."""
        return [
            f'{name} [m]' if not origin else f'{name} - {plain(float(origin))} [m]'
            for name, origin in zip('xyz', self.origin, strict=True)
        ]

    @cached_property
    def origin(self) -> np.ndarray:
        """(3,) metres, the origin of the drawing: 0 unless all positions are far from it."""
        extent = float(np.ptp(self.truth, axis=0).max())
        far = np.abs(self.truth).max() > FAR_AWAY * max(extent, 1.0)
        return np.round(self.truth[0]) if far else np.zeros(3)

    @property
    def axes_from_above(self) -> str:
        """The horizontal axes: x and y, or x and z where the run is flat in y (a camera frame)."""
        extent = np.ptp(self.truth, axis=0)
        return 'xz' if extent[1] < min(extent[0], 0.5 * extent[2]) else 'xy'

    def evenly_spaced(self) -> np.ndarray:
        """Return evenly spaced pairs, the first and last among them."""
        count = min(len(self.seconds), self.most_points)
        return np.unique(np.linspace(0, len(self.seconds) - 1, count).round().astype(int))

    def extremes(self, values: np.ndarray) -> np.ndarray:
        """Return pairs that keep the outline of a curve, the first and last among them."""
        if len(values) <= self.most_points or math.isnan(values.sum()):
            return self.evenly_spaced()
        return np.union1d([0, len(values) - 1], extremes(values, self.most_points))

    def gap_between(self, chosen: np.ndarray) -> np.ndarray:
        """Return whether there is a gap between each chosen pair and the next."""
        passed = np.concatenate([[0], np.cumsum(np.diff(self.seconds) > self.longest_s)])
        return np.diff(passed[chosen]) > 0

    def broken(self, values: np.ndarray, chosen: np.ndarray) -> list[float | None]:
        """Return the chosen values, with None where there is a gap between two of them."""
        holes = np.flatnonzero(self.gap_between(chosen)) + 1
        return numbers(np.insert(values[chosen], holes, math.nan))

    def places(self, positions: np.ndarray, names: str, chosen: np.ndarray) -> Figure:
        """Return chosen positions along some axes as plotly's x, y and z."""
        shown = positions - self.origin
        return {
            axis: self.broken(shown[:, 'xyz'.index(name)], chosen)
            for axis, name in zip('xyz', names, strict=False)
        }

    def over_time(self, values: np.ndarray, chosen: np.ndarray | None = None) -> Curve:
        """
        Return (N,) or (N, D) values of the pairs over time, without a line across gaps.

        :param chosen: which of them; by default those that keep the outline of every column.
        """
        if chosen is None:
            columns = values.reshape(len(values), -1)
            chosen = np.unique(np.concatenate([self.extremes(column) for column in columns.T]))
        holes = np.flatnonzero(self.gap_between(chosen)) + 1
        return _interrupted(self.seconds[chosen], values[chosen], holes)


@dataclass(frozen=True, eq=False, kw_only=True)
class DrawnRun(DrawnPairs):
    """
    A run as it is drawn: positions, attitudes and errors over time.

    :param result: that of the run.
    """

    result: Result

    @classmethod
    def of(cls, result: Result, most_points: int = MOST_POINTS) -> DrawnRun:
        """Return how a result is drawn."""
        truth = result.ground_truth
        return cls.of_pairs(
            result.summary.pairs,
            result.summary.alignment,
            (truth.first_stamp_ns or 0, truth.last_stamp_ns or 0),
            result.config.max_gap_s,
            most_points=most_points,
            whole=result.truth,
            result=result,
        )

    @property
    def truth_over_time(self) -> Curve:
        """Seconds and (N, 3) places of the truth, also where the estimate has none."""
        if self.whole is None or len(self.whole) < 2:
            everything = np.arange(len(self.seconds))
            return self.over_time(self.truth - self.origin, everything)
        first_ns = self.result.ground_truth.first_stamp_ns or 0
        seconds = (self.whole.stamps_ns - first_ns) / 1e9
        steps = np.diff(seconds)
        longest = longest_tracked(self.longest_s, float(np.median(steps)))
        holes = np.flatnonzero(steps > longest) + 1
        return _interrupted(seconds, self.whole.positions - self.origin, holes)

    @cached_property
    def attitudes(self) -> tuple[np.ndarray, np.ndarray] | None:
        """
        (N, 3) roll, pitch and yaw [deg] of truth and aligned estimate; None without orientations.

        Angles do not jump by 360 degrees: those of the truth are unwrapped, those of the estimate
        are the nearest to them.
        """
        pairs, alignment = self.result.summary.pairs, self.result.summary.alignment
        if not pairs.oriented or not np.isfinite(self.angles).any():
            return None
        truth = np.unwrap(_euler_deg(pairs.ground_truth.rotations), period=360.0, axis=0)
        estimate = _euler_deg(alignment.apply(pairs.estimate).rotations)
        return truth, truth + (estimate - truth + 180.0) % 360.0 - 180.0

    @cached_property
    def three_sigma(self) -> np.ndarray | None:
        """(N, 3) metres, of the estimate's own covariance in the world of the truth; or None."""
        deviations = self.result.summary.pairs.deviations
        if deviations is None or not np.isfinite(deviations[:, 0]).any():
            return None
        lower = np.zeros((len(deviations), 3, 3))
        lower[(slice(None), *np.tril_indices(3))] = deviations[:, 0]
        turned = self.result.summary.alignment.linear @ lower
        return np.asarray(3 * np.sqrt((turned**2).sum(axis=2)))


def _interrupted(x: np.ndarray, y: np.ndarray, holes: np.ndarray) -> Curve:
    """Return a line that is interrupted before each of the points ``holes``."""
    return Curve(np.insert(x, holes, math.nan), np.insert(y, holes, math.nan, axis=0))


def _euler_deg(q: np.ndarray | None) -> np.ndarray:
    """Return (N, 3) roll, pitch and yaw [deg] of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    matrices = rotation.to_matrix(np.asarray(q))
    roll = np.arctan2(matrices[:, 2, 1], matrices[:, 2, 2])
    pitch = np.arcsin(np.clip(-matrices[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    return np.degrees(np.stack([roll, pitch, yaw], axis=1))
