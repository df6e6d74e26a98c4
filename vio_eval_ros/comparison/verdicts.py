"""Which differences between systems are real: each system against the best one, with a verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from vio_eval_ros.comparison.direction import worse_sign
from vio_eval_ros.comparison.matrix import Cell, Matrix
from vio_eval_ros.comparison.paired import compare_runs, LEAST_PIECES
from vio_eval_ros.comparison.repeated import differ, FAMILY_P
from vio_eval_ros.comparison.signed_ranks import compare_over_sequences

#: of what chance may tell in a suite, by far the most is for all sequences together: two systems
#: on seven sequences, or four on eleven by three metrics, can just be told apart so
SHARE_OVER_SEQUENCES = 0.9


@dataclass(frozen=True)
class Difference:
    """
    How the best system differs from another in a metric, on a sequence or over all of them.

    :param sequence: None for all of them.
    :param method: by which it was found: `paired block bootstrap` of single runs, `permutation of
        runs` of repeated ones, `signed ranks` over sequences.
    :param difference: one minus other, in the unit of the metric; NaN over sequences.
    :param interval: of that, 95 %; NaN where there is none.
    :param ratio: one over other; with its interval.
    :param count: independent pieces, runs of the system with fewer, or sequences.
    :param p_value: two-sided; NaN where the data can tell nothing.
    :param p_adjusted: for all differences of the comparison that were looked at in this way.
    :param why: it cannot tell; empty where it could.
    """

    sequence: str | None
    one: str
    other: str
    metric: str
    method: str
    difference: float = math.nan
    interval: tuple[float, float] = (math.nan, math.nan)
    ratio: float = math.nan
    ratio_interval: tuple[float, float] = (math.nan, math.nan)
    count: float = 0.0
    p_value: float = math.nan
    p_adjusted: float = math.nan
    why: str = ''

    @property
    def tells(self) -> bool:
        """Whether chance makes any such difference in at most FAMILY_P of all comparisons."""
        return self.p_adjusted <= FAMILY_P

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        return 'tells' if self.tells else 'does not tell'

    def to_dict(self) -> dict[str, Any]:
        """Return the difference as results have it."""
        return {
            'sequence': self.sequence,
            'one': self.one,
            'other': self.other,
            'metric': self.metric,
            'method': self.method,
            'difference': self.difference,
            'confidence_interval': list(self.interval),
            'ratio': self.ratio,
            'ratio_confidence_interval': list(self.ratio_interval),
            'count': self.count,
            'p_value': self.p_value,
            'p_adjusted': self.p_adjusted,
            'verdict': self.verdict,
            'why': self.why or None,
        }


def differences(matrix: Matrix) -> tuple[Difference, ...]:
    """
    Return the differences of the systems from the best one: over all sequences, then on each.

    The data chose the best. So p-values are adjusted as if all pairs of systems had been compared;
    over sequences by the number of pairs, on single ones (Holm 1979) by that of pairs, metrics and
    sequences. Where both could tell, each has its share of what chance may tell.
    """
    if len(matrix.systems) < 2:
        return ()
    if matrix not in _FOUND:
        pairs = len(matrix.systems) * (len(matrix.systems) - 1) // 2
        over_all = list(_over_sequences(matrix, pairs)) if len(matrix.sequences) > 1 else []
        each = list(_on_sequences(matrix))
        family = pairs * len(matrix.metrics) * len(matrix.sequences)
        adjusted = holm([one.p_value for one in each], family)
        each = [replace(one, p_adjusted=p) for one, p in zip(each, adjusted, strict=True)]
        if len(matrix.sequences) >= _least_sequences(pairs):
            over_all = [_of_share(one, SHARE_OVER_SEQUENCES) for one in over_all]
            each = [_of_share(one, 1 - SHARE_OVER_SEQUENCES) for one in each]
        _FOUND[matrix] = (*over_all, *each)
    return _FOUND[matrix]


def _of_share(one: Difference, share: float) -> Difference:
    """Return a difference whose p-value holds beside those of other looks at the same suite."""
    return replace(one, p_adjusted=float(np.minimum(one.p_adjusted / share, 1.0)))


def _least_sequences(pairs: int) -> int:
    """Return on how many sequences the rarest of all signs is rare enough for so many pairs."""
    return 1 + math.ceil(math.log2(pairs / (FAMILY_P * SHARE_OVER_SEQUENCES)))


@dataclass(frozen=True)
class SuiteVerdict:
    """
    One verdict on all differences of a suite: of all metrics, sequences and pairs of systems.

    :param differences: all of them.
    :param p_value: how often chance alone makes any of them as clear as the clearest is; NaN where
        the data can tell nothing.
    """

    differences: tuple[Difference, ...]
    sequences: int
    metrics: int
    p_value: float

    @property
    def tells(self) -> bool:
        """Whether any system is told from another; by chance in at most FAMILY_P of suites."""
        return self.p_value <= FAMILY_P

    @property
    def better(self) -> dict[tuple[str, str], int]:
        """In how many differences that tell a system is better than another, the most first."""
        count = Counter((one.one, one.other) for one in self.differences if one.tells)
        return dict(count.most_common())

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as results have it."""
        return {
            'verdict': 'tells' if self.tells else 'does not tell',
            'p_value': self.p_value,
            'better': [
                {'one': one, 'other': other, 'differences': count}
                for (one, other), count in self.better.items()
            ],
        }


