"""The world of the estimate is tilted, or its heading drifts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.steps import path_of_changed_steps, step_lengths
from vio_eval_ros.diagnosis.causes.cause import KnownCause, template
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.correction import Correction, PosesInCorrection
from vio_eval_ros.diagnosis.geometry import fit_world
from vio_eval_ros.diagnosis.measurement import Measurement

#: alignments that remove a tilt
LEVELLING = ('se3', 'sim3')


def _undo_tilt(poses: PosesInCorrection, level: np.ndarray) -> PosesInCorrection:
    """Return the poses in an upright world, given the (4,) rotation to it."""
    rotations = poses.rotations
    return replace(
        poses,
        positions=rotation.rotate(level, poses.positions),
        rotations=None if rotations is None else rotation.multiply(level, rotations),
    )


def _undo_yaw_drift(poses: PosesInCorrection, rad_s: float) -> PosesInCorrection:
    """Return the poses without the drift of the heading."""
    if not rad_s:
        return poses
    headings = rotation.about_z(-rad_s * poses.elapsed_s)
    rotations = poses.rotations
    return replace(
        poses,
        positions=path_of_changed_steps(poses.positions, rotations=headings),
        rotations=None if rotations is None else rotation.multiply(headings, rotations),
    )


def _tilt_flags(correction: Correction, config: EvaluationConfig) -> tuple[str, ...]:
    """Return an alignment that removes the tilt, where none does that is given or advised."""
    levelled = config.alignment in LEVELLING or correction.value('scale', 1.0) != 1
    return () if levelled else ('--alignment', 'se3')


def _yaw_evidence(measurement: Measurement, findings: Mapping[str, Any]) -> str:
    """Return the drift of the heading over time and over the path."""
    return (
        f'its heading drifts by {measurement.value:.1f} ± {measurement.uncertainty:.1f} deg per '
        f'minute, {findings["yaw_drift_deg_per_m"]:.2g} deg per metre'
    )


GRAVITY_TILT = KnownCause(
    name='gravity_tilt',
    unit='deg',
    meaning='angle',
    measured='the robust mean of R_g R_eᵀ; without orientations, the alignment',
    remedy='`--alignment se3` hides it',
    evidence=template('its world is tilted by {v:.2f} ± {u:.2f} deg'),
    advice='Check the gravity alignment at initialisation and the accelerometer bias; under se3 '
    'it does not count, under posyaw it does.',
    advice_without_imu='Rotate the world until it is upright: without an IMU it has the '
    'orientation of the first camera. Under se3 the tilt does not count, under posyaw it does.',
    limits=('gravity_tilt_deg', 'upright_deg'),
    healthy=lambda limits, half_s: limits.gravity_tilt_deg,
    undo=_undo_tilt,
    undo_order=40,
    flags=_tilt_flags,
    acts_on='posyaw ATE',
)
YAW_DRIFT = KnownCause(
    name='yaw_drift',
    unit='deg/min',
    meaning='per minute; evidence and findings have it per metre, too',
    measured='the slope of those rotations about the vertical',
    remedy='the estimator',
    evidence=_yaw_evidence,
    advice='Check the gyroscope bias about the vertical and its noise parameters; only loop '
    'closure or an absolute heading stops the drift.',
    advice_without_imu='Only loop closure or an absolute heading stops the drift.',
    limits=('yaw_drift_deg_per_min', 'yaw_drift_deg', 'upright_deg'),
    healthy=lambda limits, half_s: max(
        limits.yaw_drift_deg_per_min, limits.yaw_drift_deg * 30 / half_s
    ),
    undo=_undo_yaw_drift,
    undo_order=70,
)
CAUSES = (GRAVITY_TILT, YAW_DRIFT)


def measure(run: Measuring) -> None:
    """Note the tilt of the estimate's world, and the drift of its heading."""
    pairs = run.pairs()
    world = fit_world(pairs)
    tilt_deg = math.degrees(world.tilt_rad.value)
    tilt = run.measured(GRAVITY_TILT, tilt_deg, math.degrees(world.tilt_rad.uncertainty))
    yaw = run.measured(
        YAW_DRIFT,
        60 * math.degrees(world.yaw_drift.value),
        60 * math.degrees(world.yaw_drift.uncertainty),
    )
    upright = tilt_deg < run.limits.upright_deg
    if not upright:
        tilt, yaw = tilt.as_unobservable(), yaw.as_unobservable()
    run.note(GRAVITY_TILT, tilt, world.level)
    run.note(YAW_DRIFT, yaw, world.yaw_drift.value)
    path_m = float(step_lengths(pairs.ground_truth.positions).sum())
    minutes = float(np.ptp(pairs.estimate.stamps_ns)) / 60e9 if path_m else math.nan
    run.findings['yaw_drift_deg_per_m'] = yaw.value * minutes / (path_m or math.nan)
    run.findings['world_upright'] = upright
    run.findings['level_xyzw'] = world.level.tolist()
