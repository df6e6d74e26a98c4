"""A motion is found through any TF tree, and is what composing the transforms by hand gives."""

from types import SimpleNamespace as Message

import numpy as np
import pytest

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.transforms import static_topics, TransformTree

TURN_Z_90 = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
IDENTITY = (0.0, 0.0, 0.0, 1.0)


def transform(parent, child, stamp_ns, translation, rotation=IDENTITY):
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    x, y, z = (float(value) for value in translation)
    qx, qy, qz, qw = rotation
    return Message(
        header=Message(stamp=Message(sec=seconds, nanosec=nanoseconds), frame_id=parent),
        child_frame_id=child,
        transform=Message(
            translation=Message(x=x, y=y, z=z), rotation=Message(x=qx, y=qy, z=qz, w=qw)
        ),
    )


def tree(dynamic=(), static=()):
    built = TransformTree('/tf', ['/tf_static'])
    built.add(Message(transforms=list(static)), '/tf_static')
    for each in dynamic:
        built.add(Message(transforms=[each]))
    return built


def moving(parent, child, stamps_ns, rotation=IDENTITY):
    """Return transforms along x, at as many metres as the stamp has nanoseconds."""
    return [transform(parent, child, stamp, (stamp, 0, 0), rotation) for stamp in stamps_ns]


def test_a_single_transform_is_returned_as_it_was_recorded():
    unnormalised = (0.0, 0.0, 0.6, 0.9)
    poses = tree(moving('odom', 'base', [3, 1, 1, 2], unnormalised)).lookup('odom.base')
    assert poses.stamps_ns.tolist() == [3, 1, 1, 2]
    assert poses.positions[:, 0].tolist() == [3, 1, 1, 2]
    assert poses.rotations.tolist() == [list(unnormalised)] * 4


def test_the_way_back_is_the_inverse():
    poses = tree(moving('odom', 'base', [1, 2], TURN_Z_90)).lookup('base.odom')
    np.testing.assert_allclose(poses.positions, [[0, 1, 0], [0, 2, 0]], atol=1e-15)
    np.testing.assert_allclose(poses.rotations, [[0, 0, -np.sqrt(0.5), np.sqrt(0.5)]] * 2)


def test_static_transforms_are_chained_on_both_sides():
    built = tree(
        moving('odom', 'base', [1, 2]),
        [
            transform('map', 'odom', 0, (0, 10, 0), TURN_Z_90),
            transform('base', 'camera', 0, (0, 0, 1), TURN_Z_90),
        ],
    )
    poses = built.lookup('map.camera')
    # odom's x axis is map's y axis
    np.testing.assert_allclose(poses.positions, [[0, 11, 1], [0, 12, 1]], atol=1e-15)
    np.testing.assert_allclose(np.abs(poses.rotations), [[0, 0, 1, 0]] * 2, atol=1e-15)
    assert poses.stamps_ns.tolist() == [1, 2]


def test_two_branches_are_joined_through_their_common_parent():
    built = tree(moving('world', 'a', [5, 6]), [transform('world', 'b', 0, (1, 0, 0), TURN_Z_90)])
    # seen from b, the x axis of the world points along -y
    np.testing.assert_allclose(built.lookup('b.a').positions, [[0, -4, 0], [0, -5, 0]], atol=1e-15)


def test_the_densest_transform_gives_the_stamps_and_others_are_interpolated():
    sparse = [
        transform('map', 'odom', 0, (0, 0, 0)),
        transform('map', 'odom', 10, (0, 100, 0), TURN_Z_90),
    ]
    poses = tree([*sparse, *moving('odom', 'base', [0, 4, 5, 10])]).lookup('map.base')
    assert poses.stamps_ns.tolist() == [0, 4, 5, 10]
    angles = 2 * np.arctan2(poses.rotations[:, 2], poses.rotations[:, 3])
    np.testing.assert_allclose(np.degrees(angles), [0, 36, 45, 90], atol=1e-12)
    expected = [
        [0, 0, 0],
        [4 * np.cos(np.radians(36)), 40 + 4 * np.sin(np.radians(36)), 0],
        [5 * np.sqrt(0.5), 50 + 5 * np.sqrt(0.5), 0],
        [0, 110, 0],
    ]
    np.testing.assert_allclose(poses.positions, expected, atol=1e-12)


