"""Which files of a rosbag2 folder belong to the recording, whatever its metadata.yaml says."""

import os
from pathlib import Path
import shutil

from backports import zstd
import pytest
import yaml

import recorded
from verbs import complaint, document
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import rosbag2_folder
from vio_eval_ros.recordings.recording import Recording

PARTS = 3
EACH = 20
TOPIC = '/vio/odometry'


@pytest.fixture(scope='module', params=['mcap', 'sqlite'])
def split(request, tmp_path_factory) -> Path:
    """Return a recording in three files."""
    folder = tmp_path_factory.mktemp('split') / 'run'
    folder.mkdir()
    stream = recorded.odometry(PARTS * EACH)
    messages, names = list(stream.messages), []
    for number in range(PARTS):
        mine = slice(number * EACH, (number + 1) * EACH)
        times = [recorded.stamp(k) for k in range(PARTS * EACH)][mine]
        part = stream._replace(messages=messages[mine], logged_ns=times)
        single = recorded.write(folder.parent / f'run_{number}', request.param, part)
        (file,) = single.glob('run_*')
        names.append(shutil.move(file, folder / file.name).name)
    metadata = yaml.safe_load((single / 'metadata.yaml').read_text())
    information = metadata['rosbag2_bagfile_information']
    information['relative_file_paths'] = names
    information['topics_with_message_count'][0]['message_count'] = PARTS * EACH
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    return folder


@pytest.fixture
def run(split, tmp_path) -> Path:
    """Return a copy of it that may be changed."""
    return Path(shutil.copytree(split, tmp_path / 'run'))


@pytest.fixture
def suffix(run) -> str:
    return next(run.glob('run_0.*')).suffix


def restate(run: Path, **fields: object) -> None:
    """Change fields of the metadata; those that are None are left out."""
    file = run / 'metadata.yaml'
    metadata = yaml.safe_load(file.read_text())
    information = metadata['rosbag2_bagfile_information']
    information.update(fields)
    for name in [name for name, value in fields.items() if value is None]:
        del information[name]
    file.write_text(yaml.safe_dump(metadata))


def read(run: Path) -> tuple[int, list[str]]:
    """Return the number of poses, and the warnings without the name of the folder."""
    with Recording(run) as opened:
        poses = opened.read([TOPIC])[0].poses
        assert poses.stamps_ns.tolist() == sorted(poses.stamps_ns.tolist())
        return len(poses), [line.removeprefix(f'{run}: ') for line in opened.warnings]


def refused(run: Path) -> str:
    with pytest.raises(ReadError) as caught:
        Recording(run)
    assert '\n' not in str(caught.value)
    return str(caught.value)


def compress(path: Path, suffix: str = '.zstd', *, keep: bool = False) -> None:
    path.with_name(path.name + suffix).write_bytes(zstd.compress(path.read_bytes()))
    if not keep:
        path.unlink()


def test_what_is_listed_and_there_is_read_without_a_word(run):
    assert read(run) == (PARTS * EACH, [])


@pytest.mark.parametrize('listed', [[0], [1], [0, 2], [1, 2]])
def test_parts_that_are_not_listed_are_read_and_named(run, suffix, listed):
    restate(run, relative_file_paths=[f'run_{number}{suffix}' for number in listed])
    names = ', '.join(f'run_{k}{suffix}' for k in range(PARTS) if k not in listed)
    warning = f'metadata.yaml does not list {names}; read all the same'
    assert read(run) == (PARTS * EACH, [warning])


@pytest.mark.parametrize('name', ['other{}', 'run{}', 'run_0_copy{}', 'run_0 (1){}', 'run_01{}'])
def test_files_that_are_no_part_are_not_read_but_named(run, suffix, name):
    name = name.format(suffix)
    shutil.copy(run / f'run_0{suffix}', run / name)
    warning = f'metadata.yaml does not list {name}; not read'
    assert read(run) == (PARTS * EACH, [warning])


def test_parts_of_another_kind_are_not_read_twice(run, suffix):
    other = {'.mcap': '.db3', '.db3': '.mcap'}[suffix]
    shutil.copy(run / f'run_0{suffix}', run / f'run_0{other}')
    assert read(run) == (PARTS * EACH, [f'metadata.yaml does not list run_0{other}; not read'])


