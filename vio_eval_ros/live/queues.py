"""
Which run a pose belongs to: the next one begins where a stream jumps back in time.

On its way from a topic to a number a pose waits three times: here until it is certain which run it
belongs to, in the series of :class:`LiveRun` until both streams have passed its second, and in the
association until no nearer pose can come.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.side import AFTER_ALL, BEFORE_ALL
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.recordings.messages import PathRevisions

#: smallest step back of the stamps that begins another run
JUMP_BACK_NS = 1_000_000_000
#: smallest step ahead after which a pose is set aside, until others confirm it
JUMP_AHEAD_NS = 60_000_000_000
#: fewest poses in a row that confirm a jump
MIN_JUMPED = 5
#: how long to wait for the other stream to jump back as well
LAG_S = 5.0
#: most jumps that wait: two publishers with different clocks must not split a stream for ever
MOST_WAITING = 3


class TimeJump(NamedTuple):
    """Between which stamps [ns] a stream jumped back, and when that was seen [monotonic s]."""

    from_ns: int
    to_ns: int
    seen_s: float

    def __str__(self) -> str:
        """Return what happened, in seconds."""
        return f'jumped back from {self.from_ns / 1e9:.1f} to {self.to_ns / 1e9:.1f} s'


class RunQueue:
    """
    The poses of a stream as they arrive, separated by run.

    A run ends where the stream jumps back by more than a second. A single late pose is not a jump:
    several in a row must be that late, and until that is certain they are withheld. So are those
    that are far ahead; where they remain single, they are handed on at the end of their run.

    ``oldest_ns`` and ``newest_ns`` are of the newest run; poses stamped 0 do not count.
    """

    def __init__(self) -> None:
        self.jumps: deque[TimeJump] = deque()
        self._runs: deque[list[Poses]] = deque([[]])
        self._begin_run()
        self._withheld: Poses = Trajectory.empty()
        self._astray: list[Poses] = []

    @property
    def jump(self) -> TimeJump | None:
        """The first jump back after which the run has not ended yet."""
        return self.jumps[0] if self.jumps else None

    def add(self, poses: Poses, now_s: float) -> None:
        """
        Add poses in order of arrival.

        :param now_s: when they were seen [monotonic s].
        """
        poses = Poses.concatenate([self._withheld, poses])
        poses, uncertain = self._without_strays(poses)
        end, begins_next = next_jump(poses.stamps_ns, self.newest_ns)
        while begins_next and len(self.jumps) < MOST_WAITING:
            self._append(poses[:end])
            poses = poses[end:]
            self._begin_next(int(poses.stamps_ns[0]), now_s)
            end, begins_next = next_jump(poses.stamps_ns, self.newest_ns)
        certain = len(poses) if begins_next else end
        self._append(poses[:certain])
        self._withheld = Poses.concatenate([poses[certain:], uncertain])

    def resume(self, poses: Poses) -> None:
        """Begin with poses of the run that another queue had handed on."""
        self._append(poses)

    def take(self) -> Poses:
        """Return the poses of the run that were added since the last call."""
        poses = Poses.concatenate([Trajectory.empty(), *self._runs[0]])
        self._runs[0] = []
        return poses

    def release(self) -> None:
        """Add what is withheld to the run: no more poses will come to tell what it is."""
        for poses in (self._withheld, *self._astray):
            self._append(poses)
        self._withheld, self._astray = Trajectory.empty(), []

    def next_run(self) -> None:
        """Go on to the next run: to that after the jump, or to one that begins now."""
        if self.jumps:
            self.jumps.popleft()
            self._runs.popleft()
        else:
            self._begin_run()

    def _without_strays(self, poses: Poses) -> tuple[Poses, Poses]:
        """Set lone poses far ahead aside; return the others, and those that may be such."""
        looked_at = 0
        while True:
            before = np.concatenate([[self.newest_ns], poses.stamps_ns])
            before = np.maximum.accumulate(before)[:-1]
            ahead = (poses.stamps_ns > before + JUMP_AHEAD_NS) & (before != BEFORE_ALL)
            ahead[:looked_at] = False
            if not ahead.any():
                return poses, poses[:0]
            k = int(ahead.argmax())
            is_far = poses.stamps_ns[k : k + MIN_JUMPED] > before[k] + JUMP_AHEAD_NS
            if not is_far.all():
                strays = k + np.flatnonzero(is_far)
                self._astray.append(poses[strays])
                poses = poses[np.delete(np.arange(len(poses)), strays)]
            elif len(is_far) < MIN_JUMPED:
                return poses[:k], poses[k:]
            else:  # a gap
                looked_at = k + 1

    def _begin_next(self, begin_ns: int, now_s: float) -> None:
        self.jumps.append(TimeJump(self.newest_ns, begin_ns, now_s))
        self._runs[-1] += self._astray
        self._astray = []
        self._runs.append([])
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


class PathQueue(RunQueue):
    """
    The poses of Path messages as first published, separated by run.

    A Path that ends before the middle of the current run begins the next run, if the message after
    it does so too: a single one is late, and one that ends a little earlier has been pruned.

    :param topic: what an error names.
    """

    def __init__(self, topic: str) -> None:
        super().__init__()
        self._topic = topic
        self._revisions = deque([PathRevisions(topic)])
        self._suspect: Poses | None = None
        self._first_ns: int = AFTER_ALL
        self._last_ns: int = BEFORE_ALL
        #: what is not after this belongs to a run that is over
        self._over_ns: int = BEFORE_ALL

    @property
    def revisions(self) -> PathRevisions:
        """What the messages of the run said, the last word on each stamp included."""
        return self._revisions[0]

    def add(self, poses: Poses, now_s: float) -> None:
        """Take the poses of one more message."""
        restarts = len(self.jumps) < MOST_WAITING and self._is_far_behind(poses)
        if restarts and self._suspect is None:
            self._suspect = poses
            return
        if restarts:
            self._begin_next(int(poses.stamps_ns.min()), now_s)
            self._revisions.append(PathRevisions(self._topic))
            self._first_ns, self._last_ns, self._over_ns = AFTER_ALL, BEFORE_ALL, BEFORE_ALL
        self.release()
        self._first_ns = min(self._first_ns, int(poses.stamps_ns.min()))
        self._last_ns = max(self._last_ns, int(poses.stamps_ns.max()))
        self._revise(poses)

    def resume(self, poses: Poses) -> None:
        """Begin with poses that another queue had handed on, as if they were one message."""
        if len(poses):
            self.add(poses, 0.0)

    def release(self) -> None:
        """Add a message that is withheld, if there is one."""
        suspect, self._suspect = self._suspect, None
        if suspect is not None:
            self._revise(suspect)

    def next_run(self) -> None:
        """Go on to the next run; to one that begins now, what is over does not belong."""
        if self.jumps:
            self._revisions.popleft()
        else:
            self._over_ns = max(self._over_ns, self.newest_ns)
            self._revisions = deque([PathRevisions(self._topic)])
        super().next_run()

    def _revise(self, poses: Poses) -> None:
        self._append(self._revisions[-1].add(poses[poses.stamps_ns > self._over_ns]))

    def _is_far_behind(self, poses: Poses) -> bool:
        if self._last_ns == BEFORE_ALL:
            return False
        allowed_ns = max(JUMP_BACK_NS, (self._last_ns - self._first_ns) // 2)
        return int(poses.stamps_ns.max()) + allowed_ns < self._last_ns


def next_jump(stamps_ns: np.ndarray, newest_ns: int) -> tuple[int, bool]:
    """
    Return how many stamps certainly belong to the run, and whether the next run follows them.

    Stamps of 0 are ignored: they are of messages that were published before ``/clock``.

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


class Progress(NamedTuple):
    """
    How far a stream has come.

    :param received_s: when a message arrived last [monotonic s].
    :param jump: the first jump back after which the run has not ended yet.
    """

    topic: str
    received_s: float
    jump: TimeJump | None


def why_the_run_ends(streams: Sequence[Progress], now_s: float, at_once: bool = False) -> str:
    """
    Return which jump back in time ends the run of these streams; empty where none does.

    Not before all have jumped or had time to: what is still under way belongs to this run.

    :param now_s: the time [monotonic s].
    :param at_once: nothing more is under way.
    """
    jumps = [(stream.topic, stream.jump) for stream in streams if stream.jump is not None]
    if not jumps:
        return ''
    topic, jump = min(jumps, key=lambda item: item[1].seen_s)
    lagging = any(now_s - stream.received_s < LAG_S for stream in streams if stream.jump is None)
    has_time = now_s - jump.seen_s < LAG_S
    return '' if lagging and has_time and not at_once else f'{topic} {jump}'
