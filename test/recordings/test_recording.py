"""Every kind of recording gives the same poses; none that is damaged gives a traceback."""

from contextlib import ExitStack
from pathlib import Path
import random
import shutil

from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import yaml

from vio_eval_ros.errors import ReadError, UnsupportedMessage, VioEvalError
from vio_eval_ros.recordings import decoder
from vio_eval_ros.recordings.container import Topic
from vio_eval_ros.recordings.mcap_storage import McapStorage
from vio_eval_ros.recordings.messages import collect, PATH, PathRevisions, USUAL
from vio_eval_ros.recordings.recording import Recording

ROS2 = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg('geometry_msgs/TransformStamped[] transforms', 'tf2_msgs/msg/TFMessage')
)
START_NS = 1_403_715_273_262_142_976
STEP_NS = 5_000_000
COUNT = 60
TOPICS = {f'/{msgtype.split("/")[-1]}': msgtype for msgtype in USUAL}
POSE_TOPICS = tuple(TOPICS)
TOPICS |= {'/tf': 'tf2_msgs/msg/TFMessage', '/tf_static': 'tf2_msgs/msg/TFMessage'}
SPECS = [*POSE_TOPICS, '/tf:map.camera']


class Build:
    """Messages of one ROS version; of a topic, number k is the same in both."""

    def __init__(self, types):
        self.types = types

    def __call__(self, msgtype, **fields):
        return self.types.types[msgtype.replace('/', '/msg/')](**fields)

    def header(self, k, frame='map'):
        seconds, nanoseconds = divmod(START_NS + k * STEP_NS, 1_000_000_000)
        stamp = self('builtin_interfaces/Time', sec=seconds, nanosec=nanoseconds)
        counter = {'seq': k} if self.types is ROS1 else {}
        return self('std_msgs/Header', stamp=stamp, frame_id=frame, **counter)

    def vector(self, k, kind='geometry_msgs/Point'):
        return self(kind, x=k / 7, y=-k / 3, z=float(k))

    def quaternion(self, k):
        half = k / 10
        return self('geometry_msgs/Quaternion', x=0.0, y=np.sin(half), z=0.0, w=np.cos(half))

    def pose(self, k):
        return self('geometry_msgs/Pose', position=self.vector(k), orientation=self.quaternion(k))

    def covariant_pose(self, k):
        return self(
            'geometry_msgs/PoseWithCovariance',
            pose=self.pose(k),
            covariance=np.arange(36.0) + k,
        )

    def transform(self, k, parent, child):
        vector = self.vector(k, 'geometry_msgs/Vector3')
        return self(
            'geometry_msgs/TransformStamped',
            header=self.header(k, parent),
            child_frame_id=child,
            transform=self(
                'geometry_msgs/Transform', translation=vector, rotation=self.quaternion(k)
            ),
        )

    def message(self, topic, k):
        frame = 'map' if k % 3 else 'a_longer_name'
        if topic == '/Odometry':
            zero = self.vector(0, 'geometry_msgs/Vector3')
            twist = self('geometry_msgs/Twist', linear=zero, angular=zero)
            covariant = self(
                'geometry_msgs/TwistWithCovariance', twist=twist, covariance=np.zeros(36)
            )
            return self(
                'nav_msgs/Odometry',
                header=self.header(k, frame),
                child_frame_id='base' * (k % 2),
                pose=self.covariant_pose(k),
                twist=covariant,
            )
        if topic == '/PoseStamped':
            return self(
                'geometry_msgs/PoseStamped', header=self.header(k, frame), pose=self.pose(k)
            )
        if topic == '/PoseWithCovarianceStamped':
            return self(
                'geometry_msgs/PoseWithCovarianceStamped',
                header=self.header(k, frame),
                pose=self.covariant_pose(k),
            )
        if topic == '/PointStamped':
            return self(
                'geometry_msgs/PointStamped', header=self.header(k, frame), point=self.vector(k)
            )
        if topic == '/TransformStamped':
            return self.transform(k, frame, 'base')
        if topic == '/Path':
            poses = [self.message('/PoseStamped', j) for j in range(k + 1)]
            return self('nav_msgs/Path', header=self.header(k), poses=poses)
        edge = ('map', 'base') if topic == '/tf' else ('base', 'camera')
        return self('tf2_msgs/TFMessage', transforms=[self.transform(k, *edge)])

    def serialised(self, topic, k):
        message, msgtype = self.message(topic, k), TOPICS[topic]
        if self.types is ROS1:
            return bytes(ROS1.serialize_ros1(message, msgtype))
        return bytes(ROS2.serialize_cdr(message, msgtype))


def stream(types=ROS2, topics=TOPICS, count=COUNT):
    """Yield topic, log time and bytes of a run; the log time is not the stamp."""
    build = Build(types)
    for k in range(count):
        for topic in topics:
            if topic != '/tf_static' or k == 0:  # sent once
                yield topic, START_NS + k * STEP_NS + 123, build.serialised(topic, k)


def write_ros1(path, compression=None, types=TOPICS):
    with_suffix = path.with_suffix('.bag')
    writer = Writer1(with_suffix)
    if compression:
        writer.set_compression(compression)
    with writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=ROS1)
            for topic, msgtype in types.items()
        }
        for topic, log_time, data in stream(ROS1, types):
            writer.write(connections[topic], log_time, data)
    return with_suffix