def test_files_that_are_listed_twice_are_read_once(run, suffix):
    compress(run / f'run_1{suffix}', keep=True)
    names = [f'run_0{suffix}', f'run_1{suffix}', f'run_1{suffix}.zstd', f'old/run_2{suffix}']
    restate(run, relative_file_paths=[*names, *names])
    assert read(run) == (PARTS * EACH, [])


def test_a_folder_around_recordings_names_them(run):
    assert refused(run.parent) == (
        f'{run.parent}: is not a rosbag2 folder: has no metadata.yaml, and there is no .mcap, '
        f'.db3 or .bag in it; name a folder in it: {run}'
    )


def test_a_file_that_is_missing_is_named_with_those_that_are_there(run, suffix):
    (run / f'run_1{suffix}').unlink()
    assert refused(run) == (
        f'{run}/run_1{suffix}: there is no such file or folder, but metadata.yaml lists it; put '
        f'it back, or name a file that is there: run_0{suffix}, run_2{suffix}'
    )


@pytest.mark.parametrize('packed', ['.zstd', '.zst'])
def test_files_may_be_compressed_or_decompressed_since(run, suffix, packed):
    compress(run / f'run_1{suffix}', packed)
    assert read(run) == (PARTS * EACH, [])
    listed = [f'run_{number}{suffix}{packed}' for number in range(PARTS)]
    restate(run, relative_file_paths=listed, compression_mode='FILE', compression_format='zstd')
    assert read(run) == (PARTS * EACH, [])


def test_what_was_decompressed_beside_is_not_read_twice(run, suffix):
    for number in range(PARTS):
        compress(run / f'run_{number}{suffix}', keep=True)
    assert read(run) == (PARTS * EACH, [])
    listed = [f'run_{number}{suffix}.zstd' for number in range(PARTS)]
    restate(run, relative_file_paths=listed, compression_mode='FILE', compression_format='zstd')
    assert read(run) == (PARTS * EACH, [])
    (run / 'metadata.yaml').unlink()
    count, warnings = read(run)
    assert count == PARTS * EACH
    assert len(warnings) == 1


def cut(text: str) -> bytes:
    return text[: text.index('relative_file_paths')].encode()


@pytest.mark.parametrize(
    ('damage', 'words'),
    [
        (lambda text: b'', 'is empty (0 bytes)'),
        (lambda text: bytes(4096), 'is empty (4096 bytes of zeros)'),
        (lambda text: b' \n\n', 'is empty (3 bytes)'),
        (cut, 'lists no files'),
        (lambda text: text.encode()[:40], 'is damaged or was cut short'),
        (lambda text: b'{', 'is damaged or was cut short'),
        (lambda text: b'[]', 'is damaged or was cut short'),
        (lambda text: b'\xff\xfe\x00', 'is damaged or was cut short'),
        (lambda text: b'a: b', 'is damaged or was cut short'),
        (lambda text: b'rosbag2_bagfile_information: 3', 'is damaged or was cut short'),
        (lambda text: b'rosbag2_bagfile_information: {relative_file_paths: [3]}', 'lists no'),
        (lambda text: b'rosbag2_bagfile_information: {relative_file_paths: []}', 'lists no'),
        (lambda text: b'[' * 100_000, 'is damaged or was cut short'),
    ],
)
def test_without_usable_metadata_the_files_that_are_there_are_read(run, suffix, damage, words):
    file = run / 'metadata.yaml'
    file.write_bytes(damage(file.read_text()))
    count, (warning,) = read(run)
    assert count == PARTS * EACH
    assert warning.startswith(f'its metadata.yaml {words}')
    assert warning.endswith(f'; read run_0{suffix}, run_1{suffix}, run_2{suffix}')


def test_without_metadata_the_files_that_are_there_are_read_by_every_verb(run, suffix):
    (run / 'metadata.yaml').unlink()
    warning = f'has no metadata.yaml; read run_0{suffix}, run_1{suffix}, run_2{suffix}'
    assert read(run) == (PARTS * EACH, [warning])
    result = document('replay', run, '--estimate', TOPIC, '--ground-truth', f'{run}:{TOPIC}')
    assert result['association']['pairs'] == PARTS * EACH
    assert f'{run}: {warning}' in result['warnings']
    assert f'name a topic in it: {run}:/topic' in complaint(
        'replay', '--estimate', run, '--ground-truth', f'{run}:{TOPIC}'
    )


