"""From what a user writes to poses: source specs in, the poses that they name out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
import re
from typing import Any, TYPE_CHECKING

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.orientations import MIN_QUATERNION_NORM, why_positions_only
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError, VioEvalError
from vio_eval_ros.recordings.layouts import poses_of, Reading, stated_stamps
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.spec import is_recording, LENGTH_UNITS, Spec
from vio_eval_ros.recordings.stamps import check_resolution, run_of
from vio_eval_ros.recordings.text import read_text

if TYPE_CHECKING:
    import pandas as pd

    from vio_eval_ros.recordings.recording import Frames, Recording
    from vio_eval_ros.recordings.topic_poses import TopicPoses
    from vio_eval_ros.recordings.ulog import Ulog

PARALLEL_BYTES = 1 << 24
TRUTH_WORDS = r'truth|(^|[/_])gt($|[/_])|vicon|leica|mocap|optitrack|qualisys'


@dataclass(frozen=True, eq=False, repr=False)
class Source:
    """
    Poses as they were recorded, and where they come from.

    :param spec: as the user wrote it.
    :param kind: tum, euroc, kitti, ros1, rosbag2, mcap, ulog or arrays.
    :param paths: the files that hold them, in order.
    :param warnings: what was taken for granted, in sentences.
    :param causal: the same poses as first published, where a Path revised them since.
    :param readings: where the file leaves something open, all ways to read it, ``poses`` first.
    :param order: that of the quaternions in the columns of a file: 'wxyz' for example; else empty.
    """

    spec: str
    kind: str
    paths: tuple[Path, ...]
    poses: Poses
    warnings: tuple[str, ...] = ()
    causal: Poses | None = None
    readings: tuple[Reading, ...] = ()
    order: str = ''

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.poses)

    @property
    def stamps_ns(self) -> np.ndarray:
        """(N,) int64 nanoseconds, in the order in which they were recorded."""
        return self.poses.stamps_ns

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) float64 metres, world frame."""
        return self.poses.positions

    @property
    def rotations(self) -> np.ndarray | None:
        """(N, 4) float64 quaternions x y z w, body to world; None where they are unknown."""
        return self.poses.rotations

    def to_dataframe(self) -> pd.DataFrame:
        """
        Return the poses as a DataFrame with columns x y z qx qy qz qw, indexed by stamp [ns].

        Without orientations the columns are x y z.

        :raises ConfigError: pandas is not installed.
        """
        columns = dict(zip('xyz', self.positions.T, strict=True))
        if self.rotations is not None:
            columns |= zip(('qx', 'qy', 'qz', 'qw'), self.rotations.T, strict=True)
        return indexed_by_stamp(columns, self.stamps_ns)

    def __repr__(self) -> str:
        """Return what it is in a line."""
        seconds = float(np.ptp(self.stamps_ns)) / 1e9 if len(self) else 0.0
        only = '' if self.rotations is not None else ', positions only'
        return f'<Source {self.spec} ({self.kind}): {len(self):,} poses, {seconds:.4g} s{only}>'

    def revising(self, first: Source) -> Source:
        """Return the source as what revises another, which was published first."""
        return replace(self, causal=first.poses, warnings=(*self.warnings, *first.warnings))


def indexed_by_stamp(columns: Mapping[str, np.ndarray], stamps_ns: np.ndarray) -> pd.DataFrame:
    """Return columns as a DataFrame; ``ConfigError`` where pandas is not installed."""
    return indexed(columns, stamps_ns, 'stamp_ns')


def indexed(columns: Mapping[str, Any], index: Any, name: str) -> pd.DataFrame:
    """Return columns as a DataFrame, with an index of that name; ``ConfigError`` likewise."""
    try:
        from pandas import DataFrame, Index
    except ImportError:
        raise ConfigError("a DataFrame needs pandas: pip install 'vio_eval_ros[pandas]'") from None
    return DataFrame(columns, index=Index(index, name=name))


def read_sources(
    specs: Sequence[str],
    recording: Path | None = None,
    times: Path | None = None,
    progress: Progress = silent,
) -> list[Source]:
    """
    Return what each spec names, with one pass over each recording.

    :param recording: where topics without a recording of their own are.
    :param times: a file with one stamp a line, for KITTI pose files.
    """
    parsed = [_located(spec, recording) for spec in specs]
    found: dict[int, Source] = {}
    for path in dict.fromkeys(spec.path for spec in parsed if spec.topic):
        wanted = [k for k, spec in enumerate(parsed) if spec.topic and spec.path == path]
        texts, chosen = [specs[k] for k in wanted], [parsed[k] for k in wanted]
        found |= zip(wanted, _from_recording(path, texts, chosen, progress), strict=True)
    files = [k for k in range(len(specs)) if k not in found]
    jobs = [(specs[k], parsed[k], times) for k in files]
    found |= zip(files, _from_texts(jobs, progress), strict=True)
    return [found[k] for k in range(len(specs))]


