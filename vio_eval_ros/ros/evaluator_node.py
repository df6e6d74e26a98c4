"""
The live node: subscribes to an estimate and a ground truth, publishes how far they are apart.

Messages are taken serialised, many at a time, and decoded in columns: one of them costs less here
than its mere deserialisation elsewhere. What has arrived is evaluated once a second: from
:class:`PoseTopic` by way of its queue of runs into the :class:`LiveRun`, and from there to
``/diagnostics`` by way of :mod:`vio_eval_ros.live.health`.
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
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, UNABLE, VioEvalError, WriteError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.live.health import conclusions, statuses, why_no_pairs
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.live.queues import LAG_S, why_the_run_ends
from vio_eval_ros.live.report_folder import ReportFolder
from vio_eval_ros.live.run import LiveRun, RunSetup
from vio_eval_ros.live.snapshot import Snapshot
from vio_eval_ros.recordings.agreement.orders import alone
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.rendering.text import number
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.text import headline
from vio_eval_ros.ros.context import join
from vio_eval_ros.ros.markers import Display
from vio_eval_ros.ros.parameters import changed, declare, refuse_unknown
from vio_eval_ros.ros.pose_topic import PoseTopic
from vio_eval_ros.ros.status import status_message
from vio_eval_ros.settings import gates_of, limits_of

NAME = 'vio_evaluator'
DRAIN_S = 0.05
TICK_S = 1.0
DISCOVERY_S = 0.5


class Evaluator(Node):
    """
    The node ``vio_evaluator``.

    :param options: of :class:`Node`, such as its context.
    :raises VioEvalError: a parameter, gate or ground-truth file that cannot be used.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(NAME, **options)
        config, self._settings = declare(self)
        gates, file = self._settings.gates_file, self._settings.ground_truth_file
        with _naming('gates_file'):
            self._gates = gates_of(Path(gates)) if gates else []
        with _naming('ground_truth_file'):
            truth = alone(read_sources([file])[0]) if file else None
        with _naming('limits_file'):
            limits_file = Path(self._settings.limits_file) if self._settings.limits_file else None
            limits = limits_of(DiagnosisLimits, 'diagnose', self._settings.profile, limits_file)
        for sentence in truth.warnings if truth else ():
            self.get_logger().warning(sentence)
        self._estimate = PoseTopic(self, 'estimate', self._settings.estimate_type)
        # made for its parameters also where a file takes its place
        truth_topic = PoseTopic(
            self, 'ground_truth', '' if file else self._settings.ground_truth_type
        )
        self._topics = [self._estimate] if file else [self._estimate, truth_topic]
        refuse_unknown(self)
        if len({topic.topic for topic in self._topics}) < len(self._topics):
            raise ConfigError(f'estimate and ground_truth are both {self._estimate.topic}')
        names = (self.resolve_topic_name('estimate'), self.resolve_topic_name('ground_truth'))
        self._setup = RunSetup(
            config=config,
            names=names,
            gates=self._gates,
            truth=truth,
            max_pairs=self._settings.max_pairs,
            limits=limits,
        )
        self._run = LiveRun(self._setup)
        self._reports = ReportFolder(self._settings.report_dir, self.get_logger().error)
        self._failed_gates = False
        self._problem = ''  # of the run: why it cannot be evaluated
        self._other_nodes = 0  # of the same name
        self._clock_jumped_s = math.inf  # monotonic, until the run ends
        self._ended_s = -math.inf  # monotonic, when the run before ended
        self._published = 0  # messages of which the result is published
        self._create_outputs()
        self._create_timers()
        self.add_on_set_parameters_callback(self._set_parameters)
        awaited = ' and '.join(f'{t.topic} ({t.name.replace("_", " ")})' for t in self._topics)
        self.get_logger().info(f'waiting for {awaited}')

    def create_publisher(self, *given: Any, **options: Any) -> Publisher:
        """Create a publisher without handlers of events: each would cost at every wake-up."""
        without = PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*given, **{'event_callbacks': without, **options})

    def destroy_node(self) -> None:
        """Leave the graph."""
        for topic in self._topics:
            topic.close()
        super().destroy_node()

    @property
    def exit_status(self) -> int:
        """The exit status for what has become of the runs."""
        if self._reports.unwritten:
            return UNABLE
        return FAILED if self._failed_gates and self._settings.exit_code_from_gates else PASSED

    @property
    def _frame(self) -> str:
        """The frame of the ground truth."""
        return 'world' if self._setup.truth else self._topics[-1].frame

    @property
    def _folder(self) -> Path:
        """Where the report of the run goes, in the report folder."""
        return _folder_of(self._run) if self._run.number > 1 else Path()

    def _create_outputs(self) -> None:
        config = self._setup.config
        known, running = metric_names(config), Evaluation(config).running()
        check_names(self._gates, known)
        names = self._settings.publish_metrics
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
        self._metrics = {name: topic('metrics', name) for name in names if name in running}
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
        for topic in self._topics:
            topic.drain()

    def _discover(self) -> None:
        for topic in self._topics:
            topic.discover()
        own = (self.get_name(), self.get_namespace())
        self._other_nodes = self.get_node_names_and_namespaces().count(own) - 1

    def _tick(self) -> None:
        """Evaluate what has arrived since the last tick, and publish."""
        try:
            self._evaluate()
        except VioEvalError as error:
            if str(error) != self._problem:
                self._problem = str(error)
                self.get_logger().error(self._problem)
        found = statuses(self._snapshot())
        array = DiagnosticArray(status=[status_message(status, NAME) for status in found])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _snapshot(self) -> Snapshot:
        """Return all that the health of the evaluation is judged by."""
        truth = self._setup.truth
        stamps_ns = truth.poses.stamps_ns if truth else None
        problems = (self._problem, *self._reports.unwritten.values())
        return Snapshot(
            run=self._run.state(),
            topics=tuple(topic.state for topic in self._topics),
            file_span_ns=None
            if stamps_ns is None
            else (int(stamps_ns.min()), int(stamps_ns.max())),
            gates=self._gates,
            time_offset_s=self._setup.config.time_offset_s,
            stale_after_s=self._settings.stale_after_s,
            problems=tuple(problem for problem in problems if problem),
            clock_jumped=self._clock_jumped_s < math.inf,
            other_node=self.get_fully_qualified_name() if self._other_nodes else '',
        )

    def _evaluate(self) -> None:
        self._take_in()
        self._advance()
        self._run.look(self._settings.window_s)
        if self._run.values:
            _publish(self._windows, self._run.window)
            if self._display.is_watched():
                self._display.show(*self._run.evaluation.aligned(), self._frame)
        received = sum(topic.received for topic in self._topics)
        silent = all(topic.silent_s > self._settings.stale_after_s for topic in self._topics)
        if silent and received > self._published:
            self._published = received
            self._publish_result(self._run.result())

    def _advance(self) -> None:
        """Evaluate the seconds that are over, and publish their running metrics."""
        for _, values in self._run.advance():
            _publish(self._metrics, values)

    def _publish_result(self, result: Result) -> None:
        self._result.publish(String(data=REPORTS['json'](result)))

    def _take_in(self) -> None:
        """Hand the poses that have arrived to their run; go on to the next where one ends."""
        for topic in self._topics:
            topic.read()
        self._hand_over()
        self._end_runs()
        if self._clock_jumped_s + LAG_S < time.monotonic():
            self._next_run('the clock jumped back')

    def _end_runs(self, at_once: bool = False) -> None:
        """Go on to the next run as long as a jump back in time says so."""
        while why := why_the_run_ends(
            [topic.progress for topic in self._topics], time.monotonic(), at_once
        ):
            self._next_run(why)

    def _hand_over(self) -> None:
        for topic in self._topics:
            poses = topic.queue.take()
            if not len(poses):
                continue
            if topic is self._estimate:
                self._run.add_estimate(poses, topic.revisions)
            else:
                self._run.add_ground_truth(poses)

    def _release(self) -> None:
        """Hand over what is withheld as well: nothing more will come to tell what it is."""
        for topic in self._topics:
            topic.queue.release()
        self._hand_over()

    def _on_clock_jump(self) -> None:
        # the streams, which jump as well, may have ended the run already
        if not self._run.is_empty and time.monotonic() - self._ended_s > LAG_S:
            self._clock_jumped_s = time.monotonic()

    def _next_run(self, why: str) -> None:
        """Close the run with its report, and begin the next."""
        self.get_logger().warning(f'{why}: run {self._run.number} ends, the next begins')
        try:
            self._close(_folder_of(self._run))
        finally:  # whatever became of it, it has ended
            for topic in self._topics:
                topic.next_run()
            self._reports.next_run()
            self._ended_s = time.monotonic()
            self._clock_jumped_s = math.inf
            self._problem = ''
            self._run = LiveRun(self._setup, self._run.number + 1, why)
        self._hand_over()

    def end(self) -> None:
        """Evaluate all that has arrived and close the run with its report."""
        self._take_in()
        self._end_runs(at_once=True)
        self._release()
        if not (self._run.is_empty and self._run.number > 1):  # else the one before was the last
            self._close(self._folder)

    def _close(self, folder: Path) -> None:
        """Write, publish and log the result of a run that has ended; remember its verdict."""
        self._failed_gates |= self._finish(folder).passed is False

    def _finish(self, folder: Path) -> Result:
        """Write, publish and log the result of the run; return it."""
        self._advance()
        self._run.notes = [note for topic in self._topics for note in topic.notes()]
        # what an earlier evaluator left there is not replaced by nothing
        written = None if self._run.is_empty else self._reports.write(self._run, folder)
        result = written[0] if written else self._run.result()
        self._publish_result(result)
        self._log(result, f'; the report is in {written[1]}' if written else '')
        return result

    def _log(self, result: Result, where: str) -> None:
        log, pairs = self.get_logger(), result.summary.pairs
        found = headline(result) if len(pairs) else why_no_pairs(self._snapshot())
        log.info(f'run {self._run.number}: {found}{where}')
        diagnosis = self._run.monitor.conclude(pairs)
        for note in [*self._run.notes, *conclusions(diagnosis, self._run.monitor.problem)]:
            log.warning(note)
        for verdict in result.verdicts:
            if not verdict.passed:
                log.warning(f'{verdict.word} {verdict.gate} (is {number(verdict.value)})')

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
        self._release()
        if not self._run.is_empty:
            self._next_run('reset was called')
        return f'run {self._run.number} begins'

    def _write_report(self) -> str:
        self._take_in()
        if self._run.is_empty:
            raise VioEvalError(f'nothing to report: {why_no_pairs(self._snapshot())}')
        self._finish(self._folder)
        if not self._settings.report_dir:
            return 'published, not written'
        folder = Path(self._settings.report_dir) / self._folder
        if folder in self._reports.unwritten:
            raise VioEvalError(self._reports.unwritten[folder])
        return str(folder)

    def _set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            settings = changed(self._settings, parameters)
            self._reports.move(settings.report_dir, self._folder)
            self._settings = settings
        except (ConfigError, WriteError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _folder_of(run: LiveRun) -> Path:
    return Path(f'run_{run.number:04d}')


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


def spin(argv: list[str], signals: list[int]) -> int:
    """
    Run the node until a signal ends it; return the exit status.

    :param signals: receives the signals. The handlers of rclpy would end the graph before what is
        still under way is evaluated.
    """
    try:
        join(argv)
        node = Evaluator()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not signals:
            executor.spin_once(timeout_sec=DRAIN_S)
        node.end()
    except ParameterException as error:
        raise ConfigError(str(error)) from None
    finally:
        rclpy.try_shutdown()
    return node.exit_status
