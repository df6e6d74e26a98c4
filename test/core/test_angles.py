"""The closed form of the mean squared angle is what the angles themselves give."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.angles import AngleMoments

SPREADS = st.sampled_from([1e-7, 1e-4, 0.02, 0.3, 1.0])
ANGLES = st.sampled_from([0.0, 1e-6, 1e-3, 0.01, 0.03, 0.1, 1.0])


def scattered(seed: int, spread: float, count: int = 3000):
    """Return a rotation, and others around it with random signs."""
    rng = np.random.default_rng(seed)
    centre = rotation.normalize(rng.normal(size=4))
    offsets = rotation.from_rotation_vector(rng.normal(0, spread, (count, 3)))
    signs = rng.choice([-1, 1], (count, 1))
    return centre, signs * rotation.multiply(offsets, centre)


def rotated(centre: np.ndarray, angle: float) -> np.ndarray:
    axis = rotation.normalize(np.array([1.0, -2.0, 0.5]))
    return rotation.multiply(rotation.from_rotation_vector(angle * axis), centre)


def mean_square(rotations: np.ndarray, other: np.ndarray) -> float:
    return float(np.mean(rotation.angle_between(rotations, other) ** 2))


@given(st.integers(0, 99), SPREADS, ANGLES)
def test_where_it_says_that_it_holds_it_is_exact(seed, spread, angle):
    centre, rotations = scattered(seed, spread)
    moments, other = AngleMoments.of(rotations, centre), rotated(centre, angle)
    if moments.is_exact_for(other):
        expected = mean_square(rotations, other)
        assert moments.mean_square(other) == pytest.approx(expected, rel=1e-9)
    assert moments.is_exact_for(centre)


@pytest.mark.parametrize('spread', [1e-7, 1e-3, 0.02, 0.3])
def test_moments_are_exact_within_a_degree(spread):
    centre, rotations = scattered(5, spread)
    moments = AngleMoments.of(rotations, centre)
    assert moments.is_exact_for(rotated(centre, np.radians(1)))
    assert not moments.is_exact_for(rotated(centre, np.radians(40)))


@given(st.integers(0, 99), st.sampled_from([0.003, 0.01, 0.03]), st.sampled_from([0.5, 1.5, 3.0]))
def test_rare_outliers_are_not_overlooked(seed, angle, far):
    centre, rotations = scattered(seed, 1e-3)
    rotations[:3] = rotated(centre, far)
    moments, other = AngleMoments.of(rotations, centre), rotated(centre, angle)
    if moments.is_exact_for(other):
        assert moments.mean_square(other) == pytest.approx(mean_square(rotations, other), rel=1e-9)


def test_the_sign_of_a_quaternion_does_not_matter():
    centre, rotations = scattered(6, 0.1)
    moments, other = AngleMoments.of(rotations, centre), rotated(centre, 0.01)
    assert moments.mean_square(-other) == moments.mean_square(other)
    assert AngleMoments.of(-rotations, centre).mean_square(other) == moments.mean_square(other)


def test_half_a_rotation_away_nothing_is_extrapolated():
    centre, rotations = scattered(7, 1e-3)
    opposite = rotation.multiply(np.array([1.0, 0.0, 0.0, 0.0]), centre)
    moments = AngleMoments.of(np.concatenate([rotations, [opposite]]), centre)
    assert moments.is_exact_for(centre)
    assert not moments.is_exact_for(rotated(centre, 1e-3))


def test_merging_gives_the_moments_of_both():
    centre, rotations = scattered(8, 0.05)
    merged = AngleMoments.of(rotations[:100], centre).merge(
        AngleMoments.of(rotations[100:], centre)
    )
    other = rotated(centre, 0.005)
    assert merged.count == len(rotations)
    assert merged.mean_square(other) == pytest.approx(mean_square(rotations, other), rel=1e-10)


def test_of_nothing_there_is_no_mean():
    moments = AngleMoments.of(np.empty((0, 4)), np.array([0.0, 0.0, 0.0, 1.0]))
    assert np.isnan(moments.mean_square(moments.reference))