@pytest.mark.parametrize(
    'names', [('V1_01', 'V1_02'), ('run_0', 'run_2'), ('run_1', 'run_2'), 'ab']
)
def test_without_metadata_files_that_may_be_of_several_runs_are_refused(run, suffix, names):
    (run / 'metadata.yaml').unlink()
    for name in names:
        shutil.copy(run / f'run_0{suffix}', run / f'{name}{suffix}.kept')
    for file in run.glob(f'*{suffix}'):
        file.unlink()
    for file in run.iterdir():
        file.rename(file.with_suffix(''))
    assert refused(run).endswith(
        'has no metadata.yaml, and which of its files belong together is not known; name one of '
        f'{names[0]}{suffix}, {names[1]}{suffix}, or write a metadata.yaml with `ros2 bag reindex`'
    )


def test_metadata_of_a_newer_version_is_read_where_it_lists_files(run):
    restate(run, version=10, what_is_new={'a': 1}, storage_identifier=None, duration=None)
    assert read(run) == (PARTS * EACH, [])


def test_metadata_of_a_newer_version_that_lists_no_files_is_refused_by_its_version(run):
    restate(run, version=99, relative_file_paths=None)
    assert 'metadata.yaml: is of version 99, newer than' in refused(run)
    assert 'name a storage file' in refused(run)


def test_paths_may_lie_in_folders_that_are_gone(run, suffix):
    """Early releases write the folder too; nothing outside of it is read."""
    restate(run, relative_file_paths=[f'../old/{name}' for name in ('run_0' + suffix,)])
    assert read(run)[0] == PARTS * EACH
    restate(run, relative_file_paths=['/etc/passwd'])
    assert refused(run).startswith(f'{run}/passwd: there is no such file')


def test_counts_that_are_more_than_what_is_there_are_named(run):
    restate(
        run,
        topics_with_message_count=[
            {'topic_metadata': {'name': 'vio/odometry'}, 'message_count': 99},
            {'topic_metadata': {'name': '/gone'}, 'message_count': 5},
        ],
    )
    assert read(run)[1] == [
        f'metadata.yaml states 99 messages of {TOPIC}, but {PARTS * EACH} are there',
        'metadata.yaml states 5 messages of /gone, but 0 are there',
    ]


@pytest.mark.parametrize('counts', [3, [3], [{}], None, [{'topic_metadata': 1}]])
def test_counts_that_make_no_sense_are_none(run, counts):
    restate(run, topics_with_message_count=counts)
    assert read(run) == (PARTS * EACH, [])


def test_another_compression_is_refused_by_name(run):
    restate(run, compression_mode='message', compression_format='lz4')
    assert "compressed with 'lz4'; only zstd" in refused(run)


def test_pipes_are_not_opened(run, suffix):
    path = run / f'run_1{suffix}'
    path.unlink()
    os.mkfifo(path)
    assert refused(run) == f'{path}: is neither a file nor a folder'
    assert refused(path) == f'{path}: is neither a file nor a folder'
    (run / 'metadata.yaml').unlink()
    os.mkfifo(run / 'metadata.yaml')
    assert refused(run) == f'{run}/metadata.yaml: is not a file'


def test_devices_are_not_opened():
    assert refused(Path('/dev/zero')) == '/dev/zero: is neither a file nor a folder'


def test_metadata_without_end_is_not_read(run, monkeypatch):
    monkeypatch.setattr(rosbag2_folder, 'MAX_METADATA_BYTES', 100)
    assert read(run)[1][0].startswith('its metadata.yaml is larger than 16 MiB')


@pytest.mark.parametrize(
    ('estimate', 'truth'),
    [
        ('vio/odometry', 'vio/odometry'),
        ('vio/odometry', '{run}:vio/odometry'),
        ('{run}/{file}:vio/odometry', '/vio/odometry'),
    ],
)
def test_topics_may_be_named_without_their_slash(run, suffix, estimate, truth):
    estimate, truth = (spec.format(run=run, file=f'run_0{suffix}') for spec in (estimate, truth))
    result = document('replay', run, '--estimate', estimate, '--ground-truth', truth)
    assert result['association']['pairs'] == (EACH if 'run_0' in estimate else PARTS * EACH)


def test_what_is_neither_a_file_nor_a_topic_is_answered_with_the_topics(run):
    problem = complaint('replay', run, '--estimate', 'vio/odom', '--ground-truth', TOPIC)
    assert f'{run}:/vio/odom: there is no such topic' in problem
    problem = complaint('replay', run, '--estimate', 'odom.txt', '--ground-truth', TOPIC)
    assert 'odom.txt: No such file' in problem
