"""Steps between positions: their lengths, their errors, and which of them are jumps."""

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.steps import (
    distances,
    jump_limit,
    path_of_changed_steps,
    step_errors,
    step_lengths,
)

CORNER = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 2.0]])


def test_lengths_of_steps_add_up_to_distances_along_the_path():
    assert step_lengths(CORNER).tolist() == [5.0, 2.0]
    assert distances(CORNER).tolist() == [0.0, 5.0, 7.0]


def test_no_positions_have_no_steps_and_one_is_at_the_start():
    assert distances(CORNER[:0]).tolist() == []
    assert distances(CORNER[:1]).tolist() == [0.0]
    assert step_lengths(CORNER[:1]).tolist() == []


def test_steps_of_equal_length_in_other_directions_are_wrong():
    mirrored = CORNER * [1, -1, 1]
    assert step_errors(mirrored, CORNER).tolist() == [8.0, 0.0]
    assert step_errors(CORNER + 7, CORNER).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(('sizes', 'limit'), [([0.01, 0.01], 0.05), ([0.1, 0.1], 0.5)])
def test_a_jump_is_larger_than_the_least_and_than_most_steps(sizes, limit):
    assert jump_limit(np.array(sizes), least=0.05, times=5, quantile=0.95) == limit


def test_a_path_of_changed_steps_keeps_its_first_position():
    path = CORNER + 1
    left = rotation.about_z(np.full(3, np.pi / 2))
    changed = path_of_changed_steps(path, factors=np.array([2.0, 3.0, 1.0]), rotations=left)
    assert changed == pytest.approx(np.array([[1, 1, 1], [-7, 7, 1], [-7, 7, 7]]))
    assert path_of_changed_steps(path).tolist() == path.tolist()
