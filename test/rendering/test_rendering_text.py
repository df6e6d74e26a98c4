"""Numbers and names as text, and trajectories as TUM files."""

import math
import subprocess
import sys

import numpy as np
import pytest

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.rendering.text import escaped, number, percent, printable
from vio_eval_ros.rendering.tum import tum


def test_the_text_of_errors_is_written_without_numpy():
    code = 'import sys, vio_eval_ros.rendering.text; sys.exit("numpy" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0


def test_numbers_have_four_digits_and_what_is_unknown_is_a_dash():
    assert [number(v) for v in (0.0123456, 12345.6, 0.0, math.nan)] == [
        '0.01235', '1.235e+04', '0', '-'
    ]  # fmt: skip
    assert [percent(v) for v in (0.98765, math.nan)] == ['98.8 %', '-']


def test_names_can_neither_move_a_cursor_nor_become_markup():
    assert printable('a\x1b[2J\nb') == 'a?[2J?b'
    assert escaped('<b>|`x`') == '\\<b\\>\\|\\`x\\`'
    assert escaped('https://example.org') == 'https\\://example.org'


def test_a_tum_file_has_every_digit_of_a_stamp_and_refuses_positions_alone():
    stamps = np.array([-1, 1_403_636_579_763_555_584])
    rotations = np.array([[0.0, 0, 0, 1]] * 2)
    rows = tum(Trajectory(stamps, np.ones((2, 3)), rotations)).splitlines()
    assert rows[0] == '# timestamp tx ty tz qx qy qz qw'
    assert rows[1].startswith('-0.000000001 1.000000000 ')
    assert rows[2].startswith('1403636579.763555584 1.000000000 ')
    with pytest.raises(ConfigError, match='a TUM file needs orientations'):
        tum(Trajectory(stamps, np.ones((2, 3))))
