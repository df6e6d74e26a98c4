"""Every rule, level and message of ``/diagnostics``, as functions of values."""

from dataclasses import replace
import math
from types import SimpleNamespace

import numpy as np
import pytest

from vio_eval_ros.core.alignment import Moments, solve
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.core.side import AFTER_ALL, BEFORE_ALL
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.live import health
from vio_eval_ros.live.health import Level
from vio_eval_ros.live.queues import TimeJump
from vio_eval_ros.live.snapshot import RunState, SideState, Snapshot, TopicState

S = 1_000_000_000
ODOMETRY, POSE = 'nav_msgs/msg/Odometry', 'geometry_msgs/msg/PoseStamped'
STRING = 'std_msgs/msg/String'
VALUES = {
    'pairs': 100,
    'ate_trans_rmse_m': 0.1,
    'ate_extent_ratio': 0.01,
    'coverage_ratio': 0.99,
    'tracked_ratio': 0.99,
    'initialisation_s': 0.0,
    'matched_ratio': 0.98,
}
ESTIMATE = TopicState(
    name='estimate',
    topic='/odom',
    oldest_ns=100 * S,
    newest_ns=120 * S,
    msgtype=ODOMETRY,
    published_types=(ODOMETRY,),
    publishers=('/vins',),
    received=200,
)
TRUTH = replace(
    ESTIMATE, name='ground_truth', topic='/truth', msgtype=POSE, published_types=(POSE,)
)
RUN = RunState(
    values=VALUES,
    estimate=SideState(100, {'late': 0}),
    ground_truth=SideState(200, {'late': 0}),
    estimate_moved_m=5.0,
    ground_truth_moved_m=5.0,
    waiting_for='no ground truth yet',
    no_pairs='no pairs within 0.02 s',
)
MIXED = '2 publishers on /odom: their poses are mixed (/bag, /vins)'
HEALTHY = Snapshot(RUN, (ESTIMATE, TRUTH), stale_after_s=2.0)


def told(status: health.Status) -> tuple[str, str]:
    return status.level.name, status.message


def alignment_of(positions: np.ndarray):
    poses = Trajectory(np.arange(len(positions)) * S, positions)
    pairs = Pairs.of(poses, poses)
    return solve('se3', Moments.of(pairs), pairs[:1])


def with_values(**values: float) -> RunState:
    return replace(RUN, values=VALUES | values)


def test_a_healthy_evaluation_is_ok_in_every_respect():
    found = health.statuses(HEALTHY)
    names = ['accuracy', 'association', 'streams', 'timing', 'diagnosis']
    assert [status.name for status in found] == names
    assert {status.level for status in found} == {Level.OK}
    assert [status.message for status in found[:3]] == ['running'] * 3


def test_timing_tells_latency_rate_and_broken_gates():
    assert (
        told(health.timing(RUN, ()))[1] == 'latency unknown: no stamps by the clock of this node'
    )
    values = {'latency_median_s': 0.0321, 'latency_p99_s': 0.08, 'real_time_factor': 0.99}
    run = replace(RUN, timing=values)
    message = 'latency 32.1 ms (median), 80 ms (99 %); 0.99 times real time'
    assert told(health.timing(run, ())) == ('OK', message)
    gates = Gate.of('latency_p99_s', {'max': 0.1, 'warn': 0.05})
    assert told(health.timing(run, gates)) == ('WARN', 'gate latency_p99_s<=0.05 is broken: 0.08')
    unknown = replace(RUN, timing=dict.fromkeys(values, math.nan))
    assert told(health.timing(unknown, gates))[0] == 'OK'


def test_levels_are_numbered_as_in_diagnostic_msgs():
    assert {level.name: level.value for level in Level} == {
        'OK': 0,
        'WARN': 1,
        'ERROR': 2,
        'STALE': 3,
    }


# accuracy


def test_accuracy_has_the_running_values_but_for_those_of_the_association():
    values = health.accuracy(RUN, ()).values
    assert values == {'pairs': 100, 'ate_trans_rmse_m': 0.1, 'ate_extent_ratio': 0.01}


def test_without_pairs_there_is_no_accuracy():
    for run in (RunState(), with_values(pairs=0)):
        assert told(health.accuracy(run, ())) == ('WARN', 'no pairs yet')


