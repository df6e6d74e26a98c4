"""What is done to a trajectory on its way to another format."""

import numpy as np

from vio_eval_ros.conversion.changes import in_order
from vio_eval_ros.core.cleaning import Cleaning
from vio_eval_ros.core.trajectory import Poses


def test_every_pose_keeps_its_own_quaternion_with_every_digit():
    source = np.random.default_rng(1)
    rotations = source.normal(size=(8, 4)) * 1.0001
    positions = source.normal(size=(8, 3))
    stamps_ns = np.array([5, 1, 0, 2, 2, 3, 4, 6]) * 10**9
    positions[5, 1] = np.nan
    rotations[6] = 0.0
    counts = Cleaning()
    kept = in_order(Poses(stamps_ns, positions, rotations, zero_is_unset=True), counts)
    rows = [1, 3, 0, 7]
    np.testing.assert_array_equal(kept.stamps_ns, stamps_ns[rows])
    np.testing.assert_array_equal(kept.positions, positions[rows])
    np.testing.assert_array_equal(kept.rotations, rotations[rows])
    assert kept.weights is None
    assert (counts.zero_stamp, counts.duplicate, counts.non_finite) == (1, 1, 1)
    assert counts.zero_quaternion == 1
