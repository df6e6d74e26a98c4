"""The motion between two frames, chained through a recorded TF tree."""

from __future__ import annotations

from array import array
from collections import defaultdict, deque
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core.interpolation import interpolated
from vio_eval_ros.core.rotation import conjugate, multiply, normalize, rotate
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.messages import from_transform_stamped

TF_TYPES = ('tf2_msgs/msg/TFMessage', 'tf/msg/tfMessage')

Edge = tuple[str, str]  # parent and child frame


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

    def poses(self) -> Poses:
        """Return the transforms as poses of the child in the parent."""
        numbers = np.array(self._numbers).reshape(-1, 7)
        positions, rotations = numbers[:, :3].copy(), numbers[:, 3:].copy()
        return Poses(np.array(self._stamps), positions, rotations, zero_is_unset=True)


class TransformTree:
    """
    The transforms of a TF topic and its static twin.

    :param topic: the name of the dynamic topic, for messages to the user.
    """

    def __init__(self, topic: str = '/tf') -> None:
        self._topic = topic
        self._dynamic: dict[Edge, Samples] = defaultdict(Samples)
        self._static: dict[Edge, Samples] = defaultdict(Samples)
        self.warnings: list[str] = []

    def add(self, message: Any, static: bool, recorded_ns: int | None = None) -> None:
        """
        Take the transforms of a TFMessage.

        :param recorded_ns: when it was recorded, where that takes the place of its stamps.
        """
        edges = self._static if static else self._dynamic
        for transform in message.transforms:
            # tf2 knows no leading slashes, ROS 1 recordings still have them
            parent = transform.header.frame_id.lstrip('/')
            edges[parent, transform.child_frame_id.lstrip('/')].append(transform, recorded_ns)

    def lookup(self, frames: str) -> Poses:
        """
        Return the poses of CHILD in PARENT.

        They have the stamps of the moving transform on the way from one frame to the other; of
        several, of the one with the most samples. The others are then interpolated as tf2 does
        (linearly, the rotation on the shorter arc), and stamps at which one of them is not known
        yet or no longer are left out, with a line in ``warnings``.

        :param frames: 'PARENT.CHILD'; frames may themselves contain dots.
        :raises ReadError: unknown or unconnected frames, or nothing between them that moves.
        """
        source = f'{self._topic}:{frames}'
        chain = self._chain(source, *self._split(source, frames))
        moving = [edge for edge, _ in chain if edge in self._dynamic]
        if not moving:
            raise ReadError(source, 'every transform between the two is static: nothing moves')
        leading = max(moving, key=lambda edge: len(self._dynamic[edge]))
        poses = self._dynamic[leading].poses()
        if chain == [(leading, True)]:
            return poses

        moving.remove(leading)
        others = {edge: _in_order(self._dynamic[edge].poses()) for edge in moving}
        known = np.ones(len(poses), bool)
        for other in others.values():
            known &= poses.stamps_ns >= other.stamps_ns[0]
            known &= poses.stamps_ns <= other.stamps_ns[-1]
        if not known.any():
            raise ReadError(
                source, 'the transforms between the two are never known at the same time'
            )
        if not known.all():
            self.warnings.append(
                f'{source}: left out {np.count_nonzero(~known)} of {len(known)} poses, at whose '
                'stamps another transform between the two is not known yet or any more'
            )
            poses = poses[known]

        joined = Rigid(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        with np.errstate(invalid='ignore', over='ignore'):  # cleaning counts what is not finite
            for edge, forward in chain:
                if edge == leading:
                    transform = _rigid(poses)
                elif edge in others:
                    transform = _interpolate(others[edge], poses.stamps_ns)
                else:
                    transform = _rigid(self._static[edge].poses()[-1:])
                joined = joined @ (transform if forward else transform.inverse())
        return Poses(poses.stamps_ns, *joined, zero_is_unset=True)

    def _split(self, source: str, frames: str) -> Edge:
        """Return the two frames, split at the dot that leaves a known one on either side."""
        known = {frame for edge in (*self._dynamic, *self._static) for frame in edge}
        dots = [i for i, letter in enumerate(frames) if letter == '.']
        splits = [(frames[:i].lstrip('/'), frames[i + 1 :].lstrip('/')) for i in dots]
        matching = [split for split in splits if known.issuperset(split)]
        if len(matching) != 1:
            listed = ', '.join(sorted(known)) or 'none'
            raise ReadError(
                source, f'expected PARENT.CHILD of two known frames; there are: {listed}'
            )
        return matching[0]

    def _chain(self, source: str, parent: str, child: str) -> list[tuple[Edge, bool]]:
        """Return the edges from one frame to the other, and whether each is passed forward."""
        neighbours = defaultdict(list)
        for edge in (*self._dynamic, *self._static):
            neighbours[edge[0]].append((edge[1], edge, True))
            neighbours[edge[1]].append((edge[0], edge, False))
        chains: dict[str, list[tuple[Edge, bool]]] = {parent: []}
        queue = deque([parent])
        while queue and child not in chains:  # breadth first: the fewest edges
            frame = queue.popleft()
            for neighbour, edge, forward in neighbours[frame]:
                if neighbour not in chains:
                    chains[neighbour] = [*chains[frame], (edge, forward)]
                    queue.append(neighbour)
        if child not in chains:
            reached = ', '.join(sorted(chains))
            raise ReadError(source, f'no transforms connect the two; {parent} reaches {reached}')
        return chains[child]


def _in_order(poses: Poses) -> Poses:
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
