"""Every example in docs/formats.md is read, and shows the same poses."""

from pathlib import Path
import re

import numpy as np
import pytest

from vio_eval_ros import read
from vio_eval_ros.core import rotation
from vio_eval_ros.recordings.messages import CONVERTERS
from vio_eval_ros.recordings.spec import Spec, STATEMENTS

FORMATS = (Path(__file__).resolve().parents[1] / 'docs' / 'formats.md').read_text()
EXAMPLES = dict(re.findall(r'```text (\S+)\n(.*?)```', FORMATS, re.DOTALL))
TIMES = 'times.txt'
#: which stamps count from the start of a recording or of a device
RELATIVE = ('trial.csv', 'take.csv', 'run_6D.tsv', 'vehicle_odometry_0.csv')
#: whose positions are relative to the first
LOCAL = ('gnss.csv',)
#: of which there are no orientations
POSITIONS = ('positions.txt', 'gnss.csv')


def example(folder: Path, name: str):
    """Return what is read of an example, and of the first one."""
    for each in (name, TIMES, 'tum.txt'):
        (folder / each).write_text(EXAMPLES[each])
    times = folder / TIMES if name == 'poses.txt' else None
    return read(folder / name, times=times), read(folder / 'tum.txt')


@pytest.mark.parametrize('name', [name for name in EXAMPLES if name != TIMES])
def test_every_example_is_read_as_the_same_poses(tmp_path, name):
    found, right = example(tmp_path, name)
    assert len(found) == 4
    shift = right.positions[0] - found.positions[0] if name in LOCAL else 0
    np.testing.assert_allclose(found.positions + shift, right.positions, atol=1e-3)
    moved = right.stamps_ns[0] - found.stamps_ns[0] if name in RELATIVE else 0
    np.testing.assert_array_equal(found.stamps_ns + moved, right.stamps_ns)
    assert (found.rotations is None) == (name in POSITIONS)
    if found.rotations is not None:
        angles = rotation.angle_between(
            *map(rotation.normalize, (found.rotations, right.rotations))
        )
        assert angles.max() < 1e-4


def test_there_is_an_example_of_every_layout():
    assert len(EXAMPLES) >= 18


def test_every_statement_is_explained_and_every_spec_that_is_shown_is_one():
    for name in STATEMENTS['file'] | STATEMENTS['topic']:
        assert f'`?{name}=' in FORMATS
    specs = re.findall(r"`'?([\w./]*\?[a-z]+=[\w,&=]+)'?`", FORMATS)
    assert len(specs) > 10
    for spec in specs:
        of_topic = 'recorded' in spec or 'revision' in spec
        text = spec if not spec.startswith('?') else ('/topic' if of_topic else 'file.txt') + spec
        assert Spec.parse(text).statements


def test_every_message_type_is_listed():
    assert not [name for name in CONVERTERS if f'`{name}`' not in FORMATS]
