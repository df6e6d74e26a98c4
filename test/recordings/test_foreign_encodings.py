"""What Foxglove and Gazebo write into mcap files: JSON and protobuf."""

import json

from mcap.writer import Writer
import numpy as np
import pytest

from recorded import LATENCY_NS, numbers, odometry, pose, stamp, transform, vector, write
from verbs import call, complaint, document, transcript
from vio_eval_ros.errors import ReadError, UnsupportedMessage
from vio_eval_ros.recordings.recording import Recording
from vio_eval_ros.recordings.sources import read_sources

pytestmark = pytest.mark.needs('google.protobuf')

COUNT = 60
STAMPS = [stamp(k) for k in range(COUNT)]
MOVING = np.array([numbers(k)[0] for k in range(COUNT)])
TURNING = np.array([numbers(k)[1] for k in range(COUNT)])
#: messages of protobuf by name: its fields with their types, 'double' or another message
VECTOR = {axis: 'double' for axis in 'xyz'}
QUATERNION = VECTOR | {'w': 'double'}
PACKAGES = {
    'foxglove': {
        'Time': {'seconds': 'int64', 'nanos': 'int32'},
        'Vector3': VECTOR,
        'Quaternion': QUATERNION,
        'Pose': {'position': 'Vector3', 'orientation': 'Quaternion'},
        'PoseInFrame': {'timestamp': 'Time', 'frame_id': 'string', 'pose': 'Pose'},
        'PosesInFrame': {'timestamp': 'Time', 'frame_id': 'string', 'poses': ['Pose']},
        'FrameTransform': {
            'timestamp': 'Time',
            'parent_frame_id': 'string',
            'child_frame_id': 'string',
            'translation': 'Vector3',
            'rotation': 'Quaternion',
        },
        'FrameTransforms': {'transforms': ['FrameTransform']},
        'LocationFix': {
            'timestamp': 'Time',
            'latitude': 'double',
            'longitude': 'double',
            'altitude': 'double',
        },
        'Log': {'timestamp': 'Time', 'message': 'string'},
    },
    'gz.msgs': {
        'Time': {'sec': 'int64', 'nsec': 'int32'},
        'Header': {'stamp': 'Time'},
        'Vector3d': {'header': 'Header', **VECTOR},
        'Quaternion': {'header': 'Header', **QUATERNION},
        'Pose': {
            'header': 'Header',
            'name': 'string',
            'id': 'int64',
            'position': 'Vector3d',
            'orientation': 'Quaternion',
        },
        'Pose_V': {'header': 'Header', 'pose': ['Pose']},
    },
}


