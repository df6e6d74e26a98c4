"""A topic with poses: found out about, taken in serialised form, decoded in columns."""

from __future__ import annotations

import importlib
import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message

from vio_eval_ros.core.association import BEFORE_ALL
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings import cdr
from vio_eval_ros.recordings.messages import collect, CONVERTERS, PATH, PathRevisions, poses

# more than any sensor sends between two looks
DEPTH = 5000


class Polled(CallbackGroup):
    """
    What the executor leaves alone.

    Waking up for a message costs rclpy some 200 µs; taking many at a timer costs next to nothing.
    """

    def can_execute(self, entity: Any) -> bool:
        """Return False: the owner takes the messages itself."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False, likewise."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class Stream:
    """
    One of the two inputs.

    :param name: ``estimate`` or ``ground_truth``; remap it to the topic.
    :param msgtype: its message type; empty finds it out from the publishers.
    :raises ConfigError: a message type without poses, or one that is not installed.
    """

    def __init__(self, node: Node, name: str, msgtype: str) -> None:
        self.name = name
        self.topic = node.resolve_topic_name(name)
        self.msgtype = msgtype
        self.frame = 'world'
        self.trouble = ''
        self.publishers = 0
        self.received = 0
        self.lost = 0
        self.incompatible = 0
        self.left_over = 0
        self.newest_ns = BEFORE_ALL
        self.ignore_from_ns: int | None = None
        self.path: PathRevisions | None = None
        self._node = node
        self._raw: list[bytes] = []
        self._class: Any = None
        self._subscription: Any = None
        self._last_received = time.monotonic()
        if msgtype:
            self._subscribe()

    def discover(self) -> None:
        """Look at the publishers; subscribe as soon as their type is known."""
        found = self._node.get_publishers_info_by_topic(self.topic)
        self.publishers = len(found)
        types = sorted({info.topic_type for info in found})
        self.trouble = self._trouble_with(types)
        if self._subscription is None and len(types) == 1 and not self.trouble:
            self.msgtype = types[0]
            self._subscribe()
        if self._subscription is not None and not self.trouble:
            profile = self._subscription.qos_profile
            for info in found:
                verdict, reason = qos_check_compatible(info.qos_profile, profile)
                if verdict == QoSCompatibility.ERROR:
                    self.trouble = f'incompatible QoS on {self.topic}: {" ".join(reason.split())}'

    def drain(self) -> None:
        """Take all messages that have arrived."""
        if self._subscription is None:
            return
        taken = len(self._raw)
        with self._subscription.handle:
            take = self._subscription.handle.take_message
            while (message := take(self._class, True)) is not None:
                self._raw.append(message[0])
                if len(self._raw) - taken >= DEPTH:
                    break
        if len(self._raw) > taken:
            self.received += len(self._raw) - taken
            self._last_received = time.monotonic()

    def decode(self) -> Poses | None:
        """Return the poses of the messages taken since the last call; None of none."""
        raw, self._raw = self._raw, []
        if not raw:
            return None
        if self.frame == 'world':
            header = deserialize_message(raw[0], self._class).header
            self.frame = header.frame_id or 'world'
        if self.msgtype == PATH:
            return self._of_paths(raw)
        columns = cdr.decode(self.msgtype, raw, ros1=False)
        if columns is not None:
            return poses(*columns)
        return collect(self.msgtype, (deserialize_message(one, self._class) for one in raw))

    def silent_s(self) -> float:
        """Return for how long nothing has come."""
        return time.monotonic() - self._last_received

    def restart(self) -> None:
        """Expect the stream to begin again; what is still under way from before is left over."""
        self.ignore_from_ns = self.newest_ns if self.newest_ns != BEFORE_ALL else None
        self.newest_ns = BEFORE_ALL
        self.path = None

    def _of_paths(self, raw: list[bytes]) -> Poses:
        """Return the poses as first published; ``path`` knows how they were revised since."""
        if self.path is None:
            self.path = PathRevisions(self.topic)
        new = []
        for message in raw:
            columns = cdr.decode_path(message, ros1=False)
            revision = (
                poses(*columns)
                if columns is not None
                else collect(PATH, [deserialize_message(message, self._class)])
            )
            new.append(self.path.add(revision))
        return Poses.concatenate(new)

    def _subscribe(self) -> None:
        if self.msgtype not in CONVERTERS:
            raise ConfigError(
                f'{self.name}_type: {self.msgtype} carries no pose; types that do are '
                f'{", ".join(CONVERTERS)}'
            )
        package, _, name = self.msgtype.split('/')
        self._class = getattr(importlib.import_module(f'{package}.msg'), name)
        self._subscription = self._node.create_subscription(
            self._class,
            self.topic,
            lambda message: None,
            QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
            callback_group=Polled(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            raw=True,
        )
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._on_incompatible, message_lost=self._on_lost
        )
        for handler in events.create_event_handlers(
            self._node.default_callback_group, self._subscription.handle, self.topic
        ):
            self._node.add_waitable(handler)

    def _on_incompatible(self, event: Any) -> None:
        self.incompatible = event.total_count

    def _on_lost(self, event: Any) -> None:
        self.lost = event.total_count

    def _trouble_with(self, types: list[str]) -> str:
        if len(types) > 1:
            return f'publishers of different types on {self.topic}: {" and ".join(types)}'
        if types and self.msgtype and types[0] != self.msgtype:
            return f'{self.topic} is published as {types[0]}, not {self.msgtype}'
        if types and types[0] not in CONVERTERS:
            return f'{self.topic} carries {types[0]}, which has no pose that can be scored'
        if self.publishers > 1:
            return f'{self.publishers} publishers on {self.topic}: their poses are mixed'
        return ''
