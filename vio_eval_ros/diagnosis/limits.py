"""What counts as healthy in a diagnosis, by platform."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from vio_eval_ros.core.limits import limit, Limits

#: where no publication gives a number
RUNS = 'chosen on the runs of docs/diagnose.md'
WHEELS = 'Wu et al. 2017, VINS on Wheels'
#: by profile: the limits that the platform changes, each with the reason
CHANGES: dict[str, dict[str, tuple[float, str]]] = {
    'car': {
        'scale_percent': (5.0, f'at constant acceleration it is not observable ({WHEELS})'),
        'gravity_tilt_deg': (
            3.0,
            f'without rotation roll and pitch are not observable ({WHEELS})',
        ),
        'lever_arm_m': (
            0.1,
            'ground truth by RTK-GNSS is accurate to some centimetres',
        ),
        'outlier_m': (0.5, 'ground truth by GNSS, at the speed of a car'),
    },
    'handheld': {
        'inertial': (
            False,
            'hand-held RGB-D and monocular SLAM often has no IMU',
        ),
    },
    'indoor_robot': {
        'scale_percent': (5.0, f'at constant acceleration it is not observable ({WHEELS})'),
        'gravity_tilt_deg': (
            3.0,
            f'without rotation roll and pitch are not observable ({WHEELS})',
        ),
    },
}


@dataclass(frozen=True)
class DiagnosisLimits(Limits):
    """What healthy runs show, and what is needed to name a cause."""

    PROFILED: ClassVar[Mapping[str, Mapping[str, float]]] = {
        profile: {name: value for name, (value, _) in changes.items()}
        for profile, changes in CHANGES.items()
    }

    time_offset_s: float = limit(0.005, 's', 'offset of the stamps', RUNS)
    clock_drift_s: float = limit(
        0.01, 's', 'offset that a clock drift has built up at either end of the run', RUNS
    )
    positions_late_s: float = limit(
        0.03,
        's',
        'offset between positions and orientations of one side',
        'published ground truth has up to 0.024 s',
    )
    sensor_rotation_deg: float = limit(
        1.0, 'deg', 'rotation between the tracked frame and the body', RUNS
    )
    lever_arm_m: float = limit(0.04, 'm', 'distance of the tracked point from the body', RUNS)
    gravity_tilt_deg: float = limit(1.5, 'deg', 'tilt of the world', RUNS)
    upright_deg: float = limit(
        45.0, 'deg', 'tilt of a world that was never meant to be upright', RUNS
    )
    scale_percent: float = limit(3.0, '%', 'scale error', RUNS)
    scale_drift_percent: float = limit(
        5.0, '%', 'scale error that a drift has built up at either end of the run', RUNS
    )
    yaw_drift_deg_per_min: float = limit(8.0, 'deg/min', 'drift of the heading', RUNS)
    yaw_drift_deg: float = limit(
        5.0, 'deg', 'drift of the heading over the whole run, where that allows more', RUNS
    )
    jump_m: float = limit(0.12, 'm', 'step of the position error between two poses', RUNS)
    jump_deg: float = limit(3.0, 'deg', 'step of the orientation error between two poses', RUNS)
    jump_ratio: float = limit(10.0, '', 'step over the steps of 90 % of the poses', RUNS)
    reset_m: float = limit(
        0.3, 'm', 'step that no healthy estimator makes to correct itself', RUNS
    )
    reset_deg: float = limit(
        10.0, 'deg', 'rotation that no healthy estimator makes to correct itself', RUNS
    )
    outlier_m: float = limit(0.2, 'm', 'distance of a pose from the median around it', RUNS)
    outlier_ratio: float = limit(15.0, '', 'that distance over its median along the run', RUNS)
    outliers_percent: float = limit(0.0, '%', 'share of such poses', RUNS)
    diverged_m: float = limit(1.0, 'm', 'error of an estimate that does not come back', RUNS)
    lost_tracking_percent: float = limit(
        3.0, '%', 'share of the duration of the ground truth without an estimate', RUNS
    )
    late_start_percent: float = limit(
        5.0,
        '%',
        'share of the ground truth before the first pose, above which a warning says how long the '
        'estimate took to initialise',
        'published runs on EuRoC begin up to 37 % late',
    )
    early_end_percent: float = limit(
        25.0,
        '%',
        'share of the run after the last keyframe of an irregular stream',
        'published keyframes on EuRoC end up to 15 % early',
    )
    still_m: float = limit(0.05, 'm', 'extent of the path below which a side is at rest', RUNS)
    still_deg: float = limit(5.0, 'deg', 'rotation below which a side is at rest', RUNS)
    moving_m: float = limit(
        0.2, 'm', 'extent that the drift of an estimate at rest does not reach', RUNS
    )
    clearly_moving_m: float = limit(
        1.0, 'm', 'extent that the noise of a side at rest does not reach', RUNS
    )
    frozen_s: float = limit(5.0, 's', 'time for which one position is repeated', RUNS)
    frozen_percent: float = limit(
        5.0, '%', 'share of the run for which one position is repeated', RUNS
    )
    shortest_s: float = limit(5.0, 's', 'duration below which no interval can be estimated', RUNS)
    confidence_percent: float = limit(80.0, '%', 'confidence that a cause needs', RUNS)
    improvement_percent: float = limit(
        5.0, '%', 'reduction of an error that undoing a cause needs', RUNS
    )
    jump_improvement_percent: float = limit(
        3.0, '%', 'reduction of the ATE that undoing a jump needs', RUNS
    )
    inertial: bool = limit(
        True, '', 'whether the system has an IMU: decides what is advised', 'a fact, not a limit',
        minimum=None,
    )  # fmt: skip


DEFAULT = DiagnosisLimits()
