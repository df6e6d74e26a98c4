"""Options come in as users write them, are refused by name, and go out as plain values."""

from dataclasses import fields, FrozenInstanceError
import json
import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from vio_eval_ros.core.config import ALIGNMENTS, Delta, EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.errors import ConfigError

IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def test_the_defaults_are_those_of_the_design():
    assert EvaluationConfig().to_dict() == {
        'association': 'nearest',
        'max_difference_s': 0.02,
        'max_gap_s': 0.5,
        'time_offset_s': 0.0,
        'alignment': 'se3',
        'align_first_s': 0.0,
        'rpe_deltas': ['1f', '1s', '10m'],
        'rpe_tolerance': '10%',
        'rpe_pairs': 'all',
        'segment_lengths_m': [],
        'start_s': 0.0,
        'end_s': None,
        'estimate_to_body': list(IDENTITY),
        'ground_truth_to_body': list(IDENTITY),
    }


@pytest.mark.parametrize('option', fields(EvaluationConfig), ids=lambda option: option.name)
def test_every_option_describes_itself(option):
    assert len(option.metadata['description']) > 15
    assert '\n' not in option.metadata['description']


def test_options_as_users_write_them_become_numbers_and_tuples():
    config = EvaluationConfig(
        max_gap_s='2', rpe_deltas='5f', segment_lengths_m=['100', 200], end_s='inf', start_s=3
    )
    assert config.max_gap_s == 2.0
    assert config.rpe_deltas == ('5f',)
    assert config.segment_lengths_m == (100.0, 200.0)
    assert config.end_s == math.inf
    assert isinstance(config.start_s, float)


@given(
    st.lists(st.floats(1e-9, 1e9).map(lambda x: f'{x:.20f}'.rstrip('0') + 'm'), max_size=3),
    st.lists(st.integers(1, 10**9).map(lambda n: f'{n}f'), max_size=3),
    st.lists(st.floats(1e-3, 1e6), max_size=3),
    st.sampled_from(ALIGNMENTS),
    st.sampled_from([None, 1.5]),
)
def test_options_survive_the_way_through_json(metres, frames, lengths, alignment, end_s):
    config = EvaluationConfig(
        rpe_deltas=metres + frames, segment_lengths_m=lengths, alignment=alignment, end_s=end_s
    )
    written = json.dumps(config.to_dict(), allow_nan=False)
    assert EvaluationConfig.from_mapping(json.loads(written)) == config
    # and what was asked for is what is measured
    asked = {(round(float(text[:-1]), 9), text[-1]) for text in metres + frames}
    assert {tuple(Delta.parse(text)) for text in config.rpe_deltas} == asked
    assert len({name for name in metric_names(config) if name.endswith('f_pairs')}) == len(
        set(frames)
    )


@pytest.mark.parametrize(
    ('text', 'delta'),
    [
        ('10f', (10, 'f')),
        ('1s', (1, 's')),
        ('0.5m', (0.5, 'm')),
        ('.5m', (0.5, 'm')),
        ('15d', (15, 'd')),
        ('2.f', (2, 'f')),
        ('1000000f', (1000000, 'f')),
    ],
)
def test_a_delta_is_a_number_and_a_unit(text, delta):
    assert Delta.parse(text) == delta
    assert Delta.parse(str(Delta.parse(text))) == delta


def test_a_delta_has_one_name_however_it_is_written():
    assert EvaluationConfig(rpe_deltas=['1.0f', '01f', '0.50s', '.5s']).rpe_deltas == (
        '1f',
        '0.5s',
    )


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('association', 'next'),
        ('association', 3),
        ('alignment', 'SE3'),
        ('alignment', None),
        ('rpe_pairs', ['all']),
        ('max_difference_s', -0.01),
        ('max_difference_s', math.nan),
        ('max_difference_s', math.inf),
        ('max_difference_s', 'wide'),
        ('max_difference_s', True),
        ('max_difference_s', None),
        ('max_difference_s', [0.1]),
        ('max_gap_s', 1e30),
        ('time_offset_s', -1e30),
        ('start_s', -1),
        ('end_s', 0),
        ('end_s', -math.inf),
        ('segment_lengths_m', [0]),
        ('segment_lengths_m', [-100]),
        ('segment_lengths_m', {'a': 1}),
        ('segment_lengths_m', 'long'),
        ('estimate_to_body', [0, 0, 0]),
        ('estimate_to_body', [0, 0, 0, 0, 0, 0, 0]),
        ('ground_truth_to_body', [1, 0, 0, 0, 0, 0, 1.02]),
        ('ground_truth_to_body', [0, 0, 0, 0, 0, 0, 'w']),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_by_the_name_of_its_option(name, value):
    with pytest.raises(ConfigError) as refused:
        EvaluationConfig(**{name: value})
    assert name.split('_s')[0] in str(refused.value)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize(
    'text',
    [
        '',
        '1',
        'f',
        '0f',
        '-1f',
        '1.5f',
        '1x',
        '1 s',
        '1e3m',
        'infs',
        'nanm',
        '1fm',
        '0.0s',
        5,
        None,
    ],
)
def test_what_is_no_delta_is_refused(text):
    with pytest.raises(ConfigError):
        EvaluationConfig(rpe_deltas=[text])


def test_a_mistyped_name_or_word_gets_the_nearest():
    with pytest.raises(ConfigError, match="unknown option 'aligment'; did you mean 'alignment'"):
        EvaluationConfig.from_mapping({'aligment': 'se3'})
    with pytest.raises(ConfigError, match=r"'SE3' is not one of none, .*did you mean 'se3'"):
        EvaluationConfig(alignment='SE3')
    with pytest.raises(ConfigError, match=r"'sim' is not one of none, .*did you mean 'sim3'"):
        EvaluationConfig(alignment='sim')


def test_a_start_after_the_end_is_refused():
    with pytest.raises(ConfigError, match='start_s: 10 is not before end_s: 10'):
        EvaluationConfig(start_s=10, end_s=10)


def test_options_cannot_change_under_an_evaluation():
    lengths = [100.0]
    config = EvaluationConfig(segment_lengths_m=lengths)
    lengths.append(200.0)
    assert config.segment_lengths_m == (100.0,)
    with pytest.raises(FrozenInstanceError):
        config.alignment = 'sim3'