def file_set(package):
    """Return the definitions of a package, as they are stored in mcap: one file a message."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

    files = FileDescriptorSet()
    # those that need others first, which readers have to put in order
    for name, fields in reversed(PACKAGES[package].items()):
        file = files.file.add(name=f'{name}.proto', package=package, syntax='proto3')
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields.items(), 1):
            added = message.field.add(name=field, number=number)
            added.label = FieldDescriptorProto.LABEL_OPTIONAL
            if isinstance(kind, list):
                (kind,) = kind
                added.label = FieldDescriptorProto.LABEL_REPEATED
            if kind in PACKAGES[package]:
                added.type = FieldDescriptorProto.TYPE_MESSAGE
                added.type_name = f'.{package}.{kind}'
                if f'{kind}.proto' not in file.dependency:
                    file.dependency.append(f'{kind}.proto')
            else:
                added.type = getattr(FieldDescriptorProto, f'TYPE_{kind.upper()}')
    return files


def serializer(package, name):
    """Return a function from nested dictionaries to bytes."""
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.json_format import ParseDict
    from google.protobuf.message_factory import GetMessageClass

    pool = DescriptorPool()
    for file in reversed(file_set(package).file):
        pool.Add(file)
    kind = GetMessageClass(pool.FindMessageTypeByName(f'{package}.{name}'))
    return lambda message: ParseDict(message, kind()).SerializeToString()


def recorded(tmp_path, encoding, streams):
    """Return a bare mcap with an estimate and streams: topic -> (type, messages)."""
    folder = write(tmp_path / 'ros', 'mcap', odometry(COUNT))
    path = tmp_path / 'run.mcap'
    with Recording(folder) as source, path.open('wb') as output:
        writer = Writer(output)
        writer.start()
        (channel,) = source.channels
        schema = writer.register_schema(channel.msgtype, 'ros2msg', channel.definition.data)
        estimate = writer.register_channel(channel.topic, 'cdr', schema)
        for log_ns, _, raw in source.as_written({channel.topic}):
            writer.add_message(estimate, log_ns, raw, log_ns)
        for topic, (msgtype, messages) in streams.items():
            package, _, name = msgtype.rpartition('.')
            if encoding == 'json':
                schema = writer.register_schema(msgtype, 'jsonschema', b'{"type": "object"}')
                dump = as_json
            else:
                data = file_set(package).SerializeToString()
                schema = writer.register_schema(msgtype, 'protobuf', data)
                dump = serializer(package, name)
            number = writer.register_channel(topic, encoding, schema)
            for k, message in enumerate(messages):
                log_ns = stamp(k) + LATENCY_NS
                writer.add_message(number, log_ns, dump(message), log_ns)
        writer.finish()
    return path


def as_json(message):
    return json.dumps(message).encode()


def timestamp(k, encoding):
    seconds, nanoseconds = divmod(stamp(k), 1_000_000_000)
    names = ('sec', 'nsec') if encoding == 'json' else ('seconds', 'nanos')
    return dict(zip(names, (seconds, nanoseconds), strict=True))


def in_frame(k, encoding):
    return {'timestamp': timestamp(k, encoding), 'frame_id': 'map', 'pose': pose(k)}


def frame_transform(k, encoding, parent='map', child='base'):
    return {
        'timestamp': timestamp(k, encoding),
        'parent_frame_id': parent,
        'child_frame_id': child,
        **transform(k),
    }


def assert_moving(source):
    assert source.stamps_ns.tolist() == STAMPS
    assert source.positions.tolist() == MOVING.tolist()
    assert source.rotations.tolist() == TURNING.tolist()


@pytest.fixture(params=['json', 'protobuf'])
def encoding(request):
    return request.param


def test_a_pose_in_a_frame_is_a_pose(tmp_path, encoding):
    messages = [in_frame(k, encoding) for k in range(COUNT)]
    path = recorded(tmp_path, encoding, {'/gt/pose': ('foxglove.PoseInFrame', messages)})
    (source,) = read_sources(['/gt/pose'], path)
    assert_moving(source)
    assert source.warnings == ()
    found = document('replay', path)
    assert (found['association']['pairs'], found['inputs']['ground_truth']['source']) == (
        COUNT,
        '/gt/pose',
    )
    assert found['metrics']['ate_trans_rmse_m'] < 1e-9


def test_poses_in_a_frame_are_an_array(tmp_path, encoding):
    messages = [
        {'timestamp': timestamp(k, encoding), 'frame_id': 'map', 'poses': [pose(0), pose(k)]}
        for k in range(COUNT)
    ]
    path = recorded(tmp_path, encoding, {'/poses': ('foxglove.PosesInFrame', messages)})
    assert_moving(read_sources(['/poses[1]'], path)[0])
    with pytest.raises(ReadError, match=r'choose one: /poses\[1\] \(moves'):
        read_sources(['/poses'], path)


@pytest.mark.parametrize('several', [False, True])
def test_frame_transforms_are_a_tree(tmp_path, encoding, several):
    def message(k):
        one = frame_transform(k, encoding)
        return {'transforms': [one]} if several else one

    mount = frame_transform(5, encoding, 'base', 'camera')
    mount = {'transforms': [mount]} if several else mount
    msgtype = f'foxglove.FrameTransform{"s" * several}'
    streams = {
        '/tf': (msgtype, [message(k) for k in range(COUNT)]),
        '/tf_static': (msgtype, [mount]),
    }
    path = recorded(tmp_path, encoding, streams)
    body, camera = read_sources(['/tf:map.base', '/tf:map.camera'], path)
    assert_moving(body)
    assert len(camera) == COUNT
    assert not np.allclose(camera.positions, body.positions)
    with Recording(path) as opened:
        assert any(line.startswith('/tf:PARENT.CHILD') for line in opened.choices())


def test_location_fixes_are_positions_in_metres(tmp_path, encoding):
    from pymap3d import enu2geodetic

    places = np.column_stack(enu2geodetic(*MOVING.T, 47.4, 8.55, 500.0)).tolist()
    messages = [
        {
            'timestamp': timestamp(k, encoding),
            **dict(zip(('latitude', 'longitude', 'altitude'), place, strict=True)),
        }
        for k, place in enumerate(places)
    ]
    path = recorded(tmp_path, encoding, {'/fix': ('foxglove.LocationFix', messages)})
    (source,) = read_sources(['/fix'], path)
    moved = source.positions - source.positions[0]
    np.testing.assert_allclose(moved, MOVING - MOVING[0], atol=1e-5)


def test_poses_of_gazebo_are_chosen_by_name(tmp_path):
    def named(name, k):
        return {'name': name, **pose(k)}

    messages = [
        {
            'header': {'stamp': timestamp(k, 'json')},
            'pose': [named('ground_plane', 0), named('iris', k)],
        }
        for k in range(COUNT)
    ]
    path = recorded(tmp_path, 'protobuf', {'/world/pose/info': ('gz.msgs.Pose_V', messages)})
    (source,) = read_sources(['/world/pose/info[iris]'], path)
    assert_moving(source)
    assert 'the poses are in pose, the stamp is header.stamp' in source.warnings[0]
    with pytest.raises(ReadError, match=r'choose one: /world/pose/info\[iris\] \(moves'):
        read_sources(['/world/pose/info'], path)


def test_json_with_the_type_names_of_ros_is_read(tmp_path):
    messages = [
        {
            'header': {'stamp': {'sec': stamp(k) // 10**9, 'nanosec': stamp(k) % 10**9}},
            'pose': pose(k),
        }
        for k in range(COUNT)
    ]
    streams = {'/pose': ('geometry_msgs/msg/PoseStamped', messages)}
    assert_moving(read_sources(['/pose'], recorded(tmp_path, 'json', streams))[0])


def test_numbers_that_are_null_are_dropped(tmp_path):
    messages = [in_frame(k, 'json') for k in range(COUNT)]
    messages[7]['pose']['position'] = dict.fromkeys('xyz')
    path = recorded(tmp_path, 'json', {'/gt/pose': ('foxglove.PoseInFrame', messages)})
    found = document('replay', path)
    assert found['inputs']['ground_truth']['dropped']['non_finite'] == 1


@pytest.mark.parametrize(
    ('wrong', 'words'),
    [
        ({'timestamp': '2023-11-14T22:13:20Z'}, 'is not read: .*without'),
        ({'pose': None}, 'is not read: .*without'),
        ({'pose': {'position': vector((1, 2, 3))}}, 'is not read: .*orientation'),
        ({'timestamp': {'sec': 10**30, 'nsec': 0}}, 'damaged'),
        ({'pose': {'position': {'x': 'a', 'y': 0, 'z': 0}, 'orientation': {}}}, 'is not read'),
        ({'pose': {**pose(1), 'position': {'x': [1], 'y': 0, 'z': 0}}}, 'damaged'),
        ({'pose': {**pose(1), 'position': {'x': 'far', 'y': 0, 'z': 0}}}, 'damaged'),
    ],
)
def test_json_of_another_form_is_refused(tmp_path, wrong, words):
    messages = [in_frame(k, 'json') | wrong for k in range(5)]
    path = recorded(tmp_path, 'json', {'/gt/pose': ('foxglove.PoseInFrame', messages)})
    with pytest.raises(ReadError, match=words):
        read_sources(['/gt/pose'], path)
    assert '/gt/pose' in complaint('replay', path)


def test_what_is_not_json_is_damaged(tmp_path):
    path = recorded(tmp_path, 'json', {'/gt/pose': ('foxglove.PoseInFrame', [1, 2])})
    with pytest.raises(ReadError, match='is not read'):
        read_sources(['/gt/pose'], path)


def test_other_json_and_protobuf_is_not_read(tmp_path):
    (tmp_path / 'json').mkdir()
    log = ('foxglove.Log', [{'timestamp': timestamp(0, 'json'), 'message': 'hello'}])
    path = recorded(tmp_path / 'json', 'json', {'/log': log})
    with pytest.raises(UnsupportedMessage, match=r'foxglove.Log is not read \(json\)'):
        read_sources(['/log'], path)
    log = ('foxglove.Log', [{'timestamp': timestamp(0, 'protobuf'), 'message': 'hello'}])
    path = recorded(tmp_path, 'protobuf', {'/log': log})
    with pytest.raises(UnsupportedMessage, match=r'foxglove.Log is not read: no field of it'):
        read_sources(['/log'], path)


def test_protobuf_that_is_not_installed_is_named(tmp_path, monkeypatch):
    messages = [in_frame(k, 'protobuf') for k in range(5)]
    path = recorded(tmp_path, 'protobuf', {'/gt/pose': ('foxglove.PoseInFrame', messages)})
    monkeypatch.setitem(__import__('sys').modules, 'google.protobuf.descriptor', None)
    with pytest.raises(
        ReadError, match=r"not read \(protobuf\): pip install 'vio_eval_ros\[protobuf\]'"
    ):
        read_sources(['/gt/pose'], path)


def test_streams_that_are_not_ros_are_left_out_of_an_inspection(tmp_path, encoding):
    messages = [in_frame(k, encoding) for k in range(COUNT)]
    path = recorded(tmp_path, encoding, {'/gt/pose': ('foxglove.PoseInFrame', messages)})
    done = call('inspect', path)
    assert done.returncode == 0, transcript(done)
    assert '/gt/pose is not serialised as in ROS' in done.stdout + done.stderr
