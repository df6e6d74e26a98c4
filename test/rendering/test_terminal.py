"""What terminals show: colours only where they are wanted, and pictures made of characters."""

import io

import numpy as np
import pytest

from vio_eval_ros.rendering.terminal import BARS, drawn, painted, sparkline

RED, GREEN, OFF = '\x1b[1;31m', '\x1b[32m', '\x1b[0m'


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def colours_wanted(monkeypatch):
    monkeypatch.delenv('NO_COLOR', raising=False)
    monkeypatch.setenv('TERM', 'xterm')


def test_verdicts_are_coloured_at_either_end_of_a_line():
    text = 'fail  a<=1\nMH_01  0.1  pass\nthe gate did not fail here\nwarning: slow'
    assert painted(text, Terminal()) == (
        f'{RED}fail{OFF}  a<=1\nMH_01  0.1  {GREEN}pass{OFF}\nthe gate did not fail here\n'
        f'\x1b[33mwarning{OFF}: slow'
    )


@pytest.mark.parametrize('name', ['NO_COLOR', 'TERM'])
def test_who_wants_no_colour_gets_none(monkeypatch, name):
    monkeypatch.setenv(name, {'NO_COLOR': '1', 'TERM': 'dumb'}[name])
    assert painted('fail', Terminal()) == 'fail'


def test_files_and_pipes_get_no_colour():
    assert painted('fail', io.StringIO()) == 'fail'


def test_a_sparkline_has_the_largest_value_of_each_stretch_and_holes_for_none():
    at = np.array([0.0, 1, 2, 3, 8, 9])
    line = sparkline(at, np.array([0.0, 7, 3.5, 7, np.nan, 0]), width=9)
    assert len(line) == 9
    assert line[:4] == f'{BARS[0]}{BARS[7]}{BARS[4]}{BARS[7]}'
    assert line[4:8] == '    '
    assert line[8] == BARS[0]
    assert sparkline(at[:1], np.array([np.nan]), width=3) == '   '
    assert sparkline(at[:1], np.array([2.0]), width=3) == f'{BARS[7]}  '


@pytest.mark.parametrize('terminal', [('200', '50'), ('30', '10')])
def test_paths_have_one_scale_for_both_axes(terminal, monkeypatch):
    for name, size in zip(('COLUMNS', 'LINES'), terminal, strict=True):
        monkeypatch.setenv(name, size)
    turn = np.linspace(0, 2 * np.pi, 400)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rows = [line for line in drawn({'a': circle}, ['x [m]', 'y [m]']).splitlines() if '│' in line]
    inked = [line for line in rows if any('⠁' <= c <= '⣿' for c in line)]
    columns = {k for line in inked for k, c in enumerate(line) if '⠁' <= c <= '⣿'}
    wide, high = (max(columns) - min(columns) + 1) * 2, len(inked) * 4
    assert wide == pytest.approx(high, rel=0.15)
    assert '\x1b' not in ''.join(rows)
