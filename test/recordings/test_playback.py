"""What a recording plays: order, bytes, conversion, offers, and EuRoC's folders."""

from pathlib import Path
import sys

import numpy as np
import pytest
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import euroc
from vio_eval_ros.recordings.playback import Playback
from vio_eval_ros.recordings.storage import OfferedQos
from vio_eval_ros.simulation import simulate, write_recording

JAZZY = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
V1_02 = 'derived_bags/euroc_V1_02_vins_fusion'
POSES = {'/ground_truth/pose', '/vio/odometry'}
FIRST_NS = 1_403_636_579_763_555_584


def played(path: Path, names: set[str] | None = None) -> list[tuple[int, str, bytes]]:
    with Playback(path) as playback:
        names = names or {topic.name for topic in playback.topics}
        return list(playback.messages(names, playback.first_ns, playback.last_ns))


def test_messages_come_in_the_order_of_time_and_none_is_missing(tmp_path):
    write_recording(simulate(duration_s=5.0), tmp_path / 'run')
    messages = played(tmp_path / 'run')
    times = [log_ns for log_ns, _, _ in messages]
    assert times == sorted(times)
    with Playback(tmp_path / 'run') as playback:
        counts = {topic.name: topic.count for topic in playback.topics}
        assert (times[0], times[-1]) == (playback.first_ns, playback.last_ns)
    assert counts == {'/ground_truth/pose': 1000, '/vio/odometry': 100}
    assert [topic for _, topic, _ in messages].count('/vio/odometry') == 100


def test_a_ros1_bag_plays_what_the_same_run_in_ros2_plays(tmp_path):
    run = simulate(duration_s=5.0)
    write_recording(run, tmp_path / 'run.bag')
    write_recording(run, tmp_path / 'run')
    assert played(tmp_path / 'run.bag') == played(tmp_path / 'run')


def test_one_run_plays_the_same_from_all_three_kinds_of_recording(shared_data):
    bag, sqlite, mcap = (
        played(shared_data / (V1_02 + kind), POSES) for kind in ('.bag', '_sqlite3', '_mcap')
    )
    assert len(bag) == 1671 + 845
    assert sorted(bag) == sorted(sqlite) == sorted(mcap)


def test_both_ends_of_a_part_belong_to_it(tmp_path):
    write_recording(simulate(duration_s=2.0), tmp_path / 'run')
    whole = played(tmp_path / 'run', {'/vio/odometry'})
    with Playback(tmp_path / 'run') as playback:
        part = list(playback.messages({'/vio/odometry'}, whole[3][0], whole[9][0]))
    assert part == whole[3:10]


def test_files_out_of_order_are_played_in_order(shared_data):
    messages = played(shared_data / 'bags/rosbag_js/example-unsorted-chunks.bag')
    assert [log_ns for log_ns, _, _ in messages] == sorted(log_ns for log_ns, _, _ in messages)


def test_the_files_of_one_recording_are_merged_and_opened_when_due(shared_data):
    folder = shared_data / 'bags/rosbag2/rosbag2_py/mcap/wbag'
    messages = played(folder)
    times = [log_ns for log_ns, _, _ in messages]
    assert len(list(folder.glob('*.mcap'))) == 5
    assert times == sorted(times)
    assert len(messages) == 6074


def bag_of(path: Path, **messages: object) -> Path:
    """Write a ROS 1 bag with one message a topic."""
    with Rosbag1Writer(path) as writer:
        for k, (topic, message) in enumerate(messages.items()):
            kind = message.__msgtype__
            connection = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connection, k, ROS1.serialize_ros1(message, kind))
    return path


