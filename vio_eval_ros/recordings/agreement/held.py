"""Orientations that stand still for a part of the run though the body turns: never filled in."""

from __future__ import annotations

import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.orientations import finite, usable, why_positions_only
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.recordings.agreement.pairs import NAMES, noted, Sides

#: poses in a row that have one orientation, exactly; fewer are rounding
LONGEST_CHANCE = 10
#: of how many poses, and of what share of all, it matters
FEWEST, SHARE = 20, 0.05
#: by how much the other side turns meanwhile
TURNED_DEG = 5.0
#: stretches that are looked at, the longest ones
MOST_STRETCHES = 500


def with_held_orientations(sides: Sides, config: EvaluationConfig) -> Sides:
    """Return both sides, with a sentence where orientations of one were not filled in."""
    if any(side.poses.rotations is None or why_positions_only(side.poses) for side in sides):
        return sides
    offset_ns = nanoseconds(config.time_offset_s)
    estimate, truth = sides
    return (
        noted(estimate, _sentence(estimate.spec, estimate.poses, truth.poses, offset_ns, 1)),
        noted(truth, _sentence(truth.spec, truth.poses, estimate.poses, -offset_ns, 0)),
    )


def _sentence(spec: str, poses: Poses, other: Poses, shift_ns: int, which: int) -> str:
    """
    Return what to know of orientations that are held; empty where none are.

    :param shift_ns: is added to the stamps of the poses to compare them with the other side.
    :param which: of NAMES the other side is.
    """
    rows, begin, end = _stretches(poses)
    if not len(begin):
        return ''
    turned = _turned(other, poses.stamps_ns[rows][begin] + shift_ns,
                     poses.stamps_ns[rows][end - 1] + shift_ns)  # fmt: skip
    begin, end, turned = (each[turned > TURNED_DEG] for each in (begin, end, turned))
    count = int((end - begin).sum())
    if count < max(FEWEST, SHARE * len(rows)):
        return ''
    longest = int((end - begin).argmax())
    assert poses.rotations is not None
    held = ' '.join(f'{value:g}' for value in poses.rotations[rows[begin[longest]]])
    first_s, last_s = (poses.stamps_ns[rows[k]] / 1e9 for k in (begin[0], end[-1] - 1))
    return (
        f'{spec}: {count} of {len(rows)} poses, from {first_s:.2f} to {last_s:.2f} s, repeat the '
        f'orientation of the one before (such as {held}) while the {NAMES[which]} turns by '
        f'{float(turned.max()):.3g} deg: not filled in? Figures of rotation, and of the motion '
        'between poses, count them'
    )


def _stretches(poses: Poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the usable rows by their stamps, and where orientations are held: begin and end."""
    nothing = np.empty(0, np.int64)
    assert poses.rotations is not None
    rows = np.flatnonzero(finite(poses.positions) & usable(poses.rotations))
    rows = rows[np.argsort(poses.stamps_ns[rows], kind='stable')]
    rotations, positions = poses.rotations[rows], poses.positions[rows]
    held = rotations[1:, 3] == rotations[:-1, 3]
    if np.count_nonzero(held) < FEWEST:  # nearly always, and found in a moment
        return rows, nothing, nothing
    held &= (rotations[1:] == rotations[:-1]).all(axis=1)
    held &= (positions[1:] != positions[:-1]).any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(np.int8), [0]])))
    begin, end = edges[::2], edges[1::2] + 1
    long = end - begin >= LONGEST_CHANCE
    begin, end = begin[long], end[long]
    longest = np.sort(np.argsort(begin - end, kind='stable')[:MOST_STRETCHES])
    return rows, begin[longest], end[longest]


def _turned(other: Poses, first_ns: np.ndarray, last_ns: np.ndarray) -> np.ndarray:
    """Return (M,) degrees by which a side turns at most within each of M times."""
    assert other.rotations is not None
    rows = np.flatnonzero(finite(other.positions) & usable(other.rotations))
    rows = rows[np.argsort(other.stamps_ns[rows], kind='stable')]
    stamps_ns, rotations = other.stamps_ns[rows], rotation.normalize(other.rotations[rows])
    begin = np.searchsorted(stamps_ns, first_ns)
    end = np.searchsorted(stamps_ns, last_ns, side='right')
    angles = []
    for i, j in zip(begin, end, strict=True):
        apart = rotation.angle_between(rotations[i:j], rotations[i : i + 1])
        angles.append(math.degrees(apart.max(initial=0)))
    return np.array(angles)
