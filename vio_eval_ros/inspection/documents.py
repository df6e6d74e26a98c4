"""An inspection as the text that a person reads, and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
import json
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.inspection.calibration import Calibration
from vio_eval_ros.inspection.expectations import Verdict
from vio_eval_ros.inspection.findings import ALWAYS_INFO, Finding, LEVELS, worst_first
from vio_eval_ros.inspection.inspection import Examined, Inspection
from vio_eval_ros.rendering.text import number, printable
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.inspection/1'
# what stands out is in capitals
WORDS = {'pass': 'pass', 'info': 'info', 'warn': 'warn', 'fail': 'FAIL'}
COLUMNS = (
    '', 'topic', 'type', 'messages', 'rate [Hz]', 'jitter [ms]', 'missing', 'longest [s]',
    'latency [ms]', 'drift [ppm]',
)  # fmt: skip
LONGEST_LATENCY_S = 1e4
MOST_TIMES = 5


@dataclass(frozen=True, eq=False)
class Report:
    """
    All that is told of a recording.

    :param source: what was inspected.
    :param verdicts: of what was expected; none where nothing was.
    """

    source: str
    inspection: Inspection
    verdicts: Sequence[Verdict] = ()
    calibration: Calibration | None = None

    @property
    def findings(self) -> list[Finding]:
        """Those of the streams and of the calibration, worst first."""
        of_calibration = self.calibration.findings if self.calibration else []
        return worst_first([*self.inspection.findings, *of_calibration])

    def word(self, topic: str) -> str:
        """Return the worst that was found in a topic: fail, warn or pass."""
        of_topic = [one.level for one in self.findings if topic in one.topic.split(', ')]
        of_topic += [verdict.word for verdict in self.verdicts if verdict.topic == topic]
        return next((word for word in ('fail', 'warn') if word in of_topic), 'pass')

    def streams(self) -> list[Examined]:
        """Return the streams, the worst first."""
        order = ('fail', 'warn', 'pass')
        return sorted(
            self.inspection.streams, key=lambda one: order.index(self.word(one.stream.topic))
        )


def text_document(report: Report) -> str:
    """Return the table of streams, what was found, what was expected, and the calibration."""
    from tabulate import tabulate

    rows = table_rows(report)
    right = ('left', 'left', 'left', *['right'] * (len(COLUMNS) - 3))
    lines = tabulate(rows, COLUMNS, 'simple', disable_numparse=True, colalign=right).splitlines()
    known = list(facts(report.inspection))
    lines += ['', *known] if known else []
    if report.verdicts:
        lines.append('')
        lines += [
            f'{WORDS[one.word]}  {one.stream} {one.check}: {one.message}'
            for one in report.verdicts
        ]
    for finding in report.findings:
        lines += ['', *_paragraph(report, finding)]
    words = [one.level for one in report.findings] + [one.word for one in report.verdicts]
    if not {'warn', 'fail'} & set(words):
        lines += ['', 'nothing is wrong with the streams']
    if report.calibration is not None:
        for source, sentences in report.calibration.sentences.items():
            lines += ['', f'{source}:', *(f'  {sentence}' for sentence in sentences)]
    return '\n'.join(map(printable, lines)) + '\n'


def table_rows(report: Report) -> list[list[str]]:
    """Return the cells of all streams, as COLUMNS has them, the worst first."""
    silent = [
        [WORDS[report.word(one.topic)], printable(one.topic), _type(one.msgtype), '0', *['-'] * 6]
        for one in report.inspection.silent
    ]
    rows = [*silent, *(row(report, one) for one in report.streams())]
    return sorted(rows, key=lambda cells: ('FAIL', 'warn', 'pass').index(cells[0]))


def _type(msgtype: str) -> str:
    return msgtype.rpartition('/')[2]


def row(report: Report, one: Examined) -> list[str]:
    """Return the cells of a stream, as COLUMNS has them."""
    figures, compared = one.timing, one.clocks
    latency = drift = '-'
    if compared is not None:
        if abs(compared.latency_median_s) < LONGEST_LATENCY_S:
            latency = f'{1e3 * compared.latency_median_s:.3g} / {1e3 * compared.latency_p99_s:.3g}'
        if math.isfinite(compared.drift_ppm):
            ppm = round(compared.drift_ppm, 1) + 0.0  # -0.0 is 0.0
            drift = f'{ppm:.1f} ± {1.96 * compared.drift_uncertainty_ppm:.1f}'
    return [
        WORDS[report.word(one.stream.topic)],
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


def facts(inspection: Inspection) -> Iterator[str]:
    """Yield what is known of several streams together, and of what each IMU felt."""
    if inspection.common_ns is not None:
        begin_ns, end_ns = inspection.common_ns
        yield f'all sensors together   {(end_ns - begin_ns) / 1e9:.2f} s'
    if math.isfinite(inspection.imu_to_camera):
        yield f'IMU samples a frame    {inspection.imu_to_camera:.4g}'
    for pair in inspection.pairs:
        yield (
            f'camera pair            {pair.first}, {pair.second}: skew '
            f'{1e3 * pair.skew_s:.3g} ± {1e3 * pair.skew_jitter_s:.2g} ms, '
            f'{pair.unsynchronised} of {pair.frames} frames without a partner'
        )
    for one in inspection.streams:
        felt = one.inertial
        if felt is not None:
            turns = ' '.join(f'{rate:.2g}' for rate in felt.rotation_rms_rad_s)
            rest = (
                f'; at rest for {felt.still_s:.3g} s ({felt.still_at_begin_s:.3g} s at the '
                f'beginning), where it feels {felt.gravity_m_s2:.3f} m/s2 along {felt.up}'
                if felt.up
                else '; never at rest'
            )
            yield (
                f'motion                 {one.stream.topic}: turns {turns} rad/s (rms, principal '
                f'axes), accelerates {felt.acceleration_m_s2:.2g} m/s2{rest}'
            )


def _paragraph(report: Report, finding: Finding) -> Iterator[str]:
    """Yield a finding, when it was, and what to do about it."""
    where = f' {finding.topic}' if finding.topic else ''
    yield f'{WORDS[finding.level]}  {finding.name}{where}: {finding.message}'
    if finding.moments and finding.level != 'info':
        yield f'      {times(report, finding)}'
    if finding.level != 'info':
        yield f'      {finding.advice}'


def times(report: Report, finding: Finding) -> str:
    """Return when the first times of a finding were, in seconds of the recording."""
    begin_ns = report.inspection.begin_ns
    seconds = [
        (moment.logged_begin_ns - begin_ns) / 1e9 for moment in finding.moments[:MOST_TIMES]
    ]
    more = ', ...' if len(finding.moments) > MOST_TIMES else ''
    return f'at {", ".join(f"{at:.2f}" for at in seconds)}{more} s'


def json_document(report: Report) -> str:
    """Return all of it in schema ``vio_eval_ros.inspection/1``."""
    inspection = report.inspection
    counts = {level: sum(one.level == level for one in report.findings) for level in LEVELS}
    document = {
        'schema': SCHEMA,
        'tool': {'name': 'vio_eval_ros', 'version': __version__},
        'recording': report.source,
        'streams': [_stream(report, one) for one in report.streams()],
        'silent': [{'topic': one.topic, 'type': one.msgtype} for one in report.inspection.silent],
        'pairs': [vars(pair) for pair in inspection.pairs],
        'common_span_ns': inspection.common_ns,
        'imu_to_camera_rate': inspection.imu_to_camera,
        'counts': counts,
        'findings': [finding.to_dict() for finding in report.findings],
        'expectations': [verdict.to_dict() for verdict in report.verdicts],
        'calibration': report.calibration and report.calibration.to_dict(),
    }
    return json.dumps(without_nan(document), indent=2, allow_nan=False) + '\n'


def _stream(report: Report, one: Examined) -> dict[str, Any]:
    figures = {
        key: value for key, value in vars(one.timing).items() if not isinstance(value, np.ndarray)
    }
    return {
        'topic': one.stream.topic,
        'type': one.stream.msgtype,
        'worst': report.word(one.stream.topic),
        'frame_ids': dict(one.stream.frames),
        'timing': {**figures, 'duration_s': one.timing.duration_s},
        'clocks': one.clocks and vars(one.clocks),
        'inertial': one.inertial and vars(one.inertial),
        'motion': one.motion and vars(one.motion),
    }


def failed(report: Report, names: Iterable[str]) -> bool:
    """Return whether an expectation is not met, or one of the names was found to be wrong."""
    found = {
        finding.name
        for finding in report.findings
        if finding.level != 'info' or finding.name in ALWAYS_INFO
    }
    return any(verdict.word == 'fail' for verdict in report.verdicts) or bool(found & set(names))