def write_rosbag2(path, plugin, mode=CompressionMode.NONE, types=TOPICS):
    writer = Writer2(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=ROS2)
            for topic, msgtype in types.items()
        }
        for topic, log_time, data in stream(ROS2, types):
            writer.write(connections[topic], log_time, data)
    return path


def write_mcap(path, types=ROS2, profile='ros2', messages=None, defined=True, **options):
    """Write a bare mcap with the mcap library; it offers more variants than rosbags does."""
    path = path.with_suffix('.mcap')
    version = 1 if types is ROS1 else 2
    with path.open('wb') as output:
        writer = McapWriter(output, **options)
        writer.start(profile)
        channels = {}
        for topic, msgtype in TOPICS.items():
            definition, _ = types.generate_msgdef(msgtype, ros_version=version)
            definition = definition if defined else ''
            name = msgtype.replace('/msg/', '/') if types is ROS1 else msgtype
            schema = writer.register_schema(name, f'ros{version}msg', definition.encode())
            encoding = 'ros1' if types is ROS1 else 'cdr'
            channels[topic] = writer.register_channel(topic, encoding, schema)
        for topic, log_time, data in messages or stream(types):
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()
    return path


def write_foreign_mcap(path):
    """Write an mcap in which not everything is ROS."""
    path = write_mcap(path, profile='')
    foreign = path.with_name('foreign.mcap')
    with path.open('rb') as source, foreign.open('wb') as output:
        writer = McapWriter(output)
        writer.start('')
        schema = writer.register_schema('foxglove.Log', 'jsonschema', b'{}')
        log = writer.register_channel('/log', 'json', schema)
        pose = writer.register_channel(
            '/json_pose',
            'json',
            writer.register_schema('geometry_msgs/msg/PoseStamped', 'jsonschema', b'{}'),
        )
        bare = writer.register_channel('/bare', 'cdr', 0)
        ids = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.topic not in ids:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, 'cdr', known)
            writer.add_message(
                ids[channel.topic], message.log_time, message.data, message.publish_time
            )
            for other in (log, pose, bare):
                writer.add_message(other, message.log_time, b'{}', message.publish_time)
        writer.finish()
    return foreign


SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
BZ2, LZ4 = Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4
KINDS = {
    'ros1': write_ros1,
    'ros1 bz2': lambda path: write_ros1(path, BZ2),
    'ros1 lz4': lambda path: write_ros1(path, LZ4),
    'sqlite': lambda path: write_rosbag2(path, SQLITE),
    'sqlite files zstd': lambda path: write_rosbag2(path, SQLITE, CompressionMode.FILE),
    'sqlite messages zstd': lambda path: write_rosbag2(path, SQLITE, CompressionMode.MESSAGE),
    'mcap': lambda path: write_rosbag2(path, MCAP),
    'mcap zstd': lambda path: write_rosbag2(path, MCAP, CompressionMode.STORAGE),
    'mcap files zstd': lambda path: write_rosbag2(path, MCAP, CompressionMode.FILE),
    'bare sqlite': lambda path: write_rosbag2(path, SQLITE) / f'{path.name}.db3',
    'bare mcap': write_mcap,
    'bare mcap lz4': lambda path: write_mcap(path, compression=CompressionType.LZ4),
    'bare mcap small chunks': lambda path: write_mcap(path, chunk_size=1000),
    'bare mcap no chunks': lambda path: write_mcap(path, use_chunking=False),
    'bare mcap no index': lambda path: write_mcap(
        path, index_types=IndexType.NONE, use_statistics=False
    ),
    'bare mcap no repeated channels': lambda path: write_mcap(
        path, repeat_channels=False, repeat_schemas=False
    ),
    'bare mcap no summary': lambda path: write_mcap(
        path,
        index_types=IndexType.NONE,
        use_statistics=False,
        use_summary_offsets=False,
        repeat_channels=False,
        repeat_schemas=False,
    ),
    'bare mcap of ROS 1': lambda path: write_mcap(path, ROS1, 'ros1'),
    'bare mcap without definitions': lambda path: write_mcap(path, defined=False),
    'bare mcap of no profile': lambda path: write_mcap(path, profile=''),
    'bare mcap with foreign topics': write_foreign_mcap,
}


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp('recordings')


@pytest.fixture(scope='module')
def recording(folder):
    """Return a function that writes a kind of recording, once."""
    written = {}

    def write(kind):
        if kind not in written:
            (folder / kind).mkdir()
            written[kind] = KINDS[kind](folder / kind / 'run')
        return written[kind]

    return write


def expected(topic):
    """Return the poses of a topic by way of the converters alone."""
    build = Build(ROS2)
    return collected(TOPICS[topic], [build.message(topic, k) for k in range(COUNT)])


def collected(msgtype, messages):
    if msgtype != PATH:
        return collect(msgtype, messages)
    path = PathRevisions()
    for message in messages:
        path.add(collect(PATH, [message]))
    return path.final()


