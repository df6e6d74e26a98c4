"""The formats that a trajectory is written in; each is a function and a line in ``FORMATS``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from vio_eval_ros.conversion.texts import times_beside, write_euroc, write_kitti, write_tum
from vio_eval_ros.conversion.topics import (
    odometry_topic,
    pose_topic,
    TopicColumns,
    write_mcap,
    write_ros1,
    write_rosbag2,
    write_sqlite3,
)
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError


class Names(NamedTuple):
    """What a recording calls a trajectory."""

    topic: str = '/pose'
    frame: str = 'world'
    child: str = 'body'


class Format(NamedTuple):
    """
    How a trajectory can be written.

    :param suffixes: that tell the format; the first is the usual one.
    :param write: takes the poses, a path, and the names.
    :param has_covariances: whether these are written as well.
    """

    suffixes: tuple[str, ...]
    write: Callable[[Trajectory, Path, Names], None]
    has_covariances: bool = False


def _text(write: Callable[[Trajectory, Path], None]) -> Callable[[Trajectory, Path, Names], None]:
    return lambda poses, path, names: write(poses, path)


def _recording(
    write: Callable[[Sequence[TopicColumns], Path], None],
) -> Callable[[Trajectory, Path, Names], None]:
    """Return what writes one topic: Odometry with covariances, else PoseStamped."""

    def written(poses: Trajectory, path: Path, names: Names) -> None:
        if poses.covariances is None or poses.rotations is None:
            topic = pose_topic(poses, names.topic, names.frame)
        else:
            topic = odometry_topic(poses, names.topic, names.frame, names.child)
        write([topic], path)

    return written


FORMATS: dict[str, Format] = {
    'tum': Format(('.tum', '.txt'), _text(write_tum)),
    'euroc': Format(('.csv',), _text(write_euroc)),
    'kitti': Format(('.kitti',), _text(write_kitti)),
    'mcap': Format(('.mcap',), _recording(write_mcap), has_covariances=True),
    'ros1': Format(('.bag',), _recording(write_ros1), has_covariances=True),
    'rosbag2': Format(('',), _recording(write_rosbag2), has_covariances=True),
    'sqlite3': Format((), _recording(write_sqlite3), has_covariances=True),
}


def format_of(path: Path, stated: str | None = None) -> str:
    """
    Return the format to write: as stated, else by the suffix; a name without one is a folder.

    :raises ConfigError: the suffix tells no format.
    """
    if stated is not None:
        return stated
    for name, one in FORMATS.items():
        if path.suffix.lower() in one.suffixes:
            return name
    known = ', '.join(f'{one.suffixes[0]} {name}' for name, one in FORMATS.items() if one.suffixes)
    raise ConfigError(
        f"{path}: no format has the suffix '{path.suffix}' ({known}); state --format"
    )


def files_of(path: Path, name: str) -> list[Path]:
    """Return the files that a format writes."""
    return [path, times_beside(path)] if name == 'kitti' else [path]
