"""What people have as truth and estimate: arrays, fixes, autopilots, and types of their own."""

from itertools import pairwise

import numpy as np
import pytest

from recorded import (
    fixes,
    header,
    KINDS,
    LATENCY_NS,
    numbers,
    odometry,
    pose,
    stamp,
    Stream,
    transform,
    write,
)
from verbs import complaint, document
from vio_eval_ros.errors import ConfigError, ReadError, UnsupportedMessage
from vio_eval_ros.recordings.definitions import converter_of, Field, MOST_FIELDS, NUMBER
from vio_eval_ros.recordings.geographic import east_north_up
from vio_eval_ros.recordings.recording import Recording
from vio_eval_ros.recordings.sources import default_topics, read_sources

COUNT = 60
STAMPS = [stamp(k) for k in range(COUNT)]
LOGGED = [stamp(k) + LATENCY_NS for k in range(COUNT)]
MOVING = np.array([numbers(k)[0] for k in range(COUNT)])
TURNING = np.array([numbers(k)[1] for k in range(COUNT)])

NAMED_POSE = 'motion_capture_tracking_interfaces/msg/NamedPose'
NAMED_POSES = 'motion_capture_tracking_interfaces/msg/NamedPoseArray'
STATES = 'gazebo_msgs/msg/ModelStates'
RIGID_BODY, RIGID_BODIES = 'mocap4r2_msgs/msg/RigidBody', 'mocap4r2_msgs/msg/RigidBodies'
VEHICLE = 'px4_msgs/msg/VehicleOdometry'
GEO_POINT, GEO_POSE = 'geographic_msgs/msg/GeoPoint', 'geographic_msgs/msg/GeoPose'
GEO_POSE_STAMPED = 'geographic_msgs/msg/GeoPoseStamped'
DEFINITIONS = {
    NAMED_POSE: 'string name\ngeometry_msgs/Pose pose',
    NAMED_POSES: f'std_msgs/Header header\n{NAMED_POSE}[] poses',
    STATES: 'string[] name\ngeometry_msgs/Pose[] pose\ngeometry_msgs/Twist[] twist',
    RIGID_BODY: 'string rigid_body_name\ngeometry_msgs/Pose pose',
    RIGID_BODIES: f'std_msgs/Header header\nuint32 frame_number\n{RIGID_BODY}[] rigidbodies',
    VEHICLE: 'uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\nfloat32[3] position\n'
    'float32[4] q\nuint8 velocity_frame\nfloat32[3] velocity',
    GEO_POINT: 'float64 latitude\nfloat64 longitude\nfloat64 altitude',
    GEO_POSE: f'{GEO_POINT} position\ngeometry_msgs/Quaternion orientation',
    GEO_POSE_STAMPED: f'std_msgs/Header header\n{GEO_POSE} pose',
}


def defined(msgtype, *needed):
    return {name: DEFINITIONS[name] for name in (*needed, msgtype)}


def read(path, *specs):
    return read_sources(specs, path)


def assert_moving(source, stamps=STAMPS):
    assert source.stamps_ns.tolist() == list(stamps)
    assert source.positions.tolist() == MOVING.tolist()
    assert source.rotations.tolist() == TURNING.tolist()


def assert_scored(path, spec, pairs=COUNT):
    """Assert that a truth, which moves as the estimate does, is scored as exact."""
    found = document('replay', path, '--estimate', '/vio/odometry', '--ground-truth', spec)
    assert found['association']['pairs'] == pairs
    assert found['metrics']['ate_trans_rmse_m'] < 1e-6
    return found


# --- without stamps ---


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize(
    ('msgtype', 'made'),
    [
        ('geometry_msgs/msg/Pose', pose),
        ('geometry_msgs/msg/PoseWithCovariance', lambda k: {'pose': pose(k)}),
        ('geometry_msgs/msg/Point', lambda k: pose(k)['position']),
        (
            'geometry_msgs/msg/Transform',
            lambda k: {'translation': pose(k)['position'], 'rotation': pose(k)['orientation']},
        ),
    ],
)
def test_what_has_no_stamp_counts_when_it_was_recorded(tmp_path, kind, msgtype, made):
    stream = Stream('/truth', msgtype, [made(k) for k in range(COUNT)])
    path = write(tmp_path / 'run', kind, odometry(), stream)
    (source,) = read(path, '/truth')
    assert source.stamps_ns.tolist() == LOGGED
    assert source.positions.tolist() == MOVING.tolist()
    assert (source.rotations is None) == msgtype.endswith('Point')
    assert 'the time at which it was recorded' in source.warnings[0]


