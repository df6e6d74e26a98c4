"""
A running evaluation on a terminal: a line for each estimate, drawn anew every second.

After drawing, the cursor stands at the beginning of the first line. Whatever is logged erases the
lines and takes their place; they are drawn again below. That needs no hold of what is logged, of
which the middleware writes a part by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
import math
import os
from typing import TextIO

from vio_eval_ros.live.health import Level, Status, telling
from vio_eval_ros.live.page import drift_name, WORDS
from vio_eval_ros.rendering.terminal import COLOURS, wants_colour
from vio_eval_ros.rendering.text import number, percent, printable

#: from the cursor to the end of the screen; to the end of the line
ERASE, ERASE_LINE = '\x1b[J', '\x1b[K'
FORMAT, DEFAULT_FORMAT = (
    'RCUTILS_CONSOLE_OUTPUT_FORMAT',
    '[{severity}] [{time}] [{name}]: {message}',
)
#: from the best to the worst
SEVERITY = (Level.OK, Level.STALE, Level.WARN, Level.ERROR)


def width_of(stream: TextIO) -> int:
    """
    Return how wide a terminal is that shows lines drawn in place; 0 where a stream is none.

    The terminal that a launch file emulates has no width.
    """
    if os.environ.get('TERM') == 'dumb' or not stream.isatty():
        return 0
    try:
        return os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):
        return 0


def log_over_lines(environment: MutableMapping[str, str]) -> None:
    """Have what ROS logs from its start on erase the lines that it takes the place of."""
    log_format = environment.get(FORMAT) or DEFAULT_FORMAT
    environment[FORMAT] = ERASE + log_format.removeprefix(ERASE)


class StatusLines:
    """The lines at the end of a terminal."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def draw(self, estimates: Sequence[tuple[str, Mapping[str, float], Sequence[Status]]]) -> None:
        """
        Draw a line for each estimate in place of those drawn before.

        :param estimates: name, running values and statuses of each.
        """
        width = width_of(self._stream) - 1  # in the last column some terminals wrap
        in_colour = wants_colour(self._stream)
        room = max(len(name) for name, _, _ in estimates)
        lines = [
            line(f'{name:<{room}}  ' if room else '', values, statuses, width, in_colour)
            for name, values, statuses in estimates
        ]
        up = f'\x1b[{len(lines) - 1}A' if len(lines) > 1 else ''
        self._write(f'{ERASE_LINE}\n'.join(lines) + f'{ERASE_LINE}{up}\r')

    def clear(self) -> None:
        """Leave no line behind."""
        self._write(ERASE)

    def _write(self, text: str) -> None:
        try:
            self._stream.write(text)
            self._stream.flush()
        except OSError:  # the terminal has gone
            pass


def line(
    name: str,
    values: Mapping[str, float],
    statuses: Sequence[Status],
    width: int,
    in_colour: bool = False,
) -> str:
    """
    Return pairs, ATE, RPE, coverage and state of an estimate, as far as there is room.

    :param in_colour: whether the level is in its colour.
    """
    metres, degrees, coverage = (
        values.get(metric, math.nan)
        for metric in ('ate_trans_rmse_m', 'ate_rot_rmse_deg', 'coverage_ratio')
    )
    figures = [f'{values.get("pairs", 0):,.0f} pairs']
    if drift := drift_name(values):
        figures += [
            f'ATE {number(metres)} m {number(degrees)} deg',
            f'RPE {drift.split("_")[1]} {number(values[drift])} m',
            f'coverage {percent(coverage)}',
        ]
    worst = max(telling(statuses), key=lambda status: SEVERITY.index(status.level), default=None)
    level = worst.level.name if worst else 'OK'
    why = f' {worst.name}: {worst.message}' if worst else ''
    begin = name + '  '.join([*figures, ''])
    text = printable(f'{begin}{level}{why}')
    text = text if len(text) <= width else text[: max(width - 1, 0)] + '…'
    if not in_colour:
        return text
    end = len(begin) + len(level)
    painted = f'\x1b[{COLOURS[WORDS[Level[level]]]}m{text[len(begin) : end]}\x1b[0m'
    return f'{text[: len(begin)]}{painted}{text[end:]}'
