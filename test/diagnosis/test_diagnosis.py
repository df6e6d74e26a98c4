"""Each fault, put into a simulated flight, is named and measured; the flight alone is not."""

from dataclasses import replace
import json
import math
import warnings

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.diagnosis.fitting import student
from vio_eval_ros.diagnosis.geometry import fit_scale
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.errors import NoPairs
from vio_eval_ros.simulation import Drift, simulate

CONFIG = EvaluationConfig()
FLIGHT = simulate(duration_s=60.0)
ESTIMATE, TRUTH = FLIGHT.estimate, FLIGHT.ground_truth
HEALTHY = diagnose(ESTIMATE, TRUTH, CONFIG)


def diagnosis_of(estimate: Trajectory, **options: object):
    return diagnose(estimate, TRUTH, EvaluationConfig(**options))


def names(diagnosis) -> list[str]:
    return [cause.name for cause in diagnosis.causes]


def about(axis: list[float], degrees: float) -> np.ndarray:
    direction = np.array(axis) / np.linalg.norm(axis)
    return rotation.from_rotation_vector(direction * math.radians(degrees))


def late(seconds: float, poses: Trajectory = ESTIMATE) -> Trajectory:
    return replace(poses, stamps_ns=poses.stamps_ns + round(seconds * 1e9))


def test_a_confidence_is_that_of_students_distribution():
    # two-sided quantiles of 5 degrees of freedom, from printed tables
    for t, probability in (
        (0.0, 0.5),
        (0.920, 0.8),
        (2.015, 0.95),
        (2.571, 0.975),
        (6.869, 0.9995),
    ):
        assert student(t) == pytest.approx(probability, abs=2e-4)
        assert student(-t) == pytest.approx(1 - probability, abs=2e-4)
    assert student(math.inf) == 1


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['walk', 'noise'])
def test_the_interval_of_a_scale_holds_though_errors_walk_at_random(kind):
    held = 0
    for seed in range(40):
        source = np.random.default_rng(seed)
        flight = simulate(duration_s=120.0, seed=seed, drift=Drift(0, 0, 1, 0, 0))
        errors = source.normal(0, 0.01, flight.estimate.positions.shape)
        errors = np.cumsum(errors, axis=0) if kind == 'walk' else errors
        off = replace(flight.estimate, positions=flight.estimate.positions + errors)
        run = DiagnosedRun(off, flight.ground_truth, CONFIG)
        scale = fit_scale(run.pairs(Correction(run.middle_ns)))
        held += abs(scale.value - 1) <= scale.uncertainty
    assert 34 <= held  # of 40; 38 are due


def test_a_healthy_flight_has_nothing_unusual():
    assert names(HEALTHY) == []
    assert HEALTHY.cannot_tell == ()
    assert HEALTHY.errors_after == HEALTHY.errors_before


@pytest.mark.slow
@pytest.mark.parametrize('seconds', [0.01, -0.03, 0.2, -4.0, 9.5])
def test_a_time_offset_comes_back_to_half_a_millisecond(seconds):
    found = diagnosis_of(late(seconds))
    assert names(found) == ['time_offset']
    cause = found.causes[0]
    assert cause.value == pytest.approx(seconds, abs=5e-4)
    assert abs(cause.value - seconds) <= cause.uncertainty < 3e-3
    assert cause.flags[0] == '--time-offset-s'
    assert float(cause.flags[1]) == pytest.approx(-seconds, abs=5e-4)


def test_the_flags_of_an_offset_go_on_top_of_those_given():
    cause = diagnosis_of(late(0.1), time_offset_s=-0.06).causes[0]
    assert cause.value == pytest.approx(0.04, abs=5e-4)
    assert float(cause.flags[1]) == pytest.approx(-0.1, abs=5e-4)


def test_clocks_that_started_apart_are_brought_together():
    found = diagnosis_of(late(-1_403_715_000.0))
    assert names(found) == ['time_offset']
    assert found.causes[0].value == pytest.approx(-1_403_715_000.0, abs=5e-4)
    assert math.isnan(found.causes[0].ate_before_m)
    assert found.causes[0].ate_after_m < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ('agreed', 'late_s', 'expected'),
    [
        (0, 0.0, {'clock_drift'}),
        (600, 0.0, {'clock_drift'}),
        (0, 0.1, {'time_offset', 'clock_drift'}),
    ],
)
def test_a_clock_that_drifts_is_distinguished_from_one_that_is_off(agreed, late_s, expected):
    elapsed_ns = ESTIMATE.stamps_ns - ESTIMATE.stamps_ns[agreed]
    drifting = replace(ESTIMATE, stamps_ns=ESTIMATE.stamps_ns + elapsed_ns * 2 // 1000)
    found = diagnosis_of(late(late_s, drifting))
    assert set(names(found)) == expected
    drift = next(cause for cause in found.causes if cause.name == 'clock_drift')
    assert drift.value == pytest.approx(2000, abs=20)
    apart_ns = found.corrected.stamps_ns - ESTIMATE.stamps_ns
    assert np.abs(apart_ns).max() < 3e6


@pytest.mark.slow
@pytest.mark.parametrize('factor', [0.2, 0.9, 1.1, 5.0])
def test_a_scale_is_recovered_to_a_thousandth(factor):
    found = diagnosis_of(replace(ESTIMATE, positions=factor * ESTIMATE.positions))
    assert names(found) == ['scale']
    usual = HEALTHY.findings['scale']['value']
    assert found.causes[0].value == pytest.approx(factor * usual, rel=1e-3)
    assert found.causes[0].flags == ('--alignment', 'sim3')


def test_no_scale_is_named_where_the_alignment_takes_it_out():
    found = diagnosis_of(replace(ESTIMATE, positions=2 * ESTIMATE.positions), alignment='sim3')
    assert names(found) == []


@pytest.mark.slow
@pytest.mark.parametrize('degrees', [3.0, 90.0, 179.0])
def test_a_turned_sensor_is_turned_back(degrees):
    turn = about([1, -2, 0.5], degrees)
    found = diagnosis_of(replace(ESTIMATE, rotations=rotation.multiply(ESTIMATE.rotations, turn)))
    assert names(found) == ['sensor_rotation']
    back = np.array(found.findings['sensor_rotation_xyzw'])
    left = rotation.multiply(turn, back)
    usual = np.array(HEALTHY.findings['sensor_rotation_xyzw'])
    assert math.degrees(rotation.angle_between(left, usual)) < 0.2
    assert len(found.causes[0].flags) == 8


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(4))
def test_noise_of_the_true_orientations_passes_for_no_offset(seed):
    rng = np.random.default_rng(seed)
    noise = rotation.from_rotation_vector(rng.normal(0, 2e-3, (len(TRUTH), 3)))
    noisy = replace(TRUTH, rotations=rotation.multiply(TRUTH.rotations, noise))
    found = diagnose(late(0.0371), noisy, CONFIG).findings['time_offset']
    assert abs(found['value'] - 0.0371) <= found['uncertainty'] < 3e-3
    assert found['value'] == pytest.approx(0.0371, abs=1e-3)


