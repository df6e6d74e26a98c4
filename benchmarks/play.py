"""
Measures `play`: how punctual it is, how much memory it takes, whether EuRoC's rates keep up.

Writes the section Play of docs/benchmarks.md, with --quick only prints; exits with 1 where a
target is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
import importlib.util
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

import document
from document import machine, ranged, Target, targets_table
import numpy as np
from processes import cpu_s, private_graph, resident_bytes, started
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_typestore, Stores

FIRST_NS = 1_403_636_579_763_555_584
WIDTH, HEIGHT = 752, 480  # EuRoC's cameras
IMU_NS, CAMERA_NS = 5_000_000, 50_000_000
TOPICS = {'/imu0': 'Imu', '/cam0/image_raw': 'Image', '/cam1/image_raw': 'Image'}
SAMPLE_S = 0.1
IGNORED_SAMPLES = 20  # of the memory: while libraries are loaded and buffers fill


class Measured(NamedTuple):
    """What was found out about one case."""

    messages: int
    lost: int
    median_ms: float
    p99_ms: float
    max_ms: float
    cpu_percent: float
    first_mb: float
    growth_mb: float


def images(source: np.random.Generator) -> np.ndarray:
    """Return a few images of noise, which compress as badly as real ones."""
    return source.integers(0, 256, (8, HEIGHT * WIDTH), np.uint8)


def stream(seconds: float) -> Iterator[tuple[int, str]]:
    """Yield time and topic of each message of EuRoC's sensors, in order."""
    for elapsed_ns in range(0, round(seconds * 1e9), IMU_NS):
        yield FIRST_NS + elapsed_ns, '/imu0'
        if elapsed_ns % CAMERA_NS == 0:
            yield FIRST_NS + elapsed_ns, '/cam0/image_raw'
            yield FIRST_NS + elapsed_ns, '/cam1/image_raw'


def write_bag(path: Path, seconds: float) -> None:
    """Write a recording as EuRoC's: a ROS 1 bag, or an mcap or an SQLite folder."""
    ros1 = path.suffix == '.bag'
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    types = store.types
    plugin = StoragePlugin.MCAP if path.suffix == '.mcap' else StoragePlugin.SQLITE3
    writer = Rosbag1Writer(path) if ros1 else Rosbag2Writer(path, version=9, storage_plugin=plugin)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    pixels = images(np.random.default_rng(1))
    zero = types['geometry_msgs/msg/Vector3'](0.0, 0.0, 0.0)
    level, unknown = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0), np.zeros(9)
    with writer:
        connections = {
            topic: writer.add_connection(topic, f'sensor_msgs/msg/{name}', typestore=store)
            for topic, name in TOPICS.items()
        }
        for k, (stamp_ns, topic) in enumerate(stream(seconds)):
            stamp = types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9))
            header = types['std_msgs/msg/Header'](*([k] if ros1 else []), stamp, topic[1:5])
            values = (
                (level, unknown, zero, unknown, zero, unknown)
                if topic == '/imu0'
                else (HEIGHT, WIDTH, 'mono8', 0, WIDTH, pixels[k % len(pixels)])
            )
            kind = f'sensor_msgs/msg/{TOPICS[topic]}'
            message = types[kind](header, *values)
            writer.write(connections[topic], stamp_ns, serialize(message, kind))


def write_asl(path: Path, seconds: float) -> None:
    """Write a EuRoC folder."""
    from PIL import Image

    pixels = images(np.random.default_rng(1)).reshape(-1, HEIGHT, WIDTH) // 32  # as large as real
    rows: dict[str, list[str]] = {sensor: [] for sensor in ('imu0', 'cam0', 'cam1')}
    for camera in ('cam0', 'cam1'):
        (path / 'mav0' / camera / 'data').mkdir(parents=True)
    (path / 'mav0' / 'imu0').mkdir()
    for k, (stamp_ns, topic) in enumerate(stream(seconds)):
        sensor = topic.split('/')[1]
        if sensor == 'imu0':
            rows[sensor].append(f'{stamp_ns},0,0,0,0,0,9.81')
        else:
            rows[sensor].append(f'{stamp_ns},{stamp_ns}.png')
            image = Image.fromarray(pixels[k % len(pixels)])
            image.save(path / 'mav0' / sensor / 'data' / f'{stamp_ns}.png', compress_level=1)
    for sensor, lines in rows.items():
        text = '\n'.join(['#timestamp [ns]', *lines])
        (path / 'mav0' / sensor / 'data.csv').write_text(text)


