"""Poses that are off and return, and jumps that stay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.rotation import IDENTITY
from vio_eval_ros.diagnosis.breaks import Breaks, find_breaks
from vio_eval_ros.diagnosis.causes.cause import (
    FRAME_ERRORS,
    KnownCause,
    POSITION_ERRORS,
    template,
)
from vio_eval_ros.diagnosis.causes.divergence import DIVERGED
from vio_eval_ros.diagnosis.causes.frames import rotation_of_sensor
from vio_eval_ros.diagnosis.causes.measuring import Measuring, SIDES
from vio_eval_ros.diagnosis.correction import PosesInCorrection
from vio_eval_ros.diagnosis.diagnosed_run import improvement
from vio_eval_ros.diagnosis.jumps import PoseJump
from vio_eval_ros.diagnosis.measurement import Measurement

MOST_JUMPS = 20


def _undo_jumps(poses: PosesInCorrection, jumps: tuple[PoseJump, ...]) -> PosesInCorrection:
    """Return the poses as if there had been no jump."""
    positions, rotations = poses.positions, poses.rotations
    for jump in jumps:
        positions, rotations = jump.undo(poses.stamps_ns, positions, rotations)
    return replace(poses, positions=positions, rotations=rotations)


def _leave_out(poses: PosesInCorrection, stamps_ns: np.ndarray) -> PosesInCorrection:
    """Return the poses without those received with these stamps."""
    return replace(poses, kept=poses.kept & ~np.isin(poses.stamps_ns, stamps_ns))


def _harmful(findings: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [jump for jump in findings['jumps'] if jump['harmful']]


def _jump_evidence(measurement: Measurement, findings: Mapping[str, Any]) -> str:
    """Return the largest step and the largest rotation."""
    turn_deg = max(jump['turn_deg'] for jump in _harmful(findings))
    rotated = f'rotates by up to {turn_deg:.1f} deg'
    if not measurement.value:
        return f'it {rotated} between two poses and stays so'
    stepped = f'it steps by up to {measurement.value:.2f} m between two poses and stays there'
    return f'{stepped}, and {rotated}' if turn_deg else stepped


JUMP = KnownCause(
    name='jump',
    unit='m',
    meaning='the largest, in metres of the truth',
    measured='an error that steps aside between two poses and stays there, in position or '
    'orientation; the side that moves is named',
    remedy='the estimator',
    evidence=_jump_evidence,
    advice='Look at the named moments for tracking resets or relocalisation, and evaluate the '
    'poses as they were first published.',
    limits=(
        'jump_m', 'jump_deg', 'jump_ratio', 'reset_m', 'reset_deg', 'jump_improvement_percent'
    ),
    undo=_undo_jumps,
    undo_order=20,
    acts_on=f'ATE|{FRAME_ERRORS}',
    may_raise_ate=True,
    side=lambda findings: str(
        max(_harmful(findings), key=lambda jump: jump['size_m'])['side']
    ),
)  # fmt: skip
OUTLIERS = KnownCause(
    name='outliers',
    unit='ratio',
    meaning='share of the poses',
    measured='an error that is off while its neighbours are not, for some poses or up to a tenth '
    'of the run; the side that moves is named',
    remedy='the estimator',
    evidence=template(
        '{percent:.2g} % of the poses are off while their neighbours are not',
        percent=lambda value: 100 * value,
    ),
    advice='Look at the named poses for wrong loop closures or messages from another source; '
    'the robot would have followed them.',
    limits=('outlier_m', 'outlier_ratio', 'outliers_percent'),
    healthy=lambda limits, half_s: limits.outliers_percent / 100,
    undo=_leave_out,
    undo_order=90,
    acts_on=POSITION_ERRORS,
    side=lambda findings: str(findings['outlier_poses']['side']),
)
CAUSES = (JUMP, OUTLIERS)


def measure(run: Measuring) -> None:
    """Note outliers, divergence, and the jumps that made the run worse."""
    corrected = run.correction.apply(run.run.estimate)
    inside = run.run.true_poses.inside(corrected.stamps_ns)
    sensor = run.lag.sensor if rotation_of_sensor(run).observable else IDENTITY
    received_ns = run.run.estimate.stamps_ns[inside]
    found = find_breaks(run.pairs(), received_ns, sensor, run.limits)
    share = len(found.outliers_ns) / len(run.run.estimate)
    run.note(OUTLIERS, run.counted(OUTLIERS, share), found.outliers_ns)
    if found.diverged_ns is not None:
        left_s = float(run.run.estimate.stamps_ns[-1] - found.diverged_ns) / 1e9
        left = run.counted(DIVERGED, left_s / (2 * run.run.half_s))
        run.note(DIVERGED, left, found.diverged_ns)
    harmful = _harmful_jumps(run, found.jumps)
    largest_m = max((jump.size_m for jump in harmful), default=0.0) * found.scale
    jump = replace(run.counted(JUMP, largest_m), size=float(len(harmful)))
    run.note(JUMP, jump, harmful)
    _list_breaks(run, found, harmful)


def _list_breaks(run: Measuring, found: Breaks, harmful: tuple[PoseJump, ...]) -> None:
    """Put every jump and outlier into the findings."""
    run.findings['jumps'] = [
        {
            'stamp_ns': jump.stamp_ns,
            'size_m': jump.size_m * found.scale,
            'turn_deg': math.degrees(jump.angle_rad),
            'harmful': jump in harmful,
            'side': SIDES[jump.of_truth],
        }
        for jump in found.jumps
    ]
    run.findings['outlier_poses'] = {
        'stamps_ns': found.outliers_ns.tolist(),
        'median_m': found.outlier_m,
        'side': SIDES[found.truth_is_off],
    }


def _harmful_jumps(run: Measuring, jumps: tuple[PoseJump, ...]) -> tuple[PoseJump, ...]:
    """
    Return the jumps that made the run worse.

    An estimator also steps when it takes back an error: without that step the run would be worse.
    One that is too large for that is harmful by what it does to the motions from frame to frame.
    """
    harmful: tuple[PoseJump, ...] = ()
    errors = run.run.errors(run.correction)
    less = 1 - run.limits.jump_improvement_percent / 100
    smoother = 1 - run.limits.improvement_percent / 100
    largest_first = sorted(jumps, key=lambda jump: -jump.size_m - jump.angle_rad)
    for jump in largest_first[:MOST_JUMPS]:
        tried = tuple(sorted((*harmful, jump), key=lambda jump: jump.stamp_ns))
        without = run.run.errors(JUMP.undone(run.correction, tried))
        _, ate, ate_without = improvement(errors, without, 'ATE')
        _, step, step_without = improvement(errors, without, FRAME_ERRORS)
        if ate_without < less * ate or (jump.is_reset and step_without <= smoother * step):
            harmful, errors = tried, without
    return harmful
