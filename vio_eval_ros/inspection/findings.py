"""What can be found in a recording, and what cures it."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

from vio_eval_ros.core.sensor_stream import Moment

LEVELS = ('info', 'warn', 'fail')

#: Every name that a finding can have, and what to do about it.
CURES = {
    # when the messages come
    'silent': 'see whether the driver runs; nothing came on a topic that was recorded',
    'gap': 'find what stopped: a full buffer, a busy disk, a loose cable',
    'dropped': 'raise the bandwidth or the queues of driver and recorder, or lower the rate',
    'duplicate_stamps': 'look for two publishers of the topic, or a driver that stamps twice',
    'out_of_order': 'sort by stamp before use; look for threads that publish in parallel',
    'wrong_stamp': 'look into the driver; drop those messages, or stamp them as those around',
    'jitter': 'stamp where the sensor measures (trigger, hardware clock), not where it arrives',
    'unstamped': 'have the driver fill header.stamp',
    'late_start': 'wait for all sensors before recording; begin evaluation where all are there',
    'early_end': 'look into the log of the driver; end the evaluation where all are there',
    'no_common_span': 'put all sensors on one clock',
    'left_out': 'convert or rename what cannot be read',
    # clocks
    'clock_drift': 'synchronise the clocks (PTP), or correct the stamps by the drift',
    'clock_step': 'do not set clocks while recording: let NTP or PTP slew them',
    'clock_offset': 'synchronise the clocks; compare stamps with stamps only',
    'late_arrival': 'find what held them up (disk, processor, bus): live, they come as late',
    'replayed': 'nothing, where it was recorded from a simulation or a replay',
    # several streams
    'unsynchronised': 'trigger the cameras together; drop frames that have no partner',
    'camera_skew': 'trigger the cameras together, or tell the estimator the offset',
    'imu_rate': 'raise the rate of the IMU to ten times that of the cameras',
    # inertial
    'saturation': 'choose a larger range of the IMU, or move less',
    'stuck': 'look into the driver: it repeats samples where new ones are missing',
    'spike': 'look into the driver, its bus and its cable; leave such samples out',
    'not_finite': 'look into the driver',
    'units': 'convert to rad/s and m/s2, as sensor_msgs/Imu wants it',
    'bias_step': 'restart the estimator there; look into the supply and the heat of the IMU',
    'gravity': 'calibrate the scale of the accelerometer, or correct its unit',
    'low_excitation': 'begin with rotation about two axes and with accelerations',
    'no_still_time': 'stand still for a second, for estimators that initialise at rest',
    # poses
    'frozen': 'do not score while tracking is lost; have the source stop publishing then',
    'jump': 'look for lost tracking or a loop closure at that moment',
    'implausible_motion': 'check units, and markers that are confused',
    'quaternion_norm': 'normalise the quaternions at their source',
    # frames
    'frame_ids': 'look for two publishers of the topic',
    # calibration
    'not_a_rotation': 'give all digits, no scale, no reflection, and 0 0 0 1 as the last row',
    'direction': 'invert the transformation, or name it for what it maps',
    'lever_arm': 'give translations in metres',
    'baseline': 'give translations in metres',
    'camera_order': 'exchange the cameras where the estimator wants the left one first',
    'chain_mismatch': 'calibrate again, or find out which file is out of date',
    'timeshift': 'correct the stamps by the offset that was calibrated',
    'imu_noise': 'give densities in continuous time and SI units, as imu_noise prints them',
}

#: Those that are good to know and never worse.
ALWAYS_INFO = ('left_out', 'replayed', 'low_excitation', 'no_still_time')


@dataclass(frozen=True)
class Finding:
    """
    Something that was found in a stream.

    :param name: a key of :data:`CURES`.
    :param topic: or what else it was found in.
    :param level: ``fail`` where an estimator will go wrong, ``warn`` where it will be worse,
        ``info`` for what one should know.
    :param message: a sentence, with its numbers.
    :param count: how often.
    :param value: the figure that stands for it, in ``unit``; NaN where there is none.
    :param moments: when; of many only the first ones.
    """

    name: str
    topic: str
    level: str
    message: str
    count: int = 1
    value: float = math.nan
    unit: str = ''
    moments: tuple[Moment, ...] = ()

    @property
    def advice(self) -> str:
        """What to do about it, a sentence."""
        cure = CURES[self.name]
        return f'{cure[0].upper()}{cure[1:]}.'

    def to_dict(self) -> dict[str, Any]:
        """Return the finding for JSON."""
        return {
            **{key: value for key, value in vars(self).items() if key != 'moments'},
            'value': self.value if math.isfinite(self.value) else None,
            'advice': self.advice,
            'at': [
                {'begin_ns': moment.begin_ns, 'end_ns': moment.end_ns} for moment in self.moments
            ],
        }


def are(count: int, noun: str) -> str:
    """Return the beginning of a sentence: 1 sample is, 2 samples are."""
    return f'{count} {noun} is' if count == 1 else f'{count} {noun}s are'


def worst_first(findings: list[Finding]) -> list[Finding]:
    """Return findings by level, and within it in the order of the table of names."""
    names = list(CURES)
    return sorted(
        findings, key=lambda one: (-LEVELS.index(one.level), names.index(one.name), one.topic)
    )
