"""The limits of ``inspect``: what a user, or a platform, may hold another opinion on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from vio_eval_ros.core.limits import limit, Limits

#: the source of every limit that is not from a publication or a data sheet
CHOSEN = 'chosen on the recordings of docs/inspect.md'


#: by profile: the limits that the platform changes, each with the reason
CHANGES: dict[str, dict[str, tuple[float, str]]] = {
    'car': {
        'max_rotation_rad_s': (5.0, 'a car that spins on ice stays below'),
        'lever_arm_m': (6.0, 'the sensors of a vehicle are metres apart'),
    },
    'handheld': {
        'max_speed_m_s': (12.5, 'the fastest sprinters reach 12.4 m/s'),
    },
    'legged': {
        'max_speed_m_s': (10.0, 'legged robots run at 1 to 5 m/s'),
        'spike_acceleration_m_s2': (
            20.0,
            'a foot that touches down shakes the body by 1 to 2 g within a sample',
        ),
    },
    'indoor_robot': {
        'max_speed_m_s': (5.0, 'indoor robots drive at up to 2 m/s'),
        'max_rotation_rad_s': (10.0, 'they turn at up to 4 rad/s'),
    },
}


@dataclass(frozen=True)
class InspectionLimits(Limits):
    """From where on ``inspect`` finds something; ``ConfigError`` where a value makes no sense."""

    PROFILED: ClassVar[Mapping[str, Mapping[str, float]]] = {
        profile: {name: value for name, (value, _) in changes.items()}
        for profile, changes in CHANGES.items()
    }

    # when messages come
    gap_s: float = limit(0.1, 's', 'a gap lasts at least this', CHOSEN)
    gap_periods: float = limit(10.0, 'periods', 'and at least this', CHOSEN)
    jitter_percent: float = limit(
        3.0, '% of the period', '99th percentile of the deviation from the period', CHOSEN
    )
    jitter_min_s: float = limit(
        0.0005, 's', 'deviation that is always accepted, up to 20 % of the period', CHOSEN
    )
    jitter_max_s: float = limit(0.0015, 's', 'deviation above which it is always found', CHOSEN)
    single_jitter_s: float = limit(
        0.002, 's', 'deviation of a single interval, or 40 % of a period below 5 ms', CHOSEN
    )
    late_s: float = limit(0.5, 's', 'a stream begins or ends apart from the sensors', CHOSEN)
    late_periods: float = limit(5.0, 'periods', 'and by at least this', CHOSEN)
    rate_tolerance_percent: float = limit(
        1.0, '%', 'deviation from an expected rate_hz without rate_tolerance', CHOSEN
    )
    imu_samples_per_frame: float = limit(
        5.0, '', 'an IMU with fewer samples per image is slow', CHOSEN
    )
    # clocks
    drift_ppm: float = limit(
        10.0, 'ppm', 'drift between stamps and recorder, or between cameras', CHOSEN
    )
    drift_s: float = limit(
        0.0009, 's', 'that it amounts to against the recorder, whose transport wanders', CHOSEN
    )
    camera_drift_s: float = limit(0.0002, 's', 'that it amounts to between cameras', CHOSEN)
    replayed_ppm: float = limit(
        1000.0, 'ppm', 'a drift that no clock has',
        'quartz crystals are specified to 10 to 100 ppm',
    )  # fmt: skip
    clock_step_s: float = limit(0.005, 's', 'step of one clock against the other', CHOSEN)
    clock_offset_s: float = limit(
        0.5, 's', 'offset of the clock of a sensor from that of the others', CHOSEN
    )
    latency_min_s: float = limit(
        -0.001, 's', 'stamps later than the recording by more: another clock', CHOSEN, None
    )
    latency_max_s: float = limit(
        1.0, 's', 'stamps earlier than the recording by more: another clock', CHOSEN
    )
    late_arrival_s: float = limit(
        0.5, 's', 'delay of messages between others that are not delayed', CHOSEN
    )
    # cameras
    partner_s: float = limit(
        0.001, 's', 'difference of partner frames from the usual skew of two cameras', CHOSEN
    )
    camera_skew_s: float = limit(
        0.0005, 's', 'skew of two cameras',
        'half a pixel of blur at 1 rad/s and a focal length of 500 pixels',
    )  # fmt: skip
    # samples of an IMU
    stuck_samples: int = limit(5, 'samples', 'in a row equal in all six axes', CHOSEN, 2)
    stuck_sensor_samples: int = limit(
        10, 'samples', 'in a row equal in the gyroscope or the accelerometer', CHOSEN, 2
    )
    stuck_axis_samples: int = limit(50, 'samples', 'in a row equal in one axis', CHOSEN, 2)
    resent_percent: float = limit(
        10.0, '%', 'of the samples equal to the one before: sent again', CHOSEN
    )
    saturation_samples: int = limit(5, 'samples', 'at the extreme of an axis', CHOSEN, 1)
    saturation_run_samples: int = limit(3, 'samples', 'of them in a row', CHOSEN, 1)
    spike_rate_rad_s: float = limit(1.0, 'rad/s', 'spike of the gyroscope', CHOSEN)
    spike_acceleration_m_s2: float = limit(5.0, 'm/s²', 'spike of the accelerometer', CHOSEN)
    spike_angle_rad: float = limit(0.1, 'rad', 'angle that a spike integrates to: fail', CHOSEN)
    spike_speed_m_s: float = limit(0.5, 'm/s', 'speed that a spike integrates to: fail', CHOSEN)
    # motion of an IMU
    still_rate_rad_s: float = limit(0.02, 'rad/s', 'spread of angular rates at rest', CHOSEN)
    still_acceleration_m_s2: float = limit(
        0.15, 'm/s²', 'spread of specific forces at rest', CHOSEN
    )
    still_s: float = limit(
        1.0, 's', 'least time at rest',
        'msckf_vio initialises on the mean of 200 samples, 1 s at 200 Hz',
    )  # fmt: skip
    gravity_m_s2: float = limit(
        9.80665, 'm/s²', 'specific force at rest', 'standard gravity, CGPM 1901'
    )
    gravity_tolerance_m_s2: float = limit(
        0.5, 'm/s²', 'deviation from it',
        '5 %: latitude explains 0.5 %, a calibrated accelerometer 1 %',
    )  # fmt: skip
    degrees_rate_rad_s: float = limit(
        10.0, 'rad/s', 'median rate that means degrees per second', CHOSEN
    )
    bias_step_rad_s: float = limit(0.03, 'rad/s', 'step of the bias of a gyroscope', CHOSEN)
    bias_step_tilt_rad: float = limit(
        1.0, 'rad', 'tilt that it makes in all; accelerations that look like one make less', CHOSEN
    )
    excitation_rate_rad_s: float = limit(0.05, 'rad/s', 'rms rate about a second axis', CHOSEN)
    excitation_acceleration_m_s2: float = limit(
        0.25, 'm/s²', 'standard deviation of the specific force',
        'VINS-Mono, initialStructure(): excitation of the IMU (Qin et al., T-RO 2018)',
    )  # fmt: skip
    # poses
    frozen_poses: int = limit(5, 'poses', 'in a row equal to the last bit', CHOSEN, 2)
    jump_m: float = limit(0.05, 'm', 'step of the position beyond the motion around', CHOSEN)
    jump_rad: float = limit(0.2, 'rad', 'step of the orientation beyond the motion around', CHOSEN)
    max_speed_m_s: float = limit(
        60.0, 'm/s', 'speed of 1 % of the poses', 'above cars on a motorway and racing drones'
    )
    max_rotation_rad_s: float = limit(
        25.0, 'rad/s', 'rate of rotation of 1 % of the poses', 'above drones in a flip'
    )
    quaternion_norm_tolerance: float = limit(
        0.01, '', 'deviation of the length of quaternions from 1', CHOSEN
    )
    # calibration
    rotation_tolerance: float = limit(
        0.001, '', 'deviation of RᵀR from the identity', 'three digits, as files are rounded'
    )
    lever_arm_m: float = limit(2.0, 'm', 'translation; ten times it fails', CHOSEN)
    baseline_min_m: float = limit(0.005, 'm', 'least distance of two cameras', CHOSEN)
    baseline_max_m: float = limit(2.0, 'm', 'largest distance of two cameras', CHOSEN)
    mismatch_m: float = limit(0.005, 'm', 'difference of two calibrations', CHOSEN)
    mismatch_deg: float = limit(0.5, 'deg', 'difference of two calibrations', CHOSEN)
    upright_deg: float = limit(20.0, 'deg', 'tilt of a camera that stands upright', CHOSEN)
    timeshift_s: float = limit(0.1, 's', 'offset between camera and IMU', CHOSEN)
    imu_rate_tolerance_percent: float = limit(
        10.0, '%', 'deviation of the rate in a file from that of the recording', CHOSEN
    )
