"""The noise of the IMU in a recording or a CSV file."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.imu.analysis import analyse, Analysis, UNITS
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.imu.record import Record
from vio_eval_ros.recordings.imu import read_imu
from vio_eval_ros.recordings.progress import Progress, silent


def imu_noise(
    recording: str | Path,
    topic: str | None = None,
    *,
    gyro_unit: str | None = None,
    accel_unit: str | None = None,
    limits: ImuNoiseLimits | None = None,
    profile: str = PROFILES[0],
    progress: Progress = silent,
) -> Analysis:
    """
    Return the noise of an IMU that was recorded at rest; this needs allantools.

    :param recording: a ROS 1 bag, rosbag2, mcap or EuRoC folder with an IMU; or a CSV file of
        time, angular rates x y z and accelerations x y z, or with names in its header.
    :param topic: of the IMU; may be left out where there is only one.
    :param gyro_unit: 'rad/s' or 'deg/s', of the record; None is inferred.
    :param accel_unit: 'm/s2' or 'g'; likewise.
    :param limits: those of the profile where None.
    :raises ReadError: the recording or the topic cannot be read, or has too few samples.
    :raises ConfigError: there is no such unit or profile, or allantools is not installed.
    """
    require('allantools')
    given = {'gyro': gyro_unit, 'accel': accel_unit}
    for kind, unit in given.items():
        if unit is not None and unit not in UNITS[kind]:
            raise ConfigError(f"{kind}_unit: '{unit}' is not one of {', '.join(UNITS[kind])}")
    limits = limits or ImuNoiseLimits.of(profile)
    path = Path(recording)
    record = Record(path, limits=limits)
    source = read_imu(path, topic, record.add, progress)
    analysis = analyse(
        str(source),
        record.finish(),
        stated={**source.units, **{kind: unit for kind, unit in given.items() if unit}},
        topic=source.topic,
        limits=limits,
        profile=profile,
    )
    return replace(analysis, warnings=(*source.warnings, *analysis.warnings))


def require(library: str) -> None:
    """Raise ``ConfigError`` where a library is not installed: before hours of samples are read."""
    if find_spec(library) is None:
        raise ConfigError(f"{library} is needed: pip install {library}, or the extra 'imu'")
