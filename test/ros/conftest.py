"""
What the tests of the live node share: a graph of their own, the node on it, and a flight.

Most tests have the node in this process, in the context of their graph: it lives only while the
test waits for something, so that nothing depends on how busy the machine is. Those of its start,
of signals and of its end start it as users do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
import signal
import subprocess
import sys

import pytest

from vio_eval_ros.errors import UNABLE, VioEvalError
from vio_eval_ros.simulation import simulate, SimulatedRun

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 60
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
def another(ros, environment, graph):
    """Return another participant of the graph."""
    with closing(ros.Graph(int(environment['ROS_DOMAIN_ID']), 'another')) as another:
        another.beside.append(graph)
        yield another


class Evaluator:
    """The node in this process; what it logs is in what the test writes to stderr."""

    def __init__(self, graph, capfd, words: Sequence[str]) -> None:
        from vio_eval_ros.ros.evaluator_node import Evaluator

        self.has_ended = False
        self.told: list[str] = []
        self._graph = graph
        self._capfd = capfd
        self._node = Evaluator(context=graph.context, cli_args=['--ros-args', *words])
        graph.add(self._node)

    @property
    def received(self) -> int:
        """How many messages it has received."""
        return sum(topic.received for topic in self._node._streams.values())

    @property
    def messages(self) -> int:
        """How many messages it has received, those with transforms included."""
        node = self._node
        listeners = [one for tree in node._transforms.values() for one in tree.listeners]
        listeners += [one._listener for one in node._streams.values() if hasattr(one, '_listener')]
        return sum(listener.received for listener in listeners)

    def stop(self, status: int = 0) -> str:
        """End it as a signal does; return what it complained of."""
        self.has_ended, problem = True, ''
        try:
            self._node.end()
            ended_with = self._node.exit_status
        except VioEvalError as error:
            ended_with, problem = UNABLE, str(error)
        self._graph.remove(self._node)
        complaint, self.told = told(self._capfd.readouterr().err)
        assert ended_with == status, complaint
        return complaint + problem


class Process:
    """The evaluator, started as its users do."""

    def __init__(self, environment: dict[str, str], words: Sequence[str]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'vio_eval_ros', 'evaluator', '--ros-args', *words],
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
        complaint, self.told = told(said)
        return complaint

    def stop(self, status: int = 0) -> str:
        """End it as Ctrl-C does; return what it complained of."""
        self.tell(signal.SIGINT)
        return self.ended(status)


def told(said: str) -> tuple[str, list[str]]:
    """Return what a node complained of, and what else it said."""
    assert 'Traceback' not in said
    assert 'this is a bug' not in said
    lines = said.splitlines(keepends=True)
    informed = [line.partition(']: ')[2].rstrip() for line in lines if '[INFO]' in line]
    return ''.join(line for line in lines if '[INFO]' not in line), informed


def words_of(parameters: Sequence[str], reliable: bool, arguments: Sequence[str]) -> list[str]:
    """Return the arguments of ROS for parameters such as 'window_s:=5.0'."""
    given = ('stale_after_s:=100.0', *(RELIABLE if reliable else ()), *parameters)
    return [*(word for parameter in given for word in ('-p', parameter)), *arguments]


@pytest.fixture
def evaluator(graph, capfd, monkeypatch) -> Iterator[Callable[..., Evaluator]]:
    """
    Return a function that makes an evaluator with parameters such as 'window_s:=5.0'.

    It looks at its streams more often than it would. Its subscriptions are reliable, so that
    nothing is lost however fast a test publishes, and no stream becomes stale, however slow. It
    must survive the test and end without a complaint.
    """
    from vio_eval_ros.ros import evaluator_node

    for name, seconds in (('TICK_S', 0.1), ('DRAIN_S', 0.02)):
        monkeypatch.setattr(evaluator_node, name, seconds)
    started: list[Evaluator] = []

    def start(*parameters: str, reliable: bool = True, arguments: Sequence[str] = ()) -> Evaluator:
        started.append(Evaluator(graph, capfd, words_of(parameters, reliable, arguments)))
        return started[-1]

    yield start
    for evaluator in started:
        if not evaluator.has_ended:
            evaluator.stop()


@pytest.fixture
def process(graph, environment) -> Iterator[Callable[..., Process]]:
    """Return a function that starts an evaluator in a process of its own, else likewise."""
    started: list[Process] = []

    def start(*parameters: str, reliable: bool = True, arguments: Sequence[str] = ()) -> Process:
        started.append(Process(environment, words_of(parameters, reliable, arguments)))
        graph.processes.append(started[-1].process)
        return started[-1]

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


@pytest.fixture
def short_lag(monkeypatch) -> None:
    """Have the evaluator wait less for a stream that does not jump back with the other."""
    from vio_eval_ros.live import queues
    from vio_eval_ros.ros import runs

    for module in (queues, runs):
        monkeypatch.setattr(module, 'LAG_S', 0.5)


@pytest.fixture(scope='session')
def flight() -> SimulatedRun:
    """Return 20 s of flight: 400 estimates, 1000 true poses."""
    run = simulate(duration_s=20.0)
    return SimulatedRun(run.ground_truth[::4], run.estimate)
