"""The runs of the node, one after another: each is handed what arrives, and ends with a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import math
from pathlib import Path
import time

from rclpy.node import Node

from vio_eval_ros.comparison.comparison import Comparison
from vio_eval_ros.comparison.matrix import CellRun
from vio_eval_ros.comparison.tables import text_tables
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.live.health import conclusions
from vio_eval_ros.live.inputs import GROUND_TRUTH
from vio_eval_ros.live.monitor import DiagnosisMonitor
from vio_eval_ros.live.processes import Processes
from vio_eval_ros.live.queues import LAG_S, why_the_run_ends
from vio_eval_ros.live.report_folder import ReportFolder
from vio_eval_ros.live.snapshot import Snapshot
from vio_eval_ros.live.timeliness import ClockRelation
from vio_eval_ros.ros.estimator import Estimator
from vio_eval_ros.ros.frame_input import Input
from vio_eval_ros.ros.recovery import Recovery


class Runs:
    """
    What the node evaluates, from one jump back in time to the next.

    :param streams: all that it listens to, by name.
    :param reports: where each run leaves its report.
    :param compared: the metrics by which several estimates are compared.
    :param snapshot: returns all that the health of an evaluation is judged by.
    """

    def __init__(
        self,
        node: Node,
        estimators: Sequence[Estimator],
        streams: Mapping[str, Input],
        reports: ReportFolder,
        processes: Processes,
        compared: Sequence[str],
        snapshot: Callable[[Estimator], Snapshot],
    ) -> None:
        self.number = 1
        self.gates_failed = False
        #: what saves the run, where that was asked for
        self.recovery: Recovery | None = None
        self.clocks = ClockRelation()
        self._estimators = estimators
        self._streams = streams
        self._reports = reports
        self._processes = processes
        self._compared = tuple(compared)
        self._snapshot = snapshot
        self._log = node.get_logger()
        self._unfinished: Callable[[], None] | None = None
        self._clock_jumped_s = math.inf  # monotonic, until the run ends
        self._ended_s = -math.inf  # monotonic, when the run before ended

    @property
    def folder(self) -> Path:
        """Where the report of the run goes while it goes on, in the report folder."""
        return self._own_folder if self.number > 1 else Path()

    @property
    def _own_folder(self) -> Path:
        """Where it goes once there is another run."""
        return Path(f'run_{self.number:04d}')

    @property
    def is_empty(self) -> bool:
        """Whether no pose of the run has arrived."""
        return all(one.run.is_empty for one in self._estimators)

    @property
    def clock_jumped(self) -> bool:
        """Whether the clock of ROS has jumped back, and the streams not yet."""
        return self._clock_jumped_s < math.inf

    def resume(self, recovery: Recovery) -> None:
        """Save the runs from now on; go on with one that was left by a node that was killed."""
        self.recovery = recovery
        found = recovery.resume()
        if not found:
            return
        self.number, self.gates_failed = found.run, found.gates_failed
        for estimator in self._estimators:
            estimator.next_run(found.run, 'an earlier evaluator ended without its report')
        self._distribute({name: one.queue.take() for name, one in self._streams.items()})
        for estimator in self._estimators:
            estimator.catch_up()

    def take_in(self) -> None:
        """Hand the poses that have arrived to their run; go on to the next where one ends."""
        for stream in self._streams.values():
            stream.read()
        for estimator in self._estimators:
            estimator.note_arrivals(self.clocks)
        self._hand_over()
        self._end_runs()
        if self._clock_jumped_s + LAG_S < time.monotonic():
            self._next_run('the clock jumped back')

    def save(self) -> None:
        """Save the run, where it is time to."""
        if self.recovery:
            self.recovery.save(self.number, self.gates_failed)

    def note_clock_jump(self) -> None:
        """End the run, but give the streams time: they jump as well, or have ended it already."""
        if not self.is_empty and time.monotonic() - self._ended_s > LAG_S:
            self._clock_jumped_s = time.monotonic()

    def reset(self) -> None:
        """Close the run with all that has arrived, and begin the next."""
        self.take_in()
        self._release()
        if not self.is_empty:
            self._next_run('reset was called')

    def finish(self, folder: Path) -> dict[str, Result]:
        """Write, publish and log the results of the run as it stands; return them by estimate."""
        runs = {}
        for estimator in self._estimators:
            estimator.advance()
            heard = [
                self._streams[n] for n in (estimator.name.key, GROUND_TRUTH) if n in self._streams
            ]
            estimator.run.notes = [note for stream in heard for note in stream.notes()]
            if self.recovery and self.recovery.resumed:
                estimator.run.notes.insert(0, self.recovery.resumed)
            runs[estimator.name.label] = estimator.run
        # what an earlier evaluator left there is not replaced by nothing
        written = None if self.is_empty else self._reports.write(runs, folder, self._compare)
        results = written[0] if written else {label: run.result() for label, run in runs.items()}
        for estimator in self._estimators:
            estimator.outputs.publish_result(results[estimator.name.label])
        self._tell(results, f'; the report is in {written[1]}' if written else '')
        monitors = {one.name.label: one.run.monitor for one in self._estimators}
        self._unfinished = partial(self._complete, results, written and written[1], monitors)
        return results

    def complete(self) -> None:
        """Do what is left of a run that was finished, and takes longest: pages and diagnoses."""
        unfinished, self._unfinished = self._unfinished, None
        if unfinished:
            unfinished()

    def _complete(
        self,
        results: Mapping[str, Result],
        folder: Path | None,
        monitors: Mapping[str, DiagnosisMonitor],
    ) -> None:
        if folder and (why_not := self._reports.write_pages(results, folder, self._compare)):
            self._log.info(why_not)
        for label, monitor in monitors.items():
            diagnosis = monitor.conclude(results[label].summary.pairs)
            for line in conclusions(diagnosis, monitor.problem):
                self._log.warning(f'{label}: {line}' if label else line)

    def end(self) -> None:
        """Evaluate all that has arrived and close the last run with its report."""
        self.take_in()
        self._end_runs(at_once=True)
        self._release()
        if not (self.is_empty and self.number > 1):  # else the one before was the last
            self._close(self.folder)
        if self.recovery and not self._reports.unwritten:
            self.recovery.end()
        self.complete()

    def _end_runs(self, at_once: bool = False) -> None:
        """Go on to the next run as long as a jump back in time says so."""
        while why := why_the_run_ends(
            [stream.progress for stream in self._streams.values()], time.monotonic(), at_once
        ):
            self._next_run(why)

    def _next_run(self, why: str) -> None:
        """Close the run with its report, and begin the next."""
        self._log.warning(f'{why}: run {self.number} ends, the next begins')
        try:
            self._close(self._own_folder)
        finally:  # whatever became of it, it has ended
            for stream in self._streams.values():
                stream.next_run()
            self._reports.next_run()
            if self.recovery:
                self.recovery.next_run()
            self._processes.begin_run()
            self._ended_s = time.monotonic()
            self._clock_jumped_s = math.inf
            self.number += 1
            for estimator in self._estimators:
                estimator.next_run(self.number, why)
        self._hand_over()
        self.complete()

    def _close(self, folder: Path) -> None:
        """Finish a run that has ended; remember the verdicts."""
        results = self.finish(folder)
        self.gates_failed |= any(result.passed is False for result in results.values())

    def _hand_over(self) -> None:
        poses = {name: stream.queue.take() for name, stream in self._streams.items()}
        if self.recovery:
            self.recovery.note(poses)
        self._distribute(poses)

    def _distribute(self, poses: Mapping[str, Poses]) -> None:
        """Hand the poses of the streams, by their names, to the runs."""
        true_poses, truth = poses.get(GROUND_TRUTH), self._streams.get(GROUND_TRUTH)
        for estimator in self._estimators:
            estimator.add(poses[estimator.name.key])
            if true_poses is not None and truth is not None and len(true_poses):
                estimator.run.add_ground_truth(true_poses, truth.revisions)

    def _release(self) -> None:
        """Hand over what is withheld as well: nothing more will come to tell what it is."""
        for stream in self._streams.values():
            stream.release()
        self._hand_over()

    def _compare(self, results: Mapping[str, Result]) -> Comparison:
        runs = {label: CellRun.of(label, result) for label, result in results.items()}
        return Comparison(runs, self._compared)

    def _tell(self, results: Mapping[str, Result], where: str) -> None:
        """Log what became of the run."""
        for estimator in self._estimators:
            name = f'{estimator.name.label}: ' if estimator.name.label else ''
            found, wrong = estimator.told(results[estimator.name.label], self._snapshot(estimator))
            self._log.info(f'run {self.number}: {name}{found}{where}')
            for line in wrong:
                self._log.warning(f'{name}{line}')
        if len(results) > 1:
            for line in text_tables(self._compare(results).matrix).splitlines():
                self._log.info(line)
