"""Says what is in trajectories: span, rate, length, speed, gaps, and what was assumed."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from vio_eval_ros.cli.shell import complain, Parser, progress, run
from vio_eval_ros.conversion.facts import facts_of, info_text
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.errors import PASSED, UNABLE
from vio_eval_ros.recordings.agreement.orders import alone
from vio_eval_ros.recordings.sources import check_times, frames_of, pose_topics, read_each, Source
from vio_eval_ros.recordings.spec import is_recording, Spec
from vio_eval_ros.rendering.text import printable
from vio_eval_ros.version import __version__

VERB = 'info'
SCHEMA = 'vio_eval_ros.info/1'
EXAMPLES = """
examples:
  info est.txt gt.csv
  info run.mcap
  info run.mcap:/odom --json

exit status: 0 done, 2 could not be done
"""


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run(VERB, lambda: _info(arguments))


def _parser() -> Parser:
    parser = Parser(prog=VERB, description=__doc__, epilog=EXAMPLES)
    parser.add_argument(
        'specs',
        nargs='+',
        metavar='SPEC',
        help='a file, RECORDING:/topic, or a recording: all of its pose topics',
    )
    parser.add_argument('--times', type=Path, metavar='FILE', help='the stamps [s] of KITTI poses')
    parser.add_argument('--json', action='store_true', help='print JSON, and nothing else')
    return parser


def _info(arguments: argparse.Namespace) -> int:
    specs: list[str] = []
    for text in arguments.specs:
        spec = Spec.parse(text)
        whole = spec.path is not None and spec.topic is None and is_recording(spec.path)
        specs += pose_topics(spec.path) if whole and spec.path else [text]
    sources = read_each(specs, None, arguments.times, progress)
    read = [source for source in sources if isinstance(source, Source)]
    check_times(arguments.times, read)
    wrong = [error for error in sources if isinstance(error, Exception)]
    if not read:
        raise wrong[0]
    for error in wrong:
        complain(VERB, str(error))
    facts = [facts_of(alone(source), frames_of(source)) for source in read]
    if arguments.json:
        found = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'trajectories': [without_nan(one.to_dict()) for one in facts],
        }
        print(json.dumps(found, indent=2, allow_nan=False))
    else:
        print('\n'.join(map(printable, info_text(facts))))
    return UNABLE if wrong else PASSED
