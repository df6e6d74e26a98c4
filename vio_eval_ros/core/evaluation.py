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
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.alignment import Alignment, Moments, solve
from vio_eval_ros.core.association import AFTER_ALL, Associator, BEFORE_ALL, nanoseconds, Stream
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.metrics import METRICS, Run
from vio_eval_ros.core.trajectory import PairLog, Pairs, Poses

FEW_PAIRS = 10
SECOND_NS = 10**9


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
    """Compares an estimate with ground truth, in batches of any size and order."""

    def __init__(self, config: EvaluationConfig) -> None:
        self.config = config
        self.associator = Associator(config)
        self._log = PairLog()
        self._metrics = [metric(config) for metric in METRICS.values()]
        self._align_first_ns = nanoseconds(config.align_first_s)
        self._moments = Moments.empty()
        self._referenced = 0

    def add_estimate(self, poses: Poses, zero_stamps: bool = True) -> None:
        """Add a batch of estimated poses; ``zero_stamps`` False drops those stamped 0."""
        self.associator.add_estimate(poses, zero_stamps)

    def add_ground_truth(self, poses: Poses, zero_stamps: bool = True) -> None:
        """Add a batch of true poses; ``zero_stamps`` False drops those stamped 0."""
        self.associator.add_ground_truth(poses, zero_stamps)

    def flush(self) -> None:
        """Decide what only more poses could have changed: the streams have ended."""
        self._log.append(self.associator.flush())

    def running(self) -> dict[str, float]:
        """
        Return the running values over the pairs so far.

        Each call takes in the pairs since the one before. Equal to those of :meth:`summary` to
        1e-9 relative, unless a few poses are off by a million times the others' errors.
        """
        pairs, alignment = self.aligned()
        run = Run(pairs, self._moments, alignment, self.associator, [])
        values: dict[str, float] = {'pairs': len(pairs)}
        for metric in self._metrics:
            values |= metric.running(run)
        return values

    def aligned(self) -> tuple[Pairs, Alignment]:
        """Return the pairs so far, and their alignment."""
        pairs = self._decided()
        moments = self._running_moments(pairs)
        fitted = Moments.of(self._to_align(pairs)) if self._align_first_ns else moments
        return pairs, self._solve(fitted, pairs)

    def window(self, seconds: float) -> dict[str, float]:
        """Return all metrics over the pairs of the last seconds, under the alignment of all."""
        pairs, alignment = self.aligned()
        stamps = pairs.estimate.stamps_ns
        if len(stamps):
            pairs = pairs[np.searchsorted(stamps, stamps[-1] - nanoseconds(seconds)) :]
        run = Run(pairs, Moments.of(pairs), alignment, self.associator, [])
        metrics: dict[str, float] = {}
        for metric in self._metrics:
            metrics |= metric.final(run)
        # what was not paired is counted for the whole run only
        return metrics | {'coverage_ratio': math.nan, 'matched_ratio': math.nan}

    def summary(self) -> Summary:
        """Return all metrics over the pairs so far."""
        pairs = self._decided()
        warnings = self._stream_warnings()
        moments = Moments.of(pairs)
        fitted = Moments.of(self._to_align(pairs)) if self._align_first_ns else moments
        alignment = self._solve(fitted, pairs)
        if len(pairs) and not alignment.observable:
            warnings.append(
                f'{alignment.undetermined}: the rotation of the {alignment.mode} alignment is not '
                'determined; rotation errors are null'
            )
        if len(pairs) < FEW_PAIRS:
            warnings.append(f'{_only(len(pairs))}: the numbers mean little')
        run = Run(pairs, moments, alignment, self.associator, warnings)
        metrics: dict[str, float] = {}
        for metric in self._metrics:
            metrics |= metric.final(run)
        return Summary(pairs, self._association(pairs, metrics), alignment, metrics, warnings)

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

    def _decided(self) -> Pairs:
        """Return all pairs that the poses so far decide."""
        self._log.append(self.associator.decide())
        return self._log.all()

    def _running_moments(self, pairs: Pairs) -> Moments:
        """Return the moments of all pairs, about an alignment never older than half of them."""
        if len(pairs) >= 2 * self._referenced:
            reference = solve('sim3', Moments.of(pairs), pairs[:1]).near().linear
            self._moments, self._referenced = Moments.of(pairs, reference), len(pairs)
        else:
            new = Moments.of(pairs[self._moments.count :], self._moments.reference)
            self._moments = self._moments.merge(new)
        return self._moments

    def _to_align(self, pairs: Pairs) -> Pairs:
        """Return the pairs of the first ``align_first_s`` seconds."""
        stamps = pairs.estimate.stamps_ns
        if not len(stamps):
            return pairs
        return pairs[: np.searchsorted(stamps, stamps[0] + self._align_first_ns, side='right')]

    def _solve(self, fitted: Moments, pairs: Pairs) -> Alignment:
        return solve(self.config.alignment, fitted, pairs[:1])

    def _association(self, pairs: Pairs, metrics: dict[str, float]) -> dict[str, float]:
        estimate, truth = self.associator.estimate, self.associator.ground_truth
        difference = np.abs(pairs.estimate.stamps_ns - pairs.ground_truth.stamps_ns) / 1e9
        one_to_one = self.config.association == 'nearest'
        return {
            'pairs': len(pairs),
            'coverage_ratio': metrics['coverage_ratio'],
            'matched_ratio': metrics['matched_ratio'],
            'abs_difference_mean_s': float(difference.mean()) if len(pairs) else math.nan,
            'abs_difference_max_s': float(difference.max()) if len(pairs) else math.nan,
            'unmatched_estimates': estimate.settled - len(pairs),
            'unmatched_ground_truth': truth.settled - len(pairs) if one_to_one else math.nan,
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
    """

    def __init__(self, config: EvaluationConfig) -> None:
        self.evaluation = Evaluation(config)
        self._offset_ns = nanoseconds(config.time_offset_s)
        self._estimate = _Held(self.evaluation.add_estimate)
        self._ground_truth = _Held(self.evaluation.add_ground_truth)

    def add_estimate(self, poses: Poses, zero_stamps: bool = True) -> None:
        """Add a batch of estimated poses; ``zero_stamps`` False drops those stamped 0."""
        self._estimate.hold(poses, poses.stamps_ns + self._offset_ns, zero_stamps)

    def add_ground_truth(self, poses: Poses, zero_stamps: bool = True) -> None:
        """Add a batch of true poses; ``zero_stamps`` False drops those stamped 0."""
        self._ground_truth.hold(poses, poses.stamps_ns, zero_stamps)

    def rows(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield stamp and running values of every second that both streams have passed."""
        passed_ns = min(self._estimate.newest_ns, self._ground_truth.newest_ns)
        for stamp_ns in self._seconds():
            if stamp_ns < passed_ns:
                self._release(stamp_ns)
                yield stamp_ns, self.evaluation.running()

    def rest(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield the rows that are left at the end of both streams; the last has final values."""
        for stamp_ns in self._seconds()[:-1]:
            self._release(stamp_ns)
            yield stamp_ns, self.evaluation.running()
        newest_ns = max(self._estimate.newest_ns, self._ground_truth.newest_ns)
        self._release(newest_ns)
        self.evaluation.flush()
        summary = self.evaluation.summary()
        final = {'pairs': len(summary.pairs)} | summary.metrics
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

    def _seconds(self) -> list[int]:
        """Return the whole seconds by which the poses held have arrived."""
        clocks = [*self._estimate.clocks, *self._ground_truth.clocks]
        if not clocks:
            return []
        seconds = np.unique(-(-np.concatenate(clocks) // SECOND_NS)) * SECOND_NS
        return [int(second) for second in seconds]

    def _release(self, until_ns: int) -> None:
        """Evaluate the poses up to a stamp."""
        self._estimate.release(until_ns)
        self._ground_truth.release(until_ns)


def running_series(
    config: EvaluationConfig,
    estimate: Poses,
    ground_truth: Poses,
    zero_stamps: tuple[bool, bool] = (True, True),
) -> Iterator[tuple[int, dict[str, float]]]:
    """Yield the rows of a series of two whole streams, as if they had arrived in order."""
    series = RunningSeries(config)
    ordered = [
        poses[np.argsort(poses.stamps_ns, kind='stable')] for poses in (estimate, ground_truth)
    ]
    series.add_estimate(ordered[0], zero_stamps[0])
    series.add_ground_truth(ordered[1], zero_stamps[1])
    yield from series.rest()


class _Held:
    """Poses of a stream that wait for their second to be over."""

    def __init__(self, add: Callable[[Poses, bool], None]) -> None:
        self.oldest_ns = AFTER_ALL
        self.newest_ns = BEFORE_ALL
        self.clocks: list[np.ndarray] = []
        self._poses: list[Poses] = []
        self._zero_stamps = True
        self._add = add

    def hold(self, poses: Poses, clock_ns: np.ndarray, zero_stamps: bool) -> None:
        """Add poses and the stamps by which they are ordered."""
        if not len(poses):
            return
        self.oldest_ns = min(self.oldest_ns, int(clock_ns.min()))
        self.newest_ns = max(self.newest_ns, int(clock_ns.max()))
        self.clocks.append(clock_ns)
        self._poses.append(poses)
        self._zero_stamps = zero_stamps

    def release(self, until_ns: int) -> None:
        """Hand on the poses up to a stamp."""
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
        self._add(poses[over], self._zero_stamps)
        self._poses, self.clocks = [poses[rest]], [clock[rest]]


def _only(pairs: int) -> str:
    return f'only {pairs} pair' + 's' * (pairs != 1)


def _listed(dropped: dict[str, int]) -> str:
    return ', '.join(
        f'{count} {reason.replace("_", "-")}' for reason, count in dropped.items() if count
    )


def _span(stream: Stream) -> str:
    return f'{stream.first_ns / 1e9:.1f} to {stream.newest_ns / 1e9:.1f}'
