"""Several estimates of one ground truth in one node."""

from dataclasses import replace
import json

import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation

BOTH = [
    "estimates:=['good:=/good', 'bad:=/bad']",
    'ground_truth:=/ground_truth',
    *(
        f'qos_overrides./{name}.subscription.reliability:=reliable'
        for name in ('good', 'bad', 'ground_truth')
    ),
]


@pytest.fixture
def bad(flight):
    """Return an estimate with noise."""
    noise = np.random.default_rng(1).normal(scale=0.3, size=flight.estimate.positions.shape)
    return replace(flight.estimate, positions=flight.estimate.positions + noise)


def scored(estimate, truth):
    """Return what an estimate scores by itself."""
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_estimate(estimate)
    evaluation.add_ground_truth(truth)
    evaluation.flush()
    metrics = evaluation.summary().metrics
    return {name: value if value == value else None for name, value in metrics.items()}


def publishers(graph, ros):
    return [
        graph.publisher('/good', ros.ESTIMATE),
        graph.publisher('/bad', ros.ESTIMATE),
        graph.publisher('/ground_truth', ros.GROUND_TRUTH),
    ]


def fly(graph, ros, flight, bad, loops=1):
    """Publish both estimates; the ground truth comes once."""
    streams = publishers(graph, ros)
    for _ in range(loops):
        for stream, poses in zip(
            streams, (flight.estimate, bad, flight.ground_truth), strict=True
        ):
            ros.send(stream, poses)


RELIABLE = [
    f'qos_overrides./{name}.subscription.reliability:=reliable' for name in ('good', 'bad')
]


def test_each_estimate_has_the_figures_it_has_alone(graph, ros, evaluator, flight, bad, tmp_path):
    node = evaluator(*BOTH, f'report_dir:={tmp_path}', reliable=False)
    fly(graph, ros, flight, bad)
    graph.wait_until(lambda: node.received == 1800, 'all messages')
    node.stop()
    for name, poses in (('good', flight.estimate), ('bad', bad)):
        result = json.loads((tmp_path / name / 'result.json').read_text())
        assert result['metrics'] == scored(poses, flight.ground_truth)
        assert result['inputs']['estimate']['source'] == f'/{name}'
        assert (tmp_path / name / 'estimate.tum').exists()
    comparison = json.loads((tmp_path / 'comparison.json').read_text())
    assert [system['name'] for system in comparison['systems']] == ['good', 'bad']
    assert '| good' in (tmp_path / 'comparison.md').read_text()
    for page in ('comparison.html', 'good/result.html', 'bad/result.html'):
        assert (tmp_path / page).read_text().endswith('</html>\n')
    assert any('good' in line and 'ATE' not in line for line in node.told)


def test_the_names_are_in_topics_and_statuses(graph, ros, evaluator, flight, bad):
    evaluator(*BOTH, reliable=False, arguments=['-r', '__ns:=/robot1'])
    heard = graph.listen('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
    fly(graph, ros, flight, bad)
    names = {
        f'/robot1/vio_evaluator/{label}: {kind}'
        for label in ('good', 'bad')
        for kind in ('accuracy', 'association', 'diagnosis', 'metrics', 'streams')
    }
    graph.wait_until(
        lambda: names <= {status.name for array in heard for status in array.status}, 'all names'
    )
    ids = {status.hardware_id for array in heard for status in array.status}
    assert ids == {'/robot1/vio_evaluator/good', '/robot1/vio_evaluator/bad'}
    assert {
        '/robot1/vio_evaluator/good/metrics/ate_trans_rmse_m',
        '/robot1/vio_evaluator/bad/window/ate_trans_rmse_m',
        '/robot1/vio_evaluator/bad/result',
        '/robot1/vio_evaluator/good/estimate_aligned',
    } <= graph.topics()


def test_running_values_carry_the_stamp_of_their_data(graph, ros, evaluator, flight):
    evaluator()
    heard = graph.listen('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)

    def stamps():
        return [
            array.header.stamp.sec
            for array in heard
            if array.status[0].name == '/vio_evaluator: metrics'
        ]

    graph.wait_until(lambda: len(stamps()) == 20, 'a message for each second')
    first_s = flight.ground_truth.stamps_ns[0] / 1e9
    assert stamps() == [int(np.ceil(first_s)) + k for k in range(20)]


def test_all_estimates_begin_another_run_together(graph, ros, evaluator, flight, bad, tmp_path):
    node = evaluator(*BOTH, f'report_dir:={tmp_path}', reliable=False)
    fly(graph, ros, flight, bad, loops=2)
    graph.wait_until(lambda: node.received == 3600, 'all messages')
    node.stop()
    for run in ('run_0001', 'run_0002'):
        assert (tmp_path / run / 'comparison.json').exists()
        for name, poses in (('good', flight.estimate), ('bad', bad)):
            result = json.loads((tmp_path / run / name / 'result.json').read_text())
            assert result['metrics'] == scored(poses, flight.ground_truth)
    assert not (tmp_path / 'comparison.json').exists()


def test_an_estimate_that_never_comes_does_not_stop_the_others(
    graph, ros, evaluator, flight, tmp_path
):
    node = evaluator(*BOTH, f'report_dir:={tmp_path}', reliable=False)
    good = graph.publisher('/good', ros.ESTIMATE)
    truth = graph.publisher('/ground_truth', ros.GROUND_TRUTH)
    ros.send(good, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_until(lambda: node.received == 1400, 'all messages')
    node.stop()
    found = json.loads((tmp_path / 'good' / 'result.json').read_text())
    assert found['metrics'] == scored(flight.estimate, flight.ground_truth)
    none = json.loads((tmp_path / 'bad' / 'result.json').read_text())
    assert none['association']['pairs'] == 0
    assert any('bad' in line and '-' in line for line in node.told)
