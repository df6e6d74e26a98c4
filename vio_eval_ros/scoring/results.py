"""What became of the runs of a suite, and the verdict on each sequence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any

from vio_eval_ros.comparison.doubts import doubts
from vio_eval_ros.comparison.family import adjusted
from vio_eval_ros.comparison.matrix import Cell, CellRun, default_metrics, Matrix
from vio_eval_ros.comparison.repeated import compare, Distribution, MetricComparison, Rule
from vio_eval_ros.comparison.verdicts import differences, suite_verdict, SuiteVerdict
from vio_eval_ros.core.gates import judge, Verdict
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.scoring.baseline import BaselineSequence
from vio_eval_ros.scoring.suite import RunsGate, RunSpec, Sequence, SUCCESS_RATE
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.suite/1'
#: options that make systems comparable where they differ
FRAMES = ('estimate_to_body', 'time_offset_s')
BAND_METRIC = 'ate_se3_trans_rmse_m'


@dataclass(frozen=True, eq=False)
class RunResult:
    """
    What became of one run.

    :param result: None where the run could not be scored.
    :param error: why it could not.
    """

    run: RunSpec
    result: Result | None
    error: str = ''

    def succeeded(self, sequence: Sequence) -> bool:
        """Return whether it was scored, did not diverge and covers enough."""
        return self.result is not None and all(
            verdict.passed for verdict in self._success(sequence)
        )

    def to_dict(self, sequence: Sequence) -> dict[str, Any]:
        """Return the result, or the error, with the name of the estimate."""
        if self.result is None:
            return {'estimate': self.run.name, 'error': self.error}
        return {
            'estimate': self.run.name,
            **self.result.to_dict(),
            'success': self.succeeded(sequence),
            'success_gates': [verdict.to_dict() for verdict in self._success(sequence)],
        }

    def compared(self, sequence: Sequence) -> CellRun:
        """Return the run as a comparison of systems takes it."""
        if self.result is None:
            return CellRun(self.run.name, None, self.error, missing=bool(self.run.problem))
        return CellRun.of(self.run.name, self.result, sequence.success_gates)

    def _success(self, sequence: Sequence) -> list[Verdict]:
        assert self.result is not None
        return judge(sequence.success_gates, self.result.summary.metrics)


@dataclass(frozen=True, eq=False)
class SequenceResult:
    """
    All runs of a sequence.

    :param comparisons: with the baseline; None without one, or where it lacks the sequence.
    """

    sequence: Sequence
    runs: list[RunResult]
    comparisons: list[MetricComparison] | None = None

    @cached_property
    def metrics(self) -> dict[str, Distribution]:
        """Each metric over the runs that have it."""
        scored = [run.result.summary.metrics for run in self.runs if run.result is not None]
        names = list(scored[0]) if scored else []
        found = {
            name: Distribution(
                tuple(float(one[name]) for one in scored if math.isfinite(one[name]))
            )
            for name in names
        }
        successes = sum(run.succeeded(self.sequence) for run in self.runs)
        return found | {SUCCESS_RATE: Distribution((successes / len(self.runs),))}

    def compared(self, rule: Rule, baseline: Iterable[float]) -> MetricComparison:
        """Return the comparison of a metric with its values in the runs of a baseline."""
        found = self.metrics.get(rule.metric, Distribution(())).values
        return compare(rule, tuple(baseline), found, len(self.runs) - len(found))

    @cached_property
    def verdicts(self) -> list[tuple[RunsGate, Verdict]]:
        """The verdict of each gate over the runs."""
        return [(gate, self._judged(gate)) for gate in self.sequence.gates]

    @property
    def band(self) -> str | None:
        """How the ATE compares with the literature: good, plausible, suspicious or failed."""
        limits = self.sequence.band
        if limits is None:
            return None
        value = self._of_all(BAND_METRIC, math.inf).median
        if value <= limits['good']:
            return 'good'
        if value <= limits['plausible']:
            return 'plausible'
        return 'suspicious' if value <= limits['failed'] else 'failed'

    @property
    def passed(self) -> bool:
        """Whether no gate failed and no metric is worse than in the baseline."""
        worse = any(comparison.worse for comparison in self.comparisons or ())
        return not worse and all(verdict.word != 'fail' for _, verdict in self.verdicts)

    @property
    def verdict(self) -> str:
        """Pass or fail, as results have it."""
        return 'pass' if self.passed else 'fail'

    @property
    def recorded(self) -> BaselineSequence:
        """What a baseline keeps of the sequence."""
        scored = next((run.result for run in self.runs if run.result is not None), None)
        if scored is None:
            return self.sequence.conditions
        truth = None if self.sequence.truth_is_recorded else scored.ground_truth.sha256
        values = {name: found.values for name, found in self.metrics.items()}
        return replace(self.sequence.conditions, ground_truth_sha256=truth, metrics=values)

    def _judged(self, gate: RunsGate) -> Verdict:
        limit, is_ceiling = gate.gate, gate.gate.comparison == '<='
        found = self._of_all(limit.metric, math.inf if is_ceiling else -math.inf)
        worst = max if is_ceiling else min
        value = found.median if gate.over == 'median' else worst(found.values)
        return Verdict(limit, value if math.isfinite(value) else math.nan, limit.passes(value))

    def _of_all(self, metric: str, worst: float) -> Distribution:
        """Return a metric of all runs; a run without a value counts as the worst."""
        found = self.metrics.get(metric, Distribution(())).values
        runs = 1 if metric == SUCCESS_RATE else len(self.runs)
        return Distribution((*found, *[worst] * (runs - len(found))))

    def to_dict(self) -> dict[str, Any]:
        """Return the sequence as results have it."""
        sequence = self.sequence
        return {
            'name': sequence.name,
            'system': sequence.system or None,
            'tags': list(sequence.tags),
            'ground_truth': sequence.ground_truth,
            'options': sequence.config.to_dict(),
            'runs': [run.to_dict(sequence) for run in self.runs],
            'metrics': {name: found.to_dict() for name, found in self.metrics.items()},
            'gates': self.gates_to_dicts(),
            'band': None
            if sequence.band is None
            else {
                'metric': BAND_METRIC,
                'modality': sequence.modality,
                **sequence.band,
                'verdict': self.band,
            },
            'baseline': None
            if self.comparisons is None
            else {each.rule.metric: each.to_dict() for each in self.comparisons},
            'verdict': self.verdict,
        }

    def gates_to_dicts(self) -> list[dict[str, Any]]:
        """Return the gates over the runs as results have them."""
        return [{**verdict.to_dict(), 'of': gate.over} for gate, verdict in self.verdicts]


def judged_together(sequences: Iterable[SequenceResult]) -> list[SequenceResult]:
    """Return sequences whose comparisons with a baseline are adjusted for all of them."""
    sequences = list(sequences)
    compared = adjusted([one.comparisons or () for one in sequences])
    return [
        SequenceResult(one.sequence, one.runs, None if one.comparisons is None else found)
        for one, found in zip(sequences, compared, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class SuiteResult:
    """
    All sequences of a suite.

    :param notes: what concerns no single run, such as a sequence that only the baseline has.
    :param metrics: by which systems are compared; empty for the usual ones.
    """

    sequences: list[SequenceResult]
    notes: tuple[str, ...] = ()
    metrics: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether all sequences passed."""
        return all(one.passed for one in self.sequences)

    @property
    def verdict(self) -> str:
        """Pass or fail, as results have it."""
        return 'pass' if self.passed else 'fail'

    @property
    def has_systems(self) -> bool:
        """Whether systems are compared."""
        return any(one.sequence.system for one in self.sequences)

    @property
    def difference_verdict(self) -> SuiteVerdict | None:
        """Whether any system is told from another; None without several, or of one sequence."""
        return suite_verdict(self.matrix()) if self.has_systems else None

    def matrix(self) -> Matrix:
        """Return the sequences x systems; the only system of a suite without any has no name."""
        return self._matrix

    @cached_property
    def _matrix(self) -> Matrix:
        chosen = (self.metrics or default_metrics(one.sequence.config) for one in self.sequences)
        cells = {
            (one.sequence.name, one.sequence.system): Cell(
                tuple(run.compared(one.sequence) for run in one.runs)
            )
            for one in self.sequences
        }
        sequences, systems = (tuple(dict.fromkeys(names)) for names in zip(*cells, strict=True))
        return Matrix(
            sequences,
            systems,
            tuple(dict.fromkeys(metric for names in chosen for metric in names)),
            cells,
            tuple(self._unequal_options()),
        )

    def _unequal_options(self) -> Iterator[str]:
        """Yield each option in which systems differ on a sequence, but for their frames."""
        compared = self.sequences[0].sequence.config.to_dict().keys() - set(FRAMES)
        found: dict[str, list[str]] = {}
        for sequence in dict.fromkeys(one.sequence.name for one in self.sequences):
            options = {
                one.sequence.system: one.sequence.config.to_dict()
                for one in self.sequences
                if one.sequence.name == sequence
            }
            for option in sorted(compared):
                users: dict[str, list[str]] = {}
                for system, values in options.items():
                    users.setdefault(str(values[option]), []).append(system)
                if len(users) > 1:
                    *few, (usual, _) = sorted(users.items(), key=lambda each: len(each[1]))
                    told = ', '.join(f'{value} of {", ".join(names)}' for value, names in few)
                    text = f'not with equal options: {option} is {told}, {usual} of the others'
                    found.setdefault(text, []).append(sequence)
        everywhere = len({one.sequence.name for one in self.sequences})
        for text, sequences in found.items():
            yield text if len(sequences) == everywhere else f'{", ".join(sequences)}: {text}'

    def to_dict(self) -> dict[str, Any]:
        """Return the result as schema ``vio_eval_ros.suite/1`` has it: no NaN, but None."""
        result = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'sequences': [one.to_dict() for one in self.sequences],
            'matrix': self.matrix().to_dict() if self.has_systems else None,
            'differences': [one.to_dict() for one in differences(self.matrix())]
            if self.has_systems
            else None,
            'difference_verdict': None
            if (verdict := self.difference_verdict) is None
            else verdict.to_dict(),
            'doubts': {name: one.to_dict() for name, one in doubts(self.matrix()).items()}
            if self.has_systems
            else None,
            'notes': list(self.notes),
            'verdict': self.verdict,
        }
        return {name: without_nan(value) for name, value in result.items()}
