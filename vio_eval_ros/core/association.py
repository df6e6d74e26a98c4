"""Association of two streams of poses: every pair is decided once."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.matching import (
    EstimateInterpolated,
    Matching,
    Nearest,
    nearest,
    TruthInterpolated,
)
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.side import AFTER_ALL, BEFORE_ALL, Side
from vio_eval_ros.core.trajectory import Pairs, Poses

#: how many times as long as that of the other its median interval is, where a side is sparser
SPARSER_RATIO = 1.1
#: share of the poses of a sparse truth with a partner, below which interpolation is advised
FEW_PARTNERS_RATIO = 0.9


@dataclass(frozen=True)
class Tracking:
    """
    How much of a run was evaluated at all.

    :param coverage_ratio: share of the ground truth in which the estimate was tracking.
    :param tracked_ratio: the same from the first pair on.
    :param initialisation_s: from the first true pose to the first pair.
    :param matched_ratio: pairs over the poses of the side that is not interpolated.
    :param truth_period_s: the median interval of a truth so sparse that it has long intervals
        only; NaN of any other.
    :param hole_s: the interval above which ground truth has a hole.
    :param hole_ratio: share of the time since the first pair that is in such holes.
    """

    coverage_ratio: float = math.nan
    tracked_ratio: float = math.nan
    initialisation_s: float = math.nan
    matched_ratio: float = math.nan
    truth_period_s: float = math.nan
    hole_s: float = math.nan
    hole_ratio: float = 0.0

    def ratios(self) -> dict[str, float]:
        """Return the figures that are metrics, by their names."""
        return {
            'coverage_ratio': self.coverage_ratio,
            'tracked_ratio': self.tracked_ratio,
            'initialisation_s': self.initialisation_s,
            'matched_ratio': self.matched_ratio,
        }


class Associator:
    """
    Associates two streams; each pair is decided exactly once.

    The *horizon* is the stamp that both streams have reached; poses at or before it that arrive
    later are too late. A pair is decided as soon as no pose after the horizon could separate it.
    Hence neither the order in which the streams arrive nor the size of the batches matters.

    With interpolation, which side is the denser one is known for certain only at the end: until
    then there are pairs of both kinds, and those count that suit the intervals so far.
    """

    def __init__(self, config: EvaluationConfig) -> None:
        self._gap_ns = nanoseconds(config.max_gap_s)
        self._start_ns = nanoseconds(config.start_s)
        self._end_ns = None if math.isinf(config.end_s) else nanoseconds(config.end_s)
        self._config = config
        self._horizon_ns = BEFORE_ALL
        self.estimate = Side(Preparation.of_estimate(config), self._gap_ns)
        self.ground_truth = Side(Preparation.of_ground_truth(config), self._gap_ns)
        self.closest_ns: int | None = None
        self._begin_ns: int | None = None
        self._matchings: tuple[Matching, ...] = (
            (TruthInterpolated(self._gap_ns), EstimateInterpolated(self._gap_ns))
            if config.association == 'interpolate'
            else (Nearest(self._gap_ns, nanoseconds(config.max_difference_s)),)
        )

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
            self._begin_ns = None
            for matching in self._matchings:
                matching.begin()
        return drops_earlier

    def decide(self) -> tuple[Pairs, ...]:
        """Return the pairs that the poses since the last call decide, of each kind."""
        return self._advance(min(self.estimate.newest_ns, self.ground_truth.newest_ns))

    def flush(self) -> tuple[Pairs, ...]:
        """Return the remaining pairs, only of the kind that counts; no more poses will come."""
        return self._advance(AFTER_ALL)

    @property
    def kinds(self) -> int:
        """How many kinds of pairs there are."""
        return len(self._matchings)

    @property
    def chosen(self) -> int:
        """Which kind of pairs counts, by the intervals so far."""
        return int(len(self._matchings) > 1 and self._truth_is_sparser())

    def _truth_is_sparser(self) -> bool:
        return self.ground_truth.period.ns() > SPARSER_RATIO * self.estimate.period.ns()

    def tracking(self) -> Tracking:
        """
        Return how much of the run was evaluated so far.

        Intervals between poses count as tracking where they are no longer than ``max_gap_s`` or
        three median intervals of either side. Where the truth is so sparse that its own period
        decides that, its poses are counted instead of the time between them.
        """
        matching, truth = self._matchings[self.chosen], self.ground_truth
        own_limit_ns = truth.limit.longest_ns()
        limit_ns = max(self.estimate.limit.longest_ns(), own_limit_ns)
        sparse = self._truth_is_sparser() and own_limit_ns > self._gap_ns
        if sparse:
            part, whole, since = matching.count, truth.settled, matching.true_poses
        else:
            part = matching.tracked.total_ns(limit_ns)
            whole = truth.intervals.total_ns(limit_ns)
            since = matching.since_first.total_ns(limit_ns)
        counted = self.ground_truth.settled if self.chosen else self.estimate.settled
        first_ns, span_ns = matching.first_ns, matching.since_first.span_ns
        within_ns = matching.since_first.total_ns(own_limit_ns)
        return Tracking(
            # the estimates of the first and last pair may lie outside the ground truth
            coverage_ratio=_share(part, whole),
            tracked_ratio=_share(part, since),
            initialisation_s=math.nan
            if first_ns is None
            else (first_ns - truth.first_used_ns) / 1e9,
            matched_ratio=matching.count / counted if counted else math.nan,
            truth_period_s=truth.period.ns() / 1e9 if sparse else math.nan,
            hole_s=own_limit_ns / 1e9,
            hole_ratio=1 - within_ns / span_ns if span_ns else 0.0,
        )

    def statistics(self) -> dict[str, float]:
        """Return counts, ratios and stamp differences, by their names in a result."""
        matching = self._matchings[self.chosen]
        count = matching.count
        unmatched: list[float] = [
            side.settled - count for side in (self.estimate, self.ground_truth)
        ]
        if len(self._matchings) > 1:
            unmatched[not self.chosen] = math.nan  # an interpolated pose has two sources
        return {
            'pairs': count,
            **self.tracking().ratios(),
            'abs_difference_mean_s': matching.difference_sum_ns / count / 1e9
            if count
            else math.nan,
            'abs_difference_max_s': matching.difference_max_ns / 1e9 if count else math.nan,
            'unmatched_estimates': unmatched[0],
            'unmatched_ground_truth': unmatched[1],
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
        return sentences + self._sparse_truth()

    def _sparse_truth(self) -> list[str]:
        """Return that few poses of a sparse truth have a partner, where interpolation helps."""
        tracking = self.tracking()
        period_s, few = tracking.truth_period_s, tracking.tracked_ratio < FEW_PARTNERS_RATIO
        if self._config.association != 'nearest' or math.isnan(period_s) or not few:
            return []
        return [
            f'only {self._matchings[0].count} of {self.ground_truth.settled} poses of the ground '
            f'truth, which has one every {period_s:.3g} s, have an estimate within '
            f'{self._config.max_difference_s:g} s; --association interpolate compares at the '
            'stamps of all'
        ]

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
            advice = 'try --association interpolate'
        else:
            dense = ('ground truth', 'estimate')[self.chosen]
            tolerance = f'where the {dense} has no gap above {self._config.max_gap_s:g} s'
            advice = (
                'neither side is dense enough to be interpolated; --association nearest pairs '
                'equal stamps'
            )
        apart = estimate.first_ns > truth.newest_ns or truth.first_ns > estimate.newest_ns
        if self.closest_ns is None or apart:
            return (
                f'no pairs {tolerance}: {spans}; are the clocks the same? `diagnose` measures the '
                '--time-offset-s between them; wall-clock stamps in a replay need use_sim_time'
            )
        closest = f'the closest stamps are {self.closest_ns / 1e9:g} s apart'
        return f'no pairs {tolerance}: {spans}; {closest}; {advice}'

    def _advance(self, horizon_ns: int) -> tuple[Pairs, ...]:
        """Return the pairs between the last horizon and this one."""
        nothing = tuple(Pairs.empty() for _ in self._matchings)
        if horizon_ns <= self._horizon_ns:
            return nothing
        if self._start_ns or self._end_ns is not None:
            if horizon_ns < self.ground_truth.first_ns:
                # an earlier ground truth, from which start_s and end_s count, may still come
                return nothing
            if self._begin_ns is None:
                self._begin_ns = self.ground_truth.first_ns
            if self._begin_ns != AFTER_ALL:
                self._crop(self._begin_ns)
        for side in (self.estimate, self.ground_truth):
            side.settle(self._horizon_ns, horizon_ns)
        self._note_closest()
        decided = tuple(
            self._decided(matching, horizon_ns)
            if horizon_ns != AFTER_ALL or kind == self.chosen
            else Pairs.empty()
            for kind, matching in enumerate(self._matchings)
        )
        estimate, truth = self.estimate.waiting, self.ground_truth.waiting
        needed_ns = min(
            matching.needed_from(estimate, truth, horizon_ns) for matching in self._matchings
        )
        for side in (self.estimate, self.ground_truth):
            side.forget(needed_ns)
        self._horizon_ns = horizon_ns
        return decided

    def _decided(self, matching: Matching, horizon_ns: int) -> Pairs:
        """Return the pairs of one kind between the last horizon and this one."""
        estimate, truth = self.estimate.waiting, self.ground_truth.waiting
        pairs = Pairs.empty()
        if len(estimate) and len(truth):
            pairs = matching.between(estimate, truth, self._horizon_ns, horizon_ns)
        reached = int(np.searchsorted(truth.stamps_ns, horizon_ns, side='right'))
        matching.note(pairs, truth.stamps_ns[:reached], self._horizon_ns)
        return pairs

    def _crop(self, zero_ns: int) -> None:
        """Drop poses outside ``start_s`` to ``end_s``, relative to the first ground truth."""
        begin_ns = zero_ns + self._start_ns if self._start_ns else BEFORE_ALL
        end_ns = AFTER_ALL if self._end_ns is None else zero_ns + self._end_ns
        for side in (self.estimate, self.ground_truth):
            side.crop(begin_ns, end_ns)

    def _note_closest(self) -> None:
        """Remember the smallest difference, which is reported where there are no pairs."""
        stamps, others = self.estimate.waiting.stamps_ns, self.ground_truth.waiting.stamps_ns
        if len(stamps) and len(others):
            closest_ns = int(np.abs(stamps - others[nearest(stamps, others)]).min())
            self.closest_ns = min(
                closest_ns, AFTER_ALL if self.closest_ns is None else self.closest_ns
            )


def _share(part: int, whole: int) -> float:
    return min(1.0, part / whole) if whole else math.nan


def _span(side: Side) -> str:
    return f'{side.first_ns / 1e9:.1f} to {side.newest_ns / 1e9:.1f}'
