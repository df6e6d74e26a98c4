"""A gyroscope made of the true rotations of a simulated flight."""

from dataclasses import replace
import math

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.gyroscope import compare
from vio_eval_ros.errors import NoPairs
from vio_eval_ros.simulation import simulate

FLIGHT = simulate(duration_s=30.0)


def rates_of(
    turn: np.ndarray, truth: Trajectory = FLIGHT.ground_truth
) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps and body rates [rad/s] of the flight, in a sensor turned in the body."""
    q, stamps_ns = truth.rotations, truth.stamps_ns
    steps = rotation.to_rotation_vector(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))
    rates = steps / np.diff(stamps_ns)[:, None] * 1e9
    middle_ns = (stamps_ns[:-1] + stamps_ns[1:]) // 2
    return middle_ns, rotation.rotate(rotation.conjugate(turn), rates)


def test_offset_and_turn_of_a_gyroscope_come_back_in_spite_of_bias_and_noise():
    turn = rotation.from_rotation_vector(np.array([0.4, -1.0, 0.3]))
    stamps_ns, rates = rates_of(turn)
    rates += np.random.default_rng(0).normal((0.01, -0.02, 0.005), 0.01, rates.shape)
    estimate = replace(FLIGHT.estimate, stamps_ns=FLIGHT.estimate.stamps_ns + 35_000_000)
    found = compare(estimate, stamps_ns, rates)
    assert found.offset_s == pytest.approx(0.035, abs=1e-3)
    assert found.turn_deg == pytest.approx(math.degrees(np.linalg.norm([0.4, -1.0, 0.3])), abs=1)
    assert rotation.angle_between(np.array(found.turn_xyzw), turn) < math.radians(1)
    assert found.misfit < 0.2
    assert found.bias_rad_s == pytest.approx((0.01, -0.02, 0.005), abs=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize('noise', [0.0, 0.1])
def test_rates_in_degrees_are_recognised(noise):
    stamps_ns, rates = rates_of(np.array([0.0, 0.0, 0.0, 1.0]))
    rates += np.random.default_rng(0).normal(0.02, 0.01 + noise, rates.shape)
    expected = compare(FLIGHT.estimate, stamps_ns, rates)
    found = compare(FLIGHT.estimate, stamps_ns, np.degrees(rates))
    assert (expected.degrees, found.degrees) == (False, True)
    assert found.offset_s == pytest.approx(expected.offset_s, abs=1e-6)
    assert found.turn_deg == pytest.approx(expected.turn_deg, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize('seed', [11, 1, 2])
@pytest.mark.parametrize('noise', [0.0, 0.1])
def test_mirrored_and_swapped_axes_are_distinguished_from_turned_ones(seed, noise):
    run = simulate(duration_s=30.0, seed=seed)
    stamps_ns, rates = rates_of(np.array([0.0, 0.0, 0.0, 1.0]), run.ground_truth)
    rates += np.random.default_rng(seed).normal(0.02, 0.01 + noise, rates.shape)
    for wrong in (rates * [1, -1, 1], rates[:, [1, 0, 2]]):
        assert compare(run.estimate, stamps_ns, wrong).mirrored
    for right in (rates, rates * [-1, -1, 1], rates[:, [1, 2, 0]]):
        assert not compare(run.estimate, stamps_ns, right).mirrored


def test_a_body_that_rotates_about_one_axis_does_not_show_a_mirrored_one():
    stamps_ns, rates = rates_of(np.array([0.0, 0.0, 0.0, 1.0]))
    rates = rates * [0, 0, 1] + np.random.default_rng(0).normal(0, 0.01, rates.shape)
    turned = np.concatenate([[[0.0, 0.0, 0.0]], np.cumsum(rates * 0.005, axis=0) * [0, 0, 1]])
    truth = FLIGHT.ground_truth
    estimate = replace(truth, rotations=rotation.from_rotation_vector(turned))
    assert not compare(estimate, stamps_ns, rates).mirrored


def test_the_gyroscope_of_another_flight_is_recognised_as_such():
    stamps_ns, rates = rates_of(np.array([0.0, 0.0, 0.0, 1.0]))
    other = simulate(duration_s=30.0, seed=12).estimate
    noise = rotation.from_rotation_vector(
        np.random.default_rng(5).normal(0, 0.3, (len(other), 3)).cumsum(axis=0)
    )
    assert compare(replace(other, rotations=noise), stamps_ns, rates).misfit > 0.5


def test_positions_have_nothing_to_compare():
    stamps_ns, rates = rates_of(np.array([0.0, 0.0, 0.0, 1.0]))
    with pytest.raises(NoPairs, match='positions only'):
        compare(replace(FLIGHT.estimate, rotations=None), stamps_ns, rates)
