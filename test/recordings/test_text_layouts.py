"""What the columns of a text file are is stated, named or recognised; otherwise it is refused."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.rotation import angle_between
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.headerless import BODIES
from vio_eval_ros.recordings.rotation_columns import from_euler
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.simulation import simulate, SimulatedRun

COUNT = 60
RANDOM = np.random.default_rng(3)
STAMPS_NS = 1_700_000_000_400_000_000 + np.arange(COUNT) * 100_000_000 + RANDOM.integers(0, 9999)
POSITIONS = RANDOM.normal(size=(COUNT, 3)).cumsum(axis=0).round(6)
ANGLES = (RANDOM.normal(size=(COUNT, 3)) * 0.1).cumsum(axis=0).round(9)
ROTATIONS = from_euler(ANGLES)
MATRICES = rotation.to_matrix(ROTATIONS)


def written(column: np.ndarray) -> list[str]:
    return [f'{value:.9f}' for value in column]


CELLS: dict[str, list[str]] = {
    't': [f'{ns // 10**9}.{ns % 10**9:09d}' for ns in STAMPS_NS.tolist()],
    't_ns': [str(ns) for ns in STAMPS_NS.tolist()],
    'sec': [str(ns // 10**9) for ns in STAMPS_NS.tolist()],
    'nsec': [str(ns % 10**9) for ns in STAMPS_NS.tolist()],
    'frame': [str(k) for k in range(COUNT)],
    'one': ['1'] * COUNT,
    **dict(zip('xyz', map(written, POSITIONS.T), strict=True)),
    **dict(zip(('qx', 'qy', 'qz', 'qw'), map(written, ROTATIONS.T), strict=True)),
    **dict(zip(('roll', 'pitch', 'yaw'), map(written, ANGLES.T), strict=True)),
    **{f'r{i + 1}{j + 1}': written(MATRICES[:, i, j]) for i in range(3) for j in range(3)},
    **{f'extra{k}': written(RANDOM.normal(size=COUNT) * 3) for k in range(12)},
    '0': ['0'] * COUNT,
}
TUM = ['t', 'x', 'y', 'z', 'qx', 'qy', 'qz', 'qw']
W_FIRST = ['t', 'x', 'y', 'z', 'qw', 'qx', 'qy', 'qz']
MATRIX = ['r11', 'r12', 'r13', 'x', 'r21', 'r22', 'r23', 'y', 'r31', 'r32', 'r33', 'z']


def table(
    columns: Sequence[str],
    separator: str = ' ',
    cells: Mapping[str, Sequence[str]] = CELLS,
    end: str = '\n',
) -> str:
    rows = zip(*(cells[column] for column in columns), strict=True)
    return ''.join(separator.join(row) + end for row in rows)


def read(path: Path, statement: str = '', times: Path | None = None) -> Source:
    return read_sources([f'{path}{statement}'], times=times)[0]


def check(source: Source, has_orientation: bool = True) -> None:
    """Check that a source has the poses of this module."""
    assert source.stamps_ns.tolist() == STAMPS_NS.tolist()
    assert np.allclose(source.positions, POSITIONS, atol=1e-8)
    if has_orientation:
        assert source.rotations is not None
        assert angle_between(rotation.normalize(source.rotations), ROTATIONS).max() < 1e-7
    else:
        assert source.rotations is None


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'poses.txt'


@pytest.fixture
def times(tmp_path: Path) -> Path:
    path = tmp_path / 'times.txt'
    path.write_text(table(['t']))
    return path


# -- headers -------------------------------------------------------------------------------------

#: a header with a line for each way to spell t x y z qw qx qy qz
SPELLED = [
    'timestamp tx ty tz qw qx qy qz',
    'time x y z q_w q_x q_y q_z',
    't p_x p_y p_z q_RS_w q_RS_x q_RS_y q_RS_z',
    'timestamp p_RS_R_x p_RS_R_y p_RS_R_z q_RS_w q_RS_x q_RS_y q_RS_z',
    'timestamp p_WS_W_x p_WS_W_y p_WS_W_z q_WS_w q_WS_x q_WS_y q_WS_z',
    'time pos_x pos_y pos_z quat_w quat_x quat_y quat_z',
    'Time PosX PosY PosZ QuatW QuatX QuatY QuatZ',
    'TimeStamp POS_X POS_Y POS_Z Q_W Q_X Q_Y Q_Z',
    'stamp position.x position.y position.z orientation.w orientation.x orientation.y '
    'orientation.z',
    'ts px py pz q0 q1 q2 q3',
    'header.stamp pose.position.x pose.position.y pose.position.z pose.orientation.w '
    'pose.orientation.x pose.orientation.y pose.orientation.z',
    'timestamp translation_x translation_y translation_z rotation_w rotation_x rotation_y '
    'rotation_z',
    'time transform.translation.x transform.translation.y transform.translation.z '
    'transform.rotation.w transform.rotation.x transform.rotation.y transform.rotation.z',
    'unix_time gt_x gt_y gt_z gt_qw gt_qx gt_qy gt_qz',
    '/odom/header/stamp /odom/pose/pose/position/x /odom/pose/pose/position/y '
    '/odom/pose/pose/position/z /odom/pose/pose/orientation/w /odom/pose/pose/orientation/x '
    '/odom/pose/pose/orientation/y /odom/pose/pose/orientation/z',
    'timestamp position[0] position[1] position[2] quaternion[0] quaternion[1] quaternion[2] '
    'quaternion[3]',
]
FIELDS = (
    'field.pose.pose.position.x field.pose.pose.position.y field.pose.pose.position.z '
    'field.pose.pose.orientation.w field.pose.pose.orientation.x field.pose.pose.orientation.y '
    'field.pose.pose.orientation.z'
)


@pytest.mark.parametrize('spelled', SPELLED)
@pytest.mark.parametrize('stamp', ['t', 't_ns'])
@pytest.mark.parametrize(
    ('before', 'separator'), [('# ', ' '), ('', ','), ('#', ', '), ('', '\t'), ('%', ';')]
)
def test_names_are_understood_as_people_write_them(path, spelled, stamp, before, separator):
    columns = [stamp, *W_FIRST[1:], 'extra0', 'extra1']
    names = [*spelled.split(), 'vx', 'b_g']
    path.write_text(before + separator.join(names) + '\n' + table(columns, separator))
    source = read(path)
    check(source)
    assert not source.readings or source.readings[0].usual


@pytest.mark.parametrize(
    'header',
    [
        '#timestamp [ns],x [m],y [m],z [m],q_w [],q_x [],q_y [],q_z []',
        '#timestamp(ns), x(m), y(m), z(m), qw(-), qx(-), qy(-), qz(-)',
        'timestamp_ns,x_m,y_m,z_m,qw,qx,qy,qz',
        '# time [nsec]; x [meters]; y [meters]; z [meters]; qw; qx; qy; qz',
    ],
)
def test_units_of_names_are_used(path, header):
    path.write_text(header + '\n' + table(['t_ns', *W_FIRST[1:]], ','))
    check(read(path))


@pytest.mark.parametrize(('unit', 'metres'), [('mm', 0.001), ('cm', 0.01), ('km', 1000.0)])
@pytest.mark.parametrize('name', ['{} [{}]', '{}({})', '{}_{}'])
def test_positions_are_metres_whatever_the_header_has(path, unit, metres, name):
    names = [*(name.format(axis, unit) for axis in 'xyz'), 'qw', 'qx', 'qy', 'qz']
    cells = {k: [f'{float(v) / metres:.9f}' for v in CELLS[k]] for k in 'xyz'}
    path.write_text(','.join(['t', *names]) + '\n' + table(W_FIRST, ',', {**CELLS, **cells}))
    check(read(path))


def test_units_that_are_not_known_are_refused(path):
    path.write_text('t,x [ft],y [ft],z [ft],qw,qx,qy,qz\n' + table(W_FIRST, ','))
    with pytest.raises(ReadError, match=r"positions in 'ft', which is not known .*\?unit=m"):
        read(path)


@settings(max_examples=60, deadline=None)
@given(
    st.permutations(range(8)),
    st.sampled_from(SPELLED),
    st.sampled_from([' ', ',', ', ', '\t', ';']),
    st.sampled_from(['', '#', '# ', '%']),
    st.lists(st.integers(0, 7), max_size=4),
    st.sampled_from(['t', 't_ns']),
)
def test_columns_with_names_may_come_in_any_order(
    tmp_path_factory, order, spelled, separator, before, extra, stamp
):
    path = tmp_path_factory.mktemp('order') / 'poses.txt'
    columns = [[stamp, *W_FIRST[1:]][k] for k in order]
    names = [spelled.split()[k] for k in order]
    for k, place in enumerate(extra):
        columns.insert(place, f'extra{k}')
        names.insert(place, f'v{k}')
    path.write_text(before + separator.join(names) + '\n' + table(columns, separator))
    check(read(path))


@pytest.mark.parametrize(
    ('header', 'columns'),
    [
        ('#sec,nsec,x,y,z,qx,qy,qz,qw', ['sec', 'nsec', *TUM[1:]]),
        ('# counter, sec, nsec, x, y, z, qx, qy, qz, qw', ['frame', 'sec', 'nsec', *TUM[1:]]),
        ('x,y,z,qx,qy,qz,qw,secs,nsecs', [*TUM[1:], 'sec', 'nsec']),
        ('stamp.sec,stamp.nanosec,x,y,z,qx,qy,qz,qw', ['sec', 'nsec', *TUM[1:]]),
        ('header.stamp.sec,header.stamp.nanosec,x,y,z,qx,qy,qz,qw', ['sec', 'nsec', *TUM[1:]]),
        ('time_sec,time_nsec,x,y,z,qx,qy,qz,qw', ['sec', 'nsec', *TUM[1:]]),
        ('seconds,nanoseconds,x,y,z,qx,qy,qz,qw', ['sec', 'nsec', *TUM[1:]]),
        ('nsecs,secs,x,y,z,qx,qy,qz,qw', ['nsec', 'sec', *TUM[1:]]),
        ('time_ns,x,y,z,qx,qy,qz,qw', ['t_ns', *TUM[1:]]),
        ('seconds,x,y,z,qx,qy,qz,qw', TUM),
        ('nanoseconds,x,y,z,qx,qy,qz,qw', ['t_ns', *TUM[1:]]),
        ('frame,time,x,y,z,qx,qy,qz,qw', ['frame', *TUM]),
        ('x,y,z,qx,qy,qz,qw,t', [*TUM[1:], 't']),
    ],
)
def test_stamps_keep_every_nanosecond_wherever_they_stand(path, header, columns):
    path.write_text(header + '\n' + table(columns, ','))
    check(read(path))


def test_the_stamp_of_the_header_is_meant_not_the_time_of_recording(path):
    later = {**CELLS, 'late': [str(ns + 4_000_000) for ns in STAMPS_NS.tolist()]}
    header = f'%time,field.header.seq,field.header.stamp,field.header.frame_id,{FIELDS}'
    columns = ['late', 'frame', 't_ns', 'world', *W_FIRST[1:]]
    for frame in ('world', '/world', '', 'my frame'):
        later['world'] = [frame] * COUNT
        path.write_text(header.replace(' ', ',') + '\n' + table(columns, ',', later))
        check(read(path))


def test_names_of_fields_stand_before_what_is_in_them(path):
    header = 'seq,stamp,secs,nsecs,frame_id,position,x,y,z,orientation,x,y,z,w'
    empty = {**CELLS, '': [''] * COUNT, 'map': ['map'] * COUNT}
    columns = ['frame', '', 'sec', 'nsec', 'map', '', 'x', 'y', 'z', '', *TUM[4:]]
    path.write_text(header + '\n' + table(columns, ',', empty))
    check(read(path))


def test_a_log_of_px4_counts_microseconds_and_has_w_first(path):
    us = {**CELLS, 'us': [str(5_000_000 + 20_000 * k) for k in range(COUNT)]}
    us['sample'] = [str(4_999_000 + 20_000 * k) for k in range(COUNT)]
    header = 'timestamp,timestamp_sample,position[0],position[1],position[2],q[0],q[1],q[2],q[3]'
    path.write_text(header + '\n' + table(['us', 'sample', *W_FIRST[1:]], ',', us))
    source = read(path)
    assert source.stamps_ns[:2].tolist() == [4_999_000_000, 5_019_000_000]
    # as its messages are: the world east, north, up, the body forward, left, up
    half = np.sqrt(0.5)
    turned = rotation.multiply(np.array([half, half, 0, 0]), rotation.normalize(ROTATIONS))
    turned = rotation.multiply(turned, np.array([1.0, 0, 0, 0]))
    assert angle_between(rotation.normalize(source.rotations), turned).max() < 1e-7
    east_north_up = POSITIONS[:, [1, 0, 2]] * [1, 1, -1]
    np.testing.assert_allclose(source.positions, east_north_up, atol=1e-6)
    assert 'turned to east, north, up' in source.warnings[0]


def test_the_world_of_a_log_of_px4_may_be_forward_right_down(path):
    us = {**CELLS, 'us': [str(5_000_000 + 20_000 * k) for k in range(COUNT)], '2': ['2'] * COUNT}
    header = 'timestamp,position[0],position[1],position[2],q[0],q[1],q[2],q[3],pose_frame'
    path.write_text(header + '\n' + table(['us', *W_FIRST[1:], '2'], ',', us))
    np.testing.assert_allclose(read(path).positions, POSITIONS * [1, -1, -1], atol=1e-6)


@pytest.mark.parametrize('base', [0, 1])
@pytest.mark.parametrize('name', ['r{}{}', 'R_{}{}', 'm{}{}', 'T{}{}', 'rot_{}_{}'])
def test_cells_of_matrices_are_named(path, base, name):
    cells = [name.format(i + base, j + base) for i in range(3) for j in range(4)]
    path.write_text('time ' + ' '.join(cells) + '\n' + table(['t', *MATRIX]))
    check(read(path))


@pytest.mark.parametrize('names', ['roll,pitch,yaw', 'roll [rad],pitch [rad],yaw [rad]'])
def test_angles_in_radians(path, names):
    path.write_text(f't,x,y,z,{names}\n' + table([*TUM[:4], 'roll', 'pitch', 'yaw'], ','))
    source = read(path)
    check(source)
    statements = [reading.statement for reading in source.readings]
    assert bool(statements) == ('rad' not in names)  # they may be degrees, too
    if statements:
        check(read(path, f'?{statements[0]}'))


@pytest.mark.parametrize('names', ['roll_deg,pitch_deg,yaw_deg', 'Roll [deg],Pitch [°],Yaw (deg)'])
def test_angles_in_degrees(path, names):
    degrees = {
        k: [f'{np.degrees(float(v)):.9f}' for v in CELLS[k]] for k in ('roll', 'pitch', 'yaw')
    }
    columns = ['t', 'x', 'y', 'z', 'roll', 'pitch', 'yaw']
    path.write_text(f't,x,y,z,{names}\n' + table(columns, ',', {**CELLS, **degrees}))
    check(read(path))


def test_a_vector_of_rotation_by_name(path):
    vectors = rotation.to_rotation_vector(ROTATIONS)
    cells = {**CELLS, **dict(zip('abc', map(written, vectors.T), strict=True))}
    header = 't,x,y,z,rotvec_x [rad],rotvec_y [rad],rotvec_z [rad]'
    path.write_text(header + '\n' + table(['t', 'x', 'y', 'z', 'a', 'b', 'c'], ',', cells))
    check(read(path))
    check(read(path, '?columns=t,x,y,z,rx_rad,ry_rad,rz_rad'))


@pytest.mark.parametrize('words', ['# timestamp(s) q p v bg ba cam_imu_dt', '# t q p v bg ba'])
def test_the_state_of_openvins_has_its_quaternion_first(path, words):
    extra = [f'extra{k}' for k in range(9)]
    path.write_text(words + '\n' + table(['t', *TUM[4:], 'x', 'y', 'z', *extra]))
    source = read(path)
    check(source)
    assert source.readings == ()


def test_estimates_of_ov_eval_have_covariances(path):
    values = np.tile(
        [4e-4, 1e-5, 2e-5, 3e-4, 3e-5, 2e-4, 0.04, 0.001, 0.002, 0.03, 0.003, 0.02], (COUNT, 1)
    )
    cells = {**CELLS, **{f'c{k}': written(values[:, k]) for k in range(12)}}
    rows = table([*TUM, *(f'c{k}' for k in range(12))], ' ', cells)
    upper = ('11', '12', '13', '22', '23', '33')
    names = ' '.join(f'P{part}{cell}' for part in 'rt' for cell in upper)
    header = f'# timestamp(s) tx ty tz qx qy qz qw {names}\n'
    for begin in (header, ''):
        path.write_text(begin + rows)
        source = read(path)
        check(source)
        covariances = source.poses.covariances
        assert covariances is not None
        position = [[0.04, 0.001, 0.002], [0.001, 0.03, 0.003], [0.002, 0.003, 0.02]]
        assert np.allclose(covariances[:, 0], position)
        body = np.array([[4e-4, 1e-5, 2e-5], [1e-5, 3e-4, 3e-5], [2e-5, 3e-5, 2e-4]])
        world = MATRICES @ body @ MATRICES.transpose(0, 2, 1)
        assert np.allclose(covariances[:, 1], world)


@pytest.mark.parametrize(
    ('header', 'problem'),
    [
        ('t,x,y,qx,qy,qz,qw,e', 'names no column as z'),
        ('t,x,y,z,qx,qy,qz,e', 'no column as qw'),
        ('a,b,c,d,e,f,g,h', 'names no column as a position'),
        ('t,left,front,top,qx,qy,qz,qw', 'names no column as a position'),
        ('t,x,y,z,a,b,c,d', r'no orientation that is known .*\?columns=t,x,y,z,qx,qy,qz,qw'),
        ('t,x,y,z,qx,qy,qz,qw,vx', 'names 9 columns .* its rows have 8'),
        ('t,x,y,z,x,qx,qy,qz', r'2 \(x\) and 5 \(x\) may both be x'),
        ('e,x,y,z,qx,qy,qz,qw', 'names no stamps'),
    ],
)
def test_headers_that_leave_something_open_are_refused(path, header, problem):
    path.write_text(header + '\n' + table(TUM, ','))
    with pytest.raises(ReadError, match=problem) as caught:
        read(path)
    assert '?columns=' in str(caught.value)


def test_a_header_that_names_what_is_not_there_is_refused(path):
    path.write_text('t,qw,qx,qy,qz,x,y,z\n' + table(TUM, ','))
    with pytest.raises(ReadError, match=r'columns 3 4 5 2 has no unit length|has no unit length'):
        read(path)


def test_comments_are_no_names(path):
    for line in ('# written on monday by a tool of ours', '# TF Coordinate Frame ID: /map'):
        path.write_text(line + '\n' + table(TUM))
        check(read(path))


# -- without names -------------------------------------------------------------------------------


@pytest.mark.parametrize('more', [0, 1, 3])
@pytest.mark.parametrize(
    'first', [['t'], ['t_ns'], ['sec', 'nsec'], ['frame', 't'], ['frame', 'sec', 'nsec']]
)
@pytest.mark.parametrize('separator', [' ', ',', '\t', ';', ' , '])
def test_quaternions_without_names_may_have_w_first_or_last(path, first, separator, more):
    extra = [f'extra{k}' for k in range(more)]
    for order, turned in ((TUM[4:], 0), (W_FIRST[4:], 1)):
        path.write_text(table([*first, 'x', 'y', 'z', *order, *extra], separator))
        source = read(path)
        assert source.stamps_ns.tolist() == STAMPS_NS.tolist()
        assert np.allclose(source.positions, POSITIONS, atol=1e-8)
        assert [r.statement for r in source.readings] == ['quaternion=xyzw', 'quaternion=wxyz']
        meant = source.readings[turned].poses.rotations
        assert angle_between(rotation.normalize(meant), ROTATIONS).max() < 1e-7
        check(read(path, f'?{source.readings[turned].statement}'))


@pytest.mark.parametrize(
    'first', [['t'], ['t_ns'], ['sec', 'nsec'], ['frame', 't'], ['frame', 'sec', 'nsec']]
)
@pytest.mark.parametrize('below', [[], ['0', '0', '0', 'one']])
@pytest.mark.parametrize('separator', [' ', ','])
def test_matrices_behind_a_stamp(path, first, below, separator):
    path.write_text(table([*first, *MATRIX, *below], separator))
    check(read(path))


def test_a_rotation_matrix_and_a_position(path):
    cells = [cell for cell in MATRIX if cell.startswith('r')]
    for columns in (['t', *cells, 'x', 'y', 'z'], ['t', 'x', 'y', 'z', *cells]):
        path.write_text(table(columns))
        check(read(path))


@pytest.mark.parametrize('below', [[], ['0', '0', '0', 'one']])
@pytest.mark.parametrize('first', [[], ['frame']])
def test_matrices_without_stamps_need_the_file_of_their_times(path, times, below, first):
    path.write_text(table([*first, *MATRIX, *below]))
    source = read(path, times=times)
    check(source)
    assert source.kind == 'kitti'
    with pytest.raises(ReadError, match=r'poses without stamps.*matrices 3x4.*--times'):
        read(path)


def test_numbers_of_frames_choose_among_more_stamps(path, times):
    path.write_text(''.join(table(['frame', *MATRIX]).splitlines(keepends=True)[3::2]))
    source = read(path, times=times)
    assert source.stamps_ns.tolist() == STAMPS_NS[3::2].tolist()
    assert np.allclose(source.positions, POSITIONS[3::2], atol=1e-8)


def test_seven_columns_without_stamps_need_the_file_of_their_times(path, times):
    path.write_text(table(TUM[1:]))
    check(read(path, times=times))
    with pytest.raises(ReadError, match='--times'):
        read(path)


def test_stamps_beside_may_be_nanoseconds_with_names_of_images(path, tmp_path):
    path.write_text(table(MATRIX))
    cells = {**CELLS, 'png': [f'{ns}.png' for ns in STAMPS_NS.tolist()]}
    times = tmp_path / 'times.csv'
    times.write_text('#timestamp [ns],filename\n' + table(['t_ns', 'png'], ',', cells))
    check(read(path, times=times))


def test_the_orientation_may_come_first_where_nothing_else_fits(path):
    path.write_text(table(['t', *TUM[4:], 'x', 'y', 'z']))
    check(read(path))
    path.write_text(table(['t', *TUM[4:], 'x', 'y', 'z', 'extra0']))
    with pytest.raises(
        ReadError, match=r'columns 2 3 4 5 .*append \?columns=t,qx,qy,qz,qw,x,y,z '
    ):
        read(path)


@pytest.mark.parametrize('first', [['t'], ['t_ns'], ['sec', 'nsec']])
def test_four_columns_are_positions(path, first):
    path.write_text(table([*first, 'x', 'y', 'z'], ','))
    check(read(path), has_orientation=False)


@pytest.mark.parametrize('more', [[], ['extra0', 'extra1', 'extra2']])
def test_files_of_vins_have_w_first_and_end_in_a_comma(path, more):
    path.write_text(table(['t_ns', *W_FIRST[1:], *more], ',', end=',\n'))
    source = read(path)
    check(source)
    assert source.readings == ()


ECHOED = {
    'PoseStamped': (['map'], TUM[1:], 0),
    'TransformStamped': (['map', 'base'], TUM[1:], 0),
    'PoseWithCovarianceStamped': (['map'], TUM[1:], 36),
    'Odometry': (['map', 'base'], TUM[1:], 36 + 6 + 36),
}


@pytest.mark.parametrize('message', ECHOED)
@pytest.mark.parametrize('frame', ['map', '', 'robot/map'])
def test_what_ros2_topic_echo_prints(path, message, frame):
    frames, pose, more = ECHOED[message]
    variance = np.tile((np.eye(6) * 0.01).ravel(), 3)[:more]
    cells = {**CELLS, 'map': [frame] * COUNT, 'base': [''] * COUNT}
    cells |= {f'c{k}': [str(v)] * COUNT for k, v in enumerate(variance)}
    columns = ['sec', 'nsec', *frames, *pose, *(f'c{k}' for k in range(more))]
    path.write_text(table(columns, ',', cells))
    source = read(path)
    check(source)
    assert source.readings == ()
    assert (source.poses.covariances is not None) == (more > 0)
    if more:
        assert np.allclose(source.poses.covariances, np.eye(3) * 0.01)


def test_what_ros2_topic_echo_prints_of_points(path):
    cells = {**CELLS, 'map': ['map'] * COUNT}
    path.write_text(table(['sec', 'nsec', 'map', 'x', 'y', 'z'], ',', cells))
    check(read(path), has_orientation=False)


def test_words_in_columns_are_left_out(path):
    cells = {**CELLS, 'name': ['drone 1'] * COUNT, 'png': [f'img_{k}.png' for k in range(COUNT)]}
    path.write_text(
        'VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_W\tQ_X\tQ_Y\tQ_Z\tImageFile\n'
        + table(['name', *W_FIRST, 'png'], '\t', cells)
    )
    check(read(path))


# -- the guard -----------------------------------------------------------------------------------


@pytest.mark.parametrize('scale', [0.3, 2.0])
def test_quaternions_without_unit_length_are_none(path, scale):
    cells = {k: [str(float(v) * scale) for v in CELLS[k]] for k in TUM[4:]}
    path.write_text(table(TUM, ' ', {**CELLS, **cells}))
    with pytest.raises(ReadError, match='has 8 columns; a trajectory has 8'):
        read(path)
    path.write_text('# t x y z qx qy qz qw\n' + table(TUM, ' ', {**CELLS, **cells}))
    with pytest.raises(ReadError, match='no unit length in 100 % of the rows'):
        read(path)
    with pytest.raises(ReadError, match='no unit length in 100 % of the rows'):
        read(path, '?columns=t,x,y,z,qx,qy,qz,qw')


def test_a_few_damaged_rows_do_not_spoil_a_layout(path):
    rows = table(TUM).splitlines() * 4
    rows[7] = rows[7].rsplit(' ', 1)[0] + ' nan'
    rows[9] = '9 0 0 0 0 0 0 0'
    rows[11] = '11 0 0 0 0 0 0 7'
    path.write_text('\n'.join(rows[:7] + rows[7:]) + '\n')
    with pytest.raises(ReadError, match='runs over the same time'):
        read(path)
    assert len(read(path, '?run=1')) > 0


def test_two_decimals_are_enough_for_a_quaternion(path):
    cells = {k: [f'{float(v):.2f}' for v in CELLS[k]] for k in TUM[4:]}
    path.write_text(table(TUM, ' ', {**CELLS, **cells}))
    assert len(read(path)) == COUNT


@pytest.mark.parametrize('stamp', ['t', 't_ns', 'sec nsec', 'frame t'])
def test_matrices_that_are_written_column_by_column_are_read_so(path, stamp):
    columns = [MATRIX[k + 4 * row] for k in range(3) for row in range(3)]
    cells = [*columns[:3], '0', *columns[3:6], '0', *columns[6:], '0', 'x', 'y', 'z', 'one']
    path.write_text(table([*stamp.split(), *cells]))
    source = read(path)
    check(source)
    assert 'column by column' in ' '.join(source.warnings)


@pytest.mark.parametrize(
    'below', [['0', '0', '0', '0'], ['one', '0', '0', '0'], ['x', '0', '0', 'one']]
)
@pytest.mark.parametrize('stamp', ['t', 'sec nsec'])
def test_a_matrix_whose_last_row_is_not_one_is_refused(path, stamp, below):
    path.write_text(table([*stamp.split(), *MATRIX, *below]))
    with pytest.raises(ReadError, match=r'a matrix 4x4, but its last row is not 0 0 0 1'):
        read(path)


def test_the_scale_of_a_similarity_is_taken_out_of_its_rotations(path, times):
    cells = {k: [str(float(v) * 0.3) for v in CELLS[k]] for k in MATRIX if k.startswith('r')}
    path.write_text(table(MATRIX, ' ', {**CELLS, **cells}))
    source = read(path, times=times)
    check(source)
    assert 'have a scale of 0.3' in source.warnings[0]


def test_matrices_that_mirror_are_refused(path, times):
    cells = {k: [str(-float(v)) for v in CELLS[k]] for k in ('r11', 'r21', 'r31')}
    for begin in ('', 'r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z\n'):
        path.write_text(begin + table(MATRIX, ' ', {**CELLS, **cells}))
        with pytest.raises(ReadError, match=r'determinant|has 12 columns'):
            read(path, times=times)


def test_what_fits_nothing_says_what_would(path):
    path.write_text(table(['extra0', *TUM[4:], *TUM[:4], 'extra1']))
    with pytest.raises(ReadError, match='columns 2 3 4 5 have unit length, as a quaternion has'):
        read(path)
    path.write_text(table(['t', *(f'extra{k}' for k in range(8))]))
    with pytest.raises(ReadError, match=r'has 9 columns; .*say what each column is, such as'):
        read(path)


@pytest.mark.parametrize(
    'columns',
    [
        ['x', 'y', 'z', *TUM[4:], 't'],
        ['x', 'y', 'z', 't', *TUM[4:]],
        ['extra0', *TUM[1:], 't'],
        ['extra0', *MATRIX, 't_ns'],
        [*TUM[4:], 't', 'x', 'y', 'z'],
    ],
)
def test_what_does_not_go_up_is_no_stamp(path, columns):
    path.write_text(table(columns))
    with pytest.raises(ReadError, match=r'\?columns='):
        read(path)


# -- stated --------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(
    st.permutations(range(8)),
    st.sampled_from([' ', ',', '\t', ';']),
    st.sampled_from([('t',), ('t_ns',), ('sec', 'nsec')]),
    st.booleans(),
    st.lists(st.integers(0, 7), max_size=3),
)
def test_what_is_stated_holds_whatever_the_header_says(
    tmp_path_factory, order, separator, stamp, has_header, extra
):
    path = tmp_path_factory.mktemp('stated') / 'poses.txt'
    groups = [stamp, *((role,) for role in TUM[1:])]
    columns = [role for k in order for role in groups[k]]
    for k, place in enumerate(extra):
        columns.insert(place, f'extra{k}')
    stated = ','.join('_' if role.startswith('extra') else role for role in columns)
    header = separator.join(f'a{k}' for k in range(len(columns))) + '\n'
    path.write_text(header * has_header + table(columns, separator))
    check(read(path, f'?columns={stated}'))


def test_columns_at_the_end_may_be_left_out(path):
    path.write_text(table([*W_FIRST, 'extra0', 'extra1']))
    check(read(path, '?columns=t,x,y,z,qw,qx,qy,qz'))
    check(read(path, '?columns=t,x,y,z'), has_orientation=False)


def test_stated_units_are_used(path):
    cells = {k: [f'{float(v) * 1000:.6f}' for v in CELLS[k]] for k in 'xyz'}
    path.write_text(table(W_FIRST, ' ', {**CELLS, **cells}))
    check(read(path, '?columns=t_s,x_mm,y_mm,z_mm,qw,qx,qy,qz'))


@pytest.mark.parametrize(
    ('statement', 'problem'),
    [
        ('?columns=t,x,y,z,qx,qy,qz,qw,_,_', 'names 10 columns, but its rows have 8'),
        ('?columns=t,x,y,x', 'has x twice'),
        ('?columns=t,x,y,qx,qy,qz,qw', 'has no position'),
        ('?columns=t,x,y,z,qx,qy,qz,qw&quaternion=wxyz', 'says the order of the quaternion'),
        ('?columns=x,y,z,qx,qy,qz,qw', 'poses without stamps'),
        ('?columns=t,x,y,z,w', 'columns must be what each column is'),
        ('?columns=t_mm,x,y,z', 'columns must be what each column is'),
        ('?columns=', 'columns must be what each column is'),
        ('?columns=t,qx,qy,qz,qw,x,y,z', 'in columns 2 3 4 5 has no unit length'),
        ('?columns=sec,nsec,x,y,z', 'columns 1 and 2 are taken for seconds and nanoseconds'),
    ],
)
def test_what_cannot_be_is_refused(path, statement, problem):
    path.write_text(table(TUM))
    with pytest.raises((ReadError, ConfigError), match=problem):
        read(path, statement)


def test_every_body_has_an_example_here():
    assert {role for roles in BODIES.values() for role in roles.split()} <= {
        *CELLS, '_', 'q1', 'q2', 'q3', 'q4'
    }  # fmt: skip


@pytest.mark.parametrize(
    ('stated', 'missing'),
    [
        ('t,x,y,z,qx,qy,qz', 'qw'),
        ('t,x,y,z,roll,pitch', 'yaw'),
        ('t,x,y,z,_,yaw', 'roll, pitch'),
        ('t,x,y,z,rx,ry', 'rz'),
        ('t,x,y,z,r11,r12,r13,r21,r22,r23,r31,r32', 'r33'),
    ],
)
def test_a_part_of_an_orientation_cannot_be_stated(path, stated, missing):
    path.write_text(table([*TUM, *TUM], ','))
    with pytest.raises(ConfigError, match=f'without {missing}; name all of it, or write _'):
        read(path, f'?columns={stated}')


@pytest.mark.parametrize('name', ['image_timestamp', 'sim_time', 'TimeOfArrival'])
def test_other_times_beside_the_stamps_are_said(path, name):
    other = {**CELLS, 'other': [f'{float(t) + 0.1:.6f}' for t in CELLS['t']]}
    names = f'timestamp,{name},x,y,z,qx,qy,qz,qw\n'
    path.write_text(names + table(['t', 'other', *TUM[1:]], ',', other))
    source = read(path)
    check(source)
    assert f'those of {name}, 0.1 s apart, are left out' in source.warnings[0]
    path.write_text(names + table(['t', 't', *TUM[1:]], ','))
    assert read(path).warnings == ()


def test_columns_of_an_axis_and_an_angle_are_said_to_be_left_out(path):
    names = 'timestamp,x,y,z,axis_x,axis_y,axis_z,angle\n'
    path.write_text(names + table([*TUM[:4], 'x', 'y', 'z', 'yaw'], ','))
    source = read(path)
    assert source.rotations is None
    assert 'axis_x, axis_y, axis_z, angle' in source.warnings[0]


def test_the_index_that_pandas_calls_unnamed_is_left_out(path):
    names = 'Unnamed: 0,timestamp,x,y,z,qx,qy,qz,qw\n'
    index = {**CELLS, 'index': [str(k) for k in range(COUNT)]}
    path.write_text(names + table(['index', *TUM], ',', index))
    check(read(path))


def openvins_rows(velocities: np.ndarray, run: SimulatedRun) -> str:
    """Return states without a header: t, quaternion, position, velocity, biases, calibration."""
    poses = run.estimate
    count = len(poses)
    more = np.random.default_rng(0).normal(0, 0.1, (count, 8))
    rows = np.column_stack([poses.rotations, poses.positions, velocities, more])
    stamps = (f'{ns // 10**9}.{ns % 10**9:09d}' for ns in poses.stamps_ns.tolist())
    return ''.join(
        f'{stamp} {" ".join(f"{value:.9f}" for value in row)}\n'
        for stamp, row in zip(stamps, rows, strict=True)
    )


def test_a_state_of_openvins_without_a_header_is_known_by_its_velocity(path):
    run = simulate(duration_s=20.0)
    seconds = (run.estimate.stamps_ns - run.estimate.stamps_ns[0]) / 1e9
    velocities = np.gradient(run.estimate.positions, seconds, axis=0)
    path.write_text(openvins_rows(velocities, run))
    source = read(path)
    assert source.readings == ()
    assert source.poses.positions == pytest.approx(run.estimate.positions, abs=1e-8)
    assert source.poses.rotations == pytest.approx(run.estimate.rotations, abs=1e-8)


def test_columns_that_are_no_velocity_are_no_state_of_openvins(path):
    run = simulate(duration_s=20.0)
    noise = np.random.default_rng(1).normal(0, 0.5, (len(run.estimate), 3))
    path.write_text(openvins_rows(noise, run))
    with pytest.raises(ReadError, match=r'\?columns='):
        read(path)
