"""Live is replay to the last bit, and wrong arguments are said in one line."""

from __future__ import annotations

from collections.abc import Iterable
import csv
import json
import os
from pathlib import Path
import signal
import subprocess

import pytest

from recorded import fixes, odometry, write
from verbs import call, document
from vio_eval_ros.recordings.playback import Playback, TimedMessage

pytestmark = pytest.mark.needs('rclpy')

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'demo' / 'simulated_flight'
V1_02 = 'derived_bags/euroc_V1_02_vins_fusion'
TRUTH_CSV = 'gt_euroc/vins_mono_asl_csv/V1_02_medium/data.csv'
TOPICS = ('/vio/odometry', '/ground_truth/pose')
NAMES = ('estimate', 'ground_truth')
LIMIT_S = 120
BATCH = 5000  # fewer than the queues hold


def assert_same(live: Path, offline: Path) -> None:
    """Check that the reports in two folders are of the same numbers."""
    results = [json.loads((folder / 'result.json').read_text()) for folder in (live, offline)]
    for part in ('metrics', 'association', 'alignment'):
        assert results[0][part] == results[1][part]
    for side in ('estimate', 'ground_truth'):
        one, other = (result['inputs'][side] for result in results)
        assert {**one, 'source': 0, 'kind': 0, 'sha256': 0} == {
            **other, 'source': 0, 'kind': 0, 'sha256': 0
        }  # fmt: skip
    assert results[0]['association']['pairs'] > 100
    rows = [
        list(csv.DictReader((folder / 'series.csv').read_text().splitlines()))
        for folder in (live, offline)
    ]
    assert len(rows[0]) == len(rows[1]) > 10
    for one, other in zip(*rows, strict=True):
        assert one.pop('stamp_ns') == other.pop('stamp_ns')
        values = [{name: float(row[name] or 'nan') for name in row} for row in (one, other)]
        assert values[0] == pytest.approx(values[1], rel=1e-9, nan_ok=True)


def replay_into(folder: Path, *arguments: object) -> None:
    folder.mkdir()
    report = ('--report', f'json:{folder}/result.json', '--series', f'csv:{folder}/series.csv')
    document('replay', *arguments, *report)


class Flight:
    """A recording that is published into an evaluator, message by message."""

    def __init__(self, graph, node, recording: Path, topics: Iterable[str]) -> None:
        self._graph, self._node, self._sent = graph, node, 0
        with Playback(recording) as playback:
            known = {topic.name: topic.msgtype for topic in playback.topics}
            span = (playback.first_ns, playback.last_ns)
            self.messages = list(playback.messages(set(topics), *span))
        self._publishers = {topic: graph.publisher(topic, known[topic]) for topic in topics}

    def publish(self, messages: list[TimedMessage]) -> None:
        """Publish messages and wait until they have arrived."""
        for begin in range(0, len(messages), BATCH):
            for _, topic, cdr in messages[begin : begin + BATCH]:
                self._publishers[topic].publish(cdr)
            self._sent += len(messages[begin : begin + BATCH])
            self._graph.wait_until(lambda: self._node.received == self._sent, 'the messages')


def arguments_of(report: Path, topics: tuple[str, ...]) -> list[str]:
    """Return the arguments of an evaluator of topics of which no message may be lost."""
    remap = [f'{name}:={topic}' for name, topic in zip(NAMES, topics, strict=False)]
    parameters = [f'report_dir:={report}'] + [
        f'qos_overrides.{topic}.subscription.reliability:=reliable' for topic in topics
    ]
    return [
        *(word for rule in remap for word in ('-r', rule)),
        *(word for parameter in parameters for word in ('-p', parameter)),
    ]


@pytest.fixture
def compare(graph, evaluator, tmp_path):
    """Return a function that publishes a recording, replays it, and compares the reports."""

    def check(recording, live=(), offline=(), topics=TOPICS) -> None:
        words = [*arguments_of(tmp_path / 'live', topics), *live]
        node = evaluator(reliable=False, arguments=words)
        flight = Flight(graph, node, recording, topics)
        flight.publish(flight.messages)
        node.stop()
        replay_into(tmp_path / 'offline', recording, *offline)
        assert_same(tmp_path / 'live', tmp_path / 'offline')

    return check


