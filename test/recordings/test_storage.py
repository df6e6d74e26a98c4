"""How channels find the definition of their messages, and how names are spelled."""

import pytest
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.recordings.storage import (
    Channel,
    Definition,
    OfferedQos,
    RefusedError,
    rooted,
    spelled,
    standard_types,
)

ROS2 = get_typestore(Stores.ROS2_JAZZY)
POSE = 'geometry_msgs/msg/PoseStamped'
TEXT = ROS2.generate_msgdef(POSE, ros_version=2)[0]
RULE = '=' * 80 + '\n'


def channel(msgtype: str, encoding: str, text: str | bytes, messages: str = 'cdr') -> Channel:
    data = text if isinstance(text, bytes) else text.encode()
    return Channel('/pose', msgtype, 1, messages, Definition(encoding, data))


def fields(types: object, msgtype: str) -> list[str]:
    return [name for name, _ in types.fielddefs[msgtype][1]]


def test_a_type_is_what_the_file_defines():
    types = channel(POSE, 'ros2msg', f'int8 first\n{TEXT}').types()
    assert fields(types, POSE) == ['first', 'header', 'pose']


@pytest.mark.parametrize(
    ('encoding', 'text'),
    [('', ''), ('ros2msg', ''), ('ros2msg', ' \n'), ('jsonschema', '{}'), ('protobuf', b'\xff')],
)
def test_without_a_definition_it_is_the_standard_one(encoding, text):
    assert channel(POSE, encoding, text).types() is standard_types(ros1=False)
    assert channel(POSE, encoding, text, 'ros1').types() is standard_types(ros1=True)


def test_what_a_definition_only_mentions_is_the_standard_one():
    own = 'my_msgs/msg/Tracked'
    text = 'std_msgs/Header header\ngeometry_msgs/PoseWithCovariance[] poses\nOther[2] others\n'
    types = channel(own, 'ros2msg', f'{text}{RULE}MSG: my_msgs/Other\nfloat64[<=3] x\n').types()
    assert fields(types, 'geometry_msgs/msg/Point') == ['x', 'y', 'z']
    assert fields(types, 'my_msgs/msg/Other') == ['x']
    assert 'nav_msgs/msg/Odometry' not in types.fielddefs


def test_what_a_definition_defines_is_not_the_standard_one():
    text = f'Point point\n{RULE}MSG: geometry_msgs/Point\nfloat32 x\nfloat32 y\nfloat32 z\n'
    types = channel('geometry_msgs/msg/Spot', 'ros2msg', text).types()
    point = types.types['geometry_msgs/msg/Point'](x=1.0, y=2.0, z=3.0)
    assert len(types.serialize_cdr(point, 'geometry_msgs/msg/Point')) == 4 + 12


@pytest.mark.parametrize('rule', [RULE, '=' * 40 + '\n'])
def test_definitions_in_idl_are_read(rule):
    text = (
        f'{rule}IDL: my_msgs/msg/Spot\n#include "geometry_msgs/msg/Point.idl"\n'
        'module my_msgs { module msg {\n  struct Spot { geometry_msgs::msg::Point point; '
        'long count; };\n}; };\n'
        f'{rule}IDL: geometry_msgs/msg/Point\n'
        'module geometry_msgs { module msg { struct Point { double x; double y; }; }; };\n'
    )
    types = channel('my_msgs/msg/Spot', 'ros2idl', text).types()
    assert fields(types, 'my_msgs/msg/Spot') == ['point', 'count']
    assert fields(types, 'geometry_msgs/msg/Point') == ['x', 'y']


@pytest.mark.parametrize('encoding', ['ros2msg', 'ros2idl'])
def test_a_damaged_definition_is_an_error_when_it_is_asked_for(encoding):
    damaged = channel(POSE, encoding, 'float64 [[[')
    with pytest.raises(RefusedError, match=f'has a definition of {POSE} that cannot be read'):
        damaged.types()


def test_comments_may_be_in_any_encoding():
    types = channel(POSE, 'ros2msg', b'# J\xfcrgen, 5 \xb0\n' + TEXT.encode()).types()
    assert fields(types, POSE) == ['header', 'pose']


def test_definitions_of_ros1_lead_to_its_standard_types():
    types = channel('my_msgs/msg/A', 'ros1msg', 'Header header\n', 'ros1').types()
    assert fields(types, 'std_msgs/msg/Header') == ['seq', 'stamp', 'frame_id']


@pytest.mark.parametrize(
    ('stored', 'shown'),
    [
        ('nav_msgs/Odometry', 'nav_msgs/msg/Odometry'),
        ('nav_msgs/msg/Odometry', 'nav_msgs/msg/Odometry'),
        ('nav_msgs::msg::dds_::Odometry_', 'nav_msgs/msg/Odometry'),
        ('my_msgs/srv/Plan_Event', 'my_msgs/srv/Plan_Event'),
        ('foxglove.PoseInFrame', 'foxglove.PoseInFrame'),
        ('*', '*'),
        ('', ''),
    ],
)
def test_types_are_spelled_as_ros2_does(stored, shown):
    assert spelled(stored) == shown


@pytest.mark.parametrize('topic', ['/a/b', 'a/b', '//a//b', 'a/b/'])
def test_topics_begin_with_a_slash(topic):
    assert rooted(topic) == '/a/b'


def test_what_all_publishers_offer_is_offered():
    latched, lossy = OfferedQos(latched=True, depth=1), OfferedQos(reliable=False, depth=5)
    assert OfferedQos.common([latched, latched]) == OfferedQos(True, True, 1, publishers=2)
    assert OfferedQos.common([latched, lossy]) == OfferedQos(False, False, 5, publishers=2)
    assert OfferedQos.common([]) == OfferedQos()
