"""Scores the runs of a suite against gates and a baseline, with one verdict for all."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
import math
import os
from pathlib import Path
import sys
from typing import Any

import numpy as np

from vio_eval_ros.cli.completion import complete
from vio_eval_ros.cli.shell import complain, Parser, run
from vio_eval_ros.cli.targets import add_reports, check_targets, show, Target, written
from vio_eval_ros.comparison.matrix import check_metrics
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, UNABLE
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.figures.reports import FORMATS, suite_picture
from vio_eval_ros.figures.style import check_installed
from vio_eval_ros.rendering.terminal import wants_colour
from vio_eval_ros.rendering.text import printable
from vio_eval_ros.scoring.baseline import Baseline, CONDITIONS, definition_sha256
from vio_eval_ros.scoring.documents import SUITE_REPORTS, suite_text
from vio_eval_ros.scoring.loading import load_suite
from vio_eval_ros.scoring.manifest import manifest_of_suite
from vio_eval_ros.scoring.results import SuiteResult
from vio_eval_ros.scoring.scoring import compare_suite, score_suite
from vio_eval_ros.scoring.suite import Suite
from vio_eval_ros.scoring.verification import verify

EXAMPLES = """
examples:
  score suite.yaml
  score suite.yaml --record-baseline baseline.json
  score suite.yaml --baseline baseline.json --report junit:junit.xml --report markdown:score.md
  score suite.yaml --tags easy --set options.alignment=sim3 --set sequences.V1_02.gates='{}'
  score suite.yaml --metric ate_trans_rmse_m rpe_1s_rot_rmse_deg --report table.tex
  score --verify manifest.json

