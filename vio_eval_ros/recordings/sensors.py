"""
The streams of a recording as columns, in memory that grows with messages but not with images.

Of each message only its header is kept, as it stands in the raw bytes; of inertial sensors and
poses the numbers, too. EuRoC's folders are read without opening an image.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
import struct
from typing import NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from vio_eval_ros.errors import ReadError
from vio_eval_ros.inspection.streams import Stream
from vio_eval_ros.recordings.asl import _rows, AslFolder, Sensor, sensors_in
from vio_eval_ros.recordings.bags import _Decoder, BLOCK_BYTES
from vio_eval_ros.recordings.imu import _columns, IMU
from vio_eval_ros.recordings.messages import CONVERTERS, PATH
from vio_eval_ros.recordings.playback import _Converted, HEADER, Playback, Timed
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.storage import Channel, unreadable

# numbers of a pose: what is behind, a covariance, is of no use here
POSE_NUMBERS = 7


class Sensors(NamedTuple):
    """
    What was read of a recording.

    :param left_out: a sentence for each topic that cannot be read.
    """

    streams: list[Stream]
    left_out: list[str]


def read_sensors(path: Path, progress: Progress = silent) -> Sensors:
    """
    Return every stream of a recording.

    :param path: a ROS 1 bag, a rosbag2 folder, a bare .db3 or .mcap, or an ASL folder.
    :raises ReadError: what cannot be read, is damaged or has no message with a header.
    """
    sensors = sensors_in(path)
    if sensors:
        streams, left_out = _read_folder(path, sensors, progress), []
    else:
        recording = _SensorRecording(path)
        with recording:
            streams, left_out = recording.read(progress), recording.warnings
    if not any(stream.stamps_ns is not None and len(stream) for stream in streams):
        listed = ', '.join(f'{stream.topic} ({stream.msgtype})' for stream in streams)
        raise ReadError(path, f'no topic has messages with a header; there are {listed or "none"}')
    return Sensors(streams, left_out)


class _SensorRecording(Playback):
    """A recording of ROS, open to read its streams without converting any message."""

    def read(self, progress: Progress) -> list[Stream]:
        """Return every stream that has messages."""
        collectors = self._collectors()
        total = sum(topic.count for topic in self.topics)
        for log_ns, name, raw in progress(self._raw(set(collectors)), total):
            collectors[name].add(log_ns, raw)
        for topic in self.topics:
            got = collectors[topic.name].count
            if got < topic.count:
                raise ReadError(
                    topic.name,
                    f'only {got} of the {topic.count} messages in the index are there; the '
                    'recording is damaged, or its metadata.yaml belongs to another',
                )
        return [collectors[topic.name].stream() for topic in self.topics if topic.count]

    def _collectors(self) -> dict[str, _Collector]:
        """Return what takes the messages of each topic, by the definition in its first file."""
        collectors: dict[str, _Collector] = {}
        msgtypes = {topic.name: topic.msgtype for topic in self.topics}
        for source in self._sources:
            assert isinstance(source, _Converted)
            for channel in source._storage.channels:
                name = channel.topic
                if name in msgtypes and name not in collectors:
                    types = source._storage.types(channel.msgtype)
                    collectors[name] = _Collector(source.path, msgtypes[name], channel, types)
        return collectors

    def _raw(self, names: set[str]) -> Iterator[Timed]:
        """Yield the messages of topics as they stand in the files, one file behind the other."""
        for source in self._sources:
            assert isinstance(source, _Converted)
            assert source.span_ns
            try:
                yield from source._storage.timed(names, *source.span_ns)
            except Exception as error:
                raise unreadable(source.path, error) from error


class _Collector:
    """The columns of one topic, as its messages come in."""

    def __init__(self, path: Path, msgtype: str, channel: Channel, types: Typestore) -> None:
        self.count = 0
        self._topic = channel.topic
        self._source = f'{path}:{channel.topic}'
        self._msgtype = msgtype
        self._ros1 = channel.encoding == 'ros1'
        self._has_header = _begins_with_header(types, channel.msgtype)
        self._logged, self._stamps = array('q'), array('q')
        self._frames: Counter[bytes] = Counter()
        self._block: list[bytes] = []
        self._bytes = 0
        self._parts: list[np.ndarray] = []
        self._numbers: Callable[[list[bytes]], np.ndarray] | None = None
        if self._has_header and (msgtype == IMU or (msgtype in CONVERTERS and msgtype != PATH)):
            self._numbers = _numbers_of(_Decoder(self._source, channel, types))

    def add(self, log_ns: int, raw: bytes) -> None:
        """Take one message."""
        self.count += 1
        self._logged.append(log_ns)
        if not self._has_header:
            return
        try:
            order = '<' if self._ros1 or raw[1] & 1 else '>'
            _, seconds, nanoseconds, length = struct.unpack_from(f'{order}IiII', raw)
        except (struct.error, IndexError) as error:
            raise unreadable(self._source, error) from error
        if length > len(raw) - 16:
            raise ReadError(self._source, f'its message {self.count} is damaged')
        self._stamps.append(seconds * 1_000_000_000 + nanoseconds)
        self._frames[bytes(raw[16 : 16 + length])] += 1
        if self._numbers:
            self._block.append(raw)
            self._bytes += len(raw)
            if self._bytes > BLOCK_BYTES:
                self._decode()

    def stream(self) -> Stream:
        """Return all messages, in the order in which they were recorded."""
        self._decode()
        logged = np.array(self._logged, np.int64)
        order = np.argsort(logged, kind='stable')
        return Stream(
            self._topic,
            self._msgtype,
            logged[order],
            np.array(self._stamps, np.int64)[order] if self._has_header else None,
            self._names(),
            np.concatenate(self._parts)[order] if self._parts else None,
        )

    def _names(self) -> Counter[str]:
        names: Counter[str] = Counter()
        for name, count in self._frames.items():
            names[name.rstrip(b'\0').decode(errors='replace')] += count
        return names

    def _decode(self) -> None:
        if self._block and self._numbers:
            self._parts.append(self._numbers(self._block))
            self._block, self._bytes = [], 0


def _begins_with_header(types: Typestore, msgtype: str) -> bool:
    """Return whether the first field of a message is a header; not so of unknown types."""
    if msgtype not in types.fielddefs:
        return False
    _, fields = types.fielddefs[msgtype]
    return bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)


def _numbers_of(decoder: _Decoder) -> Callable[[list[bytes]], np.ndarray]:
    """Return what makes columns of numbers of the messages of an IMU, or of poses."""
    if decoder.msgtype == IMU:
        return lambda block: _columns(block, decoder)[1]
    return lambda block: decoder.columns(block)[1][:, :POSE_NUMBERS]


def _read_folder(path: Path, sensors: dict[Path, Sensor], progress: Progress) -> list[Stream]:
    """Return the streams of an ASL folder, which does not say when messages were recorded."""
    counts = {topic.name: topic.count for topic in AslFolder(path, sensors).topics}
    rows = ((folder, row) for folder, sensor in sensors.items() for row in _rows(folder, sensor))
    stamps: dict[Path, array] = {folder: array('q') for folder in sensors}
    numbers: dict[Path, array] = {folder: array('d') for folder in sensors}
    for folder, (stamp_ns, row) in progress(rows, sum(counts.values())):
        stamps[folder].append(stamp_ns)
        if sensors[folder].columns > 2:  # the others are cameras
            try:
                numbers[folder].extend(map(float, row[1 : sensors[folder].columns]))
            except ValueError as error:
                raise ReadError(folder / 'data.csv', f'at stamp {stamp_ns}: {error}') from None
    return [
        Stream(
            sensor.topic,
            sensor.msgtype,
            None,
            np.array(stamps[folder], np.int64),
            {sensor.frame: len(stamps[folder])},
            _table(numbers[folder], sensor) if sensor.columns > 2 else None,
        )
        for folder, sensor in sensors.items()
        if stamps[folder]
    ]


def _table(numbers: Sequence[float], sensor: Sensor) -> np.ndarray:
    """Return (N, 3), (N, 6) or (N, 7) numbers; EuRoC's quaternions begin with w."""
    table = np.array(numbers).reshape(-1, sensor.columns - 1)
    return table if table.shape[1] < 7 else table[:, [0, 1, 2, 4, 5, 6, 3]]
