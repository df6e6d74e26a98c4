"""A source spec names poses: its kind, its conventions, and what is stated of it."""

from pathlib import Path

import numpy as np
import pytest

from vio_eval_ros.core.rotation import angle_between
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings import sources
from vio_eval_ros.recordings.sources import default_topics, read_sources, Source
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.simulation import simulate, write_recording

TUM = '1403715524.5 1 2 3 0.5 0.5 -0.5 0.5\n1403715525.5 4 5 6 0 0 0 1\n'
EUROC_HEADER = (
    '#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], '
    'q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n'
)
EUROC_ROW = '1403715524500000000,1,2,3,0.5,0.5,0.5,-0.5,9,9,9\n'


def read(spec: str, **options: Path) -> Source:
    return read_sources([spec], **options)[0]


@pytest.fixture
def tum(tmp_path) -> Path:
    path = tmp_path / 'est.txt'
    path.write_text(TUM)
    return path


@pytest.fixture
def sequence(tmp_path) -> Path:
    folder = tmp_path / 'V1_01' / 'mav0' / 'state_groundtruth_estimate0'
    folder.mkdir(parents=True)
    (folder / 'data.csv').write_text(EUROC_HEADER + EUROC_ROW)
    return tmp_path / 'V1_01'


@pytest.mark.parametrize(
    ('text', 'path', 'topic'),
    [
        ('/vio/odometry', None, '/vio/odometry'),
        ('/tf:map.base_link', None, '/tf:map.base_link'),
        ('est.txt', 'est.txt', None),
        ('run.bag:/vio/odometry', 'run.bag', '/vio/odometry'),
        ('/data/run.mcap:/tf:map.base', '/data/run.mcap', '/tf:map.base'),
        ('run:1.db3:/odom', 'run:1.db3', '/odom'),
    ],
)
def test_specs_are_taken_apart(text, path, topic):
    assert Spec.parse(text) == Spec(path and Path(path), topic, {})


def test_an_absolute_path_is_no_topic(tum):
    assert Spec.parse(str(tum)) == Spec(tum, None, {})


def test_what_cannot_be_stated_is_refused_with_what_can():
    with pytest.raises(ConfigError, match='columns, quaternion, stamps, body, unit, invert'):
        Spec.parse('est.txt?quaternio=wxyz')
    with pytest.raises(ConfigError, match=r"quaternion must be xyzw or wxyz, not 'wxzy'"):
        Spec.parse('est.txt?quaternion=wxzy')


def test_what_says_nothing_of_a_source_cannot_be_stated_of_it(tum):
    with pytest.raises(ConfigError, match='quaternion does not apply to a topic'):
        Spec.parse('/vio/odometry?quaternion=wxyz')
    with pytest.raises(ConfigError, match='revision does not apply to a file'):
        Spec.parse(f'{tum}?revision=causal')


def test_positions_in_another_unit_are_made_metres(tum):
    metres, stated = read(str(tum)), read(f'{tum}?unit=mm')
    assert stated.poses.positions.tolist() == (metres.poses.positions * 0.001).tolist()
    assert stated.poses.rotations.tolist() == metres.poses.rotations.tolist()
    with pytest.raises(ConfigError, match="unit must be m or cm or mm or km, not 'foot'"):
        Spec.parse(f'{tum}?unit=foot')


def test_tum_is_seconds_and_w_last(tum):
    source = read(str(tum))
    assert (source.kind, source.paths, source.warnings) == ('tum', (tum,), ())
    assert source.poses.stamps_ns.tolist() == [1403715524500000000, 1403715525500000000]
    assert source.poses.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert source.poses.rotations[0].tolist() == [0.5, 0.5, -0.5, 0.5]


def test_a_euroc_folder_is_its_ground_truth(sequence):
    for folder in (sequence, sequence / 'mav0', sequence / 'mav0/state_groundtruth_estimate0'):
        source = read(str(folder))
        assert source.kind == 'euroc'
        assert source.poses.stamps_ns.tolist() == [1403715524500000000]
        assert source.poses.rotations[0].tolist() == [0.5, 0.5, -0.5, 0.5]


def test_the_raw_leica_truth_is_positions_only_and_says_so(tmp_path):
    folder = tmp_path / 'mav0' / 'leica0'
    folder.mkdir(parents=True)
    (folder / 'data.csv').write_text('#timestamp [ns],p_x,p_y,p_z\n1403715524500000000,1,2,3\n')
    source = read(str(tmp_path))
    assert source.poses.rotations is None
    assert 'not of the IMU' in source.warnings[0]


