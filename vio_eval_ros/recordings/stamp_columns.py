"""The stamps of a text file: in one column, in two, or in a file beside it; and their unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.columns import Column, places, TIMES
from vio_eval_ros.recordings.rows import Decimals, LATEST_NS, per_second, POWERS, STAMP_UNITS
from vio_eval_ros.recordings.stamps import padded
from vio_eval_ros.recordings.text import TextFile

#: stamps below it do not count from 1970, so their size does not show their unit
EARLIEST_S = 1e8
#: between poses; longer ones are counted in a smaller unit
LONGEST_STEP_S = 30.0


def read_stamps(
    file: TextFile,
    columns: Sequence[Column],
    usual: str,
    statements: Mapping[str, str],
    notes: list[str],
) -> np.ndarray:
    """
    Return the stamps in the columns of a file as (N,) int64 nanoseconds.

    :param usual: the unit that files of its kind have; another one is noted.
    :param statements: what the user stated of the file.
    """
    at = places(columns)
    if 'sec' in at and 'nsec' in at:
        if 'stamps' in statements:
            raise ConfigError(
                f'{file.path}: stamps does not apply, seconds and nanoseconds are apart'
            )
        return _joined(file, at['sec'], at['nsec'], columns[at['nsec']].unit or 'ns')
    role, unit = next((r, u) for r, u in (('t', None), ('sec', 's'), ('nsec', 'ns')) if r in at)
    exact = _exact(file, at[role])
    named = columns[at[role]].unit or unit
    unit = statements.get('stamps') or _unit(file, exact, named, usual, notes)
    meant = padded(exact) if unit == 's' else None
    if meant is not None:
        notes.append(
            f'{file.path}: the fractions of its stamps had lost their leading zeros, as where '
            'seconds and nanoseconds are printed one after the other; they are read with these '
            'zeros'
        )
    return (meant or exact).nanoseconds(file.path, unit)


def _exact(file: TextFile, column: int) -> Decimals:
    found = file.rows.exact.get(column)
    if found is None:
        raise ReadError(
            file.path, f'column {column + 1} is too large for stamps, or holds no numbers'
        )
    return found


def _joined(file: TextFile, sec: int, nsec: int, unit: str) -> np.ndarray:
    """Return stamps whose seconds are apart from their parts, nanoseconds as a rule."""
    whole, rest = _exact(file, sec), _exact(file, nsec)
    if has_fractions(whole) or has_fractions(rest):
        raise ReadError(
            file.path,
            f'columns {sec + 1} and {nsec + 1} are taken for seconds and nanoseconds, but have '
            f'fractions; state which is the stamp, such as {_left_out(sec)}t,...',
        )
    rest_ns = rest.nanoseconds(file.path, unit)
    if rest_ns.min() < 0 or rest_ns.max() >= per_second('ns'):
        raise ReadError(
            file.path,
            f'column {nsec + 1} is taken for {unit} beside the seconds in column {sec + 1}, '
            f'but is not within 0 and {per_second(unit) - 1}',
        )
    return np.asarray(whole.nanoseconds(file.path, 's') + rest_ns)


def _left_out(count: int) -> str:
    return '?columns=' + '_,' * count


def has_fractions(exact: Decimals) -> bool:
    """Return whether some numbers are not whole ones."""
    if not exact.decimals.any():
        return False
    shift = exact.decimals.clip(max=18)
    return bool((exact.digits % 10**shift).any())


def _unit(file: TextFile, exact: Decimals, named: str | None, usual: str, notes: list[str]) -> str:
    """Return the unit that stamps are in, by their name, kind, size, or the steps between them."""
    likely = exact.likely_unit
    if usual == 'ns':
        # what counts nanoseconds has no fractions
        unit = 's' if likely == 's' and has_fractions(exact) else 'ns'
    elif named and TIMES.index(likely) <= TIMES.index(named):
        return named
    elif likely != 's' or exact.largest >= EARLIEST_S:
        unit = likely
    else:
        return _by_steps(file, exact, notes)
    if unit != (named or usual):
        notes.append(
            f'{file.path}: stamps are read as {unit}, not {named or usual}, by their size'
        )
    return unit


def _by_steps(file: TextFile, exact: Decimals, notes: list[str]) -> str:
    """
    Return the unit of stamps since a start: seconds, where they are not too large for these.

    Whether they are shows beside the other side of a run only.
    """
    values = exact.digits / POWERS[exact.decimals]
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0]
    step = float(np.median(steps)) if len(steps) else 0.0
    if exact.largest * POWERS[STAMP_UNITS['s']] <= LATEST_NS:
        return 's'
    unit = next((one for one in TIMES if step / per_second(one) <= LONGEST_STEP_S), 'ns')
    notes.append(
        f'{file.path}: stamps are read as {unit}, not s, by the steps between them; append '
        '?stamps=s if they are seconds'
    )
    return unit
