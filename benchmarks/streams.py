"""
Puts faults into the streams of a recording, and asks `inspect` and its peers to find them.

Prints a Markdown table. Peers are other programs, each in an environment of its own:

    python benchmarks/streams.py --peer clockdoctor=/path/to/clockdoctor --peer bagx=...
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
import os
from pathlib import Path
import re
from statistics import median
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

from document import machine
import numpy as np
from processes import PROJECT
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.imu.simulated_noise import EUROC
from vio_eval_ros.simulation import simulate

SECONDS = 60.0
CAMERA, IMU, ODOMETRY = (
    'sensor_msgs/msg/Image', 'sensor_msgs/msg/Imu', 'nav_msgs/msg/Odometry',
)  # fmt: skip
CAM0, CAM1, IMU0, ODOM = '/cam0/image_raw', '/cam1/image_raw', '/imu0', '/odom'
WIDTH, HEIGHT = 16, 12
MS = 1_000_000
LONGEST_S = 300.0
CLEAN = 'no fault'
# a number that is not part of a name
FIGURE = re.compile(r'(?<![\w/])[-+]?\d[\d.,]*')

Rig = dict[str, SensorStream]
Harm = Callable[[SensorStream, np.random.Generator], SensorStream]


def rig(seed: int) -> Rig:
    """Return what EuRoC's sensors record of a flight, and the odometry of it, without a fault."""
    run, source = simulate(SECONDS, seed, imu_noise=EUROC), np.random.default_rng(seed)
    assert run.imu is not None
    assert run.estimate.rotations is not None
    poses = np.hstack([run.estimate.positions, run.estimate.rotations])
    camera_ns = run.estimate.stamps_ns
    streams = (
        (IMU0, IMU, 'imu', run.imu.stamps_ns, run.imu.samples),
        (CAM0, CAMERA, 'camera', camera_ns, None),
        (CAM1, CAMERA, 'camera', camera_ns, None),
        (ODOM, ODOMETRY, 'pose', camera_ns, poses),
    )
    return {
        topic: SensorStream(
            topic, msgtype, kind, transported(stamps_ns, source), stamps_ns,
            {topic.split('/')[1]: len(stamps_ns)}, numbers,
        )
        for topic, msgtype, kind, stamps_ns, numbers in streams
    }  # fmt: skip


def transported(stamps_ns: np.ndarray, source: np.random.Generator) -> np.ndarray:
    """Return when messages are recorded: 4 ms later, and by chance another millisecond."""
    delays_ns = 4 * MS + source.exponential(1 * MS, len(stamps_ns)).astype(np.int64)
    return np.asarray(np.maximum.accumulate(stamps_ns + delays_ns))


def kept(stream: SensorStream, which: np.ndarray) -> SensorStream:
    """Return some messages of a stream, by index or mask."""
    assert stream.logged_ns is not None
    assert stream.stamps_ns is not None
    stamps_ns = stream.stamps_ns[which]
    return replace(
        stream,
        logged_ns=stream.logged_ns[which],
        stamps_ns=stamps_ns,
        frames={name: len(stamps_ns) for name in stream.frames},
        numbers=None if stream.numbers is None else stream.numbers[which],
    )


def seconds(stream: SensorStream) -> np.ndarray:
    """Return the (N,) times of the stamps since the first."""
    return np.asarray((stream.times_ns - stream.times_ns[0]) / 1e9)


def stamped(stream: SensorStream, stamps_ns: np.ndarray) -> SensorStream:
    """Return the messages with other stamps, recorded when they were."""
    return replace(stream, stamps_ns=np.rint(stamps_ns).astype(np.int64))


def measured(stream: SensorStream, numbers: np.ndarray) -> SensorStream:
    """Return the messages with other numbers."""
    return replace(stream, numbers=numbers)


