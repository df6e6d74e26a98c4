"""
Starts the evaluator beside a running estimator, and ends with its verdict.

``ros2 launch`` returns 0 whatever the status of its processes, unless an event handler raises:
then it ends all processes and returns 1. So :func:`ended` raises if the run has not passed.
"""

from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.launch_context import LaunchContext
from launch.launch_description import LaunchDescription
from launch.launch_description_entity import LaunchDescriptionEntity
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    'estimate': ('estimate', 'topic of the estimate'),
    'ground_truth': ('ground_truth', 'topic of the ground truth'),
    'ground_truth_file': ('', 'file or folder with the ground truth, instead of the topic'),
    'params_file': ('', 'YAML file of parameters, such as config/evaluator.yaml'),
    'gates_file': ('', 'YAML file of gates: {metric: {max: number, min: number}}'),
    'report_dir': ('', 'folder for the report of each run'),
    'use_sim_time': ('', 'take the time from /clock: true or false'),
    'reliable': ('', 'topics of which no message may be lost, separated by spaces'),
}
TOPICS = ('estimate', 'ground_truth')
# without such an argument, the value in params_file counts
PARAMETERS = ('ground_truth_file', 'gates_file', 'report_dir', 'use_sim_time')
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
    parameters = {name: given[name] for name in PARAMETERS if given[name]}
    if 'use_sim_time' in parameters:
        parameters['use_sim_time'] = parameters['use_sim_time'].lower() == 'true'
    for topic in given['reliable'].split():
        parameters[f'qos_overrides.{topic}.subscription.reliability'] = 'reliable'
    files = [given['params_file']] if given['params_file'] else []
    return [
        Node(
            package='vio_eval_ros',
            executable='evaluator',
            name='vio_evaluator',
            output='screen',
            remappings=[(name, given[name]) for name in TOPICS],
            parameters=[*files, {**parameters, 'exit_code_from_gates': True}],
            on_exit=ended,
            sigterm_timeout=REPORT_S,
        )
    ]


def ended(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """End the launch with the evaluator; raise where the run has not passed."""
    if event.returncode:
        problem = PROBLEMS.get(event.returncode, f'it ended with status {event.returncode}')
        raise RuntimeError(f'evaluator: {problem}')
    passed = LogInfo(msg='evaluator: no gate failed')
    return [passed] if context.is_shutdown else [passed, Shutdown(reason='the evaluator ended')]
