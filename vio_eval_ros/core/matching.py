"""Rules by which poses of two streams become pairs, and what is counted of their pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vio_eval_ros.core.interpolation import between
from vio_eval_ros.core.intervals import Intervals
from vio_eval_ros.core.side import BEFORE_ALL
from vio_eval_ros.core.trajectory import as_slice, Pairs, Trajectory


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


class Matching:
    """
    A rule that decides every pair once, as soon as no pose to come can change it.

    :param gap_ns: the longest interval between poses that counts as tracking.
    """

    def __init__(self, gap_ns: int) -> None:
        self._gap_ns = gap_ns
        self.begin()

    def begin(self) -> None:
        """Begin with no pairs."""
        self.count = 0
        self.difference_sum_ns = 0
        self.difference_max_ns = 0
        #: between pairs
        self.tracked = Intervals(self._gap_ns)
        #: from the first pair on: true poses, and the time between them
        self.true_poses = 0
        self.since_first = Intervals(self._gap_ns)
        self.first_ns: int | None = None

    def between(
        self, estimate: Trajectory, truth: Trajectory, after_ns: int, until_ns: int
    ) -> Pairs:
        """Return the pairs of waiting poses that the new horizon decides, not yet the old one."""
        raise NotImplementedError

    def needed_from(self, estimate: Trajectory, truth: Trajectory, horizon_ns: int) -> int:
        """Return the stamp from which poses may still affect undecided pairs."""
        raise NotImplementedError

    def note(self, pairs: Pairs, true_ns: np.ndarray, after_ns: int) -> None:
        """
        Count new pairs.

        :param true_ns: stamps of the waiting true poses up to the new horizon.
        :param after_ns: the old horizon.
        """
        estimate_ns, truth_ns = pairs.estimate.stamps_ns, pairs.ground_truth.stamps_ns
        self.tracked.add(estimate_ns)
        difference = np.abs(estimate_ns - truth_ns)
        self.count += len(pairs)
        self.difference_sum_ns += int(difference.sum())
        self.difference_max_ns = max(self.difference_max_ns, int(difference.max(initial=0)))
        if self.first_ns is None and len(pairs):
            self.first_ns = int(truth_ns[0])
            self.since_first.add(truth_ns[:1])
            self.true_poses = int(np.count_nonzero(true_ns == self.first_ns))
            after_ns = self.first_ns
        if self.first_ns is not None:
            new_ns = true_ns[np.searchsorted(true_ns, after_ns, side='right') :]
            self.true_poses += len(new_ns)
            self.since_first.add(new_ns)


class Nearest(Matching):
    """
    Mutually nearest poses.

    :param tolerance_ns: the largest difference between the stamps of a pair.
    """

    def __init__(self, gap_ns: int, tolerance_ns: int) -> None:
        super().__init__(gap_ns)
        self._tolerance_ns = tolerance_ns

    def between(
        self, estimate: Trajectory, truth: Trajectory, after_ns: int, until_ns: int
    ) -> Pairs:
        """Return mutually nearest poses, as far as the new horizon decides them."""
        partner = nearest(estimate.stamps_ns, truth.stamps_ns)
        difference = np.abs(estimate.stamps_ns - truth.stamps_ns[partner])
        # up to this stamp, a pose could arrive that is nearer to one of the two
        open_ns = np.maximum(estimate.stamps_ns, truth.stamps_ns[partner]) + difference
        chosen = np.flatnonzero(
            (difference <= self._tolerance_ns) & (open_ns > after_ns) & (open_ns <= until_ns)
        )
        candidates = partner[chosen]
        mutual = nearest(truth.stamps_ns[candidates], estimate.stamps_ns) == chosen
        return Pairs.of(estimate[as_slice(chosen[mutual])], truth[as_slice(candidates[mutual])])

    def needed_from(self, estimate: Trajectory, truth: Trajectory, horizon_ns: int) -> int:
        """Return what a pair across the horizon and its competitors reach back to."""
        return horizon_ns - 3 * self._tolerance_ns


class Interpolated(Matching):
    """The poses of one side, with the other side interpolated at their stamps."""

    def needed_from(self, estimate: Trajectory, truth: Trajectory, horizon_ns: int) -> int:
        """Return the last stamp that the side which is interpolated has passed."""
        stamps = self._dense(estimate, truth).stamps_ns
        passed = int(np.searchsorted(stamps, horizon_ns, side='right'))
        return int(stamps[passed - 1]) if passed else BEFORE_ALL

    def _dense(self, estimate: Trajectory, truth: Trajectory) -> Trajectory:
        """Return the side that is interpolated."""
        raise NotImplementedError

    def _at(
        self, sparse: Trajectory, dense: Trajectory, after_ns: int, until_ns: int
    ) -> tuple[Trajectory, Trajectory]:
        """Return poses of one side and the other at their stamps, as far as decided."""
        stamps = dense.stamps_ns
        after = np.searchsorted(stamps, sparse.stamps_ns)
        inside = after < len(stamps)
        # up to this stamp, a pose could arrive that is nearer to the other
        open_ns = stamps[after[inside]]
        inside[inside] = (open_ns > after_ns) & (open_ns <= until_ns)
        sparse, after = sparse[inside], after[inside]
        exact = stamps[after] == sparse.stamps_ns
        before = np.where(exact, after, after - 1)
        usable = (before >= 0) & (stamps[after] - stamps[before] <= self._gap_ns)
        sparse, begin, end = sparse[usable], dense[before[usable]], dense[after[usable]]
        return sparse, between(begin, end, sparse.stamps_ns, weighted=True)


class TruthInterpolated(Interpolated):
    """Every estimate, with ground truth at its stamp: where the truth is denser, or as dense."""

    def between(
        self, estimate: Trajectory, truth: Trajectory, after_ns: int, until_ns: int
    ) -> Pairs:
        """Return estimates with interpolated truth, as far as the new horizon decides them."""
        truth = replace(truth, covariances=None)  # pairs have none of the truth
        return Pairs.of(*self._at(estimate, truth, after_ns, until_ns))

    def _dense(self, estimate: Trajectory, truth: Trajectory) -> Trajectory:
        return truth


class EstimateInterpolated(Interpolated):
    """Every true pose, with the estimate at its stamp: where the truth is sparser."""

    def between(
        self, estimate: Trajectory, truth: Trajectory, after_ns: int, until_ns: int
    ) -> Pairs:
        """Return true poses with the interpolated estimate, as far as decided."""
        true, estimated = self._at(truth, estimate, after_ns, until_ns)
        return Pairs.of(estimated, true)

    def _dense(self, estimate: Trajectory, truth: Trajectory) -> Trajectory:
        return estimate