def suite_verdict(matrix: Matrix) -> SuiteVerdict | None:
    """Return the one verdict on several systems over several sequences; None of fewer."""
    if len(matrix.systems) < 2 or len(matrix.sequences) < 2:
        return None
    found = differences(matrix)
    known = [one.p_adjusted for one in found if not math.isnan(one.p_adjusted)]
    p_value = min(known, default=math.nan)
    return SuiteVerdict(found, len(matrix.sequences), len(matrix.metrics), p_value)


#: each report of a matrix asks again
_FOUND: WeakKeyDictionary[Matrix, tuple[Difference, ...]] = WeakKeyDictionary()


def holm(p_values: Sequence[float], family: int) -> list[float]:
    """
    Return p-values that are adjusted for all comparisons that there may have been (Holm 1979).

    :param p_values: of some of them; NaN where there is none.
    :param family: how many comparisons there may have been.
    """
    adjusted, largest = list(p_values), 0.0
    order = [k for k in np.argsort(p_values, kind='stable') if not math.isnan(p_values[k])]
    for done, k in enumerate(order):
        largest = max(largest, min(1.0, (family - done) * p_values[k]))
        adjusted[k] = largest
    return adjusted


def _over_sequences(matrix: Matrix, pairs: int) -> Iterator[Difference]:
    """Yield the differences over all sequences, by metric from the one with the best rank."""
    metrics = [metric for metric in matrix.metrics if worse_sign(metric)]
    values = {
        name: [
            [_badness(matrix.cell(one, name), metric) for one in matrix.sequences]
            for metric in metrics
        ]
        for name in matrix.systems
    }
    least = _least_sequences(pairs)
    for k, metric in enumerate(metrics):
        ranks = {name: matrix.mean_rank(metric, name) for name in matrix.systems}
        known = [name for name in matrix.systems if not math.isnan(ranks[name])]
        best = min(known, key=ranks.__getitem__, default='')
        for other in known:
            if other == best:
                continue
            found = compare_over_sequences(values[best], values[other])[k]
            few = found.sequences < least
            yield Difference(
                sequence=None,
                one=best,
                other=other,
                metric=metric,
                method='signed ranks',
                ratio=found.ratio,
                ratio_interval=found.interval,
                count=found.sequences,
                p_value=math.nan if few else found.p_value,
                p_adjusted=math.nan if few else min(1.0, pairs * found.p_adjusted),
                why=_too_few(found.sequences, least) if few else '',
            )


def _too_few(sequences: int, least: int) -> str:
    if not sequences:
        return 'no sequence has both'
    return f'{sequences} sequences are too few, {least} may tell'


def _badness(cell: Cell, metric: str) -> float:
    """Return a value of which less is better: infinite of a failure, NaN where there is none."""
    if not cell.stands(metric):
        return math.inf if not cell.missing and any(run.failure for run in cell.runs) else math.nan
    value = cell.value(metric)
    # of a share, what is missing
    return value if worse_sign(metric) > 0 else max(1 - value, 0.0)


def _on_sequences(matrix: Matrix) -> Iterator[Difference]:
    """Yield the differences on each sequence, by metric from the best system there."""
    for sequence in matrix.sequences:
        for metric in matrix.metrics:
            ranks = matrix.ranks(metric, sequence)
            standing = [n for n in matrix.systems if matrix.stands(metric, sequence, n)]
            if not ranks or not standing:
                continue
            best = min(standing, key=ranks.__getitem__)
            for other in standing:
                if other != best:
                    yield _on_sequence(matrix, metric, sequence, (best, other))


def _on_sequence(matrix: Matrix, metric: str, sequence: str, names: tuple[str, str]) -> Difference:
    """Return how two systems differ on a sequence."""
    one, other = (matrix.cell(sequence, name) for name in names)
    if len(one.runs) > 1 or len(other.runs) > 1:
        return _repeated(one, other, Difference(sequence, *names, metric, 'permutation of runs'))
    found = compare_runs(one.results[0], other.results[0], metric)
    told = Difference(sequence, *names, metric, 'paired block bootstrap')
    if found is None:
        values = one.value(metric), other.value(metric)
        ratio = values[0] / values[1] if values[1] else math.nan
        why = 'single runs have no errors of it to pair over time'
        return replace(told, difference=values[0] - values[1], ratio=ratio, why=why)
    why = ''
    if math.isnan(found.p_value):
        why = (
            f'{found.pieces:.0f} of {found.pairs} errors are independent, {LEAST_PIECES} may tell'
            if found.pieces < LEAST_PIECES
            else 'a few errors make all of it'
        )
    return replace(
        told,
        difference=found.difference,
        interval=found.interval,
        ratio=found.ratio,
        ratio_interval=found.ratio_interval,
        count=found.pieces,
        p_value=found.p_value,
        why=why,
    )


def _repeated(one: Cell, other: Cell, told: Difference) -> Difference:
    """Return how the runs of two systems differ; those that failed are worse than any other."""
    worst = worse_sign(told.metric) * math.inf
    sides = []
    for cell in (one, other):
        values = cell.successes(told.metric)
        sides.append([*values, *[worst] * (len(cell.runs) - len(values))])
    p_value, interval = differ(*sides)
    values = one.value(told.metric), other.value(told.metric)
    few = math.isnan(p_value)
    return replace(
        told,
        difference=values[0] - values[1],
        interval=interval,
        ratio=values[0] / values[1] if values[1] else math.nan,
        count=min(map(len, sides)),
        p_value=p_value,
        why=f'{len(sides[0])} and {len(sides[1])} runs are too few, 5 of each may tell'
        if few
        else '',
    )
