"""Text files whose rows are those of several bodies, which some column tells apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.advice import shown
from vio_eval_ros.recordings.columns import GEODETIC, Layout, LEFT_OUT, POSITION, STAMPS
from vio_eval_ros.recordings.rows import as_text, Decimals, Rows
from vio_eval_ros.recordings.spec import quoted
from vio_eval_ros.recordings.text import TextFile

#: of which there are no more, and with at least so many rows each in the mean
MOST_BODIES, FEWEST_ROWS = 200, 3
#: how many times as long the path through all rows is as those of the bodies together
JUMPS = 3.0
#: of the rows, the share that have the stamp of the row before, but of another body
TOGETHER = 0.3
MOST_LISTED = 8
FIRST = 100  # rows that show of most columns that they name nothing


class _Bodies(NamedTuple):
    """
    The bodies that a column tells apart.

    :param names: its different values, as text.
    :param which: (N,) which of them each row has.
    """

    column: int
    names: list[str]
    which: np.ndarray


def of_one_body(file: TextFile, layout: Layout, statements: dict[str, str]) -> TextFile:
    """
    Return a file with the rows of the body that is stated, or all where there is only one.

    :raises ReadError: there are several, or none of that name.
    :raises ConfigError: a body is stated of a file in which no column tells bodies apart.
    """
    found = list(_candidates(file, layout))
    name = statements.get('body')
    if name is None:
        several = next((one for one in found if _take_turns(file, layout, one)), None)
        if several is not None:
            raise ReadError(
                file.path,
                f'its rows are those of {len(several.names)} bodies, which '
                f'{_named(file, several.column)} tells apart ({_shown(several.names)}); append '
                f'?body={quoted(several.names[0])} or another',
            )
        return file
    names = [one for bodies in found for one in bodies.names]
    if not names:
        raise ConfigError(
            f'{file.path}: body chooses one in an export of motion capture, or by a column that '
            'tells bodies apart, and here is none'
        )
    chosen = next((one for one in found if name in one.names), None)
    if chosen is None:
        raise ReadError(
            file.path,
            f"it has no body '{name}' (there are {_shown(names)}){nearest_name(name, names)}",
        )
    mask = chosen.which == chosen.names.index(name)
    exact = {k: Decimals(each.digits[mask], each.decimals[mask]) for k, each in _exact(file)}
    return replace(file, rows=Rows(file.rows.values[mask], exact))


def _exact(file: TextFile) -> Iterable[tuple[int, Decimals]]:
    return file.rows.exact.items()


def _named(file: TextFile, column: int) -> str:
    """Return a column by its number, and its name where it has one."""
    names = file.names or ()
    name = f' ({names[column]})' if column < len(names) and names[column] else ''
    return f'column {column + 1}{name}'


def _shown(names: list[str]) -> str:
    return ', '.join(map(shown, names[:MOST_LISTED])) + ', ...' * (len(names) > MOST_LISTED)


def _candidates(file: TextFile, layout: Layout) -> Iterable[_Bodies]:
    """Return the columns that may name bodies: words or whole numbers, a few different ones."""
    values = file.rows.values
    for column, meant in enumerate(layout.columns):
        if meant.role not in (LEFT_OUT, 'frame'):
            continue
        cells = file.words.get(column, values[:, column])
        if cells.dtype.kind == 'f' and not (_are_whole(cells[:FIRST]) and _are_whole(cells)):
            continue
        different, index = np.unique(cells, return_inverse=True)
        if 2 <= len(different) <= min(MOST_BODIES, len(values) / FEWEST_ROWS):
            names = [
                f'{one:.0f}' if cells.dtype.kind == 'f' else as_text(one)
                for one in different.tolist()
            ]
            yield _Bodies(column, names, index)


def _are_whole(numbers: np.ndarray) -> bool:
    return bool((np.isfinite(numbers) & (numbers % 1 == 0)).all())


def _take_turns(file: TextFile, layout: Layout, bodies: _Bodies) -> bool:
    """Return whether rows jump between bodies: in place, or without any time in between."""
    values = file.rows.values
    place = layout.places(POSITION) or layout.places(GEODETIC) or []
    stamps = [k for k, column in enumerate(layout.columns) if column.role in STAMPS]
    changes = np.diff(bodies.which) != 0
    if stamps:
        same = (np.diff(values[:, stamps], axis=0) == 0).all(axis=1)
        if (same & changes).mean() > TOGETHER:
            return True
    order = np.argsort(bodies.which, kind='stable')
    within = np.diff(bodies.which[order]) == 0
    whole = np.nansum(lengths(np.diff(values[:, place], axis=0)))
    apart = np.nansum(lengths(np.diff(values[order][:, place], axis=0))[within])
    return bool(whole > JUMPS * apart)
