"""Everything that is measured and found in the sensor streams of a recording, on one screen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.inspection.cameras import Pair, pairs
from vio_eval_ros.inspection.clocks import Clocks, clocks, REPLAYED_PPM
from vio_eval_ros.inspection.findings import Finding, worst_first
from vio_eval_ros.inspection.glitches import measures
from vio_eval_ros.inspection.inertial import Inertial, inertial
from vio_eval_ros.inspection.motion import Motion, motion
from vio_eval_ros.inspection.stamps import corrected
from vio_eval_ros.inspection.timing import Timing, timing

# A stream begins late or ends early where it does so by this, and by five of its periods
LATE_S, LATE_PERIODS = 0.5, 5.0
# Sensors that are recorded together are stamped this much before, more or less alike
SAME_CLOCK_S = 0.5
# An IMU should have so many samples between two images
SAMPLES_A_FRAME = 5.0


@dataclass(frozen=True, eq=False)
class Examined:
    """A stream with its figures; those that its type does not have are None."""

    stream: SensorStream
    timing: Timing
    clocks: Clocks | None = None
    inertial: Inertial | None = None
    motion: Motion | None = None

    @property
    def is_timed(self) -> bool:
        """Whether it has stamps, and enough of them for a period."""
        return self.stream.stamps_ns is not None and math.isfinite(self.timing.period_s)


@dataclass(frozen=True, eq=False)
class Inspection:
    """
    What was measured in a recording, and what is wrong with it.

    :param streams: those with messages, by topic; ``silent`` are those without.
    :param findings: worst first.
    :param common_ns: the first and the last stamp of the time that all sensors have in common;
        None where there is none.
    :param imu_to_camera: the least ratio of their rates; NaN where one is missing.
    """

    streams: list[Examined]
    silent: list[SensorStream]
    pairs: list[Pair]
    findings: list[Finding]
    common_ns: tuple[int, int] | None
    imu_to_camera: float

    @property
    def begin_ns(self) -> int:
        """When the first message was recorded."""
        return min(int(one.stream.arrivals_ns.min()) for one in self.streams)


def inspect(streams: Sequence[SensorStream], left_out: Sequence[str] = ()) -> Inspection:
    """
    Return what can be said of the streams of a recording.

    :param left_out: a sentence for whatever could not be read.
    """
    findings = [Finding('left_out', '', 'info', sentence) for sentence in left_out]
    examined = []
    silent = sorted((one for one in streams if not len(one)), key=lambda one: one.topic)
    findings += map(_silent, silent)
    for stream in sorted(_parts(one for one in streams if len(one)), key=lambda one: one.topic):
        one, found = _examine(stream)
        examined.append(one)
        findings += found
    together, found = pairs([e.stream for e in examined], [e.timing for e in examined])
    sensors = [e for e in examined if e.stream.is_sensor and e.is_timed]
    common = _common(sensors)
    ratio, slow = _rates(sensors)
    findings = [_together(_alone(finding, examined), examined) for finding in findings]
    findings = [_whose(finding, findings, examined) for finding in findings]
    findings += [*found, *_spans(examined), *_clocks_differ(sensors, common is not None), *slow]
    return Inspection(examined, silent, together, worst_first(findings), common, ratio)


def _silent(stream: SensorStream) -> Finding:
    level = 'fail' if stream.is_sensor else 'warn' if stream.kind == 'pose' else 'info'
    return Finding('silent', stream.topic, level, 'the topic was recorded, but has no messages', 0)


def _parts(streams: Iterable[SensorStream]) -> list[SensorStream]:
    """Return the streams; where IMUs have a topic for each of their sensors, these lack others."""
    known = list(streams)
    zero = {
        stream.topic: tuple(name for name, has in measures(stream).items() if not has)
        for stream in known
        if stream.kind == 'imu'
    }
    if not {('gyroscope',), ('accelerometer',)} <= set(zero.values()):
        return known
    return [replace(one, lacks=zero.get(one.topic, ())) for one in known]


def _examine(stream: SensorStream) -> tuple[Examined, list[Finding]]:
    """Return the figures of a stream, and what is wrong with it alone."""
    findings = list(_headers(stream))
    stream, found = corrected(stream.stamped())
    findings += found
    compared, drifting = clocks(stream)
    steps = [f.moments[0] for f in drifting if f.name == 'clock_step' and f.level == 'warn']
    figures, found = timing(stream, *steps)
    findings += found + drifting
    felt, moved = None, None
    if stream.stamps_ns is not None and stream.kind == 'imu':
        felt, found = inertial(stream, figures)
        findings += found
    elif stream.stamps_ns is not None and stream.kind == 'pose':
        moved, found = motion(stream, figures)
        findings += found
    if stream.kind == 'other':  # no estimator takes it
        findings = [replace(one, level='info') for one in findings]
    return Examined(stream, figures, compared, felt, moved), findings


def _alone(finding: Finding, examined: Sequence[Examined]) -> Finding:
    """Return a replay that not all streams are part of as what it is: a bad clock."""
    drifts = [e.clocks.drift_ppm for e in examined if e.clocks is not None]
    if finding.name != 'replayed' or all(not abs(drift) < REPLAYED_PPM for drift in drifts):
        return finding
    return replace(
        finding,
        name='clock_drift',
        level='warn',
        message=f'{finding.message}, but other streams do not',
    )


def _together(finding: Finding, examined: Sequence[Examined]) -> Finding:
    """Return what was held up with all else as what it is: the recorder's, not the sensor's."""
    if finding.name != 'late_arrival':
        return finding
    others = [e.stream.arrivals_ns for e in examined if e.stream.topic != finding.topic]
    arrivals_ns = np.sort(np.concatenate([np.empty(0, np.int64), *others]))
    for moment in finding.moments:
        begin_ns, end_ns = moment.logged_begin_ns, moment.logged_end_ns
        # others stop a little later, and go on a little earlier
        margin_ns = (end_ns - begin_ns) // 4
        ends = np.searchsorted(arrivals_ns, [begin_ns + margin_ns, end_ns - margin_ns])
        if ends[1] > ends[0]:
            return finding
    return replace(
        finding, level='info', message=f'{finding.message}; nothing else was recorded meanwhile'
    )


def _whose(finding: Finding, findings: Sequence[Finding], examined: Sequence[Examined]) -> Finding:
    """Return a step of a clock that others, recorded meanwhile, do not have as the sensor's."""
    if finding.name != 'clock_step' or finding.level != 'info':
        return finding
    stream = next(e.stream for e in examined if e.stream.topic == finding.topic)
    step = finding.moments[0]
    steady = [
        e
        for e in examined
        if e.clocks is not None
        and e.clocks.is_steady
        and e.stream.arrivals_ns.min() < step.logged_begin_ns
        and e.stream.arrivals_ns.max() > step.logged_end_ns
    ]
    is_alone = not any(
        one.name == finding.name
        and one.topic != finding.topic
        and abs(one.value - finding.value) < abs(finding.value) / 2
        for one in findings
    )
    if not (stream.is_sensor and steady and is_alone):
        return finding
    return replace(
        finding,
        level='warn',
        message=f'a clock steps by {1e3 * abs(finding.value):.3g} ms, and that of no other '
        'stream: that of the stamps, or what delays this one alone',
    )


