"""The numbers are those of evo and of the KITTI devkit, on made-up and on real trajectories."""

import json
import os
from pathlib import Path
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import vio_eval_ros as vio
from vio_eval_ros.core import rotation
from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation, Summary
from vio_eval_ros.core.trajectory import Pairs, Poses, Trajectory
from vio_eval_ros.recordings.sources import read_sources

EVO_STATISTICS = ('rmse', 'mean', 'median', 'std', 'min', 'max')
# evo takes stamps as float seconds and angles from matrices: the last digits are not the same.
RELATIVE = 1e-6
# The definitions print six decimals.
PRINTED = 5.1e-7
V102 = ('evo_test_data/V102.txt', 'gt_euroc/open_vins_tum/V1_02_medium.txt')
FR1 = (
    'evo_test_data/freiburg1_xyz-rgbdslam_drift.txt',
    'evo_test_data/freiburg1_xyz-groundtruth.txt',
)


@pytest.fixture(scope='module')
def evo() -> SimpleNamespace:
    """Return the parts of evo; without it skip, but fail where everything is required."""
    required = os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1'
    # the release that the golden numbers are of cannot be installed below 3.11
    if not required or sys.version_info < (3, 11):
        pytest.importorskip('evo.core.metrics')
    from evo.core import metrics, sync, trajectory

    return SimpleNamespace(metrics=metrics, sync=sync, Trajectory=trajectory.PoseTrajectory3D)


def evaluate(estimate: Poses, truth: Poses, **options) -> Summary:
    evaluation = Evaluation(EvaluationConfig(**{'max_difference_s': 0.01} | options))
    evaluation.add_estimate(estimate)
    evaluation.add_ground_truth(truth)
    evaluation.flush()
    return evaluation.summary()


def read(shared_data: Path, pair, times: str | None = None) -> list[Poses]:
    path = None if times is None else shared_data / times
    return [
        source.poses
        for source in read_sources([f'{shared_data}/{spec}' for spec in pair], times=path)
    ]


def assert_statistics(
    metrics: dict[str, float], name: str, expected: dict[str, float], absolute: float = 1e-12
) -> None:
    """Compare all statistics that evo gives; ``name`` has a place for the statistic."""
    for statistic in EVO_STATISTICS:
        ours = metrics[name.format(statistic)]
        assert ours == pytest.approx(expected[statistic], rel=RELATIVE, abs=absolute), name.format(
            statistic
        )


# evo itself


def as_evo(evo, poses: Poses):
    return evo.Trajectory(
        poses.positions, np.roll(poses.rotations, 1, axis=1), poses.stamps_ns / 1e9
    )


def evo_pairs(evo, estimate: Poses, truth: Poses):
    reference, other = evo.sync.associate_trajectories(
        as_evo(evo, truth), as_evo(evo, estimate), max_diff=0.01
    )
    return reference, other


def align(reference, other, mode: str) -> None:
    if mode == 'origin':
        other.align_origin(reference)
    elif mode != 'none':
        other.align(reference, correct_scale=mode == 'sim3')


def figures(metric, reference, other) -> dict[str, float]:
    metric.process_data((reference, other))
    return metric.get_all_statistics()


@pytest.fixture(params=range(3))
def random_pair(request) -> tuple[Trajectory, Trajectory]:
    """Return an estimate at 20 Hz with gaps, in a world of its own, and truth at 50 Hz."""
    rng = np.random.default_rng(request.param)
    stamps = 1_403_636_579_763_555_584 + np.cumsum(rng.integers(18_000_000, 22_000_000, 1500))
    truth = Trajectory(
        stamps,
        rng.normal(0, 0.02, (1500, 3)).cumsum(axis=0).cumsum(axis=0) / 30,
        rotation.from_rotation_vector(rng.normal(0, 0.05, (1500, 3)).cumsum(axis=0)),
    )
    seen = truth[np.sort(rng.choice(1500, 600, replace=False))]
    world = rotation.normalize(rng.normal(size=4))
    noise = rotation.from_rotation_vector(rng.normal(0, 0.03, (600, 3)))
    noisy = seen.positions + rng.normal(0, 0.05, (600, 3))
    return Trajectory(
        seen.stamps_ns + rng.integers(-8_000_000, 8_000_000, 600),
        0.8 * rotation.rotate(world, noisy) + rng.normal(0, 10, 3),
        rotation.multiply(world, rotation.multiply(seen.rotations, noise)),
    ), truth


