"""What figures draw: each system by name, with its look and its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.palette import Look, look
from vio_eval_ros.reports.drawn_run import Curve, DrawnRun
from vio_eval_ros.reports.plots import relative_samples

#: drawn of each curve: more than a column of a paper can show
MOST_POINTS = 2000


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

    def path(self, positions: np.ndarray) -> np.ndarray:
        """Return (N, 3) positions of the pairs as a line without a bridge over gaps."""
        return self.run.over_time(positions - self.run.origin, self.chosen).y

    @cached_property
    def chosen(self) -> np.ndarray:
        """Which pairs a path is drawn of: evenly, and all of its corners."""
        along = [self.run.extremes(column) for column in self.run.estimate.T]
        return np.unique(np.concatenate([self.run.evenly_spaced(), *along]))

    @cached_property
    def outline(self) -> Curve:
        """Seconds and (N, 3) places of the truth, also where the estimate has none."""
        return self.run.truth_over_time

    @property
    def tracked_s(self) -> float:
        """Seconds with pairs."""
        steps = np.diff(self.run.seconds)
        return float(steps[steps <= self.run.longest_s].sum())


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
