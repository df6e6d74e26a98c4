"""What several publishers wrote in turn is refused by every verb that would score it."""

import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.interleaving import interleaving
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.diagnosis.recorded import diagnose_sources
from vio_eval_ros.errors import ReadError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.recordings.publishers import of_one_publisher
from vio_eval_ros.recordings.sensors import read_sensors
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.simulation.simulated_run import simulate


def source(name: str, poses: Poses) -> Source:
    return Source(name, 'tum', (), poses)


@pytest.fixture(scope='module')
def run():
    return simulate(40, seed=5)


@pytest.fixture(scope='module')
def mixed(run):
    """Return an estimate into which another publisher writes for the last ten seconds."""
    estimate = run.estimate
    begins = np.searchsorted(estimate.stamps_ns, estimate.stamps_ns[0] + 30_000_000_000)
    other = Poses(
        estimate.stamps_ns + 20_000_000, 0 * estimate.positions, estimate.rotations
    )[np.arange(begins, len(estimate))]  # fmt: skip
    known = Poses(estimate.stamps_ns, estimate.positions, estimate.rotations)
    joined = Poses.concatenate([known, other])
    return joined[np.argsort(joined.stamps_ns, kind='stable')]


@pytest.mark.parametrize('verb', [score_run, diagnose_sources, of_one_publisher])
def test_neither_side_may_be_of_two_publishers(run, mixed, verb):
    sides = {'est.txt': run.estimate, 'gt.txt': run.ground_truth}
    for wrong in sides:
        one, other = (source(k, mixed if k == wrong else v) for k, v in sides.items())
        with pytest.raises(ReadError, match=f'^{wrong}: poses of two trajectories, .* m apart'):
            verb(one, other, EvaluationConfig())


def test_the_time_in_which_there_is_but_one_can_be_scored(run, mixed):
    sources = source('est.txt', mixed), source('gt.txt', run.ground_truth)
    result = score_run(*sources, EvaluationConfig(end_s=29.0))
    assert result.summary.metrics['ate_trans_rmse_m'] < 0.2
    with pytest.raises(ReadError, match='two publishers'):
        score_run(*sources, EvaluationConfig(start_s=29.0))


def test_a_time_offset_counts_before_the_time_is_chosen(run, mixed):
    later = Poses(mixed.stamps_ns + 3_600_000_000_000, mixed.positions, mixed.rotations)
    sources = source('est.txt', later), source('gt.txt', run.ground_truth)
    of_one_publisher(*sources, EvaluationConfig(time_offset_s=-3600.0, end_s=29.0))
    with pytest.raises(ReadError, match='two publishers'):
        of_one_publisher(*sources, EvaluationConfig(time_offset_s=-3600.0, end_s=39.0))


@pytest.mark.parametrize('late_ns', [200_000, 1_000_000])
def test_poses_that_two_publishers_sent_alike_are_counted_once(run, late_ns):
    estimate = Poses(run.estimate.stamps_ns, run.estimate.positions, run.estimate.rotations)
    again = Poses(estimate.stamps_ns + late_ns, estimate.positions, estimate.rotations)
    twice = Poses.concatenate([estimate, again])
    twice = twice[np.argsort(twice.stamps_ns, kind='stable')]
    truth = source('gt.txt', run.ground_truth)
    config = EvaluationConfig()
    once = score_run(source('est.txt', estimate), truth, config)
    result = score_run(source('est.txt', twice), truth, config)
    assert result.summary.metrics == pytest.approx(once.summary.metrics, abs=0, rel=0, nan_ok=True)
    (warning,) = set(result.summary.warnings) - set(once.summary.warnings)
    assert warning.startswith('est.txt: 800 of 1600 poses repeat the one before')
    assert not diagnose_sources(source('est.txt', twice), truth, config).causes


@pytest.mark.slow
def test_no_trajectory_of_a_published_system_is_taken_for_two(shared_data):
    folders = [
        one for one in sorted(shared_data.iterdir()) if one.name[:3] in ('est', 'gt_', 'evo')
    ]
    files = [file for one in folders for file in one.rglob('*') if file.suffix in ('.txt', '.csv')]
    read = 0
    for file in files:
        try:
            (known,) = read_sources([str(file)])
        except ReadError:
            continue  # KITTI's poses have no stamps, tables are no trajectories
        assert interleaving(known.poses) is None, file
        read += 1
    assert read > 30


@pytest.mark.slow
@pytest.mark.parametrize(
    'name',
    [
        'evo/nav2_turtlebot.mcap',
        'evo/tf_example.bag',
        'robot_localization/test2.bag',
        'rosbag_js/example-bz2.bag',
    ],
)
def test_no_recorded_topic_or_transform_is_taken_for_two(shared_data, name):
    streams = read_sensors(shared_data / 'bags' / name).streams
    transforms = [poses for stream in streams for poses in stream.transforms.values()]
    poses = [
        Poses(stream.stamps_ns, stream.numbers[:, :3], stream.numbers[:, 3:])
        for stream in streams
        if stream.kind == 'pose'
    ]
    assert transforms or poses
    assert not any(interleaving(one) for one in [*transforms, *poses])
