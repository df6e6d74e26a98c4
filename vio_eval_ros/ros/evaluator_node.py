"""
The live node: subscribes to an estimate and a ground truth, publishes how far they are apart.

Messages are taken serialised, many at a time, and decoded in columns: one of them costs less here
than its mere deserialisation elsewhere. What has arrived is evaluated once a second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import math
from pathlib import Path
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.evaluation import Evaluation, metric_names
from vio_eval_ros.core.gates import check_names
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, UNABLE, VioEvalError, WriteError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.live.queues import LAG_S, why_the_run_ends
from vio_eval_ros.live.report_folder import Reporter
from vio_eval_ros.live.run import LiveRun
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.rendering.text import number
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.text import headline, WORDS
from vio_eval_ros.ros.context import join
from vio_eval_ros.ros.markers import Display
from vio_eval_ros.ros.parameters import changed, declare, refuse_unknown
from vio_eval_ros.ros.pose_topic import PoseTopic
from vio_eval_ros.ros.status import found_wrong, status_messages, why_no_pairs
from vio_eval_ros.settings import gates_of

DRAIN_S = 0.05
TICK_S = 1.0
DISCOVERY_S = 0.5


class Evaluator(Node):
    """
    The node ``vio_evaluator``.

    :raises VioEvalError: a parameter, gate or ground-truth file that cannot be used.
    """

    def __init__(self) -> None:
        super().__init__('vio_evaluator')
        self.config, self.settings = declare(self)
        gates, file = self.settings.gates_file, self.settings.ground_truth_file
        with _naming('gates_file'):
            self.gates = gates_of(Path(gates)) if gates else []
        with _naming('ground_truth_file'):
            self.truth = read_sources([file])[0] if file else None
        self.estimate = PoseTopic(self, 'estimate', self.settings.estimate_type)
        truth = PoseTopic(self, 'ground_truth', '' if file else self.settings.ground_truth_type)
        self.streams = [self.estimate] if file else [self.estimate, truth]
        refuse_unknown(self)
        if len({stream.topic for stream in self.streams}) < len(self.streams):
            raise ConfigError(f'estimate and ground_truth are both {self.estimate.topic}')
        self.run_number = 0
        self.failed_gates = False
        self.reporter = Reporter(self.settings.report_dir, self.get_logger().error)
        self.namesakes = 0
        self._ended_s = -math.inf
        self._published = 0
        self._begin_run('')
        self._create_outputs()
        self._create_timers()
        self.add_on_set_parameters_callback(self._set_parameters)
        awaited = ' and '.join(f'{s.topic} ({s.name.replace("_", " ")})' for s in self.streams)
        self.get_logger().info(f'waiting for {awaited}')

    def create_publisher(self, *given: Any, **options: Any) -> Publisher:
        """Create a publisher without handlers of events: each would cost at every wake-up."""
        without = PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*given, **{'event_callbacks': without, **options})

    @property
    def frame(self) -> str:
        """The frame of the ground truth."""
        return 'world' if self.truth else self.streams[-1].frame

    @property
    def folder(self) -> Path:
        """Where the report of the run goes, in the report folder."""
        return Path(f'run_{self.run_number:04d}') if self.run_number > 1 else Path()

    def _create_outputs(self) -> None:
        known, kept_up = metric_names(self.config), Evaluation(self.config).running()
        check_names(self.gates, known)
        names = self.settings.publish_metrics
        if names == NodeConfig().publish_metrics:
            names = tuple(name for name in names if name in known)  # other deltas, other names
        for name in names:
            if name not in known:
                near = nearest_name(name, known)
                raise ConfigError(f"publish_metrics: there is no metric '{name}'{near}")

        def topic(kind: str, name: str) -> Publisher:
            # a delta such as 0.5s has a dot, which the name of a topic must not have
            return self.create_publisher(Float64, f'~/{kind}/{name.replace(".", "_")}', 10)

        self._windows = {name: topic('window', name) for name in names}
        self._metrics = {name: topic('metrics', name) for name in names if name in kept_up}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._result = self.create_publisher(String, '~/result', latched)
        self._display = Display(self)
        self._serve('reset', self._reset)
        self._serve('write_report', self._write_report)

    def _create_timers(self) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DRAIN_S, self._drain, clock=steady)
        self.create_timer(TICK_S, self._tick, clock=steady)
        self.create_timer(DISCOVERY_S, self._discover, clock=steady)
        back = JumpThreshold(
            min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=False
        )
        self._clock_jumps = self.get_clock().create_jump_callback(
            back, post_callback=lambda jump: self._on_clock_jump()
        )

    def _drain(self) -> None:
        for stream in self.streams:
            stream.drain()

    def _discover(self) -> None:
        for stream in self.streams:
            stream.discover()
        own = (self.get_name(), self.get_namespace())
        self.namesakes = self.get_node_names_and_namespaces().count(own) - 1

    def _tick(self) -> None:
        """Evaluate what has arrived since the last tick, and publish."""
        try:
            self._evaluate()
        except VioEvalError as error:
            if str(error) != self.problem:
                self.problem = str(error)
                self.get_logger().error(self.problem)
        array = DiagnosticArray(status=status_messages(self))
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _evaluate(self) -> None:
        self._take_in()
        self._advance()
        self.run.diagnosing.look(self.run.evaluation.since(0))
        if self.values:
            self.window = self.run.evaluation.window(self.settings.window_s)
            _publish(self._windows, self.window)
            if self._display.is_watched():
                self._display.show(*self.run.evaluation.aligned(), self.frame)
        received = sum(stream.received for stream in self.streams)
        silent = all(s.silent_s() > self.settings.stale_after_s for s in self.streams)
        if silent and received > self._published:
            self._published = received
            self._result.publish(String(data=REPORTS['json'](self.run.result())))

    def _advance(self) -> None:
        """Evaluate the seconds that are over, and publish their running metrics."""
        for _, values in self.run.advance():
            self.values = values
            _publish(self._metrics, values)

    def _take_in(self) -> None:
        """Hand the poses that have arrived to their run; go on to the next where one ends."""
        for stream in self.streams:
            stream.read()
        self._hand_over()
        while why := why_the_run_ends(self.streams, time.monotonic()):
            self._next_run(why)
        if self.clock_jumped_s + LAG_S < time.monotonic():
            self._next_run('the clock jumped back')

    def _hand_over(self) -> None:
        for stream in self.streams:
            poses = stream.runs.take()
            if not len(poses):
                continue
            self._is_empty = False
            if stream is self.estimate:
                self.run.add_estimate(poses, stream.revisions)
            else:
                self.run.add_ground_truth(poses)

    def _on_clock_jump(self) -> None:
        # the streams, which jump as well, may have ended the run already
        if not self._is_empty and time.monotonic() - self._ended_s > LAG_S:
            self.clock_jumped_s = time.monotonic()

    def _begin_run(self, why: str) -> None:
        self.run_number += 1
        self.began_as, self.problem = why, ''
        names = tuple(self.resolve_topic_name(name) for name in ('estimate', 'ground_truth'))
        limit = self.settings.max_pairs
        self.run = LiveRun(self.config, self.gates, names, self.truth, limit)
        self.values: Mapping[str, float] = {}
        self.window: Mapping[str, float] = {}
        self._is_empty = True
        self.clock_jumped_s = math.inf

    def _next_run(self, why: str) -> None:
        """Close the run with its report, and begin the next."""
        self.get_logger().warning(f'{why}: run {self.run_number} ends, the next begins')
        try:
            self._close(Path(f'run_{self.run_number:04d}'))
        finally:  # whatever became of it, it has ended
            for stream in self.streams:
                stream.next_run()
            self.reporter.next_run()
            self._ended_s = time.monotonic()
            self._begin_run(why)
        self._hand_over()

    def end(self) -> None:
        """Evaluate all that has arrived and close the run with its report."""
        self._take_in()
        while why := why_the_run_ends(self.streams, time.monotonic(), at_once=True):
            self._next_run(why)
        for stream in self.streams:
            stream.release()
        self._hand_over()
        if not (self._is_empty and self.run_number > 1):  # else the one before was the last
            self._close(self.folder)

    def _close(self, folder: Path) -> None:
        """Write, publish and log the result of a run that has ended; remember its verdict."""
        self.failed_gates |= self._finish(folder).passed is False

    def _finish(self, folder: Path) -> Result:
        """Write, publish and log the result of the run; return it."""
        self._advance()
        self.run.notes = [note for stream in self.streams for note in stream.notes()]
        # what an earlier evaluator left there is not replaced by nothing
        written = None if self._is_empty else self.reporter.write(self.run, folder)
        result = written[0] if written else self.run.result()
        self._result.publish(String(data=REPORTS['json'](result)))
        pairs = result.summary.association['pairs']
        found = headline(result) if pairs else why_no_pairs(self)
        where = f'; the report is in {written[1]}' if written else ''
        self.get_logger().info(f'run {self.run_number}: {found}{where}')
        for note in [*self.run.notes, *found_wrong(self.run.diagnosing, result.summary.pairs)]:
            self.get_logger().warning(note)
        for verdict in result.verdicts:
            if not verdict.passed:
                said = f'{WORDS[verdict.word]} {verdict.gate} (is {number(verdict.value)})'
                self.get_logger().warning(said)
        return result

    def _serve(self, name: str, do: Callable[[], str]) -> None:
        """Offer a service that answers with what was done, or why it could not be."""

        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message, response.success = do(), True
            except VioEvalError as error:
                response.message = str(error)
            return response

        self.create_service(Trigger, f'~/{name}', answer)

    def _reset(self) -> str:
        self._take_in()
        for stream in self.streams:
            stream.release()
        self._hand_over()
        if not self._is_empty:
            self._next_run('reset was called')
        return f'run {self.run_number} begins'

    def _write_report(self) -> str:
        self._take_in()
        if self._is_empty:
            raise VioEvalError(f'nothing to report: {why_no_pairs(self)}')
        self._finish(self.folder)
        if not self.settings.report_dir:
            return 'published, not written'
        folder = Path(self.settings.report_dir) / self.folder
        if folder in self.reporter.unwritten:
            raise VioEvalError(self.reporter.unwritten[folder])
        return str(folder)

    def _set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            settings = changed(self.settings, parameters)
            self.reporter.move(settings.report_dir, self.folder)
            self.settings = settings
        except (ConfigError, WriteError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


@contextmanager
def _naming(parameter: str) -> Iterator[None]:
    """Name the parameter in front of what is wrong with its value."""
    try:
        yield
    except VioEvalError as error:
        raise ConfigError(f'{parameter}: {error}') from None


def _publish(publishers: Mapping[str, Publisher], values: Mapping[str, float]) -> None:
    for name, publisher in publishers.items():
        publisher.publish(Float64(data=float(values[name])))


def spin(argv: list[str], told: list[int]) -> int:
    """
    Run the node until it is told to stop; return the exit status.

    :param told: receives the signals that say so. The handlers of rclpy would end the graph
        before what is still under way is evaluated.
    """
    try:
        join(argv)
        node = Evaluator()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not told:
            executor.spin_once(timeout_sec=DRAIN_S)
        node.end()
    except ParameterException as error:
        raise ConfigError(str(error)) from None
    finally:
        rclpy.try_shutdown()
    if node.reporter.unwritten:
        return UNABLE
    return FAILED if node.failed_gates and node.settings.exit_code_from_gates else PASSED