def assert_identical(found, wanted):
    for name in ('stamps_ns', 'positions', 'rotations', 'covariances'):
        a, b = getattr(found, name), getattr(wanted, name)
        assert (a is None) == (b is None), name
        if a is not None:
            assert a.dtype == b.dtype
            assert a.shape == b.shape
            assert a.tobytes() == b.tobytes(), name


def read(path, *specs, **options):
    with Recording(path) as opened:
        return [read.poses for read in opened.read(specs, **options)]


# --- the same poses out of everything ---


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
def test_every_kind_of_recording_gives_the_same_poses(recording, kind):
    found = read(recording(kind), *SPECS)
    *posed, transformed = found
    for topic, poses in zip(POSE_TOPICS, posed, strict=True):
        assert_identical(poses, expected(topic))
    (reference,) = read(recording('mcap'), SPECS[-1])
    assert len(reference) == COUNT
    assert_identical(transformed, reference)


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
def test_every_kind_of_recording_lists_its_topics(recording, kind):
    with Recording(recording(kind)) as opened:
        listed = {topic.name: topic for topic in opened.topics}
        assert list(listed) == sorted(listed)
    assert {name: listed[name].msgtype for name in TOPICS} == TOPICS
    assert {name: listed[name].count for name in TOPICS} == {
        name: 1 if name == '/tf_static' else COUNT for name in TOPICS
    }
    assert [name for name in TOPICS if listed[name].has_pose] == list(POSE_TOPICS)


@pytest.mark.parametrize('kind', KINDS)
def test_every_kind_of_recording_names_its_kind_and_files(recording, kind):
    path = recording(kind)
    with Recording(path) as opened:
        assert opened.kind == (
            'ros1' if path.suffix == '.bag' else 'mcap' if path.suffix == '.mcap' else 'rosbag2'
        )
        assert all(file.is_file() for file in opened.paths)
        assert opened.paths == (
            (path,)
            if path.is_file()
            else tuple(file for file in path.iterdir() if file.name != 'metadata.yaml')
        )


@pytest.mark.slow
@pytest.mark.parametrize('name', ['', '_sqlite3', '_mcap'])
def test_a_real_run_is_the_same_in_all_storages(shared_data, name):
    specs = ['/ground_truth/pose', '/vio/odometry', '/tf:odom.imu', '/tf:imu.odom']
    derived = shared_data / 'derived_bags'
    wanted = read(derived / 'euroc_V1_02_vins_fusion.bag', *specs)
    assert [len(poses) for poses in wanted] == [1671, 845, 845, 845]
    run = derived / f'euroc_V1_02_vins_fusion{name}'
    paths = [run.with_suffix('.bag')] if not name else [run, *run.glob('euroc*')]
    for path in paths:
        for found, reference in zip(read(path, *specs), wanted, strict=True):
            assert_identical(found, reference)


@pytest.mark.slow
def test_real_recordings_give_what_rosbags_and_the_converters_give(shared_data):
    compared = 0
    for path in sorted(shared_data.glob('*bags/**/*')):
        if path.suffix not in ('.bag', '.db3', '.mcap') or path.parent.name == 'damaged':
            continue
        try:
            opened = Recording(path)
        except ReadError:
            continue
        with opened, AnyReader([path], default_typestore=ROS2) as reader:
            for topic in opened.topics:
                if topic.has_pose:
                    connections = reader.topics[topic.name].connections
                    messages = (
                        reader.deserialize(data, topic.msgtype)
                        for _, _, data in reader.messages(connections)
                    )
                    (found,) = opened.read([topic.name])
                    assert_identical(found.poses, collected(topic.msgtype, messages))
                    compared += 1
    assert compared >= 15


@pytest.mark.slow
def test_the_poses_are_those_that_evo_reads(shared_data):
    evo = pytest.importorskip('evo.tools.file_interface')
    derived = shared_data / 'derived_bags'
    for path, topic in (
        (derived / 'euroc_V1_02_vins_fusion.bag', '/vio/odometry'),
        (derived / 'euroc_V1_02_vins_fusion_mcap', '/ground_truth/pose'),
        (shared_data / 'bags/robot_localization/test2.bag', '/jackal_velocity_controller/odom'),
        (shared_data / 'bags/evo/nav2_turtlebot.mcap', '/amcl_pose'),
    ):
        with AnyReader([path]) as reader:
            trajectory = evo.read_bag_trajectory(reader.readers[0], topic)
        (poses,) = read(path, topic)
        np.testing.assert_array_equal(poses.positions, trajectory.positions_xyz)
        wxyz = trajectory.orientations_quat_wxyz
        np.testing.assert_array_equal(poses.rotations, np.roll(wxyz, -1, axis=1))
        # evo's stamps are float seconds
        np.testing.assert_allclose(poses.stamps_ns / 1e9, trajectory.timestamps, rtol=0, atol=1e-6)


def single_edge(path, parent, child):
    """Return the stamps and numbers of one transform of /tf, as they lie in the recording."""
    with AnyReader([path], default_typestore=ROS2) as reader:
        rows = [
            (stamped.header.stamp, stamped.transform.translation, stamped.transform.rotation)
            for connection, _, data in reader.messages(reader.topics['/tf'].connections)
            for stamped in reader.deserialize(data, connection.msgtype).transforms
            if stamped.header.frame_id.lstrip('/') == parent
            and stamped.child_frame_id.lstrip('/') == child
        ]
    return [(t.sec * 10**9 + t.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w) for t, p, q in rows]