def test_rotations_are_interpolated_on_the_shorter_arc():
    negated = tuple(-value for value in TURN_Z_90)
    sparse = [
        transform('map', 'odom', 0, (0, 0, 0)),
        transform('map', 'odom', 10, (0, 0, 0), negated),
    ]
    poses = tree([*sparse, *moving('odom', 'base', [0, 5, 10])]).lookup('map.base')
    half = np.radians(45) / 2
    np.testing.assert_allclose(
        np.abs(poses.rotations[1]), [0, 0, np.sin(half), np.cos(half)], atol=1e-12
    )


def test_stamps_outside_the_other_transforms_are_left_out_and_counted():
    sparse = [transform('map', 'odom', stamp, (0, stamp, 0)) for stamp in (3, 6)]
    built = tree([*sparse, *moving('odom', 'base', range(1, 9))])
    assert built.lookup('map.base').stamps_ns.tolist() == [3, 4, 5, 6]
    (warning,) = built.warnings
    assert warning.startswith('/tf:map.base: left out 4 of 8 poses')


@pytest.mark.parametrize(('gap_s', 'said'), [(1, False), (10, True)])
def test_a_transform_that_is_interpolated_over_long_is_said_to_be(gap_s, said):
    second = 1_000_000_000
    known = [0, second, (1 + gap_s) * second, (2 + gap_s) * second]
    sparse = [transform('map', 'odom', stamp, (0, stamp / second, 0)) for stamp in known]
    built = tree([*sparse, *moving('odom', 'base', range(0, known[-1] + 1, second // 2))])
    assert len(built.lookup('map.base')) == 2 * (2 + gap_s) + 1
    expected = 'map.odom is interpolated over up to 10 s, for 19 of 25 poses'
    assert [expected in one for one in built.warnings] == [True] * said


def test_a_transform_that_came_once_is_constant_and_said_to_be():
    built = tree([transform('map', 'odom', 2, (0, 7, 0)), *moving('odom', 'base', [1, 2, 3])])
    poses = built.lookup('map.base')
    assert poses.stamps_ns.tolist() == [1, 2, 3]
    assert poses.positions.tolist() == [[1, 7, 0], [2, 7, 0], [3, 7, 0]]
    (warning,) = built.warnings
    assert warning.startswith('/tf:map.base: map.odom came only once, at 0.00 s')


@pytest.mark.parametrize('rotation', [TURN_Z_90, (0.0, 0.0, 0.6, 0.6)])
@pytest.mark.parametrize('noise', [0.0, 1e-9])
def test_a_transform_that_never_changes_leads_no_chain_however_often_it_comes(rotation, noise):
    signs = [1, -1]  # a quaternion and its negative are one rotation
    constant = [
        transform(
            'base', 'imu', stamp, (1 + noise * signs[stamp % 2], 0, 0),
            tuple(signs[stamp % 2] * value for value in rotation),
        )
        for stamp in range(100)
    ]  # fmt: skip
    built = tree([*constant, *moving('odom', 'base', [20, 40, 60])])
    poses = built.lookup('odom.imu')
    assert poses.stamps_ns.tolist() == [20, 40, 60]
    np.testing.assert_allclose(poses.positions[:, 0], [21, 41, 61], atol=1e-8)
    assert not built.warnings


def test_poses_outside_the_time_of_a_constant_transform_are_kept_and_counted():
    constant = [transform('map', 'odom', stamp, (0, 7, 0)) for stamp in (3, 4, 5, 6)]
    built = tree([*constant, *moving('odom', 'base', [1, 4, 5, 8])])
    assert built.lookup('map.base').stamps_ns.tolist() == [1, 4, 5, 8]
    (warning,) = built.warnings
    assert 'map.odom never changes and is used as a constant, also for 2 of 4 poses' in warning


def test_a_correction_that_is_sent_again_and_again_does_not_lead():
    """Localisation sends map to odom ahead of time and often, though it changes now and then."""
    steps = [transform('map', 'odom', stamp, (0, stamp // 50, 0)) for stamp in range(0, 200, 2)]
    poses = tree([*steps, *moving('odom', 'base', range(0, 198, 10))]).lookup('map.base')
    assert poses.stamps_ns.tolist() == list(range(0, 198, 10))
    # as tf2 does, a step is a line between the two transforms around it
    assert poses.positions[:, 1].tolist() == [stamp // 50 for stamp in range(0, 198, 10)]


@pytest.mark.parametrize('ratio', [1, 4])
def test_a_transform_that_two_publishers_send_in_turn_breaks_a_chain(ratio):
    """Two nodes localise the robot, one of them wrongly; neither changes what it sends."""
    corrections = [
        transform('map', 'odom', 50_000_000 * k, (0.0 if k % (ratio + 1) else 2.0, 0, 0))
        for k in range(400)
    ]
    steps = np.arange(400)
    base = [
        transform('odom', 'base', 50_000_000 * k + 1, (np.sin(k / 40), np.cos(k / 30), 0))
        for k in steps.tolist()
    ]
    built = tree([*corrections, *base])
    with pytest.raises(ReadError, match=r'map\.base: map\.odom: poses of two trajectories, 2 m'):
        built.lookup('map.base')
    assert len(built.lookup('odom.base')) == 400


def test_a_slow_motion_is_one_though_no_step_of_it_is_seen():
    slow = [transform('odom', 'base', stamp, (stamp * 4e-7, 0, 0)) for stamp in range(10)]
    built = tree(slow, [transform('base', 'imu', 0, (0, 0, 1))])
    assert len(built.lookup('odom.imu')) == 10
    assert not built.warnings


def test_a_chain_in_which_nothing_moves_is_said_to_be_one():
    built = tree([transform('odom', 'base', stamp, (1, 0, 0)) for stamp in range(10)])
    assert len(built.lookup('odom.base')) == 10
    assert built.warnings == ['/tf:odom.base: nothing moves: odom.base never changes']


def test_the_latest_of_several_static_transforms_counts():
    static = [transform('base', 'imu', 0, (0, 0, z)) for z in (1, 2)]
    built = tree(moving('odom', 'base', [1, 2]), static)
    assert built.lookup('odom.imu').positions.tolist() == [[1, 0, 2], [2, 0, 2]]
    (warning,) = built.warnings
    assert 'the static base.imu came with different values; the last is used' in warning


def test_unordered_and_repeated_samples_are_interpolated_in_order():
    sparse = [transform('map', 'odom', stamp, (0, stamp, 0)) for stamp in (10, 0, 10, 5)]
    poses = tree([*sparse, *moving('odom', 'base', [1, 2, 7, 8, 9])]).lookup('map.base')
    assert poses.positions[:, 1].tolist() == [1, 2, 7, 8, 9]


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_numbers_that_are_not_finite_stay_with_their_own_poses(value):
    broken = [transform('odom', 'base', stamp, (0, value, 0)) for stamp in (3, 4)]
    sparse = [transform('map', 'odom', stamp, (0, 0, 0)) for stamp in (0, 10)]
    static = [transform('base', 'imu', 0, (0, 0, 1), TURN_Z_90)]
    built = tree([*sparse, *broken, *moving('odom', 'base', [5, 6])], static)
    finite = np.isfinite(built.lookup('imu.map').positions).all(axis=1)
    assert finite.tolist() == [False, False, True, True]


def test_a_quaternion_of_zeros_leaves_no_number_that_could_be_mistaken():
    built = tree(
        [*moving('odom', 'base', [1], (0.0, 0.0, 0.0, 0.0)), *moving('odom', 'base', [2])],
        [transform('base', 'imu', 0, (0, 0, 1))],
    )
    assert np.isnan(built.lookup('odom.imu').rotations).all(axis=1).tolist() == [True, False]


def test_two_writers_of_one_child_make_two_edges():
    built = tree([*moving('odom', 'base', [1, 2]), *moving('map', 'base', [11, 12])])
    assert built.lookup('odom.base').stamps_ns.tolist() == [1, 2]
    assert built.lookup('map.base').stamps_ns.tolist() == [11, 12]


def test_leading_slashes_mean_nothing():
    built = tree(moving('/odom', '/base', [1]))
    for frames in ('odom.base', '/odom./base', 'odom./base'):
        assert len(built.lookup(frames)) == 1


@pytest.mark.parametrize(
    ('parent', 'child'), [('robot.1/odom', 'robot.1/base.link'), ('a.b', 'c'), ('a', 'b.c')]
)
def test_frames_may_contain_dots(parent, child):
    built = tree(moving(parent, child, [1, 2]))
    assert len(built.lookup(f'{parent}.{child}')) == 2


def test_names_that_can_be_split_in_two_ways_are_refused():
    built = tree([*moving('a', 'b.c', [1]), *moving('a.b', 'c', [1])])
    with pytest.raises(ReadError, match=r'expected PARENT\.CHILD of two known frames'):
        built.lookup('a.b.c')


@pytest.mark.parametrize(
    ('frames', 'answer'),
    [
        ('map.bose', r"no frame 'bose'; there are: base, map; did you mean 'base'\?"),
        ('mop.base', r"no frame 'mop'; there are: base, map; did you mean 'map'\?"),
        ('/world.imu', r"no frames 'world' and 'imu'; there are: base, map$"),
        ('map', r'expected PARENT\.CHILD of two known frames; there are: base, map$'),
        ('', r'expected PARENT\.CHILD of two known frames; there are: base, map$'),
        ('.', r"no frames '' and ''; there are: base, map$"),
    ],
)
def test_unknown_frames_are_answered_with_the_known_ones(frames, answer):
    with pytest.raises(ReadError, match=answer):
        tree(moving('map', 'base', [1])).lookup(frames)


def test_of_many_frames_the_first_are_listed():
    built = tree([each for k in range(60) for each in moving('map', f'leg_{k:02}', [1])])
    with pytest.raises(ReadError, match=r"leg_39 and 21 more; did you mean 'leg_59'"):
        built.lookup('map.leg_592')


def test_frames_that_are_not_connected_are_answered_with_what_each_is_connected_with():
    built = tree([*moving('map', 'base', [1]), *moving('world', 'drone', [1])])
    with pytest.raises(
        ReadError,
        match=r'no transforms connect the two: map is connected with base and drone with world, '
        r'but the one between these is missing$',
    ):
        built.lookup('map.drone')


def test_two_spellings_of_a_frame_that_break_a_chain_are_named():
    built = tree([*moving('map', 'odom', [1]), *moving('robot1/odom', 'base', [1])])
    with pytest.raises(ReadError, match=r"are 'odom' and 'robot1/odom' the same\?$"):
        built.lookup('map.base')


def test_a_recording_without_static_transforms_is_said_to_be_one():
    built = TransformTree('/tf')
    built.add(Message(transforms=moving('odom', 'base', [1])))
    with pytest.raises(ReadError, match=r"no frame 'imu'.*; no static transforms were recorded"):
        built.lookup('odom.imu')


def test_the_static_transforms_of_a_namespace_come_before_those_around_it():
    built = TransformTree('/a/tf', ['/a/tf_static', '/tf_static'])
    built.add(Message(transforms=moving('odom', 'base', [1, 2])))
    built.add(Message(transforms=[transform('base', 'imu', 0, (0, 0, 1))]), '/a/tf_static')
    around = [transform('base', 'imu', 0, (0, 0, 5)), transform('map', 'odom', 0, (0, 3, 0))]
    built.add(Message(transforms=around), '/tf_static')
    assert built.lookup('odom.imu').positions.tolist() == [[1, 0, 1], [2, 0, 1]]
    assert built.lookup('map.imu').positions.tolist() == [[1, 3, 1], [2, 3, 1]]
    assert not built.warnings


def test_static_transforms_that_came_on_another_topic_are_said_to():
    built = TransformTree('/tf', ['/robot/static_frames'])
    built.add(Message(transforms=moving('odom', 'base', [1, 2])))
    built.add(Message(transforms=[transform('base', 'imu', 0, (0, 0, 1))]), '/robot/static_frames')
    assert built.lookup('odom.imu').positions.tolist() == [[1, 0, 1], [2, 0, 1]]
    assert built.warnings == [
        '/tf:odom.imu: the static transforms are those of /robot/static_frames'
    ]


@pytest.mark.parametrize(
    ('topic', 'names', 'static'),
    [
        ('/tf', ['/tf', '/tf_static'], ['/tf_static']),
        ('/tf', ['/tf', '/a/tf', '/a/tf_static'], ['/a/tf_static']),
        ('/a/tf', ['/a/tf', '/tf_static', '/a/tf_static'], ['/a/tf_static', '/tf_static']),
        (
            '/a/b/tf',
            ['/b/tf_static', '/tf_static', '/a/tf_static', '/a/b2/tf_static'],
            ['/a/tf_static', '/tf_static', '/a/b2/tf_static', '/b/tf_static'],
        ),
        ('/tf_old', ['/tf_static', '/tf_old_static'], ['/tf_old_static', '/tf_static']),
        ('/tf', ['/tf', '/tf_static_remapped', '/Static'], ['/Static', '/tf_static_remapped']),
        ('/tf', ['/tf', '/static/tf'], []),
    ],
)
def test_static_topics_are_found_by_name_the_nearest_first(topic, names, static):
    assert static_topics(topic, names) == static


@pytest.mark.parametrize('frames', ['base.imu', 'base.base'])
def test_frames_that_do_not_move_against_each_other_are_refused(frames):
    built = tree(moving('odom', 'base', [1]), [transform('base', 'imu', 0, (0, 0, 1))])
    with pytest.raises(ReadError, match='nothing moves'):
        built.lookup(frames)


def test_transforms_that_share_no_time_are_refused():
    built = tree([*moving('map', 'odom', [1, 2]), *moving('odom', 'base', [3, 4, 5])])
    with pytest.raises(ReadError, match='never known at the same time'):
        built.lookup('map.base')


@pytest.mark.parametrize(
    ('dynamic', 'static', 'motion'),
    [
        (moving('odom', 'base', [1, 2, 3]), [], 'odom.base'),
        (moving('odom', 'base', [1, 2, 3]), [('map', 'odom')], 'map.base'),
        (
            [*moving('map', 'odom', [1, 3]), *moving('odom', 'base', [1, 2, 3])],
            [('world', 'map'), ('base', 'imu')],
            'world.base',
        ),
        ([*moving('a', 'b', [1, 2, 3]), *moving('b', 'a', [1, 2])], [], 'a.b'),
        ([transform('odom', 'base', stamp, (1, 0, 0)) for stamp in (1, 2, 3)], [], None),
        ([], [('map', 'odom')], None),
    ],
)
def test_the_main_motion_begins_at_the_root(dynamic, static, motion):
    built = tree(dynamic, [transform(*edge, 0, (0, 0, 1)) for edge in static])
    assert built.main_motion() == motion


def test_a_chain_of_random_transforms_is_what_scipy_makes_of_it():
    spatial = pytest.importorskip('scipy.spatial.transform')
    random = np.random.default_rng(7)
    stamps = {'a': np.arange(0, 1000, 10), 'b': np.arange(5, 900, 25), 'c': np.arange(0, 950, 30)}
    frames = {'a': ('root', 'a'), 'b': ('a', 'b'), 'c': ('b', 'c')}
    quaternions = {key: random.normal(size=(len(times), 4)) for key, times in stamps.items()}
    positions = {key: random.normal(size=(len(times), 3)) for key, times in stamps.items()}
    for q in quaternions.values():
        q /= np.linalg.norm(q, axis=1, keepdims=True)
    dynamic = [
        transform(*frames[key], int(stamp), *pose)
        for key, times in stamps.items()
        for stamp, *pose in zip(times, positions[key], quaternions[key], strict=True)
    ]
    built = tree(dynamic, [transform('c', 'tool', 0, (1, 2, 3), (0.5, 0.5, -0.5, 0.5))])
    poses, backward = built.lookup('root.tool'), built.lookup('tool.root')

    times = stamps['a'][(stamps['a'] >= 5) & (stamps['a'] <= 880)]
    assert poses.stamps_ns.tolist() == times.tolist()
    expected = np.tile(np.eye(4), (len(times), 1, 1))
    for key in 'abc':
        step = np.tile(np.eye(4), (len(times), 1, 1))
        rotations = spatial.Rotation.from_quat(quaternions[key])
        step[:, :3, :3] = spatial.Slerp(stamps[key], rotations)(times).as_matrix()
        for axis in range(3):
            step[:, axis, 3] = np.interp(times, stamps[key], positions[key][:, axis])
        expected = expected @ step
    tool = np.eye(4)
    tool[:3, :3] = spatial.Rotation.from_quat([0.5, 0.5, -0.5, 0.5]).as_matrix()
    tool[:3, 3] = 1, 2, 3
    expected = expected @ tool
    for found, matrices in ((poses, expected), (backward, np.linalg.inv(expected))):
        np.testing.assert_allclose(found.positions, matrices[:, :3, 3], atol=1e-12)
        rotations = spatial.Rotation.from_quat(found.rotations).as_matrix()
        np.testing.assert_allclose(rotations, matrices[:, :3, :3], atol=1e-12)


def test_a_chain_may_be_long():
    links = [transform(f'f{k}', f'f{k + 1}', 0, (1, 0, 0)) for k in range(3000)]
    poses = tree(moving('odom', 'f0', [1, 2]), links).lookup('odom.f3000')
    assert poses.positions[:, 0].tolist() == [3001, 3002]
