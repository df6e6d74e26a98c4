"""A gate passes only on a number that keeps its limit; no number never passes."""

import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from vio_eval_ros.core.gates import check_names, Gate, judge
from vio_eval_ros.errors import ConfigError

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.parametrize(
    ('text', 'gate'),
    [
        ('ate_trans_rmse_m<=0.1', Gate('ate_trans_rmse_m', '<=', 0.1)),
        (' coverage_ratio >= 95e-2 ', Gate('coverage_ratio', '>=', 0.95)),
        ('drift_percent<=-1', Gate('drift_percent', '<=', -1)),
    ],
)
def test_a_gate_is_a_metric_and_a_limit(text, gate):
    assert Gate.parse(text) == gate
    assert Gate.parse(str(gate)) == gate


@given(FINITE, st.sampled_from(['<=', '>=']))
def test_a_gate_is_written_as_it_is_read(limit, comparison):
    gate = Gate('ate_trans_rmse_m', comparison, limit)
    assert Gate.parse(str(gate)) == gate


@pytest.mark.parametrize(
    'text',
    [
        '',
        'ate',
        'ate<0.1',
        'ate=0.1',
        'ate==0.1',
        '<=0.1',
        'ate<=',
        'ate<=fast',
        'ate<=nan',
        'ate<=inf',
        '0<=ate<=1',
        'a b<=1',
    ],
)
def test_what_is_no_gate_is_refused(text):
    with pytest.raises(ConfigError, match='gate'):
        Gate.parse(text)


def test_a_file_of_gates_gives_each_bound_a_gate():
    assert Gate.from_mapping({'ate': {'max': 0.1}, 'coverage': {'min': 0.9, 'max': '1'}}) == [
        Gate('ate', '<=', 0.1),
        Gate('coverage', '>=', 0.9),
        Gate('coverage', '<=', 1.0),
    ]
    assert Gate.from_mapping({}) == []


@pytest.mark.parametrize(
    'limits',
    [
        0.1,
        None,
        {},
        [0.1],
        {'maximum': 1},
        {'max': None},
        {'max': True},
        {'max': math.nan},
        {'max': 1, 'mean': 2},
    ],
)
def test_a_file_of_something_else_is_refused(limits):
    with pytest.raises(ConfigError, match='gate ate'):
        Gate.from_mapping({'ate': limits})


@given(FINITE, FINITE)
def test_a_limit_is_kept_by_itself_and_what_is_on_the_right_side(value, limit):
    assert Gate('m', '<=', limit).passes(value) == (value <= limit)
    assert Gate('m', '>=', limit).passes(value) == (value >= limit)
    assert Gate('m', '<=', limit).passes(limit)
    assert Gate('m', '>=', limit).passes(limit)


@pytest.mark.parametrize('comparison', ['<=', '>='])
def test_no_number_never_passes(comparison):
    (verdict,) = judge([Gate('m', comparison, 0.0)], {'m': math.nan})
    assert verdict.passed is False
    assert math.isnan(verdict.value)


def test_each_gate_gets_its_own_verdict():
    gates = [Gate('a', '<=', 1.0), Gate('b', '>=', 1.0)]
    assert [(v.gate.metric, v.value, v.passed) for v in judge(gates, {'a': 2.0, 'b': 2.0})] == [
        ('a', 2.0, False),
        ('b', 2.0, True),
    ]


def test_a_gate_on_a_metric_that_there_is_not_gets_the_nearest_name():
    check_names([Gate('ate_rmse', '<=', 1)], ['ate_rmse'])
    with pytest.raises(ConfigError, match=r"no metric 'ate_rsme'.*did you mean 'ate_rmse'\?"):
        check_names([Gate('ate_rsme', '<=', 1)], ['ate_rmse', 'coverage_ratio'])


def test_a_limit_to_warn_at_goes_in_the_direction_of_the_other():
    fail, warn = Gate.from_mapping({'ate_trans_rmse_m': {'max': 0.3, 'warn': 0.2}})
    assert fail == Gate('ate_trans_rmse_m', '<=', 0.3)
    assert warn == Gate('ate_trans_rmse_m', '<=', 0.2, 'warn')
    words = [v.word for v in judge([fail, warn], {'ate_trans_rmse_m': 0.25})]
    assert words == ['pass', 'warn']
    _, floor = Gate.from_mapping({'coverage_ratio': {'min': 0.8, 'warn': 0.9}})
    assert floor == Gate('coverage_ratio', '>=', 0.9, 'warn')


@pytest.mark.parametrize(
    ('bounds', 'problem'),
    [
        ({'warn': 0.2}, 'warn needs either max or min'),
        ({'max': 0.3, 'min': 0.1, 'warn': 0.2}, 'warn needs either max or min'),
        ({'max': 0.3, 'warn': 0.4}, 'is beyond the limit that fails a run'),
        ({'max': 0.3, 'warning': 0.2}, 'and warn: number beside only one of them'),
    ],
)
def test_a_warning_that_makes_no_sense_is_refused(bounds, problem):
    with pytest.raises(ConfigError, match=problem):
        Gate.from_mapping({'ate_trans_rmse_m': bounds})
