"""What only a terminal shows: verdicts in colour, and small pictures made of characters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
import os
import re
import sys
from typing import TextIO

import numpy as np

from vio_eval_ros.errors import ConfigError

#: ANSI codes: bold red, yellow, green
COLOURS = {'fail': '1;31', 'warn': '33', 'warning': '33', 'pass': '32'}
#: a verdict begins a line or ends one, as in tables
VERDICT = re.compile(r'^(?:fail|warn|warning|pass)\b|\b(?:fail|warn|pass)$', re.MULTILINE | re.I)
#: ANSI codes around what is best and second in a table
BEST, SECOND = '\x1b[1m{}\x1b[0m', '\x1b[4m{}\x1b[0m'
BARS = '▁▂▃▄▅▆▇█'
#: characters; rows are at most
WIDTH, ROWS = 72, 20
#: dots of braille in a character
DOTS = (2, 4)


def wants_colour(stream: TextIO | None = None) -> bool:
    """
    Return whether a stream is a terminal that takes ANSI codes.

    ``NO_COLOR`` is respected, see https://no-color.org.

    :param stream: by default stdout.
    """
    stream = sys.stdout if stream is None else stream
    unwanted = os.environ.get('NO_COLOR') or os.environ.get('TERM') == 'dumb'
    return not unwanted and stream.isatty()


def painted(text: str, stream: TextIO | None = None) -> str:
    """
    Return text with its verdicts in colour where a stream wants them.

    :param stream: by default stdout.
    """
    if not wants_colour(stream):
        return text
    return VERDICT.sub(lambda found: f'\x1b[{COLOURS[found[0].lower()]}m{found[0]}\x1b[0m', text)


def sparkline(at: np.ndarray, values: np.ndarray, width: int = WIDTH) -> str:
    """
    Return the largest value in each of ``width`` equal stretches as a bar, a space for none.

    :param at: (N,) where the values are, rising.
    :param values: (N,) from 0 on, NaN where they are not known.
    """
    known = np.isfinite(values)
    at, values = at[known], values[known]
    if not len(at):
        return ' ' * width
    place = ((at - at[0]) * (width / (np.ptp(at) or 1))).astype(int).clip(max=width - 1)
    highest = np.full(width, -1.0)
    np.maximum.at(highest, place, values)
    top = float(highest.max()) or 1.0
    level = (highest / top * (len(BARS) - 1)).round().astype(int)
    return ''.join(BARS[k] if h >= 0 else ' ' for k, h in zip(level, highest, strict=True))


def check_plotext() -> None:
    """Raise ``ConfigError`` where the library that draws in characters is not installed."""
    if find_spec('plotext') is None:
        raise ConfigError("--plot terminal needs plotext: pip install 'vio_eval_ros[terminal]'")


def drawn(paths: Mapping[str, np.ndarray], labels: Sequence[str]) -> str:
    """
    Return paths in braille, with one scale for both axes.

    :param paths: (N, 2) points of each line, by its name.
    :raises ConfigError: where plotext is not installed.
    """
    check_plotext()
    import plotext

    points = np.concatenate(list(paths.values()))
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    extent = np.maximum(high - low, 1e-9)
    # both axes have as many dots a metre; the frame and its numbers are not part of that
    columns = min(WIDTH - 8, max(8, int(extent[0] / extent[1] * ROWS * DOTS[1] / DOTS[0])))
    rows = max(3, min(ROWS, int(columns * DOTS[0] / DOTS[1] * extent[1] / extent[0])))
    plotext.clear_figure()
    plotext.theme('clear')
    plotext.limit_size(False, False)  # else a small terminal would squeeze one of the axes
    plotext.plot_size(columns + 8, rows + 4)
    for name, line in paths.items():
        plotext.plot(*line.T.tolist(), marker='braille', label=name if len(paths) > 1 else None)
    plotext.xlabel(labels[0])
    plotext.ylabel(labels[1])
    return '\n'.join(line.rstrip() for line in plotext.uncolorize(plotext.build()).splitlines())
