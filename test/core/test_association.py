"""The pairs are those of the definition, and nothing about how poses arrive can change them."""

from dataclasses import asdict
import math

from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.association import Associator
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.matching import nearest
from vio_eval_ros.core.trajectory import PairLog, Pairs, Poses
from vio_eval_ros.errors import ConfigError

MS = 1_000_000
TURN_X_90 = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
TURN_Z_90 = [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]

# A stream is the steps [ms] between its stamps; a step of 0 repeats a stamp.
FORWARD = st.lists(st.integers(1, 12), max_size=30)
STUTTERING = st.lists(st.integers(0, 12), max_size=30)
JUMPING = st.lists(st.integers(0, 12), unique=True)
# Which stream delivers next, and how many poses at once; the rest comes at the end.
DELIVERIES = st.lists(
    st.tuples(st.sampled_from(['estimate', 'ground_truth']), st.integers(1, 8)), max_size=30
)
OPTIONS = st.fixed_dictionaries(
    {
        'association': st.sampled_from(['nearest', 'interpolate']),
        'max_difference_s': st.sampled_from([0.0, 0.002, 0.005, 0.02, 1.0]),
        'max_gap_s': st.sampled_from([0.006, 0.011, 0.5]),
        'time_offset_s': st.sampled_from([0.0, 0.003, -0.05]),
        'start_s': st.sampled_from([0.0, 0.02, 0.08]),
        'end_s': st.sampled_from([0.1, 0.15, math.inf]),
    }
)


def poses(milliseconds, rotations: bool = True) -> Poses:
    """Return poses with numbers of their own at these stamps."""
    stamps = np.round(np.array(milliseconds, float) * MS).astype(np.int64)
    rng = np.random.default_rng(len(stamps))
    position, quaternion = rng.normal(size=(len(stamps), 3)), rng.normal(size=(len(stamps), 4))
    return Poses(stamps, position, rotation.normalize(quaternion) if rotations else None)


def squares(milliseconds) -> Poses:
    """Return positions that follow from the stamps, and not along a line in time."""
    stamps = np.array(milliseconds, np.int64) * MS
    return Poses(stamps, np.outer(np.array(milliseconds) ** 2, [1.0, 2.0, 3.0]))


def associate(
    estimate: Poses, truth: Poses, deliveries=(), flush: bool = True, **options
) -> tuple[Pairs, Associator]:
    """Return the pairs of two streams that arrive in these batches, and the associator."""
    associator = Associator(EvaluationConfig(**options))
    logs = [PairLog() for _ in range(associator.kinds)]

    def keep(decided) -> None:
        for log, pairs in zip(logs, decided, strict=True):
            log.append(pairs)

    waiting = {'estimate': estimate, 'ground_truth': truth}
    add = {'estimate': associator.add_estimate, 'ground_truth': associator.add_ground_truth}
    for name, size in [*deliveries, ('estimate', len(estimate)), ('ground_truth', len(truth))]:
        add[name](waiting[name][:size])
        keep(associator.decide())
        waiting[name] = waiting[name][size:]
    if flush:
        keep(associator.flush())
    return logs[associator.chosen].all(), associator


def in_ms(pairs: Pairs) -> list[tuple[float, float]]:
    return [
        (e / MS, g / MS)
        for e, g in zip(
            pairs.estimate.stamps_ns.tolist(), pairs.ground_truth.stamps_ns.tolist(), strict=True
        )
    ]


def mutually_nearest(estimate: list[int], truth: list[int], tolerance: int):
    """Return the pairs of the definition, by looking at every combination."""
    pairs = []
    for e in estimate:
        g = min(truth, key=lambda other: (abs(other - e), other), default=None)
        if g is None or abs(g - e) > tolerance:
            continue
        if e == min(estimate, key=lambda other: (abs(other - g), other)):
            pairs.append((e, g))
    return pairs


@given(st.lists(st.integers(-50, 50)), st.lists(st.integers(-50, 50), min_size=1))
def test_nearest_is_the_first_of_those_at_the_smallest_distance(stamps, others):
    stamps, others = np.sort(stamps), np.unique(others)
    distances = np.abs(stamps[:, None] - others)
    np.testing.assert_array_equal(nearest(stamps, others), distances.argmin(axis=1))


