"""While it runs, the evaluator says what is wrong, and says what `diagnose` would."""

from dataclasses import replace
import math
import time

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.live import monitor as module
from vio_eval_ros.live.monitor import Diagnosing, sample
from vio_eval_ros.simulation import simulate

RUN = simulate(duration_s=40.0)
TRUTH = RUN.ground_truth[::4]
CONFIG = EvaluationConfig()


def late(poses: Trajectory) -> Trajectory:
    return replace(poses, stamps_ns=poses.stamps_ns + 80_000_000)


def turned(poses: Trajectory) -> Trajectory:
    turn = rotation.from_rotation_vector(np.array([0.1, -0.2, 0.15]))
    return replace(poses, rotations=rotation.multiply(poses.rotations, turn))


def pairs_of(estimate: Trajectory) -> Pairs:
    evaluation = Evaluation(CONFIG)
    evaluation.add_estimate(estimate)
    evaluation.add_ground_truth(TRUTH)
    evaluation.flush()
    return evaluation.summary().pairs


@pytest.mark.parametrize(
    ('harm', 'name', 'key', 'tolerance'),
    [
        (late, 'time_offset', 'time_offset_s', 5e-4),
        (turned, 'sensor_rotation', 'sensor_rotation_deg', 0.1),
    ],
)
def test_live_and_offline_name_the_same_first_cause(
    graph, ros, evaluator, harm, name, key, tolerance
):
    node = evaluator()
    estimate, truth = graph.both()
    harmed = harm(RUN.estimate)
    ros.send(truth, TRUTH)
    ros.send(estimate, harmed)

    def is_of_nearly_all() -> bool:
        status = graph.statuses.get('diagnosis')
        return status is not None and int(status.values.get('diagnosed_pairs', 0)) >= 770

    graph.wait_until(is_of_nearly_all, 'a diagnosis of the whole run')
    status = graph.wait_for('diagnosis', 'WARN', f'{name}: ', cause_1=name)
    offline = diagnose(harmed, TRUTH, CONFIG).causes[0]
    assert offline.name == name
    assert float(status.values[key]) == pytest.approx(offline.value, abs=tolerance)
    assert status.values[f'{name}_advice'] == offline.advice
    assert status.values[f'{name}_flags'].split()[0] == offline.flags[0]
    assert f'{name}: ' in node.stop()


def test_of_a_short_run_nothing_can_be_told_yet(graph, ros, evaluator, flight):
    evaluator()
    estimate, truth = graph.both()
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, late(flight.estimate))
    graph.wait_for_arrival()
    graph.wait_for('diagnosis', 'OK', 'cannot tell yet')


@pytest.mark.parametrize('seconds', [0.02, -0.08])
def test_the_pairs_tell_an_offset_almost_as_well_as_the_whole_streams(seconds):
    harmed = replace(RUN.estimate, stamps_ns=RUN.estimate.stamps_ns + round(seconds * 1e9))
    cause = Diagnosing(CONFIG).conclude(pairs_of(harmed)).causes[0]
    assert cause.name == 'time_offset'
    assert cause.value == pytest.approx(seconds, abs=1e-3)


def test_options_that_were_applied_to_the_pairs_are_not_applied_again():
    config = EvaluationConfig(time_offset_s=-0.03)
    evaluation = Evaluation(config)
    evaluation.add_estimate(late(RUN.estimate))
    evaluation.add_ground_truth(TRUTH)
    evaluation.flush()
    cause = Diagnosing(config).conclude(evaluation.summary().pairs).causes[0]
    assert cause.value == pytest.approx(0.05, abs=1e-3)
    assert float(cause.flags[1]) == pytest.approx(-0.08, abs=1e-3)


def test_a_healthy_run_has_nothing_wrong():
    assert Diagnosing(CONFIG).conclude(pairs_of(RUN.estimate)).causes == ()


def test_too_short_a_run_has_no_diagnosis():
    assert Diagnosing(CONFIG).conclude(pairs_of(late(RUN.estimate))[:300]) is None


def test_a_diagnosis_that_fails_is_told_and_nothing_stops(monkeypatch):
    def fail(run: object) -> None:
        raise ZeroDivisionError('oh')

    monkeypatch.setattr(module, 'diagnose_run', fail)
    diagnosing = Diagnosing(CONFIG)
    assert diagnosing.conclude(pairs_of(RUN.estimate)) is None
    assert diagnosing.problem == 'ZeroDivisionError: oh'


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

    monkeypatch.setattr(module, 'Thread', AtOnce)
    diagnosing, pairs = Diagnosing(CONFIG), pairs_of(RUN.estimate)
    for now_s[0] in (100.0, 105.0, 109.9, 110.0, 119.0, 121.0):
        diagnosing.look(pairs)
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
