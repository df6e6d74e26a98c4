"""A jump back in time closes the run with its report and begins the next; nothing is mixed up."""

from dataclasses import replace
import json
from pathlib import Path

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.rendering.tum import tum

S = 1_000_000_000


@pytest.fixture(scope='module')
def scored(flight):
    """Return what the flight scores by itself."""
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_estimate(flight.estimate)
    evaluation.add_ground_truth(flight.ground_truth)
    evaluation.flush()
    return evaluation.summary()


def assert_is_whole(report: Path, scored) -> None:
    """Assert that a run had all poses of the flight, and no others."""
    result = json.loads((report / 'result.json').read_text())
    assert result['association']['pairs'] == 400
    assert result['metrics'] == {
        name: value if value == value else None for name, value in scored.metrics.items()
    }
    for side in ('estimate', 'ground_truth'):
        assert not any(result['inputs'][side]['dropped'].values())


def test_every_loop_of_a_recording_is_a_run(graph, ros, evaluator, flight, scored, tmp_path):
    node = evaluator(f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    for loop in (1, 2, 3):
        ros.send(truth, flight.ground_truth)
        ros.send(estimate, flight.estimate)
        graph.wait_for_arrival(400 * loop, 1000 * loop)
    graph.wait_for('diagnosis', 'OK', 'run 3 began as /', 'jumped back from 1403715544.9 to')
    said = node.stop()
    assert said.count('jumped back') == 2
    runs = sorted(tmp_path.iterdir())
    assert [run.name for run in runs] == ['run_0001', 'run_0002', 'run_0003']
    for run in runs:
        assert_is_whole(run, scored)


def test_every_loop_of_a_path_is_a_run(graph, ros, evaluator, flight, scored, tmp_path):
    node = evaluator(f'report_dir:={tmp_path}')
    estimate = graph.publisher('/estimate', ros.PATH)
    truth = graph.publisher('/ground_truth', ros.GROUND_TRUTH)
    for _ in range(2):
        ros.send(truth, flight.ground_truth)
        for end in range(40, 401, 40):
            ros.send_path(estimate, flight.estimate[:end])
        ros.send_path(estimate, flight.estimate[:0])  # tells nothing
    estimate.publish(b'\x00\x01\x00\x00no Path')
    graph.wait_for(
        'streams', 'WARN', '1 message on /estimate could not be decoded as nav_msgs/msg/Path'
    )
    graph.wait_for_arrival(23, 2000)
    node.stop()
    for run in ('run_0001', 'run_0002'):
        result = json.loads((tmp_path / run / 'result.json').read_text())
        assert result['association']['pairs'] == 400
        assert result['metrics']['ate_trans_rmse_m'] == scored.metrics['ate_trans_rmse_m']
        assert result['metrics']['loop_closure_gain'] == pytest.approx(1)


def test_the_ground_truth_of_every_loop_may_be_a_file(
    graph, ros, evaluator, flight, scored, tmp_path
):
    file, reports = tmp_path / 'truth.tum', tmp_path / 'reports'
    file.write_text(tum(flight.ground_truth))
    node = evaluator(f'report_dir:={reports}', f'ground_truth_file:={file}')
    estimate = graph.publisher('/estimate', ros.ESTIMATE)
    ros.send(estimate, flight.estimate)
    ros.send(estimate, flight.estimate)
    graph.wait_for('streams', 'OK', run=2, estimate_received=800)
    node.stop()
    for run in ('run_0001', 'run_0002'):
        metrics = json.loads((reports / run / 'result.json').read_text())['metrics']
        ate = scored.metrics['ate_trans_rmse_m']
        assert metrics['ate_trans_rmse_m'] == pytest.approx(ate, rel=1e-6)  # of nine decimals


@pytest.mark.parametrize('first', ['ground_truth', 'estimate'])
def test_a_stream_that_jumps_after_the_other_loses_nothing(
    graph, ros, evaluator, flight, scored, tmp_path, first
):
    node = evaluator(f'report_dir:={tmp_path}')
    publishers = dict(zip(('estimate', 'ground_truth'), graph.both(), strict=True))
    ahead = publishers.pop(first)
    ((name, behind),) = publishers.items()
    early, late = getattr(flight, first), getattr(flight, name)
    half = len(early) // 2
    ros.send(ahead, early)
    ros.send(behind, late[:-50])
    ros.send(ahead, early[:half])
    graph.wait_for('streams', 'WARN', f'/{first} jumped back', 'waiting for the other stream')
    ros.send(behind, late[-50:])
    ros.send(behind, late)
    ros.send(ahead, early[half:])
    graph.wait_for_arrival(800, 2000)
    node.stop()
    assert_is_whole(tmp_path / 'run_0001', scored)
    assert_is_whole(tmp_path / 'run_0002', scored)


def test_a_run_that_ends_while_a_stream_lags_is_reported_all_the_same(
    graph, ros, evaluator, flight, scored, tmp_path
):
    node = evaluator(f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, flight.estimate)
    graph.wait_for_arrival()
    ros.send(truth, flight.ground_truth[:100])
    graph.wait_for('streams', 'WARN', 'waiting for the other stream')
    node.stop()
    assert_is_whole(tmp_path / 'run_0001', scored)
    second = json.loads((tmp_path / 'run_0002' / 'result.json').read_text())
    assert second['association']['pairs'] == 0
    assert second['inputs']['ground_truth']['poses'] == 100


def test_a_stream_that_does_not_jump_with_the_other_is_not_waited_for_for_ever(
    graph, ros, evaluator, flight, short_lag
):
    evaluator()
    estimate, truth = graph.both()
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, flight.estimate)
    graph.wait_for('association', 'OK', pairs=381)
    ros.send(estimate, flight.estimate[:200])
    stamps_ns = flight.ground_truth.stamps_ns + 20 * S
    beyond = replace(flight.ground_truth, stamps_ns=stamps_ns)
    each = (beyond[k : k + 1] for k in range(len(beyond)))
    graph.wait_for('streams', 'any', run=2, meanwhile=lambda: ros.send(truth, next(each)))
    graph.wait_for('association', 'WARN', 'are the clocks the same?')


