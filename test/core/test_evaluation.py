"""The evaluation as a whole: the same however poses arrive, true at every moment, never silent."""

from dataclasses import asdict, replace
from itertools import pairwise
import math
import re

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import FREE_PARAMETERS
from vio_eval_ros.core.config import ALIGNMENTS, EvaluationConfig, RPE_PAIRS
from vio_eval_ros.core.evaluation import Evaluation, metric_names
from vio_eval_ros.core.trajectory import Poses, Trajectory

MS = 1_000_000
TODAY_NS = 1_403_636_579_763_555_584
UTM = np.array([4.5e5, 5.4e6, 200.0])
DELTAS = ('1f', '7f', '0.5s', '2s', '3m', '20d')
EVERYTHING = {'rpe_deltas': DELTAS, 'segment_lengths_m': (5, 20)}
REVISED = re.compile('ate_causal_.*|loop_closure_gain')
NOTHING = Poses(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4)))

# A stream is the steps [5 ms] between its stamps; a step of 0 repeats a stamp.
STEPS = st.lists(st.integers(0, 12), max_size=30)
# Which stream delivers next, and how many poses at once; the rest comes at the end.
DELIVERIES = st.lists(
    st.tuples(st.sampled_from(['estimate', 'ground_truth']), st.integers(1, 9)), max_size=30
)


def deliver(evaluation: Evaluation, estimate: Poses, truth: Poses, deliveries):
    """Add both streams to an evaluation in these batches; yield after every one."""
    waiting = {'estimate': estimate, 'ground_truth': truth}
    add = {'estimate': evaluation.add_estimate, 'ground_truth': evaluation.add_ground_truth}
    for name, size in [*deliveries, ('estimate', len(estimate)), ('ground_truth', len(truth))]:
        add[name](waiting[name][:size])
        waiting[name] = waiting[name][size:]
        yield
    evaluation.flush()
    yield


def rows(trajectory: Trajectory, columns: str = 'pr') -> Poses:
    """Return poses of which only the positions (p) or also the orientations (r) are known."""
    return Poses(
        trajectory.stamps_ns,
        trajectory.positions,
        trajectory.rotations if 'r' in columns else None,
    )


def moved(trajectory: Trajectory, turn, shift) -> Trajectory:
    """Return the trajectory in another world."""
    turn = rotation.from_rotation_vector(np.array(turn, float))
    return replace(
        trajectory,
        positions=rotation.rotate(turn, trajectory.positions) + shift,
        rotations=rotation.multiply(turn, trajectory.rotations),
    )


def assert_close(found, expected, relative, absolute, but=()):
    for name, value in expected.items():
        if not name.startswith(but):
            assert found[name] == pytest.approx(value, rel=relative, abs=absolute, nan_ok=True), (
                name
            )


# However poses arrive


def test_how_poses_lie_in_memory_does_not_show_in_the_last_bit():
    stamps = TODAY_NS + 50 * MS * np.arange(500)
    rng = np.random.default_rng(3)
    walk = Poses(stamps, rng.normal(size=(500, 3)).cumsum(axis=0), rng.normal(size=(500, 4)))
    truth = replace(walk, positions=walk.positions + rng.normal(size=(500, 3)))

    def metrics(rearranged):
        evaluation = Evaluation(EvaluationConfig())
        for add, poses in (
            (evaluation.add_ground_truth, truth),
            (evaluation.add_estimate, walk),
        ):
            columns = (rearranged(poses.positions), rearranged(poses.rotations))
            add(Poses(poses.stamps_ns, *columns))
        evaluation.flush()
        return repr(evaluation.summary().metrics)

    by_rows = metrics(np.ascontiguousarray)
    assert metrics(np.asfortranarray) == by_rows
    assert metrics(lambda array: np.repeat(array, 2, axis=1)[:, ::2]) == by_rows


@pytest.mark.slow
@given(
    STEPS,
    STEPS,
    DELIVERIES,
    st.fixed_dictionaries(
        {
            'association': st.sampled_from(['nearest', 'interpolate']),
            'time_offset_s': st.sampled_from([0.0, 0.012]),
            'end_s': st.sampled_from([0.3, math.inf]),
            'rpe_pairs': st.sampled_from(RPE_PAIRS),
            'alignment': st.sampled_from(ALIGNMENTS),
        }
    ),
)
def test_the_summary_is_the_same_to_the_last_bit_however_poses_arrive(
    wandering, est_steps, gt_steps, deliveries, options
):
    estimate = wandering(np.cumsum(est_steps) * 5 * MS, seed=1)
    truth = wandering(np.cumsum(gt_steps) * 5 * MS)
    config = EvaluationConfig(rpe_deltas=('1f', '0.1s', '1m', '5d'), **options)
    at_once, piecewise = Evaluation(config), Evaluation(config)
    for _ in deliver(at_once, estimate, truth, []):
        pass
    for _ in deliver(piecewise, estimate, truth, deliveries):
        piecewise.running()
    expected, found = at_once.summary(), piecewise.summary()
    np.testing.assert_equal(found.metrics, expected.metrics)
    np.testing.assert_equal(found.association, expected.association)
    assert found.warnings == expected.warnings
    for side in ('estimate', 'ground_truth'):
        assert asdict(getattr(piecewise.associator, side).counts) == asdict(
            getattr(at_once.associator, side).counts
        )
    assert piecewise.associator.why_no_pairs() == at_once.associator.why_no_pairs()


# At every moment