@pytest.mark.parametrize(
    ('estimate_m', 'truth_m', 'ratio', 'ate_m', 'diverged'),
    [
        (60.1, 5.0, 0.01, 0.1, True),  # moved more than 10 times as far and 10 m
        (60.0, 5.0, 0.01, 0.1, False),
        (10.1, 0.0, 0.01, 0.1, True),
        (1e9, math.inf, 0.01, 0.1, False),  # there is no window yet
        (5.0, 5.0, 10.1, 10.1, True),  # off by more than 10 times the extent and 10 m
        (5.0, 5.0, 10.0, 10.1, False),
        (5.0, 5.0, 10.1, 10.0, False),
        (5.0, 5.0, math.nan, math.nan, False),
    ],
)
def test_an_estimate_has_diverged_where_it_moves_or_is_off_by_ten_times(
    estimate_m, truth_m, ratio, ate_m, diverged
):
    run = replace(
        with_values(ate_extent_ratio=ratio, ate_trans_rmse_m=ate_m),
        estimate_moved_m=estimate_m,
        ground_truth_moved_m=truth_m,
    )
    assert health.has_diverged(run) == diverged
    if diverged:
        gates = [Gate('ate_trans_rmse_m', '<=', 1e-9)]  # divergence comes first
        assert told(health.accuracy(run, gates)) == ('ERROR', 'the estimate has diverged')


def test_a_broken_gate_is_an_error_or_a_warning_and_the_worst_is_reported():
    fails, warns = (Gate('ate_trans_rmse_m', '<=', 0.05, word) for word in ('fail', 'warn'))
    message = 'gate ate_trans_rmse_m<=0.05 is broken: 0.1'
    assert told(health.accuracy(RUN, [fails])) == ('ERROR', message)
    assert told(health.accuracy(RUN, [warns])) == ('WARN', message)
    other = Gate('coverage_ratio', '>=', 0.999, 'warn')
    assert told(health.accuracy(RUN, [other, fails])) == ('ERROR', message)
    assert told(health.accuracy(RUN, [fails._replace(limit=0.2)])) == ('OK', 'running')


def test_a_gate_on_what_has_no_running_value_is_not_judged_yet():
    assert told(health.accuracy(RUN, [Gate('rpe_1s_trans_max_m', '<=', 0.0)]))[0] == 'OK'


def test_an_alignment_that_is_not_determined_is_reported_with_its_reason():
    line = np.outer(np.arange(20.0), [1, 0, 0])
    run = replace(RUN, alignment=alignment_of(line))
    assert run.alignment.undetermined
    assert told(health.accuracy(run, ())) == (
        'WARN',
        f'{run.alignment.undetermined}: the alignment is not determined yet',
    )
    run = replace(RUN, alignment=alignment_of(np.random.default_rng(1).normal(size=(20, 3))))
    assert told(health.accuracy(run, ())) == ('OK', 'running')
    undefined = with_values(ate_trans_rmse_m=math.nan)
    assert told(health.accuracy(undefined, ())) == (
        'WARN',
        'the alignment is not determined yet',
    )


def test_other_problems_are_added_and_are_at_least_a_warning():
    assert told(health.accuracy(RUN, (), ('a', 'b'))) == ('WARN', 'running; a; b')
    gates = [Gate('ate_trans_rmse_m', '<=', 0.05)]
    level, message = told(health.accuracy(RUN, gates, ('/disk: cannot write',)))
    assert (level, message[-21:]) == ('ERROR', '; /disk: cannot write')


# association


def test_the_association_counts_every_pose_that_was_not_used():
    run = replace(RUN, estimate=SideState(100, {'late': 1, 'non_finite': 0}))
    status = health.association(replace(HEALTHY, run=run))
    assert told(status) == ('OK', 'running')
    assert status.values == {
        'pairs': 100,
        'coverage_ratio': 0.99,
        'tracked_ratio': 0.99,
        'initialisation_s': 0.0,
        'matched_ratio': 0.98,
        'estimate_poses': 100,
        'estimate_late': 1,
        'estimate_non_finite': 0,
        'ground_truth_poses': 200,
        'ground_truth_late': 0,
    }


