"""Samples of an IMU are read exactly, from every kind of recording and from CSV."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from vio_eval_ros.errors import ReadError, UnsupportedMessage
from vio_eval_ros.recordings import decoder, imu
from vio_eval_ros.recordings.imu import read_imu
from vio_eval_ros.recordings.recording import Recording

FIRST_NS = 1_403_636_579_763_555_584
IMU = 'sensor_msgs/msg/Imu'
KINDS = ['ros1', 'mcap', 'sqlite3', 'compressed']
EUROC_HEADER = (
    '#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],'
    'a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n'
)


def made(count=60):
    stamps_ns = FIRST_NS + 5_000_000 * np.arange(count)
    return stamps_ns, np.random.default_rng(1).standard_normal((count, 6))


def message(types, stamp_ns, row, frame='imu0'):
    ros1 = 'seq' in types['std_msgs/msg/Header'].__dataclass_fields__
    time = types['builtin_interfaces/msg/Time'](*divmod(int(stamp_ns), 10**9))
    header = types['std_msgs/msg/Header'](*([7] if ros1 else []), time, frame)
    vector = types['geometry_msgs/msg/Vector3']
    return types[IMU](
        header,
        types['geometry_msgs/msg/Quaternion'](0.1, 0.2, 0.3, 0.4),
        np.full(9, 0.5),
        vector(*row[:3]),
        np.full(9, 0.6),
        vector(*row[3:]),
        np.full(9, 0.7),
    )


def write(path: Path, kind: str, topics: dict[str, tuple], frames=('imu0',)) -> Path:
    """Write the samples of each topic as a recording."""
    ros1 = kind == 'ros1'
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    if ros1:
        path = path.with_suffix('.bag')
        writer = Rosbag1Writer(path)
    else:
        plugin = StoragePlugin.SQLITE3 if kind == 'sqlite3' else StoragePlugin.MCAP
        writer = Rosbag2Writer(path, version=9, storage_plugin=plugin)
        if kind == 'compressed':
            writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        for topic, (stamps_ns, samples) in topics.items():
            connection = writer.add_connection(topic, IMU, typestore=store)
            for index, (stamp_ns, row) in enumerate(zip(stamps_ns, samples.tolist(), strict=True)):
                one = message(store.types, stamp_ns, row, frames[index % len(frames)])
                writer.write(connection, int(stamp_ns), serialize(one, IMU))
    return path


class Collected:
    """What a reader hands out."""

    def __init__(self):
        self.blocks = []

    def __call__(self, stamps_ns, samples):
        assert stamps_ns.dtype == np.int64
        assert samples.dtype == np.float64
        self.blocks.append((stamps_ns, samples))

    def columns(self):
        stamps_ns, samples = zip(*self.blocks, strict=True)
        return np.concatenate(stamps_ns), np.concatenate(samples)


def read(path, topic=None):
    sink = Collected()
    source = read_imu(path, topic, sink)
    return *sink.columns(), source


def csv(path, header, stamps, samples):
    rows = zip(stamps, samples.tolist(), strict=True)
    path.write_text(
        header + ''.join(f'{stamp},{",".join(map(repr, row))}\n' for stamp, row in rows)
    )
    return path


@pytest.mark.parametrize('kind', KINDS)
def test_every_kind_of_recording_gives_the_samples_exactly(tmp_path, kind):
    stamps_ns, samples = made()
    found_ns, found, source = read(write(tmp_path / 'run', kind, {'/imu0': (stamps_ns, samples)}))
    np.testing.assert_array_equal(found_ns, stamps_ns)
    np.testing.assert_array_equal(found, samples)
    assert source.topic == '/imu0'
    assert str(source).endswith(':/imu0')


@pytest.mark.parametrize('kind', KINDS)
def test_frames_of_changing_length_do_not_matter(tmp_path, kind):
    frames = ('', 'imu', 'a/rather/long/frame', 'Rahmen äöü')
    path = write(tmp_path / 'run', kind, {'/imu0': made()}, frames)
    np.testing.assert_array_equal(read(path)[1], made()[1])


def test_samples_come_in_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(decoder, 'BLOCK_BYTES', 4_000)
    path = write(tmp_path / 'run', 'mcap', {'/imu0': made()})
    sink = Collected()
    read_imu(path, None, sink)
    assert len(sink.blocks) > 3
    np.testing.assert_array_equal(sink.columns()[1], made()[1])


def test_messages_of_another_definition_are_read_by_the_names_of_their_fields(tmp_path):
    definition = (
        'std_msgs/Header header\n'
        'geometry_msgs/Vector3 linear_acceleration\n'
        'geometry_msgs/Vector3 angular_velocity\n'
    )
    store = get_typestore(Stores.ROS2_JAZZY)
    store.fielddefs.pop(IMU)
    store.types.pop(IMU)
    store.register(get_types_from_msg(definition, IMU))
    types = store.types
    vector, time = types['geometry_msgs/msg/Vector3'], types['builtin_interfaces/msg/Time']
    with Rosbag2Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/imu', IMU, typestore=store)
        header = types['std_msgs/msg/Header'](time(3, 5), 'imu')
        one = types[IMU](header, vector(4.0, 5.0, 6.0), vector(1.0, 2.0, 3.0))
        writer.write(connection, 1, store.serialize_cdr(one, IMU))
    found_ns, found, _ = read(tmp_path / 'run')
    assert found_ns.tolist() == [3_000_000_005]
    assert found.tolist() == [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]]


def test_of_two_imus_one_is_to_be_named(tmp_path):
    path = write(tmp_path / 'run', 'mcap', {'/imu0': made(), '/imu1': made(30)})
    advice = r'choose --topic /imu0 \(60 messages\) or --topic /imu1 \(30 messages\)$'
    with pytest.raises(ReadError, match=advice):
        read(path)
    with pytest.raises(ReadError, match=advice.replace('--topic ', '--imu run:')):
        read_imu(path, None, Collected(), option='--imu run:')
    assert len(read(path, '/imu1')[0]) == 30


def test_a_topic_that_is_not_there_or_no_imu_is_refused_by_name(tmp_path, leica_recording):
    path = write(tmp_path / 'run', 'mcap', {'/imu0': made()})
    with pytest.raises(ReadError, match='no such topic; choose --topic /imu0'):
        read(path, '/imu')
    with pytest.raises(UnsupportedMessage, match='carries geometry_msgs/msg/PoseStamped'):
        read(leica_recording, '/vio/pose')
    with pytest.raises(
        ReadError, match=r'recording: the recording has no topic of type sensor_msgs/msg/Imu$'
    ):
        read(leica_recording)
    silent = write(tmp_path / 'silent', 'mcap', {'/imu0': made(0)})
    with pytest.raises(ReadError, match='silent: the recording has no messages of type'):
        read(silent)
    with pytest.raises(ReadError, match='imu0: has no messages; the recording has no messages'):
        read(silent, '/imu0')


def test_a_damaged_message_is_an_error_of_one_line(tmp_path, monkeypatch):
    path = write(tmp_path / 'run', 'mcap', {'/imu0': made()})

    def cut(self, names):
        for log_ns, channel, raw in original(self, names):
            yield log_ns, channel, raw[:40]

    original = Recording.as_written
    monkeypatch.setattr(Recording, 'as_written', cut)
    with pytest.raises(ReadError, match='damaged'):
        read(path)


@pytest.mark.parametrize('where', ['data.csv', 'imu0/data.csv', 'mav0/imu0/data.csv'])
def test_euroc_folders_and_files_are_read_exactly(tmp_path, where):
    stamps_ns, samples = made()
    file = tmp_path / where
    file.parent.mkdir(parents=True, exist_ok=True)
    csv(file, EUROC_HEADER, stamps_ns, samples)
    for path in (file, tmp_path):
        found_ns, found, source = read(path)
        np.testing.assert_array_equal(found_ns, stamps_ns)
        np.testing.assert_array_equal(found, samples)
        assert source.units == {'gyro': 'rad/s', 'accel': 'm/s2'}


@pytest.mark.parametrize(
    ('header', 'order', 'units'),
    [
        ('', [0, 1, 2, 3, 4, 5], {}),
        ('# t gx gy gz ax ay az\n', [0, 1, 2, 3, 4, 5], {}),
        ('time,ax,ay,az,gx,gy,gz\n', [3, 4, 5, 0, 1, 2], {}),
        (
            'stamp,gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s],acc_x [g],acc_y [g],acc_z [g]\n',
            [0, 1, 2, 3, 4, 5],
            {'gyro': 'deg/s', 'accel': 'g'},
        ),
        (
            '"time","linear_acceleration.x","angular_velocity.x","linear_acceleration.y",'
            '"angular_velocity.y","linear_acceleration.z","angular_velocity.z"\n',
            [1, 3, 5, 0, 2, 4],
            {},
        ),
    ],
)
def test_columns_are_found_by_their_names(tmp_path, header, order, units):
    stamps_ns, samples = made()
    seconds = [f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09}' for stamp_ns in stamps_ns.tolist()]
    found_ns, found, source = read(csv(tmp_path / 'imu.csv', header, seconds, samples))
    np.testing.assert_array_equal(found_ns, stamps_ns)
    np.testing.assert_array_equal(found, samples[:, order])
    assert source.units == units


def test_further_columns_are_left_out(tmp_path):
    stamps_ns, samples = made()
    wide = np.hstack([samples[:, :3], np.full((60, 1), 30.0), samples[:, 3:]])
    path = csv(tmp_path / 'imu.csv', 'time,gx,gy,gz,temperature,ax,ay,az\n', stamps_ns, wide)
    np.testing.assert_array_equal(read(path)[1], samples)


@pytest.mark.parametrize(
    ('header', 'step', 'unit_ns'),
    [
        ('', 5_000_000, 1),
        ('', 5_000, 1_000),
        ('', 5, 1_000_000),
        ('', 0.005, 1_000_000_000),
        ('time [us],gx,gy,gz,ax,ay,az\n', 50, 1_000),
        ('stamp_ns,gx,gy,gz,ax,ay,az\n', 5, 1),
    ],
)
def test_the_unit_of_stamps_is_stated_or_inferred_from_their_steps(
    tmp_path, header, step, unit_ns
):
    stamps = [round(step * index, 3) for index in range(60)]
    found_ns, _, _ = read(csv(tmp_path / 'imu.csv', header, stamps, made()[1]))
    np.testing.assert_array_equal(np.diff(found_ns), round(step * unit_ns))


@pytest.mark.parametrize('wrong', [0, -1])
def test_one_wrong_stamp_does_not_change_the_unit(tmp_path, wrong):
    stamps = [round(1.4e9 + index / 200, 3) for index in range(60)]
    stamps[wrong] = 0.0
    found_ns, _, _ = read(csv(tmp_path / 'imu.csv', '', stamps, made()[1]))
    assert np.median(np.diff(found_ns)) == 5_000_000


def test_a_csv_is_read_in_blocks_and_errors_name_the_line(tmp_path, monkeypatch):
    monkeypatch.setattr(imu, 'TEXT_BYTES', 1_000)
    path = csv(tmp_path / 'imu.csv', EUROC_HEADER, *made())
    sink = Collected()
    read_imu(path, None, sink)
    assert len(sink.blocks) > 3
    np.testing.assert_array_equal(sink.columns()[1], made()[1])
    lines = path.read_text().splitlines(keepends=True)
    lines[40] = lines[40].replace(',', ',x', 1)
    path.write_text(''.join(lines))
    with pytest.raises(ReadError, match=r'line 41: .* is not a number'):
        read(path)


@pytest.mark.parametrize(
    ('content', 'problem'),
    [
        ('', 'is empty'),
        ('# nothing\n', 'no rows of numbers'),
        ('1,2,3,4\n2,3,4,5\n', 'has 4 columns'),
        ('time,a,b,c,d,e,f\n1,2,3,4,5,6,7\n', 'not recognised; name them time, gx'),
    ],
)
def test_what_is_no_csv_of_an_imu_is_an_error(tmp_path, content, problem):
    path = tmp_path / 'imu.csv'
    path.write_text(content)
    with pytest.raises(ReadError, match=problem):
        read(path)


def test_a_csv_has_no_topics(tmp_path):
    with pytest.raises(ReadError, match='no topic /imu0'):
        read(csv(tmp_path / 'imu.csv', '', *made()), '/imu0')


def test_what_is_not_there_is_an_error(tmp_path):
    for name in ('imu.csv', 'run.mcap'):
        with pytest.raises(ReadError, match=r'(?i)no such file'):
            read(tmp_path / name)


def test_stamps_since_1970_show_their_unit_by_their_size_however_slow(tmp_path):
    path = tmp_path / 'slow.csv'
    path.write_text(''.join(f'{1_700_000_000 + 0.1 * k:.1f},1,2,3,4,5,6\n' for k in range(50)))
    blocks = []
    read_imu(path, None, lambda stamps_ns, _: blocks.append(stamps_ns))
    assert np.diff(np.concatenate(blocks)).tolist() == [100_000_000] * 49


def test_a_trajectory_without_a_header_is_no_imu(tmp_path):
    path = tmp_path / 'est.txt'
    path.write_text(''.join(f'{k / 10} 1 2 3 0 0 0 1\n' for k in range(50)))
    with pytest.raises(ReadError, match='has 8 columns and no header that names them'):
        read_imu(path, None, lambda *_: None)
