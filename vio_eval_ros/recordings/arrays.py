"""
Trajectories in memory: arrays, lists and DataFrames, checked before anything is computed.

Every error names the column, what was expected and what was given.
"""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING, Union

import numpy as np
from numpy.typing import ArrayLike

from vio_eval_ros.core.orientations import LARGEST_NUMBER, MIN_QUATERNION_NORM
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import InputError
from vio_eval_ros.recordings.rows import LATEST_NS
from vio_eval_ros.recordings.sources import Source

if TYPE_CHECKING:
    import pandas as pd

POSITION, ROTATION = ['x', 'y', 'z'], ['qx', 'qy', 'qz', 'qw']
#: estimators are slower than 5 kHz; stamps closer together are of another unit, or frame numbers
SHORTEST_PERIOD_NS = 200_000
#: of a run; shorter ones may have stamps of another unit
SHORTEST_RUN_S = 1.0
INDEX_FORMS = 'dates, float seconds or integer nanoseconds'

Columns = tuple[ArrayLike, ArrayLike, ArrayLike | None]
TrajectoryLike = Union[str, Path, Source, Poses, Columns, 'pd.DataFrame']


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
    stamps_ns = _stamps(_array('stamps', stamps, '(N,)'))
    return _of_columns('arrays', stamps_ns, positions, rotations)


def source_of(name: str, value: Any) -> Source:
    """Return what a value that is not a spec holds; errors begin with its name."""
    try:
        if isinstance(value, Source):
            return _checked(value)
        if isinstance(value, Poses):
            stamps_ns = _stamps(np.asarray(value.stamps_ns))
            checked = _of_columns('arrays', stamps_ns, value.positions, value.rotations)
            covariances, expected = value.covariances, (len(stamps_ns), 2, 3, 3)
            if covariances is not None and covariances.shape != expected:
                raise InputError(
                    f'covariances: expected shape {expected}, got {covariances.shape}'
                )
            poses = replace(
                checked.poses, covariances=covariances, zero_is_unset=value.zero_is_unset
            )
            return replace(checked, poses=poses)
        if hasattr(value, 'columns') and hasattr(value, 'index'):
            return _of_frame(value)
        if isinstance(value, tuple) and len(value) in (2, 3):
            return trajectory(*value)
    except InputError as error:
        raise InputError(f'{name}: {error}') from None
    raise InputError(
        f'{name}: expected a source spec, a path, a tuple (stamps, positions, rotations), a '
        f'DataFrame or what vio.read or vio.trajectory returns, got {_shown(value)}'
    )


def _checked(source: Source) -> Source:
    """Return a source whose columns have the right shapes; what is in them is judged later."""
    poses = source.poses
    if not isinstance(poses, Poses):
        raise InputError(f'poses: expected Poses, got {_shown(poses)}')
    count = len(poses.stamps_ns)
    for name, expected in (('positions', (count, 3)), ('rotations', (count, 4))):
        column = getattr(poses, name)
        if (column is not None or name == 'positions') and np.shape(column) != expected:
            raise InputError(f'{name}: expected shape {expected}, got {np.shape(column)}')
    return source


def _of_frame(frame: Any) -> Source:
    """Return what a DataFrame holds, with columns as evo's ``pandas_bridge`` names them."""
    if not frame.columns.is_unique:
        twice = frame.columns[frame.columns.duplicated()][0]
        raise InputError(f"expected a DataFrame with unique columns, got '{twice}' twice")
    missing = [name for name in POSITION if name not in frame.columns]
    oriented = [name for name in ROTATION if name in frame.columns]
    if missing or len(oriented) not in (0, 4):
        expected = ' '.join(POSITION + ROTATION)
        got = ' '.join(map(str, frame.columns))
        raise InputError(f'expected a DataFrame with columns {expected} (or x y z), got {got}')
    rotations = _columns(frame, ROTATION) if oriented else None
    return _of_columns('DataFrame', _index(frame.index), _columns(frame, POSITION), rotations)


def _columns(frame: Any, names: list[str]) -> np.ndarray:
    """Return columns as one array; those of pandas' own types, such as Float64, as numbers."""
    columns = [frame[name].to_numpy() for name in names]
    if all(column.dtype.kind in 'fiu' for column in columns):
        return np.column_stack(columns)
    return np.asarray(frame[names].to_numpy())


