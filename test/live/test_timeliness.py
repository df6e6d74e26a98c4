"""Known delays, speeds and twists come back."""

import numpy as np
import pytest

from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.live.timeliness import Arrivals, ClockRelation, Timeliness

CONFIG = EvaluationConfig()
BEGIN_NS = 1_700_000_000_000_000_000
SPEED = 2.0
PERIOD_S = 0.05
UNALIGNED = Alignment('none', 1.0, np.array([0.0, 0, 0, 1]), np.zeros(3))


def straight(period_s, seconds=20.0):
    """Return poses of a body that moves straight on at a constant speed, turned by 90 degrees."""
    seconds = np.arange(0, seconds, period_s)
    stamps_ns = BEGIN_NS + np.rint(seconds * 1e9).astype(np.int64)
    positions = np.column_stack([0 * seconds, SPEED * seconds, 0 * seconds])
    quaternion = np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    return Poses(stamps_ns, positions, np.tile(quaternion, (len(seconds), 1)))


def timed(delays_s, *, config=CONFIG, twist=None, batch=7, rate=1.0, clock_ns=0):
    """Return what is known of an estimate that comes late by so much."""
    found = Timeliness(config, None)
    estimate = straight(PERIOD_S)
    passed_ns = estimate.stamps_ns - BEGIN_NS + np.rint(1e9 * np.asarray(delays_s)).astype(int)
    received_ns = BEGIN_NS + np.rint(passed_ns / rate).astype(np.int64)
    node_ns = BEGIN_NS + passed_ns + clock_ns
    twists = None if twist is None else np.tile(twist, (len(estimate), 1))
    for k in range(0, len(estimate), batch):
        rows = slice(k, k + batch)
        of_batch = None if twists is None else twists[rows]
        arrivals = Arrivals(estimate[rows], received_ns[rows], of_batch)
        found.add_estimate(arrivals, node_ns[rows])
    truth = straight(0.005)
    for k in range(0, len(truth), 100):
        found.add_ground_truth(truth[k : k + 100])
    return found


@pytest.mark.parametrize('delay_s', [0.02, 0.13, 1.0])
def test_a_constant_delay_and_its_cost_come_back(delay_s):
    metrics = timed(delay_s).metrics(UNALIGNED)
    assert metrics['latency_median_s'] == pytest.approx(delay_s, abs=1e-9)
    assert metrics['latency_p99_s'] == pytest.approx(delay_s, abs=1e-9)
    # a pose is held from its arrival to that of the next
    ages_s = delay_s + np.arange(0, PERIOD_S, 0.005)
    held_m = SPEED * np.sqrt(np.mean(ages_s**2))
    assert metrics['held_trans_rmse_m'] == pytest.approx(held_m, rel=0.05)
    assert np.isnan(metrics['propagated_trans_rmse_m'])
    assert metrics['real_time_factor'] == pytest.approx(1.0)


def test_percentiles_of_delays_that_vary():
    delays_s = np.random.default_rng(3).gamma(2.0, 0.02, size=400)
    metrics = timed(delays_s).metrics(UNALIGNED)
    assert metrics['latency_median_s'] == pytest.approx(np.median(delays_s), abs=1e-8)
    assert metrics['latency_p99_s'] == pytest.approx(np.percentile(delays_s, 99), abs=1e-8)


@pytest.mark.parametrize('rate', [0.5, 2.0, 8.0])
def test_the_real_time_factor_is_by_the_clock_on_the_wall(rate):
    found = timed(0.1, rate=rate)
    assert found.metrics(UNALIGNED)['real_time_factor'] == pytest.approx(rate, rel=1e-6)
    recent = found.recent(2.0)
    assert recent['real_time_factor'] == pytest.approx(rate, rel=1e-3)
    assert recent['latency_median_s'] == pytest.approx(0.1, abs=1e-9)
    assert 'held_trans_rmse_m' not in recent


def test_a_twist_in_the_frame_of_the_body_makes_up_for_the_delay():
    metrics = timed(0.3, twist=[SPEED, 0, 0, 0, 0, 0]).metrics(UNALIGNED)
    assert metrics['held_trans_rmse_m'] > 0.6
    assert metrics['propagated_trans_rmse_m'] < 1e-9
    too_slow = timed(0.3, twist=[0.9 * SPEED, 0, 0, 0, 0, 0]).metrics(UNALIGNED)
    assert too_slow['propagated_trans_rmse_m'] == pytest.approx(
        0.1 * metrics['held_trans_rmse_m'], rel=1e-6
    )