@pytest.mark.slow
@pytest.mark.parametrize('mode', ['none', 'origin', 'se3', 'sim3'])
def test_absolute_errors_are_evos(evo, random_pair, mode):
    summary = evaluate(*random_pair, alignment=mode)
    reference, other = evo_pairs(evo, *random_pair)
    align(reference, other, mode)
    assert reference.num_poses == len(summary.pairs) > 500
    relation = evo.metrics.PoseRelation
    for name, kind in (
        ('ate_trans_{}_m', relation.translation_part),
        ('ate_rot_{}_deg', relation.rotation_angle_deg),
    ):
        assert_statistics(summary.metrics, name, figures(evo.metrics.APE(kind), reference, other))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('delta', 'number', 'unit', 'pairs'),
    [
        ('1f', 1, 'frames', 'sequential'),
        ('10f', 10, 'frames', 'sequential'),
        ('1f', 1, 'frames', 'all'),
        ('10f', 10, 'frames', 'all'),
        ('0.5m', 0.5, 'meters', 'all'),
        ('3m', 3, 'meters', 'all'),
    ],
)
def test_relative_errors_are_evos(evo, random_pair, delta, number, unit, pairs):
    metrics = evaluate(*random_pair, rpe_deltas=[delta], rpe_pairs=pairs).metrics
    reference, other = evo_pairs(evo, *random_pair)
    relation = evo.metrics.PoseRelation
    for name, kind in (
        ('trans_{}_m', relation.translation_part),
        ('rot_{}_deg', relation.rotation_angle_deg),
        ('dist_{}_m', relation.point_distance),
    ):
        metric = evo.metrics.RPE(
            kind,
            number,
            evo.metrics.Unit[unit],
            all_pairs=pairs == 'all',
            pairs_from_reference=True,
        )
        assert_statistics(metrics, f'rpe_{delta}_{name}', figures(metric, reference, other))
        assert metrics[f'rpe_{delta}_pairs'] == len(metric.error) > 50


# evo's numbers on real trajectories


def golden(shared_data: Path, index: int) -> tuple[dict, list[Poses]]:
    case = json.loads((shared_data / 'golden.json').read_text())[index]
    return case, read(shared_data, (case['estimate'], case['ground_truth']))


def test_no_golden_case_is_left_out(shared_data):
    assert len(json.loads((shared_data / 'golden.json').read_text())) == 20


@pytest.mark.slow
@pytest.mark.parametrize('index', range(20))
def test_golden_errors_are_ours(shared_data, index):
    case, (estimate, truth) = golden(shared_data, index)
    for mode in ('none', 'se3', 'sim3'):
        summary = evaluate(
            estimate,
            truth,
            alignment=mode,
            rpe_pairs='sequential',
            rpe_deltas=('1f', '10f'),
            max_difference_s=case['max_difference_s'],
        )
        metrics = summary.metrics
        assert len(summary.pairs) == case['matched']
        assert_statistics(metrics, 'ate_trans_{}_m', case[f'ate_{mode}_trans'])
        assert_statistics(metrics, 'ate_rot_{}_deg', case[f'ate_{mode}_rot_deg'])
        assert metrics[f'ate_{mode}_trans_rmse_m'] == pytest.approx(
            case[f'ate_{mode}_trans']['rmse'], rel=RELATIVE
        )
        assert metrics['sim3_scale'] == pytest.approx(case['sim3_scale'], rel=RELATIVE)
        if mode == 'sim3':  # of an estimate at the right scale: evo's are not scaled here
            continue
        for delta in ('1f', '10f'):
            assert_statistics(metrics, f'rpe_{delta}_trans_{{}}_m', case[f'rpe_{delta}_trans'])
            assert_statistics(metrics, f'rpe_{delta}_rot_{{}}_deg', case[f'rpe_{delta}_rot_deg'])
            assert_statistics(metrics, f'rpe_{delta}_dist_{{}}_m', case[f'rpe_{delta}_point'])


