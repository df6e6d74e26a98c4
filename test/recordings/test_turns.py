"""What the columns of an orientation leave open is settled by the other side, or asked for."""

from pathlib import Path

import numpy as np
import pytest

from vio_eval_ros import evaluate, trajectory
from vio_eval_ros.core import rotation
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.rotation_columns import from_euler, unit_of_angles

COUNT = 300
T = np.arange(COUNT) / 10
STAMPS_NS = 1_700_000_000_000_000_000 + (np.arange(COUNT) * 100_000_000)
POSITIONS = np.stack([3 * np.sin(0.35 * T), 2.5 * np.cos(0.23 * T), 1 + 0.6 * np.sin(0.5 * T)], 1)
ROLL_PITCH_YAW = np.stack([0.25 * np.sin(0.7 * T), 0.2 * np.cos(0.9 * T), 0.5 * T], 1)
ROTATIONS = from_euler(ROLL_PITCH_YAW)
#: of a world that is turned about its vertical axis
TURN = from_euler(np.array([[0, 0, 0.6]]))
TRUTH = trajectory(STAMPS_NS, rotation.rotate(TURN, POSITIONS), rotation.multiply(TURN, ROTATIONS))
WHERE = trajectory(STAMPS_NS, POSITIONS)


def wrapped(angles: np.ndarray) -> np.ndarray:
    return (angles + np.pi) % (2 * np.pi) - np.pi


def write(path: Path, header: str, turns: np.ndarray) -> str:
    """Write poses under a header; ``turns`` is (N, C)."""
    rows = [
        f'{ns / 1e9:.3f},' + ','.join(f'{value:.9f}' for value in (*position, *turn))
        for ns, position, turn in zip(STAMPS_NS, POSITIONS, turns, strict=True)
    ]
    path.write_text('\n'.join([header, *rows]) + '\n')
    return str(path)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'poses.csv'


@pytest.mark.parametrize(
    ('header', 'turns', 'said'),
    [
        # radians that count turns
        ('yaw,pitch,roll', ROLL_PITCH_YAW[:, ::-1], 'yaw_rad,pitch_rad,roll_rad'),
        ('roll,pitch,yaw', np.degrees(ROLL_PITCH_YAW), 'degrees, as their range'),
        ('rx,ry,rz', rotation.to_rotation_vector(ROTATIONS), 'rx_rad,ry_rad,rz_rad'),
        ('rx,ry,rz', np.degrees(rotation.to_rotation_vector(ROTATIONS)), 'rx_deg,ry_deg'),
        ('angle_x,angle_y,angle_z', wrapped(ROLL_PITCH_YAW), 'roll_rad,pitch_rad,yaw_rad'),
        ('q0,q1,q2,q3', ROTATIONS, 'quaternion=xyzw'),
        ('q_0,q_1,q_2,q_3', ROTATIONS, 'quaternion=xyzw'),
        ('q3,q0,q1,q2', ROTATIONS[:, [3, 0, 1, 2]], 'quaternion=xyzw'),
        ('q4,q1,q2,q3', ROTATIONS[:, [3, 0, 1, 2]], 'quaternion=xyzw'),
    ],
)
def test_the_other_side_shows_what_angles_and_quaternions_are(path, header, turns, said):
    result = evaluate(write(path, f't,x,y,z,{header}', turns), TRUTH)
    assert said in result.warnings[0]
    assert result.metrics['rpe_1s_rot_rmse_deg'] == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize('header', ['yaw,pitch,roll', 'rx,ry,rz'])
def test_angles_that_nothing_settles_are_asked_for(path, header):
    rng = np.random.default_rng(0)
    other = trajectory(STAMPS_NS, POSITIONS, rotation.normalize(rng.normal(size=(COUNT, 4))))
    with pytest.raises(ReadError, match=r'the meaning of its angles .*_rad.* or .*_deg'):
        evaluate(write(path, f't,x,y,z,{header}', ROLL_PITCH_YAW[:, ::-1]), other)


def test_the_unit_of_angles_is_said_beside_positions_only(path):
    result = evaluate(write(path, 't,x,y,z,roll,pitch,yaw', ROLL_PITCH_YAW), WHERE)
    assert 'which nothing here confirms' in result.warnings[0]


@pytest.mark.parametrize('is_named', [True, False])
def test_matrices_by_columns_are_told_from_those_by_rows(path, is_named):
    cells = rotation.to_matrix(ROTATIONS).transpose(0, 2, 1).reshape(-1, 9)
    names = [f'r{row}{column}' for column in '123' for row in '123']
    spec = write(path, ','.join(['t', 'x', 'y', 'z', *names]), cells)
    if not is_named:
        path.write_text(path.read_text().partition('\n')[2])
    result = evaluate(spec, TRUTH)
    assert result.metrics['ate_rot_rmse_deg'] == pytest.approx(0, abs=1e-4)
    assert any('invert=rotation' in one for one in result.warnings) != is_named
    if not is_named:
        stated = evaluate(f'{spec}?invert=rotation', TRUTH)
        assert stated.metrics['ate_rot_rmse_deg'] == result.metrics['ate_rot_rmse_deg']
        assert not stated.warnings


def test_angles_without_names_are_asked_for(path):
    spec = write(path, '', ROLL_PITCH_YAW)
    path.write_text(path.read_text().lstrip())
    with pytest.raises(ReadError, match=r'append \?columns=t,x,y,z,roll_rad,pitch_rad,yaw_rad \('):
        evaluate(spec, TRUTH)
    result = evaluate(f'{spec}?columns=t,x,y,z,roll_rad,pitch_rad,yaw_rad', TRUTH)
    assert result.metrics['ate_rot_rmse_deg'] == pytest.approx(0, abs=1e-4)


def test_q0_is_the_real_part_where_nothing_shows_otherwise(path):
    result = evaluate(write(path, 't,x,y,z,q0,q1,q2,q3', ROTATIONS[:, [3, 0, 1, 2]]), TRUTH)
    assert result.metrics['ate_rot_rmse_deg'] == pytest.approx(0, abs=1e-4)
    assert not result.warnings


@pytest.mark.parametrize(
    ('angles', 'unit'),
    [
        (ROLL_PITCH_YAW, None),
        (np.degrees(ROLL_PITCH_YAW), 'deg'),
        (np.degrees(ROLL_PITCH_YAW * [1, 0.1, 1]), None),
        (np.degrees(wrapped(ROLL_PITCH_YAW * [1, 0.1, 1])), 'deg'),
        (np.degrees(ROLL_PITCH_YAW * [1, 0.1, 1]) % 360, 'deg'),
        (wrapped(ROLL_PITCH_YAW), 'rad'),
        (ROLL_PITCH_YAW % (2 * np.pi), 'rad'),
        (np.full((3, 3), np.nan), None),
    ],
)
def test_the_range_of_angles_shows_their_unit_or_does_not(angles, unit):
    assert unit_of_angles(angles) == unit
