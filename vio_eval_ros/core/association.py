"""Association of two streams of poses: every pair is decided once."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.interpolation import between
from vio_eval_ros.core.intervals import Intervals, nanoseconds
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.side import AFTER_ALL, BEFORE_ALL, Side
from vio_eval_ros.core.trajectory import as_slice, Pairs, Poses


def nearest(stamps: np.ndarray, others: np.ndarray) -> np.ndarray:
    """
    Return for each stamp the index of the nearest of ``others``; ties go to the earlier one.

    :param stamps: (N,) sorted.
    :param others: (M,) sorted, M >= 1.
    """
    after = np.searchsorted(others, stamps).clip(max=len(others) - 1)
    before = (after - 1).clip(min=0)
    return np.asarray(
        np.where(np.abs(stamps - others[before]) <= np.abs(others[after] - stamps), before, after)
    )


class Associator:
    """
    Associates two streams; each pair is decided exactly once.

    The *horizon* is the stamp that both streams have reached; poses at or before it that arrive
    later are too late. A pair is decided as soon as no pose after the horizon could separate it.
    Hence neither the order in which the streams arrive nor the size of the batches matters.
    """

    def __init__(self, config: EvaluationConfig) -> None:
        self._gap_ns = nanoseconds(config.max_gap_s)
        self._tolerance_ns = nanoseconds(config.max_difference_s)
        self._start_ns = nanoseconds(config.start_s)
        self._end_ns = None if math.isinf(config.end_s) else nanoseconds(config.end_s)
        self._config = config
        self._horizon_ns = BEFORE_ALL
        self.estimate = Side(Preparation.of_estimate(config), self._gap_ns)
        self.ground_truth = Side(Preparation.of_ground_truth(config), self._gap_ns)
        self.closest_ns: int | None = None
        self._begin()

    def add_estimate(self, poses: Poses) -> bool:
        """
        Add a batch of the estimate, with stamps of its own clock.

        Return whether the pairs so far are void: their poses turned out to be unusable.
        """
        return self._receive(self.estimate, poses)

    def add_ground_truth(self, poses: Poses) -> bool:
        """Add a batch of ground truth, likewise."""
        return self._receive(self.ground_truth, poses)

    def _receive(self, side: Side, poses: Poses) -> bool:
        drops_earlier = side.receive(poses, self._horizon_ns)
        if drops_earlier:
            self._begin()
        return drops_earlier

    def _begin(self) -> None:
        """Begin to count pairs."""
        self._begin_ns: int | None = None
        self._pairs = 0
        self._difference_sum_ns = 0
        self._difference_max_ns = 0
        self._tracked = Intervals(self._gap_ns)

    def decide(self) -> Pairs:
        """Return the pairs that the poses since the last call decide."""
        return self._advance(min(self.estimate.newest_ns, self.ground_truth.newest_ns))

    def flush(self) -> Pairs:
        """Return the remaining pairs; no more poses will come."""
        return self._advance(AFTER_ALL)

    def coverage_ratio(self) -> float:
        """
        Return the share of the ground truth's duration in which the estimate was tracking.

        Intervals between poses count where they are no longer than ``max_gap_s`` or three median
        intervals of the estimate. NaN without ground truth.
        """
        limit_ns = self.estimate.limit.longest_ns()
        duration_ns = self.ground_truth.intervals.total_ns(limit_ns)
        # the estimates of the first and last pair may lie outside the ground truth
        return (
            min(1.0, self._tracked.total_ns(limit_ns) / duration_ns) if duration_ns else math.nan
        )

    def statistics(self) -> dict[str, float]:
        """Return counts, ratios and stamp differences, by their names in a result."""
        count, settled = self._pairs, self.estimate.settled
        unmatched_truth: float = self.ground_truth.settled - count
        if self._config.association != 'nearest':
            unmatched_truth = math.nan  # an interpolated pose has two sources
        return {
            'pairs': count,
            'coverage_ratio': self.coverage_ratio(),
            'matched_ratio': count / settled if settled else math.nan,
            'abs_difference_mean_s': self._difference_sum_ns / count / 1e9 if count else math.nan,
            'abs_difference_max_s': self._difference_max_ns / 1e9 if count else math.nan,
            'unmatched_estimates': settled - count,
            'unmatched_ground_truth': unmatched_truth,
        }

    def warnings(self) -> list[str]:
        """Return what was dropped or repaired, or says nothing, in sentences."""
        sentences: list[str] = []
        for name, side in (('estimate', self.estimate), ('ground truth', self.ground_truth)):
            sentences += side.counts.warnings(name)
            if why := side.why_positions_only():
                sentences.append(
                    f'{name}: {why}: it counts as positions only, figures that need its '
                    'orientation are null'
                )
        return sentences

    def why_no_pairs(self) -> str:
        """Return why there are no pairs, in one line with both time spans."""
        estimate, truth = self.estimate, self.ground_truth
        for name, side in (('estimate', estimate), ('ground truth', truth)):
            if not side.used:
                dropped = side.counts.listed()
                return f'no pairs: the {name} has no usable pose' + (
                    f' (dropped: {dropped})' if dropped else ''
                )
        spans = f'estimate spans {_span(estimate)} s, ground truth {_span(truth)} s'
        if self._config.association == 'nearest':
            tolerance = f'within {self._config.max_difference_s:g} s'
            advice = 'is --max-difference-s too small, or --association interpolate meant?'
        else:
            tolerance = f'where ground truth has no gap above {self._config.max_gap_s:g} s'
            advice = 'is --max-gap-s too small?'
        apart = estimate.first_ns > truth.newest_ns or truth.first_ns > estimate.newest_ns
        if self.closest_ns is None or apart:
            return (
                f'no pairs {tolerance}: {spans}; are the clocks the same? `diagnose` measures the '
                '--time-offset-s between them; wall-clock stamps in a replay need use_sim_time'
            )
        closest = f'the closest stamps are {self.closest_ns / 1e9:g} s apart'
        return f'no pairs {tolerance}: {spans}; {closest}; {advice}'

    def _advance(self, horizon_ns: int) -> Pairs:
        """Return the pairs between the last horizon and this one."""
        if horizon_ns <= self._horizon_ns:
            return Pairs.empty()
        if self._start_ns or self._end_ns is not None:
            if horizon_ns < self.ground_truth.first_ns:
                # an earlier ground truth, from which start_s and end_s count, may still come
                return Pairs.empty()
            if self._begin_ns is None:
                self._begin_ns = self.ground_truth.first_ns
            if self._begin_ns != AFTER_ALL:
                self._crop(self._begin_ns)
        decided = self._nearest if self._config.association == 'nearest' else self._interpolated
        pairs = decided(self._horizon_ns, horizon_ns)
        self._count(pairs)
        for side in (self.estimate, self.ground_truth):
            side.settle(self._horizon_ns, horizon_ns)
            side.forget(self._needed_from(horizon_ns))
        self._horizon_ns = horizon_ns
        return pairs

    def _count(self, pairs: Pairs) -> None:
        """Keep the counts of what was decided up to date."""
        self._tracked.add(pairs.estimate.stamps_ns)
        difference = np.abs(pairs.estimate.stamps_ns - pairs.ground_truth.stamps_ns)
        self._pairs += len(pairs)
        self._difference_sum_ns += int(difference.sum())
        self._difference_max_ns = max(self._difference_max_ns, int(difference.max(initial=0)))

    def _needed_from(self, horizon_ns: int) -> int:
        """Return the stamp from which poses may still affect undecided pairs."""
        if self._config.association == 'nearest':
            # such a pair spans the horizon, and its competitors lie within the same distance of it
            return horizon_ns - 3 * self._tolerance_ns
        stamps = self.ground_truth.waiting.stamps_ns
        passed = int(np.searchsorted(stamps, horizon_ns, side='right'))
        return int(stamps[passed - 1]) if passed else BEFORE_ALL

    def _crop(self, zero_ns: int) -> None:
        """Drop poses outside ``start_s`` to ``end_s``, relative to the first ground truth."""
        begin_ns = zero_ns + self._start_ns if self._start_ns else BEFORE_ALL
        end_ns = AFTER_ALL if self._end_ns is None else zero_ns + self._end_ns
        for side in (self.estimate, self.ground_truth):
            side.crop(begin_ns, end_ns)

    def _nearest(self, after_ns: int, until_ns: int) -> Pairs:
        """Return mutually nearest poses, as far as the new horizon decides them."""
        estimate, truth = self.estimate.waiting, self.ground_truth.waiting
        if not len(estimate) or not len(truth):
            return Pairs.empty()
        partner = nearest(estimate.stamps_ns, truth.stamps_ns)
        difference = np.abs(estimate.stamps_ns - truth.stamps_ns[partner])
        self._note_closest(difference)
        # up to this stamp, a pose could arrive that is nearer to one of the two
        open_ns = np.maximum(estimate.stamps_ns, truth.stamps_ns[partner]) + difference
        chosen = np.flatnonzero(
            (difference <= self._tolerance_ns) & (open_ns > after_ns) & (open_ns <= until_ns)
        )
        candidates = partner[chosen]
        mutual = nearest(truth.stamps_ns[candidates], estimate.stamps_ns) == chosen
        return Pairs.of(estimate[as_slice(chosen[mutual])], truth[as_slice(candidates[mutual])])

    def _interpolated(self, after_ns: int, until_ns: int) -> Pairs:
        """Return estimates with interpolated truth, as far as the new horizon decides them."""
        estimate, truth = self.estimate.waiting, self.ground_truth.waiting
        if not len(estimate) or not len(truth):
            return Pairs.empty()
        truth = replace(truth, covariances=None)  # pairs have none of the truth
        stamps = truth.stamps_ns
        self._note_closest(
            np.abs(estimate.stamps_ns - stamps[nearest(estimate.stamps_ns, stamps)])
        )
        after = np.searchsorted(stamps, estimate.stamps_ns)
        inside = after < len(stamps)
        # up to this stamp, a pose could arrive that is nearer to the estimate's
        open_ns = stamps[after[inside]]
        inside[inside] = (open_ns > after_ns) & (open_ns <= until_ns)
        estimate, after = estimate[inside], after[inside]
        exact = stamps[after] == estimate.stamps_ns
        before = np.where(exact, after, after - 1)
        usable = (before >= 0) & (stamps[after] - stamps[before] <= self._gap_ns)
        estimate, begin, end = estimate[usable], truth[before[usable]], truth[after[usable]]
        return Pairs.of(estimate, between(begin, end, estimate.stamps_ns, weighted=True))

    def _note_closest(self, differences: np.ndarray) -> None:
        """Remember the smallest difference, which is reported where there are no pairs."""
        closest = int(differences.min())
        if self.closest_ns is None or closest < self.closest_ns:
            self.closest_ns = closest


def _span(side: Side) -> str:
    return f'{side.first_ns / 1e9:.1f} to {side.newest_ns / 1e9:.1f}'
