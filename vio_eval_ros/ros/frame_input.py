"""The motion between two frames of a TF tree, as an input beside topics with poses."""

from __future__ import annotations

from collections import deque
import time
from typing import Any, TypeAlias

from rclpy.node import Node

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.live.frames import FrameMotion
from vio_eval_ros.live.queues import Progress, RunQueue
from vio_eval_ros.live.snapshot import TopicState
from vio_eval_ros.live.timeliness import Arrivals
from vio_eval_ros.recordings.transforms import Edge, edge_of
from vio_eval_ros.ros.listener import Listener
from vio_eval_ros.ros.pose_topic import PoseTopic

TF_MESSAGE = 'tf2_msgs/msg/TFMessage'


class TransformTopic:
    """
    A TF topic with the static topics that go with it, for all inputs that read frames of it.

    :param topic: ``/tf``, or one in a namespace, such as ``/robot1/tf``.
    :raises ConfigError: tf2_msgs is not installed; a quality of service that does not exist.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self.dynamic = Listener(node, topic)
        names = dict.fromkeys([f'{self.dynamic.topic}_static', '/tf_static'])
        self.static = {name: Listener(node, name) for name in names}
        self.undecodable = 0
        #: transforms that the node itself publishes
        self.ignored: set[Edge] = set()
        self._inboxes: list[deque[tuple[Any, str]]] = []
        for listener in (self.dynamic, *self.static.values()):
            listener.subscribe(TF_MESSAGE)

    @property
    def listeners(self) -> list[Listener]:
        """All that are listened to; the static ones come first: they connect the others."""
        return [*self.static.values(), self.dynamic]

    def inbox(self) -> deque[tuple[Any, str]]:
        """Return where all messages will arrive, each with its static topic, if it has one."""
        inbox: deque[tuple[Any, str]] = deque()
        self._inboxes.append(inbox)
        return inbox

    def read(self) -> None:
        """Put what has arrived into the inboxes."""
        for listener in self.listeners:
            static = '' if listener is self.dynamic else listener.topic
            for raw in listener.take()[0]:
                message = listener.deserialised(raw)
                self.undecodable += message is None
                if self.ignored and message is not None:
                    transforms = message.transforms
                    message.transforms = [t for t in transforms if edge_of(t) not in self.ignored]
                for inbox in self._inboxes if message is not None else ():
                    inbox.append((message, static))


class FrameInput:
    """
    The poses of one frame in another; an input as :class:`PoseTopic` is.

    :param name: ``estimate`` or ``ground_truth``.
    :param frames: 'PARENT.CHILD'.
    """

    def __init__(self, name: str, transforms: TransformTopic, frames: str) -> None:
        self.name = name
        self.topic = f'{transforms.dynamic.topic}:{frames}'
        self.queue = RunQueue()
        #: how many poses have come
        self.received = 0
        self._received_s = time.monotonic()
        self._transforms = transforms
        self._inbox = transforms.inbox()
        self._motions = deque(
            [FrameMotion(transforms.dynamic.topic, frames, tuple(transforms.static))]
        )
        self._counts_before: dict[str, int] = {}

    @property
    def frame(self) -> str:
        """The frame of its poses."""
        return self._motions[0].parent or 'world'

    @property
    def _problem(self) -> str:
        """Why there are no poses of the two frames, though there are transforms."""
        problem = self._motions[-1].problem if self._transforms.dynamic.received else ''
        return f'{self.topic}: {problem}' if problem else ''

    @property
    def revisions(self) -> FrameMotion:
        """The motion in the whole run, as it is known by now."""
        return self._motions[0]

    @property
    def silent_s(self) -> float:
        """How long no pose has come."""
        return time.monotonic() - self._received_s

    @property
    def progress(self) -> Progress:
        """How far its poses have come."""
        return Progress(self.topic, self._received_s, self.queue.jump)

    @property
    def state(self) -> TopicState:
        """What is known of it."""
        dynamic = self._transforms.dynamic
        return TopicState(
            name=self.name,
            topic=self.topic,
            oldest_ns=self.queue.oldest_ns,
            newest_ns=self.queue.newest_ns,
            msgtype=TF_MESSAGE,
            type_is_given=True,
            published_types=(),
            publishers=dynamic.publishers,
            received=self.received,
            incompatibility=dynamic.incompatibility,
            silent_s=self.silent_s,
            unstamped=self.queue.unstamped,
            jump=self.queue.jump,
            problem=self._problem,
            **self._counts,
        )

    @property
    def _counts(self) -> dict[str, int]:
        return {**self._transforms.dynamic.counts, 'undecodable': self._transforms.undecodable}

    def close(self) -> None:
        """Count no more events."""
        for listener in self._transforms.listeners:
            listener.close()

    def discover(self) -> None:
        """Look at the publishers; subscribe as they offer."""
        for listener in self._transforms.listeners:
            listener.discover()

    def drain(self) -> None:
        """Take all messages that have arrived."""
        for listener in self._transforms.listeners:
            listener.drain()

    def read(self) -> None:
        """Hand what has become certain of the poses to the queue."""
        self._transforms.read()
        while self._inbox:
            message, static = self._inbox.popleft()
            motion = self._motions[-1]
            jumped = motion.add(message, static)
            if jumped:
                self._hand_over(motion.take(at_end=True))
                self._motions.append(jumped)
        self._hand_over(self._motions[-1].take())

    def arrivals(self) -> list[Arrivals]:
        """Return nothing: a pose of several transforms has no time of arrival of its own."""
        return []

    def resume(self, msgtype: str, poses: Poses) -> None:
        """Begin with what an evaluator before this one had received."""
        self._motions[0].resume(poses)
        self.queue.resume(poses)
        self.received += len(poses)

    def release(self) -> None:
        """Hand over what waits for other transforms: no more will come."""
        self._hand_over(self._motions[0].take(at_end=True))
        self.queue.release()

    def notes(self) -> list[str]:
        """Return what is missing of the run."""
        dynamic = self._transforms.dynamic
        dynamic.count_events()
        found = dynamic.missing(self._counts_before)
        return [f'{self.name.replace("_", " ")}: {line}' for line in found]

    def next_run(self) -> None:
        """Go on to the next run."""
        self.queue.next_run()
        motion = self._motions.popleft()
        if not self._motions:
            self._motions.append(motion.next())
        self._counts_before = dict(self._counts)

    def _hand_over(self, poses: Poses) -> None:
        if len(poses):
            self._received_s = time.monotonic()
            self.received += len(poses)
            self.queue.add(poses, self._received_s)


Input: TypeAlias = PoseTopic | FrameInput