def _index(index: Any) -> np.ndarray:
    """Return the stamps [ns] that an index has: dates, float seconds or integer nanoseconds."""
    if getattr(index, 'tz', None) is not None:
        index = index.tz_convert(None)  # the same instants in UTC
    values = index.to_numpy()
    if values.dtype.kind == 'M':
        if np.isnat(values).any():
            raise InputError(f'index: expected dates, got NaT in row {np.isnat(values).argmax()}')
        return _stamps(values.astype('datetime64[ns]').astype(np.int64), 'index')
    if values.dtype.kind != 'f':
        return _stamps(values, 'index')
    if not np.isfinite(values).all():
        raise InputError('index: expected finite seconds, got NaN or infinity')
    if np.abs(values).max(initial=0.0) > 1e11:
        raise InputError(
            f'index: expected seconds as floats, got {values.flat[0]:.10g}; give nanoseconds as '
            'integers: df.index = df.index.astype("int64")'
        )
    if len(values) > 1 and np.array_equal(values, np.arange(len(values))):
        raise InputError(f'index: expected {INDEX_FORMS}, got row numbers 0 to {len(values) - 1}')
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
        forms = 'integers, nanoseconds' if name == 'stamps' else INDEX_FORMS
        raise InputError(f'{name}: expected {forms}, got {stamps.dtype}')
    farthest = max(int(stamps.max()), -int(stamps.min()))
    if farthest > LATEST_NS:
        raise InputError(f'{name}: expected nanoseconds, got {farthest}: more than 146 years')
    stamps = stamps.astype(np.int64)
    steps = np.diff(stamps)
    if (steps < 0).any():
        k = int((steps < 0).argmax()) + 1
        raise InputError(
            f'{name}: expected in increasing order, got {stamps[k]} after {stamps[k - 1]} in row '
            f'{k}; sort all columns by stamp first: numpy.argsort({name}, kind="stable")'
        )
    if len(steps) and not steps.any():
        raise InputError(f'{name}: expected increasing, got {stamps[0]} in all {len(stamps)} rows')
    period = float(np.median(steps[steps > 0])) if len(steps) else math.inf
    if period < SHORTEST_PERIOD_NS:
        raise InputError(
            f'{name}: expected nanoseconds, got {stamps[0]} to {stamps[-1]}, {period:g} apart: '
            'another unit or row numbers?'
        )
    return stamps


def _of_columns(
    spec: str, stamps_ns: np.ndarray, positions: ArrayLike, rotations: ArrayLike | None
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
    seconds = float(np.ptp(stamps_ns)) / 1e9
    doubtful = count > 1 and seconds < SHORTEST_RUN_S
    return Source(
        spec=spec,
        kind='arrays',
        paths=(),
        poses=Poses(stamps_ns, positions, rotations),
        warnings=(f'{spec}: all stamps within {seconds:.3g} s; are they nanoseconds?',) * doubtful,
    )


def _numbers(name: str, values: ArrayLike, shape: tuple[int, int]) -> np.ndarray:
    """Return (N, D) float64; the error names the shape or type expected and the one given."""
    array = _array(name, values, str(shape))
    if array.shape != shape:
        raise InputError(f'{name}: expected shape {shape}, got {array.shape}')
    if array.dtype.kind not in 'fiu':
        raise InputError(f'{name}: expected float64, got {array.dtype}')
    # another layout in memory would sum in another order, and change last bits
    array = np.array(array, np.float64, order='C')
    wrong = ~np.isfinite(array).all(axis=1)
    if wrong.any():
        raise InputError(
            f'{name}: expected finite numbers, got NaN or infinity in {np.count_nonzero(wrong)} '
            f'of {len(wrong)} rows, first in row {wrong.argmax()}; drop these rows from all '
            'columns'
        )
    largest = np.abs(array).max(initial=0.0)
    if largest >= LARGEST_NUMBER:
        raise InputError(f'{name}: expected numbers below {LARGEST_NUMBER:g}, got {largest:g}')
    return array


def _array(name: str, values: ArrayLike, shape: str) -> np.ndarray:
    """Return an array of any type, of which nothing is masked."""
    masked = np.ma.count_masked(values) if isinstance(values, np.ma.MaskedArray) else 0
    if masked:
        raise InputError(
            f'{name}: expected no masked values, got {masked}; drop these rows from all columns'
        )
    try:
        return np.asarray(values)
    except ValueError:
        raise InputError(
            f'{name}: expected shape {shape}, got rows of different lengths'
        ) from None


def _shown(value: Any) -> str:
    shape = getattr(value, 'shape', None)
    name = type(value).__name__
    return name if shape is None else f'{name} of shape {tuple(shape)}'