def read_each(
    specs: Sequence[str],
    recording: Path | None = None,
    times: Path | None = None,
    progress: Progress = silent,
) -> list[Source | Exception]:
    """
    Return what each spec names, or the error where it cannot be read.

    Parameters are those of :func:`read_sources`; recordings are read in one pass where nothing is
    wrong with any spec.
    """
    with suppress(VioEvalError, OSError):
        return list(read_sources(specs, recording, times, progress))
    found: list[Source | Exception] = []
    for spec in specs:
        try:
            found += read_sources([spec], recording, times, progress)
        except (VioEvalError, OSError) as error:
            found.append(error)
    return found


def check_times(times: Path | None, sources: Iterable[Source]) -> None:
    """Check that a file of stamps belongs to some source, which has no stamps of its own."""
    if times is not None and not any(times in source.paths for source in sources):
        raise ConfigError(
            f'{times}: these times are not used; they are for poses without stamps, such as those '
            'of KITTI, and neither input has such'
        )


def default_topics(
    recording: Path, estimate: str | None = None, ground_truth: str | None = None
) -> tuple[str, str]:
    """
    Return the topics of the estimate and of the ground truth, where only one choice makes sense.

    :param estimate: what is chosen already, or None.
    :param ground_truth: likewise.
    """
    with _opened(recording) as opened:
        topics = [topic for topic in opened.topics if topic.has_pose and topic.count]
        for considered in ([topic for topic in topics if topic.has_usual_pose], topics):
            others = [one.name for one in considered if one.name not in (estimate, ground_truth)]
            truths = [name for name in others if re.search(TRUTH_WORDS, name.lower())]
            estimates = [name for name in others if name not in truths]
            truths = truths if ground_truth is None else [ground_truth]
            estimates = estimates if estimate is None else [estimate]
            if len(estimates) == 1 and len(truths) == 1:
                return estimates[0], truths[0]
        advice = 'choose topics with --estimate and --ground-truth; ' if opened.choices() else ''
        raise ReadError(recording, advice + opened.choice())


def pose_topics(recording: Path) -> list[str]:
    """Return the specs of the topics of a recording whose messages have one pose each."""
    with _opened(recording) as opened:
        usual = [one.name for one in opened.topics if one.has_usual_pose and one.count]
        if not usual:
            raise ReadError(recording, f'no topic has a pose; {opened.choice()}')
        return [f'{recording}:{name}' for name in usual]


def frames_of(source: Source) -> Frames:
    """Return the frames that a source names; none of what is no recording of ROS or Foxglove."""
    from vio_eval_ros.recordings.recording import Frames, Recording

    spec = Spec.parse(source.spec)
    if spec.path is None or spec.topic is None:
        return Frames()
    with _opened(spec.path) as opened:
        return opened.frames(spec.topic) if isinstance(opened, Recording) else Frames()


def _located(text: str, recording: Path | None) -> Spec:
    spec = Spec.parse(text, beside_recording=recording is not None)
    if spec.path is None:
        if recording is None:
            raise ReadError(
                text,
                'there is no such file; for a topic, give the RECORDING first or write '
                'RECORDING:/topic',
            )
        return spec._replace(path=recording)
    if spec.topic is None and is_recording(spec.path):
        raise ReadError(text, f'this is a recording; name a topic in it: {spec.path}:/topic')
    return spec


def _from_recording(
    path: Path | None,
    texts: Sequence[str],
    specs: Sequence[Spec],
    progress: Progress,
) -> list[Source]:
    assert path is not None
    with _opened(path) as opened:
        read = opened.read([_of_recording(spec) for spec in specs], progress)
        return [_of_topic(opened, *each) for each in zip(texts, specs, read, strict=True)]


def _opened(path: Path) -> Recording | Ulog:
    """Return an open recording, or a log of PX4."""
    if path.suffix == '.ulg':
        from vio_eval_ros.recordings.ulog import Ulog

        return Ulog(path)
    from vio_eval_ros.recordings.recording import Recording

    return Recording(path)


def _of_recording(spec: Spec) -> str:
    """Return what of a spec the recording is asked for; the rest is done with the poses."""
    stamps = spec.statements.get('stamps')
    return str(spec.topic) + (f'?stamps={stamps}' if stamps else '')


