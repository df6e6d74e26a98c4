"""`convert` and `info` as their users run them."""

from dataclasses import replace
from functools import partial
import json

from evo.core.filters import filter_by_motion
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface as evo
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
import numpy as np
import pytest

import verbs
from vio_eval_ros.conversion import changes
from vio_eval_ros.conversion.formats import FORMATS, Names
from vio_eval_ros.core import rotation
from vio_eval_ros.core.cleaning import Cleaning
from vio_eval_ros.core.steps import distances
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate

convert, info, complaint = (
    partial(how, verb)
    for how, verb in ((verbs.call, 'convert'), (verbs.call, 'info'), (verbs.complaint, 'convert'))
)
RUN = simulate(duration_s=20.0)
SUFFIXES = {'tum': '.tum', 'euroc': '.csv', 'mcap': '.mcap', 'ros1': '.bag', 'rosbag2': ''}


@pytest.fixture(scope='module')
def est(tmp_path_factory):
    """Return a TUM file with all digits of a flight, without covariances."""
    path = tmp_path_factory.mktemp('convert') / 'est.tum'
    FORMATS['tum'].write(RUN.estimate, path, Names())
    return path


def read(path, topic=True):
    spec = f'{path}:/pose' if topic and path.suffix in ('', '.mcap', '.bag') else str(path)
    return read_sources([spec])[0].poses


@pytest.mark.parametrize('one', SUFFIXES)
@pytest.mark.parametrize('other', SUFFIXES)
def test_round_trips_keep_every_digit(est, tmp_path, one, other):
    first, second = tmp_path / f'a{SUFFIXES[one]}', tmp_path / f'b{SUFFIXES[other]}'
    assert convert(est, first).returncode == 0
    spec = f'{first}:/pose' if first.suffix in ('', '.mcap', '.bag') else first
    assert convert(spec, second).returncode == 0
    poses = read(second)
    assert np.array_equal(poses.stamps_ns, RUN.estimate.stamps_ns)
    assert np.array_equal(poses.positions, RUN.estimate.positions)
    assert np.array_equal(poses.rotations, RUN.estimate.rotations)
    assert not [p for p in tmp_path.iterdir() if p not in (first, second)]


floats = st.floats(-1e6, 1e6, allow_nan=False)


@given(
    st.lists(st.integers(0, 2**31 * 10**9 - 1), min_size=1, max_size=5, unique=True).map(sorted),
    st.data(),
)
@settings(max_examples=40, deadline=None)
def test_any_numbers_survive_text(tmp_path_factory, stamps, data):
    count = len(stamps)
    positions = np.array(data.draw(st.lists(floats, min_size=3 * count, max_size=3 * count)))
    poses = Trajectory(
        np.array(stamps, np.int64),
        positions.reshape(-1, 3),
        rotation.normalize(np.random.default_rng(count).normal(size=(count, 4))),
    )
    folder = tmp_path_factory.mktemp('any')
    FORMATS['euroc'].write(poses, folder / 'a.csv', Names())
    back = read_sources([f'{folder / "a.csv"}?stamps=ns&quaternion=wxyz'])[0].poses
    assert np.array_equal(back.stamps_ns, poses.stamps_ns)
    assert np.array_equal(back.positions, poses.positions)
    assert np.array_equal(back.rotations, poses.rotations)


def test_evo_reads_what_is_written(est, tmp_path):
    for name in ('a.tum', 'a.csv', 'a.kitti'):
        assert convert(est, tmp_path / name).returncode == 0
    read_tum = evo.read_tum_trajectory_file(tmp_path / 'a.tum')
    read_euroc = evo.read_euroc_csv_trajectory(tmp_path / 'a.csv')
    for found in (read_tum, read_euroc):
        assert np.array_equal(found.positions_xyz, RUN.estimate.positions)
        assert np.array_equal(found.orientations_quat_wxyz, np.roll(RUN.estimate.rotations, 1, 1))
    matrices = np.array(evo.read_kitti_poses_file(tmp_path / 'a.kitti').poses_se3)
    assert np.array_equal(matrices[:, :3, 3], RUN.estimate.positions)
    assert matrices[:, :3, :3] == pytest.approx(rotation.to_matrix(RUN.estimate.rotations))
    times = np.loadtxt(tmp_path / 'a_times.txt')
    assert times == pytest.approx(RUN.estimate.stamps_ns / 1e9, abs=1e-6)
    again = convert(tmp_path / 'a.kitti', tmp_path / 'b.tum', '--times', tmp_path / 'a_times.txt')
    assert again.returncode == 0
    poses = read(tmp_path / 'b.tum')
    assert np.array_equal(poses.stamps_ns, RUN.estimate.stamps_ns)
    # the sign of a quaternion is not in its matrix
    agree = np.abs(np.sum(poses.rotations * RUN.estimate.rotations, axis=1))
    assert agree == pytest.approx(1, abs=1e-15)