def test_a_turning_body_is_propagated_along_its_arc():
    """With a constant twist in the body frame a body moves on a circle."""
    radius_m, turn = 3.0, 0.8
    seconds = np.arange(0, 20, 0.005)
    angles = turn * seconds
    positions = radius_m * np.column_stack([np.sin(angles), 1 - np.cos(angles), 0 * angles])
    rotations = np.column_stack([0 * angles, 0 * angles, np.sin(angles / 2), np.cos(angles / 2)])
    stamps_ns = BEGIN_NS + np.rint(seconds * 1e9).astype(np.int64)
    truth = Poses(stamps_ns, positions, rotations)
    estimate = truth[::10]
    received_ns = estimate.stamps_ns + 200_000_000
    twists = np.tile([radius_m * turn, 0, 0, 0, 0, turn], (len(estimate), 1))
    found = Timeliness(CONFIG, None)
    found.add_estimate(Arrivals(estimate, received_ns, twists), received_ns)
    found.add_ground_truth(truth)
    metrics = found.metrics(UNALIGNED)
    assert metrics['held_trans_rmse_m'] == pytest.approx(radius_m * turn * 0.225, rel=0.05)
    assert metrics['propagated_trans_rmse_m'] < 0.01 * metrics['held_trans_rmse_m']


def test_twists_that_are_all_zero_are_unknown():
    assert np.isnan(timed(0.3, twist=[0.0] * 6).metrics(UNALIGNED)['propagated_trans_rmse_m'])


def test_stamps_of_another_clock_have_no_latency():
    """As where a recording is played, and the evaluator has no use_sim_time."""
    for apart_ns in (10**18, -(10**18), 61 * 10**9, -(10**9)):
        metrics = timed(0.1, clock_ns=apart_ns).metrics(UNALIGNED)
        assert np.isnan([v for k, v in metrics.items() if k != 'real_time_factor']).all()
        assert metrics['real_time_factor'] == pytest.approx(1.0)


def test_an_offset_of_the_stamps_is_taken_into_account():
    config = EvaluationConfig(time_offset_s=0.04)
    metrics = timed(0.1, config=config).metrics(UNALIGNED)
    assert metrics['latency_median_s'] == pytest.approx(0.06, abs=1e-9)


def test_an_older_pose_that_comes_late_is_not_gone_by():
    delays_s = np.full(400, 0.1)
    straggling = timed(delays_s, batch=400)
    arrivals, node_ns = straggling._arrivals[0]
    order = np.arange(400)
    order[[100, 103]] = order[[103, 100]]  # one overtakes
    moved = Arrivals(arrivals.poses[order], arrivals.received_ns)
    mixed = Timeliness(CONFIG, None)
    mixed.add_estimate(moved, node_ns)
    mixed.add_ground_truth(straight(0.005))
    expected = straggling.metrics(UNALIGNED)['held_trans_rmse_m']
    assert mixed.metrics(UNALIGNED)['held_trans_rmse_m'] == pytest.approx(expected, rel=0.05)


def test_the_oldest_are_given_up():
    found = Timeliness(CONFIG, 100)
    estimate = straight(PERIOD_S)
    for k in range(0, 400, 20):
        rows = estimate[k : k + 20]
        found.add_estimate(Arrivals(rows, rows.stamps_ns), rows.stamps_ns)
        found.add_ground_truth(rows)
    assert sum(len(node_ns) for _, node_ns in found._arrivals) == 100
    assert sum(map(len, found._truth)) == 100
    assert found.metrics(UNALIGNED)['held_trans_rmse_m'] == pytest.approx(0, abs=1e-12)


def test_of_nothing_nothing_is_known():
    assert np.isnan(list(Timeliness(CONFIG, None).metrics(UNALIGNED).values())).all()
    assert np.isnan(list(Timeliness(CONFIG, None).recent(5.0).values())).all()


def test_the_clock_of_a_simulation_is_between_those_noted():
    clock = ClockRelation()
    times = np.array([BEGIN_NS, BEGIN_NS + 10**9], np.int64)
    assert clock.node_ns(times).tolist() == times.tolist()
    clock.note(BEGIN_NS, 5 * 10**9)
    clock.note(BEGIN_NS + 10**9, 9 * 10**9)
    asked = BEGIN_NS + np.array([0, 250_000_000, 10**9], np.int64)
    assert clock.node_ns(asked).tolist() == [5 * 10**9, 6 * 10**9, 9 * 10**9]
