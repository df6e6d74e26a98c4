"""An inspection to look at: one HTML file with the timeline of all streams and their periods."""

from __future__ import annotations

from collections.abc import Sequence
import math

from vio_eval_ros.inspection.figures import period_over_time, timeline, TOP_PERIODS
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.measured_stream import MeasuredStream
from vio_eval_ros.inspection.report import Report
from vio_eval_ros.inspection.text_report import COLUMNS, facts, table_rows, times
from vio_eval_ros.rendering.figures import AMBER, BLUE, GREY, RED
from vio_eval_ros.rendering.page import badge, Html, joined, page, plot, swatch, table, tag
from vio_eval_ros.rendering.text import number


def html_document(report: Report) -> str:
    """Return the page: verdict, timeline, findings, expectations, periods, figures."""
    streams = report.streams
    return page(
        f'{report.source}: inspection',
        tag(
            'header',
            tag('div', tag('h1', report.source), tag('p', _summary(report), class_='soft')),
            badge(report.word, report.word),
        ),
        tag('h2', 'Timeline'),
        tag('p', *_legend(), class_='soft'),
        plot(timeline(report), 70 + 34 * len(streams), 'timeline of all streams'),
        tag('h2', 'Findings'),
        _findings(report),
        *_expected(report),
        tag('h2', 'Streams'),
        tag(
            'div',
            table(
                COLUMNS,
                [
                    [badge(cells[0].lower(), cells[0].lower()), *cells[1:]]
                    for cells in table_rows(report)
                ],
                numbers=range(3, len(COLUMNS)),
            ),
            # all of it in a narrow window, too
            style='overflow-x:auto;overflow-wrap:normal',
        ),
        tag('ul', *(tag('li', fact) for fact in facts(report.inspection))),
        *_calibrated(report),
        *_periods(streams, report.inspection.begin_ns),
    )


def _summary(report: Report) -> str:
    inspection = report.inspection
    known = [f'{len(inspection.streams)} streams']
    if inspection.common_ns is not None:
        begin_ns, end_ns = inspection.common_ns
        known.append(f'{(end_ns - begin_ns) / 1e9:.1f} s common to all sensors')
    if math.isfinite(inspection.imu_to_camera):
        known.append(f'{inspection.imu_to_camera:.3g} IMU samples per image')
    return ', '.join(known)


def _legend() -> list[object]:
    return [
        'When each topic was recorded. ',
        swatch(BLUE), 'messages', swatch(GREY), 'missing messages',
        swatch(RED), 'fail', swatch(AMBER), 'warn',
    ]  # fmt: skip


def _findings(report: Report) -> Html:
    if not report.findings:
        return tag('p', 'Nothing is wrong with the streams.')
    rows = [
        [
            badge(one.level, one.level),
            joined(
                [
                    tag('b', one.name, style='white-space:nowrap;font-weight:600'),
                    tag('div', one.topic, class_='soft', style='min-width:9rem'),
                ]
            ),
            joined([one.message, _when(report, one), '. ', _advice(one)]),
        ]
        for one in report.findings
    ]
    return table(['', 'finding', ''], rows)


def _when(report: Report, finding: Finding) -> str:
    return f', {times(report, finding)}' if finding.moments else ''


def _advice(finding: Finding) -> Html:
    return Html() if finding.level == 'info' else tag('span', finding.advice, class_='soft')


def _expected(report: Report) -> list[Html]:
    if not report.expectations:
        return []
    rows = [
        [
            badge(one.word, one.word),
            joined([tag('b', one.stream), tag('div', one.check, class_='soft')]),
            one.message,
        ]
        for one in report.expectations
    ]
    return [tag('h2', 'Expectations'), table(['', 'expected of', 'measured'], rows)]


def _calibrated(report: Report) -> list[Html]:
    if report.calibration is None:
        return []
    return [
        tag('h2', 'Calibration'),
        *(
            joined([tag('h3', source), tag('ul', *(tag('li', one) for one in sentences))])
            for source, sentences in report.calibration.sentences.items()
        ),
    ]


def _periods(streams: Sequence[MeasuredStream], origin_ns: int) -> list[Html]:
    """Return the period of each stamped stream over time."""
    drawn = [
        one for one in streams if one.stream.stamps_ns is not None and len(one.timing.periods_s)
    ]
    if not drawn:
        return []
    return [
        tag('h2', 'Periods'),
        tag(
            'p',
            f'From one stamp to the next. Triangles: more than {TOP_PERIODS:.0f} medians.',
            class_='soft',
        ),
        tag(
            'div',
            *(
                plot(
                    period_over_time(one, origin_ns),
                    240,
                    f'periods of {one.stream.topic}',
                    _titled(one),
                )
                for one in drawn
            ),
            class_='plots',
        ),
    ]


def _titled(one: MeasuredStream) -> str:
    return f'{one.stream.topic}, {number(1e3 * one.timing.period_s)} ms in the median'