# --- arrays ---


def of_poses(topic, *bodies):
    """Return arrays of what each body has at message k; None where it is missing."""
    messages = [
        {'header': header(k), 'poses': [one for body in bodies if (one := body(k)) is not None]}
        for k in range(COUNT)
    ]
    return Stream(topic, 'geometry_msgs/msg/PoseArray', messages)


def of_names(msgtype, bodies, count=COUNT):
    """Return arrays of the named bodies, of one of the types that have names."""
    messages = []
    for k in range(count):
        named = [(name, one) for name, body in bodies.items() if (one := body(k)) is not None]
        if msgtype == STATES:
            names, poses = zip(*named, strict=True) if named else ((), ())
            messages.append({'name': names, 'pose': poses, 'twist': [{}] * len(names)})
        elif msgtype == RIGID_BODIES:
            bodies_ = [{'rigid_body_name': name, 'pose': one} for name, one in named]
            messages.append({'header': header(k), 'rigidbodies': bodies_})
        else:
            poses = [{'name': name, 'pose': one} for name, one in named]
            messages.append({'header': header(k), 'poses': poses})
    needed = {STATES: (), RIGID_BODIES: (RIGID_BODY,), NAMED_POSES: (NAMED_POSE,)}[msgtype]
    return Stream('/poses', msgtype, messages, defined(msgtype, *needed))


def still(k):
    return {'position': {'x': 1.0, 'y': 2.0, 'z': 3.0}, 'orientation': {'w': 1.0}}


@pytest.mark.parametrize('kind', KINDS)
def test_arrays_with_one_pose_are_that_pose(tmp_path, kind):
    path = write(tmp_path / 'run', kind, odometry(), of_poses('/poses', pose))
    chosen, taken = read(path, '/poses[0]', '/poses')
    assert_moving(chosen)
    assert_moving(taken)
    assert chosen.warnings == ()
    assert taken.warnings == (f'{path}:/poses: its messages have one pose each, [0]',)
    assert_scored(path, '/poses')


def test_states_of_models_may_have_a_header_as_in_ros_2(tmp_path):
    stream = of_names(STATES, {'box': still, 'drone': pose})
    definitions = {STATES: f'std_msgs/Header header\n{DEFINITIONS[STATES]}'}
    messages = [{'header': header(k), **message} for k, message in enumerate(stream.messages)]
    path = write(
        tmp_path / 'run', 'mcap', stream._replace(messages=messages, definitions=definitions)
    )
    (source,) = read(path, '/poses[drone]')
    assert_moving(source)
    assert 'the stamp is header.stamp' in source.warnings[0]


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('msgtype', [NAMED_POSES, STATES, RIGID_BODIES])
def test_an_element_is_chosen_by_its_name(tmp_path, kind, msgtype):
    stream = of_names(msgtype, {'box': still, 'drone/base link': pose})
    path = write(tmp_path / 'run', kind, odometry(), stream)
    (source,) = read(path, '/poses[drone/base link]')
    assert_moving(source, LOGGED if msgtype == STATES else STAMPS)
    assert 'is read by its definition: the poses are in ' in source.warnings[0]
    assert len(source.warnings) == 1 + (msgtype == STATES)
    assert_scored(path, '/poses[drone/base link]')


def test_elements_are_chosen_by_index_where_they_have_no_names(tmp_path):
    path = write(tmp_path / 'run', 'mcap', of_poses('/poses', still, pose))
    assert_moving(read(path, '/poses[1]')[0])
    (quiet,) = read(path, '/poses[0]')
    assert np.ptp(quiet.positions) == 2
    with pytest.raises(ReadError, match=r'there is no \[2\]; there are: /poses\[0\], /poses\[1\]'):
        read(path, '/poses[2]')


