"""What zstd has compressed is read as if it were not, within limits, and leaves nothing behind."""

from pathlib import Path
import shutil
import sqlite3
import tempfile

from backports import zstd
import pytest

import recorded
from verbs import complaint, document
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import compression
from vio_eval_ros.recordings.recording import Recording

TOPIC = '/vio/odometry'
COUNT = 60
SKIPPED = b'\x50\x2a\x4d\x18\x03\x00\x00\x00abc'  # a frame that holds no data


@pytest.fixture(params=recorded.KINDS)
def file(request, tmp_path) -> Path:
    """Return a storage file of each kind."""
    path = recorded.write(tmp_path / 'run', request.param, recorded.odometry(COUNT))
    return path if path.is_file() else next(path.glob('run.*'))


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch) -> Path:
    """Return where temporary folders are made; it must be empty in the end."""
    folder = tmp_path / 'temporary'
    folder.mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def positions(path: Path) -> list[list[float]]:
    with Recording(path) as opened:
        return opened.read([TOPIC])[0].poses.positions.tolist()


def packed(file: Path, suffix: str, content: bytes | None = None) -> Path:
    path = file.with_name(f'{file.name}{suffix}')
    path.write_bytes(zstd.compress(file.read_bytes()) if content is None else content)
    return path


@pytest.mark.parametrize('suffix', ['.zstd', '.zst'])
def test_a_compressed_file_is_read(file, suffix):
    path = packed(file, suffix)
    with Recording(path) as opened, Recording(file) as reference:
        assert opened.paths == (path,)
        assert opened.kind == reference.kind
        assert opened.topics == reference.topics
    assert positions(path) == positions(file)
    assert document('replay', '--estimate', f'{path}:{TOPIC}', '--ground-truth', f'{file}:{TOPIC}')


def test_a_file_of_several_frames_is_read(file):
    content = file.read_bytes()
    frames = [zstd.compress(content[k : k + 5000]) for k in range(0, len(content), 5000)]
    assert positions(packed(file, '.zst', SKIPPED.join(frames))) == positions(file)


def test_a_compressed_file_that_is_cut_off_is_refused(file):
    whole = zstd.compress(file.read_bytes())
    for content in (whole[:-4], whole[: len(whole) // 2], whole + b'rest'):
        with pytest.raises(ReadError, match='is damaged or was cut short'):
            Recording(packed(file, '.zstd', content))


def test_a_file_beyond_the_limit_says_how_to_decompress_it(file, monkeypatch):
    monkeypatch.setattr(compression, 'MAX_FILE_BYTES', 1 << 20)
    bomb = packed(file, '.zstd', zstd.compress(bytes(64 << 20)))
    problem = complaint('replay', bomb)
    assert 'is larger than 0.000977 GiB when decompressed' in problem
    assert 'zstd -d' in problem


def test_a_file_for_which_there_is_no_room_says_how_to_decompress_it(file, monkeypatch, tmp_path):
    full = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(compression.shutil, 'disk_usage', lambda _: full)
    with pytest.raises(ReadError, match=r'zstd -d'):
        Recording(packed(file, '.zstd'))


def test_a_window_beyond_the_limit_says_how_to_decompress_it(file):
    options = {
        zstd.CompressionParameter.window_log: 28,
        zstd.CompressionParameter.content_size_flag: 0,
    }
    compressor = zstd.ZstdCompressor(options=options)
    content = compressor.compress(file.read_bytes()) + compressor.flush()
    with pytest.raises(ReadError, match=r'zstd -d --long=31'):
        Recording(packed(file, '.zstd', content))


def test_something_else_that_is_compressed_is_refused(file):
    with pytest.raises(ReadError, match=r'run\.\w+\.zstd: does not begin like'):
        Recording(packed(file, '.zstd', zstd.compress(b'# timestamp tx ty tz qx qy qz qw')))


@pytest.mark.parametrize(
    ('begin', 'command'),
    [(b'\x1f\x8b\x08', 'gunzip'), (b'BZh91', 'bunzip2'), (b'PK\3\4', 'unzip')],
)
def test_other_compressions_are_named_with_their_cure(tmp_path, begin, command):
    path = tmp_path / 'run.mcap.gz'
    path.write_bytes(begin + b'....')
    problem = complaint('replay', path)
    assert f'is compressed; decompress it first: {command} run.mcap.gz' in problem


def test_messages_that_are_compressed_one_by_one_are_read_without_metadata(tmp_path):
    plain = recorded.write(tmp_path / 'run', 'sqlite', recorded.odometry(COUNT)) / 'run.db3'
    path = tmp_path / 'packed.db3'
    shutil.copy(plain, path)
    database = sqlite3.connect(path)
    database.create_function('packed', 1, zstd.compress)
    with database:
        database.execute('UPDATE messages SET data = packed(data) WHERE id % 3')
    database.close()
    assert positions(path) == positions(plain)


@pytest.mark.parametrize('damage', [lambda raw: raw[:-3], lambda raw: raw[:5]])
def test_a_compressed_message_that_is_cut_off_is_refused(tmp_path, damage):
    path = recorded.write(tmp_path / 'run', 'sqlite', recorded.odometry(COUNT)) / 'run.db3'
    database = sqlite3.connect(path)
    database.create_function('packed', 1, lambda raw: damage(zstd.compress(raw)))
    with database:
        database.execute('UPDATE messages SET data = packed(data)')
    database.close()
    with pytest.raises(ReadError, match='compressed message that is cut off'):
        positions(path)


def test_a_message_beyond_the_limit_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(compression, 'MAX_MESSAGE_BYTES', 1 << 16)
    path = recorded.write(tmp_path / 'run', 'sqlite', recorded.odometry(COUNT)) / 'run.db3'
    with sqlite3.connect(path) as database:
        bomb = zstd.compress(bytes(16 << 20))
        database.execute('UPDATE messages SET data = ? WHERE id = 5', (bomb,))
    database.close()
    with pytest.raises(ReadError, match='larger than'):
        positions(path)
