"""Writes a run with known truth: a simulated flight, or a real run, with chosen faults."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from vio_eval_ros.cli.shell import Parser, progress, run
from vio_eval_ros.conversion.staging import check_out
from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError, PASSED
from vio_eval_ros.imu.analysis import KALIBR
from vio_eval_ros.imu.fit import PARAMETERS
from vio_eval_ros.imu.simulated_noise import EUROC, Noise, NoiseModel
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.rendering.text import printable
from vio_eval_ros.settings import finite, load_yaml
from vio_eval_ros.simulation import at_rest, Drift, FAULTS, simulate, SimulatedRun
from vio_eval_ros.simulation.faults import inject, parse_fault, usage
from vio_eval_ros.simulation.formats import format_of, FORMATS, write_recording

VERB = 'simulate'
SEED = 7
DURATION_S = 60.0
NOISE_FLAGS = {
    key: '--' + key.replace('scope', '').replace('erometer', '').replace('_', '-')
    for key in KALIBR
}
EXAMPLES = """
examples:
  simulate run.mcap --fault time_offset=0.05 --fault scale=1.1
  simulate faulty --format tum --from est.txt --ground-truth gt.txt --fault outliers=0.01,2
  simulate rest.bag --still --duration-s 10800

exit status: 0 done, 2 could not be done
"""

# least value of a drift, and what is expected; of all others 0
MIN_DRIFT = {'scale_drift': (-1e6, 'a number'), 'scale': (1e-6, 'a number above 0')}


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run(VERB, lambda: _simulate(arguments))


def _parser() -> Parser:
    parser = Parser(prog=VERB, description=__doc__, epilog=_faults() + EXAMPLES)
    parser.add_argument(
        'out', type=Path, metavar='OUT', help='file or folder to write; must not exist'
    )
    parser.add_argument(
        '--format',
        choices=FORMATS,
        help='ros1 writes a bag, mcap a file, rosbag2 (with mcap) and sqlite3 a rosbag2 folder, '
        'tum and euroc a folder of files (default: by the suffix of OUT: .bag ros1, .mcap mcap, '
        'otherwise rosbag2)',
    )
    parser.add_argument(
        '--fault',
        action='append',
        default=[],
        metavar='NAME=SIZE',
        help='one of those below; may be repeated, and they are applied in that order',
    )
    parser.add_argument(
        '--seed',
        type=int,
        default=SEED,
        help='of flight, drift, noise and faults; the same seed writes the same bytes '
        f'(default: {SEED})',
    )
    flight = parser.add_argument_group('a simulated flight')
    flight.add_argument('--duration-s', metavar='S', help=f'duration (default: {DURATION_S:g})')
    flight.add_argument(
        '--drift',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='errors of the estimate: '
        + ', '.join(f'{field.name} ({field.default:g})' for field in fields(Drift))
        + ', or none; may be repeated',
    )
    flight.add_argument(
        '--still', action='store_true', help='only an IMU at rest, as imu_noise needs it'
    )
    flight.add_argument(
        '--imu-noise',
        type=Path,
        metavar='FILE',
        help="noise of the IMU: Kalibr's imu.yaml or EuRoC's sensor.yaml; the flags below "
        "override it (default: EuRoC's ADIS16448)",
    )
    for key, (kind, attribute) in KALIBR.items():
        default = getattr(getattr(EUROC, kind), attribute)
        unit = PARAMETERS[attribute].units[kind]
        flight.add_argument(
            NOISE_FLAGS[key], dest=key, metavar='X', help=f'in {unit} (default: {default:g})'
        )
    real = parser.add_argument_group('a real run')
    real.add_argument(
        '--from', dest='source', metavar='SPEC', help='an estimate, as replay reads it'
    )
    real.add_argument('--ground-truth', metavar='SPEC', help='its ground truth, written as well')
    return parser


def _faults() -> str:
    rows = [f'  {usage(name):<24}{fault.does}' for name, fault in FAULTS.items()]
    return '\n'.join(['faults, named as diagnose names them:', *rows, ''])


def _simulate(arguments: argparse.Namespace) -> int:
    kind = format_of(arguments.out, arguments.format)
    check_out(arguments.out)
    faults = [parse_fault(text) for text in arguments.fault]
    if arguments.seed < 0:
        raise ConfigError('--seed: expected a whole number >= 0')
    notes: list[str] = []
    made = _real_run(arguments, notes) if arguments.source else _simulated_run(arguments)
    source = np.random.default_rng(arguments.seed)
    for name, sizes in faults:
        made = inject(made, name, sizes, source)
    write_recording(made, arguments.out, kind)
    lines = [*notes, *_text(made, arguments.out, kind, arguments.fault)]
    print('\n'.join(map(printable, lines)))
    return PASSED


def _simulated_run(arguments: argparse.Namespace) -> SimulatedRun:
    if arguments.ground_truth is not None:
        raise ConfigError('--ground-truth goes with --from; a simulated flight has its own')
    duration_s = finite(DURATION_S if arguments.duration_s is None else arguments.duration_s)
    if not duration_s > 0:
        raise ConfigError('--duration-s: expected a positive number of seconds')
    noise = _noise(arguments)
    if not arguments.still:
        return simulate(duration_s, arguments.seed, _drift(arguments.drift), noise)
    if arguments.drift:
        raise ConfigError('--drift does not go with --still: there is no estimate')
    return at_rest(duration_s, arguments.seed, noise)


def _real_run(arguments: argparse.Namespace, notes: list[str]) -> SimulatedRun:
    """Return a run as it was recorded; what was left out or assumed is added to the notes."""
    of_flights = {
        name: f'--{name.replace("_", "-")}'
        for name in ('duration_s', 'drift', 'still', 'imu_noise')
    } | NOISE_FLAGS
    for name, flag in of_flights.items():
        if getattr(arguments, name) not in (None, False, []):
            raise ConfigError(f'{flag} does not go with --from')
    specs = [spec for spec in (arguments.source, arguments.ground_truth) if spec]
    poses = []
    for source in read_sources(specs, progress=progress):
        counts = Cleaning()
        poses.append(clean(source.poses, counts))
        notes += [f'{source.spec}: {warning}' for warning in source.warnings]
        notes += [
            f'{source.spec}: {count} poses left out: {reason.replace("_", " ")}'
            for reason, count in counts.dropped.items()
            if count
        ]
    return SimulatedRun(poses[1] if len(poses) > 1 else Trajectory.empty(), poses[0])


def _drift(texts: Sequence[str]) -> Drift:
    """Return the drift of an estimate that the command line asks for."""
    drift = Drift()
    names = [field.name for field in fields(Drift)]
    for text in texts:
        if text == 'none':
            drift = Drift(**dict.fromkeys(names, 0.0) | {'scale': 1.0})
            continue
        name, _, given = text.partition('=')
        if name not in names:
            near = nearest_name(name, names) or f'; there are {", ".join(names)}'
            raise ConfigError(f"--drift: there is no '{name}'{near}")
        value = finite(given)
        low, what = MIN_DRIFT.get(name, (0.0, 'a number >= 0'))
        if not value >= low:
            raise ConfigError(f'--drift {text}: expected {what}')
        drift = replace(drift, **{name: value})
    return drift


def _noise(arguments: argparse.Namespace) -> NoiseModel:
    """Return the noise of the IMU: of the flags, else of the file, else EuRoC's."""
    stated = {key: getattr(arguments, key) for key in KALIBR}
    values = {key: getattr(getattr(EUROC, kind), name) for key, (kind, name) in KALIBR.items()}
    if arguments.imu_noise is not None:
        values = _noise_file(arguments.imu_noise)
    values |= {key: value for key, value in stated.items() if value is not None}
    numbers: dict[str, dict[str, float]] = {'gyro': {}, 'accel': {}}
    for key, (kind, name) in KALIBR.items():
        numbers[kind][name] = finite(values[key])
        if not numbers[kind][name] >= 0:
            raise ConfigError(f'{NOISE_FLAGS[key]}: expected a number >= 0')
    return NoiseModel(**{kind: Noise(**of_kind) for kind, of_kind in numbers.items()})


def _noise_file(path: Path) -> dict[str, Any]:
    """Return the values of Kalibr's keys in a calibration file."""
    expected = f'a calibration with {", ".join(KALIBR)}'
    content = load_yaml(path, expected)
    # a chain has the keys of each IMU under its name
    for part in (content, *(part for part in content.values() if isinstance(part, dict))):
        if KALIBR.keys() <= part.keys():
            return {key: part[key] for key in KALIBR}
    raise ConfigError(f'{path}: expected {expected}')


def _text(made: SimulatedRun, out: Path, kind: str, faults: Sequence[str]) -> list[str]:
    """Return what was written."""
    counts = {
        'ground truth': len(made.ground_truth),
        'estimates': len(made.estimate),
        'IMU samples': 0 if made.imu is None else len(made.imu.stamps_ns),
    }
    held = ', '.join(f'{count:,} {name}' for name, count in counts.items() if count)
    return [
        f'{out} ({kind}): {held}',
        f'faults: {", ".join(faults) or "none"}',
    ]
