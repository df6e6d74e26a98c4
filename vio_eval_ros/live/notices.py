"""Which sentences of the statuses are worth a line of the log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import re
import time

from vio_eval_ros.live.health import Level, Status, telling

#: what passes sooner is not worth a line: much is missing while a system starts
STANDS_S = 3.0
#: what changes from second to second, other than in names
VARIABLE = re.compile(r'(?<![\w/])\d[\d.,]*')


class Notices:
    """
    Tells each sentence once, when it has been so for a while.

    :param clock: seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._told: set[str] = set()
        self._since_s: dict[str, float] = {}

    def new(self, sentences: Iterable[str]) -> list[str]:
        """Return which of the sentences that are so now are to be told now."""
        now_s, found = self._clock(), {VARIABLE.sub('#', one): one for one in sentences}
        self._since_s = {kind: self._since_s.get(kind, now_s) for kind in found}
        new = [
            kind
            for kind, since_s in self._since_s.items()
            if kind not in self._told and now_s - since_s >= STANDS_S
        ]
        self._told.update(new)
        return [found[kind] for kind in new]


def warnings(statuses: Sequence[Status]) -> list[str]:
    """Return what is wrong; that a stream has ended is not."""
    return [
        f'{status.name}: {status.message}'
        for status in telling(statuses)
        if status.level != Level.STALE
    ]
