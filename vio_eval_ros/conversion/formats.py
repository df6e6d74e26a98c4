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

    :raises ConfigError: the suffix tells no format, or another kind of recording than is stated.
    """
    if stated is not None:
        _check_suffix(path, stated)
        return stated
    for name, one in FORMATS.items():
        if path.suffix.lower() in one.suffixes:
            return name
    known = ', '.join(f'{one.suffixes[0]} {name}' for name, one in FORMATS.items() if one.suffixes)
    raise ConfigError(
        f"{path}: no format has the suffix '{path.suffix}' ({known}); state --format"
    )


def _check_suffix(path: Path, name: str) -> None:
    """Raise ``ConfigError`` where the suffix of a recording is that of another kind of it."""
    suffix = path.suffix.lower()
    if name in ('mcap', 'ros1') and suffix not in FORMATS[name].suffixes:
        wanted = FORMATS[name].suffixes[0]
        raise ConfigError(f'{path}: for {name}, OUT is a file: name it with {wanted}')
    if name in ('rosbag2', 'sqlite3') and any(suffix in one.suffixes for one in _files()):
        raise ConfigError(f'{path}: for {name}, OUT is a folder: drop {path.suffix}')


def _files() -> list[Format]:
    """Return the formats of which OUT is a file."""
    return [one for one in FORMATS.values() if any(one.suffixes)]


def files_of(path: Path, name: str) -> list[Path]:
    """Return the files that a format writes."""
    return [path, times_beside(path)] if name == 'kitti' else [path]