def _of_topic(recording: Recording | Ulog, text: str, spec: Spec, read: TopicPoses) -> Source:
    poses, causal, warnings, _ = read
    if 'revision' in spec.statements:
        if causal is None:
            raise ConfigError(f'{text}: only a Path has revisions')
        poses, causal = causal if spec.statements['revision'] == 'causal' else poses, None
    return Source(
        spec=text,
        kind=recording.kind,
        paths=recording.paths,
        poses=_as_stated(text, poses, spec),
        warnings=(*warnings, *recording.warnings),
        causal=None if causal is None else _as_stated(text, causal, spec),
    )


def _from_texts(jobs: Sequence[tuple[str, Spec, Path | None]], progress: Progress) -> list[Source]:
    """Return what text files hold; two that are large are read at the same time."""
    if len(jobs) == 2 and all(_size(spec.path) > PARALLEL_BYTES for _, spec, _ in jobs):
        from concurrent.futures import ProcessPoolExecutor
        from concurrent.futures.process import BrokenProcessPool
        from multiprocessing import get_context

        try:
            with ProcessPoolExecutor(1, get_context('fork')) as pool:
                other = pool.submit(_from_text, *jobs[1])
                return [_from_text(*jobs[0], progress), other.result()]
        except (BrokenProcessPool, NotImplementedError, ValueError, OSError):
            pass  # not on this machine: one after another
    return [_from_text(*job, progress) for job in jobs]


def _size(path: Path | None) -> int:
    return path.stat().st_size if path is not None and path.is_file() else 0


def _from_text(text: str, spec: Spec, times: Path | None, progress: Progress = silent) -> Source:
    path, notes = _file(spec.path or Path())
    file = read_text(path, progress, stated_stamps(spec.statements))
    kind, readings = poses_of(file, times, spec.statements, notes)
    check_resolution(text, readings[0].poses)
    stated = tuple(one._replace(poses=_as_stated(text, one.poses, spec)) for one in readings)
    return Source(
        spec=text,
        kind=kind,
        paths=(path, times) if kind == 'kitti' and times else (path,),
        poses=stated[0].poses,
        warnings=(*file.notes, *notes),
        readings=stated if len(stated) > 1 else (),
        order=stated[0].order,
    )


def _file(path: Path) -> tuple[Path, list[str]]:
    """Return the file that a path means: of a EuRoC (or TUM-VI) folder, its ground truth."""
    if not path.is_dir():
        return path, []
    for sensor in ('state_groundtruth_estimate0', 'mocap0', 'vicon0', 'leica0'):
        for file in (path / 'mav0' / sensor / 'data.csv', path / sensor / 'data.csv'):
            if file.is_file():
                raw = sensor in ('vicon0', 'leica0')
                return file, [f'{file}: poses of a marker, not of the IMU'] if raw else []
    if (path / 'data.csv').is_file():
        return path / 'data.csv', []
    raise ReadError(
        path,
        'neither a rosbag2 folder (it has no metadata.yaml) nor a EuRoC sequence '
        '(it has no mav0/state_groundtruth_estimate0/data.csv)',
    )


def _as_stated(text: str, poses: Poses, spec: Spec) -> Poses:
    """Return the poses of one run, in metres, and those stated to be inverse inverted."""
    poses = run_of(text, poses, spec.statements.get('run'))
    if 'unit' in spec.statements:
        poses = _scaled(poses, LENGTH_UNITS[spec.statements['unit']])
    invert = spec.statements.get('invert')
    if invert is None:
        return poses
    if poses.rotations is None or why_positions_only(poses):
        raise ConfigError(
            f'{spec.topic or spec.path}: cannot invert positions without orientations'
        )
    inverse = rotation.conjugate(poses.rotations)
    if invert == 'rotation':
        return replace(poses, rotations=inverse, covariances=None)
    norms = np.linalg.norm(inverse, axis=1, keepdims=True)
    unit = inverse / np.where(norms < MIN_QUATERNION_NORM, 1.0, norms)
    return replace(
        poses,
        positions=-rotation.rotate(unit, poses.positions),
        rotations=inverse,
        covariances=None,
    )


def _scaled(poses: Poses, metres: float) -> Poses:
    """Return poses whose positions have another unit in metres."""
    covariances = poses.covariances
    if covariances is not None:
        covariances = covariances * np.array([metres**2, 1.0])[:, None, None]
    return replace(poses, positions=poses.positions * metres, covariances=covariances)