def test_a_ros1_image_keeps_its_pixels_and_stamp(tmp_path):
    time, header = ROS1.types['builtin_interfaces/msg/Time'], ROS1.types['std_msgs/msg/Header']
    pixels = np.arange(35, dtype=np.uint8)
    image = ROS1.types['sensor_msgs/msg/Image'](
        header(9, time(12, 34), 'cam0'), 5, 7, 'mono8', 0, 7, pixels
    )
    ((_, topic, cdr),) = played(bag_of(tmp_path / 'images.bag', image=image))
    got = JAZZY.deserialize_cdr(cdr, 'sensor_msgs/msg/Image')
    assert topic == '/image'
    assert (got.header.stamp.sec, got.header.stamp.nanosec) == (12, 34)
    assert (got.header.frame_id, got.height, got.width, got.step) == ('cam0', 5, 7, 7)
    np.testing.assert_array_equal(got.data, pixels)


def test_a_type_that_has_grown_since_ros1_gets_the_default(tmp_path):
    time, header = ROS1.types['builtin_interfaces/msg/Time'], ROS1.types['std_msgs/msg/Header']
    sonar = ROS1.types['sensor_msgs/msg/Range'](
        header(9, time(12, 34), 'sonar'), 1, 0.5, 0.25, 8.0, 1.5
    )
    ((_, _, cdr),) = played(bag_of(tmp_path / 'sonar.bag', sonar=sonar))
    got = JAZZY.deserialize_cdr(cdr, 'sensor_msgs/msg/Range')
    assert (got.header.frame_id, got.max_range, got.range, got.variance) == ('sonar', 8, 1.5, 0)


FOREVER = QosTime(2147483647, 4294967295)


def profile(reliability: str, durability: str, history: str, depth: int) -> Qos:
    return Qos(
        QosHistory[history], depth, QosReliability[reliability], QosDurability[durability],
        FOREVER, FOREVER, QosLiveliness.AUTOMATIC, FOREVER, False,
    )  # fmt: skip


@pytest.mark.parametrize('plugin', StoragePlugin)
def test_offers_are_those_of_the_recorded_publishers(tmp_path, plugin):
    profiles = {
        '/sensor': [profile('BEST_EFFORT', 'VOLATILE', 'KEEP_LAST', 5)],
        '/map': [profile('RELIABLE', 'TRANSIENT_LOCAL', 'KEEP_LAST', 1)],
        '/unknown': [profile('RELIABLE', 'VOLATILE', 'UNKNOWN', 0)],
        '/none': [],
    }
    with Rosbag2Writer(tmp_path / 'run', version=9, storage_plugin=plugin) as writer:
        for topic, offered in profiles.items():
            connection = writer.add_connection(
                topic, 'std_msgs/msg/String', typestore=JAZZY, offered_qos_profiles=offered
            )
            writer.write(connection, 1, b'\0\1\0\0\1\0\0\0\0')
    with Playback(tmp_path / 'run') as playback:
        names = [topic.name for topic in playback.topics]
        offers = {name: playback.offers.get(name, OfferedQos()) for name in names}
    assert offers == {
        '/sensor': OfferedQos(reliable=False, depth=5),
        '/map': OfferedQos(latched=True, depth=1),
        '/unknown': OfferedQos(),
        '/none': OfferedQos(),
    }