def measure(path: Path, seconds: float, rate: float) -> Measured:
    """Play a recording into a process that listens."""
    environment = os.environ | private_graph()
    command = [sys.executable, '-m', 'vio_eval_ros', 'play', path, '--wait-for-subscribers']
    listener = [sys.executable, Path(__file__).with_name('listener.py')]
    memory, used_s = [], 0.0
    with (
        started(listener, env=environment, stdout=subprocess.PIPE, text=True) as listening,
        started([*command, '--rate', rate], env=environment) as playing,
    ):
        while playing.poll() is None:
            try:
                memory.append(resident_bytes(playing.pid) / 2**20)
                used_s = cpu_s(playing.pid)
            except (OSError, ValueError):  # it has just ended
                break
            time.sleep(SAMPLE_S)
        playing.wait()
        listening.terminate()
        printed = listening.communicate()[0].split()
    expected = {(topic, stamp_ns) for stamp_ns, topic in stream(seconds)}
    arrived = [
        (topic, int(stamp_ns), float(at_s))
        for topic, stamp_ns, at_s in zip(*[iter(printed)] * 3, strict=True)
    ]
    missing = expected - {(topic, stamp_ns) for topic, stamp_ns, _ in arrived}
    errors_ms = np.array(
        [1e3 * at_s - (stamp_ns - FIRST_NS) / 1e6 / rate for _, stamp_ns, at_s in arrived]
    )
    memory = memory[IGNORED_SAMPLES:] or memory
    quarter = max(len(memory) // 4, 1)
    first_mb, last_mb = np.median(memory[:quarter]), np.median(memory[-quarter:])
    return Measured(
        len(arrived),
        len(missing),
        *np.percentile(errors_ms - errors_ms.min(), [50, 99, 100]),  # the earliest was in time
        100 * used_s * rate / seconds,
        first_mb,
        last_mb - first_mb,
    )


def targets(timed: Sequence[Measured], large: Measured, gigabytes: float) -> list[Target]:
    """Return what is promised of `play`."""
    medians_ms = [measured.median_ms for measured in timed]
    lost = sum(measured.lost for measured in timed)
    return [
        Target(
            'Timing error at rate 1: a median below 2 ms',
            ranged(medians_ms, 2),
            max(medians_ms) < 2,
        ),
        Target(
            "EuRoC's 2 x 20 Hz of images and 200 Hz of IMU at rate 1: nothing lost",
            f'{lost:,} of {lost + sum(measured.messages for measured in timed):,}',
            not lost,
        ),
        Target(
            f'Memory over a recording of {gigabytes:g} GB: grows by at most 5 MB',
            f'{large.growth_mb:+.1f} MB',
            large.growth_mb <= 5,
        ),
    ]


def table(rows: Mapping[str, Measured], rates: Sequence[float]) -> Iterator[str]:
    """Yield the figures of each recording."""
    columns = (
        'recording | rate | messages | lost | timing error, median [ms] | 99 % | largest '
        '| CPU [%] | memory [MB] | growth [MB]'
    )
    yield f'| {columns} |'
    yield '|---' + '|---:' * columns.count('|') + '|'
    for (name, row), rate in zip(rows.items(), rates, strict=True):
        yield (
            f'| {name} | {rate:g} | {row.messages:,} | {row.lost} | {row.median_ms:.2f} '
            f'| {row.p99_ms:.2f} | {row.max_ms:.1f} | {row.cpu_percent:.0f} '
            f'| {row.first_mb:.0f} | {row.growth_mb:+.1f} |'
        )


def main() -> int:
    """Measure and write; return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=5.0, help='length of the timed cases')
    parser.add_argument('--gigabytes', type=float, default=1.0, help='size of the large one')
    parser.add_argument(
        '--quick', action='store_true', help='measure less, and leave docs/benchmarks.md as it is'
    )
    options = parser.parse_args()
    if importlib.util.find_spec('rclpy') is None:
        print(
            '`play` is not measured, its figures stay: there is no rclpy; pip install -e ".[ros]"'
        )
        return 0
    seconds, gigabytes = (3.0, 0.1) if options.quick else (options.seconds, options.gigabytes)
    bytes_a_second = 2 * WIDTH * HEIGHT / (CAMERA_NS / 1e9)
    cases = [
        ('ROS 1 bag', 'euroc.bag', seconds, 1.0),
        ('SQLite', 'euroc', seconds, 1.0),
        ('MCAP', 'euroc.mcap', seconds, 1.0),
        ('EuRoC folder', 'asl', seconds, 1.0),
        (f'ROS 1 bag of {gigabytes:g} GB', 'large.bag', gigabytes * 1e9 / bytes_a_second, 3.0),
    ]
    rows = {}
    for name, file, length_s, rate in cases:
        print(f'play: {name}', flush=True)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / file
            (write_asl if file == 'asl' else write_bag)(path, length_s)
            rows[name] = measure(path, length_s, rate)
    *timed, large = rows.values()
    promised = targets(timed, large, gigabytes)
    lines = [
        "`play` of EuRoC's sensors: an IMU at 200 Hz, two cameras of 752 x 480 at 20 Hz. Measured "
        'by `benchmarks/play.py`.',
        '',
        *targets_table(promised),
        '',
        *table(rows, [rate for *_, rate in cases]),
        '',
        '`play` publishes to another process, which only notes when each message arrives. The '
        'timing error is how much later than its time in the recording a message arrives, '
        'relative to the earliest of all. Memory is the private memory of the process '
        '(`RssAnon`), the median over the first quarter of the time; growth is the median over '
        'the last quarter minus that.',
        '',
        machine('numpy', 'rosbags', 'ros-rclpy', 'ros-rmw-fastrtps-cpp'),
    ]
    print('\n'.join(lines))
    if not options.quick:
        document.write('Play', lines)
    return 0 if all(target.met for target in promised) else 1


if __name__ == '__main__':
    sys.exit(main())
