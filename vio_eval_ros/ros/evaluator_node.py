"""
The live node: subscribes to an estimate and a ground truth, publishes how far they are apart.

Messages are taken serialised, many at a time, and decoded in columns: one of them costs less here
than its mere deserialisation elsewhere. What has arrived is evaluated once a second: from
:class:`PoseTopic` by way of its queue of runs into the :class:`LiveRun`, and from there to
``/diagnostics`` by way of :mod:`vio_eval_ros.live.health`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
import math
from pathlib import Path
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

from vio_eval_ros.comparison.comparison import Comparison
from vio_eval_ros.comparison.matrix import CellRun, default_metrics
from vio_eval_ros.comparison.tables import text_tables
from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.evaluation import Evaluation, metric_names
from vio_eval_ros.core.gates import check_names
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, UNABLE, VioEvalError, WriteError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.live.health import statuses, why_no_pairs
from vio_eval_ros.live.inputs import estimates_of, GROUND_TRUTH, ground_truth_of, InputName
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.live.processes import Processes
from vio_eval_ros.live.queues import LAG_S, why_the_run_ends
from vio_eval_ros.live.report_folder import ReportFolder
from vio_eval_ros.live.run import RunSetup
from vio_eval_ros.live.snapshot import Snapshot
from vio_eval_ros.live.timeliness import ClockRelation, NAMES, RECENT
from vio_eval_ros.recordings.agreement.orders import alone
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.ros.context import join, watch_graph
from vio_eval_ros.ros.estimator import Estimator
from vio_eval_ros.ros.outputs import Outputs
from vio_eval_ros.ros.parameters import changed, declare, refuse_unknown
from vio_eval_ros.ros.pose_topic import PoseTopic
from vio_eval_ros.ros.recovery import Recovery
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
        streams = [self._stream('estimate', name) for name in names[0]]
        # made for its parameters also where a file takes its place
        truth = self._stream('ground_truth', names[1])
        self._truth = None if setup.truth else truth
        self._streams = {name.key: one for name, one in zip(names[0], streams, strict=True)}
        if self._truth:
            self._streams[GROUND_TRUTH] = self._truth
        refuse_unknown(self)
        _refuse_twice(self._streams.values())
        metrics = self._chosen_metrics(config)
        running = tuple(Evaluation(config).running())
        self._estimators = [
            Estimator(
                name,
                stream,
                replace(setup, names=(stream.topic, truth.topic)),
                Outputs(self, name.label, metrics, running),
            )
            for name, stream in zip(names[0], streams, strict=True)
        ]
        self._number = 1  # of the run
        self._clocks = ClockRelation()
        self._gates = setup.gates
        self._file_span_ns = _span_ns(setup.truth) if setup.truth else None
        self._time_offset_s = config.time_offset_s
        self._compared = default_metrics(config)
        self._reports = ReportFolder(self._settings.report_dir, self.get_logger().error)
        self._failed_gates = False
        self._other_nodes = 0  # of the same name
        self._clock_jumped_s = math.inf  # monotonic, until the run ends
        self._ended_s = -math.inf  # monotonic, when the run before ended
        self._published = 0  # messages of which the result is published
        self._recovery = self._resumed(config)
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

    def _resumed(self, config: EvaluationConfig) -> Recovery | None:
        """Return what saves the run; go on with one that was left by a node that was killed."""
        if not self._settings.checkpoint_s:
            return None
        identity = {
            'options': asdict(config),
            'streams': {name: stream.topic for name, stream in self._streams.items()},
            'ground_truth_file': self._settings.ground_truth_file,
        }
        recovery = Recovery(self._settings, identity, self._streams, self.get_logger().warning)
        if found := recovery.resume():
            self._number, self._failed_gates = found.run, found.gates_failed
            for estimator in self._estimators:
                estimator.next_run(found.run, 'an earlier evaluator ended without its report')
            self._distribute({name: one.queue.take() for name, one in self._streams.items()})
            for estimator in self._estimators:
                estimator.catch_up()
        return recovery

    def _stream(self, side: str, name: InputName) -> PoseTopic:
        """Return a stream of poses."""
        msgtype = getattr(self._settings, f'{side}_type')
        is_unused = side == 'ground_truth' and self._settings.ground_truth_file
        return PoseTopic(self, side, name.topic, '' if is_unused else msgtype)

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

    def destroy_node(self) -> None:
        """Leave the graph."""
        self.close()
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
        return self._truth.frame if self._truth else 'world'

    @property
    def _run_folder(self) -> Path:
        """Where the report of the run goes while it goes on, in the report folder."""
        return self._folder if self._number > 1 else Path()

    @property
    def _folder(self) -> Path:
        """Where it goes once there is another run."""
        return Path(f'run_{self._number:04d}')

    @property
    def _is_empty(self) -> bool:
        """Whether no pose of the run has arrived."""
        return all(one.run.is_empty for one in self._estimators)

    def _create_timers(self) -> None:
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DRAIN_S, self._drain, clock=steady)
        self.create_timer(TICK_S, self._tick, clock=steady)
        watch_graph(self, self._discover)
        back = JumpThreshold(
            min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=False
        )
        self._clock_jumps = self.get_clock().create_jump_callback(
            back, post_callback=lambda jump: self._on_clock_jump()
        )

    def _drain(self) -> None:
        clock = self.get_clock()
        if isinstance(clock, ROSClock) and clock.ros_time_is_active:
            self._clocks.note(time.time_ns(), clock.now().nanoseconds)
        for stream in self._streams.values():
            stream.drain()

    def _discover(self) -> None:
        for stream in self._streams.values():
            stream.discover()
        own = (self.get_name(), self.get_namespace())
        self._other_nodes = self.get_node_names_and_namespaces().count(own) - 1

    def _tick(self) -> None:
        """Evaluate what has arrived since the last tick, and publish."""
        try:
            self._take_in()
        except VioEvalError as error:
            self.get_logger().error(str(error))
        self._processes.sample()
        for estimator in self._estimators:
            if problem := estimator.evaluate(self._settings.window_s, self._frame):
                self.get_logger().error(problem)
            estimator.outputs.publish_health(statuses(self._snapshot(estimator)))
        self._publish_results_of_silence()
        if self._recovery:
            self._recovery.save(self._number, self._failed_gates)

    def _snapshot(self, estimator: Estimator) -> Snapshot:
        """Return all that the health of an evaluation is judged by."""
        streams = filter(None, (estimator.stream, self._truth))
        unsaved = self._recovery.problem if self._recovery else ''
        problems = (estimator.problem, *self._reports.unwritten.values(), unsaved)
        return Snapshot(
            run=estimator.run.state(),
            topics=tuple(stream.state for stream in streams),
            file_span_ns=self._file_span_ns,
            gates=self._gates,
            time_offset_s=self._time_offset_s,
            stale_after_s=self._settings.stale_after_s,
            problems=tuple(problem for problem in problems if problem),
            clock_jumped=self._clock_jumped_s < math.inf,
            other_node=self.get_fully_qualified_name() if self._other_nodes else '',
        )

    def _publish_results_of_silence(self) -> None:
        """Publish the results where all streams are silent, once for what has arrived."""
        received = sum(stream.received for stream in self._streams.values())
        silent = all(one.silent_s > self._settings.stale_after_s for one in self._streams.values())
        if silent and received > self._published:
            self._published = received
            for estimator in self._estimators:
                estimator.outputs.publish_result(estimator.run.result())

    def _take_in(self) -> None:
        """Hand the poses that have arrived to their run; go on to the next where one ends."""
        for stream in self._streams.values():
            stream.read()
        for estimator in self._estimators:
            estimator.note_arrivals(self._clocks)
        self._hand_over()
        self._end_runs()
        if self._clock_jumped_s + LAG_S < time.monotonic():
            self._next_run('the clock jumped back')

    def _end_runs(self, at_once: bool = False) -> None:
        """Go on to the next run as long as a jump back in time says so."""
        while why := why_the_run_ends(
            [stream.progress for stream in self._streams.values()], time.monotonic(), at_once
        ):
            self._next_run(why)

    def _hand_over(self) -> None:
        poses = {name: stream.queue.take() for name, stream in self._streams.items()}
        if self._recovery:
            self._recovery.note(poses)
        self._distribute(poses)

    def _distribute(self, poses: Mapping[str, Poses]) -> None:
        """Hand the poses of the streams, by their names, to the runs."""
        truth = poses.get(GROUND_TRUTH, Trajectory.empty())
        for estimator in self._estimators:
            estimator.add(poses[estimator.name.key], truth)

    def _release(self) -> None:
        """Hand over what is withheld as well: nothing more will come to tell what it is."""
        for stream in self._streams.values():
            stream.queue.release()
        self._hand_over()

    def _on_clock_jump(self) -> None:
        # the streams, which jump as well, may have ended the run already
        if not self._is_empty and time.monotonic() - self._ended_s > LAG_S:
            self._clock_jumped_s = time.monotonic()

    def _next_run(self, why: str) -> None:
        """Close the run with its report, and begin the next."""
        self.get_logger().warning(f'{why}: run {self._number} ends, the next begins')
        try:
            self._close(self._folder)
        finally:  # whatever became of it, it has ended
            for stream in self._streams.values():
                stream.next_run()
            self._reports.next_run()
            if self._recovery:
                self._recovery.next_run()
            self._processes.begin_run()
            self._ended_s = time.monotonic()
            self._clock_jumped_s = math.inf
            self._number += 1
            for estimator in self._estimators:
                estimator.next_run(self._number, why)
        self._hand_over()

    def end(self) -> None:
        """Evaluate all that has arrived and close the run with its report."""
        self._take_in()
        self._end_runs(at_once=True)
        self._release()
        if not (self._is_empty and self._number > 1):  # else the one before was the last
            self._close(self._run_folder)
        if self._recovery and not self._reports.unwritten:
            self._recovery.end()

    def _close(self, folder: Path) -> None:
        """Write, publish and log the results of a run that has ended; remember the verdicts."""
        results = self._finish(folder)
        self._failed_gates |= any(result.passed is False for result in results.values())

    def _finish(self, folder: Path) -> dict[str, Result]:
        """Write, publish and log the results of the run; return them by estimate."""
        runs = {}
        for estimator in self._estimators:
            estimator.advance()
            heard = filter(None, (estimator.stream, self._truth))
            estimator.run.notes = [note for stream in heard for note in stream.notes()]
            if self._recovery and self._recovery.resumed:
                estimator.run.notes.insert(0, self._recovery.resumed)
            runs[estimator.name.label] = estimator.run
        # what an earlier evaluator left there is not replaced by nothing
        written = None if self._is_empty else self._reports.write(runs, folder, self._compare)
        results = written[0] if written else {label: run.result() for label, run in runs.items()}
        for estimator in self._estimators:
            estimator.outputs.publish_result(results[estimator.name.label])
        self._log(results, f'; the report is in {written[1]}' if written else '')
        return results

    def _compare(self, results: Mapping[str, Result]) -> Comparison:
        runs = {label: CellRun.of(label, result) for label, result in results.items()}
        return Comparison(runs, tuple(self._compared))

    def _log(self, results: Mapping[str, Result], where: str) -> None:
        log = self.get_logger()
        for estimator in self._estimators:
            name = f'{estimator.name.label}: ' if estimator.name.label else ''
            found, wrong = estimator.told(results[estimator.name.label], self._snapshot(estimator))
            log.info(f'run {self._number}: {name}{found}{where}')
            for line in wrong:
                log.warning(f'{name}{line}')
        if len(results) > 1:
            for line in text_tables(self._compare(results).matrix).splitlines():
                log.info(line)

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
        if not self._is_empty:
            self._next_run('reset was called')
        return f'run {self._number} begins'

    def _write_report(self) -> str:
        self._take_in()
        if self._is_empty:
            why = why_no_pairs(self._snapshot(self._estimators[0]))
            raise VioEvalError(f'nothing to report: {why}')
        self._finish(self._run_folder)
        if not self._settings.report_dir:
            return 'published, not written'
        folder = Path(self._settings.report_dir) / self._run_folder
        if folder in self._reports.unwritten:
            raise VioEvalError(self._reports.unwritten[folder])
        return str(folder)

    def _set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            settings = changed(self._settings, parameters)
            self._reports.move(settings.report_dir, self._run_folder)
            self._settings = settings
        except (ConfigError, WriteError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _refuse_twice(streams: Iterable[PoseTopic]) -> None:
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