@pytest.mark.slow
@pytest.mark.parametrize('alignment', ALIGNMENTS)
@pytest.mark.parametrize('rpe_pairs', RPE_PAIRS)
@pytest.mark.parametrize('align_first_s', [0, 3])
def test_running_values_are_those_of_the_summary_at_every_moment(
    flight, estimated, alignment, rpe_pairs, align_first_s
):
    evaluation = Evaluation(
        EvaluationConfig(
            alignment=alignment,
            rpe_pairs=rpe_pairs,
            align_first_s=align_first_s,
            rpe_deltas=DELTAS,
        )
    )
    estimate = estimated(flight)
    deliveries = [(name, 11) for _ in range(37) for name in ('ground_truth', 'estimate')]
    for _ in deliver(evaluation, estimate, flight, deliveries):
        running, summary = evaluation.running(), evaluation.summary()
        assert running.pop('pairs') == len(summary.pairs)
        # of the one to three pairs that an alignment fits exactly only rounding is left
        absolute = 1e-6 if len(summary.pairs) <= 3 else 1e-12
        for name, value in running.items():
            assert value == pytest.approx(
                summary.metrics[name], rel=1e-9, abs=absolute, nan_ok=True
            ), name


@pytest.mark.slow
@pytest.mark.parametrize(
    ('alignment', 'scale'),
    [('none', 1), ('posyaw', 1), ('se3', 1), ('sim3', 1), ('sim3', 5), ('sim3', 0.2)],
)
@pytest.mark.parametrize('metres', [1e-2, 1e-4, 1e-6])
def test_running_values_of_small_errors_are_as_exact(flight, evaluate, alignment, scale, metres):
    noise = np.random.default_rng(0).normal(0, metres, flight.positions.shape)
    estimate = replace(flight, positions=(flight.positions + noise) / scale)
    if alignment != 'none':
        estimate = moved(estimate, [0, 0, 2] if alignment == 'posyaw' else [1, -2, 0.5], [5, 6, 7])
    evaluation = Evaluation(EvaluationConfig(alignment=alignment, rpe_deltas=('1f', '1s')))
    for _ in deliver(
        evaluation, estimate, flight, [('ground_truth', 400)] + [('estimate', 23)] * 20
    ):
        running = evaluation.running()
    final = evaluation.summary().metrics
    for name in ('ate_trans_rmse_m', 'rpe_1f_trans_rmse_m', 'rpe_1f_disp_rmse_m'):
        # the coordinates of some metres are themselves rounded to 1e-15
        assert running[name] == pytest.approx(final[name], rel=1e-9, abs=1e-14), name


@pytest.mark.parametrize('columns', [('p', 'pr'), ('pr', 'p'), ('p', 'p')])
def test_running_values_without_orientations_are_those_of_the_summary(flight, estimated, columns):
    evaluation = Evaluation(EvaluationConfig(rpe_deltas=('1f', '7f')))
    estimate, truth = rows(estimated(flight), columns[0]), rows(flight, columns[1])
    for _ in deliver(
        evaluation, estimate, truth, [('ground_truth', 400)] + [('estimate', 50)] * 8
    ):
        running, metrics = evaluation.running(), evaluation.summary().metrics
        del running['pairs']
        assert_close(running, {name: metrics[name] for name in running}, 1e-9, 1e-12)
    assert math.isfinite(running['rpe_7f_disp_rmse_m'])
    assert math.isnan(running['rpe_7f_trans_rmse_m'])
    assert math.isnan(running['ate_rot_rmse_deg'])


@pytest.mark.slow
@pytest.mark.parametrize('alignment', ALIGNMENTS)
def test_running_values_get_over_an_estimate_that_stands_still_at_first(flight, alignment):
    # as a monocular system does until it has initialised, and then at a scale of its own
    moving = np.arange(len(flight))[:, None] >= 120
    positions = 0.2 * (flight.positions - flight.positions[120])
    estimate = replace(flight, positions=np.where(moving, positions, 0.0))
    evaluation = Evaluation(EvaluationConfig(alignment=alignment, rpe_deltas=DELTAS))
    for _ in deliver(
        evaluation, estimate, flight, [('ground_truth', 400)] + [('estimate', 50)] * 8
    ):
        running, metrics = evaluation.running(), evaluation.summary().metrics
        del running['pairs']
        assert_close(running, {name: metrics[name] for name in running}, 1e-9, 1e-12)
    assert math.isfinite(running['rpe_7f_trans_rmse_m'])


def test_a_window_has_the_metrics_of_its_pairs_under_the_alignment_of_all(flight, estimated):
    estimate = estimated(flight)
    evaluation = Evaluation(EvaluationConfig(alignment='sim3', rpe_deltas=('7f',)))
    for _ in deliver(evaluation, estimate, flight, []):
        pass
    window, summary = evaluation.window(3), evaluation.summary()
    last = estimate.stamps_ns >= estimate.stamps_ns[-1] - 3_000_000_000
    aligned = summary.alignment.apply(estimate).positions
    errors = np.linalg.norm(aligned - flight.positions, axis=1)[last]
    assert window['ate_trans_max_m'] == pytest.approx(errors.max(), rel=1e-9)
    assert window['rpe_7f_pairs'] == np.count_nonzero(last) - 7
    unknown = dict.fromkeys(
        ('coverage_ratio', 'tracked_ratio', 'initialisation_s', 'matched_ratio'), math.nan
    )
    assert_close({name: window[name] for name in unknown}, unknown, 0, 0)
    assert_close(evaluation.window(1000), summary.metrics | unknown, 1e-9, 1e-12)


