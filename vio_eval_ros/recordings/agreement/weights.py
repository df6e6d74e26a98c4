"""Weights of the ground truth, where its spec asks for those of its covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vio_eval_ros.core.alignment import UNFITTED
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.orientations import finite
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.agreement.pairs import noted, Sides, statements_of
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.recordings.spec import with_statement

STATEMENT = 'weights=covariance'


def with_weights(sides: Sides, config: EvaluationConfig) -> Sides:
    """
    Return both sides, the ground truth with a weight for each pose where its spec asks for them.

    :raises ConfigError: the estimate asks for them, or an alignment is chosen that they cannot
        change.
    :raises ReadError: the ground truth has no covariance of a position that is usable.
    """
    estimate, truth = sides
    if 'weights' in statements_of(estimate):
        spec = with_statement(truth.spec, STATEMENT) if truth.paths else f'...?{STATEMENT}'
        raise ConfigError(
            f'{estimate.spec}: weights are those of the ground truth; leave them out here, and '
            f'write --ground-truth {spec}'
        )
    if 'weights' not in statements_of(truth):
        return sides
    if config.alignment in UNFITTED:
        raise ConfigError(
            f'{truth.spec}: weights change nothing under alignment {config.alignment}, which '
            f'{UNFITTED[config.alignment]}; leave them out, or write --alignment se3'
        )
    return estimate, _weighted(truth)


def refuse_weights(source: Source) -> None:
    """Raise ``ConfigError`` where a spec asks for weights, but nothing is fitted to its poses."""
    if 'weights' in statements_of(source):
        raise ConfigError(
            f'{source.spec}: {STATEMENT} is for the ground truth of replay, score, diagnose and '
            'the library; leave it out here'
        )


def _weighted(truth: Source) -> Source:
    """Return the ground truth with weights of inverse variances, of which the mean is 1."""
    variances = _variances(truth.poses)
    usable = np.isfinite(variances)
    if not usable.any():
        why = (
            'what is inverted has none'
            if 'invert' in statements_of(truth)
            else 'there is none, or each is zero, negative, not a number or of unknown type'
        )
        raise ReadError(
            truth.spec,
            f'no position has a covariance that weights could follow from ({why}); leave '
            f'{STATEMENT} out',
        )
    known = variances[usable]
    weights = np.zeros(len(variances))
    weights[usable] = known.min() / known
    weights /= weights[usable].mean()
    placed = finite(truth.poses.positions)
    least, most = np.sqrt([known.min(), known.max()])
    notes = [
        f'{truth.spec}: the alignment is fitted with weights, the inverse variances of true '
        f'positions (standard deviations {least:.3g} to {most:.3g} m); errors are not weighted'
    ]
    if least == most:
        notes.append('all are equal, so that they change nothing')
    if left_out := int(np.count_nonzero(placed & (weights == 0))):
        notes.append(
            f'{left_out} of {np.count_nonzero(placed)} poses, whose covariance is zero, negative, '
            'not a number or of unknown type, are left out of the fit'
        )
    return noted(replace(truth, poses=replace(truth.poses, weights=weights)), '; '.join(notes))


def _variances(poses: Poses) -> np.ndarray:
    """Return (N,) square metres, the mean variance along the axes; NaN where it is unusable."""
    if poses.covariances is None:
        return np.full(len(poses), np.nan)
    along = np.diagonal(poses.covariances[:, 0], axis1=1, axis2=2)
    mean = along.mean(axis=1)
    usable = finite(poses.positions) & (along >= 0).all(axis=1) & (mean > 0) & np.isfinite(mean)
    return np.where(usable, mean, np.nan)
