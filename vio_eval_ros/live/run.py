"""
A live run: poses as they arrive, evaluated second by second, reported when it ends.

Knows nothing of ROS: the node moves poses in and results out.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
import copy
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Protocol

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation, Summary
from vio_eval_ros.core.gates import Gate, judge
from vio_eval_ros.core.interleaving import interleaving
from vio_eval_ros.core.series import MAX_WAITING_PER_PAIR, RunningSeries
from vio_eval_ros.core.side import Side
from vio_eval_ros.core.steps import step_lengths
from vio_eval_ros.core.trajectory import Pairs, Poses
from vio_eval_ros.diagnosis.limits import DEFAULT, DiagnosisLimits
from vio_eval_ros.errors import ReadError
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.live.monitor import DiagnosisMonitor
from vio_eval_ros.live.processes import Processes
from vio_eval_ros.live.snapshot import RunState, SideState
from vio_eval_ros.live.timeliness import Arrivals, Timeliness
from vio_eval_ros.recordings.messages import PathRevisions
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.rendering.files import make_writable, write_all
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.tables import series_csv

#: the smallest step of the estimate, beyond that of the ground truth, that is called a jump
MIN_JUMP_M = 0.5
REPORT_FILES = {'json': 'result.json', 'markdown': 'result.md', 'csv': 'errors.csv'}
SERIES, TRAJECTORY = 'series.csv', '{}.tum'
ESTIMATE, GROUND_TRUTH = SIDES = ('estimate', 'ground_truth')
#: comes last, since drawing takes longer than all that
PAGE = 'result.html'


class Revised(Protocol):
    """A trajectory of which more is known at the end of a run than when its poses came."""

    warnings: Sequence[str]

    def final(self) -> Poses:
        """Return the trajectory as it is known now; raise ``ReadError`` where it makes none."""


@dataclass(frozen=True, eq=False)
class RunSetup:
    """
    What the runs of an evaluator have in common.

    :param names: what the estimate and the ground truth are called in the result.
    :param truth: the ground truth, where it comes from a file.
    :param max_pairs: how many pairs are kept, see :class:`Evaluation`.
    :param limits: what the diagnosis calls healthy.
    :param processes: of the stack, whose cost is measured.
    """

    config: EvaluationConfig
    names: tuple[str, str]
    gates: Sequence[Gate] = ()
    truth: Source | None = None
    max_pairs: int | None = None
    limits: DiagnosisLimits = DEFAULT
    processes: Processes | None = None


class LiveRun:
    """
    One run of the estimator under test, from its first pose to its last.

    :param number: which run of the evaluator it is, from 1.
    :param began_as: why the run before it ended; empty for the first.
    """

    def __init__(self, setup: RunSetup, number: int = 1, began_as: str = '') -> None:
        self.number = number
        self.began_as = began_as
        #: the running values of the last second that is over
        self.values: Mapping[str, float] = {}
        #: the stamp of the first second that was over; 0 before
        self.began_ns = 0
        #: all metrics of the window
        self.window: Mapping[str, float] = {}
        #: latency and rate in the window
        self.timing: Mapping[str, float] = {}
        #: whether no pose has arrived
        self.is_empty = True
        #: what the user should know of how the poses came here, for the warnings of the result
        self.notes: list[str] = []
        #: why it is as bad as it is
        self.monitor = DiagnosisMonitor(setup.config, setup.limits)
        self._setup = setup
        self._series = RunningSeries(setup.config, setup.max_pairs)
        self._rows = SeriesRows()
        self._timeliness = Timeliness(setup.config, setup.max_pairs)
        self._window_s = 0.0
        self._turns: tuple[str, ...] = ()
        self._seen = 0
        self._largest_jump: tuple[int, float] | None = None
        self._revisions: dict[str, Revised] = {}  # by side
        # needed once more where the other side is revised; None when it is known not to be
        self._kept: dict[str, KeptPoses | None] = {
            side: KeptPoses(setup.max_pairs) for side in SIDES
        }
        if setup.truth is not None:
            self._series.add_ground_truth(setup.truth.poses, waits=False)
            self._timeliness.add_ground_truth(setup.truth.poses)
            self._kept[ESTIMATE] = None

    def add_estimate(self, poses: Poses, revisions: Revised | None = None) -> None:
        """
        Add a batch of estimated poses.

        :param revisions: what is known of them later, of a Path or of transforms.
        """
        self.is_empty = False
        self._series.add_estimate(poses)
        self._keep(ESTIMATE, GROUND_TRUTH, poses, revisions)

    def add_ground_truth(self, poses: Poses, revisions: Revised | None = None) -> None:
        """Add a batch of true poses; likewise."""
        self.is_empty = False
        self._series.add_ground_truth(poses)
        self._timeliness.add_ground_truth(poses)
        self._keep(GROUND_TRUTH, ESTIMATE, poses, revisions)

    def _keep(self, side: str, other: str, poses: Poses, revisions: Revised | None) -> None:
        """Keep poses as long as the other side may be revised, and this one is not."""
        if revisions is not None:
            self._revisions[side] = revisions
            self._kept[side] = None
            return
        self._revisions.pop(side, None)
        self._kept[other] = None
        kept = self._kept[side]
        if kept is not None:
            kept.add(poses)

    def note_arrivals(self, arrivals: Arrivals, node_ns: np.ndarray) -> None:
        """
        Note when poses of the estimate arrived.

        :param node_ns: (N,) by the clock of the node.
        """
        self._timeliness.add_estimate(arrivals, node_ns)

    @property
    def names(self) -> tuple[str, str]:
        """What the estimate and the ground truth are called."""
        estimate, truth = self._setup.names
        return estimate, truth if self._setup.truth is None else self._setup.truth.spec

    @property
    def evaluation(self) -> Evaluation:
        """The evaluation that the series is of."""
        return self._series.evaluation

    def state(self) -> RunState:
        """Return what is known so far."""
        associator = self.evaluation.associator
        has_pairs = bool(self.values.get('pairs'))
        alignment = self.evaluation.alignment() if has_pairs else None
        return RunState(
            number=self.number,
            began_as=self.began_as,
            values=self.values,
            timing=self.timing,
            estimate=_side_state(associator.estimate),
            ground_truth=_side_state(associator.ground_truth),
            alignment=alignment,
            estimate_moved_m=alignment.scale * self._estimate_moved() if alignment else 0.0,
            ground_truth_moved_m=self.window.get('path_length_m', math.inf),
            waiting_for=self._series.waiting_for(),
            no_pairs='' if has_pairs else self.evaluation.associator.why_no_pairs(),
            largest_jump=self.largest_jump(),
            turns=self._turns,
            diagnosis=self.monitor.latest,
            diagnosed_pairs=self.monitor.pairs,
            diagnosis_problem=self.monitor.problem,
        )

    def largest_jump(self) -> tuple[int, float] | None:
        """Look at what is new; return stamp [ns] and size [m] of the largest jump, if any."""
        if self.evaluation.count < self._seen:  # other pairs count by now
            self._seen = 0
        pairs = self.evaluation.since(self._seen)
        if len(pairs) > 1:
            self._seen += len(pairs) - 1
            scale = self.evaluation.alignment().scale
            estimate_m, truth_m = (
                step_lengths(side.positions) for side in (pairs.estimate, pairs.ground_truth)
            )
            off = np.abs(scale * estimate_m - truth_m)
            k = int(off.argmax())
            if off[k] > max(MIN_JUMP_M, self._largest_jump[1] if self._largest_jump else 0.0):
                self._largest_jump = (int(pairs.estimate.stamps_ns[k + 1]), float(off[k]))
        return self._largest_jump

    def _estimate_moved(self) -> float:
        """Return how far the estimate moved in the window, in its own metres."""
        return float(step_lengths(self._in_window().estimate.positions).sum())

    def _in_window(self) -> Pairs:
        """Return the pairs of the window."""
        pairs = self.evaluation.since(0)
        if not len(pairs):
            return pairs
        stamps_ns = pairs.estimate.stamps_ns
        return pairs[np.searchsorted(stamps_ns, stamps_ns[-1] - round(self._window_s * 1e9)) :]

    def advance(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield stamp and running values of each second that is over, and remember them."""
        for row in self._series.rows():
            self._rows.append(row)
            self.values = row[1]
            self.began_ns = self.began_ns or row[0]
            yield row

    def look(self, window_s: float) -> None:
        """Bring the window and the diagnosis up to date."""
        self.monitor.look(self.evaluation.since(0))
        if self.values:
            self._window_s = window_s
            self.timing = self._timeliness.recent(window_s) | self._cost()
            self.window = self.evaluation.window(window_s) | self.timing
            self._turns = _turns(self._in_window())

    def _cost(self) -> dict[str, float]:
        return self._setup.processes.metrics() if self._setup.processes else {}

    def result(self) -> Result:
        """Return the result as if both streams had ended now; they may go on."""
        return self._ended()[0]

    def write(self, folder: Path) -> Result:
        """
        Write the report of the run into a folder of its own, and return the result.

        A page that is there is of another report, and removed.

        :raises WriteError: where that is not possible; a report that is there stays whole.
        """
        result, rows = self._ended()
        pairs = result.summary.pairs
        files = {name: REPORTS[kind](result) for kind, name in REPORT_FILES.items()}
        files[SERIES] = series_csv(rows)
        for side, trajectory in zip(SIDES, (pairs.estimate, pairs.ground_truth), strict=True):
            if trajectory.rotations is not None:
                files[TRAJECTORY.format(side)] = tum(trajectory)
        make_writable(folder)
        write_all({folder / name: content for name, content in files.items()})
        (folder / PAGE).unlink(missing_ok=True)
        return result

    def _ended(self) -> tuple[Result, SeriesRows]:
        # the copies share the pairs so far, and may be brought to an end without ending the run
        series, rows = copy.deepcopy(self._series), copy.deepcopy(self._rows)
        for row in series.rest():
            rows.append(row)
        assert series.summary is not None  # the rows have come to their end
        evaluation, summary, problems = series.evaluation, series.summary, []
        if self._revisions:
            try:
                evaluation = self._revised()
                is_path = isinstance(self._revisions.get(ESTIMATE), PathRevisions)
                summary = evaluation.summary(causal=summary.metrics if is_path else None)
            except ReadError as error:
                problems.append(str(error))
            problems += [line for one in self._revisions.values() for line in one.warnings]
            problems += [line for kept in self._kept.values() if kept for line in kept.warnings]
        problems += _turns(summary.pairs)
        summary = replace(summary, warnings=(*self.notes, *summary.warnings, *problems))
        return self._result(evaluation, summary), rows

    def _result(self, evaluation: Evaluation, summary: Summary) -> Result:
        setup, associator = self._setup, evaluation.associator
        offset_s = setup.config.time_offset_s
        estimate = Input.of(setup.names[0], 'topic', associator.estimate, offset_s=offset_s)
        truth = Input.of(setup.names[1], 'topic', associator.ground_truth)
        if setup.truth is not None:
            truth = replace(truth, source=setup.truth.spec, kind=setup.truth.kind)
        arrival = self._timeliness.metrics(summary.alignment) | self._cost()
        return Result(
            estimate=estimate,
            ground_truth=truth,
            config=setup.config,
            summary=summary,
            verdicts=judge(setup.gates, summary.metrics | arrival),
            live=arrival,
        )

    def _revised(self) -> Evaluation:
        """Return the evaluation of both sides as they are known in the end."""
        final, truth = Evaluation(self._setup.config), self._setup.truth
        for poses in [truth.poses] if truth is not None else self._last_word(GROUND_TRUTH):
            final.add_ground_truth(poses)
        for poses in self._last_word(ESTIMATE):
            final.add_estimate(poses)
        final.flush()
        return final

    def _last_word(self, side: str) -> Sequence[Poses]:
        if side in self._revisions:
            return [self._revisions[side].final()]
        kept = self._kept[side]
        return kept.poses if kept else ()