# What must not matter


def test_pieces_that_fit_into_a_cache_join_to_the_same_numbers(
    flight, estimated, evaluate, monkeypatch
):
    before = evaluate(estimated(flight), flight, **EVERYTHING)
    monkeypatch.setattr('vio_eval_ros.core.trajectory.BLOCK_ROWS', 32)
    after = evaluate(estimated(flight), flight, **EVERYTHING)
    assert_close(after.metrics, before.metrics, 1e-12, 1e-13)


@pytest.mark.parametrize('alignment', ['se3', 'sim3'])
@pytest.mark.parametrize('side', ['estimate', 'ground_truth'])
def test_moving_either_world_rigidly_changes_nothing(flight, estimated, evaluate, alignment, side):
    sides = {'estimate': estimated(flight), 'ground_truth': flight}
    before = evaluate(**sides, alignment=alignment, **EVERYTHING).metrics
    sides[side] = moved(sides[side], [0.7, -1.1, 2.3], [30, -20, 10])
    after = evaluate(**sides, alignment=alignment, **EVERYTHING).metrics
    # Rounding of coordinates of 40 m, 7e-15 m, in the smallest of 400 errors; 100 of it in degrees
    assert_close(after, before, 1e-9, 1e-11, but=('ate_none', 'ate_posyaw'))


def test_turning_about_the_vertical_changes_nothing_for_posyaw(flight, estimated, evaluate):
    before = evaluate(estimated(flight), flight, alignment='posyaw', **EVERYTHING).metrics
    there = moved(estimated(flight), [0, 0, 2.3], [30, -20, 10])
    after = evaluate(there, flight, alignment='posyaw', **EVERYTHING).metrics
    assert_close(after, before, 1e-9, 1e-11, but='ate_none')


@pytest.mark.parametrize('alignment', ['none', 'origin', 'posyaw', 'se3', 'sim3'])
def test_coordinates_of_the_size_of_utms_change_nothing(flight, estimated, evaluate, alignment):
    estimate = estimated(flight)
    before = evaluate(estimate, flight, alignment=alignment, **EVERYTHING)
    far = [replace(side, positions=side.positions + UTM) for side in (estimate, flight)]
    after = evaluate(*far, alignment=alignment, **EVERYTHING)
    # 5.4e6 m is resolved to 1e-9 m
    assert_close(after.metrics, before.metrics, 1e-6, 5e-9)
    evaluation = Evaluation(EvaluationConfig(alignment=alignment, **EVERYTHING))
    for _ in deliver(evaluation, *far, [('ground_truth', 400)] + [('estimate', 50)] * 8):
        running = evaluation.running()
    assert running['ate_trans_rmse_m'] == pytest.approx(
        before.metrics['ate_trans_rmse_m'], rel=1e-6
    )


@given(st.integers(0, 2**32 - 1), st.integers(3, 40))
def test_more_freedom_never_makes_the_error_larger(wandering, estimated, evaluate, seed, count):
    truth = wandering(np.arange(count) * 50 * MS, seed)
    metrics = evaluate(estimated(truth, seed + 1, metres=0.5), truth, alignment='origin').metrics
    errors = [metrics[f'ate_{mode}_trans_rmse_m'] for mode in ('sim3', 'se3', 'posyaw', 'none')]
    for smaller, larger in pairwise(errors):
        assert smaller <= larger * (1 + 1e-9)
    assert errors[1] <= metrics['ate_trans_rmse_m'] * (1 + 1e-9)


def test_aligning_on_the_first_seconds_fits_those_and_applies_to_all(flight, estimated, evaluate):
    estimate = estimated(flight)
    stamps = estimate.stamps_ns
    first = estimate[stamps <= stamps[0] + 3_000_000_000]
    fitted = evaluate(first, flight).alignment
    frozen = evaluate(estimate, flight, align_first_s=3)
    np.testing.assert_array_equal(frozen.alignment.rotation, fitted.rotation)
    np.testing.assert_array_equal(frozen.alignment.translation, fitted.translation)
    errors = np.linalg.norm(fitted.apply(estimate).positions - flight.positions, axis=1)
    assert frozen.metrics['ate_trans_rmse_m'] == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert frozen.metrics['ate_trans_rmse_m'] > frozen.metrics['ate_se3_trans_rmse_m'] * 1.001


# Too little


def nulls(summary) -> set[str]:
    return {name for name, value in summary.metrics.items() if math.isnan(value)}


@pytest.mark.parametrize('alignment', ALIGNMENTS)
@pytest.mark.parametrize(
    ('estimate', 'truth', 'why'),
    [
        (0, 0, 'no pairs: the estimate has no usable pose'),
        (0, 5, 'no pairs: the estimate has no usable pose'),
        (5, 0, 'no pairs: the ground truth has no usable pose'),
    ],
)
def test_empty_streams_have_no_numbers_and_the_reason_is_given(
    flight, evaluate, alignment, estimate, truth, why
):
    evaluation = Evaluation(EvaluationConfig(alignment=alignment))
    for _ in deliver(evaluation, flight[:estimate], flight[:truth], []):
        evaluation.running()
    summary = evaluation.summary()
    zero = {'rpe_1f_pairs', 'rpe_1s_pairs', 'rpe_10m_pairs', 'kitti_segments'}
    if truth:
        zero |= {'coverage_ratio'}
    if estimate:
        zero |= {'matched_ratio'}
    assert set(summary.metrics) - nulls(summary) == zero
    assert not any(summary.metrics[name] for name in zero)
    assert evaluation.associator.why_no_pairs() == why
    assert math.isnan(summary.association['abs_difference_max_s'])
    assert list(summary.metrics) == metric_names(evaluation.config)