def on_a_floor(poses: Trajectory, noise: float, rng: np.random.Generator) -> Trajectory:
    # what a wheeled robot does: the heading alone turns
    heading = rotation.to_rotation_vector(poses.rotations)[:, 2]
    turns = rotation.from_rotation_vector(np.outer(heading, [0, 0, 1]))
    wobble = rotation.from_rotation_vector(rng.normal(0, noise, (len(poses), 3)))
    return replace(
        poses,
        positions=poses.positions * [1, 1, 0],
        rotations=rotation.multiply(turns, wobble),
    )


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(4))
def test_rotations_about_one_axis_show_neither_sensor_nor_conventions(seed):
    rng, run = np.random.default_rng(seed), simulate(duration_s=30.0, seed=seed)
    found = diagnose(
        on_a_floor(run.estimate, 3e-3, rng), on_a_floor(run.ground_truth, 1e-3, rng), CONFIG
    )
    assert names(found) == []
    assert {'sensor_rotation', 'axes_swapped', 'pose_inverted'} <= set(found.cannot_tell)


def test_a_lever_arm_is_found_to_a_centimetre():
    lever = np.array([0.1, -0.2, 0.05])
    moved = ESTIMATE.positions + rotation.rotate(ESTIMATE.rotations, lever)
    found = diagnosis_of(replace(ESTIMATE, positions=moved))
    assert names(found) == ['lever_arm']
    back = np.array(found.findings['lever_arm_m']) - np.array(HEALTHY.findings['lever_arm_m'])
    assert np.linalg.norm(back + lever) < 0.01


def test_the_flags_of_a_frame_correct_what_they_say():
    turn, lever = about([0, 1, 1], 30.0), np.array([0.3, 0.1, -0.2])
    harmed = replace(
        ESTIMATE,
        positions=ESTIMATE.positions + rotation.rotate(ESTIMATE.rotations, lever),
        rotations=rotation.multiply(ESTIMATE.rotations, turn),
    )
    found = diagnosis_of(harmed)
    assert set(names(found)) == {'sensor_rotation', 'lever_arm'}
    pose = tuple(map(float, found.causes[0].flags[1:]))
    assert names(diagnosis_of(harmed, estimate_to_body=pose)) == []


def test_a_tilted_world_is_found_to_a_tenth_of_a_degree():
    tilt = about([1, 1, 0], 4.0)
    found = diagnosis_of(
        replace(
            ESTIMATE,
            positions=rotation.rotate(tilt, ESTIMATE.positions),
            rotations=rotation.multiply(tilt, ESTIMATE.rotations),
        )
    )
    assert names(found) == ['gravity_tilt']
    assert found.causes[0].value == pytest.approx(4.0, abs=0.1)


def test_the_flags_of_two_causes_do_not_undo_each_other():
    tilt = about([1, 1, 0], 4.0)
    harmed = replace(
        ESTIMATE,
        positions=1.2 * rotation.rotate(tilt, ESTIMATE.positions),
        rotations=rotation.multiply(tilt, ESTIMATE.rotations),
    )
    for alignment in ('posyaw', 'se3'):
        found = diagnosis_of(harmed, alignment=alignment)
        assert set(names(found)) == {'scale', 'gravity_tilt'}
        assert {c.flags for c in found.causes if c.flags} == {('--alignment', 'sim3')}


def test_of_a_world_that_never_was_upright_no_tilt_can_be_determined():
    turn = about([1, 0, 0], 100.0)
    found = diagnosis_of(
        replace(
            ESTIMATE,
            positions=rotation.rotate(turn, ESTIMATE.positions),
            rotations=rotation.multiply(turn, ESTIMATE.rotations),
        )
    )
    assert names(found) == []
    assert 'gravity_tilt' in found.cannot_tell


def test_a_jump_is_found_at_its_sample():
    positions = ESTIMATE.positions.copy()
    positions[600:] += [0.3, -0.4, 0.1]
    found = diagnosis_of(replace(ESTIMATE, positions=positions))
    assert names(found) == ['jump']
    (jump,) = found.findings['jumps']
    assert jump['stamp_ns'] == ESTIMATE.stamps_ns[600]
    assert found.causes[0].value == pytest.approx(math.sqrt(0.26), abs=0.03)
    assert found.causes[0].ate_after_m == pytest.approx(HEALTHY.errors_before['ATE [m]'], rel=0.05)


