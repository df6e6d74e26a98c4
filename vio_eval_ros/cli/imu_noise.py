"""Measures the noise of an IMU on a record of it at rest: Allan deviation, Kalibr's imu.yaml."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from vio_eval_ros.cli.shell import Parser, progress, run
from vio_eval_ros.cli.targets import add_reports, check_targets, Target, written
from vio_eval_ros.errors import ConfigError, PASSED, UNABLE
from vio_eval_ros.imu.analysis import analyse, Analysis, UNITS
from vio_eval_ros.imu.noise_page import html_document
from vio_eval_ros.imu.noise_reports import json_document, kalibr_document, plot, table
from vio_eval_ros.imu.record import Record
from vio_eval_ros.recordings.imu import read_imu

VERB = 'imu_noise'
EXAMPLES = """
examples:
  imu_noise rest.mcap --topic /imu0 --report kalibr:imu.yaml --report html:noise.html
  imu_noise mav0/imu0/data.csv --report png:allan.png --json > noise.json

The record should be of a sensor at rest and warmed up, several hours long. What it is too short
to tell is null, with the reason.

formats of --report: html (interactive curves), png (the same as a picture), kalibr (Kalibr's
imu.yaml), json

exit status: 0 done, 2 could not be done
"""
# takes the analysis and the topic of the IMU
REPORTS: dict[str, Callable[[Analysis, str], str | bytes]] = {
    'html': lambda analysis, topic: html_document(analysis),
    'json': lambda analysis, topic: json_document(analysis),
    'kalibr': kalibr_document,
    'png': lambda analysis, topic: plot(analysis),
}
LIBRARIES = {'html': 'plotly', 'png': 'matplotlib'}


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
    add_reports(output, REPORTS)
    return parser


def _imu_noise(arguments: argparse.Namespace) -> int:
    targets = [Target.parse(text, REPORTS) for text in arguments.report]
    check_targets(targets, [arguments.record])
    needed = {LIBRARIES[target.format] for target in targets if target.format in LIBRARIES}
    for library in ('allantools', *sorted(needed)):  # asked before hours of samples are read
        if find_spec(library) is None:
            raise ConfigError(f"{library} is needed: pip install {library}, or the extra 'imu'")
    record = Record(arguments.record)
    source = read_imu(arguments.record, arguments.topic, record.add, progress)
    stated = dict(source.units)
    for kind in UNITS:
        if getattr(arguments, f'{kind}_unit'):
            stated[kind] = getattr(arguments, f'{kind}_unit')
    analysis = analyse(str(source), record.finish(), stated)
    print(json_document(analysis) if arguments.json else table(analysis), end='', flush=True)
    topic = source.topic or '/imu0'
    done = [
        written(VERB, target, partial(REPORTS[target.format], analysis, topic))
        for target in targets
    ]
    return PASSED if all(done) else UNABLE