exit status: 0 all passed (or reproduced), 1 a gate failed or a metric is worse than in the
baseline (or not reproduced), 2 could not be done
"""


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run('score', lambda: _score(arguments))


def _parser() -> Parser:
    parser = Parser(prog='score', description=__doc__, epilog=EXAMPLES)
    _add_selection(parser)
    _add_baseline(parser.add_argument_group('baseline'))
    output = parser.add_argument_group('output')
    add_reports(output, [*SUITE_REPORTS, *FORMATS])
    output.add_argument(
        '--manifest',
        type=Path,
        metavar='FILE',
        help='record what the results were made of (default: the manifest of the suite, if any)',
    )
    parser.add_argument(
        '--verify',
        type=Path,
        metavar='MANIFEST',
        help='instead of a suite, score the runs of a manifest again and compare the results',
    )
    return parser


def _add_selection(parser: Parser) -> None:
    parser.add_argument(
        'suite', nargs='?', type=Path, metavar='SUITE.yaml', help='the sequences to score, and how'
    )
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='KEY=VALUE',
        help='override a value of the suite, such as options.alignment=sim3; may be repeated',
    )
    parser.add_argument(
        '--tags',
        nargs='+',
        default=[],
        metavar='TAG',
        help='score only the sequences with one of these tags or names',
    )
    metric = parser.add_argument(
        '--metric',
        nargs='+',
        default=[],
        metavar='NAME',
        help='by which the systems of the suite are compared (default: ATE, RPE and coverage)',
    )
    complete(metric, lambda **_: metric_names(EvaluationConfig()))
    parser.add_argument(
        '--jobs',
        type=int,
        default=len(os.sched_getaffinity(0))
        if hasattr(os, 'sched_getaffinity')
        else os.cpu_count(),
        metavar='N',
        help='number of processes (default: one per core)',
    )


def _add_baseline(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        '--record-baseline',
        type=Path,
        metavar='FILE',
        help='record the results of this suite as a baseline',
    )
    group.add_argument(
        '--baseline',
        type=Path,
        metavar='FILE',
        help='fail where a metric is worse than in this baseline',
    )
    group.add_argument(
        '--accept',
        nargs='+',
        choices=CONDITIONS,
        default=[],
        metavar='WHAT',
        help=f'compare although these differ from the baseline: {", ".join(CONDITIONS)}',
    )


def _score(arguments: argparse.Namespace) -> int:
    if arguments.verify is not None:
        return _verify(arguments)
    if arguments.suite is None:
        raise ConfigError('give a SUITE.yaml, or a manifest to --verify')
    if arguments.accept and arguments.baseline is None:
        raise ConfigError('--accept needs --baseline')
    if arguments.jobs < 1:
        raise ConfigError('--jobs: must be at least 1')
    suite = load_suite(arguments.suite, arguments.set, arguments.tags)
    _check_metrics(arguments.metric, suite)
    outputs = _outputs(arguments, suite)
    baseline = None if arguments.baseline is None else Baseline.load(arguments.baseline)
    if baseline is not None:  # what can be checked before hours of scoring
        baseline.check({one.title: one.conditions for one in suite.sequences}, arguments.accept)
    result = score_suite(suite, arguments.jobs, _progress)
    result = replace(result, metrics=tuple(arguments.metric))
    if baseline is not None:
        result = compare_suite(result, baseline, arguments.accept)
    done = [written('score', target, partial(render, result)) for target, render in outputs]
    summary = (
        partial(SUITE_REPORTS['json'], result)
        if arguments.json
        else partial(suite_text, result, wants_colour())
    )
    show(summary, [target for target, _ in outputs])
    if not all(done):
        return UNABLE
    return PASSED if result.passed else FAILED


def _check_metrics(metrics: Sequence[str], suite: Suite) -> None:
    """Check that systems are compared by metrics that there are."""
    if metrics and not suite.has_systems:
        raise ConfigError('--metric is for suites that compare systems: [{name, estimate}]')
    for config in dict.fromkeys(one.config for one in suite.sequences):
        check_metrics(metrics, [*metric_names(config)])


def _outputs(
    arguments: argparse.Namespace, suite: Suite
) -> list[tuple[Target, Callable[[SuiteResult], str | bytes]]]:
    """Return each file to write, and what makes its text."""
    targets = [Target.parse(text, [*SUITE_REPORTS, *FORMATS]) for text in arguments.report]
    check_installed(target.format for target in targets)
    outputs: list[tuple[Target, Callable[[SuiteResult], str | bytes]]] = [
        (
            target,
            partial(_picture, file_format=target.format)
            if target.format in FORMATS
            else SUITE_REPORTS[target.format],
        )
        for target in targets
    ]
    if arguments.record_baseline is not None:
        outputs.append((Target.of('baseline', arguments.record_baseline), _recorded))
    manifest = arguments.manifest or suite.manifest
    if manifest is not None:
        render = manifest_of_suite(manifest, suite, arguments.baseline)
        outputs.append((Target.of('manifest', manifest), render))
    inputs = [arguments.suite, *([arguments.baseline] if arguments.baseline else []), *suite.paths]
    check_targets([target for target, _ in outputs], inputs, arguments.json)
    return outputs


def _picture(result: SuiteResult, file_format: str) -> bytes:
    """Return the ATE of all runs and, as PDF, figures of the first runs of each sequence."""
    metric = 'ate_trans_rmse_m'
    values: dict[str, dict[str, np.ndarray]] = {}
    drawn: dict[str, dict[str, Result]] = {}
    for one in result.sequences:
        found = [run.result for run in one.runs if not run.run.problem]
        values.setdefault(one.sequence.name, {})[one.sequence.system] = np.array(
            [math.nan if of is None else of.summary.metrics[metric] for of in found]
        )
        able = [of for of in found if of and math.isfinite(of.summary.metrics[metric])]
        if able:
            drawn.setdefault(one.sequence.name, {})[one.sequence.system] = able[0]
    return suite_picture(values, 'ATE position, RMSE [m]', drawn, file_format)


def _verify(arguments: argparse.Namespace) -> int:
    """Print what differs from when a manifest was written."""
    defaults = vars(_parser().parse_args(['--verify', str(arguments.verify)]))
    for name, value in vars(arguments).items():
        if value != defaults[name]:
            raise ConfigError(f'--verify cannot be combined with {name.replace("_", "-")}')
    found = verify(arguments.verify, _progress)
    lines = [*found.differences, *(f'note: {note}' for note in found.notes)]
    runs = f'{found.reproduced} of {found.runs} runs are unchanged'
    if not found.differences:
        lines.append(f'reproduced to the last bit: {runs}')
    elif found.reproduced < found.runs:
        lines.append(f'not reproduced: {runs}')
    else:
        lines.append(f'not reproduced: {runs}, but the verdict has changed')
    print('\n'.join(printable(line) for line in lines), flush=True)
    return FAILED if found.differences else PASSED


def _recorded(result: SuiteResult) -> str:
    """Return the result as a baseline."""
    recorded = {one.sequence.title: one.recorded for one in result.sequences}
    for name, one in recorded.items():
        if not one.metrics:
            complain('score', f'{name}: no run was scored, so the baseline has no values of it')
    return Baseline(definition_sha256(), recorded).to_json()


def _progress(items: Iterable[Any], total: int) -> Iterator[Any]:
    """Yield the items, with a progress bar if stderr is a terminal."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield from items
    else:
        from tqdm import tqdm

        yield from tqdm(items, 'scoring', total, unit='run', leave=False)
