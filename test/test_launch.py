"""The launch files: what they take, what they start, and the status with which they end."""

import ast
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
import importlib.util
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest

from ros_domain import private_domain
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.recordings.sources import read_sources

ROOT = Path(__file__).resolve().parents[1]
LAUNCH_FILES = sorted((ROOT / 'launch').glob('*.launch.py'))
DEMO = ROOT / 'demo' / 'simulated_flight'
LIMIT_S = 60

# what `ros2 launch` does, for where only the two packages behind it are installed
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
arguments = [word.split(':=', 1) for word in sys.argv[2:]]
service = LaunchService(noninteractive=True)
service.include_launch_description(LaunchDescription([
    IncludeLaunchDescription(sys.argv[1], launch_arguments=arguments)
]))
sys.exit(service.run())
"""


def names_in(file: Path, table: str) -> list[str]:
    """Return the keys of a dict, or the items of a tuple, at the top of a file."""
    for statement in ast.parse(file.read_text()).body:
        if isinstance(statement, ast.Assign) and statement.targets[0].id == table:
            value = statement.value
            items = value.keys if isinstance(value, ast.Dict) else value.elts
            return [item.value for item in items]
    raise AssertionError(f'{file} has no {table}')


def test_both_launch_files_are_there_and_are_python():
    assert [file.name for file in LAUNCH_FILES] == ['euroc.launch.py', 'evaluator.launch.py']
    for file in LAUNCH_FILES:
        compile(file.read_text(), file, 'exec')


@pytest.mark.parametrize('file', LAUNCH_FILES, ids=lambda file: file.name)
def test_every_argument_is_documented(file):
    documented = re.findall(r'^\| `(\w+)` \|', section(f'`{file.name}`'), re.MULTILINE)
    assert documented == names_in(file, 'ARGUMENTS')


def section(title: str) -> str:
    """Return what docs/live.md says under a heading."""
    text = (ROOT / 'docs' / 'live.md').read_text()
    begin = text.index(f'### {title}\n')
    end = re.compile(r'^##+ ', re.MULTILINE).search(text, begin + 4)
    return text[begin : end.start() if end else None]


def test_every_parameter_that_is_set_exists():
    file = ROOT / 'launch' / 'evaluator.launch.py'
    known = {item.name for item in fields(NodeConfig)}
    assert set(names_in(file, 'PARAMETERS')) - {'use_sim_time'} <= known
    assert 'exit_code_from_gates' in known
    assert set(names_in(file, 'PARAMETERS')) <= set(names_in(file, 'ARGUMENTS'))
    assert {'estimate', 'estimates', 'ground_truth'} <= set(names_in(file, 'PARAMETERS'))


def test_every_truth_of_a_recording_has_a_file_of_parameters():
    tree = ast.parse((ROOT / 'launch' / 'euroc.launch.py').read_text())
    (truths,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and node.targets[0].id == 'TRUTHS'
    )
    for topic, file in truths.items():
        assert topic in (ROOT / 'config' / file).read_text()


def test_launch_files_settings_gates_and_layouts_are_installed(installed):
    share = installed / 'share' / 'vio_eval_ros'
    for folder in ('launch', 'config', 'config/gates'):
        files = {file.name for file in (ROOT / folder).iterdir() if file.is_file()}
        assert files == {file.name for file in (share / folder).iterdir() if file.is_file()}


# From here on with real processes.


@pytest.fixture
def launched(installed, tmp_path) -> Iterator[Callable]:
    """Return what starts a launch file of the workspace, with its arguments."""
    for package in ('rclpy', 'launch_ros'):
        if not importlib.util.find_spec(package):
            pytest.skip(f'needs {package}, which is in installations of ROS 2')

    @contextmanager
    def start(*command: object) -> Iterator[subprocess.Popen]:
        process = subprocess.Popen(
            ['bash', '-c', '. ../local_setup.bash && exec "$@"', 'bash', *map(str, command)],
            cwd=installed,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.communicate(timeout=LIMIT_S)

    def launch(file: str, **arguments: object) -> contextmanager:
        path = installed / 'share' / 'vio_eval_ros' / 'launch' / file
        words = [f'{name}:={value}' for name, value in arguments.items()]
        return start(sys.executable, '-c', LAUNCH, path, *words)

    launch.start = start
    with private_domain() as variables:
        environment = os.environ | variables | {'ROS_LOG_DIR': str(tmp_path / 'log')}
        yield launch


def ended(process: subprocess.Popen, status: int) -> str:
    """Return what a launch said; it must have ended with this status, and no process be left."""
    said, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == status, said
    for number in re.findall(r'process started with pid \[(\d+)\]', said):
        assert not Path(f'/proc/{number}').exists(), said
    return said


def gates(folder: Path, limit_m: float) -> Path:
    path = folder / 'gates.yaml'
    path.write_text(f'ate_trans_rmse_m: {{max: {limit_m}}}\n')
    return path


def replayed(*arguments: object) -> dict:
    command = [sys.executable, '-m', 'vio_eval_ros', 'replay', *map(str, arguments), '--json']
    done = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, timeout=LIMIT_S)
    return json.loads(done.stdout)


def test_a_recording_with_both_topics_is_played_scored_and_passes(launched, tmp_path):
    with launched(
        'euroc.launch.py',
        recording=DEMO,
        estimate='/vio/odometry',
        report_dir=tmp_path / 'report',
        gates_file=gates(tmp_path, 1.0),
        play_options='--rate 20',
    ) as process:
        said = ended(process, 0)
    assert 'evaluator: no gate failed' in said
    result = json.loads((tmp_path / 'report' / 'result.json').read_text())
    assert result['verdict'] == 'pass'
    assert result['association']['pairs'] == 1200
    assert result['config']['max_difference_s'] == 0.01  # of config/euroc.yaml
    expected = replayed(DEMO, '--config', ROOT / 'config' / 'euroc.yaml')
    assert result['metrics']['ate_trans_rmse_m'] == expected['metrics']['ate_trans_rmse_m']


def test_a_gate_that_fails_fails_the_launch(launched, tmp_path):
    with launched(
        'euroc.launch.py',
        recording=DEMO,
        estimate='/vio/odometry',
        report_dir=tmp_path / 'report',
        gates_file=gates(tmp_path, 0.001),
        play_options='--rate 20 --duration 20',
        settle_s=0,
    ) as process:
        said = ended(process, 1)
    assert 'evaluator: a gate failed' in said
    assert json.loads((tmp_path / 'report' / 'result.json').read_text())['verdict'] == 'fail'


def test_a_real_run_passes_the_gates_of_its_sequence(launched, tmp_path, shared_data):
    with launched(
        'euroc.launch.py',
        recording=shared_data / 'derived_bags' / 'euroc_V1_02_vins_fusion.bag',
        estimate='/vio/odometry',
        report_dir=tmp_path,
        play_options='--rate 20',
    ) as process:
        said = ended(process, 0)
    assert 'config/gates/euroc_V1_02.yaml' in said
    result = json.loads((tmp_path / 'result.json').read_text())
    assert {gate['metric'] for gate in result['gates']} == {'ate_trans_rmse_m', 'tracked_ratio'}
    assert result['verdict'] == 'pass'


def test_an_estimator_that_runs_elsewhere_is_scored_on_an_asl_folder(launched, tmp_path):
    truth, estimate = read_sources(['/ground_truth/pose', '/vio/odometry'], DEMO)
    folder = tmp_path / 'mav0' / 'state_groundtruth_estimate0'
    folder.mkdir(parents=True)
    with (folder / 'data.csv').open('w') as file:
        wxyz = truth.poses.rotations[:, [3, 0, 1, 2]]
        for stamp_ns, p, q in zip(truth.poses.stamps_ns, truth.poses.positions, wxyz, strict=True):
            print(stamp_ns, *p.tolist(), *q.tolist(), sep=',', file=file)
    (tmp_path / 'mav0' / 'imu0').mkdir()
    with (tmp_path / 'mav0' / 'imu0' / 'data.csv').open('w') as file:
        file.writelines(f'{stamp},0,0,0,0,0,9.81\n' for stamp in estimate.poses.stamps_ns)

    estimator = (sys.executable, ROOT / 'test' / 'estimator.py', f'{DEMO}:/vio/odometry', '/pose')
    with (
        launched.start(*estimator),
        launched(
            'euroc.launch.py',
            recording=tmp_path,
            estimate='/pose',
            report_dir=tmp_path / 'report',
            gates_file=gates(tmp_path, 0.1),
            play_options='--rate 10',
        ) as process,
    ):
        said = ended(process, 0)
    assert 'waiting for subscribers' in said
    result = json.loads((tmp_path / 'report' / 'result.json').read_text())
    assert result['inputs']['ground_truth']['source'] == '/ground_truth/pose'
    expected = replayed(DEMO, '--config', ROOT / 'config' / 'euroc.yaml')
    # best effort: a busy machine may lose some
    assert result['association']['pairs'] == pytest.approx(1200, rel=0.1)
    assert result['metrics']['ate_trans_rmse_m'] == pytest.approx(
        expected['metrics']['ate_trans_rmse_m'], rel=0.1
    )


def test_a_run_that_is_interrupted_has_its_report_but_has_not_passed(launched, tmp_path):
    with launched(
        'euroc.launch.py',
        recording=DEMO,
        estimate='/vio/odometry',
        report_dir=tmp_path / 'report',
        play_options='--rate 5 --duration 5 --loop',
    ) as process:
        for line in process.stdout:
            if 'jumped back' in line:  # in the second round
                break
        process.send_signal(signal.SIGINT)
        said = ended(process, 1)
    assert 'play: stopped before the recording had ended' in said
    assert (tmp_path / 'report' / 'run_0001' / 'result.json').is_file()
    assert (tmp_path / 'report' / 'run_0002' / 'result.json').is_file()


@pytest.mark.parametrize(
    ('arguments', 'problem'),
    [
        ({'recording': 'nowhere.bag'}, 'nowhere.bag: there is no such file'),
        ({'recording': DEMO, 'gates_file': 'nowhere.yaml'}, 'nowhere.yaml: No such file'),
        ({'recording': DEMO, 'play_options': '--start 1000'}, 'the recording could not be played'),
    ],
    ids=['recording', 'gates', 'options'],
)
def test_what_cannot_be_done_fails_the_launch(launched, arguments, problem, tmp_path):
    arguments = {'estimate': '/vio/odometry', 'report_dir': tmp_path, **arguments}
    with launched('euroc.launch.py', **arguments) as process:
        assert problem in ended(process, 1)


def test_the_evaluator_alone_runs_until_it_is_interrupted(launched, tmp_path):
    (tmp_path / 'parameters.yaml').write_text(
        '/**: {ros__parameters: {alignment: posyaw, report_dir: not_here}}\n'
    )
    with launched(
        'evaluator.launch.py',
        estimate='/vio/odometry',
        ground_truth='/ground_truth/pose',
        params_file=tmp_path / 'parameters.yaml',
        report_dir=tmp_path / 'report',
        use_sim_time='true',
        reliable='/vio/odometry /ground_truth/pose',
    ) as process:
        options = '--wait-for-subscribers --rate 20 --duration 20 --topics'.split()
        topics = ('/vio/odometry', '/ground_truth/pose')
        with launched.start('lib/vio_eval_ros/play', DEMO, *options, *topics) as player:
            ended(player, 0)
        process.send_signal(signal.SIGINT)
        said = ended(process, 0)
    assert 'evaluator: no gate failed' in said
    result = json.loads((tmp_path / 'report' / 'result.json').read_text())
    assert result['alignment']['mode'] == 'posyaw'
    assert result['association']['pairs'] == 400


# what starts a robot with two evaluators, each in a namespace of its own
BRING_UP = """
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription

