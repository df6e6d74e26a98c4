"""Running values second by second: the same live and recorded, and never going back."""

from dataclasses import replace
import math

from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.series import running_series, RunningSeries
from vio_eval_ros.core.trajectory import Poses

MS = 1_000_000
NOTHING = Poses(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4)))
# Which stream delivers next, and how many poses at once; the rest comes at the end.
DELIVERIES = st.lists(
    st.tuples(st.sampled_from(['estimate', 'ground_truth']), st.integers(1, 9)), max_size=30
)


def test_the_series_has_a_row_a_second_and_ends_with_the_summary(flight, estimated, evaluate):
    estimate = estimated(flight)
    series = list(running_series(EvaluationConfig(), estimate, flight))
    stamps = np.array([stamp for stamp, _ in series])
    newest = max(estimate.stamps_ns[-1], flight.stamps_ns[-1])
    assert stamps[-1] == newest
    assert (stamps[:-1] % 10**9 == 0).all()
    assert (np.diff(stamps)[:-1] == 10**9).all()
    assert np.diff(stamps)[-1] <= 10**9
    final = evaluate(estimate, flight)
    assert series[-1][1] == {
        name: final.metrics.get(name, len(final.pairs)) for name in series[-1][1]
    }
    pairs = [values['pairs'] for _, values in series]
    assert pairs == sorted(pairs)
    assert pairs[0] < 30


@pytest.mark.slow
@given(
    st.lists(st.sampled_from([1, 5, 10]), min_size=1, max_size=30),
    st.lists(st.sampled_from([1, 5, 10]), min_size=1, max_size=30),
    DELIVERIES,
)
@example([10], [10], []).via('both end at a whole second')
def test_a_live_series_has_the_rows_of_the_recording(wandering, est_steps, gt_steps, deliveries):
    estimate = wandering(np.cumsum(est_steps) * 100 * MS, seed=1)
    truth = wandering(np.cumsum(gt_steps) * 100 * MS)
    config = EvaluationConfig(rpe_deltas=('1f', '1s'))
    live, rows_ = RunningSeries(config), []
    streams = {'estimate': estimate, 'ground_truth': truth}
    add = {'estimate': live.add_estimate, 'ground_truth': live.add_ground_truth}
    rest = [(name, len(stream)) for name, stream in streams.items()]
    for name, size in [*deliveries, *rest]:
        add[name](streams[name][:size])
        streams[name] = streams[name][size:]
        rows_ += live.rows()
    rows_ += live.rest()
    recorded = list(running_series(config, estimate, truth))
    assert [stamp for stamp, _ in rows_] == [stamp for stamp, _ in recorded]
    for (_, found), (_, expected) in zip(rows_, recorded, strict=True):
        np.testing.assert_equal(found, expected)


@pytest.mark.parametrize('period', [1, 3, 20])
def test_live_and_recorded_agree_on_which_side_is_interpolated(flight, estimated, period):
    estimate, truth = estimated(flight), flight[::period]
    config = EvaluationConfig(association='interpolate')
    live, rows = RunningSeries(config, max_pairs=10_000), []
    for begin in range(0, len(estimate), 7):
        live.add_estimate(estimate[begin : begin + 7])
        live.add_ground_truth(truth[begin : begin + 7])
        rows += live.rows()
    rows += live.rest()
    recorded = list(running_series(config, estimate, truth))
    assert [stamp for stamp, _ in rows] == [stamp for stamp, _ in recorded]
    for (_, found), (_, expected) in zip(rows, recorded, strict=True):
        np.testing.assert_equal(found, expected)


def test_the_series_of_a_stream_without_poses_has_no_numbers(flight):
    for streams in ((NOTHING, flight), (flight, NOTHING)):
        *_, (stamp, values) = running_series(EvaluationConfig(), *streams)
        assert stamp == flight.stamps_ns[-1]
        assert math.isnan(values['ate_trans_rmse_m'])


def test_poses_that_wait_too_long_for_the_other_stream_are_counted(flight, estimated):
    series = RunningSeries(EvaluationConfig(), max_pairs=15)
    estimate = estimated(flight)
    for part in range(0, 400, 100):
        series.add_estimate(estimate[part : part + 100])
    series.add_ground_truth(flight[:100])
    series.add_ground_truth(flight[100:150])
    series.add_ground_truth(flight[150:])
    *_, (_, last) = series.rest()
    assert last['pairs'] == 150
    streams = series.evaluation.associator
    assert streams.estimate.counts.overflow == streams.ground_truth.counts.overflow == 250
    assert streams.estimate.used == 150


def test_a_ground_truth_that_is_complete_does_not_wait(flight, estimated):
    series = RunningSeries(EvaluationConfig(), max_pairs=15)
    series.add_ground_truth(flight, waits=False)
    series.add_estimate(estimated(flight)[:100])
    *_, (_, last) = series.rest()
    assert last['pairs'] == 100
    assert series.evaluation.associator.ground_truth.counts.overflow == 0


def test_a_series_does_not_go_back_for_a_late_pose(flight, estimated):
    series, estimate = RunningSeries(EvaluationConfig()), estimated(flight)
    late = np.r_[:100, 130:250, 100:130, 250:400]
    stamps = []
    for part in np.split(late, range(20, 400, 20)):
        series.add_estimate(estimate[part])
        series.add_ground_truth(flight[: part.max() + 1][-20:])
        stamps += [stamp_ns for stamp_ns, _ in series.rows()]
    stamps += [stamp_ns for stamp_ns, _ in series.rest()]
    assert len(stamps) > 5
    assert (np.diff(stamps) > 0).all()
    assert series.evaluation.associator.estimate.counts.late


def test_poses_stamped_0_are_counted_and_have_no_row(flight, estimated):
    series, estimate = RunningSeries(EvaluationConfig()), estimated(flight)
    unstamped = replace(estimate[:7], stamps_ns=np.zeros(7, np.int64), zero_is_unset=True)
    series.add_estimate(unstamped)
    series.add_estimate(replace(estimate, zero_is_unset=True))
    series.add_ground_truth(flight)
    stamps = [stamp_ns for stamp_ns, _ in series.rest()]
    assert stamps[0] >= flight.stamps_ns[0]
    assert series.evaluation.associator.estimate.counts.zero_stamp == 7
