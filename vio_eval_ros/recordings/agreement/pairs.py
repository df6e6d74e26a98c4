"""Poses of both sides at the same time, and whether their positions are of one path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math

import numpy as np

from vio_eval_ros.core.alignment import Alignment, Moments, solve
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.matching import nearest
from vio_eval_ros.core.orientations import finite
from vio_eval_ros.core.trajectory import Pairs, Poses, Trajectory
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.recordings.spec import Spec

NAMES = ('estimate', 'ground truth')
#: pairs of which two sides are compared, evenly over the run, and the fewest that tell anything
MOST_PAIRS, FEWEST_PAIRS = 2000, 10
#: of the extent of the path, the error under which positions are of one run
SAME_PATH = 0.3

Sides = tuple[Source, Source]


def noted(source: Source, note: str) -> Source:
    """Return a source with one more sentence before all others; an empty one is none."""
    return replace(source, warnings=(note, *source.warnings)) if note else source


def statements_of(source: Source) -> Mapping[str, str]:
    """Return what the spec of a source states; nothing of arrays, which have none."""
    return Spec.parse(source.spec).statements if source.paths else {}


@dataclass(frozen=True, eq=False)
class Matched:
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


def matched(estimate: Poses, truth: Poses, config: EvaluationConfig) -> Matched | None:
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
    return Matched(rows, alignment, error / extent if extent else math.inf)


def are_one_path(sides: Sides, config: EvaluationConfig) -> bool:
    found = matched(sides[0].poses, sides[1].poses, config)
    return found is not None and found.one_path
