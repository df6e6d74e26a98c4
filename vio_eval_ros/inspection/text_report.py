"""An inspection as the text that a person reads."""

from __future__ import annotations

from collections.abc import Iterator
import math

from vio_eval_ros.core.statistics import NORMAL_95
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.inspection import InspectedStreams
from vio_eval_ros.inspection.measured_stream import Inertial, MeasuredStream
from vio_eval_ros.inspection.report import Report
from vio_eval_ros.rendering.text import number, printable

# what stands out is in capitals
COLUMNS = (
    '', 'topic', 'type', 'messages', 'rate [Hz]', 'jitter [ms]', 'missing', 'longest [s]',
    'latency [ms]', 'drift [ppm]',
)  # fmt: skip
# Longer latencies are of two clocks that have nothing to do with each other
MAX_LATENCY_S = 1e4
# Of a robot with many joints, the first transforms are listed
MAX_TRANSFORMS = 20
# Of what happens more often, the first times are shown
MAX_TIMES = 5


def text_document(report: Report) -> str:
    """Return the table of streams, what was expected, what was found, and the calibration."""
    from tabulate import tabulate

    rows = table_rows(report)
    right = ('left', 'left', 'left', *['right'] * (len(COLUMNS) - 3))
    lines = tabulate(rows, COLUMNS, 'simple', disable_numparse=True, colalign=right).splitlines()
    known = list(facts(report.inspection))
    lines += ['', *known] if known else []
    if report.expectations:
        lines.append('')
        lines += [
            f'{one.word}  {one.stream} {one.check}: {one.message}' for one in report.expectations
        ]
    for finding in report.findings:
        lines += ['', *_paragraph(report, finding)]
    if report.word == 'pass':
        lines += ['', 'nothing is wrong with the streams']
    if report.calibration is not None:
        for source, sentences in report.calibration.sentences.items():
            lines += ['', f'{source}:', *(f'  {sentence}' for sentence in sentences)]
    return '\n'.join(map(printable, lines)) + '\n'


def table_rows(report: Report) -> list[list[str]]:
    """Return the cells of all streams, as COLUMNS has them, the worst first."""
    silent = [
        [
            report.word_of(one.topic),
            printable(one.topic),
            _type(one.msgtype),
            '0',
            *['-'] * 6,
        ]
        for one in report.inspection.silent
    ]
    rows = [*silent, *(row(report, one) for one in report.streams)]
    return sorted(rows, key=lambda cells: ('fail', 'warn', 'pass').index(cells[0]))


def _type(msgtype: str) -> str:
    return msgtype.rpartition('/')[2]


def row(report: Report, one: MeasuredStream) -> list[str]:
    """Return the cells of a stream, as COLUMNS has them."""
    figures, compared = one.timing, one.clocks
    latency = drift = '-'
    if compared is not None:
        if abs(compared.latency_median_s) < MAX_LATENCY_S:
            latency = f'{1e3 * compared.latency_median_s:.3g} / {1e3 * compared.latency_p99_s:.3g}'
        if math.isfinite(compared.drift_ppm):
            ppm = round(compared.drift_ppm, 1) + 0.0  # -0.0 is 0.0
            drift = f'{ppm:.1f} ± {NORMAL_95 * compared.drift_uncertainty_ppm:.1f}'
    return [
        report.word_of(one.stream.topic),
        printable(one.stream.topic),
        _type(one.stream.msgtype),
        f'{figures.count:,}',
        number(figures.rate_hz),
        number(1e3 * figures.jitter_p99_s),
        str(figures.missing),
        number(figures.longest_s),
        latency,
        drift,
    ]


def facts(inspection: InspectedStreams) -> Iterator[str]:
    """Yield figures of several streams together, and of the motion of each IMU."""
    if inspection.common_ns is not None:
        begin_ns, end_ns = inspection.common_ns
        yield f'all sensors together   {(end_ns - begin_ns) / 1e9:.2f} s'
    if math.isfinite(inspection.imu_to_camera):
        yield f'IMU samples per image  {inspection.imu_to_camera:.4g}'
    for pair in inspection.pairs:
        yield (
            f'camera pair            {pair.first}, {pair.second}: skew '
            f'{1e3 * pair.skew_s:.3g} ± {1e3 * pair.skew_jitter_s:.2g} ms, '
            f'{pair.unsynchronised} of {pair.frames} frames without a partner'
        )
    for one in inspection.streams:
        if one.inertial is not None:
            yield f'motion                 {one.stream.topic}: {_felt(one.inertial)}'
        if one.stream.transforms:
            sent = one.stream.transforms.items()
            listed = [f'{name} ({len(poses)})' for name, poses in list(sent)[:MAX_TRANSFORMS]]
            more = f' and {len(sent) - MAX_TRANSFORMS} more' if len(sent) > MAX_TRANSFORMS else ''
            yield f'transforms             {one.stream.topic}: {", ".join(listed)}{more}'


def _felt(felt: Inertial) -> str:
    """Return the motion that an IMU felt, or one of its sensors where it has but one."""
    has_gyroscope = math.isfinite(felt.rotation_rms_rad_s[0])
    has_accelerometer = math.isfinite(felt.acceleration_m_s2)
    rates = ' '.join(f'{rate:.2g}' for rate in felt.rotation_rms_rad_s)
    rotates = f'rotates {rates} rad/s (rms, principal axes)'
    accelerates = f'accelerates {felt.acceleration_m_s2:.2g} m/s2'
    at_rest = 'never at rest'
    if felt.still_s:
        at_rest = (
            f'at rest for {felt.still_s:.3g} s ({felt.still_at_begin_s:.3g} s at the beginning)'
        )
    if felt.up:
        at_rest += f', where it measures {felt.gravity_m_s2:.3f} m/s2 along {felt.up}'
    return (
        f'{rotates if has_gyroscope else "has no gyroscope"}, '
        f'{accelerates if has_accelerometer else "has no accelerometer"}; {at_rest}'
    )


def _paragraph(report: Report, finding: Finding) -> Iterator[str]:
    """Yield a finding, when it was, and what to do about it."""
    yield f'{finding.level}  {finding}'
    if finding.moments and finding.level != 'info':
        yield f'      {times(report, finding)}'
    if finding.level != 'info':
        yield f'      {finding.advice}'


def times(report: Report, finding: Finding) -> str:
    """Return when the first times of a finding were, in seconds of the recording."""
    begin_ns = report.inspection.begin_ns
    seconds = [(moment.logged_begin_ns - begin_ns) / 1e9 for moment in finding.moments[:MAX_TIMES]]
    more = ', ...' if len(finding.moments) > MAX_TIMES else ''
    return f'at {", ".join(f"{at:.2f}" for at in seconds)}{more} s'