@pytest.mark.parametrize('metres', [0.0, 0.5])
def test_a_reset_that_turns_the_world_is_a_jump(metres):
    turn, half = about([0, 0, 1], 17.0), len(ESTIMATE) // 2
    positions, rotations = ESTIMATE.positions.copy(), ESTIMATE.rotations.copy()
    here = positions[half].copy()
    positions[half:] = rotation.rotate(turn, positions[half:] - here) + here + [metres, 0, 0]
    rotations[half:] = rotation.multiply(turn, rotations[half:])
    found = diagnosis_of(replace(ESTIMATE, positions=positions, rotations=rotations))
    assert names(found) == ['jump']
    (jump,) = found.findings['jumps']
    assert jump['turn_deg'] == pytest.approx(17.0, abs=0.5)
    assert jump['size_m'] == pytest.approx(metres, abs=0.05)
    assert found.errors_after['ATE [m]'] < 1.3 * HEALTHY.errors_before['ATE [m]']


def test_a_burst_of_poses_that_returns_is_made_of_outliers():
    positions = ESTIMATE.positions.copy()
    positions[300:312] += [1.0, 0.0, 0.0]
    positions[700:708] += [0.0, -1.5, 0.0]
    found = diagnosis_of(replace(ESTIMATE, positions=positions))
    assert names(found) == ['outliers']
    assert len(found.findings['outlier_poses']['stamps_ns']) == 20


def test_outliers_of_a_third_of_the_poses_are_still_outliers():
    rng = np.random.default_rng(1)
    rows = rng.choice(len(ESTIMATE), len(ESTIMATE) // 3, replace=False)
    positions = ESTIMATE.positions.copy()
    positions[rows] += 2 * rng.normal(size=(len(rows), 3))
    assert names(diagnosis_of(replace(ESTIMATE, positions=positions)))[0] == 'outliers'


def test_who_flies_fifty_metres_away_does_not_hide_in_the_fit():
    count = len(ESTIMATE) // 5
    positions = ESTIMATE.positions.copy()
    positions[-count:] += np.linspace(0, 1, count)[:, None] ** 2 * [50.0, 0.0, 0.0]
    found = diagnosis_of(replace(ESTIMATE, positions=positions))
    assert names(found) == ['diverged']
    assert found.causes[0].value == pytest.approx(0.2, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize('share', [0.1, 0.3, 0.5])
def test_poses_that_are_dropped_all_over_the_run_are_lost(share):
    kept = np.random.default_rng(0).random(len(ESTIMATE)) > share
    found = diagnosis_of(ESTIMATE[kept])
    assert names(found) == ['lost_tracking']
    assert found.causes[0].value == pytest.approx(share, abs=0.03)
    assert names(diagnosis_of(ESTIMATE[::2])) == []


def test_an_estimate_that_repeats_its_pose_has_lost_track():
    positions, rotations = ESTIMATE.positions.copy(), ESTIMATE.rotations.copy()
    positions[600:], rotations[600:] = positions[600], rotations[600]
    found = diagnosis_of(replace(ESTIMATE, positions=positions, rotations=rotations))
    assert names(found) == ['lost_tracking']


def test_no_estimate_as_bad_as_none_is_called_healthy():
    nowhere = replace(ESTIMATE, positions=0 * ESTIMATE.positions)
    assert names(diagnosis_of(nowhere)) == ['insufficient_motion']
    walk = np.cumsum(np.random.default_rng(0).normal(0, 3e-3, (len(ESTIMATE), 3)), axis=0)
    assert names(diagnosis_of(replace(ESTIMATE, positions=walk))) != []


@pytest.mark.parametrize('seed', range(4))
def test_two_seconds_show_nothing(seed):
    run = simulate(duration_s=2.0, seed=seed)
    found = diagnose(run.estimate, run.ground_truth, CONFIG)
    assert names(found) == []
    assert {'time_offset', 'scale', 'sensor_rotation'} <= set(found.cannot_tell)


def test_a_step_that_takes_back_an_error_is_no_fault():
    # half of the run is off by what the step takes back
    positions = ESTIMATE.positions.copy()
    ramp = np.concatenate([np.linspace(0, 1, 600), np.zeros(len(positions) - 600)])
    positions += ramp[:, None] * [0.3, 0.0, 0.0]
    found = diagnosis_of(replace(ESTIMATE, positions=positions))
    assert 'jump' not in names(found)
    assert [jump['harmful'] for jump in found.findings['jumps']] == [False]


def test_outliers_are_those_that_were_put_there():
    rng = np.random.default_rng(3)
    rows = np.sort(rng.choice(len(ESTIMATE), 24, replace=False))
    positions = ESTIMATE.positions.copy()
    positions[rows] += 0.8 * rng.normal(size=(24, 3)) + 0.5
    found = diagnosis_of(replace(ESTIMATE, positions=positions))
    assert names(found) == ['outliers']
    assert found.causes[0].value == pytest.approx(24 / len(ESTIMATE), rel=0.1)
    assert set(found.findings['outlier_poses']['stamps_ns']) <= set(ESTIMATE.stamps_ns[rows])


@pytest.mark.parametrize('lost', [slice(300, 500), slice(900, None)])
def test_lost_tracking_is_a_gap_or_an_early_end(lost):
    kept = np.ones(len(ESTIMATE), bool)
    kept[lost] = False
    found = diagnosis_of(ESTIMATE[kept])
    assert names(found) == ['lost_tracking']
    assert found.causes[0].value == pytest.approx((~kept).mean(), abs=0.01)
    assert ('the file is an excerpt' in found.causes[0].evidence) == (not kept[-1])


def test_keyframes_are_no_lost_tracking():
    rng = np.random.default_rng(0)
    keyframes = np.unique(np.cumsum(rng.choice([2, 3, 5, 9, 14], 500)))
    found = diagnosis_of(ESTIMATE[keyframes[keyframes < len(ESTIMATE)]])
    assert names(found) == []


def test_poses_that_were_chosen_by_how_far_the_camera_turned_are_not_lost():
    turns = rotation.angle_between(ESTIMATE.rotations[1:], ESTIMATE.rotations[:-1])
    turned = np.cumsum(turns)
    chosen = np.flatnonzero(np.diff(np.floor(turned / np.quantile(turns, 0.8)))) + 1
    intervals = np.diff(chosen)
    assert np.mean(intervals == 1) > 0.5  # as often in a row as where a third was lost
    assert np.sum(intervals - 1) > 0.2 * len(ESTIMATE)
    assert names(diagnosis_of(ESTIMATE[chosen])) == []


def test_an_estimate_that_flies_away_has_diverged():
    positions = ESTIMATE.positions.copy()
    away = np.arange(len(positions) - 900)[:, None]
    positions[900:] += 3e-4 * away**2 * [1.0, 0.5, 0.2]
    found = diagnosis_of(replace(ESTIMATE, positions=positions))
    assert names(found)[0] == 'diverged'
    assert found.causes[0].ate_after_m < 1.0 < found.causes[0].ate_before_m


def test_a_heading_that_runs_away_is_measured():
    seconds = (ESTIMATE.stamps_ns - ESTIMATE.stamps_ns[0]) / 1e9
    turns = rotation.from_rotation_vector(np.outer(math.radians(20) / 60 * seconds, [0, 0, 1]))
    steps = rotation.rotate(turns[:-1], np.diff(ESTIMATE.positions, axis=0))
    found = diagnosis_of(
        replace(
            ESTIMATE,
            positions=np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]),
            rotations=rotation.multiply(turns, ESTIMATE.rotations),
        )
    )
    assert names(found) == ['yaw_drift']
    usual = HEALTHY.findings['yaw_drift']['value']
    assert found.causes[0].value == pytest.approx(20 + usual, abs=1.0)
    path_m = np.linalg.norm(np.diff(TRUTH.positions, axis=0), axis=1).sum()
    per_m = found.causes[0].value * 1 / path_m  # in a minute
    assert found.findings['yaw_drift_deg_per_m'] == pytest.approx(per_m, rel=0.02)
    assert f'{per_m:.2g} deg per metre' in found.causes[0].evidence


