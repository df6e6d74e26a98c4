"""
The streams of a recording as columns, in memory that grows with messages but not with images.

Of each message only its header is kept, as it stands in the raw bytes, of transforms that of the
first; of inertial sensors and poses the numbers, too. EuRoC's folders are read without opening an
image.
"""

from __future__ import annotations

from array import array
from collections import Counter
from itertools import groupby
from operator import attrgetter
from pathlib import Path
import struct
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.asl import Sensor, sensors_in, table
from vio_eval_ros.recordings.bags import Recording
from vio_eval_ros.recordings.container import reading
from vio_eval_ros.recordings.decoder import Blocks, Decoder
from vio_eval_ros.recordings.imu import IMU, samples
from vio_eval_ros.recordings.messages import CONVERTERS, PATH
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.transforms import TF_TYPES

IMAGES = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
# numbers of an IMU, and of a pose: what is behind, a covariance, is of no use here
IMU_NUMBERS, POSE_NUMBERS = 6, 7
# Where an IMU has no such sensor, the covariance begins with -1
SENSORS = {'gyroscope': 'angular_velocity', 'accelerometer': 'linear_acceleration'}


class Sensors(NamedTuple):
    """
    What was read of a recording.

    :param streams: of topics without messages, too.
    :param left_out: a sentence for each topic that cannot be read.
    """

    streams: list[SensorStream]
    left_out: list[str]


def read_sensors(path: Path, progress: Progress = silent) -> Sensors:
    """
    Return every stream of a recording.

    :param path: a ROS 1 bag, a rosbag2 folder, a bare .db3 or .mcap, or an ASL folder.
    :raises ReadError: what cannot be read, is damaged or has no message with a header.
    """
    folders = sensors_in(path)
    if folders:
        found = Sensors([_of_folder(*one) for one in progress(folders.items(), len(folders))], [])
    else:
        with Recording(path) as recording:
            found = _of_recording(recording, progress)
    streams = found.streams
    if not any(map(len, streams)):
        raise ReadError(path, '; '.join(['there are no messages in it', *found.left_out]))
    if not any(stream.stamps_ns is not None and len(stream) for stream in streams):
        listed = ', '.join(f'{stream.topic} ({stream.msgtype})' for stream in streams)
        why = f'no topic has messages with a header; there are {listed}'
        raise ReadError(path, '; '.join([why, *found.left_out]))
    return found


def _of_folder(folder: Path, sensor: Sensor) -> SensorStream:
    """Return a stream of an ASL folder, which does not say when messages were recorded."""
    stamps_ns, numbers = table(folder, sensor)
    frames = {sensor.frame: len(stamps_ns)}
    kind = _kind(sensor.msgtype, numbers is not None)
    return SensorStream(sensor.topic, sensor.msgtype, kind, None, stamps_ns, frames, numbers)


def _kind(msgtype: str, has_numbers: bool) -> str:
    """Return what a stream holds."""
    if msgtype in IMAGES:
        return 'camera'
    if msgtype == IMU:
        return 'imu'
    return 'pose' if has_numbers else 'other'


def _of_recording(recording: Recording, progress: Progress) -> Sensors:
    collectors: dict[str, _Collector] = {}
    left_out = []
    for name, group in groupby(recording.topics, attrgetter('name')):
        topics = list(group)
        if len(topics) > 1:
            types = ' and '.join(topic.msgtype for topic in topics)
            left_out.append(f'{name} has messages of types {types}')
            continue
        try:
            decoder = recording.decoder(topics[0])
        except ReadError as error:
            left_out.append(f'{name} {error.problem}')
            continue
        if not decoder.is_known:
            left_out.append(
                f'the recording has no definition of {topics[0].msgtype}: of {name} there is only '
                'when messages were recorded'
            )
        collectors[name] = _Collector(name, decoder)
    recording.feed({name: [one.add] for name, one in collectors.items()}, progress)
    return Sensors([one.stream() for one in collectors.values()], left_out)


class _Collector:
    """The columns of one topic, as its messages come in."""

    def __init__(self, topic: str, decoder: Decoder) -> None:
        self._topic = topic
        self._decoder = decoder
        self._logged, self._stamps = array('q'), array('q')
        self._frames: Counter[bytes] = Counter()
        self._blocks = Blocks(self._decode)
        self._parts: list[np.ndarray] = []
        self._lacks: tuple[str, ...] = ()
        msgtype = decoder.msgtype
        # where the header begins: that of the first transform is behind how many there are
        self._header = 0 if decoder.has_header else 4 if msgtype in TF_TYPES else None
        self._has_numbers = decoder.has_header and (
            msgtype == IMU or (msgtype in CONVERTERS and msgtype != PATH)
        )

    def add(self, log_ns: int, raw: bytes) -> None:
        """Take one message."""
        self._logged.append(log_ns)
        begin = self._header
        if begin is None:
            return
        source, ros1 = self._decoder.source, self._decoder.ros1
        if begin and not any(raw[:4] if ros1 else raw[4:8]):
            self._stamps.append(0)  # no transform, no stamp
            return
        with reading(source):
            order = '<' if ros1 or raw[1] & 1 else '>'
            _, seconds, nanoseconds, length = struct.unpack_from(f'{order}IiII', raw, begin)
        name = begin + 16
        if length > len(raw) - name:
            raise ReadError(source, f'its message {len(self._logged)} is damaged')
        self._stamps.append(seconds * 1_000_000_000 + nanoseconds)
        if not begin:  # transforms are between many frames
            self._frames[bytes(raw[name : name + length])] += 1
        if self._has_numbers:
            self._blocks.add(raw)

    def stream(self) -> SensorStream:
        """Return all messages, in the order in which they were written."""
        self._blocks.flush()
        width = IMU_NUMBERS if self._decoder.msgtype == IMU else POSE_NUMBERS
        return SensorStream(
            self._topic,
            self._decoder.msgtype,
            _kind(self._decoder.msgtype, self._has_numbers),
            np.array(self._logged, np.int64),
            None if self._header is None else np.array(self._stamps, np.int64),
            self._names(),
            np.concatenate(self._parts or [np.empty((0, width))]) if self._has_numbers else None,
            self._lacks,
        )

    def _names(self) -> Counter[str]:
        names: Counter[str] = Counter()
        for name, count in self._frames.items():
            names[name.rstrip(b'\0').decode(errors='replace')] += count
        return names

    def _decode(self, block: list[bytes]) -> None:
        if self._decoder.msgtype == IMU:
            part = samples(block, self._decoder)[1]
            if not self._parts:  # what the first message says of it, all do
                self._lacks = _lacking(self._decoder.deserialize(block[0]))
            for k, name in enumerate(SENSORS):
                if name in self._lacks:
                    part[:, 3 * k : 3 * k + 3] = 0
            self._parts.append(part)
        else:
            self._parts.append(self._decoder.columns(block)[1][:, :POSE_NUMBERS])


def _lacking(message: Any) -> tuple[str, ...]:
    """Return the sensors that an IMU says not to have, in a message of its."""
    covariances = {
        name: getattr(message, f'{field}_covariance', (0.0,)) for name, field in SENSORS.items()
    }
    return tuple(name for name, values in covariances.items() if values[0] == -1)
