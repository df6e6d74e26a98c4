"""Which party is wrong on each sequence of a matrix, one of the systems or the ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from weakref import WeakKeyDictionary

import numpy as np

from vio_eval_ros.comparison.hat import Doubt, LEAST_SYSTEMS, TRUTH, which_is_wrong
from vio_eval_ros.comparison.matrix import Matrix
from vio_eval_ros.evaluation.result import Result

#: stamps that are looked at, evenly over the time that all systems share
MOST_STAMPS = 400
#: nothing is known of a system between two poses that are farther apart
MOST_APART_NS = 1_000_000_000
#: of the span of the system with most; one that has less is left out
LEAST_SPAN = 0.5


def doubts(matrix: Matrix) -> dict[str, Doubt]:
    """Return which party is wrong on each sequence with two systems or more that were scored."""
    if matrix not in _FOUND:
        found = {}
        for sequence in matrix.sequences:
            runs = {
                name: results[0]
                for name in matrix.systems
                if (results := matrix.cell(sequence, name).results)
                and results[0].summary.alignment.is_known
                and len(results[0].summary.pairs.ground_truth.stamps_ns) > 1
            }
            if len(runs) > 1:
                found[sequence] = _doubt(runs)
        _FOUND[matrix] = found
    return _FOUND[matrix]


#: each report of a matrix asks again
_FOUND: WeakKeyDictionary[Matrix, dict[str, Doubt]] = WeakKeyDictionary()


def _doubt(runs: Mapping[str, Result]) -> Doubt:
    """Return which party is wrong, from the first run of each system."""
    first = min(int(run.summary.pairs.ground_truth.stamps_ns[0]) for run in runs.values())
    return which_is_wrong(*shared_positions(runs), first)


def shared_positions(
    runs: Mapping[str, Result],
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """
    Return (N,) stamps [ns] that systems share, and (N, 3) positions of the truth and of each.

    What covers less than LEAST_SPAN of the longest is left out.
    """
    stamps = {name: run.summary.pairs.ground_truth.stamps_ns for name, run in runs.items()}
    spans = {name: int(each[-1] - each[0]) for name, each in stamps.items()}
    chosen = [name for name in runs if spans[name] >= LEAST_SPAN * max(spans.values())]
    begin = max(int(stamps[name][0]) for name in chosen)
    end = min(int(stamps[name][-1]) for name in chosen)
    shared = begin + np.linspace(0, end - begin, MOST_STAMPS if end > begin else 0).astype(int)
    for name in chosen:
        after = np.clip(np.searchsorted(stamps[name], shared), 1, len(stamps[name]) - 1)
        shared = shared[stamps[name][after] - stamps[name][after - 1] <= MOST_APART_NS]
    densest = runs[max(chosen, key=lambda name: len(stamps[name]))].summary.pairs.ground_truth
    truth = _at(shared, densest.stamps_ns, densest.positions)
    systems = {}
    for name in chosen:
        pairs, alignment = runs[name].summary.pairs, runs[name].summary.alignment
        errors = alignment.positions(pairs.estimate.positions) - pairs.ground_truth.positions
        # errors change slowly, so that between two poses they are known better than positions
        systems[name] = truth + _at(shared, stamps[name], errors)
    return shared, truth, systems


def _at(shared: np.ndarray, stamps_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return (N, 3) values at other stamps."""
    seconds, known = (shared - stamps_ns[0]) / 1e9, (stamps_ns - stamps_ns[0]) / 1e9
    return np.stack([np.interp(seconds, known, column) for column in values.T], axis=1)


def doubt_lines(matrix: Matrix) -> Iterator[str]:
    """Yield a sentence for each sequence; nothing where two is the most on any."""
    scored = (
        sum(bool(matrix.cell(sequence, name).results) for name in matrix.systems)
        for sequence in matrix.sequences
    )
    if max(scored) < LEAST_SYSTEMS:
        return
    for sequence, one in doubts(matrix).items():
        yield f'{sequence}: {sentence(one)}' if sequence else sentence(one)


def sentence(one: Doubt) -> str:
    """Return which party is wrong, where and by how much."""
    if one.why:
        return f'cannot tell: {one.why}'
    count = len(one.families)
    if not one.wrong:
        return f'none of {count} systems and the ground truth is alone against all others'
    where = f'from {one.begin_s:.1f} s to {one.end_s:.1f} s ({one.path_m:.1f} m of path)'
    if one.wrong == (TRUTH,):
        return (
            f'the ground truth is doubtful {where}: {count} systems that agree to '
            f'{one.agreement_m:.2g} m are {one.error_m:.2g} m from it, unless all share an error'
        )
    return (
        f'{_listed(one.wrong)} disagrees alone {where}: the others and the ground truth agree to '
        f'{one.agreement_m:.2g} m and are {one.error_m:.2g} m from it'
    )


def _listed(names: Sequence[str]) -> str:
    return ' and '.join(names)
