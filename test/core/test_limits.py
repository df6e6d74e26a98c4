"""Limits: defaults, profiles and what a user states, checked as options are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import pytest

from vio_eval_ros.core.limits import limit, Limits
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.settings import limits_of


@dataclass(frozen=True)
class Healthy(Limits):
    """Two limits, one of which depends on the platform."""

    PROFILED: ClassVar[Mapping[str, Mapping[str, float]]] = {'car': {'scale_percent': 1.0}}

    scale_percent: float = limit(3.0, '%', 'scale error', 'chosen for this test')
    gap_s: float = limit(0.5, 's', 'longest gap', 'chosen for this test')


def test_a_profile_changes_what_depends_on_the_platform():
    assert Healthy.of('drone') == Healthy()
    assert Healthy.of('car') == Healthy(scale_percent=1.0)
    assert Healthy.of('car', {'scale_percent': 2}).scale_percent == 2.0


def test_a_limit_is_described_with_unit_meaning_and_source():
    assert Healthy.described()[0] == (
        'scale_percent', 3.0, '%', 'scale error', 'chosen for this test'
    )  # fmt: skip
    assert Healthy.of('car').to_dict() == {'scale_percent': 1.0, 'gap_s': 0.5}


def test_a_wrong_profile_or_limit_is_an_error_that_says_what_there_is():
    with pytest.raises(ConfigError, match=r"profile: 'cra' is not one of .*did you mean 'car'"):
        Healthy.of('cra')
    with pytest.raises(
        ConfigError, match="there is no limit 'scale_pct' here; did you mean 'scale_percent'"
    ):
        Healthy.of('car', {'scale_pct': 1})
    with pytest.raises(ConfigError, match='gap_s: -1 is below 0'):
        Healthy.of('car', {'gap_s': -1})


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('diagnose: {gap_s: .nan}', "line 1: gap_s: 'nan' is not a finite number"),
        ('diagnose:\n  gap: 1', "line 2: there is no 'gap' here; did you mean 'gap_s'"),
        ('diagnse: {gap_s: 1}', "line 1: there is no 'diagnse' here; did you mean 'diagnose'"),
        ('diagnose: 3', 'line 1: diagnose: expected a mapping'),
    ],
)
def test_what_is_wrong_in_a_file_of_limits_is_named_with_its_line(tmp_path, text, message):
    path = tmp_path / 'limits.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        limits_of(Healthy, 'diagnose', 'drone', path)
    assert message in str(caught.value)


def test_a_file_replaces_limits_of_the_profile_for_its_verb_only(tmp_path):
    path = tmp_path / 'limits.yaml'
    path.write_text('diagnose: {gap_s: 2}\ninspect: {rate_percent: 1}\n')
    assert limits_of(Healthy, 'diagnose', 'car', path) == Healthy(scale_percent=1.0, gap_s=2.0)
    assert limits_of(Healthy, 'imu_noise', 'car', path) == Healthy.of('car')
