"""What the other streams of a recording make of a finding in one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vio_eval_ros.inspection.finding import Finding, FindingKind
from vio_eval_ros.inspection.measured_stream import MeasuredStream


def replay_of_all(
    clock_drift: FindingKind,
    finding: Finding,
    findings: Sequence[Finding],
    streams: Sequence[MeasuredStream],
) -> Finding:
    """Return a replay as a bad clock, where not all streams are part of it."""
    replayed = {one.topic for one in findings if one.name == finding.name}
    if all(one.stream.topic in replayed for one in streams if _has_drift(one)):
        return finding
    message = f'{finding.message}, but other streams do not'
    return replace(finding, kind=clock_drift, level=clock_drift.level, message=message)


def _has_drift(one: MeasuredStream) -> bool:
    return one.clocks is not None and abs(one.clocks.drift_ppm) >= 0


def held_up_alone(
    finding: Finding, findings: Sequence[Finding], streams: Sequence[MeasuredStream]
) -> Finding:
    """Return messages that were held up with all others as what the recorder did, not they."""
    others = [one.stream.arrivals_ns for one in streams if one.stream.topic != finding.topic]
    arrivals_ns = np.sort(np.concatenate([np.empty(0, np.int64), *others]))
    for moment in finding.moments:
        begin_ns, end_ns = moment.logged_begin_ns, moment.logged_end_ns
        # others stop a little later, and go on a little earlier
        margin_ns = (end_ns - begin_ns) // 4
        ends = np.searchsorted(arrivals_ns, [begin_ns + margin_ns, end_ns - margin_ns])
        if ends[1] > ends[0]:
            return finding
    message = f'{finding.message}; nothing else was recorded meanwhile'
    return replace(finding, level='info', message=message)


def clock_of_one(
    finding: Finding, findings: Sequence[Finding], streams: Sequence[MeasuredStream]
) -> Finding:
    """Return a step that no other stream, recorded meanwhile, has as one of the sensor's clock."""
    if finding.level != 'info':
        return finding
    stream = next(one.stream for one in streams if one.stream.topic == finding.topic)
    step = finding.moments[0]
    steady = [
        one
        for one in streams
        if one.clocks is not None
        and one.clocks.is_steady
        and one.stream.arrivals_ns.min() < step.logged_begin_ns
        and one.stream.arrivals_ns.max() > step.logged_end_ns
    ]
    is_alone = not any(
        one.name == finding.name
        and one.topic != finding.topic
        and abs(one.value - finding.value) < abs(finding.value) / 2
        for one in findings
    )
    if not (stream.is_sensor and steady and is_alone):
        return finding
    message = (
        f'a clock steps by {1e3 * abs(finding.value):.3g} ms, and that of no other stream: '
        'that of the stamps, or what delays this one alone'
    )
    return replace(finding, level='warn', message=message)
