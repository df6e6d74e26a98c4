"""While it runs, the evaluator says what is wrong, and says what `diagnose` would."""

from dataclasses import replace

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.simulation import simulate

RUN = simulate(duration_s=40.0)
TRUTH = RUN.ground_truth[::4]
CONFIG = EvaluationConfig()


def late(poses: Trajectory) -> Trajectory:
    return replace(poses, stamps_ns=poses.stamps_ns + 80_000_000)


def turned(poses: Trajectory) -> Trajectory:
    turn = rotation.from_rotation_vector(np.array([0.1, -0.2, 0.15]))
    return replace(poses, rotations=rotation.multiply(poses.rotations, turn))


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


def test_limits_of_a_file_count_live(graph, ros, evaluator, tmp_path):
    limits = tmp_path / 'limits.yaml'
    limits.write_text('diagnose: {time_offset_s: 0.2}')
    evaluator(f'limits_file:={limits}', 'profile:=handheld')
    estimate, truth = graph.both()
    ros.send(truth, TRUTH)
    ros.send(estimate, late(RUN.estimate))
    graph.wait_until(
        lambda: 'diagnosis' in graph.statuses and graph.statuses['diagnosis'].values, 'a diagnosis'
    )
    assert 'time_offset' not in str(graph.statuses['diagnosis'])


def test_of_a_short_run_nothing_can_be_determined_yet(graph, ros, evaluator, flight):
    evaluator()
    estimate, truth = graph.both()
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, late(flight.estimate))
    graph.wait_for_arrival()
    graph.wait_for('diagnosis', 'OK', 'cannot tell yet')
