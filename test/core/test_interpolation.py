"""Poses between samples, where the motion is known at every instant."""

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import between, interpolated, Interpolator
from vio_eval_ros.core.trajectory import Trajectory


def fly(stamps_ns: np.ndarray) -> Trajectory:
    seconds = np.asarray(stamps_ns)[:, None] / 1e9
    return Trajectory(
        np.asarray(stamps_ns),
        np.sin(seconds * [1.1, 1.7, 0.6]),
        rotation.from_rotation_vector(np.sin(seconds * [0.9, 1.3, 0.4]) * [0.4, 0.6, 1.5]),
    )


@pytest.mark.parametrize(('rate_hz', 'metres', 'degrees'), [(200, 1e-5, 1e-3), (10, 4e-4, 0.03)])
def test_poses_between_samples_are_those_that_were_flown(rate_hz, metres, degrees):
    sampled = fly(np.arange(0, 20_000_000_000, 1_000_000_000 // rate_hz))
    stamps_ns = np.sort(np.random.default_rng(0).integers(1_000_000_000, 18_000_000_000, 500))
    found, true = Interpolator(sampled, 0.5).at(stamps_ns), fly(stamps_ns)
    assert np.abs(found.positions - true.positions).max() < metres
    assert np.degrees(rotation.angle_between(found.rotations, true.rotations)).max() < degrees


def test_samples_themselves_come_back():
    sampled = fly(np.arange(0, 5_000_000_000, 100_000_000))
    found = Interpolator(sampled, 0.5).at(sampled.stamps_ns)
    np.testing.assert_allclose(found.positions, sampled.positions, atol=1e-12)


def test_nothing_is_known_in_gaps_and_outside():
    stamps_ns = np.array([0, 1, 2, 12, 13], np.int64) * 100_000_000
    inside = Interpolator(fly(stamps_ns), 0.5).inside(
        np.array([-1, 0, 15_000_000, 200_000_000, 500_000_000, 1_200_000_000, 1_300_000_001])
    )
    assert inside.tolist() == [False, True, True, True, False, True, False]


def test_between_two_poses_both_ways_to_compute_positions_agree():
    begin, end = fly(np.array([0, 5, 7])), fly(np.array([4, 9, 7]))
    stamps_ns = np.array([1, 9, 7])
    step, mean = (between(begin, end, stamps_ns, weighted=way) for way in (False, True))
    np.testing.assert_allclose(step.positions, mean.positions, rtol=1e-15)
    assert mean.positions[1:].tolist() == end.positions[1:].tolist()
    assert step.rotations.tolist() == mean.rotations.tolist()


def test_without_orientations_only_positions_are_interpolated():
    line = Trajectory(np.array([0, 10]), np.array([[0.0, 0, 0], [10, 20, 30]]))
    found = interpolated(line, np.array([-5, 0, 1, 15]))
    assert found.positions.tolist() == [[0, 0, 0], [0, 0, 0], [1, 2, 3], [10, 20, 30]]
    assert found.rotations is None


def test_samples_that_are_very_far_apart_take_no_more_memory():
    sampled = fly(np.arange(0, 100) * 3_600_000_000_000)
    found = Interpolator(sampled, 1e5).at(sampled.stamps_ns)
    np.testing.assert_allclose(found.positions, sampled.positions, atol=1e-12)
