"""`play` as its users run it: a process, with others that listen to what it publishes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
import re
import signal
import subprocess
import sys
from threading import Event, Thread
import time
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.typesys import get_typestore, Stores

from verbs import complaint
from vio_eval_ros.recordings.playback import Playback
from vio_eval_ros.recordings.recording import Recording
from vio_eval_ros.ros import player
from vio_eval_ros.ros.player import message_class
from vio_eval_ros.ros.private import take_serialized

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'demo' / 'simulated_flight'
V1_02 = 'derived_bags/euroc_V1_02_vins_fusion'
POSES = ('/ground_truth/pose', '/vio/odometry')
JAZZY = get_typestore(Stores.ROS2_JAZZY)
ROS2 = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
LIMIT_S = 60
MANY = 1_000_000
SILENCE_S = 0.2  # after which nothing more comes


class Arrival(NamedTuple):
    """A message, when it arrived (monotonic seconds) and its bytes."""

    topic: str
    at_s: float
    cdr: bytes


@pytest.fixture
def environment(ros_environment) -> dict[str, str]:
    """Return an environment in which nobody else is on the ROS graph."""
    return ros_environment | {'PYTHONUNBUFFERED': '1'}


@pytest.fixture
def play(environment) -> Iterator[Callable[..., subprocess.Popen]]:
    """Return a function that starts `play`; it does not survive the test."""
    started = []

    def start(*arguments: object) -> subprocess.Popen:
        words = list(map(str, arguments))
        if not any(word.startswith('--wait') for word in words):
            words += ['--wait-timeout', '0']
        process = subprocess.Popen(
            [sys.executable, '-m', 'vio_eval_ros', 'play', *words],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=LIMIT_S)


class Listener(list[Arrival]):
    """What arrives on topics and on ``/clock``, taken by a thread as soon as it is there."""

    def __init__(self, domain: int, topics: Iterable[str]) -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node(
            'listener', context=self._context, start_parameter_services=False
        )
        self._subscriptions = [
            self._subscribe(item) for item in ('/clock=rosgraph_msgs/msg/Clock', *topics)
        ]
        self._stop = Event()
        self._thread = Thread(target=self._listen)
        self._thread.start()

    def _subscribe(self, item: str) -> Subscription:
        name, _, kind = item.partition('=')
        msgtype, _, latched = kind.partition(',')
        quality = QoSProfile(depth=20_000)
        if latched:
            quality.durability = DurabilityPolicy.TRANSIENT_LOCAL
        return self._node.create_subscription(
            message_class(msgtype), name, lambda message: None, quality, raw=True
        )

    def _listen(self) -> None:
        heard_s = time.monotonic()
        while not self._stop.is_set() or time.monotonic() - heard_s < SILENCE_S:
            for subscription in self._subscriptions:
                kind = subscription.msg_type
                for cdr in take_serialized(subscription, kind, MANY).messages:
                    arrival = Arrival(subscription.topic_name, time.monotonic(), cdr)
                    self.append(arrival)
                    if arrival.topic != '/clock':  # which goes on as long as `play` does
                        heard_s = arrival.at_s
            time.sleep(0.002)

    def wait_for(self, count: int) -> None:
        """Return when so many messages beside those of ``/clock`` have arrived."""
        end_s = time.monotonic() + LIMIT_S
        while sum(arrival.topic != '/clock' for arrival in list(self)) < count:
            assert time.monotonic() < end_s, f'{len(self)} messages have arrived'
            time.sleep(0.01)

    def close(self) -> None:
        """Listen until nothing more comes, and leave the graph."""
        self._stop.set()
        self._thread.join()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def listening(ros, environment):
    """Return a context manager, within which topics are listened to."""

    def listen(*topics: str) -> closing[Listener]:
        return closing(Listener(int(environment['ROS_DOMAIN_ID']), topics))

    return listen


def ended(process: subprocess.Popen, status: int = 0) -> str:
    """Return what a process said on stderr; fail if it ends otherwise."""
    printed, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == status, said
    assert 'Traceback' not in said
    assert printed == ''
    return said


def types_of(path: Path, names: tuple[str, ...] = POSES) -> list[str]:
    with Playback(path) as playback:
        return [f'{t.name}={t.msgtype}' for t in playback.topics if t.name in names]


def bytes_of(arrivals: list[Arrival], topic: str) -> list[bytes]:
    return [arrival.cdr for arrival in arrivals if arrival.topic == topic]


def took_s(arrivals: list[Arrival], topic: str) -> float:
    """Return the time between the arrivals of the first and the last message of a topic."""
    seconds = [arrival.at_s for arrival in arrivals if arrival.topic == topic]
    return seconds[-1] - seconds[0]


def delay_s(said: str) -> float:
    """Return the largest delay that `play` reports, which a busy machine causes."""
    return float(re.search(r'largest delay ([\d.]+) ms', said)[1]) / 1e3


def clocks(arrivals: list[Arrival]) -> list[int]:
    times = [
        JAZZY.deserialize_cdr(cdr, 'rosgraph_msgs/msg/Clock').clock
        for cdr in bytes_of(arrivals, '/clock')
    ]
    return [time.sec * 10**9 + time.nanosec for time in times]


def recorded(path: Path, topic: str) -> list[bytes]:
    """Return the bytes of a topic in ROS 2, as rosbags reads or converts them."""
    file = next(path.glob('*.[dm][bc]*')) if path.is_dir() else path
    with AnyReader([file], default_typestore=JAZZY) as reader:
        return [
            raw if reader.is2 else bytes(JAZZY.ros1_to_cdr(raw, connection.msgtype))
            for connection, _, raw in reader.messages(
                [c for c in reader.connections if c.topic == topic]
            )
        ]


@pytest.mark.parametrize('name', ['demo', '.bag', '_sqlite3', '_mcap'])
def test_every_message_arrives_with_its_bytes_in_order(request, play, listening, name):
    path = DEMO
    if name != 'demo':
        path = request.getfixturevalue('shared_data') / (V1_02 + name)
    with listening(*types_of(path)) as arrivals:
        process = play(path, '--topics', *POSES, '--rate', 20, '--wait-for-subscribers')
        said = ended(process)
    expected = {topic: recorded(path, topic) for topic in POSES}
    assert len(expected['/vio/odometry']) > 800
    for topic in POSES:
        assert bytes_of(arrivals, topic) == expected[topic]
    assert f'published {sum(map(len, expected.values())):,} messages of 2 topics' in said
    times = clocks(arrivals)
    assert times == sorted(times)
    with Playback(path) as playback:
        assert playback.first_ns <= times[0]
        assert times[-1] <= playback.last_ns


def test_a_part_of_a_recording_is_played_under_other_names(play, listening):
    with listening('/estimate=nav_msgs/msg/Odometry') as arrivals:
        said = ended(
            play(
                DEMO, '--topics', '/vio/odometry', '--remap', '/vio/odometry:=/estimate',
                '--start', 10, '--duration', 2, '--rate', 2, '--wait-for-subscribers',
            )
        )  # fmt: skip
    with Recording(DEMO) as recording, Playback(DEMO) as playback:
        poses = recording.read(['/vio/odometry'])[0].poses
        start_ns = playback.first_ns + 10 * 10**9
        part = playback.messages({'/vio/odometry'}, start_ns, start_ns + 2 * 10**9)
        expected = [cdr for _, _, cdr in part]
    assert len(expected) == 40 < len(poses)
    assert bytes_of(arrivals, '/estimate') == expected
    assert 'published 40 messages' in said
    assert len(clocks(arrivals)) > 40  # between messages as well
    assert took_s(arrivals, '/estimate') == pytest.approx(39 * 0.05 / 2, abs=0.2 + delay_s(said))


def test_a_loop_begins_again_and_sigterm_ends_it(play, listening):
    with listening('/vio/odometry=nav_msgs/msg/Odometry') as arrivals:
        process = play(
            DEMO, '--topics', '/vio/odometry', '--duration', 0.5, '--rate', 10, '--loop',
            '--wait-for-subscribers',
        )  # fmt: skip
        arrivals.wait_for(25)
        process.send_signal(signal.SIGTERM)
        said = ended(process)
    assert 'published' in said
    messages = bytes_of(arrivals, '/vio/odometry')
    once = recorded(DEMO, '/vio/odometry')[:10]
    assert len(messages) >= 25
    assert messages == (once * len(messages))[: len(messages)]
    assert (np.diff(clocks(arrivals)) < 0).any()


def test_services_pause_step_and_resume(play, graph, listening):
    with listening('/vio/odometry=nav_msgs/msg/Odometry') as arrivals:
        process = play(
            DEMO, '--topics', '/vio/odometry', '--duration', 2, '--paused',
            '--wait-for-subscribers',
        )  # fmt: skip
        calls = ('step', 'step', 'pause', 'step', 'resume', 'step')
        answers = [graph.call(service, 'player').success for service in calls]
        ended(process)
    assert answers == [True, True, True, True, True, False]
    assert bytes_of(arrivals, '/vio/odometry') == recorded(DEMO, '/vio/odometry')[:40]


class FakeTime:
    """A clock on which nothing takes time but sleeping."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += max(seconds, 1e-6)


