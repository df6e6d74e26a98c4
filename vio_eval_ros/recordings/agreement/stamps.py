"""In which unit stamps are written: as long as the other side lasts, and as fast as it moves."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import NamedTuple, NoReturn

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError, VioEvalError
from vio_eval_ros.recordings.agreement.pairs import are_one_path, FEWEST_PAIRS, NAMES, noted, Sides
from vio_eval_ros.recordings.columns import STAMPS, stated_columns
from vio_eval_ros.recordings.rows import STAMP_UNITS
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.recordings.spec import Spec, with_statement

#: share of the time of both that they have in common: less than any two of one run have ...
APART = 0.01
#: ... and as much as most have
TOGETHER = 0.3
#: and of the shorter one, where the motions show that it is a part of the other
CONTAINED = 0.5
#: intervals between poses of any estimate or ground truth
SHORTEST_S, LONGEST_S = 2e-4, 30.0
#: intervals of one side, and of the other, above which both may count something shorter
SLOW_S, SLOW_TOO_S = 10.0, 1.0
#: frame numbers begin below this, and those of keyframes are no further apart than this
LARGEST_FIRST_FRAME, LARGEST_FRAME_STEP = 10**7, 40


class _Span(NamedTuple):
    """The time of most poses of a side [s], and the mean interval between them."""

    first_s: float
    last_s: float
    interval_s: float

    @classmethod
    def of(cls, poses: Poses, offset_s: float) -> _Span:
        """Return the span without the earliest and latest twentieth, stray or never set."""
        stamps = np.sort(poses.stamps_ns)
        cut = len(stamps) // 20
        inner = stamps[cut : len(stamps) - cut] / 1e9 + offset_s
        seconds = float(inner[-1] - inner[0])
        return cls(float(inner[0]), float(inner[-1]), seconds / max(len(inner) - 1, 1))

    @property
    def plausible(self) -> bool:
        """Whether poses come as fast as they do of some sensor."""
        return SHORTEST_S < self.interval_s < LONGEST_S

    def share(self, other: _Span) -> float:
        """Return the time that both have, over that which either has."""
        both = min(self.last_s, other.last_s) - max(self.first_s, other.first_s)
        either = max(self.last_s, other.last_s) - min(self.first_s, other.first_s)
        return max(both, 0.0) / either if either else 0.0

    def contained(self, other: _Span) -> float:
        """Return the time that both have, over that of the shorter one."""
        both = min(self.last_s, other.last_s) - max(self.first_s, other.first_s)
        shorter = min(self.last_s - self.first_s, other.last_s - other.first_s)
        return max(both, 0.0) / shorter if shorter > 0 else 0.0

    def similar(self, other: _Span) -> bool:
        """Return whether both last about as long."""
        longer, shorter = sorted((self.last_s - self.first_s, other.last_s - other.first_s))[::-1]
        return longer < 2 * shorter


def with_units_of_stamps(sides: Sides, config: EvaluationConfig) -> Sides:
    """Return both sides with stamps in the units that the two show."""
    if min(map(len, sides)) < FEWEST_PAIRS or not any(map(_has_open_stamps, sides)):
        return sides
    spans = _spans(sides, config)
    counting = [_has_open_stamps(side) and _counts(side) for side in sides]
    if all(counting):
        return _with_frames_said(sides)
    frames = any(counting) and not spans[0].similar(spans[1]) and not are_one_path(sides, config)
    slow = sorted(span.interval_s for span in spans)
    is_slow = slow[0] > SLOW_TOO_S and slow[1] > SLOW_S and all(map(_whole_seconds, sides))
    if spans[0].share(spans[1]) > APART and not (is_slow or frames):
        return sides
    shown, likely = _other_units(sides, spans, config)
    if len(shown) == 1 and not is_slow:
        return _said(sides, shown[0])
    if frames:
        _refuse_frames(sides[counting.index(True)])
    if shown or likely:
        _ask(sides, spans, (shown or likely)[0])
    return sides


def _other_units(
    sides: Sides, spans: Sequence[_Span], config: EvaluationConfig
) -> tuple[list[Sides], list[Sides]]:
    """Return the sides in units under which they are one path, and in those that may be right."""
    shown, likely = [], []
    for choice in product(*map(_in_every_unit, sides)):
        chosen = (choice[0], choice[1])
        found = _spans(chosen, config)
        if chosen == sides or not all(span.plausible for span in found):
            continue
        lasting = found[0].similar(found[1]) and not spans[0].similar(spans[1])
        if found[0].contained(found[1]) > CONTAINED and are_one_path(chosen, config):
            shown.append(chosen)
        elif found[0].share(found[1]) > TOGETHER or lasting:
            likely.append(chosen)
    return shown, likely


def _spans(sides: Sides, config: EvaluationConfig) -> tuple[_Span, _Span]:
    return _Span.of(sides[0].poses, config.time_offset_s), _Span.of(sides[1].poses, 0.0)


def _has_open_stamps(side: Source) -> bool:
    """Return whether the unit of a side's stamps is neither stated nor known."""
    if len(side.paths) != 1 or not side.paths[0].is_file():
        return False  # arrays, a pipe, or times beside it
    spec = Spec.parse(side.spec)
    columns = spec.statements.get('columns')
    in_unit = columns is not None and any(
        column.role in STAMPS and column.unit for column in stated_columns(columns)
    )
    return spec.topic is None and 'stamps' not in spec.statements and not in_unit


