"""docs/diagnose.md has the causes, limits and profiles of the code, values included."""

from pathlib import Path

from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.limits import CHANGES, DiagnosisLimits

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / 'docs' / 'diagnose.md'
LIMITS = DiagnosisLimits().to_dict()
# limits that decide of every cause, or of none
GENERAL_LIMITS = {'shortest_s', 'confidence_percent', 'improvement_percent', 'inertial'}


def test_every_cause_is_in_the_table_and_among_what_faults_look_like():
    text = DOCUMENT.read_text()
    for name in CAUSES:
        assert text.count(f'\n| `{name}` |') == 2, name


def test_every_limit_is_that_of_a_cause():
    used = {name for cause in CAUSES.values() for name in cause.limits}
    assert used == LIMITS.keys() - GENERAL_LIMITS


def test_profiles_change_limits_that_there_are_and_say_why():
    assert CHANGES.keys() <= set(PROFILES)
    assert DiagnosisLimits.of('drone') == DiagnosisLimits()
    for profile, changes in CHANGES.items():
        limits = DiagnosisLimits.of(profile)
        for name, (value, reason) in changes.items():
            assert getattr(limits, name) == value != LIMITS[name]
            assert reason
