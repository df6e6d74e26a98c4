"""
From the bytes of a file to plain text: encodings, line ends, quotes, lines that are cut.

Files of which it is known that they hold no poses are refused by name.
"""

from __future__ import annotations

import codecs
from pathlib import Path
import re
from typing import NamedTuple

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.foreign import refuse_foreign
from vio_eval_ros.recordings.preambles import Export, export_of, rows_of

HEAD_BYTES = 1 << 12
HEAD_LINES = 100
LAST_LINES = 20
NEWLINE = b'\n'
#: byte order marks, those of 32 bits first, since one begins with that of 16 bits
MARKS = {
    codecs.BOM_UTF32_LE: 'utf-32',
    codecs.BOM_UTF32_BE: 'utf-32',
    codecs.BOM_UTF16_LE: 'utf-16',
    codecs.BOM_UTF16_BE: 'utf-16',
}
_NUMBER = re.compile(rb'[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?')
_QUOTED = re.compile(rb'"([^"\n]*)"')
_QUOTED_ONCE = re.compile(rb"'(\s*%s\s*)'" % _NUMBER.pattern)
_DECIMAL_COMMA = re.compile(rb'[-+]?\d+,\d+(?:[eE][-+]?\d+)?')


class Content(NamedTuple):
    """
    The plain text of a file.

    :param data: header and rows, in ASCII or UTF-8, lines that end in a line feed.
    :param export: what the preamble of a motion capture system says of it.
    :param notes: what was taken for granted or left out, in sentences.
    """

    data: bytes
    export: Export | None = None
    notes: tuple[str, ...] = ()


def content_of(path: Path, data: bytes) -> Content:
    """
    Return the plain text in the bytes of a file.

    :raises ReadError: there is none, it holds no poses, or its numbers have decimal commas.
    """
    refuse_foreign(path, data)
    notes: list[str] = []
    data = _decoded(path, data)
    if b'\0' in data:
        data = _without_padding(path, data, notes)
    if b'\r' in data and b'\n' not in data:
        data = data.replace(b'\r', b'\n')
    if _has_decimal_commas(data):
        raise ReadError(path, 'its numbers have decimal commas; write them with points')
    if b'"' in data:
        data = _QUOTED.sub(_cell, data)
    if b"'" in data:
        data = _QUOTED_ONCE.sub(rb'\1', data)
    data = _without_cut_line(path, data, notes)
    export = export_of(path, data)
    if export is not None:
        data = rows_of(data, export)
    return Content(data, export, tuple(notes))


def _decoded(path: Path, data: bytes) -> bytes:
    """Return text in UTF-8, whatever its encoding."""
    encoding = next((name for mark, name in MARKS.items() if data.startswith(mark)), None)
    encoding = encoding or _unmarked(data[:HEAD_BYTES])
    if encoding is None:
        return data.removeprefix(codecs.BOM_UTF8)
    # half a character at the end is a line that is cut
    data = data[: len(data) - len(data) % (4 if '32' in encoding else 2)]
    try:
        return data.decode(encoding).encode()
    except UnicodeError:
        raise ReadError(path, f'is not valid {encoding.upper()}; write it as UTF-8') from None


def _unmarked(head: bytes) -> str | None:
    """Return UTF-16 where every other byte of ASCII text is null, and which one it is."""
    for encoding, nulls, letters in (
        ('utf-16-le', head[1::2], head[0::2]),
        ('utf-16-be', head[0::2], head[1::2]),
    ):
        if len(nulls) > 3 and not nulls.strip(b'\0') and re.fullmatch(rb'[\s!-~]+', letters):
            return encoding
    return None


def _without_padding(path: Path, data: bytes, notes: list[str]) -> bytes:
    """Return a file without the null bytes at its end, as a loss of power leaves them."""
    text = data.rstrip(b'\0')
    if b'\0' in text[:HEAD_BYTES]:
        raise ReadError(path, 'neither a text file nor a recording (expected .bag, .db3 or .mcap)')
    if not text:
        raise ReadError(path, 'the file has null bytes only: its content was never written')
    if b'\0' in text:
        line = text.count(b'\n', 0, text.index(b'\0')) + 1
        raise ReadError(
            path, f'line {line} has null bytes, as a loss of power leaves them; remove it'
        )
    notes.append(f'{path}: {len(data) - len(text):,} null bytes at its end are left out')
    return text


def _cell(quoted: re.Match[bytes]) -> bytes:
    """Return what is between quotes, without what would separate cells."""
    return re.sub(rb'[,;\t]', b'_', quoted[1].strip())


def _has_decimal_commas(data: bytes) -> bool:
    """Return whether one of the first rows of numbers has commas where points should be."""
    for line in data[: 16 * HEAD_BYTES].split(b'\n')[:HEAD_LINES]:
        quoted = _QUOTED.findall(line)
        cells = quoted or [cell.strip(b',') for cell in re.split(rb'[;\s]+', line)]
        cells = [cell for cell in cells if cell]
        commas = [cell for cell in cells if _DECIMAL_COMMA.fullmatch(cell)]
        others = (_NUMBER.fullmatch(cell) for cell in cells if cell not in commas)
        if len(commas) > 1 and all(others):
            return True
    return False


def _without_cut_line(path: Path, data: bytes, notes: list[str]) -> bytes:
    """Return a file without a last line that was not written to its end, which is noted."""
    start = data.rfind(b'\n') + 1
    begin = max(start - LAST_LINES * len(data[start:]) * 4, 0)
    before = data[begin:start].splitlines()[1:][-LAST_LINES:]
    if not data[start:].strip() or not _is_cut(data[start:], before):
        return data
    notes.append(f'{path}: line {data.count(NEWLINE) + 1}, the last, is cut off and left out')
    return data[:start]


def _is_cut(last: bytes, before: list[bytes]) -> bool:
    """
    Return whether a line without an end ends too early: it lacks cells or decimals.

    :param before: the lines before it.
    """
    rows = [_cells(line) for line in before]
    if not rows or any(not _NUMBER.fullmatch(row[0]) for row in rows):
        return False
    cells, count = _cells(last), len(rows[-1])
    if len(cells) != count:
        return len(cells) < count
    decimals = {len(row[-1].partition(b'.')[2]) for row in rows}
    is_fixed = len(rows) == LAST_LINES and len(decimals) == 1
    return is_fixed and len(cells[-1].partition(b'.')[2]) < decimals.pop()


def _cells(line: bytes) -> list[bytes]:
    return re.split(rb'\s*[,;\s]\s*', line.strip())
