"""Verdicts on the differences of systems from the best, adjusted for all there may be."""

from dataclasses import replace
import json
import math

import numpy as np
import pytest

from vio_eval_ros.comparison.matrix import Cell, CellRun, Matrix
from vio_eval_ros.comparison.sentences import (
    html_verdicts,
    markdown_verdicts,
    suite_sentence,
    text_verdicts,
    verdict_lines,
)
from vio_eval_ros.comparison.verdicts import (
    Difference,
    differences,
    holm,
    SHARE_OVER_SEQUENCES,
    suite_verdict,
    SuiteVerdict,
)
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.simulation import simulate

ATE, RPE = 'ate_trans_rmse_m', 'rpe_1s_trans_rmse_m'


@pytest.fixture(scope='module')
def result():
    """Return one result, whose metrics are replaced below."""
    flight = simulate(20.0, seed=1)
    sides = (('e', flight.estimate), ('t', flight.ground_truth))
    return score_run(*(Source(n, 'tum', (), poses) for n, poses in sides), EvaluationConfig(),
                     hashed=False)  # fmt: skip


def cell(result, *values, failure=''):
    """Return a cell with a run for each value of both metrics."""
    runs = []
    for value in values:
        metrics = {**result.summary.metrics, ATE: value, RPE: value}
        runs.append(CellRun('r', replace(result, summary=replace(result.summary, metrics=metrics)),
                            failure))  # fmt: skip
    return Cell(tuple(runs))


def suite(result, random, factors, sequences=11, runs=1):
    """Return a matrix of systems whose errors are a factor of those of the first."""
    names = tuple(f'S{k}' for k in range(sequences))
    cells = {
        (one, name): cell(result, *(factor * random.lognormal(0, 0.1, runs) * (1 + k)))
        for k, one in enumerate(names)
        for name, factor in factors.items()
    }
    return Matrix(names, tuple(factors), (ATE, RPE), cells)


def test_over_a_suite_the_better_of_two_is_told(result):
    matrix = suite(result, np.random.default_rng(1), {'A': 1.0, 'B': 1.3})
    over = [one for one in differences(matrix) if one.sequence is None]
    assert [(one.one, one.other, one.metric, one.tells) for one in over] == [
        ('A', 'B', ATE, True), ('A', 'B', RPE, True)]  # fmt: skip
    low, high = over[0].ratio_interval
    assert low < 1 / 1.3 < high < 1
    verdict, line, *_ = verdict_lines(matrix)
    assert verdict.startswith('one verdict over 2 metrics and 11 sequences: tells (p = 0.00')
    assert verdict.endswith('): A better than B')
    assert line.startswith('over 11 sequences, A against B: ate_trans_rmse_m lower by ')
    assert ', tells (p = 0.00' in line


def test_few_sequences_and_equal_systems_do_not_tell(result):
    random = np.random.default_rng(2)
    few = suite(result, random, {'A': 1.0, 'B': 3.0}, sequences=6)
    assert 'over all sequences nothing tells: 6 sequences are too few, 7 may tell' in '\n'.join(
        verdict_lines(few))  # fmt: skip
    alike = suite(result, random, {'A': 1.0, 'B': 1.0, 'C': 1.0})
    assert not any(one.tells for one in differences(alike))
    assert any('does not tell' in line for line in verdict_lines(alike))


def test_a_system_that_fails_is_worse_and_a_hole_is_nothing(result):
    random = np.random.default_rng(3)
    matrix = suite(result, random, {'A': 1.0, 'B': 0.9})
    cells = dict(matrix.cells)
    for one in matrix.sequences:
        cells[one, 'B'] = cell(result, 0.9, failure='diverged')
    failed = replace(matrix, cells=cells)
    over = [one for one in differences(failed) if one.sequence is None]
    assert {(one.one, one.tells) for one in over} == {('A', True)}
    assert math.isnan(over[0].ratio) or over[0].ratio == 0
    hole = replace(
        matrix, cells={**matrix.cells, ('S0', 'B'): Cell((CellRun('', None, 'none', True),))}
    )
    (first, *_) = differences(hole)
    assert first.count == 10


