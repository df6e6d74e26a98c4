"""
Rows of numbers in text, a block of lines at a time.

Columns are separated by white space, commas or semicolons; blank lines and comments (# or %) are
skipped. Stamps stay exact: their digits are read as integers, since a float64 resolves only 238 ns
at today's times. What the columns mean is not known here.
"""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any, NamedTuple
import warnings

import numpy as np

from vio_eval_ros.errors import ReadError

#: the units of stamps, and how many decimals each has down to nanoseconds
STAMP_UNITS = {'s': 9, 'ms': 6, 'us': 3, 'ns': 0}
#: within these, sums and differences of stamps fit into int64; it is the year 2116
LATEST_NS = 1 << 62
LATEST_S = LATEST_NS / 1e9  # a larger stamp is in a smaller unit
INT64_MAX = (1 << 63) - 1
EXACT = 1 << 53  # integers below it are exact as float64
POWERS = 10.0 ** np.arange(23)  # those that are exact as float64
LONG_STAMP = 20  # characters, the point included, that an int64 is sure to hold

EMPTY_CELLS = (b',,', b'\n,', b' ', b'\t')  # in what has any, and perhaps elsewhere
TWO_IN_A_WORD = re.compile(rb'(?i)x|(nan|f|y)[^ \n]*?[ni]')
CLOCK = re.compile(rb'\d+[:/]\d+[:/]\d|\d{4}-\d\d-\d\d')
CLOCK_ADVICE = '; write times as seconds, or as 2024-06-01T12:00:00.123Z'
_SEPARATORS = bytes.maketrans(b',;\t\r\v\f', b'      ')