def test_poses_that_are_all_nan_are_counted_and_named(flight, evaluate):
    broken = replace(flight, positions=np.full_like(flight.positions, np.nan))
    evaluation = Evaluation(EvaluationConfig())
    for _ in deliver(evaluation, broken, flight, []):
        pass
    assert evaluation.associator.why_no_pairs() == (
        'no pairs: the estimate has no usable pose (dropped: 400 non-finite)'
    )
    assert 'estimate: dropped 400 non-finite' in evaluation.summary().warnings
    assert math.isnan(evaluation.summary().metrics['ate_trans_rmse_m'])


@pytest.mark.parametrize('alignment', ALIGNMENTS)
@pytest.mark.parametrize('count', [1, 2, 3])
def test_as_many_pairs_as_an_alignment_can_fit_have_no_absolute_error(
    flight, estimated, alignment, count
):
    evaluation = Evaluation(EvaluationConfig(alignment=alignment))
    evaluation.add_estimate(estimated(flight)[:count])
    evaluation.add_ground_truth(flight)
    evaluation.flush()
    running, summary = evaluation.running(), evaluation.summary()
    metrics = summary.metrics
    assert len(summary.pairs) == count
    enough = count > 1 and 3 * count > FREE_PARAMETERS[alignment]
    absolute = {name for name in metrics if name.startswith(('ate_trans', 'ate_rot'))}
    assert absolute <= nulls(summary) if not enough else not absolute & nulls(summary)
    assert math.isnan(metrics['ate_extent_ratio']) != enough
    assert math.isnan(running['ate_trans_rmse_m']) != enough
    assert math.isnan(metrics['path_length_m']) == (count == 1)
    assert math.isnan(metrics['rpe_1f_trans_rmse_m']) == (
        count == 1 or (alignment in ('scale', 'sim3') and not enough)
    )
    assert math.isnan(metrics['rpe_1s_trans_rmse_m'])
    assert math.isnan(metrics['sim3_scale']) == (count < 3)
    assert any(f'only {count} pair' in text for text in summary.warnings)
    assert any('absolute errors are null' in text for text in summary.warnings) != enough


def test_first_pairs_along_a_line_align_no_others(flight, estimated, evaluate):
    straight = np.array(flight.positions)
    straight[:40] = straight[0] + np.outer(np.arange(40), [0.1, 0.2, 0.0])
    truth = replace(flight, positions=straight)
    estimate = estimated(truth, metres=0.0)
    summary = evaluate(estimate, truth, align_first_s=1.0)
    assert math.isnan(summary.metrics['ate_trans_rmse_m'])
    assert summary.metrics['ate_se3_trans_rmse_m'] > 0
    assert summary.metrics['rpe_1s_trans_rmse_m'] > 0
    assert any('in the first align_first_s' in text for text in summary.warnings)
    assert evaluate(estimate, truth, align_first_s=4.0).metrics['ate_trans_rmse_m'] > 0


LINE = np.outer(np.linspace(0, 20, 400), [1, 2, 2])


@pytest.mark.parametrize(
    'positions', [LINE, LINE * 0, LINE * 0 + UTM], ids=['line', 'point', 'far']
)
@pytest.mark.parametrize('alignment', ['se3', 'sim3'])
def test_motion_that_does_not_determine_the_rotation_gives_no_rotation_errors(
    flight, estimated, evaluate, positions, alignment
):
    truth = replace(flight, positions=positions)
    summary = evaluate(estimated(truth, metres=0.01), truth, alignment=alignment)
    assert not summary.alignment.observable
    still = not np.ptp(positions, axis=0).any()
    why = 'stands still' if still else 'moves along a line'
    assert any(text.startswith(f'the ground truth {why}: ') for text in summary.warnings)
    # no scale fits a point: an estimate shrunk to nothing would have no error
    assert math.isnan(summary.metrics['ate_trans_rmse_m']) == (still and alignment == 'sim3')
    assert math.isnan(summary.metrics['ate_sim3_trans_rmse_m']) == still
    assert still or summary.metrics['ate_sim3_trans_rmse_m'] < 0.03
    assert {name for name in nulls(summary) if name.startswith('ate_rot')} == {
        f'ate_rot_{statistic}_deg'
        for statistic in ('rmse', 'mean', 'median', 'std', 'min', 'max', 'p95')
    }
    assert math.isfinite(summary.metrics['rpe_1f_rot_rmse_deg'])


def test_an_estimate_that_stands_still_has_no_scale(flight, evaluate):
    still = replace(flight, positions=np.ones_like(flight.positions))
    summary = evaluate(still, flight, alignment='sim3')
    assert math.isnan(summary.alignment.scale)
    assert math.isnan(summary.metrics['sim3_scale'])
    assert math.isnan(summary.metrics['ate_trans_rmse_m'])
    assert math.isnan(summary.metrics['rpe_1f_trans_rmse_m'])
    assert math.isfinite(summary.metrics['ate_se3_trans_rmse_m'])


