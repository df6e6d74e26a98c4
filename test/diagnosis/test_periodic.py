"""Runs in laps: nothing is called a fault that another explanation fits as well."""

from dataclasses import replace

import numpy as np
from periodic import ATTITUDES, periodic_run, SHAPES
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.errors import NoPairs

CONFIG = EvaluationConfig()


def named(estimate: Trajectory, truth: Trajectory) -> list[str]:
    return [cause.name for cause in diagnose(estimate, truth, CONFIG).causes]


def laps(seed: int = 0) -> tuple[Trajectory, Trajectory]:
    """Return an estimate and a truth that repeat themselves every 10 s."""
    stamps_ns = np.arange(0, 50 * 10**9, 10**7)
    angle = 2 * np.pi * stamps_ns / 1e10
    flat = np.zeros(len(angle))
    points = np.stack([3 * np.cos(angle), 2 * np.sin(angle), 0.3 * np.sin(angle)], -1)
    turns = np.stack([0.2 * np.sin(angle), 0.1 * np.cos(2 * angle), flat], -1)
    rotations = rotation.multiply(
        rotation.about_z(0.5 * np.sin(angle)), rotation.from_rotation_vector(turns)
    )
    truth = Trajectory(stamps_ns, points, rotations)
    noise = np.random.default_rng(seed).normal(0, 1e-3, (2, 1000, 3))
    poses = truth[::5]
    estimate = Trajectory(
        poses.stamps_ns,
        poses.positions + noise[0],
        rotation.multiply(poses.rotations, rotation.from_rotation_vector(noise[1])),
    )
    return estimate, truth


def late(seconds: float, poses: Trajectory) -> Trajectory:
    return replace(poses, stamps_ns=poses.stamps_ns + round(seconds * 1e9))


@pytest.mark.slow
@pytest.mark.parametrize('attitude', ATTITUDES)
@pytest.mark.parametrize('shape', SHAPES)
def test_nothing_is_wrong_with_a_run_in_laps(shape, attitude):
    seed = 10 * SHAPES.index(shape) + ATTITUDES.index(attitude)
    run = periodic_run(shape, attitude, seed)
    assert named(run.estimate, run.truth) == [], run.name


def test_of_lags_that_are_equally_good_the_one_nearest_to_zero_is_meant():
    estimate, truth = laps()
    assert named(estimate, truth) == []
    found = diagnose(late(0.08, estimate), truth, CONFIG)
    assert [cause.name for cause in found.causes] == ['time_offset']
    assert found.causes[0].value == pytest.approx(0.08, abs=3e-3)


def test_a_lag_of_half_a_lap_is_not_told_from_one_in_the_other_direction():
    estimate, truth = laps()
    found = diagnose(late(4.5, estimate), truth, CONFIG)
    assert found.causes == ()
    assert {'time_offset', 'sensor_rotation', 'lost_tracking'} <= set(found.cannot_tell)
    offsets_s = np.array(found.findings['equally_likely_offsets_s'])
    assert np.abs(offsets_s - 4.5).min() < 0.01
    assert len(offsets_s) > 1
    assert '--time-offset-s' in found.warnings[0]


def test_clocks_that_are_far_apart_are_not_brought_together_by_laps():
    estimate, truth = laps()
    found = diagnose(late(1000.0, estimate), truth, CONFIG)
    assert found.causes == ()
    assert 'time_offset' in found.cannot_tell
    with pytest.raises(NoPairs):  # a lag that takes them further apart is none
        diagnose(late(4e6, estimate[:300]), truth[:30], CONFIG)


@pytest.mark.parametrize('harm', ['turned', 'scaled', 'conjugated', 'displaced'])
def test_faults_of_a_run_in_laps_are_named(harm):
    estimate, truth = laps()
    turn = rotation.from_rotation_vector(np.array([0.3, 0.4, -0.2]))
    harmed, name = {
        'turned': (
            replace(estimate, rotations=rotation.multiply(estimate.rotations, turn)),
            'sensor_rotation',
        ),
        'scaled': (replace(estimate, positions=1.2 * estimate.positions), 'scale'),
        'conjugated': (
            replace(estimate, rotations=rotation.conjugate(estimate.rotations)),
            'quaternion_conjugated',
        ),
        'displaced': (
            replace(
                estimate,
                positions=estimate.positions
                + rotation.rotate(estimate.rotations, np.array([0.0, 0.0, -0.4])),
            ),
            'lever_arm',
        ),
    }[harm]
    assert named(harmed, truth) == [name]


def circling(radius_m: float) -> tuple[Trajectory, Trajectory]:
    """Return a truth that turns as it goes round, evenly, and an estimate that drifts by cm."""
    stamps_ns = np.arange(0, 90 * 10**9, 5 * 10**7)
    angle = 2 * np.pi * stamps_ns / 12e9
    points = radius_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    truth = Trajectory(stamps_ns, points, rotation.about_z(angle))
    random = np.random.default_rng(3)
    noise = random.normal(0, 3e-3, (2, len(angle), 3))
    walk = np.cumsum(random.normal(0, 1.5e-3, points.shape), axis=0)
    estimate = replace(
        truth,
        positions=points + walk + noise[0],
        rotations=rotation.multiply(truth.rotations, rotation.from_rotation_vector(noise[1])),
    )
    return estimate, truth


@pytest.mark.parametrize('radius_m', [3.0, 0.01])
def test_an_even_circle_and_a_turn_on_the_spot_are_sound(radius_m):
    found = diagnose(*circling(radius_m), CONFIG)
    assert [cause.name for cause in found.causes] == []
    assert not any('different moments' in one for one in found.warnings)
    assert 'time_offset' in found.cannot_tell


@pytest.mark.parametrize(
    ('lever', 'scale'), [((0.3, 0, 0), 1.0), ((0.2, 0.2, 0.1), 1.0), ((0, 0, 0), 1.1)]
)
def test_on_a_circle_a_point_beside_the_body_and_a_scale_look_alike(lever, scale):
    seconds = np.arange(0, 60, 0.05)
    turn = 0.6 * seconds
    still = np.zeros_like(turn)
    positions = np.stack([3 * np.cos(turn), 3 * np.sin(turn), still], axis=1)
    rotations = np.stack([still, still, np.sin(turn / 2), np.cos(turn / 2)], axis=1)
    stamps_ns = (1.6e18 + seconds * 1e9).astype(np.int64)
    noise = np.random.default_rng(0).normal(0, 0.002, positions.shape)
    moved = scale * positions + rotation.rotate(rotations, np.array(lever, float)) + noise
    found = diagnose(
        Trajectory(stamps_ns, moved, rotations),
        Trajectory(stamps_ns, positions, rotations),
        EvaluationConfig(),
    )
    assert found.causes == ()
    assert {'scale', 'lever_arm'} <= set(found.cannot_tell)
