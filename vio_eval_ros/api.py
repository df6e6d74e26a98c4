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
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING, Union

import numpy as np
from numpy.typing import ArrayLike

from vio_eval_ros.core.cleaning import MIN_QUATERNION_NORM
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import check_names, Gate
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, InputError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.evaluation.result import Result as RunResult
from vio_eval_ros.recordings.sources import default_topics, read_sources, Source
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.tables import pair_errors
from vio_eval_ros.reports.text import headline, rows

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

POSITION, ROTATION = ['x', 'y', 'z'], ['qx', 'qy', 'qz', 'qw']
#: sensors are slower; stamps this close together are seconds or frame numbers, not nanoseconds
SHORTEST_PERIOD_NS = 1000
PLOTS = ('path', 'path_3d', 'errors')

Columns = tuple[ArrayLike, ArrayLike, ArrayLike | None]
TrajectoryLike = Union[str, Path, Source, Poses, Columns, 'pd.DataFrame']


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


def trajectory(
    stamps: ArrayLike, positions: ArrayLike, rotations: ArrayLike | None = None
) -> Source:
    """
    Return a trajectory made of columns.

    :param stamps: (N,) integers, nanoseconds, increasing. Of equal stamps the first is used.
    :param positions: (N, 3) metres in the world frame.
    :param rotations: (N, 4) quaternions x y z w, body to world; None where they are unknown.
    :raises InputError: a shape, type or value is wrong; the message gives what was expected and
        what was given.
    """
    stamps_ns = _stamps(np.asarray(stamps))
    return _of_columns('arrays', stamps_ns, positions, rotations)


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
    return Result(**{item.name: getattr(found, item.name) for item in fields(found)})


class Result(RunResult):
    """
    What an evaluation found; made by :func:`evaluate`.

    ``metrics`` and ``warnings`` are those of ``vio_eval_ros.result/1``; a number that does not
    exist is NaN.
    """

    @property
    def metrics(self) -> Mapping[str, float]:
        """Every metric by its name, NaN where there is no data."""
        return self.summary.metrics

    @property
    def warnings(self) -> Sequence[str]:
        """What one should know before trusting a number, in sentences."""
        return self.summary.warnings

    def errors(self) -> pd.DataFrame:
        """
        Return the errors of each pair, indexed by the stamp of the estimate [ns].

        Columns: ``ground_truth_stamp_ns``, ``ate_trans_m``, ``ate_rot_deg`` (NaN without
        orientations) and ``error_x_m``, ``error_y_m``, ``error_z_m``, in the world of the ground
        truth.
        """
        table = pair_errors(self)
        index = _pandas().Index(table.pop('estimate_stamp_ns'), name='stamp_ns')
        return _pandas().DataFrame(table, index=index)

    def plot(self, what: str = 'path') -> go.Figure:
        """
        Return a plotly figure.

        :param what: ``path`` (from above, coloured by position error), ``path_3d``, or ``errors``
            (over time).
        :raises ConfigError: plotly is not installed, or there is nothing to draw.
        """
        if what not in PLOTS:
            raise ConfigError(f"plot: '{what}' is not one of {', '.join(PLOTS)}")
        if math.isnan(self.metrics['ate_trans_rmse_m']):
            raise ConfigError('there is nothing to draw: the alignment is not determined')
        try:
            from plotly.graph_objects import Figure
        except ImportError:
            raise ConfigError("a plot needs plotly: pip install 'vio_eval_ros[report]'") from None
        from vio_eval_ros.reports import plots

        course = plots.Course.of(self)
        if what == 'errors':
            rmse_m, rmse_deg = self.metrics['ate_trans_rmse_m'], self.metrics['ate_rot_rmse_deg']
            figure = plots.errors_over_time(course, rmse_m, rmse_deg)
            title = 'error of each pair; dashed: RMSE'
        else:
            figure = (plots.path_3d if what == 'path_3d' else plots.path_from_above)(course)
            title = f'position error 0 (blue) to {course.hottest:.3g} m (red); grey: ground truth'
        return Figure(figure).update_layout(title=title, margin_t=50)

    def to_json(self) -> str:
        """Return the result in schema ``vio_eval_ros.result/1``."""
        return str(REPORTS['json'](self))

    def __repr__(self) -> str:
        """Return the result in a line."""
        alignment = self.summary.alignment.mode
        return f'<Result {self.estimate.source}: {headline(self)}, {alignment}>'

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the result in a line, and the statistics as a table."""
        from vio_eval_ros.core.statistics import STATISTICS
        from vio_eval_ros.rendering.page import html, joined, table, tag, warnings
        from vio_eval_ros.rendering.text import number

        figures = ([label, *map(number, values)] for label, values in rows(self))
        head = f'{self.estimate.source} against {self.ground_truth.source}: {headline(self)}'
        return joined(
            [
                tag('p', html(head)),
                table(['error', *STATISTICS], figures, range(1, 1 + len(STATISTICS))),
                warnings(self.warnings),
            ]
        )


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
        read[k] if k in read else _source(name, given[k]) for k, name in enumerate(names)
    )
    return one, other


def _source(name: str, value: Any) -> Source:
    """Return what a value that is not a spec holds; errors begin with its name."""
    if isinstance(value, Source):
        return value
    try:
        if isinstance(value, Poses):
            stamps_ns = _stamps(np.asarray(value.stamps_ns))
            return _of_columns(
                'arrays', stamps_ns, value.positions, value.rotations, value.covariances
            )
        if hasattr(value, 'columns') and hasattr(value, 'index'):
            return _of_frame(value)
        if isinstance(value, tuple) and len(value) in (2, 3):
            return trajectory(*value)
    except InputError as error:
        raise InputError(f'{name}: {error}') from None
    raise InputError(
        f'{name}: expected a source spec, a path, (stamps, positions, rotations), a DataFrame or '
        f'what vio.read or vio.trajectory returns, got {_shown(value)}'
    )


def _of_frame(frame: Any) -> Source:
    """Return what a DataFrame holds, with columns as evo's ``pandas_bridge`` names them."""
    missing = [name for name in POSITION if name not in frame.columns]
    oriented = [name for name in ROTATION if name in frame.columns]
    if missing or len(oriented) not in (0, 4):
        expected = ' '.join(POSITION + ROTATION)
        got = ' '.join(map(str, frame.columns))
        raise InputError(f'expected a DataFrame with columns {expected} (or x y z), got {got}')
    rotations = frame[ROTATION].to_numpy() if oriented else None
    return _of_columns('DataFrame', _index(frame.index), frame[POSITION].to_numpy(), rotations)


