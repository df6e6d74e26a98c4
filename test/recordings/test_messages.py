"""Messages of every supported type become the columns they describe, whoever made them."""

import subprocess
import sys
from types import SimpleNamespace as Message

import numpy as np
import pytest

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.messages import collect, PathRevisions, STREAMED, USUAL

NUMBERS = (1.5, -2.25, 3.125, 0.1, -0.2, 0.3, 0.9)
COVARIANCE = np.arange(36.0)
EXACT_NS = 1_403_715_273_262_142_976  # float64 seconds would lose its last digits


def header(stamp_ns):
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return Message(stamp=Message(sec=seconds, nanosec=nanoseconds), frame_id='map')


def vector(x, y, z):
    return Message(x=x, y=y, z=z)


def quaternion(x, y, z, w):
    return Message(x=x, y=y, z=z, w=w)


def pose(numbers=NUMBERS):
    return Message(position=vector(*numbers[:3]), orientation=quaternion(*numbers[3:]))


def stamped_pose(stamp_ns, numbers=NUMBERS):
    return Message(header=header(stamp_ns), pose=pose(numbers))


def covariant_pose(stamp_ns, covariance=COVARIANCE):
    return Message(header=header(stamp_ns), pose=Message(pose=pose(), covariance=covariance))


def path(stamps_ns, x=0.0):
    """Return a Path whose poses all have the given x."""
    return Message(poses=[stamped_pose(stamp, (x, *NUMBERS[1:])) for stamp in stamps_ns])


MESSAGES = {
    'nav_msgs/msg/Odometry': covariant_pose,
    'geometry_msgs/msg/PoseStamped': stamped_pose,
    'geometry_msgs/msg/PoseWithCovarianceStamped': covariant_pose,
    'geometry_msgs/msg/TransformStamped': lambda stamp: Message(
        header=header(stamp),
        transform=Message(translation=vector(*NUMBERS[:3]), rotation=quaternion(*NUMBERS[3:])),
    ),
    'geometry_msgs/msg/PointStamped': lambda stamp: Message(
        header=header(stamp), point=vector(*NUMBERS[:3])
    ),
    'nav_msgs/msg/Path': lambda stamp: path([stamp], NUMBERS[0]),
}


@pytest.mark.parametrize('msgtype', USUAL)
def test_every_type_keeps_stamps_and_numbers_exactly(msgtype):
    stamps = [EXACT_NS, EXACT_NS + 1, EXACT_NS + 50_000_000]
    poses = collect(msgtype, [MESSAGES[msgtype](stamp) for stamp in stamps])
    assert poses.stamps_ns.dtype == np.int64
    assert poses.stamps_ns.tolist() == stamps
    assert poses.positions.tolist() == [list(NUMBERS[:3])] * 3
    if msgtype == 'geometry_msgs/msg/PointStamped':
        assert poses.rotations is None
    else:
        assert poses.rotations.tolist() == [list(NUMBERS[3:])] * 3


@pytest.mark.parametrize('msgtype', STREAMED)
def test_no_messages_are_no_poses(msgtype):
    poses = collect(msgtype, [])
    assert len(poses) == 0
    assert poses.positions.shape == (0, 3)


def test_messages_keep_their_order_of_arrival():
    poses = collect('geometry_msgs/msg/PoseStamped', [stamped_pose(s) for s in (3, 1, 2, 1)])
    assert poses.stamps_ns.tolist() == [3, 1, 2, 1]


def test_covariances_are_the_diagonal_blocks_of_the_matrix():
    poses = collect(
        'nav_msgs/msg/Odometry', [covariant_pose(1), covariant_pose(2, COVARIANCE + 1)]
    )
    assert poses.covariances.shape == (2, 2, 3, 3)
    assert poses.covariances[0, 0].tolist() == [[0, 1, 2], [6, 7, 8], [12, 13, 14]]
    assert poses.covariances[0, 1].tolist() == [[21, 22, 23], [27, 28, 29], [33, 34, 35]]
    assert poses.covariances[1, 0, 0, 0] == 1


def test_a_covariance_of_zeros_beside_others_is_kept():
    odometry = [covariant_pose(1, np.zeros(36)), covariant_pose(2)]
    covariances = collect('nav_msgs/msg/Odometry', odometry).covariances
    assert np.isnan(covariances[0]).all()
    assert np.isfinite(covariances[1]).all()


@pytest.mark.parametrize(('entry', 'value'), [(0, -1.0), (35, -1e-9), (7, np.nan), (2, np.inf)])
def test_an_unusable_covariance_is_nan_and_spoils_no_other(entry, value):
    unusable = COVARIANCE.copy()
    unusable[entry] = value
    poses = collect('nav_msgs/msg/Odometry', [covariant_pose(1), covariant_pose(2, unusable)])
    assert np.isfinite(poses.covariances[0]).all()
    assert np.isnan(poses.covariances[1]).all()
    assert len(poses) == 2


