"""Cleaning: from poses as received to a trajectory, with counts of what was dropped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.orientations import finite, MIN_QUATERNION_NORM, some_usable
from vio_eval_ros.core.trajectory import Poses, Trajectory

UNIT_QUATERNION_TOLERANCE = 1e-2
REPAIRED = ('went_backwards', 'scaled_quaternion')


@dataclass
class Cleaning:
    """
    What :func:`clean` and association dropped from one stream, and why.

    Poses that ``went_backwards`` (older than one before them; sorted) and those with a
    ``scaled_quaternion`` (far from unit length; normalised) were kept, all others dropped.
    ``late`` ones arrived after their pairs were decided, ``cropped`` ones lie outside ``start_s``
    to ``end_s``, ``overflow`` ones were the oldest of too many that waited for the other stream.
    """

    non_finite: int = 0
    zero_quaternion: int = 0
    zero_stamp: int = 0
    duplicate: int = 0
    late: int = 0
    cropped: int = 0
    overflow: int = 0
    went_backwards: int = 0
    scaled_quaternion: int = 0

    @property
    def dropped(self) -> dict[str, int]:
        """The number of dropped poses for each reason."""
        return {reason: n for reason, n in asdict(self).items() if reason not in REPAIRED}

    @property
    def repaired(self) -> dict[str, int]:
        """The number of poses that were kept, but changed or moved, for each reason."""
        return {reason: getattr(self, reason) for reason in REPAIRED}

    def listed(self) -> str:
        """Return what was dropped in words; empty where nothing was."""
        return ', '.join(
            f'{count} {reason.replace("_", "-")}'
            for reason, count in self.dropped.items()
            if count
        )

    def warnings(self, name: str) -> Iterator[str]:
        """Yield a sentence about what was dropped, and about each repair, of a named stream."""
        if dropped := self.listed():
            yield f'{name}: dropped {dropped}'
        if self.went_backwards:
            yield f'{name}: {self.went_backwards} stamps went backwards; sorted'
        if self.scaled_quaternion:
            yield (
                f'{name}: {self.scaled_quaternion} quaternions were far from unit length; '
                'normalised'
            )


def clean(
    poses: Poses, counts: Cleaning, newest_ns: int | None = None, positions_suffice: bool = True
) -> Trajectory:
    """
    Return the usable poses in order of their stamps; add problems to ``counts``.

    Rows with a non-finite number (or one so large that its square is not finite), an unset stamp
    or a quaternion of length zero are dropped, other quaternions normalised; of equal stamps the
    first stays. Where no quaternion at all is usable, the trajectory has none.

    :param newest_ns: the newest stamp of earlier batches of the same stream, if any.
    :param positions_suffice: False drops every row without a usable quaternion.
    """
    if positions_suffice and not some_usable(poses):
        poses = replace(poses, rotations=None)
    keep = finite(poses.positions)
    if poses.rotations is not None:
        keep &= finite(poses.rotations)
    counts.non_finite += len(poses) - int(np.count_nonzero(keep))
    if poses.zero_is_unset:
        counts.zero_stamp += int(np.count_nonzero(keep & (poses.stamps_ns == 0)))
        keep &= poses.stamps_ns != 0
    poses = _contiguous(poses if keep.all() else poses[keep])
    rotations = poses.rotations
    if rotations is not None:
        norms = rotation.lengths(rotations)
        usable = norms >= MIN_QUATERNION_NORM
        if not usable.all():
            counts.zero_quaternion += int(np.count_nonzero(~usable))
            poses, norms = poses[usable], norms[usable]
        counts.scaled_quaternion += int(
            np.count_nonzero(np.abs(norms - 1) > UNIT_QUATERNION_TOLERANCE)
        )
        rotations = poses.rotations / norms[:, None]  # type: ignore[operator]
    trajectory = Trajectory(
        poses.stamps_ns, poses.positions, rotations, poses.covariances, weights=poses.weights
    )
    return _in_order(trajectory, counts, newest_ns)


def _contiguous(poses: Poses) -> Poses:
    """Return the poses row by row in memory: in another layout, sums differ in the last bit."""
    rotations = None if poses.rotations is None else np.ascontiguousarray(poses.rotations)
    return replace(poses, positions=np.ascontiguousarray(poses.positions), rotations=rotations)


def _in_order(poses: Trajectory, counts: Cleaning, newest_ns: int | None) -> Trajectory:
    """Return the poses sorted by stamp; of equal stamps, the first."""
    stamps = poses.stamps_ns
    if not len(stamps):
        return poses
    floor = stamps[0] if newest_ns is None else newest_ns
    before = np.maximum.accumulate(np.concatenate([[floor], stamps[:-1]]))
    backwards = int(np.count_nonzero(stamps < before))
    counts.went_backwards += backwards
    if backwards:
        poses = poses[np.argsort(stamps, kind='stable')]
    first = np.concatenate([[True], np.diff(poses.stamps_ns) > 0])
    if first.all():
        return poses
    counts.duplicate += len(first) - int(np.count_nonzero(first))
    return poses[first]
