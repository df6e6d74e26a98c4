"""The tracked frame is not the body: rotated, or displaced by a lever arm."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig, plain
from vio_eval_ros.core.rotation import IDENTITY
from vio_eval_ros.diagnosis.causes.cause import KnownCause, POSITION_ERRORS, template
from vio_eval_ros.diagnosis.causes.clocks import LARGEST_RESIDUAL_RATIO
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.correction import Correction, PosesInCorrection
from vio_eval_ros.diagnosis.geometry import fit_body
from vio_eval_ros.diagnosis.measurement import Measurement


def _undo_lever_arm(poses: PosesInCorrection, lever: np.ndarray) -> PosesInCorrection:
    """Return the poses with the positions of the body, given its (3,) place in the frame."""
    if poses.rotations is None:
        return poses
    return replace(poses, positions=poses.positions + rotation.rotate(poses.rotations, lever))


def _undo_rotation(poses: PosesInCorrection, sensor: np.ndarray) -> PosesInCorrection:
    """Return the poses with the rotations of the body, given its (4,) rotation in the frame."""
    if poses.rotations is None:
        return poses
    return replace(poses, rotations=rotation.multiply(poses.rotations, sensor))


def _flags(correction: Correction, config: EvaluationConfig) -> tuple[str, ...]:
    """Return the pose of the body in the tracked frame: what is configured, then what is found."""
    if 'axes_swapped' in correction.steps:  # no flag swaps axes, and this is of the right ones
        return ()
    given = np.array(config.estimate_to_body)
    configured = rotation.normalize(given[3:])
    lever = given[:3] + rotation.rotate(configured, correction.value('lever_arm', np.zeros(3)))
    sensor = rotation.multiply(configured, correction.value('sensor_rotation', IDENTITY))
    return '--estimate-to-body', *map(plain, [*lever.tolist(), *sensor.tolist()])


SENSOR_ROTATION = KnownCause(
    name='sensor_rotation',
    unit='deg',
    meaning='angle',
    measured='the rotation between the axes of those relative rotations (hand-eye calibration)',
    remedy='`--estimate-to-body`',
    evidence=template(
        'the tracked frame is rotated by {v:.2f} ± {u:.2f} deg with respect to the body'
    ),
    advice='Give the rotation between the tracked frame and the body, and check the camera-IMU '
    'extrinsics and which frame is published.',
    advice_without_imu='Give the rotation between the tracked frame and the body, and check '
    'which frame is published.',
    limits=('sensor_rotation_deg',),
    healthy=lambda limits, half_s: limits.sensor_rotation_deg,
    undo=_undo_rotation,
    undo_order=31,
    flags=_flags,
)
LEVER_ARM = KnownCause(
    name='lever_arm',
    unit='m',
    meaning='in metres of the truth',
    measured="least squares on displacements over 0.5 s in the body's frame, "
    'R_eᵀ Δe = s u - (R_ij - I) l',
    remedy='`--estimate-to-body`',
    evidence=template('the tracked point is {v:.3f} ± {u:.3f} m from that of the ground truth'),
    advice='Give the position of the body in the tracked frame, and check the extrinsics and '
    'which frame is published.',
    limits=('lever_arm_m', 'positions_late_s'),
    healthy=lambda limits, half_s: limits.lever_arm_m,
    undo=_undo_lever_arm,
    undo_order=30,
    flags=_flags,
    acts_on=POSITION_ERRORS,
)
CAUSES = (SENSOR_ROTATION, LEVER_ARM)


def rotation_of_sensor(run: Measuring) -> Measurement:
    """Return the angle between the tracked frame and the body."""
    lag = run.lag
    if not (run.run.oriented and lag.residual < LARGEST_RESIDUAL_RATIO):
        return run.measured(SENSOR_ROTATION, 0.0, math.inf)
    angle_rad = float(rotation.angle(lag.sensor))
    return run.measured(
        SENSOR_ROTATION, math.degrees(angle_rad), math.degrees(lag.rotation_uncertainty)
    )


def measure(run: Measuring) -> None:
    """Note rotation and lever arm of the sensor, and keep the fit that the scale drift is in."""
    angle, sensor = rotation_of_sensor(run), run.lag.sensor
    pairs = run.pairs()
    run.note(SENSOR_ROTATION, angle, sensor)
    if not (angle.observable or angle.unusual):
        sensor = IDENTITY
    body = run.body = fit_body(pairs, sensor)
    lever = run.measured(LEVER_ARM, body.lever_length.value, body.lever_length.uncertainty)
    late = body.positions_late
    # orientations that do not show when they are of contradict nothing
    least_s = max(run.limits.positions_late_s, run.lag.offset_uncertainty_s)
    contradict = run.run.oriented and late.significantly_beyond(least_s)
    if run.findings['positions_late_s'] is None and contradict:
        run.findings['positions_late_s'] = late.value
    if run.findings['positions_late_s'] is not None:  # each fits other moments
        lever = lever.as_unobservable()
    run.note(LEVER_ARM, lever, body.lever)
    run.findings['sensor_rotation_xyzw'] = sensor.tolist()
    run.findings['lever_arm_m'] = body.lever.tolist()
