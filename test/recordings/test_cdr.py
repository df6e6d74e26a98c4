"""Decoding in columns gives, bit for bit, what deserialising message by message gives."""

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.recordings import cdr, messages

ROS2 = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
FORMATS = ['cdr', 'cdr big endian', 'ros1']
FRAMES = ['', 'a', 'map', 'odom', 'base_link', 'a/rather/long/frame', 'Rahmen äöü']
PATH = 'nav_msgs/msg/Path'


def random_message(types, msgtype, random, frames=FRAMES):
    """Return a message of any type, filled with random numbers and frames."""
    name = types.types[msgtype]
    fields = {}
    for field, (kind, detail) in types.fielddefs[msgtype][1]:
        if kind == 2:  # a message
            fields[field] = random_message(types, detail, random, frames)
        elif kind == 3:  # an array; of covariances
            fields[field] = random.normal(size=detail[1])
        elif detail[0] == 'string':
            fields[field] = str(random.choice(frames))
        elif detail[0] == 'float64':
            fields[field] = float(random.normal())
        else:
            fields[field] = int(random.integers(0, 2**31))
    return name(**fields)


def random_path(types, random, length, frames):
    header = random_message(types, 'std_msgs/msg/Header', random, frames)
    pose = 'geometry_msgs/msg/PoseStamped'
    poses = [random_message(types, pose, random, frames) for _ in range(length)]
    return types.types[PATH](header=header, poses=poses)


def serialise(form, message, msgtype):
    if form == 'ros1':
        return bytes(ROS1.serialize_ros1(message, msgtype))
    return bytes(ROS2.serialize_cdr(message, msgtype, little_endian=form == 'cdr'))


def deserialised(form, raw, msgtype):
    """Return the columns of serialised messages by way of rosbags and the converters."""
    read = ROS1.deserialize_ros1 if form == 'ros1' else ROS2.deserialize_cdr
    convert = messages.CONVERTERS[msgtype].rows
    return messages.columns([row for each in raw for row in convert(read(each, msgtype))])


def assert_identical(columns, expected):
    for found, wanted in zip(columns, expected, strict=True):
        assert found.dtype == wanted.dtype
        assert found.shape == wanted.shape
        assert found.tobytes() == wanted.tobytes()


@pytest.mark.parametrize('form', FORMATS)
@pytest.mark.parametrize('msgtype', cdr.LAYOUTS)
def test_columns_equal_messages_whatever_their_frames(form, msgtype):
    random = np.random.default_rng(3)
    types = ROS1 if form == 'ros1' else ROS2
    raw = [serialise(form, random_message(types, msgtype, random), msgtype) for _ in range(200)]
    assert_identical(cdr.decode(msgtype, raw, form == 'ros1'), deserialised(form, raw, msgtype))


@pytest.mark.parametrize('form', FORMATS)
@pytest.mark.parametrize('frame', FRAMES)
@pytest.mark.parametrize('length', [1, 2, 3, 50])
def test_columns_of_a_path_equal_its_poses(form, frame, length):
    types = ROS1 if form == 'ros1' else ROS2
    message = random_path(types, np.random.default_rng(3), length, [frame])
    raw = serialise(form, message, PATH)
    assert_identical(cdr.decode_path(raw, form == 'ros1'), deserialised(form, [raw], PATH))


@pytest.mark.parametrize('form', FORMATS)
def test_a_path_through_several_frames_is_left_to_rosbags(form):
    types = ROS1 if form == 'ros1' else ROS2
    raw = serialise(form, random_path(types, np.random.default_rng(3), 50, FRAMES), PATH)
    assert cdr.decode_path(raw, form == 'ros1') is None


