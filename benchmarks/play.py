"""
Measures `play`: how punctual it is, how much memory it takes, whether EuRoC's rates keep up.

Each case is played by a real process into another one that only notes when messages arrive:
``python benchmarks/play.py [--seconds S] [--gigabytes G]``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import os
from pathlib import Path
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
from typing import NamedTuple

import numpy as np
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_typestore, Stores

ROOT = Path(__file__).resolve().parents[1]
FIRST_NS = 1_403_636_579_763_555_584
WIDTH, HEIGHT = 752, 480  # EuRoC's cameras
IMU_NS, CAMERA_NS = 5_000_000, 50_000_000
TOPICS = {'/imu0': 'Imu', '/cam0/image_raw': 'Image', '/cam1/image_raw': 'Image'}
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


LISTENER = """
import signal, time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, Imu

stopping = []
signal.signal(signal.SIGTERM, lambda *_: stopping.append(True))
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node('listener')
arrivals = []
for topic, kind in (('/imu0', Imu), ('/cam0/image_raw', Image), ('/cam1/image_raw', Image)):
    note = lambda message, topic=topic: arrivals.append((topic, time.monotonic()))
    node.create_subscription(kind, topic, note, QoSProfile(depth=1000), raw=True)
executor = SingleThreadedExecutor()
executor.add_node(node)
count = -1
while not stopping or len(arrivals) > count:  # until nothing more comes
    count = len(arrivals)
    executor.spin_once(timeout_sec=0.2)
print(*(f'{topic} {at!r}' for topic, at in arrivals), sep='\\n')
"""


def resident_mb(pid: int) -> float:
    """Return what a process has in memory that is its own, not mapped files."""
    status = Path(f'/proc/{pid}/status').read_text()
    (anonymous,) = re.findall(r'RssAnon:\s+(\d+) kB', status)
    return int(anonymous) / 1024


def cpu_s(pid: int) -> float:
    """Return the CPU time that a process has used."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def measure(path: Path, seconds: float, rate: float) -> Measured:
    """Play a recording into a process that listens."""
    environment = os.environ | {
        'PYTHONPATH': str(ROOT),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': str(random.randint(30, 60)),
    }
    listener = subprocess.Popen(
        [sys.executable, '-c', LISTENER], env=environment, stdout=subprocess.PIPE, text=True
    )
    player = subprocess.Popen(
        [sys.executable, '-m', 'vio_eval_ros', 'play', path, '--rate', str(rate),
         '--wait-for-subscribers'],
        env=environment,
    )  # fmt: skip
    memory, cpu, over = [], 0.0, threading.Event()
    watcher = threading.Thread(target=lambda: (player.wait(), over.set()))
    watcher.start()
    try:
        while not over.wait(0.1):
            try:
                memory.append(resident_mb(player.pid))
                cpu = cpu_s(player.pid)
            except (OSError, ValueError):  # it has just ended
                break
        watcher.join()
        listener.send_signal(signal.SIGTERM)
        printed, _ = listener.communicate(timeout=60)
    finally:
        for process in (player, listener):
            if process.poll() is None:
                process.kill()
                process.wait()
    arrivals: dict[str, list[float]] = {topic: [] for topic in TOPICS}
    for line in printed.splitlines():
        topic, at_s = line.split()
        arrivals[topic].append(float(at_s))
    due: dict[str, list[float]] = {topic: [] for topic in TOPICS}
    for stamp_ns, topic in stream(seconds):
        due[topic].append((stamp_ns - FIRST_NS) / 1e9 / rate)
    expected = sum(map(len, due.values()))
    received = sum(map(len, arrivals.values()))
    errors_ms = np.array([np.nan])
    if received == expected:
        errors_ms = np.concatenate(
            [np.subtract(arrivals[topic], due[topic]) * 1e3 for topic in TOPICS]
        )
        errors_ms -= errors_ms.min()  # the earliest was in time
    memory = memory[IGNORED_SAMPLES:] or memory
    quarter = max(len(memory) // 4, 1)
    growth = np.median(memory[-quarter:]) - np.median(memory[:quarter])
    return Measured(
        received,
        expected - received,
        *np.percentile(errors_ms, [50, 99, 100]),
        100 * cpu / (seconds / rate),
        float(np.median(memory[:quarter])),
        float(growth),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seconds', type=float, default=20.0, help='length of the timed cases')
    parser.add_argument('--gigabytes', type=float, default=1.0, help='size of the large one')
    options = parser.parse_args()
    bytes_a_second = 2 * WIDTH * HEIGHT / (CAMERA_NS / 1e9)
    large_s = options.gigabytes * 1e9 / bytes_a_second
    cases = [
        ('ROS 1 bag', 'euroc.bag', options.seconds, 1.0),
        ('SQLite', 'euroc', options.seconds, 1.0),
        ('MCAP', 'euroc.mcap', options.seconds, 1.0),
        ('EuRoC folder', 'asl', options.seconds, 1.0),
        (f'ROS 1 bag of {options.gigabytes:g} GB', 'large.bag', large_s, 2.0),
        (f'MCAP of {options.gigabytes:g} GB', 'large.mcap', large_s, 2.0),
    ]
    print("EuRoC's sensors: 200 Hz IMU, two cameras of 752 x 480 at 20 Hz\n")
    columns = 'recording rate messages lost median_ms p99_ms max_ms CPU_% MB growth_MB'.split()
    print(f'| {" | ".join(columns).replace("_", " ")} |')
    print('|---' + '|--:' * (len(columns) - 1) + '|')
    for name, file, seconds, rate in cases:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / file
            (write_asl if file == 'asl' else write_bag)(path, seconds)
            row = measure(path, seconds, rate)
        print(
            f'| {name} | {rate:g} | {row.messages:,} | {row.lost} | {row.median_ms:.2f} '
            f'| {row.p99_ms:.2f} | {row.max_ms:.1f} | {row.cpu_percent:.0f} '
            f'| {row.first_mb:.0f} | {row.growth_mb:+.1f} |',
            flush=True,
        )


if __name__ == '__main__':
    main()
