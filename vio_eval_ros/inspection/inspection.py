"""What is measured and found in the sensor streams of a recording, on one screen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.inspection.cameras import Pair, pairs
from vio_eval_ros.inspection.clock_offsets import poses_apart, sensors_apart
from vio_eval_ros.inspection.clocks import clocks
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS, worst_first
from vio_eval_ros.inspection.inertial import inertial
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.measured_stream import MeasuredStream
from vio_eval_ros.inspection.pose_motion import pose_motion
from vio_eval_ros.inspection.publishers import publishers
from vio_eval_ros.inspection.stuck import measures
from vio_eval_ros.inspection.timing import timing
from vio_eval_ros.inspection.wrong_stamps import corrected


@dataclass(frozen=True, eq=False)
class InspectedStreams:
    """
    What was measured in the streams of a recording, and what is wrong with them.

    :param limits: by which it was judged.
    :param streams: those with messages, by topic; ``silent`` are those without.
    :param findings: worst first.
    :param common_ns: the first and the last stamp of the time that all sensors have in common;
        None where there is none.
    :param imu_to_camera: the least ratio of their rates; NaN where one is missing.
    """

    limits: InspectionLimits
    streams: list[MeasuredStream]
    silent: list[SensorStream]
    pairs: list[Pair]
    findings: list[Finding]
    common_ns: tuple[int, int] | None
    imu_to_camera: float

    @property
    def begin_ns(self) -> int:
        """When the first message was recorded."""
        return min(int(one.stream.arrivals_ns.min()) for one in self.streams)


def inspect_streams(
    streams: Sequence[SensorStream],
    left_out: Sequence[str] = (),
    limits: InspectionLimits | None = None,
    *,
    unfinished: Sequence[str] = (),
) -> InspectedStreams:
    """
    Return what can be said of the streams of a recording.

    :param left_out: a sentence for whatever could not be read.
    :param limits: between healthy and not; by default those of a drone.
    :param unfinished: a sentence for whatever is unusual about the files.
    """
    limits = limits or InspectionLimits()
    findings = [FINDINGS['unfinished'].found('', sentence=sentence) for sentence in unfinished]
    findings += [FINDINGS['left_out'].found('', sentence=sentence) for sentence in left_out]
    silent = sorted((one for one in streams if not len(one)), key=lambda one: one.topic)
    findings += [FINDINGS['silent'].found(stream, count=0) for stream in silent]
    measured = []
    for stream in sorted(_parts(one for one in streams if len(one)), key=lambda one: one.topic):
        one, found = _measured(stream, limits)
        measured.append(one)
        findings += found
    findings = [
        finding.kind.amended(finding, findings, measured) if finding.kind.amended else finding
        for finding in findings
    ]
    together, found = pairs(measured, limits)
    sensors = [one for one in measured if one.stream.is_sensor and one.is_timed]
    common = _common(sensors)
    ratio, slow = _rates(sensors, limits)
    findings += [*found, *slow, *_spans(measured, limits)]
    findings += _no_common_span(sensors, common)
    if common is not None:
        findings += sensors_apart(sensors, limits)
    apart = list(poses_apart(measured))
    # how far they are off the clock of the recorder says less
    known = {(one.name, one.topic) for one in apart}
    findings = [one for one in findings if (one.name, one.topic) not in known] + apart
    return InspectedStreams(
        limits=limits,
        streams=measured,
        silent=silent,
        pairs=together,
        findings=worst_first(findings),
        common_ns=common,
        imu_to_camera=ratio,
    )


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


def _measured(
    stream: SensorStream, limits: InspectionLimits
) -> tuple[MeasuredStream, list[Finding]]:
    """Return the figures of a stream, and what is wrong with it alone."""
    findings = [*_headers(stream), *publishers(stream)]
    stream, found = corrected(stream.stamped())
    findings += found
    compared = clocks(stream, limits)
    findings += compared.findings
    # where stamps step while messages go on, none is missing
    figures, found = timing(stream, limits, compared.stamps_step)
    findings += found
    felt, moved = None, None
    if stream.stamps_ns is not None and stream.kind == 'imu':
        felt, found = inertial(stream, figures, limits)
        findings += found
    elif stream.stamps_ns is not None and stream.kind == 'pose':
        moved, found = pose_motion(stream, figures, limits)
        findings += found
    return MeasuredStream(stream, figures, compared.clocks, felt, moved), findings


def _headers(stream: SensorStream) -> Iterator[Finding]:
    """Yield what is wrong with the headers of a stream, but for the times in them."""
    if len(stream.frames) > 1:
        names = ', '.join(f"'{name}' ({count})" for name, count in sorted(stream.frames.items()))
        yield FINDINGS['frame_ids'].found(stream, names=names, count=len(stream.frames))
    if stream.stamps_ns is not None and not stream.is_stamped.all():
        which = np.flatnonzero(~stream.is_stamped)
        is_all = len(which) == len(stream)
        instead = ''
        if is_all and stream.has_poses and stream.logged_ns is not None:
            first_s, last_s = (
                end / 1e9 for end in (stream.logged_ns.min(), stream.logged_ns.max())
            )
            instead = (
                f'; they were recorded from {first_s:.2f} to {last_s:.2f} s, which is what they '
                'are scored by after ?stamps=recorded'
            )
        yield FINDINGS['unstamped'].found(
            # transforms are no input of an estimator, but what it is scored by
            stream.topic if instead else stream,
            instead=instead,
            severe=stream.is_sensor and is_all,
            total=len(stream),
            count=len(which),
            moments=stream.moments(which, which),
        )


def _common(sensors: Sequence[MeasuredStream]) -> tuple[int, int] | None:
    """Return the first and the last stamp of the time that all sensors have, if there is any."""
    if not sensors:
        return None
    first_ns = max(one.timing.first_ns for one in sensors)
    last_ns = min(one.timing.last_ns for one in sensors)
    return (first_ns, last_ns) if first_ns <= last_ns else None


def _spans(measured: Sequence[MeasuredStream], limits: InspectionLimits) -> Iterator[Finding]:
    """Yield the streams that begin later, or end earlier, than the first and the last sensor."""
    known = [one for one in measured if one.stream.stamps_ns is not None]
    sensors = [one for one in known if one.stream.is_sensor] or known
    if len(sensors) < 2:
        return
    of = 'sensor' if sensors[0].stream.is_sensor else 'stream'
    begin_ns = min(int(one.stream.arrivals_ns.min()) for one in sensors)
    end_ns = max(int(one.stream.arrivals_ns.max()) for one in sensors)
    for one in known:
        if one.stream.kind == 'other' and not one.is_timed:
            continue  # one that is latched
        arrivals = one.stream.arrivals_ns
        limit_s = limits.late_s
        if math.isfinite(one.timing.period_s):
            limit_s = max(limit_s, limits.late_periods * one.timing.period_s)
        first, last = int(arrivals.argmin()), int(arrivals.argmax())
        for name, k, late_s in (
            ('late_start', first, (int(arrivals[first]) - begin_ns) / 1e9),
            ('early_end', last, (end_ns - int(arrivals[last])) / 1e9),
        ):
            if late_s > limit_s:
                moments = (one.stream.moment(k, k),)
                yield FINDINGS[name].found(one.stream, of=of, value=late_s, moments=moments)


def _no_common_span(
    sensors: Sequence[MeasuredStream], common: tuple[int, int] | None
) -> Iterator[Finding]:
    """Yield that the stamps of sensors do not overlap in time."""
    if len(sensors) >= 2 and common is None:
        spans = ', '.join(
            f'{one.stream.topic} {one.timing.first_ns / 1e9:.2f} to '
            f'{one.timing.last_ns / 1e9:.2f} s'
            for one in sensors
        )
        yield FINDINGS['no_common_span'].found(sensors[0].stream, spans=spans)


def _rates(
    sensors: Sequence[MeasuredStream], limits: InspectionLimits
) -> tuple[float, list[Finding]]:
    """Return the least ratio of the rates of IMUs and cameras, and where it is too small."""
    ratios = [
        (imu.timing.rate_hz / camera.timing.rate_hz, imu, camera)
        for imu in sensors
        if imu.stream.kind == 'imu'
        for camera in sensors
        if camera.stream.kind == 'camera'
    ]
    if not ratios:
        return math.nan, []
    ratio, imu, camera = min(ratios, key=lambda one: one[0])
    if ratio >= limits.imu_samples_per_frame:
        return ratio, []
    finding = FINDINGS['imu_rate'].found(
        imu.stream,
        rate_hz=imu.timing.rate_hz,
        camera=camera.stream.topic,
        least=limits.imu_samples_per_frame,
        value=ratio,
    )
    return ratio, [finding]
