"""The motion between two frames, chained through a recorded TF tree."""

from __future__ import annotations

from array import array
from collections import defaultdict, deque
from collections.abc import Collection, Iterable, Mapping, Sequence
import difflib
import itertools
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.interleaving import interleaving
from vio_eval_ros.core.interpolation import interpolated
from vio_eval_ros.core.rotation import conjugate, multiply, normalize, rotate
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.messages import from_transform_stamped

TF_TYPES = ('tf2_msgs/msg/TFMessage', 'tf/msg/tfMessage')
FOXGLOVE_TF = tuple(
    f'{package}FrameTransform{ending}'
    for package in ('foxglove.', 'foxglove_msgs/msg/')
    for ending in ('', 's')
)
TREE_TYPES = (*TF_TYPES, *FOXGLOVE_TF)


def as_transforms(message: Any) -> Any:
    """Return a FrameTransform of Foxglove, or several, as a TFMessage."""
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=SimpleNamespace(stamp=one.timestamp, frame_id=one.parent_frame_id),
                child_frame_id=one.child_frame_id,
                transform=one,
            )
            for one in getattr(message, 'transforms', [message])
        ]
    )


Edge = tuple[str, str]  # parent and child frame
Link = tuple[Edge, bool]  # an edge of a chain, and whether it is passed forward


def edge_of(transform: Any) -> Edge:
    """Return the two frames of a TransformStamped."""
    # tf2 knows no leading slashes, ROS 1 recordings still have them
    return transform.header.frame_id.lstrip('/'), transform.child_frame_id.lstrip('/')


#: what changes by no more, in metres and in numbers of its unit quaternion, is constant
UNMOVED = 1e-6
#: a transform that moves and is known less often than this is said to be interpolated [s]
LONG_GAP_S = 2.0
#: of more frames, a message has only the first
LISTED_FRAMES = 40
#: how alike two names are that may mean the same frame
ALIKE = 0.75


class Rigid(NamedTuple):
    """Transforms T_parent_child: (N, 3) translations and (N, 4) unit quaternions."""

    translations: np.ndarray
    rotations: np.ndarray

    def __matmul__(self, other: Rigid) -> Rigid:
        """Return T_a_c of T_a_b and T_b_c."""
        return Rigid(
            self.translations + rotate(self.rotations, other.translations),
            multiply(self.rotations, other.rotations),
        )

    def inverse(self) -> Rigid:
        """Return T_child_parent."""
        rotations = conjugate(self.rotations)
        return Rigid(-rotate(rotations, self.translations), rotations)


class Samples:
    """The transforms of one edge of the tree, in the order in which they were recorded."""

    def __init__(self) -> None:
        self._stamps = array('q')
        self._numbers = array('d')

    def __len__(self) -> int:
        return len(self._stamps)

    def append(self, transform: Any, recorded_ns: int | None = None) -> None:
        """Take the stamp, or the time of recording in its place, and numbers of a transform."""
        ((stamp_ns, numbers),) = from_transform_stamped(transform)
        self._stamps.append(stamp_ns if recorded_ns is None else recorded_ns)
        self._numbers.extend(numbers)

    def poses(self, begin: int = 0) -> Poses:
        """
        Return the transforms as poses of the child in the parent.

        :param begin: the first of them; -1 is the last.
        """
        numbers = np.array(self._numbers[7 * begin :], float).reshape(-1, 7)
        positions, rotations = numbers[:, :3].copy(), numbers[:, 3:].copy()
        stamps_ns = np.array(self._stamps[begin:], np.int64)
        return Poses(stamps_ns, positions, rotations, zero_is_unset=True)

    def forget(self, count: int) -> None:
        """Drop the first of the transforms."""
        del self._stamps[:count]
        del self._numbers[: 7 * count]


