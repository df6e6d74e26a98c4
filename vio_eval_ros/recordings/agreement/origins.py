"""One origin for both sides, where latitude and longitude were projected around two."""

from __future__ import annotations

from dataclasses import replace
import math

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.recordings.agreement.pairs import noted, Sides
from vio_eval_ros.recordings.geographic import between_origins, Origin
from vio_eval_ros.recordings.sources import Source

#: alignments that fit no translation
UNTRANSLATED = ('none', 'scale')


def with_one_origin(sides: Sides, config: EvaluationConfig) -> Sides:
    """
    Return both sides in the world of the ground truth, where both are places on the earth.

    Without it, an alignment that fits no translation would count how far the first fixes lie apart
    as an error. Where only one side is such a place, it does, and a sentence says so.
    """
    estimate, truth = sides
    own, origin = estimate.poses.origin, truth.poses.origin
    if own == origin:
        return sides
    if own is None or origin is None:
        if config.alignment not in UNTRANSLATED:
            return sides
        note = _one_sided(estimate if origin is None else truth, config.alignment)
        return noted(estimate, note), truth
    causal = estimate.causal and _moved(estimate.causal, own, origin)
    moved = replace(estimate, poses=_moved(estimate.poses, own, origin), causal=causal)
    note = f'{estimate.spec}: its metres are made relative to the origin of the ground truth'
    return noted(moved, note), truth


def _one_sided(source: Source, alignment: str) -> str:
    """Return that only this source is relative to a place on the earth."""
    latitude, longitude, height = source.poses.origin or (math.nan,) * 3
    return (
        f'{source.spec}: its metres are relative to latitude {latitude:.7f}, longitude '
        f'{longitude:.7f}, height {height:.3f} m, those of the other side to something else: '
        f'errors under alignment {alignment} contain that offset; write --alignment se3'
    )


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
