"""`play` as its users run it: a process, with others that listen to what it publishes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import importlib.util
import os
from pathlib import Path
import pickle
import signal
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.recordings.playback import Playback
from vio_eval_ros.recordings.recording import Recording

pytest.importorskip('rclpy', reason='needs ROS 2: pip install ".[ros]"')

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'demo' / 'simulated_flight'
V1_02 = 'derived_bags/euroc_V1_02_vins_fusion'
POSES = ('/ground_truth/pose', '/vio/odometry')
JAZZY = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
LIMIT_S = 60

HAS_ROS = importlib.util.find_spec('rclpy') is not None
needs_ros = pytest.mark.skipif(
    not HAS_ROS and os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') != '1',
    reason='rclpy is not installed',
)


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
def start(environment) -> Iterator[Callable[..., subprocess.Popen]]:
    """Return a function that starts a process; it does not survive the test."""
    started = []

    def begin(*command: object) -> subprocess.Popen:
        process = subprocess.Popen(
            [sys.executable, *map(str, command)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=LIMIT_S)


@pytest.fixture
def play(start):
    """Return a function that starts `play`."""
    return lambda *arguments: start('-m', 'vio_eval_ros', 'play', *arguments)


class Listener(list[Arrival]):
    """What has arrived, once the listening process has ended."""

    def __init__(self, process: subprocess.Popen) -> None:
        self._process = process

    def wait_for_messages(self) -> None:
        """Return when as many messages have arrived as were asked for."""
        assert self._process.stdout.readline() == 'arrived\n'


@pytest.fixture
def listening(start, tmp_path):
    """Return a context manager; within it topics are listened to, behind it is what arrived."""

    @contextmanager
    def listen(*topics: str, messages: int = 0) -> Iterator[Listener]:
        file = tmp_path / 'arrivals.pickle'
        process = start(Path(__file__).with_name('listen.py'), file, messages, *topics)
        arrivals = Listener(process)
        yield arrivals
        process.terminate()
        _, complaint = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 0, complaint
        arrivals += [Arrival(*item) for item in pickle.loads(file.read_bytes())]

    return listen


def ended(process: subprocess.Popen, status: int = 0) -> str:
    """Return what a process said on stderr; fail if it ends otherwise."""
    printed, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == status, said
    assert 'Traceback' not in said
    assert printed == ''
    return said


def complaint(process: subprocess.Popen) -> str:
    said = ended(process, status=2)
    assert said.startswith('play: ')
    assert said.count('\n') == 1, said
    return said


def types_of(path: Path, names: tuple[str, ...] = POSES) -> list[str]:
    with Playback(path) as playback:
        return [f'{t.name}={t.msgtype}' for t in playback.topics if t.name in names]


def bytes_of(arrivals: list[Arrival], topic: str) -> list[bytes]:
    return [arrival.cdr for arrival in arrivals if arrival.topic == topic]


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


@needs_ros
@pytest.mark.parametrize('name', ['demo', '.bag', '_sqlite3', '_mcap'])
def test_every_message_arrives_with_its_bytes_in_order(request, play, listening, name):
    path = DEMO
    if name != 'demo':
        path = request.getfixturevalue('shared_data') / (V1_02 + name)
    with listening(*types_of(path)) as arrivals:
        player = play(path, '--topics', *POSES, '--rate', 20, '--wait-for-subscribers')
        said = ended(player)
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


@needs_ros
def test_a_part_of_a_recording_is_played_under_other_names(play, listening):
    with listening('/estimate=nav_msgs/msg/Odometry') as arrivals:
        said = ended(
            play(
                DEMO, '--topics', '/vio/odometry', '--remap', '/vio/odometry:=/estimate',
                '--start', 10, '--duration', 2, '--rate', 2, '--wait-for-subscribers',
            )
        )  # fmt: skip
    with Recording(DEMO) as recording, Playback(DEMO) as playback:
        ((poses, _),) = recording.read(['/vio/odometry'])
        start_ns = playback.first_ns + 10 * 10**9
        part = playback.messages({'/vio/odometry'}, start_ns, start_ns + 2 * 10**9)
        expected = [cdr for _, _, cdr in part]
    assert len(expected) == 40 < len(poses)
    assert bytes_of(arrivals, '/estimate') == expected
    assert 'published 40 messages' in said
    # told at least every 10 ms between messages that are 25 ms apart
    assert len(clocks(arrivals)) > 80
    seconds = [arrival.at_s for arrival in arrivals if arrival.topic == '/estimate']
    assert seconds[-1] - seconds[0] == pytest.approx(39 * 0.05 / 2, abs=0.2)


@needs_ros
def test_a_loop_begins_again_and_sigterm_ends_it(play, listening):
    with listening('/vio/odometry=nav_msgs/msg/Odometry', messages=25) as arrivals:
        player = play(
            DEMO, '--topics', '/vio/odometry', '--duration', 0.5, '--rate', 10, '--loop',
            '--wait-for-subscribers',
        )  # fmt: skip
        arrivals.wait_for_messages()
        player.send_signal(signal.SIGTERM)
        said = ended(player)
    assert 'published' in said
    messages = bytes_of(arrivals, '/vio/odometry')
    once = recorded(DEMO, '/vio/odometry')[:10]
    assert len(messages) >= 25
    assert messages == (once * len(messages))[: len(messages)]
    assert (np.diff(clocks(arrivals)) < 0).any()


@needs_ros
def test_services_pause_step_and_resume(play, start, listening):
    with listening('/vio/odometry=nav_msgs/msg/Odometry') as arrivals:
        player = play(
            DEMO, '--topics', '/vio/odometry', '--duration', 2, '--paused',
            '--wait-for-subscribers',
        )  # fmt: skip
        calls = start(
            Path(__file__).with_name('call.py'), 'step', 'step', 'pause', 'step', 'resume', 'step'
        )
        answers, complaint = calls.communicate(timeout=LIMIT_S)
        assert calls.returncode == 0, complaint
        ended(player)
    answered = [line.split(' ')[0] for line in answers.splitlines()]
    assert answered == ['True', 'True', 'True', 'True', 'True', 'False']
    assert bytes_of(arrivals, '/vio/odometry') == recorded(DEMO, '/vio/odometry')[:40]


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


@needs_ros
def test_what_was_latched_reaches_those_who_come_late(play, start, listening, latched_bag):
    player = play(latched_bag, '--topics', '/map', '/log', '/time')
    assert '/time: std_msgs/msg/Time is not installed; left out' in player.stderr.readline()
    calls = start(Path(__file__).with_name('call.py'), 'pause')  # when /map has been published
    assert calls.wait(timeout=LIMIT_S) == 0
    with listening('/map=std_msgs/msg/String,latched', messages=1) as arrivals:
        arrivals.wait_for_messages()
        player.send_signal(signal.SIGINT)
        ended(player)
    assert len(bytes_of(arrivals, '/map')) == 1


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


@needs_ros
def test_pairs_of_images_arrive_whole_and_in_time(play, listening, stereo_bag):
    with listening(*types_of(stereo_bag, ('/left', '/right'))) as arrivals:
        ended(play(stereo_bag, '--wait-for-subscribers'))
    for topic in ('/left', '/right'):
        assert bytes_of(arrivals, topic) == recorded(stereo_bag, topic)
        seconds = [arrival.at_s for arrival in arrivals if arrival.topic == topic]
        # in shared memory as small as Fast DDS has it, some come more than a second late
        assert seconds[-1] - seconds[0] == pytest.approx(9 * 0.05, abs=0.4)


@needs_ros
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_waiting_for_subscribers_ends_at_once_when_told(play, number):
    player = play(DEMO, '--wait-for-subscribers')
    assert 'waiting for subscribers' in player.stderr.readline()
    player.send_signal(number)
    ended(player)


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
def test_what_cannot_be_done_is_said_in_one_line(play, case):
    arguments, problem = BAD[case]
    assert problem in complaint(play(*arguments))


@needs_ros
def test_a_name_that_no_topic_may_have_is_said_in_one_line(play):
    assert '--remap' in complaint(play(DEMO, '--remap', '/vio/odometry:=/not a name'))


@needs_ros
def test_a_recording_that_nobody_listens_to_is_told(play):
    said = ended(play(DEMO, '--rate', '100', '--topics', '/vio/odometry', '--duration', '5'))
    assert said.splitlines()[-1] == 'play: no subscribers of /vio/odometry'


@needs_ros
def test_it_plays_on_when_nobody_reads_what_it_says(play, listening):
    with listening(*types_of(DEMO, ('/vio/odometry',)), messages=100) as arrivals:
        player = play(
            DEMO, '--topics', '/vio/odometry', '--duration', '5', '--wait-for-subscribers'
        )
        player.stderr.close()  # before it says for whom it waits
        arrivals.wait_for_messages()
        assert player.wait(LIMIT_S) == 0
    assert len(bytes_of(arrivals, '/vio/odometry')) == 100


@needs_ros
@pytest.mark.parametrize('verb', ['play', 'evaluator'])
@pytest.mark.parametrize('domain', ['9999', 'mine'])
def test_a_domain_that_there_is_not_is_one_line(start, environment, verb, domain):
    environment['ROS_DOMAIN_ID'] = domain
    said = ended(start('-m', 'vio_eval_ros', verb, *[DEMO][: verb == 'play']), status=2)
    assert said == f"{verb}: ROS_DOMAIN_ID: '{domain}' is not a number from 0 to 232\n"


@needs_ros
@pytest.mark.parametrize(
    'msgtype', ['String', '/msg/X', 'std_msgs/msg/_string', 'std_msgs/msg/__name__', 'a b/msg/C']
)
def test_what_is_no_name_of_a_message_is_none(msgtype):
    from vio_eval_ros.ros.player import message_class

    assert message_class(msgtype) is None
    assert message_class('std_msgs/msg/String') is not None


@needs_ros
def test_nothing_to_play_is_said(play, latched_bag):
    said = ended(play(latched_bag, '--topics', '/time'), status=2)
    assert said.splitlines()[-1].startswith('play: nothing to play')
