"""A recording is inspected in one call, by name."""

from pathlib import Path

import pytest

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.recording import inspect_recording

FLIGHT = Path(__file__).resolve().parents[2] / 'demo' / 'simulated_flight'


@pytest.mark.slow
def test_a_recording_is_inspected_by_the_limits_of_its_platform():
    report = inspect_recording(FLIGHT, profile='car')
    assert (report.source, report.profile) == (str(FLIGHT), 'car')
    assert report.inspection.limits == InspectionLimits.of('car')
    assert report.to_dict()['limits']['lever_arm_m'] == 6.0
    assert {one.stream.kind for one in report.streams} >= {'pose'}
    assert report.calibration is None
    own = InspectionLimits(jump_m=1.0)
    assert inspect_recording(FLIGHT, limits=own).inspection.limits == own


def test_what_cannot_be_inspected_is_an_error(tmp_path):
    with pytest.raises(ReadError, match='there is no such file'):
        inspect_recording(tmp_path / 'no.bag')
    with pytest.raises(ConfigError, match="profile: 'boat' is not one of"):
        inspect_recording(FLIGHT, profile='boat')
    with pytest.raises(ReadError, match=r'there is no sensor\.yaml in it'):
        inspect_recording(FLIGHT, [tmp_path])