@pytest.mark.parametrize('rate', [0.5, 1.0, 2.0])
def test_messages_are_published_when_due_and_the_time_every_10_ms(
    ros, environment, monkeypatch, rate
):
    clock = FakeTime()
    monkeypatch.setattr(player, 'time', clock)
    monkeypatch.setattr(player.signal, 'signal', lambda number, handler: None)
    monkeypatch.setenv('ROS_DOMAIN_ID', environment['ROS_DOMAIN_ID'])
    messages, ticks = [], []
    with player.running([], rate, False, [], messages.append) as node:
        node._outputs = {'/a': SimpleNamespace(publish=lambda _: messages.append(clock.now_s))}
        node._time = SimpleNamespace(publish=lambda time: ticks.append((clock.now_s, time.clock)))
        node.play([(k * 50_000_000, '/a', b'') for k in range(40)], 0, lambda seconds: None)
        node._outputs = {}
    assert messages == pytest.approx(100 + np.arange(40) * 0.05 / rate, abs=1e-4)
    times_s, stamps = zip(*ticks, strict=True)
    assert np.diff(times_s).max() <= 0.0101
    stamps_s = [stamp.sec + stamp.nanosec / 1e9 for stamp in stamps]
    assert stamps_s == pytest.approx((np.array(times_s) - 100) * rate, abs=0.011 * rate)


