"""
Measures `imu_noise` on 6 h at 200 Hz: time, memory, and what it finds of the noise put in.

Writes the section Noise of an IMU of docs/benchmarks.md, with --quick only prints, of 20 min;
exits with 1 where a target is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
from multiprocessing import get_context
import os
from pathlib import Path
import shutil
from statistics import median
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

import document
from document import machine, ranged, Target, targets_table
import numpy as np
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.imu.simulate import EUROC, simulate_noise

PROJECT = Path(__file__).resolve().parents[1]
TITLE = 'Noise of an IMU'
FIRST_NS, PERIOD_NS, RATE_HZ = 1_403_636_579_763_555_584, 5_000_000, 200.0
IMU = 'sensor_msgs/msg/Imu'
MARKS = (11.0, 12.0, 13.0, 21.0, 22.0, 23.0)  # of the template
BLOCK = 100_000
KINDS = {
    'ROS 1 bag': 'rest.bag',
    'rosbag2 mcap': 'rest.mcap',
    'rosbag2 sqlite3': 'rest',
    'CSV': 'rest.csv',
}
EUROC_NAMES = (
    *(f'w_RS_S_{axis} [rad s^-1]' for axis in 'xyz'),
    *(f'a_RS_S_{axis} [m s^-2]' for axis in 'xyz'),
)
MOST_S, MOST_MIB = 60.0, 1000.0


class Measured(NamedTuple):
    """Time and peak memory of one process, and the largest errors of what it found."""

    seconds: float
    cpu_s: float
    mebibytes: float
    density_percent: float
    walk_percent: float


def write_record(path: Path, hours: float) -> None:
    """Write a simulated record as a recording, after the end of its name, or as EuRoC's CSV."""
    count = round(hours * 3600 * RATE_HZ)
    samples = simulate_noise(count, RATE_HZ, EUROC, np.random.default_rng(1))
    samples[:, 5] += 9.81
    if path.suffix == '.csv':
        with path.open('w') as file:
            file.write('#timestamp [ns],' + ','.join(EUROC_NAMES) + '\n')
            for first, block in _blocks(samples):
                stamps = range(FIRST_NS + first * PERIOD_NS, 1 << 62, PERIOD_NS)
                file.writelines(
                    f'{stamp},{row[0]!r},{row[1]!r},{row[2]!r},{row[3]!r},{row[4]!r},{row[5]!r}\n'
                    for stamp, row in zip(stamps, block.tolist(), strict=False)
                )
        return
    ros1 = path.suffix == '.bag'
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    plugin = StoragePlugin.MCAP if path.suffix == '.mcap' else StoragePlugin.SQLITE3
    writer = Rosbag1Writer(path) if ros1 else Rosbag2Writer(path, version=9, storage_plugin=plugin)
    template = _template(store, ros1)
    with writer:
        connection = writer.add_connection('/imu0', IMU, typestore=store)
        for first, block in _blocks(samples):
            stamps_ns = FIRST_NS + PERIOD_NS * np.arange(first, first + len(block))
            for stamp_ns, row in zip(
                stamps_ns.tolist(), _filled(template, ros1, stamps_ns, block), strict=True
            ):
                writer.write(connection, stamp_ns, row.tobytes())


