"""Times as ISO 8601 writes them, 2024-06-01T12:00:00.123+02:00, in rows of text."""

from __future__ import annotations

from pathlib import Path
import re

import numpy as np

from vio_eval_ros.errors import ReadError

_TIME = re.compile(
    rb'(?<![^\s,;])(\d{4}-\d\d-\d\d)[T ]+(\d\d:\d\d:\d\d)(\.\d*)?(Z|z| ?UTC|[-+]\d\d(?::?\d\d)?)?'
    rb'(?![^\s,;])'
)
_GROUPS = 5  # of what is split by it: those four, and what is between two times


def has_times(row: bytes) -> bool:
    """Return whether a row has a time as ISO 8601 writes it."""
    return _TIME.search(row) is not None


def with_seconds(path: Path, rows: bytes, notes: list[str]) -> bytes:
    """
    Return rows in which times are seconds since 1970, to the last digit that they have.

    :param notes: takes a sentence where times have no zone, and are taken for UTC.
    :raises ReadError: a time that there is not, or before 1970.
    """
    parts = _TIME.split(rows)
    dates, clocks, fractions, zones = (
        np.array([part or b'' for part in parts[k::_GROUPS]], bytes) for k in range(1, _GROUPS)
    )
    try:
        texts = np.char.add(np.char.add(dates, b'T'), clocks).astype(str)
        seconds = texts.astype('datetime64[s]').astype(np.int64)
    except ValueError as error:
        raise ReadError(path, f'one of its times is none: {error}') from None
    different, which = np.unique(zones, return_inverse=True)
    seconds -= np.array([_offset_s(zone) for zone in different.tolist()], np.int64)[which]
    if (seconds < 0).any():
        raise ReadError(path, 'its times are before 1970; write seconds')
    if b'' in different:
        notes.append(f'{path}: its times have no zone, and are read as UTC')
    parts[1::_GROUPS] = np.char.add(seconds.astype(bytes), fractions).tolist()
    for k in range(2, _GROUPS):
        parts[k::_GROUPS] = [b''] * len(seconds)
    return b''.join(parts)


def _offset_s(zone: bytes) -> int:
    """Return how much a zone is ahead of UTC."""
    digits = re.sub(rb'\D', b'', zone)
    if not digits:
        return 0
    sign = -1 if zone.startswith(b'-') else 1
    return sign * (int(digits[:2]) * 3600 + int(digits[2:] or b'0') * 60)
