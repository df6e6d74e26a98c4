"""
A live run: poses as they arrive, evaluated second by second, reported when it ends.

Knows nothing of ROS: the node moves poses in and results out.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from contextlib import suppress
import copy
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation, MOST_WAITING, RunningSeries
from vio_eval_ros.core.gates import Gate, judge
from vio_eval_ros.core.steps import step_lengths
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError, WriteError
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.live.monitor import Diagnosing
from vio_eval_ros.recordings.messages import PathRevisions
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.rendering.files import write_all
from vio_eval_ros.rendering.text import tum
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.tables import series_csv

MIN_JUMP_M = 0.5
REPORT_FILES = {'json': 'result.json', 'markdown': 'result.md', 'csv': 'errors.csv'}
SERIES, ESTIMATE, GROUND_TRUTH = 'series.csv', 'estimate.tum', 'ground_truth.tum'


class LiveRun:
    """
    One run of the estimator under test, from its first pose to its last.

    :param names: what the estimate and the ground truth are called in the result.
    :param truth: the ground truth, where it comes from a file.
    :param max_pairs: how many pairs are kept, see :class:`Evaluation`.
    """

    def __init__(
        self,
        config: EvaluationConfig,
        gates: Sequence[Gate],
        names: tuple[str, str],
        truth: Source | None = None,
        max_pairs: int | None = None,
    ) -> None:
        self.config = config
        #: what the user should know of how the poses came here, for the warnings of the result
        self.notes: list[str] = []
        #: why it is as bad as it is
        self.diagnosing = Diagnosing(config)
        self._series = RunningSeries(config, max_pairs)
        self._rows = Rows()
        self._gates = gates
        self._names = names
        self._truth = truth
        self._seen = 0
        self._jump: tuple[int, float] | None = None
        self._revisions: PathRevisions | None = None
        # needed once more for an estimate that is revised; None when it is known not to be
        self._true_poses: list[Poses] | None = []
        self._most_true = MOST_WAITING * max_pairs if max_pairs else 0
        self._given_up = 0
        if truth is not None:
            self._series.add_ground_truth(truth.poses, waits=False)

    def add_estimate(self, poses: Poses, revisions: PathRevisions | None = None) -> None:
        """
        Add a batch of estimated poses.

        :param revisions: of a Path, of which ``poses`` are those that it had not had before.
        """
        self._series.add_estimate(poses)
        self._revisions = revisions
        if revisions is None:
            self._true_poses = None

    def add_ground_truth(self, poses: Poses) -> None:
        """Add a batch of true poses."""
        self._series.add_ground_truth(poses)
        if self._true_poses is not None:
            self._true_poses.append(poses)
            while self._most_true and sum(map(len, self._true_poses)) > self._most_true:
                self._given_up += len(self._true_poses.pop(0))

    @property
    def evaluation(self) -> Evaluation:
        """The evaluation behind the series."""
        return self._series.evaluation

    def largest_jump(self) -> tuple[int, float] | None:
        """Look at what is new; return stamp [ns] and size [m] of the largest jump, if any."""
        pairs = self.evaluation.since(self._seen)
        if len(pairs) > 1:
            self._seen += len(pairs) - 1
            scale = self.evaluation.alignment().scale
            moved, truly = (
                step_lengths(side.positions) for side in (pairs.estimate, pairs.ground_truth)
            )
            off = np.abs(scale * moved - truly)
            k = int(off.argmax())
            if off[k] > max(MIN_JUMP_M, self._jump[1] if self._jump else 0.0):
                self._jump = (int(pairs.estimate.stamps_ns[k + 1]), float(off[k]))
        return self._jump

    def estimate_path_m(self, seconds: float) -> float:
        """Return how far the estimate moved in the last seconds, in its own metres."""
        estimate = self.evaluation.since(0).estimate
        if not len(estimate):
            return 0.0
        begin = estimate.stamps_ns[-1] - round(seconds * 1e9)
        return float(
            step_lengths(estimate.positions[np.searchsorted(estimate.stamps_ns, begin) :]).sum()
        )

    def waiting_for(self) -> str:
        """Return why there are no values yet, with the spans of what has arrived."""
        return self._series.waiting_for()

    def advance(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield stamp and running values of each second that is over, and remember them."""
        for row in self._series.rows():
            self._rows.append(row)
            yield row

    def result(self) -> Result:
        """Return the result as if both streams had ended now; they may go on."""
        return self._ended()[0]

    def write(self, folder: Path) -> Result:
        """
        Write the report of the run into a folder of its own, and return the result.

        :raises WriteError: where that is not possible; a report that is there stays whole.
        """
        result, rows = self._ended()
        pairs = result.summary.pairs
        files = {name: REPORTS[kind](result) for kind, name in REPORT_FILES.items()}
        files[SERIES] = series_csv(rows)
        for name, trajectory in (
            (ESTIMATE, pairs.estimate),
            (GROUND_TRUTH, pairs.ground_truth),
        ):
            if trajectory.rotations is not None:
                files[name] = tum(trajectory)
        make_writable(folder)
        write_all({folder / name: content for name, content in files.items()})
        return result

    def _ended(self) -> tuple[Result, Rows]:
        # the copies share the pairs so far, and may be brought to an end without ending the run
        series, rows = copy.deepcopy(self._series), copy.deepcopy(self._rows)
        for row in series.rest():
            rows.append(row)
        evaluation, trouble = series.evaluation, ''
        if self._revisions is not None:
            try:
                evaluation = self._revised(evaluation, self._revisions)
            except ReadError as error:
                trouble = str(error)
        summary = series.summary if evaluation is series.evaluation else evaluation.summary()
        assert summary is not None  # the rows have come to their end
        summary.warnings[:0] = self.notes
        if trouble:
            summary.warnings.append(trouble)
        if self._revisions is not None and self._given_up:
            summary.warnings.append(
                f'the revised Path is scored without the first {self._given_up} true poses: there '
                'were more than ten times max_pairs'
            )
        streams = evaluation.associator
        estimate = Input(
            self._names[0], 'topic', None, streams.estimate, self.config.time_offset_s
        )
        truth = Input(self._names[1], 'topic', None, streams.ground_truth)
        if self._truth is not None:
            truth = replace(truth, source=self._truth.spec, kind=self._truth.kind)
        verdicts = judge(self._gates, summary.metrics)
        return Result(estimate, truth, self.config, summary, verdicts), rows

    def _revised(self, causal: Evaluation, revisions: PathRevisions) -> Evaluation:
        """Return the evaluation of the estimate as last revised."""
        final = Evaluation(self.config)
        if self._truth is not None:
            final.add_ground_truth(self._truth.poses)
        for poses in self._true_poses or ():
            final.add_ground_truth(poses)
        final.add_estimate(revisions.final())
        final.flush()
        final.causal = causal
        return final


class Rows:
    """Rows of a series, kept as bare numbers: in dicts they would outweigh the pairs."""

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


def make_writable(folder: Path) -> None:
    """
    Create a folder where there is none, and try to write a file in it.

    :raises WriteError: neither is possible.
    """
    try:
        if folder.exists() and not folder.is_dir():
            raise WriteError(folder, 'it is a file, not a folder')
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise WriteError(folder, error.strerror or str(error)) from None


def remove_report(folder: Path) -> None:
    """Remove the files of a report, as far as they are there and can be."""
    for name in (*REPORT_FILES.values(), SERIES, ESTIMATE, GROUND_TRUTH):
        with suppress(OSError):
            (folder / name).unlink()