def _turns(pairs: Pairs) -> tuple[str, ...]:
    """Return which sides are several trajectories that take turns, as of several publishers."""
    found = []
    for name, side in (('estimate', pairs.estimate), ('ground truth', pairs.ground_truth)):
        if turns := interleaving(Poses(side.stamps_ns, side.positions, side.rotations)):
            found.append(f'{name}: {turns}')
    return tuple(found)


def _side_state(side: Side) -> SideState:
    return SideState(side.used, side.counts.dropped, side.counts.overflow)


class KeptPoses:
    """
    The poses of a side that is evaluated once more, against the other as it is in the end.

    :param max_pairs: of the evaluation; ten times as many are kept.
    """

    def __init__(self, max_pairs: int | None) -> None:
        self.poses: deque[Poses] = deque()
        self._most = MAX_WAITING_PER_PAIR * max_pairs if max_pairs else math.inf
        self._count = 0
        self._given_up = 0

    def add(self, poses: Poses) -> None:
        """Keep poses, in place of the oldest where there are too many."""
        self.poses.append(poses)
        self._count += len(poses)
        while self._count > self._most:
            oldest = len(self.poses.popleft())
            self._count -= oldest
            self._given_up += oldest

    @property
    def warnings(self) -> Sequence[str]:
        """What is missing of them, in words."""
        if not self._given_up:
            return ()
        return (
            f'the result is without the first {self._given_up} poses of the side that is not '
            'revised: there were more than ten times max_pairs',
        )


class SeriesRows:
    """Rows of a series, kept as bare numbers: as dicts they would outweigh the pairs."""

    def __init__(self) -> None:
        self._stamps_ns = array('q')
        self._values = array('d')
        self._kinds: dict[str, type] = {}

    def append(self, row: tuple[int, dict[str, float]]) -> None:
        """Add a row; all have the same names."""
        stamp_ns, values = row
        self._kinds = self._kinds or {name: type(value) for name, value in values.items()}
        self._stamps_ns.append(stamp_ns)
        self._values.extend(values.values())

    def __iter__(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield stamp and values of each row."""
        width = len(self._kinds)
        for k, stamp_ns in enumerate(self._stamps_ns):
            values = self._values[k * width : (k + 1) * width]
            kinds = zip(self._kinds.items(), values, strict=True)
            yield stamp_ns, {name: kind(value) for (name, kind), value in kinds}


def remove_report(folder: Path) -> None:
    """Remove the files of a report, as far as they are there and can be."""
    for name in (*REPORT_FILES.values(), SERIES, *map(TRAJECTORY.format, SIDES), PAGE):
        with suppress(OSError):
            (folder / name).unlink()
