"""What may happen to a live node: it goes on, and ``/diagnostics`` says what is the matter."""

from dataclasses import replace
from itertools import count
import json

import numpy as np
import pytest

from vio_eval_ros.core.trajectory import Poses

S = 1_000_000_000
FIRST_S = 1403715524.9  # of the flight


def later(poses: Poses, seconds: float) -> Poses:
    return replace(poses, stamps_ns=poses.stamps_ns + round(seconds * S))


def moved(poses: Poses, metres: float) -> Poses:
    return replace(poses, positions=poses.positions + np.array([metres, 0, 0]))


def test_streams_may_come_late_stop_and_come_back(graph, ros, evaluator, flight):
    evaluator('stale_after_s:=0.5')
    graph.wait_for('streams', 'WARN', 'nobody publishes /estimate; nobody publishes /ground_truth')
    graph.wait_for('association', 'WARN', 'no estimate yet, no ground truth yet')
    graph.wait_for('accuracy', 'WARN', 'no pairs yet')
    estimate = graph.publisher('/estimate', ros.ESTIMATE)
    graph.wait_for('streams', 'WARN', 'nothing received on /estimate; nobody publishes')
    ros.send(estimate, flight.estimate[:100])
    graph.wait_for('association', 'WARN', f'estimate spans {FIRST_S} to', 'no ground truth yet')
    truth = graph.publisher('/ground_truth', ros.GROUND_TRUTH)
    ros.send(truth, flight.ground_truth[:250])
    graph.wait_for('association', 'OK', 'running', pairs=81)
    graph.wait_for('accuracy', 'OK', 'running')
    graph.wait_for('streams', 'OK', 'ended: nothing on /estimate for ', 'on /ground_truth for')

    graph.withdraw(truth)
    ros.send(estimate, flight.estimate[100:])
    graph.wait_for('streams', 'STALE', 'nothing on /ground_truth for', 'nobody publishes it')
    truth = graph.publisher('/ground_truth', ros.GROUND_TRUTH)
    ros.send(truth, flight.ground_truth[250:])
    graph.wait_for('association', 'OK', pairs=381)
    tenths = count()

    def fly_on() -> None:
        lap, k = divmod(next(tenths), 200)
        ros.send(estimate, later(flight.estimate[2 * k : 2 * k + 2], 20 * (lap + 1)))
        ros.send(truth, later(flight.ground_truth[5 * k : 5 * k + 5], 20 * (lap + 1)))

    graph.wait_for('streams', 'OK', 'running', meanwhile=fly_on)


def test_poses_that_cannot_be_used_are_counted(graph, ros, evaluator, flight, tmp_path):
    node = evaluator(f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    positions, rotations = flight.estimate.positions.copy(), flight.estimate.rotations.copy()
    positions[[50, 51]] = [np.nan, 0, 0], [0, np.inf, 0]
    rotations[60] = 0
    rotations[61, 2] = np.nan
    rotations[62] *= 3  # is normalised
    poses = Poses(flight.estimate.stamps_ns, positions, rotations)
    order = np.r_[:20, 21:70, 70, 70:100, 101, 100, 102:150, 155, 150:155, 156:200]
    ros.send(estimate, poses[order])
    ros.send(truth, flight.ground_truth[:500])
    graph.wait_for('association', 'WARN', pairs=176)
    ros.send(estimate, poses[np.r_[20, 200:400]])  # the first is 9 s late
    ros.send(truth, flight.ground_truth[500:])
    graph.wait_for(
        'association',
        'WARN',
        'estimate: dropped 3 non-finite, 1 zero-quaternion, 1 duplicate, 1 late',
        pairs=376,
        estimate_non_finite=3,
        estimate_zero_quaternion=1,
        estimate_duplicate=1,
        estimate_late=1,
        ground_truth_late=0,
    )
    graph.wait_for_arrival(401, 1000)
    node.stop()
    result = json.loads((tmp_path / 'result.json').read_text())
    assert result['association']['pairs'] == 395
    assert 'run_0001' not in {path.name for path in tmp_path.iterdir()}


def test_clocks_that_are_apart_are_named_with_both_spans(graph, ros, evaluator, flight):
    evaluator()
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, later(flight.ground_truth, 7200))
    graph.wait_for(
        'association',
        'WARN',
        f'estimate spans {FIRST_S} to 1403715544.9 s',
        'ground truth spans 1403722724.9 to 1403722744.9 s; are the clocks the same?',
        pairs=0,
    )


def test_stamps_of_0_are_not_used_and_the_cause_is_named(graph, ros, evaluator, flight):
    evaluator('use_sim_time:=true')
    estimate, truth = graph.both()
    clock = graph.publisher('/clock', ros.CLOCK)
    ros.send(estimate, replace(flight.estimate, stamps_ns=np.zeros(400, np.int64)))
    ros.send(truth, flight.ground_truth[:1])
    graph.wait_for('association', 'WARN', '/estimate stamped 0: is there a /clock?')
    assert graph.stamp_ns == 0

    graph.set_time(clock, 1403715530 * S)
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth[1:])
    graph.wait_for('association', 'WARN', pairs=381, estimate_zero_stamp=400)
    assert graph.statuses['streams'].values['run'] == '1'


