"""Which run a pose belongs to: the next one begins where a stream jumps back in time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TYPE_CHECKING

import numpy as np

from vio_eval_ros.core.association import AFTER_ALL, BEFORE_ALL
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.recordings.messages import PathRevisions

if TYPE_CHECKING:
    from vio_eval_ros.nodes.stream import Stream

JUMP_BACK_NS = 1_000_000_000
MIN_JUMPED = 5
# How long a stream may lag behind another: only then does it count as one that did not jump back.
LAG_S = 5.0
MOST_WAITING = 3  # so that two publishers with different clocks do not split it forever


class Jump(NamedTuple):
    """Between which stamps [ns] a stream jumped back, and when that was seen [monotonic s]."""

    from_ns: int
    to_ns: int
    seen_s: float

    def __str__(self) -> str:
        """Return what happened, in seconds."""
        return f'jumped back from {self.from_ns / 1e9:.1f} to {self.to_ns / 1e9:.1f} s'


class RunQueue:
    """
    The poses of a stream as they arrive, told apart by run.

    A run ends where the stream jumps back by more than a second. A late pose is no jump: several
    in a row must be that far behind, and until that is certain they are withheld.
    """

    def __init__(self) -> None:
        self.jumps: deque[Jump] = deque()
        self._runs: deque[list[Poses]] = deque([[]])
        self._begin_run()
        self._withheld: Poses = Trajectory.empty()

    def add(self, poses: Poses, now_s: float) -> None:
        """
        Add poses in order of arrival.

        :param now_s: when they were seen [monotonic s].
        """
        poses = Poses.concatenate([self._withheld, poses])
        end, begins_next = next_jump(poses.stamps_ns, self.newest_ns)
        while begins_next and len(self.jumps) < MOST_WAITING:
            self._append(poses[:end])
            poses = poses[end:]
            self.jumps.append(Jump(self.newest_ns, int(poses.stamps_ns[0]), now_s))
            self._runs.append([])
            self._begin_run()
            end, begins_next = next_jump(poses.stamps_ns, self.newest_ns)
        certain = len(poses) if begins_next else end
        self._append(poses[:certain])
        self._withheld = poses[certain:]

    def take(self) -> Poses:
        """Return the poses of the run that were added since the last call."""
        poses = Poses.concatenate([Trajectory.empty(), *self._runs[0]])
        self._runs[0] = []
        return poses

    def release(self) -> None:
        """Add what is withheld to the run: no more poses will come to tell what it is."""
        self._append(self._withheld)
        self._withheld = Trajectory.empty()

    def next_run(self) -> None:
        """Go on to the next run: to that after the jump, or to one that begins now."""
        if self.jumps:
            self.jumps.popleft()
            self._runs.popleft()
        else:
            self._begin_run()

    def _begin_run(self) -> None:
        self.oldest_ns, self.newest_ns = AFTER_ALL, BEFORE_ALL
        self.unstamped = False

    def _append(self, poses: Poses) -> None:
        if not len(poses):
            return
        self._runs[-1].append(poses)
        stamps_ns = poses.stamps_ns[poses.stamps_ns != 0]
        self.oldest_ns = min(self.oldest_ns, int(stamps_ns.min(initial=AFTER_ALL)))
        self.newest_ns = max(self.newest_ns, int(stamps_ns.max(initial=BEFORE_ALL)))
        self.unstamped = self.newest_ns == BEFORE_ALL


class PathQueue:
    """
    The Path messages of a stream, told apart by run.

    A Path that ends behind the half of the one before begins the next run, if the message after it
    does so too: a single one is late, and one that ends a little earlier has been pruned.
    """

    def __init__(self, topic: str) -> None:
        self.runs: deque[PathRevisions] = deque()
        self._topic = topic
        self._suspect: Poses | None = None
        self._begin_run()

    def add(self, revision: Poses) -> Iterator[Poses]:
        """Take the poses of one more message; yield those that are new to their run."""
        restarts = len(self.runs) <= MOST_WAITING and self._is_far_behind(revision)
        if restarts and self._suspect is None:
            self._suspect = revision
            return
        if restarts or not self.runs:
            self.runs.append(PathRevisions(self._topic))
            self._begin_run()
        yield from self.release()
        self._oldest_ns = min(self._oldest_ns, int(revision.stamps_ns.min()))
        self._newest_ns = max(self._newest_ns, int(revision.stamps_ns.max()))
        yield self.runs[-1].add(revision)

    def release(self) -> Iterator[Poses]:
        """Yield the poses of a message that is withheld, if there is one."""
        suspect, self._suspect = self._suspect, None
        if suspect is not None and self.runs:
            yield self.runs[-1].add(suspect)

    def next_run(self) -> None:
        """Go on to the next run."""
        if self.runs:
            self.runs.popleft()

    def _begin_run(self) -> None:
        self._oldest_ns, self._newest_ns = AFTER_ALL, BEFORE_ALL

    def _is_far_behind(self, revision: Poses) -> bool:
        if self._newest_ns == BEFORE_ALL:
            return False
        allowed_ns = max(JUMP_BACK_NS, (self._newest_ns - self._oldest_ns) // 2)
        return int(revision.stamps_ns.max()) + allowed_ns < self._newest_ns


def next_jump(stamps_ns: np.ndarray, newest_ns: int) -> tuple[int, bool]:
    """
    Return how many stamps surely belong to the run, and whether the next one follows them.

    Stamps of 0 tell nothing: they are those of messages that were published before ``/clock``.

    :param stamps_ns: (N,) in order of arrival.
    :param newest_ns: the newest stamp before them.
    """
    newest = np.maximum.accumulate(np.concatenate([[newest_ns], stamps_ns]))[:-1]
    behind = (stamps_ns + JUMP_BACK_NS < newest) & (stamps_ns != 0)
    if not behind.any():
        return len(stamps_ns), False
    # the length of each row of stamps that are behind, from its begin on
    edges = np.flatnonzero(np.diff(np.concatenate([[False], behind, [False]])))
    begins, ends = edges[::2], edges[1::2]
    jumped = ends - begins >= MIN_JUMPED
    if jumped.any():
        return int(begins[jumped.argmax()]), True
    return int(begins[-1]) if behind[-1] else len(stamps_ns), False


def why_the_run_ends(streams: Sequence[Stream], now_s: float, at_once: bool = False) -> str:
    """
    Return which jump back in time ends the run of these streams, if any.

    Not before all have jumped or had time to: what is still under way belongs to this run.

    :param now_s: the time [monotonic s].
    :param at_once: nothing more is under way.
    """
    jumped = [stream for stream in streams if stream.runs.jumps]
    if not jumped:
        return ''
    first = min(jumped, key=lambda stream: stream.runs.jumps[0].seen_s)
    jump = first.runs.jumps[0]
    lagging = any(now_s - stream.received_s < LAG_S for stream in streams if stream not in jumped)
    has_time = now_s - jump.seen_s < LAG_S
    return '' if lagging and has_time and not at_once else f'{first.topic} {jump}'
