"""Samples of an IMU from recordings and CSV files of any length, a block at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import re
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from vio_eval_ros.errors import ReadError, UnsupportedMessage
from vio_eval_ros.recordings.cdr import columns, Layout
from vio_eval_ros.recordings.container import Topic
from vio_eval_ros.recordings.decoder import Blocks, Decoder
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.recording import Recording
from vio_eval_ros.recordings.rows import BadRow, parse, per_second, Rows, STAMP_UNITS
from vio_eval_ros.recordings.storage_files import reading
from vio_eval_ros.recordings.text import split_header

IMU = 'sensor_msgs/msg/Imu'
# orientation, angular velocity and linear acceleration, each followed by its covariance
LAYOUT = Layout(strings=1, doubles=37, pose_doubles=28)
SAMPLE = [13, 14, 15, 25, 26, 27]  # the angular velocity and the acceleration among them
SUFFIXES = ('.csv', '.txt')
TEXT_BYTES = 1 << 20
# where EuRoC's folders have the IMU
FILES = ('data.csv', 'imu0/data.csv', 'mav0/imu0/data.csv')
BOM = b'\xef\xbb\xbf'
# beginnings and ends of the names of columns, and the units in brackets after them
KINDS = {'gyro': '(w|g|ang|omega|rot)(?!rav).*[xyz]', 'accel': '(a(?!ng)|lin|force|f_).*[xyz]'}
UNITS = {
    'gyro': {'rad/s': r'[\[(].*rad', 'deg/s': r'[\[(].*(deg|°|dps)'},
    'accel': {'m/s2': r'[\[(].*m */? *s', 'g': r'[\[(] *g *[\])]'},
}
LONGEST_STEP_S, SLOWEST_STEP_S = 0.05, 1.0  # between samples of an IMU, and of a slow one
EARLIEST_S, LATEST_S = 946_684_800, 4_102_444_800  # 2000 and 2100, since 1970
NAMES = ('time', 'gx', 'gy', 'gz', 'ax', 'ay', 'az')

# Takes stamps (N,) int64 ns and samples (N, 6): gyroscope x y z, accelerometer x y z.
Sink = Callable[[np.ndarray, np.ndarray], None]


class ImuSource(NamedTuple):
    """
    Where samples were read from.

    :param topic: None for a file.
    :param units: of 'gyro' and 'accel', where the header of a file states them.
    :param warnings: what is unusual about the files, in sentences.
    """

    path: Path
    topic: str | None
    units: dict[str, str]
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f'{self.path}:{self.topic}' if self.topic else str(self.path)


def read_imu(
    path: Path,
    topic: str | None,
    sink: Sink,
    progress: Progress = silent,
    option: str = '--topic ',
) -> ImuSource:
    """
    Hand all samples of an IMU to a sink, in blocks and as they were recorded.

    :param path: a recording, a CSV file, or a EuRoC folder with an ``imu0``.
    :param topic: of the recording; None for the only one with IMU messages.
    :param option: the option that selects a topic, for the advice in errors.
    :raises ReadError: it cannot be read, is damaged or has no such topic; the columns of a file
        are not recognised.
    """
    files = [path / name for name in FILES if (path / name).is_file()]
    if files or path.suffix.lower() in SUFFIXES:
        if topic is not None:
            raise ReadError(path, f'is a text file; it has no topic {topic}')
        return _read_csv(files[0] if files else path, sink, progress)
    with Recording(path) as recording:
        found = _imu_topic(recording, topic, option)
        _read_topic(recording, found, sink, progress)
        return ImuSource(path, found.name, {}, tuple(recording.warnings))


def _imu_topic(recording: Recording, name: str | None, option: str) -> Topic:
    """Return the topic of this name, or the only one with IMU messages."""
    found = {topic.name: topic for topic in recording.topics if topic.msgtype == IMU}
    filled = [topic for topic in found.values() if topic.count]
    choice = 'choose ' + ' or '.join(
        f'{option}{one.name} ({one.count} messages)' for one in filled
    )
    if not filled:
        choice = f'the recording has no {"messages" if found else "topic"} of type {IMU}'
    path = recording.path
    if name is None:
        if len(filled) == 1:
            return filled[0]
        several = f'there are several topics of type {IMU}; ' if filled else ''
        raise ReadError(path, several + choice)
    if name not in found:
        others = [topic.msgtype for topic in recording.topics if topic.name == name]
        if others:
            raise UnsupportedMessage(f'{path}:{name}', f'carries {others[0]}; {choice}')
        raise ReadError(f'{path}:{name}', f'there is no such topic; {choice}')
    if found[name] not in filled:
        raise ReadError(f'{path}:{name}', f'has no messages; {choice}')
    return found[name]


def _read_topic(recording: Recording, topic: Topic, sink: Sink, progress: Progress) -> None:
    """Hand all samples of a topic to a sink, in blocks."""
    decoder = recording.decoder(topic)
    blocks = Blocks(lambda block: sink(*samples(block, decoder)))
    recording.feed({topic.name: [lambda _, message: blocks.add(message)]}, progress)
    blocks.flush()


def samples(messages: list[bytes], decoder: Decoder) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the samples in serialised messages of an IMU.

    :return: (N,) int64 nanoseconds, and (N, 6) gyroscope x y z, accelerometer x y z.
    :raises ReadError: messages that are damaged.
    """
    found = columns(LAYOUT, messages, decoder.ros1) if decoder.is_standard else None
    if found is not None:
        return found[0], found[1][:, SAMPLE]
    with reading(decoder.source):
        rows = [_sample(decoder.deserialize(message)) for message in messages]
    return np.array([row[0] for row in rows], np.int64), np.array([row[1:] for row in rows])