def _blocks(samples: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    for first in range(0, len(samples), BLOCK):
        yield first, samples[first : first + BLOCK]


def _template(store, ros1: bool) -> bytes:
    types = store.types
    time_ = types['builtin_interfaces/msg/Time'](0, 0)
    header = types['std_msgs/msg/Header'](*([0] if ros1 else []), time_, 'imu0')
    vector, level = types['geometry_msgs/msg/Vector3'], types['geometry_msgs/msg/Quaternion']
    unknown = np.zeros(9)
    message = types[IMU](
        header,
        level(0.0, 0.0, 0.0, 1.0),
        unknown,
        vector(*MARKS[:3]),
        unknown,
        vector(*MARKS[3:]),
        unknown,
    )
    return bytes((store.serialize_ros1 if ros1 else store.serialize_cdr)(message, IMU))


def _filled(template: bytes, ros1: bool, stamps_ns: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Return a message a row, (N, B) bytes: the template with stamps and samples."""
    rows = np.tile(np.frombuffer(template, np.uint8), (len(samples), 1))
    stamps = np.column_stack(np.divmod(stamps_ns, 10**9)).astype('<u4').view(np.uint8)
    rows[:, 4:12] = stamps  # behind the counter of ROS 1, the preamble of ROS 2
    for begin in (0, 3):
        at = template.index(np.array(MARKS[begin : begin + 3]).tobytes())
        numbers = np.ascontiguousarray(samples[:, begin : begin + 3])
        rows[:, at : at + 24] = numbers.view(np.uint8)
    return rows


def measure(path: Path) -> Measured:
    """Return what one process took, and how far off its figures are."""
    command = [sys.executable, '-m', 'vio_eval_ros', 'imu_noise', str(path), '--json']
    begin = time.perf_counter()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(command, stdout=output, cwd=PROJECT)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f'imu_noise ended with {process.returncode} on {path}')
        output.seek(0)
        axes = json.load(output)['axes']
    errors = {
        (name, parameter): 100 * abs(axis['parameters'][parameter]['value'] / truth - 1)
        for name, axis in axes.items()
        for noise in [getattr(EUROC, name.partition('_')[0])]
        for parameter, truth in (
            ('white_noise_density', noise.density),
            ('random_walk', noise.walk),
        )
    }
    density, walk = (
        max(error for (_, name), error in errors.items() if name == parameter)
        for parameter in ('white_noise_density', 'random_walk')
    )
    cpu_s = usage.ru_utime + usage.ru_stime
    return Measured(seconds, cpu_s, usage.ru_maxrss / 1024, density, walk)


def targets(measured: dict[str, list[Measured]]) -> list[Target]:
    """Return what is promised of the recording that takes most."""
    slowest = max(measured.values(), key=lambda runs: median(run.seconds for run in runs))
    largest = max(measured.values(), key=lambda runs: median(run.mebibytes for run in runs))
    seconds, mebibytes = [run.seconds for run in slowest], [run.mebibytes for run in largest]
    density = max(run.density_percent for runs in measured.values() for run in runs)
    walk = max(run.walk_percent for runs in measured.values() for run in runs)
    return [
        Target(
            f'At most {MOST_S:g} s, whatever the recording',
            f'{ranged(seconds, 1)} s',
            median(seconds) <= MOST_S,
        ),
        Target(
            f'At most {MOST_MIB:g} MiB',
            f'{ranged(mebibytes, 0)} MiB',
            median(mebibytes) <= MOST_MIB,
        ),
        Target('Density of each axis within 5 %', f'{density:.2f} %', density <= 5),
        Target('Random walk of each axis within 15 %', f'{walk:.1f} %', walk <= 15),
    ]


def table(measured: dict[str, list[Measured]]) -> Iterator[str]:
    """Yield the lines of a Markdown table of all recordings."""
    yield '| recording | time [s] | CPU [s] | peak memory [MiB] | error of density | of walk |'
    yield '|---|---:|---:|---:|---:|---:|'
    for kind, runs in measured.items():
        yield (
            f'| {kind} | {ranged([run.seconds for run in runs], 1)} '
            f'| {ranged([run.cpu_s for run in runs], 1)} '
            f'| {ranged([run.mebibytes for run in runs], 0)} '
            f'| {runs[0].density_percent:.2f} % | {runs[0].walk_percent:.1f} % |'
        )


def main() -> int:
    """Measure, print and write; return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='20 min once; writes nothing')
    options = parser.parse_args()
    hours, rounds = (1 / 3, 1) if options.quick else (6.0, 3)
    measured: dict[str, list[Measured]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for kind, name in KINDS.items():
            path = Path(folder, name)
            # by a process of its own: that of `imu_noise` is charged with the memory of this one
            writer = get_context('spawn').Process(target=write_record, args=(path, hours))
            writer.start()
            writer.join()
            if writer.exitcode:
                return 1
            measured[kind] = [measure(path) for _ in range(rounds)]
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    lines = [
        f'`imu_noise` of {hours:.2g} h of a simulated IMU at {RATE_HZ:g} Hz, '
        f'{round(hours * 3600 * RATE_HZ):,} samples. '
        'Measured by `benchmarks/imu_noise.py`.',
        '',
        *targets_table(promised := targets(measured)),
        '',
        *table(measured),
        '',
        'Time is that of the whole process, memory the largest resident set. The errors are the '
        "largest of all six axes; the simulated noise is that of EuRoC's ADIS16448.",
        '',
        machine('numpy', 'rosbags', 'mcap', 'allantools'),
    ]
    print('\n'.join(lines))
    if not options.quick and TITLE in document.SECTIONS:
        document.write(TITLE, lines)
    return 0 if all(target.met for target in promised) else 1


if __name__ == '__main__':
    sys.exit(main())
