"""The report of a suite that people look at: one HTML file, interactive and offline."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math

from vio_eval_ros.comparison.repeated import MetricComparison
from vio_eval_ros.comparison.sentences import html_verdicts
from vio_eval_ros.comparison.tables import html_tables
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.figures import AMBER, BLUE, GREY, RED
from vio_eval_ros.rendering.page import (
    badge,
    Html,
    joined,
    page,
    plot,
    table,
    tag,
    tiles,
    warnings,
)
from vio_eval_ros.rendering.text import number, percent
from vio_eval_ros.reports.html import gate_rows, options, run_plots
from vio_eval_ros.reports.overlaid import overlaid
from vio_eval_ros.scoring.plots import marks, strips
from vio_eval_ros.scoring.results import RunResult, SequenceResult, SuiteResult
from vio_eval_ros.scoring.suite import RunsGate
from vio_eval_ros.scoring.tables import (
    ATE,
    cautions,
    change,
    failed_of_all,
    filled_table,
    problems,
    TEXTS,
    worst_first,
)

#: drawn of each line of each run
MOST_POINTS = 1000
NARROW = ('sequence', 'ATE [m]', 'change', 'verdict')


def suite_html(result: SuiteResult) -> str:
    """Return a page: what failed, all sequences worst first, and each of them by itself."""
    ordered = worst_first(result)
    failed = sum(not one.passed for one in ordered)
    scored = (one for one in ordered if any(run.result is not None for run in one.runs))
    worst = next((one for one in scored if not one.passed), None)
    title = failed_of_all(result) if failed else 'All sequences passed'
    word = 'fail' if failed else 'pass'
    return page(
        f'{title}: evaluation',
        tag('header', tag('div', tag('h1', title)), badge(word, word)),
        tiles(_headlines(result)),
        warnings(result.notes),
        html_tables(result.matrix()) if result.has_systems else '',
        html_verdicts(result.matrix()) if result.has_systems else '',
        *_overlaid(result),
        tag('h2', 'Position error (ATE) of every run'),
        tag('p', *_legend(result), class_='soft'),
        plot(
            strips('RMSE [m]', [(one.sequence.title, marks(one, ATE)) for one in ordered]),
            60 + 34 * len(ordered),
            'position error of every run, by sequence',
        ),
        tag('h2', 'Sequences, worst first'),
        _table(ordered),
        tag('h2', 'Each sequence'),
        *(_sequence(k, one, one is worst) for k, one in enumerate(ordered)),
    )


def _overlaid(result: SuiteResult) -> Iterator[Html]:
    """Yield the first runs of all systems in the same plots, folded by sequence."""
    if not result.has_systems:
        return
    yield tag('h2', 'All systems')
    first: dict[str, dict[str, Result]] = {}
    for one in result.sequences:
        scored = (run.result for run in one.runs if run.result is not None)
        able = (of for of in scored if not math.isnan(of.summary.metrics[ATE]))
        for of in able:
            first.setdefault(one.sequence.name, {}).setdefault(one.sequence.system, of)
    order = list(result.matrix().systems)
    for k, (name, results) in enumerate(first.items()):
        told = tag('span', 'the first run of each system', class_='soft')
        yield tag(
            'details',
            tag('summary', name, ' ', told),
            overlaid(results, order),
            open=None if k else 'open',
        )


def _headlines(result: SuiteResult) -> Iterator[tuple[str, str, str]]:
    """Yield the headline figures."""
    sequences = result.sequences
    runs = [(run, one.sequence) for one in sequences for run in one.runs]
    unscored = sum(run.result is None for run, _ in runs)
    succeeded = sum(run.succeeded(sequence) for run, sequence in runs)
    failed = sum(not one.passed for one in sequences)
    what = 'Sequences x systems' if result.has_systems else 'Sequences'
    yield what, str(len(sequences)), f'{failed} failed'
    yield 'Runs', str(len(runs)), f'{unscored} could not be scored' if unscored else 'all scored'
    yield 'Success', percent(succeeded / len(runs)), 'of the runs kept track and did not diverge'
    compared = [each for one in sequences for each in one.comparisons or ()]
    if compared:
        worse = sum(each.worse for each in compared)
        yield 'Baseline', f'{worse} worse', f'of {len(compared)} comparisons'


def _legend(result: SuiteResult) -> Iterator[object]:
    yield _mark('●', BLUE)
    yield 'a run '
    yield _mark('✕', RED)
    yield 'a failed run '
    if any(one.comparisons for one in result.sequences):
        yield _mark('○', GREY)
        yield 'a run of the baseline '
    yield _mark('|', 'inherit')
    yield 'median '
    yield _mark('|', RED)
    yield 'gate '
    if any(
        gate.gate.severity == 'warn' for one in result.sequences for gate in one.sequence.gates
    ):
        yield _mark('|', AMBER)
        yield 'warning'


def _mark(sign: str, colour: str) -> Html:
    return tag('b', sign, style=f'color:{colour};margin:0 .25rem 0 .6rem')


def _table(ordered: Iterable[SequenceResult]) -> Html:
    """Return a row for each sequence, linked to its section below."""

    def row(k: int, cells: list[str]) -> list[object]:
        name, *others, word = cells
        return [tag('a', name, href=f'#sequence-{k}'), *others, badge(word, word)]

    heads, rows = filled_table(ordered)
    return table(
        heads,
        [row(k, cells) for k, cells in enumerate(rows)],
        numbers=[k for k, name in enumerate(heads) if name not in TEXTS],
        minor=[k for k, name in enumerate(heads) if name not in NARROW],
    )


def _sequence(k: int, one: SequenceResult, worst: bool) -> Html:
    """Return the section of a sequence, folded if it passed; the worst one is fully open."""
    warned = any(verdict.word == 'warn' for _, verdict in one.verdicts)
    word = ('warn' if warned else 'pass') if one.passed else 'fail'
    ate = one.metrics.get(ATE)
    return tag(
        'details',
        tag(
            'summary',
            one.sequence.title,
            ' ',
            badge(word, word),
            tag('span', f' ATE {number(ate.median)} m' if ate else ' not scored', class_='soft'),
        ),
        warnings(problems(one), 'warn' if one.passed else 'fail'),
        warnings(cautions(one)),
        *_strips(one),
        _compared(one.comparisons or ()),
        tag('h3', 'Gates'),
        gate_rows((_name(gate), verdict) for gate, verdict in one.verdicts),
        tag('h3', 'Runs'),
        _runs(one),
        *_run_sections(one, worst),
        id=f'sequence-{k}',
        open=None if one.passed else 'open',
    )


def _name(gate: RunsGate) -> str:
    over = '' if gate.over == 'median' else f', {gate.over} run'
    return gate.gate.metric + over + (' (warning)' if gate.gate.severity == 'warn' else '')


def _strips(one: SequenceResult) -> Iterator[Html]:
    """Yield the runs by ATE and by each compared metric, where there is more than one."""
    compared = [each.rule.metric for each in one.comparisons or ()]
    for metric in dict.fromkeys([ATE, *compared]):
        line = marks(one, metric)
        if sum(mark.kind in ('run', 'failed run') for mark in line) > 1:
            yield plot(strips(metric, [('', line)]), 110, f'{metric} of every run')


def _compared(comparisons: Iterable[MetricComparison]) -> Html:
    """Return the comparison of each metric with the baseline; nothing without one."""
    rows = [
        [
            each.rule.metric,
            f'{number(each.baseline.median)} ± {number(each.baseline.mad)}',
            number(each.candidate.median),
            f'± {number(each.candidate.mad)}',
            change(each) or '-',
            number(each.allowed),
            number(each.p_value),
            number(each.p_adjusted),
            badge('fail', 'worse') if each.worse else badge('pass', 'not worse'),
        ]
        for each in comparisons
    ]
    heads = [
        'metric',
        'baseline',
        'now',
        'spread',
        'change',
        'allowed',
        'p',
        'p of all',
        'verdict',
    ]
    found = table(heads, rows, numbers=range(1, 8), minor=(1, 3, 5, 6, 7))
    return joined([tag('h3', 'Compared with the baseline'), found]) if rows else Html()


def _runs(one: SequenceResult) -> Html:
    """Return a row for each run, the one with the largest error first."""

    def badness(run: RunResult) -> float:
        ate = math.nan if run.result is None else run.result.summary.metrics[ATE]
        return -math.inf if math.isnan(ate) else -ate

    def row(run: RunResult) -> list[object]:
        if run.result is None:
            return [run.run.name, '-', '-', '-', badge('fail', 'not scored')]
        metrics = run.result.summary.metrics
        good = run.succeeded(one.sequence)
        return [
            run.run.name,
            number(metrics[ATE]),
            number(metrics['ate_rot_rmse_deg']),
            percent(metrics['coverage_ratio']),
            badge('pass', 'success') if good else badge('fail', 'failed'),
        ]

    return table(
        ['run', 'ATE [m]', 'ATE [deg]', 'coverage', 'tracking'],
        [row(run) for run in sorted(one.runs, key=badness)],
        numbers=(1, 2, 3),
        minor=(2,),
    )


def _run_sections(one: SequenceResult, opened: bool) -> Iterator[Html]:
    """Yield the error in space and time of the median run, and of the worst if one failed."""
    scored = [(run, run.result) for run in one.runs if run.result is not None]
    if not scored:
        return

    def badness(run: RunResult, result: Result) -> tuple[bool, bool, float, str]:
        ate = result.summary.metrics[ATE]
        return not run.succeeded(one.sequence), math.isnan(ate), ate, run.run.name

    by_ate = sorted(scored, key=lambda each: badness(*each)[1:])
    median, worst = by_ate[(len(scored) - 1) // 2], max(scored, key=lambda each: badness(*each))
    yield _run_section(*median, ', the median run' if len(scored) > 1 else '', opened)
    if worst is not median and not (one.passed and worst[0].succeeded(one.sequence)):
        yield _run_section(*worst, ', the worst run', False)


def _run_section(run: RunResult, result: Result, which: str, opened: bool) -> Html:
    """Return the error of a run in space and time, folded."""
    return tag(
        'details',
        tag('summary', f'Where and when: {run.run.name}{which}'),
        warnings(result.summary.warnings),
        tag('section', run_plots(result, MOST_POINTS), class_='run'),
        options(result),
        open='open' if opened else None,
    )
