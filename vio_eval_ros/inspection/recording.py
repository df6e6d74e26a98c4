"""Inspects a recording: its streams, its calibration, what was expected; start reading here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.inspection.calibration import check_calibration
from vio_eval_ros.inspection.calibration_files import read_calibrations
from vio_eval_ros.inspection.expectations import Expectations
from vio_eval_ros.inspection.inspection import inspect_streams
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.report import Report
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.sensors import read_sensors


def inspect_recording(
    recording: Path,
    calibrations: Sequence[Path] = (),
    expectations: Expectations | None = None,
    *,
    profile: str = PROFILES[0],
    limits: InspectionLimits | None = None,
    progress: Progress = silent,
) -> Report:
    """
    Return what is wrong with the sensor streams of a recording.

    :param recording: a ROS 1 bag, a rosbag2 folder, a bare .db3 or .mcap, or a EuRoC folder.
    :param calibrations: Kalibr's files, EuRoC's ``sensor.yaml`` files or their folder.
    :param expectations: what the streams should be like.
    :param profile: the platform, one of PROFILES.
    :param limits: between healthy and not; by default those of the profile.
    :raises ReadError: the recording or a calibration cannot be read.
    :raises ConfigError: a calibration, or the profile, makes no sense.
    """
    limits = limits or InspectionLimits.of(profile)
    files = read_calibrations(calibrations)
    sensors = read_sensors(recording, progress)
    inspection = inspect_streams(
        sensors.streams, sensors.left_out, limits, unfinished=sensors.unfinished
    )
    return Report(
        source=str(recording),
        inspection=inspection,
        expectations=expectations.check(inspection) if expectations else (),
        calibration=check_calibration(files, inspection) if files else None,
        profile=profile,
    )
