"""Trajectories as text files, with all digits of their numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import blocks, Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.rendering.tum import formatted

POSE_COLUMNS = (
    '#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],'
    'q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n'
)
POSITION_COLUMNS = '#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m]\n'


def write_tum(poses: Trajectory, path: Path) -> None:
    """
    Write seconds with nine decimals, x y z, qx qy qz qw.

    :raises ConfigError: there are no orientations, which the format cannot do without.
    """
    rotations = _needed(poses, 'TUM')
    with path.open('w') as file:
        file.write('# timestamp tx ty tz qx qy qz qw\n')
        for block in blocks(len(poses)):
            stamps_ns = poses.stamps_ns[block]
            table = np.empty((len(stamps_ns), 10), object)
            table[:, :3] = _seconds(stamps_ns)
            table[:, 3:6], table[:, 6:] = poses.positions[block], rotations[block]
            file.write(formatted(table, '%s%d.%09d' + ' %r' * 7))


def write_euroc(poses: Trajectory, path: Path) -> None:
    """Write EuRoC's ``data.csv``: nanoseconds, x y z, qw qx qy qz; or positions only."""
    with path.open('w') as file:
        if poses.rotations is None:
            file.write(POSITION_COLUMNS)
            write_rows(file, poses.stamps_ns, poses.positions)
            return
        file.write(POSE_COLUMNS)
        columns = [poses.positions, np.roll(poses.rotations, 1, axis=1)]
        write_rows(file, poses.stamps_ns, np.concatenate(columns, axis=1))


def write_kitti(poses: Trajectory, path: Path) -> None:
    """
    Write a 3x4 matrix a line, and the stamps [s] beside it, in ``NAME_times.txt``.

    :raises ConfigError: there are no orientations.
    """
    rotations = _needed(poses, 'KITTI')
    with path.open('w') as file, times_beside(path).open('w') as times:
        for block in blocks(len(poses)):
            matrices = np.empty((len(poses.stamps_ns[block]), 3, 4))
            matrices[:, :, :3] = rotation.to_matrix(rotation.normalize(rotations[block]))
            matrices[:, :, 3] = poses.positions[block]
            file.write(formatted(matrices.reshape(-1, 12), ' '.join(['%r'] * 12)))
            times.write(formatted(_seconds(poses.stamps_ns[block]), '%s%d.%09d'))


def times_beside(path: Path) -> Path:
    """Return the file of the stamps of KITTI poses."""
    return path.with_name(f'{path.stem}_times.txt')


def write_rows(file: Any, stamps_ns: np.ndarray, numbers: np.ndarray) -> None:
    """Write a line for each stamp and its numbers, with all of their digits."""
    for block in blocks(len(stamps_ns)):
        table = np.empty((len(stamps_ns[block]), 1 + numbers.shape[1]), object)
        table[:, 0], table[:, 1:] = stamps_ns[block], numbers[block]
        file.write(formatted(table, ','.join(['%d'] + ['%r'] * numbers.shape[1])))


def _seconds(stamps_ns: np.ndarray) -> np.ndarray:
    """Return (N, 3) objects: the sign, whole seconds, and the nanoseconds beyond them."""
    table = np.empty((len(stamps_ns), 3), object)
    table[:, 0] = np.where(stamps_ns < 0, '-', '')
    table[:, 1], table[:, 2] = np.divmod(np.abs(stamps_ns), 10**9)
    return table


def _needed(poses: Trajectory, name: str) -> np.ndarray:
    if poses.rotations is None:
        raise ConfigError(
            f'{name} files have orientations, and there are none; write .csv or .mcap instead'
        )
    return poses.rotations
