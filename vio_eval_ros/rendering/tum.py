"""How trajectories are written as TUM files."""

from __future__ import annotations

import numpy as np

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError


def tum(trajectory: Trajectory) -> str:
    """
    Return a trajectory as a TUM file: seconds, x y z, qx qy qz qw with 9 decimals.

    :raises ConfigError: for a trajectory without orientations, which the format cannot hold.
    """
    if trajectory.rotations is None:
        raise ConfigError('a TUM file needs orientations, but there are none; use a csv report')
    seconds, rest = np.divmod(np.abs(trajectory.stamps_ns), 10**9)
    table = np.empty((len(trajectory), 10), object)
    table[:, 0] = np.where(trajectory.stamps_ns < 0, '-', '')
    table[:, 1], table[:, 2] = seconds, rest
    table[:, 3:6], table[:, 6:] = trajectory.positions, trajectory.rotations
    return '# timestamp tx ty tz qx qy qz qw\n' + formatted(
        table, '%s%d.%09d %.9f %.9f %.9f %.9f %.9f %.9f %.9f'
    )


def formatted(table: np.ndarray, row: str) -> str:
    """Return a line for each row of an (N, C) table; one formatting operation is fast."""
    return (row + '\n') * len(table) % tuple(table.ravel().tolist())
