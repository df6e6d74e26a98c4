"""Reports of a suite: JSON for scripts, JUnit for build servers, tables for people."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math

from vio_eval_ros.comparison.latex_tables import latex_tables, tabular
from vio_eval_ros.comparison.sentences import markdown_verdicts, text_verdicts
from vio_eval_ros.comparison.tables import (
    csv_table,
    markdown_tables,
    Row,
    Shown,
    spreadsheet_text,
    Table,
    text_tables,
)
from vio_eval_ros.core.gates import Verdict
from vio_eval_ros.rendering.text import escaped, number, printable
from vio_eval_ros.reports.documents import junit
from vio_eval_ros.scoring.html import suite_html
from vio_eval_ros.scoring.results import SequenceResult, SuiteResult
from vio_eval_ros.scoring.suite import RunsGate, SUCCESS_RATE
from vio_eval_ros.scoring.tables import (
    ATE,
    broken_gate,
    cautions,
    failed_of_all,
    filled_table,
    remarks,
    TEXTS,
    unsuccessful,
    worse_metric,
    worst_first,
)

LATEX = {
    'ATE [m]': ATE,
    'ATE [deg]': 'ate_rot_rmse_deg',
    'RPE 1 s [m]': 'rpe_1s_trans_rmse_m',
    'RPE 1 s [deg]': 'rpe_1s_rot_rmse_deg',
    'coverage': 'coverage_ratio',
}


def suite_json(result: SuiteResult) -> str:
    """Return the result in schema ``vio_eval_ros.suite/1``; numbers survive the round trip."""
    import json

    return json.dumps(result.to_dict(), indent=2, allow_nan=False) + '\n'


def suite_text(result: SuiteResult, styled: bool = False) -> str:
    """
    Return the table of sequences, worst first, and the problems of each.

    :param styled: whether ANSI codes may mark the best systems.
    """
    if result.has_systems:
        table = text_tables(result.matrix(), styled) + text_verdicts(result.matrix())
    else:
        table = _rows(result) + '\n'
    lines = ['']
    lines += [
        f'{name}: {"warning: " if is_caution else ""}{text}'
        for name, is_caution, text in remarks(result)
    ]
    lines += [f'note: {note}' for note in result.notes]
    lines.append(f'{"pass" if result.passed else "fail"}: {failed_of_all(result)}')
    return table + '\n'.join(map(printable, lines)) + '\n'


def _rows(result: SuiteResult) -> str:
    from tabulate import tabulate

    heads, rows = filled_table(worst_first(result))
    shown = [list(map(printable, row)) for row in rows]
    return tabulate(shown, heads, 'simple', disable_numparse=True)


def suite_markdown(result: SuiteResult) -> str:
    """Return a table that fits a pull-request comment, worst first, with all problems."""
    verdict = '✅ all pass' if result.passed else f'❌ {failed_of_all(result)}'
    lines = [f'### vio_eval_ros: {verdict}', '']
    if result.has_systems:
        lines += markdown_tables(result.matrix()).splitlines()
        lines += markdown_verdicts(result.matrix()).splitlines()
    else:
        heads, rows = filled_table(worst_first(result))
        lines += ['| ' + ' | '.join(heads) + ' |']
        lines.append('|' + ''.join('---|' if head in TEXTS else '---:|' for head in heads))
        lines += ['| ' + ' | '.join(map(escaped, row)) + ' |' for row in rows]
    details = [
        f'- **{escaped(name)}**: {"⚠ " if is_caution else ""}{escaped(text)}'
        for name, is_caution, text in remarks(result)
    ]
    notes = [f'- {escaped(note)}' for note in result.notes]
    return '\n'.join([*lines, '', *details, *notes]).rstrip() + '\n'


def suite_csv(result: SuiteResult) -> str:
    """Return a row for each run and metric, or for each metric, sequence and system."""
    if result.has_systems:
        return csv_table(result.matrix())
    import csv
    import io

    text = io.StringIO()
    table = csv.writer(text, lineterminator='\n')
    table.writerow(['sequence', 'estimate', 'metric', 'value'])
    for one in result.sequences:
        for run in one.runs:
            names = spreadsheet_text(one.sequence.title), spreadsheet_text(run.run.name)
            if run.result is None:
                table.writerow([*names, 'error', spreadsheet_text(run.error)])
                continue
            for name, value in run.result.summary.metrics.items():
                table.writerow([*names, name, '' if math.isnan(value) else value])
    return text.getvalue()


def suite_latex(result: SuiteResult, siunitx: bool = False) -> str:
    """
    Return a LaTeX table (booktabs) of the sequences and systems, in the order of the suite.

    :param siunitx: whether its columns are those of siunitx.
    """
    if result.has_systems:
        return latex_tables(result.matrix(), siunitx)
    rows = [
        Row(
            one.sequence.title,
            [
                Shown(str(len(one.runs))),
                *(
                    Shown(number(one.metrics[name].median) if name in one.metrics else '-')
                    for name in LATEX.values()
                ),
            ],
        )
        for one in result.sequences
    ]
    table = Table('', ['sequence', 'runs', *LATEX], rows, [])
    return '\n'.join(tabular([table], siunitx)) + '\n'


def suite_junit(result: SuiteResult) -> str:
    """Return JUnit XML: a suite for each sequence, a case for each gate and comparison."""
    suites = []
    for one in result.sequences:
        cases: list[tuple[str, str | None]] = [
            (_gate_name(gate), _reason(one, gate, verdict) if verdict.word == 'fail' else None)
            for gate, verdict in one.verdicts
        ]
        cases += [
            (
                f'{each.rule.metric} against the baseline',
                worse_metric(each) if each.worse else None,
            )
            for each in one.comparisons or ()
        ]
        values = {name: of.median for name, of in one.metrics.items()}
        suites.append((one.sequence.title, values, cases, list(cautions(one))))
    return junit(suites)


def _gate_name(gate: RunsGate) -> str:
    over = '' if gate.over == 'median' else f' of the {gate.over} run'
    return f'{gate.gate}{over}' + (' (warning)' if gate.gate.severity == 'warn' else '')


def _reason(one: SequenceResult, gate: RunsGate, verdict: Verdict) -> str:
    """Return why a gate failed; with the failed runs if it is on the success rate."""
    runs = unsuccessful(one) if gate.gate.metric == SUCCESS_RATE else ()
    return printable('; '.join([broken_gate(gate, verdict), *runs]))


SUITE_REPORTS: dict[str, Callable[[SuiteResult], str]] = {
    'json': suite_json,
    'junit': suite_junit,
    'markdown': suite_markdown,
    'html': suite_html,
    'csv': suite_csv,
    'latex': suite_latex,
    'siunitx': partial(suite_latex, siunitx=True),
}
