"""Poses from the logs of the PX4 autopilot (ULog), which pyulog reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
import re
from types import SimpleNamespace, TracebackType
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import messages, px4
from vio_eval_ros.recordings.container import Topic
from vio_eval_ros.recordings.messages import adjustment_of
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.storage_files import reading
from vio_eval_ros.recordings.topic_poses import TopicPoses

MAGIC = b'ULog\x01\x12\x35'
ELEMENT = re.compile(r'(.*)\[([0-9]+)\]')


class Kind(NamedTuple):
    """
    A kind of topic that has poses, recognised by its fields.

    :param msgtype: the type that has the same fields in ROS.
    :param numbers: from a message, or from the columns of many, to the numbers of its pose.
    """

    msgtype: str
    fields: frozenset[str]
    numbers: Callable[[Any], tuple[Any, ...]]


KINDS = tuple(
    Kind(msgtype, frozenset(['timestamp', *fields.split()]), numbers)
    for (msgtype, *_), fields, numbers in (
        (px4.ODOMETRY, 'position q pose_frame', px4.odometry_numbers),
        (px4.ODOMETRY, 'x y z q local_frame', px4.odometry_numbers),
        (px4.LOCAL_POSITION, 'x y z xy_valid z_valid', px4.local_position_numbers),
        (px4.GLOBAL_POSITION, 'lat lon alt', px4.global_position_numbers),
    )
)


class Logged(NamedTuple):
    """
    A topic of a log.

    :param name: with a slash before and, where there are several of it, its instance behind.
    :param columns: its fields, each with the values of all messages.
    """

    name: str
    kind: Kind
    columns: Any

    @property
    def topic(self) -> Topic:
        """The topic as recordings have it."""
        return Topic(self.name, self.kind.msgtype, len(self.columns.timestamp))

    def poses(self, source: str, by_recording: bool) -> TopicPoses:
        """
        Return the poses, stamped since the start of the autopilot.

        :param by_recording: whether at the time of logging, not at that of measurement.
        """
        columns = self.columns
        sampled = getattr(columns, 'timestamp_sample', np.zeros(1, np.uint64))
        stamps = columns.timestamp if by_recording or not sampled.any() else sampled
        if stamps.max(initial=0) >= px4.LATEST_US:
            raise ReadError(source, 'is damaged: its stamps are beyond all time')
        adjust = adjustment_of(self.kind.msgtype)
        assert adjust is not None
        numbers = np.column_stack(np.broadcast_arrays(*self.kind.numbers(columns)))
        poses = messages.poses(stamps.astype(np.int64) * 1000, adjust(numbers.astype(np.float64)))
        notes = [*adjust.notes(), 'its stamps count from the boot of the autopilot']
        return TopicPoses(poses, warnings=tuple(f'{source}: {note}' for note in notes))


class Ulog:
    """
    A log of PX4, of which poses are read as of a recording.

    :raises ReadError: when it is read, and is none.
    """

    kind = 'ulog'

    def __init__(self, path: Path) -> None:
        self.path = path
        self.paths = (path,)
        self.warnings: list[str] = []
        self._logged: list[Logged] | None = None

    def __enter__(self) -> Ulog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Do nothing: pyulog has closed the file."""

    @property
    def topics(self) -> list[Topic]:
        """The topics that have poses."""
        return [one.topic for one in self._all()]

    def choices(self) -> list[str]:
        """Return the specs of what can be evaluated, each with type and number of messages."""
        return [f'{one.name} ({one.msgtype}, {one.count})' for one in self.topics]

    def choice(self) -> str:
        """Return a sentence that lists what can be evaluated."""
        listed = self.choices()
        return f'topics with poses: {", ".join(listed)}' if listed else 'no topic has poses'

    def read(self, specs: Sequence[str], progress: Progress = silent) -> list[TopicPoses]:
        """
        Return the poses of topics.

        :param specs: '/topic', or '/topic[1]' for one of several instances; with
            '?stamps=recorded', at the times at which the messages were logged.
        :raises ReadError: unknown topics, or a damaged log.
        """
        return [self._read(*spec.partition('?')[::2]) for spec in progress(specs, len(specs))]

    def _read(self, name: str, stated: str) -> TopicPoses:
        source = f'{self.path}:{name}'
        found = {one.name: one for one in self._all()}
        only = name.removesuffix('[0]')
        if name not in found and only not in found:
            raise ReadError(source, f'there is no such topic with poses; {self.choice()}')
        one = found.get(name) or found[only]
        if sum(each.name == one.name for each in self._all()) > 1:
            raise ReadError(source, 'two streams of the log have this name; log it once')
        with reading(self.path):
            return one.poses(source, stated == 'stamps=recorded')

    def _all(self) -> list[Logged]:
        if self._logged is None:
            self._logged = _logged_in(self.path, self.warnings)
        return self._logged


def _logged_in(path: Path, warnings: list[str]) -> list[Logged]:
    """Return the topics with poses in a log, by name."""
    try:
        from pyulog import ULog
    except ImportError:
        raise ReadError(path, "is not read (ULog): pip install 'vio_eval_ros[px4]'") from None
    with reading(path), path.open('rb') as file:
        if not file.read(len(MAGIC)).startswith(MAGIC):
            raise ReadError(path, 'does not begin like a log of PX4 (ULog)')
        file.seek(0)
        with redirect_stdout(StringIO()):  # pyulog prints what it finds
            log = ULog(file)
    if log.file_corruption:
        warnings.append(f'{path}: parts of the log are damaged, and were left out')
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) / 1000
        warnings.append(
            f'{path}: {len(log.dropouts)} times messages were lost, {lost_s:.3g} s in all'
        )
    instances = Counter(data.name for data in log.data_list)
    found = []
    for data in log.data_list:
        columns = _as_message(data.data)
        kind = next((kind for kind in KINDS if kind.fields <= vars(columns).keys()), None)
        if kind is not None:
            instance = f'[{data.multi_id}]' * (instances[data.name] > 1)
            found.append(Logged(f'/{data.name}{instance}', kind, columns))
    return sorted(found, key=lambda one: one.name)


def _as_message(columns: Mapping[str, np.ndarray]) -> Any:
    """Return columns by the names of fields, those of an array in a list."""
    fields: dict[str, Any] = {}
    for name, column in columns.items():
        element = ELEMENT.fullmatch(name)
        if element:
            fields.setdefault(element.group(1), []).append(column)
        else:
            fields[name] = column
    return SimpleNamespace(**fields)
