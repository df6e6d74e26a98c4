"""The evaluator as its users run it: a process beside one that plays a recording."""

from collections.abc import Iterator
from contextlib import contextmanager
import csv
import json
import os
from pathlib import Path
import signal
import subprocess
import time

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2: pip install ".[ros]"')

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'demo' / 'simulated_flight'
V1_02 = 'derived_bags/euroc_V1_02_vins_fusion'
TRUTH_CSV = 'gt_euroc/vins_mono_asl_csv/V1_02_medium/data.csv'
TOPICS = ('-r', 'estimate:=/vio/odometry', '-r', 'ground_truth:=/ground_truth/pose')
TOPICS_PLAYED = ('/vio/odometry', '/ground_truth/pose')
LIMIT_S = 60


@pytest.fixture
def environment(ros, ros_environment, installed: Path) -> dict[str, str]:
    """Return an environment with the installed verbs, in which nobody else is on the graph."""
    (packages,) = installed.glob('lib/python*/site-packages')
    verbs = installed / 'lib' / 'vio_eval_ros'
    return ros_environment | {
        'PATH': f'{verbs}{os.pathsep}{os.environ["PATH"]}',
        'PYTHONPATH': str(packages),
    }


def verb(name: str, *arguments: object) -> list[str]:
    return [name, *map(str, arguments)]


@contextmanager
def evaluator(environment, *arguments: object) -> Iterator[subprocess.Popen]:
    """Start the node; end it as Ctrl-C does."""
    process = subprocess.Popen(
        verb('evaluator', '--ros-args', *arguments, *TOPICS),
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 0, said
        assert 'Traceback' not in said
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def play(environment, recording: Path, *arguments: object) -> None:
    done = subprocess.run(
        verb('play', recording, '--rate', 20, '--wait-for-subscribers', *arguments),
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def replayed(environment, *arguments: object) -> dict:
    done = subprocess.run(
        verb('replay', *arguments, '--json'),
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
    )
    return json.loads(done.stdout)


def reliable(*topics: str) -> list[str]:
    return [
        word
        for topic in topics
        for word in ('-p', f'qos_overrides.{topic}.subscription.reliability:=reliable')
    ]


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


def replay_into(folder: Path, environment, *arguments: object) -> None:
    folder.mkdir()
    report = ('--report', f'json:{folder}/result.json', '--series', f'csv:{folder}/series.csv')
    replayed(environment, *arguments, *report)


def compare(environment, tmp_path, recording, live=(), offline=(), topics=TOPICS_PLAYED) -> None:
    """Play into the evaluator, replay the same, and compare."""
    options = ('-p', f'report_dir:={tmp_path}/live', *reliable(*topics), *live)
    with evaluator(environment, *options):
        play(environment, recording, '--topics', *topics)
    replay_into(tmp_path / 'offline', environment, recording, *offline)
    assert_same(tmp_path / 'live', tmp_path / 'offline')


@pytest.mark.parametrize('kind', ['.bag', '_sqlite3', '_mcap'])
def test_live_is_replay_to_the_last_bit(environment, tmp_path, shared_data, kind):
    compare(environment, tmp_path, shared_data / f'{V1_02}{kind}')


def test_live_is_replay_of_the_demo(environment, tmp_path):
    compare(environment, tmp_path, DEMO)


def test_live_is_replay_with_the_ground_truth_in_a_file(environment, tmp_path, shared_data):
    file = shared_data / TRUTH_CSV
    compare(
        environment,
        tmp_path,
        shared_data / f'{V1_02}.bag',
        live=('-p', f'ground_truth_file:={file}'),
        offline=('--estimate', '/vio/odometry', '--ground-truth', file),
        topics=('/vio/odometry',),
    )


def test_live_is_replay_with_a_truth_of_positions_only(environment, tmp_path, leica_recording):
    topics = ('/vio/pose', '/leica/position')
    remap = ('-r', 'estimate:=/vio/pose', '-r', 'ground_truth:=/leica/position')
    live, offline = ('-p', 'alignment:=posyaw'), ('--alignment', 'posyaw')
    compare(environment, tmp_path, leica_recording, (*remap, *live), offline, topics)
    result = json.loads((tmp_path / 'live' / 'result.json').read_text())
    assert result['inputs']['ground_truth']['position_only']
    assert result['metrics']['ate_rot_rmse_deg'] is None


def test_live_is_replay_of_a_path_that_is_revised(environment, tmp_path, revising_recording):
    topics = ('/slam/path', '/ground_truth/pose')
    options = ('-r', 'estimate:=/slam/path')
    compare(environment, tmp_path, revising_recording, options, topics=topics)
    result = json.loads((tmp_path / 'live' / 'result.json').read_text())
    assert result['metrics']['loop_closure_gain'] < 1


@pytest.mark.parametrize('first', TOPICS_PLAYED)
def test_the_stream_that_begins_five_seconds_later_changes_nothing(environment, tmp_path, first):
    (second,) = set(TOPICS_PLAYED) - {first}
    options = ('-p', f'report_dir:={tmp_path}/live', *reliable(*TOPICS_PLAYED))
    with evaluator(environment, *options):
        ahead = subprocess.Popen(
            verb('play', DEMO, '--rate', 8, '--wait-for-subscribers', '--topics', first),
            env=environment,
            stderr=subprocess.DEVNULL,
        )
        try:
            time.sleep(5)
            play(environment, DEMO, '--topics', second, '--rate', 8)
            assert ahead.wait(timeout=LIMIT_S) == 0
        finally:
            ahead.kill()
            ahead.wait()
    replay_into(tmp_path / 'offline', environment, DEMO)
    assert_same(tmp_path / 'live', tmp_path / 'offline')


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
def test_a_wrong_argument_is_one_line_and_status_2(environment, arguments, problem):
    done = subprocess.run(
        verb('evaluator', '--ros-args', *arguments.split()),
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert problem in done.stderr
    assert done.stderr.count('\n') == 1, done.stderr
