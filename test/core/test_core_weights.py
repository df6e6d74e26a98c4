"""Weights of true positions: in the fit of alignments, and nowhere else."""

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Moments, solve
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.interpolation import between, Interpolator
from vio_eval_ros.core.series import running_series
from vio_eval_ros.core.trajectory import PairLog, Pairs, Trajectory

SEEDS = st.integers(0, 2**32 - 1)
FITTED = ('scale', 'posyaw', 'se3', 'sim3')
MS = 1_000_000


def umeyama(
    estimate: np.ndarray, truth: np.ndarray, weights: np.ndarray, scaled: bool
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return s, R, t that minimise the weighted sum of |s R e + t - g|² (Umeyama 1991)."""
    w = weights / weights.sum()
    e, g = estimate - w @ estimate, truth - w @ truth
    u, d, vt = np.linalg.svd((g * w[:, None]).T @ e)
    signs = np.array([1.0, 1.0, round(np.linalg.det(u @ vt))])
    turn = u @ np.diag(signs) @ vt
    scale = float(d @ signs) / float(w @ (e**2).sum(axis=1)) if scaled else 1.0
    return scale, turn, w @ truth - scale * turn @ (w @ estimate)


def draw(seed: int, count: int = 60, spread: float = 100.0) -> Pairs:
    """Return pairs whose errors go with their weights, of which some are 0."""
    rng = np.random.default_rng(seed)
    deviations = 0.01 * spread ** rng.uniform(size=count)
    weights = deviations**-2
    weights[rng.uniform(size=count) < 0.1] = 0
    truth = rng.normal(size=(count, 3)) * [3, 2, 1]
    turn = rotation.normalize(rng.normal(size=4))
    estimate = rotation.rotate(turn, truth) * rng.uniform(0.3, 3) + rng.normal(size=3) * 10
    truth = truth + rng.normal(size=(count, 3)) * deviations[:, None]
    stamps_ns = np.arange(count) * 50 * MS
    orientations = rotation.normalize(rng.normal(size=(count, 4)))
    return Pairs(
        Trajectory(stamps_ns, estimate, orientations),
        Trajectory(stamps_ns, truth, orientations, weights=weights),
    )


def weighted(pairs: Pairs, weights: np.ndarray | None) -> Pairs:
    return replace(pairs, ground_truth=replace(pairs.ground_truth, weights=weights))


@given(SEEDS, st.sampled_from(['se3', 'sim3']))
def test_an_alignment_is_the_weighted_one(seed, mode):
    pairs = draw(seed)
    found = solve(mode, Moments.of(pairs), pairs[:1])
    weights = pairs.ground_truth.weights
    scale, turn, translation = umeyama(
        pairs.estimate.positions, pairs.ground_truth.positions, weights, mode == 'sim3'
    )
    assert found.scale == pytest.approx(scale, rel=1e-9)
    np.testing.assert_allclose(found.matrix, turn, atol=1e-9)
    np.testing.assert_allclose(found.translation, translation, atol=1e-7)


@given(SEEDS, st.sampled_from(FITTED))
def test_no_other_alignment_has_a_smaller_weighted_error(seed, mode):
    pairs = draw(seed)
    weights = pairs.ground_truth.weights
    found = solve(mode, Moments.of(pairs), pairs[:1])

    def cost(one):
        errors = one.positions(pairs.estimate.positions) - pairs.ground_truth.positions
        return float(weights @ (errors**2).sum(axis=1))

    rng = np.random.default_rng(seed)
    step = rng.normal(size=3) * 1e-4 * ([0, 0, 1] if mode == 'posyaw' else [1, 1, 1])
    for sign in (1, -1):
        moved = {'scale': found.scale * (1 + 1e-4 * sign)} if mode in ('scale', 'sim3') else {}
        if mode != 'scale':
            turn = rotation.from_rotation_vector(sign * step)
            moved |= {
                'rotation': rotation.multiply(turn, found.rotation),
                'translation': found.translation + sign * rng.normal(size=3) * 1e-4,
            }
        assert cost(replace(found, **moved)) > cost(found)


@given(SEEDS, st.sampled_from(FITTED), st.floats(1e-30, 1e30))
def test_only_their_ratios_count(seed, mode, factor):
    pairs = draw(seed)
    one = solve(mode, Moments.of(pairs), pairs[:1])
    scaled = weighted(pairs, pairs.ground_truth.weights * factor)
    other = solve(mode, Moments.of(scaled), pairs[:1])
    np.testing.assert_allclose(other.linear, one.linear, atol=1e-9)
    np.testing.assert_allclose(other.translation, one.translation, atol=1e-7)
    assert other.observable == one.observable


@given(SEEDS, st.sampled_from(FITTED))
def test_equal_weights_change_nothing(seed, mode):
    pairs = draw(seed)
    plain = weighted(pairs, None)
    equal = weighted(pairs, np.full(len(pairs), 0.3))
    one, other = (solve(mode, Moments.of(each), each[:1]) for each in (plain, equal))
    np.testing.assert_allclose(other.linear, one.linear, atol=1e-9)
    np.testing.assert_allclose(other.translation, one.translation, atol=1e-7)


@given(SEEDS, st.sampled_from(FITTED))
def test_what_has_no_weight_is_as_if_it_were_not_there_for_the_fit(seed, mode):
    pairs = draw(seed)
    has = pairs.ground_truth.weights > 0
    whole = solve(mode, Moments.of(pairs), pairs[:1])
    rest = solve(mode, Moments.of(pairs[has]), pairs[:1])
    np.testing.assert_allclose(whole.linear, rest.linear, atol=1e-9)
    assert Moments.of(pairs).count == len(pairs)


@given(SEEDS, st.lists(st.integers(0, 20), min_size=1, max_size=6))
def test_weighted_moments_merge(seed, sizes):
    pairs = draw(seed, count=max(sum(sizes), 1))
    merged, begin = Moments.empty(), 0
    for size in sizes:
        merged, begin = merged.merge(Moments.of(pairs[begin : begin + size])), begin + size
    whole = Moments.of(pairs[:begin])
    plain = Moments.of(weighted(pairs, None)[:begin])
    np.testing.assert_array_equal(whole.scatter, plain.scatter)
    for one, other in ((merged, whole), (merged.to_fit(), whole.to_fit())):
        assert one.count == other.count
        np.testing.assert_allclose(one.mean, other.mean, atol=1e-9)
        np.testing.assert_allclose(one.scatter, other.scatter, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('mode', FITTED)
def test_where_no_pair_has_a_weight_nothing_is_determined(mode):
    pairs = draw(0)
    pairs = weighted(pairs, np.zeros(len(pairs)))
    found = solve(mode, Moments.of(pairs), pairs[:1])
    assert not found.is_known
    assert 'counting only pairs with a weight' in found.undetermined


def test_pairs_with_a_weight_on_a_line_do_not_determine_the_others():
    pairs = draw(1)
    weights = np.zeros(len(pairs))
    weights[:20] = 1
    for side in (pairs.estimate, pairs.ground_truth):
        side.positions[:20] = np.arange(20)[:, None] * [1.0, 2, 3]
    found = solve('se3', Moments.of(weighted(pairs, weights)), pairs[:1])
    assert not found.is_known
    assert found.undetermined == (
        'the ground truth moves along a line, counting only pairs with a weight'
    )


def evaluated(pairs: Pairs, batches: int = 1, **options) -> Evaluation:
    evaluation = Evaluation(EvaluationConfig(**options))
    for rows in np.array_split(np.arange(len(pairs)), batches):
        evaluation.add_ground_truth(pairs.ground_truth[rows])
        evaluation.add_estimate(pairs.estimate[rows])
        if batches > 1:
            evaluation.running()
    evaluation.flush()
    return evaluation


@pytest.mark.parametrize('association', ['nearest', 'interpolate'])
@pytest.mark.parametrize('alignment', FITTED)
@pytest.mark.parametrize('align_first_s', [0.0, 2.0])
def test_running_values_are_those_of_the_summary(association, alignment, align_first_s):
    options = {
        'association': association, 'alignment': alignment, 'align_first_s': align_first_s
    }  # fmt: skip
    pairs = draw(3, count=300)
    evaluation = evaluated(pairs, batches=40, **options)
    final = evaluation.summary()
    names = [name for name in evaluation.running() if name in final.metrics]
    assert 'ate_trans_rmse_m' in names
    for values in (evaluation.running(), evaluated(pairs, **options).summary().metrics):
        assert {name: values[name] for name in names} == pytest.approx(
            {name: final.metrics[name] for name in names}, rel=1e-9, nan_ok=True
        )
    config = EvaluationConfig(**options)
    *_, (_, last) = running_series(config, pairs.estimate, pairs.ground_truth)
    assert last['ate_trans_rmse_m'] == final.metrics['ate_trans_rmse_m']


@pytest.mark.parametrize('mode', ['se3', 'sim3'])
def test_errors_and_their_statistics_are_not_weighted(mode):
    pairs = draw(4, count=300)
    summary = evaluated(pairs, alignment=mode).summary()
    scale, turn, translation = umeyama(
        pairs.estimate.positions,
        pairs.ground_truth.positions,
        pairs.ground_truth.weights,
        mode == 'sim3',
    )
    aligned = scale * pairs.estimate.positions @ turn.T + translation
    errors = np.linalg.norm(aligned - pairs.ground_truth.positions, axis=1)
    rmse = math.sqrt(float(np.mean(errors**2)))
    assert summary.metrics['ate_trans_rmse_m'] == pytest.approx(rmse, rel=1e-9)
    assert summary.metrics['ate_trans_median_m'] == pytest.approx(np.median(errors), rel=1e-9)
    assert summary.metrics[f'ate_{mode}_trans_rmse_m'] == pytest.approx(rmse, rel=1e-9)


def test_a_fit_that_hangs_on_few_poses_is_said():
    pairs = draw(5, count=200)
    weights = np.full(200, 1.0)
    assert not [w for w in evaluated(weighted(pairs, weights)).summary().warnings if 'equal' in w]
    weights[[3, 70, 140]] = 1e6
    told = [w for w in evaluated(weighted(pairs, weights)).summary().warnings if 'equal' in w]
    assert told == [
        'the weights of 200 pairs are worth 3.0 equal ones: few true poses decide the alignment'
    ]


def test_between_two_poses_the_variance_is_interpolated():
    poses = Trajectory(
        np.array([0, 100, 200, 300, 400]) * MS,
        np.random.default_rng(0).normal(size=(5, 3)),
        weights=np.array([1.0, 0.25, 0.0, 0.5, 2.0]),
    )
    at_ns = np.array([0, 50, 100, 150, 250, 325]) * MS
    before = np.array([0, 0, 1, 1, 2, 3])
    found = between(poses[before], poses[before + 1], at_ns)
    assert found.weights == pytest.approx([1, 1 / 2.5, 0.25, 0, 0, 1 / (0.75 / 0.5 + 0.25 / 2)])
    finer = Interpolator(poses, 0.5).at(at_ns)
    assert finer.weights == pytest.approx(found.weights)


def test_columns_keep_their_weights():
    pairs = draw(6)
    truth = pairs.ground_truth
    assert Trajectory.concatenate([truth[:7], truth[7:]]).weights == pytest.approx(truth.weights)
    assert Trajectory.concatenate([Trajectory.empty(), truth]).weights is truth.weights
    mixed = Trajectory.concatenate([truth[:7], replace(truth[7:], weights=None)])
    assert mixed.weights is None
    log = PairLog()
    for begin in range(0, 60, 9):
        log.append(pairs[begin : begin + 9])
    np.testing.assert_array_equal(log.all().ground_truth.weights, truth.weights)
