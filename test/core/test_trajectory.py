"""Columns of poses stay together; the log of pairs keeps all of them."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np

from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.trajectory import PairLog, Pairs, Poses, Trajectory

IDENTITY = [0.0, 0.0, 0.0, 1.0]


def poses(stamps, rotations=None):
    """Return poses whose x is the place in which they arrived."""
    stamps = np.array(stamps, np.int64)
    positions = np.zeros((len(stamps), 3))
    positions[:, 0] = np.arange(len(stamps))
    if rotations is None:
        rotations = [IDENTITY] * len(stamps)
    return Poses(stamps, positions, np.array(rotations, float).reshape(-1, 4))


def test_selecting_and_joining_keep_the_columns_together():
    covariances = np.arange(3 * 18, dtype=float).reshape(3, 2, 3, 3)
    whole = Trajectory(np.arange(3), np.eye(3), np.eye(4)[:3], covariances)
    joined = Trajectory.concatenate([whole[:1], Trajectory.empty(), whole[1:]])
    for name in ('stamps_ns', 'positions', 'rotations', 'covariances'):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name))
    assert (
        Trajectory.concatenate([whole, Trajectory(np.array([9]), np.ones((1, 3)))]).rotations
        is None
    )
    assert len(Trajectory.concatenate([Trajectory.empty(), Trajectory.empty()])) == 0


@given(st.lists(st.integers(0, 5), max_size=12), st.sampled_from([0, 3, 100, 10**15]))
def test_the_log_returns_all_pairs_in_order_whatever_the_batches(sizes, capacity):
    count = sum(sizes)
    rng = np.random.default_rng(count)
    whole = Pairs(
        *(
            Trajectory(np.arange(count), rng.normal(size=(count, 3)), rng.normal(size=(count, 4)))
            for _ in range(2)
        ),
        rng.normal(size=(count, 2, 6)).astype(np.float32),
    )
    log, begin = PairLog(capacity), 0
    for size in sizes:
        log.append(whole[begin : begin + size])
        begin += size
        read = log.all()
        assert len(read) == begin
    if count:
        np.testing.assert_array_equal(read.rotations, whole.rotations)
        np.testing.assert_array_equal(read.deviations, whole.deviations)
        np.testing.assert_array_equal(read.estimate.stamps_ns, whole.estimate.stamps_ns)
        np.testing.assert_array_equal(read.ground_truth.positions, whole.ground_truth.positions)
        np.testing.assert_array_equal(read.ground_truth.rotations, whole.ground_truth.rotations)


def test_a_column_that_one_batch_lacks_is_lost_for_the_whole_log():
    log = PairLog()
    log.append(Pairs.of(*(clean(poses([1, 2]), Cleaning()) for _ in range(2))))
    log.append(Pairs.of(Trajectory(np.array([3]), np.ones((1, 3))), clean(poses([3]), Cleaning())))
    pairs = log.all()
    assert len(pairs) == 3
    assert pairs.rotations is None
    assert pairs.estimate.rotations is None
    assert pairs.ground_truth.rotations is not None


def test_what_was_read_from_the_log_does_not_change_when_it_grows():
    log = PairLog()
    for stamp in range(40):
        log.append(Pairs.of(*(clean(poses([stamp]), Cleaning()) for _ in range(2))))
        if stamp == 4:
            early = log.all()
    assert early.estimate.stamps_ns.tolist() == [0, 1, 2, 3, 4]
    assert log.all().estimate.stamps_ns.tolist() == list(range(40))
