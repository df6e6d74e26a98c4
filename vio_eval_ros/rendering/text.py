"""How numbers, names and trajectories are written as text."""

from __future__ import annotations

import math
import re

import numpy as np

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError


def number(value: float) -> str:
    """Return a number with four significant digits, a dash for none."""
    return '-' if math.isnan(value) else f'{value:.4g}'


def percent(ratio: float) -> str:
    """Return a ratio in percent, a dash for none."""
    return '-' if math.isnan(ratio) else f'{100 * ratio:.1f} %'


def printable(text: str) -> str:
    """Return text that cannot move a terminal's cursor, whatever names it contains."""
    return ''.join(c if c.isprintable() else '?' for c in text)


#: what makes a link of bare text
LINK = re.compile(r':(?=//)|(?<=www)\.', re.IGNORECASE)


def escaped(text: str) -> str:
    """Return text without anything that Markdown or HTML would take as its own."""
    text = ''.join(f'\\{c}' if c in '\\`*_[]<>&|#~$@' else c for c in printable(text))
    return LINK.sub(r'\\\g<0>', text)


def tum(trajectory: Trajectory) -> str:
    """
    Return a trajectory as a TUM file: seconds, x y z, qx qy qz qw with 9 decimals.

    :raises ConfigError: for a trajectory without orientations, which the format cannot hold.
    """
    if trajectory.rotations is None:
        raise ConfigError('a TUM file needs orientations, and there are none; use a csv report')
    seconds, rest = np.divmod(np.abs(trajectory.stamps_ns), 10**9)
    table = np.empty((len(trajectory), 10), object)
    table[:, 0] = np.where(trajectory.stamps_ns < 0, '-', '')
    table[:, 1], table[:, 2] = seconds, rest
    table[:, 3:6], table[:, 6:] = trajectory.positions, trajectory.rotations
    return '# timestamp tx ty tz qx qy qz qw\n' + formatted(
        table, '%s%d.%09d %.9f %.9f %.9f %.9f %.9f %.9f %.9f'
    )


def formatted(table: np.ndarray, row: str) -> str:
    """Return a line for each row of an (N, C) table, formatted in one go."""
    return (row + '\n') * len(table) % tuple(table.ravel().tolist())
