"""A baseline is read as it was written; other conditions than those of now are named."""

from dataclasses import replace
import hashlib
import json
from pathlib import Path

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.scoring import baseline as baselines
from vio_eval_ros.scoring.baseline import Baseline, BaselineSequence, definition_sha256

BEFORE = [0.10, 0.11, 0.09, 0.105, 0.095]
OPTIONS = EvaluationConfig().to_dict()
RECORDED = BaselineSequence(OPTIONS, 'ab' * 32, {'ate_trans_rmse_m': tuple(BEFORE)}, '/truth')


@pytest.fixture
def baseline() -> Baseline:
    return Baseline(definition_sha256(), {'V1_02': RECORDED})


def test_a_baseline_is_read_as_it_was_written(baseline, tmp_path):
    (tmp_path / 'baseline.json').write_text(baseline.to_json())
    assert Baseline.load(tmp_path / 'baseline.json') == baseline
    content = json.loads(baseline.to_json())['sequences']['V1_02']
    assert content['metrics']['ate_trans_rmse_m'] == {
        'values': BEFORE,
        'median': 0.1,
        'mad': pytest.approx(0.005),
    }


def test_a_baseline_may_have_a_sequence_of_which_nothing_was_scored(tmp_path):
    empty = Baseline({}, {'V1_02': BaselineSequence(OPTIONS)})
    (tmp_path / 'baseline.json').write_text(empty.to_json())
    assert Baseline.load(tmp_path / 'baseline.json') == empty


def _damaged(text: str, tmp_path: Path) -> str:
    (tmp_path / 'baseline.json').write_text(text)
    with pytest.raises(ReadError) as raised:
        Baseline.load(tmp_path / 'baseline.json')
    assert '\n' not in str(raised.value)
    return str(raised.value)


def test_a_truncated_baseline_is_damaged_wherever_it_ends(baseline, tmp_path):
    whole = baseline.to_json().rstrip()
    for end in range(0, len(whole), 97):
        assert 'is not a baseline, or is damaged' in _damaged(whole[:end], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('old', 'new', 'problem'),
    [
        ('baseline/1', 'baseline/2', 'has the schema vio_eval_ros.baseline/2, not vio_eval_ros.b'),
        ('"values"', '"value"', 'is damaged'),
        ('0.11', 'NaN', 'ate_trans_rmse_m has no values, or invalid ones'),
        ('0.11', '"low"', 'ate_trans_rmse_m has no values, or invalid ones'),
        ('0.11', '[[]]', 'ate_trans_rmse_m has no values, or invalid ones'),
        ('"options": {', '"options": 3, "more": {', 'is damaged'),
        ('"sequences": {', '"sequences": [], "more": {', 'is damaged'),
        ('"definition_sha256": {', '"definition_sha256": "00", "more": {', 'is damaged'),
    ],
)
def test_a_damaged_baseline_is_refused_in_one_line(baseline, tmp_path, old, new, problem):
    assert old in baseline.to_json()
    assert problem in _damaged(baseline.to_json().replace(old, new), tmp_path)


@pytest.mark.parametrize('text', ['', 'null', '[]', '3', '{}', '[' * 100_000, '\ufeff{}'])
def test_what_is_no_baseline_is_refused(tmp_path, text):
    assert 'is not a baseline, or is damaged' in _damaged(text, tmp_path)


def test_a_baseline_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ReadError, match='No such file'):
        Baseline.load(tmp_path / 'baseline.json')
    with pytest.raises(ReadError, match='Is a directory'):
        Baseline.load(tmp_path)


def test_the_same_conditions_are_no_difference(baseline):
    assert baseline.check({'V1_02': RECORDED, 'new': RECORDED}) == []


