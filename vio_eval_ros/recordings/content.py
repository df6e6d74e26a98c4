"""From the bytes of a file to plain text: encodings, line ends, what programs put around rows."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from vio_eval_ros.errors import ReadError

CHECKED_BYTES = 1 << 18


class Content(NamedTuple):
    """
    The plain text of a file.

    :param data: header and rows, in ASCII or UTF-8, lines that end in a line feed.
    :param names: of the columns, where another place than the header tells them; units are
        in brackets behind the name, such as ``x [mm]``.
    :param notes: what was taken for granted, in sentences.
    """

    data: bytes
    names: tuple[str, ...] | None = None
    notes: tuple[str, ...] = ()


def content_of(path: Path, data: bytes) -> Content:
    """Return the plain text in the bytes of a file; ``ReadError`` where there is none."""
    if b'\0' in data[:CHECKED_BYTES]:
        raise ReadError(path, 'neither a text file nor a recording (expected .bag, .db3 or .mcap)')
    data = data.removeprefix(b'\xef\xbb\xbf')  # the byte order mark of Windows
    if b'\r' in data and b'\n' not in data:
        data = data.replace(b'\r', b'\n')
    return Content(data)
