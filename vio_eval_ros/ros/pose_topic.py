"""A topic with poses: found out about, taken in serialised form, decoded in columns."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from rclpy.node import Node

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.health import mixed, undecodable
from vio_eval_ros.live.queues import PathQueue, Progress, RunQueue
from vio_eval_ros.live.snapshot import TopicState
from vio_eval_ros.live.timeliness import Arrivals
from vio_eval_ros.recordings import cdr
from vio_eval_ros.recordings.messages import (
    Adjustment,
    adjustment_of,
    collect,
    PATH,
    PathRevisions,
    poses,
    STREAMED,
)
from vio_eval_ros.recordings.storage import spelled
from vio_eval_ros.ros.listener import Listener

#: how long a publisher that sends nothing keeps those of another type from being heard
SILENCE_S = 1.0


class PoseTopic:
    """
    One of the inputs: finds out its type, takes its messages and hands on their poses.

    :param name: ``estimate`` or ``ground_truth``.
    :param topic: as written in a parameter, or to be remapped.
    :param msgtype: its message type; empty finds it out from the publishers.
    :raises ConfigError: a message type without poses, or a quality of service that does not exist.
    """

    def __init__(self, node: Node, name: str, topic: str, msgtype: str) -> None:
        self.name = name
        self.queue = RunQueue()
        self._listener = Listener(node, topic)
        self.topic = self._listener.topic
        self._msgtype = spelled(msgtype)
        self._type_is_given = bool(msgtype)
        self._mixed = ''  # of the run: who sent it at once
        self._received_before = 0
        self._frame = ''
        self._undecodable = 0
        self._counts_before: dict[str, int] = {}
        self._arrivals: list[Arrivals] = []
        self._adjustment: Adjustment | None = None
        if self._msgtype:
            self._subscribe(self._msgtype)

    @property
    def frame(self) -> str:
        """The frame of its poses."""
        return self._frame or 'world'

    @property
    def received(self) -> int:
        """How many messages have come."""
        return self._listener.received

    @property
    def revisions(self) -> PathRevisions | None:
        """What the messages of the run said, where they are Paths."""
        return self.queue.revisions if isinstance(self.queue, PathQueue) else None

    @property
    def silent_s(self) -> float:
        """How long nothing has come."""
        return self._listener.silent_s

    @property
    def progress(self) -> Progress:
        """How far its poses have come."""
        return Progress(self.topic, self._listener.received_s, self.queue.jump)

    @property
    def state(self) -> TopicState:
        """What is known of it."""
        listener = self._listener
        return TopicState(
            name=self.name,
            topic=self.topic,
            oldest_ns=self.queue.oldest_ns,
            newest_ns=self.queue.newest_ns,
            msgtype=self._msgtype,
            type_is_given=self._type_is_given,
            published_types=listener.published_types,
            publishers=listener.publishers,
            received=listener.received,
            incompatibility=listener.incompatibility,
            silent_s=self.silent_s,
            unstamped=self.queue.unstamped,
            jump=self.queue.jump,
            problem='',
            **self._counts,
        )

    @property
    def _counts(self) -> dict[str, int]:
        return {**self._listener.counts, 'undecodable': self._undecodable}

    def close(self) -> None:
        """Count no more events."""
        self._listener.close()

    def discover(self) -> None:
        """Look at the publishers; subscribe when the type is known, and as they offer."""
        self._listener.discover()
        self._choose_type()

    def drain(self) -> None:
        """Take all messages that have arrived; decoding them can wait."""
        self._listener.drain()

    def read(self) -> None:
        """Take all messages that have arrived, and hand their poses to the queue."""
        raw, received_ns = self._listener.take()
        self._choose_type()
        if self.received > self._received_before:
            self._mixed = mixed(self.topic, self._listener.publishers) or self._mixed
        self._received_before = self.received
        for arrived in self._decode(raw, received_ns):
            self.queue.add(arrived, self._listener.received_s)

    def resume(self, msgtype: str, poses: Poses) -> None:
        """Begin with what an evaluator before this one had received."""
        if not self._listener.is_subscribed and msgtype:
            self._subscribe(msgtype)
        self.queue.resume(poses)
        self._listener.received += len(poses)

    def release(self) -> None:
        """Hand over what is withheld: no more will come to tell what it is."""
        self.queue.release()

    def notes(self) -> list[str]:
        """Return what is missing of the run: no other figure shows what did not arrive."""
        self._listener.count_events()
        found = self._listener.missing(self._counts_before)
        bad = self._undecodable - self._counts_before.get('undecodable', 0)
        if bad:
            found.append(undecodable(bad, self.topic, self._msgtype))
        if self._mixed:
            found.append(self._mixed)
        return [f'{self.name.replace("_", " ")}: {line}' for line in found]

    def next_run(self) -> None:
        """Go on to the next run."""
        self.queue.next_run()
        self._mixed = ''
        self._listener.count_events()
        self._counts_before = dict(self._counts)

    def _decode(self, raw: list[bytes], received_ns: list[int]) -> Iterator[Poses]:
        """Yield the poses of messages; of each Path by itself."""
        if not raw:
            return
        if not self._frame:
            header = getattr(next(self._messages(raw), None), 'header', None)
            # what is adjusted is no longer in the frame of its messages
            self._frame = (header and not self._adjustment and header.frame_id) or 'world'
        if self._msgtype == PATH:
            yield from self._of_paths(raw)
            return
        found, twists = self._of_block(raw)
        if len(found) == len(raw) and received_ns[0]:
            times = np.array(received_ns, np.int64)
            self._arrivals.append(Arrivals(found, times, twists))
        yield found

    def _of_block(self, raw: list[bytes]) -> tuple[Poses, np.ndarray | None]:
        """Return the poses of messages, and their twists where the type has them."""
        if self._msgtype == cdr.ODOMETRY and (odometry := cdr.decode_odometry(raw)):
            stamps, numbers, twists = odometry
            return poses(stamps, numbers), twists
        columns = cdr.decode(self._msgtype, raw, ros1=False)
        return poses(*columns) if columns is not None else self._collected(raw), None

    def arrivals(self) -> list[Arrivals]:
        """Return what was read since the last call, and when it arrived, as far as is known."""
        arrivals, self._arrivals = self._arrivals, []
        return arrivals

    def _of_paths(self, raw: list[bytes]) -> Iterator[Poses]:
        for message in raw:
            columns = cdr.decode_path(message, ros1=False)
            revision = poses(*columns) if columns else self._collected([message])
            if len(revision):
                yield revision

    def _collected(self, raw: list[bytes]) -> Poses:
        """Return the poses of messages one by one, without those that are not of their type."""
        messages = list(self._messages(raw))
        self._undecodable += len(raw) - len(messages)
        return collect(self._msgtype, messages, self._adjustment)

    def _messages(self, raw: list[bytes]) -> Iterator[Any]:
        """Yield the messages, but for those that are not what their type says."""
        for one in raw:
            message = self._listener.deserialised(one)
            if message is not None:
                yield message

    def _choose_type(self) -> None:
        """
        Subscribe to the type that is published, where it is not given.

        A publisher that has sent nothing does not stand in the way of one of another type.
        """
        if self._type_is_given or self.received:
            return
        scorable = [msgtype for msgtype in self._listener.published_types if msgtype in STREAMED]
        others = [msgtype for msgtype in scorable if msgtype != self._msgtype]
        listener = self._listener
        is_silent = self._msgtype not in scorable or listener.subscribed_for_s > SILENCE_S
        if len(others) == 1 and (not listener.is_subscribed or is_silent):
            self._subscribe(others[0])

    def _subscribe(self, msgtype: str) -> None:
        """Subscribe to a type, in place of what was subscribed to before."""
        if msgtype not in STREAMED:
            raise ConfigError(
                f'{self.name}_type: {msgtype} carries no pose that can be scored live; types that '
                f'do are {", ".join(STREAMED)}'
            )
        self._listener.subscribe(msgtype)
        self._msgtype = msgtype
        self.queue = PathQueue(self.topic) if msgtype == PATH else RunQueue()
        self._adjustment = adjustment_of(msgtype)
