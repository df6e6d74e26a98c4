"""
Text files with rows of numbers: trajectories, stamps, signals.

Headers, comments, byte order marks and any line ends are read. What the columns mean is decided in
:mod:`~vio_eval_ros.recordings.layouts`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
import re

import numpy as np

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.content import content_of
from vio_eval_ros.recordings.preambles import Export
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.rows import BadRow, parse, Rows

BLOCK_BYTES = 1 << 18


@dataclass(frozen=True)
class TextFile:
    """
    What a text file holds.

    :param header: the comments and names of columns at its top.
    :param has_commas: whether commas separate its columns.
    :param export: what the preamble of a motion capture system says of its columns.
    :param notes: what was taken for granted, in sentences.
    """

    path: Path
    rows: Rows
    header: bytes
    has_commas: bool
    export: Export | None = None
    notes: tuple[str, ...] = ()


def read_text(path: Path, progress: Progress = silent) -> TextFile:
    """Return what a text file holds; ``ReadError`` names the line that is not a row of numbers."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ReadError(path, error.strerror or str(error)) from None
    except ValueError as error:  # a null character in the path
        raise ReadError(path, str(error)) from None
    if not data or data.isspace():
        raise ReadError(path, 'the file is empty')
    data, export, notes = content_of(path, data)
    header, start = split_header(data)
    rows = _rows(path, data, start, progress)
    has_commas = b',' in data[start : start + BLOCK_BYTES]
    return TextFile(path, rows, header, has_commas, export, notes)


def split_header(data: bytes) -> tuple[bytes, int]:
    """Return the comments and column names at the top of a file, and where the rows begin."""
    start = 0
    while start < len(data):
        end = data.find(b'\n', start) + 1 or len(data)
        line = data[start:end].strip().lower()
        if line and re.match(rb'[^#%a-z_"]|nan|inf', line):
            break
        start = end
    return data[:start], start


def _rows(path: Path, data: bytes, start: int, progress: Progress) -> Rows:
    """Return the numbers from ``start`` on."""
    cuts = [start]
    while cuts[-1] < len(data):
        cuts.append(data.find(b'\n', cuts[-1] + BLOCK_BYTES) + 1 or len(data))
    parts, width = [], 0
    for begin, end in progress(pairwise(cuts), len(cuts) - 1):
        block = data[begin:end]
        try:
            rows = parse(block, width)
        except BadRow as bad:
            line = data.count(b'\n', 0, begin) + bad.line
            raise ReadError(path, f'line {line}: {bad.problem}') from None
        if rows is not None:
            parts.append(rows)
            width = rows.values.shape[1]
    if not parts:
        raise ReadError(path, 'the file has no rows of numbers')
    return parts[0] if len(parts) == 1 else _joined(parts)


def _joined(parts: list[Rows]) -> Rows:
    """Return all parts in one; each is let go as soon as it is copied."""
    count, width = sum(len(part.digits) for part in parts), parts[0].values.shape[1]
    whole = Rows(np.empty(count, np.int64), np.empty(count, np.int64), np.empty((count, width)))
    for part in reversed(parts):
        parts.pop()
        for column, rows in zip(whole, part, strict=True):
            column[count - len(rows) : count] = rows
        count -= len(part.digits)
    return whole