@given(FORWARD, FORWARD, st.integers(-20, 20), st.integers(0, 15), DELIVERIES)
def test_pairs_are_each_others_nearest(est_steps, gt_steps, shift, tolerance, deliveries):
    estimate, truth = np.cumsum(est_steps) + shift, np.cumsum(gt_steps)
    pairs, associator = associate(
        poses(estimate), poses(truth), deliveries, max_difference_s=tolerance / 1000
    )
    assert in_ms(pairs) == mutually_nearest(estimate.tolist(), truth.tolist(), tolerance)
    if not len(pairs) and len(estimate) and len(truth):
        closest = np.abs(estimate[:, None] - truth).min()
        assert associator.closest_ns == closest * MS


@given(STUTTERING, STUTTERING, st.integers(-20, 20), DELIVERIES, OPTIONS)
@example(  # the estimate goes on while all ground truth so far lies before the start
    [1] * 30,
    [10] * 9,
    0,
    [('ground_truth', 3), ('estimate', 5), ('estimate', 5)],
    {'start_s': 0.08},
).via('found by hand')
@example(  # a stamp is repeated after the first of it has been cropped
    [50, 50, 0],
    [50, 50, 50],
    0,
    [('ground_truth', 3), ('estimate', 2)],
    {'end_s': 0.04},
).via('found by hand')
def test_pairs_and_counts_do_not_depend_on_order_and_batches_of_arrival(
    est_steps, gt_steps, shift, deliveries, options
):
    estimate, truth = poses(np.cumsum(est_steps) + shift), poses(np.cumsum(gt_steps))
    at_once, first = associate(estimate, truth, **options)
    piecewise, second = associate(estimate, truth, deliveries, **options)
    for side in ('estimate', 'ground_truth'):
        for column in ('stamps_ns', 'positions', 'rotations'):
            np.testing.assert_array_equal(
                getattr(getattr(piecewise, side), column), getattr(getattr(at_once, side), column)
            )
        one, other = getattr(first, side), getattr(second, side)
        assert asdict(other.counts) == asdict(one.counts)
        assert (other.used, other.settled) == (one.used, one.settled)
    np.testing.assert_equal(asdict(second.tracking()), asdict(first.tracking()))
    np.testing.assert_equal(second.statistics(), first.statistics())


@given(JUMPING, JUMPING, st.lists(st.booleans()), st.sampled_from(['nearest', 'interpolate']))
@example(  # truth comes between an estimate that could have its partner and the next
    [1, 3], [0, 4, 2], [False, False, True, False, True], 'nearest'
).via('found by hand')
def test_stamps_that_go_backwards_change_nothing_unless_they_come_late(
    estimate, truth, turns, association
):
    options = {'association': association, 'max_difference_s': 0.03, 'max_gap_s': 0.03}
    associator = Associator(EvaluationConfig(**options))
    logs = [PairLog() for _ in range(associator.kinds)]
    add = {'estimate': associator.add_estimate, 'ground_truth': associator.add_ground_truth}
    waiting = {'estimate': [10 * e + 4 for e in estimate], 'ground_truth': [10 * g for g in truth]}
    kept = {'estimate': [], 'ground_truth': []}
    for ours in [*turns, *[True] * len(estimate), *[False] * len(truth)]:
        side = 'estimate' if ours else 'ground_truth'
        counts = getattr(associator, side).counts
        late = counts.late
        for stamp in waiting[side][:1]:
            add[side](squares([stamp]))
            for log, decided in zip(logs, associator.decide(), strict=True):
                log.append(decided)
            if counts.late == late:
                kept[side].append(stamp)
        del waiting[side][:1]
    for log, decided in zip(logs, associator.flush(), strict=True):
        log.append(decided)
    log = logs[associator.chosen]
    pairs, _ = associate(squares(kept['estimate']), squares(kept['ground_truth']), **options)
    assert in_ms(log.all()) == in_ms(pairs)
    np.testing.assert_array_equal(log.all().ground_truth.positions, pairs.ground_truth.positions)


def test_the_pose_between_two_others_goes_to_the_earlier():
    pairs, _ = associate(poses([10]), poses([5, 15]), max_difference_s=0.02)
    assert in_ms(pairs) == [(10, 5)]
    pairs, _ = associate(poses([5, 15]), poses([10]), max_difference_s=0.02)
    assert in_ms(pairs) == [(5, 10)]