@pytest.mark.parametrize('form', FORMATS)
def test_a_path_whose_frames_differ_only_inside_is_left_to_rosbags(form):
    """Its length is that of a path with one frame, and zeros could be read as empty strings."""
    types = ROS1 if form == 'ros1' else ROS2
    path = random_path(types, np.random.default_rng(3), 6, ['x' * 8])
    for pose, frame in zip(path.poses[2:4], ('x' * 16, ''), strict=True):
        object.__setattr__(pose.header, 'frame_id', frame)
        for part in (pose.header.stamp, pose.pose.position, pose.pose.orientation):
            for field in {'sec', 'nanosec', *'xyzw'} & set(vars(part)):
                object.__setattr__(part, field, 0)
    assert cdr.decode_path(serialise(form, path, PATH), form == 'ros1') is None


@pytest.mark.parametrize('form', FORMATS)
def test_an_empty_path_is_left_to_rosbags(form):
    types = ROS1 if form == 'ros1' else ROS2
    raw = serialise(form, random_path(types, np.random.default_rng(3), 0, FRAMES), PATH)
    assert cdr.decode_path(raw, form == 'ros1') is None


def test_layouts_are_of_types_that_have_a_converter():
    assert {*cdr.LAYOUTS} <= {*messages.CONVERTERS} - {PATH}
    assert len(cdr.LAYOUTS) >= 5


@pytest.mark.parametrize('form', FORMATS)
@pytest.mark.parametrize('msgtype', cdr.LAYOUTS)
def test_a_message_of_another_length_is_left_to_rosbags(form, msgtype):
    random, ros1 = np.random.default_rng(5), form == 'ros1'
    good = serialise(form, random_message(ROS1 if ros1 else ROS2, msgtype, random), msgtype)
    assert cdr.decode(msgtype, [good, good], ros1) is not None
    for bad in (good[:-1], good[: len(good) // 2], good[:5], b'', good + bytes(8)):
        for block in ([bad], [good, bad], [bad, good], [bad, bad]):
            assert cdr.decode(msgtype, block, ros1) is None


def test_alignment_padding_at_the_end_is_allowed_in_cdr_as_rosbags_allows_it():
    msgtype = 'geometry_msgs/msg/PoseStamped'
    raw = serialise('cdr', random_message(ROS2, msgtype, np.random.default_rng(5)), msgtype)
    padded = [raw + bytes(3), raw]
    assert_identical(cdr.decode(msgtype, padded, False), deserialised('cdr', padded, msgtype))


@pytest.mark.parametrize('preamble', [b'\x00\x02', b'\x00\x07', b'\x01\x01', b'\xff\xff'])
def test_other_encapsulations_are_left_to_rosbags(preamble):
    msgtype = 'geometry_msgs/msg/PoseStamped'
    raw = serialise('cdr', random_message(ROS2, msgtype, np.random.default_rng(5)), msgtype)
    assert cdr.decode(msgtype, [raw, preamble + raw[2:]], False) is None
    assert cdr.decode(msgtype, [preamble + raw[2:]], False) is None


@pytest.mark.slow
@pytest.mark.parametrize('form', FORMATS)
def test_no_damaged_byte_makes_it_fail_or_differ(form):
    """Each byte of each message type in turn: what is decoded is what rosbags decodes."""
    random, ros1 = np.random.default_rng(9), form == 'ros1'
    types = ROS1 if ros1 else ROS2
    cases = {t: random_message(types, t, random, ['odom']) for t in cdr.LAYOUTS}
    cases[PATH] = random_path(types, random, 3, ['map'])
    for msgtype, message in cases.items():
        raw = serialise(form, message, msgtype)
        for position in range(min(len(raw), 120)):
            for value in (0x00, 0x01, 0x40, 0x7F):  # all are text, too
                damaged = raw[:position] + bytes([value]) + raw[position + 1 :]
                if msgtype == PATH:
                    columns = cdr.decode_path(damaged, ros1)
                else:
                    columns = cdr.decode(msgtype, [damaged], ros1)
                if columns is not None:
                    assert_identical(columns, deserialised(form, [damaged], msgtype))
