"""What has to be done to an estimate to undo its faults."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class PosesInCorrection:
    """
    Poses of which some faults have been undone.

    :param stamps_ns: (N,) as received.
    :param middle_ns: the stamp at which drifts are zero.
    :param positions: (N, 3) metres.
    :param rotations: (N, 4), or None.
    :param late_s: (N,) how late the stamps are, as far as is known by now.
    :param kept: (N,) which poses are not left out.
    """

    stamps_ns: np.ndarray
    middle_ns: int
    positions: np.ndarray
    rotations: np.ndarray | None
    late_s: np.ndarray
    kept: np.ndarray

    @property
    def elapsed_s(self) -> np.ndarray:
        """(N,) seconds since the middle of the run."""
        return np.asarray((self.stamps_ns - self.middle_ns) / 1e9)

    def trajectory(self) -> Trajectory:
        """Return the poses with the stamps and the values known by now."""
        late_ns = np.round(self.late_s * 1e9).astype(np.int64)
        return Trajectory(self.stamps_ns - late_ns, self.positions, self.rotations)[self.kept]


Undo = Callable[[PosesInCorrection, Any], PosesInCorrection]


class Step(NamedTuple):
    """How one fault is undone: steps of a lower order come first, each with its value."""

    order: int
    undo: Undo
    value: Any


@dataclass(frozen=True, eq=False)
class Correction:
    """
    Everything found wrong.

    :param middle_ns: the stamp at which drifts are zero.
    :param steps: what undoes each cause, by its name.
    """

    middle_ns: int
    steps: Mapping[str, Step] = field(default_factory=dict)

    def having(self, name: str, step: Step) -> Correction:
        """Return the correction that undoes one more cause."""
        return replace(self, steps={**self.steps, name: step})

    def without(self, name: str) -> Correction:
        """Return the correction of all but one cause."""
        return self.only(other for other in self.steps if other != name)

    def only(self, names: Iterable[str]) -> Correction:
        """Return the correction of some causes."""
        return replace(
            self, steps={name: self.steps[name] for name in names if name in self.steps}
        )

    def value(self, name: str, default: Any = None) -> Any:
        """Return what undoes a cause; the default where it is not undone."""
        return self.steps[name].value if name in self.steps else default

    def apply(self, received: Trajectory) -> Trajectory:
        """Return the estimate as it would be without these faults."""
        poses = PosesInCorrection(
            stamps_ns=received.stamps_ns,
            middle_ns=self.middle_ns,
            positions=received.positions,
            rotations=received.rotations,
            late_s=np.zeros(len(received)),
            kept=np.ones(len(received), bool),
        )
        for step in sorted(self.steps.values(), key=lambda step: step.order):
            poses = step.undo(poses, step.value)
        return poses.trajectory()