def test_a_difference_of_exactly_the_tolerance_is_a_pair():
    assert len(associate(poses([0, 100]), poses([20, 120]), max_difference_s=0.02)[0]) == 2
    assert len(associate(poses([0, 100]), poses([20.001, 80]), max_difference_s=0.02)[0]) == 1


def test_a_pair_is_decided_only_when_no_nearer_pose_can_come():
    associator = Associator(EvaluationConfig(max_difference_s=0.02))
    associator.add_ground_truth(poses([0, 10]))
    associator.add_estimate(poses([9]))
    assert len(associator.decide()[0]) == 0  # another estimate may be nearer to 10
    associator.add_estimate(poses([12]))
    assert len(associator.decide()[0]) == 0  # and, late but not too late, another truth to 9
    associator.add_ground_truth(poses([13]))
    assert in_ms(associator.decide()[0]) == [(9, 10)]
    assert in_ms(associator.flush()[0]) == [(12, 13)]
    assert len(associator.flush()[0]) == 0


def test_the_time_offset_is_added_to_the_estimate():
    pairs, _ = associate(poses([0, 50, 100]), poses([30, 80, 130]), time_offset_s=0.03)
    assert in_ms(pairs) == [(30, 30), (80, 80), (130, 130)]


def test_pairs_stay_apart_by_single_nanoseconds_in_todays_stamps():
    stamps = 1_403_636_579_763_555_584 + np.arange(5)
    estimate, truth = (
        Poses(s, np.zeros((5, 3)), np.tile([0.0, 0, 0, 1], (5, 1))) for s in (stamps, stamps)
    )
    pairs, _ = associate(estimate, truth, max_difference_s=0.0)
    np.testing.assert_array_equal(pairs.ground_truth.stamps_ns, stamps)


