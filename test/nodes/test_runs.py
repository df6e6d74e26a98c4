"""Where a stream jumps back in time the next run begins; a late pose is no jump."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.nodes.runs import MIN_JUMPED, MOST_WAITING, RunQueue

S = 1_000_000_000
LOOP = 100 * S + np.arange(0, 20 * S, S // 10)


def poses(stamps_ns) -> Poses:
    stamps_ns = np.asarray(stamps_ns, np.int64)
    return Poses(stamps_ns, np.zeros((len(stamps_ns), 3)))


def runs_of(*batches) -> list[list[int]]:
    """Return the stamps of each run, where they arrive in batches."""
    queue = RunQueue()
    for batch in batches:
        queue.add(poses(batch))
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


def test_a_stamp_far_in_the_future_costs_a_run_and_no_more():
    wild = LOOP[-1] + 10**6 * S
    assert runs_of(LOOP, [wild], LOOP + 20 * S) == [
        [*LOOP.tolist(), wild],
        (LOOP + 20 * S).tolist(),
    ]


def test_a_jump_tells_from_where_and_to_where():
    queue = RunQueue()
    queue.add(poses(np.tile(LOOP, 2)))
    (jump,) = queue.jumps
    assert str(jump) == 'jumped back from 119.9 to 100.0 s'
    assert (queue.oldest_ns, queue.newest_ns) == (LOOP[0], LOOP[-1])


def test_a_run_may_end_though_the_stream_goes_on():
    queue = RunQueue()
    queue.add(poses(LOOP))
    assert len(queue.take()) == len(LOOP)
    queue.next_run()
    queue.add(poses(LOOP[50:]))  # earlier, but that is not held against the new run
    assert not queue.jumps
    assert len(queue.take()) == len(LOOP) - 50


def test_two_clocks_on_one_topic_do_not_split_for_ever():
    queue = RunQueue()
    for k in range(50):
        queue.add(poses(LOOP[:10] + k * S))
        queue.add(poses(LOOP[:10] - 3600 * S + k * S))
    assert len(queue.jumps) == MOST_WAITING
    taken = 0
    while True:
        taken += len(queue.take())
        if not queue.jumps:
            break
        queue.next_run()
    assert taken == 1000
