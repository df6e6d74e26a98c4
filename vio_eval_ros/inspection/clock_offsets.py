"""Which streams are stamped by another clock than the others, as the recorder's clock shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.measured_stream import MeasuredStream

#: poses may be published this late without another clock: estimators take their time
LATE_POSES_S = 5.0
#: fewer messages may be latched ones, which are recorded when the recorder begins
MIN_MESSAGES = 5
#: known differences of clocks, and how near an offset is to one
LEAP_SECONDS_S = {37: 'TAI is ahead of UTC by that', 18: 'GPS time is ahead of UTC by that'}
HOUR_S, MAX_HOURS = 3600, 14
NEAR_S = 0.5


def known_offset(offset_s: float) -> str:
    """Return why two clocks are apart by so much, after a comma; nothing where that is open."""
    apart_s = abs(offset_s)
    for seconds, why in LEAP_SECONDS_S.items():
        if abs(apart_s - seconds) < NEAR_S:
            return f', {why}'
    hours = round(apart_s / HOUR_S)
    if 1 <= hours <= MAX_HOURS and abs(apart_s - hours * HOUR_S) < NEAR_S:
        return ', as another time zone is'
    return ''


def sensors_apart(
    sensors: Sequence[MeasuredStream], limits: InspectionLimits
) -> Iterator[Finding]:
    """Yield the sensors whose clock is off that of most of them."""
    offsets = _offsets(sensors)
    if len(sensors) >= 2 and offsets:
        # of two that differ, the first is the usual one
        usual = _usual(offsets, offsets, limits.clock_offset_s)
        yield from _apart(offsets, offsets, usual, limits.clock_offset_s)


def poses_apart(streams: Sequence[MeasuredStream]) -> Iterator[Finding]:
    """Yield poses and transforms whose clock is off that of the sensors, or of most of them."""
    sensors = _offsets(one for one in streams if one.stream.is_sensor)
    posed = _offsets(
        one
        for one in streams
        if one.stream.has_poses and one.is_timed and len(one.stream) >= MIN_MESSAGES
    )
    offsets = sensors | posed
    if posed and len(offsets) >= 2:
        # of two that differ, the one that is nearer to the clock of the recorder
        nearest = sorted(sensors or posed, key=lambda topic: abs(offsets[topic]))
        usual = _usual(nearest, offsets, LATE_POSES_S)
        yield from _apart(posed, offsets, usual, LATE_POSES_S)


def _offsets(streams: Iterable[MeasuredStream]) -> dict[str, float]:
    return {one.stream.topic: one.clocks.offset_s for one in streams if one.clocks is not None}


def _usual(topics: Iterable[str], offsets: Mapping[str, float], near_s: float) -> str:
    """Return the first of the topics with whose offset most others agree."""
    return max(
        topics,
        key=lambda topic: sum(abs(one - offsets[topic]) <= near_s for one in offsets.values()),
    )


def _apart(
    topics: Iterable[str], offsets: Mapping[str, float], usual: str, near_s: float
) -> Iterator[Finding]:
    """Yield those topics whose offset differs from the usual one."""
    for topic in topics:
        later_s = offsets[topic] - offsets[usual]
        if abs(later_s) > near_s:
            yield FINDINGS['clock_offset'].found(
                topic,
                'sensors',
                apart=abs(later_s),
                side='earlier' if later_s > 0 else 'later',
                usual=usual,
                why=known_offset(later_s),
                value=later_s,
            )