def test_of_several_elements_none_is_taken_and_those_that_move_come_first(tmp_path):
    bodies = {f'box{k}': still for k in range(30)} | {'drone': pose}
    path = write(tmp_path / 'run', 'mcap', odometry(), of_names(NAMED_POSES, bodies))
    told = complaint('replay', path, '--estimate', '/vio/odometry', '--ground-truth', '/poses')
    assert 'choose one: /poses[drone] (moves ' in told
    assert '/poses[box0] (stands still)' in told
    assert 'and 11 more' in told
    assert 'carries no pose' not in told


def test_a_wrong_name_is_answered_with_the_nearest(tmp_path):
    bodies = {'cf231': pose, 'cf5': still}
    path = write(tmp_path / 'run', 'mcap', odometry(), of_names(NAMED_POSES, bodies))
    with pytest.raises(ReadError, match=r"no \[cf213\]; did you mean 'cf231'\?; there are: .*cf5"):
        read(path, '/poses[cf213]')


def test_messages_without_the_element_are_counted(tmp_path):
    bodies = {
        'late': lambda k: pose(k) if k >= 20 else None,
        'seldom': lambda k: still(k) if k % 2 else None,
    }
    path = write(tmp_path / 'run', 'mcap', of_names(NAMED_POSES, bodies))
    (source,) = read(path, '/poses[late]')
    assert source.stamps_ns.tolist() == STAMPS[20:]
    assert source.warnings[-1] == f'{path}:/poses: [late] is in 40 of 60 messages'
    with pytest.raises(ReadError, match='has several poses in a message'):
        read(path, '/poses')


def test_arrays_that_are_empty_at_times_are_counted(tmp_path):
    stream = of_poses('/poses', lambda k: pose(k) if k % 3 else None)
    path = write(tmp_path / 'run', 'mcap', stream)
    (source,) = read(path, '/poses')
    assert len(source) == 40
    assert any('[0] is in 40 of 60 messages' in line for line in source.warnings)
    path = write(tmp_path / 'none', 'mcap', of_poses('/poses', lambda k: None))
    for spec in ('/poses', '/poses[0]'):
        with pytest.raises(ReadError, match='its messages have no poses'):
            read(path, spec)


def test_an_index_is_doubted_where_the_number_of_poses_changes(tmp_path):
    first = [lambda k: None if 20 < k < 30 else still(k), pose]
    path = write(tmp_path / 'run', 'mcap', of_poses('/poses', *first))
    (source,) = read(path, '/poses[0]')
    assert source.warnings == (
        f'{path}:/poses: its messages have 1 to 2 poses: where one is missing, [0] may be another '
        'body',
    )
    path = write(tmp_path / 'sound', 'mcap', of_poses('/poses', still, pose))
    assert read(path, '/poses[0]')[0].warnings == ()


def test_of_two_elements_with_one_name_the_first_counts(tmp_path):
    messages = [
        {'header': header(k), 'poses': [{'name': 'a', 'pose': p} for p in (pose(k), still(k))]}
        for k in range(COUNT)
    ]
    stream = Stream('/poses', NAMED_POSES, messages, defined(NAMED_POSES, NAMED_POSE))
    path = write(tmp_path / 'run', 'mcap', stream)
    assert_moving(read(path, '/poses[a]')[0])


def test_thousands_of_elements_are_refused_without_listing_them(tmp_path):
    particles = [{'header': header(0), 'poses': [still(0)] * 3000}] * 2
    path = write(
        tmp_path / 'run', 'mcap', Stream('/cloud', 'geometry_msgs/msg/PoseArray', particles)
    )
    with pytest.raises(ReadError, match=r'and 980 more'):
        read(path, '/cloud')


def test_what_has_one_pose_has_no_elements(tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry())
    with pytest.raises(ConfigError, match=r'one pose in each message; leave out \[3\]'):
        read(path, '/vio/odometry[3]')


def test_arrays_are_listed_among_what_can_be_scored(tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry(), of_names(NAMED_POSES, {'a': pose}))
    with Recording(path) as opened:
        assert f'/poses[NAME] ({NAMED_POSES}, 60)' in opened.choice()
    with pytest.raises(ReadError, match=r'there is no such topic; .*/poses\[NAME\]'):
        read(path, '/pose[a]')


# --- on the earth ---


