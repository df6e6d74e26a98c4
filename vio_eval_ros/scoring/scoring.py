"""Scores all runs of a suite in parallel, and judges each sequence over its runs."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
import math
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
import signal
from typing import Any
import warnings

from vio_eval_ros.core.gates import judge, Verdict
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.errors import ReadError, VioEvalError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.scoring.baseline import (
    Baseline,
    compare,
    Comparison,
    Distribution,
    Recorded,
    Rule,
)
from vio_eval_ros.scoring.suite import Run, RunsGate, Sequence, SUCCESS_RATE, Suite
from vio_eval_ros.version import __version__

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

    def compared(self, rule: Rule, baseline: Iterable[float]) -> Comparison:
        """Return a metric beside what the runs of a baseline had."""
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
        """Whether no gate failed, and nothing is worse than the baseline's."""
        worse = any(comparison.worse for comparison in self.comparisons or ())
        return not worse and all(verdict.word != 'fail' for _, verdict in self.verdicts)

    @property
    def verdict(self) -> str:
        """Pass or fail, as results have it."""
        return 'pass' if self.passed else 'fail'

    @property
    def recorded(self) -> Recorded:
        """What a baseline keeps of it."""
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
        """Return a metric of all runs; than one that has no number, nothing is worse."""
        found = self.metrics.get(metric, Distribution(())).values
        runs = 1 if metric == SUCCESS_RATE else len(self.runs)
        return Distribution((*found, *[worst] * (runs - len(found))))

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

    @property
    def verdict(self) -> str:
        """Pass or fail, as results have it."""
        return 'pass' if self.passed else 'fail'

    def to_dict(self) -> dict[str, Any]:
        """Return the result as schema ``vio_eval_ros.suite/1`` has it: no NaN, but None."""
        result = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'sequences': [one.to_dict() for one in self.sequences],
            'notes': list(self.notes),
            'verdict': self.verdict,
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
    sequences = [_compared(one, baseline.sequences) for one in result.sequences]
    for one in sequences:
        notes += [f'{one.sequence.name}: {note}' for note in _unanswered(one)]
    notes += [
        f'{name}: in the baseline, not scored'
        for name in baseline.sequences
        if name not in current
    ]
    return SuiteResult(sequences, (*result.notes, *notes))


def _compared(one: SequenceResult, baseline: Mapping[str, Recorded]) -> SequenceResult:
    if one.sequence.name not in baseline:
        return one
    before = baseline[one.sequence.name].metrics
    comparisons = [one.compared(rule, before.get(rule.metric, ())) for rule in one.sequence.rules]
    return SequenceResult(one.sequence, one.runs, comparisons)


def _unanswered(one: SequenceResult) -> Iterator[str]:
    """Yield what the baseline could not tell of a sequence."""
    if one.comparisons is None:
        yield 'not in the baseline'
    for each in one.comparisons or ():
        metric, before = each.rule.metric, len(each.baseline.values)
        runs = f'{before} and {len(one.runs)} runs'
        if not before:
            yield f'no {metric} in the baseline'
        elif math.isnan(each.p_value) and not math.isnan(each.difference):
            yield (
                f'{runs} are too few to tell chance from change; '
                f'{metric} is compared by its limits alone'
            )
        elif each.least_p_value > each.rule.p:
            yield (
                f'{runs} cannot show {metric} to be worse with p: {each.rule.p:g}; '
                f'the least that they can have is {each.least_p_value:.2g}'
            )
        elif each.contradicted:
            yield (
                f'the median of {metric} is worse by more than is allowed, but its mean without '
                'the outermost fifth, which is tested, is not: look at single runs'
            )


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
    with closing(_in_processes(work, jobs)) as scored:
        found = dict(progress(scored, len(work)))
    ordered = iter([found[k] for k in range(len(work))])
    return SuiteResult(
        [
            SequenceResult(sequence, [next(ordered) for _ in sequence.runs])
            for sequence in suite.sequences
        ],
        tuple(
            f'{one.name}: {one.bands} has no limits for {one.modality}; no band is given'
            for one in suite.sequences
            if one.bands and one.modality and one.band is None
        ),
    )


def _in_processes(
    work: list[tuple[Sequence, Run]], jobs: int
) -> Generator[tuple[int, RunResult], None, None]:
    """Yield number and result of each run, as they are finished."""
    waiting = iter(range(len(work)))
    workers: list[_Worker] = []
    try:
        while True:
            while len(workers) < jobs and (k := next(waiting, None)) is not None:
                workers.append(_Worker(work))
                workers[-1].begin(k)
            if not workers:
                return
            ready = wait([worker.pipe for worker in workers])
            for worker in [worker for worker in workers if worker.pipe in ready]:
                yield worker.k, worker.result()
                if worker.process.is_alive() and (k := next(waiting, None)) is not None:
                    worker.begin(k)
                else:
                    worker.pipe.close()
                    workers.remove(worker)
    finally:
        for worker in workers:
            worker.process.kill()
            worker.process.join()


class _Worker:
    """A process that scores one run after the other; if it dies, that run is the only loss."""

    def __init__(self, work: list[tuple[Sequence, Run]]) -> None:
        context = get_context('fork')
        self.work = work
        self.pipe, end = context.Pipe()
        self.process = context.Process(target=_serve, args=(work, end, self.pipe))
        with warnings.catch_warnings():  # of threads: numpy's, which outlive a fork
            warnings.simplefilter('ignore', DeprecationWarning)
            self.process.start()
        end.close()
        self.k = -1

    def begin(self, k: int) -> None:
        """Have a run scored."""
        self.k = k
        with suppress(BrokenPipeError):  # whether it lives, its answer tells
            self.pipe.send(k)

    def result(self) -> RunResult:
        """Return the result of that run, when there is something in the pipe."""
        try:
            result: RunResult = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode or 0
            how = signal.strsignal(-code) if code < 0 else f'exit status {code}'
            problem = f'the process that scored it died: {how}'
            return RunResult(self.work[self.k][1], None, problem)
        return result


def _serve(work: list[tuple[Sequence, Run]], pipe: Connection, other_end: Connection) -> None:
    """Score the runs whose numbers come through a pipe, until its other end is closed."""
    other_end.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    with suppress(EOFError):
        while True:
            pipe.send(_score(*work[pipe.recv()]))


def _score(sequence: Sequence, run: Run) -> RunResult:
    """Return the result of a run, or why there is none."""
    estimates = [run.estimate] if run.causal is None else [run.estimate, run.causal]
    truth, times = sequence.ground_truth, sequence.times
    try:
        if sequence.truth_is_recorded:
            *read, true = read_sources([*estimates, truth], run.recording, times)
        else:
            read, true = read_sources(estimates, run.recording, times), _truth(truth, times)
        if times is not None and not any(one.kind == 'kitti' for one in (*read, true)):
            raise ReadError(times, 'times go with KITTI pose files, and there are none')
        estimate = read[0] if run.causal is None else read[0].revising(read[1])
        return RunResult(run, score_run(estimate, true, sequence.config))
    except (VioEvalError, OSError) as error:
        problem = str(error)
    except Exception as error:
        problem = f'{type(error).__name__}: {error}'
    return RunResult(run, None, ' '.join(problem.split()))


@lru_cache(maxsize=2)
def _truth(spec: str, times: Path | None) -> Source:
    """Return the ground truth, which runs of a sequence share."""
    return read_sources([spec], None, times)[0]