@pytest.fixture
def latched_bag(tmp_path) -> Path:
    """Return a ROS 1 bag with one latched and one other text, and a type that ROS 2 lacks."""
    path = tmp_path / 'latched.bag'
    text = ROS1.types['std_msgs/msg/String']
    with Rosbag1Writer(path) as writer:
        map_ = writer.add_connection('/map', 'std_msgs/msg/String', typestore=ROS1, latching=1)
        log = writer.add_connection('log', 'std_msgs/msg/String', typestore=ROS1)
        time = writer.add_connection('/time', 'std_msgs/msg/Time', typestore=ROS1)
        stamp = ROS1.types['builtin_interfaces/msg/Time'](1, 2)
        for connection, second, message in (
            (map_, 1, text('a map')),
            (time, 2, ROS1.types['std_msgs/msg/Time'](stamp)),
            (log, 2, text('a log')),
            (log, 30, text('the end')),
        ):
            raw = ROS1.serialize_ros1(message, message.__msgtype__)
            writer.write(connection, second * 10**9, raw)
    return path


def test_what_was_latched_reaches_those_who_come_late(play, graph, listening, latched_bag):
    process = play(latched_bag, '--topics', '/map', '/log', '/time')
    assert '/time: std_msgs/msg/Time is not installed; left out' in process.stderr.readline()
    with listening('/map=std_msgs/msg/String,latched') as arrivals:
        arrivals.wait_for(1)  # it has been published
    assert graph.call('pause', 'player').success
    with listening('/map=std_msgs/msg/String,latched') as arrivals:
        arrivals.wait_for(1)
        process.send_signal(signal.SIGINT)
        ended(process)
    assert len(bytes_of(arrivals, '/map')) == 1