def test_more_than_a_percent_of_dropped_poses_is_a_warning_with_the_reasons():
    dropped = {'non_finite': 2, 'zero_stamp': 0, 'late': 1}
    run = replace(RUN, ground_truth=SideState(200, dropped))
    assert told(health.association(replace(HEALTHY, run=run))) == (
        'WARN',
        'ground truth: dropped 2 non-finite, 1 late',
    )


def test_low_coverage_and_a_side_that_ends_early_are_warnings_the_worse_first():
    ends = replace(HEALTHY, topics=(replace(ESTIMATE, newest_ns=105 * S), TRUTH))
    early = 'the estimate ends 15.0 s before the ground truth: no values for the rest'
    assert told(health.association(ends)) == ('WARN', early)
    run = replace(with_values(tracked_ratio=0.8), estimate=SideState(9, {'late': 1}))
    assert told(health.association(replace(ends, run=run))) == (
        'WARN',
        f'only 80.0 % of the ground truth was tracked; {early}; estimate: dropped 1 late',
    )
    unknown = replace(HEALTHY, run=with_values(tracked_ratio=math.nan))
    assert told(health.association(unknown))[0] == 'OK'
    late = replace(HEALTHY, run=with_values(tracked_ratio=0.8, initialisation_s=15.0))
    assert told(health.association(late)) == (
        'WARN',
        'only 80.0 % of the ground truth was tracked since the first estimate',
    )
    late = replace(HEALTHY, run=with_values(coverage_ratio=0.7, initialisation_s=15.0))
    assert told(health.association(late)) == ('OK', 'running')


def test_which_side_ends_early_takes_the_offset_into_account():
    ahead = replace(HEALTHY, topics=(replace(ESTIMATE, newest_ns=125 * S), TRUTH))
    assert 'the ground truth ends 5.0 s before the estimate' in told(health.association(ahead))[1]
    assert told(health.association(replace(ahead, time_offset_s=-4.0)))[0] == 'OK'
    behind = replace(HEALTHY, time_offset_s=-3.0)
    assert 'the estimate ends 3.0 s before' in told(health.association(behind))[1]
    assert told(health.association(replace(behind, stale_after_s=3.0)))[0] == 'OK'


def test_a_ground_truth_that_is_a_file_does_not_end_early():
    snapshot = replace(HEALTHY, topics=(ESTIMATE,), file_span_ns=(0, 10**6 * S))
    assert told(health.association(snapshot)) == ('OK', 'running')


NO_PAIRS = replace(RUN, values={})
NOTHING = replace(NO_PAIRS, estimate=SideState(), ground_truth=SideState())


def test_where_both_sides_have_come_the_evaluation_says_why_there_are_no_pairs():
    snapshot = replace(HEALTHY, run=NO_PAIRS)
    status = health.association(snapshot)
    assert told(status) == ('WARN', 'no pairs within 0.02 s')
    assert status.values['pairs'] == 0
    assert math.isnan(status.values['coverage_ratio'])
    all_dropped = replace(NO_PAIRS, estimate=SideState(0, {'non_finite': 3}))
    assert health.why_no_pairs(replace(snapshot, run=all_dropped)) == 'no pairs within 0.02 s'


def test_what_was_given_up_while_it_waited_has_not_come_yet():
    waited = SideState(0, {'overflow': 5, 'late': 0}, overflow=5)
    assert not waited.has_arrived
    assert SideState(0, {'overflow': 5, 'late': 1}, overflow=5).has_arrived
    snapshot = replace(HEALTHY, run=replace(NO_PAIRS, ground_truth=waited))
    assert health.why_no_pairs(snapshot) == 'no pairs yet: no ground truth yet'


def test_problems_of_a_topic_that_has_not_arrived_are_reported():
    silent = replace(TRUTH, received=0, publishers=(), published_types=(), msgtype='')
    snapshot = replace(HEALTHY, run=NOTHING, topics=(ESTIMATE, silent))
    assert health.why_no_pairs(snapshot) == (
        'no pairs yet: no ground truth yet; nobody publishes /truth'
    )


def test_stamps_of_zero_are_reported():
    zero = replace(ESTIMATE, unstamped=True, oldest_ns=AFTER_ALL, newest_ns=BEFORE_ALL)
    snapshot = replace(HEALTHY, run=NOTHING, topics=(zero, TRUTH))
    assert health.why_no_pairs(snapshot) == (
        'no pairs yet: no ground truth yet; /odom stamped 0: is there a /clock?'
    )
    both = replace(snapshot, topics=(zero, replace(TRUTH, unstamped=True)))
    assert '/odom and /truth stamped 0' in health.why_no_pairs(both)


