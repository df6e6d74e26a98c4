"""
Whatever a text file looks like, its poses are read right, or it is said that they may not be.

A known motion is written with its columns in any order, named or not, in any unit and encoding.
Evaluating that file either fails, or warns, or gives every figure of the motion itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from pathlib import Path
import re
from typing import Any
import warnings

from hypothesis import assume, event, given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros import evaluate, trajectory
from vio_eval_ros.core import rotation
from vio_eval_ros.errors import VioEvalError

COUNT, PERIOD_NS = 120, 100_000_000
#: relative, and the floor of the text's precision
TOLERANCE = 1e-6
#: how many examples are tried, the same ones each time
EXAMPLES = 200
#: of these, at least so many are to be read right without a word
LEAST_READ = 0.15
#: what a warning that explains other figures speaks of, where it does not name the file
ABOUT = re.compile(r'scale|unit|convention|orientation|rotation|clock|stamps', re.IGNORECASE)
FIGURES = ('ate_', 'rpe_', 'path_length_m', 'drift_percent', 'sim3_scale')

NAMES: dict[str, tuple[str, ...]] = {
    't': ('t', 'time', 'timestamp', 'stamp', 'header.stamp', '#timestamp', '%time', 'Timestamp'),
    'x': ('x', 'tx', 'p_x', 'pos_x', 'position.x', 'pose.position.x', 'p_RS_R_x', 'X', 'px'),
    'qx': ('qx', 'q_x', 'quat_x', 'orientation.x', 'pose.orientation.x', 'q_RS_x', 'QX'),
    'roll': ('roll', 'Roll'),
    'r11': ('r11', 'R11', 'm11'),
    'rx': ('rvec_x', 'rotvec_x'),
}
EXTRAS = ('vx', 'v_y', 'bg_x', 'b_a_z', 'confidence', 'num_features', 'std_x', 'error', 'flag')
POSITION, QUATERNION, EULER = ('x', 'y', 'z'), ('qx', 'qy', 'qz', 'qw'), ('roll', 'pitch', 'yaw')
MATRIX = tuple(f'r{row}{column}' for row in '123' for column in '123')
VECTOR = ('rx', 'ry', 'rz')
STAMP_UNITS = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}
LENGTH_UNITS = {'m': 1.0, 'mm': 1e3, 'cm': 1e2}


@dataclass
class Motion:
    """A smooth motion, and an estimate of it."""

    stamps_ns: np.ndarray
    truth: tuple[np.ndarray, np.ndarray]
    estimate: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, seed: int, start_s: int, turns: float) -> Motion:
        """Return a motion with a scale of its rotations [rad]."""
        random = np.random.default_rng(seed)
        stamps_ns = start_s * 10**9 + np.arange(COUNT) * PERIOD_NS
        stamps_ns += random.integers(-20, 20, COUNT) * 10**6 * (np.arange(COUNT) > 0)
        t = np.arange(COUNT)[:, None] / 10
        rates, phases = random.uniform(0.2, 0.9, (3, 6)), random.uniform(0, 6.28, (3, 6))
        waves = np.sin(rates[None] * t[:, :, None] + phases).sum(axis=1)
        positions = waves[:, :3] * [2, 1.5, 0.5] + t * random.uniform(0.1, 0.4, 3)
        start = rotation.normalize(random.normal(size=(1, 4)) * [turns, turns, turns, 1])
        rotations = rotation.multiply(
            start, rotation.from_rotation_vector(waves[:, 3:] * turns / 2)
        )
        noise = rotation.from_rotation_vector(random.normal(0, 0.01, (COUNT, 3)))
        estimate = (
            positions + random.normal(0, 0.02, (COUNT, 3)),
            rotation.multiply(rotations, noise),
        )
        return cls(stamps_ns, (positions, rotations), estimate)


@dataclass
class Text:
    """How poses are written."""

    kind: tuple[str, ...]
    order: list[str]
    stamps: str = 's'
    length: str = 'm'
    degrees: bool = False
    names: dict[str, str] | None = None
    units: bool = False
    separator: str = ' '
    end: str = '\n'
    encoding: str = 'utf-8'
    quoted: bool = False
    comment: str = ''
    tail: str = ''
    decimals: int = 9
    has_flips: bool = False
    extras: list[str] = field(default_factory=list)

    def columns(
        self, motion: Motion, poses: tuple[np.ndarray, np.ndarray]
    ) -> dict[str, list[str]]:
        """Return the cells of each column by its role."""
        positions, rotations = poses
        random = np.random.default_rng(0)
        if self.has_flips:
            rotations = rotations * random.choice([-1, 1], (COUNT, 1))
        found: dict[str, list[str]] = {}
        stamps = motion.stamps_ns.tolist()
        if self.stamps == 'sec nsec':
            found['sec'] = [str(stamp // 10**9) for stamp in stamps]
            found['nsec'] = [str(stamp % 10**9) for stamp in stamps]
        elif self.stamps == 's':
            found['t'] = [f'{stamp // 10**9}.{stamp % 10**9:09d}' for stamp in stamps]
        elif self.stamps != 'none':
            found['t'] = [str(stamp // STAMP_UNITS[self.stamps]) for stamp in stamps]
        values = dict(zip(POSITION, positions.T * LENGTH_UNITS[self.length], strict=True))
        matrices = rotation.to_matrix(rotations)
        values |= zip(QUATERNION, rotations.T, strict=True)
        values |= zip(MATRIX, matrices.reshape(-1, 9).T, strict=True)
        pitch = np.arcsin(np.clip(-matrices[:, 2, 0], -1, 1))
        roll = np.arctan2(matrices[:, 2, 1], matrices[:, 2, 2])
        yaw = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
        angles = np.stack([roll, pitch, yaw]), rotation.to_rotation_vector(rotations).T
        scale = 180 / np.pi if self.degrees else 1.0
        values |= zip((*EULER, *VECTOR), np.concatenate(angles) * scale, strict=True)
        for role, column in values.items():
            found[role] = [f'{value:.{self.decimals}f}' for value in column]
        for name in EXTRAS:
            found[name] = [f'{value:.4f}' for value in random.normal(size=COUNT).cumsum()]
        found['frame'] = [str(k) for k in range(COUNT)]
        found['text'] = ['odom'] * COUNT
        return found

    def name(self, role: str) -> str:
        """Return what the header calls a column."""
        assert self.names is not None
        name = self.names.get(role, role)
        unit = ''
        if self.units and (role in POSITION or role == 't' or role in (*EULER, *VECTOR)):
            if role == 't':
                unit = self.stamps
            else:
                unit = self.length if role in POSITION else 'deg' if self.degrees else 'rad'
        return f'{name} [{unit}]' if unit else name

    def write(self, path: Path, motion: Motion, poses: tuple[np.ndarray, np.ndarray]) -> None:
        columns = self.columns(motion, poses)
        rows = [list(row) for row in zip(*(columns[role] for role in self.order), strict=True)]
        if self.names is not None:
            rows.insert(0, [self.name(role) for role in self.order])
        if self.quoted:
            rows = [[f'"{cell}"' for cell in row] for row in rows]
        lines = [self.separator.join(row) + self.tail for row in rows]
        if self.comment:
            lines.insert(0, self.comment)
        path.write_bytes((self.end.join(lines) + self.end).encode(self.encoding))


def named(draw: st.DrawFn, roles: list[str]) -> dict[str, str]:
    """Return names for roles, those of a vector spelled alike, as programs write them."""
    spelled = {'t': draw(st.sampled_from(NAMES['t'])), 'sec': 'sec', 'nsec': 'nanosec'}
    for first, roles_of in (
        ('x', POSITION), ('qx', QUATERNION), ('roll', EULER), ('r11', MATRIX), ('rx', VECTOR),
    ):  # fmt: skip
        pattern = draw(st.sampled_from(NAMES[first]))
        for role in roles_of:
            if first == 'r11':
                spelled[role] = pattern[:-2] + role[1:]
            elif first == 'roll':
                spelled[role] = role.capitalize() if pattern[0] == 'R' else role
            else:
                axis = role[-1].upper() if pattern[-1].isupper() else role[-1]
                spelled[role] = pattern[:-1] + axis
    return {role: spelled.get(role, role) for role in roles}


@st.composite
def texts(draw: st.DrawFn) -> Text:
    """Return any way to write poses."""
    kind = draw(st.sampled_from([QUATERNION, QUATERNION, QUATERNION, EULER, MATRIX, VECTOR, ()]))
    stamps = draw(st.sampled_from(['s', 's', 'ns', 'ns', 'us', 'ms', 'sec nsec', 'none']))
    first = {'none': [], 'sec nsec': ['sec', 'nsec']}.get(stamps, ['t'])
    extras = draw(st.lists(st.sampled_from(EXTRAS), max_size=3, unique=True))
    order = [*first, *POSITION, *kind, *extras]
    if kind == MATRIX and draw(st.booleans()):
        rows = [MATRIX[0:3], ['x'], MATRIX[3:6], ['y'], MATRIX[6:9], ['z']]
        order = [*first, *(role for row in rows for role in row), *extras]
    if kind == QUATERNION and draw(st.booleans()):
        order = [*first, *POSITION, 'qw', 'qx', 'qy', 'qz', *extras]
    has_header = draw(st.booleans())
    if draw(st.integers(0, 3)) == 0:
        order = draw(st.permutations(order))
    for role in draw(st.sampled_from([[], [], [], ['frame'], ['text']])):
        order.insert(draw(st.sampled_from([0, len(order)])), role)
    separator = draw(st.sampled_from([' ', ',', ', ', ';', '\t', '   ']))
    is_blank = not separator.strip()
    end = draw(st.sampled_from(['\n', '\n', '\r\n', '\r']))
    return Text(
        kind=kind,
        order=order,
        stamps=stamps,
        length=draw(st.sampled_from(['m', 'm', 'm', 'mm', 'cm'])),
        degrees=draw(st.booleans()),
        names=named(draw, order) if has_header else None,
        units=has_header and not is_blank and draw(st.booleans()),
        separator=separator,
        end=end,
        encoding=draw(st.sampled_from(['utf-8', 'utf-8', 'utf-8-sig', 'utf-16', 'utf-16-le'])),
        quoted=not is_blank and draw(st.integers(0, 4)) == 0,
        comment=draw(st.sampled_from(['', '', '# written by a program', '# a, b'])),
        tail=draw(st.sampled_from(['', '', '', ',' if separator == ',' else ''])),
        has_flips=draw(st.booleans()),
    )


@st.composite
def blocks(draw: st.DrawFn) -> Text:
    """Return poses whose parts come in any order, without names."""
    kind = draw(st.sampled_from([QUATERNION, QUATERNION, EULER, MATRIX, VECTOR, ()]))
    turn = list(kind)
    if kind == QUATERNION and draw(st.booleans()):
        turn = ['qw', 'qx', 'qy', 'qz']
    if kind == MATRIX and draw(st.booleans()):  # column by column
        turn = [f'r{row}{column}' for column in '123' for row in '123']
    stamps = draw(st.sampled_from(['s', 's', 'ns', 'us', 'ms', 'sec nsec']))
    parts = [['sec', 'nsec'] if stamps == 'sec nsec' else ['t'], list(POSITION), turn]
    further = [['frame'], list(EXTRAS[:3]), ['confidence'], ['text']]
    parts += draw(st.lists(st.sampled_from(further), max_size=2, unique_by=tuple))
    return Text(
        kind=kind,
        order=[role for part in draw(st.permutations(parts)) for role in part],
        stamps=stamps,
        length=draw(st.sampled_from(['m', 'm', 'm', 'mm'])),
        degrees=draw(st.booleans()),
        separator=draw(st.sampled_from([' ', ',', ';', '\t'])),
        has_flips=draw(st.booleans()),
    )


def figures(result: Any) -> dict[str, float | None]:
    """Return the metrics that say how wrong a trajectory is."""
    return {name: value for name, value in result.metrics.items() if name.startswith(FIGURES)}


def is_equal(found: float | None, right: float | None) -> bool:
    """Return whether two figures are the same within the precision of the text."""
    if found is None or right is None or math.isnan(found) or math.isnan(right):
        return (found is None or math.isnan(found)) == (right is None or math.isnan(right))
    return abs(found - right) <= TOLERANCE * max(1.0, abs(right))


def statement(text: Text) -> str:
    """Return what says of each column what it is."""
    angle = 'deg' if text.degrees else 'rad'
    units = dict.fromkeys(POSITION, text.length) | dict.fromkeys((*EULER, *VECTOR), angle)
    units['t'] = text.stamps
    meant = ('sec', 'nsec', 't', *POSITION, *text.kind)
    columns = [
        '_' if role not in meant else f'{role}_{units[role]}' if role in units else role
        for role in text.order
    ]
    return '?columns=' + ','.join(columns)


def outcome(
    path: Path, text: Text, motion: Motion, is_estimate: bool, stated: str = ''
) -> tuple[str, str]:
    """Return what came of a file: 'refused', 'warned', 'right' or 'wrong', and the details."""
    sides = {'estimate': motion.estimate, 'ground_truth': motion.truth}
    written = 'estimate' if is_estimate else 'ground_truth'
    poses = {
        side: trajectory(motion.stamps_ns, p, q if text.kind or side != written else None)
        for side, (p, q) in sides.items()
    }
    right = evaluate(**poses)
    text.write(path, motion, sides[written])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error')
            result = evaluate(**poses | {written: f'{path}{stated}'})
    except VioEvalError as error:
        return 'refused', str(error)
    pairs = figures(result), figures(right)
    wrong = {
        name: (pairs[0][name], value)
        for name, value in pairs[1].items()
        if not is_equal(pairs[0][name], value)
    }
    if not wrong:
        return 'right', ''
    further = [one for one in result.warnings if one not in right.warnings]
    told = [one for one in further if str(path) in one or ABOUT.search(one)]
    return ('warned', told[0]) if told else ('wrong', f'{wrong} {further}')


SEARCH = settings(
    max_examples=EXAMPLES,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
)
MOTIONS = {
    'seed': st.integers(0, 9),
    'start_s': st.sampled_from([1_700_000_000, 1_700_000_000, 100, 0]),
    'turns': st.sampled_from([1.0, 1.0, 0.3, 0.05]),
}


@pytest.mark.slow
def test_any_layout_that_is_stated_is_read_right(tmp_path):
    @settings(SEARCH, max_examples=EXAMPLES // 3)
    @given(text=texts(), is_estimate=st.booleans(), **MOTIONS)
    def check(text: Text, is_estimate: bool, seed: int, start_s: int, turns: float) -> None:
        assume(text.stamps != 'none')
        path, motion = tmp_path / 'poses.txt', Motion.of(seed, start_s, turns)
        what, details = outcome(path, text, motion, is_estimate, statement(text))
        assert what == 'right', f'{details}\n{statement(text)}\n{path.read_bytes()[:400]!r}'

    check()


@pytest.mark.slow
@pytest.mark.parametrize(('written', 'least_read'), [(texts(), LEAST_READ), (blocks(), 0.03)])
def test_any_layout_is_read_right_or_not_in_silence(tmp_path, written, least_read):
    counts: dict[str, int] = {}

    @SEARCH
    @given(text=written, is_estimate=st.booleans(), **MOTIONS)
    def check(text: Text, is_estimate: bool, seed: int, start_s: int, turns: float) -> None:
        path = tmp_path / 'poses.txt'
        what, details = outcome(path, text, Motion.of(seed, start_s, turns), is_estimate)
        counts[what] = counts.get(what, 0) + 1
        event(what)
        assert what != 'wrong', f'{details}\n{path.read_bytes()[:400]!r}'

    check()
    assert counts.get('right', 0) > least_read * sum(counts.values()), counts