def _sample(message: Any) -> tuple[float, ...]:
    stamp, w, a = message.header.stamp, message.angular_velocity, message.linear_acceleration
    return stamp.sec * 10**9 + stamp.nanosec, w.x, w.y, w.z, a.x, a.y, a.z


class _Columns(NamedTuple):
    """
    What the header of a file says.

    :param samples: the columns of gyroscope x y z and accelerometer x y z.
    :param stamps: the unit of the first column; None where it is not stated.
    :param units: of 'gyro' and 'accel', where they are stated.
    :param in_header: whether a header names the columns.
    """

    samples: list[int]
    stamps: str | None
    units: dict[str, str]
    in_header: bool = True


def _read_csv(path: Path, sink: Sink, progress: Progress) -> ImuSource:
    try:
        with path.open('rb') as file:
            begin = file.read(TEXT_BYTES)
            if not begin or begin.isspace():
                raise ReadError(path, 'the file is empty')
            bom = len(begin) - len(begin.removeprefix(BOM))
            header, start = split_header(begin[bom:])
            named = _named(path, header)
            file.seek(bom + start)
            blocks = path.stat().st_size // TEXT_BYTES + 1
            unit, width, line = named.stamps, 0, header.count(b'\n')
            for block in progress(_blocks(file), blocks):
                rows = _rows(path, block, width, line)
                line += block.count(b'\n')
                if rows is None:
                    continue
                width = rows.values.shape[1]
                if width <= max(named.samples):
                    raise ReadError(path, f'has {width} columns; expected {", ".join(NAMES)}')
                if not named.in_header and width > len(NAMES):
                    raise ReadError(
                        path,
                        f'has {width} columns and no header that names them; the columns of an '
                        f'IMU are {", ".join(NAMES)}: name them in a first line',
                    )
                unit = unit or _stamp_unit(rows.values[:, 0])
                sink(rows.exact[0].nanoseconds(path, unit), rows.values[:, named.samples])
    except OSError as error:
        raise ReadError(path, error.strerror or str(error)) from None
    if not width:
        raise ReadError(path, 'the file has no rows of numbers')
    return ImuSource(path, None, named.units)


def _blocks(file: BinaryIO) -> Iterator[bytes]:
    """Yield the rest of a file in blocks of whole lines."""
    while block := file.read(TEXT_BYTES):
        yield block + file.readline()


def _rows(path: Path, block: bytes, width: int, line: int) -> Rows | None:
    """Return the rows of a block that comes after ``line`` lines."""
    if not block.endswith(b'\n'):
        block += b'\n'
    try:
        return parse(block, width)
    except BadRow as bad:
        raise ReadError(path, f'line {line + bad.line}: {bad.problem}') from None


def _named(path: Path, header: bytes) -> _Columns:
    """
    Return what the header says of the columns; without one, they are those of EuRoC.

    :raises ReadError: a header that names columns, but not those of an IMU.
    """
    last = header.decode(errors='replace').strip().rpartition('\n')[2].strip('#% \t\r').lower()
    names = [name.strip(' "') for name in re.split(r'[,;]' if ',' in last else r'\s+', last)]
    if len(names) < len(NAMES):
        return _Columns(list(range(1, 7)), None, {}, in_header=False)
    found = {
        (kind, bare[-1]): column
        for column, name in reversed(list(enumerate(names)))
        for bare in [re.sub(r'[\[(].*', '', name).strip()]
        for kind, pattern in KINDS.items()
        if re.fullmatch(pattern, bare)
    }
    wanted = [(kind, axis) for kind in KINDS for axis in 'xyz']
    if not found.keys() >= set(wanted):
        raise ReadError(
            path, f'columns {", ".join(names)} are not recognised; name them {", ".join(NAMES)}'
        )
    units = {
        kind: unit
        for kind in KINDS
        for unit, pattern in UNITS[kind].items()
        if re.search(pattern, names[found[kind, 'x']])
    }
    stated = re.search(r'[\[(_](ns|us|ms|s)[\])]?$', names[0])
    return _Columns([found[key] for key in wanted], stated and stated[1], units)


def _stamp_unit(stamps: np.ndarray) -> str:
    """
    Return the unit of stamps.

    Those since 1970 show it by their size; of others, an IMU has 20 to 20,000 samples per second.
    """
    stride = min(len(stamps) // 8 + 1, 64)  # longer than bursts of equal stamps
    steps = np.abs(np.diff(stamps[::stride])) / stride
    step = np.median(steps) if len(steps) else 0.0
    for unit in STAMP_UNITS:
        since_1970 = EARLIEST_S <= np.median(stamps) / per_second(unit) < LATEST_S
        if since_1970 and step <= SLOWEST_STEP_S * per_second(unit):
            return unit
    return next(
        (unit for unit in STAMP_UNITS if step <= LONGEST_STEP_S * per_second(unit)),
        'ns',
    )
