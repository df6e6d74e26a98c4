"""Measures the noise of an IMU on a record of it at rest: Allan deviation, Kalibr's imu.yaml."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from vio_eval_ros.cli.limits import add_limits, chosen_limits
from vio_eval_ros.cli.shell import Parser, progress, run
from vio_eval_ros.cli.targets import add_reports, check_targets, show, Target, written
from vio_eval_ros.errors import PASSED, UNABLE
from vio_eval_ros.imu.analysis import Analysis, UNITS
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.imu.noise_page import html_document
from vio_eval_ros.imu.noise_reports import json_document, kalibr_document, plot, table
from vio_eval_ros.imu.recorded import imu_noise, require

VERB = 'imu_noise'
EXAMPLES = """
examples:
  imu_noise rest.mcap --topic /imu0 --report kalibr:imu.yaml --report html:noise.html
  imu_noise mav0/imu0/data.csv --report png:allan.png --json > noise.json

The sensor should be at rest and warmed up, the record several hours long. What the record is too
short to determine is null, with the reason.

formats of --report: html (interactive curves), png (the same as a picture), kalibr (Kalibr's
imu.yaml), json

exit status: 0 done, 2 could not be done
"""
REPORTS: dict[str, Callable[[Analysis], str | bytes]] = {
    'html': html_document,
    'json': json_document,
    'kalibr': kalibr_document,
    'png': plot,
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
    for kind, sensor in (('gyro', 'gyroscope'), ('accel', 'accelerometer')):
        parser.add_argument(
            f'--{kind}-unit',
            choices=UNITS[kind],
            help=f'of the {sensor} in the record (default: as its header states, else by its '
            'magnitude)',
        )
    add_limits(parser.add_argument_group('limits'))
    output = parser.add_argument_group('output')
    add_reports(output, REPORTS)
    return parser


def _imu_noise(arguments: argparse.Namespace) -> int:
    targets = [Target.parse(text, REPORTS) for text in arguments.report]
    inputs = [path for path in (arguments.record, arguments.limits) if path]
    check_targets(targets, inputs, arguments.json)
    formats = {target.format for target in targets}
    for library in (LIBRARIES[name] for name in sorted(formats & LIBRARIES.keys())):
        require(library)
    analysis = imu_noise(
        arguments.record,
        arguments.topic,
        gyro_unit=arguments.gyro_unit,
        accel_unit=arguments.accel_unit,
        limits=chosen_limits(arguments, VERB, ImuNoiseLimits),
        profile=arguments.profile,
        progress=progress,
    )
    summary = json_document if arguments.json else table
    show(partial(summary, analysis), targets)
    done = [written(VERB, target, partial(REPORTS[target.format], analysis)) for target in targets]
    return PASSED if all(done) else UNABLE
