"""An estimate under test, on the node: its stream, its run, its topics."""

from __future__ import annotations

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import VioEvalError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.live.health import why_no_pairs
from vio_eval_ros.live.inputs import InputName
from vio_eval_ros.live.run import LiveRun, RunSetup
from vio_eval_ros.live.snapshot import Snapshot
from vio_eval_ros.live.timeliness import ClockRelation
from vio_eval_ros.rendering.text import number
from vio_eval_ros.reports.text import headline
from vio_eval_ros.ros.frame_input import Input
from vio_eval_ros.ros.outputs import Outputs


class Estimator:
    """
    An estimate under test.

    :param name: of its stream, and what it is called beside others.
    """

    def __init__(self, name: InputName, stream: Input, setup: RunSetup, outputs: Outputs) -> None:
        self.name = name
        self.stream = stream
        self.run = LiveRun(setup)
        self.outputs = outputs
        self.problem = ''  # of the run: why it cannot be evaluated
        self._setup = setup

    def add(self, poses: Poses) -> None:
        """Hand poses that have arrived to the run."""
        if len(poses):
            self.run.add_estimate(poses, self.stream.revisions)

    def note_arrivals(self, clock: ClockRelation) -> None:
        """Note how late poses came, but for those of the next run."""
        if self.stream.queue.jumps:
            return
        for arrivals in self.stream.arrivals():
            self.run.note_arrivals(arrivals, clock.node_ns(arrivals.received_ns))

    def evaluate(self, window_s: float, frame: str) -> str:
        """Evaluate what is certain by now, and publish; return what is newly wrong."""
        try:
            self.advance()
            self.run.look(window_s)
        except VioEvalError as error:
            before, self.problem = self.problem, str(error)
            return '' if self.problem == before else self.problem
        if self.run.values:
            self.outputs.publish_window(self.run.window)
            self.outputs.show(self.run.evaluation, frame)
        return ''

    def advance(self) -> None:
        """Evaluate the seconds that are over, and publish their running values."""
        for stamp_ns, values in self.run.advance():
            self.outputs.publish_second(stamp_ns, values, self.run.began_ns)

    def catch_up(self) -> None:
        """Evaluate seconds that were published before."""
        for _ in self.run.advance():
            pass

    def next_run(self, number: int, why: str) -> None:
        """Begin another run."""
        self.problem = ''
        self.run = LiveRun(self._setup, number, why)

    def told(self, result: Result, snapshot: Snapshot) -> tuple[str, list[str]]:
        """Return what to log of a run that has ended: a line, and what is wrong."""
        found = headline(result) if len(result.summary.pairs) else why_no_pairs(snapshot)
        broken = [
            f'{verdict.word} {verdict.gate} (is {number(verdict.value)})'
            for verdict in result.verdicts
            if not verdict.passed
        ]
        return found, [*self.run.notes, *broken]