OTHERS = {
    'options': (
        replace(RECORDED, options=OPTIONS | {'alignment': 'sim3'}),
        'V1_02: alignment was se3, now sim3',
    ),
    'ground_truth': (
        replace(RECORDED, ground_truth_sha256='cd' * 32),
        'V1_02: the ground truth has changed',
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize('condition', OTHERS)
def test_another_condition_is_an_error_that_says_which(baseline, condition):
    now, problem = OTHERS[condition]
    with pytest.raises(ConfigError) as raised:
        baseline.check({'V1_02': now})
    assert problem in str(raised.value)
    assert f'--accept {condition}' in str(raised.value)
    assert baseline.check({'V1_02': now}, [condition]) == [problem]
    with pytest.raises(ConfigError):
        baseline.check({'V1_02': now}, ['definition'])


def test_options_that_only_one_of_the_two_has_are_a_difference_too(baseline):
    more, less = OPTIONS | {'gravity': 9.81}, OPTIONS.copy()
    del less['alignment']
    for options, problem in ((more, 'gravity was None, now 9.81'), (less, 'alignment was se3')):
        with pytest.raises(ConfigError, match=problem):
            baseline.check({'V1_02': replace(RECORDED, options=options)})


def test_the_same_difference_in_several_sequences_is_reported_once():
    two = Baseline(definition_sha256(), {'a': RECORDED, 'b': RECORDED})
    now, _ = OTHERS['options']
    assert two.check({'a': now, 'b': now}, ['options']) == ['a, b: alignment was se3, now sim3']


def test_a_baseline_that_does_not_say_how_the_truth_was_read_has_no_difference(baseline, tmp_path):
    assert '"ground_truth": "/truth",' in baseline.to_json()
    text = baseline.to_json().replace('"ground_truth": "/truth",', '')
    (tmp_path / 'baseline.json').write_text(text)
    assert Baseline.load(tmp_path / 'baseline.json').check({'V1_02': RECORDED}) == []
    other = replace(RECORDED, ground_truth='/truth?invert=pose')
    problem = "V1_02: the ground truth was '/truth', now '/truth?invert=pose'"
    assert baseline.check({'V1_02': other}, ['ground_truth']) == [problem]


def test_where_nothing_was_scored_the_ground_truth_is_not_known_to_differ(baseline):
    assert baseline.check({'V1_02': BaselineSequence(OPTIONS)}) == []


@pytest.mark.slow
def test_another_definition_of_a_metric_is_an_error_that_says_of_which(baseline):
    meant = definition_sha256()
    problem = 'ate_trans_rmse_m, sim3_scale had another definition'
    other = replace(
        baseline, definition_sha256=meant | {'ate_trans_rmse_m': '00', 'sim3_scale': '00'}
    )
    with pytest.raises(ConfigError, match=f'{problem}.* --accept definition'):
        other.check({'V1_02': RECORDED})
    assert other.check({}, ['definition']) == [problem]
    all_others = replace(baseline, definition_sha256=dict.fromkeys(meant, '00'))
    (text,) = all_others.check({}, ['definition'])
    assert text.endswith(f' and {len(meant) - 3} more had another definition')


def test_metrics_that_only_one_version_has_are_no_other_definition(baseline):
    meant = definition_sha256()
    more = replace(baseline, definition_sha256=meant | {'a_metric_of_before': '00'})
    less = replace(baseline, definition_sha256={'sim3_scale': meant['sim3_scale']})
    assert more.check({}) == less.check({}) == []


def test_every_metric_has_a_fingerprint_whatever_its_delta_or_length():
    config = EvaluationConfig(
        rpe_deltas=('3f', '2.5s', '10m', '15d'), segment_lengths_m=(100.0, 12.5)
    )
    assert {baselines.family(name) for name in metric_names(config)} <= definition_sha256().keys()
    assert baselines.family('rpe_2.5s_trans_rmse_m') == 'rpe_*s_trans_rmse_m'
    assert baselines.family('segment_100m_trans_percent') == 'segment_*m_trans_percent'
    assert baselines.family('ate_trans_rmse_m') == 'ate_trans_rmse_m'


def test_no_fingerprint_is_of_nothing():
    nothing = hashlib.sha256(' '.join(['nan'] * 8).encode()).hexdigest()
    assert nothing not in definition_sha256().values()


def test_the_definition_changes_with_what_a_metric_means(monkeypatch):
    before = definition_sha256()
    assert definition_sha256() == before
    monkeypatch.setattr('vio_eval_ros.core.metrics.np.degrees', lambda radians: radians)
    others = {name for name, digest in definition_sha256().items() if digest != before[name]}
    assert 'ate_rot_rmse_deg' in others
    assert 'ate_trans_rmse_m' not in others
