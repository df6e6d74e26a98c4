"""What figures draw: each system by name, with its look and its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.intervals import longest_tracked
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.palette import Look, look
from vio_eval_ros.reports.drawn_run import DrawnRun
from vio_eval_ros.reports.plots import relative_samples

#: drawn of each curve: more than a column of a paper can show
MOST_POINTS = 2000


class Curve(NamedTuple):
    """Points of a line, NaN where it is interrupted: (N,) and (N, ...)."""

    x: np.ndarray
    y: np.ndarray


@dataclass(frozen=True, eq=False)
class System:
    """
    A system as it is drawn.

    :param results: of its runs, at least one; the first is drawn where a figure shows one run.
    """

    name: str
    results: Sequence[Result]
    look: Look

    @cached_property
    def run(self) -> DrawnRun:
        """The first run."""
        return DrawnRun.of(self.results[0], MOST_POINTS)

    @property
    def result(self) -> Result:
        """The result of the first run."""
        return self.results[0]

    @property
    def oriented(self) -> bool:
        """Whether there are errors of orientation."""
        return bool(np.isfinite(self.run.angles).any())

    @cached_property
    def has_relative_errors(self) -> bool:
        """Whether the run is long enough for one of the configured deltas."""
        return bool(relative_samples(self.result))

    def over_time(self, values: np.ndarray) -> Curve:
        """Return (N,) or (N, D) values of the pairs over time, without a line across gaps."""
        columns = values.reshape(len(values), -1)
        chosen = np.unique(np.concatenate([self.run.extremes(column) for column in columns.T]))
        return self._broken(self.run.seconds, values, chosen)

    def path(self, positions: np.ndarray) -> np.ndarray:
        """Return (N, 3) positions of the pairs as a line without a bridge over gaps."""
        return self._broken(self.run.seconds, positions - self.run.origin, self.chosen).y

    @cached_property
    def chosen(self) -> np.ndarray:
        """Which pairs a path is drawn of: evenly, and all of its corners."""
        along = [self.run.extremes(column) for column in self.run.estimate.T]
        return np.unique(np.concatenate([self.run.evenly_spaced(), *along]))

    def _broken(self, x: np.ndarray, y: np.ndarray, chosen: np.ndarray) -> Curve:
        holes = np.flatnonzero(self.run.gap_between(chosen)) + 1
        return Curve(
            np.insert(x[chosen], holes, math.nan),
            np.insert(y[chosen], holes, math.nan, axis=0),
        )

    @cached_property
    def outline(self) -> Curve:
        """Seconds and (N, 3) places of the truth, also where the estimate has none."""
        run, whole = self.run, self.run.whole
        if whole is None or len(whole) < 2:
            return self._broken(run.seconds, run.truth - run.origin, self.chosen)
        seconds = (whole.stamps_ns - (self.result.ground_truth.first_stamp_ns or 0)) / 1e9
        steps = np.diff(seconds)
        longest = longest_tracked(run.longest_s, float(np.median(steps)))
        holes = np.flatnonzero(steps > longest) + 1
        return Curve(
            np.insert(seconds, holes, math.nan),
            np.insert(whole.positions - run.origin, holes, math.nan, axis=0),
        )

    @property
    def tracked_s(self) -> float:
        """Seconds with pairs."""
        steps = np.diff(self.run.seconds)
        return float(steps[steps <= self.run.longest_s].sum())

    @cached_property
    def attitudes(self) -> tuple[np.ndarray, np.ndarray] | None:
        """
        (N, 3) roll, pitch and yaw [deg] of truth and aligned estimate; None without orientations.

        Angles do not jump by 360 degrees: those of the truth are unwrapped, those of the estimate
        are the nearest to them.
        """
        pairs, alignment = self.result.summary.pairs, self.result.summary.alignment
        if not pairs.oriented or not self.oriented:
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


def systems_of(
    runs: Mapping[str, Result | Sequence[Result]], order: Sequence[str] = ()
) -> list[System]:
    """
    Return the systems, each with the look of its place.

    :param runs: a result, or those of several runs, by the name of the system.
    :param order: of all systems, also those without a result; by default that of the mapping.
    :raises ConfigError: there is nothing to draw of one of them.
    """
    listed = {name: [of] if isinstance(of, Result) else list(of) for name, of in runs.items()}
    for name, results in listed.items():
        if any(math.isnan(of.summary.metrics['ate_trans_rmse_m']) for of in results):
            raise ConfigError(
                f'{name}: there is nothing to draw: too few pairs or too little motion to '
                'align; leave this estimate out'
            )
    places = {name: place for place, name in enumerate(order or listed)}
    return [System(name, results, look(places[name])) for name, results in listed.items()]


def _euler_deg(q: np.ndarray | None) -> np.ndarray:
    """Return (N, 3) roll, pitch and yaw [deg] of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    matrices = rotation.to_matrix(np.asarray(q))
    roll = np.arctan2(matrices[:, 2, 1], matrices[:, 2, 2])
    pitch = np.arcsin(np.clip(-matrices[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    return np.degrees(np.stack([roll, pitch, yaw], axis=1))
