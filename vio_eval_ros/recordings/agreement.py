"""
What an estimate and its ground truth settle between them: how each was meant to be read.

A text file does not say the unit of its stamps or positions, nor, often, the order of its
quaternions. Two sides of one run do: only under the right reading do they agree. Where they do not
tell, the rule of the layout holds, or the user is asked; what the user states is never changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
import math
from typing import NamedTuple, NoReturn

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Alignment, Moments, SCALED_MODES, solve
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.matching import nearest
from vio_eval_ros.core.orientations import finite, usable, why_positions_only
from vio_eval_ros.core.trajectory import Pairs, Poses, Trajectory
from vio_eval_ros.errors import ReadError, VioEvalError
from vio_eval_ros.recordings.columns import STAMPS, stated_columns
from vio_eval_ros.recordings.layouts import Reading
from vio_eval_ros.recordings.rows import STAMP_UNITS
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.recordings.spec import LENGTH_UNITS, Spec, with_statement

NAMES = ('estimate', 'ground truth')
#: pairs of which two sides are compared, evenly over the run, and the fewest that tell anything
MOST_PAIRS, FEWEST_PAIRS = 2000, 10
#: of the extent of the path, the error under which positions are of one run
SAME_PATH = 0.3
#: the angle within which orientations keep their relation, in the median ...
CONSTANT_DEG = 20.0
#: ... and the one that does not matter
RESOLVED_DEG = 0.3
#: ... and the one within which a rule gives way
DEPARTING_DEG = 10.0
#: the rotation between two bodies that are meant to be one
SAME_BODY_DEG = 10.0
#: ... and the one that makes a rule doubtful, where the other order has less than that
DOUBTFUL_DEG = 90.0
#: how many times as far off any other reading is
CLEARLY = 3.0
#: how near to a power of ten a scale is that comes from a unit
UNIT_TOLERANCE = 0.03
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
#: m/s, beyond which a body in front of cameras does not move in the mean
FASTEST_M_S = 150.0

Sides = tuple[Source, Source]


def settled(estimate: Source, truth: Source, config: EvaluationConfig | None = None) -> Sides:
    """
    Return both sides as they were meant, with a sentence for whatever was taken.

    :param config: its offset is added to the stamps of the estimate.
    :raises ReadError: something is open that the two do not settle; the message says what to
        state.
    """
    config = config or EvaluationConfig()
    sides = _with_units_of_stamps((estimate, truth), config)
    sides = _with_orders(sides, config)
    return _with_units_of_positions(sides, config)


def assumed(estimate: Source, truth: Source) -> tuple[str, ...]:
    """Return what was taken for granted when both sides were read, each sentence once."""
    return tuple(dict.fromkeys([*estimate.warnings, *truth.warnings]))


# -- pairs ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Matched:
    """
    Poses of both sides at the same time, and how their worlds lie to each other.

    :param rows: (N,) of the estimate, and of the ground truth.
    :param alignment: sim3 of the positions.
    :param misfit: the error that it leaves, as a share of the extent of the path.
    """

    rows: tuple[np.ndarray, np.ndarray]
    alignment: Alignment
    misfit: float

    @property
    def one_path(self) -> bool:
        """Whether the positions are of one run, and determine the alignment."""
        return self.alignment.observable and self.misfit < SAME_PATH


def _matched(estimate: Poses, truth: Poses, config: EvaluationConfig) -> _Matched | None:
    """Return poses at the same time, at most MOST_PAIRS; None where there are too few."""
    sides = (estimate, truth)
    orders = [np.flatnonzero(finite(side.positions)) for side in sides]
    orders = [
        rows[np.argsort(side.stamps_ns[rows], kind='stable')]
        for rows, side in zip(orders, sides, strict=True)
    ]
    if min(map(len, orders)) < FEWEST_PAIRS:
        return None
    stamps = [side.stamps_ns[rows] for rows, side in zip(orders, sides, strict=True)]
    stamps[0] = stamps[0] + nanoseconds(config.time_offset_s)
    few = int(len(stamps[1]) < len(stamps[0]))
    chosen = np.flatnonzero(
        (stamps[few] >= stamps[1 - few][0]) & (stamps[few] <= stamps[1 - few][-1])
    )
    if len(chosen) > MOST_PAIRS:
        chosen = chosen[np.linspace(0, len(chosen) - 1, MOST_PAIRS).astype(int)]
    partner = nearest(stamps[few][chosen], stamps[1 - few])
    apart = np.abs(stamps[few][chosen] - stamps[1 - few][partner])
    near = apart <= nanoseconds(config.max_difference_s)
    if np.count_nonzero(near) < FEWEST_PAIRS:
        return None
    places = (chosen[near], partner[near])
    rows = (orders[0][places[few]], orders[1][places[1 - few]])
    one, other = (
        Trajectory(side.stamps_ns[each], side.positions[each])
        for side, each in zip(sides, rows, strict=True)
    )
    pairs = Pairs(one, other)
    moments = Moments.of(pairs)
    alignment = solve('sim3', moments, pairs[:1])
    extent = math.sqrt(float(np.trace(moments.truth_scatter)) / moments.count)
    error = math.sqrt(alignment.mean_square(moments)) if math.isfinite(alignment.scale) else 0.0
    return _Matched(rows, alignment, error / extent if extent else math.inf)


# -- the order of quaternions --------------------------------------------------------------------

#: the ways to read one side, and which of them is taken of each
Ways = Sequence[Reading]
Choice = tuple[int, ...]


def _with_orders(sides: Sides, config: EvaluationConfig) -> Sides:
    """Return both sides in one reading each."""
    ways = [side.readings or _stated_and_other(side) for side in sides]
    if max(map(len, ways)) == 1:
        return sides
    ways = [
        each if len(each) > 1 else _named_and_others(side, each[0])
        for side, each in zip(sides, ways, strict=True)
    ]
    relations = _relations(ways, config)
    choice = _choice(ways, relations)
    if choice is None:
        _check_usual(sides, relations)
    settled = []
    for k, side in enumerate(sides):
        note, taken = '', ways[k][0] if choice is None else ways[k][choice[k]]
        if choice is not None and not taken.usual:
            shown = _shown(choice, k, relations=relations, other=NAMES[1 - k])
            if side.readings:
                spec = with_statement(side.spec, taken.statement)
                note = (
                    f'{side.spec}: read with {taken.statement}, {shown}; to state it, write {spec}'
                )
            else:
                said = 'stated' if side.paths else 'the order of rotations'
                what = ways[k][0].statement or 'the order of its quaternions'
                said = said if ways[k][0].statement else 'given'
                note = f'{side.spec}: {what} is {said}, but not {shown}'
                taken = ways[k][0]
        elif choice is not None and side.readings:
            note = _doubt(side, choice, k, relations=relations)
        elif choice is None and not taken.usual:
            note = _undecided(side, NAMES[1 - k], comparable=bool(relations))
        settled.append(_noted(replace(side, poses=taken.poses, readings=()), note))
    return settled[0], settled[1]


def alone(source: Source) -> Source:
    """
    Return a source that is read before there is another side, by the rule of its layout.

    :raises ReadError: it has no rule; what is open has to be stated.
    """
    if source.readings and not source.readings[0].usual:
        _undecided(source, 'estimate', comparable=True)
    return replace(source, readings=())


def _noted(source: Source, note: str) -> Source:
    """Return a source with one more sentence before all others; an empty one is none."""
    return replace(source, warnings=(note, *source.warnings)) if note else source


def _stated_and_other(side: Source) -> tuple[Reading, ...]:
    """Return the reading that is stated, as it is of arrays, and the one with the other order."""
    statements = Spec.parse(side.spec).statements if side.paths else {'quaternion': 'xyzw'}
    stated, rotations = statements.get('quaternion'), side.poses.rotations
    only = Reading('', side.poses, usual=True)
    if stated is None or rotations is None or 'invert' in statements:
        return (only,)
    other, turn = ('wxyz', -1) if stated == 'xyzw' else ('xyzw', 1)
    turned = replace(side.poses, rotations=np.roll(rotations, turn, axis=1))
    return (
        only._replace(statement=f'quaternion={stated}'),
        Reading(f'quaternion={other}', turned),
    )


def _named_and_others(side: Source, named: Reading) -> tuple[Reading, ...]:
    """Return a reading whose order a header or message names, and those if the name is wrong."""
    rotations = side.poses.rotations
    if rotations is None or 'invert' in _statements(side):
        return (named,)
    others = (
        Reading('', replace(side.poses, rotations=np.roll(rotations, turn, axis=1)))
        for turn in (1, -1)
    )
    return (named, *others)


def _statements(side: Source) -> Mapping[str, str]:
    return Spec.parse(side.spec).statements if side.paths else {}


class _Relation(NamedTuple):
    """
    The rotation between estimated and true orientations.

    :param spread_deg: the median angle to its mean; infinite where it is not known.
    :param turn_deg: of the mean.
    """

    spread_deg: float = math.inf
    turn_deg: float = math.inf


def _relations(ways: Sequence[Ways], config: EvaluationConfig) -> dict[Choice, _Relation]:
    """Return the relation for each choice of readings; none where there is nothing to compare."""
    known = _matched(ways[0][0].poses, ways[1][0].poses, config)
    if known is None:
        return {}
    relations = {}
    for choice in product(*(range(len(each)) for each in ways)):
        one, other = (each[k].poses for each, k in zip(ways, choice, strict=True))
        first = (each[0].poses for each in ways)
        if any(
            not np.array_equal(poses.positions, usual.positions)
            for poses, usual in zip((one, other), first, strict=True)
        ):  # inverted poses, whose positions depend on their orientations
            found = _matched(one, other, config)
        else:
            found = known
        compared = [one[known.rows[0]], other[known.rows[1]]]
        if any(poses.rotations is None or why_positions_only(poses) for poses in compared):
            return {}
        relations[choice] = _Relation() if found is None else _relation(one, other, found)
    return relations


def _relation(estimate: Poses, truth: Poses, matched: _Matched) -> _Relation:
    """
    Return the rotation from the estimate's orientations to the true ones.

    The worlds are those that the positions show, and a sensor that is mounted otherwise, a
    constant rotation, is allowed for.
    """
    if not matched.one_path:
        return _Relation()
    sides = [
        poses.rotations[rows]  # type: ignore[index]
        for poses, rows in zip((estimate, truth), matched.rows, strict=True)
    ]
    known = usable(sides[0]) & usable(sides[1])
    if np.count_nonzero(known) < FEWEST_PAIRS:
        return _Relation()
    one, other = (rotation.normalize(side[known]) for side in sides)
    world = rotation.multiply(matched.alignment.rotation, one)
    relative = rotation.multiply(rotation.conjugate(world), other)
    # the mean rotation (Markley et al. 2007), whatever the signs of the quaternions
    mean = np.linalg.eigh(relative.T @ relative)[1][:, -1]
    off = float(np.median(rotation.angle_between(relative, mean)))
    return _Relation(math.degrees(off), math.degrees(float(rotation.angle(mean))))


def _agreeing(relations: dict[Choice, _Relation]) -> list[Choice]:
    """Return the choices of readings under which the relation is constant, as far as any is."""
    best = min((one.spread_deg for one in relations.values()), default=math.inf)
    if not best < CONSTANT_DEG:
        return []
    limit = CLEARLY * max(best, RESOLVED_DEG)
    return [choice for choice, one in relations.items() if one.spread_deg < limit]


def _choice(ways: Sequence[Ways], relations: dict[Choice, _Relation]) -> Choice | None:
    """
    Return which readings the two sides settle on; None where they do not.

    Where several agree equally well, as where both sides could be misread alike, it is the one
    that follows the rules of the layouts; then, of orientations that change, the only one under
    which both sides have the same body.
    """
    agreeing = _agreeing(relations)

    def departures(choice: Choice) -> int:
        """Return how many sides have a rule that is not followed."""
        return sum(ways[k][0].usual and not ways[k][taken].usual for k, taken in enumerate(choice))

    fewest = min(map(departures, agreeing), default=0)
    left = [choice for choice in agreeing if departures(choice) == fewest]
    if fewest and min(relations[choice].spread_deg for choice in left) > DEPARTING_DEG:
        return None
    if len(left) > 1 and len(agreeing) < len(relations):
        turns = sorted((relations[choice].turn_deg, choice) for choice in left)
        if turns[0][0] < SAME_BODY_DEG and turns[1][0] > CLEARLY * SAME_BODY_DEG:
            return turns[0][1]
    return left[0] if len(left) == 1 else None


def _check_usual(sides: Sides, relations: dict[Choice, _Relation]) -> None:
    """Raise what to state where orientations agree only under readings that are not usual."""
    agreeing = _agreeing(relations)
    if not agreeing or (0, 0) in agreeing:
        return
    for k, side in enumerate(sides):
        for choice in agreeing:
            if side.readings and choice[k]:
                spec = with_statement(side.spec, side.readings[choice[k]].statement)
                raise ReadError(
                    side.spec,
                    f'its orientations do not fit those of the {NAMES[1 - k]}, unless one side '
                    f'is read otherwise; write {spec}, or state both',
                )


def _shown(choice: Choice, k: int, *, relations: dict[Choice, _Relation], other: str) -> str:
    """Return what shows a reading of one side, in words."""
    others = [
        one.spread_deg
        for each, one in relations.items()
        if each[k] != choice[k] and each[1 - k] == choice[1 - k]
    ]
    return (
        f'as the {other} shows: relative to it orientations vary by '
        f'{relations[choice].spread_deg:.2g} deg, read otherwise by {min(others):.2g} deg'
    )


def _doubt(side: Source, choice: Choice, k: int, *, relations: dict[Choice, _Relation]) -> str:
    """Return that orientations that hardly change would fit in another order; empty if not."""
    agreeing = _agreeing(relations)
    for each in agreeing:
        near, taken = relations[each].turn_deg, relations[choice].turn_deg
        if each[1 - k] == choice[1 - k] and near < SAME_BODY_DEG and taken > DOUBTFUL_DEG:
            return (
                f'{side.spec}: read with {side.readings[choice[k]].statement}, the rule of its '
                f'layout, orientations are {taken:.0f} deg from those of the {NAMES[1 - k]}, and '
                f'with {side.readings[each[k]].statement} {near:.0f} deg'
            )
    return ''


def _open(side: Source) -> str:
    """Return what is open of a side, in words."""
    orders = all(way.statement.startswith('quaternion=') for way in side.readings)
    return 'the order of its quaternions' if orders else 'the meaning of its angles'


def _undecided(side: Source, other: str, *, comparable: bool) -> str:
    """Return what is open of a side; ``ReadError`` where orientations would be compared."""
    specs = ' or '.join(with_statement(side.spec, way.statement) for way in side.readings)
    if comparable:
        raise ReadError(
            side.spec,
            f'{_open(side)} is open, and the {other} does not settle it; write {specs}',
        )
    return (
        f'{side.spec}: read with {side.readings[0].statement}, which nothing here confirms; to '
        f'state it, write {specs}'
    )


# -- the unit of stamps --------------------------------------------------------------------------


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


def _with_units_of_stamps(sides: Sides, config: EvaluationConfig) -> Sides:
    """Return both sides with stamps in the units that the two show."""
    if min(map(len, sides)) < FEWEST_PAIRS or not any(map(_has_open_stamps, sides)):
        return sides
    spans = _spans(sides, config)
    counting = [_has_open_stamps(side) and _counts(side) for side in sides]
    if all(counting):
        return _with_frames_said(sides)
    frames = any(counting) and not spans[0].similar(spans[1]) and not _are_one_path(sides, config)
    slow = sorted(span.interval_s for span in spans)
    is_slow = slow[0] > SLOW_TOO_S and slow[1] > SLOW_S and all(map(_whole_seconds, sides))
    if spans[0].share(spans[1]) > APART and not (is_slow or frames):
        return sides
    shown, likely = [], []
    for choice in product(*map(_in_every_unit, sides)):
        chosen = (choice[0], choice[1])
        found = _spans(chosen, config)
        if chosen == sides or not all(span.plausible for span in found):
            continue
        if found[0].contained(found[1]) > CONTAINED and _are_one_path(chosen, config):
            shown.append(chosen)
        elif found[0].share(found[1]) > TOGETHER or (
            found[0].similar(found[1]) and not spans[0].similar(spans[1])
        ):
            likely.append(chosen)
    if len(shown) == 1 and not is_slow:
        return _said(sides, shown[0])
    if frames:
        _refuse_frames(sides[counting.index(True)])
    if shown or likely:
        _ask(sides, spans, (shown or likely)[0])
    return sides


def _spans(sides: Sides, config: EvaluationConfig) -> tuple[_Span, _Span]:
    return _Span.of(sides[0].poses, config.time_offset_s), _Span.of(sides[1].poses, 0.0)


def _are_one_path(sides: Sides, config: EvaluationConfig) -> bool:
    found = _matched(sides[0].poses, sides[1].poses, config)
    return found is not None and found.one_path


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
        else _noted(
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
    changed = [way for side, way in zip(sides, chosen, strict=True) if way is not side]
    lasts = [f'{span.last_s - span.first_s:.6g} s' for span in spans]
    units = ' and '.join(f'{_unit(way)}: {way.spec}' for way in changed)
    raise ReadError(
        next(side.spec for side, way in zip(sides, chosen, strict=True) if way is not side),
        f'are its stamps in seconds? Most of the estimate lasts {lasts[0]}, most of the ground '
        f'truth {lasts[1]}; state the unit of stamps, such as {units}',
    )


def _with_frames_said(sides: Sides) -> Sides:
    """Return two sides that count, noting it where they count frames."""
    if not all(side.stamps_ns[0] <= 10**9 and _step_ns(side) == 10**9 for side in sides):
        return sides
    note = (
        f'{sides[0].spec}: the stamps of both sides count 1, 2, 3: if they are frame numbers, '
        'every second here is a frame; write their times instead'
    )
    return _noted(sides[0], note), sides[1]


def _refuse_frames(side: Source) -> NoReturn:
    """Raise that the stamps of a side are frame numbers."""
    numbers = ', '.join(str(stamp) for stamp in (side.stamps_ns[:3] // 10**9).tolist())
    raise ReadError(
        side.spec,
        f'its stamps {numbers} ... are frame numbers, as it seems; write the time of each frame '
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


# -- the unit of positions -----------------------------------------------------------------------


def _with_units_of_positions(sides: Sides, config: EvaluationConfig) -> Sides:
    """Return both sides; ``ReadError`` where one has positions in mm or cm, as the other shows."""
    known = _matched(sides[0].poses, sides[1].poses, config)
    if known is None or not known.one_path:
        return sides
    sides = _with_speed_said(sides, known)
    for unit, metres in LENGTH_UNITS.items():
        for k, scale in enumerate((metres, 1 / metres)):
            if metres < 1 and abs(known.alignment.scale / scale - 1) < UNIT_TOLERANCE:
                return _in_another_unit(sides, k, unit, config)
    return sides


def _with_speed_said(sides: Sides, matched: _Matched) -> Sides:
    """Return both sides, noting where both are too fast to be in metres."""
    speeds = []
    for side, rows in zip(sides, matched.rows, strict=True):
        seconds = np.diff(side.stamps_ns[rows]) / 1e9
        moved = rotation.lengths(np.diff(side.positions[rows], axis=0))
        later = seconds > 0
        speeds.append(float(np.median(moved[later] / seconds[later])) if later.any() else 0.0)
    if min(speeds) < FASTEST_M_S or any(
        'unit' in Spec.parse(one.spec).statements for one in sides
    ):
        return sides
    note = (
        f'both sides move at {min(speeds):.0f} m/s in the median: positions in mm? Then append '
        '?unit=mm to both'
    )
    return _noted(sides[0], note), sides[1]


def _in_another_unit(sides: Sides, k: int, unit: str, config: EvaluationConfig) -> Sides:
    """Return the sides with a note that one has another unit, or raise it."""
    side, statements = (
        sides[k],
        [Spec.parse(each.spec).statements for each in sides if each.paths],
    )
    found = (
        f'its path is {1 / LENGTH_UNITS[unit]:.0f} times as large as that of the {NAMES[1 - k]}: '
        f'positions in {unit}?'
    )
    # of what was stated, and of a scale that is fitted, it is only said
    fitted = k == 0 and config.alignment in SCALED_MODES
    if fitted or not side.paths or any('unit' in stated for stated in statements):
        noted = _noted(side, f'{side.spec}: {found}')
        return (noted, sides[1]) if k == 0 else (sides[0], noted)
    ways = [with_statement(side.spec, f'unit={unit}')]
    if unit == 'mm':
        ways.append(with_statement(sides[1 - k].spec, 'unit=km'))
    as_is = with_statement(side.spec, 'unit=m')
    raise ReadError(side.spec, f'{found} Write {" or ".join(ways)}, or {as_is} to leave them so')
