"""
The evaluation: from batches of poses to a Summary. Start reading here.

Live node, ``replay`` and ``score`` all drive this one class::

    evaluation = Evaluation(EvaluationConfig(alignment='se3'))
    evaluation.add_ground_truth(poses)      # order and batch size do not matter
    evaluation.add_estimate(poses)
    evaluation.running()                    # at any time, cheap: RMSE so far
    evaluation.flush()                      # no more poses will come
    evaluation.summary()                    # everything, in one pass over the pairs
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vio_eval_ros.core.alignment import Aligner, Alignment, Moments
from vio_eval_ros.core.association import Associator, Tracking
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.metric import MetricValues, Observations
from vio_eval_ros.core.metrics import METRICS
from vio_eval_ros.core.trajectory import PairLog, Pairs, Poses

FEW_PAIRS = 10


@dataclass(frozen=True, eq=False)
class Summary:
    """
    What an evaluation found.

    :param pairs: all associated poses.
    :param association: counts, ratios and stamp differences, by their names in the result.
    :param alignment: takes the estimate into the ground truth's world.
    :param metrics: name to number, NaN where there is no data.
    :param warnings: sentences about what the user should know before trusting a number.
    """

    pairs: Pairs
    association: dict[str, float]
    alignment: Alignment
    metrics: dict[str, float]
    warnings: tuple[str, ...]


class Evaluation:
    """
    Compares an estimate with ground truth, in batches of any size and order.

    :param max_pairs: how many pairs are kept. Where there are more, values that can be kept up to
        date are of all pairs, others of those that are kept, see :class:`PairLog`.
    """

    def __init__(self, config: EvaluationConfig, max_pairs: int | None = None) -> None:
        self.config = config
        self.associator = Associator(config)
        self._max_pairs = max_pairs
        self._begin()

    def _begin(self) -> None:
        """Begin with no pairs."""
        kinds = range(self.associator.kinds)
        self._accounts = [_Account(self.config, self._max_pairs) for _ in kinds]

    @property
    def _account(self) -> _Account:
        """The pairs that count, and what follows from them."""
        return self._accounts[self.associator.chosen]

    @property
    def count(self) -> int:
        """How many pairs there are so far."""
        return self._account.log.count

    def add_estimate(self, poses: Poses) -> None:
        """Add a batch of estimated poses."""
        if self.associator.add_estimate(poses):
            self._begin()

    def add_ground_truth(self, poses: Poses) -> None:
        """Add a batch of true poses."""
        if self.associator.add_ground_truth(poses):
            self._begin()

    def flush(self) -> None:
        """Decide the remaining pairs: the streams have ended."""
        self._append(self.associator.flush())

    def _append(self, decided: Iterable[Pairs]) -> None:
        sides = self.associator.estimate, self.associator.ground_truth
        for account, pairs in zip(self._accounts, decided, strict=True):
            account.log.append(pairs)
            account.log.position_only = (sides[0].position_only, sides[1].position_only)

    def running(self) -> dict[str, float]:
        """
        Return the running values over the pairs so far.

        Each call takes in the pairs since the last one. They equal those of :meth:`summary` to
        1e-9 relative, unless errors of a few poses are a million times as large as the others.
        """
        self._append(self.associator.decide())
        tracking, chosen = self.associator.tracking(), self._account
        values: dict[str, float] = {}
        for account in self._accounts:  # each takes in every pair of its kind
            found = account.running(account.observed(tracking))
            values = found if account is chosen else values
            if self._max_pairs is not None:
                account.log.downsample(self._max_pairs)
        return {'pairs': chosen.log.count} | values

    def aligned(self) -> tuple[Pairs, Alignment]:
        """Return pairs, evenly over the run so far, and the alignment of all."""
        alignment = self.alignment()
        return self._account.log.evenly(), alignment

    def alignment(self) -> Alignment:
        """Take in the pairs that are decided by now; return the alignment of all."""
        self._append(self.associator.decide())
        return self._account.alignment()

    def kept(self) -> Pairs:
        """Return all pairs that are kept, without copying them."""
        return self._account.log.all()

    def since(self, index: int) -> Pairs:
        """Return the pairs from an index of the run on, as far as none is missing."""
        return self._account.log.since(index)

    def window(self, seconds: float) -> dict[str, float]:
        """Return all metrics over the pairs of the last seconds, under the alignment of all."""
        alignment = self.alignment()
        pairs, log = self.since(0), PairLog()
        stamps = pairs.estimate.stamps_ns
        if len(stamps):
            log.append(pairs[np.searchsorted(stamps, stamps[-1] - nanoseconds(seconds)) :])
        # unpaired poses are counted over the whole run only
        observed = Observations(log, Moments.of(log.all()), alignment, Tracking())
        return self._account.final(observed).values

    def summary(self, causal: Mapping[str, float] | None = None) -> Summary:
        """
        Return all metrics over the pairs so far.

        :param causal: the metrics of the estimate as first published, where it was revised since.
        """
        self._append(self.associator.decide())
        account = self._account
        log, pairs = account.log, account.log.evenly()
        moments = account.aligner.update(log) if log.dropped else Moments.of(pairs)
        alignment = account.aligner.solve(log, moments)
        observed = Observations(log, moments, alignment, self.associator.tracking(), causal)
        measured = account.final(observed)
        metrics = measured.values
        if log.dropped:
            metrics = metrics | account.running(observed)
        return Summary(
            pairs=pairs,
            association=self.associator.statistics(),
            alignment=alignment,
            metrics=metrics,
            warnings=(
                *self.associator.warnings(),
                *self._warnings(pairs, alignment),
                *measured.warnings,
            ),
        )

    def _warnings(self, pairs: Pairs, alignment: Alignment) -> Iterator[str]:
        """Yield why the motion or the number of pairs makes numbers unreliable."""
        if len(pairs) and not alignment.is_known:
            yield (
                f'{alignment.undetermined}: nothing determines the {alignment.mode} alignment; '
                'absolute errors are null'
            )
        elif len(pairs) and not alignment.observable:
            yield (
                f'{alignment.undetermined}: the rotation of the {alignment.mode} alignment is not '
                'determined; rotation errors are null'
            )
        weights = pairs.ground_truth.weights
        if weights is not None and weights.any():
            equal = float(weights.sum()) ** 2 / float(weights @ weights)  # Kish (1965)
            if equal < FEW_PAIRS <= len(pairs):
                yield (
                    f'the weights of {len(pairs)} pairs are worth {equal:.1f} equal ones: few '
                    'true poses decide the alignment'
                )
        if len(pairs) < FEW_PAIRS:
            yield f'only {len(pairs)} pair{"s" * (len(pairs) != 1)}: the numbers mean little'
        if self._account.log.dropped:
            yield (
                f'{self.count} pairs, more than max_pairs: rmse, counts, path and ratios are '
                f'over all of them, relative errors and segments over the newest '
                f'{len(self.since(0))}, everything else over {len(pairs)} of the whole run'
            )


class _Account:
    """The pairs of one kind, and all that is kept up to date with them."""

    def __init__(self, config: EvaluationConfig, max_pairs: int | None) -> None:
        # it grows beyond the limit before it is downsampled
        self.log = PairLog(2 * (max_pairs or 0))
        self.aligner = Aligner(config.alignment, nanoseconds(config.align_first_s))
        self._metrics = [metric(config) for metric in METRICS.values()]

    def alignment(self) -> Alignment:
        """Return the alignment of all pairs so far."""
        return self.aligner.solve(self.log, self.aligner.update(self.log))

    def observed(self, tracking: Tracking) -> Observations:
        """Return what running values are computed from."""
        alignment = self.alignment()
        return Observations(self.log, self.aligner.moments, alignment, tracking)

    def running(self, observed: Observations) -> dict[str, float]:
        """Return the running values of all metrics."""
        values: dict[str, float] = {}
        for metric in self._metrics:
            values |= metric.running(observed)
        return values

    def final(self, observed: Observations) -> MetricValues:
        """Return all metrics, in one pass over the pairs."""
        values: dict[str, float] = {}
        warnings: list[str] = []
        for metric in self._metrics:
            measured = metric.final(observed)
            values |= measured.values
            warnings += measured.warnings
        return MetricValues(values, tuple(warnings))


def metric_names(config: EvaluationConfig) -> list[str]:
    """Return the names of all metrics that these options give, whatever the path is."""
    known = tuple(delta for delta in config.rpe_deltas if not delta.endswith('%'))
    return list(Evaluation(replace(config, rpe_deltas=known)).summary().metrics)