@pytest.mark.parametrize(
    ('begin_s', 'end_s', 'offset_s', 'apart'),
    [
        (121, 140, 0.0, True),
        (60, 99, 0.0, True),
        (119, 140, 0.0, False),
        (60, 101, 0.0, False),
        (121, 140, 2.0, False),
        (119, 140, -2.0, True),
        (121, 121, 0.0, False),  # a single pose is too little to tell
    ],
)
def test_clocks_without_a_time_in_common_are_reported(begin_s, end_s, offset_s, apart):
    truth = replace(TRUTH, oldest_ns=begin_s * S, newest_ns=end_s * S)
    snapshot = replace(HEALTHY, run=NOTHING, topics=(ESTIMATE, truth), time_offset_s=offset_s)
    assert health.why_no_pairs(snapshot).endswith('are the clocks the same?') == apart
    file = replace(snapshot, topics=(ESTIMATE,), file_span_ns=(begin_s * S, end_s * S))
    assert health.why_no_pairs(file).endswith('are the clocks the same?') == apart


def test_a_stream_that_has_not_come_is_not_apart():
    nothing = replace(TRUTH, oldest_ns=AFTER_ALL, newest_ns=BEFORE_ALL)
    snapshot = replace(HEALTHY, run=NOTHING, topics=(ESTIMATE, nothing))
    assert health.why_no_pairs(snapshot) == 'no pairs yet: no ground truth yet'


# streams


def test_the_streams_have_their_counts_by_name():
    topic = replace(ESTIMATE, sent_before=5, lost=1, full=2, undecodable=3, incompatible=4)
    values = health.streams(replace(HEALTHY, topics=(topic,))).values
    assert values == {
        'run': 1,
        'estimate_topic': '/odom',
        'estimate_type': ODOMETRY,
        'estimate_publishers': 1,
        'estimate_received': 200,
        'estimate_sent_before': 5,
        'estimate_lost': 1,
        'estimate_queue_full': 2,
        'estimate_undecodable': 3,
        'estimate_incompatible_qos': 4,
    }


def test_what_was_sent_before_the_node_was_there_is_told_but_is_no_problem():
    late = replace(ESTIMATE, sent_before=12), replace(TRUTH, sent_before=1)
    status = health.streams(replace(HEALTHY, topics=late))
    assert status.level == Level.OK
    assert status.message == (
        f'running; 12 messages of {ESTIMATE.topic} were sent before the evaluator subscribed; '
        f'1 message of {TRUTH.topic} was sent before the evaluator subscribed'
    )


@pytest.mark.parametrize(
    ('changes', 'problem'),
    [
        ({'received': 0}, 'nothing received on /odom'),
        ({'received': 0, 'publishers': (), 'published_types': ()}, 'nobody publishes /odom'),
        ({'publishers': ('/bag', '/vins')}, MIXED),
        (
            {'published_types': (STRING,)},
            f'/odom carries {STRING}, which has no pose that can be scored',
        ),
        (
            {'published_types': (POSE, ODOMETRY), 'msgtype': ''},
            f'/odom is published as {POSE} and {ODOMETRY}; set estimate_type to one of them',
        ),
        (
            {'published_types': (POSE,)},
            f'/odom is published as {POSE}, not {ODOMETRY}; restart the evaluator',
        ),
        (
            {'published_types': (POSE,), 'type_is_given': True},
            f'/odom is published as {POSE}, not {ODOMETRY}; set estimate_type',
        ),
        (
            {'published_types': (ODOMETRY, STRING), 'publishers': ('/a', '/b')},
            f'/odom is published as {ODOMETRY} and {STRING}; only {ODOMETRY} is read',
        ),
        ({'incompatibility': 'reliable only'}, 'incompatible QoS on /odom: reliable only'),
        ({'undecodable': 1}, f'1 message on /odom could not be decoded as {ODOMETRY}'),
        ({'undecodable': 3}, f'3 messages on /odom could not be decoded as {ODOMETRY}'),
        ({'lost': 2}, '2 messages lost on /odom'),
        ({'full': 1}, '/odom: the queue was full 1 time'),
        ({'full': 2, 'lost': 1}, '1 message lost on /odom; /odom: the queue was full 2 times'),
    ],
)
def test_what_is_wrong_with_a_topic_is_a_warning(changes, problem):
    topic = replace(ESTIMATE, **changes)
    assert told(health.streams(replace(HEALTHY, topics=(topic, TRUTH)))) == ('WARN', problem)


