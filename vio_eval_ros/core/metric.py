"""What a family of metrics is, and what it is computed from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vio_eval_ros.core.alignment import Alignment, Moments
from vio_eval_ros.core.association import Tracking
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.statistics import statistics
from vio_eval_ros.core.trajectory import PairLog, Pairs


@dataclass(frozen=True, eq=False)
class Observations:
    """
    What metrics are computed from.

    :param log: all pairs so far.
    :param moments: of their positions.
    :param alignment: the chosen one.
    :param tracking: how much of the run was evaluated at all.
    :param causal: the metrics of the estimate as first published, where it was revised since.
    """

    log: PairLog
    moments: Moments
    alignment: Alignment
    tracking: Tracking
    causal: Mapping[str, float] | None = None

    @property
    def pairs(self) -> Pairs:
        """All pairs that are kept; where that is not all, the newest are denser."""
        return self.log.all()

    @cached_property
    def sample(self) -> Pairs:
        """All pairs; where they are too many to be kept, some, evenly over the run."""
        return self.log.evenly()


@dataclass(frozen=True)
class MetricValues:
    """
    What a family of metrics found.

    :param values: metrics by their names, NaN where there is no data.
    :param warnings: sentences about what the user should know before trusting them.
    """

    values: dict[str, float]
    warnings: tuple[str, ...] = ()


class Metric:
    """A family of metrics; a subclass may also keep running values up to date."""

    def __init__(self, config: EvaluationConfig) -> None:
        self.config = config

    def final(self, observed: Observations) -> MetricValues:
        """Return the metrics over all pairs, in one pass."""
        raise NotImplementedError

    def running(self, observed: Observations) -> dict[str, float]:
        """Return those metrics that can be kept up to date as pairs arrive."""
        return {}


def named(prefix: str, unit: str, errors: np.ndarray) -> dict[str, float]:
    """Return the statistics of (N,) errors under their full names."""
    return {f'{prefix}_{name}_{unit}': value for name, value in statistics(errors).items()}