def test_a_scale_that_grows_along_the_run_is_measured():
    seconds = (ESTIMATE.stamps_ns - ESTIMATE.stamps_ns[0]) / 1e9
    steps = np.diff(ESTIMATE.positions, axis=0) * (0.75 + 0.5 * seconds[:-1, None] / 60)
    positions = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    found = diagnosis_of(replace(ESTIMATE, positions=positions))
    assert names(found)[0] == 'scale_drift'
    assert found.causes[0].value == pytest.approx(50, abs=5)


def conjugated(poses: Trajectory) -> Trajectory:
    return replace(poses, rotations=rotation.conjugate(poses.rotations))


def inverted(poses: Trajectory) -> Trajectory:
    back = rotation.conjugate(poses.rotations)
    return Trajectory(poses.stamps_ns, -rotation.rotate(back, poses.positions), back)


def reordered(*order: int):
    return lambda poses: replace(poses, rotations=poses.rotations[:, list(order)])


CONVENTIONS = {
    'quaternion_conjugated': (conjugated, ('?invert=rotation',)),
    'pose_inverted': (inverted, ('?invert=pose',)),
    'w first': (reordered(3, 0, 1, 2), ('?quaternion=wxyz',)),
    'w last': (reordered(1, 2, 3, 0), ('?quaternion=xyzw',)),
    'mirrored': (lambda p: replace(p, positions=p.positions[:, [1, 0, 2]]), ()),
    'permuted': (lambda p: replace(p, positions=p.positions[:, [1, 2, 0]]), ()),
    'mirrored altogether': (
        lambda p: replace(
            p, positions=p.positions[:, [0, 2, 1]], rotations=p.rotations[:, [0, 2, 1, 3]]
        ),
        (),
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize('case', CONVENTIONS)
@pytest.mark.parametrize('seconds', [0.0, 0.05])
def test_a_wrong_convention_comes_first_whatever_else_is_wrong(case, seconds):
    harm, flags = CONVENTIONS[case]
    found = diagnosis_of(late(seconds, harm(ESTIMATE)))
    name = {
        'w first': 'quaternion_order', 'w last': 'quaternion_order', 'mirrored': 'axes_swapped',
        'permuted': 'axes_swapped', 'mirrored altogether': 'axes_swapped',
    }.get(case, case)  # fmt: skip
    assert names(found) == [name, *(['time_offset'] if seconds else [])]
    assert found.causes[0].flags == flags
    assert found.errors_after['ATE [m]'] == pytest.approx(
        HEALTHY.errors_before['ATE [m]'], rel=0.1
    )


@pytest.mark.slow
def test_estimate_and_truth_in_each_others_place_are_noticed():
    found = diagnose(TRUTH, ESTIMATE, CONFIG)
    assert 'swapped_inputs' in names(found)
    assert 'swapped_inputs' not in names(HEALTHY)


def test_exchanged_sides_of_one_rate_are_recognised_by_where_they_begin():
    found = diagnose(TRUTH[::10], ESTIMATE, CONFIG)
    assert names(found)[0] == 'swapped_inputs'
    assert found.causes[0].confidence < 0.7


def test_axes_of_the_truth_are_distinguished_from_those_of_the_estimate():
    turn = about([0, 0, 1], 30.0)
    elsewhere = replace(
        TRUTH,
        positions=rotation.rotate(turn, TRUTH.positions)[:, [1, 0, 2]],
        rotations=rotation.multiply(turn, TRUTH.rotations),
    )
    found = diagnose(ESTIMATE, elsewhere, CONFIG)
    assert [(cause.name, cause.side) for cause in found.causes] == [
        ('axes_swapped', 'ground_truth')
    ]


def test_a_noisy_truth_of_one_place_is_static():
    noise = np.random.default_rng(0).normal(0, 0.02, TRUTH.positions.shape)
    assert names(diagnose(ESTIMATE, replace(TRUTH, positions=noise), CONFIG)) == ['truth_static']


def test_a_truth_that_froze_for_a_while_is_named_and_the_rest_diagnosed():
    positions, rotations = TRUTH.positions.copy(), TRUTH.rotations.copy()
    positions[6000:], rotations[6000:] = positions[6000], rotations[6000]
    found = diagnose(late(0.1), replace(TRUTH, positions=positions, rotations=rotations), CONFIG)
    assert names(found)[0] == 'truth_static'
    assert found.causes[0].value == pytest.approx(0.5, abs=0.01)
    assert found.findings['time_offset']['value'] == pytest.approx(0.1, abs=1e-3)


def test_a_truth_that_stands_still_is_named_and_nothing_else():
    static = replace(
        TRUTH,
        positions=np.tile(TRUTH.positions[:1], (len(TRUTH), 1)),
        rotations=np.tile(TRUTH.rotations[:1], (len(TRUTH), 1)),
    )
    found = diagnose(ESTIMATE, static, CONFIG)
    assert names(found) == ['truth_static']
    assert 'scale' in found.cannot_tell


def test_a_truth_that_froze_half_way_is_named():
    positions = TRUTH.positions.copy()
    positions[4000:] = positions[4000]
    assert 'truth_static' in names(diagnose(ESTIMATE, replace(TRUTH, positions=positions), CONFIG))


def test_of_two_that_stand_still_nothing_can_be_determined():
    def resting(poses: Trajectory) -> Trajectory:
        noise = np.random.default_rng(0).normal(0, 1e-3, (len(poses), 3))
        return Trajectory(poses.stamps_ns, noise, rotation.from_rotation_vector(noise))

    found = diagnose(resting(ESTIMATE), resting(TRUTH), CONFIG)
    assert names(found) == ['insufficient_motion']
    assert set(found.cannot_tell) == set(CAUSES) - {'truth_static', 'insufficient_motion'}


def test_what_a_straight_way_does_not_show_cannot_be_determined():
    seconds = (TRUTH.stamps_ns - TRUTH.stamps_ns[0]) / 1e9
    rng = np.random.default_rng(0)

    def straight(stamps_ns: np.ndarray, noise: float) -> Trajectory:
        along = 10 * np.sin((stamps_ns - TRUTH.stamps_ns[0]) / 1e9 / 10)
        positions = np.outer(along, [1.0, 0.2, 0.0]) + rng.normal(0, noise, (len(stamps_ns), 3))
        turns = rotation.from_rotation_vector(rng.normal(0, noise, (len(stamps_ns), 3)))
        return Trajectory(stamps_ns, positions, turns)

    found = diagnose(straight(ESTIMATE.stamps_ns, 3e-3), straight(TRUTH.stamps_ns, 1e-5), CONFIG)
    assert seconds[-1] > 50
    assert {'time_offset', 'sensor_rotation', 'lever_arm'} <= set(found.cannot_tell)
    assert 'scale' not in found.cannot_tell
    assert names(found) == []


def test_positions_alone_still_determine_offset_and_scale():
    points = replace(TRUTH, rotations=None)
    harmed = late(0.1, replace(ESTIMATE, positions=1.1 * ESTIMATE.positions))
    found = diagnose(harmed, points, CONFIG)
    assert set(names(found)) == {'time_offset', 'scale'}
    assert found.findings['time_offset']['value'] == pytest.approx(0.1, abs=5e-3)
    assert {'sensor_rotation', 'yaw_drift'} <= set(found.cannot_tell)


def test_positions_alone_determine_small_offsets_and_tilts_but_no_drift_of_a_clock():
    points = replace(TRUTH, rotations=None)
    found = diagnose(late(0.02), points, CONFIG)
    assert names(found) == ['time_offset']
    assert found.causes[0].value == pytest.approx(0.02, abs=3e-3)
    assert 'clock_drift' in found.cannot_tell
    tilt = about([1, 1, 0], 5.0)
    tilted = replace(ESTIMATE, positions=rotation.rotate(tilt, ESTIMATE.positions))
    found = diagnose(tilted, points, CONFIG)
    assert names(found) == ['gravity_tilt']
    assert found.causes[0].value == pytest.approx(5.0, abs=0.5)


def test_two_faults_at_once_are_both_named():
    harmed = late(0.05, replace(ESTIMATE, positions=1.2 * ESTIMATE.positions))
    assert set(names(diagnosis_of(harmed))) == {'time_offset', 'scale'}


def test_causes_are_undone_one_after_the_other():
    harmed = late(0.3, replace(ESTIMATE, positions=1.2 * ESTIMATE.positions))
    first, second = diagnosis_of(harmed).causes
    assert second.ate_before_m == first.ate_after_m
    assert second.ate_after_m < 0.1 < first.ate_before_m


def test_the_document_is_strict_json_with_the_names_listed():
    found = diagnosis_of(late(-1_403_715_000.0))
    document = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert document['schema'] == 'vio_eval_ros.diagnosis/1'
    assert document['causes'][0]['ate_before_m'] is None
    assert set(document) == {
        *('schema', 'profile', 'limits', 'causes', 'cannot_tell', 'warnings', 'findings')
    }
    assert document['limits'] == DiagnosisLimits().to_dict()
    assert document['causes'][0]['name'] in CAUSES


def test_a_handful_of_poses_is_refused():
    with pytest.raises(NoPairs, match='estimate has 5 usable poses'):
        diagnosis_of(ESTIMATE[:5])


@pytest.mark.slow
@pytest.mark.parametrize('every_kth', [200, 400, 600])
def test_the_error_beside_a_sparse_truth_is_that_at_its_poses(every_kth):
    sparse = diagnose(ESTIMATE, TRUTH[::every_kth], CONFIG)
    assert names(sparse) == []
    if len(TRUTH[::every_kth]) > 20:
        dense_m, sparse_m = (each.errors_before['ATE [m]'] for each in (HEALTHY, sparse))
        assert sparse_m == pytest.approx(dense_m, rel=0.05)


def test_an_estimate_that_is_out_of_proportion_from_the_beginning_has_not_left():
    far = replace(ESTIMATE, positions=1e8 * (ESTIMATE.positions + 1e3))
    assert 'diverged' not in names(diagnosis_of(far))


@pytest.mark.parametrize('rate_hz', [10, 20, 50, 200])
def test_an_offset_is_as_exact_against_a_slow_truth(rate_hz):
    every_kth = TRUTH[:: 200 // rate_hz]
    found = diagnose(late(0.0371), every_kth, CONFIG)
    assert found.findings['time_offset']['value'] == pytest.approx(0.0371, abs=1e-3)


def test_the_published_run_that_lags_by_a_frame_is_found(shared_data):
    from vio_eval_ros.core.cleaning import clean, Cleaning
    from vio_eval_ros.recordings.sources import read_sources

    folder = 'est_rpg_trajectory_evaluation/euroc_vislam_mono/vislam_rp/V1_02'
    sources = read_sources(
        [
            f'{shared_data}/{folder}/stamped_traj_estimate0.txt',
            f'{shared_data}/gt_euroc/open_vins_tum/V1_02_medium.txt',
        ]
    )
    found = diagnose(*(clean(source.poses, Cleaning()) for source in sources), CONFIG)
    assert names(found) == ['time_offset']
    assert found.causes[0].value == pytest.approx(0.05, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize('harm', [conjugated, inverted])
def test_a_truth_that_is_inverse_is_distinguished_from_an_estimate_that_is(harm):
    # worlds far apart tell on which side of a rotation the other world is
    turn = about([0, 0, 1], 100.0)
    elsewhere = replace(
        ESTIMATE,
        positions=rotation.rotate(turn, ESTIMATE.positions),
        rotations=rotation.multiply(turn, ESTIMATE.rotations),
    )
    found = diagnose(elsewhere, harm(TRUTH), CONFIG)
    assert [(cause.name, cause.side) for cause in found.causes] == [
        ('quaternion_conjugated' if harm is conjugated else 'pose_inverted', 'ground_truth')
    ]
    assert found.errors_after['ATE [m]'] == pytest.approx(
        HEALTHY.errors_before['ATE [m]'], rel=0.1
    )
    own = diagnose(harm(elsewhere), TRUTH, CONFIG)
    assert [cause.side for cause in own.causes] == ['estimate']


def test_a_stamp_of_zero_among_those_of_today_does_not_matter():
    stamps_ns = ESTIMATE.stamps_ns.copy()
    stamps_ns[0] = 0
    found = diagnosis_of(late(0.05, replace(ESTIMATE, stamps_ns=stamps_ns)))
    assert names(found) == ['time_offset']
    assert found.findings['stamps_far_from_all_others'] == {'estimate': 1, 'ground_truth': 0}


def test_rotations_that_never_change_stand_for_none():
    # a prism or an antenna that is written as a pose
    constant = replace(TRUTH, rotations=np.tile([0.0, 0.0, 0.0, 1.0], (len(TRUTH), 1)))
    found = diagnose(ESTIMATE, constant, CONFIG)
    assert found.findings['position_only']
    assert names(found) == []
    assert {'sensor_rotation', 'yaw_drift'} <= set(found.cannot_tell)


def test_an_offset_of_the_orientations_alone_is_not_named():
    # what a tracker does that filters positions and orientations differently
    truth = replace(TRUTH, rotations=np.roll(TRUTH.rotations, -10, axis=0))[:-10]
    found = diagnose(ESTIMATE, truth, CONFIG)
    assert found.findings['time_offset']['value'] == pytest.approx(0.05, abs=1e-3)
    assert found.findings['positions_late_s'] == pytest.approx(-0.05, rel=0.2)
    assert names(found) == []
    assert {'time_offset', 'lever_arm'} <= set(found.cannot_tell)
    assert HEALTHY.findings['positions_late_s'] is None


def test_what_the_ground_truth_does_is_not_blamed_on_the_estimate():
    stepping, spiking = TRUTH.positions.copy(), TRUTH.positions.copy()
    stepping[6000:] += [0.6, 0.8, 0.0]
    spiking[::140] += [0.0, 1.5, 0.0]
    for name, positions in (('jump', stepping), ('outliers', spiking)):
        (cause,) = diagnose(ESTIMATE, replace(TRUTH, positions=positions), CONFIG).causes
        assert (cause.name, cause.side) == (name, 'ground_truth')
        assert 'markers' in cause.advice


@pytest.mark.slow
@pytest.mark.parametrize('row', [0, 1, -2, -1])
def test_one_orientation_at_an_end_of_the_run_is_neither_tilt_nor_jump(row):
    rotations = ESTIMATE.rotations.copy()
    rotations[row] = rotation.multiply(about([1, 1, 0], 30.0), rotations[row])
    assert names(diagnosis_of(replace(ESTIMATE, rotations=rotations))) == []


@pytest.mark.parametrize('shift', [1, -1])
def test_an_order_and_a_conjugation_at_once_are_reported(shift):
    rotations = np.roll(rotation.conjugate(ESTIMATE.rotations), shift, axis=1)
    (cause,) = diagnosis_of(replace(ESTIMATE, rotations=rotations)).causes
    order = 'wxyz' if shift == 1 else 'xyzw'
    assert cause.name == 'quaternion_order'
    assert cause.flags == (f'?quaternion={order}&invert=rotation',)
    assert 'inverse' in cause.advice


def test_what_flew_off_and_came_back_has_not_diverged():
    seconds = (ESTIMATE.stamps_ns - ESTIMATE.stamps_ns[0]) / 1e9
    positions = ESTIMATE.positions.copy()
    blind = (seconds > 25) & (seconds < 35)
    positions[blind] = positions[blind][0] + np.outer(seconds[blind] - 25, [1.0, 0.5, 0.0])
    found = names(diagnosis_of(replace(ESTIMATE, positions=positions)))
    assert found
    assert 'diverged' not in found


def test_runs_without_common_time_cannot_be_diagnosed():
    turns = np.cumsum(np.random.default_rng(0).normal(0, 0.02, ESTIMATE.positions.shape), axis=0)
    other = replace(ESTIMATE, rotations=rotation.from_rotation_vector(turns))
    with pytest.raises(NoPairs, match='from the same run'):
        diagnosis_of(late(4000.0, other))


def test_lost_tracking_counts_only_where_there_is_truth():
    kept = np.ones(len(ESTIMATE), bool)
    kept[100:700] = False  # 5 to 35 s
    truth = TRUTH[(TRUTH.stamps_ns - TRUTH.stamps_ns[0]) > 30e9]
    found = diagnose(ESTIMATE[kept], truth, CONFIG).findings
    assert found['lost_tracking']['value'] == pytest.approx(5 / 30, abs=0.01)
    source = np.random.default_rng(0)
    scattered = source.random(len(ESTIMATE)) > 0.1
    found = diagnose(ESTIMATE[scattered], truth, CONFIG).findings
    inside = ESTIMATE.stamps_ns > truth.stamps_ns[0]
    share = 1 - scattered[inside].mean()
    assert found['lost_tracking']['value'] == pytest.approx(share, abs=0.01)


def test_a_simulator_whose_robot_waits_has_a_truth():
    sides = []
    for poses, noise_m in ((ESTIMATE[:600], 0.001), (TRUTH[:6000], 0.0)):
        waits = np.arange(1600, 0, -1)  # 80 s, then it flies for 30 s
        rest = poses.positions[0] + np.random.default_rng(0).normal(0, noise_m, (1600, 3))
        sides.append(
            Trajectory(
                np.concatenate([ESTIMATE.stamps_ns[0] - 50_000_000 * waits, poses.stamps_ns]),
                np.concatenate([rest, poses.positions]),
                np.concatenate([np.repeat(poses.rotations[:1], 1600, axis=0), poses.rotations]),
            )
        )
    assert names(diagnose(*sides, CONFIG)) == []


@pytest.mark.parametrize('late_s', [0.1, -0.3])
def test_positions_of_other_moments_than_orientations_are_no_lever_arm(late_s):
    seconds = (ESTIMATE.stamps_ns - ESTIMATE.stamps_ns[0]) / 1e9
    delayed = [np.interp(seconds - late_s, seconds, column) for column in ESTIMATE.positions.T]
    found = diagnosis_of(replace(ESTIMATE, positions=np.stack(delayed, -1)))
    assert names(found) == []
    assert found.findings['positions_late_s'] == pytest.approx(late_s, rel=0.2)
    assert 'lever_arm' in found.cannot_tell


@pytest.mark.slow
def test_a_heading_that_walks_at_random_does_not_run_away():
    rng = np.random.default_rng(11)
    named = 0
    for seed in range(10):
        run = simulate(duration_s=40.0, seed=seed)
        walk = np.cumsum(rng.normal(0, math.radians(1.2) * math.sqrt(0.05), len(run.estimate)))
        turns = rotation.from_rotation_vector(np.outer(walk, [0, 0, 1]))
        steps = rotation.rotate(turns[:-1], np.diff(run.estimate.positions, axis=0))
        walked = replace(
            run.estimate,
            positions=np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]),
            rotations=rotation.multiply(turns, run.estimate.rotations),
        )
        named += 'yaw_drift' in names(diagnose(walked, run.ground_truth, CONFIG))
    assert named <= 2


def test_a_few_keyframes_are_diagnosed_as_far_as_they_go():
    found = diagnose(ESTIMATE[:600:25], TRUTH[:6000:250], CONFIG)
    assert names(found) == []
    assert 'scale' not in found.findings or found.findings['scale']['value'] > 0


def test_a_drift_of_what_stands_still_is_no_static_truth():
    resting = replace(
        TRUTH,
        positions=np.tile(TRUTH.positions[:1], (len(TRUTH), 1)),
        rotations=np.tile(TRUTH.rotations[:1], (len(TRUTH), 1)),
    )
    along = np.linspace(0, 0.15, len(ESTIMATE))[:, None] * [1.0, 0.0, 0.0]
    still = np.tile(ESTIMATE.rotations[:1], (len(ESTIMATE), 1))
    drifting = replace(ESTIMATE, positions=along, rotations=still)
    assert names(diagnose(drifting, resting, CONFIG)) == ['insufficient_motion']


def moving(source: np.random.Generator, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rotations of some motion, or none, during some of the time."""
    begin, end = np.sort(source.random(2)) * seconds[-1]
    within = ((seconds >= begin) & (seconds <= end))[:, None] | (source.random() < 0.4)
    waves = np.sin(seconds[:, None] * source.uniform(0.3, 1.5, 6) + source.uniform(0, 6, 6))
    places = waves[:, :3] * source.choice([0.0, 1e-6, 1.0, 1e6])
    turns = waves[:, 3:] * source.choice([0.0, 1e-6, 0.5], 3)
    return places * within, rotation.from_rotation_vector(turns * within)


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(60))
def test_no_pair_of_motions_breaks_it(seed):
    source = np.random.default_rng(seed)
    count, last_s = int(source.integers(20, 400)), source.choice([2, 10, 60])
    microseconds = np.sort(source.choice(int(last_s) * 10**6, count, replace=False))
    stamps_ns = 1_400_000_000_000_000_000 + 1000 * microseconds
    sides = []
    for _ in range(2):
        places, turns = moving(source, microseconds / 1e6)
        sides.append(Trajectory(stamps_ns, places, turns if source.random() < 0.8 else None))
    if source.random() < 0.5:
        factor = source.choice([1.0, 1e-8, 1e8])
        sides[0] = replace(sides[1], positions=factor * sides[1].positions)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = diagnose(*sides, CONFIG)
    assert set(names(found)) <= set(CAUSES)
    json.dumps(found.to_dict(), allow_nan=False)


def test_an_estimate_that_begins_late_took_its_time_to_initialise():
    found = diagnosis_of(ESTIMATE[500:])  # 25 of 60 s
    assert names(found) == []
    assert found.findings['initialised']['after_s'] == pytest.approx(25.0, abs=0.1)
    assert 'initialised after 25.0 s' in found.warnings[0]
    assert not [warning for warning in HEALTHY.warnings if 'initialised' in warning]


def test_recordings_that_were_stopped_one_after_the_other_have_lost_nothing():
    assert names(diagnosis_of(ESTIMATE[:1130])) == []  # 3.5 s
    assert names(diagnosis_of(ESTIMATE[:1080])) == ['lost_tracking']  # 6 s


def test_keyframes_of_which_the_last_are_missing_are_no_lost_tracking():
    rng = np.random.default_rng(0)
    keyframes = np.unique(np.cumsum(rng.choice([2, 3, 5, 9, 14], 500)))
    assert names(diagnosis_of(ESTIMATE[keyframes[keyframes < 1000]])) == []


@pytest.mark.parametrize('largest', [1e6, 1e27, 1e90])
@pytest.mark.parametrize('first', [100, 600, 1150])
@pytest.mark.parametrize('growing', [True, False])
def test_an_estimate_that_blows_up_has_diverged_and_the_rest_is_diagnosed(largest, first, growing):
    positions, count = ESTIMATE.positions.copy(), len(ESTIMATE) - first
    by = np.geomspace(1, largest, count) - 1 if growing else np.full(count, largest)
    positions[first:] = positions[first] + by[:, None] * [1.0, 0.0, 0.0]
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = diagnosis_of(late(0.1, replace(ESTIMATE, positions=positions)))
    assert names(found)[0] == 'diverged'
    assert set(names(found)) <= {'diverged', 'time_offset'}
    assert found.causes[0].value == pytest.approx(count / len(ESTIMATE), rel=0.2)
    json.dumps(found.to_dict(errors=True), allow_nan=False)


@pytest.mark.slow
@pytest.mark.parametrize('apart_s', [0, 1_000_000])
@pytest.mark.parametrize('pace', [0.1, 0.5, 0.95, 1.33, 2.0, 10.0])
def test_time_that_is_played_at_another_pace_is_a_clock_that_drifts(pace, apart_s):
    elapsed = ESTIMATE.stamps_ns - ESTIMATE.stamps_ns[0]
    stamps_ns = ESTIMATE.stamps_ns[0] + np.round(elapsed * pace).astype(np.int64)
    found = diagnosis_of(late(apart_s, replace(ESTIMATE, stamps_ns=stamps_ns)))
    assert names(found) == ['clock_drift', *(['time_offset'] if apart_s else [])]
    drift = found.causes[0]
    assert drift.value == pytest.approx(1e6 * (1 - 1 / pace), rel=1e-3)
    assert f'{pace:.4g} times the pace' in drift.evidence
    assert found.errors_after['ATE [m]'] < 0.1


def test_two_motions_that_have_nothing_in_common_agree_at_no_pace():
    other = simulate(duration_s=60.0, seed=7).ground_truth
    turned = replace(other, positions=other.positions[::-1], rotations=other.rotations[::-1])
    assert 'clock_drift' not in names(diagnose(ESTIMATE, turned, CONFIG))


def prism(metres: float) -> Trajectory:
    """Return the positions of a prism on a stick, away from the body."""
    arm = metres * np.array([0.7, 0.1, 0.7])
    return replace(
        TRUTH, positions=TRUTH.positions + rotation.rotate(TRUTH.rotations, arm), rotations=None
    )


@pytest.mark.parametrize('metres', [0.15, 0.4, 1.0])
def test_a_lever_arm_to_a_truth_of_positions_is_found_by_the_orientations_of_the_estimate(metres):
    found = diagnose(ESTIMATE, prism(metres), CONFIG)
    assert names(found) == ['lever_arm']
    cause = found.causes[0]
    assert cause.value == pytest.approx(metres, rel=0.05)
    assert cause.flags[0] == '--estimate-to-body'
    arm = [float(value) for value in cause.flags[1:4]]
    assert arm == pytest.approx([0.7 * metres, 0.1 * metres, 0.7 * metres], abs=0.05)
    assert cause.ate_after_m < 0.1


def test_positions_of_the_body_itself_have_no_lever_arm():
    assert names(diagnose(ESTIMATE, prism(0.0), CONFIG)) == []


def test_a_lever_arm_to_positions_is_not_taken_for_a_lag_nor_the_other_way_round():
    found = diagnose(late(0.1), prism(0.4), CONFIG)
    assert set(names(found)) == {'lever_arm', 'time_offset'}
    assert found.findings['time_offset']['value'] == pytest.approx(0.1, abs=0.01)
    assert names(diagnose(late(0.1), prism(0.0), CONFIG)) == ['time_offset']


@pytest.mark.parametrize('unit', ['mm', 'cm'])
def test_a_scale_that_is_a_unit_is_called_so_and_the_side_that_is_in_it(unit):
    factor = {'mm': 1000.0, 'cm': 100.0}[unit]
    of_estimate = diagnosis_of(replace(ESTIMATE, positions=factor * ESTIMATE.positions))
    larger = replace(TRUTH, positions=factor * TRUTH.positions)
    for found, side in (
        (of_estimate, 'estimate'),
        (diagnose(ESTIMATE, larger, CONFIG), 'ground_truth'),
    ):
        (cause,) = found.causes
        assert (cause.name, cause.side, cause.flags) == ('scale', side, (f'?unit={unit}',))
        assert {'mm': 'millimetres', 'cm': 'centimetres'}[unit] in cause.advice
        assert 'baseline' not in cause.advice


def test_a_monocular_scale_is_no_unit():
    (cause,) = diagnosis_of(replace(ESTIMATE, positions=70 * ESTIMATE.positions)).causes
    assert cause.flags == ('--alignment', 'sim3')
    assert 'baseline' in cause.advice