def test_covariances_go_where_they_can_and_are_mentioned_elsewhere(tmp_path):
    FORMATS['mcap'].write(RUN.estimate, tmp_path / 'run.mcap', Names())
    done = convert(f'{tmp_path}/run.mcap:/pose', tmp_path / 'a.bag')
    assert read(tmp_path / 'a.bag').covariances == pytest.approx(RUN.estimate.covariances)
    assert 'left out' not in done.stdout
    done = convert(f'{tmp_path}/run.mcap:/pose', tmp_path / 'a.tum')
    assert 'covariances are left out' in done.stdout


def test_positions_only_go_into_csv_and_recordings(tmp_path):
    (tmp_path / 'gnss.txt').write_text(''.join(f'{1.6e9 + k} {k} {2 * k} 0\n' for k in range(30)))
    assert 'TUM files have orientations' in complaint(tmp_path / 'gnss.txt', tmp_path / 'a.tum')
    assert not (tmp_path / 'a.tum').exists()
    for name in ('a.csv', 'a.mcap'):
        assert 'positions only' in convert(tmp_path / 'gnss.txt', tmp_path / name).stdout
        assert read(tmp_path / name).rotations is None


def test_what_is_there_is_not_replaced_unless_forced(est, tmp_path):
    out = tmp_path / 'a.tum'
    out.write_text('mine')
    assert 'exists already; --force replaces it' in complaint(est, out)
    assert out.read_text() == 'mine'
    assert convert(est, out, '--force').returncode == 0
    assert read(out).stamps_ns.tolist() == RUN.estimate.stamps_ns.tolist()
    assert 'is an input' in complaint(out, out, '--force')
    convert(est, tmp_path / 'k.kitti')
    times = tmp_path / 'k_times.txt'
    assert 'k_times.txt is an input' in complaint(
        tmp_path / 'k.kitti', times, '--times', times, '--format', 'tum', '--force'
    )


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['a.foo'], "no format has the suffix '.foo'"),
        (['nowhere/a.tum'], 'there is no folder'),
        (['a.mcap', '--topic', '/b ad'], 'is no name of a topic'),
        (['a.tum', '--every', '1.5'], 'expected a whole number'),
        (['a.tum', '--rate-hz', '0'], 'expected a number >='),
        (['a.tum', '--start-s', '100'], 'none of 400 poses is left; they last 19.950 s'),
        (['a.tum', '--start-s', '10', '--end-s', '5'], '--start-s: 10 is not before --end-s: 5'),
        (['a.tum', '--time-offset-s', '1e11'], 'more than clocks can differ'),
        (['a.tum', '--max-gap-s', '1'], '--max-gap-s needs --resample-to'),
        (['a.tum', '--child', 'c'], 'tum files have no such name'),
        (['a.tum', '--alignment', 'se3'], '--alignment needs --align-to'),
        (['a.tum', '--to-body', *'0000000'], 'unit quaternion'),
    ],
)
def test_wrong_input_is_one_line(est, tmp_path, arguments, said):
    assert said in complaint(est, tmp_path / arguments[0], *arguments[1:])


def test_alignment_is_that_of_replay(est, tmp_path):
    (tmp_path / 'gt.txt').write_text(tum(RUN.ground_truth))
    truth = ['--ground-truth', tmp_path / 'gt.txt']
    options = ['--align-to', tmp_path / 'gt.txt', '--alignment', 'sim3']
    assert convert(est, tmp_path / 'a.tum', *options).returncode == 0
    aligned = verbs.document('replay', '--estimate', tmp_path / 'a.tum', *truth)['metrics']
    asked = verbs.document('replay', '--estimate', est, *truth, '--alignment', 'sim3')['metrics']
    assert aligned['ate_none_trans_rmse_m'] == pytest.approx(asked['ate_trans_rmse_m'], rel=1e-12)


