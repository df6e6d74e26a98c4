"""A stream whose orientations say nothing carries positions only."""

import numpy as np
import pytest

from vio_eval_ros.core.orientations import (
    CONSTANT,
    Orientations,
    UNUSABLE,
    why_positions_only,
    with_known_orientations,
)
from vio_eval_ros.core.rotation import about_z
from vio_eval_ros.core.trajectory import Poses

TILTED = [0.1, -0.2, 0.3, 0.9]


def poses(rotations, step_m=1.0, origin=0.0):
    """Return poses on a straight line."""
    rotations = np.array(rotations, float)
    positions = origin + step_m * np.arange(len(rotations))[:, None] * np.ones(3)
    return Poses(np.arange(len(rotations)), positions, rotations)


@pytest.mark.parametrize(
    ('rotation', 'why'),
    [
        ([0, 0, 0, 1], CONSTANT),
        (TILTED, CONSTANT),
        ([0, 0, 0, 0], UNUSABLE),
        ([1e-9, 0, 0, 0], UNUSABLE),
        ([np.nan] * 4, UNUSABLE),
        ([0, 0, 0, np.inf], UNUSABLE),
    ],
)
@pytest.mark.parametrize('origin', [0.0, 4.5e6])
def test_orientations_that_say_nothing_are_left_out(rotation, why, origin):
    received = poses([rotation] * 5, origin=origin)
    assert why_positions_only(received) == why
    known = with_known_orientations(received)
    assert known.rotations is None
    assert known.positions is received.positions


def test_a_few_unusable_ones_do_not_hide_that_all_others_are_the_same():
    received = [TILTED, [0, 0, 0, 0], TILTED, [np.nan] * 4, -np.array(TILTED)]
    assert why_positions_only(poses(received)) == CONSTANT
    received[2] = [0, 0, 0, 1]
    assert why_positions_only(poses(received)) == ''


def test_a_body_that_turns_or_stands_still_has_orientations():
    turning = poses(about_z(np.array([0.0, 0, 0, 1e-6])))
    assert with_known_orientations(turning) is turning
    assert why_positions_only(poses([TILTED] * 4, step_m=0.0)) == ''
    assert why_positions_only(poses([TILTED])) == ''
    assert why_positions_only(poses(np.empty((0, 4)))) == ''
    assert why_positions_only(Poses(np.arange(2), np.ones((2, 3)))) == ''


def test_it_does_not_matter_in_which_batches_a_stream_arrives():
    turning = poses(about_z(np.array([0.0, 0, 0, 0.1])))
    orientations, constant = Orientations(), []
    for k in range(len(turning)):
        orientations.add(turning[k : k + 1])
        constant.append(orientations.constant)
    assert constant == [False, True, True, False]