class TransformTree:
    """
    The transforms of a TF topic and of the static topics that go with it.

    :param topic: the name of the dynamic topic, for messages to the user.
    :param static: the names of the static topics, the nearest first. A farther one is asked only
        where the nearer ones do not connect two frames: of several robots, each has its own.
    """

    def __init__(self, topic: str = '/tf', static: Sequence[str] = ()) -> None:
        self._topic = topic
        self._dynamic: dict[Edge, Samples] = defaultdict(Samples)
        self._static: dict[str, dict[Edge, Samples]] = {
            name: defaultdict(Samples) for name in static
        }
        self.warnings: list[str] = []

    def add(self, message: Any, static: str = '', recorded_ns: int | None = None) -> None:
        """
        Take the transforms of a TFMessage.

        :param static: the static topic that it came on, if it came on one.
        :param recorded_ns: when it was recorded, where that takes the place of its stamps.
        """
        edges = self._static[static] if static else self._dynamic
        for transform in message.transforms:
            edges[edge_of(transform)].append(transform, recorded_ns)

    def sent(self) -> dict[str, Poses]:
        """Return what came of each transform, by 'PARENT.CHILD', but on static topics."""
        return {_name(edge): samples.poses() for edge, samples in sorted(self._dynamic.items())}

    @property
    def static(self) -> Sequence[str]:
        """The names of the static topics."""
        return tuple(self._static)

    def samples(self, edge: Edge) -> Samples:
        """Return what came of a transform, but on static topics; nothing where none did."""
        return self._dynamic.get(edge) or Samples()

    def keep_only(self, edges: Collection[Edge]) -> None:
        """Forget what came of all other transforms, but for the last of each: it connects."""
        for edge, samples in self._dynamic.items():
            if edge not in edges:
                samples.forget(len(samples) - 1)

    def main_motion(self) -> str | None:
        """
        Return the transform that changes most often as 'PARENT.CHILD', from the root of its tree.

        None where none changes.
        """
        changes = {edge: changes_of(samples.poses()) for edge, samples in self._dynamic.items()}
        moving = max(changes, key=lambda edge: changes[edge], default=None)
        if moving is None or not changes[moving]:
            return None
        edges = [*itertools.chain.from_iterable(self._static.values()), *self._dynamic]
        parents = {child: parent for parent, child in edges}
        root, child = moving
        passed = {root, child}
        while root in parents and parents[root] not in passed:
            root = parents[root]
            passed.add(root)
        return f'{root}.{child}'

    def lookup(self, frames: str) -> Poses:
        """
        Return the poses of CHILD in PARENT.

        They have the stamps of the transform on the way from one frame to the other that changes
        most often; a correction, for one, is sent again and again between its changes. The others
        that change are interpolated as tf2 does (linearly, the rotation on the shorter arc), and
        stamps at which one of them is not known yet or no longer are left out. One that never
        changes is static, whatever topic it came on and however often. ``warnings`` has a line
        for whatever was left out or assumed.

        :param frames: 'PARENT.CHILD'; frames may themselves contain dots.
        :raises ReadError: unknown or unconnected frames, or nothing between them that moves; of
            several transforms between them, one that two publishers send in turn.
        """
        source = f'{self._topic}:{frames}'
        chain, static = self.way(frames)
        sent = {edge: self._dynamic[edge].poses() for edge, _ in chain if edge in self._dynamic}
        if not sent:
            raise ReadError(source, 'every transform between the two is static: nothing moves')
        changes = {edge: changes_of(samples) for edge, samples in sent.items()}
        if len(sent) > 1:  # of one alone, whoever scores it sees as much
            _refuse_mixed(source, {edge: sent[edge] for edge in sent if changes[edge]})
        leading = max(sent, key=lambda edge: (changes[edge], len(sent[edge])))
        if not changes[leading]:
            self.warnings.append(f'{source}: nothing moves: {_name(leading)} never changes')
        poses = sent.pop(leading)
        if chain == [(leading, True)]:
            return poses

        moving = {edge: in_order(sent[edge]) for edge in sent if changes[edge]}
        poses = self._while_known(source, poses, moving)
        for edge, samples in sent.items():
            if edge in moving:
                self._warn_of_gaps(source, edge, moving[edge], poses)
            else:
                self._warn_of_constant(source, edge, samples, poses)
        return joined(chain, leading, poses, moving, static | sent)

    def way(self, frames: str) -> tuple[list[Link], dict[Edge, Poses]]:
        """
        Return the links from one frame to the other, and the static transforms among them.

        :param frames: 'PARENT.CHILD'.
        :raises ReadError: unknown or unconnected frames.
        """
        source = f'{self._topic}:{frames}'
        return self._chain(source, *self._split(source, frames))

    def _while_known(self, source: str, poses: Poses, moving: Mapping[Edge, Poses]) -> Poses:
        """Return the poses at whose stamps all other transforms that move are known."""
        known = np.ones(len(poses), bool)
        for other in moving.values():
            known &= poses.stamps_ns >= other.stamps_ns[0]
            known &= poses.stamps_ns <= other.stamps_ns[-1]
        if not known.any():
            spans = ', '.join(f'{_name(edge)} {_span(each)}' for edge, each in moving.items())
            raise ReadError(
                source,
                'the transforms between the two are never known at the same time: '
                f'{spans}, the other {_span(poses)}',
            )
        if known.all():
            return poses
        self.warnings.append(
            f'{source}: left out {np.count_nonzero(~known)} of {len(known)} poses, at whose '
            'stamps another transform between the two is not known yet or any more '
            f'({", ".join(map(_name, moving))})'
        )
        return poses[known]

    def _warn_of_gaps(self, source: str, edge: Edge, samples: Poses, poses: Poses) -> None:
        """Say of a transform that moves for how many poses it is not known from nearby."""
        gaps_s = np.diff(samples.stamps_ns) / 1e9
        after = np.searchsorted(samples.stamps_ns, poses.stamps_ns)  # all are known
        between = samples.stamps_ns[after] != poses.stamps_ns
        between &= np.append(0.0, gaps_s)[after] > LONG_GAP_S
        if between.any():
            self.warnings.append(
                f'{source}: {_name(edge)} is interpolated over up to {gaps_s.max():.3g} s, for '
                f'{np.count_nonzero(between)} of {len(poses)} poses: where it jumps, as a '
                'correction does, they are wrong'
            )

    def _warn_of_constant(self, source: str, edge: Edge, samples: Poses, poses: Poses) -> None:
        """Say of a transform that came as if it moved what was assumed of it."""
        name = _name(edge)
        if len(samples) == 1:
            self.warnings.append(
                f'{source}: {name} came only once, at {samples.stamps_ns[0] / 1e9:.2f} s; it is '
                'used as a constant, as if it were static'
            )
            return
        stamps_ns = poses.stamps_ns
        outside = (stamps_ns < samples.stamps_ns.min()) | (stamps_ns > samples.stamps_ns.max())
        if outside.any():
            self.warnings.append(
                f'{source}: {name} never changes and is used as a constant, also for '
                f'{np.count_nonzero(outside)} of {len(poses)} poses before it came first or after '
                'it came last'
            )

    def _split(self, source: str, frames: str) -> Edge:
        """Return the two frames, split at the dot that leaves a known one on either side."""
        edges = [edge for group in (self._dynamic, *self._static.values()) for edge in group]
        known = {frame for edge in edges for frame in edge}
        dots = [i for i, letter in enumerate(frames) if letter == '.']
        splits = [(frames[:i].lstrip('/'), frames[i + 1 :].lstrip('/')) for i in dots]
        matching = [split for split in splits if known.issuperset(split)]
        if len(matching) == 1:
            return matching[0]
        listed = f'there are: {_listed(known)}'
        if matching or not splits:
            raise ReadError(source, f'expected PARENT.CHILD of two known frames; {listed}')
        # where one side is known, the other is the name that is wrong
        unknown = min(([f for f in split if f not in known] for split in splits), key=len)
        near = ''.join(nearest_name(frame, known) for frame in unknown)
        names = ' and '.join(f"'{frame}'" for frame in unknown)
        which = f'frame {names}' if len(unknown) == 1 else f'frames {names}'
        raise ReadError(source, f'there is no {which}; {listed}{self._without_static()}{near}')

    def _chain(self, source: str, parent: str, child: str) -> tuple[list[Link], dict[Edge, Poses]]:
        """Return the links from one frame to the other, and the static ones among them."""
        static: dict[Edge, Samples] = {}
        reached: dict[str, Link | None] = {}
        for name in self._static or ('',):
            static = {**self._static.get(name, {}), **static}
            reached = _reached([*self._dynamic, *static], parent)
            if child in reached:
                chain = _links_to(child, reached)
                if not f'{self._topic}_static'.endswith(name):  # of another name or namespace
                    self.warnings.append(f'{source}: the static transforms are those of {name}')
                fixed = {edge: static[edge].poses() for edge, _ in chain if edge in static}
                self.warnings += [
                    f'{source}: the static {_name(edge)} came with different values; the last is '
                    'used'
                    for edge, samples in fixed.items()
                    if changes_of(samples)
                ]
                return chain, fixed
        others = _reached([*self._dynamic, *static], child)
        raise ReadError(
            source,
            f'no transforms connect the two: {parent} is connected with {_rest(parent, reached)} '
            f'and {child} with {_rest(child, others)}, but the one between these is missing'
            f'{self._without_static()}{_alike([*reached], [*others])}',
        )

    def _without_static(self) -> str:
        return '' if self._static else '; no static transforms were recorded'