def test_nanoseconds_in_a_tum_file_are_taken_as_such_and_said_so(tmp_path):
    path = tmp_path / 'CameraTrajectory.txt'
    path.write_text('1403715524500000000.000000 1 2 3 0 0 0 1\n')
    source = read(str(path))
    assert source.poses.stamps_ns.tolist() == [1403715524500000000]
    assert 'read as ns, not s' in source.warnings[0]
    # ORB-SLAM writes such files; the data may show another order
    assert [one.statement for one in source.readings] == ['quaternion=xyzw', 'quaternion=wxyz']
    assert source.readings[0].usual
    assert read(f'{path}?stamps=ns&quaternion=xyzw').warnings == ()


def test_seconds_in_a_euroc_csv_are_taken_as_such_and_said_so(tmp_path):
    path = tmp_path / 'data.csv'
    path.write_text(EUROC_HEADER + '1403715524.5,1,2,3,1,0,0,0\n')
    source = read(str(path))
    assert source.poses.stamps_ns.tolist() == [1403715524500000000]
    assert 'read as s, not ns' in source.warnings[0]


def test_the_order_of_a_quaternion_is_stated_by_user_header_or_kind_never_guessed(tmp_path):
    path = tmp_path / 'est.csv'
    path.write_text('1,0,0,0,1,0,0,0\n')
    unsaid = read(str(path))
    assert unsaid.poses.rotations[0].tolist() == [1, 0, 0, 0]
    assert [one.poses.rotations[0].tolist() for one in unsaid.readings] == [
        [1, 0, 0, 0],
        [0, 0, 0, 1],
    ]
    stated = read(f'{path}?quaternion=wxyz')
    assert stated.poses.rotations[0].tolist() == [0, 0, 0, 1]
    assert stated.warnings == ()
    path.write_text('#timestamp,x,y,z,qw,qx,qy,qz\n1,0,0,0,1,0,0,0\n')
    assert read(str(path)).poses.rotations[0].tolist() == [0, 0, 0, 1]
    path.write_text('# t tx ty tz qx qy qz qw\n1 0 0 0 1 0 0 0\n')
    assert read(str(path)).poses.rotations[0].tolist() == [1, 0, 0, 0]


def test_stamps_of_kitti_poses_that_are_no_numbers_spoil_their_rows(tmp_path):
    (tmp_path / 'poses.txt').write_text('1 0 0 5 0 1 0 6 0 0 1 7\n' * 2)
    (tmp_path / 'times.txt').write_text('nan\n1\n')
    source = read(str(tmp_path / 'poses.txt'), times=tmp_path / 'times.txt')
    assert np.isnan(source.poses.positions[0]).all()
    assert source.poses.positions[1].tolist() == [5, 6, 7]


def test_a_question_mark_may_be_part_of_a_name(tmp_path):
    (tmp_path / 'a?b.txt').write_text(TUM)
    assert len(read(f'{tmp_path}/a?b.txt').poses) == 2


def test_the_same_cannot_be_stated_twice():
    with pytest.raises(ConfigError, match='stated twice'):
        Spec.parse('/odom?invert=pose&invert=rotation')


def test_an_inverted_pose_is_turned_round(tum):
    given, inverse = read(str(tum)).poses, read(f'{tum}?invert=pose').poses
    assert np.allclose(inverse.positions[1], [-4, -5, -6])
    # this rotation takes x to -z, y to x and z to -y: Rᵀ (1, 2, 3) = (-3, 1, -2)
    assert np.allclose(inverse.positions[0], [3, -1, 2])
    turned = read(f'{tum}?invert=rotation').poses
    assert np.array_equal(turned.positions, given.positions)
    assert np.array_equal(turned.rotations, inverse.rotations)
    assert np.allclose(turned.rotations[0], [-0.5, -0.5, 0.5, 0.5])


def test_kitti_poses_need_their_times(tmp_path, shared_data):
    folder = shared_data / 'evo_test_data'
    poses, times = str(folder / 'KITTI_00_gt.txt'), folder / 'KITTI_00_gt_times.txt'
    source = read(poses, times=times)
    assert (source.kind, len(source.poses)) == ('kitti', 4541)
    assert np.allclose(source.poses.positions[1], [-4.690294e-02, -2.839928e-02, 8.586941e-01])
    assert angle_between(source.poses.rotations[1], source.poses.rotations[0]) < 0.01
    with pytest.raises(ReadError, match='--times'):
        read(poses)
    short = tmp_path / 'times.txt'
    short.write_text('0\n1\n')
    with pytest.raises(ReadError, match='2 stamps for 4541 poses'):
        read(poses, times=short)


@pytest.mark.parametrize('columns', [1, 2, 3, 5, 6])
def test_too_few_columns_are_counted(tmp_path, columns):
    path = tmp_path / 'est.txt'
    path.write_text(' '.join('1' * columns) + '\n')
    with pytest.raises(ReadError, match=f'{columns} columns; a trajectory has 8'):
        read(str(path))