def test_the_clock_may_jump_back_with_the_streams(graph, ros, evaluator, flight, scored, tmp_path):
    node = evaluator('use_sim_time:=true', f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    clock = graph.publisher('/clock', ros.CLOCK)
    begin_ns, end_ns = flight.ground_truth.stamps_ns[[0, -1]].tolist()
    graph.set_time(clock, end_ns)
    for loop, clock_first in ((1, False), (2, True), (3, False)):
        if clock_first:
            graph.set_time(clock, begin_ns)
        ros.send(truth, flight.ground_truth)
        ros.send(estimate, flight.estimate)
        graph.wait_for_arrival(400 * loop, 1000 * loop)
        clock.publish(ros.clock_message(end_ns))
    graph.set_time(clock, begin_ns)
    assert graph.statuses['streams'].message == 'running'  # the streams have ended that run
    node.stop()
    assert len(list(tmp_path.iterdir())) == 3
    for run in tmp_path.iterdir():
        assert_is_whole(run, scored)


def test_the_clock_may_jump_back_alone(graph, ros, evaluator, flight, scored, tmp_path, short_lag):
    evaluator('use_sim_time:=true', f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    clock = graph.publisher('/clock', ros.CLOCK)
    graph.set_time(clock, int(flight.ground_truth.stamps_ns[-1]))
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, flight.estimate)
    graph.wait_for_arrival()
    graph.set_time(clock, int(flight.ground_truth.stamps_ns[0]))
    graph.wait_for('streams', 'WARN', 'the clock jumped back: waiting for the streams to do so')
    graph.wait_for('diagnosis', 'OK', 'run 2 began as the clock jumped back')
    assert_is_whole(tmp_path / 'run_0001', scored)
    # whoever begins again only now is in the new run
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, flight.estimate)
    graph.wait_for('association', 'OK', pairs=381)
    assert graph.statuses['streams'].values['run'] == '2'
