"""docs/inspect.md has the findings, limits and profiles of the code, values included."""

from pathlib import Path
import re
from string import Formatter

import pytest

from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.inspection.expectations import PAIR_KEYS, STREAM_KEYS
from vio_eval_ros.inspection.finding import FindingKind, LEVELS
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import CHANGES, InspectionLimits

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / 'docs' / 'inspect.md'
LIMITS = InspectionLimits().to_dict()
# limits that no finding states, since they only refine when one is made
SILENT_LIMITS = {
    'rate_tolerance_percent', 'latency_min_s', 'still_rate_rad_s', 'still_acceleration_m_s2',
}  # fmt: skip


def test_every_key_of_an_expectation_is_in_the_document():
    text = DOCUMENT.read_text()
    for key in (*STREAM_KEYS, *PAIR_KEYS):
        assert re.search(rf'\b{key}\b', text), key


@pytest.mark.parametrize('kind', FINDINGS.values(), ids=list(FINDINGS))
def test_an_entry_is_complete(kind: FindingKind):
    assert kind.level in LEVELS
    assert kind.in_poses in ('', *LEVELS)
    assert set(kind.limits) <= LIMITS.keys()
    assert len((kind.when + kind.severe).format(**LIMITS).split()) < 60
    texts = [kind.evidence] if isinstance(kind.evidence, str) else kind.evidence.values()
    for text in texts:
        assert all(name != '' for _, name, _, _ in Formatter().parse(text)), 'fields have names'
    assert kind.advice[0].isupper()
    assert kind.advice.endswith('.')


def test_every_limit_is_that_of_a_finding():
    used = {name for kind in FINDINGS.values() for name in kind.limits}
    assert used == LIMITS.keys() - SILENT_LIMITS


def test_profiles_change_limits_that_there_are_and_say_why():
    assert CHANGES.keys() <= set(PROFILES)
    assert InspectionLimits.of('drone') == InspectionLimits()
    for profile, changes in CHANGES.items():
        limits = InspectionLimits.of(profile)
        for name, (value, reason) in changes.items():
            assert getattr(limits, name) == value != LIMITS[name]
            assert reason
