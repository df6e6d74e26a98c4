"""Whatever is written has the stamps and names that it should, and what is left out is said."""

from pathlib import Path
import re

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

from verbs import call, complaint, transcript
from vio_eval_ros.conversion.formats import FORMATS, Names
from vio_eval_ros.conversion.texts import times_beside
from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate, write_recording

RUN = simulate(duration_s=5)
DOCUMENT = (Path(__file__).resolve().parents[2] / 'docs' / 'convert.md').read_text()


def turning(stamps_ns: np.ndarray) -> Trajectory:
    random = np.random.default_rng(1)
    rotations = rotation.normalize(random.normal(size=(len(stamps_ns), 4)))
    return Trajectory(stamps_ns, random.normal(size=(len(stamps_ns), 3)), rotations)


@pytest.mark.parametrize('kind', ['tum', 'euroc', 'kitti'])
def test_stamps_before_zero_are_written_as_they_are(tmp_path, kind):
    stamps_ns = np.array([-1_500_000_001, -500_000_000, -1, 0, 250_000_000])
    path = tmp_path / f'a{FORMATS[kind].suffixes[0]}'
    FORMATS[kind].write(turning(stamps_ns), path, Names())
    if kind == 'kitti':
        lines = times_beside(path).read_text().split()
        assert lines == [
            '-1.500000001',
            '-0.500000000',
            '-0.000000001',
            '0.000000000',
            '0.250000000',
        ]
        return
    (found,) = read_sources([str(path)])
    np.testing.assert_array_equal(found.stamps_ns, stamps_ns)


@pytest.mark.parametrize(
    ('kind', 'name'), [('mcap', 'a.mcap'), ('ros1', 'a.bag'), ('sqlite3', 'a')]
)
def test_rosbags_reads_the_same_numbers(tmp_path, kind, name):
    made = turning(np.arange(1, 9) * 10**8 + 1)
    FORMATS[kind].write(made, tmp_path / name, Names(topic='/vio/pose', frame='map'))
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([tmp_path / name], default_typestore=store) as reader:
        found = [reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages()]
    assert {one.header.frame_id for one in found} == {'map'}
    stamps_ns = [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in found]
    assert stamps_ns == made.stamps_ns.tolist()
    positions = [[getattr(one.pose.position, axis) for axis in 'xyz'] for one in found]
    rotations = [[getattr(one.pose.orientation, axis) for axis in 'xyzw'] for one in found]
    np.testing.assert_array_equal(positions, made.positions)
    np.testing.assert_array_equal(rotations, made.rotations)


def test_what_a_change_leaves_out_is_said(tmp_path):
    write_recording(RUN, tmp_path / 'run.mcap')
    done = call(
        'convert', 'run.mcap:/vio/odometry', 'a.mcap', '--align-to', 'run.mcap:/ground_truth/pose',
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, transcript(done)
    assert '--align-to: covariances are left out' in done.stdout


def test_orientations_that_say_nothing_are_left_out_with_a_reason(tmp_path):
    stamps_ns = np.arange(1, 9) * 10**8
    line = np.arange(24.0).reshape(8, 3)
    still = Trajectory(stamps_ns, line, np.tile([0.0, 0.0, 0.0, 1.0], (8, 1)))
    (tmp_path / 'a.tum').write_text(tum(still))
    done = call('convert', 'a.tum', 'a.csv', cwd=tmp_path)
    assert 'a.tum: orientations left out: ' in done.stdout, transcript(done)


@pytest.mark.parametrize(
    ('kind', 'out', 'advice'),
    [
        ('mcap', 'b', 'name it with .mcap'),
        ('ros1', 'b.mcap', 'name it with .bag'),
        ('sqlite3', 'b.mcap', 'drop .mcap'),
    ],
)
def test_a_recording_is_named_as_what_it_is(tmp_path, kind, out, advice):
    (tmp_path / 'a.tum').write_text(tum(RUN.estimate))
    assert advice in complaint('convert', 'a.tum', out, '--format', kind, cwd=tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ['a.tum']


@pytest.mark.slow
def test_the_commands_of_the_document_run(tmp_path):
    (block,) = re.findall(r'```bash\n(.*?)```', DOCUMENT, re.DOTALL)
    for line in block.splitlines():
        done = call(*line.split()[1:], cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, ''), transcript(done)
