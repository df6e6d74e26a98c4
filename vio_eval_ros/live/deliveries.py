"""Which messages of a stream did not arrive, by the numbers that its publisher gives them."""

from __future__ import annotations

import numpy as np

#: stands for a number after which any number may follow
ANY = -1


class Deliveries:
    """
    Counts what a publisher sent and what did not arrive: it numbers its messages from 1.

    Numbers of several publishers cannot be told apart: while there are such, nothing is counted.

    ``sent_before`` are the messages before the first that arrived of a publisher, ``lost`` those
    between two that did.
    """

    def __init__(self) -> None:
        self.sent_before = 0
        self.lost = 0
        #: the number of the last message; None before the first
        self.last: int | None = None

    def note(self, numbers: np.ndarray, are_mixed: bool, overwritten: bool) -> np.ndarray:
        """
        Take the numbers of messages in the order in which they arrived.

        :param numbers: (N,) int64, at least one.
        :param are_mixed: whether several publishers gave them.
        :param overwritten: whether the first of those that arrived may be there no more.
        :return: (K,) the indices of messages right before which others were lost.
        """
        if are_mixed:
            self.last = ANY
            return np.empty(0, np.int64)
        last = numbers[0] - 1 if self.last == ANY else self.last
        first = 0 if last is None and overwritten else numbers[0] if last is None else last
        before = np.concatenate([[first], numbers[:-1]])
        begins = numbers <= before  # the first of a publisher
        self.sent_before += int(numbers[begins].sum() - np.count_nonzero(begins))
        missing = np.where(begins, 0, numbers - before - 1)
        self.lost += int(missing.sum())
        self.last = int(numbers[-1])
        return np.flatnonzero(missing)