@pytest.mark.slow
@pytest.mark.parametrize(
    ('name', 'parent', 'child', 'count'),
    [
        ('bags/evo/tf_example', 'odom', 'base_footprint', 517),
        ('bags/evo/tf_example.bag', 'odom', 'base_footprint', 517),
        ('bags/evo/nav2_turtlebot.mcap', 'map', 'odom', 921),
        ('bags/rosbag_js/example-bz2.bag', 'world', 'turtle1', 1344),
        ('derived_bags/euroc_V1_02_vins_fusion_sqlite3', 'odom', 'imu', 845),
    ],
)
def test_a_recorded_transform_is_returned_unchanged(shared_data, name, parent, child, count):
    (poses,) = read(shared_data / name, f'/tf:{parent}.{child}')
    assert len(poses) == count
    columns = (poses.stamps_ns, poses.positions, poses.rotations)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    found = [(stamp, *position, *rotation) for stamp, position, rotation in rows]
    assert found == single_edge(shared_data / name, parent, child)


@pytest.mark.slow
def test_a_chain_through_a_real_tree_agrees_with_its_odometry(shared_data):
    """The robot publishes odom to base_link as a transform and as odometry."""
    path = shared_data / 'bags/evo/nav2_turtlebot.mcap'
    with Recording(path) as opened:
        read = opened.read(['/odom', '/tf:odom.base_link', '/tf:map.base_footprint'])
        odometry, transform, mapped = (one.poses for one in read)
        warnings = opened.warnings
    assert transform.stamps_ns.tolist() == odometry.stamps_ns.tolist()
    # the localisation begins a little later than the odometry
    assert len(mapped) == 2611
    left_out, interpolated = warnings
    assert f'{path}:/tf:map.base_footprint: left out 28 of 2639' in left_out
    # the localisation pauses for a while
    assert 'map.odom is interpolated over up to 2.3 s, for 37 of 2611 poses' in interpolated


@pytest.mark.parametrize(
    ('dynamic', 'static'),
    [('/a/tf', '/a/tf_static'), ('/a/tf', '/tf_static'), ('/tf', '/tf_static_remapped')],
)
def test_static_transforms_are_found_in_a_namespace_and_under_another_name(
    tmp_path, dynamic, static
):
    build = Build(ROS2)
    edges = [(dynamic, k, 'map', 'base') for k in range(1, 9)] + [(static, 0, 'base', 'camera')]
    msgtype = 'tf2_msgs/msg/TFMessage'
    with Writer2(tmp_path / 'run', version=9, storage_plugin=MCAP) as writer:
        connections = {
            name: writer.add_connection(name, msgtype, typestore=ROS2)
            for name in (dynamic, static)
        }
        for name, k, *edge in edges:  # the static one comes last
            message = build('tf2_msgs/TFMessage', transforms=[build.transform(k, *edge)])
            raw = bytes(ROS2.serialize_cdr(message, msgtype))
            writer.write(connections[name], START_NS + k * STEP_NS, raw)
    (poses,) = read(tmp_path / 'run', f'{dynamic}:map.camera')
    assert len(poses) == 8


# --- asking for something ---


def test_results_come_in_the_order_of_the_specs_also_when_repeated(recording):
    specs = ['/tf:map.base', '/PointStamped', '/tf:base.map', '/PointStamped']
    forward, point, backward, again = read(recording('sqlite'), *specs)
    assert forward.rotations is not None
    assert point.rotations is None
    assert_identical(point, again)
    assert not np.array_equal(forward.positions, backward.positions)


def test_all_specs_are_read_in_one_pass_that_reports_its_progress(recording):
    passes = []

    def progress(messages, total):
        passes.append([total, 0])
        for message in messages:
            passes[-1][1] += 1
            yield message

    read(recording('mcap'), '/Odometry', '/tf:map.base', '/tf:map.camera', progress=progress)
    assert passes == [[2 * COUNT + 1, 2 * COUNT + 1]]


def test_only_the_topics_asked_for_are_decoded(tmp_path):
    garbage = [('/Odometry', START_NS, b'garbage'), *stream(topics=['/PoseStamped'])]
    path = write_mcap(tmp_path / 'run', messages=garbage)
    assert len(read(path, '/PoseStamped')[0]) == COUNT
    with pytest.raises(ReadError, match=r'/Odometry: is damaged'):
        read(path, '/Odometry')


def test_a_path_is_read_as_last_revised_and_as_first_published(tmp_path):
    build = Build(ROS2)
    first, second = build.message('/Path', 3), build.message('/Path', 5)
    for pose in second.poses:
        object.__setattr__(pose.pose.position, 'x', 99.0)
    messages = [
        ('/Path', k, bytes(ROS2.serialize_cdr(message, 'nav_msgs/msg/Path')))
        for k, message in enumerate((first, second))
    ]
    path = write_mcap(tmp_path / 'run', messages=messages)
    with Recording(path) as recording:
        ((final, causal, *_),) = recording.read(['/Path'])
    assert (final.positions[:, 0] == 99).tolist() == [True] * 6
    assert (causal.positions[:, 0] == 99).tolist() == [False] * 4 + [True] * 2


