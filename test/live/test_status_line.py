"""The lines of a running evaluation on a terminal, and what becomes of them there."""

from collections.abc import Iterator
from contextlib import contextmanager
import fcntl
import io
import math
import os
import struct
import termios

import pytest

from vio_eval_ros.live.health import Level, Status
from vio_eval_ros.live.status_line import (
    DEFAULT_FORMAT,
    ERASE,
    FORMAT,
    line,
    log_over_lines,
    StatusLines,
    width_of,
)

VALUES = {
    'pairs': 1200,
    'ate_trans_rmse_m': 0.076499,
    'ate_rot_rmse_deg': 1.45262,
    'rpe_1s_trans_rmse_m': 0.02748,
    'coverage_ratio': 0.9987,
}
OK = [Status('accuracy', Level.OK, 'running', {}), Status('streams', Level.OK, 'running', {})]
STALE = Status('streams', Level.STALE, 'nothing on /odom for 3 s', {})
WARN = Status('association', Level.WARN, 'only 80 % was tracked', {})
FIGURES = '1,200 pairs  ATE 0.0765 m 1.453 deg  RPE 1s 0.02748 m  coverage 99.9 %  '


@contextmanager
def terminal(columns: int) -> Iterator[tuple[int, io.TextIOWrapper]]:
    """Yield what is to be read of a terminal, and the terminal."""
    reader, writer = os.openpty()
    fcntl.ioctl(writer, termios.TIOCSWINSZ, struct.pack('HHHH', 24, columns, 0, 0))
    with os.fdopen(writer, 'w', encoding='utf-8') as stream:
        yield reader, stream
    os.close(reader)


def test_a_line_has_the_figures_and_how_it_is():
    assert line('', VALUES, OK, 200) == f'{FIGURES}OK'
    assert line('vins  ', VALUES, [*OK, STALE], 200) == (
        f'vins  {FIGURES}STALE streams: nothing on /odom for 3 s'
    )
    assert line('', VALUES, [*OK, WARN, STALE], 200).endswith(
        'WARN association: only 80 % was tracked'
    )


def test_before_there_are_pairs_the_room_is_for_the_reason():
    waiting = [
        Status('accuracy', Level.WARN, 'no pairs yet', {}),
        Status('association', Level.WARN, 'no pairs yet: no estimate yet', {}),
    ]
    assert line('', {}, waiting, 200) == '0 pairs  WARN association: no pairs yet: no estimate yet'


def test_what_is_not_known_is_a_dash():
    unaligned = VALUES | {'ate_trans_rmse_m': math.nan, 'ate_rot_rmse_deg': math.nan}
    assert line('', unaligned, OK, 200).startswith('1,200 pairs  ATE - m - deg  RPE 1s ')


@pytest.mark.parametrize('width', [1, 10, 75, 79, 80, 90])
def test_a_line_is_cut_to_the_width_with_and_without_colour(width):
    plain = line('', VALUES, [WARN], width)
    assert len(plain) <= width
    assert (f'{FIGURES}WARN association: only 80 % was tracked').startswith(plain.rstrip('…'))
    coloured = line('', VALUES, [WARN], width, in_colour=True)
    assert coloured.replace('\x1b[33m', '').replace('\x1b[0m', '') == plain


def test_names_cannot_move_the_cursor():
    hostile = Status('streams', Level.WARN, 'nobody publishes /\x1b[2J', {})
    assert '\x1b' not in line('\x1b[H', VALUES, [hostile], 200)


def test_lines_are_drawn_in_place_and_leave_the_cursor_at_their_beginning(monkeypatch):
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.setenv('NO_COLOR', '1')
    with terminal(81) as (reader, stream):
        assert width_of(stream) == 81
        lines = StatusLines(stream)
        lines.draw([('vins', VALUES, OK), ('openvins', VALUES, [WARN])])
        lines.clear()
        written = ''
        while not written.endswith(ERASE):
            written += os.read(reader, 10_000).decode()
    first, second = (
        line(name, VALUES, health, 80)
        for name, health in (('vins      ', OK), ('openvins  ', [WARN]))
    )
    assert written == f'{first}\x1b[K\r\n{second}\x1b[K\x1b[1A\r{ERASE}'


def test_colours_are_those_of_verdicts(monkeypatch):
    monkeypatch.setenv('TERM', 'xterm')
    monkeypatch.delenv('NO_COLOR', raising=False)
    with terminal(200) as (reader, stream):
        StatusLines(stream).draw([('', VALUES, [WARN])])
        written = os.read(reader, 10_000).decode()
    assert written == f'{FIGURES}\x1b[33mWARN\x1b[0m association: only 80 % was tracked\x1b[K\r'


def test_what_is_no_terminal_or_takes_no_codes_has_no_width(monkeypatch):
    monkeypatch.setenv('TERM', 'xterm')
    assert width_of(io.StringIO()) == 0
    with terminal(0) as (_, stream):  # as launch files emulate it
        assert width_of(stream) == 0
    with terminal(80) as (_, stream):
        assert width_of(stream) == 80
        monkeypatch.setenv('TERM', 'dumb')
        assert width_of(stream) == 0


@pytest.mark.parametrize('given', ['', '[{severity}]: {message}'])
def test_logs_erase_the_lines_in_the_format_that_was_asked_for(given):
    environment = {FORMAT: given} if given else {}
    for _ in range(2):  # the interpreter may be executed once more
        log_over_lines(environment)
        assert environment == {FORMAT: ERASE + (given or DEFAULT_FORMAT)}
