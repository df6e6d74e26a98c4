"""What the tests of the core share: made-up runs, evaluating them, how Hypothesis searches."""

from collections.abc import Callable
import os

from hypothesis import settings
import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation, Summary
from vio_eval_ros.core.trajectory import Poses, Trajectory

IN_CI = bool(os.environ.get('CI')) or os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1'
TODAY_NS = 1_403_636_579_763_555_584  # far beyond what a float64 of seconds resolves

# Where a failure stops others it must come back: always the same examples.
settings.register_profile('core', deadline=None, max_examples=60)
settings.register_profile('core-ci', settings.get_profile('core'), derandomize=True, database=None)
settings.load_profile('core-ci' if IN_CI else 'core')


def wander(stamps_ns: np.ndarray, seed: int = 0) -> Trajectory:
    """Return a body that wanders about: on no line, in no plane, at no constant speed."""
    rng = np.random.default_rng(seed)
    shape = (len(stamps_ns), 3)
    return Trajectory(
        np.asarray(stamps_ns, np.int64),
        rng.normal(0, 0.3, shape).cumsum(axis=0),
        rotation.from_rotation_vector(rng.normal(0, 0.05, shape).cumsum(axis=0)),
    )


@pytest.fixture(scope='session')
def wandering() -> Callable[..., Trajectory]:
    """Return a function from stamps and a seed to a body that wanders about."""
    return wander


@pytest.fixture(scope='session')
def flight() -> Trajectory:
    """Return some 20 s of ground truth at uneven intervals around 50 ms."""
    rng = np.random.default_rng(7)
    return wander(TODAY_NS + rng.integers(40_000_000, 60_000_000, 400).cumsum())


@pytest.fixture(scope='session')
def estimated() -> Callable[..., Trajectory]:
    """
    Return a function from ground truth to an estimate of it.

    The estimate lives in a world of its own, at another scale, and is noisy in position,
    orientation and stamp.
    """

    def estimate(
        truth: Trajectory, seed: int = 1, metres: float = 0.1, radians: float = 0.03
    ) -> Trajectory:
        rng = np.random.default_rng(seed)
        shape = (len(truth), 3)
        world = rotation.from_rotation_vector(np.array([0.4, -0.3, 2.0]))
        noise = rotation.from_rotation_vector(rng.normal(0, radians, shape))
        positions = rotation.rotate(world, truth.positions + rng.normal(0, metres, shape))
        return Trajectory(
            truth.stamps_ns + rng.integers(-9_000_000, 9_000_000, len(truth)),
            1.1 * positions + [3.0, -4.0, 5.0],
            rotation.multiply(world, rotation.multiply(truth.rotations, noise)),
        )

    return estimate


@pytest.fixture(scope='session')
def evaluate() -> Callable[..., Summary]:
    """Return a function from estimate, ground truth and options to what the evaluation finds."""

    def summary(estimate: Poses, ground_truth: Poses, **options: object) -> Summary:
        evaluation = Evaluation(EvaluationConfig(**options))
        evaluation.add_estimate(estimate)
        evaluation.add_ground_truth(ground_truth)
        evaluation.flush()
        return evaluation.summary()

    return summary
