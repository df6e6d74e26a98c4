"""Times as ISO 8601 writes them are stamps, to the last digit; others are asked for in seconds."""

from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.sources import read_sources, Source

START = datetime(2024, 2, 28, 23, 59, 50, tzinfo=timezone.utc)
COUNT = 300


def write(path: Path, zone_h: float, end: str, between: str = 'T', separator: str = ',') -> str:
    zone = timezone(timedelta(hours=zone_h))
    lines = []
    for k in range(COUNT):
        time = (START + timedelta(milliseconds=50 * k)).astimezone(zone)
        text = time.strftime(f'%Y-%m-%d{between}%H:%M:%S.%f') + '789' + end
        lines.append(separator.join([text, f'{k / 10}', '0', '1', '0', '0', '0', '1']))
    header = separator.join('time x y z qx qy qz qw'.split())
    path.write_text('\n'.join([header, *lines]) + '\n')
    return str(path)


def read(spec: str) -> Source:
    return read_sources([spec])[0]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'poses.csv'


@pytest.mark.parametrize('separator', [',', ' ', ';', '\t'])
@pytest.mark.parametrize('between', ['T', ' '])
@pytest.mark.parametrize(
    ('zone_h', 'end'), [(0, 'Z'), (0, '+00:00'), (2, '+02:00'), (-3.5, '-0330'), (0, '')]
)
def test_times_are_read_to_the_nanosecond(path, zone_h, end, between, separator):
    source = read(write(path, zone_h, end, between, separator))
    first_ns = int(START.timestamp()) * 10**9 + 789
    assert source.stamps_ns.tolist() == [first_ns + 50_000_000 * k for k in range(COUNT)]
    assert any('no zone' in one for one in source.warnings) == (end == '')


@pytest.mark.parametrize(
    ('time', 'problem'),
    [
        ('2024-13-01T00:00:00', 'one of its times is none'),
        ('1969-12-31T00:00:00Z', 'before 1970'),
        ('12:00:01.5', "'12:00:01.5' is not a number; write times as seconds"),
        ('2024/06/01', "'2024/06/01' is not a number; write times as seconds"),
    ],
)
def test_other_times_are_refused(path, time, problem):
    path.write_text(''.join(f'{time},{k},0,0,0,0,0,1\n' for k in range(20)))
    with pytest.raises(ReadError, match=problem):
        read(str(path))
