"""A matrix as a table of a paper: LaTeX with booktabs, and with siunitx where that is wanted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import re
from typing import NamedTuple

from vio_eval_ros.comparison.matrix import Matrix
from vio_eval_ros.comparison.tables import (
    FAILED,
    footnotes,
    legend,
    PARTLY,
    Row,
    Shown,
    Table,
    tables_of,
)
from vio_eval_ros.rendering.text import printable

SPECIAL = {
    '\\': r'\textbackslash{}', '~': r'\textasciitilde{}', '^': r'\textasciicircum{}',
    '<': r'\textless{}', '>': r'\textgreater{}', '|': r'\textbar{}', '†': r'$\dagger$',
    '‡': r'$\ddagger$', **{sign: f'\\{sign}' for sign in '&%$#_{}'},
}  # fmt: skip
COMPARISONS = {r'\textgreater{}=': r'$\geq$', r'\textless{}=': r'$\leq$'}
MARKS = {'': '', FAILED: r'\rlap{$^\dagger$}', PARTLY: r'\rlap{$^\ddagger$}'}
#: sign, digits before and after the point of what siunitx lines up
NUMBER = re.compile(r'(-?)(\d+)(?:\.(\d+))?')


class Columns(NamedTuple):
    """
    How the numbers of a table are set.

    :param needs: packages.
    :param setup: goes before the table.
    :param types: of the columns, without that of the names.
    :param cells: each writes a value of its column.
    """

    needs: tuple[str, ...]
    setup: str
    types: str
    cells: Sequence[Callable[[Shown], str]]


def latex_tables(matrix: Matrix, siunitx: bool = False) -> str:
    """Return one tabular, a block for each metric, and the footnotes below it."""
    lines = tabular(tables_of(matrix), siunitx)
    if notes := [*legend(matrix), *map(latex, footnotes(matrix))]:
        lines += ['\\par\\smallskip', '{\\footnotesize\\raggedright']
        lines += [*(note if note.endswith('.') else f'{note}.' for note in notes), '\\par}']
    return '\n'.join(lines) + '\n'


def tabular(tables: Sequence[Table], siunitx: bool) -> list[str]:
    """
    Return the lines of a tabular with a block for each table.

    Numbers have their points below each other: right-aligned, by booktabs alone, or in the ``S``
    columns of siunitx.
    """
    width = max(len(one.heads) for one in tables)
    columns = _aligned(tables, width) if siunitx else _right(width)
    packages = ', '.join(f'\\usepackage{{{name}}}' for name in columns.needs)
    lines = [
        f'% needs {packages}',
        # most columns of papers are narrow
        f'{{\\setlength{{\\tabcolsep}}{{4pt}}{columns.setup}\\begin{{tabular}}{{l{columns.types}}}',
        '\\toprule',
        _heads(tables[0], width),
    ]
    heads = tables[0].heads
    for one in tables:
        has_heads = one.heads != heads[: len(one.heads)]
        lines += ['\\midrule', *_block(one, width, columns.cells, has_heads)]
        heads = one.heads if has_heads else heads
    return [*lines, '\\bottomrule', '\\end{tabular}}']


def _heads(one: Table, width: int) -> str:
    heads = [latex(head) for head in one.heads] + [''] * (width - len(one.heads))
    return _row([heads[0], *(f'\\multicolumn{{1}}{{c}}{{{head}}}' for head in heads[1:])])


def _block(
    one: Table, width: int, cells: Sequence[Callable[[Shown], str]], has_heads: bool
) -> Iterator[str]:
    """
    Yield the lines of a table within the tabular.

    :param has_heads: of its own, as where its mean is over other sequences.
    """
    if has_heads:
        yield _heads(one, width)
        yield '\\midrule'
    if one.title:
        yield _row([f'\\multicolumn{{{width}}}{{l}}{{\\emph{{{latex(one.title)}}}}}'])

    def line(row: Row) -> str:
        values = (cell(value) for cell, value in zip(cells, row.values, strict=False))
        return _row([latex(row.name), *values])

    yield from map(line, one.rows)
    if one.summary:
        yield f'\\cmidrule(lr){{1-{width}}}'
    yield from map(line, one.summary)


def latex(text: str) -> str:
    """Return text with nothing in it that LaTeX would interpret."""
    escaped_text = ''.join(SPECIAL.get(sign, sign) for sign in printable(text))
    for written, sign in COMPARISONS.items():
        escaped_text = escaped_text.replace(written, sign)
    return escaped_text


def _row(cells: Sequence[str]) -> str:
    # after the end of a row, LaTeX would take these for its argument
    guard = '{}' if cells[0].startswith(('[', '*')) else ''
    return f'{guard}{" & ".join(cells)} \\\\'


def _right(width: int) -> Columns:
    """Return columns that are right-aligned."""
    return Columns(('booktabs',), '', 'r' * (width - 1), [_in_right] * (width - 1))


def _in_right(value: Shown) -> str:
    missing = f'\\phantom{{{value.missing}}}' if value.missing else ''
    styled = ('{}', '\\textbf{{{}}}', '\\underline{{{}}}')[value.place].format(_text(value))
    return f'{styled}{MARKS[value.mark]}{missing}'


def _text(value: Shown) -> str:
    return '--' if value.text == '-' else value.text


class _Places(NamedTuple):
    """The room of an ``S`` column: sign, and digits before and after the point."""

    signs: int
    whole: int
    decimals: int

    @classmethod
    def of(cls, text: str) -> _Places | None:
        """Return what a number takes; None of other text."""
        found = NUMBER.fullmatch(text)
        return found and cls(*(len(part or '') for part in found.groups()))

    @property
    def column(self) -> str:
        """The type of the column."""
        return f'S[table-format={"-" * self.signs}{self.whole}.{self.decimals}]'

    def cell(self, value: Shown) -> str:
        """
        Return a value in such a column.

        Siunitx cannot underline, and sets marks apart. Such a number is text, with the room
        around it that others have: both are centred.
        """
        own = self.of(value.text)
        if own is None:
            return f'{{{_text(value)}{MARKS[value.mark]}}}'
        if value.place < 2 and not value.mark:
            bold = '\\bfseries ' * value.place
            return f'{bold}{value.text}'
        number = f'\\num{{{value.text}}}'
        number = ('{}', '{{\\bfseries {}}}', '\\underline{{{}}}')[value.place].format(number)
        before = '$-$' * (self.signs - own.signs) + '0' * (self.whole - own.whole)
        after = '.' * (bool(self.decimals) - bool(own.decimals))
        after += '0' * (self.decimals - own.decimals)
        before, after = (f'\\phantom{{{room}}}' if room else '' for room in (before, after))
        return f'{{{before}{number}{MARKS[value.mark]}{after}}}'


def _aligned(tables: Sequence[Table], width: int) -> Columns:
    """Return ``S`` columns, each with the room that its largest number takes."""
    places = []
    for k in range(width - 1):
        texts = [
            row.values[k].text
            for one in tables
            for row in (*one.rows, *one.summary)
            if k < len(row.values)
        ]
        known = [found for text in texts if (found := _Places.of(text))]
        places.append(_Places(*map(max, zip(*known, strict=True))) if known else _Places(0, 1, 0))
    return Columns(
        ('booktabs', 'siunitx'),
        '\\sisetup{detect-weight, mode=text}',
        ''.join(one.column for one in places),
        [one.cell for one in places],
    )