@pytest.mark.slow
@pytest.mark.parametrize('index', range(20))
def test_golden_pairs_are_ours(evo, shared_data, index):
    _, (estimate, truth) = golden(shared_data, index)
    pairs: Pairs = evaluate(estimate, truth).pairs
    reference, other = evo_pairs(evo, clean(estimate, Cleaning()), clean(truth, Cleaning()))
    for evos, ours in ((reference, pairs.ground_truth), (other, pairs.estimate)):
        # the very floats that the stamps were handed over as
        np.testing.assert_array_equal(evos.timestamps, ours.stamps_ns / 1e9)
        np.testing.assert_array_equal(evos.positions_xyz, ours.positions)


# What else the definitions state (section 6)


def test_repeated_stamps_of_v102_are_paired_by_evo_and_dropped_here(evo, shared_data):
    estimate, truth = read(shared_data, V102)
    kept = clean(estimate, Cleaning())
    assert len(estimate) - len(kept) == 4
    found = {}
    for name, poses in (('raw', estimate), ('kept', kept)):
        reference, other = evo_pairs(evo, poses, truth)
        other.align(reference)
        metric = evo.metrics.APE(evo.metrics.PoseRelation.translation_part)
        found[name] = reference.num_poses, figures(metric, reference, other)
    assert found['raw'][0] == 798
    assert found['raw'][1]['rmse'] == pytest.approx(0.091727, abs=PRINTED)
    ours = evaluate(estimate, truth)
    assert found['kept'][0] == len(ours.pairs) == 794
    assert_statistics(ours.metrics, 'ate_trans_{}_m', found['kept'][1])
    assert ours.metrics['ate_trans_rmse_m'] == pytest.approx(0.091747, abs=PRINTED)
    assert 'estimate: dropped 4 duplicate' in ours.warnings


def test_v102_is_near_what_evo_finds_with_the_repeated_stamps(shared_data):
    metrics = evaluate(
        *read(shared_data, V102), alignment='origin', rpe_pairs='sequential'
    ).metrics
    for name, expected in {
        'ate_none_trans_rmse_m': 2.554174,
        'ate_se3_trans_rmse_m': 0.091727,
        'ate_sim3_trans_rmse_m': 0.083841,
        'sim3_scale': 0.979698,
        'ate_trans_rmse_m': 0.153679,
        'ate_posyaw_trans_rmse_m': 0.091843,
    }.items():
        # 4 of 798 pairs are not the same
        assert metrics[name] == pytest.approx(expected, rel=2e-3), name


def test_freiburg1_is_what_evo_finds(shared_data):
    estimate, truth = read(shared_data, FR1)
    summary = evaluate(estimate, truth, alignment='origin', rpe_deltas=('1f', '10f', '1m'))
    sequential = evaluate(
        estimate, truth, rpe_deltas=('1f', '10f'), rpe_pairs='sequential'
    ).metrics
    assert len(summary.pairs) == 785
    for metrics, expected in (
        (
            summary.metrics,
            {
                'ate_se3_trans_rmse_m': 0.013470,
                'ate_sim3_trans_rmse_m': 0.013389,
                'sim3_scale': 1.008001,
                'ate_trans_rmse_m': 0.019368,
                'rpe_10f_trans_rmse_m': 0.014041,
                'rpe_10f_pairs': 775,
                'rpe_1m_trans_rmse_m': 0.017737,
                'rpe_1m_pairs': 649,
            },
        ),
        (
            sequential,
            {
                'ate_rot_rmse_deg': 2.057702,
                'rpe_1f_trans_rmse_m': 0.005764,
                'rpe_1f_rot_rmse_deg': 0.353614,
                'rpe_10f_trans_rmse_m': 0.014610,
                'rpe_10f_pairs': 78,
            },
        ),
    ):
        for name, value in expected.items():
            assert metrics[name] == pytest.approx(value, abs=PRINTED), name


def test_freiburg1_with_a_wider_tolerance_is_what_evo_finds(shared_data):
    summary = evaluate(*read(shared_data, FR1), max_difference_s=0.02)
    assert len(summary.pairs) == 786
    assert summary.metrics['ate_trans_rmse_m'] == pytest.approx(0.013473, abs=PRINTED)


