"""Expectations are checked when they are read, with the line of an error, and then met or not."""

from dataclasses import replace
import math
from pathlib import Path
import re

import numpy as np
import pytest
import yaml

from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.inspection.expectations import CheckedExpectation, Expectations, FIGURES
from vio_eval_ros.inspection.inspection import inspect_streams
from vio_eval_ros.inspection.limits import InspectionLimits

STREAM = 'streams:\n  cam:\n    topic: /cam0/image_raw\n'


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        (
            STREAM + '    rate_hs: 20\n',
            "line 4: there is no 'rate_hs' here; did you mean 'rate_hz'",
        ),
        (STREAM + '    rate_hz: fast\n', 'line 4: rate_hz: expected a number >= 0'),
        (STREAM + '    max_jitter_s: .nan\n', 'line 4: max_jitter_s: expected a number >= 0'),
        (STREAM + '    level: bad\n', "line 4: level: expected 'warn' or 'fail'"),
        (STREAM + '    up_axis: up\n', 'line 4: up_axis: expected one of +x, -x'),
        (STREAM + '    rate_tolerance: 0.1\n', 'line 4: rate_tolerance: goes with rate_hz'),
        ('streams:\n  cam:\n    rate_hz: 20\n', 'line 2: topic: expected the name of a topic'),
        ('streams:\n  cam: 3\n', 'line 2: cam: expected a mapping'),
        ('stream:\n  cam: 3\n', "line 1: there is no 'stream' here; did you mean 'streams'?"),
        ('{}', 'expected at least one stream under streams'),
        (STREAM + 'pairs:\n  a: {streams: [cam, dog]}\n', "line 5: there is no stream 'dog'"),
        (
            STREAM + 'pairs:\n  a: {streams: [cam]}\n',
            'line 5: streams: expected the names of two streams',
        ),
    ],
)
def test_what_makes_no_sense_is_reported_with_its_line(tmp_path, text, problem):
    file = tmp_path / 'expect.yaml'
    file.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(problem)):
        Expectations.load(file)


def checked(
    folder: Path,
    rig: dict[str, SensorStream],
    content: dict[str, object],
    limits: InspectionLimits | None = None,
) -> dict[tuple[str, str], CheckedExpectation]:
    file = folder / 'expect.yaml'
    file.write_text(yaml.safe_dump(content))
    found = Expectations.load(file).check(inspect_streams(list(rig.values()), limits=limits))
    return {(one.stream, one.check): one for one in found}


IMU = {
    'topic': '/imu0', 'rate_hz': 200, 'frame_id': 'frame', 'up_axis': '+z',
    'max_jitter_s': 0.001, 'max_gap_s': 0.01, 'max_missing_ratio': 0, 'max_latency_s': 0.05,
    'max_drift_ppm': 20, 'min_duration_s': 29, 'min_rotation_rad_s': 0.1,
    'min_acceleration_m_s2': 0.2, 'min_still_at_begin_s': 2,
}  # fmt: skip


def test_a_clean_rig_meets_every_expectation(tmp_path, rig):
    assert FIGURES.keys() < IMU.keys()
    pairs = {'stereo': {'streams': ['left', 'right'], 'max_skew_s': 0.001}}
    pairs['stereo']['max_unsynchronised_ratio'] = 0
    cameras = {'left': {'topic': '/cam0/image_raw'}, 'right': {'topic': '/cam1/image_raw'}}
    found = checked(tmp_path, rig, {'streams': {'imu': IMU, **cameras}, 'pairs': pairs})
    assert {one.word for one in found.values()} == {'pass'}
    assert {check for stream, check in found if stream == 'imu'} == {
        'findings', *IMU.keys() - {'topic'}
    }  # fmt: skip
    assert ('stereo', 'max_skew_s') in found


