"""Evaluates one recording, or a pair of trajectory files, offline."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from vio_eval_ros.cli.completion import complete
from vio_eval_ros.cli.inputs import add_inputs, each_source_of, named_estimates, sources_of
from vio_eval_ros.cli.shell import add_options, complain, config_of, Parser, run
from vio_eval_ros.cli.targets import add_reports, check_targets, show, Target, written
from vio_eval_ros.comparison.comparison import compared, Comparison, scorer
from vio_eval_ros.comparison.matrix import check_metrics, default_metrics
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import check_names, Gate
from vio_eval_ros.core.glossary import listed
from vio_eval_ros.core.series import running_series
from vio_eval_ros.core.statistics import STATISTICS
from vio_eval_ros.errors import ConfigError, FAILED, NoPairs, PASSED, UNABLE, VioEvalError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.figures.reports import FORMATS, overview_picture
from vio_eval_ros.figures.style import check_installed
from vio_eval_ros.recordings.agreement import comparable
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.rendering.terminal import check_plotext, wants_colour
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.compared import COMPARISON_REPORTS, comparison_text
from vio_eval_ros.reports.documents import json_report
from vio_eval_ros.reports.tables import series_csv
from vio_eval_ros.reports.text import text_report
from vio_eval_ros.scoring.stack import Stack, STACK_KEYS
from vio_eval_ros.settings import gates_of

SERIES = ('csv',)


def _picture_of_one(file_format: str, result: Result) -> bytes:
    return overview_picture(file_format, {'estimate': result})


def _picture(file_format: str, found: Comparison) -> bytes:
    return overview_picture(file_format, found.results, list(found.runs))


#: reports of one estimate, and of several
RENDERERS: dict[str, Callable[[Result], str | bytes]] = {
    **REPORTS,
    **{name: partial(_picture_of_one, name) for name in FORMATS},
}
COMPARISON_RENDERERS: dict[str, Callable[[Comparison], str | bytes]] = {
    **COMPARISON_REPORTS,
    **{name: partial(_picture, name) for name in FORMATS},
}
HASHED = ('json', 'html', 'mcap', 'manifest')  # show the sha256 of the inputs
RUNNING = ('mcap',)  # shows the running values
EXAMPLES = f"""
metrics, as gates and JSON name them; STATISTIC is one of {', '.join(STATISTICS)}:
{listed()}

examples:
  replay run.mcap --estimate /vio/odometry --ground-truth /ground_truth/pose
  replay --estimate est.txt --ground-truth mav0 --max-difference-s 0.01
  replay run.bag --ground-truth V1_02/data.csv --estimate /odometry \\
      --gate 'ate_trans_rmse_m<=0.1' --report json:result.json --report junit:result.xml
  replay --estimate VINS=vins.txt --estimate DSO=dso.txt --ground-truth gt.txt \\
      --metric ate_trans_rmse_m rpe_1s_trans_rmse_m --report table.tex
  replay run.mcap --manifest manifest.json --stack-commit 4f2a9c1 --stack-config vio.yaml

