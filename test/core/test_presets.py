"""The defaults of other tools: which options they are, and the rules that they need."""

import math

from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core.config import Delta, EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation, metric_names
from vio_eval_ros.core.presets import PRESETS
from vio_eval_ros.core.relative import candidates
from vio_eval_ros.core.steps import distances
from vio_eval_ros.errors import ConfigError

paths = st.lists(st.floats(0.01, 3.0), min_size=2, max_size=60).map(
    lambda steps: np.concatenate([[0.0], np.cumsum(steps)])
)


@pytest.mark.parametrize('tool', PRESETS)
def test_a_preset_is_made_of_options_and_given_ones_override_it(tool):
    assert EvaluationConfig.from_mapping({'as': tool}) == EvaluationConfig(**PRESETS[tool])
    changed = EvaluationConfig.from_mapping({'as': tool, 'alignment': 'origin'})
    assert changed == EvaluationConfig(**{**PRESETS[tool], 'alignment': 'origin'})


def test_an_unknown_tool_is_refused_with_the_nearest():
    with pytest.raises(ConfigError, match=r"as: 'ov_evall' .* did you mean 'ov_eval'"):
        EvaluationConfig.from_mapping({'as': 'ov_evall'})
    with pytest.raises(ConfigError, match="as: '3' is not one of evo"):
        EvaluationConfig.from_mapping({'as': 3})


def within(path: np.ndarray, length: float, tolerance: float) -> list[tuple[int, int]]:
    """Return from where to where segments lead, as rpg and ov_eval look for them."""
    found = []
    for i, begin in enumerate(path):
        off = [abs(place - begin - length) for place in path[i:]]
        best = min(range(len(off)), key=off.__getitem__)
        if best and off[best] < tolerance:
            found.append((i, i + best))
    return found


@given(paths, st.sampled_from([2.0, 5.0, 8.0]), st.sampled_from(['rpg', 'ov_eval']))
@settings(max_examples=150)
def test_segments_end_within_the_tolerance_of_the_tool(path, length, tool):
    config = EvaluationConfig.from_mapping({'as': tool})
    tolerance = 0.2 * length if tool == 'rpg' else 0.5
    off = np.abs(path - path[:, None] - length)
    assume(np.abs(off - tolerance).min() > 1e-5)  # just at it, the tools leave a segment out
    found = candidates(path, Delta(length, 'm'), config)
    pairs = zip(found.begin[found.usable].tolist(), found.end[found.usable].tolist(), strict=True)
    assert list(pairs) == within(path, length, tolerance)


@pytest.mark.parametrize(
    ('text', 'delta', 'metres'),
    [('10%', '8m', 0.8), ('0.5', '8m', 0.5), ('0', '8m', 0), ('10%', '3f', 0), ('5', '3f', 0)],
)
def test_a_tolerance_is_a_share_or_in_the_unit_of_the_delta(text, delta, metres):
    assert Delta.parse(delta).tolerance(text) == pytest.approx(metres)


@pytest.mark.parametrize('text', ['', '%', '-1', '10 %', '1m', 'nan', '1e3'])
def test_a_tolerance_that_is_none_is_refused(text):
    with pytest.raises(ConfigError, match='rpe_tolerance'):
        EvaluationConfig(rpe_tolerance=text)


def test_shares_of_the_path_become_whole_centimetres():
    config = EvaluationConfig(rpe_deltas=['10%', '1f', '33%']).of_path(97.589)
    assert config.rpe_deltas == ('9.75m', '1f', '32.2m')
    assert not config.needs_path
    assert Delta.parse('10%').of_path(0.05) == Delta(0.005, 'm')
    with pytest.raises(ConfigError, match='no part of the path'):
        Delta.parse('101%')


def test_a_share_of_the_path_is_not_known_while_it_grows():
    config = EvaluationConfig(rpe_deltas=['10%', '1s'])
    with pytest.raises(ConfigError, match='known only once a run is over; give metres'):
        Evaluation(config)
    assert 'rpe_1s_trans_rmse_m' in metric_names(config)
    assert not any('%' in name for name in metric_names(config))


def test_path_lengths_are_those_of_steps():
    positions = np.array([[0.0, 0, 0], [3.0, 4, 0], [3.0, 4, 12]])
    assert distances(positions).tolist() == [0, 5, 17]
    assert math.isclose(Delta.parse('50%').of_path(17.0).value, 8.5)