def joined(
    chain: Iterable[Link],
    leading: Edge,
    poses: Poses,
    moving: Mapping[Edge, Poses],
    fixed: Mapping[Edge, Poses],
) -> Poses:
    """
    Return the poses at the end of a chain, at the stamps of the transform that leads it.

    :param poses: of the leading transform.
    :param moving: samples in order of the others that move, around these stamps.
    :param fixed: those that do not; the last sample of each counts.
    """
    whole = Rigid(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    with np.errstate(invalid='ignore', over='ignore'):  # cleaning counts what is not finite
        for edge, forward in chain:
            if edge == leading:
                transform = _rigid(poses)
            elif edge in moving:
                transform = _interpolate(moving[edge], poses.stamps_ns)
            else:
                transform = _rigid(fixed[edge][-1:])
            whole = whole @ (transform if forward else transform.inverse())
    return Poses(poses.stamps_ns, *whole, zero_is_unset=True)


def static_topics(topic: str, names: Iterable[str]) -> list[str]:
    """
    Return the names of those TF topics that are static, those that go best with one first.

    That is the one in the same namespace, then in the namespaces around it, then any other; one
    that was remapped still says in its name that it is static.
    """
    namespace, _, _ = topic.rpartition('/')

    def distance(name: str) -> tuple[bool, int, bool, str]:
        around, _, _ = name.rpartition('/')
        is_around = f'{namespace}/'.startswith(f'{around}/')
        return not is_around, -len(around), name != f'{topic}_static', name

    return sorted((n for n in names if 'static' in n.rpartition('/')[2].lower()), key=distance)


def _reached(edges: Iterable[Edge], frame: str) -> dict[str, Link | None]:
    """Return the frames that one is connected with, each with the last of the fewest links."""
    neighbours = defaultdict(list)
    for edge in edges:
        neighbours[edge[0]].append((edge[1], edge, True))
        neighbours[edge[1]].append((edge[0], edge, False))
    reached: dict[str, Link | None] = {frame: None}
    queue = deque([frame])
    while queue:
        frame = queue.popleft()
        for neighbour, edge, forward in neighbours[frame]:
            if neighbour not in reached:
                reached[neighbour] = edge, forward
                queue.append(neighbour)
    return reached


def _links_to(frame: str, reached: Mapping[str, Link | None]) -> list[Link]:
    """Return the links on the way to a frame."""
    links = []
    while link := reached[frame]:
        links.append(link)
        (parent, child), forward = link
        frame = parent if forward else child
    return links[::-1]


def changes_of(poses: Poses) -> int:
    """Return how many of the samples differ from the one before, beyond rounding."""
    samples = _rigid(poses)
    columns = np.hstack([samples.translations, samples.rotations])
    finite = columns[np.isfinite(columns).all(axis=1)]
    if not len(finite):
        return len(poses)
    changed = int(np.count_nonzero(_differ(finite[1:], finite[:-1])))
    return changed or int(_differ(finite, finite[:1]).any())  # as slowly as that


def _differ(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return (N,) whether (N, 7) translations and unit quaternions, of either sign, differ."""
    moved = np.abs(one[:, :3] - other[:, :3]).max(axis=1)
    turned = np.abs(one[:, 3:] - other[:, 3:]).max(axis=1)
    turned_back = np.abs(one[:, 3:] + other[:, 3:]).max(axis=1)
    return np.asarray(np.maximum(moved, np.minimum(turned, turned_back)) > UNMOVED)


def _refuse_mixed(source: str, sent: Mapping[Edge, Poses]) -> None:
    """Raise ``ReadError`` where two publishers send one transform in turn, with two values."""
    for edge, samples in sent.items():
        found = interleaving(samples)
        if found is not None:
            raise ReadError(
                source, f'{_name(edge)}: {found}; stop one of them, or give it frames of its own'
            )


def _name(edge: Edge) -> str:
    return '.'.join(edge)


def _span(poses: Poses) -> str:
    return f'{poses.stamps_ns.min() / 1e9:.2f} to {poses.stamps_ns.max() / 1e9:.2f} s'


def _listed(frames: Iterable[str]) -> str:
    names = sorted(frames)
    more = f' and {len(names) - LISTED_FRAMES} more' if len(names) > LISTED_FRAMES else ''
    return (', '.join(names[:LISTED_FRAMES]) or 'none') + more


def _rest(frame: str, frames: Iterable[str]) -> str:
    """Return what a frame is connected with, in words."""
    others = set(frames) - {frame}
    return _listed(others) if others else 'nothing'


def _alike(frames: Sequence[str], others: Sequence[str]) -> str:
    """Return which two frames may be one that is spelled in two ways; nothing where none are."""
    pairs = itertools.product(frames[:LISTED_FRAMES], others[:LISTED_FRAMES])
    one, other = max(pairs, key=_likeness)
    return f"; are '{one}' and '{other}' the same?" if _likeness((one, other)) > ALIKE else ''


def _likeness(frames: Edge) -> float:
    """Return how alike two frames are, from 0 to 1; what comes before a slash does not count."""
    one, other = (frame.rpartition('/')[2] for frame in frames)
    return difflib.SequenceMatcher(None, one, other).ratio()


def in_order(poses: Poses) -> Poses:
    """Return the poses sorted by stamp, the first of equal ones."""
    return poses[np.unique(poses.stamps_ns, return_index=True)[1]]


def _rigid(poses: Poses) -> Rigid:
    assert poses.rotations is not None
    return Rigid(poses.positions, normalize(poses.rotations))


def _interpolate(samples: Poses, stamps_ns: np.ndarray) -> Rigid:
    """Return the transforms at stamps within the time span of samples in order."""
    known = _rigid(samples)
    if len(samples) == 1:
        return known
    poses = interpolated(Poses(samples.stamps_ns, *known), stamps_ns)
    assert poses.rotations is not None
    return Rigid(poses.positions, poses.rotations)
