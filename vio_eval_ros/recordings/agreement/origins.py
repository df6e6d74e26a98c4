"""One origin for both sides, where latitude and longitude were projected around two."""

from __future__ import annotations

from dataclasses import replace

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.recordings.agreement.pairs import noted, Sides
from vio_eval_ros.recordings.geographic import between_origins, Origin


def with_one_origin(sides: Sides) -> Sides:
    """
    Return both sides in the world of the ground truth, where both are places on the earth.

    Without it, an alignment that fits no translation would count how far the first fixes lie apart
    as an error.
    """
    estimate, truth = sides
    own, origin = estimate.poses.origin, truth.poses.origin
    if own is None or origin is None or own == origin:
        return sides
    causal = estimate.causal and _moved(estimate.causal, own, origin)
    moved = replace(estimate, poses=_moved(estimate.poses, own, origin), causal=causal)
    note = f'{estimate.spec}: its metres are made relative to the origin of the ground truth'
    return noted(moved, note), truth


def _moved(poses: Poses, own: Origin, origin: Origin) -> Poses:
    """Return poses relative to another origin."""
    matrix, translation = between_origins(own, origin)
    turned = poses.rotations
    if turned is not None:
        turned = rotation.multiply(rotation.from_matrix(matrix[None]), turned)
    positions = poses.positions @ matrix.T + translation
    covariances = poses.covariances
    if covariances is not None:  # about the axes of the world
        covariances = matrix @ covariances @ matrix.T
    return replace(
        poses, positions=positions, rotations=turned, covariances=covariances, origin=origin
    )