def test_an_unknown_topic_is_answered_with_those_that_can_be_scored(recording):
    with pytest.raises(ReadError) as caught:
        read(recording('ros1'), '/odometry')
    message = str(caught.value)
    assert '/odometry: there is no such topic' in message
    assert f'/Odometry (nav_msgs/msg/Odometry, {COUNT})' in message
    assert f'/tf:PARENT.CHILD (tf2_msgs/msg/TFMessage, {COUNT})' in message
    assert message.endswith('; /tf has map.base; write /tf:map.base, for example')
    assert '/tf_static' not in message
    assert '\n' not in message


def test_a_topic_without_poses_is_refused_by_the_name_of_its_type(shared_data):
    path = shared_data / 'bags/robot_localization/test2.bag'
    with pytest.raises(UnsupportedMessage) as caught:
        read(path, '/imu/data')
    assert 'sensor_msgs/msg/Imu carries no pose' in str(caught.value)
    assert '/jackal_velocity_controller/odom (nav_msgs/msg/Odometry, 3060)' in str(caught.value)


@pytest.mark.parametrize(
    ('spec', 'error', 'words'),
    [
        ('/tf', UnsupportedMessage, 'write /tf:PARENT.CHILD; /tf has map.base;'),
        (
            '/Odometry:map.base',
            UnsupportedMessage,
            'carries nav_msgs/msg/Odometry, not transforms',
        ),
        ('/tf:map.nothing', ReadError, 'there are: base, camera, map'),
        ('/tf:', ReadError, 'there are: base, camera, map'),
        ('/tf_static:base.camera', ReadError, 'nothing moves'),
        ('', ReadError, 'there is no such topic'),
    ],
)
def test_what_cannot_be_scored_is_refused_with_a_reason(recording, spec, error, words):
    with pytest.raises(error, match=words):
        read(recording('bare mcap'), spec)


@pytest.mark.parametrize('name', ['ros2bag/empty_bag', 'ros2bag/empty_bag/empty_bag_0.db3'])
def test_a_recording_without_messages_has_topics_all_the_same(shared_data, name):
    with Recording(shared_data / 'bags/rosbag2' / name) as opened:
        assert Topic('/rosout', 'rcl_interfaces/msg/Log', 0) in opened.topics


def test_a_bag_without_anything_is_listed_as_empty(shared_data):
    with Recording(shared_data / 'bags/rosbag_js/no-messages.bag') as opened:
        assert opened.topics == []
        with pytest.raises(ReadError, match='no topic has poses'):
            opened.read(['/odom'])


@pytest.mark.parametrize('plugin', [SQLITE, MCAP], ids=['sqlite', 'mcap'])
def test_a_topic_without_messages_is_refused(tmp_path, plugin):
    path = tmp_path / 'run'
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        writer.add_connection('/Odometry', TOPICS['/Odometry'], typestore=ROS2)
    with pytest.raises(ReadError, match='/Odometry: has no messages'):
        read(path, '/Odometry')


def test_paths_without_poses_are_refused(tmp_path):
    build = Build(ROS2)
    empty = build('nav_msgs/Path', header=build.header(0), poses=[])
    data = bytes(ROS2.serialize_cdr(empty, 'nav_msgs/msg/Path'))
    path = write_mcap(tmp_path / 'run', messages=[('/Path', 0, data)])
    with pytest.raises(ReadError, match='/Path: its messages have no poses'):
        read(path, '/Path')


def test_paths_without_stamps_are_refused_by_the_name_of_their_topic(tmp_path):
    build = Build(ROS2)
    message = build.message('/Path', 3)
    for pose in message.poses:
        object.__setattr__(
            pose.header, 'stamp', build('builtin_interfaces/Time', sec=0, nanosec=0)
        )
    data = bytes(ROS2.serialize_cdr(message, 'nav_msgs/msg/Path'))
    path = write_mcap(tmp_path / 'run', messages=[('/Path', 0, data)])
    with pytest.raises(ReadError, match=f'{path}:/Path: .* no stamps of their own'):
        read(path, '/Path')


def test_a_topic_of_two_types_is_refused(tmp_path):
    path = tmp_path / 'run.bag'
    with Writer1(path) as writer:
        for topic in ('/Odometry', '/PoseStamped'):
            connection = writer.add_connection('/pose', TOPICS[topic], typestore=ROS1)
            writer.write(connection, START_NS, Build(ROS1).serialised(topic, 0))
    with pytest.raises(ReadError, match=r'different types: .*PoseStamped and nav_msgs'):
        read(path, '/pose')


def test_several_publishers_of_a_topic_are_one_topic(tmp_path):
    path = tmp_path / 'run.bag'
    with Writer1(path) as writer:
        for k, name in enumerate(('/a', '/b')):
            connection = writer.add_connection(
                'pose', TOPICS['/PoseStamped'], typestore=ROS1, callerid=name
            )
            writer.write(connection, START_NS + k, Build(ROS1).serialised('/PoseStamped', k))
    with Recording(path) as opened:
        # the slash that ROS 1 lets one leave out is there, so that it can be asked for
        assert opened.topics == [Topic('/pose', 'geometry_msgs/msg/PoseStamped', 2)]
        assert len(opened.read(['/pose'])[0].poses) == 2


