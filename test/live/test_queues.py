"""Where a stream jumps back in time the next run begins; a late pose is no jump."""

from dataclasses import dataclass, field, replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.live.queues import (
    LAG_S,
    MIN_JUMPED,
    MOST_WAITING,
    PathQueue,
    Progress,
    RunQueue,
    why_the_run_ends,
)

S = 1_000_000_000
NOW_S = 500.0
LOOP = 100 * S + np.arange(0, 20 * S, S // 10)


def poses(stamps_ns) -> Poses:
    stamps_ns = np.asarray(stamps_ns, np.int64)
    return Poses(stamps_ns, np.zeros((len(stamps_ns), 3)))


def runs_of(*batches) -> list[list[int]]:
    """Return the stamps of each run, where they arrive in batches."""
    queue = RunQueue()
    for batch in batches:
        queue.add(poses(batch), NOW_S)
    queue.release()
    runs = [queue.take().stamps_ns.tolist()]
    while queue.jumps:
        queue.next_run()
        runs.append(queue.take().stamps_ns.tolist())
    return runs


@given(st.lists(st.integers(0, 3 * len(LOOP)), max_size=12))
def test_a_loop_is_a_run_however_its_batches_are_cut(cuts):
    batches = np.split(np.tile(LOOP, 3), sorted(cuts))
    assert runs_of(*batches) == [LOOP.tolist()] * 3


@given(st.lists(st.integers(0, len(LOOP) + MIN_JUMPED), max_size=5))
def test_late_poses_stay_in_their_run(cuts):
    late = LOOP[: MIN_JUMPED - 1] + 1
    stamps = np.concatenate([LOOP[:150], late, LOOP[150:]])
    assert runs_of(*np.split(stamps, sorted(cuts))) == [stamps.tolist()]


def test_what_is_late_at_the_end_is_not_lost():
    late = LOOP[: MIN_JUMPED - 1]
    assert runs_of(LOOP, late) == [[*LOOP.tolist(), *late.tolist()]]


def test_a_jump_of_less_than_a_second_is_none():
    stamps = np.concatenate([LOOP, LOOP[-9:] + 1])
    assert runs_of(stamps) == [stamps.tolist()]


def test_stamps_of_zero_are_no_jump():
    stamps = [*LOOP.tolist(), *[0] * 20, *(LOOP + 20 * S).tolist()]
    assert runs_of(stamps) == [stamps]


@given(st.lists(st.integers(0, 2 * len(LOOP)), max_size=6), st.integers(1, MIN_JUMPED - 1))
def test_stamps_far_in_the_future_are_handed_on_at_the_end(cuts, count):
    wild = LOOP[-1] + 10**6 * S + np.arange(count) * S
    beyond = LOOP + 20 * S
    stamps = np.concatenate([LOOP, wild, beyond])
    assert runs_of(*np.split(stamps, sorted(cuts))) == [[*LOOP, *beyond, *wild]]


@given(st.lists(st.integers(0, 2 * len(LOOP)), max_size=6))
def test_a_long_gap_is_no_reason_to_withhold_anything(cuts):
    stamps = np.concatenate([LOOP, LOOP + 1000 * S])
    assert runs_of(*np.split(stamps, sorted(cuts))) == [stamps.tolist()]
    queue = RunQueue()
    for batch in np.split(stamps, sorted(cuts)):
        queue.add(poses(batch), NOW_S)
    assert queue.take().stamps_ns.tolist() == stamps.tolist()


def test_a_stamp_far_in_the_future_stays_in_its_run():
    wild = LOOP[-1] + 10**6 * S
    assert runs_of(LOOP, [wild], LOOP) == [[*LOOP, wild], LOOP.tolist()]


def test_a_jump_states_from_where_and_to_where():
    queue = RunQueue()
    queue.add(poses(np.tile(LOOP, 2)), NOW_S)
    (jump,) = queue.jumps
    assert str(jump) == 'jumped back from 119.9 to 100.0 s'
    assert (queue.oldest_ns, queue.newest_ns) == (LOOP[0], LOOP[-1])


def test_a_run_may_end_though_the_stream_goes_on():
    queue = RunQueue()
    queue.add(poses(LOOP), NOW_S)
    assert len(queue.take()) == len(LOOP)
    queue.next_run()
    queue.add(poses(LOOP[50:]), NOW_S)  # earlier, but that is not held against the new run
    assert not queue.jumps
    assert len(queue.take()) == len(LOOP) - 50


def test_two_clocks_on_one_topic_do_not_split_for_ever():
    queue = RunQueue()
    for k in range(50):
        queue.add(poses(LOOP[:10] + k * S), NOW_S)
        queue.add(poses(LOOP[:10] - 3600 * S + k * S), NOW_S)
    assert len(queue.jumps) == MOST_WAITING
    taken = 0
    while True:
        taken += len(queue.take())
        if not queue.jumps:
            break
        queue.next_run()
    assert taken == 1000


@dataclass
class Received:
    """A stream as it arrives."""

    topic: str
    received_s: float = NOW_S
    queue: RunQueue = field(default_factory=RunQueue)

    def receive(self, stamps_ns, now_s: float) -> None:
        self.received_s = now_s
        self.queue.add(poses(stamps_ns), now_s)


def why(streams: list[Received], now_s: float, at_once: bool = False) -> str:
    """Return why the run of these streams ends."""
    progress = [Progress(s.topic, s.received_s, next(iter(s.queue.jumps), None)) for s in streams]
    return why_the_run_ends(progress, now_s, at_once)


def two_loops(which: Received, *others: Received) -> None:
    for stream in (which, *others):
        stream.receive(LOOP, NOW_S)
    which.receive(LOOP, NOW_S)


def test_a_run_ends_when_both_streams_have_jumped():
    estimate, truth = Received('/estimate'), Received('/truth')
    assert why([estimate, truth], NOW_S, at_once=True) == ''
    two_loops(estimate, truth)
    assert why([estimate, truth], NOW_S) == ''
    truth.receive(LOOP, NOW_S + 1)
    assert why([estimate, truth], NOW_S + 1) == '/estimate jumped back from 119.9 to 100.0 s'
    assert why([truth, estimate], NOW_S + 1).startswith('/estimate')


def test_a_stream_that_lags_is_waited_for_but_not_for_ever():
    estimate, truth = Received('/estimate'), Received('/truth')
    two_loops(estimate, truth)
    for now_s in np.arange(NOW_S, NOW_S + LAG_S, 0.5):
        truth.receive([LOOP[-1]], now_s)
        assert why([estimate, truth], now_s) == ''
    assert why([estimate, truth], NOW_S + LAG_S) != ''


def test_a_stream_that_is_silent_is_not_waited_for():
    estimate, truth = Received('/estimate'), Received('/truth', received_s=NOW_S - LAG_S)
    two_loops(estimate)
    assert why([estimate, truth], NOW_S) != ''


def test_at_the_end_nothing_is_waited_for():
    estimate, truth = Received('/estimate'), Received('/truth')
    two_loops(estimate, truth)
    assert why([estimate, truth], NOW_S, at_once=True) != ''


def path(begin_s: float, end_s: float) -> Poses:
    stamps_ns = (np.arange(begin_s, end_s, 0.05) * 1e9).astype(np.int64)
    return Poses(stamps_ns, np.zeros((len(stamps_ns), 3)), np.eye(4)[np.full(len(stamps_ns), 3)])


def paths_of(*messages: Poses) -> PathQueue:
    queue = PathQueue('/path')
    for message in messages:
        queue.add(message, NOW_S)
    queue.release()
    return queue


def all_of(queue: PathQueue) -> list[list[int]]:
    """Return the stamps of each run, as first published."""
    runs = [queue.take().stamps_ns.tolist()]
    while queue.jumps:
        queue.next_run()
        runs.append(queue.take().stamps_ns.tolist())
    return runs


GROWING = [path(100, 100 + end) for end in range(1, 21)]
THINNED = [GROWING[-1][::3], path(100, 121)[::2], path(100, 122)[::2], path(100, 123)]


@pytest.mark.parametrize(
    ('messages', 'runs'),
    [
        (GROWING, 1),
        ([*GROWING, path(100, 103), path(100, 120.5)], 1),  # one late message
        ([*GROWING, path(100, 118), path(100, 118.2), path(100, 121)], 1),  # pruned
        (THINNED, 1),  # poses from long ago that were left out at first
        ([*GROWING, *GROWING], 2),  # a loop
        ([*GROWING, *GROWING, *GROWING], 3),
        ([m for k in range(20) for m in (GROWING[k], path(10, 11 + k))], 1),  # two clocks
    ],
)
def test_the_paths_and_the_poses_of_a_stream_are_of_the_same_runs(messages, runs):
    queue = paths_of(*messages)
    assert len(queue.jumps) == runs - 1
    for run in range(runs):
        taken = queue.take()
        assert set(taken.stamps_ns) == set(queue.revisions.final().stamps_ns)
        assert len(taken)
        if run < runs - 1:
            queue.next_run()


def test_a_late_path_revises_and_is_not_lost():
    late = path(100, 103)
    late = replace(late, positions=np.ones((len(late), 3)))
    final = paths_of(*GROWING, late, path(119, 120.5)).revisions.final()
    assert (final.positions[: len(late), 0] == 1).all()


def test_what_a_path_repeats_of_a_run_that_was_ended_is_not_in_the_next():
    queue = paths_of(*GROWING[:10])
    queue.take()
    queue.next_run()
    for message in GROWING[10:]:
        queue.add(message, NOW_S)
    assert queue.take().stamps_ns.tolist() == GROWING[-1].stamps_ns[200:].tolist()
    assert queue.revisions.final().stamps_ns[0] == GROWING[-1].stamps_ns[200]
    # until the recording begins again
    for message in GROWING:
        queue.add(message, NOW_S)
    assert [run[-1:] for run in all_of(queue)] == [[], GROWING[-1].stamps_ns[-1:].tolist()]
    assert queue.revisions.final().stamps_ns[0] == GROWING[0].stamps_ns[0]
