"""What the differences of systems come to, in sentences: beneath a table of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import math

from vio_eval_ros.comparison.direction import unit_of
from vio_eval_ros.comparison.doubts import doubt_lines
from vio_eval_ros.comparison.matrix import Matrix
from vio_eval_ros.comparison.verdicts import Difference, differences, suite_verdict, SuiteVerdict
from vio_eval_ros.rendering.page import Html, joined, tag
from vio_eval_ros.rendering.text import escaped, printable

HEAD = 'Is the difference real?'
DOUBTS = 'Which one is wrong, the truth?'


def text_verdicts(matrix: Matrix) -> str:
    """Return the sentences for a terminal; nothing where there is only one system."""
    return ''.join(
        f'{printable(line)}\n' for head, lines in _parts(matrix) for line in ('', head, *lines)
    )


def markdown_verdicts(matrix: Matrix) -> str:
    """Return the sentences in Markdown."""
    return ''.join(
        '\n'.join(['', head, '', *(f'- {escaped(line)}' for line in lines)]) + '\n'
        for head, lines in _parts(matrix)
    )


def html_verdicts(matrix: Matrix) -> Html:
    """Return the sentences as a part of a page."""
    return joined(
        part
        for head, lines in _parts(matrix)
        for part in (tag('h3', head), tag('ul', *(tag('li', line) for line in lines)))
    )


def _parts(matrix: Matrix) -> Iterator[tuple[str, list[str]]]:
    """Yield each question that has an answer, with the sentences of it."""
    for head, lines in ((HEAD, verdict_lines(matrix)), (DOUBTS, doubt_lines(matrix))):
        if told := list(lines):
            yield head, told


def verdict_lines(matrix: Matrix) -> Iterator[str]:
    """Yield what is known of the differences, in sentences; those that do not tell together."""
    found = differences(matrix)
    several = len(matrix.sequences) > 1
    if verdict := suite_verdict(matrix):
        yield suite_sentence(verdict)
    chosen = [one for one in found if not several or one.sequence is None]
    if several and chosen and all(one.why for one in chosen):
        most = max(chosen, key=lambda one: one.count)
        yield f'over all sequences nothing tells: {most.why}'
    else:
        for metric in matrix.metrics:
            yield from _of_metric([one for one in chosen if one.metric == metric])
    if several:
        for metric in matrix.metrics:
            yield from _on_single([one for one in found if one.sequence and one.metric == metric])


def suite_sentence(verdict: SuiteVerdict) -> str:
    """Return the one verdict on all metrics and sequences."""
    over = f'{_counted(verdict.metrics, "metric")} and {_counted(verdict.sequences, "sequence")}'
    told = f'one verdict over {over}: {"tells" if verdict.tells else "does not tell"}'
    if math.isnan(verdict.p_value):
        return f'{told}: no difference has enough data'
    told = f'{told} ({probability(verdict.p_value)})'
    if not verdict.tells:
        return told
    better: dict[str, list[str]] = {}
    for (one, other), count in verdict.better.items():
        opposite = verdict.better.get((other, one), 0)
        times = f' ({count} of {_counted(count + opposite, "difference")})' if opposite else ''
        better.setdefault(one, []).append(f'{other}{times}')
    pairs = [f'{one} better than {", ".join(others)}' for one, others in better.items()]
    return f'{told}: {"; ".join(pairs)}'


def _counted(count: int, noun: str) -> str:
    return f'{count} {noun}{"" if count == 1 else "s"}'


def _of_metric(found: Sequence[Difference]) -> Iterator[str]:
    """Yield a sentence for each difference of a metric, one for all those that do not tell."""
    alone = len(found) == 1
    rest = [one for one in found if not (one.tells or alone)]
    yield from (sentence(one) for one in found if one not in rest)
    if rest:
        names = ', '.join(
            one.other if one.why else f'{one.other} ({probability(one.p_adjusted)})'
            for one in rest
        )
        why = min(rest, key=lambda one: one.count if one.why else math.inf).why
        where = '' if rest[0].sequence is not None else ' over all sequences'
        yield (
            f'{rest[0].one} against {names}: {rest[0].metric}{where} does not tell'
            f'{f": {why}" if why else ""}'
        )


def _on_single(found: Sequence[Difference]) -> Iterator[str]:
    """Yield on which sequences a metric tells two systems apart, and on how many it does not."""
    if not found:
        return
    better: dict[str, list[str]] = {}
    for one in found:
        if one.tells and one.sequence is not None:
            better.setdefault(f'{one.one} better than {one.other}', []).append(one.sequence)
    told = [f'{names} on {", ".join(where)}' for names, where in better.items()]
    rest = sum(not one.tells for one in found)
    if rest:
        many = f'{rest} of {len(found)} differences do' if rest > 1 else 'one difference does'
        told.append(f'{many} not tell')
    yield f'on single sequences, {found[0].metric}: {"; ".join(told)}'


def sentence(one: Difference) -> str:
    """Return a difference with its interval and the verdict."""
    where = f'over {one.count:.0f} sequences, ' if one.sequence is None else ''
    told = f'{where}{one.one} against {one.other}: {one.metric} {_amount(one)}, {one.verdict}'
    if one.why:
        return f'{told}: {one.why}'
    return f'{told} ({probability(one.p_adjusted)})'


def probability(p_value: float) -> str:
    """Return an adjusted p-value; below a ten-thousandth, its digits mean nothing."""
    return f'p = {p_value:.2g}' if p_value >= 1e-4 else 'p < 0.0001'


def _amount(one: Difference) -> str:
    """Return by how much it is lower or higher, with the interval."""
    value, unit = one.difference, unit_of(one.metric)
    low, high = one.interval
    if math.isnan(value) and one.ratio > 0:
        value, unit = 100 * (one.ratio - 1), '%'
        low, high = (100 * (end - 1) for end in one.ratio_interval)
    if math.isnan(value) or not value:
        return 'equal' if value == 0 else 'of unknown difference'
    word, (low, high) = ('higher', (low, high)) if value > 0 else ('lower', (-high, -low))
    interval = '' if math.isnan(low) else f' [{low:.3g}, {high:.3g}]'
    return f'{word} by {abs(value):.3g}{f" {unit}" if unit else ""}{interval}'
