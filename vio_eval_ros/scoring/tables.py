"""What the reports of a suite say of a sequence: its row in the table, and what is wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import compress
import math

from vio_eval_ros.comparison.direction import unit_of
from vio_eval_ros.comparison.repeated import MetricComparison
from vio_eval_ros.core.gates import Verdict
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.rendering.text import number, percent
from vio_eval_ros.scoring.results import SequenceResult, SuiteResult
from vio_eval_ros.scoring.suite import DEFAULT_GATES, RunsGate, SUCCESS_RATE

ATE = 'ate_trans_rmse_m'
MOST_WARNINGS = 10
#: gates on these fail whenever runs do
FAILING = tuple(gate.metric for gate in DEFAULT_GATES)
COLUMNS = (
    'sequence', 'runs', 'ATE [m]', 'spread', 'baseline', 'change', 'p', 'coverage', 'success',
    'band', 'verdict',
)  # fmt: skip


#: columns that are no numbers
TEXTS = ('sequence', 'band', 'verdict')


def filled_table(ordered: Iterable[SequenceResult]) -> tuple[list[str], list[list[str]]]:
    """Return the heads and the rows of the table, without columns that are empty throughout."""
    rows = [row_of(one) for one in ordered]
    filled = [any(column) for column in zip(*rows, strict=True)]
    return list(compress(COLUMNS, filled)), [list(compress(row, filled)) for row in rows]


def row_of(one: SequenceResult) -> list[str]:
    """Return the row of a sequence in the table, in the order of COLUMNS."""
    coverage = one.metrics.get('coverage_ratio')
    warned = any(verdict.word == 'warn' for _, verdict in one.verdicts)
    return [
        one.sequence.title,
        *_errors(one),
        *_against_baseline(one),
        percent(coverage.median) if coverage else '-',
        percent(one.metrics[SUCCESS_RATE].median),
        one.band or '',
        ('warn' if warned else 'pass') if one.passed else 'fail',
    ]


def _errors(one: SequenceResult) -> tuple[str, str, str]:
    """Return the number of runs, their ATE and its spread."""
    runs, ate = len(one.runs), one.metrics.get(ATE)
    if ate is None:
        return f'0 of {runs}', '-', ''
    scored = len(ate.values)
    return (
        str(runs) if scored == runs else f'{scored} of {runs}',
        number(ate.median),
        f'± {number(ate.mad)}' if scored > 1 else '',
    )


def _against_baseline(one: SequenceResult) -> tuple[str, str, str]:
    """Return the ATE of the baseline, the change and its p-value."""
    found = next((each for each in one.comparisons or () if each.rule.metric == ATE), None)
    if found is None:
        return '', '', ''
    p_value = '' if math.isnan(found.p_value) else number(found.p_value)
    return number(found.baseline.median), change(found), p_value


def change(one: MetricComparison) -> str:
    """Return the relative change of a median; nothing where it is unknown."""
    share = one.relative_difference
    return '' if math.isnan(share) else f'{100 * share:+.1f} %'


def worst_first(result: SuiteResult) -> list[SequenceResult]:
    """Return the failed sequences before the passed ones, by falling ATE."""

    def badness(one: SequenceResult) -> tuple[bool, float]:
        ate = one.metrics[ATE].median if ATE in one.metrics else math.nan
        return one.passed, -math.inf if math.isnan(ate) else -ate

    return sorted(result.sequences, key=badness)


def failed_of_all(result: SuiteResult) -> str:
    """Return how many sequences, or sequences of systems, failed."""
    failed = sum(not one.passed for one in result.sequences)
    what = 'sequences x systems' if result.has_systems else 'sequences'
    return f'{failed} of {len(result.sequences)} {what} failed'


def remarks(result: SuiteResult) -> Iterator[tuple[str, bool, str]]:
    """
    Yield what is to be said of sequences: whose it is, whether it is a mere caution, and the text.

    Where systems are compared, the failed runs stand below their table already, and a caution
    that several of them share is said once.
    """
    shared: dict[str, list[str]] = {}
    yield from ((system, False, text) for system, text in _missing(result))
    for one in worst_first(result):
        title = one.sequence.title
        if result.has_systems:
            yield from ((title, False, problem) for problem in judged(one))
            for caution in cautions(one):
                shared.setdefault(caution, []).append(title)
        else:
            yield from ((title, False, problem) for problem in problems(one))
            yield from ((title, True, caution) for caution in cautions(one))
    yield from ((', '.join(titles), True, caution) for caution, titles in shared.items())


def _missing(result: SuiteResult) -> Iterator[tuple[str, str]]:
    """Yield each system without any run of some sequences, and where none was found."""
    found: dict[str, list[SequenceResult]] = {}
    for one in result.sequences:
        if all(run.run.problem for run in one.runs):
            found.setdefault(one.sequence.system, []).append(one)
    for system, holes in found.items():
        named = ', '.join(one.sequence.name for one in holes)
        likewise = ', and so on' if len(holes) > 1 else ''
        yield system, f'no run of {named}: {holes[0].runs[0].error}{likewise}'


def judged(one: SequenceResult) -> Iterator[str]:
    """Yield the problems of a sequence but for those that only repeat that runs have failed."""
    told = set(unsuccessful(one))
    repeated = {f'fail {broken_gate(g, v)}' for g, v in one.verdicts if g.gate.metric in FAILING}
    yield from (text for text in problems(one) if text not in (told | repeated if told else ()))


def problems(one: SequenceResult) -> Iterator[str]:
    """Yield a sentence for each problem of a sequence, the most severe first."""
    yield from (f'fail {broken_gate(g, v)}' for g, v in one.verdicts if v.word == 'fail')
    yield from (f'fail {worse_metric(each)}' for each in one.comparisons or () if each.worse)
    yield from unsuccessful(one)
    failed = {gate.gate.metric for gate, verdict in one.verdicts if verdict.word == 'fail'}
    for gate, verdict in one.verdicts:
        if verdict.word == 'warn' and gate.gate.metric not in failed:
            yield f'warn {broken_gate(gate, verdict)}'


def unsuccessful(one: SequenceResult) -> Iterator[str]:
    """Yield each run that was not a success, and why."""
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
            yield f'{run.run.name}: failed, {" and ".join(broken)}'


def cautions(one: SequenceResult) -> Iterator[str]:
    """Yield each warning once, with the number of runs that have it."""
    told: Counter[str] = Counter()
    for run in one.runs:
        if run.result is not None:
            texts = list(run.result.summary.warnings)
            for path in run.result.estimate.paths:  # else no two runs would have the same
                texts = [text.removeprefix(f'{path}: ') for text in texts]
            told.update(list(dict.fromkeys(texts)))
    for text, runs in told.most_common(MOST_WARNINGS):
        yield f'{text} ({runs} of {len(one.runs)} runs)' if len(one.runs) > 1 else text
    if len(told) > MOST_WARNINGS:
        yield f'and {len(told) - MOST_WARNINGS} more warnings; the JSON report has all of them'


def broken_gate(gate: RunsGate, verdict: Verdict) -> str:
    """Return why a value does not pass a gate."""
    what = verdict.gate.metric + ('' if gate.over == 'median' else f' of the {gate.over} run')
    return f'{what} is {number(verdict.value)}, the gate is {verdict.gate}'


def worse_metric(one: MetricComparison) -> str:
    """Return how much worse a metric is than in the baseline, and how certain that is."""
    metric, was, low, high = one.rule.metric, one.baseline.median, *one.interval
    unit = f' {unit_of(metric)}'.rstrip()
    runs = len(one.candidate.values) + one.missing
    missing = [f'no value in {one.missing} of {runs} runs'] if one.missing else []
    if math.isnan(one.difference):
        return f'{metric} has {missing[0]}, was {number(was)}{unit}'
    facts = list(missing)
    if not math.isnan(one.p_value):
        facts.append(f'p = {one.p_value:.2g}')
    if not math.isnan(one.p_adjusted):
        facts.append(f'{one.p_adjusted:.2g} among all comparisons')
    if not math.isnan(low):
        facts.append(f'95 % interval of the change {number(low)} to {number(high)}{unit}')
    moved = 'rose' if one.difference > 0 else 'fell'
    told = f'{metric} {moved} from {number(was)} to {number(was + one.difference)}{unit}'
    return f'{told} ({", ".join(facts)})' if facts else told