def test_covariances_of_zeros_are_unknown():
    odometry = [covariant_pose(stamp, np.zeros(36)) for stamp in (1, 2)]
    assert collect('nav_msgs/msg/Odometry', odometry).covariances is None


def test_messages_of_rclpy_serve_as_well():
    nav = pytest.importorskip('nav_msgs.msg')
    odometry = nav.Odometry()
    odometry.header.stamp.sec, odometry.header.stamp.nanosec = divmod(EXACT_NS, 1_000_000_000)
    at, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w = NUMBERS
    odometry.pose.covariance = COVARIANCE
    live = collect('nav_msgs/msg/Odometry', [odometry])
    offline = collect('nav_msgs/msg/Odometry', [covariant_pose(EXACT_NS)])
    assert live.stamps_ns.tolist() == offline.stamps_ns.tolist()
    assert live.positions.tolist() == offline.positions.tolist()
    assert live.rotations.tolist() == offline.rotations.tolist()
    assert live.covariances.tolist() == offline.covariances.tolist()


def test_neither_rclpy_nor_rosbags_is_imported():
    code = (
        'import sys, vio_eval_ros.recordings.messages\n'
        "sys.exit(bool({'rclpy', 'rosbags', 'mcap'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0


REVISIONS = [([1, 2, 3], 10.0), ([1, 2, 3, 4], 20.0), ([3, 4, 5], 30.0)]


def revised(revisions) -> PathRevisions:
    merged = PathRevisions()
    for revision in revisions:
        merged.add(collect('nav_msgs/msg/Path', [path(*revision)]))
    return merged


def test_the_final_trajectory_has_the_latest_revision_of_each_stamp():
    poses = revised(REVISIONS).final()
    assert poses.stamps_ns.tolist() == [1, 2, 3, 4, 5]
    assert poses.positions[:, 0].tolist() == [20, 20, 30, 30, 30]


def test_the_causal_trajectory_has_each_pose_as_first_published():
    poses = revised(REVISIONS).causal()
    assert poses.stamps_ns.tolist() == [1, 2, 3, 4, 5]
    assert poses.positions[:, 0].tolist() == [10, 10, 10, 20, 30]


def test_a_path_too_long_to_merge_at_once_is_merged_all_the_same():
    final, causal, merged = {}, {}, PathRevisions()
    random = np.random.default_rng(1)
    for _ in range(300):
        stamps, x = random.integers(0, 5000, 1000), random.random()
        merged.add(Poses(stamps, np.full((1000, 3), x), np.tile(NUMBERS[3:], (1000, 1))))
        for stamp in stamps.tolist():
            final[stamp] = x
            causal.setdefault(stamp, x)
    for poses, expected in ((merged.final(), final), (merged.causal(), causal)):
        found = zip(poses.stamps_ns.tolist(), poses.positions[:, 0].tolist(), strict=True)
        assert dict(found) == expected
        assert (np.diff(poses.stamps_ns) > 0).all()


def test_each_message_of_a_path_gives_what_is_new_in_it():
    merged = PathRevisions()
    new = [merged.add(collect('nav_msgs/msg/Path', [path(*each)])) for each in REVISIONS]
    assert [poses.stamps_ns.tolist() for poses in new] == [[1, 2, 3], [4], [5]]
    assert [poses.positions[0, 0] for poses in new] == [10, 20, 30]


def test_a_path_can_be_read_while_it_grows():
    merged = revised([([1, 2], 1.0)])
    assert merged.final().positions[:, 0].tolist() == [1, 1]
    merged.add(collect('nav_msgs/msg/Path', [path([2, 3], 2.0)]))
    assert merged.final().positions[:, 0].tolist() == [1, 2, 2]
    assert merged.causal().positions[:, 0].tolist() == [1, 1, 2]


@pytest.mark.parametrize('stamps', [[[0]], [[0, 0], [0, 0, 0]], [[7], [8, 8], [9, 9, 9]]])
def test_a_path_whose_poses_have_no_stamps_of_their_own_is_refused(stamps):
    merged = PathRevisions(source='/vio/path')
    for each in stamps:
        merged.add(collect('geometry_msgs/msg/PoseStamped', map(stamped_pose, each)))
    for revision in (merged.final, merged.causal):
        with pytest.raises(ReadError, match=r'^/vio/path: .* no stamps of their own'):
            revision()


def test_a_repeated_stamp_in_a_path_is_no_reason_to_refuse_it():
    merged = revised([([1], 0.0), ([1, 1], 0.0), ([1, 1, 2], 0.0)])
    assert merged.final().stamps_ns.tolist() == merged.causal().stamps_ns.tolist() == [1, 2]


def test_a_stamp_beyond_all_time_counts_as_never_set():
    message = Message(
        timestamp=1, timestamp_sample=1 << 63, position=(1, 2, 3), q=(1, 0, 0, 0), pose_frame=1
    )
    found = collect('px4_msgs/msg/VehicleOdometry', [message])
    assert found.stamps_ns.tolist() == [0]
    assert found.zero_is_unset