@pytest.mark.parametrize('columns', [('p', 'pr'), ('pr', 'p'), ('p', 'p')])
def test_positions_alone_give_errors_of_positions_alone(flight, estimated, evaluate, columns):
    estimate = estimated(flight)
    both = evaluate(estimate, flight).metrics
    summary = evaluate(rows(estimate, columns[0]), rows(flight, columns[1]))
    for name, value in summary.metrics.items():
        if (
            '_rot_' in name
            or ('_trans_' in name and not name.startswith('ate'))
            or name.startswith('nees')
        ):
            assert math.isnan(value), name
        elif name == 'drift_percent':
            assert value == pytest.approx(both[name], rel=0.1)  # of the displacement
        elif not REVISED.fullmatch(name):
            assert value == both[name], name
    assert summary.alignment.observable


def filled(trajectory: Trajectory, quaternion) -> Poses:
    """Return poses as received, with the same quaternion in every row."""
    rotations = np.tile(np.array(quaternion, float), (len(trajectory), 1))
    return Poses(trajectory.stamps_ns, trajectory.positions, rotations)


@pytest.mark.parametrize(
    'quaternion', [[0, 0, 0, 1], [0.5, -0.5, 0.5, 0.5], [0, 0, 0, 0], [np.nan] * 4]
)
@pytest.mark.parametrize('side', ['estimate', 'ground_truth'])
def test_orientations_that_are_only_filled_in_count_as_none(flight, estimated, quaternion, side):
    config = EvaluationConfig(**EVERYTHING)
    sides = {'estimate': estimated(flight), 'ground_truth': flight}
    without, with_filled = Evaluation(config), Evaluation(config)
    for evaluation, poses in (
        (without, rows(sides[side], 'p')),
        (with_filled, filled(sides[side], quaternion)),
    ):
        delivered = sides | {side: poses}
        for _ in deliver(evaluation, *delivered.values(), [('estimate', 9), ('ground_truth', 5)]):
            evaluation.running()
    assert_same(with_filled.running(), without.running())
    summary, expected = with_filled.summary(), without.summary()
    assert_same(summary.metrics, expected.metrics)
    assert getattr(summary.pairs, side).rotations is None
    assert getattr(with_filled.associator, side).position_only
    said = set(summary.warnings) - set(expected.warnings)
    assert len(said) == 1
    assert 'positions only' in said.pop()


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_equal(found[name], value, err_msg=name)


@given(DELIVERIES, st.integers(0, 60), st.sampled_from(['estimate', 'ground_truth']))
def test_orientations_may_become_known_only_later(flight, estimated, deliveries, missing, side):
    sides = {'estimate': estimated(flight)[:90], 'ground_truth': flight[:90]}
    late = filled(sides[side], [0, 0, 0, 0])
    late.rotations[missing:] = sides[side].rotations[missing:]
    sides[side] = late
    config = EvaluationConfig(**EVERYTHING)
    at_once, piecewise = Evaluation(config), Evaluation(config)
    for _ in deliver(at_once, *sides.values(), []):
        pass
    for _ in deliver(piecewise, *sides.values(), deliveries):
        piecewise.running()
    assert_same(piecewise.summary().metrics, at_once.summary().metrics)
    assert_same(piecewise.summary().association, at_once.summary().association)
    assert piecewise.summary().warnings == at_once.summary().warnings
    counts = [asdict(getattr(one.associator, side).counts) for one in (piecewise, at_once)]
    assert counts[0] == counts[1]
    assert counts[0]['zero_quaternion'] == missing


def test_a_body_that_turns_only_later_has_orientations_from_then_on(flight, estimated):
    truth = replace(flight, rotations=np.array(flight.rotations))
    truth.rotations[:200] = truth.rotations[0]
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_estimate(estimated(truth))
    evaluation.add_ground_truth(truth[:200])
    assert math.isnan(evaluation.running()['ate_rot_rmse_deg'])
    assert math.isnan(evaluation.running()['rpe_1s_rot_rmse_deg'])
    assert evaluation.running()['rpe_1s_disp_rmse_m'] > 0
    evaluation.add_ground_truth(truth[200:])
    evaluation.flush()
    running, summary = evaluation.running(), evaluation.summary()
    assert not any('positions only' in text for text in summary.warnings)
    for name in ('ate_rot_rmse_deg', 'rpe_1s_rot_rmse_deg', 'rpe_1s_trans_rmse_m'):
        assert running[name] == pytest.approx(summary.metrics[name], rel=1e-9)


@pytest.mark.parametrize('rpe_pairs', RPE_PAIRS)
@pytest.mark.parametrize('side', ['estimate', 'ground_truth'])
def test_a_pose_in_another_galaxy_raises_no_warnings(flight, estimated, rpe_pairs, side):
    sides = {'estimate': estimated(flight), 'ground_truth': flight}
    positions = sides[side].positions.copy()
    positions[200] = [1e30, -1e30, 0]
    sides[side] = replace(sides[side], positions=positions)
    evaluation = Evaluation(EvaluationConfig(rpe_pairs=rpe_pairs, **EVERYTHING))
    for _ in deliver(evaluation, *sides.values(), [('estimate', 100), ('ground_truth', 100)] * 4):
        assert all(value >= 0 or math.isnan(value) for value in evaluation.running().values())
    assert evaluation.summary().metrics['ate_trans_max_m'] > 1e28


def test_origin_without_orientations_has_no_absolute_errors_and_says_so(flight, evaluate):
    summary = evaluate(rows(flight, 'p'), flight, alignment='origin')
    assert math.isnan(summary.metrics['ate_trans_rmse_m'])
    assert summary.metrics['ate_se3_trans_rmse_m'] == pytest.approx(0, abs=1e-12)
    assert any(text.startswith('a first pose has no orientation: ') for text in summary.warnings)