@pytest.mark.parametrize(
    ('max_gap_s', 'max_diff', 'pairs', 'rmse'),
    [
        (0.1, 0.01, 785, 0.013467),  # the truth has a single gap, of 0.11 s
        (0.5, 0.05, 788, 0.013504),
    ],
)
def test_freiburg1_interpolated_is_what_evo_finds(
    evo, shared_data, max_gap_s, max_diff, pairs, rmse
):
    estimate, truth = read(shared_data, FR1)
    summary = evaluate(estimate, truth, association='interpolate', max_gap_s=max_gap_s)
    reference, other = evo.sync.associate_trajectories(
        as_evo(evo, truth),
        as_evo(evo, estimate),
        max_diff=max_diff,
        sync_method=evo.sync.SyncMethod.interpolation,
    )
    other.align(reference)
    metric = evo.metrics.APE(evo.metrics.PoseRelation.translation_part)
    # a float of today's seconds is off by up to 238 ns, in which the camera moves 0.1 µm
    assert_statistics(
        summary.metrics, 'ate_trans_{}_m', figures(metric, reference, other), absolute=1e-7
    )
    assert reference.num_poses == len(summary.pairs) == pairs
    assert summary.metrics['ate_trans_rmse_m'] == pytest.approx(rmse, abs=PRINTED)


@pytest.fixture(scope='module')
def kitti_00(shared_data) -> list[Poses]:
    pair = ('evo_test_data/KITTI_00_ORB.txt', 'evo_test_data/KITTI_00_gt.txt')
    return read(shared_data, pair, 'evo_test_data/KITTI_00_gt_times.txt')


def test_kitti_00_is_what_evo_and_the_devkit_find(kitti_00):
    summary = evaluate(*kitti_00)
    assert len(summary.pairs) == 4541
    for name, value in {
        'ate_none_trans_rmse_m': 7.790289,
        'ate_se3_trans_rmse_m': 1.303450,
        'ate_sim3_trans_rmse_m': 0.937709,
        'kitti_rot_deg_per_m': 0.002533,
        'kitti_segments': 3283,
    }.items():
        assert summary.metrics[name] == pytest.approx(value, abs=PRINTED), name
    assert summary.metrics['kitti_trans_percent'] == pytest.approx(0.6997, abs=5e-5)


def test_metres_are_those_of_the_ground_truth_where_evo_takes_the_estimates(evo, kitti_00):
    metrics = evaluate(*kitti_00, rpe_deltas=['100m']).metrics
    reference, other = evo_pairs(evo, *kitti_00)
    found = {}
    for of_reference in (True, False):
        metric = evo.metrics.RPE(
            evo.metrics.PoseRelation.translation_part,
            100,
            evo.metrics.Unit.meters,
            all_pairs=True,
            pairs_from_reference=of_reference,
        )
        found[of_reference] = figures(metric, reference, other)
    assert_statistics(metrics, 'rpe_100m_trans_{}_m', found[True])
    assert metrics['rpe_100m_pairs'] == 4458
    # what the definitions print is evo's default, along the estimate
    assert found[False]['mean'] == pytest.approx(1.014695, abs=PRINTED)
    assert found[False]['rmse'] == pytest.approx(1.254830, abs=PRINTED)
    assert metrics['rpe_100m_trans_rmse_m'] == pytest.approx(1.250926, abs=PRINTED)


def test_a_dataframe_of_evo_is_taken_as_it_is(evo, shared_data):
    bridge = pytest.importorskip('evo.tools.pandas_bridge')
    frames = []
    for name in FR1:
        source = vio.read(shared_data / name)
        rotations = np.roll(source.rotations, 1, axis=1)
        path = evo.Trajectory(source.positions, rotations, source.stamps_ns / 1e9)
        frames.append(bridge.trajectory_to_df(path))
    result = vio.evaluate(*frames, max_difference_s=0.01, alignment='sim3')
    assert result.metrics['ate_trans_rmse_m'] == pytest.approx(0.013389, abs=5e-7)
    assert len(result.errors()) == 785
