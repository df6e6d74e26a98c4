"""
Starts the evaluator beside a running estimator, and ends with its verdict.

``ros2 launch`` returns 0 whatever the status of its processes, unless an event handler raises:
then it ends all processes and returns 1. So :func:`ended` raises if the run has not passed. A
launch file of a robot that includes this one must not end with it: there it logs the verdict.
"""

from functools import partial
from pathlib import Path
import sys

from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.launch_context import LaunchContext
from launch.launch_description import LaunchDescription
from launch.launch_description_entity import LaunchDescriptionEntity
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    'name': ('vio_evaluator', 'name of the node'),
    'namespace': ('', 'namespace of the node; topics without a leading slash are in it'),
    'estimate': ('', 'topic of the estimate, or frames: /tf:PARENT.CHILD (default: estimate)'),
    'estimates': ('', 'several instead, separated by spaces: NAME:=TOPIC'),
    'ground_truth': ('', 'topic of the ground truth, or frames (default: ground_truth)'),
    'ground_truth_file': ('', 'file or folder with the ground truth, instead of the topic'),
    'params_file': ('', 'YAML file of parameters, such as config/evaluator.yaml'),
    'gates_file': ('', 'YAML file of gates: {metric: {max: number, min: number}}'),
    'report_dir': ('', 'folder for the report of each run'),
    'use_sim_time': ('', 'take the time from /clock: true or false'),
    'reliable': ('', 'topics of which no message may be lost, separated by spaces'),
    'on_exit': (
        '',
        'what the end of the node does to the launch: shutdown or ignore (default: ignore where '
        'another launch file includes this one, else shutdown)',
    ),
}
# without such an argument, the value in params_file counts
PARAMETERS = (
    'estimate',
    'estimates',
    'ground_truth',
    'ground_truth_file',
    'gates_file',
    'report_dir',
    'use_sim_time',
)
PROBLEMS = {1: 'a gate failed', 2: 'it could not run or could not write its report'}
REPORT_S = '60'  # to write the report of a long run


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and the node that is made of them."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=evaluator)])


def evaluator(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the node, with the arguments that were given."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    on_exit = given['on_exit'] or ('shutdown' if is_launched() else 'ignore')
    if on_exit not in ('shutdown', 'ignore'):
        raise RuntimeError(f"on_exit: '{on_exit}' is neither shutdown nor ignore")
    parameters = {name: given[name] for name in PARAMETERS if given[name]}
    if 'use_sim_time' in parameters:
        parameters['use_sim_time'] = parameters['use_sim_time'].lower() == 'true'
    if 'estimates' in parameters:
        parameters['estimates'] = parameters['estimates'].split()
    for topic in given['reliable'].split():
        parameters[f'qos_overrides.{topic}.subscription.reliability'] = 'reliable'
    files = [given['params_file']] if given['params_file'] else []
    return [
        Node(
            package='vio_eval_ros',
            executable='evaluator',
            name=given['name'],
            namespace=given['namespace'] or None,
            output='screen',
            parameters=[*files, {**parameters, 'exit_code_from_gates': True}],
            on_exit=partial(ended, on_exit=on_exit),
            sigterm_timeout=REPORT_S,
        )
    ]


def is_launched() -> bool:
    """Return whether ``ros2 launch`` was given this file, rather than one that includes it."""
    here, words = Path(__file__), sys.argv
    by_name = 'vio_eval_ros' in words and here.name in words
    return by_name or any(Path(word).resolve() == here.resolve() for word in words)


def ended(
    event: ProcessExited, context: LaunchContext, on_exit: str
) -> list[LaunchDescriptionEntity]:
    """End the launch with the evaluator, and raise where the run has not passed; or only log."""
    status = event.returncode
    verdict = 'no gate failed'
    if status:
        verdict = PROBLEMS.get(status, f'it ended with status {status}')
    if on_exit == 'ignore':
        return [LogInfo(msg=f'{event.process_name}: {verdict}; the launch goes on')]
    if status:
        raise RuntimeError(f'evaluator: {verdict}')
    passed = LogInfo(msg=f'evaluator: {verdict}')
    return [passed] if context.is_shutdown else [passed, Shutdown(reason='the evaluator ended')]