def test_parts_are_merged_and_what_is_there_twice_is_counted(est, tmp_path):
    convert(est, tmp_path / 'a.tum', '--end-s', '12')
    convert(est, tmp_path / 'b.tum', '--start-s', '10')
    done = convert(tmp_path / 'b.tum', tmp_path / 'a.tum', tmp_path / 'whole.tum')
    assert 'merged 2 trajectories; 41 poses had a stamp twice' in done.stdout
    assert np.array_equal(read(tmp_path / 'whole.tum').positions, RUN.estimate.positions)


# Changes


def test_poses_that_are_none_are_left_out_and_the_rest_keeps_its_digits():
    estimate = RUN.estimate
    positions = estimate.positions.copy()
    positions[5] = np.nan
    stamps = estimate.stamps_ns.copy()
    stamps[8] = stamps[7]
    counts = Cleaning()
    found = changes.in_order(Poses(stamps, positions, 1.001 * estimate.rotations), counts)
    assert len(found) == len(estimate) - 2
    assert (counts.non_finite, counts.duplicate) == (1, 1)
    kept = np.delete(np.arange(len(estimate)), [5, 8])
    assert np.array_equal(found.rotations, 1.001 * estimate.rotations[kept])


def test_fewer_poses():
    poses = RUN.estimate
    assert np.array_equal(changes.every(poses, 3).stamps_ns, poses.stamps_ns[::3])
    slow = changes.at_rate(poses, 2.0)
    assert np.diff(slow.stamps_ns).min() > 0.4e9
    assert len(slow) == pytest.approx(40, abs=1)
    moved = changes.after_motion(poses, 0.5, np.inf)
    along = distances(poses.positions)
    places = along[np.isin(poses.stamps_ns, moved.stamps_ns)]
    assert (np.diff(places) >= 0.5).all()
    assert np.diff(places).max() < 0.5 + np.diff(along).max()


@pytest.mark.parametrize(('distance_m', 'angle_deg'), [(0.5, np.inf), (0.3, 8.0), (1e6, 25.0)])
def test_the_motion_filter_keeps_what_that_of_evo_keeps(distance_m, angle_deg):
    poses = RUN.ground_truth[::5]
    found = changes.after_motion(poses, distance_m, angle_deg)
    theirs = PoseTrajectory3D(
        poses.positions, np.roll(poses.rotations, 1, axis=1), poses.stamps_ns / 1e9
    )
    kept = filter_by_motion(
        theirs.poses_se3, distance_m, angle_deg if np.isfinite(angle_deg) else 1e9, degrees=True
    )
    assert found.stamps_ns.tolist() == poses.stamps_ns[kept].tolist()
    assert 3 < len(found) < len(poses)


def test_resampled_poses_are_at_the_other_stamps_and_bridge_no_gap():
    truth = RUN.ground_truth
    wanted = RUN.estimate.stamps_ns
    found = changes.resampled(truth, wanted, 0.5)
    assert np.isin(found.stamps_ns, wanted).all()
    lost = truth[(np.arange(len(truth)) < 800) | (np.arange(len(truth)) > 1400)]
    apart = changes.resampled(lost, wanted, 0.5)
    inside = (apart.stamps_ns > truth.stamps_ns[800]) & (apart.stamps_ns < truth.stamps_ns[1400])
    assert not inside.any()
    assert len(apart) < len(found)


def test_north_east_down_becomes_east_north_up():
    level = np.array([[0.0, 0, 0, 1], [0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)]])
    ned = Trajectory(np.array([0, 1]), np.array([[1.0, 2, 3], [4, 5, 6]]), level)
    found = changes.turned(ned, 'ned')
    assert found.positions.tolist() == [[2, 1, -3], [5, 4, -6]]
    # facing north is 90 deg from east; a turn to the right by 90 deg faces east
    forward = rotation.rotate(found.rotations, np.array([1.0, 0, 0]))
    assert forward == pytest.approx(np.array([[0, 1, 0], [1, 0, 0]]), abs=1e-12)
    up = rotation.rotate(found.rotations, np.array([0, 0, 1.0]))
    assert up == pytest.approx(np.array([[0, 0, 1], [0, 0, 1]]), abs=1e-12)


def test_a_camera_that_looks_ahead_becomes_a_body_that_drives_ahead():
    camera = Trajectory(np.array([0]), np.array([[1.0, 2, 3]]), np.array([[0.0, 0, 0, 1]]))
    found = changes.turned(camera, 'camera')
    assert found.positions.tolist() == [[3, -1, -2]]
    assert found.rotations == pytest.approx(np.array([[0, 0, 0, 1.0]]), abs=1e-12)