def test_streams_that_have_both_ended_are_no_fault():
    topics = tuple(replace(topic, silent_s=7.0) for topic in (ESTIMATE, TRUTH))
    snapshot = replace(HEALTHY, topics=topics)
    ended = told(health.streams(snapshot))
    assert ended[0] == 'OK'
    assert ended[1].startswith('ended: nothing on /odom for 7 s')
    alone = replace(snapshot, topics=topics[:1], stale_after_s=2.0)
    span_ns = (0, topics[0].newest_ns + 1_000_000_000)
    assert told(health.streams(replace(alone, file_span_ns=span_ns)))[0] == 'OK'
    further_ns = (0, topics[0].newest_ns + 9_000_000_000)
    assert told(health.streams(replace(alone, file_span_ns=further_ns)))[0] == 'STALE'


def test_a_stream_that_has_stopped_is_stale():
    old = replace(ESTIMATE, silent_s=2.1)
    snapshot = replace(HEALTHY, topics=(old, TRUTH))
    assert told(health.streams(snapshot)) == ('STALE', 'nothing on /odom for 2 s')
    gone = replace(old, publishers=(), published_types=())
    assert told(health.streams(replace(HEALTHY, topics=(gone, TRUTH)))) == (
        'STALE',
        'nothing on /odom for 2 s, and nobody publishes it',
    )
    never = replace(old, received=0)
    assert told(health.streams(replace(HEALTHY, topics=(never, TRUTH))))[0] == 'WARN'
    assert told(health.streams(replace(snapshot, stale_after_s=3.0)))[0] == 'OK'
    two = replace(HEALTHY, topics=(replace(old, publishers=('/bag', '/vins')), TRUTH))
    assert told(health.streams(two)) == (
        'WARN',
        f'{MIXED}; nothing on /odom for 2 s',
    )


def test_what_the_run_waits_for_is_reported():
    jump = TimeJump(120 * S, 100 * S, 0.0)
    snapshot = replace(HEALTHY, topics=(ESTIMATE, replace(TRUTH, jump=jump)))
    assert told(health.streams(snapshot)) == (
        'WARN',
        '/truth jumped back from 120.0 to 100.0 s: waiting for the other stream to do so',
    )
    assert told(health.streams(replace(HEALTHY, clock_jumped=True))) == (
        'WARN',
        'the clock jumped back: waiting for the streams to do so',
    )


def test_another_node_of_the_same_name_is_reported():
    level, message = told(health.streams(replace(HEALTHY, other_node='/a/vio_evaluator')))
    assert level == 'WARN'
    assert message.startswith('there is another /a/vio_evaluator: ')
    assert message.endswith('name one with -r __node:=NAME')


# diagnosis


def cause(name: str, unit: str = 's', uncertainty: float = 0.001, flags=('--flag', '1')):
    return SimpleNamespace(
        name=name,
        value=0.08,
        unit=unit,
        uncertainty=uncertainty,
        confidence=0.9,
        evidence=f'evidence of {name}',
        advice=f'advice on {name}',
        flags=flags,
    )


def diagnosed(*causes, **changes) -> RunState:
    found = SimpleNamespace(causes=causes, cannot_tell=('scale', 'tilt'))
    return replace(RUN, diagnosis=found, diagnosed_pairs=100, **changes)


def test_a_run_that_is_not_diagnosed_yet_says_so():
    message = 'cannot tell yet: too little time or motion so far'
    status = health.diagnosis(RUN)
    assert told(status) == ('OK', message)
    assert status.values == {}
    unmoved = health.diagnosis(diagnosed(cause('insufficient_motion')))
    assert told(unmoved) == ('OK', message)
    assert unmoved.values == {'diagnosed_pairs': 100, 'cannot_tell': 'scale, tilt'}


def test_a_run_without_a_cause_is_nothing_unusual():
    status = health.diagnosis(diagnosed())
    assert told(status) == ('OK', 'nothing unusual')
    assert status.values == {'diagnosed_pairs': 100, 'cannot_tell': 'scale, tilt'}


