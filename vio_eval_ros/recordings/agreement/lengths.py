"""In which unit positions are written: the scale of one path against the other shows it."""

from __future__ import annotations

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import SCALED_MODES
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.statistics import median
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.agreement.pairs import Matched, matched, NAMES, noted, Sides
from vio_eval_ros.recordings.spec import LENGTH_UNITS, Spec, with_statement

#: how near to a power of ten a scale is that comes from a unit
UNIT_TOLERANCE = 0.03
#: m/s, beyond which a body in front of cameras does not move in the mean
FASTEST_M_S = 150.0


def with_units_of_positions(sides: Sides, config: EvaluationConfig) -> Sides:
    """Return both sides; ``ReadError`` where one has positions in mm or cm, as the other shows."""
    known = matched(sides[0].poses, sides[1].poses, config)
    if known is None or not known.one_path:
        return sides
    sides = _with_speed_said(sides, known)
    for unit, metres in LENGTH_UNITS.items():
        for k, scale in enumerate((metres, 1 / metres)):
            if metres < 1 and abs(known.alignment.scale / scale - 1) < UNIT_TOLERANCE:
                return _in_another_unit(sides, k, unit, config)
    return sides


def _with_speed_said(sides: Sides, matched: Matched) -> Sides:
    """Return both sides, noting where both are too fast to be in metres."""
    speeds = []
    for side, rows in zip(sides, matched.rows, strict=True):
        seconds = np.diff(side.stamps_ns[rows]) / 1e9
        moved = rotation.lengths(np.diff(side.positions[rows], axis=0))
        later = seconds > 0
        speeds.append(median(moved[later] / seconds[later]) if later.any() else 0.0)
    if min(speeds) < FASTEST_M_S or any(
        'unit' in Spec.parse(one.spec).statements for one in sides
    ):
        return sides
    note = (
        f'both sides move at {min(speeds):.0f} m/s in the median: positions in mm? Then append '
        '?unit=mm to both'
    )
    return noted(sides[0], note), sides[1]


def _in_another_unit(sides: Sides, k: int, unit: str, config: EvaluationConfig) -> Sides:
    """Return the sides with a note that one has another unit, or raise it."""
    side = sides[k]
    statements = [Spec.parse(each.spec).statements for each in sides if each.paths]
    found = (
        f'its path is {1 / LENGTH_UNITS[unit]:.0f} times as large as that of the {NAMES[1 - k]}: '
        f'positions in {unit}?'
    )
    # of what was stated, and of a scale that is fitted, it is only said
    fitted = k == 0 and config.alignment in SCALED_MODES
    if fitted or not side.paths or any('unit' in stated for stated in statements):
        said = noted(side, f'{side.spec}: {found}')
        return (said, sides[1]) if k == 0 else (sides[0], said)
    ways = [with_statement(side.spec, f'unit={unit}')]
    if unit == 'mm':
        ways.append(with_statement(sides[1 - k].spec, 'unit=km'))
    as_is = with_statement(side.spec, 'unit=m')
    raise ReadError(side.spec, f'{found} Write {" or ".join(ways)}, or {as_is} to leave them so')
