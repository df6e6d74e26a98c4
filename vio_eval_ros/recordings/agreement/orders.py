"""In which order quaternions are written, and what angles mean: orientations that agree tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.orientations import usable, why_positions_only
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.agreement.pairs import (
    FEWEST_PAIRS,
    Matched,
    matched,
    NAMES,
    noted,
    Sides,
    statements_of,
)
from vio_eval_ros.recordings.agreement.weights import refuse_weights
from vio_eval_ros.recordings.layouts import Reading
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.recordings.spec import with_statement

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

#: the ways to read one side, and which of them is taken of each
Ways = Sequence[Reading]
Choice = tuple[int, ...]


def with_orders(sides: Sides, config: EvaluationConfig) -> Sides:
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
        rule, note = ways[k][0], ''
        taken = rule if choice is None else ways[k][choice[k]]
        if choice is None:
            if not rule.usual:
                note = _undecided(side, NAMES[1 - k], comparable=bool(relations))
        elif not taken.usual:
            shown = _shown(choice, k, relations=relations, other=NAMES[1 - k])
            note = _departure(side, rule, taken, shown)
            taken = taken if side.readings else rule  # what is stated is never changed
        elif side.readings:
            note = _doubt(side, choice, k, relations=relations)
        order = taken.order or side.order
        settled.append(noted(replace(side, poses=taken.poses, readings=(), order=order), note))
    return settled[0], settled[1]


def alone(source: Source) -> Source:
    """
    Return a source that is read before there is another side, by the rule of its layout.

    :raises ReadError: it has no rule; what is open has to be stated.
    :raises ConfigError: its spec asks for weights, which are of a comparison.
    """
    refuse_weights(source)
    if not source.readings:
        return source
    taken = source.readings[0]
    if not taken.usual:
        _undecided(source, 'estimate', comparable=True)
    if len(source.readings) < 2 or not taken.statement:
        return replace(source, readings=())
    others = ' or '.join(with_statement(source.spec, way.statement) for way in source.readings[1:])
    note = f'{source.spec}: read with {taken.statement}, as such files are; if not, write {others}'
    return replace(source, readings=(), warnings=(*source.warnings, note))


def _stated_and_other(side: Source) -> tuple[Reading, ...]:
    """Return the reading that is stated, as it is of arrays, and the one with the other order."""
    statements = statements_of(side) if side.paths else {'quaternion': 'xyzw'}
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
    if rotations is None or 'invert' in statements_of(side):
        return (named,)
    meant = {('xyzw', -1): 'wxyz', ('wxyz', 1): 'xyzw'}
    others = (
        Reading(
            '',
            replace(side.poses, rotations=np.roll(rotations, turn, axis=1)),
            order=meant.get((side.order, turn), ''),
        )
        for turn in (1, -1)
    )
    return (named, *others)


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
    known = matched(ways[0][0].poses, ways[1][0].poses, config)
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
            found = matched(one, other, config)
        else:
            found = known
        compared = [one[known.rows[0]], other[known.rows[1]]]
        if any(poses.rotations is None or why_positions_only(poses) for poses in compared):
            return {}
        relations[choice] = _Relation() if found is None else _relation(one, other, found)
    return relations


def _relation(estimate: Poses, truth: Poses, matched: Matched) -> _Relation:
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
                statement = side.readings[choice[k]].statement
                raise ReadError(
                    side.spec,
                    f'its orientations do not fit those of the {NAMES[1 - k]}, unless one side '
                    'is read otherwise; write '
                    f'{with_statement(side.spec, statement)}, or state both',
                )


def _departure(side: Source, rule: Reading, taken: Reading, shown: str) -> str:
    """Return that a side is read against its rule, or that what is stated of it is doubtful."""
    if side.readings:
        spec = with_statement(side.spec, taken.statement)
        return f'{side.spec}: read with {taken.statement}, {shown}; to state it, write {spec}'
    if not rule.statement:
        doubt = f'{side.spec}: the order of its quaternions is given, but not {shown}'
        if not taken.order:
            return doubt
        spec = with_statement(side.spec, f'quaternion={taken.order}')
        return f'{doubt}; to read it so, write {spec}'
    said = 'stated' if side.paths else 'the order of rotations'
    return f'{side.spec}: {rule.statement} is {said}, but not {shown}'


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
