"""A report is a value: its words, texts, page and JSON say the same."""

from dataclasses import replace
import json

import numpy as np
import pytest
import yaml

from vio_eval_ros.inspection.calibration import check_calibration
from vio_eval_ros.inspection.calibration_files import read_calibrations
from vio_eval_ros.inspection.expectations import Expectations
from vio_eval_ros.inspection.html_report import html_document
from vio_eval_ros.inspection.inspection import inspect_streams
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.report import json_document, Report
from vio_eval_ros.inspection.text_report import text_document


@pytest.fixture
def report(tmp_path, rig) -> Report:
    """Return the report of a rig with a gap, an unmet expectation and a calibration."""
    which = np.r_[0:1000, 1100:6000]
    imu = rig['imu']
    rig['imu'] = replace(
        imu,
        logged_ns=imu.logged_ns[which],
        stamps_ns=imu.stamps_ns[which],
        numbers=imu.numbers[which],
    )
    file = tmp_path / 'expect.yaml'
    file.write_text('streams:\n  cam: {topic: /cam0/image_raw, rate_hz: 30, level: warn}\n')
    camera = tmp_path / 'chain.yaml'
    camera.write_text(yaml.safe_dump({'cam0': {'T_imu_cam': np.eye(4).tolist()}}))
    inspection = inspect_streams(list(rig.values()), ['/lidar cannot be read'])
    return Report(
        source='run.mcap',
        inspection=inspection,
        expectations=Expectations.load(file).check(inspection),
        calibration=check_calibration(read_calibrations([camera]), inspection),
    )


def test_the_worst_of_each_topic_and_of_all_is_known(report):
    assert report.word == report.word_of('/imu0') == 'fail'
    assert report.word_of('/cam0/image_raw') == 'warn'
    assert report.word_of('/vicon/pose') == 'pass'
    assert [one.stream.topic for one in report.streams][:2] == ['/imu0', '/cam0/image_raw']
    assert report.warnings == [
        'gap /imu0: silent once, for up to 0.505 s; 100 messages are missing',
        'cam rate_hz: expected 30 Hz ± 1 %, measured 20 Hz',
    ]


def test_names_decide_whether_a_report_has_failed(report):
    assert not report.has_failed()  # the expectation only warns
    assert not report.has_failed(['stuck'])
    assert report.has_failed(['stuck', 'gap'])
    assert report.has_failed(['left_out'])  # which is never worse than info


def test_the_text_has_streams_facts_expectations_findings_and_calibration(report):
    lines = text_document(report).splitlines()
    assert lines[2].split()[:3] == ['fail', '/imu0', 'Imu']
    assert 'fail  gap /imu0: silent once, for up to 0.505 s; 100 messages are missing' in lines
    assert 'warn  cam rate_hz: expected 30 Hz ± 1 %, measured 20 Hz' in lines
    assert 'info  left_out: /lidar cannot be read' in lines
    assert any(line.startswith('IMU samples per image  10') for line in lines)
    assert any('T_imu_cam maps cam0 into the IMU' in line for line in lines)
    assert not any('nothing is wrong' in line for line in lines)


def test_the_page_has_what_the_text_has(report, parsed):
    content = parsed(html_document(report))
    for words in (
        '100 messages are missing',
        'expected 30 Hz ± 1 %, measured 20 Hz',
        'T_imu_cam maps cam0 into the IMU',
        '/lidar cannot be read',
        'IMU samples per image',
    ):
        assert words in content.text
    # the timeline, and the periods of two cameras, an IMU and poses
    assert len(content.figures) == 1 + 4


def test_a_page_without_findings_says_so(rig):
    page = html_document(Report('run', inspect_streams(list(rig.values()))))
    assert 'Nothing is wrong with the streams.' in page


def test_the_json_has_the_profile_and_every_limit(report):
    document = json.loads(json_document(report))
    assert document == json.loads(json.dumps(report.to_dict()))
    assert document['profile'] == 'drone'
    assert document['limits'] == InspectionLimits().to_dict()
    assert document['counts'] == {'info': 1, 'warn': 0, 'fail': 1}
    assert [one['word'] for one in document['expectations']] == ['pass', 'warn']
    assert document['findings'][0]['unit'] == 's'


def test_a_limit_decides_what_is_found(rig):
    streams = list(rig.values())
    strict = inspect_streams(streams, limits=InspectionLimits(imu_samples_per_frame=20))
    assert [(one.name, one.level) for one in strict.findings] == [('imu_rate', 'warn')]
    assert strict.findings[0].message.endswith('most estimators need a factor of 20 or more')
    fast = replace(rig['pose'], numbers=rig['pose'].numbers * ([10] * 3 + [1] * 4))
    indoor = inspect_streams([fast], limits=InspectionLimits.of('indoor_robot'))
    assert {one.name for one in indoor.findings} == {'implausible_motion'}
    assert inspect_streams([fast]).findings == []
