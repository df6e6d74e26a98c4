"""When playing may begin: who asked for what, and who is reached."""

import itertools

import pytest

from vio_eval_ros.errors import VioEvalError
from vio_eval_ros.live import audience
from vio_eval_ros.live.audience import Audience, unheard, wait_for


@pytest.fixture
def clock(monkeypatch):
    """Have time pass only where it is waited for; return the time that has passed [s]."""
    now = [100.0]
    monkeypatch.setattr(audience.time, 'monotonic', lambda: now[0])
    monkeypatch.setattr(
        audience.time, 'sleep', lambda seconds: now.__setitem__(0, now[0] + seconds)
    )
    return lambda: now[0] - 100.0


def test_a_topic_that_nobody_asked_for_is_not_waited_for():
    assert unheard([Audience('/tf', 0, 0), Audience('/imu', 1, 1)], ()) == []
    assert unheard([Audience('/tf', 0, 0), Audience('/imu', 2, 1)], ()) == ['/imu']
    assert unheard([Audience('/tf', 0, 0)], ['/tf']) == ['/tf']


def test_playing_begins_when_the_audience_is_complete(clock):
    looks = itertools.chain(
        [[Audience('/imu', 0, 0)]] * 30,
        [[Audience('/imu', 1, 0)]] * 40,
        itertools.repeat([Audience('/imu', 1, 1)]),
    )
    wait_for(lambda: next(looks), (), 10.0, lambda line: None)
    assert clock() == pytest.approx(70 * audience.POLL_S + audience.QUIET_S, abs=0.05)


def test_where_nobody_comes_it_begins_after_a_second(clock):
    wait_for(lambda: [Audience('/imu', 0, 0)], (), 10.0, pytest.fail)
    assert clock() == pytest.approx(audience.DISCOVERY_S, abs=0.05)


def test_those_who_are_missing_are_named_every_few_seconds(clock):
    said = []
    looks = itertools.chain(
        [[Audience('/imu', 0, 0), Audience('/tf', 0, 0)]] * 600,
        itertools.repeat([Audience('/imu', 1, 1), Audience('/tf', 0, 0)]),
    )
    wait_for(lambda: next(looks), ['/imu'], float('inf'), said.append)
    assert said == ['waiting for subscribers of /imu'] * 3
    assert clock() > 12


def test_an_awaited_topic_that_nobody_listens_to_is_an_error_in_the_end(clock):
    with pytest.raises(VioEvalError, match='after 3 s nobody listens to /imu'):
        wait_for(lambda: [Audience('/imu', 0, 0)], ['/imu'], 3.0, lambda line: None)


def test_a_subscription_that_cannot_be_reached_does_not_stop_the_others(clock):
    said = []
    wait_for(lambda: [Audience('/imu', 1, 0)], (), 3.0, said.append)
    assert said[-1] == (
        'a subscription to /imu is not reached; is its quality of service compatible?'
    )


def test_no_time_at_all_is_no_wait(clock):
    wait_for(lambda: [Audience('/imu', 1, 0)], ['/imu'], 0.0, pytest.fail)
    assert clock() == 0