@pytest.mark.slow
@pytest.mark.parametrize(
    ('key', 'value', 'message'),
    [
        ('rate_hz', 210, 'expected 210 Hz ± 1 %, measured 200 Hz'),
        ('frame_id', 'imu', "expected frame 'imu', found 'frame'"),
        ('up_axis', '-x', r'expected -x, measured \+z'),
        ('min_duration_s', 60, 'expected at least 60 s, measured 30 s'),
        ('max_latency_s', 0.001, r'expected at most 0.001 s, measured 0.01\d* s'),
        ('min_rotation_rad_s', 2, r'expected at least 2 rad/s, measured 0.\d+ rad/s'),
    ],
)
@pytest.mark.parametrize('level', ['warn', 'fail'])
def test_what_is_not_met_says_what_was_expected_and_measured(
    tmp_path, rig, key, value, message, level
):
    stream = {'topic': '/imu0', key: value, 'level': level}
    found = checked(tmp_path, rig, {'streams': {'imu': stream}})
    assert found['imu', key].word == level
    assert re.fullmatch(message, found['imu', key].message)


def test_the_tolerance_of_a_rate_is_a_limit_unless_it_is_stated(tmp_path, rig):
    stream = {'topic': '/imu0', 'rate_hz': 210}
    limits = InspectionLimits(rate_tolerance_percent=6)
    found = checked(tmp_path, rig, {'streams': {'imu': stream}}, limits)
    assert found['imu', 'rate_hz'].word == 'pass'
    stream['rate_tolerance'] = 0.03
    found = checked(tmp_path, rig, {'streams': {'imu': stream}}, limits)
    assert found['imu', 'rate_hz'].message == 'expected 210 Hz ± 3 %, measured 200 Hz'


def test_what_cannot_be_determined_is_not_met(tmp_path, rig):
    rig['imu'] = replace(rig['imu'], numbers=rig['imu'].numbers[::-1] * [1, 1, 1, 50, 50, 50])
    moving = replace(rig['imu'], numbers=rig['imu'].numbers + np.arange(6000)[:, None])
    found = checked(tmp_path, {'imu': moving}, {'streams': {'imu': IMU}})
    assert found['imu', 'up_axis'].message == 'expected +z, cannot be determined: never at rest'
    camera = {'topic': '/cam0/image_raw', 'min_rotation_rad_s': 0.1}
    found = checked(tmp_path, rig, {'streams': {'cam': camera}})
    one = found['cam', 'min_rotation_rad_s']
    assert (one.word, one.to_dict()['value']) == ('fail', None)
    assert math.isnan(one.value)
    assert one.message == 'expected at least 0.1 rad/s, cannot be determined'


def test_topics_and_pairs_that_are_not_there_are_not_met(tmp_path, rig):
    content = {
        'streams': {'imu': {'topic': '/imu0'}, 'lidar': {'topic': '/points'}},
        'pairs': {'odd': {'streams': ['imu', 'lidar'], 'level': 'warn'}},
    }
    found = checked(tmp_path, rig, content)
    assert found['lidar', 'topic'].message == 'there are no messages on /points'
    assert found['odd', 'streams'].message == 'not two cameras that overlap in time'
    assert (found['lidar', 'topic'].word, found['odd', 'streams'].word) == ('fail', 'warn')


def test_a_failing_finding_is_not_expected(tmp_path, rig):
    numbers = rig['imu'].numbers.copy()
    numbers[7] = np.nan
    rig['imu'] = replace(rig['imu'], numbers=numbers)
    found = checked(tmp_path, rig, {'streams': {'imu': {'topic': '/imu0'}}})
    assert found['imu', 'findings'].message == 'expected no failing finding, found not_finite'


def test_times_of_recording_are_not_expected_where_there_are_none(tmp_path, rig):
    folder = {name: replace(stream, logged_ns=None) for name, stream in rig.items()}
    found = checked(tmp_path, folder, {'streams': {'imu': IMU}})
    assert not {('imu', 'max_latency_s'), ('imu', 'max_drift_ppm')} & found.keys()


def test_expectations_stand_beside_the_parameters_of_a_node(tmp_path, rig):
    content = {'inspect': {'ros__parameters': {'streams': {'imu': {'topic': '/imu0'}}}}}
    assert checked(tmp_path, rig, content)['imu', 'findings'].word == 'pass'
