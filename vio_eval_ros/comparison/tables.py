"""A matrix as tables that people read: text, Markdown, HTML; and as CSV for scripts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
import math
import re
from typing import NamedTuple

from vio_eval_ros.comparison.direction import UNITS
from vio_eval_ros.comparison.matrix import Matrix
from vio_eval_ros.rendering.page import Html, html, joined, system_swatch, table, tag
from vio_eval_ros.rendering.terminal import BEST, SECOND
from vio_eval_ros.rendering.text import escaped, printable

#: parts of the names of metrics that the unit, or the custom of the field, tells already
UNSAID = ('trans', 'rot', 'rmse')
WRITTEN = {
    **{word: word.upper() for word in ('ate', 'rpe', 'kitti', 'nees')},
    'se3': 'SE(3)',
    'sim3': 'Sim(3)',
}
#: behind a value: its cell has failed, or only some of its runs
FAILED, PARTLY = '†', '‡'
#: in place of a value: no run could be scored, or there was none
UNSCORED, MISSING = 'failed', 'missing'
#: what a spreadsheet takes for the beginning of a formula
FORMULAS = ('=', '+', '-', '@')


class Shown(NamedTuple):
    """
    A value of a table.

    :param place: 1 for the best, 2 for the second, else 0.
    :param mark: FAILED, PARTLY or nothing.
    :param missing: decimals that others in the table have beside it, with the point.
    """

    text: str = '-'
    place: int = 0
    mark: str = ''
    missing: str = ''


class Row(NamedTuple):
    """A line of a table: its name, and a value for each further column."""

    name: str
    values: list[Shown]


class Table(NamedTuple):
    """
    One table.

    :param title: the metric, or the only sequence where the columns are metrics.
    :param heads: of the columns, the first of which has the names.
    :param summary: rows below a rule: mean and rank.
    """

    title: str
    heads: list[str]
    rows: list[Row]
    summary: list[Row]


def label(metric: str) -> str:
    """Return a metric as the head of a column names it: ``RPE 1 s [deg]``."""
    end = next((end for end in UNITS if metric.endswith(end)), '')
    words = [word for word in metric.removesuffix(end).split('_') if word not in UNSAID]
    text = ' '.join(WRITTEN.get(word, word) for word in words)
    text = re.sub(r'\b([\d.]+)([a-z])\b', r'\1 \2', text)
    return f'{text.removesuffix(" ratio")} [{UNITS[end]}]' if end else text.removesuffix(' ratio')


def tables_of(matrix: Matrix) -> list[Table]:
    """
    Return one table with a column for each metric, or one for each metric of several sequences.

    The longer of sequences and systems is what goes down.
    """
    if len(matrix.sequences) > 1:
        return [_of_metric(matrix, metric) for metric in matrix.metrics]
    (sequence,) = matrix.sequences
    rows = [
        Row(system, [_shown(matrix, metric, sequence, system) for metric in matrix.metrics])
        for system in matrix.systems
    ]
    return [Table(sequence, ['system', *map(label, matrix.metrics)], rows, [])]


def _of_metric(matrix: Matrix, metric: str) -> Table:
    """Return the sequences x systems of one metric, with mean and rank."""
    title, sequences, systems = label(metric), matrix.sequences, matrix.systems
    values = [[_shown(matrix, metric, one, name) for name in systems] for one in sequences]
    summary = []
    if matrix.common(metric):
        summary.append(Row(_mean_name(matrix, metric), _means(matrix, metric)))
    if any(matrix.ranks(metric, one) for one in sequences) and len(systems) > 1:
        summary.append(Row('rank', _ranks(matrix, metric)))
    if len(systems) <= len(sequences):
        rows = [Row(*each) for each in zip(sequences, values, strict=True)]
        return Table(title, ['sequence', *systems], rows, summary)
    columns = zip(*values, *(row.values for row in summary), strict=True)
    rows = [Row(name, list(found)) for name, found in zip(systems, columns, strict=True)]
    return Table(title, ['system', *sequences, *(row.name for row in summary)], rows, [])


def _shown(matrix: Matrix, metric: str, sequence: str, system: str) -> Shown:
    """Return a cell as tables show it."""
    cell = matrix.cell(sequence, system)
    value = matrix.rounded(metric, sequence, system)
    if math.isnan(value):
        if any(not run.failure for run in cell.runs):
            return Shown('-')
        return Shown(MISSING if cell.missing else UNSCORED)
    decimals, most = matrix.decimals(metric, sequence, system), matrix.most_decimals[metric]
    mark = PARTLY if any(cell.failures(metric)) else ''
    exact = cell.value(metric)
    return Shown(
        f'{value:.{decimals}f}' if value or not exact else f'{exact:.1e}',  # no silent zero
        place=_place(system, matrix.best(metric, sequence), matrix.second(metric, sequence)),
        mark=mark if matrix.stands(metric, sequence, system) else FAILED,
        missing=_missing(decimals, most),
    )


def _place(name: str, best: Sequence[str], second: Sequence[str]) -> int:
    return 1 if name in best else 2 * (name in second)


def _mean_name(matrix: Matrix, metric: str) -> str:
    """Return the name of the mean, with over how many sequences it is where not over all."""
    common = len(matrix.common(metric))
    return 'mean' if common == len(matrix.sequences) else f'mean of {common}'


def _means(matrix: Matrix, metric: str) -> list[Shown]:
    """Return the mean of each system over the common sequences."""
    best, second = matrix.places_of_means(metric)
    means = {name: matrix.mean(metric, name) for name in matrix.systems}
    decimals = matrix.decimals_of_means[metric]
    missing = _missing(decimals, matrix.most_decimals[metric])
    return [
        Shown()
        if math.isnan(mean)
        else Shown(f'{mean:.{decimals}f}', _place(name, best, second), missing=missing)
        for name, mean in means.items()
    ]


def _missing(decimals: int, most: int) -> str:
    """Return what stands in place of the decimals that a value does not have."""
    return '' if decimals == most else '.' * (not decimals) + '0' * (most - decimals)


def _ranks(matrix: Matrix, metric: str) -> list[Shown]:
    best, second = matrix.places_of_ranks(metric)
    return [
        Shown(f'{matrix.mean_rank(metric, name):.2f}', _place(name, best, second))
        for name in matrix.systems
    ]


def footnotes(matrix: Matrix) -> Iterator[str]:
    """Yield what marks mean, every failure with its reason, and over what the means are."""
    shown = [value for one in tables_of(matrix) for row in one.rows for value in row.values]
    signs = [s for s in (FAILED, UNSCORED, MISSING) if any(s in value for value in shown)]
    if signs:
        yield f'{", ".join(signs)}: no part in best and mean, and the last rank'
    if PARTLY in {value.mark for value in shown}:
        yield f'{PARTLY} some of its runs failed; they count as the worst in the median'
    for (sequence, system), cell in matrix.cells.items():
        if cell.missing:
            continue
        told = Counter(run.failure for run in cell.runs if run.failure)
        for metric in matrix.metrics:
            told.update(why for _, why in cell.failures(metric) if why == f'has no {metric}')
        name = ', '.join(filter(None, (sequence, system)))
        for why, runs in told.items():
            of = f'{runs} of {len(cell.runs)} runs: ' if len(cell.runs) > 1 else ''
            yield f'{name}: {of}{why}'
    if len(matrix.sequences) > 1:
        yield from _of_means(matrix)
    for sequence, names in matrix.twins():
        where = f'{sequence}: ' if sequence else ''
        yield f'{where}{" and ".join(names)} have the same results: are they the same runs?'
    if len(matrix.systems) == 1:
        yield 'only one system: nothing to compare it with'
    yield from matrix.notes


def _of_means(matrix: Matrix) -> Iterator[str]:
    """Yield the sequences of each mean that is not over all."""
    found: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
    for metric in matrix.metrics:
        never = (name for name in matrix.systems if math.isnan(matrix.mean(metric, name)))
        found.setdefault((matrix.common(metric), tuple(never)), []).append(label(metric))
    for (common, nowhere), metrics in found.items():
        names = ', '.join(metrics)
        if common and len(common) < len(matrix.sequences):
            but = f' but {", ".join(nowhere)}, which succeeded nowhere' if nowhere else ''
            where = f'over {", ".join(common)}, where all systems succeeded{but}'
            yield f'mean of {len(common)} ({names}): {where}'
        elif not common:
            yield f'no mean of {names}: on every sequence some system has failed or no run'


def text_tables(matrix: Matrix, styled: bool = False) -> str:
    """
    Return the tables and footnotes for a terminal.

    :param styled: whether ANSI codes make the best bold and underline the second.
    """
    lines: list[str] = []
    for one in tables_of(matrix):
        lines += [*([printable(one.title)] if one.title else []), *_text_table(one, styled), '']
    if len(matrix.systems) > 1:
        places = BEST.format('best'), SECOND.format('second')
        lines.append(', '.join(places) if styled else '* best, + second')
    return ''.join(f'{line}\n' for line in (*lines, *map(printable, footnotes(matrix))))


def _text_table(one: Table, styled: bool) -> list[str]:
    """Return the lines of a table."""
    rows = [*one.rows, *one.summary]
    marks = any(value.mark for row in rows for value in row.values)
    room = ' ' * ((0 if styled else 2) + marks)
    heads = [one.heads[0], *(head + room for head in one.heads[1:])]
    cells = [[row.name, *(_in_text(value, marks, styled) for value in row.values)] for row in rows]
    cells = [[printable(cell) for cell in line] for line in (heads, *cells)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    styles = [[], *(row.values if styled else [] for row in rows)]
    lines = [_justified(*line, widths) for line in zip(cells, styles, strict=True)]
    rule = '  '.join('-' * width for width in widths)
    lines.insert(1, rule)
    if one.summary:
        lines.insert(-len(one.summary), rule)
    return lines


def _in_text(value: Shown, marks: bool, styled: bool) -> str:
    """Return a value with what marks it; points of a column are below each other."""
    mark = value.mark or ' ' if marks else ''
    place = '' if styled else ('  ', ' *', ' +')[value.place]
    return f'{value.text}{" " * len(value.missing)}{place}{mark}'


def _justified(cells: Sequence[str], styles: Sequence[Shown], widths: Sequence[int]) -> str:
    """Return cells as a line; the codes that style some values take no room."""
    name, *others = cells
    numbers = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
    for k, value in enumerate(styles):
        code = ('{}', BEST, SECOND)[value.place]
        numbers[k] = numbers[k].replace(value.text, code.format(value.text), 1)
    return '  '.join([name.ljust(widths[0]), *numbers]).rstrip()


def markdown_tables(matrix: Matrix) -> str:
    """Return the tables and footnotes in Markdown."""
    lines: list[str] = []
    for one in tables_of(matrix):
        lines += [f'**{escaped(one.title)}**', ''] if one.title else []
        lines.append('| ' + ' | '.join(map(escaped, one.heads)) + ' |')
        lines.append('|---|' + '---:|' * (len(one.heads) - 1))
        for row in (*one.rows, *one.summary):
            values = (_styled(value, '**{}**', '<ins>{}</ins>') for value in row.values)
            lines.append('| ' + ' | '.join([escaped(row.name), *values]) + ' |')
        lines.append('')
    notes = [*legend(matrix), *map(escaped, footnotes(matrix))]
    return '\n'.join([*lines, *(f'- {note}' for note in notes)]) + '\n'


def _styled(value: Shown, best: str, second: str) -> str:
    return ('{}', best, second)[value.place].format(value.text) + value.mark


def legend(matrix: Matrix) -> list[str]:
    """Return what says how the best are marked; nothing of one system."""
    return ['Best in bold, second underlined.'] if len(matrix.systems) > 1 else []


def html_tables(matrix: Matrix) -> Html:
    """Return the tables and footnotes as a part of a page."""
    parts: list[object] = []
    for one in tables_of(matrix):
        down = one.heads[0] == 'system'
        names = [_head(matrix, row.name, down) for row in one.rows]
        names += [html(row.name) for row in one.summary]
        rows = [
            [name, *map(_in_html, row.values)]
            for name, row in zip(names, (*one.rows, *one.summary), strict=True)
        ]
        parts += [tag('h3', one.title)] if one.title else []
        heads = [html(one.heads[0]), *(_head(matrix, name, not down) for name in one.heads[1:])]
        parts.append(table(heads, rows, numbers=range(1, len(one.heads))))
    notes = [*legend(matrix), *footnotes(matrix)]
    return joined([*parts, tag('ul', *(tag('li', note) for note in notes), class_='soft')])


def _head(matrix: Matrix, name: str, of_system: bool) -> Html:
    """Return the head of a row or column; a system has the colour that it has in plots."""
    if not of_system:
        return html(name)
    return joined([system_swatch(matrix.systems.index(name)), name])


def _in_html(value: Shown) -> Html:
    """Return a value whose point is below that of the others; a mark takes no room."""
    kind = ('span', 'b', 'u')[value.place]
    is_hole = value.text in (UNSCORED, MISSING)
    shown = tag(kind, value.text, class_='soft' if is_hole else None)
    mark = tag('span', value.mark, style='display:inline-block;width:0') if value.mark else ''
    unseen = tag('span', value.missing, style='visibility:hidden') if value.missing else ''
    return joined([shown, mark, unseen])


def csv_table(matrix: Matrix) -> str:
    """Return a row for each metric, sequence and system; numbers in full, unknown ones empty."""
    import csv
    import io

    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(
        ['metric', 'sequence', 'system', 'value', 'place', 'runs', 'successes', 'standard_error',
         'failure']
    )  # fmt: skip
    for metric in matrix.metrics:
        for (sequence, system), cell in matrix.cells.items():
            best, second = matrix.best(metric, sequence), matrix.second(metric, sequence)
            numbers = cell.value(metric), cell.standard_error(metric)
            value, error = ('' if math.isnan(number) else repr(number) for number in numbers)
            why = '; '.join(dict.fromkeys(why for _, why in cell.failures(metric)))
            place = _place(system, best, second) or ''
            runs = len(cell.runs), len(cell.successes(metric))
            names = spreadsheet_text(sequence), spreadsheet_text(system)
            row = [metric, *names, value, place, *runs, error, spreadsheet_text(why)]
            writer.writerow(row)
    return text.getvalue()


def spreadsheet_text(text: str) -> str:
    """Return text that no spreadsheet takes for a formula."""
    return f"'{printable(text)}" if text.startswith(FORMULAS) else printable(text)
