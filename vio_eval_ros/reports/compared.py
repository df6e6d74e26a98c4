"""Reports of several estimates of one ground truth: the table first, then what is said of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import json

from vio_eval_ros.comparison.comparison import Comparison
from vio_eval_ros.comparison.latex_tables import latex_tables
from vio_eval_ros.comparison.matrix import CellRun
from vio_eval_ros.comparison.sentences import html_verdicts, markdown_verdicts, text_verdicts
from vio_eval_ros.comparison.tables import (
    csv_table,
    html_tables,
    markdown_tables,
    text_tables,
)
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.page import badge, Html, page, system_swatch, tag, warnings
from vio_eval_ros.rendering.text import escaped, number, printable
from vio_eval_ros.reports.documents import gate_cases, junit
from vio_eval_ros.reports.html import gate_rows, run_plots
from vio_eval_ros.reports.overlaid import overlaid
from vio_eval_ros.reports.text import described, headline

#: drawn of each line of each system
MOST_POINTS = 1000


def comparison_json(found: Comparison) -> str:
    """Return the comparison in schema ``vio_eval_ros.comparison/1``; with each result in full."""
    return json.dumps(found.to_dict(), indent=2, allow_nan=False) + '\n'


def comparison_text(found: Comparison, styled: bool = False) -> str:
    """
    Return the truth, the table, and the warnings and gates of the systems.

    :param styled: whether ANSI codes may mark the best systems.
    """
    first = next(iter(found.results.values()))
    head = [
        f'ground truth  {described(first.ground_truth)}',
        f'alignment     {first.config.alignment}',
        '',
    ]
    table = text_tables(found.matrix, styled) + text_verdicts(found.matrix)
    lines = [f'warning: {text}' for text in cautions(found)]
    verdicts = [
        f'{verdict.word}  {name}: {verdict.gate}  (is {number(verdict.value)})'
        for name, result in found.results.items()
        for verdict in result.verdicts
    ]
    lines += ['', *verdicts] if verdicts else []
    above, below = (''.join(f'{printable(line)}\n' for line in part) for part in (head, lines))
    return f'{above}{table}{below}'


def cautions(found: Comparison) -> Iterator[str]:
    """Yield each warning once, with the systems that have it."""
    told: dict[str, list[str]] = {}
    for name, result in found.results.items():
        for text in dict.fromkeys(_without_path(text, result) for text in result.summary.warnings):
            told.setdefault(text, []).append(name)
    for text, names in told.items():
        everybody = len(names) == len(found.results) > 1
        yield f'{"all systems" if everybody else ", ".join(names)}: {text}'


def _without_path(warning: str, result: Result) -> str:
    """Return a warning without the file that it is on, for which the system stands."""
    for path in result.estimate.paths:
        warning = warning.removeprefix(f'{path}: ')
    return warning


def comparison_markdown(found: Comparison) -> str:
    """Return the table, and the warnings and gates of the systems, in Markdown."""
    first = next(iter(found.results.values()))
    lines = [
        f'Against {escaped(first.ground_truth.source)}, alignment {first.config.alignment}.',
        '',
        markdown_tables(found.matrix) + markdown_verdicts(found.matrix),
        *(
            f'- **fail** {escaped(name)}: `{verdict.gate}` (is {number(verdict.value)})'
            for name, result in found.results.items()
            for verdict in result.verdicts
            if verdict.word == 'fail'
        ),
        *(f'- ⚠ {escaped(text)}' for text in cautions(found)),
    ]
    return '\n'.join(lines).rstrip() + '\n'


def comparison_html(found: Comparison) -> str:
    """Return a page: the table, and each system by itself, folded."""
    first, order = next(iter(found.results.values())), list(found.runs)
    word = {True: 'pass', False: 'fail', None: ''}[found.passed]
    return page(
        f'{", ".join(found.runs)}: comparison',
        tag(
            'header',
            tag(
                'div',
                tag('h1', f'{len(found.runs)} systems'),
                tag('p', f'against {first.ground_truth.source}', class_='soft'),
                tag('p', f'alignment {first.config.alignment}', class_='soft'),
            ),
            badge(word, word or 'no gates'),
        ),
        html_tables(found.matrix),
        html_verdicts(found.matrix),
        warnings(cautions(found)),
        tag('h2', 'All systems'),
        overlaid(found.results, order),
        tag('h2', 'Each system'),
        *(
            _system(list(found.runs).index(name), name, result)
            for name, result in found.results.items()
        ),
    )


def _system(place: int, name: str, result: Result) -> Html:
    """Return the section of a system, folded."""
    return tag(
        'details',
        tag(
            'summary',
            system_swatch(place),
            name,
            ' ',
            tag('span', headline(result), class_='soft'),
        ),
        gate_rows((str(verdict.gate), verdict) for verdict in result.verdicts)
        if result.verdicts
        else '',
        tag('section', run_plots(result, MOST_POINTS), class_='run'),
    )


def comparison_junit(found: Comparison) -> str:
    """Return JUnit XML: a suite for each system; one that could not be scored has failed."""
    return junit(map(_suite, found.runs.values()))


def _suite(
    run: CellRun,
) -> tuple[str, Mapping[str, float], list[tuple[str, str | None]], Sequence[str]]:
    """Return name, metrics, cases and warnings of a system."""
    if run.result is None:
        return run.name, {}, [('evaluated', run.failure)], ()
    summary = run.result.summary
    return run.name, summary.metrics, gate_cases(run.result), summary.warnings


COMPARISON_REPORTS: dict[str, Callable[[Comparison], str]] = {
    'json': comparison_json,
    'junit': comparison_junit,
    'markdown': comparison_markdown,
    'html': comparison_html,
    'csv': lambda found: csv_table(found.matrix),
    'latex': lambda found: latex_tables(found.matrix),
    'siunitx': lambda found: latex_tables(found.matrix, siunitx=True),
}
