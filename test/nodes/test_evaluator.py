"""The evaluator as its users run it: a process beside one that plays a recording."""

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import random
import signal
import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2: pip install ".[ros]"')

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'demo' / 'simulated_flight'
V1_02 = 'derived_bags/euroc_V1_02_vins_fusion'
TOPICS = ('-r', 'estimate:=/vio/odometry', '-r', 'ground_truth:=/ground_truth/pose')
LIMIT_S = 60


@pytest.fixture
def environment() -> dict[str, str]:
    """Return an environment in which nobody else is on the ROS graph."""
    return os.environ | {
        'PYTHONPATH': str(ROOT),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': str(random.randint(61, 90)),
    }


def verb(name: str, *arguments: object) -> list[str]:
    return [sys.executable, '-m', 'vio_eval_ros', name, *map(str, arguments)]


@contextmanager
def evaluator(environment, *arguments: object) -> Iterator[subprocess.Popen]:
    """Start the node; end it as Ctrl-C does."""
    process = subprocess.Popen(
        verb('evaluator', '--ros-args', *TOPICS, *arguments),
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


@pytest.mark.parametrize('recording', ['demo', '.bag', '_sqlite3', '_mcap'])
def test_live_is_replay_to_the_last_bit(environment, tmp_path, request, recording):
    path = DEMO
    if recording != 'demo':
        path = request.getfixturevalue('shared_data') / f'{V1_02}{recording}'
    reliable = [
        word
        for topic in ('/vio/odometry', '/ground_truth/pose')
        for word in ('-p', f'qos_overrides.{topic}.subscription.reliability:=reliable')
    ]
    with evaluator(environment, '-p', f'report_dir:={tmp_path}', *reliable):
        play(environment, path, '--topics', '/vio/odometry', '/ground_truth/pose')
    live = json.loads((tmp_path / 'result.json').read_text())
    offline = replayed(environment, path)
    for part in ('metrics', 'association', 'alignment'):
        assert live[part] == offline[part]
    series = (tmp_path / 'series.csv').read_text()
    replayed(environment, path, '--series', f'csv:{tmp_path}/offline.csv')
    assert series.splitlines()[0] == (tmp_path / 'offline.csv').read_text().splitlines()[0]
    assert series.splitlines()[-1] == (tmp_path / 'offline.csv').read_text().splitlines()[-1]


@pytest.mark.parametrize(
    ('parameter', 'problem'),
    [
        ('alignmnt:=se3', "there is no parameter 'alignmnt'; did you mean 'alignment'?"),
        ('alignment:=se4', "alignment: 'se4' is not one of"),
        ('max_gap_s:=-1.0', 'max_gap_s: -1 is below 0'),
        ('gates_file:=/nowhere.yaml', '/nowhere.yaml: No such file'),
        ('ground_truth_file:=/nowhere.txt', '/nowhere.txt'),
        ('estimate_type:=std_msgs/msg/String', 'carries no pose'),
        ('publish_metrics:=[ate]', "there is no metric 'ate'"),
    ],
)
def test_a_wrong_parameter_is_one_line_and_status_2(environment, parameter, problem):
    done = subprocess.run(
        verb('evaluator', '--ros-args', '-p', parameter),
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 2
    assert problem in done.stderr
    assert done.stderr.count('\n') == 1, done.stderr


def test_the_file_of_defaults_is_a_parameter_file(environment):
    with evaluator(environment, '--params-file', ROOT / 'config' / 'evaluator.yaml') as process:
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=5)
