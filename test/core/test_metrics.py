"""Metrics are what their definitions say, computed from the poses by brute force."""

from dataclasses import replace
import math

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Moments, solve
from vio_eval_ros.core.association import Associator
from vio_eval_ros.core.config import Delta, EvaluationConfig, RPE_PAIRS
from vio_eval_ros.core.metric import Observations
from vio_eval_ros.core.metrics import METRICS
from vio_eval_ros.core.relative import candidates, progress_along
from vio_eval_ros.core.statistics import statistics
from vio_eval_ros.core.trajectory import PairLog, Trajectory

DELTAS = ('1f', '7f', '0.5s', '2s', '3m', '20d')
NOTHING = Trajectory.empty()
# of rank 2, but rounding makes the smallest eigenvalue positive
SINGULAR = np.array([[10.9, 1.3, -0.92], [1.3, 0.2, -0.12], [-0.92, -0.12, 0.08]])


def observations(
    estimate: Trajectory, truth: Trajectory, config: EvaluationConfig
) -> Observations:
    associator, log = Associator(config), PairLog()
    associator.add_estimate(estimate)
    associator.add_ground_truth(truth)
    log.append(associator.flush()[associator.chosen])
    moments = Moments.of(log.all())
    alignment = solve(config.alignment, moments, log.all()[:1])
    return Observations(
        log=log,
        moments=moments,
        alignment=alignment,
        tracking=associator.tracking(),
    )


def matrices(trajectory: Trajectory, scale: float = 1.0) -> np.ndarray:
    """Return (N, 4, 4) poses."""
    poses = np.tile(np.eye(4), (len(trajectory), 1, 1))
    poses[:, :3, :3] = rotation.to_matrix(trajectory.rotations)
    poses[:, :3, 3] = scale * trajectory.positions
    return poses


def rotated_by(matrix: np.ndarray) -> np.ndarray:
    """Return the degrees of (M, 3, 3) rotation matrices."""
    return np.degrees(
        np.linalg.norm(rotation.to_rotation_vector(rotation.from_matrix(matrix)), axis=-1)
    )


# Generic: whatever is added to METRICS passes these.


@pytest.mark.parametrize('name', METRICS)
class TestEveryMetric:
    CONFIG = EvaluationConfig(rpe_deltas=DELTAS, segment_lengths_m=(5, 20), alignment='sim3')

    def full(self, flight, estimated) -> Observations:
        estimate = estimated(flight)
        covariances = np.tile(np.eye(3), (len(estimate), 2, 1, 1))
        run = observations(replace(estimate, covariances=covariances), flight, self.CONFIG)
        return replace(run, causal={'ate_trans_rmse_m': 1.0, 'ate_rot_rmse_deg': 2.0})

    def test_gives_the_same_names_with_and_without_data(self, name, flight, estimated):
        empty, full = observations(NOTHING, NOTHING, self.CONFIG), self.full(flight, estimated)
        metric = METRICS[name](self.CONFIG)
        assert list(metric.final(empty).values) == list(metric.final(full).values)
        assert list(metric.running(empty)) == list(metric.running(full))
        assert metric.running(full).keys() <= metric.final(full).values.keys()

    def test_is_a_number_with_data_and_none_without(self, name, flight, estimated):
        empty, full = observations(NOTHING, NOTHING, self.CONFIG), self.full(flight, estimated)
        metric, idle = METRICS[name](self.CONFIG), METRICS[name](self.CONFIG)
        for values in (metric.final(full).values, metric.running(full)):
            assert all(type(value) in (int, float) for value in values.values())
            # 20 s and some 200 m of path
            assert not [key for key, value in values.items() if not math.isfinite(value)]
        for values in (idle.final(empty).values, idle.running(empty)):
            counts = [value for value in values.values() if isinstance(value, int)]
            assert counts == [0] * len(counts)
            assert all(isinstance(value, int) or math.isnan(value) for value in values.values())

    def test_has_no_memory_of_what_was_asked_before(self, name, flight, estimated):
        metric, full = METRICS[name](self.CONFIG), self.full(flight, estimated)
        first = metric.final(full)
        metric.running(full)
        assert metric.final(full) == first


