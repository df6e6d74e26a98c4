"""What makes the poses of one side comparable with those of the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.errors import ConfigError


class Preparation:
    """
    Cleans poses, puts their stamps on the common clock, and moves them to the body.

    :param offset_s: added to the stamps.
    :param to_body: x y z qx qy qz qw, the pose of the body in the tracked frame.
    """

    def __init__(self, offset_s: float, to_body: Sequence[float]) -> None:
        self._offset_ns = nanoseconds(offset_s)
        self._lever = np.array(to_body[:3])
        self._rotation = rotation.normalize(np.array(to_body[3:]))

    @classmethod
    def of_estimate(cls, config: EvaluationConfig) -> Preparation:
        """Return the preparation of the estimate."""
        return cls(config.time_offset_s, config.estimate_to_body)

    @classmethod
    def of_ground_truth(cls, config: EvaluationConfig) -> Preparation:
        """Return the preparation of the ground truth."""
        return cls(0.0, config.ground_truth_to_body)

    @property
    def moves(self) -> bool:
        """Whether the body is not the tracked frame itself, so that orientations are needed."""
        return bool(self._lever.any()) or abs(self._rotation[3]) != 1

    def apply(
        self,
        poses: Poses,
        counts: Cleaning | None = None,
        newest_ns: int | None = None,
        positions_suffice: bool = True,
    ) -> Trajectory:
        """
        Return the poses of the body, in order, on the common clock.

        :param counts: what was dropped is added to them.
        :param newest_ns: the newest stamp of earlier batches, on the common clock.
        :param positions_suffice: as of :func:`clean`; never where the body is not the tracked
            frame.
        :raises ConfigError: poses without orientation are to be moved to another frame.
        """
        newest_ns = None if newest_ns is None else newest_ns - self._offset_ns
        positions_suffice &= not self.moves
        prepared = clean(poses, counts or Cleaning(), newest_ns, positions_suffice)
        if self._offset_ns:
            prepared = replace(prepared, stamps_ns=prepared.stamps_ns + self._offset_ns)
        return self._of_body(prepared) if len(prepared) else prepared

    def _of_body(self, tracked: Trajectory) -> Trajectory:
        """Return the poses of the body, given those of the tracked frame, in which it is fixed."""
        if not self.moves:
            return tracked
        if tracked.rotations is None:
            raise ConfigError(
                'poses without orientation cannot be moved to another frame; leave '
                'estimate_to_body and ground_truth_to_body at the identity for them'
            )
        covariances = tracked.covariances
        if covariances is not None and self._lever.any():
            # that of the position would need its correlation with the orientation
            covariances = covariances.copy()
            covariances[:, 0] = np.nan
        return replace(
            tracked,
            covariances=covariances,
            positions=tracked.positions + rotation.rotate(tracked.rotations, self._lever),
            rotations=rotation.multiply(tracked.rotations, self._rotation),
        )
