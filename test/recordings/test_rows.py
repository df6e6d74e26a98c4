"""The unit of stamps follows from their size, and is the same in every reader."""

import numpy as np
import pytest

from vio_eval_ros.recordings.rows import parse, STAMP_UNITS


@pytest.mark.parametrize('unit', STAMP_UNITS)
@pytest.mark.parametrize('seconds', [1_403_715_524, 4_000_000_000])
def test_the_unit_of_stamps_shows_in_their_size(unit, seconds):
    stamp = seconds * 10 ** (9 - STAMP_UNITS[unit])
    rows = parse(f'{stamp} 1\n'.encode())
    assert rows is not None
    assert rows.exact[0].likely_unit == unit


def test_small_stamps_are_seconds():
    rows = parse(b'-12.5 1\n0 2\n')
    assert rows is not None
    assert rows.exact[0].likely_unit == 's'
    assert np.array_equal(rows.values, [[-12.5, 1], [0, 2]])


def test_a_block_of_comments_has_no_rows():
    assert parse(b'# a\n\n  % b\n') is None
