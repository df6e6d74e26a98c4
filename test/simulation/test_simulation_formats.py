"""A run is written in every kind whole, the same to the byte, and reads back as it was."""

from dataclasses import replace
from pathlib import Path

from mcap.reader import make_reader
import numpy as np
import pytest

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, WriteError
from vio_eval_ros.imu.simulated_noise import EUROC
from vio_eval_ros.recordings.imu import read_imu
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.simulation import at_rest, simulate, SimulatedRun, write_recording
from vio_eval_ros.simulation.formats import format_of, FORMATS

RUN = simulate(duration_s=2, imu_noise=EUROC)
SPECS = {
    'tum': ('{}/estimate.tum', '{}/ground_truth.tum'),
    'euroc': ('{}/estimate.tum', '{}/mav0'),
}
TOPICS = ('{}:/vio/odometry', '{}:/ground_truth/pose')
#: a TUM file has nine decimals
DIGITS = {'tum': 1e-9, 'euroc': 1e-9}


def written(run: SimulatedRun, folder: Path, kind: str) -> Path:
    path = folder / f'run{FORMATS[kind].suffix}'
    write_recording(run, path, kind)
    return path


def files_in(path: Path) -> dict[str, bytes]:
    files = [path] if path.is_file() else [file for file in path.rglob('*') if file.is_file()]
    return {str(file.relative_to(path)): file.read_bytes() for file in files}


def assert_same(read: Poses, simulated: Poses, atol: float) -> None:
    np.testing.assert_array_equal(read.stamps_ns, simulated.stamps_ns)
    np.testing.assert_allclose(read.positions, simulated.positions, rtol=0, atol=atol)
    np.testing.assert_allclose(read.rotations, simulated.rotations, rtol=0, atol=atol)


@pytest.mark.parametrize('kind', FORMATS)
def test_every_kind_reads_back_as_it_was(tmp_path, kind):
    path = written(RUN, tmp_path, kind)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    specs = [spec.format(path) for spec in SPECS.get(kind, TOPICS)]
    estimate, truth = (source.poses for source in read_sources(specs))
    assert_same(estimate, RUN.estimate, DIGITS.get(kind, 0))
    assert_same(truth, RUN.ground_truth, DIGITS.get(kind, 0))
    if kind not in DIGITS:
        np.testing.assert_array_equal(estimate.covariances, RUN.estimate.covariances)


@pytest.mark.parametrize('kind', FORMATS)
def test_every_kind_holds_the_imu(tmp_path, kind):
    path, blocks = written(RUN, tmp_path, kind), []
    path = path / 'imu0.csv' if kind == 'tum' else path
    source = read_imu(path, None, lambda *block: blocks.append(block))
    assert source.topic in ('/imu0', None)
    stamps_ns, samples = (np.concatenate(part) for part in zip(*blocks, strict=True))
    np.testing.assert_array_equal(stamps_ns, RUN.imu.stamps_ns)
    np.testing.assert_array_equal(samples, RUN.imu.samples)


@pytest.mark.parametrize('kind', FORMATS)
def test_writing_twice_is_the_same_to_the_byte(tmp_path, kind):
    found = []
    for folder in (tmp_path / 'first', tmp_path / 'second'):
        folder.mkdir()
        again = simulate(duration_s=2, imu_noise=EUROC)
        found.append(files_in(written(again, folder, kind)))
    assert found[0] == found[1]
    assert found[0]


@pytest.mark.parametrize('kind', FORMATS)
def test_what_is_there_is_never_overwritten(tmp_path, kind):
    path = written(RUN, tmp_path, kind)
    before = files_in(path)
    with pytest.raises(ConfigError, match='exists already'):
        written(simulate(duration_s=1), tmp_path, kind)
    assert files_in(path) == before


def test_a_write_that_fails_leaves_nothing(tmp_path, monkeypatch):
    def fails(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr('rosbags.rosbag2.Writer.write', fails)
    with pytest.raises(WriteError, match='No space left'):
        written(RUN, tmp_path, 'mcap')
    assert list(tmp_path.iterdir()) == []


def test_a_recording_holds_messages_in_the_order_of_their_arrival(tmp_path):
    with written(RUN, tmp_path, 'mcap').open('rb') as file:
        messages = make_reader(file).iter_messages(log_time_order=False)
        received = [(message.log_time, channel.topic) for _, channel, message in messages]
    times = [time_ns for time_ns, _ in received]
    assert times == sorted(times)
    first = {topic: time_ns for time_ns, topic in reversed(received)}
    assert first['/vio/odometry'] - first['/ground_truth/pose'] == 1_300_000 + 38_000_000
    assert first['/imu0'] == first['/ground_truth/pose']


def test_what_a_run_has_not_is_not_written(tmp_path):
    path = written(at_rest(1, 7, EUROC), tmp_path, 'mcap')
    with path.open('rb') as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert topics == {'/imu0'}
    euroc = written(at_rest(1, 7, EUROC), tmp_path, 'euroc')
    assert set(files_in(euroc)) == {'mav0/imu0/data.csv', 'mav0/imu0/sensor.yaml'}


def test_positions_alone_are_points_and_no_tum_file(tmp_path):
    run = SimulatedRun(estimate=replace(RUN.estimate, rotations=None, covariances=None))
    path = written(run, tmp_path, 'ros1')
    (source,) = read_sources([f'{path}:/vio/position'])
    assert source.poses.rotations is None
    np.testing.assert_array_equal(source.poses.positions, run.estimate.positions)
    for kind in ('tum', 'euroc'):
        with pytest.raises(ConfigError, match='needs orientations'):
            write_recording(run, tmp_path / 'files', kind)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ('name', 'kind'), [('a.bag', 'ros1'), ('a.mcap', 'mcap'), ('a', 'rosbag2'), ('a.1', 'rosbag2')]
)
def test_the_kind_follows_the_name(name, kind):
    assert format_of(Path(name)) == kind


@pytest.mark.parametrize(
    ('name', 'kind', 'advice'),
    [
        ('a', 'ros1', 'name it with .bag'),
        ('a.bag', 'mcap', 'name it with .mcap'),
        ('a.mcap', 'tum', 'OUT is a folder: drop .mcap'),
    ],
)
def test_a_name_of_another_kind_is_refused(name, kind, advice):
    with pytest.raises(ConfigError, match=advice):
        format_of(Path(name), kind)
