"""Who listens to what is played: when everybody is there, and playing can begin."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
import time
from typing import NamedTuple

from vio_eval_ros.errors import VioEvalError

#: how long others have at least to find out about the player, and it about them
DISCOVERY_S = 1.0
#: the audience is complete when it has not changed for so long
QUIET_S = 0.5
#: how often those who are missing are named
TELL_S = 5.0
POLL_S = 0.02


class Audience(NamedTuple):
    """
    Who listens to a topic.

    :param asked: how many subscriptions there are.
    :param matched: how many of these the publisher reaches.
    """

    topic: str
    asked: int
    matched: int


def unheard(audiences: Iterable[Audience], awaited: Collection[str]) -> list[str]:
    """
    Return the topics of which a subscription is not reached yet.

    :param awaited: those that must have a subscription.
    """
    return [
        one.topic
        for one in audiences
        if one.matched < one.asked or (one.topic in awaited and not one.matched)
    ]


def wait_for(
    look: Callable[[], Sequence[Audience]],
    awaited: Collection[str],
    timeout_s: float,
    say: Callable[[str], object],
) -> None:
    """
    Return when every topic that anybody asks for is heard, and each that is awaited.

    :param look: returns who listens by now.
    :param awaited: topics that must be heard.
    :param timeout_s: how long to wait at most.
    :param say: takes a line with those that are missing, every few seconds.
    :raises VioEvalError: where an awaited topic is not heard in time. Playing begins without a
        subscription that is not reached though nobody insists on it: its quality of service may
        be of another kind.
    """
    began_s = changed_s = time.monotonic()
    told_s = began_s - TELL_S + DISCOVERY_S  # not at once: most are there soon
    before: Sequence[Audience] = ()
    while timeout_s > 0:
        audiences, now_s = look(), time.monotonic()
        if audiences != before:
            before, changed_s = audiences, now_s
        missing = unheard(audiences, awaited)
        is_settled = now_s - began_s >= min(DISCOVERY_S, timeout_s)
        is_settled &= now_s - changed_s >= min(QUIET_S, timeout_s)
        if is_settled and not missing:
            return
        if now_s - began_s >= timeout_s and missing:
            names = ', '.join(missing)
            if any(topic in awaited for topic in missing):
                raise VioEvalError(f'after {timeout_s:g} s nobody listens to {names}')
            say(f'a subscription to {names} is not reached; is its quality of service compatible?')
            return
        if missing and now_s - told_s >= TELL_S:
            say(f'waiting for subscribers of {", ".join(missing)}')
            told_s = now_s
        time.sleep(POLL_S)