def dropped(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages without 5 % of them."""
    return kept(stream, source.random(len(stream)) > 0.05)


def silent(begin_s: float, end_s: float) -> Harm:
    """Return what leaves out the messages from one time to another."""

    def harm(stream: SensorStream, source: np.random.Generator) -> SensorStream:
        at = seconds(stream)
        return kept(stream, (at < begin_s) | (at >= end_s))

    return harm


def swapped(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages with ten pairs in the wrong order."""
    order = np.arange(len(stream))
    for first in source.choice(len(stream) // 2, 10, replace=False) * 2:
        order[[first, first + 1]] = first + 1, first
    return replace(kept(stream, order), logged_ns=stream.logged_ns)


def repeated(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages with twenty of them twice."""
    twice = source.choice(len(stream), 20, replace=False)
    return kept(stream, np.sort(np.concatenate([np.arange(len(stream)), twice])))


def nearly_repeated(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages with twenty of them twice, the second time a microsecond later."""
    twice = repeated(stream, source)
    return stamped(twice, twice.times_ns + 1000 * np.append(False, np.diff(twice.times_ns) == 0))


def misstamped(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages, of which one is stamped 1000 s ahead."""
    stamps_ns = stream.times_ns.copy()
    stamps_ns[len(stamps_ns) // 2] += 10**6 * MS
    return stamped(stream, stamps_ns)


def jittering(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages with stamps that scatter by 3 ms."""
    return stamped(stream, stream.times_ns + source.normal(0, 3 * MS, len(stream)))


def drifting(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages with stamps of a clock that gains 50 ppm."""
    return stamped(stream, stream.times_ns + 50e-6 * 1e9 * seconds(stream))


def stepping(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages with stamps of a clock that is set forward by 20 ms half-way."""
    return stamped(stream, stream.times_ns + 20 * MS * (seconds(stream) > SECONDS / 2))


def off(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages with stamps of a clock that is 2 s slow."""
    return stamped(stream, stream.times_ns - 2000 * MS)


def skewed(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages 5 ms later, as of a camera that is triggered so much later."""
    later = stamped(stream, stream.times_ns + 5 * MS)
    return replace(later, logged_ns=stream.arrivals_ns + 5 * MS)


def coarse(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages with stamps in steps of 10 ms."""
    return stamped(stream, stream.times_ns // (10 * MS) * (10 * MS))


def stalling(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages, of which those of 2 s arrive together."""
    at, logged_ns = seconds(stream), np.array(stream.logged_ns)
    held = np.flatnonzero((at >= 30) & (at < 32))
    logged_ns[held] = logged_ns[held[-1]]
    return replace(stream, logged_ns=logged_ns)


def unstamped(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages without stamps."""
    return stamped(stream, np.zeros(len(stream)))


def thinned(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return every fourth message."""
    return kept(stream, np.arange(0, len(stream), 4))


def halved(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return every second message."""
    return kept(stream, np.arange(0, len(stream), 2))


def stuck(columns: slice, begin_s: float, end_s: float) -> Harm:
    """Return what repeats some columns of a sample, from one time to another."""

    def harm(stream: SensorStream, source: np.random.Generator) -> SensorStream:
        at, numbers = seconds(stream), np.array(stream.numbers)
        held = np.flatnonzero((at >= begin_s) & (at < end_s))
        numbers[held, columns] = numbers[held[0], columns]
        return measured(stream, numbers)

    return harm


def spiked(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return samples, of which one is 500 m/s² off."""
    numbers = np.array(stream.numbers)
    numbers[len(numbers) // 2, 3] += 500
    return measured(stream, numbers)


def noisy(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return samples with ten times the noise of the IMU."""
    deviations = np.repeat([EUROC.gyro.density, EUROC.accel.density], 3) * 200**0.5
    numbers = np.asarray(stream.numbers)
    return measured(stream, numbers + source.normal(0, 10 * deviations, numbers.shape))


def saturated(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return samples whose acceleration is cut off at 0.9 of what its z axis reaches."""
    numbers = np.array(stream.numbers)
    limit = 0.9 * np.abs(numbers[:, 5]).max()
    numbers[:, 3:] = numbers[:, 3:].clip(-limit, limit)
    return measured(stream, numbers)


def without_numbers(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages, of which ten in a row are NaN."""
    numbers = np.array(stream.numbers)
    numbers[2000:2010] = np.nan
    return measured(stream, numbers)


def times(*factors: float) -> Harm:
    """Return what multiplies each column."""
    return lambda stream, source: measured(stream, np.asarray(stream.numbers) * factors)


def jumping(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return poses that are 1 m away half-way and stay there."""
    numbers = np.array(stream.numbers)
    numbers[len(numbers) // 2 :, 0] += 1
    return measured(stream, numbers)


def renamed(stream: SensorStream, source: np.random.Generator) -> SensorStream:
    """Return the messages, of which the last hundred name another frame."""
    (name,) = stream.frames
    return replace(stream, frames={name: len(stream) - 100, f'{name}_2': 100})


class Fault(NamedTuple):
    """What goes wrong, and with which topic."""

    does: str
    topic: str
    harm: Harm


FAULTS = (
    Fault('5 % of the frames dropped', CAM0, dropped),
    Fault('frames in swapped order, 10 times', CAM0, swapped),
    Fault('3 ms of jitter', CAM0, jittering),
    Fault('50 ppm of drift', CAM0, drifting),
    Fault('5 ms of skew to the other camera', CAM1, skewed),
    Fault('IMU stuck for 0.1 s', IMU0, stuck(slice(6), 30, 30.1)),
    Fault('IMU stuck for 3 s', IMU0, stuck(slice(6), 30, 33)),
    Fault('gyroscope stuck for the last 10 s', IMU0, stuck(slice(3), 50, 60)),
    Fault('gyroscope x stuck for 20 s', IMU0, stuck(slice(0, 1), 20, 40)),
    Fault('gap of 0.3 s in the IMU', IMU0, silent(30, 30.3)),
    Fault('gap of 2 s in a camera', CAM0, silent(30, 32)),
    Fault('20 frames twice', CAM0, repeated),
    Fault('20 frames twice, 1 µs later', CAM0, nearly_repeated),
    Fault('one frame stamped 1000 s ahead', CAM0, misstamped),
    Fault('one camera at half the rate', CAM1, halved),
    Fault('camera begins 3 s late', CAM1, silent(0, 3)),
    Fault('camera ends 3 s early', CAM1, silent(57, SECONDS)),
    Fault('camera is silent', CAM1, silent(0, SECONDS)),
    Fault('clock steps by 20 ms', CAM0, stepping),
    Fault('clock 2 s off', CAM0, off),
    Fault('stamps in steps of 10 ms', IMU0, coarse),
    Fault('2 s of messages arrive at once', CAM0, stalling),
    Fault('no stamps', CAM0, unstamped),
    Fault('two frame ids', CAM0, renamed),
    Fault('IMU of 50 Hz', IMU0, thinned),
    Fault('accelerometer saturated', IMU0, saturated),
    Fault('one sample 500 m/s² off', IMU0, spiked),
    Fault('ten times the noise', IMU0, noisy),
    Fault('10 samples NaN', IMU0, without_numbers),
    Fault('gyroscope in degrees', IMU0, times(*[180 / np.pi] * 3, 1, 1, 1)),
    Fault('accelerometer in g', IMU0, times(1, 1, 1, *[1 / 9.80665] * 3)),
    Fault('odometry jumps by 1 m', ODOM, jumping),
    Fault('odometry stands for 3 s and leaps', ODOM, stuck(slice(7), 30, 33)),
    Fault('quaternions of length 1.1', ODOM, times(1, 1, 1, *[1.1] * 4)),
)


def write(path: Path, streams: Mapping[str, SensorStream]) -> Path:
    """Write streams as a rosbag2 folder; return the mcap file in it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    pixels = np.random.default_rng(0).integers(0, 256, (64, WIDTH * HEIGHT), np.uint8)
    messages = []
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for stream in streams.values():
            connection = writer.add_connection(stream.topic, stream.msgtype, typestore=store)
            frames = [name for name, count in stream.frames.items() for _ in range(count)]
            numbers = pixels if stream.numbers is None else stream.numbers
            for k, frame in enumerate(frames):
                stamp = store.types['builtin_interfaces/msg/Time'](
                    *divmod(int(stream.times_ns[k]), 10**9)
                )
                header = store.types['std_msgs/msg/Header'](stamp, frame)
                content = CONTENTS[stream.msgtype](store.types, numbers[k % len(numbers)])
                message = store.types[stream.msgtype](header, *content)
                raw = store.serialize_cdr(message, stream.msgtype)
                messages.append((int(stream.arrivals_ns[k]), connection, raw))
        for logged_ns, connection, raw in sorted(messages, key=lambda one: one[0]):
            writer.write(connection, logged_ns, raw)
    return path / f'{path.name}.mcap'


def _image(types: Any, pixels: np.ndarray) -> tuple[Any, ...]:
    return HEIGHT, WIDTH, 'mono8', 0, WIDTH, pixels


def _imu(types: Any, sample: np.ndarray) -> tuple[Any, ...]:
    vector, unknown = types['geometry_msgs/msg/Vector3'], np.array([-1.0, *[0.0] * 8])
    level = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    rates, forces = vector(*sample[:3].tolist()), vector(*sample[3:].tolist())
    return level, unknown, rates, np.zeros(9), forces, np.zeros(9)


def _odometry(types: Any, pose: np.ndarray) -> tuple[Any, ...]:
    kinds = {name: types[f'geometry_msgs/msg/{name}'] for name in POSE_TYPES}
    position, turn = kinds['Point'](*pose[:3].tolist()), kinds['Quaternion'](*pose[3:].tolist())
    zero, unknown = kinds['Vector3'](0.0, 0.0, 0.0), np.zeros(36)
    return (
        'body',
        kinds['PoseWithCovariance'](kinds['Pose'](position, turn), unknown),
        kinds['TwistWithCovariance'](kinds['Twist'](zero, zero), unknown),
    )


POSE_TYPES = (
    'Point', 'Pose', 'PoseWithCovariance', 'Quaternion', 'Twist', 'TwistWithCovariance', 'Vector3',
)  # fmt: skip
CONTENTS = {CAMERA: _image, IMU: _imu, ODOMETRY: _odometry}


class Tool(NamedTuple):
    """
    A program that looks for faults in a recording.

    :param before: its arguments in front of the recording.
    :param warning: what a line looks like that tells of something wrong.
    :param statuses: with which it may end.
    """

    before: tuple[str, ...]
    warning: str
    statuses: tuple[int, ...] = (0,)


INSPECT = 'inspect'
TOOLS = {
    INSPECT: Tool((), r'(FAIL|warn)  [a-z].*'),
    'clockdoctor': Tool((), r'  \[/\S+\] \S.*'),
    'bagx': Tool(
        ('eval', '--include-anomaly', '--findings-only', '--severity-min', 'warning'),
        r'  [A-Z]+  .*',
    ),
    'deepen-bag-check': Tool((), r'  \[(WARN|FAIL)\] .*', (0, 1, 2)),
    'robot-triage': Tool(('run',), r'\[ *[A-Z]+\] .*'),
}


class Answer(NamedTuple):
    """
    What a tool says of a recording.

    :param warnings: its lines that tell of something wrong, without their figures; None where
        it ended in an error.
    """

    warnings: frozenset[str] | None
    seconds: float


# of each tool and recording, one a seed
Answers = dict[str, dict[str, list[Answer]]]


def ask(name: str, command: list[str], recording: Path) -> Answer:
    """Return what a tool says of a recording."""
    tool = TOOLS[name]
    begin = time.perf_counter()
    done = subprocess.run(
        [*command, *tool.before, recording],
        capture_output=True,
        text=True,
        env=os.environ | {'COLUMNS': '1000'},
        cwd=PROJECT,
        check=False,
        timeout=LONGEST_S,
    )
    took_s = time.perf_counter() - begin
    if done.returncode not in tool.statuses:
        print(f'{name}: {done.stderr.strip()[-300:]}', file=sys.stderr)
        return Answer(None, took_s)
    lines = (line for line in done.stdout.splitlines() if re.fullmatch(tool.warning, line))
    return Answer(frozenset(FIGURE.sub('#', line.strip()) for line in lines), took_s)


def recordings(folder: Path, seed: int) -> Iterator[tuple[str, Path]]:
    """Yield what is wrong with a recording, and the recording; the first is as it should be."""
    clean = rig(seed)
    # all have the same name, so that what is said differs for other reasons only
    yield CLEAN, write(folder / 'clean' / 'run', clean)
    for k, fault in enumerate(FAULTS):
        harmed = fault.harm(clean[fault.topic], np.random.default_rng([seed, k]))
        yield fault.does, write(folder / str(k) / 'run', clean | {fault.topic: harmed})


def table(answers: Answers) -> Iterator[str]:
    """Yield the lines of a Markdown table, from what each tool says of each recording."""
    yield f'| | {" | ".join(answers)} |'
    yield '|---|' + '---|' * len(answers)
    cells = [_false_alarms(of_tool[CLEAN]) for of_tool in answers.values()]
    yield f'| {CLEAN} | {" | ".join(cells)} |'
    for fault in FAULTS:
        cells = [_found(of_tool[fault.does], of_tool[CLEAN]) for of_tool in answers.values()]
        yield f'| {fault.does} | {" | ".join(cells)} |'
    times_s = (
        median(answer.seconds for several in of_tool.values() for answer in several)
        for of_tool in answers.values()
    )
    yield f'| time [s] | {" | ".join(f"{took_s:.1f}" for took_s in times_s)} |'


def _false_alarms(answers: Sequence[Answer]) -> str:
    """Return how many warnings there are where nothing is wrong, at most."""
    counts = [len(answer.warnings) for answer in answers if answer.warnings is not None]
    return f'warnings: {max(counts)}' if len(counts) == len(answers) else 'error'


def _found(answers: Sequence[Answer], clean: Sequence[Answer]) -> str:
    """Return in how many recordings a tool warns of what it does not in the clean ones."""
    if any(answer.warnings is None for answer in (*answers, *clean)):
        return 'error'
    count = sum(bool(news(*pair)) for pair in zip(answers, clean, strict=True))
    return {0: '-', len(answers): 'found'}.get(count, f'{count} of {len(answers)}')


def news(answer: Answer, clean: Answer) -> frozenset[str]:
    """Return the warnings that there are not of the clean recording."""
    return (answer.warnings or frozenset()) - (clean.warnings or frozenset())


def version_of(name: str, command: str) -> str:
    """Return the version of a peer, as its environment has it."""
    asked = f'from importlib.metadata import version; print(version({name!r}))'
    python = Path(command).with_name('python')
    done = subprocess.run([python, '-c', asked], capture_output=True, text=True, check=True)
    return f'{name} {done.stdout.strip()}'


def main() -> None:
    """Ask all of all, and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument(
        '--peer', action='append', default=[], metavar='NAME=PATH', help=', '.join([*TOOLS][1:])
    )
    parser.add_argument('--seeds', type=int, default=3, help='how many of each (default: 3)')
    parser.add_argument('--show', action='store_true', help='print what each says')
    options = parser.parse_args()
    peers = dict(one.split('=', 1) for one in options.peer)
    if unknown := peers.keys() - TOOLS.keys():
        parser.error(f'there is no peer {", ".join(sorted(unknown))}; {", ".join([*TOOLS][1:])}')
    commands = {INSPECT: [sys.executable, '-m', 'vio_eval_ros', 'inspect']}
    commands |= {name: [path] for name, path in peers.items()}
    answers: Answers = {name: defaultdict(list) for name in commands}
    for seed in range(options.seeds):
        with tempfile.TemporaryDirectory() as folder:
            for does, recording in recordings(Path(folder), seed):
                for name, command in commands.items():
                    answer = ask(name, command, recording)
                    answers[name][does].append(answer)
                    clean = answers[name][CLEAN][seed]
                    shown = answer.warnings or () if does == CLEAN else news(answer, clean)
                    for line in sorted(shown) if options.show else ():
                        print(f'{does}: {name}: {line}', file=sys.stderr)
    print('\n'.join(table(answers)))
    versions = ''.join(f'{version_of(*peer)}, ' for peer in peers.items())
    print(f'\n{versions}on recordings of {SECONDS:g} s. {machine("numpy", "rosbags")}')


if __name__ == '__main__':
    main()
