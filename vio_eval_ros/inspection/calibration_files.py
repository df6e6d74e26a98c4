"""The calibration files of Kalibr, OpenVINS and EuRoC: which transformations they give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path

import numpy as np

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.settings import finite, load_yaml, Section

#: What the names of transformations mean: whether the first or the second frame is the sensor's.
#: T_A_B maps coordinates in B into coordinates in A.
FROM_CAMERA = ('T_imu_cam', 'T_BS', 'T_i_c', 'T_body_cam')
TO_CAMERA = ('T_cam_imu', 'T_c_i', 'T_cam_body')
#: Kalibr's name of what maps the camera before one into it
FROM_CAMERA_BEFORE = 'T_cn_cnm1'
#: What Kalibr and EuRoC say of the noise of an IMU: the unit, and the least and the most of any
#: sensor, from fibre-optic gyroscopes to cheap ones whose figures were enlarged for a filter.
NOISE = {
    'gyroscope_noise_density': ('rad/s/√Hz', 1e-8, 0.1),
    'gyroscope_random_walk': ('rad/s²/√Hz', 1e-10, 0.01),
    'accelerometer_noise_density': ('m/s²/√Hz', 1e-6, 1.0),
    'accelerometer_random_walk': ('m/s³/√Hz', 1e-8, 0.1),
}
RATES = dict.fromkeys(('update_rate', 'rate_hz'), ('Hz', 10.0, 20_000.0))
# Larger entries of a matrix are not lengths in any unit
LARGEST_ENTRY = 1e6


@dataclass(frozen=True, eq=False)
class CalibrationFile:
    """
    The sensors of one file of Kalibr's, or of one folder of EuRoC's, cameras by name.

    :param cameras: by name, (4, 4) what maps coordinates in the camera into those of the IMU.
    :param keys: by name, the key under which the file has it; empty where it is the origin.
    :param between: by name, (4, 4) what maps the camera before it into it (``T_cn_cnm1``).
    :param shifts: by name, seconds to be added to the stamps of the camera.
    :param given: (4, 4) all transformations as they were written, by sensor and key.
    :param noise: by name, the noise densities of an IMU and its rate.
    """

    source: str
    cameras: dict[str, np.ndarray] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    between: dict[str, np.ndarray] = field(default_factory=dict)
    shifts: dict[str, float] = field(default_factory=dict)
    given: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)
    noise: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def has_imu(self) -> bool:
        """Whether the cameras are given in an IMU; otherwise the first of them is the origin."""
        return '' not in self.keys.values()


def read_calibrations(paths: Sequence[Path]) -> list[CalibrationFile]:
    """
    Return what each file of Kalibr's and each folder of EuRoC's gives.

    :param paths: Kalibr's camchain, camchain-imucam or imu files, EuRoC's ``sensor.yaml`` files,
        or folders of those.
    :raises ReadError: a file does not exist, or is not YAML.
    :raises ConfigError: a file has neither a transformation nor the noise of an IMU, or has a
        transformation that is not a 4 x 4 matrix, or a value that is not a finite number.
    """
    found: dict[str, CalibrationFile] = {}
    for path in paths:
        files = sorted(path.glob('**/sensor.yaml')) if path.is_dir() else [path]
        if not files:
            raise ReadError(path, 'there is no sensor.yaml in it')
        for file in files:
            content = load_yaml(file, 'a calibration')
            is_euroc = 'T_BS' in content
            source = str(file.parent.parent if is_euroc else file)
            sensors = {file.parent.name: content} if is_euroc else _sensors(content)
            if not sensors:
                raise ConfigError(
                    f'{file}: there is no T_BS, and no sensor with a transformation in it'
                )
            for name, sensor in sensors.items():
                _add(found.setdefault(source, CalibrationFile(source)), name, sensor)
    return list(found.values())


def _sensors(content: Section) -> dict[str, Section]:
    """Return the sensors in a file of Kalibr's: each has a section, but for the only IMU."""
    if content.keys() & NOISE.keys():
        return {'imu0': content}
    return {
        name: value
        for name, value in content.items()
        if isinstance(value, Section) and name.startswith(('cam', 'imu'))
    }


def _add(file: CalibrationFile, name: str, sensor: Section) -> None:
    """Add a sensor to its file."""
    if sensor.get('sensor_type', name[:3]) in ('camera', 'cam'):
        _add_camera(file, name, sensor)
    else:
        _add_imu(file, name, sensor)


def _add_imu(file: CalibrationFile, name: str, sensor: Section) -> None:
    _transformations(file, name, sensor, ('T_BS', 'T_i_b'))
    known = [key for key in (*NOISE, *RATES) if key in sensor]
    file.noise[name] = {key: _number(sensor, key) for key in known}


def _add_camera(file: CalibrationFile, name: str, sensor: Section) -> None:
    keys = [key for key in (*FROM_CAMERA, *TO_CAMERA) if key in sensor]
    given = _transformations(file, name, sensor, (*keys[:1], FROM_CAMERA_BEFORE))
    before = next(reversed(file.cameras), None)
    if FROM_CAMERA_BEFORE in given and before is not None:
        file.between[name] = given[FROM_CAMERA_BEFORE]
    if keys:
        matrix = given[keys[0]]
        file.cameras[name] = matrix if keys[0] in FROM_CAMERA else inverse(matrix)
        file.keys[name] = keys[0]
    elif before is not None and name in file.between:
        # cn from cn-1, so the IMU from cn by way of cn-1
        file.cameras[name] = file.cameras[before] @ inverse(file.between[name])
        file.keys[name] = FROM_CAMERA_BEFORE
    elif before is None:
        # the first camera of a chain without an IMU: all is relative to it
        file.cameras[name] = np.eye(4)
        file.keys[name] = ''
    else:
        known = [*FROM_CAMERA, *TO_CAMERA, FROM_CAMERA_BEFORE]
        raise sensor.error(name, f'{name} has none of {", ".join(known)}')
    if 'timeshift_cam_imu' in sensor:
        file.shifts[name] = _number(sensor, 'timeshift_cam_imu')


def _transformations(
    file: CalibrationFile, name: str, sensor: Section, keys: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return the (4, 4) matrices under those of the keys that are there, and remember them."""
    given = {key: _matrix(sensor, key) for key in keys if key in sensor}
    file.given.update({(name, key): matrix for key, matrix in given.items()})
    return given


def _number(sensor: Section, key: str) -> float:
    number = finite(sensor[key])
    if math.isnan(number):
        raise sensor.error(key, f'{key}: expected a finite number')
    return number


def _matrix(sensor: Section, key: str) -> np.ndarray:
    """Return a (4, 4) matrix, of rows as Kalibr has it or of columns, rows and data as EuRoC."""
    value = sensor[key]
    if isinstance(value, Mapping):
        value = value.get('data')
    try:
        matrix = np.array(value, np.float64)
        if matrix.shape in ((4, 4), (16,)) and (np.abs(matrix) < LARGEST_ENTRY).all():
            return matrix.reshape(4, 4)
    except (TypeError, ValueError, OverflowError):
        pass
    raise sensor.error(
        key,
        f'{key}: expected a matrix of 4 rows and 4 columns, of numbers below {LARGEST_ENTRY:g}',
    )


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a rigid transformation; another one is treated as if it were rigid."""
    result = np.eye(4)
    result[:3, :3] = matrix[:3, :3].T
    result[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return result