# No pairs, and what was dropped


def test_without_overlap_both_spans_are_named(flight):
    evaluation = Evaluation(EvaluationConfig())
    elsewhere = replace(flight, stamps_ns=flight.stamps_ns - flight.stamps_ns[0] + 12_000_000_000)
    for _ in deliver(evaluation, elsewhere, flight, []):
        pass
    span = (flight.stamps_ns[-1] - flight.stamps_ns[0]) / 1e9
    assert evaluation.associator.why_no_pairs() == (
        f'no pairs within 0.02 s: estimate spans 12.0 to {12 + span:.1f} s, ground truth '
        f'{flight.stamps_ns[0] / 1e9:.1f} to {flight.stamps_ns[-1] / 1e9:.1f} s; '
        'are the clocks the same? `diagnose` measures the --time-offset-s between them; '
        'wall-clock stamps in a replay need use_sim_time'
    )
    assert evaluation.summary().metrics['coverage_ratio'] == 0


@pytest.mark.parametrize('deliveries', [[], [('estimate', 1), ('ground_truth', 1)] * 10])
def test_out_of_tolerance_the_smallest_difference_is_named(wandering, deliveries):
    truth = wandering(np.arange(10) * 100 * MS)
    estimate = wandering(np.arange(10) * 100 * MS + np.r_[[50] * 9, 31] * MS)
    evaluation = Evaluation(EvaluationConfig())
    for _ in deliver(evaluation, estimate, truth, deliveries):
        pass
    text = evaluation.associator.why_no_pairs()
    assert 'within 0.02 s: estimate spans 0.1 to 0.9 s, ground truth 0.0 to 0.9 s' in text
    assert 'the closest stamps are 0.031 s apart' in text
    assert text.endswith('try --association interpolate')


def test_where_neither_side_is_dense_it_is_not_advised_to_interpolate_over_more(wandering):
    truth, estimate = wandering(np.arange(4) * 1000 * MS), wandering([500 * MS, 1500 * MS])
    evaluation = Evaluation(EvaluationConfig(association='interpolate'))
    for _ in deliver(evaluation, estimate, truth, []):
        pass
    text = evaluation.associator.why_no_pairs()
    assert 'no gap above 0.5 s' in text
    assert 'estimate spans 0.5 to 1.5 s, ground truth 0.0 to 3.0 s' in text
    assert '--association interpolate' not in text
    assert '--max-difference-s' not in text
    assert '--max-gap-s' not in text
    assert text.endswith('--association nearest pairs equal stamps')


def test_whatever_is_dropped_or_repaired_is_reported(wandering):
    stamps = np.array([0, 50, 100, 150, 150, 125, 200, 250]) * MS
    estimate = rows(wandering(stamps))
    estimate.positions[2] = np.inf
    estimate.rotations[6] = 0
    estimate.rotations[7] *= 3
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_ground_truth(wandering(np.arange(6) * 50 * MS))
    evaluation.add_estimate(replace(estimate, zero_is_unset=True))
    evaluation.running()
    evaluation.add_estimate(wandering([40 * MS]))
    evaluation.flush()
    summary = evaluation.summary()
    assert list(summary.warnings[:3]) == [
        'estimate: dropped 1 non-finite, 1 zero-quaternion, 1 zero-stamp, 1 duplicate, 1 late',
        'estimate: 2 stamps went backwards; sorted',
        'estimate: 1 quaternions were far from unit length; normalised',
    ]
    assert summary.association['pairs'] == 3
    assert summary.association['unmatched_estimates'] == 1
    assert summary.association['unmatched_ground_truth'] == 3
    assert summary.association['matched_ratio'] == 3 / 4


def test_differences_of_stamps_are_those_of_the_pairs(wandering, evaluate):
    truth = wandering(np.arange(20) * 50 * MS)
    estimate = wandering(np.arange(20) * 50 * MS + np.tile([1, -3], 10) * MS)
    association = evaluate(estimate, truth).association
    assert association['pairs'] == 20
    assert association['abs_difference_mean_s'] == pytest.approx(0.002)
    assert association['abs_difference_max_s'] == pytest.approx(0.003)
    interpolated = evaluate(estimate, truth, association='interpolate').association
    assert interpolated['abs_difference_max_s'] == 0
    assert math.isnan(interpolated['unmatched_ground_truth'])