def test_a_message_type_of_ones_own_making_is_converted_by_its_definition(tmp_path):
    """A definition that differs from the standard one counts, where it has the fields."""
    text = 'string comment\nHeader header\nPose pose\n' + '=' * 80 + '\nMSG: std_msgs/Header\n'
    text += 'builtin_interfaces/Time stamp\nstring frame_id\n' + '=' * 80
    text += '\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n' + '=' * 80
    text += '\nMSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n' + '=' * 80
    text += '\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n' + '=' * 80
    text += '\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n'
    name = 'geometry_msgs/msg/PoseStamped'
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(text, name))
    build = Build(types)
    message = build(
        'geometry_msgs/PoseStamped',
        comment='of our own',
        header=build.header(3),
        pose=build.pose(3),
    )
    path = tmp_path / 'run.mcap'
    with path.open('wb') as output:
        writer = McapWriter(output)
        writer.start('ros2')
        schema = writer.register_schema(name, 'ros2msg', text.encode())
        channel = writer.register_channel('/pose', 'cdr', schema)
        writer.add_message(channel, 1, bytes(types.serialize_cdr(message, name)), 1)
        writer.finish()
    assert_identical(read(path, '/pose')[0], collect(name, [message]))


def test_blocks_do_not_show(recording, monkeypatch):
    whole = read(recording('sqlite'), *SPECS)
    monkeypatch.setattr(decoder, 'BLOCK_BYTES', 1000)
    for found, wanted in zip(read(recording('sqlite'), *SPECS), whole, strict=True):
        assert_identical(found, wanted)


# --- rosbag2 folders ---


@pytest.mark.parametrize('plugin', ['mcap', 'sqlite3'])
def test_several_files_are_one_recording_in_recorded_order(shared_data, plugin):
    path = shared_data / 'bags/rosbag2/rosbag2_py' / plugin / 'wbag'
    with Recording(path) as opened:
        assert [file.stem for file in opened.paths] == [f'wbag_{k}' for k in range(5)]
        assert sum(topic.count for topic in opened.topics) == 6074


def split(folder, plugin, parts=12):
    """Write a rosbag2 folder of several files, each with a part of the same run."""
    folder.mkdir()
    names = []
    for part in range(parts):
        single = folder / f'run_{part}'
        with Writer2(single, version=9, storage_plugin=plugin) as writer:
            connection = writer.add_connection('/Odometry', TOPICS['/Odometry'], typestore=ROS2)
            for k in range(5 * part, 5 * part + 5):
                data = Build(ROS2).serialised('/Odometry', k)
                writer.write(connection, START_NS + k, data)
        (file,) = single.glob(f'{single.name}.*')
        shutil.move(file, folder)
        names.append(file.name)
    metadata = yaml.safe_load((single / 'metadata.yaml').read_text())
    metadata['rosbag2_bagfile_information']['relative_file_paths'] = names
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    for part in range(parts):
        shutil.rmtree(folder / f'run_{part}')
    return folder


@pytest.mark.parametrize('plugin', [SQLITE, MCAP], ids=['sqlite', 'mcap'])
def test_a_split_run_is_read_through(tmp_path, plugin):
    path = split(tmp_path / 'split', plugin)
    with Recording(path) as opened:
        assert len(opened.paths) == 12
        assert opened.topics == [Topic('/Odometry', 'nav_msgs/msg/Odometry', COUNT)]
        assert_identical(opened.read(['/Odometry'])[0].poses, expected('/Odometry'))


@pytest.mark.parametrize('plugin', [SQLITE, MCAP], ids=['sqlite', 'mcap'])
def test_a_part_without_the_topic_gives_nothing(tmp_path, plugin):
    path = split(tmp_path / 'split', plugin, parts=2)
    (other,) = write_rosbag2(tmp_path / 'run_0', plugin, types={'/tf': TOPICS['/tf']}).glob('r*')
    shutil.copy(other, path)
    passed = []

    def progress(messages, total):
        passed.extend(messages)
        return passed

    (poses,) = read(path, '/Odometry', progress=progress)
    assert len(poses) == len(passed) == 5


@pytest.mark.parametrize('plugin', [SQLITE, MCAP], ids=['sqlite', 'mcap'])
def test_a_missing_part_is_named(tmp_path, plugin):
    path = split(tmp_path / 'split', plugin)
    (missing,) = path.glob('run_7.*')
    missing.unlink()
    with pytest.raises(ReadError) as caught:
        Recording(path)
    message = str(caught.value)
    assert message.startswith(f'{missing}: there is no such file or folder, but metadata.yaml')


