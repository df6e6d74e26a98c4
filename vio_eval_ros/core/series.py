"""Running values of an evaluation: one row for every whole second of stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from vio_eval_ros.core.cleaning import Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation, Summary
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.side import AFTER_ALL, BEFORE_ALL
from vio_eval_ros.core.trajectory import Poses

SECOND_NS = 10**9
MAX_WAITING_PER_PAIR = 10


class RunningSeries:
    """
    An evaluation that gives its running values once for every whole second of stamps.

    Poses may come in batches of any size: a second is evaluated when both streams have passed it.
    Hence a live series has the same rows as a recording of it.

    :param max_pairs: how many pairs are kept, see :class:`Evaluation`. Where more than ten times
        as many poses wait for the other stream, the oldest are dropped.
    """

    def __init__(self, config: EvaluationConfig, max_pairs: int | None = None) -> None:
        self.evaluation = Evaluation(config, max_pairs)
        #: of all pairs, once :meth:`rest` has ended
        self.summary: Summary | None = None
        self._offset_ns = nanoseconds(config.time_offset_s)
        associator = self.evaluation.associator
        limit = None if max_pairs is None else MAX_WAITING_PER_PAIR * max_pairs
        self._estimate = _Waiting(self.evaluation.add_estimate, associator.estimate.counts, limit)
        self._ground_truth = _Waiting(
            self.evaluation.add_ground_truth, associator.ground_truth.counts, limit
        )

    def add_estimate(self, poses: Poses) -> None:
        """Add a batch of estimated poses."""
        self._estimate.add(poses, poses.stamps_ns + self._offset_ns)

    def add_ground_truth(self, poses: Poses, waits: bool = True) -> None:
        """
        Add a batch of true poses.

        :param waits: False where they are all there are, so that their number is not limited.
        """
        self._ground_truth.add(poses, poses.stamps_ns, waits)

    def rows(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield stamp and running values of every second that both streams have passed."""
        passed_ns = min(self._estimate.newest_ns, self._ground_truth.newest_ns)
        for stamp_ns in self._seconds(passed_ns):
            if stamp_ns < passed_ns:
                self._release(stamp_ns)
                yield stamp_ns, self.evaluation.running()

    def rest(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield the remaining rows at the end of both streams; the last one has final values."""
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
        """Return which stream is missing or late, with the span of each."""
        spans = []
        for name, waiting in (('estimate', self._estimate), ('ground truth', self._ground_truth)):
            if waiting.newest_ns == BEFORE_ALL:
                spans.append(f'no {name} yet')
            else:
                spans.append(
                    f'{name} spans {waiting.oldest_ns / 1e9:.1f} to '
                    f'{waiting.newest_ns / 1e9:.1f} s'
                )
        return ', '.join(spans)

    def _seconds(self, until_ns: int) -> list[int]:
        """Return the whole seconds at which waiting poses up to a stamp are due."""
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
    """Yield the rows of two complete streams, as if their poses had arrived in order."""
    series = RunningSeries(config)
    ordered = [
        poses[np.argsort(poses.stamps_ns, kind='stable')] for poses in (estimate, ground_truth)
    ]
    series.add_estimate(ordered[0])
    series.add_ground_truth(ordered[1])
    yield from series.rest()


class _Waiting:
    """Poses of a stream that wait until their second is over."""

    def __init__(self, add: Callable[[Poses], None], counts: Cleaning, limit: int | None) -> None:
        self._counts = counts
        self._limit = limit
        self.oldest_ns = AFTER_ALL
        self.newest_ns = BEFORE_ALL
        self.clocks: list[np.ndarray] = []
        self._poses: list[Poses] = []
        self._released_ns = BEFORE_ALL
        self._add = add

    def add(self, poses: Poses, clock_ns: np.ndarray, waits: bool = True) -> None:
        """Add poses and the stamps by which they are ordered."""
        if poses.zero_is_unset and not poses.stamps_ns.all():
            stamped = poses.stamps_ns != 0
            self._add(poses[~stamped])  # to be counted; it does not matter in which second
            poses, clock_ns = poses[stamped], clock_ns[stamped]
        if not len(poses):
            return
        # a late pose is evaluated with the next second: the series does not go back
        clock_ns = np.maximum(clock_ns, self._released_ns + 1)
        self.oldest_ns = min(self.oldest_ns, int(clock_ns.min()))
        self.newest_ns = max(self.newest_ns, int(clock_ns.max()))
        self.clocks.append(clock_ns)
        self._poses.append(poses)
        if self._limit is not None and waits:
            self._drop_oldest(sum(map(len, self._poses)) - self._limit)

    def _drop_oldest(self, excess: int) -> None:
        """Drop the oldest poses that exceed the limit."""
        while excess > 0:
            dropped = min(excess, len(self._poses[0]))
            self._poses[0] = self._poses[0][dropped:]
            self.clocks[0] = self.clocks[0][dropped:]
            if not len(self._poses[0]):
                del self._poses[0], self.clocks[0]
            self._counts.overflow += dropped
            excess -= dropped

    def release(self, until_ns: int) -> None:
        """Evaluate the poses up to a stamp."""
        self._released_ns = until_ns
        if not self._poses:
            return
        poses, clock = self._poses[0], self.clocks[0]
        if len(self._poses) > 1:
            poses, clock = Poses.concatenate(self._poses), np.concatenate(self.clocks)
        # where poses are in order, slices copy nothing, however many wait
        in_order = bool((np.diff(clock) >= 0).all())
        end = int(np.searchsorted(clock, until_ns, side='right')) if in_order else 0
        over: Any = slice(end) if in_order else clock <= until_ns
        rest: Any = slice(end, None) if in_order else clock > until_ns
        self._add(poses[over])
        self._poses, self.clocks = [poses[rest]], [clock[rest]]
