"""Reports of the metrics: JSON for scripts, JUnit for build servers, Markdown for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
import math

from vio_eval_ros.core.statistics import STATISTICS
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.text import escaped, number, percent, printable
from vio_eval_ros.reports.text import rows, single_figures

MARKS = {'pass': 'pass', 'warn': '⚠ warn', 'fail': '**fail**'}


def json_report(result: Result) -> str:
    """Return the result in schema ``vio_eval_ros.result/1``; numbers survive the round trip."""
    import json

    return json.dumps(result.to_dict(), indent=2, allow_nan=False) + '\n'


def junit_report(result: Result) -> str:
    """Return a JUnit test suite: a case per gate, or a single one where there are no gates."""
    summary = result.summary
    return junit([(result.estimate.source, summary.metrics, gate_cases(result), summary.warnings)])


def gate_cases(result: Result) -> list[tuple[str, str | None]]:
    """Return a case for each gate, with the reason why it failed, or a single one of none."""
    return [
        (
            str(verdict.gate),
            None
            if verdict.word != 'fail'
            else f'{verdict.gate.metric} is {number(verdict.value)}, the gate is {verdict.gate}',
        )
        for verdict in result.verdicts
    ] or [('evaluated', None)]


def junit(
    suites: Iterable[
        tuple[str, Mapping[str, float], Sequence[tuple[str, str | None]], Sequence[str]]
    ],
) -> str:
    """
    Return JUnit XML.

    :param suites: name, metrics, cases and warnings of each; a case is a name and the reason
        why it failed, or None.
    """
    from xml.etree import ElementTree

    root = ElementTree.Element('testsuites', name='vio_eval_ros')
    totals: Counter[str] = Counter()
    for title, metrics, cases, warnings in suites:
        failures = sum(failure is not None for _, failure in cases)
        counts = {'tests': len(cases), 'failures': failures, 'errors': 0, 'skipped': 0}
        totals.update(counts)
        name = printable(title)
        suite = ElementTree.SubElement(root, 'testsuite', {'name': name, **_texts(counts)})
        properties = ElementTree.SubElement(suite, 'properties')
        for metric, value in metrics.items():
            shown = 'null' if math.isnan(value) else repr(value)
            ElementTree.SubElement(properties, 'property', name=metric, value=shown)
        for gate, failure in cases:
            case = ElementTree.SubElement(suite, 'testcase', name=gate, classname=name)
            if failure is not None:
                ElementTree.SubElement(
                    case, 'failure', message=failure, type='gate'
                ).text = failure
        if warnings:
            output = '\n'.join(f'warning: {printable(warning)}' for warning in warnings)
            ElementTree.SubElement(suite, 'system-out').text = output
    del totals['skipped']  # the schema has it for suites only
    for key, total in _texts(totals).items():
        root.set(key, total)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode', xml_declaration=True) + '\n'


def _texts(counts: Mapping[str, int]) -> dict[str, str]:
    return {name: str(count) for name, count in counts.items()}


def markdown_report(result: Result) -> str:
    """Return tables that fit a pull-request comment."""
    found, alignment = result.summary.association, result.summary.alignment
    verdict = {True: '✅ pass', False: '❌ fail', None: 'no gates'}[result.passed]
    lines = [
        f'### {escaped(result.estimate.source)}: {verdict}',
        '',
        f'Against {escaped(result.ground_truth.source)}: {found["pairs"]} pairs, '
        f'coverage {percent(found["coverage_ratio"])}, '
        f'{percent(found["matched_ratio"])} of the estimates matched, '
        f'alignment {alignment.mode} (scale {number(alignment.scale)}).',
        '',
    ]
    if result.verdicts:
        lines += ['| gate | value | verdict |', '|---|---:|---|']
        lines += [
            f'| `{verdict.gate}` | {number(verdict.value)} | {MARKS[verdict.word]} |'
            for verdict in result.verdicts
        ] + ['']
    lines += ['| error | ' + ' | '.join(STATISTICS) + ' | metric |']
    lines += ['|---|' + '---:|' * len(STATISTICS) + '---|']
    lines += [
        f'| {label} | ' + ' | '.join(map(number, values)) + f' | `{metric}` |'
        for label, metric, values in rows(result)
    ]
    lines += ['', '| figure | value | metric |', '|---|---:|---|']
    lines += [
        f'| {words} | {number(value)} | `{metric}` |'
        for words, metric, value in single_figures(result)
    ]
    lines += [''] + [f'- ⚠ {escaped(warning)}' for warning in result.summary.warnings]
    return '\n'.join(lines).rstrip() + '\n'
