"""Figures that are suspicious come with their likely cause; healthy ones with nothing."""

from collections.abc import Callable
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


def hinted(
    estimate: Trajectory,
    truth: Trajectory = TRUTH,
    specs: dict[str, str] = SPECS,
    received: Callable[[], tuple[Trajectory, Trajectory]] | None = None,
    **options: object,
) -> str | None:
    config = EvaluationConfig(**options)
    evaluation = Evaluation(config)
    evaluation.add_ground_truth(truth)
    evaluation.add_estimate(estimate)
    evaluation.flush()
    summary = evaluation.summary()
    return hint(summary.pairs, summary.metrics, config, specs, received)


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
    assert line.startswith(
        f'likely cause: {name} of the estimate (or, if that is right, of the ground truth): '
    )
    assert command in line


@pytest.mark.parametrize('turned', [(0.0, 0.0, 0.0, 1.0), (0.5, -0.5, 0.5, -0.5)])
@pytest.mark.parametrize('inverted', ['the estimate', 'the ground truth'])
def test_neither_side_is_acquitted_of_what_is_between_them(turned, inverted):
    # where an estimate is of a camera, the motion does not show which of the sides is inverse
    camera = with_rotations(rotation.multiply(ESTIMATE.rotations, np.array(turned)))
    sides = {'the estimate': camera, 'the ground truth': TRUTH}
    back = rotation.conjugate(sides[inverted].rotations)
    positions = -rotation.rotate(back, sides[inverted].positions)
    sides[inverted] = replace(sides[inverted], positions=positions, rotations=back)
    line = hinted(*sides.values())
    assert line is not None
    assert line.startswith('likely cause: pose_inverted of ')
    assert f'of {inverted} (' in line or f'of {inverted})' in line


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


def test_messages_and_arrays_are_not_told_to_state_an_order():
    estimate, _ = FAULTS['quaternion_order']
    for specs in ({'estimate': 'run.bag:/odom'}, {}):
        line = hinted(estimate, specs=specs)
        assert line is not None
        assert line.startswith('likely cause: quaternion_order')
        assert line.endswith('; diagnose says more')


@pytest.mark.parametrize('oriented', [True, False])
def test_clocks_that_are_seconds_apart_are_found_where_the_run_lasts_longer(oriented):
    late = replace(ESTIMATE, stamps_ns=ESTIMATE.stamps_ns + 25 * 10**9)
    late = late if oriented else replace(late, rotations=None)
    line = hinted(late, received=lambda: (late, TRUTH))
    assert line is not None
    assert line.startswith('likely cause: time_offset of the estimate')
    assert 'try --time-offset-s -25.0' in line or 'try --time-offset-s -24.9' in line
    assert hinted(ESTIMATE, received=lambda: (ESTIMATE, TRUTH)) is None