def test_a_later_run_says_why_the_one_before_ended():
    run = diagnosed(number=2, began_as='reset was called')
    assert told(health.diagnosis(run)) == ('OK', 'run 2 began as reset was called')


def test_causes_are_reported_the_first_with_its_evidence_and_all_with_their_values():
    first = cause('time_offset')
    second = cause('yaw_drift', 'deg/min', math.nan, ())
    status = health.diagnosis(diagnosed(first, second))
    assert told(status) == ('WARN', 'time_offset: evidence of time_offset; also yaw_drift')
    assert status.values == {
        'cause_1': 'time_offset',
        'time_offset_s': 0.08,
        'time_offset_uncertainty_s': 0.001,
        'time_offset_confidence': 0.9,
        'time_offset_advice': 'advice on time_offset',
        'time_offset_flags': '--flag 1',
        'cause_2': 'yaw_drift',
        'yaw_drift_deg_per_min': 0.08,
        'yaw_drift_confidence': 0.9,
        'yaw_drift_advice': 'advice on yaw_drift',
        'yaw_drift_flags': '',
        'diagnosed_pairs': 100,
        'cannot_tell': 'scale, tilt',
    }
    assert (
        'scale_drift_percent_per_min'
        in health.diagnosis(diagnosed(cause('scale_drift', '%/min'))).values
    )


def test_the_largest_jump_is_reported_at_once_and_not_twice():
    run = replace(RUN, largest_jump=(123_456_000_000, 2.5))
    status = health.diagnosis(run)
    assert told(status) == ('WARN', 'the estimate jumped by 2.5 m at 123.456 s')
    assert status.values == {'jump_stamp_ns': 123_456_000_000, 'jump_m': 2.5}
    both = health.diagnosis(diagnosed(cause('jump', 'm'), largest_jump=run.largest_jump))
    assert both.message == status.message
    assert 'cause_1' not in both.values


def test_a_diagnosis_that_failed_is_a_bug_to_report():
    failed = 'the diagnosis failed: this is a bug, please report it: ZeroDivisionError: oh'
    run = replace(RUN, diagnosis_problem='ZeroDivisionError: oh')
    assert told(health.diagnosis(run)) == ('WARN', failed)
    assert health.conclusions(None, 'ZeroDivisionError: oh') == [failed]


def test_the_conclusions_of_a_run_are_a_line_for_each_cause():
    found = diagnosed(cause('time_offset'), cause('scale')).diagnosis
    assert health.conclusions(found, '') == [
        'time_offset: evidence of time_offset. advice on time_offset',
        'scale: evidence of scale. advice on scale',
    ]
    assert health.conclusions(None, '') == []


def test_trajectories_that_take_turns_are_told_of_their_side():
    turns = 'estimate: poses of two trajectories, 2 m apart, take turns'
    status = health.streams(replace(HEALTHY, run=replace(RUN, turns=(turns,))))
    assert told(status) == ('WARN', turns)


@pytest.mark.parametrize(
    ('topic', 'offered', 'told'),
    [
        ('/ground_truth', ['/ground_truth/pose', '/odom'], "; did you mean '/ground_truth/pose'?"),
        ('/vio/odometrie', ['/vio/odometry', '/truth'], "; did you mean '/vio/odometry'?"),
        ('/estimate', ['/a', '/b'], '; topics with poses are /a, /b'),
        ('/estimate', list('abcdef'), '; topics with poses are a, b, c, d, e ...'),
        ('/estimate', [], ''),
    ],
)
def test_of_a_topic_that_nobody_publishes_it_is_said_which_may_be_meant(topic, offered, told):
    unknown = replace(TRUTH, topic=topic, publishers=(), published_types=(), received=0)
    problem = f'nobody publishes {topic}{told}'
    assert health.topic_problems(unknown, offered) == [problem]
    run = replace(RUN, values={}, ground_truth=SideState())
    snapshot = replace(HEALTHY, run=run, topics=(ESTIMATE, unknown), offered=offered)
    assert problem in health.streams(snapshot).message
    assert problem in health.association(snapshot).message
    heard = replace(unknown, received=1)
    assert health.topic_problems(heard, offered) == []
