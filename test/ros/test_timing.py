"""Latency and cost of an estimate, as it arrives on topics."""

import json
import time

import pytest

from vio_eval_ros.core.trajectory import Poses

DELAY_S = 0.4


@pytest.fixture
def late(graph, ros, flight):
    """Return a function that publishes the flight as of now, each pose too late."""

    def fly(seconds: float, now_ns, meanwhile=lambda: None) -> None:
        estimate, truth = graph.both()
        begin_ns = now_ns()
        shift_ns = begin_ns - int(flight.ground_truth.stamps_ns[0])
        sent = [0, 0]
        while (passed_ns := now_ns() - begin_ns) < seconds * 1e9:
            meanwhile()
            for k, (stream, poses, delay_s) in enumerate(
                ((estimate, flight.estimate, DELAY_S), (truth, flight.ground_truth, 0.0))
            ):
                stamps_ns = poses.stamps_ns + shift_ns
                due = int((stamps_ns <= begin_ns + passed_ns - delay_s * 1e9).sum())
                chosen = slice(sent[k], due)
                moved = Poses(stamps_ns[chosen], poses.positions[chosen], poses.rotations[chosen])
                ros.send(stream, moved)
                sent[k] = due
            graph.wait_until(lambda: True, 'a moment')
            graph._executor.spin_once(timeout_sec=0.005)

    return fly


def test_a_known_delay_comes_back_in_result_statuses_and_gates(graph, evaluator, late, tmp_path):
    gates = tmp_path / 'gates.yaml'
    gates.write_text('latency_median_s: {max: 0.3}\nreal_time_factor: {min: 0.9}\n')
    node = evaluator(
        f'report_dir:={tmp_path}', f'gates_file:={gates}', 'exit_code_from_gates:=true'
    )
    late(4.0, time.time_ns)
    status = graph.wait_for('timing', 'ERROR', 'gate latency_median_s at most 0.3 is broken')
    assert float(status.values['latency_median_s']) == pytest.approx(DELAY_S, rel=0.05)
    node.stop(status=1)
    result = json.loads((tmp_path / 'result.json').read_text())
    live = result['live']
    assert live['latency_median_s'] == pytest.approx(DELAY_S, rel=0.05)
    assert live['latency_p99_s'] >= live['latency_median_s']
    assert live['real_time_factor'] == pytest.approx(1.0, rel=0.05)
    assert live['held_trans_rmse_m'] > 3 * result['metrics']['ate_trans_rmse_m']
    verdicts = {gate['metric']: gate['passed'] for gate in result['gates']}
    assert verdicts == {'latency_median_s': False, 'real_time_factor': True}
    assert 'latency, median' in (tmp_path / 'result.md').read_text()


def test_the_clock_of_a_recording_counts_with_use_sim_time(graph, ros, evaluator, late, tmp_path):
    """At twice the speed of the wall, so that a delay is half as long there."""
    node = evaluator(f'report_dir:={tmp_path}', 'use_sim_time:=true')
    clock = graph.publisher('/clock', ros.CLOCK)
    wall_ns, sim_ns = time.monotonic_ns(), 1_403_715_000 * 10**9

    def now_ns() -> int:
        return sim_ns + 2 * (time.monotonic_ns() - wall_ns)

    late(8.0, now_ns, lambda: clock.publish(ros.clock_message(now_ns())))
    graph.wait_for('timing', 'OK', 'latency', 'times real time')
    node.stop()
    live = json.loads((tmp_path / 'result.json').read_text())['live']
    assert live['latency_median_s'] == pytest.approx(DELAY_S, rel=0.1)
    assert live['real_time_factor'] == pytest.approx(2.0, rel=0.05)


def test_without_the_clock_of_the_stamps_latency_is_unknown(graph, ros, evaluator, flight):
    evaluator()
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for_arrival()
    graph.wait_for('timing', 'OK', 'latency unknown')