@pytest.mark.parametrize('kind', KINDS)
def test_fixes_are_positions_in_metres(tmp_path, kind):
    path = write(tmp_path / 'run', kind, odometry(), fixes(COUNT))
    (source,) = read(path, '/fix')
    assert source.rotations is None
    np.testing.assert_allclose(
        source.positions - source.positions[0], MOVING - MOVING[0], atol=1e-5
    )
    assert 'projected into metres east, north and up of 47.4' in source.warnings[0]
    found = assert_scored(path, '/fix')
    assert found['metrics']['ate_rot_rmse_deg'] is None


def test_messages_without_a_fix_are_dropped_and_counted(tmp_path):
    stream = fixes(COUNT)
    for k in range(5):
        stream.messages[k]['status']['status'] = -1
    for k in range(5, 8):
        stream.messages[k]['altitude'] = np.nan
    for k in range(8, 10):
        stream.messages[k] |= {'latitude': 0.0, 'longitude': 0.0}
    path = write(tmp_path / 'run', 'mcap', odometry(), stream)
    found = assert_scored(path, '/fix', pairs=50)
    assert found['inputs']['ground_truth']['dropped']['non_finite'] == 10
    assert any('10 of 60 messages have no fix' in line for line in found['warnings'])


def test_a_status_that_was_never_set_may_have_a_fix(tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry(), fixes(COUNT, status=-2))
    assert_scored(path, '/fix')


def test_a_receiver_that_never_has_a_fix_says_so(tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry(), fixes(COUNT, status=-1))
    told = complaint('replay', path, '--estimate', '/vio/odometry', '--ground-truth', '/fix')
    assert 'none of its 60 messages has a position, or a fix' in told


def test_poses_on_the_earth_keep_their_orientation(tmp_path):
    places = fixes(COUNT).messages
    messages = [
        {
            'header': header(k),
            'pose': {
                'position': {n: place[n] for n in ('latitude', 'longitude', 'altitude')},
                'orientation': pose(k)['orientation'],
            },
        }
        for k, place in enumerate(places)
    ]
    stream = Stream(
        '/geo', GEO_POSE_STAMPED, messages, defined(GEO_POSE_STAMPED, GEO_POINT, GEO_POSE)
    )
    path = write(tmp_path / 'run', 'mcap', odometry(), stream)
    (source,) = read(path, '/geo')
    assert source.rotations.tolist() == TURNING.tolist()
    expected = east_north_up(np.array([[*p.values()][2:] for p in places]))[0]
    assert source.positions.tolist() == expected.tolist()
    assert_scored(path, '/geo')


# --- which topics are taken where none is named ---


def test_a_usual_pair_is_found_beside_fixes_and_arrays(tmp_path):
    truth = Stream(
        '/gt', 'geometry_msgs/msg/PoseStamped', [{'header': header(0), 'pose': pose(0)}]
    )
    others = fixes(COUNT), of_poses('/gt_poses', pose)
    path = write(tmp_path / 'run', 'mcap', odometry(), truth, *others)
    assert default_topics(path) == ('/vio/odometry', '/gt')


def test_a_fix_named_as_truth_is_taken_where_nothing_else_is_one(tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry(), fixes(COUNT, '/ground_truth/fix'))
    assert default_topics(path) == ('/vio/odometry', '/ground_truth/fix')


# --- by definition ---

BARE = {
    'my_msgs/msg/Tracked': 'std_msgs/Header header\nmy_msgs/State state\nfloat64[3] error',
    'my_msgs/msg/State': 'uint8 mode\ngeometry_msgs/PoseWithCovariance estimate\n'
    'geometry_msgs/Twist twist',
}


@pytest.mark.parametrize('kind', KINDS)
def test_one_pose_in_a_definition_is_the_pose(tmp_path, kind):
    messages = [
        {'header': header(k), 'state': {'estimate': {'pose': pose(k)}}} for k in range(COUNT)
    ]
    stream = Stream('/state', 'my_msgs/msg/Tracked', messages, BARE)
    if kind == 'ros1':
        stream = stream._replace(definitions=dict(reversed(BARE.items())))
    path = write(tmp_path / 'run', kind, odometry(), stream)
    (source,) = read(path, '/state')
    assert_moving(source)
    assert source.warnings == (
        f'{path}:/state: my_msgs/msg/Tracked is read by its definition: the pose is '
        'state.estimate.pose, the stamp is header.stamp',
    )
    assert_scored(path, '/state')
    with Recording(path) as opened:
        assert '/state (my_msgs/msg/Tracked, 60)' in opened.choices()


