"""
The streams of a recording as columns; memory grows with the messages, not with their images.

Only the header of each message is read, from the raw bytes (of a TF message, that of its first
transform), and the numbers of IMUs and poses. EuRoC's folders are read without opening an image.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from operator import attrgetter
from pathlib import Path
import struct
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.decoder import Blocks, Decoder
from vio_eval_ros.recordings.euroc import Sensor, sensors_in, table
from vio_eval_ros.recordings.imu import IMU, samples
from vio_eval_ros.recordings.messages import PATH, USUAL
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.recording import Recording
from vio_eval_ros.recordings.storage_files import reading
from vio_eval_ros.recordings.transforms import TF_TYPES, TransformTree

IMAGES = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
# numbers of an IMU and of a pose; the covariance after them is not needed here
IMU_NUMBERS, POSE_NUMBERS = 6, 7
# of more messages with transforms, only the first are decoded: each takes its time
MAX_DECODED_TRANSFORMS = 20_000
# by field; a covariance that begins with -1 says that there is no such sensor
SENSORS = {'gyroscope': 'angular_velocity', 'accelerometer': 'linear_acceleration'}


class Sensors(NamedTuple):
    """
    What was read of a recording.

    :param streams: one for each topic, topics without messages included.
    :param left_out: a sentence for each topic that cannot be read.
    :param unfinished: what is unusual about the files, in sentences.
    """

    streams: list[SensorStream]
    left_out: list[str]
    unfinished: Sequence[str] = ()


def read_sensors(path: Path, progress: Progress = silent) -> Sensors:
    """
    Return every stream of a recording.

    :param path: a ROS 1 bag, a rosbag2 folder, a bare .db3 or .mcap, or an ASL folder.
    :raises ReadError: it cannot be read, is damaged or has no message with a header.
    """
    folders = sensors_in(path)
    if folders:
        found = Sensors([_of_folder(*one) for one in progress(folders.items(), len(folders))], [])
    else:
        with Recording(path) as recording:
            found = _of_recording(recording, progress)._replace(unfinished=recording.warnings)
    streams = found.streams
    if not any(map(len, streams)):
        raise ReadError(path, '; '.join(['there are no messages in it', *found.left_out]))
    if not any(stream.stamps_ns is not None and len(stream) for stream in streams):
        listed = ', '.join(f'{stream.topic} ({stream.msgtype})' for stream in streams)
        why = f'no topic has messages with a header; topics: {listed}'
        raise ReadError(path, '; '.join([why, *found.left_out]))
    return found


def _of_folder(folder: Path, sensor: Sensor) -> SensorStream:
    """Return a stream of an ASL folder, which does not say when messages were recorded."""
    stamps_ns, numbers = table(folder, sensor)
    frames = {sensor.frame: len(stamps_ns)}
    kind = _kind(sensor.msgtype, numbers is not None)
    return SensorStream(
        topic=sensor.topic,
        msgtype=sensor.msgtype,
        kind=kind,
        logged_ns=None,
        stamps_ns=stamps_ns,
        frames=frames,
        numbers=numbers,
    )


def _kind(msgtype: str, has_numbers: bool) -> str:
    """Return what a stream holds."""
    if msgtype in IMAGES:
        return 'camera'
    if msgtype == IMU:
        return 'imu'
    return 'pose' if has_numbers else 'other'


def _of_recording(recording: Recording, progress: Progress) -> Sensors:
    collectors: dict[str, _StreamColumns] = {}
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
        if not decoder.is_ros:
            left_out.append(f'{name} is not serialised as in ROS')
            continue
        if not decoder.is_known:
            left_out.append(
                f'the recording has no definition of {topics[0].msgtype}: of the messages on '
                f'{name}, only the time of recording is known'
            )
        collectors[name] = _StreamColumns(name, decoder)
    recording.feed({name: [one.add] for name, one in collectors.items()}, progress)
    return Sensors([one.stream() for one in collectors.values()], left_out)


class _StreamColumns:
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
        # where the header begins: the first transform comes after their number
        self._header = 0 if decoder.has_header else 4 if msgtype in TF_TYPES else None
        self._tree = TransformTree(topic) if msgtype in TF_TYPES and decoder.is_known else None
        self._has_numbers = decoder.has_header and (
            msgtype == IMU or (msgtype in USUAL and msgtype != PATH)
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
            raise ReadError(source, f'message {len(self._logged)} is damaged')
        self._stamps.append(seconds * 1_000_000_000 + nanoseconds)
        if not begin:  # transforms are between many frames
            self._frames[bytes(raw[name : name + length])] += 1
        if self._has_numbers:
            self._blocks.add(raw)
        elif self._tree is not None and len(self._logged) <= MAX_DECODED_TRANSFORMS:
            with reading(source):
                self._tree.add(self._decoder.deserialize(raw))

    def stream(self) -> SensorStream:
        """Return all messages, in the order in which they were written."""
        self._blocks.flush()
        width = IMU_NUMBERS if self._decoder.msgtype == IMU else POSE_NUMBERS
        numbers = np.concatenate(self._parts or [np.empty((0, width))])
        return SensorStream(
            topic=self._topic,
            msgtype=self._decoder.msgtype,
            kind=_kind(self._decoder.msgtype, self._has_numbers),
            logged_ns=np.array(self._logged, np.int64),
            stamps_ns=None if self._header is None else np.array(self._stamps, np.int64),
            frames=self._names(),
            numbers=numbers if self._has_numbers else None,
            lacks=self._lacks,
            transforms={} if self._tree is None else self._tree.sent(),
        )

    def _names(self) -> Counter[str]:
        names: Counter[str] = Counter()
        for name, count in self._frames.items():
            names[name.rstrip(b'\0').decode(errors='replace')] += count
        return names

    def _decode(self, block: list[bytes]) -> None:
        if self._decoder.msgtype == IMU:
            part = samples(block, self._decoder)[1]
            if not self._parts:  # all messages say what the first one does
                self._lacks = _lacking(self._decoder.deserialize(block[0]))
            for k, name in enumerate(SENSORS):
                if name in self._lacks:
                    part[:, 3 * k : 3 * k + 3] = 0
            self._parts.append(part)
        else:
            self._parts.append(self._decoder.columns(block)[1][:, :POSE_NUMBERS])


def _lacking(message: Any) -> tuple[str, ...]:
    """Return the sensors that an IMU does not have, as one of its messages says."""
    covariances = {
        name: getattr(message, f'{field}_covariance', (0.0,)) for name, field in SENSORS.items()
    }
    return tuple(name for name, values in covariances.items() if values[0] == -1)