@pytest.mark.parametrize('kind', ['.bag', '_sqlite3', '_mcap'])
def test_live_is_replay_to_the_last_bit(compare, shared_data, kind):
    compare(shared_data / f'{V1_02}{kind}')


def test_live_is_replay_with_the_ground_truth_in_a_file(compare, shared_data):
    file = shared_data / TRUTH_CSV
    compare(
        shared_data / f'{V1_02}.bag',
        live=('-p', f'ground_truth_file:={file}'),
        offline=('--estimate', '/vio/odometry', '--ground-truth', file),
        topics=('/vio/odometry',),
    )


def test_live_is_replay_with_a_truth_of_positions_only(compare, tmp_path, leica_recording):
    compare(
        leica_recording,
        live=('-p', 'alignment:=posyaw'),
        offline=('--alignment', 'posyaw'),
        topics=('/vio/pose', '/leica/position'),
    )
    result = json.loads((tmp_path / 'live' / 'result.json').read_text())
    assert result['inputs']['ground_truth']['position_only']
    assert result['metrics']['ate_rot_rmse_deg'] is None


def test_live_is_replay_with_a_truth_of_satellite_fixes(compare, tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry(400), fixes(400, '/ground_truth/fix'))
    compare(path, topics=('/vio/odometry', '/ground_truth/fix'))
    result = json.loads((tmp_path / 'live' / 'result.json').read_text())
    assert result['inputs']['ground_truth']['position_only']
    assert result['metrics']['ate_trans_rmse_m'] < 1e-4


def test_live_is_replay_of_a_path_that_is_revised(compare, tmp_path, revising_recording):
    compare(revising_recording, topics=('/slam/path', '/ground_truth/pose'))
    result = json.loads((tmp_path / 'live' / 'result.json').read_text())
    assert result['metrics']['loop_closure_gain'] < 1


