"""What did not arrive, from the numbers of what did."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.live.deliveries import Deliveries


def noted(*batches: list[int], mixed: bool = False, full: bool = False) -> Deliveries:
    found = Deliveries()
    for batch in batches:
        found.note(np.array(batch), are_mixed=mixed, overwritten=full)
    return found


@pytest.mark.parametrize(
    ('batches', 'sent_before', 'lost'),
    [
        (([1, 2, 3], [4, 5]), 0, 0),
        (([13, 14], [15]), 12, 0),
        (([1, 2, 5], [6, 9]), 0, 4),
        (([4, 6], [3, 4], [5, 7]), 3 + 2, 1 + 1),  # the publisher began again
        (([1, 2], [2, 3]), 1, 0),  # likewise
    ],
)
def test_what_was_sent_before_and_what_was_lost_are_counted(batches, sent_before, lost):
    found = noted(*batches)
    assert (found.sent_before, found.lost) == (sent_before, lost)


def test_what_was_overwritten_in_the_queue_was_not_sent_before():
    found = noted([351, 352], full=True)
    assert (found.sent_before, found.lost) == (0, 350)


def test_numbers_of_several_publishers_say_nothing():
    found = noted([7, 1, 8, 2], [9, 3], mixed=True)
    found.note(np.array([11, 12, 14]), are_mixed=False, overwritten=False)
    assert (found.sent_before, found.lost) == (0, 1)


def test_it_is_told_before_which_messages_others_were_lost():
    found = Deliveries()
    assert found.note(np.array([3, 4, 6, 7, 9]), False, False).tolist() == [2, 4]
    assert found.note(np.array([11, 12]), False, False).tolist() == [0]


@given(
    arrived=st.sets(st.integers(1, 60), min_size=1).map(sorted),
    cuts=st.lists(st.integers(1, 59), max_size=4).map(sorted),
)
def test_all_that_was_sent_is_accounted_for_however_it_came(arrived, cuts):
    found = Deliveries()
    for batch in np.split(np.array(arrived), [cut for cut in cuts if cut < len(arrived)]):
        if len(batch):
            found.note(batch, are_mixed=False, overwritten=False)
    assert found.sent_before + found.lost + len(arrived) == arrived[-1]