# Statistics


# Absolute errors


@pytest.mark.parametrize('metres', [0.0, 0.25])
@pytest.mark.parametrize('degrees', [0.0, 5.0])
@pytest.mark.parametrize('scale', [1.0, 0.8])
def test_a_known_fault_gives_a_known_error(flight, evaluate, metres, degrees, scale):
    turn = rotation.from_rotation_vector(np.radians([0, 0, degrees]))
    estimate = replace(
        flight,
        positions=scale * flight.positions + [0, 0, metres],
        rotations=rotation.multiply(turn, flight.rotations),
    )
    none = evaluate(estimate, flight, alignment='none').metrics
    expected = np.linalg.norm((scale - 1) * flight.positions + [0, 0, metres], axis=1)
    assert none['ate_trans_mean_m'] == pytest.approx(expected.mean(), abs=1e-12)
    assert none['ate_trans_rmse_m'] == pytest.approx(np.sqrt(np.mean(expected**2)), abs=1e-12)
    assert none['ate_rot_max_deg'] == pytest.approx(degrees, abs=1e-9)
    assert none['ate_rot_min_deg'] == pytest.approx(degrees, abs=1e-9)
    spread = np.sqrt(np.mean(np.sum((flight.positions - flight.positions.mean(0)) ** 2, axis=1)))
    assert none['ate_se3_trans_rmse_m'] == pytest.approx(abs(1 - scale) * spread, abs=1e-9)
    assert none['ate_sim3_trans_rmse_m'] == pytest.approx(0, abs=1e-9)
    assert none['sim3_scale'] == pytest.approx(1 / scale, rel=1e-12)


def test_a_rotated_world_is_removed_from_the_orientations_as_well(flight, evaluate):
    turn = rotation.from_rotation_vector(np.array([0.3, -1.0, 2.0]))
    estimate = replace(
        flight,
        positions=rotation.rotate(turn, flight.positions),
        rotations=rotation.multiply(turn, flight.rotations),
    )
    metrics = evaluate(estimate, flight).metrics
    assert metrics['ate_rot_max_deg'] < 1e-10
    # a sensor that is rotated on the body stays rotated, whatever the world
    mounted = rotation.multiply(
        estimate.rotations, rotation.from_rotation_vector(np.radians([0, 30.0, 0]))
    )
    metrics = evaluate(replace(estimate, rotations=mounted), flight).metrics
    assert metrics['ate_rot_min_deg'] == pytest.approx(30, abs=1e-9)
    assert metrics['ate_rot_max_deg'] == pytest.approx(30, abs=1e-9)


# Relative errors


@pytest.mark.parametrize('mode', RPE_PAIRS)
@pytest.mark.parametrize('alignment', ['none', 'se3', 'sim3'])
def test_relative_errors_are_those_of_composed_poses(flight, estimated, mode, alignment):
    config = EvaluationConfig(rpe_deltas=DELTAS, rpe_pairs=mode, alignment=alignment)
    run = observations(estimated(flight), flight, config)
    metrics = METRICS['rpe'](config).final(run).values
    p = matrices(run.pairs.estimate, run.alignment.scale)
    g = matrices(run.pairs.ground_truth)
    aligned = run.alignment.apply(run.pairs.estimate).positions
    for delta in map(Delta.parse, DELTAS):
        found = candidates(progress_along(run.pairs, delta.unit), delta, config)
        i, j = found.begin[found.usable], found.end[found.usable]
        assert metrics[f'rpe_{delta}_pairs'] == len(i) > 2
        error = np.linalg.inv(np.linalg.inv(g[i]) @ g[j]) @ (np.linalg.inv(p[i]) @ p[j])
        for kind, errors in {
            'trans_{}_m': np.linalg.norm(error[:, :3, 3], axis=1),
            'rot_{}_deg': rotated_by(error[:, :3, :3]),
            'disp_{}_m': np.linalg.norm(aligned[j] - aligned[i] - (g[j] - g[i])[:, :3, 3], axis=1),
            'dist_{}_m': np.abs(
                np.linalg.norm((p[j] - p[i])[:, :3, 3], axis=1)
                - np.linalg.norm((g[j] - g[i])[:, :3, 3], axis=1)
            ),
        }.items():
            for statistic, value in statistics(errors).items():
                name = f'rpe_{delta}_{kind.format(statistic)}'
                # the smallest distances and angles are differences of numbers around 1
                assert metrics[name] == pytest.approx(value, rel=1e-9, abs=1e-11), name


