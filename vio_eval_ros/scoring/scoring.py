"""Scores all runs of a suite in parallel, and judges each sequence over its runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import as_completed, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cached_property, lru_cache
import math
from multiprocessing import get_context
from typing import Any

from vio_eval_ros import __version__
from vio_eval_ros.core.gates import judge, Verdict
from vio_eval_ros.errors import VioEvalError
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.reports.result import Result, without_nan
from vio_eval_ros.scoring.baseline import Baseline, compare, Comparison, Distribution, Recorded
from vio_eval_ros.scoring.run import score_run
from vio_eval_ros.scoring.suite import Run, RunsGate, Sequence, SUCCESS_RATE, Suite

SCHEMA = 'vio_eval_ros.suite/1'
BAND_METRIC = 'ate_se3_trans_rmse_m'


@dataclass(frozen=True, eq=False)
class RunResult:
    """
    What became of one run.

    :param result: None where it could not be scored.
    :param error: why not.
    """

    run: Run
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

    def _success(self, sequence: Sequence) -> list[Verdict]:
        assert self.result is not None
        return judge(sequence.success_gates, self.result.summary.metrics)


@dataclass(frozen=True, eq=False)
class SequenceResult:
    """
    All runs of a sequence.

    :param comparisons: with the baseline; None where there is none, or it lacks the sequence.
    """

    sequence: Sequence
    runs: list[RunResult]
    comparisons: list[Comparison] | None = None

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

    @cached_property
    def verdicts(self) -> list[tuple[RunsGate, Verdict]]:
        """The verdict of each gate over the runs."""
        return [(gate, self._judged(gate)) for gate in self.sequence.gates]

    @property
    def band(self) -> str | None:
        """How the ATE compares with the literature: good, plausible, suspicious or failed."""
        limits, of = self.sequence.band, self.metrics.get(BAND_METRIC)
        if limits is None:
            return None
        value = of.median if of else math.nan
        if value <= limits['good']:
            return 'good'
        if value <= limits['plausible']:
            return 'plausible'
        return 'suspicious' if value <= limits['failed'] else 'failed'

    @property
    def passed(self) -> bool:
        """Whether no gate failed, and nothing is worse than the baseline's."""
        worse = any(comparison.worse for comparison in self.comparisons or ())
        return not worse and all(verdict.word != 'fail' for _, verdict in self.verdicts)

    @property
    def recorded(self) -> Recorded:
        """What a baseline keeps of it."""
        hashes = {run.result.ground_truth.sha256 for run in self.runs if run.result is not None}
        return Recorded(
            self.sequence.config.to_dict(),
            hashes.pop() if len(hashes) == 1 else None,
            {name: found.values for name, found in self.metrics.items()},
        )

    def _judged(self, gate: RunsGate) -> Verdict:
        limit, values = gate.gate, self.metrics.get(gate.gate.metric, Distribution(()))
        if gate.over == 'median':
            value = values.median
        elif limit.metric != SUCCESS_RATE and len(values.values) < len(self.runs):
            value = math.nan  # of a run that has no number nothing is worse
        else:
            value = max(values.values) if limit.comparison == '<=' else min(values.values)
        return Verdict(limit, value, limit.passes(value))

    def to_dict(self) -> dict[str, Any]:
        """Return the sequence as results have it."""
        sequence = self.sequence
        return {
            'name': sequence.name,
            'tags': list(sequence.tags),
            'ground_truth': sequence.ground_truth,
            'options': sequence.config.to_dict(),
            'runs': [run.to_dict(sequence) for run in self.runs],
            'metrics': {name: found.to_dict() for name, found in self.metrics.items()},
            'gates': [{**verdict.to_dict(), 'of': gate.over} for gate, verdict in self.verdicts],
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
            else [comparison.to_dict() for comparison in self.comparisons],
            'verdict': 'pass' if self.passed else 'fail',
        }


@dataclass(frozen=True, eq=False)
class SuiteResult:
    """
    All sequences of a suite.

    :param notes: what was found beside the sequences, such as one that a baseline has more.
    """

    sequences: list[SequenceResult]
    notes: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether all sequences passed."""
        return all(one.passed for one in self.sequences)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as schema ``vio_eval_ros.suite/1`` has it: no NaN, but None."""
        result = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'sequences': [one.to_dict() for one in self.sequences],
            'notes': list(self.notes),
            'verdict': 'pass' if self.passed else 'fail',
        }
        return {name: without_nan(value) for name, value in result.items()}