def test_what_was_latched_before_the_start_is_published_first(play, listening, latched_bag):
    with listening('/map=std_msgs/msg/String', '/log=std_msgs/msg/String') as arrivals:
        words = ('--topics', '/map', '/log', '--start', 1, '--rate', 100)
        said = ended(play(latched_bag, *words, '--wait-for-subscribers'))
    assert 'published 1 messages that were latched before --start' in said
    assert [arrival.topic for arrival in arrivals if arrival.topic != '/clock'] == [
        '/map', '/log', '/log'
    ]  # fmt: skip


def test_at_an_infinite_rate_all_is_published_at_once_and_in_order(play, listening):
    with listening(*types_of(DEMO)) as arrivals:
        words = ('--topics', *POSES, '--rate', 'inf', '--wait-for-subscribers')
        said = ended(play(DEMO, *words))
    assert 'as fast as it goes' in said
    assert ' late' not in said
    for topic in POSES:
        heard, rest = bytes_of(arrivals, topic), iter(recorded(DEMO, topic))
        assert all(one in rest for one in heard)  # in order; a slow machine may lose some
        assert len(heard) > 100


def test_a_topic_that_is_waited_for_must_be_played(play):
    said = ended(play(DEMO, '--wait-for-subscribers', '/vio/odometri'), status=2)
    assert "/vio/odometri is not played; did you mean '/vio/odometry'?" in said


def test_waiting_ends_after_the_time_that_is_given(play):
    said = ended(
        play(DEMO, '--wait-for-subscribers', '/vio/odometry', '--wait-timeout', 0.2), status=2
    )
    assert said == 'play: after 0.2 s nobody listens to /vio/odometry\n'


@pytest.mark.parametrize(('publishers', 'kept'), [(1, [5]), (3, [0, 1, 2, 3, 4, 5])])
def test_what_each_publisher_latched_reaches_those_who_come_late(
    play, listening, tmp_path, publishers, kept
):
    kind, text = 'std_msgs/msg/String', ROS1.types['std_msgs/msg/String']
    texts = [ROS1.serialize_ros1(text(f'{k}'), kind) for k in range(6)]
    path = tmp_path / 'publishers.bag'
    with Rosbag1Writer(path) as writer:
        nodes = [
            writer.add_connection('/map', kind, typestore=ROS1, latching=1, callerid=f'/node_{k}')
            for k in range(publishers)
        ]
        for k, raw in enumerate(texts):
            writer.write(nodes[k % publishers], 10**9 + k, raw)
        log = writer.add_connection('/log', kind, typestore=ROS1)
        writer.write(log, 10**9 + 6, texts[0])
        writer.write(log, 30 * 10**9, texts[0])
    process = play(path, '--topics', '/map', '/log')
    with listening('/log=std_msgs/msg/String') as arrivals:
        while not clocks(arrivals):
            time.sleep(0.01)
    with listening('/map=std_msgs/msg/String,latched') as arrivals:
        arrivals.wait_for(len(kept))
        process.send_signal(signal.SIGINT)
        ended(process)
    heard = [ROS2.deserialize_cdr(cdr, kind).data for cdr in bytes_of(arrivals, '/map')]
    assert heard == [f'{k}' for k in kept]


@pytest.fixture
def stereo_bag(tmp_path) -> Path:
    """Return a ROS 1 bag with half a second of two cameras like EuRoC's."""
    path = tmp_path / 'stereo.bag'
    kind, source = 'sensor_msgs/msg/Image', np.random.default_rng(1)
    with Rosbag1Writer(path) as writer:
        cameras = [
            writer.add_connection(topic, kind, typestore=ROS1) for topic in ('/left', '/right')
        ]
        for k in range(10):
            stamp = ROS1.types['builtin_interfaces/msg/Time'](100, k * 50_000_000)
            header = ROS1.types['std_msgs/msg/Header'](k, stamp, 'cam')
            for camera in cameras:
                pixels = source.integers(0, 256, 752 * 480, np.uint8)
                image = ROS1.types[kind](header, 480, 752, 'mono8', 0, 752, pixels)
                log_ns = 100 * 10**9 + k * 50_000_000
                writer.write(camera, log_ns, ROS1.serialize_ros1(image, kind))
    return path


