"""The motion of one frame in another, of transforms as they arrive."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.live.frames import FrameMotion
from vio_eval_ros.recordings.transforms import TransformTree

START_NS = 10**18
STEP_NS = 20_000_000


def transform(parent, child, k, position):
    seconds, nanoseconds = divmod(START_NS + k * STEP_NS, 10**9)
    stamp = SimpleNamespace(sec=seconds, nanosec=nanoseconds)
    x, y, z = position
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id=parent),
        child_frame_id=child,
        transform=SimpleNamespace(
            translation=SimpleNamespace(x=x, y=y, z=z),
            rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    )


def message(*transforms):
    return SimpleNamespace(transforms=list(transforms))


FIXED = message(transform('base', 'imu', 0, (0.1, 0.0, 0.0)))


def odometry(k, begin=0):
    return message(transform('odom', 'base', k, (0.1 * (k - begin), np.sin(0.05 * k), 0.0)))


def correction(k, x):
    return message(transform('map', 'odom', k, (x, 0.0, 0.0)))


def slam(count=300):
    """Return messages of an odometry, of corrections that begin later, and of a wheel."""
    for k in range(count):
        yield odometry(k)
        yield message(transform('base', 'wheel', k, (0.0, 0.0, 0.3 * k)))
        if k % 10 == 3 and k > 20:
            yield correction(k, 0.0 if k < 100 else 0.3 * (k // 50))


@pytest.fixture
def motion():
    motion = FrameMotion('/tf', 'map.imu', ('/tf_static',))
    motion.add(FIXED, '/tf_static')
    return motion


def taken(motion, messages, every):
    """Return what is handed on, looked at after some messages each."""
    parts = []
    for k, one in enumerate(messages):
        assert motion.add(one) is None
        if k % every == 0:
            parts.append(motion.take())
    return Poses.concatenate([*parts, motion.take(at_end=True)])


@pytest.mark.parametrize('every', [1, 7, 50, 10_000])
def test_in_the_end_it_is_what_a_recording_gives(motion, every):
    tree = TransformTree('/tf', ('/tf_static',))
    tree.add(FIXED, '/tf_static')
    for one in slam():
        tree.add(one)
    live, expected = taken(motion, slam(), every), tree.lookup('map.imu')
    final = motion.final()
    for name in ('stamps_ns', 'positions', 'rotations'):
        np.testing.assert_array_equal(getattr(final, name), getattr(expected, name))
    assert motion.warnings == tuple(tree.warnings)
    assert motion.parent == 'map'
    # on the way, a transform that does not change yet is as good as a constant
    assert (np.diff(live.stamps_ns) > 0).all()
    known = np.isin(live.stamps_ns, expected.stamps_ns)
    assert known.sum() == len(expected)
    np.testing.assert_allclose(live.positions[known], expected.positions, atol=0.61)


def test_a_pose_waits_for_the_transform_that_comes_later(motion):
    for k in range(10):
        motion.add(odometry(k))
        if k in (0, 7):
            motion.add(correction(k, 0.1 * k))
    assert len(motion.take()) == 8
    motion.add(correction(9, 1.0))
    assert motion.take().stamps_ns.tolist() == [START_NS + k * STEP_NS for k in (8, 9)]


def test_a_frame_that_is_missing_is_the_problem(motion):
    for k in range(5):
        motion.add(odometry(k))
    assert len(motion.take()) == 0
    assert "there is no frame 'map'" in motion.problem
    motion.add(correction(0, 0.0))
    assert len(motion.take()) == 5
    assert motion.problem == ''


def test_transforms_that_jump_back_are_of_another_run(motion):
    for k in range(100):
        motion.add(odometry(k))
        motion.add(correction(k, 0.0))
    assert len(motion.take()) == 100
    following = None
    for k in range(20):
        following = following or motion.add(odometry(k, begin=5))
        if following:
            break
    assert k == 4
    assert len(motion.take(at_end=True)) == 0
    following.add(correction(0, 0.0))
    assert following.take(at_end=True).positions[0, 0] == pytest.approx(-0.4)


def test_a_single_late_transform_is_no_jump(motion):
    for k in range(100):
        motion.add(odometry(k))
        motion.add(correction(k, 0.0))
    motion.take()
    for k in (10, 100, 101):
        assert motion.add(odometry(k)) is None
    assert len(motion.final()) == 103


def test_transforms_beside_the_two_frames_are_not_kept(motion):
    taken(motion, slam(), 50)
    assert len(motion._tree.samples(('base', 'wheel'))) == 1


def test_a_run_that_was_resumed_begins_with_what_there_was(motion):
    before = taken(FrameMotion('/tf', 'odom.base', ()), [odometry(k) for k in range(5)], 1)
    motion = FrameMotion('/tf', 'odom.base', ())
    motion.resume(before)
    for k in range(5, 9):
        motion.add(odometry(k))
    assert len(motion.take(at_end=True)) == 4
    assert motion.final().stamps_ns.tolist() == [START_NS + k * STEP_NS for k in range(9)]
