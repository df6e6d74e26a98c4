"""
The evaluation: batches of poses in, a Summary out. Start reading here.

Live node, ``replay`` and ``score`` all drive this one class::

    evaluation = Evaluation(EvaluationConfig(alignment='se3'))
    evaluation.add_ground_truth(poses)      # any order, any batch size: the same pairs
    evaluation.add_estimate(poses)
    evaluation.running()                    # at any moment, cheap: RMSE so far
    evaluation.flush()                      # no more poses will come
    evaluation.summary()                    # everything, in one pass over the pairs
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.alignment import Alignment, Moments, solve
from vio_eval_ros.core.association import AFTER_ALL, Associator, BEFORE_ALL, Side
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.metrics import METRICS, Run
from vio_eval_ros.core.trajectory import Cleaning, PairLog, Pairs, Poses

FEW_PAIRS = 10
SECOND_NS = 10**9
MOST_WAITING = 10


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
    warnings: list[str]


class Evaluation:
    """
    Compares an estimate with ground truth, in batches of any size and order.

    :param max_pairs: how many pairs are kept; with more, only what can be kept up to date is of
        all pairs, and the rest of those that are left, see :class:`PairLog`.
    """

    def __init__(self, config: EvaluationConfig, max_pairs: int | None = None) -> None:
        self.config = config
        self.associator = Associator(config)
        #: the same run as first published, where its estimate was revised since
        self.causal: Evaluation | None = None
        self._log = PairLog(2 * (max_pairs or 0))  # it is a little longer before it is thinned
        self._max_pairs = max_pairs
        self._difference_sum_ns = 0
        self._difference_max_ns = 0
        self._metrics = [metric(config) for metric in METRICS.values()]
        self._align_first_ns = nanoseconds(config.align_first_s)
        self._first: Moments | None = None
        self._moments = Moments.empty()
        self._referenced = 0

    def add_estimate(self, poses: Poses) -> None:
        """Add a batch of estimated poses."""
        self.associator.add_estimate(poses)

    def add_ground_truth(self, poses: Poses) -> None:
        """Add a batch of true poses."""
        self.associator.add_ground_truth(poses)

    def flush(self) -> None:
        """Decide what only more poses could have changed: the streams have ended."""
        self._take(self.associator.flush())

    def running(self) -> dict[str, float]:
        """
        Return the running values over the pairs so far.

        Each call takes in the pairs since the one before. Equal to those of :meth:`summary` to
        1e-9 relative, unless a few poses are off by a million times the others' errors.
        """
        alignment = self.alignment()
        run = Run(self._log, self._moments, alignment, self.associator, [])
        values = {'pairs': self._log.count} | self._running(run)
        if self._max_pairs is not None:
            self._log.thin(self._max_pairs)  # now that every pair was taken in
        return values

    def aligned(self) -> tuple[Pairs, Alignment]:
        """Return the pairs, evenly over the run so far, and the alignment of all."""
        alignment = self.alignment()
        return self._log.evenly(), alignment

    def alignment(self) -> Alignment:
        """Take in what the poses so far decide; return the alignment of all pairs."""
        self._take(self.associator.decide())
        return self._solve(self._running_moments())

    def since(self, index: int) -> Pairs:
        """Return the pairs from this one on, counted over the run, as far as none is missing."""
        return self._log.since(index)

    def window(self, seconds: float) -> dict[str, float]:
        """Return all metrics over the pairs of the last seconds, under the alignment of all."""
        alignment = self.alignment()
        pairs, log = self._log.since(0), PairLog()
        stamps = pairs.estimate.stamps_ns
        if len(stamps):
            log.append(pairs[np.searchsorted(stamps, stamps[-1] - nanoseconds(seconds)) :])
        run = Run(log, Moments.of(log.all()), alignment, self.associator, [])
        metrics: dict[str, float] = {}
        for metric in self._metrics:
            metrics |= metric.final(run)
        # what was not paired is counted for the whole run only
        return metrics | {'coverage_ratio': math.nan, 'matched_ratio': math.nan}

    def summary(self) -> Summary:
        """Return all metrics over the pairs so far."""
        self._take(self.associator.decide())
        pairs, warnings = self._log.evenly(), self._stream_warnings()
        moments = self._running_moments() if self._log.dropped else Moments.of(pairs)
        alignment = self._solve(moments)
        if len(pairs) and not alignment.observable:
            warnings.append(
                f'{alignment.undetermined}: the rotation of the {alignment.mode} alignment is not '
                'determined; rotation errors are null'
            )
        if len(pairs) < FEW_PAIRS:
            warnings.append(f'{_only(len(pairs))}: the numbers mean little')
        if self._log.dropped:
            warnings.append(
                f'{self._log.count} pairs, more than max_pairs: rmse, pairs, path and ratios are '
                f'of all, relative errors and segments of the newest {len(self.since(0))}, all '
                f'else of {len(pairs)}'
            )
        causal = self.causal.summary().metrics if self.causal else None
        run = Run(self._log, moments, alignment, self.associator, warnings, causal)
        metrics: dict[str, float] = {}
        for metric in self._metrics:
            metrics |= metric.final(run)
        if self._log.dropped:
            metrics |= self._running(replace(run, warnings=[]))  # those are there already
        return Summary(pairs, self._association(metrics), alignment, metrics, warnings)

    def no_pairs(self) -> str:
        """Return why there are no pairs, in one line with both time spans."""
        estimate, truth = self.associator.estimate, self.associator.ground_truth
        for name, stream in (('estimate', estimate), ('ground truth', truth)):
            if not stream.used:
                dropped = _listed(stream.counts.dropped)
                return f'no pairs: the {name} has no usable pose' + (
                    f' (dropped: {dropped})' if dropped else ''
                )
        spans = f'estimate spans {_span(estimate)} s, ground truth {_span(truth)} s'
        closest_ns = self.associator.closest_ns
        if self.config.association == 'nearest':
            tolerance = f'within {self.config.max_difference_s:g} s'
            advice = 'is --max-difference-s too small, or --association interpolate meant?'
        else:
            tolerance = f'where ground truth has no gap above {self.config.max_gap_s:g} s'
            advice = 'is --max-gap-s too small?'
        apart = estimate.first_ns > truth.newest_ns or truth.first_ns > estimate.newest_ns
        if closest_ns is None or apart:
            return f'no pairs {tolerance}: {spans}; are the clocks the same?'
        closest = f'the closest stamps are {closest_ns / 1e9:g} s apart'
        return f'no pairs {tolerance}: {spans}; {closest}; {advice}'

    def _take(self, pairs: Pairs) -> None:
        """Add newly decided pairs."""
        if len(pairs):
            difference = np.abs(pairs.estimate.stamps_ns - pairs.ground_truth.stamps_ns)
            self._difference_sum_ns += int(difference.sum())
            self._difference_max_ns = max(self._difference_max_ns, int(difference.max()))
            self._log.append(pairs)

    def _running(self, run: Run) -> dict[str, float]:
        values: dict[str, float] = {}
        for metric in self._metrics:
            values |= metric.running(run)
        return values

    def _running_moments(self) -> Moments:
        """Return the moments of all pairs, about an alignment never older than half of them."""
        log = self._log
        if log.count >= 2 * self._referenced and not log.dropped:
            pairs = log.all()
            reference = solve('sim3', Moments.of(pairs), pairs[:1]).near().linear
            self._moments, self._referenced = Moments.of(pairs, reference), len(pairs)
        else:
            new = Moments.of(log.since(self._moments.count), self._moments.reference)
            self._moments = self._moments.merge(new)
        return self._moments

    def _first_moments(self) -> Moments:
        """Return the moments of the pairs of the first ``align_first_s`` seconds."""
        if self._first is not None:
            return self._first
        pairs = self._log.evenly()
        stamps = pairs.estimate.stamps_ns
        if not len(stamps):
            return Moments.empty()
        end = int(np.searchsorted(stamps, stamps[0] + self._align_first_ns, side='right'))
        moments = Moments.of(pairs[:end])
        if end < len(pairs):
            self._first = moments  # all of them are there
        return moments

    def _solve(self, moments: Moments) -> Alignment:
        fitted = self._first_moments() if self._align_first_ns else moments
        return solve(self.config.alignment, fitted, self._log.all()[:1])

    def _association(self, metrics: dict[str, float]) -> dict[str, float]:
        estimate, truth = self.associator.estimate, self.associator.ground_truth
        count = self._log.count
        one_to_one = self.config.association == 'nearest'
        return {
            'pairs': count,
            'coverage_ratio': metrics['coverage_ratio'],
            'matched_ratio': metrics['matched_ratio'],
            'abs_difference_mean_s': self._difference_sum_ns / count / 1e9 if count else math.nan,
            'abs_difference_max_s': self._difference_max_ns / 1e9 if count else math.nan,
            'unmatched_estimates': estimate.settled - count,
            'unmatched_ground_truth': truth.settled - count if one_to_one else math.nan,
        }

    def _stream_warnings(self) -> list[str]:
        warnings = []
        for name, stream in (
            ('estimate', self.associator.estimate),
            ('ground truth', self.associator.ground_truth),
        ):
            dropped = _listed(stream.counts.dropped)
            if dropped:
                warnings.append(f'{name}: dropped {dropped}')
            if stream.counts.went_backwards:
                warnings.append(
                    f'{name}: {stream.counts.went_backwards} stamps went backwards; sorted'
                )
            if stream.counts.scaled_quaternion:
                warnings.append(
                    f'{name}: {stream.counts.scaled_quaternion} quaternions were far '
                    'from unit length; normalised'
                )
        return warnings


def metric_names(config: EvaluationConfig) -> list[str]:
    """Return the names of all metrics that these options give."""
    return list(Evaluation(config).summary().metrics)


class RunningSeries:
    """
    An evaluation that gives its running values once for every whole second of stamps.

    Poses may come in batches of any size: what belongs to a second is evaluated when both streams
    have passed it. So a live series has the rows that a recording of it has.

    :param max_pairs: how many pairs are kept, see :class:`Evaluation`. Of ten times as many poses
        that wait for the other stream, ground truth being faster, the oldest are given up.
    """

    def __init__(self, config: EvaluationConfig, max_pairs: int | None = None) -> None:
        self.evaluation = Evaluation(config, max_pairs)
        #: of all pairs, once :meth:`rest` has come to its end
        self.summary: Summary | None = None
        self._offset_ns = nanoseconds(config.time_offset_s)
        associator = self.evaluation.associator
        limit = None if max_pairs is None else MOST_WAITING * max_pairs
        self._estimate = _Held(self.evaluation.add_estimate, associator.estimate.counts, limit)
        self._ground_truth = _Held(
            self.evaluation.add_ground_truth, associator.ground_truth.counts, limit
        )

    def add_estimate(self, poses: Poses) -> None:
        """Add a batch of estimated poses."""
        self._estimate.hold(poses, poses.stamps_ns + self._offset_ns)

    def add_ground_truth(self, poses: Poses, waits: bool = True) -> None:
        """
        Add a batch of true poses.

        :param waits: False where they do not wait for the other stream, being all there are.
        """
        self._ground_truth.hold(poses, poses.stamps_ns, waits)

    def rows(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield stamp and running values of every second that both streams have passed."""
        passed_ns = min(self._estimate.newest_ns, self._ground_truth.newest_ns)
        for stamp_ns in self._seconds(passed_ns):
            if stamp_ns < passed_ns:
                self._release(stamp_ns)
                yield stamp_ns, self.evaluation.running()

    def rest(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield the rows that are left at the end of both streams; the last has final values."""
        for stamp_ns in self._seconds(AFTER_ALL)[:-1]:
            self._release(stamp_ns)
            yield stamp_ns, self.evaluation.running()
        newest_ns = max(self._estimate.newest_ns, self._ground_truth.newest_ns)
        self._release(newest_ns)
        self.evaluation.flush()
        self.summary = self.evaluation.summary()
        final = self.summary.association | self.summary.metrics
        yield newest_ns, {name: final[name] for name in self.evaluation.running()}

    def waiting_for(self) -> str:
        """Return which stream is missing or behind, with what has arrived of each."""
        spans = []
        for name, held in (('estimate', self._estimate), ('ground truth', self._ground_truth)):
            if held.newest_ns == BEFORE_ALL:
                spans.append(f'no {name} yet')
            else:
                spans.append(
                    f'{name} spans {held.oldest_ns / 1e9:.1f} to {held.newest_ns / 1e9:.1f} s'
                )
        return ', '.join(spans)

    def _seconds(self, until_ns: int) -> list[int]:
        """Return the whole seconds by which the poses held up to a stamp have arrived."""
        clocks = [*self._estimate.clocks, *self._ground_truth.clocks]
        if not clocks:
            return []
        clock = np.concatenate(clocks)
        seconds = np.unique(-(-clock[clock <= until_ns] // SECOND_NS)) * SECOND_NS
        return [int(second) for second in seconds]

    def _release(self, until_ns: int) -> None:
        """Evaluate the poses up to a stamp."""
        self._estimate.release(until_ns)
        self._ground_truth.release(until_ns)


def running_series(
    config: EvaluationConfig, estimate: Poses, ground_truth: Poses
) -> Iterator[tuple[int, dict[str, float]]]:
    """Yield the rows of a series of two whole streams, as if they had arrived in order."""
    series = RunningSeries(config)
    ordered = [
        poses[np.argsort(poses.stamps_ns, kind='stable')] for poses in (estimate, ground_truth)
    ]
    series.add_estimate(ordered[0])
    series.add_ground_truth(ordered[1])
    yield from series.rest()


class _Held:
    """Poses of a stream that wait for their second to be over."""

    def __init__(self, add: Callable[[Poses], None], counts: Cleaning, limit: int | None) -> None:
        self._counts = counts
        self._limit = limit
        self.oldest_ns = AFTER_ALL
        self.newest_ns = BEFORE_ALL
        self.clocks: list[np.ndarray] = []
        self._poses: list[Poses] = []
        self._released_ns = BEFORE_ALL
        self._add = add

    def hold(self, poses: Poses, clock_ns: np.ndarray, waits: bool = True) -> None:
        """Add poses and the stamps by which they are ordered."""
        if poses.zero_is_unset and not poses.stamps_ns.all():
            stamped = poses.stamps_ns != 0
            self._add(poses[~stamped])  # to be counted, in whatever second
            poses, clock_ns = poses[stamped], clock_ns[stamped]
        if not len(poses):
            return
        # a late one is evaluated with the next second: the series does not go back
        clock_ns = np.maximum(clock_ns, self._released_ns + 1)
        self.oldest_ns = min(self.oldest_ns, int(clock_ns.min()))
        self.newest_ns = max(self.newest_ns, int(clock_ns.max()))
        self.clocks.append(clock_ns)
        self._poses.append(poses)
        if self._limit is not None and waits:
            self._give_up(sum(map(len, self._poses)) - self._limit)

    def _give_up(self, excess: int) -> None:
        """Drop as many of the oldest poses as are too many."""
        while excess > 0:
            dropped = min(excess, len(self._poses[0]))
            self._poses[0] = self._poses[0][dropped:]
            self.clocks[0] = self.clocks[0][dropped:]
            if not len(self._poses[0]):
                del self._poses[0], self.clocks[0]
            self._counts.overflow += dropped
            excess -= dropped

    def release(self, until_ns: int) -> None:
        """Hand on the poses up to a stamp."""
        self._released_ns = until_ns
        if not self._poses:
            return
        poses, clock = self._poses[0], self.clocks[0]
        if len(self._poses) > 1:
            poses, clock = Poses.concatenate(self._poses), np.concatenate(self.clocks)
        # slices of what is in order copy nothing, however much is held
        in_order = bool((np.diff(clock) >= 0).all())
        end = int(np.searchsorted(clock, until_ns, side='right')) if in_order else 0
        over: Any = slice(end) if in_order else clock <= until_ns
        rest: Any = slice(end, None) if in_order else clock > until_ns
        self._add(poses[over])
        self._poses, self.clocks = [poses[rest]], [clock[rest]]


def _only(pairs: int) -> str:
    return f'only {pairs} pair' + 's' * (pairs != 1)


def _listed(dropped: dict[str, int]) -> str:
    return ', '.join(
        f'{count} {reason.replace("_", "-")}' for reason, count in dropped.items() if count
    )


def _span(side: Side) -> str:
    return f'{side.first_ns / 1e9:.1f} to {side.newest_ns / 1e9:.1f}'