def _index(index: Any) -> np.ndarray:
    """Return the stamps [ns] that an index has: dates, float seconds or integer nanoseconds."""
    values = index.to_numpy()
    if values.dtype.kind == 'M':
        return _stamps(values.astype('datetime64[ns]').astype(np.int64))
    if values.dtype.kind != 'f':
        return _stamps(values, 'index')
    if not np.isfinite(values).all():
        raise InputError('index: expected finite seconds, got NaN or infinity')
    if np.abs(values).max(initial=0.0) > 1e11:
        raise InputError(
            f'index: expected seconds as floats, got {values.flat[0]:.10g}; give nanoseconds as '
            'integers: df.index = df.index.astype("int64")'
        )
    return _stamps(np.round(values * 1e9).astype(np.int64), 'index')


def _stamps(stamps: np.ndarray, name: str = 'stamps') -> np.ndarray:
    """
    Return (N,) int64 stamps [ns].

    :raises InputError: they are not integers, none, out of order, or no nanoseconds.
    """
    if stamps.ndim != 1 or not len(stamps):
        raise InputError(f'{name}: expected shape (N,) with N >= 1, got {stamps.shape}')
    if stamps.dtype.kind == 'f':
        raise InputError(
            f'{name}: expected integers, nanoseconds, got {stamps.dtype}; from seconds: '
            f'numpy.round({name} * 1e9).astype(numpy.int64)'
        )
    if stamps.dtype.kind not in 'iu':
        raise InputError(f'{name}: expected integers, nanoseconds, got {stamps.dtype}')
    stamps = stamps.astype(np.int64)
    steps = np.diff(stamps)
    if (steps < 0).any():
        k = int((steps < 0).argmax()) + 1
        raise InputError(
            f'{name}: expected in increasing order, got {stamps[k]} after {stamps[k - 1]} in row '
            f'{k}; sort all columns by stamp first: numpy.argsort({name}, kind="stable")'
        )
    if len(steps) and np.median(steps) < SHORTEST_PERIOD_NS:
        raise InputError(
            f'{name}: expected nanoseconds, got {stamps[0]} to {stamps[-1]}, '
            f'{float(np.median(steps)):g} apart: seconds or row numbers?'
        )
    return stamps


def _of_columns(
    spec: str,
    stamps_ns: np.ndarray,
    positions: ArrayLike,
    rotations: ArrayLike | None,
    covariances: np.ndarray | None = None,
) -> Source:
    count = len(stamps_ns)
    positions = _numbers('positions', positions, (count, 3))
    if rotations is not None:
        rotations = _numbers('rotations', rotations, (count, 4))
        short = np.linalg.norm(rotations, axis=1) < MIN_QUATERNION_NORM
        if short.any():
            raise InputError(
                f'rotations: expected unit quaternions x y z w, got zero in row {short.argmax()}; '
                'leave rotations out where they are unknown'
            )
    return Source(
        spec=spec,
        kind='arrays',
        paths=(),
        poses=Poses(stamps_ns, positions, rotations, covariances),
    )


def _numbers(name: str, values: ArrayLike, shape: tuple[int, int]) -> np.ndarray:
    """Return (N, D) float64; the error names the shape or type expected and the one given."""
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        raise InputError(
            f'{name}: expected shape {shape}, got rows of different lengths'
        ) from None
    if array.shape != shape:
        raise InputError(f'{name}: expected shape {shape}, got {array.shape}')
    if array.dtype.kind not in 'fiu':
        raise InputError(f'{name}: expected float64, got {array.dtype}')
    array = array.astype(np.float64)
    wrong = ~np.isfinite(array).all(axis=1)
    if wrong.any():
        raise InputError(
            f'{name}: expected finite numbers, got NaN or infinity in {np.count_nonzero(wrong)} '
            f'of {len(wrong)} rows, first in row {wrong.argmax()}; drop these rows from all '
            'columns'
        )
    return array


def _shown(value: Any) -> str:
    shape = getattr(value, 'shape', None)
    name = type(value).__name__
    return name if shape is None else f'{name} of shape {tuple(shape)}'


def _pandas() -> Any:
    try:
        import pandas
    except ImportError:
        raise ConfigError("a DataFrame needs pandas: pip install 'vio_eval_ros[pandas]'") from None
    return pandas
