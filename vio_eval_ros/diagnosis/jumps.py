"""Jumps: steps of the error between two poses that stay."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.steps import jump_limit
from vio_eval_ros.core.trajectory import Pairs
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.windows import NEIGHBOURS, neighbours_of, without_ends

#: a jump is as many times as large as the median of its neighbours
NEIGHBOUR_RATIO = 3.0
#: the share of a step that has to stay
LASTING_SHARE = 0.5
#: a second jump takes back the first where no more than this share is left, within this share of
#: the run
LEFT_SHARE, EXCURSION_SHARE = 0.25, 0.1


@dataclass(frozen=True)
class PoseJump:
    """
    A pose from which on all are rotated about its position and displaced.

    :param step: metres in the estimate's world.
    :param rotation_xyzw: likewise.
    :param is_reset: whether it is larger than any step by which an estimator corrects itself.
    :param of_truth: whether it is the truth that steps.
    """

    stamp_ns: int
    step: tuple[float, float, float]
    rotation_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    is_reset: bool = False
    of_truth: bool = False

    @property
    def size_m(self) -> float:
        """The length of the step."""
        return math.hypot(*self.step)

    @property
    def angle_rad(self) -> float:
        """The angle of the rotation."""
        return float(rotation.angle(np.array(self.rotation_xyzw)))

    def undo(
        self, stamps_ns: np.ndarray, positions: np.ndarray, rotations: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return positions and rotations of poses as if it had not been."""
        first = int(np.searchsorted(stamps_ns, self.stamp_ns))
        before, after = positions[:first], positions[first:]
        if self.angle_rad:
            back = rotation.conjugate(np.array(self.rotation_xyzw))
            after = rotation.rotate(back, after - after[:1]) + after[:1]
            if rotations is not None:
                rotated = rotation.multiply(back, rotations[first:])
                rotations = np.concatenate([rotations[:first], rotated])
        return np.concatenate([before, after - np.array(self.step)]), rotations


def _over_time(sizes: np.ndarray, stamps_ns: np.ndarray) -> np.ndarray:
    """Return sizes of steps as over the median interval: random walks grow with its root."""
    intervals = np.diff(stamps_ns)
    return np.asarray(sizes / np.sqrt(np.maximum(intervals / np.median(intervals), 1)))


def orientation_jumps(
    pairs: Pairs, received_ns: np.ndarray, sensor: np.ndarray, limits: DiagnosisLimits
) -> dict[int, PoseJump]:
    """
    Return the jumps of the orientations by their samples, as rotations of the estimate's world.

    :param received_ns: (N,) the stamps that the estimates came with.
    :param sensor: (4,) rotation of the body in the tracked frame.
    """
    if pairs.rotations is None:
        return {}
    assert pairs.estimate.rotations is not None
    assert pairs.ground_truth.rotations is not None
    body = rotation.multiply(pairs.estimate.rotations, sensor)
    worlds = rotation.multiply(pairs.ground_truth.rotations, rotation.conjugate(body))
    steps = rotation.to_rotation_vector(
        rotation.multiply(worlds[1:], rotation.conjugate(worlds[:-1]))
    )
    size = _over_time(lengths(steps), pairs.estimate.stamps_ns)
    limit = jump_limit(size, math.radians(limits.jump_deg), limits.jump_ratio, 0.9)
    found = {}
    for k in np.flatnonzero(without_ends(size > limit)).tolist():
        back = rotation.conjugate(worlds[k])
        before, after = (
            np.median(rotation.to_rotation_vector(rotation.multiply(side, back)), axis=0)
            for side in (worlds[k - NEIGHBOURS + 1 : k + 1], worlds[k + 1 : k + 1 + NEIGHBOURS])
        )
        lasting = after - before
        if lasting @ steps[k] > LASTING_SHARE * size[k] ** 2:
            jump = rotation.from_rotation_vector(-rotation.rotate(back, lasting))
            worlds[k + 1 :] = rotation.multiply(worlds[k + 1 :], jump)
            x, y, z, w = jump.tolist()
            found[k + 1] = PoseJump(
                stamp_ns=int(received_ns[k + 1]),
                step=(0.0, 0.0, 0.0),
                rotation_xyzw=(x, y, z, w),
                is_reset=bool(size[k] > math.radians(limits.reset_deg)),
            )
    return found


class PositionJump(NamedTuple):
    """After the sample ``row`` the error steps aside and stays there; ``step`` in metres."""

    row: int
    step: np.ndarray
    is_reset: bool


def position_jumps(
    errors: np.ndarray, stamps_ns: np.ndarray, limits: DiagnosisLimits
) -> list[PositionJump]:
    """Return where (N, 3) errors step aside and stay there."""
    steps = np.diff(errors, axis=0)
    size = _over_time(lengths(steps), stamps_ns)
    limit = jump_limit(size, limits.jump_m, limits.jump_ratio, 0.9)
    found = []
    for k in np.flatnonzero(without_ends(size > min(limit, limits.reset_m))).tolist():
        before, after = slice(k - NEIGHBOURS + 1, k + 1), slice(k + 1, k + 1 + NEIGHBOURS)
        around = np.concatenate(
            [size[max(k - NEIGHBOURS, 0) : k], size[k + 1 : k + 1 + NEIGHBOURS]]
        )
        lasting = np.median(errors[after], axis=0) - np.median(errors[before], axis=0)
        usual = float(np.median(around))
        is_reset = bool(size[k] > max(limits.reset_m, limits.jump_ratio * usual))
        if (
            (is_reset or size[k] > max(limit, NEIGHBOUR_RATIO * usual))
            and lasting @ steps[k] > LASTING_SHARE * size[k] ** 2
        ):  # fmt: skip
            step = steps[k] - np.median(steps[neighbours_of(k, len(steps))], axis=0)
            found.append(PositionJump(k, step, is_reset))
    return found


def excursions(jumps: list[PositionJump], count: int) -> list[tuple[PositionJump, PositionJump]]:
    """Return the neighbouring pairs of jumps of which the second takes back the first."""
    found: list[tuple[PositionJump, PositionJump]] = []
    for there, back in pairwise(jumps):
        left = float(np.linalg.norm(there.step + back.step))
        if (
            left < LEFT_SHARE * float(np.linalg.norm(there.step))
            and back.row - there.row <= EXCURSION_SHARE * count
            and not (found and found[-1][1] is there)
        ):
            found.append((there, back))
    return found