def test_on_a_plane_there_is_neither_height_nor_tilt():
    found = changes.on_plane(RUN.ground_truth, 'xy')
    assert not found.positions[:, 2].any()
    assert np.array_equal(found.positions[:, :2], RUN.ground_truth.positions[:, :2])
    up = rotation.rotate(found.rotations, np.array([0, 0, 1.0]))
    assert up == pytest.approx(np.tile([0, 0, 1.0], (len(up), 1)), abs=1e-12)


# info


def test_facts_of_a_trajectory(est):
    done = info(est, est, '--json')
    found = json.loads(done.stdout)
    schema = json.loads((verbs.ROOT / 'docs/schema/info-1.json').read_text())
    Draft202012Validator(schema).validate(found)
    one = found['trajectories'][0]
    steps = np.linalg.norm(np.diff(RUN.estimate.positions, axis=0), axis=1)
    assert one['poses'] == len(RUN.estimate)
    assert one['path_length_m'] == pytest.approx(steps.sum())
    assert one['rate_hz'] == pytest.approx(20)
    assert one['gaps'] == 0
    assert one['longest_gap_s'] is None
    assert (one['first_stamp_ns'], one['position_only']) == (int(RUN.estimate.stamps_ns[0]), False)


def test_facts_as_a_table(est, tmp_path):
    cut = replace(RUN.estimate, covariances=None)
    cut = cut[(np.arange(len(cut)) < 100) | (np.arange(len(cut)) > 200)]
    FORMATS['tum'].write(cut, tmp_path / 'cut.tum', Names())
    text = info(est, tmp_path / 'cut.tum').stdout
    assert '1, up to 5.1 s' in text or '1, up to 5.05 s' in text
    assert '2014-06-25' in text
    late = replace(cut, stamps_ns=cut.stamps_ns + 3_600_000_000_000)
    FORMATS['tum'].write(late, tmp_path / 'late.tum', Names())
    assert 'share no time' in info(est, tmp_path / 'late.tum').stdout


def test_a_recording_alone_has_a_column_for_each_pose_topic():
    text = info('demo/simulated_flight', cwd=verbs.ROOT).stdout
    assert ':/vio/odometry' in text
    assert ':/ground_truth/pose' in text
    assert 'rosbag2, poses, covariances' in text


def test_frames_are_those_that_messages_name(est, tmp_path):
    def frames(*specs):
        found = json.loads(info(*specs, '--json').stdout)['trajectories']
        return [(one['frame_ids'], one['child_frame_ids']) for one in found]

    demo = verbs.ROOT / 'demo/simulated_flight'
    assert frames(demo) == [(['world'], []), (['odom'], ['body'])]
    assert frames(est) == [([], [])]
    for suffix in ('.mcap', '.bag'):
        convert(est, tmp_path / f'named{suffix}', '--frame', 'map')
        assert frames(tmp_path / f'named{suffix}') == [(['map'], [])]


def test_frames_of_transforms_are_those_that_were_asked_for(shared_data):
    path = shared_data / 'derived_bags/euroc_V1_02_vins_fusion.bag'
    (one,) = json.loads(info(f'{path}:/tf:odom.imu', '--json').stdout)['trajectories']
    assert (one['frame_ids'], one['child_frame_ids']) == (['odom'], ['imu'])


def test_first_and_last_position_are_those_of_the_poses(est):
    (one,) = json.loads(info(est, '--json').stdout)['trajectories']
    (poses,) = read_sources([str(est)])
    assert one['first_position_m'] == poses.positions[0].tolist()
    assert one['last_position_m'] == poses.positions[-1].tolist()


def test_one_file_that_cannot_be_read_does_not_hide_the_others(est, tmp_path):
    (tmp_path / 'empty.txt').write_text('')
    done = info(tmp_path / 'empty.txt', est)
    assert done.returncode == 2
    assert 'empty.txt' in done.stderr
    assert '19.95' in done.stdout


def test_stamps_before_zero_are_shown_as_they_are(tmp_path):
    stamps_ns = RUN.estimate.stamps_ns - RUN.estimate.stamps_ns[-1] - 10**8
    early = replace(RUN.estimate, stamps_ns=stamps_ns)
    FORMATS['tum'].write(early, tmp_path / 'a.tum', Names())
    assert ' -0.100000000' in info(tmp_path / 'a.tum').stdout