@pytest.mark.parametrize(
    ('fields', 'message', 'named'),
    [
        (
            'std_msgs/Header header\ngeometry_msgs/Transform world_to_body',
            lambda k: {
                'world_to_body': {
                    'translation': pose(k)['position'],
                    'rotation': pose(k)['orientation'],
                }
            },
            'world_to_body',
        ),
        (
            'std_msgs/Header header\ngeometry_msgs/Vector3 position\n'
            'geometry_msgs/Quaternion orientation\ngeometry_msgs/Vector3 velocity',
            pose,
            'the message',
        ),
        (
            'std_msgs/Header header\ngeometry_msgs/Vector3 position\n'
            'geometry_msgs/Quaternion attitude\ngeometry_msgs/Vector3 velocity',
            lambda k: {'position': pose(k)['position'], 'attitude': pose(k)['orientation']},
            'the message',
        ),
        (
            'std_msgs/Header header\ngeometry_msgs/PoseStamped inner',
            lambda k: {'inner': {'pose': pose(k)}},
            'inner.pose',
        ),
    ],
)
def test_poses_are_recognised_by_what_they_are_made_of(tmp_path, fields, message, named):
    messages = [{'header': header(k), **message(k)} for k in range(COUNT)]
    stream = Stream('/own', 'my_msgs/msg/Own', messages, {'my_msgs/msg/Own': fields})
    path = write(tmp_path / 'run', 'mcap', stream)
    (source,) = read(path, '/own')
    assert_moving(source)
    assert f'the pose is {named}, the stamp is ' in source.warnings[0]
    assert source.warnings[0].endswith(' header.stamp')


def own(tmp_path, fields, message, stamped=True):
    """Write a type of one's own, and return the recording."""
    messages = [({'header': header(k)} if stamped else {}) | message(k) for k in range(COUNT)]
    fields = ('std_msgs/Header header\n' if stamped else '') + fields
    stream = Stream('/own', 'my_msgs/msg/Own', messages, {'my_msgs/msg/Own': fields})
    return write(tmp_path / 'run', 'mcap', odometry(), stream)


def test_the_stamp_next_to_the_pose_counts(tmp_path):
    path = own(
        tmp_path,
        'nav_msgs/Odometry state',
        lambda k: {
            'header': header(k + 3),
            'state': {'header': header(k), 'pose': {'pose': pose(k)}},
        },
    )
    (source,) = read(path, '/own')
    assert_moving(source)
    said = 'the stamp is state.header.stamp or, where it is zero, header.stamp'
    assert said in source.warnings[0]


def test_positions_alone_are_read_by_definition_too(tmp_path):
    path = own(
        tmp_path,
        'geometry_msgs/Point position\nfloat64 distance',
        lambda k: {'position': pose(k)['position']},
    )
    (source,) = read(path, '/own')
    assert source.positions.tolist() == MOVING.tolist()
    assert source.rotations is None
    assert 'the position, without orientation, is the message' in source.warnings[0]


def test_a_pose_in_a_definition_without_a_stamp_counts_when_recorded(tmp_path):
    path = own(tmp_path, 'geometry_msgs/Pose pose', lambda k: {'pose': pose(k)}, stamped=False)
    (source,) = read(path, '/own')
    assert_moving(source, LOGGED)
    assert 'it has no stamp' in source.warnings[0]
    assert 'the time at which it was recorded' in source.warnings[1]


def named(tmp_path, *bodies):
    """Write messages with a name, of one body after the other."""
    messages = [
        {'header': header(k), 'subject_name': name, 'pose': body(k)}
        for k in range(COUNT)
        for name, body in bodies
    ]
    fields = 'std_msgs/Header header\nstring subject_name\ngeometry_msgs/Pose pose'
    logged = [stamp(k) + LATENCY_NS for k in range(COUNT) for _ in bodies]
    stream = Stream('/own', 'my_msgs/msg/Own', messages, {'my_msgs/msg/Own': fields}, logged)
    return write(tmp_path / 'run', 'mcap', odometry(), stream)


def test_bodies_that_share_a_topic_are_told_apart_by_name(tmp_path):
    path = named(tmp_path, ('drone', pose), ('box', still))
    assert_moving(read(path, '/own[drone]')[0])
    with pytest.raises(ReadError, match=r'choose one: /own\[drone\] \(moves .*, /own\[box\]'):
        read(path, '/own')