def compared(result: SuiteResult, baseline: Baseline, accepted: Iterable[str] = ()) -> SuiteResult:
    """
    Return the result with the comparison of each sequence.

    :param accepted: differences in conditions to compare in spite of, see ``Baseline.check``.
    :raises ConfigError: where the baseline was made under other conditions.
    """
    current = {one.sequence.name: one.recorded for one in result.sequences}
    notes = [f'compared in spite of: {text}' for text in baseline.check(current, accepted)]
    sequences = []
    for one in result.sequences:
        before = baseline.sequences.get(one.sequence.name)
        if before is None:
            notes.append(f'{one.sequence.name}: not in the baseline')
            sequences.append(one)
            continue
        comparisons = [
            compare(
                rule,
                before.metrics.get(rule.metric, ()),
                one.recorded.metrics.get(rule.metric, ()),
            )
            for rule in one.sequence.rules
        ]
        sequences.append(SequenceResult(one.sequence, one.runs, comparisons))
    notes += [
        f'{name}: in the baseline, not scored'
        for name in baseline.sequences
        if name not in current
    ]
    return SuiteResult(sequences, (*result.notes, *notes))


def score_suite(
    suite: Suite, jobs: int, progress: Any = lambda items, total: items
) -> SuiteResult:
    """
    Score all runs in parallel.

    A run that cannot be scored, even one that takes the process down in which it is read, is a
    result like any other and stops nothing.

    :param jobs: how many processes.
    :param progress: wraps the iterable of finished runs given their number, as ``tqdm`` would.
    """
    work = [(sequence, run) for sequence in suite.sequences for run in sequence.runs]
    found: dict[int, RunResult] = {}
    for k, result in progress(_scored(work, jobs), len(work)):
        found[k] = result
    results, k = [], 0
    for sequence in suite.sequences:
        runs = [found[k + n] for n in range(len(sequence.runs))]
        results.append(SequenceResult(sequence, runs))
        k += len(runs)
    return SuiteResult(results)


def _scored(work: list[tuple[Sequence, Run]], jobs: int) -> Iterator[tuple[int, RunResult]]:
    """Yield the number and result of each run, as they are finished."""
    suspects = []
    for k, outcome in _in_processes(dict(enumerate(work)), jobs):
        if outcome is None:
            suspects.append(k)
        else:
            yield k, outcome
    # a process died, and took the runs of others with it: each of them gets one of its own
    for k in suspects:
        for _, outcome in _in_processes({k: work[k]}, 1):
            run = work[k][1]
            yield k, outcome or RunResult(run, None, 'the process that scored it died')


def _in_processes(
    work: Mapping[int, tuple[Sequence, Run]], jobs: int
) -> Iterator[tuple[int, RunResult | None]]:
    """Yield the result of each run; None where the process that had it died."""
    with ProcessPoolExecutor(min(jobs, len(work)), get_context('fork')) as pool:
        futures: dict[Future[RunResult], int] = {}
        try:
            futures |= {pool.submit(_score, *one): k for k, one in work.items()}
            for future in as_completed(futures):
                try:
                    yield futures[future], future.result()
                except BrokenProcessPool:
                    yield futures[future], None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _score(sequence: Sequence, run: Run) -> RunResult:
    """Return the result of a run; in a process of its own."""
    try:
        estimate, *causal = read_sources(
            [spec for spec in (run.estimate, run.causal) if spec is not None], run.recording
        )
        if causal:
            estimate = estimate.revising(causal[0])
        truth = _truth(sequence.ground_truth, run.recording)
        return RunResult(run, score_run(estimate, truth, sequence.config))
    except (VioEvalError, OSError) as error:
        return RunResult(run, None, ' '.join(str(error).split()))
    except Exception as error:
        return RunResult(run, None, f'{type(error).__name__}: {" ".join(str(error).split())}')


@lru_cache(maxsize=2)
def _truth(spec: str, recording: Any) -> Source:
    """Return the ground truth, which runs of a sequence share."""
    return read_sources([spec], recording)[0]