@given(st.integers(0, 2**32 - 1), st.integers(5, 60), DELIVERIES)
def test_the_denser_side_is_interpolated_linearly_in_position_and_by_slerp(
    seed, count, deliveries
):
    transform = pytest.importorskip('scipy.spatial.transform')
    rng = np.random.default_rng(seed)
    truth = poses(rng.integers(1, 1000, 30).cumsum() / 10)
    span = truth.stamps_ns[0] / MS, truth.stamps_ns[-1] / MS
    estimate = poses(np.sort(rng.uniform(*span, count)))
    pairs, associator = associate(
        estimate, truth, deliveries, association='interpolate', max_gap_s=1000.0
    )
    median_e, median_g = (
        np.sort(steps)[(len(steps) - 1) // 2]
        for steps in (np.diff(estimate.stamps_ns), np.diff(truth.stamps_ns))
    )
    if abs(median_g / median_e - 1.1) > 0.05:  # medians are known to a percent or two
        assert associator.chosen == (median_g > 1.1 * median_e)
    sparse, dense = (truth, estimate) if associator.chosen else (estimate, truth)
    found = pairs.estimate if associator.chosen else pairs.ground_truth
    at = sparse.stamps_ns
    at = at[(at >= dense.stamps_ns[0]) & (at <= dense.stamps_ns[-1])]
    np.testing.assert_array_equal(pairs.estimate.stamps_ns, at)
    np.testing.assert_array_equal(pairs.ground_truth.stamps_ns, at)
    for axis in range(3):
        expected = np.interp(at, dense.stamps_ns, dense.positions[:, axis])
        # 1 ns of at least 100 µs, in metres of at most a few
        np.testing.assert_allclose(found.positions[:, axis], expected, atol=1e-6)
    slerp = transform.Slerp(dense.stamps_ns, transform.Rotation.from_quat(dense.rotations))
    assert rotation.angle_between(found.rotations, slerp(at).as_quat()).max(initial=0) < 1e-7


def test_truth_is_interpolated_over_no_gap_that_is_too_long_and_not_beyond_its_ends():
    truth = poses([0, 100, 200, 301])
    pairs, _ = associate(
        poses([-200, 0, 150, 250, 301, 502]), truth, association='interpolate', max_gap_s=0.1
    )
    assert pairs.estimate.stamps_ns.tolist() == [0, 150 * MS, 301 * MS]
    np.testing.assert_array_equal(pairs.ground_truth.positions[[0, 2]], truth.positions[[0, 3]])


def test_the_estimate_is_interpolated_over_no_gap_that_is_too_long():
    estimate = poses([0, 100, 200, 301, 401])
    pairs, associator = associate(
        estimate, poses([-200, 0, 150, 250, 401, 700]), association='interpolate', max_gap_s=0.1
    )
    assert in_ms(pairs) == [(0, 0), (150, 150), (401, 401)]
    np.testing.assert_array_equal(pairs.estimate.positions[[0, 2]], estimate.positions[[0, 4]])
    found = associator.statistics()
    assert math.isnan(found['unmatched_estimates'])
    assert found['unmatched_ground_truth'] == 3
    assert found['matched_ratio'] == 0.5


def test_interpolation_without_orientations_gives_positions_alone():
    pairs, _ = associate(poses([5]), poses([0, 10], rotations=False), association='interpolate')
    assert len(pairs) == 1
    assert pairs.rotations is None
    assert pairs.ground_truth.rotations is None


def test_the_crop_is_relative_to_the_first_ground_truth_and_includes_its_ends():
    stamps = np.arange(10) * 10
    pairs, associator = associate(
        poses(stamps), poses(stamps[2:]), start_s=0.02, end_s=0.05, max_difference_s=0.0
    )
    assert in_ms(pairs) == [(40, 40), (50, 50), (60, 60), (70, 70)]
    assert associator.estimate.counts.cropped == 6
    assert associator.ground_truth.counts.cropped == 4
    assert (associator.estimate.used, associator.estimate.settled) == (4, 4)


def test_a_pose_whose_pairing_was_decided_comes_late_and_is_counted():
    associator = Associator(EvaluationConfig())
    associator.add_ground_truth(poses([0, 10, 20, 30]))
    associator.add_estimate(poses([0, 10, 20, 30]))
    assert len(associator.decide()[0]) == 4
    associator.add_estimate(poses([15, 10, 40]))
    assert len(associator.decide()[0]) == 0
    counts = associator.estimate.counts
    assert (counts.late, counts.duplicate, counts.went_backwards) == (1, 1, 2)
    associator.add_ground_truth(poses([40]))
    assert len(associator.decide()[0]) == 1


def test_what_comes_after_the_flush_is_late():
    _, associator = associate(poses([0, 10]), poses([0, 10]))
    associator.add_estimate(poses([20]))
    assert len(associator.decide()[0]) == 0
    assert associator.estimate.counts.late == 1


def test_the_body_pose_is_multiplied_from_the_right():
    tracked = Poses(np.array([0]), np.array([[1.0, 2, 3]]), np.array([TURN_Z_90]))
    pairs, _ = associate(
        tracked, poses([0]), estimate_to_body=(1, 0, 0, *TURN_X_90), max_difference_s=0
    )
    np.testing.assert_allclose(pairs.estimate.positions, [[1, 3, 3]])
    # the body's z axis looks along the tracked frame's -y, and that along the world's x
    np.testing.assert_allclose(
        rotation.rotate(pairs.estimate.rotations, np.array([0.0, 0, 1])), [[1, 0, 0]], atol=1e-15
    )


def test_positions_alone_cannot_be_moved_to_another_frame():
    with pytest.raises(ConfigError, match='without orientation'):
        associate(
            poses([0]), poses([0], rotations=False), ground_truth_to_body=(0, 0, 0.1, 0, 0, 0, 1)
        )


# Ground truth every 10 ms for 1 s, an interval as long as the gap, and the estimate of each case.
SECOND = list(range(0, 1001, 10))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('estimate', 'ratio'),
    [
        (SECOND, 1.0),
        (SECOND[:6], 0.05),  # the filter died: a superb ATE over 5 % of the run
        (SECOND[:31] + SECOND[36:], 0.94 + 0.06),  # a gap of 60 ms counts as tracking
        (SECOND[:31] + SECOND[37:], 0.93),  # a gap of 70 ms does not
        (SECOND[:1] + SECOND[-1:], 1.0),  # its median interval is the whole run
        (SECOND[::3], 0.99),  # 30 ms, three of which make 90 ms
        (SECOND[::3][:11] + SECOND[::3][13:], 0.99),  # a gap of 90 ms
        (SECOND[::3][:11] + SECOND[::3][14:], 0.87),  # a gap of 120 ms
        ([*range(0, 501, 10), 1000], 0.5),
        ([0, 10, 20, 30, 80, 130, 210], 0.21),  # its median is 30 ms: a gap of 80 ms counts
        (SECOND[:1], 0.0),
        ([], 0.0),
        ([2000, 2010, 2020], 0.0),
    ],
)
@pytest.mark.parametrize('association', ['nearest', 'interpolate'])
@pytest.mark.parametrize('size', [1, 1000])
def test_coverage_is_the_share_of_time_between_pairs_without_a_gap(
    estimate, ratio, association, size
):
    deliveries = [('ground_truth', size), ('estimate', size)] * 102
    _, associator = associate(
        poses(estimate),
        poses(SECOND),
        deliveries,
        association=association,
        max_gap_s=0.06,
        max_difference_s=0.002,
    )
    assert associator.tracking().coverage_ratio == pytest.approx(ratio, rel=1e-12)