def _common(sensors: Sequence[Examined]) -> tuple[int, int] | None:
    """Return the first and the last stamp of the time that all sensors have, if there is any."""
    if not sensors:
        return None
    first_ns = max(e.timing.first_ns for e in sensors)
    last_ns = min(e.timing.last_ns for e in sensors)
    return (first_ns, last_ns) if first_ns <= last_ns else None


def _headers(stream: SensorStream) -> Iterator[Finding]:
    """Yield what is wrong with the headers of a stream, but for the times in them."""
    level = 'info' if stream.kind == 'other' else 'warn'
    if len(stream.frames) > 1:
        names = ', '.join(f"'{name}' ({count})" for name, count in sorted(stream.frames.items()))
        yield Finding(
            'frame_ids', stream.topic, level, f'messages name different frames: {names}',
            len(stream.frames),
        )  # fmt: skip
    if stream.stamps_ns is not None and not stream.is_stamped.all():
        which = np.flatnonzero(~stream.is_stamped)
        is_lost = stream.is_sensor and len(which) == len(stream)
        yield Finding(
            'unstamped', stream.topic, 'fail' if is_lost else level,
            f'{len(which)} of {len(stream)} messages have no stamp, or zero',
            len(which), moments=stream.moments(which, which),
        )  # fmt: skip