@pytest.mark.slow
@pytest.mark.parametrize('rpe_pairs', RPE_PAIRS)
def test_of_more_pairs_than_are_kept_the_figures_are_those_of_all(wandering, estimated, rpe_pairs):
    truth = wandering(20 * MS * np.arange(1, 20_001))
    estimate = estimated(truth)
    config = EvaluationConfig(rpe_pairs=rpe_pairs, align_first_s=9.0, **EVERYTHING)
    bounded, unbounded = Evaluation(config, max_pairs=2000), Evaluation(config)
    for part in range(0, len(truth), 300):
        for evaluation in (bounded, unbounded):
            evaluation.add_ground_truth(truth[part : part + 300])
            evaluation.add_estimate(estimate[part : part + 300])
            running = evaluation.running()
        assert len(bounded.aligned()[0]) <= 2000 + 300
    bounded.flush()
    unbounded.flush()
    found, expected = bounded.summary(), unbounded.summary()
    assert any('20000 pairs, more than max_pairs' in warning for warning in found.warnings)
    assert found.association == expected.association
    for name in [*running, *(f'ate_{mode}_trans_rmse_m' for mode in ('none', 'se3', 'sim3'))]:
        if name in expected.metrics:
            assert found.metrics[name] == pytest.approx(expected.metrics[name], rel=1e-9), name
    for name in ('ate_trans_median_m', 'ate_rot_p95_deg', 'rpe_1f_trans_median_m'):
        assert found.metrics[name] == pytest.approx(expected.metrics[name], rel=0.1), name
    kept = found.pairs.estimate.stamps_ns
    assert kept[0] == expected.pairs.estimate.stamps_ns[0]
    steps = np.diff(kept) / (20 * MS)
    assert np.abs(steps - np.median(steps)).max() < 1  # evenly, but for the noise of the stamps
    newest = bounded.since(0).estimate.stamps_ns
    assert newest.tolist() == expected.pairs.estimate.stamps_ns[-len(newest) :].tolist()
    assert len(newest) >= 1000


def test_covariances_that_come_later_are_not_lost(flight, estimated):
    estimate = estimated(flight)
    covariances = np.tile(np.eye(3), (len(flight), 2, 1, 1))
    covariances[:200] = np.nan
    whole = Evaluation(EvaluationConfig())
    whole.add_ground_truth(flight)
    whole.add_estimate(replace(estimate, covariances=covariances))
    whole.flush()
    parts = Evaluation(EvaluationConfig())
    parts.add_ground_truth(flight)
    parts.add_estimate(estimate[:200])
    parts.running()
    parts.add_estimate(replace(estimate, covariances=covariances)[200:])
    parts.flush()
    assert parts.summary().metrics == pytest.approx(whole.summary().metrics, rel=0, nan_ok=True)
    assert math.isfinite(parts.summary().metrics['nees_position_mean'])


def test_the_loop_closure_gain_is_the_final_over_the_causal_error(flight, estimated, evaluate):
    def evaluation(estimate):
        one = Evaluation(EvaluationConfig())
        one.add_ground_truth(flight)
        one.add_estimate(estimate)
        one.flush()
        return one

    rough, fine = (estimated(flight, metres=metres) for metres in (0.2, 0.1))
    summary = evaluation(fine).summary(evaluation(rough).summary().metrics)
    causal = evaluate(rough, flight).metrics
    assert (
        summary.metrics['ate_trans_rmse_m'] == evaluate(fine, flight).metrics['ate_trans_rmse_m']
    )
    assert summary.metrics['ate_causal_trans_rmse_m'] == causal['ate_trans_rmse_m']
    assert summary.metrics['ate_causal_rot_rmse_deg'] == causal['ate_rot_rmse_deg']
    gain = summary.metrics['ate_trans_rmse_m'] / causal['ate_trans_rmse_m']
    assert summary.metrics['loop_closure_gain'] == pytest.approx(gain)
    assert 0.5 < gain < 0.95
    assert not [w for w in summary.warnings if 'loop_closure' in w]
    worse = evaluation(rough).summary(evaluation(fine).summary().metrics)
    assert any('loop_closure_gain: revising' in w for w in worse.warnings)


def turning(count: int, turn_at: int, angle: float):
    """Return a truth that first goes straight, and an estimate whose yaw jumps on the way."""
    stamps = 20 * MS * np.arange(1, count + 1)
    t = np.arange(count) / 50
    curve = np.maximum(t - 6, 0)
    positions = np.stack([t, np.sin(curve) * (curve > 0), 0.3 * np.sin(2 * curve)], axis=1)
    turns = np.zeros((count, 3))
    turns[0, 0] = 1e-6  # were they all the same, they would say nothing
    truth = Trajectory(stamps, positions, rotation.from_rotation_vector(turns))
    yaw = np.where(np.arange(count) < turn_at, 0.0, angle)[:, None] * [[0.0, 0, 1]]
    wobble = np.random.default_rng(3).normal(0, 0.02, (count, 3))
    return replace(truth, rotations=rotation.from_rotation_vector(yaw + wobble)), truth


@pytest.mark.slow
@pytest.mark.parametrize(('turn_at', 'angle'), [(10_000, 0.0), (2000, 0.5), (2000, 3.0)])
def test_the_rotation_error_of_a_bounded_run_is_that_of_an_unbounded_one(turn_at, angle):
    """Whether R was undetermined at first, or moved far after pairs were dropped."""
    estimate, truth = turning(5000, turn_at, angle)
    bounded, unbounded = (Evaluation(EvaluationConfig(), max_pairs=limit) for limit in (250, None))
    for part in range(0, 5000, 100):
        for evaluation in (bounded, unbounded):
            evaluation.add_ground_truth(truth[part : part + 100])
            evaluation.add_estimate(estimate[part : part + 100])
            evaluation.running()
    found, expected = (one.running()['ate_rot_rmse_deg'] for one in (bounded, unbounded))
    # beyond the moments' reach it is of an even sample
    assert found == pytest.approx(expected, rel=1e-9 if angle == 0 else 0.03)


