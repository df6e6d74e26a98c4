"""
What a run has been given so far, on the disk: an evaluator that was killed goes on with it.

Poses are kept and not figures: these follow from them bit for bit, and a damaged file cannot pass
for a result. Each block holds what has come since the one before, so that the cost of the next one
does not grow with the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
import io
import json
from pathlib import Path
import time
from typing import Any, NamedTuple
import zipfile

import numpy as np

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import WriteError
from vio_eval_ros.rendering.files import make_writable, write

SCHEMA = 'checkpoint/1'
FOLDER, SET_ASIDE = 'checkpoint', 'checkpoint_set_aside'
#: an older one is of another session: what comes now is not the rest of its run
MOST_AGE_S = 600.0
#: shape of a row of each column, and its type
ROWS = {
    'stamps_ns': ((), np.int64),
    'positions': ((3,), np.float64),
    'rotations': ((4,), np.float64),
    'covariances': ((2, 3, 3), np.float64),
}


class Unusable(Exception):
    """A checkpoint that must not be believed; says why."""


class Stream(NamedTuple):
    """What a stream had sent, and as which message type."""

    msgtype: str
    poses: Poses


class Resumed(NamedTuple):
    """
    What was saved of a run.

    :param run: its number.
    :param gates_failed: whether a gate of an earlier run had failed.
    :param streams: by their names.
    """

    run: int
    gates_failed: bool
    streams: dict[str, Stream]


class Checkpoint:
    """
    Saves what arrives, block by block.

    :param folder: of the blocks; made where there is none.
    :param identity: what must be the same for a run to go on: options and streams.
    :raises WriteError: the folder cannot be written.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        self.folder = folder
        self._identity = json.loads(json.dumps(identity))
        self._waiting: dict[str, list[Poses]] = {}
        self._blocks = 0
        make_writable(folder)
        for path in folder.glob('.*.npz.*'):  # left behind by who was killed while writing
            path.unlink(missing_ok=True)

    def resume(self) -> Resumed | None:
        """
        Return what an evaluator before this one saved; None where it left nothing.

        :raises Unusable: what it left is damaged, too old, or of other options. It was renamed.
        """
        paths = sorted(self.folder.glob('*.npz'))
        if not paths:
            return None
        try:
            return self._read(paths)
        except Unusable as error:
            aside = self._set_aside()
            raise Unusable(f'{self.folder}: {error}; it is set aside as {aside.name}') from None

    def add(self, stream: str, poses: Poses) -> None:
        """Remember poses for the next block."""
        if len(poses):
            self._waiting.setdefault(stream, []).append(poses)

    def save(self, run: int, gates_failed: bool, msgtypes: Mapping[str, str]) -> None:
        """
        Write a block of what has come since the last one, where anything has.

        :raises WriteError: it cannot be written; what it would have held is in the next one.
        """
        if not self._waiting:
            return
        names = list(self._waiting)
        about = {
            'schema': SCHEMA,
            'block': self._blocks + 1,
            'identity': self._identity,
            'run': run,
            'gates_failed': gates_failed,
            'streams': [],
        }
        columns: dict[str, Any] = {}
        for k, name in enumerate(names):
            poses = Poses.concatenate(self._waiting[name])
            about['streams'].append(
                {
                    'name': name,
                    'msgtype': msgtypes.get(name, ''),
                    'zero_is_unset': poses.zero_is_unset,
                    'origin': poses.origin,
                }
            )
            columns |= {
                f'{k}.{column}': getattr(poses, column)
                for column in ROWS
                if getattr(poses, column) is not None
            }
        content = io.BytesIO()
        np.savez(content, about=np.array(json.dumps(about)), **columns)
        write(self.folder / f'{self._blocks + 1:06d}.npz', content.getvalue())
        self._blocks += 1
        self._waiting = {}

    def clear(self) -> None:
        """Forget the run: it has ended, and its report is written."""
        self._waiting, self._blocks = {}, 0
        for path in sorted(self.folder.glob('*.npz'), reverse=True):  # never a hole in the middle
            path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Forget the run, and remove the folder."""
        self.clear()
        with suppress(OSError):
            self.folder.rmdir()

    def _read(self, paths: list[Path]) -> Resumed:
        age_s = time.time() - paths[-1].stat().st_mtime
        if age_s > MOST_AGE_S:
            raise Unusable(f'it is {age_s:.0f} s old, too old to go on with')
        blocks = [_block(path, k) for k, path in enumerate(paths, 1)]
        about = blocks[-1][0]
        if any(one['identity'] != self._identity for one, _ in blocks):
            raise Unusable('it was written with other options, or for other streams')
        if len({one['run'] for one, _ in blocks}) > 1:
            raise Unusable('it is damaged: its blocks are of several runs')
        parts: dict[str, list[Poses]] = {}
        msgtypes: dict[str, str] = {}
        for one, streams in blocks:
            for stream, poses in zip(one['streams'], streams, strict=True):
                parts.setdefault(stream['name'], []).append(poses)
                msgtypes[stream['name']] = stream['msgtype']
        self._blocks = len(blocks)
        resumed = {name: Stream(msgtypes[name], Poses.concatenate(parts[name])) for name in parts}
        return Resumed(about['run'], about['gates_failed'], resumed)

    def _set_aside(self) -> Path:
        """Rename the folder, and make another one."""
        k = 1
        while (aside := self.folder.with_name(f'{SET_ASIDE}_{k}')).exists():
            k += 1
        try:
            self.folder.rename(aside)
        except OSError as error:
            raise WriteError(aside, error.strerror or str(error)) from None
        make_writable(self.folder)
        return aside


def _block(path: Path, number: int) -> tuple[dict[str, Any], list[Poses]]:
    """Return what a block tells of itself, and the poses of its streams."""
    try:
        # opened here: NumPy would not close a file that it cannot read
        with path.open('rb') as file, np.load(file, allow_pickle=False) as found:
            columns = {name: found[name] for name in found.files}
        about = json.loads(str(columns['about'][()]))
        if about['schema'] != SCHEMA:
            raise Unusable(f'{path.name} is of another version ({about["schema"]:.40})')
        if about['block'] != number:
            raise Unusable(f'it is damaged: block {number} is missing')
        streams = [_poses(columns, k, one) for k, one in enumerate(about['streams'])]
        return {**about, 'run': int(about['run'])}, streams
    except (KeyError, TypeError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        what = ' '.join(str(error).split())[:100]
        raise Unusable(f'it is damaged: {path.name}: {what or type(error).__name__}') from None


def _poses(columns: Mapping[str, np.ndarray], k: int, about: Mapping[str, Any]) -> Poses:
    """Return the poses of a stream of a block; raise where a column is not what it must be."""
    found: dict[str, Any] = {}
    count = len(columns[f'{k}.stamps_ns'])
    for name, (shape, kind) in ROWS.items():
        column = columns.get(f'{k}.{name}')
        if column is not None:
            if column.shape != (count, *shape) or column.dtype != kind:
                raise ValueError(f'{name} has the shape {column.shape} and type {column.dtype}')
            found[name] = column
    origin = None
    if about['origin'] is not None:
        latitude, longitude, height = map(float, about['origin'])
        origin = latitude, longitude, height
    return Poses(**found, zero_is_unset=bool(about['zero_is_unset']), origin=origin)
