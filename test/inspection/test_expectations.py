"""Expectations are checked when they are read, and errors have their line."""

import re

import pytest

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.inspection.expectations import Expectations

STREAM = 'streams:\n  cam:\n    topic: /cam0/image_raw\n'


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        (
            STREAM + '    rate_hs: 20\n',
            "line 4: there is no 'rate_hs' here; did you mean 'rate_hz'",
        ),
        (STREAM + '    rate_hz: fast\n', 'line 4: rate_hz: a number is expected'),
        (STREAM + '    max_jitter_s: .nan\n', 'line 4: max_jitter_s: a number is expected'),
        (STREAM + '    level: bad\n', "line 4: level: 'warn' or 'fail' is expected"),
        (STREAM + '    up_axis: up\n', 'line 4: up_axis: one of +x, -x'),
        (STREAM + '    rate_tolerance: 0.1\n', 'line 4: rate_tolerance: goes with rate_hz'),
        ('streams:\n  cam:\n    rate_hz: 20\n', 'line 2: topic: the name of a topic is expected'),
        ('streams:\n  cam: 3\n', 'line 2: cam: expected a mapping'),
        ('stream:\n  cam: 3\n', "line 1: there is no 'stream' here; did you mean 'streams'?"),
        ('{}', 'no streams are expected; name them under streams'),
        (STREAM + 'pairs:\n  a: {streams: [cam, dog]}\n', "line 5: there is no stream 'dog'"),
        (STREAM + 'pairs:\n  a: {streams: [cam]}\n', 'line 5: streams: the names of two streams'),
    ],
)
def test_what_makes_no_sense_is_told_with_its_line(tmp_path, text, problem):
    file = tmp_path / 'expect.yaml'
    file.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(problem)):
        Expectations.load(file)
