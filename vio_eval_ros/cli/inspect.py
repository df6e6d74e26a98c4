"""Looks for faults in the sensor streams of a recording: rates, gaps, clocks, synchronisation."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
import re

from vio_eval_ros.cli.limits import add_limits, chosen_limits
from vio_eval_ros.cli.shell import complain, Parser, progress, run
from vio_eval_ros.cli.targets import add_reports, check_targets, show, Target, written
from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, UNABLE, VioEvalError
from vio_eval_ros.inspection.expectations import Expectations
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.html_report import html_document
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.recording import inspect_recording
from vio_eval_ros.inspection.report import json_document
from vio_eval_ros.inspection.text_report import text_document
from vio_eval_ros.recordings.clips import Clips
from vio_eval_ros.recordings.playback import Playback
from vio_eval_ros.rendering.files import check_folder, make_writable, write

VERB = 'inspect'
EXAMPLES = """
examples:
  inspect V1_02_medium.bag
  inspect run.mcap --expect config/euroc.yaml --report html:run.html
  inspect run.mcap --calibration camchain-imucam.yaml
  inspect run.mcap --profile car --limits limits.yaml
  inspect run.mcap --fail-on gap,stuck --clip clips

exit status: 0 inspected, 1 an expectation is not met or something named by --fail-on was found,
2 the recording could not be inspected
"""
REPORTS = {'html': html_document, 'json': json_document, 'text': text_document}
MAX_CLIPS = 20
# of a finding that lasts longer, the clip has the beginning
FINDING_CLIP_S = 5.0
MAX_MARGIN_S = 3600


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run(VERB, lambda: _run(arguments))


def _parser() -> Parser:
    parser = Parser(prog=VERB, description=__doc__, epilog=EXAMPLES)
    parser.add_argument(
        'recording',
        type=Path,
        metavar='RECORDING',
        help='ROS 1 .bag, rosbag2 folder, .db3, .mcap or EuRoC folder',
    )
    parser.add_argument(
        '--expect',
        type=Path,
        metavar='FILE.yaml',
        help='what the streams should be like, such as config/euroc.yaml',
    )
    parser.add_argument(
        '--calibration',
        nargs='+',
        type=Path,
        default=[],
        metavar='FILE',
        help="also check Kalibr's camchain.yaml and imu.yaml, EuRoC's sensor.yaml or its folder",
    )
    add_limits(parser.add_argument_group('limits'))
    output = parser.add_argument_group('output')
    add_reports(output, REPORTS)
    output.add_argument(
        '--fail-on',
        metavar='NAME,...',
        default='',
        help='exit with status 1 if one of these is found (names: docs/inspect.md)',
    )
    output.add_argument(
        '--clip',
        type=Path,
        metavar='DIR',
        help=f'cut a small mcap around each of the first {MAX_CLIPS} findings that have a time',
    )
    output.add_argument(
        '--clip-s',
        type=float,
        default=1.0,
        metavar='S',
        help='how much a clip has before and after the finding (default: 1)',
    )
    return parser


def _run(arguments: argparse.Namespace) -> int:
    failing = [name for name in arguments.fail_on.split(',') if name]
    targets = [Target.parse(text, REPORTS) for text in arguments.report]
    _check(arguments, failing, targets)
    report = inspect_recording(
        arguments.recording,
        arguments.calibration,
        Expectations.load(arguments.expect) if arguments.expect is not None else None,
        profile=arguments.profile,
        limits=chosen_limits(arguments, VERB, InspectionLimits),
        progress=progress,
    )
    summary = json_document if arguments.json else text_document
    show(partial(summary, report), targets)
    done = [written(VERB, target, partial(REPORTS[target.format], report)) for target in targets]
    if arguments.clip is not None:
        done.append(_clipped(arguments, report.findings))
    if not all(done):
        return UNABLE
    return FAILED if report.has_failed(failing) else PASSED


def _check(
    arguments: argparse.Namespace, failing: Sequence[str], targets: Sequence[Target]
) -> None:
    """Check the arguments, before a long recording is read."""
    for name in failing:
        if name not in FINDINGS:
            near = nearest_name(name, FINDINGS) or f'; {", ".join(FINDINGS)}'
            raise ConfigError(f"--fail-on: there is no finding '{name}'{near}")
    if not 0 <= arguments.clip_s <= MAX_MARGIN_S:
        raise ConfigError(f'--clip-s: expected a number of seconds from 0 to {MAX_MARGIN_S}')
    optional = [path for path in (arguments.expect, arguments.limits) if path is not None]
    inputs = [arguments.recording, *arguments.calibration, *optional]
    check_targets(targets, inputs, arguments.json)
    if arguments.clip is not None:
        _check_clips(arguments.clip, arguments.recording)


def _check_clips(folder: Path, recording: Path) -> None:
    """Raise ``ConfigError`` where clips cannot be, before a long recording is read."""
    if not folder.parent.is_dir():
        raise ConfigError(f'--clip: there is no folder {folder.parent}')
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f'--clip: {folder} is not a folder')
    if recording.resolve() in (folder.resolve(), *folder.resolve().parents):
        raise ConfigError(f'--clip: {folder} is in the recording')
    check_folder(folder if folder.exists() else folder.parent)


def _clipped(arguments: argparse.Namespace, findings: Sequence[Finding]) -> bool:
    """Return whether the clips could be written; what was found has been printed already."""
    timed = [finding for finding in findings if finding.moments]
    try:
        make_writable(arguments.clip)
        for line in _clips(arguments, timed[:MAX_CLIPS]):
            if not (arguments.json or any(text.endswith(':-') for text in arguments.report)):
                print(line)
    except VioEvalError as error:
        complain(VERB, f'--clip: {error}')
        return False
    if len(timed) > MAX_CLIPS:
        complain(VERB, f'--clip: {len(timed) - MAX_CLIPS} more findings have no clip')
    return True


def _clips(arguments: argparse.Namespace, findings: Sequence[Finding]) -> Iterator[str]:
    """Write a clip around the first time of each finding; yield a line for each."""
    margin_ns = round(1e9 * arguments.clip_s)
    with Playback(arguments.recording) as playback:
        clips = Clips(playback)
        yield from (f'clips are without a topic: {line}' for line in clips.left_out)
        for k, finding in enumerate(findings, 1):
            topic = re.sub(r'\W+', '_', finding.topic).strip('_')
            path = arguments.clip / f'{k:02}_{finding.name}_{topic}.mcap'
            moment = finding.moments[0]
            begin_ns = moment.logged_begin_ns
            end_ns = min(moment.logged_end_ns, begin_ns + round(1e9 * FINDING_CLIP_S))
            content, count = clips.cut(begin_ns - margin_ns, end_ns + margin_ns)
            write(path, content)
            yield f'clip  {path}: {count} messages'
