"""What has to be done to an estimate to undo its faults."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.steps import path_of_changed_steps
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.breaks import Jump
from vio_eval_ros.diagnosis.clocks import true_stamps
from vio_eval_ros.diagnosis.conventions import Convention


@dataclass(frozen=True, eq=False)
class Correction:
    """
    Everything found wrong, in the order in which it is undone.

    :param middle_ns: the stamp that drifts are zero at.
    :param convention: how the poses were written.
    :param offset_s: how late the stamps are.
    :param clock_drift: how much later they become, seconds a second.
    :param agreed_ns: the stamp at which that is zero; None for the middle.
    :param outliers_ns: stamps, as received, of poses to leave out.
    :param diverged_ns: the stamp, as received, from which on all are left out.
    :param jumps: with stamps as received, in their order.
    :param turn: (4,) R_s, the rotation of the body in the tracked frame.
    :param lever: (3,) metres of the estimate, the position of the body in the tracked frame.
    :param level: (4,) the rotation that makes the estimate's world upright.
    :param scale: estimated over true length.
    :param scale_drift: by how much more of itself the scale grows, per second.
    :param yaw_drift: rad/s by which the heading runs away about the world's z axis.
    """

    middle_ns: int
    convention: Convention = field(default_factory=Convention)
    offset_s: float = 0.0
    clock_drift: float = 0.0
    agreed_ns: int | None = None
    outliers_ns: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    diverged_ns: int | None = None
    jumps: tuple[Jump, ...] = ()
    turn: np.ndarray = field(default_factory=lambda: rotation.IDENTITY)
    lever: np.ndarray = field(default_factory=lambda: np.zeros(3))
    level: np.ndarray = field(default_factory=lambda: rotation.IDENTITY)
    scale: float = 1.0
    scale_drift: float = 0.0
    yaw_drift: float = 0.0

    def without(self, name: str) -> Correction:
        """Return the correction of all but one cause."""
        return replace(self, **{part: getattr(Correction(0), part) for part in PARTS[name]})

    def only(self, names: list[str]) -> Correction:
        """Return the correction of some causes."""
        chosen = {part: getattr(self, part) for name in names for part in PARTS[name]}
        return Correction(self.middle_ns, **chosen)

    def apply(self, received: Trajectory) -> Trajectory:
        """Return the estimate as it would be without these faults."""
        poses = self.convention.undo(received)
        positions, rotations = poses.positions, poses.rotations
        for jump in self.jumps:
            positions, rotations = jump.undo(poses.stamps_ns, positions, rotations)
        if rotations is not None:
            positions = positions + rotation.rotate(rotations, self.lever)
            rotations = rotation.multiply(rotations, self.turn)
            rotations = rotation.multiply(self.level, rotations)
        positions = rotation.rotate(self.level, positions) / self.scale
        elapsed = (poses.stamps_ns - self.middle_ns) / 1e9
        if self.scale_drift:
            positions = path_of_changed_steps(positions, 1 / (1 + self.scale_drift * elapsed))
        if self.yaw_drift:
            turns = rotation.about_z(-self.yaw_drift * elapsed)
            positions = path_of_changed_steps(positions, rotations=turns)
            rotations = None if rotations is None else rotation.multiply(turns, rotations)
        agreed_ns = self.middle_ns if self.agreed_ns is None else self.agreed_ns
        stamps_ns = true_stamps(poses.stamps_ns, agreed_ns, self.offset_s, self.clock_drift)
        kept = ~np.isin(received.stamps_ns, self.outliers_ns)
        if self.diverged_ns is not None:
            kept &= received.stamps_ns < self.diverged_ns
        return Trajectory(stamps_ns, positions, rotations)[kept]


#: the cause of each name, by the fields that undo it
PARTS: dict[str, tuple[str, ...]] = {
    'quaternion_conjugated': ('convention',),
    'quaternion_order': ('convention',),
    'pose_inverted': ('convention',),
    'axes_swapped': ('convention',),
    'time_offset': ('offset_s',),
    'clock_drift': ('clock_drift', 'agreed_ns'),
    'outliers': ('outliers_ns',),
    'diverged': ('diverged_ns',),
    'jump': ('jumps',),
    'sensor_rotation': ('turn',),
    'lever_arm': ('lever',),
    'gravity_tilt': ('level',),
    'scale': ('scale',),
    'scale_drift': ('scale_drift',),
    'yaw_drift': ('yaw_drift',),
    'lost_tracking': (),
}
