"""Scores the runs of a suite of sequences against gates and a baseline: one verdict for all."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
import os
from pathlib import Path
import sys
from typing import Any

from vio_eval_ros.cli.shell import complain, FAILED, Parser, PASSED, run, UNABLE
from vio_eval_ros.cli.targets import check_targets, Target, written
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.reports import write
from vio_eval_ros.scoring.baseline import Baseline, CONDITIONS, definition_sha256
from vio_eval_ros.scoring.documents import SUITE_REPORTS, suite_text
from vio_eval_ros.scoring.scoring import compared, score_suite, SuiteResult
from vio_eval_ros.scoring.suite import Suite

EXAMPLES = """
examples:
  score suite.yaml
  score suite.yaml --record-baseline baseline.json
  score suite.yaml --baseline baseline.json --report junit:junit.xml --report markdown:score.md
  score suite.yaml --tags easy --set options.alignment=sim3 --set sequences.V1_02.gates='{}'

exit status: 0 all passed, 1 a gate failed or the baseline was better, 2 could not be done
"""


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run('score', lambda: _score(arguments))


def _parser() -> Parser:
    parser = Parser(prog='score', description=__doc__, epilog=EXAMPLES)
    parser.add_argument('suite', type=Path, metavar='SUITE.yaml', help='what is scored, and how')
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='KEY=VALUE',
        help='override a value of the suite, such as options.alignment=sim3; may be repeated',
    )
    parser.add_argument(
        '--tags', nargs='+', default=[], metavar='TAG', help='score the sequences with such a tag'
    )
    parser.add_argument(
        '--jobs',
        type=int,
        default=os.cpu_count() or 1,
        metavar='N',
        help='how many processes (default: one for each core)',
    )
    against = parser.add_argument_group('baseline')
    against.add_argument(
        '--record-baseline',
        type=Path,
        metavar='FILE',
        help='write what the runs gave, to compare others with',
    )
    against.add_argument(
        '--baseline', type=Path, metavar='FILE', help='fail where the runs are worse than these'
    )
    against.add_argument(
        '--accept',
        nargs='+',
        choices=CONDITIONS,
        default=[],
        metavar='WHAT',
        help='compare though these were others for the baseline: ' + ', '.join(CONDITIONS),
    )
    output = parser.add_argument_group('output')
    output.add_argument(
        '--json', action='store_true', help='print the result as JSON, and nothing else, on stdout'
    )
    output.add_argument(
        '--report',
        action='append',
        default=[],
        metavar='FORMAT:PATH',
        help=f'write a report; {", ".join(SUITE_REPORTS)}; may be repeated',
    )
    return parser


def _score(arguments: argparse.Namespace) -> int:
    if arguments.jobs < 1:
        raise ConfigError('--jobs: at least 1 is needed')
    targets = [Target.parse(text, SUITE_REPORTS) for text in arguments.report]
    check_targets(targets, [arguments.suite])
    suite = Suite.load(arguments.suite, arguments.set)
    if arguments.tags:
        suite = suite.tagged(arguments.tags)
    baseline = None if arguments.baseline is None else Baseline.load(arguments.baseline)
    result = score_suite(suite, arguments.jobs, _progress)
    if baseline is not None:
        result = compared(result, baseline, arguments.accept)
    done = [
        written('score', target, lambda target=target: SUITE_REPORTS[target.format](result))
        for target in targets
    ]
    if arguments.record_baseline is not None:
        _record(arguments.record_baseline, result)
    text = SUITE_REPORTS['json'](result) if arguments.json else suite_text(result)
    print(text, end='', flush=True)
    if not all(done):
        return UNABLE
    return PASSED if result.passed else FAILED


def _record(file: Path, result: SuiteResult) -> None:
    recorded = {one.sequence.name: one.recorded for one in result.sequences}
    for name, one in recorded.items():
        if not any(name != 'success_rate' and values for name, values in one.metrics.items()):
            complain('score', f'{name}: no run of it was scored; the baseline has nothing of it')
    write(file, Baseline(definition_sha256(), recorded).to_json())


def _progress(items: Iterable[Any], total: int) -> Iterator[Any]:
    """Yield the items behind a bar, where stderr is a terminal."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield from items
    else:
        from tqdm import tqdm

        yield from tqdm(items, 'scoring', total, unit='run', leave=False)
