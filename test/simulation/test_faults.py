"""Each fault is what diagnose calls it, of the size that was asked for."""

from dataclasses import replace
import math
import re

import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.simulation import FAULTS, simulate, SimulatedRun
from vio_eval_ros.simulation.faults import inject, parse_fault

RUN = simulate()
# Sizes that a run of 60 s shows, and by how much what is found may be off.
WRITTEN = {
    'time_offset': ('=0.05', 5e-4),
    'clock_drift': ('=2000', 20),
    'scale': ('=1.1', 0.02),
    'scale_drift': ('=50', 5),
    'sensor_rotation': ('=10', 0.2),
    'lever_arm': ('=0.2', 0.01),
    'gravity_tilt': ('=5', 0.1),
    'yaw_drift': ('=20', 5),
    'jump': ('=0.5', 0.03),
    'outliers': ('=0.02,1', 1e-3),
    'lost_tracking': ('=0.2', 0.01),
    # the path bends before it is far off
    'diverged': ('=0.2,30', 0.1),
    'quaternion_order': ('=1', math.inf),
}


def harmed(*texts: str, run: SimulatedRun = RUN) -> SimulatedRun:
    source = np.random.default_rng(1)
    for text in texts:
        run = inject(run, *parse_fault(text), source)
    return run


def causes_of(run: SimulatedRun) -> list:
    return list(diagnose(run.estimate, run.ground_truth, EvaluationConfig()).causes)


def test_there_is_a_fault_for_every_cause():
    assert set(FAULTS) == set(CAUSES)


@pytest.mark.slow
@pytest.mark.parametrize('name', FAULTS)
def test_diagnose_names_each_fault_and_its_size(name):
    size, off = WRITTEN.get(name, ('', math.inf))
    causes = causes_of(harmed(f'{name}{size}'))
    assert [cause.name for cause in causes] == [name]
    if math.isfinite(off):
        expected = parse_fault(f'{name}{size}')[1][0]
        assert causes[0].value == pytest.approx(expected, abs=off)


def test_several_faults_are_put_in_one_after_the_other():
    names = {cause.name for cause in causes_of(harmed('time_offset=0.1', 'scale=1.2', 'jump=1'))}
    assert names == {'time_offset', 'scale', 'jump'}
    larger = harmed('jump=1', 'scale=2').estimate.positions
    jumped = harmed('jump=1').estimate.positions
    np.testing.assert_array_equal(larger, 2 * jumped)


@pytest.mark.parametrize('name', FAULTS)
def test_a_fault_changes_its_side_alone_and_leaves_it_a_trajectory(name):
    run = harmed(name + WRITTEN.get(name, ('',))[0])
    for side in ('estimate', 'ground_truth'):
        after = getattr(run, side)
        assert (after is not getattr(RUN, side)) == (side in FAULTS[name].sides)
        assert (np.diff(after.stamps_ns) > 0).all()
        np.testing.assert_allclose(np.linalg.norm(after.rotations, axis=1), 1, atol=1e-12)


def test_a_fault_without_effect_does_not_change_the_poses():
    for text in ('time_offset=0', 'clock_drift=0', 'scale=1', 'scale_drift=0', 'yaw_drift=0'):
        after = harmed(text).estimate
        np.testing.assert_array_equal(after.stamps_ns, RUN.estimate.stamps_ns)
        np.testing.assert_allclose(after.positions, RUN.estimate.positions, rtol=0, atol=1e-12)
        np.testing.assert_allclose(after.rotations, RUN.estimate.rotations, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        ('tme_offset=1', "did you mean 'time_offset'"),
        ('nonsense', 'there are time_offset, '),
        ('scale', 'write scale=FACTOR'),
        ('scale=1,2', 'write scale=FACTOR'),
        ('axes_swapped=1', 'write axes_swapped'),
        ('outliers=0.1', 'write outliers=SHARE,M'),
        ('scale=big', "'big' is not a number"),
        ('scale=0', 'expected a number between 0 and 1e+06'),
        ('lost_tracking=1.5', 'expected a number between 0 and 1'),
        ('jump=nan', 'expected a number between -1e+06 and 1e+06'),
        ('clock_drift=-1e6', 'a number between'),
        ('time_offset=1e12', 'a number between'),
        ('quaternion_order=4', 'expected a whole number between 0 and 4'),
        ('quaternion_order=1.5', 'expected a whole number between 0 and 4'),
        ('jump=1e300', 'expected a number between -1e+06 and 1e+06'),
        ('jump=inf', 'expected a number between -1e+06 and 1e+06'),
    ],
)
def test_what_is_no_fault_is_refused_in_one_line(text, problem):
    with pytest.raises(ConfigError, match=re.escape(problem)) as refused:
        parse_fault(text)
    assert '\n' not in str(refused.value)


def test_a_fault_needs_the_side_that_it_changes():
    alone = SimulatedRun(estimate=RUN.estimate)
    for name in ('truth_static', 'swapped_inputs', 'insufficient_motion'):
        with pytest.raises(ConfigError, match=f'{name} needs a run with ground truth'):
            harmed(name, run=alone)


def test_a_fault_of_orientations_needs_some():
    positions = SimulatedRun(estimate=replace(RUN.estimate, rotations=None))
    with pytest.raises(ConfigError, match='lever_arm: it needs orientations'):
        harmed('lever_arm=0.1', run=positions)
    assert harmed('gravity_tilt=5', run=positions).estimate.rotations is None


@pytest.mark.parametrize('share', [0.05, 0.5, 0.95, 0.999])
def test_as_much_is_lost_as_was_asked_for(share):
    count = len(simulate().estimate)
    left = len(harmed(f'lost_tracking={share}').estimate)
    assert left == pytest.approx((1 - share) * count, abs=2)