def generate_launch_description():
    return LaunchDescription([
        GroupAction([IncludeLaunchDescription({file!r}, launch_arguments=given.items())])
        for given in {robots!r}
    ])
"""


def test_a_robot_outlives_an_evaluator_with_a_misspelt_gate(launched, installed, tmp_path):
    (tmp_path / 'misspelt.yaml').write_text('ate_trans_rsme_m: {max: 0.1}\n')
    robots = [
        {'namespace': 'robot1', 'gates_file': str(tmp_path / 'misspelt.yaml')},
        {
            'namespace': 'robot2',
            'name': 'eval',
            'estimates': 'vio:=/vio/odometry',
            'ground_truth': '/ground_truth/pose',
            'reliable': '/vio/odometry /ground_truth/pose',
            'gates_file': str(gates(tmp_path, 1.0)),
            'report_dir': str(tmp_path / 'report'),
        },
    ]
    file = str(installed / 'share' / 'vio_eval_ros' / 'launch' / 'evaluator.launch.py')
    bring_up = tmp_path / 'bring_up.launch.py'
    bring_up.write_text(BRING_UP.format(file=file, robots=robots))
    with launched.start(sys.executable, '-c', LAUNCH, bring_up) as process:
        said = ''
        for line in process.stdout:
            said += line
            if 'the launch goes on' in line:
                break
        options = '--wait-for-subscribers --rate 20 --duration 20 --topics'.split()
        topics = ('/vio/odometry', '/ground_truth/pose')
        with launched.start('lib/vio_eval_ros/play', DEMO, *options, *topics) as player:
            ended(player, 0)
        process.send_signal(signal.SIGINT)
        said += ended(process, 0)
    assert "there is no metric 'ate_trans_rsme_m'" in said
    assert 'no gate failed; the launch goes on' in said
    assert re.search(r'\[robot2\.eval\].* vio: .*1,?200 pairs|robot2', said)
    assert (
        json.loads(next((tmp_path / 'report').rglob('result.json')).read_text())['verdict']
        == 'pass'
    )


def test_an_evaluator_that_is_included_ends_the_launch_where_that_is_asked_for(
    launched, installed, tmp_path
):
    (tmp_path / 'misspelt.yaml').write_text('ate_trans_rsme_m: {max: 0.1}\n')
    file = str(installed / 'share' / 'vio_eval_ros' / 'launch' / 'evaluator.launch.py')
    robots = [{'gates_file': str(tmp_path / 'misspelt.yaml'), 'on_exit': 'shutdown'}]
    bring_up = tmp_path / 'bring_up.launch.py'
    bring_up.write_text(BRING_UP.format(file=file, robots=robots))
    with launched.start(sys.executable, '-c', LAUNCH, bring_up) as process:
        assert 'evaluator: it could not run' in ended(process, 1)
