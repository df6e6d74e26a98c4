"""The node that publishes recorded messages when they are due."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
import importlib
from itertools import chain, islice
import math
import os
from pathlib import Path
import signal
from tempfile import TemporaryDirectory
from threading import Semaphore, Thread
import time
from typing import NamedTuple

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.audience import Audience
from vio_eval_ros.recordings.playback import TimedMessage
from vio_eval_ros.recordings.storage import OfferedQos
from vio_eval_ros.ros.context import join

TICK_S = 0.01  # of /clock while no message is due
MIN_TICK_S = 0.001  # of /clock in a burst of messages
LATE_S = 0.2  # a longer delay is reported
FLUSH_S = 5.0  # for subscribers to acknowledge the last messages
# A recorded depth suited the pace of the robot. These also hold bursts that make up for a delay,
# and take memory only while a subscriber lags: as much for images as for all else.
DEPTH, IMAGE_DEPTH = 5000, 100
IMAGES = ('Image', 'CompressedImage', 'PointCloud2')

# Fast DDS allocates 512 kB of shared memory, too little for two of EuRoC's images: they then came
# a second late or, at times, not at all. Only the publisher needs more.
TRANSPORTS = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>shm</transport_id>
        <type>SHM</type>
        <segment_size>33554432</segment_size>
      </transport_descriptor>
      <transport_descriptor>
        <transport_id>udp</transport_id>
        <type>UDPv4</type>
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="player" is_default_profile="true">
      <rtps>
        <userTransports>
          <transport_id>shm</transport_id>
          <transport_id>udp</transport_id>
        </userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
SET_BY_USER = (PROFILES, 'FASTDDS_DEFAULT_PROFILES_FILE', 'FASTDDS_BUILTIN_TRANSPORTS')

Say = Callable[[str], None]


class Publication(NamedTuple):
    """A recorded topic, the name under which it is published, its class and its QoS."""

    topic: str
    name: str
    message_type: type
    offer: OfferedQos


class Player(Node):
    """
    The node ``player``.

    The thread that calls :meth:`play` publishes; the services answer from a thread of their own
    and only set flags. So no message waits for a service.

    :param rate: seconds of the recording per second; infinite publishes as fast as it goes.
    :param say: takes what a user should know, a line at a time.
    :raises ConfigError: a name that no topic may have.
    """

    def __init__(
        self, publications: Sequence[Publication], rate: float, paused: bool, say: Say
    ) -> None:
        super().__init__('player', start_parameter_services=False)
        self.published = 0
        self.largest_delay_s = 0.0
        self._say = say
        self._warned_s = -1.0
        self._rate = rate
        self._paused = paused
        self._steps = Semaphore(0)
        self._begin_s = self._ticked_s = 0.0  # monotonic
        self._begin_ns = self._now_ns = 0  # of the recording
        # reliable, so that every subscriber gets the time; depth 1, since only the last one counts
        self._time = self.create_publisher(Clock, '/clock', QoSProfile(depth=1))
        try:
            self._outputs = {
                topic: self.create_publisher(message_type, name, _qos(offer, message_type))
                for topic, name, message_type, offer in publications
            }
        except (InvalidTopicNameException, ValueError) as error:
            problem = ' '.join(str(error).split())
            raise ConfigError(f'{problem}; give that topic another name with --remap') from None
        for name in ('pause', 'resume', 'step'):
            self.create_service(Trigger, f'~/{name}', getattr(self, f'_{name}'))

    def audiences(self) -> list[Audience]:
        """Return who listens to each topic."""
        return [
            Audience(
                one.topic_name,
                self.count_subscribers(one.topic_name),
                one.get_subscription_count(),
            )
            for one in self._outputs.values()
        ]

    def without_subscribers(self) -> list[str]:
        """Return the names of the topics without subscribers."""
        return [one.topic for one in self.audiences() if not one.matched]

    def names_of(self, topics: Iterable[str]) -> list[str]:
        """Return under which names recorded topics are published."""
        return [self._outputs[topic].topic_name for topic in topics]

    def publish_latched(self, messages: Iterable[TimedMessage]) -> int:
        """Publish at once what was latched before the part that is played; return how much."""
        count = 0
        for _, topic, cdr in messages:
            self._outputs[topic].publish(cdr)
            count += 1
        return count

    def play(
        self, messages: Iterable[TimedMessage], start_ns: int, progress: Callable[[float], object]
    ) -> None:
        """
        Publish each message when it is due, and the time of the recording on ``/clock``.

        The schedule is absolute: a delay is made up for as soon as possible, never accumulated.

        :param messages: in the order of their times.
        :param start_ns: the time of the recording with which to begin.
        :param progress: takes the seconds of the recording that have been played.
        """
        messages = iter(messages)
        first = list(islice(messages, 1))  # before the clock starts: opening the files takes time
        self._begin_ns = self._now_ns = start_ns
        self._begin_s = time.monotonic()
        for log_ns, topic, cdr in chain(first, messages):
            self._wait_until(log_ns)
            self._now_ns = max(self._now_ns, log_ns)
            if time.monotonic() - self._ticked_s > MIN_TICK_S:
                self._publish_time()
            self._outputs[topic].publish(cdr)
            self.published += 1
            progress((self._now_ns - start_ns) / 1e9)

    def flush(self) -> None:
        """Wait until subscribers have acknowledged all reliable messages, though not for ever."""
        end_s = time.monotonic() + FLUSH_S
        for publisher in self._outputs.values():
            # in short waits: Ctrl-C does not interrupt one
            while not publisher.wait_for_all_acked(Duration(seconds=0.05)):
                if time.monotonic() > end_s:
                    self._say(f'a subscriber of {publisher.topic_name} did not get all messages')
                    break

    def _wait_until(self, log_ns: int) -> None:
        """Return when a message is due; meanwhile publish the time and obey the services."""
        while True:
            if self._paused:
                stepped = self._steps.acquire(timeout=TICK_S)
                self._begin_s = time.monotonic()
                self._begin_ns = max(self._now_ns, log_ns) if stepped else self._now_ns
                if stepped:
                    return
                self._publish_time()
                continue
            if math.isinf(self._rate):
                return
            now_s = time.monotonic()
            delay_s = now_s - self._begin_s - (log_ns - self._begin_ns) / 1e9 / self._rate
            if delay_s >= 0:
                self._note(delay_s)
                return
            if now_s - self._ticked_s >= TICK_S:
                elapsed_ns = round((now_s - self._begin_s) * 1e9 * self._rate)
                self._now_ns = max(self._now_ns, min(self._begin_ns + elapsed_ns, log_ns))
                self._publish_time()
            time.sleep(min(-delay_s, TICK_S))

    def _publish_time(self) -> None:
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(self._now_ns, 10**9)
        self._time.publish(clock)
        self._ticked_s = time.monotonic()

    def _note(self, delay_s: float) -> None:
        self.largest_delay_s = max(self.largest_delay_s, delay_s)
        if delay_s > LATE_S and time.monotonic() - self._warned_s > 1:
            self._warned_s = time.monotonic()
            self._say(
                f'{delay_s:.2f} s late; the machine cannot keep up with --rate {self._rate:g}'
            )

    def _pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._steps = Semaphore(0)
        self._paused = True
        return _answered(response, 'paused')

    def _resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._paused = False
        return _answered(response, 'playing')

    def _step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._paused:
            return _answered(response, 'playing; pause first', success=False)
        self._steps.release()
        return _answered(response, 'one more message')


@contextmanager
def running(
    publications: Sequence[Publication],
    rate: float,
    paused: bool,
    ros_arguments: Sequence[str],
    say: Say,
) -> Iterator[Player]:
    """Start ROS and the node with its services; end both after the with statement."""
    join(['play', *ros_arguments])
    executor = SingleThreadedExecutor()
    services = Thread(target=executor.spin, name='services')
    try:
        with _room_for_images():
            player = Player(publications, rate, paused, say)
        executor.add_node(player)
        services.start()
        yield player
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):  # a second one must not spoil the end
            signal.signal(number, signal.SIG_IGN)
        executor.shutdown()
        if services.ident:
            services.join()
        rclpy.try_shutdown()


@contextmanager
def _room_for_images() -> Iterator[None]:
    """Have Fast DDS start with enough shared memory, unless the user configures it."""
    if any(name in os.environ for name in SET_BY_USER):
        yield
        return
    with TemporaryDirectory() as folder:
        file = Path(folder) / 'transports.xml'
        file.write_text(TRANSPORTS, encoding='utf-8')
        os.environ[PROFILES] = str(file)
        try:
            yield
        finally:
            del os.environ[PROFILES]


def message_class(msgtype: str) -> type | None:
    """Return the class of a type such as 'nav_msgs/msg/Odometry', where it is installed."""
    package, _, name = msgtype.partition('/msg/')
    if not (package.isidentifier() and name.isidentifier() and name[0].isupper()):
        return None  # not the name of a message type; a file may contain anything
    try:
        return getattr(importlib.import_module(f'{package}.msg'), name, None)
    except ImportError:
        return None


def _qos(offer: OfferedQos, message_type: type) -> QoSProfile:
    """
    Return the quality of service that was recorded, as far as it makes sense for a recording.

    Deadline, lifespan and liveliness are left out: none holds at another rate or in a pause.
    """
    least = IMAGE_DEPTH if message_type.__name__ in IMAGES else DEPTH
    return QoSProfile(
        depth=offer.depth if offer.latched and offer.depth else max(offer.depth, least),
        reliability=(
            ReliabilityPolicy.RELIABLE if offer.reliable else ReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if offer.latched else DurabilityPolicy.VOLATILE
        ),
    )


def _answered(response: Trigger.Response, message: str, success: bool = True) -> Trigger.Response:
    response.success, response.message = success, message
    return response
