"""Scores all runs of a suite in parallel, and compares them with a baseline."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
import math
from typing import Any

from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.scoring.baseline import Baseline, BaselineSequence
from vio_eval_ros.scoring.results import (
    judged_together,
    RunResult,
    SequenceResult,
    SuiteResult,
)
from vio_eval_ros.scoring.run import score_specs
from vio_eval_ros.scoring.suite import RunSpec, Sequence, Suite
from vio_eval_ros.scoring.workers import Died, in_processes


def score_suite(
    suite: Suite, jobs: int, progress: Any = lambda items, total: items
) -> SuiteResult:
    """
    Score all runs in parallel.

    A run that cannot be scored, even one that kills the process that reads it, does not affect
    the others. Processes are started as :mod:`multiprocessing` does it for ``forkserver``: a
    script that calls this needs ``if __name__ == '__main__':``.

    :param jobs: the number of processes.
    :param progress: wraps the iterable of finished runs, given their number, as ``tqdm`` would.
    """
    work = [(one, run) for one in suite.sequences for run in one.runs if not run.problem]
    with closing(in_processes(score_specs, [_call(*each) for each in work], jobs)) as scored:
        found = dict(progress(scored, len(work)))
    results = iter([found[k] for k in range(len(work))])
    return SuiteResult(
        [
            SequenceResult(
                one, [_run_result(run, run.problem or next(results)) for run in one.runs]
            )
            for one in suite.sequences
        ],
        tuple(
            f'{one.title}: {one.bands} has no limits for {one.modality}; not assigned to a band'
            for one in suite.sequences
            if one.bands and one.modality and one.band is None
        ),
    )


def _call(sequence: Sequence, run: RunSpec) -> tuple[Any, ...]:
    """Return the arguments by which another process scores a run."""
    estimates = [run.estimate] if run.causal is None else [run.estimate, run.causal]
    return estimates, sequence.ground_truth, run.recording, sequence.times, sequence.config


def _run_result(run: RunSpec, found: Result | str | Died) -> RunResult:
    if isinstance(found, Result):
        return RunResult(run, found)
    if isinstance(found, Died):
        return RunResult(run, None, f'the process that scored it died: {found.how}')
    return RunResult(run, None, found)


def compare_suite(
    result: SuiteResult, baseline: Baseline, accepted: Iterable[str] = ()
) -> SuiteResult:
    """
    Return the result with each sequence compared with the baseline.

    :param accepted: conditions that may differ, see ``Baseline.check``.
    :raises ConfigError: the baseline was recorded under other conditions.
    """
    current = {one.sequence.title: one.recorded for one in result.sequences}
    notes = [f'accepted difference: {text}' for text in baseline.check(current, accepted)]
    sequences = judged_together([_compared(one, baseline.sequences) for one in result.sequences])
    for one in sequences:
        notes += [f'{one.sequence.title}: {note}' for note in _unanswered(one)]
    notes += [
        f'{name}: in the baseline, but not scored'
        for name in baseline.sequences
        if name not in current
    ]
    return replace(result, sequences=sequences, notes=(*result.notes, *notes))


def _compared(one: SequenceResult, baseline: Mapping[str, BaselineSequence]) -> SequenceResult:
    if one.sequence.title not in baseline:
        return one
    before = baseline[one.sequence.title].metrics
    comparisons = [one.compared(rule, before.get(rule.metric, ())) for rule in one.sequence.rules]
    return SequenceResult(one.sequence, one.runs, comparisons)


def _unanswered(one: SequenceResult) -> Iterator[str]:
    """Yield what could not be compared with the baseline."""
    if one.comparisons is None:
        yield 'not in the baseline'
    for each in one.comparisons or ():
        metric, before = each.rule.metric, len(each.baseline.values)
        runs = f'{before} and {len(one.runs)} runs'
        if not before:
            yield f'no {metric} in the baseline'
        elif math.isnan(each.p_value) and not math.isnan(each.difference):
            yield (
                f'{runs} are too few for a test of significance; '
                f'{metric} is compared by its limits alone'
            )
        elif each.least_p_value > each.rule.p:
            yield (
                f'{runs} cannot show that {metric} is worse with p <= {each.rule.p:g}; '
                f'the smallest possible p is {each.least_p_value:.2g}'
            )
        elif each.may_be_chance:
            yield (
                f'{metric} is worse by itself (p = {each.p_value:.2g}), but among so many '
                f'comparisons chance would do as much (adjusted p = {each.p_adjusted:.2g}): more '
                'runs of each side tell'
            )
        elif each.contradicted:
            yield (
                f'the median of {metric} is worse than allowed, but its trimmed mean, which is '
                'tested, is not: look at single runs'
            )
