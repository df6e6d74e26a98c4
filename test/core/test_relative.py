"""Pairs that are a delta apart are found as they are defined."""

from itertools import pairwise
import math

from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.core.config import Delta, EvaluationConfig, RPE_PAIRS
from vio_eval_ros.core.relative import candidates, progress_along, relative_errors
from vio_eval_ros.core.trajectory import Pairs, Trajectory


def _along(unit: str, steps: list[int]) -> np.ndarray:
    """Return how far poses are along after steps of 1/32 of a delta of 1 (1/20 of a second)."""
    if unit == 'f':
        return np.arange(len(steps))
    along = np.cumsum(steps) - steps[0]
    return along * 50_000_000 if unit == 's' else along / 32


def _brute_force(along: np.ndarray, step: float, mode: str, exact: bool) -> list[tuple[int, int]]:
    def nearest(place):
        return int(np.argmin(np.abs(along - place)))  # the first of those as near

    def near_enough(i, j):
        return j > i and 10 * abs(along[j] - along[i] - step) <= (0 if exact else step)

    if mode == 'all':
        motions = [(i, nearest(along[i] + step)) for i in range(len(along))]
    else:
        poses = [nearest(mark * step) for mark in range(int(along[-1] / step) + 2)]
        motions = list(pairwise(poses))
    return [pair for pair in motions if near_enough(*pair)]


@given(
    st.sampled_from('fsmd'),
    st.sampled_from(RPE_PAIRS),
    st.lists(st.sampled_from([0, 1, 9, 15, 16, 17, 20, 22, 32, 48]), min_size=1, max_size=40),
    st.integers(1, 3),
)
@example('s', 'sequential', [0, 20, 20, 30, 20, 20, 20, 20], 1).via('1 Hz, shifted by half a step')
@example('m', 'all', [0, 9, 9, 9, 0, 0, 9], 1).via('standing still just before the place')
@settings(max_examples=200)
def test_motions_lead_to_the_first_pose_nearest_to_a_delta_further(unit, mode, steps, delta):
    along = _along(unit, steps)
    found = candidates(along, Delta(float(delta), unit), EvaluationConfig(rpe_pairs=mode))
    step = delta * 1_000_000_000 if unit == 's' else delta
    motions = zip(
        found.begin[found.usable].tolist(), found.end[found.usable].tolist(), strict=True
    )
    assert list(motions) == _brute_force(along, step, mode, exact=unit == 'f')


def test_deltas_are_measured_along_the_ground_truth_and_the_stamps_of_the_estimate(
    flight, estimated, evaluate
):
    pairs = evaluate(estimated(flight), flight).pairs
    estimate, truth = pairs.estimate, pairs.ground_truth
    path, rotated = [0.0], [0.0]
    for i in range(1, len(truth)):
        path.append(path[-1] + math.dist(truth.positions[i], truth.positions[i - 1]))
        between = rotation.multiply(rotation.conjugate(truth.rotations[i - 1]), truth.rotations[i])
        rotated.append(
            rotated[-1] + math.degrees(np.linalg.norm(rotation.to_rotation_vector(between)))
        )
    np.testing.assert_array_equal(progress_along(pairs, 'f'), np.arange(len(truth)))
    np.testing.assert_array_equal(
        progress_along(pairs, 's'), estimate.stamps_ns - estimate.stamps_ns[0]
    )
    np.testing.assert_allclose(progress_along(pairs, 'm'), path, rtol=1e-12)
    np.testing.assert_allclose(progress_along(pairs, 'd'), rotated, rtol=1e-12)


def test_an_error_at_one_pair_is_in_the_two_motions_that_meet_there():
    stamps, positions = np.arange(5), np.outer(np.arange(5.0), [1, 0, 0])
    rotations = np.tile([0.0, 0, 0, 1], (5, 1))
    off = positions.copy()
    off[2, 1] = 0.5
    pairs = Pairs.of(Trajectory(stamps, off, rotations), Trajectory(stamps, positions, rotations))
    steps = np.arange(4)
    pose, angle, displacement, distance = relative_errors(
        pairs, steps, steps + 1, Alignment('none', 1.0, rotation.IDENTITY, np.zeros(3))
    )
    assert pose.tolist() == displacement.tolist() == [0, 0.5, 0.5, 0]
    assert angle.tolist() == [0, 0, 0, 0]
    np.testing.assert_allclose(distance, [0, np.hypot(1, 0.5) - 1, np.hypot(1, 0.5) - 1, 0])
