"""What the live node offers to others: topics, services and parameters."""

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def flown(graph, ros, flight):
    """Return a function that publishes the flight and waits until it is evaluated."""

    def fly() -> None:
        estimate, truth = graph.both()
        ros.send(estimate, flight.estimate)
        ros.send(truth, flight.ground_truth)
        graph.wait_for_arrival()

    return fly


def test_every_topic_can_be_listened_to(graph, another, flown, evaluator, flight):
    evaluator('stale_after_s:=0.5', 'publish_metrics:=[ate_trans_rmse_m, ate_trans_max_m]')
    float64 = 'std_msgs/msg/Float64'
    running = graph.listen('/vio_evaluator/metrics/ate_trans_rmse_m', float64)
    window = graph.listen('/vio_evaluator/window/ate_trans_rmse_m', float64)
    largest = graph.listen('/vio_evaluator/window/ate_trans_max_m', float64)
    flown()
    graph.wait_until(lambda: len(running) == 20 and window and largest, 'running metrics')
    accuracy = graph.statuses['accuracy'].values
    assert running[-1].data == float(accuracy['ate_trans_rmse_m'])
    assert 0 < window[-1].data < largest[-1].data
    names = {'accuracy', 'association', 'streams', 'diagnosis', 'metrics', 'timing'}
    assert set(graph.statuses) == names
    # as PlotJuggler names what it plots
    metrics = graph.statuses['metrics']
    plotted = ElementTree.parse(ROOT / 'config' / 'plotjuggler.xml').iter('curve')
    assert {curve.get('name') for curve in plotted} <= {
        f'/diagnostics/{metrics.hardware_id}/{metrics.name}/{key}' for key in metrics.values
    }
    # what is latched reaches those who come late
    graph.wait_for('streams', 'OK', 'ended: ')
    results = another.listen('/vio_evaluator/result', 'std_msgs/msg/String', latched=True)
    paths = [
        another.listen(f'/vio_evaluator/{name}', 'nav_msgs/msg/Path', latched=True)
        for name in ('estimate_aligned', 'ground_truth_path')
    ]
    markers = another.listen(
        '/vio_evaluator/error_markers', 'visualization_msgs/msg/MarkerArray', latched=True
    )
    another.wait_until(lambda: results and all(paths) and markers, 'what is latched')
    assert json.loads(results[0].data)['association']['pairs'] == 400
    for path, *_ in paths:
        assert path.header.frame_id == 'map'
        assert len(path.poses) == 381
    aligned, truth = (path[0].poses[-1].pose.position for path in paths)
    assert math.dist((aligned.x, aligned.y, aligned.z), (truth.x, truth.y, truth.z)) < 0.2
    (marker,) = markers[0].markers
    assert len(marker.points) == len(marker.colors) == 381


def test_other_deltas_need_no_other_metrics(graph, evaluator):
    evaluator("rpe_deltas:=['0.5s']")
    graph.wait_for('accuracy', 'WARN', 'no pairs yet')
    published = {name for name in graph.topics() if '/metrics/' in name}
    assert published == {
        f'/vio_evaluator/metrics/ate_{n}' for n in ('trans_rmse_m', 'rot_rmse_deg')
    }


def test_metrics_without_a_running_value_have_no_running_topic(graph, evaluator):
    evaluator('publish_metrics:=[ate_trans_rmse_m, ate_trans_max_m]')
    graph.wait_for('accuracy', 'WARN', 'no pairs yet')
    topics = graph.topics()
    assert topics >= {f'/vio_evaluator/window/ate_trans_{name}_m' for name in ('rmse', 'max')}
    assert '/vio_evaluator/metrics/ate_trans_rmse_m' in topics
    assert '/vio_evaluator/metrics/ate_trans_max_m' not in topics


def test_services_write_the_report_and_begin_a_new_run(graph, ros, flown, evaluator, tmp_path):
    evaluator(f'report_dir:={tmp_path}')
    assert graph.call('reset').message == 'run 1 begins'  # there is nothing to end
    flown()
    answer = graph.call('write_report')
    assert (answer.success, answer.message) == (True, str(tmp_path))
    assert json.loads((tmp_path / 'result.json').read_text())['association']['pairs'] == 400
    answer = graph.call('reset')
    assert (answer.success, answer.message) == (True, 'run 2 begins')
    first = json.loads((tmp_path / 'run_0001' / 'result.json').read_text())
    assert first['association']['pairs'] == 400
    graph.wait_for('accuracy', 'WARN', 'no pairs yet')
    graph.wait_for('diagnosis', 'OK', 'run 2 began as reset was called')


def test_what_goes_on_after_a_reset_is_in_the_new_run(graph, ros, flight, evaluator):
    evaluator()
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate[:200])
    ros.send(truth, flight.ground_truth[:500])
    graph.wait_for_arrival(200, 500)
    graph.call('reset')
    ros.send(estimate, flight.estimate[200:])
    ros.send(truth, flight.ground_truth[500:])
    graph.wait_for('association', 'OK', pairs=181, estimate_late=0, ground_truth_late=0)