def test_relative_errors_do_not_depend_on_an_alignment_without_scale(flight, estimated, evaluate):
    metrics = [
        evaluate(estimated(flight), flight, alignment=mode).metrics
        for mode in ('none', 'origin', 'posyaw', 'se3')
    ]
    for name, value in metrics[0].items():
        if name.startswith(('rpe', 'segment', 'kitti', 'drift')) and 'disp' not in name:
            assert [other[name] for other in metrics] == [value] * 4


def test_motions_over_a_gap_are_counted_for_frames_only(flight, evaluate):
    gap = np.r_[0:100, 130:400]  # 30 poses of 50 ms are missing
    warnings = evaluate(flight[gap], flight, rpe_deltas=('1f', '10f', '1s')).warnings
    assert [text for text in warnings if text.startswith('rpe')] == [
        'rpe_1f: 1 of 369 relative motions bridge a gap longer than 0.5 s',
        'rpe_10f: 10 of 360 relative motions bridge a gap longer than 0.5 s',
    ]


def test_a_delta_that_no_two_poses_are_apart_is_reported(flight, evaluate):
    summary = evaluate(flight, flight, rpe_deltas=('1f', '100s'))
    assert 'rpe_100s: no two pairs are 100s apart' in summary.warnings
    assert summary.metrics['rpe_100s_pairs'] == 0
    assert math.isnan(summary.metrics['rpe_100s_trans_rmse_m'])


# Segments and path


def test_segments_are_those_of_the_kitti_devkit(flight, estimated):
    config = EvaluationConfig(segment_lengths_m=(5, 20), alignment='none')
    run = observations(estimated(flight), flight, config)
    metrics = METRICS['segments'](config).final(run).values
    path = progress_along(run.pairs, 'm')
    p, g = matrices(run.pairs.estimate), matrices(run.pairs.ground_truth)
    for name, over in (
        ('segment_5m', [5]),
        ('segment_20m', [20]),
        ('kitti', range(100, 900, 100)),
    ):
        drift, turn = [], []
        for length in over:
            for i in range(0, len(path), 10):
                beyond = [j for j in range(i, len(path)) if path[j] > path[i] + length]
                if beyond:
                    j = beyond[0]
                    error = np.linalg.inv(np.linalg.inv(p[i]) @ p[j]) @ np.linalg.inv(g[i]) @ g[j]
                    drift.append(np.linalg.norm(error[:3, 3]) / length)
                    turn.append(float(rotated_by(error[None, :3, :3])[0]) / length)
        assert metrics[f'{name}_segments'] == len(drift) > 0
        assert metrics[f'{name}_trans_percent'] == pytest.approx(100 * np.mean(drift), rel=1e-9)
        assert metrics[f'{name}_rot_deg_per_m'] == pytest.approx(np.mean(turn), rel=1e-9)


def test_drift_is_the_error_at_the_end_in_percent_of_the_path(evaluate):
    truth = Trajectory(
        np.arange(5) * 10**7, np.outer(np.arange(5.0), [3, 4, 0]), np.tile([0.0, 0, 0, 1], (5, 1))
    )
    estimate = replace(truth, positions=truth.positions * 1.1)
    metrics = evaluate(estimate, truth).metrics
    assert metrics['path_length_m'] == pytest.approx(20, rel=1e-12)
    assert metrics['drift_percent'] == pytest.approx(10, rel=1e-12)


# Consistency


