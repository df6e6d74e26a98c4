"""
Plays a EuRoC sequence, evaluates an estimate of it, and ends with the verdict.

The recording is a ROS 1 bag or an ASL folder of EuRoC, or any other with one of the topics in
``TRUTHS``. The estimator under test runs elsewhere, or its output is in the recording.
"""

from pathlib import Path
import re
import shlex

from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    LogInfo,
    OpaqueFunction,
    Shutdown,
    TimerAction,
)
from launch.events.process import ProcessExited
from launch.launch_context import LaunchContext
from launch.launch_description import LaunchDescription
from launch.launch_description_entity import LaunchDescriptionEntity
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from vio_eval_ros.recordings.playback import Playback
from vio_eval_ros.recordings.storage import OfferedQos

SHARE = Path(__file__).resolve().parents[1]
SENSORS = ('/imu0', '/cam0/image_raw', '/cam1/image_raw')
# the ground truths that a recording may have, best first, and their parameters
TRUTHS = {
    '/ground_truth/pose': 'euroc.yaml',
    '/vicon/firefly_sbx/firefly_sbx': 'euroc_vicon.yaml',
    '/leica/position': 'euroc_leica.yaml',
}
ARGUMENTS = {
    'recording': (None, 'ROS 1 bag or ASL folder of a sequence'),
    'estimate': (None, 'topic of the estimate'),
    'ground_truth': ('', f'topic of the ground truth (default: the first of {", ".join(TRUTHS)})'),
    'ground_truth_file': (
        '',
        'file or folder with the ground truth instead, such as the ASL folder of a bag',
    ),
    'params_file': ('', 'YAML file of parameters (default: the one for this ground truth)'),
    'gates_file': (
        '',
        'YAML file of gates, or none (default: config/gates/euroc_V1_02.yaml, where the name of '
        'the recording has V1_02 in it)',
    ),
    'report_dir': ('report', 'folder for the report'),
    'topics': (
        '',
        'topics to play for the estimator; playing begins when each has a subscriber '
        f'(default: {" ".join(SENSORS)}, unless the estimate is in the recording)',
    ),
    'play_options': ('', "further options of play, such as '--rate 2 --start 40'"),
    'settle_s': ('2', 'seconds that the estimator has to finish after the last message'),
    'name': ('vio_evaluator', 'name of the evaluator'),
    'namespace': ('', 'namespace of the evaluator'),
}


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and the player and evaluator that are made of them."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=player_and_evaluator)])


def player_and_evaluator(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return both, according to the arguments and to what is in the recording."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    recording = Path(given['recording'])
    with Playback(recording) as playback:
        recorded = {topic.name for topic in playback.topics if topic.count}
        offers = {topic: playback.offers.get(topic, OfferedQos()) for topic in recorded}
        reliable = {topic for topic, offer in offers.items() if offer.reliable}
    truth = given['ground_truth'] or next((topic for topic in TRUTHS if topic in recorded), '')
    if given['ground_truth_file']:
        truth = ''
    elif not truth:
        raise RuntimeError(
            f'{recording}: none of {", ".join(TRUTHS)} is in it; '
            'give ground_truth or ground_truth_file'
        )
    defaults = () if given['estimate'] in recorded else SENSORS
    wanted = given['topics'].split() or [topic for topic in defaults if topic in recorded]
    inputs = [topic for topic in (given['estimate'], truth) if topic in recorded]
    evaluator = {
        'name': given['name'],
        'namespace': given['namespace'],
        'estimate': given['estimate'],
        'ground_truth': truth,
        'ground_truth_file': given['ground_truth_file'],
        'params_file': given['params_file']
        or str(SHARE / 'config' / TRUTHS.get(truth, 'euroc.yaml')),
        'gates_file': gates(given['gates_file'], recording),
        'report_dir': given['report_dir'],
        'use_sim_time': 'true',
        'reliable': ' '.join(topic for topic in inputs if topic in reliable),
        'on_exit': 'shutdown',
    }
    settle_s = float(given['settle_s'])
    return [
        LogInfo(msg=', '.join(f'{name}: {value or "none"}' for name, value in evaluator.items())),
        IncludeLaunchDescription(
            str(SHARE / 'launch' / 'evaluator.launch.py'), launch_arguments=evaluator.items()
        ),
        Node(
            package='vio_eval_ros',
            executable='play',
            output='screen',
            arguments=[
                str(recording),
                *('--topics', *wanted, *inputs),
                *('--wait-for-subscribers', *wanted, *inputs),
                *shlex.split(given['play_options']),
            ],
            on_exit=lambda event, context: played(event, context, settle_s),
        ),
    ]


def gates(file: str, recording: Path) -> str:
    """Return the file of gates that was given, or that of the sequence; '' for none."""
    if file:
        return '' if file == 'none' else file
    sequences = re.findall(r'(?:MH|V1|V2)_0\d', str(recording.resolve()))
    found = SHARE / 'config' / 'gates' / f'euroc_{"".join(sequences[-1:])}.yaml'
    return str(found) if found.is_file() else ''


def played(
    event: ProcessExited, context: LaunchContext, settle_s: float
) -> list[LaunchDescriptionEntity]:
    """End the launch a little after the recording; raise where it could not be played."""
    if event.returncode:
        raise RuntimeError('play: the recording could not be played')
    if context.is_shutdown:
        raise RuntimeError('play: stopped before the recording had ended')
    return [TimerAction(period=settle_s, actions=[Shutdown(reason='the recording was played')])]