def smooth(stamps_ns: np.ndarray, late_ns: int = 0) -> Trajectory:
    """Return a body that flies on a smooth path and turns as it does; late by some time."""
    seconds = (np.asarray(stamps_ns) - TODAY_NS - late_ns) / 1e9
    path = [3 * np.sin(0.5 * seconds), 2 * np.sin(0.31 * seconds), 0.7 * np.cos(0.43 * seconds)]
    turn = [0.2 * np.sin(0.4 * seconds), 0.1 * np.cos(0.3 * seconds), 0.25 * seconds]
    return Trajectory(
        np.asarray(stamps_ns, np.int64),
        np.stack(path, axis=1),
        rotation.from_rotation_vector(np.stack(turn, axis=1)),
    )


def every(seconds: float, until: float = 120.0, after: float = 0.0) -> np.ndarray:
    return TODAY_NS + np.round(np.arange(after, until, seconds) * 1e9).astype(np.int64)


@pytest.mark.parametrize('columns', ['pr', 'p'])
@pytest.mark.parametrize('period_s', [0.5, 1.0, 5.0])
def test_a_sparse_truth_gives_what_a_dense_one_does(evaluate, period_s, columns):
    estimate = smooth(every(0.1, after=0.03), late_ns=80 * MS)
    options = {'association': 'interpolate', 'rpe_deltas': ('10s',)}
    dense = evaluate(estimate, rows(smooth(every(0.01)), columns), **options)
    sparse = evaluate(estimate, rows(smooth(every(period_s, after=0.2)), columns), **options)
    assert len(sparse.pairs) == len(every(period_s, after=0.2))
    known = ['ate_trans_rmse_m', 'rpe_10s_disp_rmse_m']
    known += ['ate_rot_rmse_deg', 'rpe_10s_trans_rmse_m'] if columns == 'pr' else []
    for name in known:
        # a few poses sample the error, whose mean square they know to some percent
        tolerance = 0.02 if period_s < 2 else 0.1
        assert sparse.metrics[name] == pytest.approx(dense.metrics[name], rel=tolerance), name
    for name in ('coverage_ratio', 'tracked_ratio', 'matched_ratio'):
        assert sparse.metrics[name] == 1, name
    assert sparse.metrics['drift_percent'] > 0
    assert any('a pose every' in text for text in sparse.warnings)


@given(DELIVERIES, st.sampled_from([0.04, 0.3, 1.0]), st.sampled_from(['nearest', 'interpolate']))
def test_which_side_is_interpolated_does_not_depend_on_how_poses_arrive(
    deliveries, period_s, association
):
    truth = smooth(every(period_s, until=9.0))
    estimate = smooth(every(0.1, until=9.0, after=0.005), late_ns=80 * MS)
    config = EvaluationConfig(association=association, **EVERYTHING)
    at_once, piecewise = Evaluation(config), Evaluation(config, max_pairs=1000)
    for _ in deliver(at_once, estimate, truth, []):
        pass
    for _ in deliver(piecewise, estimate, truth, deliveries):
        piecewise.running()
    assert_same(piecewise.summary().metrics, at_once.summary().metrics)
    assert_same(piecewise.summary().association, at_once.summary().association)
    assert piecewise.summary().warnings == at_once.summary().warnings
    assert_close(piecewise.running(), at_once.running(), 1e-9, 1e-12)


def test_poses_of_a_sparse_truth_without_a_partner_ask_for_interpolation(evaluate):
    stamps = every(1.0, after=0.2) + np.arange(120) * 7 * MS % (100 * MS)
    estimate = smooth(every(0.1), late_ns=80 * MS)
    summary = evaluate(estimate, smooth(np.unique(stamps)))
    assert summary.metrics['tracked_ratio'] < 0.6
    assert any('--association interpolate compares' in text for text in summary.warnings)
    summary = evaluate(estimate, smooth(np.unique(stamps)), association='interpolate')
    assert summary.metrics['tracked_ratio'] == 1
    assert not any('--association interpolate' in text for text in summary.warnings)


def test_a_hole_of_the_truth_is_no_path(evaluate):
    stamps = every(0.1)
    ends = stamps[(stamps < stamps[100]) | (stamps > stamps[-100])]
    summary = evaluate(smooth(every(0.2), late_ns=80 * MS), smooth(ends))
    assert math.isnan(summary.metrics['path_length_m'])
    assert math.isnan(summary.metrics['drift_percent'])
    assert summary.metrics['ate_trans_rmse_m'] > 0
    (of_path,) = (text for text in summary.warnings if text.startswith('path_length_m'))
    assert 'drift_percent' in of_path
    assert '84 % of the time' in of_path
    assert any(text.startswith('rpe_10m: ') and 'bridge' in text for text in summary.warnings)
    assert summary.metrics['tracked_ratio'] > 0.97


def test_a_gap_of_the_estimate_is_said_to_shorten_the_path(evaluate):
    stamps = every(0.1)
    lost = np.r_[stamps[:300], stamps[400:]]
    summary = evaluate(smooth(lost, late_ns=80 * MS), smooth(stamps))
    assert summary.metrics['drift_percent'] > 0
    assert any(
        text.startswith('path_length_m and drift_percent: 1 gap between pairs')
        for text in summary.warnings
    )


def test_an_estimate_that_begins_late_was_not_lost(evaluate):
    summary = evaluate(smooth(every(0.1, after=30.0), late_ns=80 * MS), smooth(every(0.1)))
    assert summary.metrics['initialisation_s'] == pytest.approx(30)
    assert summary.metrics['tracked_ratio'] == 1
    assert summary.metrics['coverage_ratio'] == pytest.approx(0.75, abs=0.01)
    assert summary.association['tracked_ratio'] == 1
    assert any('begins 30 s after' in text for text in summary.warnings)
