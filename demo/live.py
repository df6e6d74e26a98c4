"""
A live evaluation, ``live.py RECORDING REPORT``: plays a run through ROS 2 into the evaluator.

There are three processes, as on a robot: ``play`` stands for the robot and its estimator,
``evaluator`` scores what they publish, and this one watches ``/diagnostics``. In the end the score
is compared with that of ``replay``, which needs no ROS.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import signal
import subprocess
import sys

ESTIMATE, GROUND_TRUTH = TOPICS = ('/vio/odometry', '/ground_truth/pose')
RATE = 6
SHOWN = {
    'ate_trans_rmse_m': 'ATE [m]',
    'ate_rot_rmse_deg': 'ATE [deg]',
    'rpe_1s_trans_rmse_m': 'RPE 1s [m]',
    'rpe_1s_rot_rmse_deg': 'RPE 1s [deg]',
}
LIMIT_S = 30

# this machine only, and a graph of its own
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 29)

try:
    from diagnostic_msgs.msg import DiagnosticArray
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions
except ImportError as error:
    sys.exit(f'The live demo needs ROS 2 ({error}); `make demo-offline` does without.')


class Watcher(Node):
    """Prints the running figures whenever they change."""

    def __init__(self) -> None:
        super().__init__('watcher')
        self.pairs = 0.0
        self.create_subscription(DiagnosticArray, '/diagnostics', self.show, 10)

    def show(self, diagnostics: DiagnosticArray) -> None:
        """Print a line of the table, where the accuracy is among the statuses."""
        named = {one.name.rpartition(': ')[2]: one for one in diagnostics.status}
        if 'accuracy' not in named:
            return
        values = {item.key: item.value for item in named['accuracy'].values}
        pairs = float(values.get('pairs', 0))
        if pairs > self.pairs:
            self.pairs = pairs
            figures = (f'{float(values[name]):.4f}' for name in SHOWN)
            print(row(f'{pairs:.0f}', figures), flush=True)


def main(recording: str, report: str) -> int:
    """Play, watch, compare; return 0 where live and offline are equal."""
    print(f'Playing {recording} at {RATE} times its speed into the evaluator, live:\n')
    print(row('poses', SHOWN.values()))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    watcher = Watcher()
    with running('evaluator', *evaluator_arguments(report)) as evaluator:
        while not watcher.count_publishers('/diagnostics') and evaluator.poll() is None:
            rclpy.spin_once(watcher, timeout_sec=0.1)
        with running(
            'play', recording, '--rate', RATE, '--topics', *TOPICS, '--wait-for-subscribers'
        ) as player:
            while player.poll() is None and evaluator.poll() is None:
                rclpy.spin_once(watcher, timeout_sec=0.1)
    rclpy.shutdown()
    if player.returncode or evaluator.returncode:
        return 1
    live = Path(report, 'result.json').read_text()
    offline = subprocess.run(
        verb('replay', recording, '--json'), stdout=subprocess.PIPE, check=True, text=True
    )
    equal = compare(json.loads(live), json.loads(offline.stdout))
    print(f'The report is in {report}/result.md, with all files beside it.')
    return 0 if equal else 1


def compare(live: dict, offline: dict) -> bool:
    """Print both scores side by side; return whether every figure is the same, to the last bit."""
    print(f'\nIn the end{"live":>26}{"offline":>26}')
    print(f'{"pairs":<12}{live["association"]["pairs"]:>24}{offline["association"]["pairs"]:>26}')
    for name, label in SHOWN.items():
        print(f'{label:<12}{live["metrics"][name]!r:>24}{offline["metrics"][name]!r:>26}')
    names = live['metrics'].keys() | offline['metrics'].keys()
    equal = sum(live['metrics'].get(n) == offline['metrics'].get(n) for n in names)
    print(f'\n{equal} of {len(names)} figures are equal to the last bit.')
    return equal == len(names)


def evaluator_arguments(report: str) -> list[str]:
    """Return the topics, where the report goes, and that no message may be lost."""
    remap = [f'estimate:={ESTIMATE}', f'ground_truth:={GROUND_TRUTH}']
    parameters = [f'qos_overrides.{topic}.subscription.reliability:=reliable' for topic in TOPICS]
    parameters.append(f'report_dir:={report}')
    return [
        '--ros-args',
        *(word for rule in remap for word in ('-r', rule)),
        *(word for parameter in parameters for word in ('-p', parameter)),
    ]


def row(first: str, others: Iterator[str]) -> str:
    """Return a line of the table."""
    return f'{first:>7}' + ''.join(f'{other:>14}' for other in others)


def verb(name: str, *arguments: object) -> list[str]:
    """Return the command line of a verb; in a workspace it is ``ros2 run vio_eval_ros VERB``."""
    return [sys.executable, '-m', 'vio_eval_ros', name, *map(str, arguments)]


@contextmanager
def running(name: str, *arguments: object) -> Iterator[subprocess.Popen]:
    """Run a verb beside this program; end it as Ctrl-C does, unless it has ended by itself."""
    process = subprocess.Popen(verb(name, *arguments), stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            _, said = process.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        if process.returncode:
            print(said, file=sys.stderr)


if __name__ == '__main__':
    for number in (signal.SIGINT, signal.SIGTERM):  # also where a shell started it to ignore them
        signal.signal(number, signal.default_int_handler)
    try:
        sys.exit(main(*sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit('interrupted')
