"""Figures that are suspicious come with their likely cause; healthy ones with nothing."""

from dataclasses import replace

import numpy as np
from periodic import periodic_run
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.hint import hint
from vio_eval_ros.simulation import simulate

FLIGHT = simulate(duration_s=40.0)
ESTIMATE, TRUTH = FLIGHT.estimate, FLIGHT.ground_truth
SPECS = {'estimate': 'my est.csv', 'ground_truth': 'gt.txt?stamps=ns'}


def hinted(estimate: Trajectory, truth: Trajectory = TRUTH, **options: object) -> str | None:
    config = EvaluationConfig(**options)
    evaluation = Evaluation(config)
    evaluation.add_ground_truth(truth)
    evaluation.add_estimate(estimate)
    evaluation.flush()
    summary = evaluation.summary()
    return hint(summary.pairs, summary.metrics, config, SPECS)


def with_rotations(rotations: np.ndarray) -> Trajectory:
    return replace(ESTIMATE, rotations=rotations)


FAULTS = {
    'quaternion_order': (
        with_rotations(ESTIMATE.rotations[:, [3, 0, 1, 2]]),
        "try --estimate 'my est.csv?quaternion=wxyz'",
    ),
    'quaternion_conjugated': (
        with_rotations(rotation.conjugate(ESTIMATE.rotations)),
        "try --estimate 'my est.csv?invert=rotation'",
    ),
    'sensor_rotation': (
        with_rotations(
            rotation.multiply(ESTIMATE.rotations, np.array([0.0, 0.0, 0.8**0.5, 0.2**0.5]))
        ),
        'try --estimate-to-body ',
    ),
    'scale': (replace(ESTIMATE, positions=3 * ESTIMATE.positions), 'try --alignment sim3'),
    'time_offset': (
        replace(ESTIMATE, stamps_ns=ESTIMATE.stamps_ns + 200_000_000),
        'try --time-offset-s -0.1999',
    ),
    'lever_arm': (
        replace(
            ESTIMATE,
            positions=ESTIMATE.positions
            + rotation.rotate(ESTIMATE.rotations, np.array([0.5, 0.2, 0.1])),
        ),
        'try --estimate-to-body -0.',
    ),
    'axes_swapped': (
        replace(ESTIMATE, positions=ESTIMATE.positions[:, [1, 0, 2]]),
        'diagnose says more',
    ),
}


@pytest.mark.parametrize('name', FAULTS)
def test_a_fault_that_one_cure_undoes_is_named_with_what_to_write(name):
    estimate, command = FAULTS[name]
    line = hinted(estimate)
    assert line is not None
    assert line.startswith(f'likely cause: {name} of the estimate: ')
    assert command in line


def test_the_unit_of_a_truth_is_stated_after_its_spec():
    line = hinted(ESTIMATE, replace(TRUTH, positions=1000 * TRUTH.positions))
    assert line is not None
    assert "try --ground-truth 'gt.txt?stamps=ns&unit=mm'" in line


def test_no_scale_is_hinted_at_where_the_alignment_removes_it():
    assert hinted(FAULTS['scale'][0], alignment='sim3') is None


@pytest.mark.parametrize('seed', range(6))
def test_nothing_is_said_of_healthy_runs(seed):
    flight = simulate(duration_s=30.0, seed=seed)
    assert hinted(flight.estimate, flight.ground_truth) is None
    run = periodic_run('ellipse', 'banked', seed)
    assert hinted(run.estimate, run.truth) is None


def test_nothing_is_said_of_a_few_pairs_or_of_two_unrelated_paths():
    assert hinted(ESTIMATE[:12]) is None
    assert hinted(ESTIMATE, periodic_run('lawnmower', 'spinning', 1).truth) is None
