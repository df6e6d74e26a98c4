"""
The live node: subscribes to an estimate and a ground truth, publishes how far they are apart.

Messages are taken serialised, many at a time, and decoded in columns: one of them costs less here
than its mere deserialisation elsewhere. What has arrived is evaluated once a second.
"""

from __future__ import annotations

from pathlib import Path
import signal
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path as PathMessage
import rclpy
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from vio_eval_ros.cli.shell import FAILED, PASSED
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import check_names, Gate
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, VioEvalError
from vio_eval_ros.nodes.display import error_markers, path_message
from vio_eval_ros.nodes.live import jumped_back, LiveRun
from vio_eval_ros.nodes.parameters import declare
from vio_eval_ros.nodes.status import status_messages
from vio_eval_ros.nodes.stream import Stream
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.reports import REPORTS
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
        self.gates = _gates(self.settings.gates_file)
        known = metric_names(self.config)
        check_names(self.gates, known)
        for name in self.settings.publish_metrics:
            if name not in known:
                raise ConfigError(f"publish_metrics: there is no metric '{name}'")
        file = self.settings.ground_truth_file
        self._truth = read_sources([file])[0] if file else None
        self.estimate = Stream(self, 'estimate', self.settings.estimate_type)
        self.ground_truth = (
            None if file else Stream(self, 'ground_truth', self.settings.ground_truth_type)
        )
        self.streams = [stream for stream in (self.estimate, self.ground_truth) if stream]
        self.run_number = 0
        self.values: dict[str, float] = {}
        self.window: dict[str, float] = {}
        self.failed_gates = False
        self.note = ''
        self._published = 0
        self._begin()
        self._create_outputs(known)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(DRAIN_S, self._drain, clock=steady)
        self.create_timer(TICK_S, self._tick, clock=steady)
        self.create_timer(DISCOVERY_S, self._discover, clock=steady)
        self._jump = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(seconds=-1)),
            post_callback=lambda jump: self._next_run('the clock jumped back'),
        )

    @property
    def folder(self) -> Path:
        """Where the report of the run goes, in the report folder."""
        return Path(f'run_{self.run_number:04d}') if self.run_number > 1 else Path()

    def _create_outputs(self, known: list[str]) -> None:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._result = self.create_publisher(String, '~/result', latched)
        self._aligned = self.create_publisher(PathMessage, '~/estimate_aligned', latched)
        self._truth_path = self.create_publisher(PathMessage, '~/ground_truth_path', latched)
        self._markers = self.create_publisher(MarkerArray, '~/error_markers', latched)
        names = self.settings.publish_metrics
        self._metrics = {n: self.create_publisher(Float64, f'~/metrics/{n}', 10) for n in names}
        self._windows = {n: self.create_publisher(Float64, f'~/window/{n}', 10) for n in names}
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_service(Trigger, '~/write_report', self._write_report)

    def _begin(self) -> None:
        self.run_number += 1
        names = tuple(self.resolve_topic_name(name) for name in ('estimate', 'ground_truth'))
        self.run = LiveRun(
            self.config, self.gates, names, self._truth, self.settings.max_pairs
        )
        self.values, self.window = {}, {}

    def _discover(self) -> None:
        for stream in self.streams:
            stream.discover()

    def _drain(self) -> None:
        for stream in self.streams:
            stream.drain()

    def _tick(self) -> None:
        """Evaluate what has arrived since the last tick, and publish."""
        self.take_in()
        for _, values in self.run.advance():
            self.values = values
            for name, publisher in self._metrics.items():
                if name in self.values:
                    publisher.publish(Float64(data=self.values[name]))
        if self.values:
            self.window = self.run.evaluation.window(self.settings.window_s)
            for name, publisher in self._windows.items():
                publisher.publish(Float64(data=self.window[name]))
        self._display()
        array = DiagnosticArray(status=status_messages(self))
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
        received = sum(stream.received for stream in self.streams)
        silent = all(s.silent_s() > self.settings.stale_after_s for s in self.streams)
        if silent and received > self._published:
            self._published = received
            self._result.publish(String(data=REPORTS['json'](self.run.result())))

    def take_in(self) -> None:
        """Hand the poses that have arrived to the run; split it where a stream jumps back."""
        self._drain()
        for stream in self.streams:
            poses = stream.decode()
            if poses is None or not len(poses):
                continue
            start = jumped_back(poses.stamps_ns, stream.newest_ns)
            if start is not None:
                self._add(stream, poses[:start])
                poses = poses[start:]
                self._next_run(f'{stream.name} jumped back in time')
            stream.newest_ns = max(stream.newest_ns, int(poses.stamps_ns.max()))
            self._add(stream, self._of_this_run(stream, poses))

    def _add(self, stream: Stream, poses: Poses) -> None:
        if stream is self.estimate:
            self.run.add_estimate(poses, stream.path)
        else:
            self.run.add_ground_truth(poses)

    def _of_this_run(self, stream: Stream, poses: Poses) -> Poses:
        """Return the poses without those that are left over from before a jump back."""
        if stream.ignore_from_ns is None:
            return poses
        current = poses.stamps_ns < stream.ignore_from_ns
        if current.any():
            stream.ignore_from_ns = None
        stream.left_over += int((~current).sum())
        return poses[current]

    def _next_run(self, why: str) -> None:
        """Close the run with its report, and begin the next."""
        if not any(stream.received for stream in self.streams):
            return
        self.get_logger().warning(f'{why}: run {self.run_number} ends, the next begins')
        self.finish(Path(f'run_{self.run_number:04d}'))
        for stream in self.streams:
            stream.restart()
        self._begin()

    def finish(self, folder: Path) -> None:
        """Write and publish the result of the run; a folder that cannot be written is logged."""
        for _ in self.run.advance():
            pass
        if self.settings.report_dir:
            try:
                result = self.run.write(Path(self.settings.report_dir) / folder)
            except (VioEvalError, OSError) as error:
                self.note = f'report: {error}'
                self.get_logger().error(self.note)
        result = self.run.result()
        self.failed_gates = result.passed is False
        self._result.publish(String(data=REPORTS['json'](result)))

    def _display(self) -> None:
        """Publish paths and errors to whoever looks at them."""
        wanted = [
            p
            for p in (self._aligned, self._truth_path, self._markers)
            if p.get_subscription_count()
        ]
        if not wanted or not self.values:
            return
        pairs, alignment = self.run.evaluation.aligned()
        frame = self.ground_truth.frame if self.ground_truth else 'world'
        if self._aligned in wanted:
            self._aligned.publish(path_message(alignment.apply(pairs.estimate), frame))
        if self._truth_path in wanted:
            self._truth_path.publish(path_message(pairs.ground_truth, frame))
        if self._markers in wanted:
            self._markers.publish(error_markers(pairs, alignment, frame))

    def _reset(self, _: Any, response: Any) -> Any:
        self._next_run('reset was called')
        response.success, response.message = True, f'run {self.run_number} begins'
        return response

    def _write_report(self, _: Any, response: Any) -> Any:
        self.take_in()
        self.note = ''
        self.finish(self.folder)
        response.success = not self.note
        response.message = self.note or (self.settings.report_dir or 'published, not written')
        return response


def _gates(file: str) -> list[Gate]:
    return gates_of(Path(file)) if file else []


def spin(argv: list[str]) -> int:
    """Run the node until it is told to stop; return the exit status."""
    told: list[int] = []
    # rclpy's own handlers would end the graph before what is still under way is evaluated
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: told.append(number))
    rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Evaluator()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not told:
            executor.spin_once(timeout_sec=DRAIN_S)
        node.take_in()
        node.finish(node.folder)
        return FAILED if node.failed_gates and node.settings.exit_code_from_gates else PASSED
    finally:
        rclpy.try_shutdown()
