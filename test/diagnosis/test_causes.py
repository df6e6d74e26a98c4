"""The table of causes: every entry is complete, and adding one takes nothing else."""

from dataclasses import replace
import math

import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis import measurements
from vio_eval_ros.diagnosis.causes import CAUSES, FAMILIES
from vio_eval_ros.diagnosis.causes.cause import KnownCause, template
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.simulation import simulate

FLIGHT = simulate(duration_s=40.0)
CONFIG = EvaluationConfig()


@pytest.mark.parametrize('cause', CAUSES.values(), ids=list(CAUSES))
def test_an_entry_is_complete(cause: KnownCause):
    assert CAUSES[cause.name] is cause
    for text in filter(None, (cause.advice, cause.advice_without_imu)):
        assert text[0].isupper()
        assert text.endswith('.')
    assert cause.measured
    assert cause.remedy
    assert set(cause.limits) <= DiagnosisLimits().to_dict().keys()
    assert cause.healthy(DiagnosisLimits(), 30.0) >= 0
    assert '%' not in cause.unit_in_names
    assert '/' not in cause.unit_in_names


def test_without_an_imu_nobody_is_advised_to_check_one():
    for cause in CAUSES.values():
        said = cause.advice_without_imu or cause.advice
        assert 'accelerometer' not in said
        assert 'gyroscope' not in said
        assert 'IMU' not in said.replace('without an IMU', '')


def test_a_profile_or_a_limit_decides_what_is_unusual():
    larger = replace(FLIGHT.estimate, positions=1.045 * FLIGHT.estimate.positions)

    def named(limits: DiagnosisLimits) -> list[str]:
        found = diagnose(larger, FLIGHT.ground_truth, CONFIG, limits)
        assert found.to_dict()['limits'] == limits.to_dict()
        return [cause.name for cause in found.causes]

    assert named(DiagnosisLimits()) == ['scale']
    assert named(DiagnosisLimits.of('indoor_robot')) == []
    assert named(DiagnosisLimits(scale_percent=4.9)) == []


def test_a_profile_without_an_imu_gives_other_advice():
    larger = replace(FLIGHT.estimate, positions=1.5 * FLIGHT.estimate.positions)
    for limits, advised in ((DiagnosisLimits(), True), (DiagnosisLimits.of('handheld'), False)):
        (cause,) = diagnose(larger, FLIGHT.ground_truth, CONFIG, limits).causes
        assert ('IMU calibration' in cause.advice) == advised


def test_a_further_cause_is_an_entry_and_what_measures_it(monkeypatch):
    squeezed = KnownCause(
        name='squeezed',
        unit='ratio',
        meaning='estimated over true height',
        measured='the slope of heights',
        remedy='the estimator',
        evidence=template('heights are {v:.2f} times the true ones'),
        advice='Look at the vertical.',
        undo=lambda poses, ratio: replace(poses, positions=poses.positions / [1.0, 1.0, ratio]),
        undo_order=65,
        acts_on='ATE',
    )

    def measure(run: Measuring) -> None:
        pairs = run.pairs()
        heights = (side.positions[:, 2] for side in (pairs.ground_truth, pairs.estimate))
        ratio = np.polyfit(*heights, 1)[0]
        note = run.counted(squeezed, ratio)
        run.note(squeezed, replace(note, size=float(abs(ratio - 1) > 0.1)), ratio)

    monkeypatch.setitem(CAUSES, squeezed.name, squeezed)
    monkeypatch.setattr(measurements, 'FAMILIES', (*FAMILIES, measure))
    low = replace(FLIGHT.estimate, positions=FLIGHT.estimate.positions * [1.0, 1.0, 0.4])
    found = diagnose(low, FLIGHT.ground_truth, CONFIG)
    cause = next(cause for cause in found.causes if cause.name == 'squeezed')
    assert cause.value == pytest.approx(0.4, abs=0.02)
    assert cause.evidence.startswith('heights are 0.4')
    assert cause.advice == 'Look at the vertical.'
    assert cause.ate_after_m < 0.2 * cause.ate_before_m
    healthy = diagnose(FLIGHT.estimate, FLIGHT.ground_truth, CONFIG)
    assert healthy.causes == ()
    assert healthy.findings['squeezed']['unit'] == 'ratio'


def test_a_correction_undoes_causes_in_their_order_whatever_the_order_of_noting():
    poses = FLIGHT.estimate
    level = np.array([0.0, 0.0, math.sin(0.2), math.cos(0.2)])
    parts = {'scale': 2.0, 'gravity_tilt': level, 'lever_arm': np.array([0.1, 0.0, 0.3])}
    ways = []
    for names in (list(parts), list(parts)[::-1]):
        correction = Correction(0)
        for name in names:
            correction = CAUSES[name].undone(correction, parts[name])
        ways.append(correction.apply(poses))
        assert correction.without('scale').steps.keys() == parts.keys() - {'scale'}
        assert correction.only(['scale', 'jump']).steps.keys() == {'scale'}
    assert isinstance(ways[0], Trajectory)
    np.testing.assert_array_equal(ways[0].positions, ways[1].positions)
    np.testing.assert_array_equal(ways[0].rotations, ways[1].rotations)
