"""While a run goes on it is diagnosed now and then, and never at much cost."""

from dataclasses import replace
import math
import time

import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.live import monitor as monitor_module
from vio_eval_ros.live.monitor import DiagnosisMonitor, sample
from vio_eval_ros.simulation import simulate

RUN = simulate(duration_s=40.0)
TRUTH = RUN.ground_truth[::4]
CONFIG = EvaluationConfig()


def late(poses: Trajectory) -> Trajectory:
    return replace(poses, stamps_ns=poses.stamps_ns + 80_000_000)


def pairs_of(estimate: Trajectory) -> Pairs:
    evaluation = Evaluation(CONFIG)
    evaluation.add_estimate(estimate)
    evaluation.add_ground_truth(TRUTH)
    evaluation.flush()
    return evaluation.summary().pairs


@pytest.mark.parametrize('seconds', [0.02, -0.08])
def test_the_pairs_determine_an_offset_almost_as_well_as_the_whole_streams(seconds):
    harmed = replace(RUN.estimate, stamps_ns=RUN.estimate.stamps_ns + round(seconds * 1e9))
    cause = DiagnosisMonitor(CONFIG).conclude(pairs_of(harmed)).causes[0]
    assert cause.name == 'time_offset'
    assert cause.value == pytest.approx(seconds, abs=1e-3)


def test_options_that_were_applied_to_the_pairs_are_not_applied_again():
    config = EvaluationConfig(time_offset_s=-0.03)
    evaluation = Evaluation(config)
    evaluation.add_estimate(late(RUN.estimate))
    evaluation.add_ground_truth(TRUTH)
    evaluation.flush()
    cause = DiagnosisMonitor(config).conclude(evaluation.summary().pairs).causes[0]
    assert cause.value == pytest.approx(0.05, abs=1e-3)
    assert float(cause.flags[1]) == pytest.approx(-0.08, abs=1e-3)


def test_a_healthy_run_has_nothing_wrong():
    assert DiagnosisMonitor(CONFIG).conclude(pairs_of(RUN.estimate)).causes == ()


def test_what_is_healthy_depends_on_the_limits():
    harmed = pairs_of(late(RUN.estimate))
    assert DiagnosisMonitor(CONFIG).conclude(harmed).causes[0].name == 'time_offset'
    limits = DiagnosisLimits.of('drone', {'time_offset_s': 0.2})
    causes = DiagnosisMonitor(CONFIG, limits).conclude(harmed).causes
    assert 'time_offset' not in [cause.name for cause in causes]


def test_too_short_a_run_has_no_diagnosis():
    assert DiagnosisMonitor(CONFIG).conclude(pairs_of(late(RUN.estimate))[:300]) is None


def test_a_diagnosis_that_fails_is_reported_and_nothing_stops(monkeypatch):
    def fail(*given: object) -> None:
        raise ZeroDivisionError('oh')

    monkeypatch.setattr(monitor_module, 'diagnose_run', fail)
    monitor = DiagnosisMonitor(CONFIG)
    assert monitor.conclude(pairs_of(RUN.estimate)) is None
    assert monitor.problem == 'ZeroDivisionError: oh'


@pytest.mark.slow
@pytest.mark.parametrize(('busy_s', 'begun'), [(0.0, [100, 110, 121]), (0.4, [100, 121])])
def test_the_next_diagnosis_waits_longer_the_more_work_it_is(monkeypatch, busy_s, begun):
    now_s, worked_s = [0.0], [0.0]

    def thread_time() -> float:
        worked_s[0] += busy_s
        return worked_s[0]

    monkeypatch.setattr(time, 'monotonic', lambda: now_s[0])
    monkeypatch.setattr(time, 'thread_time', thread_time)
    began = []

    class AtOnce:
        def __init__(self, target, args) -> None:
            self.start = lambda: (began.append(now_s[0]), target(*args))

        def is_alive(self) -> bool:
            return False

    monkeypatch.setattr(monitor_module, 'Thread', AtOnce)
    monitor, pairs = DiagnosisMonitor(CONFIG), pairs_of(RUN.estimate)
    for now_s[0] in (100.0, 105.0, 109.9, 110.0, 119.0, 121.0):
        monitor.look(pairs)
    assert began == begun


@pytest.mark.parametrize(
    ('count', 'rate_hz', 'left', 'interval_s'),
    [
        (10_000, 20, 10_000, 0.05),  # all
        (15_000, 20, 7_500, 0.1),  # every other
        (45_000, 20, 10_000, 0.1),  # no sparser: the newest
        (450_000, 1000, 10_000, 0.045),
        (15_000, 5, 10_000, 0.2),
    ],
)
def test_of_many_pairs_the_newest_are_taken_evenly(count, rate_hz, left, interval_s):
    stamps_ns = 10**18 + np.arange(count) * (10**9 // rate_hz)
    poses = Trajectory(stamps_ns, np.zeros((count, 3)))
    taken = sample(Pairs.of(poses, poses)).estimate.stamps_ns
    assert len(taken) == left
    assert taken[-1] == stamps_ns[-1]
    assert math.isclose(np.diff(taken).min() / 1e9, interval_s)
    assert math.isclose(np.diff(taken).max() / 1e9, interval_s)
