"""Which sentences come into the log: each once, and only what stands."""

from vio_eval_ros.live.health import Level, Status
from vio_eval_ros.live.notices import Notices, STANDS_S, warnings


class Clock:
    """Seconds that pass as a test says."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_a_sentence_is_told_once_when_it_has_stood():
    clock = Clock()
    notices = Notices(clock)
    assert notices.new(['nobody publishes /a']) == []
    clock.now_s += STANDS_S
    assert notices.new(['nobody publishes /a', 'nobody publishes /b']) == ['nobody publishes /a']
    clock.now_s += STANDS_S
    assert notices.new(['nobody publishes /a', 'nobody publishes /b']) == ['nobody publishes /b']
    assert notices.new([]) == []
    clock.now_s += STANDS_S
    assert notices.new(['nobody publishes /a']) == []


def test_what_passes_is_not_told():
    clock = Clock()
    notices = Notices(clock)
    for _ in range(3):
        assert notices.new(['no pairs yet']) == []
        clock.now_s += STANDS_S - 0.1
        assert notices.new([]) == []


def test_other_numbers_make_no_other_sentence_but_other_names_do():
    clock = Clock()
    notices = Notices(clock)
    for seconds in range(10):
        clock.now_s += 1
        told = notices.new([f'nothing on /robot1/odom for {seconds} s, 1.{seconds} m'])
        assert told == (['nothing on /robot1/odom for 3 s, 1.3 m'] if seconds == 3 else [])
    for seconds in range(5):
        clock.now_s += 1
        told = notices.new([f'nothing on /robot2/odom for {seconds} s, 1.{seconds} m'])
        assert bool(told) == (seconds == 3)


def test_a_warning_that_another_contains_is_left_out():
    statuses = [
        Status('accuracy', Level.WARN, 'no pairs yet', {}),
        Status('association', Level.WARN, 'no pairs yet: no estimate yet', {}),
        Status('streams', Level.STALE, 'nothing on /odom for 3 s', {}),
        Status('timing', Level.OK, 'latency unknown', {}),
        Status('diagnosis', Level.ERROR, 'it diverges', {}),
    ]
    assert warnings(statuses) == [
        'association: no pairs yet: no estimate yet',
        'diagnosis: it diverges',
    ]
