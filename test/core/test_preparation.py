"""Poses of one side become comparable with those of the other."""

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.cleaning import Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError

LEFT = rotation.about_z(np.array(np.pi / 2))
POSES = Poses(
    np.array([3, 1, 1]), np.array([[3.0, 0, 0], [1, 0, 0], [9, 0, 0]]), np.tile(LEFT, (3, 1))
)
CONFIG = EvaluationConfig(
    time_offset_s=1e-9,
    estimate_to_body=(2, 0, 0, 0, 0, 0, 1),
    ground_truth_to_body=(0, 0, 0, *LEFT),
)


def test_the_estimate_is_cleaned_shifted_and_moved_to_the_body():
    counts = Cleaning()
    prepared = Preparation.of_estimate(CONFIG).apply(POSES, counts)
    assert prepared.stamps_ns.tolist() == [2, 4]
    np.testing.assert_allclose(prepared.positions, [[1, 2, 0], [3, 2, 0]], atol=1e-15)
    assert (counts.duplicate, counts.went_backwards) == (1, 2)


def test_the_ground_truth_keeps_its_stamps_and_has_a_frame_of_its_own():
    prepared = Preparation.of_ground_truth(CONFIG).apply(POSES)
    assert prepared.stamps_ns.tolist() == [1, 3]
    assert prepared.positions.tolist() == [[1, 0, 0], [3, 0, 0]]
    np.testing.assert_allclose(rotation.angle(prepared.rotations), np.pi)


def test_what_is_older_than_earlier_batches_went_backwards():
    counts = Cleaning()
    Preparation.of_estimate(CONFIG).apply(POSES[:1], counts, newest_ns=4)
    assert counts.went_backwards == 0  # 3 is 4 on the common clock
    Preparation.of_estimate(CONFIG).apply(POSES[:1], counts, newest_ns=5)
    assert counts.went_backwards == 1


def test_positions_alone_cannot_be_moved_but_none_at_all_can():
    positions = Poses(POSES.stamps_ns, POSES.positions)
    with pytest.raises(ConfigError, match='without orientation'):
        Preparation.of_estimate(CONFIG).apply(positions)
    assert len(Preparation.of_estimate(CONFIG).apply(positions[:0])) == 0


def test_a_lever_arm_makes_the_covariance_of_the_position_unknown():
    covariances = np.tile(np.eye(3), (3, 2, 1, 1))
    poses = Poses(POSES.stamps_ns, POSES.positions, POSES.rotations, covariances)
    prepared = Preparation.of_estimate(CONFIG).apply(poses)
    assert np.isnan(prepared.covariances[:, 0]).all()
    assert np.isfinite(prepared.covariances[:, 1]).all()
    assert np.isfinite(covariances).all()
