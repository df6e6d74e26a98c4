"""Measures the noise of an IMU on a record of it at rest: Allan deviation, Kalibr's imu.yaml."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

from vio_eval_ros.cli.shell import complain, Parser, PASSED, progress, run, UNABLE
from vio_eval_ros.errors import ConfigError, VioEvalError, WriteError
from vio_eval_ros.imu.analysis import analyse, Analysis, UNITS
from vio_eval_ros.imu.documents import json_document, kalibr_document, plot, table
from vio_eval_ros.imu.record import Record
from vio_eval_ros.recordings.imu import ImuSource, read_imu
from vio_eval_ros.reports import write

VERB = 'imu_noise'
EXAMPLES = """
examples:
  imu_noise rest.mcap --topic /imu0 --kalibr imu.yaml
  imu_noise mav0/imu0/data.csv --plot allan.png --json > noise.json

The record should be of a sensor at rest and warmed up, several hours long. What it is too short
to tell is null, with the reason.

exit status: 0 done, 2 could not be done
"""


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run(VERB, lambda: _imu_noise(arguments))


def _parser() -> Parser:
    parser = Parser(prog=VERB, description=__doc__, epilog=EXAMPLES)
    parser.add_argument(
        'record',
        type=Path,
        metavar='RECORDING|CSV',
        help='ROS 1 .bag, rosbag2 folder, .db3, .mcap or EuRoC folder with sensor_msgs/Imu; or a '
        '.csv of time, angular rates x y z and accelerations x y z, or with names in its header',
    )
    parser.add_argument('--topic', help='of the IMU (default: the only one there is)')
    parser.add_argument(
        '--gyro-unit', choices=UNITS['gyro'], help='of the record (default: told by magnitude)'
    )
    parser.add_argument(
        '--accel-unit', choices=UNITS['accel'], help='of the record (default: told by magnitude)'
    )
    output = parser.add_argument_group('output')
    output.add_argument(
        '--json', action='store_true', help='print the result as JSON, and nothing else, on stdout'
    )
    output.add_argument('--plot', type=Path, metavar='FILE.png', help='draw the curves')
    output.add_argument('--kalibr', type=Path, metavar='FILE', help='write an imu.yaml for Kalibr')
    return parser


def _imu_noise(arguments: argparse.Namespace) -> int:
    _check_outputs(arguments)
    record = Record(arguments.record)
    source = read_imu(arguments.record, arguments.topic, record.add, progress)
    stated = dict(source.units)
    for kind in UNITS:
        if getattr(arguments, f'{kind}_unit'):
            stated[kind] = getattr(arguments, f'{kind}_unit')
    analysis = analyse(str(source), record.finish(), stated)
    print(json_document(analysis) if arguments.json else table(analysis), end='', flush=True)
    done = [
        _written(option, arguments, source, analysis)
        for option in ('kalibr', 'plot')
        if getattr(arguments, option) is not None
    ]
    return PASSED if all(done) else UNABLE


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Raise ``ConfigError`` before hours of samples are read for what cannot be written."""
    for library in ('allantools', *(['matplotlib'] if arguments.plot else [])):
        if find_spec(library) is None:
            raise ConfigError(f"{library} is needed: pip install {library}, or the extra 'imu'")
    paths = [path for path in (arguments.kalibr, arguments.plot) if path is not None]
    for path in paths:
        if not path.parent.is_dir():
            raise ConfigError(f'{path}: there is no folder {path.parent}')
        if path.resolve() == arguments.record.resolve():
            raise ConfigError(f'{path} would overwrite the input')
    if len({path.resolve() for path in paths}) < len(paths):
        raise ConfigError('--kalibr and --plot name the same file')
    if arguments.plot is not None and arguments.plot.suffix.lower() != '.png':
        raise ConfigError(f'{arguments.plot}: a plot is a PNG; let its name end in .png')


def _written(
    option: str, arguments: argparse.Namespace, source: ImuSource, analysis: Analysis
) -> bool:
    """Return whether a file could be written; the result has been printed already."""
    path: Path = getattr(arguments, option)
    try:
        if option == 'kalibr':
            write(path, kalibr_document(analysis, source.topic or '/imu0'))
        else:
            _write_png(path, plot(analysis))
    except VioEvalError as error:
        complain(VERB, f'--{option}: {error}')
        return False
    return True


def _write_png(path: Path, png: bytes) -> None:
    temporary = path.with_name(f'.{path.name}.part')
    try:
        temporary.write_bytes(png)
        temporary.replace(path)
    except OSError as error:
        raise WriteError(path, error.strerror or str(error)) from None