def test_a_topic_of_another_type_is_named_and_has_no_effect(
    graph, another, ros, evaluator, flight
):
    evaluator()
    wrong = another.publisher('/estimate', 'std_msgs/msg/String', matched=False)
    graph.wait_for(
        'streams', 'WARN', '/estimate carries std_msgs/msg/String, which has no pose', 'scored'
    )
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for('association', 'OK', pairs=381)
    graph.wait_for('streams', 'WARN', 'only nav_msgs/msg/Odometry is read')
    another.withdraw(wrong)
    other = another.publisher('/estimate', 'geometry_msgs/msg/PoseStamped', matched=False)
    graph.withdraw(estimate)
    graph.wait_for(
        'streams',
        'WARN',
        '/estimate is published as geometry_msgs/msg/PoseStamped, not nav_msgs/msg/Odometry; '
        'restart the evaluator',
    )
    another.withdraw(other)


def test_messages_that_are_not_what_they_say_are_counted(graph, ros, evaluator, flight):
    evaluator()
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate[:200])
    estimate.publish(b'\x00\x01\x00\x00no Odometry')
    ros.send(estimate, flight.estimate[200:])
    ros.send(truth, flight.ground_truth)
    graph.wait_for(
        'streams', 'WARN', '1 message on /estimate could not be decoded as nav_msgs/msg/Odometry'
    )
    graph.wait_for('association', 'OK', pairs=381)


def test_two_publishers_of_a_stream_are_named(graph, another, ros, evaluator, flight, tmp_path):
    node = evaluator(f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    second = another.publisher('/estimate', ros.ESTIMATE)
    graph.wait_for(
        'streams',
        'WARN',
        '2 publishers on /estimate: their poses are mixed (/',
        '/another',
        estimate_publishers=2,
    )
    other = moved(flight.estimate, 2)
    for k in range(0, 400, 2):
        ros.send(estimate, flight.estimate[k : k + 1])
        ros.send(second, other[k + 1 : k + 2])
    ros.send(truth, flight.ground_truth)
    graph.wait_for('diagnosis', 'WARN', 'the estimate jumped by 2')
    graph.wait_for('streams', 'WARN', 'estimate: poses of two trajectories, 2 m apart, take turns')
    another.withdraw(second)
    ros.send(truth, later(flight.ground_truth, 20))
    ros.send(estimate, later(flight.estimate, 20))
    graph.wait_for('association', 'OK')
    graph.wait_for('streams', 'OK', 'running')
    node.stop()
    (result,) = tmp_path.rglob('result.json')
    warnings = json.loads(result.read_text())['warnings']
    assert [line for line in warnings if line.startswith('estimate: 2 publishers on /estimate')]
    assert [line for line in warnings if 'two trajectories, 2 m apart, take turns' in line]


def test_two_evaluators_of_one_name_are_reported(graph, evaluator, process):
    evaluator()
    second = process()
    graph.wait_for('streams', 'WARN', 'there is another /vio_evaluator')
    graph.processes.remove(second.process)
    second.stop()
    graph.wait_until(
        lambda: 'another' not in graph.statuses['streams'].message, 'the one that is left'
    )


def test_a_vehicle_that_stands_still_shows_nothing_yet(graph, ros, evaluator, flight):
    evaluator()
    estimate, truth = graph.both()
    for publisher, poses in ((estimate, flight.estimate), (truth, flight.ground_truth)):
        still = np.zeros(len(poses), int)
        ros.send(
            publisher,
            replace(poses, positions=poses.positions[still], rotations=poses.rotations[still]),
        )
    graph.wait_for('accuracy', 'WARN', 'the alignment is not determined yet', pairs=381)


def test_an_estimator_that_dies_is_reported(graph, ros, evaluator, flight):
    evaluator('stale_after_s:=1.0')
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate[:100])
    ros.send(truth, flight.ground_truth)
    graph.wait_for(
        'association', 'WARN', 'the estimate ends 15.0 s before the ground truth: no values for'
    )


def test_a_queue_that_was_full_is_reported_for_the_run_that_it_was_in(
    graph, ros, evaluator, flight, tmp_path
):
    node = evaluator('qos_overrides./estimate.subscription.depth:=50', f'report_dir:={tmp_path}')
    estimate, truth = graph.both()
    # the node does not look meanwhile: of these the last 50 are there when it does
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for(
        'streams',
        'WARN',
        '350 messages lost on /estimate; /estimate: the queue was full 1 time',
        estimate_received=50,
        estimate_sent_before=0,
    )
    graph.call('reset')
    for part in range(0, 400, 20):
        ros.send(estimate, later(flight.estimate[part : part + 20], 20))
        graph.wait_for('streams', 'any', estimate_received=50 + part + 20)
    ros.send(truth, later(flight.ground_truth, 20))
    graph.wait_for('association', 'OK', pairs=381)
    node.stop()
    warnings = [
        json.loads((tmp_path / run / 'result.json').read_text())['warnings']
        for run in ('run_0001', 'run_0002')
    ]
    told = [[line for line in lines if 'queue was full' in line] for lines in warnings]
    assert told == [
        ['estimate: /estimate: the queue was full 1 time, and may have lost messages'],
        [],
    ]


