"""
Text files with rows of numbers: trajectories, stamps, signals.

Headers, comments, byte order marks and any line ends are read. What the columns mean is decided in
:mod:`~vio_eval_ros.recordings.layouts`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
import re
from typing import NamedTuple

import numpy as np

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.columns import expanded, LEFT_OUT, named_columns, names_in, STAMPS
from vio_eval_ros.recordings.content import content_of
from vio_eval_ros.recordings.iso_times import has_times, with_seconds
from vio_eval_ros.recordings.preambles import Export
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.rows import as_text, BadRow, Decimals, parse, Rows

BLOCK_BYTES = 1 << 18
#: numbers of the first two rows
COUNTS = ((b'0', b'1'), (b'1', b'2'))
LEAST_NUMBERS = 3  # in a row that begins with a word, and names with a meaning in a header


WORD = rb'[A-Za-z_/]|.*\.[A-Za-z]{2,}[0-9]?$'  # a name, or that of a file
NUMBER = rb'[-+]?(\d+(\.\d*)?|\.\d+)(e[-+]?\d+)?|[-+]?(nan|inf(inity)?)|'


@dataclass(frozen=True)
class TextFile:
    """
    What a text file holds.

    :param header: the comments and names of columns at its top.
    :param separator: what is between its columns: ``,``, ``;``, a tab or a space.
    :param has_end: whether a separator ends each row, too.
    :param names: of its columns, units in brackets behind them; None where nothing tells them.
    :param export: what the preamble of a motion capture system says of its columns.
    :param text: the columns that hold no numbers; there, the values of ``rows`` are NaN.
    :param words: what those hold, (N,) bytes each.
    :param blank: the columns that hold nothing in the first rows.
    :param notes: what was taken for granted, in sentences.
    """

    path: Path
    rows: Rows
    header: bytes
    separator: str
    has_end: bool
    names: tuple[str, ...] | None = None
    export: Export | None = None
    text: tuple[int, ...] = ()
    words: dict[int, np.ndarray] = field(default_factory=dict)
    blank: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()


def read_text(
    path: Path, progress: Progress = silent, stamps: tuple[int, ...] | None = None
) -> TextFile:
    """
    Return what a text file holds; ``ReadError`` names the line that is not a row of numbers.

    :param stamps: the columns whose exact decimals are kept; None for those that its header names
        as stamps, and without names the first, with two more where it holds whole numbers.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ReadError(path, error.strerror or str(error)) from None
    except ValueError as error:  # a null character in the path
        raise ReadError(path, str(error)) from None
    if not data or data.isspace():
        raise ReadError(path, 'the file is empty')
    data, export, known = content_of(path, data)
    notes = list(known)
    header, start = split_header(data)
    first = _first_rows(data, start)
    if first and has_times(first[0]):
        data = data[:start] + with_seconds(path, data[start:], notes)
        first = _first_rows(data, start)
    separator = _separator(first)
    has_end = _has_end(data, start, separator)
    cells = [_cells(row, separator, has_end) for row in first]
    columns = list(zip(*cells, strict=False))
    text = _text_columns(columns)
    blank = tuple(k for k, words in enumerate(columns) if not any(words))
    names = _names(header, len(columns))
    if names and _is_counted(names, columns):
        names = ('', *names)
    if stamps is None:
        stamps = _stamp_columns(names, columns, (*text, *blank))
    rows, words = _rows(path, data, start, progress, _Parser(separator, has_end, text, stamps))
    return TextFile(
        path=path,
        rows=rows,
        header=header,
        separator=separator,
        has_end=has_end,
        names=names,
        export=export,
        text=text,
        words=words,
        blank=blank,
        notes=tuple(notes),
    )


def split_header(data: bytes) -> tuple[bytes, int]:
    """Return the comments and column names at the top of a file, and where the rows begin."""
    start = 0
    while start < len(data):
        end = data.find(b'\n', start) + 1 or len(data)
        line = data[start:end].strip().lstrip(b',; ').lower()  # its first name may be empty
        if (line and re.match(rb'[^#%a-z_"/]|(nan|inf)\b', line)) or _is_row(line):
            break
        start = end
    return data[:start], start


def _is_row(line: bytes) -> bool:
    """Return whether a line that begins with a word is a row: a few numbers are in it."""
    if line.startswith((b'#', b'%')):
        return False
    separator = next((mark for mark in (b',', b';', b'\t') if mark in line), None)
    cells = [cell.strip() for cell in line.split(separator)]
    numbers = [cell for cell in cells if cell and re.fullmatch(NUMBER, cell)]
    return len(numbers) >= LEAST_NUMBERS and 2 * len(numbers) >= len(cells) - cells.count(b'')


def _first_rows(data: bytes, start: int) -> list[bytes]:
    """Return the first two rows."""
    lines = (line.strip(b' \r') for line in data[start : start + BLOCK_BYTES].split(b'\n'))
    return [line for line in lines if line and not line.startswith((b'#', b'%'))][:2]


def _separator(rows: list[bytes]) -> str:
    """Return what separates the columns of rows."""
    return next((mark for mark in ',;\t' if rows and mark.encode() in rows[0]), ' ')


def _is_counted(names: tuple[str, ...], columns: list[tuple[bytes, ...]]) -> bool:
    """Return whether the first column numbers the rows, without a name, as tables of R have it."""
    is_stamp = named_columns(names)[0].role in STAMPS
    return len(names) == len(columns) - 1 and is_stamp and columns[0] in COUNTS


