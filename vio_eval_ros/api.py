"""
The package as a library: what ``import vio_eval_ros as vio`` gives.

A trajectory is taken in any form: a source spec or path as on the command line, what :func:`read`
or :func:`trajectory` returned, columns ``(stamps, positions, rotations)``, or a pandas DataFrame
with columns ``x y z qx qy qz qw``. Shapes, types and stamps are checked before anything is
computed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TYPE_CHECKING

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import check_names, Gate
from vio_eval_ros.core.limits import Kind, Limits, PROFILES
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.recorded import diagnose_sources, read_gyroscope
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.imu.recorded import imu_noise as noise_of
from vio_eval_ros.inspection.expectations import Expectations
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.recording import inspect_recording
from vio_eval_ros.recordings.arrays import source_of, TrajectoryLike
from vio_eval_ros.recordings.progress import silent
from vio_eval_ros.recordings.sources import default_topics, read_sources, Source
from vio_eval_ros.results import Diagnosis, ImuNoise, Inspection, Result

if TYPE_CHECKING:
    pass


def read(
    spec: str | Path, recording: str | Path | None = None, *, times: str | Path | None = None
) -> Source:
    """
    Return the poses that a source spec names, as they were recorded.

    :param spec: a path of a TUM, EuRoC or KITTI file, ``/topic``, ``/tf:PARENT.CHILD`` or
        ``RECORDING:/topic``, with ``?quaternion=wxyz`` and the like appended where needed.
    :param recording: where a topic without a recording of its own is.
    :param times: a file of one stamp [s] a line, for KITTI pose files.
    :raises ReadError: the file, recording or topic cannot be read.
    """
    return read_sources([str(spec)], _path(recording), _path(times))[0]


def evaluate(
    estimate: TrajectoryLike | None = None,
    ground_truth: TrajectoryLike | None = None,
    *,
    recording: str | Path | None = None,
    times: str | Path | None = None,
    gates: Iterable[str | Gate] = (),
    **options: Any,
) -> Result:
    """
    Return how accurate an estimate is.

    :param estimate: in any form, see the module; may be left out where ``recording`` has exactly
        one sensible pair of topics.
    :param ground_truth: likewise.
    :param recording: where topics without a recording of their own are.
    :param times: a file of one stamp [s] a line, for KITTI pose files.
    :param gates: limits such as ``'ate_trans_rmse_m<=0.1'``, judged in ``result.passed``.
    :param options: of :class:`EvaluationConfig`, such as ``alignment='sim3'``; or ``config=`` one.
    :raises InputError: an array or DataFrame has a wrong shape, type or value.
    :raises ReadError: a file, recording or topic cannot be read.
    :raises ConfigError: an option or gate makes no sense.
    :raises NoPairs: the two share no instant.
    """
    config = _config(options)
    judged = [gate if isinstance(gate, Gate) else Gate.parse(gate) for gate in gates]
    if judged:
        check_names(judged, metric_names(config))
    one, other = _sources(estimate, ground_truth, _path(recording), _path(times))
    found = score_run(one, other, config, judged)
    return Result(**_values(found))


def diagnose(
    estimate: TrajectoryLike | None = None,
    ground_truth: TrajectoryLike | None = None,
    *,
    recording: str | Path | None = None,
    times: str | Path | None = None,
    imu: str | None = None,
    profile: str = PROFILES[0],
    limits: Mapping[str, float] | DiagnosisLimits | None = None,
    **options: Any,
) -> Diagnosis:
    """
    Return what is wrong with an estimate: ``.causes``, ``.cannot_tell``, ``.warnings``.

    Inputs and options are those of :func:`evaluate`.

    :param imu: a gyroscope to compare the estimate with: a topic or a CSV file.
    :param profile: the platform, one of drone, car, handheld, legged and indoor_robot.
    :param limits: by name, those to replace in what the profile calls healthy.
    :raises NoPairs: there are too few poses, or the two have no time in common.
    :raises VioEvalError: what else :func:`evaluate` raises; there is no such profile or limit.
    """
    path = _path(recording)
    one, other = _sources(estimate, ground_truth, path, _path(times))
    found = diagnose_sources(
        one,
        other,
        _config(options),
        profile=profile,
        limits=_limits(DiagnosisLimits, profile, limits),
        gyroscope=None if imu is None else read_gyroscope(imu, path, silent),
    )
    return Diagnosis(**_values(found))


def inspect(
    recording: str | Path,
    calibrations: Sequence[str | Path] = (),
    *,
    expectations: str | Path | None = None,
    profile: str = PROFILES[0],
    limits: Mapping[str, float] | InspectionLimits | None = None,
) -> Inspection:
    """
    Return what is wrong with the sensor streams of a recording: ``.findings``, ``.streams``.

    :param recording: a ROS 1 bag, rosbag2 folder, .db3, .mcap or EuRoC folder.
    :param calibrations: files of Kalibr or EuRoC to check against the recording.
    :param expectations: a YAML file of what the streams should be like.
    :param profile: as for :func:`diagnose`; ``limits`` likewise.
    :raises VioEvalError: a file cannot be read or makes no sense.
    """
    found = inspect_recording(
        Path(recording),
        [Path(path) for path in calibrations],
        None if expectations is None else Expectations.load(Path(expectations)),
        profile=profile,
        limits=_limits(InspectionLimits, profile, limits),
    )
    return Inspection(**_values(found))


def imu_noise(
    recording: str | Path,
    topic: str | None = None,
    *,
    gyro_unit: str | None = None,
    accel_unit: str | None = None,
    profile: str = PROFILES[0],
    limits: Mapping[str, float] | ImuNoiseLimits | None = None,
) -> ImuNoise:
    """
    Return the noise of an IMU that was recorded at rest: ``.axes``, ``.parameters()``.

    :param recording: with ``sensor_msgs/Imu``, a EuRoC folder, or a CSV file of time, angular
        rates x y z and accelerations x y z.
    :param topic: of the IMU; may be left out where there is only one.
    :param gyro_unit: ``rad/s`` or ``deg/s``, where the record does not tell.
    :param accel_unit: ``m/s2`` or ``g``, likewise.
    :param profile: as for :func:`diagnose`; ``limits`` likewise.
    :raises VioEvalError: it cannot be read, is too short, or allantools is not installed.
    """
    found = noise_of(
        recording,
        topic,
        gyro_unit=gyro_unit,
        accel_unit=accel_unit,
        profile=profile,
        limits=_limits(ImuNoiseLimits, profile, limits),
    )
    return ImuNoise(**_values(found))


def _values(found: Any) -> dict[str, Any]:
    """Return the fields of a dataclass, to make the class of the face of them."""
    return {item.name: getattr(found, item.name) for item in fields(found)}


def _limits(kind: type[Kind], profile: str, stated: Mapping[str, float] | Kind | None) -> Kind:
    if not isinstance(stated, Limits):
        return kind.of(profile, stated)
    if not isinstance(stated, kind):
        raise ConfigError(f'limits: expected {kind.__name__}, got {type(stated).__name__}')
    return stated


def _config(options: dict[str, Any]) -> EvaluationConfig:
    config = options.pop('config', None)
    if config is None:
        return EvaluationConfig.from_mapping(options)
    if options or not isinstance(config, EvaluationConfig):
        raise ConfigError('config: give an EvaluationConfig alone, or its options by name')
    return config


def _path(path: str | Path | None) -> Path | None:
    return None if path is None else Path(path)


def _sources(
    estimate: TrajectoryLike | None,
    ground_truth: TrajectoryLike | None,
    recording: Path | None,
    times: Path | None,
) -> tuple[Source, Source]:
    """Return both inputs; what is read from files is read in one pass over each recording."""
    given: list[Any] = [estimate, ground_truth]
    if any(one is None for one in given):
        if recording is None:
            raise ConfigError('give a recording, or both an estimate and a ground truth')
        # a side that is there already only needs not to be None
        specs = [one if one is None or isinstance(one, str) else 'given' for one in given]
        topics = default_topics(recording, *specs)
        given = [topic if one is None else one for one, topic in zip(given, topics, strict=True)]
    named = {k: str(one) for k, one in enumerate(given) if isinstance(one, (str, Path))}
    read = dict(zip(named, read_sources(list(named.values()), recording, times), strict=True))
    names = ('estimate', 'ground_truth')
    one, other = (
        read[k] if k in read else source_of(name, given[k]) for k, name in enumerate(names)
    )
    return one, other
