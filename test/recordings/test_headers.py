"""What a header names is used, and what it leaves open is asked for with what to write."""

from collections.abc import Sequence
import contextlib
from pathlib import Path
import re
import time

import numpy as np
import pytest

from vio_eval_ros.errors import ReadError, VioEvalError
from vio_eval_ros.recordings.sources import read_sources, Source

COUNT = 50
STAMPS_NS = 1_700_000_000_040_000_000 + np.arange(COUNT) * 50_000_000
T = np.arange(COUNT) / 20
POSITIONS = np.stack([np.sin(T), np.cos(T), T / 10], axis=1).round(6)
HALF = T[:, None] / 4
QUATERNIONS = np.hstack([np.zeros((COUNT, 2)), np.sin(HALF), np.cos(HALF)])
CELLS = {
    **dict(zip('xyz', POSITIONS.T, strict=True)),
    **dict(zip(('qx', 'qy', 'qz', 'qw'), QUATERNIONS.T, strict=True)),
}
POSE = 't x y z qx qy qz qw'


def cell(role: str, k: int) -> str:
    ns = int(STAMPS_NS[k])
    texts = {
        't': f'{ns // 10**9}.{ns % 10**9:09d}',
        'sec': str(ns // 10**9),
        'nsec': str(ns % 10**9),
        'us': str(ns % 10**9 // 1000),
        'ms': str(ns % 10**9 // 10**6),
        'k': str(k),
        'k1': f'{k + 1}',
    }
    return texts[role] if role in texts else f'{CELLS[role][k]:.9f}'


def write(path: Path, header: str, roles: str, separator: str = ',') -> Path:
    rows = [separator.join(cell(role, k) for role in roles.split()) for k in range(COUNT)]
    path.write_text('\n'.join([header, *rows]) + '\n')
    return path


def read(path: Path, statement: str = '') -> Source:
    return read_sources([f'{path}{statement}'])[0]


def check(source: Source, roles: Sequence[str] = ('qx',)) -> None:
    assert source.stamps_ns.tolist() == STAMPS_NS.tolist()
    assert np.allclose(source.positions, POSITIONS, atol=1e-8)
    assert (source.rotations is not None) == ('qx' in roles)
    if source.rotations is not None:
        assert np.allclose(source.rotations, QUATERNIONS, atol=1e-8)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'poses.csv'


@pytest.mark.parametrize('counter', ['k', 'k1'])
@pytest.mark.parametrize('separator', [',', ', ', ';', '\t'])
def test_a_counter_without_a_name_is_left_out(path, separator, counter):
    names = separator.join(['', 'timestamp', *POSE.split()[1:]])
    check(read(write(path, names, f'{counter} {POSE}', separator)))


@pytest.mark.parametrize('separator', [' ', ',', '\t'])
def test_names_of_a_table_of_r_begin_behind_its_counter(path, separator):
    names = separator.join(f'"{name}"' for name in POSE.split())
    check(read(write(path, names, f'k1 {POSE}', separator)))


@pytest.mark.parametrize(
    ('header', 'said'),
    [
        ('time,east,north,up', ''),
        ('time,E,N,U', ''),
        ('t,utm_x,utm_y,height', ''),
        ('time,easting,northing,altitude', ''),
        ('t,utm_easting [m],utm_northing [m],alt [m]', ''),
        ('t,x,y,height', ''),
        ('time,north,east,down', 'north, east, down'),
        ('time,pos_n,pos_e,pos_d', None),
        ('time,N,E,D', 'north, east, down'),
    ],
)
def test_axes_of_the_earth_are_positions(path, header, said):
    write(path, header, 't x y z')
    if said is None:
        with pytest.raises(ReadError, match='names no column as a position'):
            read(path)
        return
    source = read(path)
    check(source, [])
    assert said in ' '.join(source.warnings)
    assert bool(said) == bool(source.warnings)


@pytest.mark.parametrize(
    ('header', 'roles'),
    [
        ('sec,usec', 'sec us'),
        ('tv_sec,tv_usec', 'sec us'),
        ('stamp_sec,stamp_usec', 'sec us'),
        ('secs,nsecs', 'sec nsec'),
        ('stamp_sec,stamp_nsec', 'sec nsec'),
        ('timestamp_sec,timestamp_nanosec', 'sec nsec'),
        ('sec,msec', 'sec ms'),
        ('usec,sec', 'us sec'),
    ],
)
def test_parts_of_seconds_stand_beside_them(path, header, roles):
    check(read(write(path, f'{header},x,y,z,qx,qy,qz,qw', f'{roles} {POSE[2:]}')))


def test_parts_of_seconds_are_less_than_one(path):
    write(path, 'sec,msec,x,y,z,qx,qy,qz,qw', f'sec us {POSE[2:]}')
    with pytest.raises(ReadError, match=r'taken for ms .* not within 0 and 999'):
        read(path)
    check(read(path, '?columns=sec,nsec_us,x,y,z,qx,qy,qz,qw'))


def test_several_bodies_in_columns_are_stated_one_by_one(path):
    topics = {'/a/odom': POSE[2:].split(), '/a/gt': POSE[2:].split()}
    names = [
        f'{topic}/pose/{"position" if len(role) == 1 else "orientation"}/{role[-1]}'
        for topic, roles in topics.items()
        for role in roles
    ]
    write(path, ','.join(['__time', *names]), f'{POSE} {POSE[2:]}')
    with pytest.raises(ReadError, match=r'several bodies \(/a/odom, /a/gt\)') as caught:
        read(path)
    ways = re.findall(r'\?columns=\S+', str(caught.value))
    assert len(ways) == 2
    for way in ways:
        check(read(path, way))


@pytest.mark.parametrize(
    'names', ['gt_x gt_y gt_z est_x est_y est_z', 'truth.x truth.y truth.z est.x est.y est.z']
)
def test_several_positions_in_columns_are_stated_one_by_one(path, names):
    write(path, ','.join(['t', *names.split()]), 't x y z x y z')
    with pytest.raises(ReadError, match='several bodies') as caught:
        read(path)
    assert re.findall(r'\?columns=\S+', str(caught.value)) == [
        '?columns=t,x,y,z',
        '?columns=t,_,_,_,x,y,z',
    ]


def test_of_many_bodies_the_first_are_named(path):
    names = [f'body{k}.position.{axis}' for k in range(400) for axis in 'xyz']
    write(path, ','.join(['t', *names]), ' '.join(['t', *['x y z'] * 400]))
    with pytest.raises(ReadError, match=r'several bodies \(body0, 399 more\); append') as caught:
        read(path)
    assert re.findall(r'\?columns=\S+', str(caught.value)) == ['?columns=t,x,y,z']


LONG = 60_000  # what is quadratic takes a minute for it, what is linear a fraction of a second


@pytest.mark.parametrize('begin', ['# ', 'timestamp,', 't [s] '])
@pytest.mark.parametrize(
    'unit', [*'1 .a([_\'"#%,;\t', '[ ', 'x (', '1,', '1 ', '1_', "'1", '1.', 'q_', 'a.a[', '()']
)
def test_a_header_of_any_length_is_read_in_no_time(path, begin, unit):
    header = begin + unit * (LONG // len(unit))
    rows = '1.5 1 2 3 0 0 0 1\n' * 30
    path.write_text(f'{header}x\n{rows}')
    began = time.process_time()
    with contextlib.suppress(VioEvalError):
        read(path)
    assert time.process_time() - began < 10


def test_a_pose_is_not_put_together_from_two_topics(path):
    names = [f'/gps/pose/position/{axis}' for axis in 'xyz']
    names += [f'/imu/orientation/{axis}' for axis in 'xyzw']
    write(path, ','.join(['__time', *names]), POSE)
    with pytest.raises(ReadError, match=r'several topics \(gps, imu\)'):
        read(path)


def test_rows_without_a_pose_are_dropped_whichever_comes_first(path):
    write(path, POSE.replace(' ', ','), POSE)
    lines = path.read_text().splitlines()
    for k in (1, 8, COUNT):
        lines[k] = lines[k].split(',')[0] + ',' * 7
    for end in ('\n', '\r\n'):
        path.write_bytes((end.join(lines) + end).encode())
        source = read(path)
        assert len(source) == COUNT
        assert np.flatnonzero(np.isnan(source.positions[:, 0])).tolist() == [0, 7, COUNT - 1]


@pytest.mark.parametrize('separator', [',', ';'])
def test_empty_cells_are_not_numbers(path, separator):
    write(path, POSE.replace(' ', separator), POSE, separator)
    lines = path.read_text().splitlines()
    cells = lines[5].split(separator)
    lines[5] = separator.join([*cells[:2], '', *cells[3:7], ''])
    path.write_text('\n'.join(lines) + '\n')
    source = read(path)
    assert source.rotations is not None
    assert np.isnan(source.positions[4, 1])
    assert np.isnan(source.rotations[4, 3])
    assert np.count_nonzero(np.isnan(source.positions)) == 1


@pytest.mark.parametrize(
    'names', ['phi,theta,psi', 'heading', 'att_a,att_b,att_c', 'euler1,euler2,euler3']
)
def test_an_orientation_that_is_not_known_is_said(path, names):
    write(path, f't,x,y,z,{names}', 't x y z ' + 'x y z'[: 2 * names.count(',') + 1])
    source = read(path)
    check(source, [])
    assert f'columns {names.replace(",", ", ")} are is not known' in source.warnings[0]


@pytest.mark.parametrize('names', ['std_x,roll_rate', 'vx,vy', 'cov,err_yaw'])
def test_what_is_no_orientation_is_not_spoken_of(path, names):
    assert read(write(path, f't,x,y,z,{names}', 't x y z x y')).warnings == ()


@pytest.mark.parametrize(
    'header', ['t,x,y,z,qi,qj,qk,qr', 't,x,y,z,q_i,q_j,q_k,q_real', 't,x,y,z,qx,qy,qz,q_scalar']
)
def test_units_of_quaternions_name_their_parts(path, header):
    check(read(write(path, header, POSE)))


def test_the_stamp_of_an_unknown_name_is_stated(path):
    write(path, 'Zeit;Position X;Position Y;Position Z;qx;qy;qz;qw', POSE, ';')
    with pytest.raises(ReadError, match=r'if column 1 is the stamp, append \?columns=t,x,y,z,qx'):
        read(path)


def test_bytes_that_are_not_utf_8_are_printed_as_letters(path):
    write(path, 't,x [?m],y,z,qx,qy,qz,qw', POSE)
    path.write_bytes(path.read_bytes().replace(b'?', b'\xb5\xe4', 1))
    with pytest.raises(ReadError, match="positions in 'µäm'"):
        read(path)


def test_long_names_are_cut_off_in_messages(path):
    names = f'timestamp,{"_" * 5000}x,x,y,z,qx,qy,qz,qw'
    path.write_text(f'{names}\n{",".join(["1.5"] * 9)}\n')
    with pytest.raises(ReadError) as raised:
        read_sources([str(path)])
    assert len(str(raised.value)) < 1500
