"""
The package as a library: what ``import vio_eval_ros as vio`` gives.

A trajectory is taken in any form: a source spec or path as on the command line, what :func:`read`
or :func:`trajectory` returned, columns ``(stamps, positions, rotations)``, or a pandas DataFrame
with columns ``x y z qx qy qz qw``. Shapes, types and stamps are checked before anything is
computed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any

from vio_eval_ros.comparison.comparison import compared, scorer
from vio_eval_ros.comparison.matrix import check_metrics, default_metrics
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import check_names, Gate
from vio_eval_ros.core.limits import Kind, Limits, PROFILES
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.recorded import diagnose_sources, read_gyroscope
from vio_eval_ros.errors import ConfigError, InputError, ReadError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.imu.recorded import imu_noise as noise_of
from vio_eval_ros.inspection.expectations import Expectations
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.recording import inspect_recording
from vio_eval_ros.recordings.arrays import source_of, TrajectoryLike
from vio_eval_ros.recordings.progress import silent
from vio_eval_ros.recordings.sources import (
    check_times,
    default_topics,
    read_each,
    read_sources,
    Source,
)
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.results import Comparison, Diagnosis, ImuNoise, Inspection, Result


@contextmanager
def _files() -> Iterator[None]:
    """Turn what the system says of a path, such as that it may not be read, into ReadError."""
    try:
        yield
    except OSError as error:
        raise ReadError(error.filename or 'a file', error.strerror or str(error)) from None


@_files()
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
    path, stamps = _path('recording', recording), _path('times', times)
    return read_sources([_spec('spec', spec)], path, stamps)[0]


@_files()
def evaluate(
    estimate: TrajectoryLike | None = None,
    ground_truth: TrajectoryLike | None = None,
    *,
    recording: str | Path | None = None,
    times: str | Path | None = None,
    gates: str | Gate | Iterable[str | Gate] = (),
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
    judged = _gates(gates)
    if judged:
        check_names(judged, metric_names(config))
    path, stamps = _path('recording', recording), _path('times', times)
    one, other = _sources(estimate, ground_truth, path, stamps)
    found = score_run(one, other, config, judged)
    return Result(**_values(found))


@_files()
def compare(
    estimates: Mapping[str, TrajectoryLike],
    ground_truth: TrajectoryLike | None = None,
    *,
    metrics: str | Iterable[str] = (),
    recording: str | Path | None = None,
    times: str | Path | None = None,
    gates: str | Gate | Iterable[str | Gate] = (),
    **options: Any,
) -> Comparison:
    """
    Return how accurate several estimates of one ground truth are, beside each other.

    Inputs, gates and options are those of :func:`evaluate`. A system whose file cannot be read,
    or that has no pairs, does not stop the others: ``.unscored`` has the reason.

    :param estimates: by the names of their systems.
    :param metrics: which are compared; by default ATE and RPE.
    :raises VioEvalError: what else :func:`evaluate` raises; or no system can be scored.
    """
    config, judged = _config(options), _gates(gates)
    known = metric_names(config)
    chosen = _listed('metrics', metrics)
    check_metrics(chosen, known)
    check_names(judged, known)
    if not isinstance(estimates, Mapping) or not estimates:
        raise ConfigError("estimates: give a mapping such as {'VINS-Mono': 'vins.txt'}")
    path, stamps = _path('recording', recording), _path('times', times)
    named = {str(name): estimate for name, estimate in estimates.items()}
    *given, truth = _each_source(named, ground_truth, path, stamps)
    if isinstance(truth, Exception):
        raise truth
    found = compared(
        dict(zip(named, given, strict=True)),
        scorer(truth, config, judged),
        chosen or default_metrics(config),
    )
    return Comparison(**_values(found))


@_files()
def diagnose(
    estimate: TrajectoryLike | None = None,
    ground_truth: TrajectoryLike | None = None,
    *,
    recording: str | Path | None = None,
    times: str | Path | None = None,
    imu: str | Path | None = None,
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
    path, stamps = _path('recording', recording), _path('times', times)
    gyroscope = None if imu is None else _spec('imu', imu)
    one, other = _sources(estimate, ground_truth, path, stamps)
    found = diagnose_sources(
        one,
        other,
        _config(options),
        profile=profile,
        limits=_limits(DiagnosisLimits, profile, limits),
        gyroscope=None if gyroscope is None else read_gyroscope(gyroscope, path, silent),
    )
    return Diagnosis(**_values(found))


@_files()
def inspect(
    recording: str | Path,
    calibrations: str | Path | Iterable[str | Path] = (),
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
    expected = _path('expectations', expectations)
    found = inspect_recording(
        _required('recording', recording),
        [_required('calibrations', path) for path in _listed('calibrations', calibrations)],
        None if expected is None else Expectations.load(expected),
        profile=profile,
        limits=_limits(InspectionLimits, profile, limits),
    )
    return Inspection(**_values(found))


@_files()
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
        _required('recording', recording),
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


def _gates(given: Any) -> list[Gate]:
    """Return the gates that texts, or gates, state; one alone needs no list."""
    gates = [given] if isinstance(given, Gate) else _listed('gates', given)
    for gate in gates:
        if not isinstance(gate, (str, Gate)):
            raise ConfigError(
                f"gates: expected texts such as 'ate_trans_rmse_m<=0.1', got {type(gate).__name__}"
            )
    return [gate.checked() if isinstance(gate, Gate) else Gate.parse(gate) for gate in gates]


def _listed(name: str, given: Any) -> list[Any]:
    """Return the items of a list; a text or path is one item."""
    if isinstance(given, (str, PathLike)):
        return [given]
    if isinstance(given, Mapping) or not isinstance(given, Iterable):
        raise ConfigError(f'{name}: expected a list, got {type(given).__name__}')
    return list(given)


def _required(name: str, path: Any) -> Path:
    """Return a path; ``InputError`` for what cannot be one."""
    if not isinstance(path, (str, PathLike)):
        raise InputError(f'{name}: expected a path, got {type(path).__name__}')
    if not str(path):
        raise InputError(f"{name}: expected a path, got ''")
    return Path(path)


def _spec(name: str, spec: Any) -> str:
    """Return the text of a source spec, as it was written."""
    if not isinstance(spec, (str, PathLike)):
        raise InputError(f'{name}: expected a source spec or a path, got {type(spec).__name__}')
    return str(spec)


def _path(name: str, path: Any) -> Path | None:
    return None if path is None else _required(name, path)


def _sources(
    estimate: TrajectoryLike | None,
    ground_truth: TrajectoryLike | None,
    recording: Path | None,
    times: Path | None,
) -> tuple[Source, Source]:
    """Return both inputs; what is read from files is read in one pass over each recording."""
    given = _with_default_topics([estimate, ground_truth], recording)
    specs = {k: str(one) for k, one in enumerate(given) if isinstance(one, (str, PathLike))}
    _check_recording(list(specs.values()), recording)
    read = dict(zip(specs, read_sources(list(specs.values()), recording, times), strict=True))
    check_times(times, read.values())
    one, other = (
        read[k] if k in read else source_of(name, given[k])
        for k, name in enumerate(('estimate', 'ground_truth'))
    )
    return one, other


def _each_source(
    estimates: Mapping[str, TrajectoryLike],
    ground_truth: TrajectoryLike | None,
    recording: Path | None,
    times: Path | None,
) -> list[Source | Exception]:
    """Return all estimates and the ground truth, or why a file of theirs cannot be read."""
    names, given = [*estimates, 'ground_truth'], [*estimates.values(), ground_truth]
    if ground_truth is None:
        given[-1] = _with_default_topics([given[0], None], recording)[1]
    specs = {k: str(one) for k, one in enumerate(given) if isinstance(one, (str, PathLike))}
    if recording is not None:
        _check_recording(list(specs.values()), recording)
    found = read_each(list(specs.values()), recording, times)
    check_times(times, [one for one in found if isinstance(one, Source)])
    read = dict(zip(specs, found, strict=True))
    return [read[k] if k in read else source_of(name, given[k]) for k, name in enumerate(names)]


def _with_default_topics(given: list[Any], recording: Path | None) -> list[Any]:
    """Return both inputs, a missing one being the only sensible topic of the recording."""
    if all(one is not None for one in given):
        return given
    if recording is None:
        raise ConfigError('give a recording, or both an estimate and a ground truth')
    # of a side that is no topic only that it is there matters
    topics = [one if one is None or isinstance(one, str) else 'given' for one in given]
    defaults = default_topics(recording, *topics)
    return [default if one is None else one for one, default in zip(given, defaults, strict=True)]


def _check_recording(specs: Sequence[str], recording: Path | None) -> None:
    """Check that topics come with a recording, and a recording with topics."""
    beside = recording is not None
    topics = [spec for spec in specs if Spec.parse(spec, beside_recording=beside).path is None]
    if recording is None and topics:
        raise ReadError(topics[0], 'no such file; for a topic, give recording= as well')
    if recording is not None and not topics:
        raise ConfigError(f'recording: {recording} is not used, neither input is a topic of it')
