"""One of the two streams of poses: prepared, counted, and kept as long as pairs may need it."""

from __future__ import annotations

import numpy as np

from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.intervals import Intervals, MedianInterval, TrackingLimit
from vio_eval_ros.core.orientations import CONSTANT, Orientations, some_usable, UNUSABLE
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.trajectory import Poses, Trajectory

BEFORE_ALL = np.iinfo(np.int64).min
AFTER_ALL = np.iinfo(np.int64).max


class Side:
    """
    One side of the association: prepares arriving poses and keeps those that are still needed.

    :param preparation: of its poses.
    :param gap_ns: the longest interval between poses that counts as tracking.
    """

    def __init__(self, preparation: Preparation, gap_ns: int) -> None:
        self.counts = Cleaning()
        self.waiting = Trajectory.empty()
        self.first_ns = AFTER_ALL
        self.newest_ns = BEFORE_ALL
        self.first_used_ns = AFTER_ALL
        self.last_used_ns = BEFORE_ALL
        self.used = 0
        self.settled = 0
        self.intervals = Intervals(gap_ns)
        #: the longest interval that counts as tracking, by the period of its own
        self.limit = TrackingLimit(gap_ns)
        self.period = MedianInterval()
        self._gap_ns = gap_ns
        self._preparation = preparation
        self._lacks_rotations = False
        self._orientations = Orientations()
        #: whether orientations have come, and one of them was usable
        self._oriented, self._unusable = False, False
        #: what the poses without a usable one count as, should one come after them
        self._unoriented = Cleaning()

    @property
    def position_only(self) -> bool:
        """Whether orientations are missing or say nothing."""
        return self._lacks_rotations or self._orientations.constant

    def receive(self, poses: Poses, horizon_ns: int) -> bool:
        """
        Add a batch; poses at or before the horizon are too late and only counted.

        Return whether all before it are dropped by that: none had a usable orientation, until now.
        """
        drops_earlier = self._unusable and some_usable(poses)
        if drops_earlier:
            self._drop_unoriented()
        newest_ns = None if self.newest_ns == BEFORE_ALL else self.newest_ns
        batch = self._preparation.apply(poses, self.counts, newest_ns, not self._oriented)
        self._note_orientations(poses, batch)
        self._keep(batch, horizon_ns)
        return drops_earlier

    def _note_orientations(self, poses: Poses, batch: Trajectory) -> None:
        """Note whether the orientations that came with a batch are usable and change."""
        self._orientations.add(batch)
        if self._oriented or poses.rotations is None:
            return
        self._oriented = bool(len(batch)) and batch.rotations is not None
        if not self._oriented:
            self._unusable |= bool(len(batch))
            clean(poses, self._unoriented, positions_suffice=False)

    def _drop_unoriented(self) -> None:
        """Drop all poses so far, as a batch of the whole stream drops them."""
        overflow = self.counts.overflow
        vars(self.counts).update(vars(self._unoriented), overflow=overflow)
        self.waiting = Trajectory.empty()
        self.first_ns = self.first_used_ns = AFTER_ALL
        self.last_used_ns = BEFORE_ALL
        self.used = self.settled = 0
        self.intervals = Intervals(self._gap_ns)
        self.limit = TrackingLimit(self._gap_ns)
        self.period = MedianInterval()
        self._lacks_rotations = self._unusable = False

    def _keep(self, batch: Trajectory, horizon_ns: int) -> None:
        """Let the poses of a batch wait for their partners."""
        if len(batch) and batch.stamps_ns[0] <= max(self.newest_ns, horizon_ns):
            batch = self._without_repeated_and_late(batch, horizon_ns)
        if not len(batch):
            return
        in_order = batch.stamps_ns[0] > self.newest_ns
        self.waiting = Trajectory.concatenate([self.waiting, batch])
        if not in_order:
            self.waiting = self.waiting[np.argsort(self.waiting.stamps_ns)]
        self.used += len(batch)
        self._lacks_rotations |= batch.rotations is None
        self.first_ns = min(self.first_ns, int(batch.stamps_ns[0]))
        self.newest_ns = max(self.newest_ns, int(batch.stamps_ns[-1]))

    def _without_repeated_and_late(self, batch: Trajectory, horizon_ns: int) -> Trajectory:
        repeated = np.isin(batch.stamps_ns, self.waiting.stamps_ns)
        repeated |= batch.stamps_ns == self.newest_ns
        late = ~repeated & (batch.stamps_ns <= horizon_ns)
        self.counts.duplicate += int(np.count_nonzero(repeated))
        self.counts.late += int(np.count_nonzero(late))
        return batch[~(repeated | late)]

    def crop(self, begin_ns: int, end_ns: int) -> None:
        """Drop the waiting poses outside [begin, end]; they still count for ``newest_ns``."""
        inside = self.waiting.within(begin_ns, end_ns)
        cropped = len(self.waiting) - len(inside)
        self.counts.cropped += cropped
        self.used -= cropped
        self.waiting = inside

    def why_positions_only(self) -> str:
        """Return why the orientations that came say nothing; empty where they do."""
        if self._unusable:
            return UNUSABLE
        if not self._orientations.constant:
            return ''
        moved = ', and the body cannot be moved by them to another frame'
        return CONSTANT + (moved if self._preparation.moves else '')

    def settle(self, after_ns: int, until_ns: int) -> None:
        """Count the poses in (after, until], whose partners are known."""
        begin, end = np.searchsorted(self.waiting.stamps_ns, [after_ns, until_ns], side='right')
        self.settled += int(end - begin)
        if end > begin:
            self.first_used_ns = min(self.first_used_ns, int(self.waiting.stamps_ns[begin]))
            self.last_used_ns = int(self.waiting.stamps_ns[end - 1])
        intervals = self.intervals.add(self.waiting.stamps_ns[begin:end])
        self.limit.add(intervals)
        self.period.add(intervals)

    def forget(self, before_ns: int) -> None:
        """Drop earlier poses, except the last of them, from which an interpolation may start."""
        first = int(np.searchsorted(self.waiting.stamps_ns, before_ns)) - 1
        if first > 0:
            self.waiting = self.waiting[first:]
