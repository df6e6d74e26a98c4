"""A text file with the rows of several bodies is refused, until one of them is stated."""

from pathlib import Path

import numpy as np
import pytest

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.sources import read_sources, Source

COUNT = 200
T = np.arange(COUNT) / 20
PATH = np.stack([np.sin(T), np.cos(T), T / 10], axis=1)
AWAY = np.array([4.0, 0, 1])


def read(path: Path, statement: str = '') -> Source:
    return read_sources([f'{path}{statement}'])[0]


def rows(path: Path, header: str, names: tuple[str, str], *, is_last: bool, late_s: float) -> None:
    """Write two bodies in turn, their names in the last column or in the first."""
    lines = [header] if header else []
    separator = ',' if ',' in header else '\t'
    for t, place in zip(T, PATH, strict=True):
        for name, offset, late in ((names[0], 0 * AWAY, 0.0), (names[1], AWAY, late_s)):
            pose = [f'{t + late + 100:.3f}', *(f'{x:.5f}' for x in place + offset), *'0001']
            lines.append(separator.join([*pose, name] if is_last else [name, *pose]))
    path.write_text('\n'.join(lines) + '\n')


@pytest.mark.parametrize('late_s', [0.0, 0.01])
@pytest.mark.parametrize(
    ('header', 'names', 'is_last'),
    [
        ('VehicleName\tTimeStamp\tPOS_X\tPOS_Y\tPOS_Z\tQ_X\tQ_Y\tQ_Z\tQ_W', ('a', 'bb'), False),
        ('time,x,y,z,qx,qy,qz,qw,object', ('cup', 'hand 2'), True),
        ('id,time,x,y,z,qx,qy,qz,qw', ('3', '7'), False),
        ('time,x,y,z,qx,qy,qz,qw,track', ('0', '1'), True),
    ],
)
def test_several_bodies_are_not_one_trajectory(tmp_path, header, names, is_last, late_s):
    path = tmp_path / 'poses.csv'
    rows(path, header, names, is_last=is_last, late_s=late_s)
    with pytest.raises(ReadError, match=rf'2 bodies, .*column \d \(.*{names[0]}, {names[1]}\)'):
        read(path)
    for name, offset in zip(names, (0, 1), strict=True):
        source = read(path, f'?body={name}')
        assert np.allclose(source.positions, PATH + AWAY * offset, atol=1e-4)
        assert (np.diff(source.stamps_ns) == 50_000_000).all()
    with pytest.raises(ReadError, match="no body 'none'"):
        read(path, '?body=none')


@pytest.mark.parametrize('words', [('TRACKING', 'LOST'), ('0', '1'), ('odom', 'odom')])
def test_what_says_something_else_of_one_body_is_left_out(tmp_path, words):
    path = tmp_path / 'poses.csv'
    lines = [
        f'{t:.3f},{x:.5f},{y:.5f},{z:.5f},0,0,0,1,{words[k % 7 == 3]}'
        for k, (t, (x, y, z)) in enumerate(zip(T, PATH, strict=True))
    ]
    path.write_text('\n'.join(['time,x,y,z,qx,qy,qz,qw,state', *lines]) + '\n')
    assert len(read(path)) == COUNT


def test_a_body_is_stated_where_there_are_several_only(tmp_path):
    path = tmp_path / 'poses.txt'
    path.write_text(''.join(f'{t:.3f} {t:.5f} 0 0 0 0 0 1\n' for t in T))
    with pytest.raises(ConfigError, match='here is none'):
        read(path, '?body=drone')