def _has_end(data: bytes, start: int, separator: str) -> bool:
    """Return whether rows end in a separator, behind which no other cell begins."""
    rows = data[start : start + BLOCK_BYTES].replace(b' ', b'').replace(b'\r', b'')
    ends = rows.count(separator.encode() + b'\n')
    return separator != ' ' and 2 * ends > rows.count(b'\n')


def _cells(row: bytes, separator: str, has_end: bool) -> list[bytes]:
    """Return the cells of a row."""
    if separator == ' ':
        return row.split()
    row = row.removesuffix(separator.encode()) if has_end else row
    return [cell.strip() for cell in row.split(separator.encode())]


def _text_columns(columns: list[tuple[bytes, ...]]) -> tuple[int, ...]:
    """Return the columns that hold words in all of the first rows."""
    return tuple(
        column
        for column, words in enumerate(columns)
        if all(re.match(WORD, word) for word in words)
        and not any(re.fullmatch(NUMBER, word.lower()) for word in words)
    )


def _names(header: bytes, width: int) -> tuple[str, ...] | None:
    """Return the names of columns in a header: of the last line that means something."""
    for line in reversed(as_text(header).splitlines()):
        names = names_in(line)
        meant = {column.role for column in named_columns(names)} - {LEFT_OUT}
        vectors = expanded(names, width)
        if vectors and vectors[0].role in STAMPS:  # not a sentence, such as: position of ...
            return tuple(names)
        is_bare = not line.lstrip().startswith(('#', '%')) and len(names) == width
        if (
            len(meant) >= LEAST_NUMBERS
            or is_bare
            or (width <= 2 and len(names) == width and meant)
        ):
            return tuple(names)
    return None


def _stamp_columns(
    names: tuple[str, ...] | None, columns: list[tuple[bytes, ...]], empty: tuple[int, ...]
) -> tuple[int, ...]:
    """Return the columns that may hold stamps, those without numbers excepted."""
    if names:
        roles = [(k, one.role) for k, one in enumerate(named_columns(names)) if k not in empty]
        named = [k for k, role in roles if role in STAMPS]
        return tuple(named or [k for k, role in roles if role == 'frame'] or [0])
    whole = bool(columns) and all(re.match(rb'[-+]?\d{1,10}$', cell) for cell in columns[0])
    numbers = [k for k in range(len(empty) + 3) if k not in empty]
    return tuple(numbers[:3] if whole else numbers[:1])


class _Parser(NamedTuple):
    """How blocks of a file become rows."""

    separator: str
    has_end: bool
    text: tuple[int, ...]
    stamps: tuple[int, ...]

    def parse(self, block: bytes, width: int) -> tuple[Rows | None, list[np.ndarray]]:
        """Return the rows of a block, NaN in the columns of text, and the words there."""
        words = []
        if self.separator == ';':
            block = block.replace(b';', b',')
        if self.text:
            block = re.sub(rb'(?m)^[ \t]*[#%][^\n]*', b'', block)
            mark = self.separator.replace(';', ',').encode()
            inside = rb'\S' if mark == b' ' else rb'[^%s\n]' % mark
            between = rb'[ ]+' if mark == b' ' else mark
            for column in self.text:
                before = rb'(?m)^([ ]*(?:%s*%s){%d})' % (inside, between, column)
                cell = re.compile(before + rb'(%s+)' % inside)
                words.append(np.array([word for _, word in cell.findall(block)], bytes))
                block = cell.sub(rb'\1nan', block)
        try:
            return parse(block, width, self.stamps), words
        except BadRow:
            if self.has_end or self.separator not in ',;':
                raise
        # a cell at the end of a row may be empty
        return parse(re.sub(rb',(?=\r?\n|\Z)', b',nan', block), width, self.stamps), words


def _rows(
    path: Path, data: bytes, start: int, progress: Progress, parser: _Parser
) -> tuple[Rows, dict[int, np.ndarray]]:
    """Return the numbers from ``start`` on, and the words in columns of text."""
    cuts = [start]
    while cuts[-1] < len(data):
        cuts.append(data.find(b'\n', cuts[-1] + BLOCK_BYTES) + 1 or len(data))
    parts, words, width = [], [], 0
    for begin, end in progress(pairwise(cuts), len(cuts) - 1):
        block = data[begin:end]
        try:
            rows, in_block = parser.parse(block, width)
        except BadRow as bad:
            line = data.count(b'\n', 0, begin) + bad.line
            raise ReadError(path, f'line {line}: {bad.problem}') from None
        if rows is not None:
            parts.append(rows)
            words.append(in_block)
            width = rows.values.shape[1]
    if not parts:
        raise ReadError(path, 'the file has no rows of numbers')
    count = sum(len(part.values) for part in parts)
    found = {
        k: np.concatenate(each)
        for k, each in zip(parser.text, zip(*words, strict=True), strict=False)
    }
    # a cell without a word in it has none here either
    found = {k: each for k, each in found.items() if len(each) == count}
    return parts[0] if len(parts) == 1 else _joined(parts), found


def _joined(parts: list[Rows]) -> Rows:
    """Return all parts in one; each is let go as soon as it is copied."""
    count, width = sum(len(part.values) for part in parts), parts[0].values.shape[1]
    held = set.intersection(*(set(part.exact) for part in parts))
    whole = Rows(
        np.empty((count, width)),
        {k: Decimals(np.empty(count, np.int64), np.empty(count, np.int64)) for k in sorted(held)},
    )
    for part in reversed(parts):
        parts.pop()
        begin = count - len(part.values)
        whole.values[begin:count] = part.values
        for k in held:
            whole.exact[k].digits[begin:count] = part.exact[k].digits
            whole.exact[k].decimals[begin:count] = part.exact[k].decimals
        count = begin
    return whole
