"""The matrix of sequences x systems: medians, failures, ranks, means and decimals."""

import math
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from vio_eval_ros.comparison.matrix import Cell, CellRun, Matrix

ATE = 'ate_trans_rmse_m'
LOST = 'tracked_ratio is 0.4'


def run(ate: float, failure: str = '', metric: str = ATE) -> CellRun:
    result = SimpleNamespace(summary=SimpleNamespace(metrics={metric: ate}))
    return CellRun('run', result, failure)


def unread() -> CellRun:
    return CellRun('run', None, 'there is no such file')


def matrix(rows: dict[str, dict[str, list[CellRun]]], metric: str = ATE) -> Matrix:
    cells = {(s, name): Cell(tuple(of)) for s, row in rows.items() for name, of in row.items()}
    return Matrix(tuple(rows), tuple(next(iter(rows.values()))), (metric,), cells)


def test_the_best_and_the_second_are_named_and_a_third_is_not():
    found = matrix({'V1': {'a': [run(0.3)], 'b': [run(0.1)], 'c': [run(0.2)]}})
    assert found.best(ATE, 'V1') == ('b',)
    assert found.second(ATE, 'V1') == ('c',)
    assert found.ranks(ATE, 'V1') == {'a': 3, 'b': 1, 'c': 2}


def test_a_lost_track_never_wins_and_is_shown_all_the_same():
    found = matrix({'V1': {'a': [run(0.3)], 'b': [run(0.01, LOST)], 'c': [run(0.2)]}})
    assert found.best(ATE, 'V1') == ('c',)
    assert found.cell('V1', 'b').value(ATE) == 0.01
    assert not found.stands(ATE, 'V1', 'b')
    assert list(found.failures()) == [('V1', 'b', 'run', LOST)]


def test_a_failed_run_counts_as_the_worst_of_the_runs():
    cell = Cell((run(0.1), run(0.2), unread()))
    assert cell.stands(ATE)
    assert cell.value(ATE) == 0.2
    assert list(cell.failures(ATE)) == [('run', 'there is no such file')]


def test_a_cell_in_which_half_of_the_runs_failed_has_failed():
    assert not Cell((run(0.1), unread())).stands(ATE)
    assert Cell((run(0.1), unread())).value(ATE) == 0.1
    assert math.isnan(Cell((unread(),)).value(ATE))


def test_a_failed_run_is_the_worst_also_where_more_is_better():
    ratio = 'coverage_ratio'
    runs = [run(v, metric=ratio) for v in (0.9, 0.95)] + [run(0.99, LOST, metric=ratio)]
    assert Cell(tuple(runs)).value(ratio) == 0.9
    found = matrix(
        {'V1': {'a': [run(0.9, metric=ratio)], 'b': [run(0.95, metric=ratio)]}}, metric=ratio
    )
    assert found.best(ratio, 'V1') == ('b',)


def test_where_neither_more_nor_less_is_worse_nothing_is_best():
    scale = 'sim3_scale'
    row = {'V1': {'a': [run(1.0, metric=scale)], 'b': [run(5.0, metric=scale)]}}
    found = matrix(row, metric=scale)
    assert found.best(scale, 'V1') == ()
    assert math.isnan(found.mean_rank(scale, 'a'))


def test_what_looks_the_same_shares_its_place():
    found = matrix({'V1': {'a': [run(0.10001)], 'b': [run(0.1)], 'c': [run(0.2)]}})
    assert found.best(ATE, 'V1') == ('a', 'b')
    assert found.second(ATE, 'V1') == ()
    assert found.ranks(ATE, 'V1') == {'a': 1.5, 'b': 1.5, 'c': 3}


def test_one_system_is_not_the_best_of_any():
    assert matrix({'V1': {'a': [run(0.1)]}}).best(ATE, 'V1') == ()


def test_the_mean_is_over_what_all_have_and_the_rank_over_all_sequences():
    found = matrix(
        {
            'V1': {'a': [run(0.1)], 'b': [run(0.2)], 'c': [unread()]},
            'V2': {'a': [run(0.3)], 'b': [unread()], 'c': [unread()]},
            'V3': {'a': [run(0.5)], 'b': [run(0.4)], 'c': [unread()]},
        }
    )
    assert found.common(ATE) == ('V1', 'V3')  # c, which stands nowhere, does not empty it
    assert math.isclose(found.mean(ATE, 'a'), 0.3)
    assert math.isclose(found.mean(ATE, 'b'), 0.3)
    assert math.isnan(found.mean(ATE, 'c'))
    assert found.mean_rank(ATE, 'a') == 4 / 3
    assert found.mean_rank(ATE, 'b') == (2 + 2.5 + 1) / 3
    assert found.places_of_ranks(ATE) == (('a',), ('b',))


def test_who_succeeded_nowhere_is_not_second_in_rank():
    found = matrix(
        {'V1': {'a': [run(0.1)], 'b': [unread()]}, 'V2': {'a': [run(0.1)], 'b': [unread()]}}
    )
    assert found.places_of_ranks(ATE) == ((), ())


def test_values_without_spread_have_the_decimals_of_the_smallest():
    found = matrix({'V1': {'a': [run(0.02234)], 'b': [run(3.4912345)]}})
    assert found.most_decimals[ATE] == 4
    assert found.rounded(ATE, 'V1', 'b') == 3.4912


def test_repeated_runs_show_no_more_than_their_standard_error_supports():
    rough = [run(v) for v in (0.10, 0.16, 0.22)]  # 0.16 +- 0.035
    fine = [run(v) for v in (0.12341, 0.12342, 0.12343)]
    same = [run(0.1234)] * 3
    found = matrix({'V1': {'rough': rough, 'fine': fine, 'same': same}})
    assert [found.decimals(ATE, 'V1', name) for name in found.systems] == [2, 3, 3]
    assert found.rounded(ATE, 'V1', 'rough') == 0.16


errors = st.floats(1e-4, 1e3)
cells = st.lists(st.tuples(errors, st.sampled_from(['', LOST])), min_size=1, max_size=5).map(
    lambda runs: [run(*one) for one in runs]
)
rows = st.fixed_dictionaries({name: cells for name in 'abcd'})


@given(rows, st.permutations('abcd'))
def test_the_order_of_the_systems_changes_nothing(row, order):
    one, other = matrix({'V1': row}), matrix({'V1': {name: row[name] for name in order}})
    assert one.ranks(ATE, 'V1') == other.ranks(ATE, 'V1')
    assert set(one.best(ATE, 'V1')) == set(other.best(ATE, 'V1'))
    assert set(one.second(ATE, 'V1')) == set(other.second(ATE, 'V1'))


@given(rows)
def test_ranks_are_shared_out_and_the_best_have_the_lowest(row):
    found = matrix({'V1': row})
    ranks = found.ranks(ATE, 'V1')
    assert not ranks or sum(ranks.values()) == 1 + 2 + 3 + 4
    for name in found.best(ATE, 'V1'):
        assert ranks[name] == min(ranks.values())
        assert found.stands(ATE, 'V1', name)


@given(cells, errors)
def test_one_more_failed_run_never_makes_a_cell_better(runs, error):
    before, after = Cell(tuple(runs)), Cell((*runs, run(error, LOST)))
    if after.stands(ATE):
        assert before.stands(ATE)
        assert after.value(ATE) >= before.value(ATE)
