"""What to do about each cause, in one sentence and in flags."""

from __future__ import annotations

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig, plain
from vio_eval_ros.diagnosis.correction import Correction

ADVICE = {
    'truth_static': 'Check that the ground truth was recorded: the right topic, and the tracker '
    'seeing its markers.',
    'insufficient_motion': 'Record a run with translation and with rotation about two axes; '
    'nothing can be told from this one.',
    'swapped_inputs': 'Exchange --estimate and --ground-truth.',
    'quaternion_conjugated': 'Publish the rotation from body to world, not its inverse (JPL '
    'quaternions are conjugates of Hamilton ones).',
    'quaternion_order': 'Write and read quaternions in the same order; ROS and TUM files have '
    'x y z w, EuRoC files w x y z.',
    'pose_inverted': 'Publish the pose of the body in the world, not of the world in the body '
    '(world-from-camera, not camera-from-world).',
    'axes_swapped': 'Convert all of a pose between axis conventions, positions and rotations, '
    'with one proper rotation.',
    'time_offset': 'Make both clocks the same (PTP, one recording computer, the stamp of the '
    'exposure and not of the arrival), or correct for it.',
    'clock_drift': 'Synchronise the two clocks for the whole run (PTP or NTP): one constant '
    'offset cannot correct it.',
    'scale': 'Check baseline and IMU calibration, or that a monocular system was initialised '
    'with metric scale; sim3 shows what is left without it.',
    'scale_drift': 'Give the estimator something metric all the time: accelerometer excitation, '
    'stereo overlap at the depth seen; check the accelerometer bias.',
    'sensor_rotation': 'Give the rotation between the tracked frame and the body, and check the '
    'camera-IMU extrinsics and which frame is published.',
    'lever_arm': 'Give the position of the body in the tracked frame, and check the extrinsics '
    'and which frame is published.',
    'gravity_tilt': 'Check the gravity alignment at initialisation and the accelerometer bias; '
    'under se3 it does not count, under posyaw it does.',
    'yaw_drift': 'Check the gyroscope bias about the vertical and the noise it is given; only '
    'loop closure or an absolute heading stops it.',
    'jump': 'Look at the named moments for tracking resets or relocalisation, and evaluate '
    'what a robot would have had.',
    'outliers': 'Look at the named poses for wrong loop closures or messages from another '
    'source; the robot would have followed them.',
    'lost_tracking': 'Look at the images of the named intervals: blur, darkness, no texture, '
    'dropped frames.',
    'diverged': 'Look at what comes just before: lost features, saturated IMU, or noise '
    'parameters that are too small.',
}
# of either side, where it is not the estimate's
ADVICE['ground_truth'] = (
    'Look at what gave the ground truth at those moments (markers lost or exchanged, multipath), '
    'and leave them out.'
)
# what was measured, given value v and uncertainty u in the unit of the cause
EVIDENCE = {
    'quaternion_conjugated': 'relative rotations fit when conjugated, as they are they do not',
    'quaternion_order': 'relative rotations fit with w in another place, as they are they do not',
    'pose_inverted': 'relative motions fit when inverted, as they are they do not',
    'axes_swapped': 'positions and orientations agree with other axes, as they are they do not',
    'time_offset': 'its stamps are {ms:.1f} ± {ums:.1f} ms {late}',
    'clock_drift': 'its clock gains {v:.0f} ± {u:.0f} ppm on that of the ground truth',
    'scale': 'it is {v:.4f} ± {u:.4f} times as large as the truth',
    'scale_drift': 'its scale changes by {v:.1f} ± {u:.1f} % a minute',
    'sensor_rotation': 'the tracked frame is turned by {v:.2f} ± {u:.2f} deg to the body',
    'lever_arm': 'the tracked point is {v:.3f} ± {u:.3f} m from that of the ground truth',
    'gravity_tilt': 'its world is tilted by {v:.2f} ± {u:.2f} deg',
    'yaw_drift': 'its heading runs away by {v:.1f} ± {u:.1f} deg a minute',
    'jump': 'it steps by up to {v:.2f} m between two poses and stays there',
    'outliers': '{percent:.2g} % of the poses are off while their neighbours are not',
    'lost_tracking': '{percent:.0f} % of the ground truth has no estimate',
    'diverged': 'it has flown away and never comes back, for the last {percent:.0f} % of the run',
}
# alignments that take a tilt out
LEVELLING = ('se3', 'sim3')
STATEMENTS = {
    'quaternion_conjugated': '?invert=rotation',
    'pose_inverted': '?invert=pose',
}


def advice(name: str, detail: str = '') -> str:
    """Return what to do about a cause."""
    return f'{ADVICE[name]}' + (f' Here {detail}.' if detail else '')


def evidence(name: str, value: float, uncertainty: float) -> str:
    """Return what was measured of a cause, as the end of a sentence about that side."""
    return EVIDENCE[name].format(
        v=value,
        u=uncertainty,
        ms=1e3 * abs(value),
        ums=1e3 * uncertainty,
        late='late' if value > 0 else 'early',
        percent=100 * value,
    )


def flags(name: str, correction: Correction, config: EvaluationConfig) -> tuple[str, ...]:
    """
    Return the flags that correct a cause, given all causes' correction and the flags there are.

    What starts with a question mark goes behind the spec of the estimate.
    """
    if name == 'time_offset':
        return '--time-offset-s', plain(config.time_offset_s - correction.offset_s)
    if name in ('sensor_rotation', 'lever_arm') and correction.convention.axes is None:
        return '--estimate-to-body', *map(plain, _to_body(correction, config))
    if name == 'scale':
        return '--alignment', 'sim3'
    if name == 'gravity_tilt' and correction.scale == 1 and config.alignment not in LEVELLING:
        return '--alignment', 'se3'
    if name == 'quaternion_order':
        w_first = correction.convention.quaternion[0] == 1
        inverse = '&invert=rotation' * correction.convention.conjugate
        return (f'?quaternion={"wxyz" if w_first else "xyzw"}{inverse}',)
    return (STATEMENTS[name],) if name in STATEMENTS else ()


def _to_body(correction: Correction, config: EvaluationConfig) -> list[float]:
    """Return the body in the tracked frame: what is configured, and what was found behind it."""
    given = np.array(config.estimate_to_body)
    turn = rotation.normalize(given[3:])
    lever = given[:3] + rotation.rotate(turn, correction.lever)
    return [*lever.tolist(), *rotation.multiply(turn, correction.turn).tolist()]