def consistent(count: int, seed: int) -> tuple[Trajectory, Trajectory]:
    """Return an estimate whose errors are drawn from the covariances that it states, and truth."""
    rng = np.random.default_rng(seed)
    factors = (rng.normal(size=(count, 2, 3, 3)) + 5 * np.eye(3)) * [[[0.03]], [[0.004]]]
    errors = np.squeeze(factors @ rng.normal(size=(count, 2, 3, 1)), -1)
    truth = Trajectory(
        np.arange(count) * 10**7,
        rng.normal(0, 5, (count, 3)),
        rotation.normalize(rng.normal(size=(count, 4))),
    )
    # orientation errors are rotations about the fixed axes of the world, as ROS has it
    rotations = rotation.multiply(rotation.from_rotation_vector(errors[:, 1]), truth.rotations)
    covariances = factors @ np.swapaxes(factors, -1, -2)
    return replace(
        truth,
        positions=truth.positions + errors[:, 0],
        rotations=rotations,
        covariances=covariances,
    ), truth


@pytest.mark.parametrize('alignment', ['none', 'se3', 'sim3'])
def test_the_nees_of_a_consistent_estimate_is_about_3(evaluate, alignment):
    metrics = evaluate(*consistent(4000, 0), alignment=alignment).metrics
    # five standard deviations of the mean of 4000 chi-squares of 3 degrees of freedom
    assert metrics['nees_position_mean'] == pytest.approx(3, abs=5 * math.sqrt(6 / 4000))
    assert metrics['nees_orientation_mean'] == pytest.approx(3, abs=5 * math.sqrt(6 / 4000))


@pytest.mark.parametrize(('alignment', 'scale'), [('se3', 1.0), ('origin', 1.0), ('sim3', 2.5)])
def test_nees_does_not_depend_on_the_world_of_the_estimate(evaluate, alignment, scale):
    estimate, truth = consistent(300, 1)
    turn = rotation.from_rotation_vector(np.array([0.5, 1.0, -2.0]))
    matrix = rotation.to_matrix(turn)
    covariances = matrix @ estimate.covariances @ matrix.T * [[[scale**2]], [[1.0]]]
    moved = Trajectory(
        estimate.stamps_ns,
        scale * rotation.rotate(turn, estimate.positions) + [7, 8, 9],
        rotation.multiply(turn, estimate.rotations),
        covariances,
    )
    here, there = (evaluate(e, truth, alignment=alignment).metrics for e in (estimate, moved))
    for name in ('nees_position_mean', 'nees_orientation_mean'):
        assert there[name] == pytest.approx(here[name], rel=1e-8), name


def test_nees_takes_each_block_for_its_own_error(evaluate):
    estimate, truth = consistent(300, 2)
    before = evaluate(estimate, truth, alignment='none').metrics
    doubled = estimate.covariances * [[[4.0]], [[9.0]]]
    after = evaluate(replace(estimate, covariances=doubled), truth, alignment='none').metrics
    for name, factor in (('nees_position_mean', 4), ('nees_orientation_mean', 9)):
        assert after[name] == pytest.approx(before[name] / factor, rel=1e-9)


@pytest.mark.parametrize(
    'unusable', [np.zeros((3, 3)), np.diag([1.0, -1, 1]), np.full((3, 3), np.nan), SINGULAR]
)
def test_nees_leaves_out_covariances_that_are_not_positive_definite(evaluate, unusable):
    estimate, truth = consistent(100, 3)
    covariances = estimate.covariances.copy()
    covariances[::2, 0] = unusable
    summary = evaluate(replace(estimate, covariances=covariances), truth, alignment='none')
    kept = evaluate(estimate[1::2], truth, alignment='none').metrics
    assert summary.metrics['nees_position_mean'] == pytest.approx(
        kept['nees_position_mean'], rel=1e-9
    )
    assert math.isfinite(summary.metrics['nees_orientation_mean'])
    assert any(
        text.startswith('nees_position: left out 50 of 100 covariances')
        for text in summary.warnings
    )


def test_nees_of_an_estimate_without_scale_is_not_a_number(evaluate):
    estimate, truth = consistent(20, 4)
    nowhere = replace(truth, positions=np.zeros((20, 3)))
    assert math.isnan(evaluate(estimate, nowhere, alignment='scale').metrics['nees_position_mean'])