@pytest.mark.parametrize('first', TOPICS)
def test_the_stream_that_begins_much_later_changes_nothing(graph, evaluator, tmp_path, first):
    node = evaluator(reliable=False, arguments=arguments_of(tmp_path / 'live', TOPICS))
    flight = Flight(graph, node, DEMO, TOPICS)
    ahead = [message for message in flight.messages if message[1] == first]
    behind = [message for message in flight.messages if message[1] != first]
    for messages in (ahead[: len(ahead) // 2], behind, ahead[len(ahead) // 2 :]):
        flight.publish(messages)
        graph.wait_for_statuses()  # it has been evaluated meanwhile
    node.stop()
    replay_into(tmp_path / 'offline', DEMO)
    assert_same(tmp_path / 'live', tmp_path / 'offline')


# From here on as users run it.


@pytest.fixture
def verbs(ros_environment, installed: Path) -> dict[str, str]:
    """Return an environment with the installed verbs, in which nobody else is on the graph."""
    (packages,) = installed.glob('lib/python*/site-packages')
    verbs = installed / 'lib' / 'vio_eval_ros'
    return ros_environment | {
        'PATH': f'{verbs}{os.pathsep}{os.environ["PATH"]}',
        'PYTHONPATH': str(packages),
    }


@pytest.mark.parametrize('name', ['demo', '_sqlite3'])
def test_live_is_replay_of_what_play_publishes(verbs, request, tmp_path, name):
    path = DEMO if name == 'demo' else request.getfixturevalue('shared_data') / f'{V1_02}{name}'
    report = tmp_path / 'live'
    node = subprocess.Popen(
        ['evaluator', '--ros-args', *arguments_of(report, TOPICS)],
        env=verbs,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        options = ('--rate', '20', '--wait-for-subscribers', '--topics', *TOPICS)
        played = subprocess.run(
            ['play', path, *options], env=verbs, capture_output=True, timeout=LIMIT_S, check=False
        )
        assert played.returncode == 0, played.stderr
        node.send_signal(signal.SIGINT)
        said, _ = node.communicate(timeout=LIMIT_S)
        assert node.returncode == 0, said
        assert 'Traceback' not in said
    finally:
        if node.poll() is None:
            node.kill()
            node.communicate()
    replay_into(tmp_path / 'offline', path)
    assert_same(report, tmp_path / 'offline')


QOS = '-p qos_overrides./estimate.subscription'


@pytest.mark.parametrize(
    ('arguments', 'problem'),
    [
        ('-p alignmnt:=se3', "there is no parameter 'alignmnt'; did you mean 'alignment'?"),
        ('-p alignment:=se4', "alignment: 'se4' is not one of"),
        ('-p max_gap_s:=-1.0', 'max_gap_s: -1 is below 0'),
        ('-p window_s:=.nan', "window_s: 'nan' is not a finite number"),
        ('-p report_dir:=3', "report_dir: '3' is not a word"),
        ('-p max_pairs:=3', 'max_pairs: 3 is below 1000'),
        ('-p gates_file:=/nowhere.yaml', 'gates_file: /nowhere.yaml: No such file'),
        ('-p ground_truth_file:=/nowhere.txt', '/nowhere.txt'),
        ('-p limits_file:=/nowhere.yaml', 'limits_file: /nowhere.yaml: No such file'),
        ('-p profile:=boat', "profile: 'boat' is not one of drone, car, handheld"),
        ('-p estimate_type:=std_msgs/msg/String', 'carries no pose'),
        ('-p rpe_deltas:=[1q]', "rpe_deltas: '1q' is not a valid delta"),
        ('-p publish_metrics:=[ate]', "there is no metric 'ate'"),
        ('-p use_sim_time:=maybe', "'use_sim_time' to 'maybe' of type 'STRING', expecting type"),
        (f'{QOS}.reliability:=relible', 'policy `reliability`: `relible`'),
        (f'{QOS}.depth:=deep', "expecting type 'INTEGER'"),
        (f'{QOS}.depth:=0', 'qos_overrides./estimate: depth must be from 1 to 1000000'),
        (f'{QOS}.history:=system_default', 'history must be keep_last or keep_all'),
        (
            f'{QOS}.relability:=reliable',
            "did you mean 'qos_overrides./estimate",
        ),
        ('-r estimate:=/pose -r ground_truth:=/pose', 'estimate and ground_truth are both /pose'),
        ('-p alignment', "Couldn't parse parameter override rule: '-p alignment'"),
        ('--params-file /nowhere.yaml', 'Error opening YAML file'),
        ('--alignment se3', "--ros-args: not understood: ['--alignment', 'se3']"),
    ],
)
def test_a_wrong_argument_is_one_line_and_status_2(environment, arguments, problem, capfd):
    done = call('evaluator', '--ros-args', *arguments.split())
    said = done.stderr + capfd.readouterr().err  # of Python, and of the libraries below it
    assert done.returncode == 2, said
    assert problem in said
    assert said.count('\n') == 1, said


def test_a_live_evaluation_is_not_weighted(environment, tmp_path, capfd):
    file = tmp_path / 'truth.txt'
    file.write_text(''.join(f'{k} {k} 0 0 0 0 0 1\n' for k in range(1, 9)))
    spec = f'{file}?weights=covariance'
    done = call('evaluator', '--ros-args', '-p', f'ground_truth_file:={spec}')
    said = done.stderr + capfd.readouterr().err
    assert (done.returncode, said.count('\n')) == (2, 1), said
    assert f'ground_truth_file: {spec}: weights=covariance is for the ground truth of' in said


@pytest.mark.parametrize(
    ('arguments', 'problem'),
    [
        ('-p alignmnt:=se3', "there is no parameter 'alignmnt'; did you mean 'alignment'?"),
        ('-p alignment', "Couldn't parse parameter override rule: '-p alignment'"),
    ],
)
def test_a_wrong_argument_of_the_installed_verb_is_one_line(verbs, arguments, problem):
    done = subprocess.run(
        ['evaluator', '--ros-args', *arguments.split()],
        env=verbs,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert problem in done.stderr
    assert done.stderr.count('\n') == 1, done.stderr