def test_a_quality_of_service_that_nobody_offers_is_named(graph, ros, evaluator, flight):
    evaluator(reliable=True)
    unreliable = graph.publisher('/estimate', ros.ESTIMATE, reliable=False, matched=False)
    graph.wait_for(
        'streams',
        'WARN',
        'incompatible QoS on /estimate: Best effort publisher and reliable subscription',
        estimate_incompatible_qos=1,
    )
    graph.withdraw(unreliable)
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for('streams', 'OK', 'running', estimate_received=400)
    graph.wait_for('association', 'OK', pairs=381)


def test_reliable_and_best_effort_publishers_are_both_received(graph, ros, evaluator, flight):
    evaluator(reliable=False)
    estimate = graph.publisher('/estimate', ros.ESTIMATE, reliable=False)
    truth = graph.publisher('/ground_truth', ros.GROUND_TRUTH, reliable=True)
    graph.wait_for('streams', 'WARN', 'nothing received on /estimate; nothing received on /ground')
    # few, since best effort may lose what comes in bursts
    ros.send(estimate, flight.estimate[:50])
    ros.send(truth, flight.ground_truth[:125])
    graph.wait_for('streams', 'OK', estimate_received=50, ground_truth_received=125)
    graph.wait_for('association', 'OK', pairs=41)


def test_a_tracking_reset_is_reported_with_its_stamp_and_size(graph, ros, evaluator, flight):
    evaluator()
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate[:200])
    ros.send(estimate, moved(flight.estimate[200:], 3))
    ros.send(truth, flight.ground_truth)
    status = graph.wait_for('diagnosis', 'WARN', 'the estimate jumped by ', ' m at 1403715534.9')
    assert status.values['jump_stamp_ns'] == str(flight.estimate.stamps_ns[200])
    assert float(status.values['jump_m']) == pytest.approx(3, abs=0.1)
    assert graph.statuses['accuracy'].level == 'OK'


def test_an_estimate_that_diverges_is_an_error(graph, ros, evaluator, flight):
    evaluator('window_s:=5.0')
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate[:200])
    ros.send(truth, flight.ground_truth[:500])
    graph.wait_for('accuracy', 'OK', 'running', pairs=181)
    positions = flight.estimate.positions.copy()
    positions[200:] += np.geomspace(1, 1e9, 200)[:, None]
    ros.send(estimate, replace(flight.estimate, positions=positions)[200:300])
    ros.send(truth, flight.ground_truth[500:])
    # it is far too fast before it is far away
    status = graph.wait_for('accuracy', 'ERROR', 'the estimate has diverged', pairs=281)
    assert float(status.values['ate_extent_ratio']) < 10000
    ros.send(estimate, replace(flight.estimate, positions=positions)[300:])
    status = graph.wait_for('accuracy', 'ERROR', 'the estimate has diverged', pairs=381)
    assert float(status.values['ate_trans_rmse_m']) > 1e7
    # it stays so when the estimate moves as it should, but far away
    ros.send(estimate, later(moved(flight.estimate, 1e9), 20))
    ros.send(truth, later(flight.ground_truth, 20))
    graph.wait_for('accuracy', 'ERROR', 'the estimate has diverged', pairs=781)


def test_positions_that_a_lever_arm_cannot_be_taken_from_are_a_clear_problem(
    graph, ros, evaluator, flight
):
    node = evaluator('ground_truth_to_body:=[0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]')
    estimate = graph.publisher('/estimate', ros.ESTIMATE)
    truth = graph.publisher('/ground_truth', 'geometry_msgs/msg/PointStamped')
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    problem = 'poses without orientation cannot be moved to another frame'
    graph.wait_for('accuracy', 'WARN', problem)
    answer = graph.call('write_report')
    assert not answer.success
    assert problem in answer.message
    assert problem in node.stop(status=2)


@pytest.mark.parametrize(
    ('limits', 'level', 'status'), [('max: 0.001', 'ERROR', 1), ('max: 1, warn: 0.001', 'WARN', 0)]
)
def test_a_broken_gate_is_reported_and_decides(
    graph, ros, evaluator, flight, tmp_path, limits, level, status
):
    gates = tmp_path / 'gates.yaml'
    gates.write_text(f'ate_trans_rmse_m: {{{limits}}}')
    node = evaluator(f'gates_file:={gates}', 'exit_code_from_gates:=true')
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for('accuracy', level, 'gate ate_trans_rmse_m at most 0.001 is broken: 0.038')
    node.stop(status)