def test_parameters_are_described(graph, evaluator):
    evaluator('max_gap_s:=1')
    names = graph.parameters('list_parameters').result.names
    for name in EvaluationConfig().to_dict():
        assert name in names
    asked = ['alignment', 'max_gap_s', 'time_offset_s', 'window_s', 'report_dir', 'max_pairs']
    described = graph.parameters('describe_parameters', asked).descriptors
    alignment, gap, offset, window, report, pairs = described
    assert alignment.additional_constraints == 'one of none, origin, scale, posyaw, se3, sim3'
    assert 'removed before the absolute error' in alignment.description
    assert all(parameter.read_only for parameter in (alignment, gap, offset, pairs))
    assert not window.read_only
    assert not report.read_only
    (range_,) = gap.floating_point_range
    assert (range_.from_value, range_.to_value) == (0, math.inf)
    assert not offset.floating_point_range
    assert window.floating_point_range
    assert pairs.integer_range[0].from_value == 1000
    values = graph.parameters('get_parameters', ['max_gap_s', 'alignment', 'rpe_deltas']).values
    assert values[0].double_value == 1
    assert values[1].string_value == 'se3'
    assert values[2].string_array_value == ['1f', '1s', '10m']


def test_the_file_of_defaults_is_a_parameter_file(graph, evaluator):
    evaluator(arguments=['--params-file', str(ROOT / 'config' / 'evaluator.yaml')])
    values = graph.parameters('get_parameters', ['alignment', 'end_s', 'segment_lengths_m']).values
    assert values[0].string_value == 'se3'
    assert values[1].double_value == math.inf
    assert not values[2].double_array_value


def test_parameters_that_do_not_change_the_score_can_be_set(
    graph, ros, flown, evaluator, tmp_path
):
    evaluator()

    def set_to(name: str, value: object) -> str:
        """Return why a value was rejected, if it was."""
        (result,) = graph.parameters('set_parameters', [ros.Parameter(name, value=value)]).results
        assert result.successful == (not result.reason)
        return result.reason

    assert set_to('alignment', 'sim3') == 'Trying to set a read-only parameter: alignment.'
    assert set_to('window_s', 'long') == "window_s: 'long' is not a finite number"
    assert set_to('window_s', 0) == 'window_s: 0 is below 0.1'
    assert 'out of range' in set_to('window_s', 0.0)
    assert (
        set_to('exit_code_from_gates', 3) == "exit_code_from_gates: '3' is neither true nor false"
    )
    assert set_to('window_s', 5) == ''
    assert set_to('stale_after_s', 0.5) == ''
    taken = tmp_path / 'taken'
    taken.write_text('a file')
    assert set_to('report_dir', str(taken)).startswith(f'{taken}: cannot write')
    assert set_to('report_dir', str(tmp_path)) == ''
    flown()
    graph.wait_for('streams', 'OK', 'ended: ')
    assert graph.call('write_report').message == str(tmp_path)
    assert (tmp_path / 'result.json').exists()


def test_every_metric_can_have_a_topic(graph, flown, evaluator):
    names = metric_names(EvaluationConfig(rpe_deltas=('0.5s', '1f'), segment_lengths_m=(5.0,)))
    evaluator(
        "rpe_deltas:=['0.5s', '1f']",
        'segment_lengths_m:=[5.0]',
        f'publish_metrics:=[{", ".join(names)}]',
    )
    shown = ('rpe_1f_pairs', 'rpe_0.5s_trans_rmse_m', 'coverage_ratio')
    heard = {
        name: graph.listen(
            f'/vio_evaluator/metrics/{name.replace(".", "_")}', 'std_msgs/msg/Float64'
        )
        for name in shown
    }
    flown()
    graph.wait_until(lambda: all(len(values) == 20 for values in heard.values()), 'the values')
    told = graph.statuses['accuracy'].values | graph.statuses['association'].values
    for name, values in heard.items():
        assert values[-1].data == float(told[name])


def test_what_was_written_during_the_first_run_is_not_taken_for_the_last(
    graph, flown, evaluator, tmp_path
):
    evaluator(f'report_dir:={tmp_path}')
    flown()
    (tmp_path / 'mine.txt').write_text('is not theirs')
    assert graph.call('write_report').success
    assert graph.call('reset').success
    assert {path.name for path in tmp_path.iterdir()} == {'run_0001', 'mine.txt'}


def test_a_reset_before_the_end_changes_nothing_about_the_verdict(
    graph, flown, evaluator, tmp_path
):
    gates, reports = tmp_path / 'gates.yaml', tmp_path / 'reports'
    gates.write_text('ate_trans_rmse_m: {max: 1}')
    node = evaluator(
        f'gates_file:={gates}', 'exit_code_from_gates:=true', f'report_dir:={reports}'
    )
    flown()
    graph.call('reset')
    assert 'broken' not in node.stop()
    assert [path.name for path in reports.iterdir()] == ['run_0001']


def test_a_report_folder_can_be_mended(graph, ros, flown, evaluator, tmp_path):
    taken, mended = tmp_path / 'taken', tmp_path / 'mended'
    taken.write_text('a file')
    node = evaluator(f'report_dir:={taken}')
    flown()
    graph.wait_for('accuracy', 'WARN', f'{taken}: cannot write')
    parameter = ros.Parameter('report_dir', value=str(mended))
    graph.parameters('set_parameters', [parameter])
    graph.wait_for('accuracy', 'OK', 'running')
    assert f'{mended}' not in node.stop()
    assert (mended / 'result.json').exists()
