"""
Sequences x systems x metrics: one value of each, which of them are best, mean and rank.

A failed run never disappears: it counts as worse than any value. So the value of a cell is the
median over all its runs; where half of them or more have failed, there is no such median, and the
cell has failed: what numbers it has are shown, but take no part in best, mean and rank.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.comparison.direction import worse_sign
from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.gates import Gate, judge
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result, SUCCESS_GATES
from vio_eval_ros.rendering.text import number

#: shown of a value whose runs do not tell how far it is certain
SIGNIFICANT_DIGITS = 3
MOST_DECIMALS = 6
#: a smaller value is as good as zero where decimals are counted
LEAST_VALUE = 10**-MOST_DECIMALS
USUAL_DELTA = '1s'


class CellRun(NamedTuple):
    """
    One run of a system on a sequence.

    :param name: as the user named its estimate.
    :param result: None where it could not be scored.
    :param failure: why it could not, or why it is no success; empty for a success.
    :param missing: whether there is nothing that could have been scored.
    """

    name: str
    result: Result | None
    failure: str = ''
    missing: bool = False

    @classmethod
    def of(cls, name: str, result: Result, gates: Sequence[Gate] = SUCCESS_GATES) -> CellRun:
        """Return a run that was scored; the gates say what a success is."""
        broken = (one for one in judge(gates, result.summary.metrics) if not one.passed)
        why = ' and '.join(
            f'{gate.metric} is {number(value)}, not {gate.comparison} {gate.limit:g}'
            for gate, value, _ in broken
        )
        return cls(name, result, why)


@dataclass(frozen=True, eq=False)
class Cell:
    """All runs of one system on one sequence; ``runs`` is never empty."""

    runs: tuple[CellRun, ...]

    @property
    def results(self) -> tuple[Result, ...]:
        """The results of the runs that were scored, successes or not."""
        return tuple(run.result for run in self.runs if run.result is not None)

    @property
    def missing(self) -> bool:
        """Whether there is no run at all."""
        return all(run.missing for run in self.runs)

    def values(self, metric: str) -> tuple[float, ...]:
        """Return a metric of each run; NaN where it has none."""
        return tuple(
            math.nan if run.result is None else run.result.summary.metrics.get(metric, math.nan)
            for run in self.runs
        )

    def successes(self, metric: str) -> tuple[float, ...]:
        """Return a metric of the successful runs that have it."""
        found = zip(self.runs, self.values(metric), strict=True)
        return tuple(value for run, value in found if not run.failure and math.isfinite(value))

    def stands(self, metric: str) -> bool:
        """Return whether more than half of the runs are successes with a value."""
        return 2 * len(self.successes(metric)) > len(self.runs)

    def value(self, metric: str) -> float:
        """
        Return the median over the runs, those without success counting as the worst.

        Where half of them or more have failed, it is the median of what numbers there are; NaN
        where there are none.
        """
        succeeded = self.successes(metric)
        if self.stands(metric):
            worst = (worse_sign(metric) or 1) * math.inf
            failed = [worst] * (len(self.runs) - len(succeeded))
            # in the middle are two values at most, finite since most are
            return float(np.median([*succeeded, *failed]))
        known = [value for value in self.values(metric) if math.isfinite(value)]
        return float(np.median(known)) if known else math.nan

    def standard_error(self, metric: str) -> float:
        """Return the standard error of the mean of the successful runs; NaN of fewer than two."""
        found = self.successes(metric)
        return float(np.std(found, ddof=1) / math.sqrt(len(found))) if len(found) > 1 else math.nan

    def failures(self, metric: str) -> Iterator[tuple[str, str]]:
        """Yield the name of each run that does not count, and why."""
        for run, value in zip(self.runs, self.values(metric), strict=True):
            if run.failure:
                yield run.name, run.failure
            elif not math.isfinite(value):
                yield run.name, f'has no {metric}'


class _Shown(NamedTuple):
    """A value rounded to its decimals, and whether it takes part in best, mean and rank."""

    number: float
    decimals: int
    stands: bool


@dataclass(frozen=True, eq=False)
class Matrix:
    """
    What several systems reached on several sequences.

    :param sequences: names, in the order of the user; likewise ``systems`` and ``metrics``.
    :param cells: by sequence and system; there is one for every pair of these.
    :param notes: what one must know before comparing, such as unequal options.
    """

    sequences: tuple[str, ...]
    systems: tuple[str, ...]
    metrics: tuple[str, ...]
    cells: Mapping[tuple[str, str], Cell]
    notes: tuple[str, ...] = ()

    @classmethod
    def of_runs(
        cls, runs: Mapping[str, CellRun], metrics: Sequence[str], sequence: str = ''
    ) -> Matrix:
        """Return the matrix of one run of each system on one sequence."""
        cells = {(sequence, name): Cell((run,)) for name, run in runs.items()}
        return cls((sequence,), tuple(runs), tuple(metrics), cells)

    def cell(self, sequence: str, system: str) -> Cell:
        """Return the runs of a system on a sequence."""
        return self.cells[sequence, system]

    def stands(self, metric: str, sequence: str, system: str) -> bool:
        """Return whether a value takes part in best, mean and rank."""
        return self._shown[metric, sequence, system].stands

    def rounded(self, metric: str, sequence: str, system: str) -> float:
        """Return the value of a cell as it is shown; NaN where it has none."""
        return self._shown[metric, sequence, system].number

    def decimals(self, metric: str, sequence: str, system: str) -> int:
        """
        Return to how many decimals a value is shown.

        Those of a metric are the same for all its values: they show the smallest one in three
        significant digits. A value of repeated runs has no more of them than its standard error
        supports: the last one is that of the error's first digit.
        """
        return self._shown[metric, sequence, system].decimals

    @cached_property
    def most_decimals(self) -> dict[str, int]:
        """The most decimals that any value of a metric is shown with."""
        most = dict.fromkeys(self.metrics, 0)
        for (metric, *_), shown in self._shown.items():
            if not math.isnan(shown.number):
                most[metric] = max(most[metric], shown.decimals)
        return most

    @cached_property
    def _shown(self) -> dict[tuple[str, str, str], _Shown]:
        """Each value as it is shown; all else asks for them often."""
        found = {}
        for metric in self.metrics:
            usual = self._usual_decimals(metric)
            for names, cell in self.cells.items():
                error, decimals = cell.standard_error(metric), usual
                if error > 0:  # neither unknown, nor of runs that are the same
                    decimals = min(usual, _clipped(-math.floor(math.log10(error))))
                number = round(cell.value(metric), decimals)
                found[(metric, *names)] = _Shown(number, decimals, cell.stands(metric))
        return found

    def _usual_decimals(self, metric: str) -> int:
        """Return the decimals that show the smallest value in three digits, but for zeros."""
        found = (abs(cell.value(metric)) for cell in self.cells.values() if cell.stands(metric))
        # a perfect run would fill the table with zeros
        least = min((value for value in found if value >= LEAST_VALUE), default=math.nan)
        if math.isnan(least):
            return SIGNIFICANT_DIGITS
        return _clipped(SIGNIFICANT_DIGITS - 1 - math.floor(math.log10(least)))

    def ranks(self, metric: str, sequence: str) -> dict[str, float]:
        """
        Return the rank of each system on a sequence, 1 for the best.

        Systems that look the same as rounded share the mean of their ranks; those that failed
        share the last ones. Empty where no system has a value, or neither more nor less is worse.
        """
        return self._ranks[metric, sequence]

    @cached_property
    def _ranks(self) -> dict[tuple[str, str], dict[str, float]]:
        return {
            (metric, sequence): self._ranked(metric, sequence)
            for metric in self.metrics
            for sequence in self.sequences
        }

    def _ranked(self, metric: str, sequence: str) -> dict[str, float]:
        sign = worse_sign(metric)
        badness = np.array(
            [
                sign * self.rounded(metric, sequence, name)
                if self.stands(metric, sequence, name)
                else math.inf
                for name in self.systems
            ]
        )
        if not sign or not np.isfinite(badness).any():
            return {}
        better = (badness[:, None] > badness).sum(axis=1)
        equal = (badness[:, None] == badness).sum(axis=1)
        return dict(zip(self.systems, (better + (1 + equal) / 2).tolist(), strict=True))

    def best(self, metric: str, sequence: str) -> tuple[str, ...]:
        """Return the best system on a sequence, or those that share the place; none of one."""
        return self._places_on(metric, sequence)[0]

    def second(self, metric: str, sequence: str) -> tuple[str, ...]:
        """Return the second best system, or those that share the place; none after two firsts."""
        return self._places_on(metric, sequence)[1]

    def _places_on(self, metric: str, sequence: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        ranks = self.ranks(metric, sequence).items()
        return _places({n: rank for n, rank in ranks if self.stands(metric, sequence, n)})

    def common(self, metric: str) -> tuple[str, ...]:
        """Return the sequences on which every system stands, but for those that nowhere do."""
        standing = self._standing(metric)
        return tuple(
            one
            for one in self.sequences
            if standing and all(self.stands(metric, one, name) for name in standing)
        )

    def mean(self, metric: str, system: str) -> float:
        """Return the mean over the common sequences; NaN where it nowhere stands."""
        values = [
            self.cell(one, system).value(metric)
            for one in self.common(metric)
            if self.stands(metric, one, system)
        ]
        return float(np.mean(values)) if values else math.nan

    def mean_rank(self, metric: str, system: str) -> float:
        """Return the mean rank over the sequences, failures included; NaN without any rank."""
        ranks = [self.ranks(metric, one).get(system, math.nan) for one in self.sequences]
        known = [rank for rank in ranks if not math.isnan(rank)]
        return float(np.mean(known)) if known else math.nan

    @cached_property
    def decimals_of_means(self) -> dict[str, int]:
        """As many decimals as the most certain of the values has that a mean is made of."""
        return {
            metric: max(
                (
                    self.decimals(metric, one, name)
                    for one in self.common(metric)
                    for name in self.systems
                    if self.stands(metric, one, name)
                ),
                default=SIGNIFICANT_DIGITS,
            )
            for metric in self.metrics
        }

    def places_of_means(self, metric: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the systems with the best and the second best mean."""
        sign, decimals = worse_sign(metric), self.decimals_of_means[metric]
        means = {name: round(self.mean(metric, name), decimals) for name in self.systems}
        return _places({name: sign * mean for name, mean in means.items()} if sign else {})

    def places_of_ranks(self, metric: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the systems with the best and the second best mean rank."""
        return _places({name: self.mean_rank(metric, name) for name in self._standing(metric)})

    def _standing(self, metric: str) -> tuple[str, ...]:
        """Return the systems that stand on any sequence."""
        return tuple(
            name
            for name in self.systems
            if any(self.stands(metric, one, name) for one in self.sequences)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the matrix as results have it; NaN where there is no number."""
        return {
            'sequences': list(self.sequences),
            'systems': list(self.systems),
            'metrics': {metric: self._of_metric(metric) for metric in self.metrics},
            'notes': list(self.notes),
        }

    def _of_metric(self, metric: str) -> dict[str, Any]:
        sign = worse_sign(metric)
        return {
            'better': {1: 'lower', -1: 'higher', 0: None}[sign],
            'sequences': {one: self._of_sequence(metric, one) for one in self.sequences},
            'mean': {name: self.mean(metric, name) for name in self.systems},
            'mean_over': list(self.common(metric)),
            'mean_rank': {name: self.mean_rank(metric, name) for name in self.systems},
        }

    def _of_sequence(self, metric: str, sequence: str) -> dict[str, Any]:
        cells = {name: self.cell(sequence, name) for name in self.systems}
        return {
            'systems': {
                name: {
                    'value': cell.value(metric),
                    'standard_error': cell.standard_error(metric),
                    'runs': len(cell.runs),
                    'successes': len(cell.successes(metric)),
                    'failed': not cell.stands(metric),
                    'failures': list(dict.fromkeys(why for _, why in cell.failures(metric))),
                }
                for name, cell in cells.items()
            },
            'best': list(self.best(metric, sequence)),
            'second': list(self.second(metric, sequence)),
        }

    def twins(self) -> Iterator[tuple[str, list[str]]]:
        """Yield systems whose results on a sequence are the same to the last bit."""
        for sequence in self.sequences:
            found: dict[str, list[str]] = {}
            for system in self.systems:
                results = self.cell(sequence, system).results
                # NaN is not equal to NaN, but written the same
                numbers = [list(one.summary.metrics.values()) for one in results]
                found.setdefault(repr(numbers), []).append(system)
            found.pop(repr([]), None)
            yield from ((sequence, names) for names in found.values() if len(names) > 1)

    def failures(self) -> Iterator[tuple[str, str, str, str]]:
        """Yield sequence, system, run and reason of each run that was no success."""
        for (sequence, system), cell in self.cells.items():
            for run in cell.runs:
                if run.failure:
                    yield sequence, system, run.name, run.failure


def check_metrics(metrics: Sequence[str], known: Sequence[str]) -> None:
    """Raise ``ConfigError`` for a metric that the evaluation does not give, or one given twice."""
    for metric in metrics:
        if metric not in known:
            raise ConfigError(
                f"there is no metric '{metric}' with these options{nearest_name(metric, known)}"
            )
        if metrics.count(metric) > 1:
            raise ConfigError(f"the metric '{metric}' is given twice")


def default_metrics(config: EvaluationConfig) -> tuple[str, ...]:
    """Return what is compared where nobody chooses: ATE, RPE of the usual delta, coverage."""
    deltas = config.rpe_deltas
    delta = USUAL_DELTA if USUAL_DELTA in deltas else deltas[0] if deltas else None
    rpe = () if delta is None else (f'rpe_{delta}_trans_rmse_m', f'rpe_{delta}_rot_rmse_deg')
    return 'ate_trans_rmse_m', 'ate_rot_rmse_deg', *rpe, 'coverage_ratio'


def _clipped(decimals: int) -> int:
    return min(max(decimals, 0), MOST_DECIMALS)


def _places(badness: Mapping[str, float]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return who is best and who is second; nobody is second to two, and one alone is nothing."""
    known = {name: value for name, value in badness.items() if not math.isnan(value)}
    values = sorted(set(known.values()))
    if len(known) < 2 or len(values) < 2:
        # if all are alike, none stands out
        return (), ()
    best, second = (
        tuple(name for name, value in known.items() if value == place) for place in values[:2]
    )
    return best, second if len(best) == 1 else ()