@pytest.mark.parametrize('plugin', StoragePlugin)
@pytest.mark.parametrize(('publishers', 'depth'), [(1, 1), (3, 7)])
def test_what_several_publishers_latched_is_kept_for_late_subscribers(
    tmp_path, plugin, publishers, depth
):
    latched = profile('RELIABLE', 'TRANSIENT_LOCAL', 'KEEP_LAST', 1)
    with Rosbag2Writer(tmp_path / 'run', version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection(
            '/tf_static',
            'std_msgs/msg/String',
            typestore=JAZZY,
            offered_qos_profiles=[latched] * publishers,
        )
        for k in range(7):
            writer.write(connection, k, b'\0\1\0\0\1\0\0\0\0')
    with Playback(tmp_path / 'run') as playback:
        offer = playback.offers['/tf_static']
    assert (offer.latched, offer.depth) == (True, depth)


def test_several_latching_nodes_of_ros1_are_several_publishers(tmp_path):
    path, text = tmp_path / 'run.bag', 'std_msgs/msg/String'
    message = ROS1.serialize_ros1(ROS1.types[text](data='a'), text)
    with Rosbag1Writer(path) as writer:
        for k, name in enumerate(('/a', '/b')):
            connection = writer.add_connection(
                '/tf_static', text, typestore=ROS1, callerid=name, latching=1
            )
            for time in range(3):
                writer.write(connection, 10 * time + k, message)
    with Playback(path) as playback:
        assert playback.offers['/tf_static'] == OfferedQos(latched=True, depth=6, publishers=2)


def test_a_topic_whose_definition_is_damaged_is_left_out_and_the_rest_plays(tmp_path):
    path = bag_of(
        tmp_path / 'run.bag',
        a=ROS1.types['std_msgs/msg/String'](data='a'),
        b=ROS1.types['std_msgs/msg/Float64'](data=1.0),
    )
    content = path.read_bytes()
    assert b'float64 data' in content
    path.write_bytes(content.replace(b'float64 data', b'float64 [[[a'))
    with Playback(path) as playback:
        assert [topic.name for topic in playback.topics] == ['/a']
        (warning,) = playback.warnings
        assert warning.startswith('/b has a definition of std_msgs/msg/Float64 that')
        assert len(list(playback.messages({'/a', '/b'}, 0, 10))) == 1


@pytest.mark.parametrize('name', ['no-messages.bag', 'empty-file.bag'])
def test_a_recording_without_messages_is_said_to_be_empty(shared_data, name):
    with pytest.raises(ReadError, match=r'no messages|is empty'):
        Playback(shared_data / 'bags/rosbag_js' / name)


def test_what_is_serialised_otherwise_is_left_out_with_a_word(shared_data):
    with Playback(shared_data / 'bags/rosbag2/rosbag2_tests/resources/mcap/wrong_rmw_test') as p:
        found = p.warnings, [topic.name for topic in p.topics]
    assert found[0] or found[1]


# ---- EuRoC's folders ------------------------------------------------------------------------


@pytest.fixture
def sequence(tmp_path) -> Path:
    """Return a sequence of 0.1 s: 21 inertial samples, 3 stereo images, truth and two trackers."""
    images = pytest.importorskip('PIL.Image')
    root = tmp_path / 'V9_01' / 'mav0'

    def write(sensor: str, header: str, rows: list[str]) -> Path:
        (root / sensor).mkdir(parents=True)
        (root / sensor / 'data.csv').write_text('\r\n'.join([f'#timestamp [ns],{header}', *rows]))
        return root / sensor

    stamps = [FIRST_NS + k * 5_000_000 for k in range(21)]
    write('imu0', 'w,a', [f'{s},0.1,0.2,0.3,9.1,9.2,{k}' for k, s in enumerate(stamps)])
    for camera in ('cam0', 'cam1'):
        rows = [f'{s},{s}.png' for s in stamps[::10]]
        folder = write(camera, 'filename', rows) / 'data'
        folder.mkdir()
        for k, stamp in enumerate(stamps[::10]):
            pixels = np.full((4, 6), 10 * k + (camera == 'cam1'), np.uint8)
            pixels[1, 2] = 255
            images.fromarray(pixels).save(folder / f'{stamp}.png')
    pose = '1,2,3,0.5,0.1,-0.7,0.5'
    write('state_groundtruth_estimate0', 'p,q,v,b', [f'{s},{pose},0,0,0' for s in stamps])
    write('leica0', 'p', [f'{stamps[3]},4,5,6'])
    write('vicon0', 'p,q', [f'{stamps[4]},{pose}'])
    return root


@pytest.fixture
def folder(sequence) -> Path:
    return sequence.parent


def test_a_euroc_folder_plays_the_topics_of_euroc_s_bags(folder, sequence):
    for path in (folder, sequence):
        with Playback(path) as playback:
            assert {topic.name: (topic.msgtype, topic.count) for topic in playback.topics} == {
                '/imu0': ('sensor_msgs/msg/Imu', 21),
                '/cam0/image_raw': ('sensor_msgs/msg/Image', 3),
                '/cam1/image_raw': ('sensor_msgs/msg/Image', 3),
                '/ground_truth/pose': ('geometry_msgs/msg/PoseStamped', 21),
                '/leica/position': ('geometry_msgs/msg/PointStamped', 1),
                '/vicon/firefly_sbx/firefly_sbx': ('geometry_msgs/msg/TransformStamped', 1),
            }
            assert playback.last_ns - playback.first_ns == 100_000_000


def decoded(path: Path, topic: str) -> list:
    with Playback(path) as playback:
        (msgtype,) = [found.msgtype for found in playback.topics if found.name == topic]
        messages = playback.messages({topic}, playback.first_ns, playback.last_ns)
        return [(log_ns, JAZZY.deserialize_cdr(cdr, msgtype)) for log_ns, _, cdr in messages]


def test_the_messages_of_a_euroc_folder_have_its_values(folder):
    log_ns, image = decoded(folder, '/cam1/image_raw')[2]
    assert log_ns == FIRST_NS + 100_000_000
    assert image.header.stamp.sec * 10**9 + image.header.stamp.nanosec == log_ns
    assert (image.height, image.width, image.step, image.encoding) == (4, 6, 6, 'mono8')
    assert image.header.frame_id == 'cam1'
    assert image.data.reshape(4, 6)[1].tolist() == [21, 21, 255, 21, 21, 21]

    imu = decoded(folder, '/imu0')[7][1]
    rate, acceleration = imu.angular_velocity, imu.linear_acceleration
    assert (rate.x, rate.y, rate.z) == (0.1, 0.2, 0.3)
    assert (acceleration.x, acceleration.y, acceleration.z) == (9.1, 9.2, 7)
    assert imu.orientation_covariance[0] == -1

    truth = decoded(folder, '/ground_truth/pose')[0][1].pose
    position, rotation = truth.position, truth.orientation
    assert (position.x, position.y, position.z) == (1, 2, 3)
    assert (rotation.w, rotation.x, rotation.y, rotation.z) == (0.5, 0.1, -0.7, 0.5)

    point = decoded(folder, '/leica/position')[0][1].point
    assert (point.x, point.y, point.z) == (4, 5, 6)
    transform = decoded(folder, '/vicon/firefly_sbx/firefly_sbx')[0][1].transform
    assert (transform.translation.z, transform.rotation.w) == (3, 0.5)


def test_inertial_data_comes_before_the_image_of_the_same_stamp(folder):
    order = [(log_ns, topic) for log_ns, topic, _ in played(folder)]
    assert order.index((FIRST_NS, '/imu0')) < order.index((FIRST_NS, '/cam0/image_raw'))
    assert [log_ns for log_ns, _ in order] == sorted(log_ns for log_ns, _ in order)


def test_without_pillow_images_say_what_to_install_and_the_rest_plays(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, 'PIL', None)
    with pytest.raises(ReadError, match=r'pip install pillow.*--topics'):
        played(folder)
    assert len(played(folder, {'/imu0'})) == 21


def test_an_image_that_is_missing_is_named(folder, sequence):
    stamp = FIRST_NS + 50_000_000
    (sequence / 'cam0' / 'data' / f'{stamp}.png').unlink()
    with pytest.raises(ReadError, match=f'{stamp}.*No such file'):
        played(folder)


@pytest.mark.parametrize('row', ['12,1,2', 'x,1,2,3,4,5,6', '12,1,2,3,4,5,east'])
def test_a_row_that_is_none_is_named(folder, sequence, row):
    with (sequence / 'imu0' / 'data.csv').open('a') as file:
        file.write(f'\r\n{row}\r\n')
    with pytest.raises(ReadError, match='imu0'):
        played(folder)


@pytest.mark.parametrize('name', euroc.SENSORS)
def test_every_sensor_makes_messages_of_the_type_that_it_names(folder, name):
    sensor = euroc.SENSORS[name]
    messages = decoded(folder, sensor.topic)
    assert all(message.header.frame_id == sensor.frame for _, message in messages)
    assert {message.__msgtype__ for _, message in messages} == {sensor.msgtype}