def test_one_verdict_tells_exactly_where_any_difference_does(result):
    random = np.random.default_rng(7)
    for factor in (1.0, 1.1, 1.3, 2.0):
        matrix = suite(result, random, {'A': 1.0, 'B': factor}, runs=2)
        verdict, found = suite_verdict(matrix), differences(matrix)
        assert verdict.tells == any(one.tells for one in found)
        assert verdict.p_value == min(one.p_adjusted for one in found if one.p_adjusted > 0)
        assert bool(verdict.better) == verdict.tells
    assert suite_verdict(suite(result, random, {'A': 1.0, 'B': 2.0}, sequences=1)) is None
    assert suite_verdict(suite(result, random, {'A': 1.0})) is None


def test_two_systems_that_are_better_in_turn_are_both_named(result):
    one = Difference(None, 'A', 'B', ATE, 'signed ranks', p_adjusted=0.001)
    turned = replace(one, one='B', other='A', metric=RPE)
    alike = replace(one, metric=RPE, p_adjusted=0.5)
    told = suite_sentence(SuiteVerdict((one, turned, one, alike), 11, 2, 0.001))
    assert told.endswith('tells (p = 0.001): A better than B (2 of 3 differences); '
                         'B better than A (1 of 3 differences)')  # fmt: skip


def test_without_enough_data_the_one_verdict_has_no_p_value(result):
    few = suite(result, np.random.default_rng(8), {'A': 1.0, 'B': 3.0}, sequences=3, runs=2)
    verdict = suite_verdict(few)
    assert math.isnan(verdict.p_value)
    assert not verdict.tells
    assert suite_sentence(verdict).endswith('does not tell: no difference has enough data')


def test_of_few_sequences_all_that_chance_may_tell_is_left_to_single_ones(result):
    random = np.random.default_rng(9)
    few, many = (
        next(
            one.p_adjusted / one.p_value
            for one in differences(
                suite(result, random, {'A': 1.0, 'B': 9.0}, sequences=count, runs=9)
            )
            if one.sequence
        )
        for count in (6, 7)
    )
    assert few == pytest.approx(6 * 2)
    assert many == pytest.approx(7 * 2 / (1 - SHARE_OVER_SEQUENCES))


def test_repeated_runs_are_permuted(result):
    random = np.random.default_rng(4)
    matrix = suite(result, random, {'A': 1.0, 'B': 1.5}, sequences=1, runs=6)
    for one in differences(matrix):
        assert one.method == 'permutation of runs'
        assert one.count == 6
        assert one.p_value == pytest.approx(2 / 924)
        assert one.tells
        assert one.interval[1] < 0
    few = suite(result, random, {'A': 1.0, 'B': 5.0}, sequences=1, runs=2)
    assert all('2 and 2 runs are too few' in one.why for one in differences(few))
    uneven = replace(few, cells={**few.cells, ('S0', 'A'): cell(result, 0.1)})
    assert not any(one.tells for one in differences(uneven))


def test_p_values_are_adjusted_as_by_holm():
    found = holm([0.01, math.nan, 0.002, 0.03, 0.5], 10)
    assert found[2] == pytest.approx(0.02)
    assert found[0] == pytest.approx(0.09)
    assert found[3] == pytest.approx(0.24)
    assert found[4] == 1
    assert math.isnan(found[1])


def test_every_report_has_the_verdicts_and_json_has_all(result):
    matrix = suite(result, np.random.default_rng(5), {'A': 1.0, 'B': 1.3})
    (_, line, *_) = verdict_lines(matrix)
    for report in (text_verdicts, html_verdicts, markdown_verdicts):
        assert 'Is the difference real' in report(matrix)
        assert line.split(' [')[0].replace('_', '') in report(matrix).replace('\\', '').replace(
            '_', ''
        )
    told = [one.to_dict() for one in differences(matrix)]
    assert len(told) == 2 + 2 * 11
    json.dumps(without_nan(told), allow_nan=False)


def test_one_system_is_compared_with_nothing(result):
    matrix = suite(result, np.random.default_rng(6), {'A': 1.0})
    assert differences(matrix) == ()
    assert text_verdicts(matrix) == markdown_verdicts(matrix) == html_verdicts(matrix) == ''
