"""Quaternions do what rotation matrices do, and lose nothing at the ends of their range."""

from collections.abc import Callable
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core import rotation

Draws = Callable[[np.random.Generator], np.ndarray]
SEEDS = st.integers(0, 2**32 - 1)
TINY = 1e-14  # some tens of roundings of numbers around 1


def draw(seed: int, count: int = 20) -> np.ndarray:
    """Return random unit quaternions; some by 180 degrees, some by nearly nothing."""
    rng = np.random.default_rng(seed)
    angles = rng.choice([0, 1e-9, 1e-3, 1, np.pi - 1e-9, np.pi], (count, 1))
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    quaternions = np.concatenate([np.sin(angles / 2) * axes, np.cos(angles / 2)], axis=1)
    return quaternions * rng.choice([-1, 1], (count, 1))


def as_matrix(q: np.ndarray) -> np.ndarray:
    """Return rotation matrices, written out (Kuipers 1999, equation 5.11)."""
    x, y, z, w = q.T
    return np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        ),
        -1,
        0,
    )


@given(SEEDS)
def test_products_inverses_and_rotated_vectors_are_those_of_as_matrix(seed):
    a, b = draw(seed), draw(seed + 1)
    v = np.random.default_rng(seed).normal(size=(len(a), 3))
    np.testing.assert_allclose(rotation.to_matrix(a), as_matrix(a), atol=TINY)
    np.testing.assert_allclose(
        as_matrix(rotation.multiply(a, b)), as_matrix(a) @ as_matrix(b), atol=TINY
    )
    np.testing.assert_allclose(
        as_matrix(rotation.conjugate(a)), as_matrix(a).swapaxes(1, 2), atol=TINY
    )
    np.testing.assert_allclose(
        rotation.rotate(a, v), (as_matrix(a) @ v[..., None])[..., 0], atol=10 * TINY
    )


@given(SEEDS)
def test_matrices_and_rotation_vectors_lead_back_to_the_quaternion(seed):
    q = draw(seed)
    for back in (
        rotation.from_matrix(rotation.to_matrix(q)),
        rotation.from_rotation_vector(rotation.to_rotation_vector(q)),
    ):
        np.testing.assert_allclose(np.abs(np.sum(back * q, axis=1)), 1, atol=TINY)
        np.testing.assert_allclose(rotation.angle_between(back, q), 0, atol=10 * TINY)


def test_one_quaternion_turns_many_vectors_and_many_turn_one():
    q, v = draw(0), np.random.default_rng(0).normal(size=(20, 3))
    np.testing.assert_array_equal(rotation.rotate(q[0], v)[7], rotation.rotate(q[0], v[7]))
    np.testing.assert_array_equal(rotation.rotate(q, v[0])[7], rotation.rotate(q[7], v[0]))
    np.testing.assert_array_equal(rotation.multiply(q[0], q)[7], rotation.multiply(q[0], q[7]))


@pytest.mark.parametrize('angle', [0, 1e-12, 1e-7, 0.3, 3, np.pi - 1e-7, np.pi])
@pytest.mark.parametrize('sign', [-1, 1])
def test_an_angle_is_as_exact_where_it_is_tiny_as_where_it_is_half_a_turn(angle, sign):
    # arccos of a trace would give 0 below 1e-8
    a = draw(3)
    b = rotation.multiply(rotation.from_rotation_vector(np.array([0, 0, angle])), a)
    np.testing.assert_allclose(rotation.angle_between(a, sign * b), angle, atol=1e-15, rtol=1e-9)


def test_normalize_gives_unit_length_and_nan_for_no_rotation():
    q = rotation.normalize(np.array([[0.0, 0, 3, 4], [0, 0, 0, 0]]))
    np.testing.assert_allclose(q[0], [0, 0, 0.6, 0.8])
    assert np.isnan(q[1]).all()


@given(SEEDS, st.floats(0, 1))
def test_slerp_is_that_of_scipy(seed, weight):
    transform = pytest.importorskip('scipy.spatial.transform')
    rng = np.random.default_rng(seed)
    a, b = rotation.normalize(rng.normal(size=(2, 8, 4)))
    for k, q in enumerate(rotation.slerp(a, b, np.full(8, weight))):
        both = transform.Rotation.from_quat([a[k], b[k]])
        expected = transform.Slerp([0, 1], both)(weight).as_quat()
        # towards half a turn the arc itself becomes uncertain
        assert rotation.angle_between(q, expected) < 1e-9


def test_slerp_between_equal_and_opposite_quaternions_stays_there():
    q = draw(5)
    weight = np.linspace(0, 1, len(q))
    for end in (q, -q):
        between = rotation.slerp(q, end, weight)
        np.testing.assert_allclose(rotation.angle_between(between, q), 0, atol=1e-15)


@pytest.mark.parametrize('angle', [0, 1e-10, 1, 3, math.pi - 1e-9, math.pi])
def test_the_angle_of_a_rotation_is_that_of_its_matrix(angle):
    q = rotation.from_rotation_vector(angle * np.array([0.36, 0.48, -0.8]))
    assert rotation.angle(q) == pytest.approx(angle, rel=1e-9, abs=1e-15)
    assert rotation.angle_of_matrix(as_matrix(q[None])[0]) == pytest.approx(angle, abs=1e-9)


def test_rotations_about_z_take_x_towards_y():
    angles = np.array([0, math.pi / 2, -math.pi])
    forward = rotation.rotate(rotation.about_z(angles), np.array([1.0, 0, 0]))
    np.testing.assert_allclose(forward, [[1, 0, 0], [0, 1, 0], [-1, 0, 0]], atol=TINY)
