"""What the reports of a suite say of a sequence: its row in the table, and all that is wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import math

from vio_eval_ros.core.gates import Verdict
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.rendering.text import number, percent
from vio_eval_ros.scoring.comparison import MetricComparison
from vio_eval_ros.scoring.results import SequenceResult, SuiteResult
from vio_eval_ros.scoring.suite import RunsGate, SUCCESS_RATE

ATE = 'ate_trans_rmse_m'
MOST_TOLD = 10
COLUMNS = (
    'sequence', 'runs', 'ATE [m]', 'spread', 'baseline', 'change', 'p', 'coverage', 'success',
    'band', 'verdict',
)  # fmt: skip


def row_of(one: SequenceResult) -> list[str]:
    """Return what the table has of a sequence, in the order of COLUMNS."""
    ate = one.metrics.get(ATE)
    compared = {each.rule.metric: each for each in one.comparisons or ()}.get(ATE)
    words = {verdict.word for _, verdict in one.verdicts}
    coverage = one.metrics.get('coverage_ratio')
    runs, scored = len(one.runs), len(ate.values) if ate else 0
    return [
        one.sequence.name,
        str(runs) if scored == runs else f'{scored} of {runs}',
        number(ate.median) if ate else '-',
        f'± {number(ate.mad)}' if ate and len(ate.values) > 1 else '',
        number(compared.baseline.median) if compared else '',
        f'{100 * compared.difference / compared.baseline.median:+.1f} %'
        if compared and compared.baseline.median and not math.isnan(compared.difference)
        else '',
        number(compared.p_value) if compared and not math.isnan(compared.p_value) else '',
        percent(coverage.median) if coverage else '-',
        percent(one.metrics[SUCCESS_RATE].median),
        one.band or '',
        ('warn' if 'warn' in words else 'pass') if one.passed else 'FAIL',
    ]


def worst_first(result: SuiteResult) -> list[SequenceResult]:
    """Return the failed before the passed, and of each the largest ATE first."""

    def badness(one: SequenceResult) -> tuple[bool, float]:
        ate = one.metrics[ATE].median if ATE in one.metrics else math.nan
        return one.passed, -math.inf if math.isnan(ate) else -ate

    return sorted(result.sequences, key=badness)


def problems(one: SequenceResult) -> Iterator[str]:
    """Yield a sentence for all that is wrong with a sequence, the grave things first."""
    yield from (f'FAIL {broken_gate(g, v)}' for g, v in one.verdicts if v.word == 'fail')
    yield from (f'FAIL {worse_metric(each)}' for each in one.comparisons or () if each.worse)
    yield from unsuccessful(one)
    failed = {gate.gate.metric for gate, verdict in one.verdicts if verdict.word == 'fail'}
    for gate, verdict in one.verdicts:
        if verdict.word == 'warn' and gate.gate.metric not in failed:
            yield f'warn {broken_gate(gate, verdict)}'


def unsuccessful(one: SequenceResult) -> Iterator[str]:
    """Yield each run that was no success, and why."""
    for run in one.runs:
        if run.result is None:
            path = Spec.parse(run.run.estimate).path
            yield f'{run.run.name}: {run.error.removeprefix(f"{path}: ")}'
        elif not run.succeeded(one.sequence):
            metrics = run.result.summary.metrics
            broken = [
                f'{gate.metric} is {number(metrics[gate.metric])}'
                for gate in one.sequence.success_gates
                if not gate.passes(metrics[gate.metric])
            ]
            yield f'{run.run.name}: no success, {" and ".join(broken)}'


def cautions(one: SequenceResult) -> Iterator[str]:
    """Yield what the runs warn of, each once, with in how many of them."""
    told: Counter[str] = Counter()
    for run in one.runs:
        if run.result is not None:
            texts = list(run.result.summary.warnings)
            for path in run.result.estimate.paths:  # which would tell the runs apart
                texts = [text.removeprefix(f'{path}: ') for text in texts]
            told.update(list(dict.fromkeys(texts)))
    for text, runs in told.most_common(MOST_TOLD):
        yield f'{text} ({runs} of {len(one.runs)} runs)' if len(one.runs) > 1 else text
    if len(told) > MOST_TOLD:
        yield f'and {len(told) - MOST_TOLD} more warnings of single runs; json has them all'


def broken_gate(gate: RunsGate, verdict: Verdict) -> str:
    """Return what a gate says of a value that it does not let pass."""
    what = verdict.gate.metric + ('' if gate.over == 'median' else f' of the {gate.over} run')
    return f'{what} is {number(verdict.value)}, the gate is {verdict.gate}'


def worse_metric(one: MetricComparison) -> str:
    """Return how much worse a metric is than in the baseline, and how sure that is."""
    metric, low, high = one.rule.metric, *one.interval
    was, now = number(one.baseline.median), number(one.candidate.median)
    runs = len(one.candidate.values) + one.missing
    missing = f' (no number in {one.missing} of {runs} runs)' if one.missing else ''
    chance = '' if math.isnan(one.p_value) else f', by chance with p = {number(one.p_value)}'
    between = '' if math.isnan(low) else f', difference {number(low)} to {number(high)} (95 %)'
    return f'{metric} was {was} and is {now}{missing}{chance}{between}'
