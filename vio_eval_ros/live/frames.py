"""The motion of one frame in another, of transforms as they arrive: one pose after the other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

from vio_eval_ros.core.side import BEFORE_ALL
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.errors import ReadError
from vio_eval_ros.live.queues import JUMP_BACK_NS, MIN_JUMPED
from vio_eval_ros.recordings.messages import header_ns
from vio_eval_ros.recordings.transforms import (
    changes_of,
    Edge,
    edge_of,
    in_order,
    joined,
    Link,
    TransformTree,
)

#: most samples of a transform that are kept for the end of the run: 7 hours at 200 Hz, 320 MB
MOST_KEPT = 5_000_000


class FrameMotion:
    """
    The motion between two frames in one run.

    Poses are handed on as soon as all transforms between the frames are known on both sides of
    their stamps. What leads the chain, and what never changes, is only known when the run has
    ended: so :meth:`final` has the poses once more, exactly as :meth:`TransformTree.lookup` gives
    them of a recording.

    :param topic: the name of the dynamic topic.
    :param frames: 'PARENT.CHILD'.
    :param static: the names of the static topics, the nearest first.
    """

    def __init__(self, topic: str, frames: str, static: Sequence[str]) -> None:
        self.topic = topic
        self.frames = frames
        #: why there are no poses, or not all
        self.problem = ''
        #: what was left out or assumed, of the last :meth:`final`
        self.warnings: Sequence[str] = ()
        #: the frame of the poses, as soon as it is known
        self.parent = ''
        self._before: Poses = Trajectory.empty()  # of an evaluator before this one
        self._tree = TransformTree(topic, static)
        self._fixed: dict[tuple[str, str, str], Any] = {}  # the last of each static transform
        self._chain: list[Link] = []
        self._looked_at: Counter[Edge] = Counter()
        self._changes: Counter[Edge] = Counter()
        self._begins: Counter[Edge] = Counter()  # of what is still needed of a transform
        self._leading: Edge | None = None
        self._waiting: Poses = Trajectory.empty()
        self._given_ns = BEFORE_ALL
        self._forgotten = 0
        self._newest_ns: dict[Edge, int] = {}
        self._behind: Counter[Edge] = Counter()  # how many in a row are far behind
        self._suspect: list[Any] = []  # messages that may be of the next run

    def resume(self, poses: Poses) -> None:
        """Begin with poses of the run that an evaluator before this one had received."""
        self._before = poses
        self._given_ns = int(poses.stamps_ns.max(initial=BEFORE_ALL))

    def add(self, message: Any, static: str = '') -> FrameMotion | None:
        """
        Take a TFMessage.

        :param static: the static topic that it came on, if it came on one.
        :return: the motion in the next run, where time has jumped back by more than a second:
            the message belongs to that.
        """
        if static:
            self._tree.add(message, static)
            for one in message.transforms:
                self._fixed[static, one.header.frame_id, one.child_frame_id] = one
            return None
        self._look_for_a_jump(message)
        if not self._behind:
            self._settle([message])
        elif max(self._behind.values()) < MIN_JUMPED:
            self._suspect.append(message)
        else:
            following = self.next()
            following._settle([*self._suspect, message])
            self._suspect, self._behind = [], Counter()
            return following
        return None

    def _look_for_a_jump(self, message: Any) -> None:
        """Count of the transforms between the two frames how many in a row are far behind."""
        between = {edge for edge, _ in self._chain}
        for transform in message.transforms:
            edge, stamp_ns = edge_of(transform), header_ns(transform)
            newest_ns = self._newest_ns.get(edge, BEFORE_ALL)
            if edge in between and stamp_ns and stamp_ns + JUMP_BACK_NS < newest_ns:
                self._behind[edge] += 1
            else:
                self._newest_ns[edge] = max(newest_ns, stamp_ns)
                self._behind.pop(edge, None)

    def _settle(self, messages: Sequence[Any]) -> None:
        """Take messages that are of this run, and those that were suspect until now."""
        for message in (*self._suspect, *messages):
            self._tree.add(message)
        self._suspect = []

    def next(self) -> FrameMotion:
        """Return the motion in the next run, with the static transforms of this one."""
        motion = FrameMotion(self.topic, self.frames, tuple(self._tree.static))
        for (static, _, _), transform in self._fixed.items():
            motion.add(SimpleNamespace(transforms=[transform]), static)
        return motion

    def take(self, at_end: bool = False) -> Poses:
        """
        Return the poses that are certain by now, in the order in which their transforms came.

        :param at_end: no more will come.
        """
        if at_end:
            self._settle([])
        try:
            self._tree.warnings.clear()
            chain, static = self._tree.way(self.frames)
        except ReadError as error:
            self.problem = error.problem
            return Trajectory.empty()
        dynamic = [edge for edge, _ in chain if len(self._tree.samples(edge))]
        self.problem = '' if dynamic else 'every transform between the two is static'
        if not dynamic:
            return Trajectory.empty()
        self._note_chain(chain)
        for edge in dynamic:
            self._count_changes(edge)
        self._lead(max(dynamic, key=lambda e: (self._changes[e], len(self._tree.samples(e)))))
        others = [edge for edge in dynamic if edge != self._leading]
        moving = {edge: self._recent(edge) for edge in others if self._changes[edge]}
        last = {edge: self._tree.samples(edge).poses(-1) for edge in others}
        poses = self._certain(moving, at_end)
        if not len(poses):
            return poses
        self._given_ns = max(self._given_ns, int(poses.stamps_ns.max()))
        if chain != [(self._leading, True)]:
            assert self._leading is not None
            poses = joined(chain, self._leading, poses, moving, static | last)
        self._let_go(dynamic)
        return poses

    def final(self) -> Poses:
        """
        Return the poses of the whole run.

        :raises ReadError: as :meth:`TransformTree.lookup` does.
        """
        self._tree.warnings.clear()
        poses = self._tree.lookup(self.frames)
        self.warnings = tuple(self._tree.warnings)
        if self._forgotten:
            self.warnings += (
                f'{self.topic}:{self.frames}: the first {self._forgotten} transforms of the run '
                'were too many to be kept, and are left out',
            )
        return Poses.concatenate([self._before, poses]) if len(self._before) else poses

    def _note_chain(self, chain: list[Link]) -> None:
        """Forget the transforms that are not between the two frames."""
        if chain != self._chain:
            self._chain = chain
            (first, forward), *_ = chain
            self.parent = first[0] if forward else first[1]
        self._tree.keep_only([edge for edge, _ in chain])

    def _count_changes(self, edge: Edge) -> None:
        samples, begin = self._tree.samples(edge), max(self._looked_at[edge] - 1, 0)
        self._changes[edge] += changes_of(samples.poses(begin))
        self._looked_at[edge] = len(samples)

    def _lead(self, edge: Edge) -> None:
        """Have a transform lead: the poses have its stamps from now on."""
        samples = self._tree.samples(edge)
        if edge != self._leading:
            if self._leading is not None:
                self._begins[self._leading] = 0  # it is between samples that the next poses are
            self._leading = edge
            poses = samples.poses()
            self._waiting = poses[poses.stamps_ns > self._given_ns]
        else:
            new = samples.poses(self._begins[edge])
            self._waiting = Poses.concatenate([self._waiting, new])
        self._begins[edge] = len(samples)

    def _certain(self, moving: dict[Edge, Poses], at_end: bool) -> Poses:
        """Return those of the waiting poses at whose stamps all other transforms are known."""
        stamps_ns = self._waiting.stamps_ns
        known = ready = stamps_ns == stamps_ns
        for samples in moving.values():
            known = known & (stamps_ns >= samples.stamps_ns[0])
            ready = ready & (stamps_ns <= samples.stamps_ns[-1])
        poses = self._waiting[known & ready]
        self._waiting = self._waiting[:0] if at_end else self._waiting[~ready]
        return poses

    def _recent(self, edge: Edge) -> Poses:
        return in_order(self._tree.samples(edge).poses(self._begins[edge]))

    def _let_go(self, dynamic: Sequence[Edge]) -> None:
        """Look no more at samples before the last pose; keep them for the end of the run."""
        oldest_ns = int(self._waiting.stamps_ns.min(initial=self._given_ns))
        for edge in dynamic:
            samples = self._tree.samples(edge)
            if edge != self._leading:
                stamps_ns = samples.poses(self._begins[edge]).stamps_ns
                # the last one before is the left neighbour of the next pose
                self._begins[edge] += max(int((stamps_ns <= oldest_ns).sum()) - 1, 0)
            if len(samples) > MOST_KEPT:
                count = min(len(samples) // 2, self._begins[edge])
                samples.forget(count)
                self._begins[edge] -= count
                self._looked_at[edge] -= count
                self._forgotten += count