class Decimals(NamedTuple):
    """
    The exact decimals of a column.

    :param digits: (N,) int64, without the decimal point.
    :param decimals: (N,) how many of them stood after the point.
    """

    digits: np.ndarray
    decimals: np.ndarray

    @property
    def largest(self) -> float:
        """The largest number, whatever its sign."""
        return float(np.max(np.abs(self.digits / POWERS[self.decimals])))

    @property
    def likely_unit(self) -> str:
        """The unit of stamps, by their size."""
        largest = self.largest
        return next(
            (unit for unit in STAMP_UNITS if largest < LATEST_S * per_second(unit)),
            'ns',
        )

    def nanoseconds(self, path: Path, unit: str) -> np.ndarray:
        """Return stamps as (N,) int64 nanoseconds, given their unit."""
        shift = STAMP_UNITS[unit] - self.decimals
        if self.largest * POWERS[STAMP_UNITS[unit]] > LATEST_NS:
            raise ReadError(path, f'stamps are too large to be {unit}')
        stamps: np.ndarray = self.digits * 10 ** shift.clip(min=0)
        if (shift < 0).any():
            divisor = 10 ** (-shift).clip(min=0)
            stamps = (stamps + divisor // 2) // divisor
        return stamps


class Rows(NamedTuple):
    """
    The numbers of rows.

    :param values: (N, C) float64, all columns.
    :param exact: the exact decimals of some columns, those that may hold stamps.
    """

    values: np.ndarray
    exact: dict[int, Decimals]


def per_second(unit: str) -> int:
    """Return how many of a unit of stamps make a second."""
    return 10 ** (STAMP_UNITS['s'] - STAMP_UNITS[unit])


class BadRow(Exception):
    """
    A line is not a row of numbers.

    :param line: counted from 1 in the block.
    """

    def __init__(self, line: int, problem: str) -> None:
        super().__init__(problem)
        self.line = line
        self.problem = problem


def parse(block: bytes, width: int = 0, exact: tuple[int, ...] = (0,)) -> Rows | None:
    """
    Return the rows of a block of whole lines, or None where there are none.

    A decimal number is its digits, an integer that parses fast and exactly, over a power of ten:
    as long as the digits are below 2^53, the quotient is the float64 nearest to the text (Clinger
    1990). Longer numbers, exponents and NaN go through the slower general parser. ``np.loadtxt``
    takes 2.5 times as long, and its errors do not say the line.

    :param width: the columns of the rows before, or 0.
    :param exact: the columns whose exact decimals are kept. Where the first of them is not finite,
        nothing in its row is; the others are left out where an int64 does not hold them.
    :raises BadRow: for the first line that is not a row of as many numbers.
    """
    text, chars, ends = _tidied(block)
    if text == b'\n':
        return None
    newlines = np.flatnonzero(chars[ends] == ord('\n'))
    width = width or int(newlines[0]) + 1
    is_table = np.array_equal(newlines, np.arange(width - 1, len(ends), width))
    is_table = is_table and _signs_begin_numbers(chars)
    decimal = _decimals(text, chars, ends) if is_table else None
    if decimal is not None and _are_exact(decimal[0].reshape(-1, width)[:, 1:], decimal[1]):
        values = decimal[0] / POWERS[decimal[1]]
    else:
        # numpy would read two numbers of nannan, and older ones hexadecimal numbers, too
        has_words = any(letter in text for letter in b'xXnNiI')
        is_clean = is_table and not (has_words and TWO_IN_A_WORD.search(text))
        general = _numbers(text, np.float64, len(ends)) if is_clean else None
        if general is None:
            raise _first_bad_row(block, width)
        values = general
    values = values.reshape(-1, width)
    kept = [column for column in exact if column < width]
    if decimal is not None and (not kept or decimal[0][kept[0] :: width].max() < INT64_MAX):
        digits, decimals = (part.reshape(-1, width).T for part in decimal)
        held = [k for k in kept if digits[k].max() < INT64_MAX]
        return Rows(values, {k: Decimals(digits[k].copy(), decimals[k].copy()) for k in held})
    values[~np.isfinite(values[:, kept[:1]]).all(axis=1)] = np.nan
    columns = {}
    for k in kept:
        try:
            columns[k] = _decimals_of(k, block, text, values[:, k])
        except BadRow:
            if k == kept[0]:
                raise
    return Rows(values, columns)


def _signs_begin_numbers(chars: np.ndarray) -> bool:
    """Return whether no sign is within a number; numpy would read two numbers of 1-2."""
    after, before = chars[1:], chars[:-1]
    within = ((after == ord('-')) | (after == ord('+'))) & (before > ord(' '))
    return not within.any() or bool((before[within] | 32 == ord('e')).all())


def _separated(block: bytes) -> bytes:
    """Return a block with spaces between its numbers, and without comments."""
    if b',' in block and (block[0] == ord(',') or any(mark in block for mark in EMPTY_CELLS)):
        # nothing between two commas is a number that is missing
        block = re.sub(rb',[ \t]*(?=,)', b',nan', re.sub(rb'(?m)^[ \t]*,', b'nan,', block))
    if any(mark in block for mark in b',;\t\r\v\f'):
        block = block.translate(_SEPARATORS)
    if b'#' in block or b'%' in block:
        block = re.sub(rb'(?m)^[ \t]*[#%][^\n]*', b'', block)
    return block


def _tidied(block: bytes) -> tuple[bytes, np.ndarray, np.ndarray]:
    """Return a block with one space or line end after each number, its bytes, and where."""
    text = _separated(block)
    chars = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(chars <= ord(' '))
    if (ends[:1] > 0).all() and (np.diff(ends) > 1).all() and text.endswith(b'\n'):
        return text, chars, ends
    text = re.sub(rb' *\n\s*', b'\n', re.sub(rb' +', b' ', text)).strip() + b'\n'
    chars = np.frombuffer(text, np.uint8)
    return text, chars, np.flatnonzero(chars <= ord(' '))


def _decimals(
    text: bytes, chars: np.ndarray, ends: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Return the digits of all numbers as integers, and how many stood after the point.

    None where one is not a plain decimal number. Digits beyond an int64 are INT64_MAX.
    """
    points = np.flatnonzero(chars == ord('.'))
    if not (len(points) == len(ends) and (points < ends).all() and (points[1:] > ends[:-1]).all()):
        found = points
        owner = np.searchsorted(ends, found)
        if (np.diff(owner) == 0).any():  # two points in a number
            return None
        points = ends.copy()
        points[owner] = found
    digits = _numbers(text.translate(None, b'.'), np.int64, len(ends))
    return None if digits is None else (digits, (ends - points - 1).clip(min=0))


def _are_exact(digits: np.ndarray, decimals: np.ndarray) -> bool:
    """Return whether digits and powers of ten are both exact as float64."""
    return bool(
        -EXACT < digits.min(initial=0)
        and digits.max(initial=0) < EXACT
        and decimals.max() < len(POWERS)
    )


def _numbers(text: bytes, kind: type[Any], count: int) -> np.ndarray | None:
    """Return ``count`` numbers, or None where the text has something else."""
    with warnings.catch_warnings():
        # how numpy, depending on its version, says that it stopped at what is not a number
        warnings.simplefilter('error', DeprecationWarning)
        try:
            numbers = np.fromstring(text, kind, sep=' ')
        except (ValueError, DeprecationWarning):
            return None
    return numbers if len(numbers) == count else None


def _decimals_of(column: int, block: bytes, text: bytes, values: np.ndarray) -> Decimals:
    """Return the exact decimals of a column, in a block that has more than decimals."""
    words = text
    if column:
        words = re.sub(rb'(?m)^(?:[^ \n]+ ){%d}' % column, b'', words)
    words = re.sub(rb' [^\n]*', b'', words)
    if re.search(rb'[eE]\+?-?\d', words):
        return Decimals(*_decimals_of_floats(block, np.nan_to_num(values)))
    words = re.sub(rb'(?mi)^[-+]?(nan|inf).*$', b'0', words)
    words = re.sub(rb'(?m)^.{%d,}$' % (LONG_STAMP + 1), _cut, words)
    chars = np.frombuffer(words, np.uint8)
    decimal = _decimals(words, chars, np.flatnonzero(chars <= ord(' ')))
    if decimal is None or decimal[0].max() == INT64_MAX:
        large = 0 if decimal is None else int(decimal[0].argmax())
        raise BadRow(_line_of(block, large), 'a stamp is too large')
    return Decimals(*decimal)


def _cut(stamp: re.Match[bytes]) -> bytes:
    """Return a stamp without the digits after the point that an int64 does not hold."""
    return stamp[0][: max(LONG_STAMP, stamp[0].find(b'.') + 1)] if b'.' in stamp[0] else stamp[0]


def _decimals_of_floats(block: bytes, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return digits and decimals of numbers with exponents: as exact as a float64 is."""
    whole = np.floor(values)
    largest = np.abs(whole).max()
    if largest >= 2.0**63:
        line = _line_of(block, int(np.abs(whole).argmax()))
        raise BadRow(line, 'a stamp is too large')
    if largest >= 2.0**33:
        return whole.astype(np.int64), np.zeros(len(whole), np.int64)
    rest = np.rint((values - whole) * 1e9)
    return whole.astype(np.int64) * 10**9 + rest.astype(np.int64), np.full(len(whole), 9)


def _lines(block: bytes) -> list[tuple[int, list[bytes]]]:
    """Return the number, from 1, and the words of each line that has any."""
    lines = enumerate(_separated(block).split(b'\n'), 1)
    return [(number, line.split()) for number, line in lines if line.strip()]


def _line_of(block: bytes, row: int) -> int:
    """Return the line of a row."""
    return _lines(block)[row][0]


def _first_bad_row(block: bytes, width: int) -> BadRow:
    """Return the error for the first line of a block that is not a row of numbers."""
    for line, words in _lines(block):
        if len(words) != width:
            return BadRow(line, f'{len(words)} columns, but {width} in the lines before')
        for word in words:
            if b'|' in word:
                return BadRow(line, 'columns are separated by |; use commas, spaces or tabs')
            if word.count(b'.') > 1:
                return BadRow(line, f"'{_shown(word)}' has two decimal points")
            try:
                float(b'?' if b'_' in word else word)  # Python reads 1_000, and others do not
            except ValueError:
                advice = CLOCK_ADVICE if CLOCK.match(word) else ''
                return BadRow(line, f"'{_shown(word)}' is not a number{advice}")
    return BadRow(1, 'contains something that is not a number')


def as_text(data: bytes) -> str:
    """Return text in UTF-8, or in Latin-1, in which all bytes are letters."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode('latin-1')


def _shown(word: bytes) -> str:
    return as_text(word[:40])
