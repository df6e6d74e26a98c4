"""Draws figures of one or several estimates, ready for a paper."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from vio_eval_ros.cli.completion import complete, words
from vio_eval_ros.cli.inputs import add_inputs, each_source_of, named_estimates, sources_of
from vio_eval_ros.cli.shell import add_options, complain, config_of, Parser, run
from vio_eval_ros.cli.targets import check_targets, Target, written
from vio_eval_ros.comparison.comparison import compared, scorer
from vio_eval_ros.comparison.matrix import default_metrics
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, UNABLE
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.figures.catalogue import check_figures, FIGURES, FORMATS, MAPPED, pages
from vio_eval_ros.figures.maps import load_map
from vio_eval_ros.figures.style import theme, WIDTHS
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.rendering.files import make_writable

VERB = 'plot'
USUAL = ('top', 'xyz', 'errors')
_LISTED = '\n'.join(f'  {name:<13}{kind.words}' for name, kind in FIGURES.items())
EXAMPLES = f"""
figures:
{_LISTED}

examples:
  plot run.mcap --estimate /vio/odometry --ground-truth /ground_truth/pose --out figures
  plot --estimate VINS=vins.txt --estimate DSO=dso.txt --ground-truth gt.txt \\
      --figure top errors segments --width 2 --out figures.pdf

exit status: 0 done, 1 one of several estimates could not be scored, 2 could not be done
"""


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run(VERB, lambda: _plot(arguments))


def _parser() -> Parser:
    parser = Parser(prog=VERB, description=__doc__, epilog=EXAMPLES)
    add_inputs(parser, several=True)
    output = parser.add_argument_group('output')
    figure = output.add_argument(
        '--figure', nargs='+', default=list(USUAL), metavar='NAME',
        help=f'what to draw, or all (default: {" ".join(USUAL)})',
    )  # fmt: skip
    complete(figure, words([*FIGURES, 'all']))
    output.add_argument(
        '--out', type=Path, required=True, metavar='DIR|FILE',
        help='a folder, for one file per figure; or a file: .pdf with a page per figure, .svg or '
        '.png of one figure',
    )  # fmt: skip
    output.add_argument(
        '--format', choices=FORMATS, default='pdf',
        help='of the files in a folder (default: pdf)',
    )  # fmt: skip
    output.add_argument(
        '--width', type=int, choices=tuple(WIDTHS), default=1,
        help='columns of the page that a figure spans: 3.5 or 7.16 inches (default: 1)',
    )  # fmt: skip
    output.add_argument(
        '--theme', type=Path, metavar='FILE', help='a style sheet of matplotlib (.mplstyle)'
    )
    output.add_argument(
        '--map', type=Path, metavar='YAML',
        help='a map of map_server in the frame of the ground truth, drawn beneath top and '
        'projections',
    )  # fmt: skip
    add_options(parser)
    return parser


def _plot(arguments: argparse.Namespace) -> int:
    names = list(dict.fromkeys(arguments.figure))
    names = list(FIGURES) if names == ['all'] else names
    check_figures(names)
    with theme(arguments.theme):  # whether it can be drawn is told before anything is read
        pass
    beneath = None if arguments.map is None else load_map(arguments.map)
    if beneath is not None and not set(MAPPED) & set(names):
        raise ConfigError(f'--map is drawn beneath {" and ".join(MAPPED)}: add one to --figure')
    into_file = arguments.out.suffix[1:].lower() in FORMATS and not arguments.out.is_dir()
    if into_file:
        target = Target.of(arguments.out.suffix[1:].lower(), arguments.out)
        if target.format != 'pdf' and len(names) > 1:
            raise ConfigError(
                f'--out {arguments.out}: one figure per .{target.format} file; give a folder or a '
                '.pdf, or one --figure'
            )
    elif arguments.out.suffix:
        raise ConfigError(
            f'--out {arguments.out}: write a folder, or a file that ends in .{", .".join(FORMATS)}'
        )
    results, inputs, complete_ = _results(arguments)
    order = list(named_estimates(arguments))
    options = {
        'columns': arguments.width,
        'style': arguments.theme,
        'order': order or ['estimate'],
        'beneath': beneath,
    }
    if into_file:
        targets = {target: partial(pages, names, results, target.format, **options)}
    else:
        make_writable(arguments.out)
        targets = {
            Target.of(arguments.format, arguments.out / f'{name}.{arguments.format}'): partial(
                pages, [name], results, arguments.format, **options
            )
            for name in names
        }
    check_targets(list(targets), inputs)
    done = [written(VERB, target, render) for target, render in targets.items()]
    if not all(done):
        return UNABLE
    return PASSED if complete_ else FAILED


def _results(arguments: argparse.Namespace) -> tuple[dict[str, Result], list[Path], bool]:
    """Return the results by system, the files that were read, and whether all could be scored."""
    config, named = config_of(arguments), named_estimates(arguments)
    if len(named) < 2:
        estimate, truth = sources_of(arguments, next(iter(named.values()), None))
        name = next(iter(named), 'estimate')
        result = scorer(truth, config, hashed=False)(estimate)
        return {name: result}, [*estimate.paths, *truth.paths], True
    estimates, truth = each_source_of(arguments, named)
    score = scorer(truth, config, hashed=False)
    found = compared(estimates, score, default_metrics(config))
    for name, why in found.unscored.items():
        complain(VERB, f'{name} could not be scored and is not drawn: {why}')
    read = [one for one in estimates.values() if isinstance(one, Source)]
    inputs = [path for one in (*read, truth) for path in one.paths]
    return dict(found.results), inputs, not found.unscored
