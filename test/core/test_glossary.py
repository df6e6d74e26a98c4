"""The glossary: each metric once, in words that reports and help use."""

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.glossary import GLOSSARY, in_words, listed, term_of
from vio_eval_ros.live import timeliness
from vio_eval_ros.live.processes import Usage

NAMES = [
    *metric_names(
        EvaluationConfig(segment_lengths_m=(100, 0.5), rpe_deltas=('1f', '0.5s', '10m', '15d'))
    ),
    *timeliness.NAMES,
    *Usage('vins_node').names,
]


@pytest.mark.parametrize('name', NAMES)
def test_each_metric_is_one_term(name):
    assert [term.name for term in GLOSSARY if term.pattern.fullmatch(name)] == [term_of(name).name]


def test_each_term_is_a_metric():
    unused = [t.name for t in GLOSSARY if not any(t.pattern.fullmatch(name) for name in NAMES)]
    assert unused == []
    assert all(term.name in listed() for term in GLOSSARY)


@pytest.mark.parametrize(
    ('metric', 'words'),
    [
        ('ate_trans_p95_m', 'ATE of position [m]'),
        ('ate_none_trans_rmse_m', 'ATE of position without alignment [m]'),
        ('ate_sim3_trans_rmse_m', 'ATE of position under sim3 [m]'),
        ('rpe_0.5s_rot_max_deg', 'RPE of rotation over 0.5s [deg]'),
        ('segment_100m_trans_percent', 'drift of position over 100m [%]'),
        ('success_rate', 'success_rate'),
    ],
)
def test_what_varies_is_said_in_words(metric, words):
    assert in_words(metric) == words
