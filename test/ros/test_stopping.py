"""The node ends when it is told to, whatever it is doing, and leaves whole reports behind."""

import json
import os
from pathlib import Path
import signal
import time

import pytest

REPORT = {
    'result.json',
    'result.md',
    'result.html',
    'errors.csv',
    'series.csv',
    'estimate.tum',
    'ground_truth.tum',
}


def catches_signals(pid: int) -> bool:
    """Return whether the process has handlers of its own, as it does from its first line on."""
    status = Path(f'/proc/{pid}/status').read_text()
    caught = int(status.split('SigCgt:')[1].split()[0], 16)
    return bool(caught >> (signal.SIGTERM - 1) & 1)


def has_loaded(pid: int, library: str) -> bool:
    return library in Path(f'/proc/{pid}/maps').read_text()


MOMENTS = {
    'before it imports anything': lambda pid: True,
    'while it imports numpy': lambda pid: has_loaded(pid, '_multiarray_umath'),
    'while it imports ROS': lambda pid: has_loaded(pid, 'rclpy'),
    'while it joins the graph': lambda pid: has_loaded(pid, 'rmw_fastrtps_cpp'),
    'when it has threads': lambda pid: len(os.listdir(f'/proc/{pid}/task')) > 2,
}


@pytest.mark.skipif(not Path('/proc/self/maps').exists(), reason='needs the /proc of Linux')
@pytest.mark.parametrize('moment', MOMENTS)
def test_a_signal_during_the_start_ends_it_in_order(process, tmp_path, moment):
    node = process(f'report_dir:={tmp_path}')
    pid, end_s = node.process.pid, time.monotonic() + 30
    while not (catches_signals(pid) and MOMENTS[moment](pid)):
        assert node.process.poll() is None
        assert time.monotonic() < end_s
        time.sleep(0.001)
    node.tell(signal.SIGTERM)
    node.tell(signal.SIGINT)
    assert node.ended() == ''
    assert not list(tmp_path.iterdir())  # there is nothing to report


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_runs_ends_it_with_its_report(
    graph, ros, process, flight, tmp_path, number
):
    node = process(f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, flight.estimate)
    graph.wait_for_arrival()
    node.tell(number)
    assert node.ended() == ''
    assert {path.name for path in tmp_path.iterdir()} == REPORT
    result = json.loads((tmp_path / 'result.json').read_text())
    assert result['association']['pairs'] == 400
    ate_m, ate_deg = (
        result['metrics'][f'ate_{name}'] for name in ('trans_rmse_m', 'rot_rmse_deg')
    )
    assert node.told == [
        'waiting for /estimate (estimate) and /ground_truth (ground truth)',
        f'run 1: 400 pairs, 99.8 % covered, ATE {ate_m:.4g} m, {ate_deg:.4g} deg; '
        f'the report is in {tmp_path}',
    ]


def test_a_run_without_pairs_says_why(graph, ros, evaluator, flight):
    node = evaluator()
    ros.send(graph.publisher('/estimate', ros.ESTIMATE), flight.estimate)
    graph.wait_for('streams', 'any', estimate_received=400)
    assert node.stop() == ''
    assert node.told[-1].startswith('run 1: no pairs yet: estimate spans')
    assert node.told[-1].endswith('no ground truth yet; nobody publishes /ground_truth')


def test_more_signals_do_not_damage_the_report_that_is_written(
    graph, ros, process, flight, tmp_path
):
    # writing waits where a pipe is not read yet
    os.mkfifo(tmp_path / 'result.md')
    node = process(f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, flight.estimate)
    graph.wait_for_arrival()
    node.tell(signal.SIGINT)
    graph.wait_until(lambda: list(tmp_path.glob('.result.json.*')), 'the first file of the report')
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT):
        node.tell(number)
    text = (tmp_path / 'result.md').read_text()
    assert node.ended() == ''
    assert text.startswith('### /estimate')
    assert text.endswith('|\n')
    assert {path.name for path in tmp_path.iterdir()} == REPORT
    assert json.loads((tmp_path / 'result.json').read_text())['association']['pairs'] == 400


def test_a_folder_that_cannot_be_written_does_not_end_it(graph, ros, evaluator, flight, tmp_path):
    taken = tmp_path / 'taken'
    taken.write_text('a file')
    node = evaluator(f'report_dir:={taken}')
    graph.wait_for('accuracy', 'WARN', f'no pairs yet; {taken}: cannot write: ')  # in good time
    estimate, truth = graph.both()
    ros.send(truth, flight.ground_truth)
    ros.send(estimate, flight.estimate)
    graph.wait_for_arrival()
    answer = graph.call('write_report')
    assert not answer.success
    assert f'{taken}: cannot write' in answer.message
    graph.wait_for('accuracy', 'WARN', f'running; {taken}: cannot write: ', pairs=381)
    said = node.stop(status=2)
    assert f'{taken}: cannot write' in said.splitlines()[-1]
    assert taken.read_text() == 'a file'


def test_a_full_disk_leaves_the_old_report_as_it_is(graph, ros, evaluator, flight, tmp_path):
    evaluator(f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    ros.send(truth, flight.ground_truth[:500])
    ros.send(estimate, flight.estimate[:200])
    graph.wait_for_arrival(200, 500)
    assert graph.call('write_report').success
    (tmp_path / 'result.json').unlink()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(before) == REPORT - {'result.json'}
    (tmp_path / 'result.json').symlink_to('/dev/full')
    ros.send(truth, flight.ground_truth[500:])
    ros.send(estimate, flight.estimate[200:])
    graph.wait_for_arrival()
    answer = graph.call('write_report')
    assert (answer.success, 'No space left on device' in answer.message) == (False, True)
    graph.wait_for('accuracy', 'WARN', 'No space left on device', pairs=381)
    (tmp_path / 'result.json').unlink()
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert graph.call('write_report').success
    graph.wait_for('accuracy', 'OK', 'running', pairs=381)
    assert {path.name for path in tmp_path.iterdir()} == REPORT


def test_a_report_is_not_replaced_by_nothing(graph, evaluator, tmp_path):
    (tmp_path / 'result.json').write_text('of yesterday')
    node = evaluator(f'report_dir:={tmp_path}')
    graph.wait_for('accuracy', 'WARN', 'no pairs yet')
    answer = graph.call('write_report')
    assert (answer.success, answer.message[:17]) == (False, 'nothing to report')
    node.stop()
    assert (tmp_path / 'result.json').read_text() == 'of yesterday'


def test_the_verdict_is_that_of_all_runs(graph, ros, evaluator, flight, tmp_path):
    gates = tmp_path / 'gates.yaml'
    gates.write_text('coverage_ratio: {min: 0.9}')
    node = evaluator(f'gates_file:={gates}', 'exit_code_from_gates:=true')
    estimate, truth = graph.both()
    for loop, part in ((1, flight.estimate[:200]), (2, flight.estimate)):
        ros.send(estimate, part)
        ros.send(truth, flight.ground_truth)
        graph.wait_for('streams', 'any', ground_truth_received=1000 * loop)
    said = node.stop(status=1)
    assert said.count('fail coverage_ratio>=0.9 (is 0.') == 1