@pytest.mark.parametrize('plugin', [SQLITE, MCAP], ids=['sqlite', 'mcap'])
def test_metadata_with_another_qos_hides_no_messages(tmp_path, plugin):
    """As in recordings among rosbag2's own tests, of which rosbags 0.11.9 finds no message."""
    path = write_rosbag2(tmp_path / 'run', plugin)
    metadata = path / 'metadata.yaml'
    profile = (
        '[{history: keep_last, depth: 7, reliability: reliable, durability: volatile, '
        'deadline: {sec: 0, nsec: 0}, lifespan: {sec: 0, nsec: 0}, liveliness: automatic, '
        'liveliness_lease_duration: {sec: 0, nsec: 0}, avoid_ros_namespace_conventions: false}]'
    )
    text = metadata.read_text()
    assert 'offered_qos_profiles: []' in text
    metadata.write_text(
        text.replace('offered_qos_profiles: []', f'offered_qos_profiles: {profile}')
    )
    assert_identical(read(path, '/Odometry')[0], expected('/Odometry'))


@pytest.mark.parametrize('mode', [CompressionMode.NONE, CompressionMode.MESSAGE], ids=str)
def test_a_folder_that_promises_more_than_is_found_is_warned_of(tmp_path, mode):
    path = write_rosbag2(tmp_path / 'run', SQLITE, mode, {'/Odometry': TOPICS['/Odometry']})
    metadata = path / 'metadata.yaml'
    metadata.write_text(
        metadata.read_text().replace(f'message_count: {COUNT}', 'message_count: 99')
    )
    with Recording(path) as opened:
        assert opened.warnings == [
            f'{path}: metadata.yaml states 99 messages of /Odometry, but {COUNT} are there'
        ]
        assert len(opened.read(['/Odometry'])[0].poses) == COUNT


def test_an_unindexed_mcap_may_be_out_of_order(tmp_path):
    messages = list(stream(topics=['/Odometry', '/tf']))
    random.Random(3).shuffle(messages)
    path = write_mcap(tmp_path / 'run', messages=messages, use_chunking=False)
    (poses,) = read(path, '/Odometry')
    wanted = expected('/Odometry')
    assert_identical(poses[np.argsort(poses.stamps_ns)], wanted)


def test_json_that_is_not_the_type_it_says_is_refused_with_what_is_missing(recording):
    with pytest.raises(ReadError, match=r"PoseStamped is not read: .* \(without 'header'\)"):
        read(recording('bare mcap with foreign topics'), '/json_pose')


@pytest.mark.parametrize('mode', [CompressionMode.NONE, CompressionMode.FILE], ids=str)
def test_another_serialization_format_is_refused_by_name(tmp_path, mode):
    path = tmp_path / 'run'
    writer = Writer2(path, version=9)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(
            '/Odometry', TOPICS['/Odometry'], typestore=ROS2, serialization_format='protobuf'
        )
        writer.write(connection, START_NS, b'1234')
    with pytest.raises(ReadError, match='protobuf'):
        read(path, '/Odometry')


# --- what is not a recording, or a damaged one ---


def refused(path):
    """Return the one line with which a path is refused."""
    with pytest.raises(ReadError) as caught:
        Recording(path)
    message = str(caught.value)
    assert '\n' not in message
    assert message.startswith(str(path))
    return message


def test_what_is_not_there_is_refused(tmp_path):
    for name in ('run.bag', 'run', 'run.mcap', 'run.db3'):
        assert refused(tmp_path / name).endswith('there is no such file or folder')


def test_a_folder_that_is_no_recording_is_refused(tmp_path):
    assert 'has no metadata.yaml, and there is no .mcap, .db3 or .bag in it' in refused(tmp_path)


@pytest.mark.parametrize('suffix', ['.bag', '.db3', '.mcap', '.txt'])
def test_an_empty_file_is_refused(tmp_path, suffix):
    path = tmp_path / f'run{suffix}'
    path.touch()
    assert refused(path).endswith('is empty (0 bytes)')


def test_a_published_empty_file_is_refused(shared_data):
    assert 'is empty' in refused(shared_data / 'bags/rosbag_js/empty-file.bag')


@pytest.mark.parametrize('name', ['demo.bag', 'demo.mcap'])
def test_a_git_lfs_pointer_is_recognised(shared_data, name):
    message = refused(shared_data / 'bags/mcap_lfs_pointers' / name)
    assert 'a Git LFS pointer, not the recording; run `git lfs pull`' in message


def test_a_git_lfs_pointer_is_recognised_in_a_folder(tmp_path):
    path = write_rosbag2(tmp_path / 'run', SQLITE)
    (path / 'run.db3').write_text('version https://git-lfs.github.com/spec/v1\noid sha256:00\n')
    assert 'run.db3: is a Git LFS pointer' in refused(path)


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('nav2_zstd_truncated60.mcap', 'its end is missing'),
        ('tf_example_truncated60.db3', 'malformed'),
        ('tf_example_truncated70.bag', '`rosbag reindex`'),
        ('wrong_extension/tf_example_is_ros1.mcap', 'is a ROS 1 bag; rename it to end in .bag'),
    ],
)
def test_published_damage_is_refused_with_what_to_do(shared_data, name, words):
    assert words in refused(shared_data / 'derived_bags/damaged' / name)


