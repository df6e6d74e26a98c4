"""
The live node: subscribes to an estimate and a ground truth, publishes how far they are apart.

Messages are taken serialised, many at a time, and decoded in columns: one of them costs less here
than its mere deserialisation elsewhere. What has arrived is evaluated once a second: from
:class:`PoseTopic` by way of its queue of runs into the :class:`LiveRun`, and from there to
``/diagnostics`` by way of :mod:`vio_eval_ros.live.health`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
import os
from pathlib import Path
import sys
import time
from typing import Any

from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.clock import Clock, ClockType, JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from vio_eval_ros.comparison.matrix import default_metrics
from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.evaluation import Evaluation, metric_names
from vio_eval_ros.core.gates import check_names
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, UNABLE, VioEvalError, WriteError
from vio_eval_ros.live.health import statuses, topic_problems, why_no_pairs
from vio_eval_ros.live.inputs import estimates_of, GROUND_TRUTH, ground_truth_of, InputName
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.live.processes import Processes
from vio_eval_ros.live.report_folder import ReportFolder
from vio_eval_ros.live.run import RunSetup
from vio_eval_ros.live.screens import Log, Screens, Shown
from vio_eval_ros.live.snapshot import Snapshot
from vio_eval_ros.live.status_line import log_over_lines, width_of
from vio_eval_ros.live.timeliness import NAMES, RECENT
from vio_eval_ros.recordings.agreement.orders import alone
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.ros.alignment_transform import AlignmentTransform
from vio_eval_ros.ros.context import join, topics_with_poses, watch_graph
from vio_eval_ros.ros.estimator import Estimator
from vio_eval_ros.ros.frame_input import FrameInput, Input, TransformTopic
from vio_eval_ros.ros.outputs import Outputs
from vio_eval_ros.ros.parameters import changed, declare, refuse_unknown
from vio_eval_ros.ros.pose_topic import PoseTopic
from vio_eval_ros.ros.recovery import Recovery
from vio_eval_ros.ros.runs import Runs
from vio_eval_ros.settings import gates_of, limits_of

NAME = 'vio_evaluator'
DRAIN_S = 0.05
TICK_S = 1.0


class Evaluator(Node):
    """
    The node ``vio_evaluator``.

    :param options: of :class:`Node`, such as its context.
    :raises VioEvalError: a parameter, gate or ground-truth file that cannot be used.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(NAME, **options)
        config, self._settings = declare(self)
        self._processes = Processes(self._settings.processes)
        setup = self._common_setup(config)
        names = estimates_of(self._settings), ground_truth_of(self._settings)
        self._transforms: dict[str, TransformTopic] = {}  # by topic
        streams = [self._stream('estimate', name) for name in names[0]]
        # made for its parameters also where a file takes its place
        truth = self._stream('ground_truth', names[1])
        self._truth = None if setup.truth else truth
        self._streams = {name.key: one for name, one in zip(names[0], streams, strict=True)}
        if self._truth:
            self._streams[GROUND_TRUTH] = self._truth
        refuse_unknown(self)
        _refuse_twice(self._streams.values())
        self._estimators = self._new_estimators(names[0], setup, truth.topic)
        self._gates = setup.gates
        self._file_span_ns = _span_ns(setup.truth) if setup.truth else None
        self._time_offset_s = config.time_offset_s
        self._reports = ReportFolder(self._settings.report_dir, self.get_logger().error)
        self._runs = Runs(
            self,
            self._estimators,
            self._streams,
            self._reports,
            self._processes,
            default_metrics(config),
            self._snapshot,
        )
        self._alignment = self._new_alignment() if self._settings.publish_tf else None
        self._screens = Screens(self.get_fully_qualified_name(), self._settings, self._log)
        self._other_nodes = 0  # of the same name
        self._offered: list[str] = []  # topics of which one may be meant
        self._published = 0  # messages of which the result is published
        if self._settings.checkpoint_s:
            self._runs.resume(self._new_recovery(config))
        self._serve('reset', self._reset)
        self._serve('write_report', self._write_report)
        self._create_timers()
        self.add_on_set_parameters_callback(self._set_parameters)
        awaited = ' and '.join(
            f'{s.topic} ({s.name.replace("_", " ")})' for s in self._streams.values()
        )
        self.get_logger().info(f'waiting for {awaited}')

    def _common_setup(self, config: EvaluationConfig) -> RunSetup:
        """Return what the runs of all estimates have in common."""
        gates_file, file = self._settings.gates_file, self._settings.ground_truth_file
        with _naming('gates_file'):
            gates = gates_of(Path(gates_file)) if gates_file else []
            check_names(gates, [*metric_names(config), *NAMES, *self._processes.names])
        with _naming('ground_truth_file'):
            truth = alone(read_sources([file])[0]) if file else None
        with _naming('limits_file'):
            limits_file = Path(self._settings.limits_file) if self._settings.limits_file else None
            limits = limits_of(DiagnosisLimits, 'diagnose', self._settings.profile, limits_file)
        for sentence in truth.warnings if truth else ():
            self.get_logger().warning(sentence)
        return RunSetup(
            config=config,
            names=('', ''),
            gates=gates,
            truth=truth,
            max_pairs=self._settings.max_pairs,
            limits=limits,
            processes=self._processes,
        )

    def _new_estimators(
        self, names: Sequence[InputName], setup: RunSetup, truth: str
    ) -> list[Estimator]:
        """Return the estimates under test, each with its run and its topics."""
        metrics = self._chosen_metrics(setup.config)
        running = tuple(Evaluation(setup.config).running())
        return [
            Estimator(
                name,
                self._streams[name.key],
                replace(setup, names=(self._streams[name.key].topic, truth)),
                Outputs(self, name.label, metrics, running),
            )
            for name in names
        ]

    def _new_recovery(self, config: EvaluationConfig) -> Recovery:
        """Return what saves the runs."""
        identity = {
            'options': asdict(config),
            'streams': {name: stream.topic for name, stream in self._streams.items()},
            'ground_truth_file': self._settings.ground_truth_file,
        }
        return Recovery(self._settings, identity, self._streams, self.get_logger().warning)

    def _stream(self, side: str, name: InputName) -> Input:
        """Return a stream of poses."""
        if name.frames:
            topic = self.resolve_topic_name(name.topic)
            if topic not in self._transforms:
                self._transforms[topic] = TransformTopic(self, name.topic)
            return FrameInput(side, self._transforms[topic], name.frames)
        msgtype = getattr(self._settings, f'{side}_type')
        is_unused = side == 'ground_truth' and self._settings.ground_truth_file
        return PoseTopic(self, side, name.topic, '' if is_unused else msgtype)

    def _new_alignment(self) -> AlignmentTransform:
        """Return what publishes alignments as transforms, which no input reads."""
        ignored = [tree.ignored for tree in self._transforms.values()]
        return AlignmentTransform(self, self.get_logger().warning, ignored)

    @property
    def _log(self) -> Log:
        log = self.get_logger()
        return Log(log.info, log.warning, log.error)

    def _chosen_metrics(self, config: EvaluationConfig) -> list[str]:
        """Return the names of the metrics with topics of their own."""
        known = [*metric_names(config), *RECENT, *self._processes.names]
        names = self._settings.publish_metrics
        if names == NodeConfig().publish_metrics:  # other deltas, other names
            return [name for name in names if name in known]
        for name in names:
            if name not in known:
                near = nearest_name(name, known)
                raise ConfigError(f"publish_metrics: there is no metric '{name}'{near}")
        return list(names)

    def create_publisher(self, *given: Any, **options: Any) -> Publisher:
        """Create a publisher without handlers of events: each would cost at every wake-up."""
        without = PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*given, **{'event_callbacks': without, **options})

    def close(self) -> None:
        """End what was started besides."""
        for stream in self._streams.values():
            stream.close()
        self._processes.close()
        self._screens.close()

    def destroy_node(self) -> None:
        """Leave the graph."""
        self.close()
        super().destroy_node()

    @property
    def exit_status(self) -> int:
        """The exit status for what has become of the runs."""
        if self._reports.unwritten:
            return UNABLE
        failed = self._runs.gates_failed and self._settings.exit_code_from_gates
        return FAILED if failed else PASSED

    @property
    def _frame(self) -> str:
        """The frame of the ground truth."""
        return self._truth.frame if self._truth else 'world'

    def end(self) -> None:
        """Evaluate all that has arrived and close the run with its report."""
        self._runs.end()

    def _create_timers(self) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DRAIN_S, self._drain, clock=steady)
        self.create_timer(TICK_S, self._tick, clock=steady)
        watch_graph(self, self._discover)
        back = JumpThreshold(
            min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=False
        )
        self._clock_jumps = self.get_clock().create_jump_callback(
            back, post_callback=lambda jump: self._runs.note_clock_jump()
        )

    def _drain(self) -> None:
        clock = self.get_clock()
        if isinstance(clock, ROSClock) and clock.ros_time_is_active:
            self._runs.clocks.note(time.time_ns(), clock.now().nanoseconds)
        for stream in self._streams.values():
            stream.drain()

    def _discover(self) -> None:
        for stream in self._streams.values():
            stream.discover()
        own = (self.get_name(), self.get_namespace())
        self._other_nodes = self.get_node_names_and_namespaces().count(own) - 1
        streams = self._streams.values()
        is_missing = any(not stream.state.publishers for stream in streams)
        inputs = {stream.topic for stream in streams}
        self._offered = topics_with_poses(self, inputs) if is_missing else []

    def _tick(self) -> None:
        """Evaluate what has arrived since the last tick, and publish."""
        try:
            self._runs.take_in()
        except VioEvalError as error:
            self.get_logger().error(str(error))
        self._processes.sample()
        shown = []
        for estimator in self._estimators:
            if problem := estimator.evaluate(self._settings.window_s, self._frame):
                self.get_logger().error(problem)
            elif self._alignment and estimator.run.values:
                alignment = estimator.run.evaluation.alignment()
                self._alignment.publish(alignment, self._frame, estimator.stream.frame)
            health = statuses(self._snapshot(estimator))
            estimator.outputs.publish_health(health)
            shown.append(Shown(estimator.name.label, estimator.run, health))
        self._screens.show(self._runs.number, shown, self._advice())
        self._publish_results_of_silence()
        self._runs.save()

    def _snapshot(self, estimator: Estimator) -> Snapshot:
        """Return all that the health of an evaluation is judged by."""
        streams = [one for one in (estimator.stream, self._truth) if one is not None]
        unsaved = self._runs.recovery.problem if self._runs.recovery else ''
        problems = (estimator.problem, *self._reports.unwritten.values(), unsaved)
        return Snapshot(
            run=estimator.run.state(),
            topics=tuple(stream.state for stream in streams),
            file_span_ns=self._file_span_ns,
            gates=self._gates,
            time_offset_s=self._time_offset_s,
            stale_after_s=self._settings.stale_after_s,
            problems=tuple(problem for problem in problems if problem),
            clock_jumped=self._runs.clock_jumped,
            offered=self._offered,
            other_node=self.get_fully_qualified_name() if self._other_nodes else '',
        )

    def _advice(self) -> list[str]:
        """Return what may be meant by topics that nobody publishes."""
        states = [stream.state for stream in self._streams.values()] if self._offered else []
        missing = [state for state in states if not state.publishers and not state.received]
        return [problem for one in missing for problem in topic_problems(one, self._offered)]

    def _publish_results_of_silence(self) -> None:
        """Publish the results where all streams are silent, once for what has arrived."""
        received = sum(stream.received for stream in self._streams.values())
        silent = all(one.silent_s > self._settings.stale_after_s for one in self._streams.values())
        if silent and received > self._published:
            self._published = received
            for estimator in self._estimators:
                estimator.outputs.publish_result(estimator.run.result())

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
        self._runs.reset()
        return f'run {self._runs.number} begins'

    def _write_report(self) -> str:
        self._runs.take_in()
        if self._runs.is_empty:
            why = why_no_pairs(self._snapshot(self._estimators[0]))
            raise VioEvalError(f'nothing to report: {why}')
        self._runs.finish(self._runs.folder)
        self._runs.complete()
        if not self._settings.report_dir:
            return 'published, not written'
        folder = Path(self._settings.report_dir) / self._runs.folder
        if folder in self._reports.unwritten:
            raise VioEvalError(self._reports.unwritten[folder])
        return str(folder)

    def _set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            settings = changed(self._settings, parameters)
            self._reports.move(settings.report_dir, self._runs.folder)
            self._settings = settings
        except (ConfigError, WriteError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _refuse_twice(streams: Iterable[Input]) -> None:
    """Raise where two streams are one."""
    names: dict[str, str] = {}
    for stream in streams:
        other = names.setdefault(stream.topic, stream.name)
        if other != stream.name:
            raise ConfigError(f'{other} and {stream.name} are both {stream.topic}')


def _span_ns(source: Source) -> tuple[int, int]:
    stamps_ns = source.poses.stamps_ns
    return int(stamps_ns.min()), int(stamps_ns.max())


@contextmanager
def _naming(parameter: str) -> Iterator[None]:
    """Name the parameter in front of what is wrong with its value."""
    try:
        yield
    except VioEvalError as error:
        raise ConfigError(f'{parameter}: {error}') from None


def spin(argv: list[str], signals: list[int]) -> int:
    """
    Run the node until a signal ends it; return the exit status.

    :param signals: receives the signals. The handlers of rclpy would end the graph before what is
        still under way is evaluated.
    """
    node: Evaluator | None = None
    try:
        if width_of(sys.stderr):
            log_over_lines(os.environ)
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
        if node is not None:
            node.close()
        rclpy.try_shutdown()
    return node.exit_status
