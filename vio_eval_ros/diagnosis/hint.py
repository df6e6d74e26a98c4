"""One line on the likely cause of figures that are suspicious, for whoever only evaluates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
import shlex
from typing import TYPE_CHECKING

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Moments, SCALED_MODES, solve
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.metrics import position_errors
from vio_eval_ros.core.statistics import root_mean_square
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.diagnosis.command import FLAGS_OF
from vio_eval_ros.errors import NoPairs
from vio_eval_ros.recordings.spec import Spec, STATEMENTS, with_statement

if TYPE_CHECKING:
    from vio_eval_ros.diagnosis.report import Cause

#: fewest pairs that show anything
FEWEST_PAIRS = 20
#: pairs that are looked at, evenly over the run
MOST_PAIRS = 1000
#: an orientation that is off by more is of another frame or convention
ROTATED_DEG = 45.0
#: a scale that is further from one, or from its inverse, is no error of calibration
FAR_SCALE = 1.25
#: a cure leaves at most this share of the error
CURED_SHARE = 0.5
#: of the extent of the path, the error of what is another one
OTHER_PATH_SHARE = 0.3
#: a smaller error is not looked into
SMALL_ERROR_M = 0.01
#: causes that show in the orientations
CONVENTIONS = ('quaternion_conjugated', 'quaternion_order', 'pose_inverted', 'axes_swapped')
MODES = ('se3', 'sim3')
OTHER_SIDE = {'estimate': 'ground_truth', 'ground_truth': 'estimate'}


def hint(
    pairs: Pairs,
    metrics: Mapping[str, float],
    config: EvaluationConfig,
    specs: Mapping[str, str],
    received: Callable[[], tuple[Trajectory, Trajectory]] | None = None,
) -> str | None:
    """
    Return the likely cause of figures that one cure would mend, and what to write to try it.

    It names the side that is more likely, and the other one: from the difference of two sides
    alone it does not follow which of them is written otherwise than it says.

    It takes milliseconds, unless the figures are suspicious: then a diagnosis of the pairs
    decides. None where nothing is suspicious, or nothing is found.

    :param pairs: of the whole run.
    :param metrics: of them, by name.
    :param config: the options that have been applied to the pairs.
    :param specs: how ``estimate`` and ``ground_truth`` were named; empty of what has no name.
    :param received: gives both sides as they came, in which poses may belong together that are not
        pairs: clocks that are seconds apart, in a run that lasts longer.
    """
    pairs = pairs[:: -(-len(pairs) // MOST_PAIRS)] if len(pairs) else pairs
    if len(pairs) < FEWEST_PAIRS or not _is_suspicious(pairs, metrics, config):
        return None
    # most figures are not suspicious, and need none of it
    from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
    from vio_eval_ros.diagnosis.diagnosis import diagnose_run
    from vio_eval_ros.diagnosis.warnings import SIDE_NAMES

    try:
        if received and not _are_one_path(pairs, metrics):
            run = DiagnosedRun.received(*received(), config, quick=True)
        else:
            run = DiagnosedRun(pairs.estimate, pairs.ground_truth, config, quick=True)
        causes = diagnose_run(run).causes
    except NoPairs:
        return None
    cures = [cause for cause in causes if _cures(cause, metrics)]
    if not cures:
        return None
    cause = cures[0]
    command = _command(cause, specs)
    what = f'try {command}' if command else 'diagnose says more'
    # what a cure undoes is between the sides: the one that a header lies about may be the other
    side, other = SIDE_NAMES[cause.side], SIDE_NAMES[OTHER_SIDE[cause.side]]
    whose = f'{side} (or, if that is right, of {other})'
    return f'likely cause: {cause.name} of {whose}: {cause.evidence}; {what}'


def _is_suspicious(pairs: Pairs, metrics: Mapping[str, float], config: EvaluationConfig) -> bool:
    """Return whether orientations or scale are far off, or one cure may halve the error."""
    if metrics.get('ate_rot_rmse_deg', math.nan) > ROTATED_DEG:
        return True
    scale = metrics.get('sim3_scale', math.nan)
    if config.alignment not in SCALED_MODES and scale > 0:
        if abs(math.log(scale)) > math.log(FAR_SCALE):
            return True
        se3_m, sim3_m = (metrics.get(f'ate_{mode}_trans_rmse_m', math.nan) for mode in MODES)
        if sim3_m < CURED_SHARE * se3_m > CURED_SHARE * SMALL_ERROR_M:
            return True
    return _follows_motion(pairs)


def _are_one_path(pairs: Pairs, metrics: Mapping[str, float]) -> bool:
    """Return whether the positions are of one run, whatever the scale."""
    path = pairs.ground_truth.positions
    extent_m = root_mean_square(rotation.lengths(path - path.mean(axis=0)))
    return not metrics.get('ate_sim3_trans_rmse_m', math.nan) > OTHER_PATH_SHARE * extent_m


def _follows_motion(pairs: Pairs) -> bool:
    """Return whether errors follow the velocity, as late stamps make them, or the orientation."""
    aligned = solve('se3', Moments.of(pairs), pairs[:1])
    truth, estimate = pairs.ground_truth, pairs.estimate
    rotated = rotation.rotate(aligned.rotation, estimate.positions)
    errors = rotated - truth.positions
    errors = errors - errors.mean(axis=0)
    if root_mean_square(position_errors(pairs, aligned)) < SMALL_ERROR_M:
        return False
    seconds = (estimate.stamps_ns - estimate.stamps_ns[0]) / 1e9
    explanations = [np.gradient(truth.positions, seconds, axis=0)[..., None]]
    if estimate.rotations is not None:
        body = rotation.multiply(aligned.rotation, estimate.rotations)
        explanations.append(rotation.to_matrix(body))
    return any(_explains(columns, errors) for columns in explanations)


def _explains(columns: np.ndarray, errors: np.ndarray) -> bool:
    """Return whether a combination of (N, 3, P) columns leaves half of (N, 3) errors, or less."""
    centred = columns - columns.mean(axis=0)
    design, target = centred.reshape(-1, columns.shape[2]), errors.ravel()
    solution = np.linalg.lstsq(design, target, rcond=None)[0]
    left = target - design @ solution
    return bool(left @ left < CURED_SHARE * (target @ target))


def _cures(cause: Cause, metrics: Mapping[str, float]) -> bool:
    """Return whether undoing a cause by a flag is what makes the figures right."""
    turned = metrics.get('ate_rot_rmse_deg', math.nan) > ROTATED_DEG
    if cause.name in CONVENTIONS:
        return turned
    if not cause.flags:
        return False
    if cause.name == 'sensor_rotation' and turned and cause.value > ROTATED_DEG:
        return True
    return cause.ate_after_m <= CURED_SHARE * cause.ate_before_m


def _command(cause: Cause, specs: Mapping[str, str]) -> str:
    """
    Return the flags to add, with the whole spec of a side where its reading is wrong.

    Nothing where no flag helps: arrays have no spec, and messages no order of quaternions.
    """
    stated = cause.flags[0].removeprefix('?') if cause.flags else ''
    if not stated or stated == cause.flags[0]:
        return shlex.join(cause.flags)
    spec = specs.get(cause.side, '')
    kind = 'topic' if spec and Spec.parse(spec).topic else 'file'
    if not spec or stated.partition('=')[0] not in STATEMENTS[kind]:
        return ''
    return f'{FLAGS_OF[cause.side]} {shlex.quote(with_statement(spec, stated))}'
