"""
Trajectories in text files: TUM, EuRoC csv and KITTI.

Lenient in what is read: columns apart by white space or commas, comments and headers, columns
behind those needed. Numbers are parsed in blocks, not line by line. Stamps stay exact: their
digits are read as integers, since a float64 resolves only 238 ns at today's times.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
import re
from typing import NamedTuple
import warnings

import numpy as np

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.progress import Progress, silent

BLOCK_BYTES = 1 << 18
STAMP_UNITS = {'s': 9, 'ms': 6, 'us': 3, 'ns': 0}
INT64_DIGITS = 19
EXACT = 1 << 53
LATEST_NS = 1 << 62
POWERS = 10.0 ** np.arange(23)

_SEPARATORS = bytes.maketrans(b',;\t\r\v\f', b'      ')


class Rows(NamedTuple):
    """
    The numbers of a text file.

    :param digits: (N,) int64, the digits of the first column without its decimal point.
    :param decimals: (N,) how many of them stood behind the point.
    :param values: (N, C) float64, all columns.
    """

    digits: np.ndarray
    decimals: np.ndarray
    values: np.ndarray

    @property
    def largest_stamp(self) -> float:
        """The largest number of the first column, whatever its sign."""
        return float(np.max(np.abs(self.digits / POWERS[self.decimals])))

    def nanoseconds(self, path: Path, unit: str) -> np.ndarray:
        """Return the first column as (N,) int64 nanoseconds, given its unit."""
        shift = STAMP_UNITS[unit] - self.decimals
        up = np.where(shift > 0, shift, 0)
        if self.largest_stamp * POWERS[STAMP_UNITS[unit]] > LATEST_NS:
            raise ReadError(path, f'stamps are too large to be {unit}')
        stamps = self.digits * 10**up
        if (shift < 0).any():
            divisor = 10 ** np.where(shift < 0, -shift, 0)
            stamps = (stamps + divisor // 2) // divisor
        return stamps


@dataclass(frozen=True)
class TextFile:
    """
    What a text file holds, and what its header says of the order of its columns.

    :param kind: ``euroc`` (csv with EuRoC's header or name) or ``tum``.
    :param quaternion: the order that the header names, if it does.
    :param commas: whether columns are apart by commas.
    """

    path: Path
    rows: Rows
    kind: str
    quaternion: str | None
    commas: bool


def read_text(path: Path, progress: Progress = silent) -> TextFile:
    """Return the numbers of a text file; ``ReadError`` names the line that is no row of them."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ReadError(path, error.strerror or str(error)) from None
    if not data or data.isspace():
        raise ReadError(path, 'the file is empty')
    if b'\0' in data[:BLOCK_BYTES]:
        raise ReadError(
            path, 'this is no text file and no recording; a recording ends in .bag, .db3 or .mcap'
        )
    data = data.removeprefix(b'\xef\xbb\xbf')  # the byte order mark of Windows
    if b'\r' in data and b'\n' not in data:
        data = data.replace(b'\r', b'\n')
    header, start = split_header(data)
    if re.match(rb'\s*(-?\d+,\d+[ \t;]+){2}', data[start : start + 1000]):
        raise ReadError(path, 'its numbers have decimal commas; write them with points')
    rows = _rows(path, data, start, progress)
    names = header.lower().replace(b'_', b'')
    w, x = re.search(rb'\bq(rs)?w\b', names), re.search(rb'\bq(rs)?x\b', names)
    quaternion = None if not w or not x else 'wxyz' if w.start() < x.start() else 'xyzw'
    euroc = path.name == 'data.csv' or re.match(rb'#timestamp(kf)?( \[ns\])?,', names)
    return TextFile(
        path,
        rows,
        'euroc' if euroc else 'tum',
        quaternion,
        b',' in data[start : start + BLOCK_BYTES],
    )


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
            line = data.count(b'\n', 0, begin) + line_of_row(block, bad.row)
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


class BadRow(Exception):
    """A row (counted from 0, blanks and comments left out) is no row of numbers."""

    def __init__(self, row: int, problem: str) -> None:
        super().__init__(problem)
        self.row = row
        self.problem = problem


def _tidied(block: bytes) -> tuple[bytes, np.ndarray, np.ndarray]:
    """Return a block with one space or line end behind each number, its bytes, and where."""
    if b',' in block:
        # nothing between two commas is a number that is not there
        block = re.sub(rb',[ \t]*(?=,)', b',nan', re.sub(rb'(?m)^[ \t]*,', b'nan,', block))
    if any(mark in block for mark in b',;\t\r\v\f'):
        block = block.translate(_SEPARATORS)
    if b'#' in block or b'%' in block:
        block = re.sub(rb'(?m)^[ \t]*[#%][^\n]*', b'', block)
    text = np.frombuffer(block, np.uint8)
    ends = np.flatnonzero(text <= ord(' '))
    if (ends[:1] > 0).all() and (np.diff(ends) > 1).all() and block.endswith(b'\n'):
        return block, text, ends
    block = re.sub(rb' *\n\s*', b'\n', re.sub(rb' +', b' ', block)).strip() + b'\n'
    text = np.frombuffer(block, np.uint8)
    return block, text, np.flatnonzero(text <= ord(' '))


def line_of_row(block: bytes, row: int) -> int:
    """Return the line, counted from 1, of a row of a block."""
    lines = [
        line
        for line, text in enumerate(block.translate(_SEPARATORS).splitlines(), 1)
        if text.strip() and not text.strip().startswith((b'#', b'%'))
    ]
    return lines[row]


def parse(block: bytes, width: int) -> Rows | None:
    """
    Return the rows of a block of whole lines, or None where there are none.

    A decimal number is its digits, an integer that parses fast and exactly, over a power of ten:
    as long as the digits are below 2^53, the quotient is the float64 nearest to the text (Clinger
    1990). Longer numbers, exponents and NaN go through the slower general parser.

    :param width: the columns of the rows before, or 0.
    """
    block, text, ends = _tidied(block)
    if block == b'\n':
        return None
    width = _check_width(text, ends, width)
    points = _points(text, ends, width)
    decimals = (ends - points - 1).clip(min=0)
    digits = _numbers(block.translate(None, b'.'), np.int64, len(ends))
    if digits is not None and _exact(digits.reshape(-1, width)[:, 1:], decimals):
        values = digits / POWERS[decimals]
    else:
        # older numpy would read hexadecimal numbers, too
        hexadecimal = b'x' in block or b'X' in block
        values = None if hexadecimal else _numbers(block, np.float64, len(ends))
        if values is None:
            raise _not_a_number(block)
    values = values.reshape(-1, width)
    first = np.concatenate([[0], ends[width - 1 : -1 : width] + 1])
    if (
        digits is not None
        and np.max(ends[::width] - first - (decimals[::width] > 0)) <= INT64_DIGITS
    ):
        return Rows(digits[::width], decimals[::width], values)
    finite = np.isfinite(values[:, 0])
    exponents = np.flatnonzero((text == ord('e')) | (text == ord('E')))
    if (np.searchsorted(ends, exponents) % width == 0).any() or not finite.all():
        values[~finite] = np.nan
        return Rows(*_stamps_of_floats(np.where(finite, values[:, 0], 0)), values)
    return Rows(*_long_stamps(text, first, ends[::width], points[::width]), values)


def _check_width(text: np.ndarray, ends: np.ndarray, width: int) -> int:
    """Return how many numbers every row has, given where each number ends."""
    row_ends = np.flatnonzero(text[ends] == ord('\n'))
    width = width or int(row_ends[0]) + 1
    if (
        len(ends) != width * len(row_ends)
        or (row_ends[::-1] != np.arange(len(ends) - 1, -1, -width)).any()
    ):
        counts = np.diff(row_ends, prepend=-1)
        row = int(np.flatnonzero(counts != width)[0])
        raise BadRow(row, f'{counts[row]} columns, but {width} in the lines before')
    return width


def _points(text: np.ndarray, ends: np.ndarray, width: int) -> np.ndarray:
    """Return where the decimal point of each number is; its end, where it has none."""
    points = np.flatnonzero(text == ord('.'))
    if len(points) == len(ends) and (points < ends).all() and (points[1:] > ends[:-1]).all():
        return points
    owner = np.searchsorted(ends, points)
    twice = np.flatnonzero(np.diff(owner) == 0)
    if len(twice):
        raise BadRow(int(owner[twice[0]]) // width, 'a number has two decimal points')
    found = ends.copy()
    found[owner] = points
    return found


def _exact(digits: np.ndarray, decimals: np.ndarray) -> bool:
    """Return whether digits and power of ten are both exact as float64."""
    return bool(
        -EXACT < digits.min(initial=0)
        and digits.max(initial=0) < EXACT
        and decimals.max() < len(POWERS)
    )


def _numbers(text: bytes, kind: type, count: int) -> np.ndarray | None:
    """Return ``count`` numbers, or None where the text has something else."""
    with warnings.catch_warnings():
        # how numpy, depending on its version, says that it stopped at what is no number
        warnings.simplefilter('error', DeprecationWarning)
        try:
            numbers = np.fromstring(text, kind, sep=' ')
        except (ValueError, DeprecationWarning):
            return None
    return numbers if len(numbers) == count else None


def _not_a_number(block: bytes) -> BadRow:
    """Return the error for the first word of a block that is no number."""
    for row, line in enumerate(block.splitlines()):
        for word in line.split():
            try:
                float(b'?' if b'_' in word else word)  # Python reads 1_000, and others do not
            except ValueError:
                return BadRow(row, f"'{word[:40].decode(errors='replace')}' is not a number")
    return BadRow(0, 'there is something that is not a number')


def _long_stamps(
    text: np.ndarray, begin: np.ndarray, end: np.ndarray, point: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return digits and decimals of stamps written with more digits than an int64 holds."""
    # whatever the unit, an int64 holds the nanoseconds; digits behind them are cut
    keep = np.minimum(end, point + 1 + (INT64_DIGITS - (point - begin)).clip(min=0))
    length = keep - begin + 1
    first = np.cumsum(length) - length
    chars = text[
        np.minimum(np.arange(length.sum()) + np.repeat(begin - first, length), len(text) - 1)
    ]
    chars[first + length - 1] = ord(' ')
    digits = _numbers(chars.tobytes().replace(b'.', b''), np.int64, len(begin))
    if digits is None:
        raise BadRow(0, 'a stamp is not a number')
    return digits, (keep - point - 1).clip(0)


def _stamps_of_floats(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return digits and decimals of stamps written with exponents: as exact as a float64 is."""
    whole = np.floor(values)
    largest = np.abs(whole).max()
    if largest >= 2.0**63:
        raise BadRow(int(np.abs(whole).argmax()), 'a stamp is too large')
    if largest >= 2.0**33:
        return whole.astype(np.int64), np.zeros(len(whole), np.int64)
    rest = np.rint((values - whole) * 1e9)
    return whole.astype(np.int64) * 10**9 + rest.astype(np.int64), np.full(len(whole), 9)