def _spans(examined: Sequence[Examined]) -> Iterator[Finding]:
    """Yield the streams that begin later, or end earlier, than the first and the last sensor."""
    known = [e for e in examined if e.stream.stamps_ns is not None]
    sensors = [e for e in known if e.stream.is_sensor] or known
    if len(sensors) < 2:
        return
    what = 'sensor' if sensors[0].stream.is_sensor else 'stream'
    begin = min(int(e.stream.arrivals_ns.min()) for e in sensors)
    end = max(int(e.stream.arrivals_ns.max()) for e in sensors)
    for e in known:
        if e.stream.kind == 'other' and not e.is_timed:
            continue  # one that is latched
        arrivals = e.stream.arrivals_ns
        first_ns, last_ns = int(arrivals.min()), int(arrivals.max())
        limit = LATE_S
        if math.isfinite(e.timing.period_s):
            limit = max(limit, LATE_PERIODS * e.timing.period_s)
        level = 'warn' if e.stream.is_sensor else 'info'
        index = {'late_start': arrivals.argmin(), 'early_end': arrivals.argmax()}
        for name, seconds, words in (
            ('late_start', (first_ns - begin) / 1e9, 'begins {:.3g} s after the first {}'),
            ('early_end', (end - last_ns) / 1e9, 'ends {:.3g} s before the last {}'),
        ):
            if seconds > limit:
                yield Finding(
                    name, e.stream.topic, level, words.format(seconds, what),
                    value=seconds, unit='s',
                    moments=(e.stream.moment(int(index[name]), int(index[name])),),
                )  # fmt: skip


def _clocks_differ(sensors: Sequence[Examined], has_common: bool) -> Iterator[Finding]:
    """Yield what says that sensors are not on one clock."""
    if len(sensors) < 2:
        return
    if not has_common:
        spans = ', '.join(
            f'{e.stream.topic} {e.timing.first_ns / 1e9:.2f} to {e.timing.last_ns / 1e9:.2f} s'
            for e in sensors
        )
        yield Finding(
            'no_common_span', sensors[0].stream.topic, 'fail',
            f'the stamps of the sensors have no time in common: {spans}',
        )  # fmt: skip
        return
    offsets = {e.stream.topic: e.clocks.offset_s for e in sensors if e.clocks is not None}
    if not offsets:
        return
    # what most of them agree with; of two that differ, the first
    usual = max(offsets, key=lambda topic: _agreeing(offsets[topic], offsets))
    for topic, offset in offsets.items():
        later = offset - offsets[usual]
        if abs(later) > SAME_CLOCK_S:
            yield Finding(
                'clock_offset', topic, 'warn',
                f'stamped {abs(later):.4g} s {"earlier" if later > 0 else "later"} than {usual}, '
                'by the clock of the recorder',
                value=later, unit='s',
            )  # fmt: skip


def _agreeing(offset: float, offsets: Mapping[str, float]) -> int:
    """Return how many offsets are about the same."""
    return sum(abs(other - offset) <= SAME_CLOCK_S for other in offsets.values())


def _rates(sensors: Sequence[Examined]) -> tuple[float, list[Finding]]:
    """Return the least ratio of the rates of IMUs and cameras, and where it is too small."""
    cameras = [e for e in sensors if e.stream.kind == 'camera']
    ratios = [
        (imu.timing.rate_hz / camera.timing.rate_hz, imu, camera)
        for imu in sensors
        if imu.stream.kind == 'imu'
        for camera in cameras
    ]
    if not ratios:
        return math.nan, []
    least, imu, camera = min(ratios, key=lambda one: one[0])
    if least >= SAMPLES_A_FRAME:
        return least, []
    return least, [
        Finding(
            'imu_rate', imu.stream.topic, 'warn',
            f'{imu.timing.rate_hz:.4g} Hz are only {least:.3g} times the rate of '
            f'{camera.stream.topic}; most estimators want {SAMPLES_A_FRAME:.0f} and more',
            value=least, unit='ratio',
        )
    ]  # fmt: skip