def _in_every_unit(side: Source) -> list[Source]:
    """Return a side as it was read, and read again with its stamps in each other unit."""
    ways = [side]
    for unit in STAMP_UNITS if _has_open_stamps(side) else ():
        with suppress(VioEvalError):  # too large to be this unit
            way = read_sources([with_statement(side.spec, f'stamps={unit}')])[0]
            if not np.array_equal(way.stamps_ns, side.stamps_ns):
                ways.append(way)
    return ways


def _said(sides: Sides, chosen: Sides) -> Sides:
    """Return the sides as chosen, named as they were, with what was taken."""
    settled = [
        side
        if way is side
        else noted(
            replace(way, spec=side.spec),
            f'{side.spec}: stamps are read as {_unit(way)}, as the {NAMES[1 - k]} shows; to state '
            f'it, write {way.spec}',
        )
        for k, (side, way) in enumerate(zip(sides, chosen, strict=True))
    ]
    return settled[0], settled[1]


def _unit(side: Source) -> str:
    return Spec.parse(side.spec).statements['stamps']


def _ask(sides: Sides, spans: Sequence[_Span], chosen: Sides) -> NoReturn:
    """Raise what would have to be stated for the stamps of the two to fit."""
    changed = [k for k, way in enumerate(chosen) if way is not sides[k]]
    lasts = [f'{span.last_s - span.first_s:.6g} s' for span in spans]
    written = ' and '.join(chosen[k].spec for k in changed)
    as_is = ' and '.join(with_statement(sides[k].spec, 'stamps=s') for k in changed)
    raise ReadError(
        sides[changed[0]].spec,
        f'its stamps are hardly in seconds: read so, most of the estimate lasts {lasts[0]}, most '
        f'of the ground truth {lasts[1]}; write {written}, or {as_is} to leave them so',
    )


def _with_frames_said(sides: Sides) -> Sides:
    """Return two sides that count, noting it where they count frames."""
    if not all(side.stamps_ns[0] <= 10**9 and _step_ns(side) == 10**9 for side in sides):
        return sides
    note = (
        f'{sides[0].spec}: the stamps of both sides count 1, 2, 3: if they are frame numbers, '
        'every second here is a frame; write their times instead'
    )
    return noted(sides[0], note), sides[1]


def _refuse_frames(side: Source) -> NoReturn:
    """Raise that the stamps of a side are frame numbers."""
    numbers = ', '.join(str(stamp) for stamp in (side.stamps_ns[:3] // 10**9).tolist())
    raise ReadError(
        side.spec,
        f'its stamps {numbers} ... look like frame numbers; write the time of each frame '
        'in seconds instead, or leave them out and give the times with --times FILE '
        f'(if they are seconds, {with_statement(side.spec, "stamps=s")})',
    )


def _counts(side: Source) -> bool:
    """Return whether stamps are whole numbers that grow from not much more than zero."""
    first = int(side.stamps_ns[0])
    if not (0 <= first < LARGEST_FIRST_FRAME * 10**9 and _whole_seconds(side)):
        return False
    return 10**9 <= _step_ns(side) <= LARGEST_FRAME_STEP * 10**9


def _step_ns(side: Source) -> float:
    return float(np.median(np.diff(side.stamps_ns)))


def _whole_seconds(side: Source) -> bool:
    return not (side.stamps_ns % 10**9).any()
