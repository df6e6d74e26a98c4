"""Numbers read from text equal what Python's own parsers say, and bad lines are named."""

from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import text
from vio_eval_ros.recordings.text import read_text

ROW = '1403715524.907143168 0.1 -0.25 3 0 0 0 1'


def rows_of(tmp_path: Path, content: str | bytes) -> text.Rows:
    path = tmp_path / 'trajectory.txt'
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_text(path).rows


def real_files(shared_data: Path) -> list[Path]:
    found = [
        path
        for folder in ('est_*', 'gt_*', 'evo_test_data')
        for path in sorted(shared_data.glob(f'{folder}/**/*'))
        if path.suffix in ('.txt', '.csv', '.tum') and 'hybvio' not in str(path)
    ]
    assert len(found) > 25
    return found


@pytest.mark.slow
def test_real_files_are_read_to_the_last_bit(shared_data):
    for path in real_files(shared_data):
        words = [
            line.replace(',', ' ').split()
            for line in path.read_text().splitlines()
            if line.strip() and not line.startswith('#')
        ]
        rows = read_text(path).rows
        expected = np.array(words, dtype=float)
        assert np.array_equal(rows.values[:, 1:], expected[:, 1:], equal_nan=True), path
        unit = 'ns' if float(words[0][0]) > 1e17 else 's'
        scale = 1 if unit == 'ns' else 10**9
        exact = [int(Decimal(row[0]) * scale) for row in words]
        # digits behind the nanoseconds are cut or rounded
        assert np.abs(rows.exact[0].nanoseconds(path, unit) - np.array(exact)).max() <= 1, path


@pytest.mark.parametrize(
    'number',
    [
        '0',
        '-0.0',
        '+1.5',
        '.5',
        '-.5',
        '5.',
        '1e-3',
        '-2.5E+4',
        '123456789.123456789123456789',
        '0.1',
        '0.30000000000000004',
        '9007199254740993',
        '1e22',
        '-9223372036854775808',
        '99999999999999999999',
        '0.000000000000000000000000001',
        '1e-320',
        '4.9e-324',
    ],
)
def test_a_number_is_the_float_nearest_to_its_text(tmp_path, number):
    value = rows_of(tmp_path, f'1 {number} 0 0 0 0 0 1\n').values[0, 1]
    assert value == float(number)
    assert np.signbit(value) == np.signbit(float(number)) or float(number) == 0


@pytest.mark.parametrize(
    ('stamp', 'unit', 'nanoseconds'),
    [
        ('1403715524.907143168', 's', 1403715524907143168),
        ('1403715524.9', 's', 1403715524900000000),
        ('1403715524', 's', 1403715524000000000),
        ('1403715524.90714316844', 's', 1403715524907143168),
        ('1.403638518077829599e+09', 's', 1403638518077829599),
        ('1403715524907143168', 'ns', 1403715524907143168),
        ('1403715524907143168.000000', 'ns', 1403715524907143168),
        ('1403715524907143.168', 'us', 1403715524907143168),
        ('1403715524907.143168', 'ms', 1403715524907143168),
        ('0', 's', 0),
        ('-1.5', 's', -1500000000),
        ('0.0000000005', 's', 1),
    ],
)
def test_stamps_keep_every_nanosecond(tmp_path, stamp, unit, nanoseconds):
    rows = rows_of(tmp_path, f'{stamp} 0 0 0 0 0 0 1\n')
    assert rows.exact[0].nanoseconds(tmp_path, unit).tolist() == [nanoseconds]


@pytest.mark.parametrize(
    'layout',
    [
        ROW.replace(' ', '\t') + '\n',
        ROW.replace(' ', ',') + ',\n',
        ROW.replace(' ', ' , ') + '\r\n',
        '\n\n  ' + ROW.replace(' ', '   ') + '  \n\n',
        '# a comment\n' + ROW + '\n# another\n',
        'timestamp tx ty tz qx qy qz qw\n' + ROW,
        '"t","x","y","z"\n' + ROW.replace(' ', ';') + '\n',
        '# a comment\r' + ROW + '\r',
        '# position of the drone, then its orientation\n' + ROW + '\n',
        '\ufeff# a comment\n' + ROW + '\n',
    ],
    ids=[
        'tabs',
        'trailing comma',
        'spaced commas',
        'blanks',
        'comments',
        'header',
        'semicolons',
        'carriage returns',
        'a sentence',
        'byte order mark',
    ],
)
def test_layouts_do_not_matter(tmp_path, layout):
    rows = rows_of(tmp_path, layout)
    assert rows.values[:, 1:].tolist() == [[0.1, -0.25, 3, 0, 0, 0, 1]]
    assert rows.exact[0].nanoseconds(tmp_path, 's').tolist() == [1403715524907143168]


