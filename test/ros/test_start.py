"""How the live node begins: what it hears of those who were there before it."""

import json

import pytest

ODOMETRY, POSE = 'nav_msgs/msg/Odometry', 'geometry_msgs/msg/PoseStamped'
GIVEN = ('estimate_type:=nav_msgs/msg/Odometry', 'ground_truth_type:=geometry_msgs/PoseStamped')


def warnings(folder) -> list[str]:
    """Return the warnings of the only result below a folder."""
    (result,) = folder.rglob('result.json')
    return json.loads(result.read_text())['warnings']


@pytest.mark.parametrize('given', [(), GIVEN])
def test_what_was_sent_before_is_counted_and_told(graph, ros, evaluator, flight, tmp_path, given):
    estimate = graph.publisher('/estimate', ODOMETRY, matched=False)
    truth = graph.publisher('/ground_truth', POSE, matched=False)
    ros.send(estimate, flight.estimate[:12])
    node = evaluator(*given, f'report_dir:={tmp_path}')
    graph.match(estimate)
    graph.match(truth)
    ros.send(estimate, flight.estimate[12:])
    ros.send(truth, flight.ground_truth)
    told = '12 messages of /estimate were sent before the evaluator subscribed'
    graph.wait_for('streams', 'OK', told, estimate_sent_before=12, ground_truth_sent_before=0)
    graph.wait_for('association', 'any', pairs=369)
    node.stop()
    assert f'estimate: {told}' in warnings(tmp_path)


@pytest.mark.parametrize('given', [(), GIVEN])
@pytest.mark.parametrize('reliable', [True, False])
def test_latched_publishers_that_came_first_are_heard(
    graph, ros, evaluator, flight, tmp_path, given, reliable
):
    estimate = graph.publisher('/estimate', ODOMETRY, matched=False, latched=True)
    truth = graph.publisher('/ground_truth', POSE, matched=False, latched=True)
    ros.send(estimate, flight.estimate[:300])
    ros.send(truth, flight.ground_truth)
    node = evaluator(*given, f'report_dir:={tmp_path}', reliable=reliable)
    graph.match(estimate)
    graph.wait_for('streams', 'any', estimate_received=300, ground_truth_received=1000)
    ros.send(estimate, flight.estimate[300:])
    graph.wait_for('association', 'OK', pairs=381, estimate_duplicate=0)
    graph.wait_for('streams', 'any', estimate_sent_before=0, estimate_lost=0)
    node.stop()
    assert not [line for line in warnings(tmp_path) if 'sent before' in line or 'lost' in line]


def test_durability_follows_the_offers_and_nothing_is_heard_twice(
    graph, another, ros, evaluator, flight
):
    evaluator(*GIVEN, reliable=False)
    truth = graph.publisher('/ground_truth', POSE)
    ros.send(truth, flight.ground_truth)
    latched = graph.publisher('/estimate', ODOMETRY, latched=True)
    ros.send(latched, flight.estimate[:100])
    graph.wait_for('streams', 'any', estimate_received=100)
    fleeting = another.publisher('/estimate', ODOMETRY)  # a subscription to both is not latched
    graph.wait_for('streams', 'WARN', '2 publishers on /estimate')
    another.withdraw(fleeting)
    another.wait_for('streams', 'any', estimate_publishers=1)
    ros.send(latched, flight.estimate[100:])
    graph.wait_for('association', 'OK', pairs=381, estimate_duplicate=0)
    graph.wait_for('streams', 'any', estimate_received=400)


def test_a_topic_of_known_type_is_subscribed_to_before_anybody_publishes_it(graph, evaluator):
    evaluator(*GIVEN)
    graph.wait_for('streams', 'WARN', 'nobody publishes /estimate', estimate_type=ODOMETRY)
    for topic in ('/estimate', '/ground_truth'):
        graph.wait_until(lambda: graph.subscribers(topic) == 1, topic)  # noqa: B023


@pytest.mark.slow
@pytest.mark.parametrize('stays', [True, False])
def test_a_publisher_that_never_sends_does_not_set_the_type(
    graph, another, ros, process, flight, stays
):
    process()
    silent = another.publisher('/estimate', POSE)
    graph.wait_for('streams', 'WARN', 'nothing received on /estimate', estimate_type=POSE)
    if not stays:
        another.withdraw(silent)
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for('association', 'OK', pairs=381)
    if stays:
        graph.wait_for('streams', 'WARN', f'only {ODOMETRY} is read')


def test_where_the_graph_gives_no_events_it_is_looked_at(
    graph, ros, evaluator, flight, monkeypatch
):
    from vio_eval_ros.ros import private

    monkeypatch.setattr(private, 'LIBRARY', 'no_such_library.so')
    evaluator()
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for('association', 'OK', pairs=381)
