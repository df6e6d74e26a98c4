"""
EuRoC's folders in ASL format, as the ROS messages that EuRoC's bags have.

There is one folder per sensor, each with a ``data.csv``; those of cameras have PNG images, too.
A further sensor is one function and one line in :data:`SENSORS`.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Sequence
import csv
import heapq
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.container import Topic
from vio_eval_ros.recordings.rows import INT64_MAX
from vio_eval_ros.recordings.storage import OfferedQos, standard_types

TYPES = standard_types(ros1=False).types
ENCODINGS = {'L': 'mono8', 'I;16': 'mono16', 'RGB': 'rgb8'}  # of Pillow, of ROS


def _geometry(name: str, *values: Any) -> Any:
    return TYPES[f'geometry_msgs/msg/{name}'](*values)


def _vector(texts: Sequence[str]) -> Any:
    return _geometry('Vector3', *map(float, texts))


def _point(texts: Sequence[str]) -> Any:
    return _geometry('Point', *map(float, texts))


def _quaternion(texts: Sequence[str]) -> Any:
    w, x, y, z = map(float, texts)
    return _geometry('Quaternion', x, y, z, w)


def _imu(header: Any, row: list[str], _: Path) -> Any:
    unknown, none = np.zeros(9), np.zeros(9)
    none[0] = -1  # there is no orientation
    level = _geometry('Quaternion', 0.0, 0.0, 0.0, 1.0)
    rates, accelerations = _vector(row[1:4]), _vector(row[4:7])
    return TYPES['sensor_msgs/msg/Imu'](
        header=header,
        orientation=level,
        orientation_covariance=none,
        angular_velocity=rates,
        angular_velocity_covariance=unknown,
        linear_acceleration=accelerations,
        linear_acceleration_covariance=unknown,
    )


def _image(header: Any, row: list[str], folder: Path) -> Any:
    from PIL import Image

    file = folder / 'data' / row[1].strip()
    with Image.open(file) as image:
        if image.mode not in ENCODINGS:
            raise ReadError(
                file, f'has pixels of mode {image.mode}; known: {", ".join(ENCODINGS)}'
            )
        pixels = np.frombuffer(image.tobytes(), np.uint8)
        size, encoding = image.size, ENCODINGS[image.mode]
    return TYPES['sensor_msgs/msg/Image'](
        header=header,
        height=size[1],
        width=size[0],
        encoding=encoding,
        is_bigendian=0,
        step=len(pixels) // size[1],
        data=pixels,
    )


def _pose(header: Any, row: list[str], _: Path) -> Any:
    pose = _geometry('Pose', _point(row[1:4]), _quaternion(row[4:8]))
    return _geometry('PoseStamped', header, pose)


def _position(header: Any, row: list[str], _: Path) -> Any:
    return _geometry('PointStamped', header, _point(row[1:4]))


def _transform(header: Any, row: list[str], _: Path) -> Any:
    transform = _geometry('Transform', _vector(row[1:4]), _quaternion(row[4:8]))
    return _geometry('TransformStamped', header, 'vicon/firefly_sbx/firefly_sbx', transform)


class Sensor(NamedTuple):
    """What the rows of a sensor become; ``columns`` is how many they have at least."""

    topic: str
    msgtype: str
    frame: str
    columns: int
    message: Callable[[Any, list[str], Path], Any]


# Of equal stamps, inertial data comes first: an estimator wants it up to the time of an image.
SENSORS = {
    'imu0': Sensor('/imu0', 'sensor_msgs/msg/Imu', 'imu0', 7, _imu),
    'cam0': Sensor('/cam0/image_raw', 'sensor_msgs/msg/Image', 'cam0', 2, _image),
    'cam1': Sensor('/cam1/image_raw', 'sensor_msgs/msg/Image', 'cam1', 2, _image),
    'state_groundtruth_estimate0': Sensor(
        '/ground_truth/pose', 'geometry_msgs/msg/PoseStamped', 'world', 8, _pose
    ),
    'leica0': Sensor('/leica/position', 'geometry_msgs/msg/PointStamped', 'world', 4, _position),
    'vicon0': Sensor(
        '/vicon/firefly_sbx/firefly_sbx',
        'geometry_msgs/msg/TransformStamped',
        'world',
        8,
        _transform,
    ),
}


def sensors_in(path: Path) -> dict[Path, Sensor]:
    """Return the folders of sensors in a sequence or its ``mav0``; none elsewhere."""
    return {
        folder: sensor
        for root in (path / 'mav0', path)
        for name, sensor in SENSORS.items()
        if (folder := root / name).joinpath('data.csv').is_file()
    }


class EurocFolder:
    """
    A sequence to be played.

    :raises ReadError: a file that cannot be read or does not look as it should.
    """

    def __init__(self, path: Path, sensors: dict[Path, Sensor]) -> None:
        self.path = path
        self.topics: list[Topic] = []
        self.offers: dict[str, OfferedQos] = {}  # nothing is known of publishers
        self.warnings: list[str] = []
        self.notes: list[str] = []
        self._sensors = sensors
        stamps: list[int] = []
        for folder, sensor in sensors.items():
            found = [stamp_ns for stamp_ns, _ in _rows(folder, sensor)]
            self.topics.append(Topic(sensor.topic, sensor.msgtype, len(found)))
            stamps += (*found[:1], *found[-1:])
        self.span_ns = (min(stamps), max(stamps)) if stamps else None

    def definition(self, topic: str) -> str:
        """Return the definition of the messages of a topic, as ROS 2 writes it."""
        msgtype = next(one.msgtype for one in self.topics if one.name == topic)
        return standard_types(ros1=False).generate_msgdef(msgtype, ros_version=2)[0]

    def messages(
        self, names: set[str], start_ns: int, end_ns: int
    ) -> Iterator[tuple[int, str, bytes]]:
        """Return the messages of some topics from one time to another, in order."""
        wanted = {f: sensor for f, sensor in self._sensors.items() if sensor.topic in names}
        if any(sensor.message is _image for sensor in wanted.values()):
            try:
                import PIL  # noqa: F401
            except ImportError:
                raise ReadError(
                    self.path,
                    "images need Pillow (pip install pillow, or the extra 'images'); "
                    'or name other topics with --topics',
                ) from None
        return self._messages(wanted, start_ns, end_ns)

    def _messages(
        self, wanted: dict[Path, Sensor], start_ns: int, end_ns: int
    ) -> Iterator[tuple[int, str, bytes]]:
        streams = [_labelled(folder, sensor) for folder, sensor in wanted.items()]
        serialize = standard_types(ros1=False).serialize_cdr
        time, header = TYPES['builtin_interfaces/msg/Time'], TYPES['std_msgs/msg/Header']
        for stamp_ns, row, folder, sensor in heapq.merge(*streams, key=itemgetter(0)):
            if start_ns <= stamp_ns <= end_ns:
                head = header(time(*divmod(stamp_ns, 10**9)), sensor.frame)
                try:
                    message = sensor.message(head, row, folder)
                    cdr = bytes(serialize(message, sensor.msgtype))
                except ReadError:
                    raise
                except Exception as error:  # Pillow and struct have errors of their own
                    raise ReadError(folder, f'at stamp {stamp_ns}: {error}') from error
                yield stamp_ns, sensor.topic, cdr


def _labelled(folder: Path, sensor: Sensor) -> Iterator[tuple[int, list[str], Path, Sensor]]:
    return ((stamp_ns, row, folder, sensor) for stamp_ns, row in _rows(folder, sensor))


def table(folder: Path, sensor: Sensor) -> tuple[np.ndarray, np.ndarray | None]:
    """
    Return the rows of a sensor as columns.

    :return: (N,) int64 nanoseconds, and (N, 3), (N, 6) or (N, 7) numbers, quaternions x y z w as
        messages have them; None of a camera.
    :raises ReadError: rows that are not numbers.
    """
    width = sensor.columns - 1
    has_numbers = width > 1  # the rows of cameras name a file
    stamps, numbers = array('q'), array('d')
    for stamp_ns, row in _rows(folder, sensor):
        stamps.append(stamp_ns)
        if has_numbers:
            try:
                numbers.extend(map(float, row[1 : 1 + width]))
            except ValueError as error:
                raise ReadError(folder / 'data.csv', f'at stamp {stamp_ns}: {error}') from None
    if not has_numbers:
        return np.array(stamps, np.int64), None
    columns = np.array(numbers).reshape(-1, width)
    if width == 7:
        columns = columns[:, [0, 1, 2, 4, 5, 6, 3]]
    return np.array(stamps, np.int64), columns


def _rows(folder: Path, sensor: Sensor) -> Iterator[tuple[int, list[str]]]:
    """Yield the stamp [ns] and the columns of each row of a sensor."""
    path = folder / 'data.csv'
    try:
        with path.open(newline='', encoding='utf-8') as file:
            for number, row in enumerate(csv.reader(file), 1):
                if not row or row[0].startswith('#'):
                    continue
                if len(row) < sensor.columns or not row[0].strip().isdigit():
                    raise ReadError(
                        path,
                        f'line {number}: expected a stamp [ns] and {sensor.columns - 1} values',
                    )
                if int(row[0]) > INT64_MAX:
                    raise ReadError(
                        path, f'line {number}: {row[0].strip()} is too large to be a stamp [ns]'
                    )
                yield int(row[0]), row
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ReadError(path, str(error)) from error