def test_one_body_with_a_name_needs_no_choice(tmp_path):
    (source,) = read(named(tmp_path, ('drone', pose)), '/own')
    assert_moving(source)
    assert any('[drone]' in line for line in source.warnings)


def test_frame_transforms_of_foxglove_in_ros_are_a_tree(tmp_path):
    name = 'foxglove_msgs/msg/FrameTransform'
    definition = (
        'builtin_interfaces/Time timestamp\nstring parent_frame_id\nstring child_frame_id\n'
        'geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation'
    )
    messages = [
        {
            'timestamp': header(k)['stamp'],
            'parent_frame_id': 'map',
            'child_frame_id': 'base',
            **transform(k),
        }
        for k in range(COUNT)
    ]
    stream = Stream('/tf', name, messages, {name: definition})
    path = write(tmp_path / 'run', 'mcap', stream)
    assert_moving(read(path, '/tf:map.base')[0])


def test_of_two_poses_in_a_definition_each_is_chosen_by_its_field(tmp_path):
    path = own(
        tmp_path,
        'geometry_msgs/Pose camera\ngeometry_msgs/PoseWithCovariance body',
        lambda k: {'camera': still(k), 'body': {'pose': pose(k)}},
    )
    with pytest.raises(
        ReadError, match=r'choose one: /own\[body.pose\] \(moves .*/own\[camera\] \(stands still'
    ):
        read(path, '/own')
    assert_moving(read(path, '/own[body.pose]')[0])
    assert_scored(path, '/own[body.pose]')


def test_a_list_of_poses_in_a_definition_is_an_array(tmp_path):
    messages = [
        {'header': header(k), 'tracks': [{'id': 7, 'at': pose(k)}, {'id': 9, 'at': still(k)}]}
        for k in range(COUNT)
    ]
    definitions = {
        'my_msgs/msg/Track': 'uint32 id\nfloat32 score\ngeometry_msgs/Pose at',
        'my_msgs/msg/Tracks': 'std_msgs/Header header\nmy_msgs/Track[] tracks',
    }
    stream = Stream('/tracks', 'my_msgs/msg/Tracks', messages, definitions)
    path = write(tmp_path / 'run', 'mcap', stream)
    assert_moving(read(path, '/tracks[7]')[0])
    with pytest.raises(ReadError, match=r'choose one: /tracks\[7\]'):
        read(path, '/tracks')


def test_two_lists_of_poses_are_refused_by_name(tmp_path):
    path = own(
        tmp_path,
        'geometry_msgs/Pose[] left\ngeometry_msgs/PoseStamped[] right',
        lambda k: {},
    )
    with pytest.raises(UnsupportedMessage, match=r'several lists of poses \(left, right\)'):
        read(path, '/own')


def test_what_has_no_pose_by_its_definition_is_not_read(tmp_path):
    path = own(tmp_path, 'geometry_msgs/Quaternion orientation\nfloat64[3] position', lambda k: {})
    with pytest.raises(UnsupportedMessage) as refused:
        read(path, '/own')
    assert 'no field of it has a position (x y z) and an orientation' in str(refused.value)
    assert 'publish it as PoseStamped or Odometry; topics with poses: /vio' in str(refused.value)
    assert 'carries no pose' not in str(refused.value)


def test_numbers_of_a_pose_may_lie_in_the_message_itself(tmp_path):
    def flat(k):
        position, turn = numbers(k)
        return dict(zip(('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw'), [*position, *turn], strict=True))

    fields = '\n'.join(f'float64 {name}' for name in ('qw', 'qx', 'qy', 'qz', 'x', 'y', 'z', 'vx'))
    path = own(tmp_path, fields, flat)
    assert_moving(read(path, '/own')[0])


def of_types(types):
    """Return the fields of types, and how often they were asked for."""
    asked = []

    def fields(name):
        asked.append(name)
        return types.get(name, {})

    return fields, asked