def test_pairs_of_images_arrive_whole_and_in_time(play, listening, stereo_bag):
    with listening(*types_of(stereo_bag, ('/left', '/right'))) as arrivals:
        said = ended(play(stereo_bag, '--wait-for-subscribers'))
    for topic in ('/left', '/right'):
        assert bytes_of(arrivals, topic) == recorded(stereo_bag, topic)
        # in shared memory as small as Fast DDS has it, some come more than a second late
        assert took_s(arrivals, topic) == pytest.approx(9 * 0.05, abs=0.4 + delay_s(said))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_waiting_for_subscribers_ends_at_once_when_stopped(play, number):
    process = play(DEMO, '--wait-for-subscribers')
    assert 'waiting for subscribers' in process.stderr.readline()
    process.send_signal(number)
    ended(process)


BAD = {
    'no such file': (['nowhere.bag'], 'nowhere.bag: there is no such file or folder'),
    'unknown topic': (
        [DEMO, '--topics', '/odom'],
        '/odom: there is no such topic; topics: /ground_truth/pose '
        '(geometry_msgs/msg/PoseStamped, 12000), /vio/odometry',
    ),
    'start': ([DEMO, '--start', '100'], '--start 100: the recording is 59.995 s long'),
    'rate': ([DEMO, '--rate', '0'], "argument --rate: '0' is not a number above 0"),
    'no rate': ([DEMO, '--rate', 'nan'], "argument --rate: 'nan' is not a number above 0"),
    'remap': ([DEMO, '--remap', '/a=/b'], "--remap '/a=/b': write OLD:=NEW"),
    'remap of two': (
        [DEMO, '--remap', '/vio/odometry:=/ground_truth/pose'],
        '/ground_truth/pose and /vio/odometry would both become /ground_truth/pose',
    ),
    'remap to the clock': (
        [DEMO, '--remap', '/vio/odometry:=/clock'],
        '/clock is where play publishes the time',
    ),
    'escape sequence': (['nowhere\n\x1b[31m.bag'], 'nowhere ?[31m.bag: there is no such file'),
    'remap of nothing': ([DEMO, '--remap', '/a:=/b'], '/a is not played; topics: '),
}


@pytest.mark.parametrize('case', BAD)
def test_what_cannot_be_done_is_said_in_one_line(case):
    arguments, problem = BAD[case]
    assert problem in complaint('play', *arguments)


def test_a_name_that_no_topic_may_have_is_said_in_one_line(play):
    said = ended(play(DEMO, '--remap', '/vio/odometry:=/not a name'), status=2)
    assert said.startswith('play: ')
    assert said.count('\n') == 1
    assert '--remap' in said


def test_a_recording_that_nobody_listens_to_is_reported(play):
    said = ended(play(DEMO, '--rate', '100', '--topics', '/vio/odometry', '--duration', '5'))
    assert said.splitlines()[-1] == 'play: no subscribers of /vio/odometry'


def test_it_plays_on_when_nobody_reads_what_it_says(play, listening):
    with listening(*types_of(DEMO, ('/vio/odometry',))) as arrivals:
        process = play(
            DEMO, '--topics', '/vio/odometry', '--duration', '5', '--wait-for-subscribers'
        )
        process.stderr.close()  # before it says for whom it waits
        arrivals.wait_for(100)
        assert process.wait(LIMIT_S) == 0
    assert len(bytes_of(arrivals, '/vio/odometry')) == 100


@pytest.mark.parametrize('verb', ['play', 'evaluator'])
@pytest.mark.parametrize('domain', ['9999', 'mine'])
def test_a_domain_that_there_is_not_is_one_line(monkeypatch, verb, domain):
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    said = complaint(verb, *[DEMO][: verb == 'play'])
    assert said == f"{verb}: ROS_DOMAIN_ID: '{domain}' is not a number from 0 to 232\n"


@pytest.mark.parametrize(
    'msgtype', ['String', '/msg/X', 'std_msgs/msg/_string', 'std_msgs/msg/__name__', 'a b/msg/C']
)
def test_what_is_no_name_of_a_message_is_none(msgtype):
    assert message_class(msgtype) is None
    assert message_class('std_msgs/msg/String') is not None


def test_nothing_to_play_is_said(play, latched_bag):
    said = ended(play(latched_bag, '--topics', '/time'), status=2)
    assert said.splitlines()[-1].startswith('play: nothing to play')