@pytest.mark.parametrize(
    ('kind', 'suffix', 'words'),
    [
        ('bare sqlite', '.mcap', 'is an SQLite recording; rename it to end in .db3'),
        ('bare mcap', '.bag', 'is an mcap file; rename it to end in .mcap'),
        ('bare mcap', '', 'is an mcap file; rename it to end in .mcap'),
        ('ros1', '.active', 'is a ROS 1 bag; rename it to end in .bag'),
    ],
)
def test_a_recording_by_another_name_is_recognised_by_its_content(
    recording, tmp_path, kind, suffix, words
):
    path = tmp_path / f'run{suffix}'
    shutil.copy(recording(kind), path)
    assert words in refused(path)


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('run.bag', 'does not begin like a ROS 1 bag'),
        ('run.mcap', 'does not begin like an mcap file'),
        ('run.txt', 'is not a recording (expected .bag, .db3, .mcap, one of them with .zstd, or'),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path, name, words):
    path = tmp_path / name
    path.write_text('# timestamp tx ty tz qx qy qz qw\n')
    assert words in refused(path)


def test_a_file_that_may_not_be_read_is_refused(recording, monkeypatch):
    def denied(*_, **__):
        raise PermissionError(13, 'Permission denied')

    path = recording('bare mcap')
    monkeypatch.setattr(Path, 'open', denied)
    assert refused(path).endswith('there is no permission to read it')


@pytest.mark.slow
@pytest.mark.parametrize(
    'kind',
    [
        'ros1',
        'ros1 bz2',
        'ros1 lz4',
        'bare sqlite',
        'bare mcap',
        'bare mcap lz4',
        'bare mcap no chunks',
        'bare mcap no summary',
    ],
)
def test_no_damage_gives_anything_but_poses_or_one_line(recording, tmp_path, kind):
    whole = recording(kind).read_bytes()
    path = tmp_path / f'damaged{recording(kind).suffix}'
    dice, lines = random.Random(kind), []
    for attempt in range(60):
        damaged = bytearray(whole)
        if attempt % 3 == 0:
            del damaged[dice.randrange(20, len(whole)) :]
        else:
            # beginnings and ends of files are where the lengths and offsets are
            for _ in range(4):
                near = dice.choice([0, 0, len(whole) // 2, len(whole) - 2000])
                at = min(near + dice.randrange(2000), len(whole) - 1)
                damaged[at] = dice.randrange(256)
        path.write_bytes(damaged)
        try:
            read(path, *SPECS)
        except VioEvalError as error:
            lines.append(str(error).splitlines())
    assert len(lines) >= 20  # the truncated ones at the very least
    assert {len(each) for each in lines} == {1}


def test_a_changed_number_is_found_by_its_checksum(tmp_path):
    path = write_mcap(tmp_path / 'run', compression=CompressionType.NONE)
    content = bytearray(path.read_bytes())
    number = np.float64(7 / 7).tobytes()  # x of message 7
    content[content.index(number) + 3] ^= 1
    path.write_bytes(content)
    with pytest.raises(ReadError, match='crc'):
        read(path, '/PoseStamped')


def test_an_indexed_mcap_is_read_a_chunk_at_a_time(tmp_path):
    path = tmp_path / 'two_chunks.mcap'
    with path.open('wb') as file:
        writer = McapWriter(file, compression=CompressionType.NONE, chunk_size=1)
        writer.start()
        schema = writer.register_schema('geometry_msgs/msg/PoseStamped', 'ros2msg', b'')
        channel = writer.register_channel('/pose', 'cdr', schema)
        for k, data in enumerate((b'first chunk', b'second chunk')):
            writer.add_message(channel, k, data, k)
        writer.finish()
    path.write_bytes(path.read_bytes().replace(b'second chunk', b'sEcond chunk'))
    with ExitStack() as stack:
        storage = McapStorage(path, stack)
        for messages in (storage.as_written({'/pose'}), storage.messages({'/pose'})):
            log_ns, channel, raw = next(messages)
            assert (log_ns, channel.topic, raw) == (0, '/pose', b'first chunk')
            with pytest.raises(CRCValidationError):
                next(messages)
        # a chunk that ends before the part asked for, or begins after it, is not read
        assert len(list(storage.messages({'/pose'}, end_ns=0))) == 1
        assert list(storage.messages({'/pose'}, begin_ns=2)) == []


def test_a_length_beyond_all_memory_is_taken_for_damage(recording, monkeypatch):
    def exhausted(*_, **__):
        raise MemoryError

    monkeypatch.setattr('vio_eval_ros.recordings.mcap_storage.SeekingReader', exhausted)
    assert 'a length that no memory has' in refused(recording('bare mcap'))


def test_an_interruption_is_not_taken_for_damage(recording):
    def interrupted(messages, total):
        yield next(iter(messages))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        read(recording('sqlite'), '/Odometry', progress=interrupted)


def test_a_recording_is_closed_after_use(recording, monkeypatch):
    opened = []
    original = Path.open
    monkeypatch.setattr(
        Path, 'open', lambda *args, **kw: opened.append(original(*args, **kw)) or opened[-1]
    )
    read(recording('bare mcap'), '/Odometry')
    with pytest.raises(ReadError):
        read(recording('bare mcap'), '/nothing')
    assert len(opened) >= 2
    assert all(file.closed for file in opened)