@pytest.mark.parametrize('depth', [2, 7])
@pytest.mark.parametrize('lists', [0, 1, 2])
def test_types_nested_in_each_other_are_refused_before_long(depth, lists):
    # of which each nests many others, some of them in lists
    types = {
        f'T{i}': {f'f{j}': Field(f'T{(i * 7 + j) % 200}', lists * j % 2 == 1) for j in range(200)}
        for i in range(200 if depth > 2 else 1)
    }
    fields, asked = of_types(types)
    with pytest.raises(UnsupportedMessage, match='own: T0 is not read: ') as refused:
        converter_of('own', 'T0', fields)
    assert ('nests more than 10000 fields; publish its pose as' in str(refused.value)) == (
        depth > 2
    )
    assert len(asked) < 2 * MOST_FIELDS


def test_a_type_used_many_times_is_searched_once():
    vector = {axis: Field(NUMBER) for axis in 'xyz'}
    pose = {'position': Field('V'), 'orientation': Field('Q')}
    types = {'V': vector, 'Q': {**vector, 'w': Field(NUMBER)}, 'P': pose}
    types['Track'] = {'at': Field('P'), **{f'f{k}': Field(NUMBER) for k in range(50)}}
    types['Tracks'] = {f'track_{k}': Field('Track') for k in range(100)}
    fields, asked = of_types(types)
    converter = converter_of('own', 'Tracks', fields)
    assert 'the pose is track_0.at or track_1.at or' in converter.notes[0]
    assert asked.count('Track') < 2 * len(types['Tracks'])
    assert asked.count('Q') < 5


def test_a_definition_that_contains_itself_has_an_end():
    types = {'Node': {'next': Field('Node'), 'value': Field(NUMBER)}}
    with pytest.raises(UnsupportedMessage, match='no field of it has a position'):
        converter_of('own', 'Node', of_types(types)[0])


@pytest.mark.parametrize('kind', ['mcap', 'ros1'])
def test_a_recording_may_define_types_without_end(tmp_path, kind):
    # each nests the one before it twenty times
    names = ['std_msgs/msg/Header', *(f'my_msgs/msg/T{k}' for k in range(6))]
    definitions = {
        name: '\n'.join(f'{before} f{k}' for k in range(20)) for before, name in pairwise(names)
    }
    stream = Stream('/own', names[-1], [], definitions)
    path = write(tmp_path / 'run', kind, odometry(), stream)
    assert 'nests more than 10000 fields' in complaint(
        'replay', path, '--estimate', '/own', '--ground-truth', '/vio/odometry'
    )
    assert_moving(read(path, '/vio/odometry')[0])


def test_a_type_without_a_definition_is_not_read(tmp_path):
    stream = of_names(NAMED_POSES, {'a': pose})
    path = write(tmp_path / 'run', 'sqlite', odometry(), stream)
    strip_definitions(path)
    with pytest.raises(UnsupportedMessage) as refused:
        read(path, '/poses')
    assert 'is not read: the recording has no definition of it' in str(refused.value)
    assert 'carries no pose' not in str(refused.value)
    assert len(read(path, '/vio/odometry')[0]) == COUNT


def strip_definitions(path):
    """Make of an SQLite recording one of ROS 2 Humble, which stores no definitions."""
    import sqlite3

    (file,) = path.glob('*.db3')
    with sqlite3.connect(file) as database:
        database.execute('DELETE FROM message_definitions')
    database.close()


def test_a_known_type_defined_otherwise_is_refused_with_what_is_missing(tmp_path):
    stream = Stream('/px4', VEHICLE, [{}] * 5, {VEHICLE: 'uint64 timestamp_sample\nuint8 none'})
    path = write(tmp_path / 'run', 'mcap', stream)
    with pytest.raises(
        ReadError, match=r"is not read: here it is defined otherwise .* 'timestamp"
    ):
        read(path, '/px4')


# --- PX4 ---


def px4(count=COUNT, boot_ns=5_000_000_000, frame=1):
    """Return the motion as an autopilot has it: NED (or FRD) and FRD, w first."""
    from vio_eval_ros.core.rotation import multiply

    half = np.sqrt(0.5)
    turn = {1: (half, half, 0.0, 0.0), 2: (1.0, 0.0, 0.0, 0.0)}[frame]
    messages = []
    for k in range(count):
        (x, y, z), up = numbers(k)
        position = (y, x, -z) if frame == 1 else (x, -y, -z)
        qx, qy, qz, qw = multiply(multiply(np.array(turn), up), np.array([1.0, 0.0, 0.0, 0.0]))
        microseconds = (boot_ns + stamp(k) - stamp(0)) // 1000
        messages.append(
            {
                'timestamp': microseconds + 5,
                'timestamp_sample': microseconds,
                'pose_frame': frame,
                'position': position,
                'q': (qw, qx, qy, qz),
                'velocity': [np.nan] * 3,
            }
        )
    return Stream('/fmu/out/vehicle_odometry', VEHICLE, messages, defined(VEHICLE))