def test_blocks_join_without_losing_a_row(tmp_path, monkeypatch):
    lines = [f'{k}.{k:03d} {k / 8} {-k} 0 0 0 0 1' for k in range(500)]
    whole = rows_of(tmp_path, '\n'.join(lines))
    for size in (1, 7, 64, 1000):
        monkeypatch.setattr(text, 'BLOCK_BYTES', size)
        pieces = rows_of(tmp_path, '\n'.join(lines))
        assert np.array_equal(pieces.values, whole.values)
        assert np.array_equal(pieces.exact[0].digits, whole.exact[0].digits)
    assert len(whole.values) == 500


@pytest.mark.parametrize(
    ('content', 'problem'),
    [
        ('', 'the file is empty'),
        ('\n \n', 'the file is empty'),
        ('# only\n# comments\n', 'no rows of numbers'),
        ('version https://git-lfs.github.com/spec/v1\n', 'git lfs pull'),
        (b'\x00\x01\x02', 'neither a text file nor a recording'),
        (f'{ROW}\n\n# note\n2 0 0 x 0 0 0 1\n', "line 4: 'x' is not a number"),
        (f'{ROW}\n2 0 0 0 0 0 1\n', 'line 2: 7 columns, but 8'),
        (f'{ROW}\n2 0 0 0 0 0 0 1 9\n', 'line 2: 9 columns, but 8'),
        (f'{ROW}\n1.2.3 0 0 0 0 0 0 1\n', "line 2: '1.2.3' has two decimal points"),
        ('1-2 0 0 0 0 0 0 1\n', "line 1: '1-2' is not a number"),
        (f'{ROW}\n1-2 - 5 0 0 0 0 1\n', "line 2: '1-2' is not a number"),
        (f'{ROW}\n1+2 . 5 0 0 0 0 1\n', "line 2: '1+2' is not a number"),
        (f'{ROW}\n1 nannan - 0 0 0 0 1\n', "line 2: 'nannan' is not a number"),
        (f'{ROW}\n1 1e-3-2 - 0 0 0 0 1\n', "line 2: '1e-3-2' is not a number"),
        ('- 0 0 0 0 0 0 1\n', "line 1: '-' is not a number"),
        ('1 0 0 0 0 0 0 0x10\n', "line 1: '0x10' is not a number"),
        ('1 0 0 0 0 0 0 1abc\n', "line 1: '1abc' is not a number"),
        ('1 0 0 0 0 0 0 1.5abc\n', "line 1: '1.5abc' is not a number"),
        ('1 0 0 0 0 0 0 \xe4\n', 'is not a number'),
        ('1e30 0 0 0 0 0 0 1\n', 'line 1: a stamp is too large'),
        (f'{ROW}\n# note\n99999999999999999999 0 0 0 0 0 0 1\n', 'line 3: a stamp is too large'),
        ('1,5 2,5 3,5 4,5 0,0 0,0 0,0 1,0\n', 'decimal commas'),
    ],
)
def test_what_is_no_trajectory_is_named_by_its_line(tmp_path, content, problem):
    with pytest.raises(ReadError) as caught:
        rows_of(tmp_path, content)
    assert problem in str(caught.value)
    assert 'trajectory.txt' in str(caught.value)


def test_a_line_far_into_a_large_file_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(text, 'BLOCK_BYTES', 256)
    lines = ['# header', *[ROW] * 99, '1 2 3', ROW]
    with pytest.raises(ReadError, match='line 101: 3 columns'):
        rows_of(tmp_path, '\n'.join(lines))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ReadError, match=r'nowhere.txt: No such file'):
        read_text(tmp_path / 'nowhere.txt')


def test_a_stamp_that_is_not_a_number_spoils_its_row_only(tmp_path):
    rows = rows_of(tmp_path, f'nan 1 2 3 0 0 0 1\n{ROW}\n')
    assert np.isnan(rows.values[0]).all()
    assert rows.values[1, 1:4].tolist() == [0.1, -0.25, 3]
    assert rows.exact[0].nanoseconds(tmp_path, 's').tolist() == [0, 1403715524907143168]


@pytest.mark.parametrize('gap', [',,', ', ,'])
def test_an_empty_field_is_a_number_that_is_missing_not_a_column(tmp_path, gap):
    rows = rows_of(tmp_path, f'1{gap}2,3,0,0,0,1,9\n{ROW.replace(" ", ",")},9\n')
    assert rows.values.shape == (2, 9)
    assert np.isnan(rows.values[0]).tolist() == [False, True, *[False] * 7]


def test_an_exponent_in_a_position_costs_no_stamp_a_nanosecond(tmp_path):
    rows = rows_of(tmp_path, '1403715524.907140123 1e-5 0 0 0 0 0 1\n')
    assert rows.exact[0].nanoseconds(tmp_path, 's').tolist() == [1403715524907140123]


def test_progress_is_reported_for_every_block(tmp_path, monkeypatch):
    monkeypatch.setattr(text, 'BLOCK_BYTES', 100)
    path = tmp_path / 'trajectory.txt'
    path.write_text(f'{ROW}\n' * 50)
    seen = []

    def progress(items, total):
        for item in items:
            seen.append(total)
            yield item

    assert len(read_text(path, progress).rows.values) == 50
    assert len(seen) == seen[0] > 5
