"""Streams as columns: the same from every kind of recording, headers of whatever messages."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.sensors import read_sensors
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.simulation import simulate, write_recording

V1_02 = 'derived_bags/euroc_V1_02_vins_fusion'
OWN = 'own_msgs/msg/Reading'
OWN_TEXT = 'std_msgs/Header header\nfloat32 value\n'


def streams(path: Path) -> dict[str, SensorStream]:
    return {stream.topic: stream for stream in read_sensors(path).streams}


def same(one: SensorStream, other: SensorStream) -> None:
    np.testing.assert_array_equal(one.stamps_ns, other.stamps_ns)
    np.testing.assert_array_equal(one.logged_ns, other.logged_ns)
    np.testing.assert_array_equal(one.numbers, other.numbers)
    assert (one.topic, one.msgtype, one.frames) == (other.topic, other.msgtype, other.frames)


def test_poses_are_those_that_are_scored(tmp_path):
    write_recording(simulate(duration_s=5.0), tmp_path / 'run')
    found = streams(tmp_path / 'run')['/vio/odometry']
    (estimate,) = read_sources(['/vio/odometry'], tmp_path / 'run')
    np.testing.assert_array_equal(found.stamps_ns, estimate.poses.stamps_ns)
    np.testing.assert_array_equal(found.numbers[:, :3], estimate.poses.positions)
    np.testing.assert_array_equal(found.numbers[:, 3:], estimate.poses.rotations)
    assert found.frames == {'odom': 100}
    assert (found.logged_ns - found.stamps_ns == 38_000_000).all()


def test_one_run_is_the_same_from_all_three_kinds_of_recording(shared_data):
    bag, sqlite, mcap = (
        streams(shared_data / (V1_02 + kind)) for kind in ('.bag', '_sqlite3', '_mcap')
    )
    assert bag.keys() == sqlite.keys() == mcap.keys()
    for topic in ('/ground_truth/pose', '/vio/odometry'):
        same(bag[topic], mcap[topic])
        same(sqlite[topic], mcap[topic])


def test_an_imu_has_six_numbers_a_sample(shared_data):
    imu = streams(shared_data / 'bags/robot_localization/test2.bag')['/imu/data']
    assert imu.numbers.shape == (3061, 6)
    assert np.median(np.linalg.norm(imu.numbers[:, 3:], axis=1)) == pytest.approx(9.8, abs=0.1)


def test_messages_without_a_header_are_known_by_when_they_were_recorded(shared_data):
    turtle = streams(shared_data / 'bags/rosbag_js/example-bz2.bag')
    assert turtle['/turtle1/pose'].stamps_ns is None
    assert len(turtle['/turtle1/pose']) == 1344
    assert turtle['/rosout'].frames == {'': 10}


@pytest.mark.parametrize('kind', ['ros1', 'mcap', 'sqlite3'])
def test_messages_of_ones_own_that_begin_with_a_header_have_stamps(tmp_path, kind):
    store = get_typestore(Stores.ROS1_NOETIC if kind == 'ros1' else Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(OWN_TEXT, OWN))
    time = store.types['builtin_interfaces/msg/Time'](12, 34)
    name = 'fühler'
    arguments = (7, time, name) if kind == 'ros1' else (time, name)
    message = store.types[OWN](store.types['std_msgs/msg/Header'](*arguments), 1.5)
    if kind == 'ros1':
        path = tmp_path / 'own.bag'
        writer, raw = Rosbag1Writer(path), store.serialize_ros1(message, OWN)
    else:
        path = tmp_path / 'own'
        writer = Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
        raw = store.serialize_cdr(message, OWN)
    with writer:
        writer.write(writer.add_connection('/own', OWN, typestore=store), 5, raw)
    found = streams(path)['/own']
    assert found.stamps_ns.tolist() == [12 * 10**9 + 34]
    assert found.logged_ns.tolist() == [5]
    assert found.frames == {'fühler': 1}
    assert found.numbers is None


def test_big_endian_headers_are_read(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    types, imu = store.types, 'sensor_msgs/msg/Imu'
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](12, 34), 'imu')
    vector, none = types['geometry_msgs/msg/Vector3'], np.zeros(9)
    level = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    message = types[imu](header, level, none, vector(1, 2, 3), none, vector(4, 5, 6), none)
    with Rosbag2Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/imu', imu, typestore=store)
        writer.write(connection, 5, store.serialize_cdr(message, imu, little_endian=False))
    found = streams(tmp_path / 'run')['/imu']
    assert found.stamps_ns.tolist() == [12 * 10**9 + 34]
    assert found.numbers.tolist() == [[1, 2, 3, 4, 5, 6]]


def test_a_length_that_leads_out_of_a_message_is_damage(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    with Rosbag2Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/image', 'sensor_msgs/msg/Image', typestore=store)
        writer.write(connection, 5, b'\0\1\0\0' + bytes(8) + b'\xff' * 4)
    with pytest.raises(ReadError, match='/image: message 1 is damaged'):
        read_sensors(tmp_path / 'run')


@pytest.mark.parametrize('raw', [b'', b'\0', b'\0\1\0\0', b'\0\1\0\0' + bytes(7)])
def test_a_message_that_is_cut_short_is_damage(tmp_path, raw):
    store = get_typestore(Stores.ROS2_JAZZY)
    with Rosbag2Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/image', 'sensor_msgs/msg/Image', typestore=store)
        writer.write(connection, 5, raw)
    with pytest.raises(ReadError, match='/image: is damaged'):
        read_sensors(tmp_path / 'run')


def test_rows_that_are_no_numbers_are_reported_with_their_stamp(tmp_path):
    folder = tmp_path / 'mav0' / 'imu0'
    folder.mkdir(parents=True)
    folder.joinpath('data.csv').write_text('5,1,2,3,4,5,x\n')
    with pytest.raises(ReadError, match='at stamp 5'):
        read_sensors(tmp_path)


def test_a_folder_needs_no_image_to_be_there(tmp_path):
    folder = tmp_path / 'mav0' / 'cam0'
    folder.mkdir(parents=True)
    folder.joinpath('data.csv').write_text('5,5.png\n10,10.png\n')
    found = streams(tmp_path)['/cam0/image_raw']
    assert found.stamps_ns.tolist() == [5, 10]
    assert found.logged_ns is None
    assert found.frames == {'cam0': 2}


def test_quaternions_of_a_folder_are_turned_round(tmp_path):
    folder = tmp_path / 'state_groundtruth_estimate0'
    folder.mkdir(parents=True)
    folder.joinpath('data.csv').write_text('5,1,2,3,0.1,0.2,0.3,0.4,0,0,0\n')
    (pose,) = streams(tmp_path).values()
    assert pose.numbers.tolist() == [[1, 2, 3, 0.2, 0.3, 0.4, 0.1]]


def test_topics_without_messages_are_streams(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {
        '/cam': 'sensor_msgs/msg/Image',
        '/imu': 'sensor_msgs/msg/Imu',
        '/pose': 'geometry_msgs/msg/PoseStamped',
    }
    with Rosbag2Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, msgtype in types.items():
            writer.add_connection(topic, msgtype, typestore=store)
        name, time = 'std_msgs/msg/Header', store.types['builtin_interfaces/msg/Time'](1, 2)
        point = 'geometry_msgs/msg/PointStamped'
        one = store.types[point](
            store.types[name](time, ''), store.types['geometry_msgs/msg/Point'](1.0, 2.0, 3.0)
        )
        connection = writer.add_connection('/point', point, typestore=store)
        writer.write(connection, 5, store.serialize_cdr(one, point))
    found = streams(tmp_path / 'run')
    kinds = {topic: (found[topic].kind, len(found[topic])) for topic in types}
    assert kinds == {'/cam': ('camera', 0), '/imu': ('imu', 0), '/pose': ('pose', 0)}


def test_messages_keep_the_order_of_the_file_whatever_their_times(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    name, own = 'std_msgs/msg/Header', 'sensor_msgs/msg/Imu'
    vector, none = store.types['geometry_msgs/msg/Vector3'], np.zeros(9)
    level = store.types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    with Rosbag2Writer(tmp_path / 'run', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/imu', own, typestore=store)
        for second in (1, 3, 2, 4):
            header = store.types[name](store.types['builtin_interfaces/msg/Time'](second, 0), '')
            one = store.types[own](
                header, level, none, vector(1, 2, 3), none, vector(4, 5, 6), none
            )
            writer.write(connection, second * 10**9, store.serialize_cdr(one, own))
    assert streams(tmp_path / 'run')['/imu'].stamps_ns.tolist() == [
        second * 10**9 for second in (1, 3, 2, 4)
    ]


def test_a_stamp_that_is_too_large_is_reported_with_its_line(tmp_path):
    folder = tmp_path / 'mav0' / 'cam0'
    folder.mkdir(parents=True)
    folder.joinpath('data.csv').write_text('5,5.png\n99999999999999999999,6.png\n')
    with pytest.raises(ReadError, match=r'line 2: .*too large to be a stamp'):
        read_sensors(tmp_path)


def test_an_empty_sensor_of_a_folder_is_a_stream(tmp_path):
    for name, rows in (('cam0', '5,5.png\n'), ('imu0', '')):
        folder = tmp_path / 'mav0' / name
        folder.mkdir(parents=True)
        folder.joinpath('data.csv').write_text('#timestamp\n' + rows)
    found = streams(tmp_path)
    assert (len(found['/imu0']), found['/imu0'].kind) == (0, 'imu')