exit status: 0 done and passed, 1 a gate failed or one of several estimates could not be scored,
2 could not be done
"""


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run('replay', lambda: _replay(arguments))


def _parser() -> Parser:
    parser = Parser(
        prog='replay',
        description=__doc__,
        epilog=EXAMPLES,
    )
    add_inputs(parser, several=True)
    output = parser.add_argument_group('output')
    add_reports(output, RENDERERS)
    metric = output.add_argument(
        '--metric',
        nargs='+',
        default=[],
        metavar='NAME',
        help='the columns of the table of several estimates (default: ATE, RPE and coverage)',
    )
    complete(metric, lambda **_: metric_names(EvaluationConfig()))
    output.add_argument(
        '--series',
        metavar='csv:PATH',
        help='write the running ATE and RPE, once per second of stamps',
    )
    output.add_argument(
        '--plot',
        choices=('terminal',),
        help='also draw the error over time and the path from above in characters',
    )
    gate = output.add_argument(
        '--gate',
        action='append',
        default=[],
        metavar='METRIC<=LIMIT',
        help='exit with status 1 if a metric is beyond a limit (<= or >=) or null; '
        'may be repeated',
    )
    complete(gate, lambda **_: [f'{name}<=' for name in metric_names(EvaluationConfig())])
    output.add_argument(
        '--gates',
        type=Path,
        metavar='FILE',
        help='YAML file of gates: {metric: {max: number, min: number}}',
    )
    _add_provenance(parser)
    add_options(parser)
    return parser


def _add_provenance(parser: Parser) -> None:
    group = parser.add_argument_group('manifest')
    group.add_argument(
        '--manifest',
        type=Path,
        metavar='FILE',
        help='record what the result was made of, for `score --verify FILE`; the other options of '
        'this group state what it records',
    )
    group.add_argument(
        '--sequence', metavar='NAME', help='name of the sequence (default: that of its file)'
    )
    for part in ('name', 'version', 'commit'):
        group.add_argument(
            f'--stack-{part}', metavar=part.upper(), help=f'{part} of the software under test'
        )
    for flag, what in (('--stack-config', 'configuration'), ('--calibration', 'calibration')):
        group.add_argument(
            flag,
            nargs='+',
            type=Path,
            metavar='FILE',
            help=f'its {what} files, whose text is included',
        )


def _replay(arguments: argparse.Namespace) -> int:
    if arguments.plot and (
        arguments.json or any(text.endswith(':-') for text in arguments.report)
    ):
        raise ConfigError('--plot terminal draws beside the summary; leave out what replaces it')
    if arguments.plot:
        check_plotext()
    config = config_of(arguments)
    gates = _gates(arguments, config)
    named = named_estimates(arguments)
    if len(named) > 1:
        return _compare(arguments, named, config, gates)
    if arguments.metric:
        raise ConfigError('--metric needs several estimates: --estimate NAME=SPEC for each system')
    outputs = _outputs(arguments)
    check_installed(target.format for target, _ in outputs)
    estimate, truth = sources_of(arguments, next(iter(named.values()), None))
    targets = [target for target, _ in outputs]
    inputs = [*estimate.paths, *truth.paths, *_documents(arguments)]
    check_targets(targets, inputs, arguments.json)
    formats = {target.format for target in targets}
    hashed = arguments.json or not formats.isdisjoint(HASHED)
    result = _scored(scorer(truth, config, gates, hashed), estimate, truth, config)
    if arguments.series or not formats.isdisjoint(RUNNING):
        result = replace(result, series=_series(result.config, estimate, truth))
    done = [written('replay', target, partial(render, result)) for target, render in outputs]
    summary = json_report if arguments.json else text_report
    show(partial(summary, result), targets)
    _draw(arguments, {'estimate': result})
    if not all(done):
        return UNABLE
    return FAILED if result.passed is False else PASSED


def _compare(
    arguments: argparse.Namespace,
    named: Mapping[str, str],
    config: EvaluationConfig,
    gates: Sequence[Gate],
) -> int:
    """Compare several estimates; one that cannot be scored fails, and does not stop the others."""
    if arguments.series or arguments.manifest or any(map(bool, _provenance(arguments))):
        raise ConfigError('--series and --manifest are of one estimate; give only one')
    check_metrics(arguments.metric, metric_names(config))
    targets = [Target.parse(text, COMPARISON_RENDERERS) for text in arguments.report]
    check_installed(target.format for target in targets)
    estimates, truth = each_source_of(arguments, named)
    read = [one for one in estimates.values() if isinstance(one, Source)]
    inputs = [*(path for one in (*read, truth) for path in one.paths), *_documents(arguments)]
    check_targets(targets, inputs, arguments.json)
    hashed = arguments.json or any(target.format in HASHED for target in targets)
    score = partial(_scored, scorer(truth, config, gates, hashed), truth=truth, config=config)
    found = compared(estimates, score, arguments.metric or default_metrics(config))
    for name, why in found.unscored.items():
        complain('replay', f'{name} could not be scored: {why}')
    done = [
        written('replay', target, partial(COMPARISON_RENDERERS[target.format], found))
        for target in targets
    ]
    summary = (
        partial(COMPARISON_REPORTS['json'], found)
        if arguments.json
        else partial(comparison_text, found, wants_colour())
    )
    show(summary, targets)
    _draw(arguments, found.results)
    if not all(done):
        return UNABLE
    return FAILED if found.passed is False else PASSED


def _draw(arguments: argparse.Namespace, results: Mapping[str, Result]) -> None:
    """Draw the results in characters, where that was asked for."""
    if arguments.plot == 'terminal':
        # few runs are drawn so
        from vio_eval_ros.reports.terminal import terminal_picture

        print(terminal_picture(results), end='', flush=True)


def _scored(
    score: Callable[[Source], Result], estimate: Source, truth: Source, config: EvaluationConfig
) -> Result:
    """Return the result of an estimate; where there are no pairs, the error says what may help."""
    try:
        return score(estimate)
    except NoPairs as error:
        raise NoPairs(f'{error}{_measured_offset(estimate, truth, config)}') from None


def _measured_offset(estimate: Source, truth: Source, config: EvaluationConfig) -> str:
    """Return the offset between the clocks that the motions show, to be added to an error."""
    # few runs have no pairs, and a diagnosis takes a while to import
    from vio_eval_ros.diagnosis.recorded import diagnose_sources

    with suppress(VioEvalError):
        for cause in diagnose_sources(estimate, truth, config).causes:
            if cause.name == 'time_offset' and cause.flags:
                return f'; the motions agree with {" ".join(cause.flags)}'
    return ''


def _outputs(
    arguments: argparse.Namespace,
) -> list[tuple[Target, Callable[[Result], str | bytes]]]:
    """Return each file to write, and what makes its content."""
    reports = [Target.parse(text, RENDERERS) for text in arguments.report]
    outputs = [(target, RENDERERS[target.format]) for target in reports]
    if arguments.series:
        target = Target.parse(arguments.series, SERIES)
        outputs.append((target, lambda result: series_csv(result.series)))
    if arguments.manifest is not None:
        target = Target.of('manifest', arguments.manifest)
        outputs.append((target, partial(_manifest, arguments, _stack(arguments))))
    elif any(value is not None for value in _provenance(arguments)):
        raise ConfigError('--sequence, --stack-... and --calibration need --manifest')
    return outputs


def _gates(arguments: argparse.Namespace, config: EvaluationConfig) -> list[Gate]:
    """Return the gates of the command line and of the file."""
    gates = [Gate.parse(text) for text in arguments.gate]
    if arguments.gates is not None:
        gates += gates_of(arguments.gates)
    if gates:
        check_names(gates, metric_names(config))
    return gates


def _documents(arguments: argparse.Namespace) -> list[Path]:
    """Return the files that are read apart from poses, and the recording as a whole."""
    beside, estimates = arguments.recording is not None, named_estimates(arguments).values()
    texts = (text for text in (*estimates, arguments.ground_truth) if text)
    specs = (Spec.parse(text, beside_recording=beside) for text in texts)
    named = [arguments.recording, arguments.config, arguments.gates, *(one.path for one in specs)]
    listed = [*(arguments.stack_config or ()), *(arguments.calibration or ())]
    return [path for path in (*named, *listed) if path is not None]


def _series(
    config: EvaluationConfig, estimate: Source, truth: Source
) -> list[tuple[int, dict[str, float]]]:
    """Return the running values of the run."""
    estimate, truth = comparable(estimate, truth, config)
    # a live evaluation would have seen the poses as first published
    poses = estimate.poses if estimate.causal is None else estimate.causal
    return list(running_series(config, poses, truth.poses))


def _provenance(arguments: argparse.Namespace) -> Iterator[Any]:
    """Yield all that only a manifest records."""
    yield from (arguments.sequence, arguments.calibration)
    yield from (getattr(arguments, f'stack_{key}') for key in STACK_KEYS)


def _stack(arguments: argparse.Namespace) -> Stack:
    """Return what the command line states of the software under test."""
    stated = {key: getattr(arguments, f'stack_{key}') for key in STACK_KEYS}
    return Stack.of(stated, arguments.calibration or ())


def _manifest(arguments: argparse.Namespace, stack: Stack, result: Result) -> str:
    """Return the manifest of the run."""
    # few runs have a manifest, and suites take a while to import
    from vio_eval_ros.scoring.manifest import Manifest
    from vio_eval_ros.scoring.results import RunResult
    from vio_eval_ros.scoring.suite import RunSpec

    estimate, truth = result.estimate, result.ground_truth
    manifest = Manifest(arguments.manifest)
    manifest.add_sequence(
        arguments.sequence or (arguments.recording or truth.paths[0]).stem,
        [RunResult(RunSpec(estimate.source, estimate.source, arguments.recording), result)],
        ground_truth=truth.source,
        config=result.config,
        stack=stack,
        times=arguments.times,
    )
    return manifest.to_json()
