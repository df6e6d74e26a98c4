"""
The one table of findings.

An entry says all that is known of a finding but how it is measured. A detector measures, and makes
its findings from the entry: ``FINDINGS['gap'].found(stream, count=2, ...)``. What ``--fail-on``
accepts, the order in which findings are listed and the tables in docs/inspect.md derive from here.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from vio_eval_ros.inspection.company import clock_of_one, held_up_alone, replay_of_all
from vio_eval_ros.inspection.finding import Finding, FindingKind, LEVELS

CLOCK_DRIFT = FindingKind(
    'clock_drift', 'streams', 'warn',
    when='two clocks drift apart evenly by more than {drift_ppm:g} ppm, and by {drift_s:g} s in '
    'all ({camera_drift_s:g} s between two cameras)',
    evidence={
        'recorder': 'the clock of the recorder gains {value:.1f} ± {interval:.1g} ppm on that of '
        'the stamps, {total_ms:.3g} ms over the recording',
        'cameras': 'the clock of {second} gains {value:.1f} ppm on that of {first}, '
        '{total_ms:.3g} ms over the recording',
    },
    cure='synchronise the clocks (PTP), or correct the stamps by the drift',
    unit='ppm',
)  # fmt: skip

_TIMES = (
    FindingKind(
        'silent', 'streams', 'fail', in_poses='warn',
        when='a topic was recorded, but has no messages',
        evidence='the topic was recorded, but has no messages',
        cure='check that the driver runs',
    ),
    FindingKind(
        'gap', 'streams', 'fail', in_poses='warn',
        when='no stamp for {gap_periods:g} T and for {gap_s:g} s',
        evidence='silent {times}, for up to {value:.3g} s; {lost} missing',
        cure='find what stopped: a full buffer, a busy disk, a loose cable',
        unit='s',
    ),
    FindingKind(
        'dropped', 'streams', 'warn',
        when='an interval is longer than 1.5 T and than jitter explains, but not a gap',
        minor='poses that do not come regularly',
        evidence='{lost} missing, up to {row:.0f} in a row; one is due every {period_ms:.4g} ms',
        cure='raise the bandwidth or the queues of driver and recorder, or lower the rate',
        unit='s',
    ),
    FindingKind(
        'duplicate_stamps', 'streams', 'warn',
        when='a stamp comes twice, or again within 0.001 T',
        severe='more than half of a sensor',
        evidence='{count} of {total} messages have the stamp of an earlier one{nearly}',
        cure='look for two publishers of the topic, or a driver that publishes twice',
        unit='ratio',
    ),
    FindingKind(
        'out_of_order', 'streams', 'fail', in_poses='warn',
        when='a stamp is earlier than that of the message before it in the file',
        evidence='{messages} stamped earlier than the one before, by up to {ms:.3g} ms',
        cure='sort by stamp before use; look for threads that publish in parallel',
        unit='s',
    ),
    FindingKind(
        'wrong_stamp', 'streams', 'warn',
        when='a few stamps leave the sequence and return to it, with no message missing',
        severe='a sensor, off by more than T',
        evidence='{messages} stamped wrong by up to {value:.3g} s, between others that are right; '
        'no message is missing there',
        cure='check the driver; drop those messages, or interpolate their stamps',
        unit='s',
    ),
    FindingKind(
        'jitter', 'streams', 'warn',
        when='periods deviate from T by {jitter_percent:g} % (99th percentile; {jitter_min_s:g} '
        'to {jitter_max_s:g} s), or one does by {single_jitter_s:g} s',
        minor='poses that do not come regularly',
        evidence='periods deviate from {period_ms:.4g} ms by {median_ms:.3g} ms (median), '
        '{p99_ms:.3g} ms (99th percentile) and {max_ms:.3g} ms (maximum){on_arrival}',
        cure='stamp where the sensor measures (trigger, hardware clock), not where it arrives',
        unit='s',
    ),
    FindingKind(
        'unstamped', 'streams', 'warn',
        when='a stamp is zero, and not the beginning of simulated time',
        severe='a sensor without any stamp',
        evidence='{count} of {total} messages have no stamp, or zero{instead}',
        cure='have the driver fill header.stamp',
    ),
    FindingKind(
        'late_start', 'streams', 'warn', in_poses='info',
        when='a stream begins {late_s:g} s, and {late_periods:g} T, after the first sensor',
        evidence='begins {value:.3g} s after the first {of}',
        cure='wait for all sensors before recording; start the evaluation where all have begun',
        unit='s',
    ),
    FindingKind(
        'early_end', 'streams', 'warn', in_poses='info',
        when='a stream ends {late_s:g} s, and {late_periods:g} T, before the last sensor',
        evidence='ends {value:.3g} s before the last {of}',
        cure='check the log of the driver; end the evaluation where the first sensor ends',
        unit='s',
    ),
    FindingKind(
        'no_common_span', 'sensors', 'fail',
        when='the stamps of the sensors do not overlap in time',
        evidence='the stamps of the sensors do not overlap in time: {spans}',
        cure='put all sensors on one clock',
    ),
    FindingKind(
        'unfinished', 'streams', 'warn',
        when='the recorder did not close its file, or metadata.yaml does not fit the files',
        evidence='{sentence}',
        cure='let the recorder end by itself, or write metadata.yaml with `ros2 bag reindex`',
    ),
    FindingKind(
        'left_out', 'streams', 'info',
        when='a topic cannot be read: its serialisation, two types, a type without definition',
        evidence='{sentence}',
        cure='convert or rename what cannot be read',
    ),
)  # fmt: skip

_CLOCKS = (
    CLOCK_DRIFT,
    FindingKind(
        'clock_step', 'streams', 'warn',
        when='the difference of the clocks steps by {clock_step_s:g} s and stays there',
        minor='the clock of the recorder, or transport, unless it is one sensor alone',
        evidence='a clock steps by {ms:.3g} ms, most likely {whose}',
        cure='do not set clocks while recording: let NTP or PTP slew them',
        unit='s',
        amended=clock_of_one,
    ),
    FindingKind(
        'clock_offset', 'streams', 'warn',
        when='a sensor is stamped {clock_offset_s:g} s off the others, or poses are by 5 s; or '
        'stamps are off the recording by whole hours or by the leap seconds of TAI or GPS',
        minor='stamps that are {latency_max_s:g} s older than the recording, or in its future',
        evidence={
            'sensors': 'stamped {apart:.4g} s {side} than {usual}, by the clock of the '
            'recorder{why}',
            'recorder': 'stamped {apart:.4g} s {side} it was recorded, at least: the two clocks '
            'differ{why}',
        },
        cure='synchronise the clocks; of poses that are recorded, `diagnose` finds how far apart '
        'they are, for --time-offset-s',
        unit='s',
    ),
    FindingKind(
        'late_arrival', 'streams', 'warn', in_poses='info',
        when='messages are recorded {late_arrival_s:g} s, 10 T and 10 spreads later than usual, '
        'between others that are not',
        minor='nothing else recorded meanwhile: the recorder stalled',
        evidence='{messages} recorded late, by up to {value:.3g} s',
        cure='find what held them up (disk, processor, bus); live, they arrive as late',
        unit='s',
        amended=held_up_alone,
    ),
    FindingKind(
        'replayed', 'streams', 'info',
        when='all streams drift by more than {replayed_ppm:g} ppm',
        evidence={
            'pace': 'the stamps run at {pace:.4g} times the speed of the clock of the recorder, '
            'as in a simulation or a replay',
            'still': 'the clock of the recorder does not advance with the stamps',
        },
        cure='nothing, if it was recorded from a simulation or a replay',
        unit='ppm',
        amended=partial(replay_of_all, CLOCK_DRIFT),
    ),
)  # fmt: skip

_CAMERAS = (
    FindingKind(
        'unsynchronised', 'cameras', 'warn',
        when='frames of two cameras have no partner within {partner_s:g} s, or rates differ',
        evidence={
            'some': 'frames without a partner: {counts}',
            'rates': '{count} of {frames} frames have no partner: the rates are {rates} Hz',
            'free': '{count} of {frames} frames have no partner: the cameras run freely{drift}',
        },
        cure='trigger the cameras together; drop frames that have no partner',
        unit='ratio',
    ),
    FindingKind(
        'camera_skew', 'cameras', 'warn',
        when='the median difference of their stamps is above {camera_skew_s:g} s',
        evidence='{second} is stamped {ms:.3g} ms {side} than {first}, ± {spread_ms:.2g} ms',
        cure='trigger the cameras together, or tell the estimator the offset',
        unit='s',
    ),
    FindingKind(
        'imu_rate', 'IMU', 'warn',
        when='fewer than {imu_samples_per_frame:g} samples of the IMU per image',
        evidence='{rate_hz:.4g} Hz are only {value:.3g} times the rate of {camera}; most '
        'estimators need a factor of {least:.0f} or more',
        cure='raise the rate of the IMU to ten times that of the cameras',
        unit='ratio',
    ),
)  # fmt: skip

_INERTIAL = (
    FindingKind(
        'saturation', 'IMU', 'fail',
        when='an axis stays at its extreme {saturation_samples} times, {saturation_run_samples} '
        'in a row, and more often than just below it',
        evidence='{samples} cut off at a limit: {axes}',
        cure='choose a larger range of the IMU, or move less',
    ),
    FindingKind(
        'stuck', 'IMU', 'warn',
        when='samples repeat the one before in more than {resent_percent:g} % of the recording',
        severe='{stuck_samples} in a row in all axes, {stuck_sensor_samples} in one sensor or '
        '{stuck_axis_samples} in one axis while the others move, or a sensor that is always zero',
        evidence={
            'repeated': '{count} samples repeat the one before in {axes}, up to {value} in a row',
            'zero': 'the {sensor} is zero throughout; if it does not exist, set the first element '
            'of its covariance to -1',
            'resent': '{count} of {total} samples equal the one before: a slower sensor, sent '
            'again',
        },
        cure='check the driver: it repeats samples instead of waiting for new ones',
        unit='samples',
    ),
    FindingKind(
        'spike', 'IMU', 'warn',
        when='up to three samples leave their surroundings by {spike_rate_rad_s:g} rad/s or '
        '{spike_acceleration_m_s2:g} m/s², and by ten times their range',
        severe='one that integrates to {spike_angle_rad:g} rad or {spike_speed_m_s:g} m/s',
        evidence='{samples} unlike those before and after: {axes}',
        cure='check the driver, its bus and its cable; drop such samples',
    ),
    FindingKind(
        'not_finite', 'IMU and poses', 'fail', in_poses='warn',
        when='NaN, infinite, or above 1e12',
        evidence='{samples} not finite',
        cure='check the driver',
    ),
    FindingKind(
        'units', 'IMU', 'fail',
        when='the median acceleration is near 1 (g) or 1000 (mg, cm/s²), the median rate near '
        '{gravity_m_s2:.3g} (exchanged) or above {degrees_rate_rad_s:g} rad/s (degrees), or '
        'gravity rotates as for rates in degrees',
        evidence={
            'acceleration': 'accelerations are about {value:.3g}: in {units}, not in m/s2',
            'exchanged': 'it measures {rate:.3g} rad/s and {value:.3g} m/s2: are '
            'gyroscope and accelerometer exchanged?',
            'rate': 'half of the time it rotates at {value:.3g} rad/s or more: in degrees?',
            'gravity': 'gravity rotates {factor:.0f} times slower than the gyroscope says, '
            '{value:.3g} rad/s in the median: in degrees?',
        },
        cure='convert to rad/s and m/s2, as sensor_msgs/Imu defines',
    ),
    FindingKind(
        'bias_step', 'IMU', 'warn',
        when='what the gyroscope is off by, against gravity, steps by {bias_step_rad_s:g} rad/s '
        'and makes a tilt of {bias_step_tilt_rad:g} rad in all',
        evidence='the bias of the gyroscope steps by {value:.2g} rad/s: from there on it '
        'disagrees with the rotation of gravity',
        cure='restart the estimator there; check the supply and the temperature of the IMU',
        unit='rad/s',
    ),
    FindingKind(
        'gravity', 'IMU', 'warn',
        when='at rest, the specific force is {gravity_tolerance_m_s2:g} m/s² off '
        '{gravity_m_s2:.4g}',
        evidence='at rest it measures {value:.4g} m/s2, not {gravity:.4g}',
        cure='calibrate the scale of the accelerometer, or correct its unit',
        unit='m/s2',
    ),
    FindingKind(
        'low_excitation', 'IMU', 'info',
        when='less than {excitation_rate_rad_s:g} rad/s (rms) about a second axis, or less than '
        '{excitation_acceleration_m_s2:g} m/s² of acceleration',
        evidence={
            'both': 'it rotates at {first:.2g} rad/s (rms) about one axis and {value:.2g} about a '
            'second (at least {least_rate} needed), and accelerates by {acceleration:.2g} m/s2 '
            '(at least {least_acceleration} needed)',
            'gyroscope': 'it rotates at {first:.2g} rad/s (rms) about one axis and {value:.2g} '
            'about a second (at least {least_rate} needed)',
            'accelerometer': 'it accelerates by {value:.2g} m/s2 (at least {least_acceleration} '
            'needed)',
        },
        cure='begin with rotation about two axes and with accelerations',
        unit='rad/s',
    ),
    FindingKind(
        'no_still_time', 'IMU', 'info',
        when='less than {still_s:g} s at rest at the beginning, which some estimators need',
        evidence='it begins with {value:.2g} s at rest ({least:g} s needed), and rests for '
        '{in_all:.3g} s in total',
        cure='stand still for a second, for estimators that initialise at rest',
        unit='s',
    ),
)  # fmt: skip

_POSES = (
    FindingKind(
        'frozen', 'poses', 'warn',
        when='{frozen_poses} poses in a row are equal to the last bit, and then leap or end',
        minor='poses that start slowly after it, as from rest',
        evidence='{count} poses repeat the one before to the last bit, for up to {value:.3g} s, '
        '{then}',
        cure='do not score while tracking is lost; have the source stop publishing then',
        unit='s',
    ),
    FindingKind(
        'jump', 'poses', 'warn',
        when='a step is {jump_m:g} m or {jump_rad:g} rad, and ten spreads, beyond the motion '
        'around it',
        evidence='{steps} far faster than the motion around, the largest of {value:.3g} {unit}',
        cure='look for lost tracking or a loop closure at that moment',
    ),
    FindingKind(
        'implausible_motion', 'poses', 'warn',
        when='1 % of the poses are faster than {max_speed_m_s:g} m/s or '
        '{max_rotation_rad_s:g} rad/s',
        evidence='1 % of the poses move at more than {value:.3g} {unit}',
        cure='check units, and markers that are confused',
    ),
    FindingKind(
        'two_publishers', 'poses', 'warn',
        when='poses of two or three trajectories, or clocks, take turns on one topic or transform',
        minor='poses that come twice',
        evidence={
            'mixed': '{name}{found}',
            'twice': '{name}{count} of {total} poses repeat the one before, at nearly the same '
            'stamp: two publishers of one trajectory',
        },
        cure='stop all but one of the publishers (`ros2 topic info -v`), or give each a topic',
        unit='m',
    ),
    FindingKind(
        'quaternion_norm', 'poses', 'warn',
        when='the length of a quaternion deviates from 1 by {quaternion_norm_tolerance:g}',
        evidence='{quaternions} not of length 1, by up to {value:.3g}',
        cure='normalise the quaternions at their source',
    ),
    FindingKind(
        'positions_only', 'poses', 'info',
        when='no orientation is usable, or all are the same while the position moves',
        evidence='the topic carries positions only: {why}',
        cure='score it as it is; figures that need its orientation are null',
    ),
    FindingKind(
        'frame_ids', 'streams', 'warn',
        when='messages name more than one frame',
        evidence='messages name different frames: {names}',
        cure='look for two publishers of the topic',
    ),
)  # fmt: skip

_CALIBRATION = (
    FindingKind(
        'not_a_rotation', 'calibration', 'fail',
        when='RᵀR deviates from the identity by {rotation_tolerance:g}, R is a reflection, or the '
        'last row is not 0 0 0 1',
        evidence='the rotation of {key} deviates from orthonormal by {value:.2g} and has '
        'determinant {determinant:.4g}; its last row is {row}',
        cure='write all digits, no scale, no reflection, and 0 0 0 1 as the last row',
    ),
    FindingKind(
        'direction', 'calibration', 'warn',
        when='what does not fit would, if a transformation were inverted or its rotation '
        'transposed: the chain, cameras side by side, or a camera within {upright_deg:g} degrees '
        'of upright',
        minor='a camera that may be mounted upside down',
        evidence={
            'chain': '{apart}, but would not if {ways}',
            'beside': '{second} is not beside {first}, but would be if {ways}',
            'upright': 'at rest {axis} of {camera} points up; it would stand upright if its '
            'rotation in {key} were transposed, or all of it inverted',
        },
        cure='invert the transformation, or name it for what it maps',
    ),
    FindingKind(
        'lever_arm', 'calibration', 'warn',
        when='a translation is longer than {lever_arm_m:g} m: millimetres?',
        severe='ten times as long',
        evidence='translations are longer than {limit:g} m ({arms}): in millimetres?',
        cure='give translations in metres',
        unit='m',
    ),
    FindingKind(
        'baseline', 'calibration', 'warn',
        when='two cameras are closer than {baseline_min_m:g} m or further apart than '
        '{baseline_max_m:g} m',
        evidence='its baseline to {first} is {value:.4g} m',
        cure='give translations in metres',
        unit='m',
    ),
    FindingKind(
        'camera_order', 'calibration', 'warn',
        when='the first of two cameras that look the same way is the right one',
        evidence='{first} is the right camera, {second} the left{unless}',
        cure='swap the cameras if the estimator expects the left one first',
        unit='m',
    ),
    FindingKind(
        'chain_mismatch', 'calibration', 'warn',
        when='`T_cn_cnm1` and `T_cam_imu`, or two files, differ by {mismatch_m:g} m or '
        '{mismatch_deg:g} degrees, and no `direction` explains it',
        evidence='{apart}',
        cure='recalibrate, or find out which file is out of date',
        unit='m',
    ),
    FindingKind(
        'timeshift', 'calibration', 'warn',
        when='`timeshift_cam_imu` is above {timeshift_s:g} s',
        evidence='{value:.3g} s between camera and IMU',
        cure='correct the stamps by the offset that was calibrated',
        unit='s',
    ),
    FindingKind(
        'imu_noise', 'calibration', 'warn',
        when='a density is missing, unlike that of any IMU, or smaller than its random walk; or '
        'the rate is {imu_rate_tolerance_percent:g} % off that of the recording',
        severe='one that is not positive',
        evidence={
            'range': '{key} is {value:g} {unit}; IMUs have {least:g} to {most:g}',
            'lacking': '{keys} missing',
            'exchanged': '{walk} {large:g} is larger than {density} {small:g}: exchanged?',
            'rate': '{key} is {value:g} Hz; the IMU of the recording has {recorded} Hz',
        },
        cure='give densities in continuous time and SI units, as imu_noise prints them',
    ),
)  # fmt: skip

#: Every finding that there is, by name, in the order in which they are listed.
FINDINGS: dict[str, FindingKind] = {
    kind.name: kind
    for kinds in (_TIMES, _CLOCKS, _CAMERAS, _INERTIAL, _POSES, _CALIBRATION)
    for kind in kinds
}


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings by level, and within it in the order of the table."""
    names = list(FINDINGS)
    return sorted(
        findings, key=lambda one: (-LEVELS.index(one.level), names.index(one.name), one.topic)
    )
