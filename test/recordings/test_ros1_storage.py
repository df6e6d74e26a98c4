"""ROS 1 bags: each chunk is decompressed once, with an index or without; damage is one line."""

import bz2
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
import random
import re
import struct

import lz4.frame
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_typestore, Stores

import recorded
from verbs import complaint, document
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import ros1_storage
from vio_eval_ros.recordings.container import Container
from vio_eval_ros.recordings.recording import Recording
from vio_eval_ros.recordings.ros1_storage import Ros1Storage
from vio_eval_ros.recordings.sources import read_sources

ROS1 = get_typestore(Stores.ROS1_NOETIC)
STRING = 'std_msgs/msg/String'
CHUNKS, EACH = 12, 10
NONE, BZ2, LZ4 = None, Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4


def write(path: Path, compression=NONE, *, latching: int | None = None) -> Path:
    """Write a bag of two topics over the same time, each chunk of it with only one of them."""
    writer = Writer(path)
    writer.chunk_threshold = 1000
    if compression:
        writer.set_compression(compression)
    with writer:
        topics = [
            writer.add_connection(name, STRING, typestore=ROS1, latching=latching)
            for name in ('/a', 'b')
        ]
        for chunk in range(CHUNKS):
            for k in range(EACH):
                text = f'{chunk} {k}' + 'x' * 1000 * (k == EACH - 1)
                time = 1_000_000_000 + (chunk // 2 * EACH + k) * 2 + chunk % 2
                raw = ROS1.serialize_ros1(ROS1.types[STRING](data=text), STRING)
                writer.write(topics[chunk % 2], time, raw)
    return path


@pytest.fixture(params=[NONE, BZ2, LZ4], ids=['plain', 'bz2', 'lz4'])
def bag(request, tmp_path) -> Path:
    return write(tmp_path / 'run.bag', request.param)


@pytest.fixture
def decompressed(monkeypatch) -> list[int]:
    """Return where the chunks begin that are decompressed from now on."""
    positions: list[int] = []
    original = Ros1Storage._data

    def data(storage, position):
        positions.append(position)
        return original(storage, position)

    monkeypatch.setattr(Ros1Storage, '_data', data)
    return positions


def messages(bag: Path, *names: str, written: bool = False) -> list[tuple[int, str, bytes]]:
    with Container(bag) as opened:
        found = opened.as_written({*names}) if written else opened.messages({*names})
        return [(log_ns, channel.topic, raw) for log_ns, channel, raw in found]


def test_messages_are_those_that_rosbags_reads(bag):
    with AnyReader([bag]) as reader:
        wanted = [
            (time, f'/{connection.topic.lstrip("/")}', raw)
            for connection, time, raw in reader.messages()
        ]
    assert len(wanted) == CHUNKS * EACH
    assert messages(bag, '/a', '/b') == wanted
    assert sorted(messages(bag, '/a', '/b', written=True)) == sorted(wanted)
    assert messages(bag, '/b') == [message for message in wanted if message[1] == '/b']


def test_each_chunk_is_decompressed_once(bag, decompressed):
    messages(bag, '/a', '/b', written=True)
    assert decompressed == sorted({*decompressed})
    assert len(decompressed) == CHUNKS
    decompressed.clear()
    messages(bag, '/a', '/b')
    assert len(decompressed) == len({*decompressed}) == CHUNKS
    decompressed.clear()
    messages(bag, '/b')
    assert len(decompressed) == CHUNKS // 2


def test_in_the_order_of_time_memory_stays_bounded(bag, decompressed, monkeypatch):
    wanted = messages(bag, '/a', '/b')
    decompressed.clear()
    monkeypatch.setattr(ros1_storage, 'CACHE_BYTES', 100)
    assert messages(bag, '/a', '/b') == wanted
    assert len(decompressed) > CHUNKS  # again and again, since only one fits


def test_a_part_of_the_time_reads_its_chunks_only(bag, decompressed):
    first, last = 1_000_000_000 + 2 * EACH, 1_000_000_000 + 4 * EACH - 1
    with Container(bag) as opened:
        assert opened.span_ns() == (1_000_000_000, 1_000_000_000 + CHUNKS * EACH - 1)
        found = [log_ns for log_ns, _, _ in opened.messages({'/a', '/b'}, first, last)]
    assert found == list(range(first, last + 1))
    assert len(decompressed) == 2


def without_index(bag: Path, name: str = 'killed.bag', cut: int = 0) -> Path:
    """Return a copy as a killed recorder leaves it, with some bytes missing at its end."""
    content = bytearray(bag.read_bytes())
    at = content.index(b'index_pos=') + len(b'index_pos=')
    (index,) = struct.unpack_from('<Q', content, at)
    struct.pack_into('<Q', content, at, 0)
    path = bag.with_name(name)
    path.write_bytes(content[: index - cut])
    return path


@pytest.mark.parametrize('name', ['killed.bag', 'killed.bag.active'])
def test_a_bag_without_an_index_is_read_to_its_end(bag, name):
    path = without_index(bag, name)
    for written in (True, False):
        wanted = messages(bag, '/a', '/b', written=written)
        assert messages(path, '/a', '/b', written=written) == wanted
    with Container(path) as opened, Container(bag) as whole:
        assert opened.topics == whole.topics
        assert opened.warnings == [
            f'{path}: has no index, since its recorder was stopped; read to its end'
        ]


def test_a_bag_with_an_index_that_is_still_called_active_is_read_without_a_word(bag):
    path = bag.rename(bag.with_name('run.bag.active'))
    with Container(path) as opened:
        assert opened.warnings == []
        assert opened.kind == 'ros1'
        assert sum(topic.count for topic in opened.topics) == CHUNKS * EACH


@pytest.mark.parametrize('cut', [1, 10, 100, 700])
def test_a_bag_without_an_index_that_is_cut_off_names_what_repairs_it(bag, cut):
    path = without_index(bag, cut=cut)
    with pytest.raises(ReadError) as caught:
        Container(path)
    assert str(caught.value).startswith(f'{path}: has no index')
    assert str(caught.value).endswith('`rosbag reindex` saves what is complete')


def test_a_bag_without_an_index_that_lacks_chunks_names_what_repairs_it(bag):
    """Where it is cut off between two records, the number of chunks in its header shows it."""
    with ExitStack() as stack:
        last = Ros1Storage(bag, stack)._chunks[-1].position
    path = without_index(bag)
    path.write_bytes(path.read_bytes()[:last])
    with pytest.raises(ReadError, match='`rosbag reindex` saves what is complete'):
        Container(path)


def test_a_chunk_that_was_not_finished_names_what_repairs_it(bag):
    """While a chunk is written, its length is zero."""
    path = without_index(bag)
    header = b'\4\0\0\0op=\5\x10\0\0\0compression=none\x09\0\0\0size=\0\0\0\0'
    record = struct.pack('<I', len(header)) + header + b'\0\0\0\0' + b'\x20\0\0\0conn=...'
    path.write_bytes(path.read_bytes() + record)
    with pytest.raises(ReadError, match='ends in the middle of a record; `rosbag reindex`'):
        Container(path)


@pytest.mark.slow
def test_no_damage_gives_anything_but_messages_or_one_line(bag):
    whole, dice = bag.read_bytes(), random.Random(5)
    for source in (whole, without_index(bag).read_bytes()):
        for _ in range(150):
            damaged = bytearray(source)
            for _ in range(3):
                damaged[dice.randrange(len(damaged))] = dice.randrange(256)
            path = bag.with_name('damaged.bag')
            path.write_bytes(damaged)
            with suppress(ReadError):
                messages(path, '/a', '/b')


# What errors of Python and of libraries say to programmers.
INNER = re.compile(
    r"b'|unpack|buffer|codec|object|subscript|argument|index out of|NoneType|__|[a-z](Error|Exit)"
)
#: what a recorder writes into a bag, of which one letter or the value is spoilt
NAMES = (
    'op conn time topic type message_definition size compression chunk_pos index_pos conn_count '
    'chunk_count start_time end_time ver count md5sum'
).split()


def damaged(whole: bytes, dice: random.Random) -> Iterator[bytes]:
    """Yield a bag with what disks and programs do to one."""
    for part in (1e-4, 0.001, 0.01, 0.2, 0.5, 0.9, 0.99, 0.9999):
        yield whole[: max(int(len(whole) * part), len(ros1_storage.MAGIC))]
    for name in NAMES:
        for at in {whole.find(f'{name}='.encode()), whole.rfind(f'{name}='.encode())}:
            for place, value in ((at, ord('X')), (at + len(name) + 1, 0xFF)):
                yield whole[:place] + bytes([value]) + whole[place + 1 :]
    ends = [*range(len(ros1_storage.MAGIC), 5000), *range(len(whole) - 2500, len(whole))]
    for at in dice.sample(ends, 150):  # headers, definitions and the index
        yield whole[:at] + bytes([whole[at] ^ 1 << dice.randrange(8)]) + whole[at + 1 :]
        yield whole[:at] + bytes(40) + whole[at + 40 :]


@pytest.mark.slow
def test_what_is_said_of_damage_is_in_plain_words(tmp_path):
    whole = recorded.write(tmp_path / 'run', 'ros1', recorded.odometry()).read_bytes()
    path, said = tmp_path / 'damaged.bag', set()
    for content in damaged(whole, random.Random(3)):
        path.write_bytes(content)
        try:
            read_sources(['/vio/odometry'], path)
        except ReadError as error:
            said.add(str(error).replace(str(path), ''))
    assert len(said) > 30
    assert not [line for line in said if INNER.search(line)]


def test_an_index_that_counts_messages_of_no_topic_is_damaged(tmp_path):
    path = recorded.write(tmp_path / 'run', 'ros1', recorded.odometry())
    content = path.read_bytes()
    at = content.rfind(b'conn=') + len(b'conn=')  # of the topic, in the index
    path.write_bytes(content[:at] + b'\x09' + content[at + 1 :])
    said = complaint('replay', path, '--estimate', '/vio/odometry', '--ground-truth', '/gt')
    assert 'its index counts messages of a topic that it does not name' in said


@pytest.mark.parametrize(
    ('old', 'new', 'words'),
    [
        (b'float64 z', b'fl{at64 z', "cannot be read from 'fl{at64 z' on"),
        (
            b'Quaternion or',
            b'Quatornion or',
            'nests geometry_msgs/msg/Quatornion, which it does not',
        ),
        (b'float64 w', b'float64 v', "otherwise than usual (without 'w')"),
        (b'Point position', b'Point_position', "cannot be read from 'geometry_msgs/Point_posit"),
    ],
)
def test_of_a_damaged_definition_is_said_where_it_is(tmp_path, old, new, words):
    path = changed(recorded.write(tmp_path / 'run', 'ros1', recorded.odometry()), old, new)
    with pytest.raises(ReadError) as refused:
        read_sources(['/vio/odometry'], path)
    assert words in str(refused.value)


def changed(bag: Path, old: bytes, new: bytes) -> Path:
    content = bag.read_bytes()
    assert old in content
    path = bag.with_name('changed.bag')
    path.write_bytes(content.replace(old, new))
    return path


@pytest.mark.parametrize(
    ('old', 'new', 'words'),
    [
        (b'compression=none', b'compression=gone', "compressed with 'gone'"),
        (b'#ROSBAG V2.0', b'#ROSBAG V1.2', 'version 1.2; `rosbag fix`'),
    ],
)
def test_what_is_not_known_is_refused_by_name(tmp_path, old, new, words):
    path = changed(write(tmp_path / 'run.bag'), old, new)
    with pytest.raises(ReadError, match=r'changed\.bag: ') as caught:
        messages(path, '/a')
    assert words in str(caught.value)


def test_a_chunk_larger_than_it_says_is_not_decompressed_further(tmp_path, monkeypatch):
    for name, bomb in (
        ('lz4', lz4.frame.compress(bytes(100_000))),
        ('bz2', bz2.compress(bytes(100_000))),
    ):
        assert len(ros1_storage.DECOMPRESSORS[name](bomb, 50)) == 50
    monkeypatch.setattr(ros1_storage, 'MAX_CHUNK_BYTES', 500)
    with pytest.raises(ReadError, match=r'has a chunk of .* GiB'):
        messages(write(tmp_path / 'run.bag'), '/a')


def test_each_publisher_latches_its_last_message(tmp_path):
    with Container(write(tmp_path / 'run.bag', latching=1)) as opened:
        offers = opened.offers()
    assert {topic: (offer.latched, offer.depth) for topic, offer in offers.items()} == {
        '/a': (True, 1),
        '/b': (True, 1),
    }


def test_comments_of_definitions_may_be_in_any_encoding(tmp_path):
    bag = tmp_path / 'run.bag'
    text = ROS1.generate_msgdef('geometry_msgs/msg/PointStamped', ros_version=1)[0]
    raw = ROS1.serialize_ros1(
        recorded.build(ROS1, 'geometry_msgs/msg/PointStamped', {'point': {'x': 1.0}}),
        'geometry_msgs/msg/PointStamped',
    )
    with Writer(bag) as writer:
        connection = writer.add_connection(
            '/point', 'geometry_msgs/msg/PointStamped', msgdef=f'# 90 ??\n{text}', md5sum='*'
        )
        writer.write(connection, 1, raw)
    path = changed(bag, b'# 90 ??', b'# 90 \xb0C')
    with Recording(path) as opened:
        (topic,) = opened.topics
        assert opened.decoder(topic).deserialize(raw).point.x == 1


def test_replay_reads_a_bag_whose_recorder_was_killed(tmp_path):
    bag = recorded.write(tmp_path / 'run', 'ros1', recorded.odometry())
    path = without_index(bag, 'run.bag.active')
    specs = ('--estimate', f'{path}:/vio/odometry', '--ground-truth', f'{bag}:/vio/odometry')
    result = document('replay', *specs)
    assert result['association']['pairs'] == 60
    assert any('has no index' in warning for warning in result['warnings'])
    cut = without_index(bag, 'cut.bag', cut=2000)
    assert '`rosbag reindex`' in complaint('replay', cut)
