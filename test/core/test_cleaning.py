"""Cleaning makes a trajectory of any poses, and counts every one that it drops."""

from dataclasses import asdict, replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.trajectory import Poses

IDENTITY = [0.0, 0.0, 0.0, 1.0]
ARRIVALS = st.lists(
    st.tuples(st.integers(0, 12), st.sampled_from(['good', 'nan', 'zero', 'long']))
)


def poses(stamps, rotations=None):
    """Return poses whose x is the place in which they arrived."""
    stamps = np.array(stamps, np.int64)
    positions = np.zeros((len(stamps), 3))
    positions[:, 0] = np.arange(len(stamps))
    if rotations is None:
        rotations = [IDENTITY] * len(stamps)
    return Poses(stamps, positions, np.array(rotations, float).reshape(-1, 4))


def counted(counts: Cleaning) -> dict[str, int]:
    return {reason: count for reason, count in asdict(counts).items() if count}


def test_of_equal_stamps_the_first_stays_and_all_are_sorted():
    counts = Cleaning()
    cleaned = clean(poses([20, 10, 20, 10, 30]), counts)
    assert cleaned.stamps_ns.tolist() == [10, 20, 30]
    assert cleaned.positions[:, 0].tolist() == [1, 0, 4]
    assert counted(counts) == {'duplicate': 2, 'went_backwards': 2}
    assert counts.dropped['duplicate'] == 2
    assert 'went_backwards' not in counts.dropped


def test_going_backwards_is_noticed_across_batches():
    counts = Cleaning()
    clean(poses([5, 6]), counts, newest_ns=7)
    assert counts.went_backwards == 2


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf, 1e200])
def test_a_pose_is_dropped_for_a_number_that_or_whose_square_is_not_finite(value):
    counts = Cleaning()
    broken = poses([1, 2, 3])
    broken.positions[1, 2] = value
    broken.rotations[2, 0] = value
    assert clean(broken, counts).stamps_ns.tolist() == [1]
    assert counted(counts) == {'non_finite': 2}


def test_quaternions_of_no_length_are_dropped_and_others_normalised():
    counts = Cleaning()
    four = [[0, 0, 0, 0], [0, 0, 0, 9e-7], [0, 0, 3, 4], [0, 0, 0, 1.009]]
    cleaned = clean(poses([1, 2, 3, 4], four), counts)
    assert cleaned.stamps_ns.tolist() == [3, 4]
    np.testing.assert_allclose(cleaned.rotations, [[0, 0, 0.6, 0.8], IDENTITY])
    assert counted(counts) == {'zero_quaternion': 2, 'scaled_quaternion': 1}


def test_zero_stamps_are_kept_unless_they_say_that_there_was_none():
    counts = Cleaning()
    assert len(clean(poses([0, 1]), counts)) == 2
    assert counted(counts) == {}
    unset = replace(poses([0, 1]), zero_is_unset=True)
    assert len(clean(unset[:1], Cleaning())) == 0
    joined = Poses.concatenate([poses([2]), unset])
    assert clean(joined, counts).stamps_ns.tolist() == [1, 2]
    assert counted(counts) == {'zero_stamp': 1, 'went_backwards': 1}


def test_positions_alone_have_no_orientation():
    cleaned = clean(Poses(np.array([2, 1]), np.ones((2, 3))), Cleaning())
    assert cleaned.rotations is None
    assert cleaned.stamps_ns.tolist() == [1, 2]


@pytest.mark.parametrize('quaternion', [[0, 0, 0, 0], [0, np.nan, 0, 1], [np.inf] * 4])
def test_where_no_orientation_is_usable_positions_are_kept(quaternion):
    counts = Cleaning()
    received = poses([30, 10, 10, 20], [quaternion] * 4)
    received.positions[3] = np.nan
    cleaned = clean(received, counts)
    assert cleaned.rotations is None
    assert cleaned.stamps_ns.tolist() == [10, 30]
    assert counted(counts) == {'non_finite': 1, 'duplicate': 1, 'went_backwards': 2}
    assert not len(clean(received, counts, positions_suffice=False))


@given(ARRIVALS)
def test_every_pose_is_kept_or_counted_exactly_once(arrivals):
    received = poses([stamp for stamp, _ in arrivals])
    for k, (_, kind) in enumerate(arrivals):
        if kind == 'nan':
            received.positions[k] = np.nan
        elif kind != 'good':
            received.rotations[k] *= 0 if kind == 'zero' else 2
    counts = Cleaning()
    cleaned = clean(received, counts, positions_suffice=False)
    kinds = [kind for _, kind in arrivals]
    usable = [stamp for stamp, kind in arrivals if kind in ('good', 'long')]
    assert cleaned.stamps_ns.tolist() == sorted(set(usable))
    np.testing.assert_allclose(np.linalg.norm(cleaned.rotations, axis=1), 1)
    assert counts.non_finite == kinds.count('nan')
    assert counts.zero_quaternion == kinds.count('zero')
    assert counts.scaled_quaternion == kinds.count('long')
    assert len(cleaned) + sum(counts.dropped.values()) == len(received)


def test_what_was_dropped_or_repaired_is_said_by_the_name_of_the_stream():
    counts = Cleaning(non_finite=2, zero_stamp=1, went_backwards=3, scaled_quaternion=4)
    assert counts.repaired == {'went_backwards': 3, 'scaled_quaternion': 4}
    assert counts.dropped.keys() & counts.repaired.keys() == set()
    assert list(counts.warnings('estimate')) == [
        'estimate: dropped 2 non-finite, 1 zero-stamp',
        'estimate: 3 stamps went backwards; sorted',
        'estimate: 4 quaternions were far from unit length; normalised',
    ]
    assert list(Cleaning().warnings('estimate')) == []
