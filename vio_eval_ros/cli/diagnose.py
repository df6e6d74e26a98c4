"""Says why an estimate is bad: names the causes, with evidence, and what corrects them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
import json
from pathlib import Path

from vio_eval_ros.cli.command import called_as
from vio_eval_ros.cli.inputs import add_inputs, sources_of
from vio_eval_ros.cli.limits import add_limits, chosen_limits
from vio_eval_ros.cli.shell import add_options, config_of, Parser, progress, run
from vio_eval_ros.cli.targets import add_reports, check_targets, show, Target, written
from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.command import correcting_command
from vio_eval_ros.diagnosis.documents import diagnosis_text, signals_text
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.page import diagnosis_html, diagnosis_markdown
from vio_eval_ros.diagnosis.recorded import diagnose_sources, read_gyroscope, read_signal
from vio_eval_ros.diagnosis.report import Diagnosis
from vio_eval_ros.diagnosis.signals import lag_of_signals
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, UNABLE
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.figures.reports import FORMATS, overview_picture
from vio_eval_ros.figures.style import check_installed
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.rendering.text import printable

VERB = 'diagnose'
EXAMPLES = """
examples:
  diagnose run.mcap
  diagnose --estimate est.txt --ground-truth mav0 --apply
  diagnose run.mcap --fail-on time_offset,scale --json
  diagnose run.mcap --imu /imu0 --profile car
  diagnose --signals imu.csv camera.csv

exit status: 0 diagnosed, 1 a cause named by --fail-on was found, 2 not diagnosed
"""
#: with --signals none of these makes sense
OF_TRAJECTORIES = (
    'recording', 'estimate', 'ground_truth', 'times', 'imu', 'apply', 'fail_on', 'limits', 'report'
)  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run(VERB, lambda: _run(arguments))


def _parser() -> Parser:
    parser = Parser(prog=VERB, description=__doc__, epilog=EXAMPLES)
    add_inputs(parser)
    others = parser.add_argument_group('other comparisons')
    others.add_argument(
        '--imu',
        metavar='SPEC',
        help='also compare the estimate with a gyroscope: /topic of RECORDING, '
        'RECORDING:/topic, or a CSV file',
    )
    others.add_argument(
        '--signals',
        nargs=2,
        type=Path,
        metavar='CSV',
        help='only measure the lag between two signals, files of time and value',
    )
    output = parser.add_argument_group('output')
    add_reports(output, [*REPORTS, *FORMATS])
    output.add_argument(
        '--apply',
        action='store_true',
        help='show the errors before and after all causes are undone',
    )
    output.add_argument(
        '--fail-on',
        metavar='NAME,...',
        help='exit with status 1 if one of these causes is found',
    )
    add_limits(parser.add_argument_group('limits'))
    add_options(parser)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    if arguments.signals:
        return _signals(arguments)
    failing = _failing(arguments.fail_on)
    config = config_of(arguments)
    limits = chosen_limits(arguments, VERB, DiagnosisLimits)
    targets = [Target.parse(text, [*REPORTS, *FORMATS]) for text in arguments.report]
    check_installed(target.format for target in targets)
    estimate, truth = sources_of(arguments, arguments.estimate)
    check_targets(targets, [*estimate.paths, *truth.paths], arguments.json)
    rates = None
    if arguments.imu is not None:
        rates = read_gyroscope(arguments.imu, arguments.recording, progress)
    diagnosis = diagnose_sources(
        estimate, truth, config, profile=arguments.profile, limits=limits, gyroscope=rates
    )
    command = _command(arguments, diagnosis, estimate, truth, config)
    title = f'{estimate.spec} against {truth.spec}'
    done = [
        written(
            VERB,
            target,
            partial(_picture, estimate, truth, config, target.format)
            if target.format in FORMATS
            else partial(REPORTS[target.format], diagnosis, title, command),
        )
        for target in targets
    ]
    if arguments.json:
        print(_json(diagnosis, errors=arguments.apply), end='')
    else:
        lines = diagnosis_text(diagnosis, arguments.apply, command)
        show(lambda: ''.join(f'{printable(line)}\n' for line in lines), targets)
    if not all(done):
        return UNABLE
    return FAILED if {cause.name for cause in diagnosis.causes} & failing else PASSED


def _command(
    arguments: argparse.Namespace,
    diagnosis: Diagnosis,
    estimate: Source,
    truth: Source,
    config: EvaluationConfig,
) -> str:
    """Return what to type so that flags correct all that they can; empty where none does."""
    inputs = [str(arguments.recording)] if arguments.recording else []
    inputs += ['--times', str(arguments.times)] if arguments.times else []
    specs = {'estimate': estimate.spec, 'ground_truth': truth.spec}
    command = correcting_command(diagnosis.causes, specs, config, inputs)
    return f'{called_as()} {command}'.strip() if command else ''


def _json(diagnosis: Diagnosis, title: str = '', command: str = '', errors: bool = False) -> str:
    """Return the diagnosis in schema ``vio_eval_ros.diagnosis/1``."""
    return json.dumps(diagnosis.to_dict(errors=errors), indent=2, allow_nan=False) + '\n'


REPORTS: dict[str, Callable[[Diagnosis, str, str], str]] = {
    'json': _json,
    'markdown': diagnosis_markdown,
    'html': diagnosis_html,
}


def _picture(estimate: Source, truth: Source, config: EvaluationConfig, file_format: str) -> bytes:
    """Return figures of the run as it is, in which the causes can be seen."""
    result = score_run(estimate, truth, config, hashed=False)
    return overview_picture(file_format, {'estimate': result})


def _failing(listed: str | None) -> set[str]:
    """Return the causes listed by ``--fail-on``."""
    names = set() if listed is None else {name.strip() for name in listed.split(',')}
    for name in names:
        if name not in CAUSES:
            near = nearest_name(name, CAUSES) or f'; there are {", ".join(CAUSES)}'
            raise ConfigError(f"--fail-on: there is no cause '{name}'{near}")
    return names


def _signals(arguments: argparse.Namespace) -> int:
    """Print the lag between two signals."""
    for name in OF_TRAJECTORIES:
        if getattr(arguments, name):
            flag = name.upper() if name == 'recording' else f'--{name.replace("_", "-")}'
            raise ConfigError(f'--signals stands alone: leave out {flag}')
    signals = [read_signal(path) for path in arguments.signals]
    start_ns = signals[1].stamps_ns[0]
    first_s, second_s = ((signal.stamps_ns - start_ns) / 1e9 for signal in signals)
    found = lag_of_signals(first_s, signals[0].values, second_s, signals[1].values)
    left_out = [signal.left_out for signal in signals]
    if arguments.json:
        values = {'schema': 'vio_eval_ros.signal_lag/1'} | without_nan(vars(found))
        print(json.dumps(values | {'left_out': left_out}, indent=2, allow_nan=False))
    else:
        lines = signals_text(found, arguments.signals, left_out)
        print('\n'.join(map(printable, lines)))
    return PASSED