@pytest.mark.parametrize('frame', [1, 2])
@pytest.mark.parametrize('kind', KINDS)
def test_an_autopilot_is_turned_upright(tmp_path, kind, frame):
    path = write(tmp_path / 'run', kind, odometry(), px4(boot_ns=stamp(0), frame=frame))
    (source,) = read(path, '/fmu/out/vehicle_odometry')
    assert source.stamps_ns.tolist() == STAMPS
    np.testing.assert_allclose(source.positions, MOVING, atol=1e-6)  # float32
    aligned = source.rotations * np.sign((source.rotations * TURNING).sum(axis=1))[:, None]
    np.testing.assert_allclose(aligned, TURNING, atol=1e-6)
    assert 'turned to east, north, up and forward, left, up' in source.warnings[0]
    found = assert_scored(path, '/fmu/out/vehicle_odometry')
    assert found['metrics']['ate_rot_rmse_deg'] < 1e-4
    assert found['metrics']['ate_none_trans_rmse_m'] < 1e-6


def test_stamps_from_boot_are_not_compared_with_those_of_a_set_clock(tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry(), px4())
    topic = '/fmu/out/vehicle_odometry'
    told = complaint('replay', path, '--estimate', '/vio/odometry', '--ground-truth', topic)
    assert 'count from the boot of the autopilot' in told
    assert f'{topic}?stamps=recorded' in told
    found = assert_scored(path, f'{topic}?stamps=recorded')
    assert found['inputs']['ground_truth']['first_stamp_ns'] == LOGGED[0]
    (alone,) = read(path, topic)
    assert alone.stamps_ns[0] == 5_000_000_000
    both = read(path, topic, f'{topic}?stamps=header')
    assert [len(source) for source in both] == [COUNT, COUNT]
    stated = read(path, '/vio/odometry', f'{topic}?stamps=header')
    assert stated[1].stamps_ns[0] == 5_000_000_000


def test_a_frame_that_is_not_known_is_taken_as_down_and_said(tmp_path):
    stream = px4(boot_ns=stamp(0))
    for message in stream.messages:
        message['pose_frame'] = 0
    path = write(tmp_path / 'run', 'mcap', odometry(), stream)
    (source,) = read(path, '/fmu/out/vehicle_odometry')
    assert any('pose_frame is not known' in line for line in source.warnings)
    assert_scored(path, '/fmu/out/vehicle_odometry')


def test_frames_that_change_on_the_way_are_reported(tmp_path):
    stream = px4(boot_ns=stamp(0))
    stream.messages[30]['pose_frame'] = 2
    path = write(tmp_path / 'run', 'mcap', stream)
    (source,) = read(path, '/fmu/out/vehicle_odometry')
    assert any('pose_frame changes on the way' in line for line in source.warnings)


def test_positions_that_an_autopilot_calls_invalid_are_dropped(tmp_path):
    name = 'px4_msgs/msg/VehicleLocalPosition'
    definition = (
        'uint64 timestamp\nuint64 timestamp_sample\nbool xy_valid\nbool z_valid\n'
        'float32 x\nfloat32 y\nfloat32 z'
    )
    messages = [
        {
            'timestamp_sample': stamp(k) // 1000,
            'xy_valid': k >= 10,
            'z_valid': True,
            'x': numbers(k)[0][1],
            'y': numbers(k)[0][0],
            'z': -numbers(k)[0][2],
        }
        for k in range(COUNT)
    ]
    stream = Stream('/local', name, messages, {name: definition})
    path = write(tmp_path / 'run', 'mcap', odometry(), stream)
    found = assert_scored(path, '/local', pairs=50)
    assert found['inputs']['ground_truth']['dropped']['non_finite'] == 10
    assert found['metrics']['ate_rot_rmse_deg'] is None
