"""Alignments are the best of their kind, exact in closed form, and honest where undetermined."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import FREE_PARAMETERS, Moments, solve
from vio_eval_ros.core.config import ALIGNMENTS
from vio_eval_ros.core.trajectory import Pairs, Trajectory

SEEDS = st.integers(0, 2**32 - 1)
UTM = np.array([4.5e5, 5.4e6, 200.0])
FITTED = [mode for mode in ALIGNMENTS if mode != 'none']


def pairs_of(estimate: np.ndarray, truth: np.ndarray, rotations: bool = True) -> Pairs:
    stamps = np.arange(len(truth))
    q = rotation.normalize(np.random.default_rng(0).normal(size=(len(truth), 4)))
    return Pairs.of(*(Trajectory(stamps, p, q if rotations else None) for p in (estimate, truth)))


def draw(seed: int, count: int = 50, noise: float = 0.3) -> Pairs:
    rng = np.random.default_rng(seed)
    truth = rng.normal(size=(count, 3)) * [3, 2, 1] + rng.normal(size=3) * 10
    turn = rotation.normalize(rng.normal(size=4))
    estimate = rotation.rotate(turn, truth + rng.normal(0, noise, truth.shape)) * rng.uniform(
        0.3, 3
    )
    return pairs_of(estimate + rng.normal(size=3) * 10, truth)


def moments_of(pairs: Pairs) -> Moments:
    return Moments.of(pairs)


def mean_square(alignment, pairs: Pairs) -> float:
    errors = alignment.apply(pairs.estimate).positions - pairs.ground_truth.positions
    return float(np.mean(np.sum(errors**2, axis=1)))


@given(SEEDS, st.lists(st.integers(0, 20), min_size=1, max_size=6), st.booleans())
def test_merged_moments_are_those_of_all(seed, sizes, turned):
    rng = np.random.default_rng(seed)
    pairs = pairs_of(*(rng.normal(size=(2, sum(sizes), 3)) + UTM))
    reference = rotation.to_matrix(rotation.normalize(rng.normal(size=4))) if turned else None
    merged, begin = Moments.empty(), 0
    for size in sizes:
        merged = merged.merge(Moments.of(pairs[begin : begin + size], reference))
        begin += size
    whole = Moments.of(pairs, reference)
    assert merged.count == whole.count == sum(sizes)
    # a coordinate of 5.4e6 m is resolved to 1e-9 m; the scatter is of the order of 1 m² a pair
    np.testing.assert_allclose(merged.mean, whole.mean, rtol=0, atol=5e-9)
    np.testing.assert_allclose(merged.scatter, whole.scatter, rtol=0, atol=1e-6)


@given(SEEDS)
def test_moments_are_those_of_numpy_whatever_the_reference(seed):
    pairs = draw(seed)
    e, g = pairs.estimate.positions, pairs.ground_truth.positions
    joint = np.cov(np.hstack([e, g]).T, bias=True) * len(pairs)
    turn = rotation.to_matrix(rotation.normalize(np.random.default_rng(seed).normal(size=4)))
    for moments in (Moments.of(pairs), Moments.of(pairs, turn)):
        np.testing.assert_allclose(moments.mean_estimate, e.mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(moments.mean_truth, g.mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(moments.cross, joint[3:, :3], atol=1e-9)
        np.testing.assert_allclose(moments.truth_scatter, joint[3:, 3:], atol=1e-9)
        np.testing.assert_allclose(moments.estimate_scatter, joint[:3, :3], atol=1e-9)


@given(SEEDS, st.sampled_from(ALIGNMENTS))
def test_the_closed_form_is_the_mean_square_of_the_errors(seed, mode):
    pairs = draw(seed)
    alignment = solve(mode, moments_of(pairs), pairs[:1])
    assert alignment.mean_square(moments_of(pairs)) == pytest.approx(
        mean_square(alignment, pairs), rel=1e-9
    )


@given(SEEDS)
def test_the_formulas_of_the_definitions_hold(seed):
    pairs = draw(seed)
    e, g = (
        side.positions - side.positions.mean(axis=0)
        for side in (pairs.estimate, pairs.ground_truth)
    )
    v_e, v_g, c = np.mean(np.sum(e**2, 1)), np.mean(np.sum(g**2, 1)), g.T @ e / len(e)
    u, d, vt = np.linalg.svd(c)
    trace = d @ [1, 1, round(np.linalg.det(u) * np.linalg.det(vt))]
    yawed = c[2, 2] + math.hypot(c[0, 0] + c[1, 1], c[1, 0] - c[0, 1])
    raw_e, raw_g = pairs.estimate.positions, pairs.ground_truth.positions
    found = {mode: solve(mode, moments_of(pairs), pairs[:1]) for mode in ALIGNMENTS}
    for mode, expected in {
        'se3': v_g + v_e - 2 * trace,
        'sim3': v_g - trace**2 / v_e,
        'posyaw': v_g + v_e - 2 * yawed,
        'none': np.mean(np.sum((raw_e - raw_g) ** 2, axis=1)),
    }.items():
        assert mean_square(found[mode], pairs) == pytest.approx(expected, rel=1e-9)
    assert found['sim3'].scale == pytest.approx(trace / v_e, rel=1e-12)
    assert found['scale'].scale == pytest.approx(np.sum(raw_e * raw_g) / np.sum(raw_e**2))


@given(SEEDS, st.sampled_from(['scale', 'posyaw', 'se3', 'sim3']), st.sampled_from([1e-3, 0.3]))
def test_no_alignment_near_the_one_found_is_better(seed, mode, step):
    pairs = draw(seed)
    best = solve(mode, moments_of(pairs), pairs[:1])
    rng = np.random.default_rng(seed)
    for _ in range(10):
        turn, shift, factor = rng.normal(0, step, 3), rng.normal(0, step, 3), rng.normal(0, step)
        if mode == 'posyaw':
            turn[:2] = 0
        if mode == 'scale':
            turn, shift = np.zeros(3), np.zeros(3)
        other = rotation.multiply(rotation.from_rotation_vector(turn), best.rotation)
        scale = best.scale * (1 + factor * (mode in ('scale', 'sim3')))
        positions = scale * rotation.rotate(other, pairs.estimate.positions)
        # rotated about the centre, so that shift and rotation do not hide each other
        centre = scale * rotation.rotate(other, pairs.estimate.positions.mean(axis=0))
        if mode != 'scale':
            positions += pairs.ground_truth.positions.mean(axis=0) - centre + shift
        errors = positions - pairs.ground_truth.positions
        assert mean_square(best, pairs) <= np.mean(np.sum(errors**2, axis=1)) * (1 + 1e-12)


@given(SEEDS)
def test_more_freedom_never_makes_the_error_larger(seed):
    pairs = draw(seed, count=5)
    found = {
        mode: math.sqrt(mean_square(solve(mode, moments_of(pairs), pairs[:1]), pairs))
        for mode in ALIGNMENTS
    }
    slack = 1 + 1e-9
    assert found['sim3'] <= found['se3'] * slack
    assert found['se3'] <= found['posyaw'] * slack
    assert found['se3'] <= found['origin'] * slack
    assert found['posyaw'] <= found['none'] * slack
    assert found['scale'] <= found['none'] * slack


@given(SEEDS)
def test_a_known_similarity_is_found_again(seed):
    rng = np.random.default_rng(seed)
    truth = rng.normal(size=(20, 3)) * [5, 4, 0]  # in a plane: a reflection would fit as well
    turn, shift, scale = rotation.normalize(rng.normal(size=4)), rng.normal(size=3), 1.7
    back = rotation.rotate(rotation.conjugate(turn), truth - shift) / scale
    pairs = pairs_of(back, truth)
    found = solve('sim3', moments_of(pairs), pairs[:1])
    assert found.observable
    assert found.scale == pytest.approx(scale, rel=1e-12)
    # eight digits of a square root of the rounding in the third singular value
    np.testing.assert_allclose(rotation.angle_between(found.rotation, turn), 0, atol=1e-7)
    np.testing.assert_allclose(found.translation, shift, atol=1e-6)
    np.testing.assert_allclose(found.apply(pairs.estimate).positions, truth, atol=1e-6)


def test_a_mirrored_estimate_is_not_turned_into_the_truth():
    truth = np.random.default_rng(0).normal(size=(30, 3))
    pairs = pairs_of(truth * [1, 1, -1], truth)
    found = solve('se3', moments_of(pairs), pairs[:1])
    np.testing.assert_allclose(np.linalg.det(found.matrix), 1)
    assert mean_square(found, pairs) > 0.1


@pytest.mark.parametrize('mode', ['posyaw', 'se3', 'sim3'])
def test_coordinates_of_the_size_of_utms_lose_no_digits_but_their_own(mode):
    pairs = draw(3)
    away = pairs_of(pairs.estimate.positions + UTM, pairs.ground_truth.positions + UTM)
    near, far = (solve(mode, moments_of(p), p[:1]) for p in (pairs, away))
    assert far.mean_square(moments_of(away)) == pytest.approx(
        near.mean_square(moments_of(pairs)), rel=1e-6
    )
    assert mean_square(far, away) == pytest.approx(mean_square(near, pairs), rel=1e-6)


def test_posyaw_turns_about_the_vertical_only():
    found = solve('posyaw', moments_of(draw(1)), draw(1)[:1])
    np.testing.assert_array_equal(found.rotation[:2], 0)
    assert found.scale == 1


def test_origin_makes_the_first_poses_coincide():
    rng = np.random.default_rng(0)
    pairs = Pairs.of(
        *(
            Trajectory(
                np.arange(5), rng.normal(size=(5, 3)), rotation.normalize(rng.normal(size=(5, 4)))
            )
            for _ in range(2)
        )
    )
    first = solve('origin', moments_of(pairs), pairs[:1]).apply(pairs.estimate)[:1]
    np.testing.assert_allclose(first.positions, pairs.ground_truth.positions[:1])
    assert rotation.angle_between(first.rotations, pairs.ground_truth.rotations[:1]) < 1e-15


LINE = np.outer(np.arange(20.0), [1, 2, 3])
THICK = LINE + np.outer(np.sin(np.arange(20)), [3, 0, -1])


@pytest.mark.parametrize(
    ('truth', 'se3', 'posyaw'),
    [
        (THICK, True, True),
        (THICK[:3], True, True),
        (np.zeros((20, 3)), False, False),
        (THICK * 1e-9, False, False),
        (LINE, False, True),
        (LINE + (THICK - LINE) * 1e-3, False, True),
        (LINE + (THICK - LINE) * 1e-1, True, True),
        (np.outer(np.arange(20.0), [0, 0, 1]), False, False),
        (THICK * [1, 1, 0] + UTM, True, True),
        (LINE + UTM, False, True),
        (np.zeros((20, 3)) + UTM, False, False),
    ],
)
def test_what_the_motion_does_not_determine_is_said_to_be_so(truth, se3, posyaw):
    pairs = pairs_of(truth + np.random.default_rng(0).normal(size=truth.shape), truth)
    for mode, expected in (('se3', se3), ('sim3', se3), ('posyaw', posyaw), ('none', True)):
        found = solve(mode, moments_of(pairs), pairs[:1])
        assert found.observable is expected, mode
        assert np.isfinite(found.rotation).all()
        moves = np.ptp(truth, axis=0).max() > 1e-6
        assert math.isfinite(mean_square(found, pairs)) == (mode != 'sim3' or moves)


@pytest.mark.parametrize('mode', FREE_PARAMETERS)
@pytest.mark.parametrize('count', range(1, 5))
def test_pairs_that_an_alignment_can_fit_whatever_they_are_determine_nothing(mode, count):
    truth = THICK[:count]
    pairs = pairs_of(truth + np.random.default_rng(0).normal(size=truth.shape), truth)
    found = solve(mode, moments_of(pairs), pairs[:1])
    enough = count > 1 and 3 * count > FREE_PARAMETERS[mode]
    assert found.is_known == enough
    assert found.observable == enough
    assert np.isfinite(found.rotation).all() == enough
    assert math.isfinite(mean_square(found, pairs)) == enough


def test_an_alignment_of_the_first_pairs_is_known_only_where_they_determine_it():
    along_a_line = pairs_of(LINE, LINE)
    first = moments_of(along_a_line[:5])
    assert solve('se3', first, along_a_line[:1], 5).is_known
    assert not solve('se3', first, along_a_line[:1], 20).is_known
    assert solve('posyaw', first, along_a_line[:1], 20).is_known
    assert solve('scale', moments_of(along_a_line[1:2]), along_a_line[:1], 20).is_known


@pytest.mark.parametrize('mode', FITTED)
def test_nothing_to_align_gives_no_numbers(mode):
    found = solve(mode, Moments.empty(), pairs_of(np.empty((0, 3)), np.empty((0, 3))))
    assert not found.observable
    assert np.isnan(found.translation).all()
    assert math.isnan(found.mean_square(Moments.empty()))


def test_an_estimate_that_does_not_move_has_no_scale():
    pairs = pairs_of(np.ones((20, 3)), THICK)
    found = solve('sim3', moments_of(pairs), pairs[:1])
    assert math.isnan(found.scale)
    assert math.isnan(found.mean_square(moments_of(pairs)))
    assert math.isfinite(solve('se3', moments_of(pairs), pairs[:1]).mean_square(moments_of(pairs)))
    nowhere = pairs_of(np.zeros((20, 3)), THICK)
    assert math.isnan(solve('scale', moments_of(nowhere), nowhere[:1]).scale)


def test_the_rotation_of_an_estimate_that_does_not_move_is_not_determined():
    pairs = pairs_of(np.ones((20, 3)), THICK)
    assert not solve('se3', moments_of(pairs), pairs[:1]).observable


@pytest.mark.parametrize('place', [np.zeros(3), np.array([1.1, 2.3, 0.7]), UTM])
@pytest.mark.parametrize('mode', ['posyaw', 'se3', 'sim3'])
def test_truth_that_stands_still_determines_nothing_however_far_the_estimate_goes(mode, place):
    for seed in range(20):  # whichever way rounding goes
        estimate = np.random.default_rng(seed).normal(0, 100, (100, 3))
        pairs = pairs_of(estimate, np.tile(place, (100, 1)))
        found = solve(mode, moments_of(pairs), pairs[:1])
        assert not found.observable
        assert math.isfinite(found.mean_square(moments_of(pairs))) == (mode != 'sim3')


def test_origin_needs_orientations():
    pairs = pairs_of(THICK, THICK, rotations=False)
    found = solve('origin', moments_of(pairs), pairs[:1])
    assert not found.observable
    assert np.isnan(found.apply(pairs.estimate).positions).all()