def test_coverage_leaves_out_the_gaps_of_the_ground_truth():
    truth = [*range(0, 500, 10), *range(900, 1400, 10)]
    _, associator = associate(poses(SECOND), poses(truth), max_gap_s=0.06, max_difference_s=0)
    assert associator.tracking().coverage_ratio == pytest.approx(
        (490 + 100) / (490 + 490), rel=1e-12
    )


def test_coverage_without_ground_truth_is_not_a_number():
    for truth in ([], [0]):
        tracking = associate(poses(SECOND), poses(truth))[1].tracking()
        assert math.isnan(tracking.coverage_ratio)


@pytest.mark.parametrize('association', ['nearest', 'interpolate'])
@pytest.mark.parametrize('size', [1, 7, 1000])
@pytest.mark.parametrize('start', [0, 20_000, 45_000])
def test_coverage_of_a_sparse_truth_is_the_share_of_its_poses_with_a_partner(
    association, size, start
):
    truth = np.arange(0, 60_001, 1000)
    estimate = np.arange(start, 52_001, 50)
    pairs, associator = associate(
        poses(estimate), poses(truth), [('ground_truth', 1), ('estimate', size)] * 400,
        association=association,
    )  # fmt: skip
    assert in_ms(pairs) == [(t, t) for t in range(start, 52_001, 1000)]
    found = associator.tracking()
    assert found.coverage_ratio == pytest.approx(len(pairs) / 61, rel=1e-12)
    assert found.tracked_ratio == pytest.approx(len(pairs) / (61 - start / 1000), rel=1e-12)
    assert found.initialisation_s == start / 1000
    assert found.truth_period_s == pytest.approx(1.0, rel=0.02)
    assert found.hole_ratio == 0


@pytest.mark.parametrize('association', ['nearest', 'interpolate'])
def test_what_comes_before_the_first_pair_is_initialisation(association):
    options = {'association': association, 'max_gap_s': 0.06, 'max_difference_s': 0.002}
    _, associator = associate(poses(SECOND[60:]), poses(SECOND), **options)
    found = associator.tracking()
    assert found.initialisation_s == pytest.approx(SECOND[60] / 1000)
    assert found.tracked_ratio == 1
    assert found.coverage_ratio < 0.5
    _, associator = associate(poses(SECOND), poses(SECOND), **options)
    found = associator.tracking()
    assert (found.initialisation_s, found.tracked_ratio, found.coverage_ratio) == (0, 1, 1)
    _, associator = associate(poses(SECOND), poses(SECOND), start_s=0.5, **options)
    assert associator.tracking().initialisation_s == 0
    _, associator = associate(poses([5000]), poses(SECOND), **options)
    found = associator.tracking()
    assert math.isnan(found.initialisation_s)
    assert math.isnan(found.tracked_ratio)


def test_a_hole_of_the_truth_is_measured_by_its_own_period():
    ends = [*range(0, 10_001, 100), *range(110_000, 120_001, 100)]
    _, associator = associate(poses(np.arange(0, 120_001, 200)), poses(ends))
    found = associator.tracking()
    assert found.hole_ratio == pytest.approx(100 / 120)
    assert found.hole_s == 0.5
    _, associator = associate(poses(np.arange(0, 120_001, 200)), poses(ends[::50]))
    assert associator.tracking().hole_s == pytest.approx(15.0)
