"""
Measures `imu_noise` on 6 h at 200 Hz: time, memory, and the error of the noise parameters.

Writes the section IMU noise of docs/benchmarks.md, with --quick only prints, of 20 min; exits with
1 where a target is missed.
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

from vio_eval_ros.imu.simulated_noise import EUROC
from vio_eval_ros.simulation import at_rest, write_recording
from vio_eval_ros.simulation.simulated_run import IMU_RATE_HZ

PROJECT = Path(__file__).resolve().parents[1]
TITLE = 'IMU noise'
KINDS = {
    'ROS 1 bag': ('rest.bag', 'ros1'),
    'mcap': ('rest.mcap', 'mcap'),
    'rosbag2, sqlite3': ('rest', 'sqlite3'),
    'EuRoC folder': ('rest', 'euroc'),
}
SEED = 1
MOST_S, MOST_MIB = 60.0, 1000.0


class Measured(NamedTuple):
    """Time and peak memory of one process, and the largest errors of what it found."""

    seconds: float
    cpu_s: float
    mebibytes: float
    density_percent: float
    walk_percent: float


def write_record(path: Path, kind: str, hours: float) -> None:
    """Write a simulated IMU that lies still."""
    write_recording(at_rest(3600 * hours, SEED, EUROC), path, kind)


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


def targets(measured: dict[str, list[Measured]], hours: float) -> Iterator[Target]:
    """Yield what is promised of the recording that takes most."""
    slowest = max(measured.values(), key=lambda runs: median(run.seconds for run in runs))
    largest = max(measured.values(), key=lambda runs: median(run.mebibytes for run in runs))
    seconds, mebibytes = [run.seconds for run in slowest], [run.mebibytes for run in largest]
    density = max(run.density_percent for runs in measured.values() for run in runs)
    walk = max(run.walk_percent for runs in measured.values() for run in runs)
    yield Target(
        f'At most {MOST_S:g} s, for any kind of recording',
        f'{ranged(seconds, 1)} s',
        median(seconds) <= MOST_S,
    )
    yield Target(
        f'At most {MOST_MIB:g} MiB', f'{ranged(mebibytes, 0)} MiB', median(mebibytes) <= MOST_MIB
    )
    yield Target('Density of each axis within 5 %', f'{density:.2f} %', density <= 5)
    if hours > 1:  # which a random walk takes to be seen
        yield Target('Random walk of each axis within 15 %', f'{walk:.1f} %', walk <= 15)


def table(measured: dict[str, list[Measured]]) -> Iterator[str]:
    """Yield the lines of a Markdown table of all recordings."""
    columns = 'time [s] | CPU [s] | peak memory [MiB] | error of density | of random walk'
    yield f'| recording | {columns} |'
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
        for title, (name, kind) in KINDS.items():
            path = Path(folder, name)
            # in another process: the memory of this one is charged to `imu_noise`, its child
            writer = get_context('spawn').Process(target=write_record, args=(path, kind, hours))
            writer.start()
            writer.join()
            if writer.exitcode:
                return 1
            measured[title] = [measure(path) for _ in range(rounds)]
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    lines = [
        f'`imu_noise` of {hours:.2g} h of a simulated IMU at {IMU_RATE_HZ:g} Hz, '
        f'{round(hours * 3600 * IMU_RATE_HZ):,} samples. '
        'Measured by `benchmarks/imu_noise.py`.',
        '',
        *targets_table(promised := list(targets(measured, hours))),
        '',
        *table(measured),
        '',
        'Time is that of the whole process, memory the largest resident set. The errors are the '
        "largest of all six axes; the simulated noise is that of EuRoC's ADIS16448.",
        '',
        machine('numpy', 'rosbags', 'mcap', 'allantools'),
    ]
    print('\n'.join(lines))
    if not options.quick:
        document.write(TITLE, lines)
    return 0 if all(target.met for target in promised) else 1


if __name__ == '__main__':
    sys.exit(main())
