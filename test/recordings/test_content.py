"""Text is read in whatever encoding, cells and line ends it was written."""

import codecs
from pathlib import Path

import numpy as np
import pytest

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.text import read_text, TextFile

ROWS = [f'{1700000000 + k}.500 {k / 8:.4f} -{k}.25 3 0 0 0 {1 - k / 1e4:.4f}' for k in range(30)]
TEXT = '# t x y z qx qy qz qw\n' + '\n'.join(ROWS) + '\n'
VALUES = np.array([row.split() for row in ROWS], float)


def read(tmp_path: Path, content: bytes | str) -> TextFile:
    path = tmp_path / 'trajectory.txt'
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_text(path)


def problem(tmp_path: Path, content: bytes | str) -> str:
    with pytest.raises(ReadError) as caught:
        read(tmp_path, content)
    return caught.value.problem


@pytest.mark.parametrize(
    'encoding',
    ['utf-8-sig', 'utf-16', 'utf-16-le', 'utf-16-be', 'utf-32', 'latin-1', 'cp1252'],
)
@pytest.mark.parametrize('end', ['\n', '\r\n', '\r'])
def test_encodings_and_line_ends_do_not_matter(tmp_path, encoding, end):
    file = read(tmp_path, TEXT.replace('\n', end).encode(encoding))
    np.testing.assert_array_equal(file.rows.values, VALUES)
    assert file.header.strip() == b'# t x y z qx qy qz qw'
    assert file.notes == ()


@pytest.mark.parametrize('mark', [codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE])
def test_the_mark_says_the_order_of_bytes(tmp_path, mark):
    encoding = 'utf-16-be' if len(mark) == 2 else 'utf-32-be'
    np.testing.assert_array_equal(read(tmp_path, mark + TEXT.encode(encoding)).rows.values, VALUES)


@pytest.mark.parametrize('separator', [',', ';', '\t', ' '])
@pytest.mark.parametrize('quote', ['"', "'"])
def test_quotes_around_cells_do_not_matter(tmp_path, separator, quote):
    head, *lines = TEXT.removeprefix('# ').splitlines()
    cells = [separator.join(f'{quote}{cell}{quote}' for cell in line.split()) for line in lines]
    cells.insert(0, separator.join(f'"{name}"' for name in head.split()))
    file = read(tmp_path, '\n'.join(cells))
    np.testing.assert_array_equal(file.rows.values, VALUES)
    assert file.header.strip() == separator.join('t x y z qx qy qz qw'.split()).encode()


@pytest.mark.parametrize('separator', [';', '\t', ' ', '; ', ','])
@pytest.mark.parametrize('quote', ['', '"'])
@pytest.mark.parametrize('first', ['1700000000,5', '7'])
def test_decimal_commas_are_refused_by_name(tmp_path, separator, quote, first):
    if separator == ',' and not quote:
        return  # nothing tells these commas apart
    cells = (first, '0,25', '-1,5', '3', '0', '0', '0', '1,0')
    row = separator.join(f'{quote}{cell}{quote}' for cell in cells)
    assert 'decimal commas' in problem(tmp_path, f'header\n{row}\n{row}\n')


def test_commas_that_separate_are_no_decimal_commas(tmp_path):
    for separator in (',', ', ', ' , ', ',\t'):
        rows = [separator.join(row.split()) for row in ROWS]
        np.testing.assert_array_equal(read(tmp_path, '\n'.join(rows)).rows.values, VALUES)


@pytest.mark.parametrize('cut', [1, 2, 5, 6, 10, 30])
def test_a_last_line_that_is_cut_is_left_out_and_said(tmp_path, cut):
    file = read(tmp_path, TEXT[: -1 - cut])
    np.testing.assert_array_equal(file.rows.values, VALUES[:-1])
    (note,) = file.notes
    assert 'line 31, the last, is cut off and left out' in note


@pytest.mark.parametrize('last', ['1', '0.9', '0.12345678'])
def test_a_last_line_without_an_end_is_kept_where_decimals_vary(tmp_path, last):
    rows = [f'{row}{k % 3}'[: -1 if k % 2 else None] for k, row in enumerate(ROWS)]
    rows[-1] = rows[-1].rsplit(' ', 1)[0] + f' {last}'
    file = read(tmp_path, '\n'.join(rows))
    assert file.rows.values[-1, -1] == float(last)
    assert file.notes == ()


def test_a_line_that_is_cut_elsewhere_is_an_error(tmp_path):
    lines = TEXT.splitlines()
    lines[12] = lines[12][:25]
    assert 'line 13: 3 columns, but 8' in problem(tmp_path, '\n'.join(lines) + '\n')
    assert 'line 31: 5 columns, but 8' in problem(tmp_path, TEXT[:-12] + '\n')


def test_null_bytes_at_the_end_are_left_out_and_said(tmp_path):
    file = read(tmp_path, TEXT.encode() + bytes(4000))
    np.testing.assert_array_equal(file.rows.values, VALUES)
    assert '4,000 null bytes at its end' in file.notes[0]
    cut = read(tmp_path, TEXT.encode()[:-20] + bytes(40))
    np.testing.assert_array_equal(cut.rows.values, VALUES[:-1])
    assert len(cut.notes) == 2


def test_null_bytes_elsewhere_are_refused(tmp_path):
    long = '\n'.join(ROWS * 4).encode()
    assert 'line 121 has null bytes' in problem(tmp_path, long + b'\n1' + bytes(9) + long)
    assert 'null bytes only' in problem(tmp_path, bytes(5000))
    assert 'neither a text file' in problem(tmp_path, b'1 2 3\0\0 4 5\n' + TEXT.encode())


def test_half_a_character_of_utf_16_is_a_line_that_is_cut(tmp_path):
    file = read(tmp_path, TEXT.encode('utf-16')[:-5])
    np.testing.assert_array_equal(file.rows.values, VALUES[:-1])
    assert len(file.notes) == 1
    assert 'not valid UTF-16' in problem(tmp_path, codecs.BOM_UTF16_LE + b'1\0\x00\xd8\n\0')
