"""An evaluator that was killed goes on with what it had saved."""

import json
import signal

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation


def expected(estimate, truth):
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_estimate(estimate)
    evaluation.add_ground_truth(truth)
    evaluation.flush()
    metrics = evaluation.summary().metrics
    return {name: value if value == value else None for name, value in metrics.items()}


def result_in(folder):
    return json.loads((folder / 'result.json').read_text())


def test_a_node_that_was_killed_goes_on(graph, ros, process, flight, tmp_path):
    given = (f'report_dir:={tmp_path}', 'checkpoint_s:=0.2')
    first = process(*given)
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate[:200])
    ros.send(truth, flight.ground_truth[:500])
    graph.wait_for_arrival(200, 500)
    saved = tmp_path / 'checkpoint'
    graph.wait_until(lambda: list(saved.glob('*.npz')), 'a checkpoint')
    graph.wait_for('association', 'OK')  # another tick, so that all is saved
    first.tell(signal.SIGKILL)
    graph.processes.clear()
    first.process.wait()
    first.process.stdout.close()
    first.has_ended = True
    graph.statuses.clear()

    second = process(*given)
    graph.wait_for('streams', 'any', estimate_received=200, ground_truth_received=500)
    graph.wait_until(lambda: estimate.get_subscription_count() == 1, 'the second')
    graph.wait_until(lambda: truth.get_subscription_count() == 1, 'the second')
    ros.send(estimate, flight.estimate[200:])
    ros.send(truth, flight.ground_truth[500:])
    graph.wait_for_arrival()
    complaint = second.stop()
    assert 'went on from' in complaint
    assert '200 poses of /estimate up to' in complaint
    result = result_in(tmp_path)
    assert result['metrics'] == expected(flight.estimate, flight.ground_truth)
    assert 'is missing' in result['warnings'][0]
    assert not saved.exists()


def test_a_new_recording_after_a_crash_is_another_run(graph, ros, evaluator, flight, tmp_path):
    given = (f'report_dir:={tmp_path}', 'checkpoint_s:=0.01')
    killed = evaluator(*given)
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for_arrival()
    graph.wait_until(lambda: (tmp_path / 'checkpoint').glob('*.npz'), 'a checkpoint')
    graph.wait_for('association', 'OK')
    graph.remove(killed._node)  # without its end
    killed.has_ended = True
    graph.statuses.clear()

    again = evaluator(*given)
    graph.wait_for_arrival()
    graph.wait_until(lambda: estimate.get_subscription_count() == 1, 'it')
    graph.wait_until(lambda: truth.get_subscription_count() == 1, 'it')
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, flight.estimate)
    graph.wait_for_arrival(800, 2000)
    again.stop()
    for run in ('run_0001', 'run_0002'):
        result = result_in(tmp_path / run)
        assert result['metrics'] == expected(flight.estimate, flight.ground_truth)
    assert 'went on from' in result_in(tmp_path / 'run_0001')['warnings'][0]
    assert 'went on from' not in json.dumps(result_in(tmp_path / 'run_0002')['warnings'])


def test_a_damaged_checkpoint_is_told_and_the_run_begins_anew(
    graph, ros, evaluator, flight, tmp_path
):
    (tmp_path / 'checkpoint').mkdir()
    (tmp_path / 'checkpoint' / '000001.npz').write_bytes(b'damaged')
    node = evaluator(f'report_dir:={tmp_path}', 'checkpoint_s:=1.0')
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for_arrival()
    complaint = node.stop()
    assert 'it is set aside as checkpoint_set_aside_1; the run begins anew' in complaint
    result = result_in(tmp_path)
    assert result['metrics'] == expected(flight.estimate, flight.ground_truth)
    assert not any('went on' in warning for warning in result['warnings'])


def test_a_checkpoint_needs_a_folder(evaluator):
    from vio_eval_ros.errors import ConfigError

    with pytest.raises(ConfigError, match='checkpoint_s: set report_dir as well'):
        evaluator('checkpoint_s:=1.0')