def test_a_folder_without_a_trajectory_says_what_is_looked_for(tmp_path):
    with pytest.raises(ReadError, match=r'neither a rosbag2 folder .* nor a EuRoC sequence'):
        read(str(tmp_path))


def test_a_topic_needs_a_recording_and_a_recording_a_topic(shared_data):
    with pytest.raises(ReadError, match='for a topic, give the RECORDING first'):
        read('/vio/odometry')
    with pytest.raises(ReadError, match='name a topic in it'):
        read(str(shared_data / 'derived_bags/euroc_V1_02_vins_fusion.bag'))


def test_a_recording_without_poses_offers_no_choice(shared_data):
    with pytest.raises(ReadError, match=r'no-messages.bag: no topic has poses$'):
        default_topics(shared_data / 'bags/rosbag_js/no-messages.bag')


def test_the_only_sensible_pair_of_a_recording_is_found(tmp_path):
    path = tmp_path / 'run.bag'
    write_recording(simulate(duration_s=1.0), path)
    assert default_topics(path) == ('/vio/odometry', '/ground_truth/pose')
    assert default_topics(path, estimate='/tf:a.b') == ('/tf:a.b', '/ground_truth/pose')
    assert default_topics(path, ground_truth='gt.txt') == ('/vio/odometry', 'gt.txt')
    with pytest.raises(
        ReadError,
        match=r'choose topics with --estimate .* /vio/odometry \(nav_msgs/msg/Odometry, 20\)',
    ):
        default_topics(path, ground_truth='/vio/odometry')


def test_sources_of_one_recording_come_in_the_order_asked_for(tmp_path, tum):
    path = tmp_path / 'run.bag'
    write_recording(simulate(duration_s=1.0), path)
    specs = ['/ground_truth/pose', str(tum), f'{path}:/vio/odometry']
    truth, file, estimate = read_sources(specs, path)
    assert [len(s.poses) for s in (truth, file, estimate)] == [200, 2, 20]
    assert [s.spec for s in (truth, file, estimate)] == specs
    assert (truth.poses.zero_is_unset, file.poses.zero_is_unset) == (True, False)


def test_a_recording_read_as_an_estimate_can_be_inverted(tmp_path):
    path = tmp_path / 'run.bag'
    write_recording(simulate(duration_s=1.0), path)
    given, inverse = read_sources(['/vio/odometry', '/vio/odometry?invert=pose'], path)
    assert np.allclose(inverse.poses.rotations[:, 3], given.poses.rotations[:, 3])
    assert np.allclose(inverse.poses.rotations[:, :3], -given.poses.rotations[:, :3])
    assert np.allclose(
        np.linalg.norm(inverse.poses.positions, axis=1),
        np.linalg.norm(given.poses.positions, axis=1),
    )


@pytest.mark.parametrize('kind', ['tum', 'euroc', 'kitti', 'motion capture'])
def test_every_kind_of_file_gives_as_many_poses_as_rows(kind, tmp_path, sequence, tum):
    matrices = tmp_path / 'poses.txt'
    matrices.write_text('1 0 0 5 0 1 0 6 0 0 1 7\n' * 2)
    times = tmp_path / 'times.txt'
    times.write_text('0\n1\n')
    export = tmp_path / 'trial.csv'
    columns = 'Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,rad,rad,rad,mm,mm,mm'
    export.write_text(f'Objects\n10\nGlobal Angle (Helical),a\n{columns}\n1,0,0,0,0,1,2,3\n')
    specs = {'tum': tum, 'euroc': sequence, 'kitti': matrices, 'motion capture': export}
    source = read(str(specs[kind]), times=times)
    assert source.kind == kind
    assert len(source.poses) == {'tum': 2, 'euroc': 1, 'kitti': 2, 'motion capture': 1}[kind]
    assert source.poses.stamps_ns.dtype == np.int64
    assert source.poses.rotations.shape == (len(source.poses), 4)


def test_two_large_files_are_read_at_the_same_time_with_the_same_result(tmp_path, monkeypatch):
    paths = [str(tmp_path / name) for name in ('a.txt', 'b.txt')]
    for shift, path in enumerate(paths):
        Path(path).write_text(''.join(f'{k} {k + shift} 2 3 0 0 0 1\n' for k in range(500)))
    alone = read_sources(paths)
    monkeypatch.setattr(sources, 'PARALLEL_BYTES', 0)
    together = read_sources(paths)
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.poses.positions, other.poses.positions)
        assert np.array_equal(one.poses.stamps_ns, other.poses.stamps_ns)
    Path(paths[1]).write_text('1 2 3\n')
    with pytest.raises(ReadError, match=r'b.txt: has 3 columns'):
        read_sources(paths)
