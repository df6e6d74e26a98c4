"""Every example in docs/formats.md is read, and shows the same poses."""

from pathlib import Path
import re
import warnings

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros import read
from vio_eval_ros.core import rotation
from vio_eval_ros.errors import VioEvalError
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
DAMAGED = ('', 'nan', 'inf', '1e400', '-', 'x', '1e19', '\0', ';', '"', '\r', '\xff', '9' * 25)


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


@st.composite
def damages(draw: st.DrawFn) -> str:
    """Return an example of which some lines, cells or characters are not what they were."""
    lines = EXAMPLES[draw(st.sampled_from(sorted(EXAMPLES)))].split('\n')
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(lines) - 1))
        line, cells = lines[place], lines[place].split(',')
        cells[draw(st.integers(0, len(cells) - 1))] = draw(st.sampled_from(DAMAGED))
        cut = draw(st.integers(0, len(line)))
        changed = [line[:cut], ','.join(cells), line[:cut] + draw(st.sampled_from(DAMAGED)), '']
        changed.append(lines[draw(st.integers(0, len(lines) - 1))])
        lines[place] = draw(st.sampled_from(changed))
    return '\n'.join(lines)


@pytest.mark.slow
def test_a_damaged_example_is_read_or_an_error_of_one_line(tmp_path):
    (tmp_path / TIMES).write_text(EXAMPLES[TIMES])

    @settings(max_examples=300, derandomize=True, deadline=None, database=None)
    @given(text=damages(), has_times=st.booleans())
    def check(text: str, has_times: bool) -> None:
        (tmp_path / 'damaged.csv').write_bytes(text.encode())
        with warnings.catch_warnings():
            warnings.simplefilter('error')
            try:
                read(tmp_path / 'damaged.csv', times=tmp_path / TIMES if has_times else None)
                said = ''
            except VioEvalError as error:
                said = str(error)
        assert '\n' not in said

    check()


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
