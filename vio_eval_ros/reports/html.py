"""The report of a run that people look at: one HTML file, interactive and offline."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
import math

from vio_eval_ros.core.gates import Verdict
from vio_eval_ros.core.statistics import STATISTICS
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.rendering.figures import BLUE, boxes, GREY, RED
from vio_eval_ros.rendering.page import (
    badge,
    Html,
    joined,
    page,
    plot,
    swatch,
    table,
    tag,
    tiles,
    warnings,
)
from vio_eval_ros.rendering.text import number, percent
from vio_eval_ros.reports.drawn_run import DrawnRun, MOST_POINTS
from vio_eval_ros.reports.plots import (
    errors_over_time,
    GAP,
    path_3d,
    path_from_above,
    RAMP,
    relative_samples,
    segment_samples,
    usual_lengths,
)
from vio_eval_ros.reports.text import rows, since_beginning, single_figures
from vio_eval_ros.reports.times import (
    attitudes_over_time,
    BAND,
    errors_along_axes,
    places_over_time,
)

WORDS = {'pass': 'pass', 'warn': 'warning', 'fail': 'fail'}


def html_report(result: Result) -> str:
    """Return a page: verdict, headline figures, errors in space and time, and statistics."""
    return page(
        f'{result.estimate.source}: evaluation',
        _head(result),
        tiles(_headlines(result)),
        warnings(result.summary.warnings),
        _gates(result.verdicts),
        tag('section', run_plots(result), class_='run'),
        *_relative(result),
        tag('h2', 'Statistics'),
        _figures(result),
        *_counts(result),
        options(result),
    )


def run_plots(result: Result, most_points: int = MOST_POINTS) -> Html:
    """Return the plots of a run in space and time."""
    metrics = result.summary.metrics
    if math.isnan(metrics['ate_trans_rmse_m']):
        return tag('p', 'Nothing can be drawn: the alignment is not determined.', class_='soft')
    run = DrawnRun.of(result, most_points)
    ramp = tag('span', class_='ramp', style=f'background:linear-gradient(90deg,{",".join(RAMP)})')
    in_space = joined(
        [
            'Position error: 0 ', ramp, f' {number(run.hottest)} m or more (5 % of the pairs). ',
            swatch(GREY), 'Ground truth',
            '.' if run.whole is None else ', dotted where it has no pairs.',
        ]
    )  # fmt: skip
    return joined(
        [
            tag('h2', 'Where'),
            tag('p', in_space, class_='soft'),
            tag(
                'div',
                plot(path_3d(run), 420, 'trajectory in 3-D', shows='path'),
                plot(path_from_above(run), 420, 'trajectory from above', shows='path'),
                class_='plots',
            ),
            tag('h2', 'When'),
            tag('p', *_marks(run), class_='soft'),
            plot(
                errors_over_time(run, metrics['ate_trans_rmse_m'], metrics['ate_rot_rmse_deg']),
                420,
                'errors over time',
                shows='errors',
            ),
            *_over_time(replace(run, most_points=most_points // 2)),
        ]
    )


def _over_time(run: DrawnRun) -> Iterator[Html]:
    """Yield the error along each axis, where its bounds are known, and place and attitude."""
    errors, attitudes = errors_along_axes(run), attitudes_over_time(run)
    if errors is not None:
        told = 'Error along each axis, within 3 sigma of the covariance that the estimate states:'
        yield tag('p', swatch(BAND), told, class_='soft')
        yield plot(errors, 420, 'error along each axis over time', shows='errors')
    yield tag(
        'p', swatch(BLUE), 'Estimate, aligned. ', swatch(GREY), 'Ground truth. ', class_='soft'
    )
    yield tag(
        'div',
        plot(places_over_time(run), 420, 'x, y and z over time', shows='errors'),
        ''
        if attitudes is None
        else plot(attitudes, 420, 'roll, pitch and yaw over time', shows='errors'),
        class_='plots',
    )


def _marks(run: DrawnRun) -> Iterator[object]:
    """Yield the legend of the errors over time, with the number of gaps and jumps."""
    yield 'Dashed: RMSE. '
    if run.gaps:
        lost = sum(end - begin for begin, end in run.gaps)
        yield swatch(GAP)
        yield (
            f'{_count(len(run.gaps), "gap")} without pairs for more than {run.longest_s:.3g} s, '
            f'together {lost:.1f} s. '
        )
    else:
        yield f'No gap longer than {run.longest_s:.3g} s. '
    if run.jumps:
        k, size = run.jumps[0]
        yield tag('span', '◇', style=f'color:{RED};margin:0 .3rem 0 .8rem;font-weight:700')
        yield (
            f'{_count(len(run.jumps), "jump")} of the estimate (from one pair to the next off by '
            f'more than {number(run.least_jump)} m), the largest of {number(size)} m at '
            f'{run.seconds[k]:.1f} s.'
        )


def _count(count: int, noun: str) -> str:
    return f'{count} {noun}' + 's' * (count != 1)


def _head(result: Result) -> Html:
    word = {True: 'pass', False: 'fail', None: ''}[result.passed]
    alignment = result.summary.alignment
    scale = '' if alignment.scale == 1 else f', scale {number(alignment.scale)}'
    return tag(
        'header',
        tag(
            'div',
            tag('h1', result.estimate.source),
            tag('p', f'against {result.ground_truth.source}', class_='soft'),
            tag('p', f'alignment {alignment.mode}{scale}', class_='soft'),
        ),
        badge(word, word or 'no gates'),
    )


def _headlines(result: Result) -> Iterator[tuple[str, str, str]]:
    """Yield the headline figures."""
    metrics, found = result.summary.metrics, result.summary.association
    yield (
        'ATE position',
        f'{number(metrics["ate_trans_rmse_m"])} m',
        f'RMSE, max {number(metrics["ate_trans_max_m"])} m',
    )
    yield (
        'ATE rotation',
        f'{number(metrics["ate_rot_rmse_deg"])}°',
        f'RMSE, max {number(metrics["ate_rot_max_deg"])}°',
    )
    for delta in result.config.rpe_deltas[-1:]:
        kind = 'disp' if result.summary.pairs.rotations is None else 'trans'
        yield f'RPE over {delta}', f'{number(metrics[f"rpe_{delta}_{kind}_rmse_m"])} m', 'RMSE'
    yield (
        'Coverage',
        percent(metrics['coverage_ratio']),
        '; '.join(['of the ground truth was tracked', *since_beginning(metrics)]),
    )
    yield (
        'Path',
        f'{number(metrics["path_length_m"])} m',
        f'{found["pairs"]:,} pairs',
    )
    yield 'Scale', number(metrics['sim3_scale']), 'of the Sim(3) alignment; ideally 1'


def gate_rows(verdicts: Iterable[tuple[str, Verdict]]) -> Html:
    """Return a table of gates, each under the given name."""
    return table(
        ['gate', 'value', 'limit', 'share of the limit', 'verdict'],
        [
            [
                name,
                number(verdict.value),
                f'{verdict.gate.comparison} {verdict.gate.limit:g}',
                _used(verdict),
                badge(verdict.word, WORDS[verdict.word]),
            ]
            for name, verdict in verdicts
        ],
        numbers=(1, 2),
        minor=(3,),
    )


def _used(verdict: Verdict) -> Html:
    """Return a bar that is full when a value reaches its limit."""
    value, limit = verdict.value, verdict.gate.limit
    if verdict.gate.comparison == '>=':
        value, limit = limit, value
    known = limit and not math.isnan(verdict.value)
    share = min(1.0, max(0.0, value / limit)) if known else 1.0
    return tag('div', tag('i', style=f'width:{100 * share:.0f}%'), class_=f'bar {verdict.word}')


def _gates(verdicts: Iterable[Verdict]) -> Html:
    named = [(verdict.gate.metric, verdict) for verdict in verdicts]
    return joined([tag('h2', 'Gates'), gate_rows(named)]) if named else Html()


def _relative(result: Result) -> Iterator[Html]:
    """Yield the relative errors over each delta, and the drift over lengths of path."""
    errors = relative_samples(result)
    if errors:
        yield tag('h2', 'Drift')
        yield tag(
            'p',
            'Relative errors (RPE) over each delta. Boxes: quartiles; whiskers: 5th to 95th '
            'percentile; dashed: mean.',
            class_='soft',
        )
        yield _boxes(errors)
    given = result.config.segment_lengths_m
    drift = segment_samples(
        result, given or usual_lengths(result.summary.metrics['path_length_m'])
    )
    if drift:
        yield tag(
            'p',
            'Drift over lengths of path'
            + ('' if given else ', chosen automatically since no segment_lengths_m were given')
            + '.',
            class_='soft',
        )
        yield _boxes(drift)


def _boxes(samples: Iterable[tuple[str, dict]]) -> Html:
    return tag(
        'div', *(plot(boxes(title, of), 260, title) for title, of in samples), class_='plots'
    )


def _figures(result: Result) -> Html:
    shown = ('rmse', 'median', 'p95', 'max')
    hidden = [k for k, name in enumerate(STATISTICS, 1) if name not in shown]
    errors = table(
        ['error', *STATISTICS, 'metric'],
        [[row.label, *map(number, row.values), tag('code', row.metric)] for row in rows(result)],
        numbers=range(1, len(STATISTICS) + 1),
        minor=[*hidden, len(STATISTICS) + 1],
    )
    others = table(
        ['figure', 'value', 'metric'],
        [[words, number(value), tag('code', name)]
         for words, name, value in single_figures(result)],
        numbers=(1,),
    )  # fmt: skip
    return joined([errors, others])


def _counts(result: Result) -> Iterator[Html]:
    """Yield the number of poses that were paired, and why others were not."""
    found = result.summary.association
    yield tag('h2', 'Poses')
    yield table(['', 'estimate', 'ground truth'], _streams(result), numbers=(1, 2))
    yield tag(
        'p',
        f'{found["pairs"]:,} pairs, {percent(found["matched_ratio"])} of the estimates; stamps '
        f'{number(1e3 * found["abs_difference_mean_s"])} ms apart on average, '
        f'{number(1e3 * found["abs_difference_max_s"])} ms at most.',
        class_='soft',
    )


def _streams(result: Result) -> Iterator[list[object]]:
    sides = (result.estimate, result.ground_truth)
    facts = [side.to_dict() for side in sides]
    found = result.summary.association
    unmatched = [found['unmatched_estimates'], found['unmatched_ground_truth']]
    yield ['poses used', *(f'{one["poses"]:,}' for one in facts)]
    yield [
        'rate [Hz]',
        *('-' if one['rate_hz'] is None else number(one['rate_hz']) for one in facts),
    ]
    yield ['unmatched', *('-' if math.isnan(n) else f'{n:,}' for n in unmatched)]
    for reason in facts[0]['dropped']:
        counts = [one['dropped'][reason] for one in facts]
        if any(counts):
            yield [f'dropped: {reason.replace("_", " ")}', *(f'{n:,}' for n in counts)]
    for name in ('went_backwards', 'scaled_quaternion'):
        counts = [side.repaired[name] for side in sides]
        if any(counts):
            yield [f'repaired: {name.replace("_", " ")}', *(f'{n:,}' for n in counts)]


def options(result: Result) -> Html:
    """Return how the run was evaluated, folded."""

    def shown(value: object) -> str:
        if isinstance(value, list):
            return ' '.join(map(shown, value)) or '-'
        if isinstance(value, float):
            return f'{value:g}'
        return '-' if value is None else str(value)

    given = [[name, shown(value)] for name, value in result.config.to_dict().items()]
    return tag(
        'details',
        tag('summary', 'Options and inputs'),
        table(['option', 'value'], given),
        tag('h3', 'Inputs'),
        *(tag('p', name, ': ', _input(side)) for name, side in
          (('Estimate', result.estimate), ('Ground truth', result.ground_truth))),
    )  # fmt: skip


def _input(side: Input) -> Html:
    of = f'{side.kind}, sha256 {side.sha256}' if side.sha256 else side.kind
    return joined([side.source, tag('span', f' ({of})', class_='soft')])
