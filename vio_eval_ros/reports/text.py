"""The summary of a result for a terminal, and what other reports share with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math
import re
from typing import NamedTuple

from vio_eval_ros.core.glossary import in_words
from vio_eval_ros.core.metrics import ALWAYS_ALIGNED
from vio_eval_ros.core.relative import RPE_KINDS
from vio_eval_ros.core.statistics import STATISTICS
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.rendering.text import number, percent, printable

RPE_LABELS = {
    'trans': 'position',
    'rot': 'rotation',
    'disp': 'displacement',
    'dist': 'distance',
}
#: share of the ground truth before the first estimate that is worth a line
LATE_RATIO = 0.01
#: how metrics begin that are always given under several alignments, or as first published
ALIGNED = tuple(f'ate_{mode}_' for mode in (*ALWAYS_ALIGNED, 'causal'))


def text_report(result: Result) -> str:
    """Return what was assumed and matched, how it was aligned, the errors, warnings and gates."""
    summary, found = result.summary, result.summary.association
    metrics, alignment = summary.metrics, summary.alignment
    lines = [f'warning: {sentence}' for sentence in result.assumed]
    lines += [
        f'estimate      {described(result.estimate)}',
        f'ground truth  {described(result.ground_truth)}',
        f'matched       {found["pairs"]:,} pairs ({percent(found["matched_ratio"])} of the '
        f'estimates), stamps {number(1e3 * found["abs_difference_mean_s"])} ms apart on average',
        f'coverage      {percent(metrics["coverage_ratio"])} of the ground truth was tracked, '
        f'{number(metrics["path_length_m"])} m of path',
        *(f'{"":<14}{line}' for line in since_beginning(metrics)),
        f'alignment     {alignment.mode}'
        + ('' if alignment.scale == 1 else f', scale {number(alignment.scale)}'),
        '',
        ' ' * 27 + ''.join(f'{name:>10}' for name in STATISTICS),
    ]
    lines += [
        f'{label:<27}' + ''.join(f'{number(value):>10}' for value in values)
        for label, _, values in rows(result)
    ]
    usual = ', '.join(
        f'{mode} {number(metrics[f"ate_{mode}_trans_rmse_m"])}'
        for mode in ('none', 'posyaw', 'se3', 'sim3')
    )
    lines += [
        '',
        f'ATE [m] by alignment: {usual} (scale {number(metrics["sim3_scale"])})',
        *_revisions(metrics),
        *_drift(metrics),
    ]
    lines += [f'warning: {warning}' for warning in summary.warnings[len(result.assumed) :]]
    if result.verdicts:
        lines += [''] + [
            f'{verdict.word}  {verdict.gate}  (is {number(verdict.value)})'
            for verdict in result.verdicts
        ]
    return '\n'.join(printable(line) for line in lines) + '\n'


def since_beginning(metrics: Mapping[str, float]) -> Iterator[str]:
    """Yield how much was tracked once the estimate had begun, where that was late."""
    if metrics['tracked_ratio'] - metrics['coverage_ratio'] > LATE_RATIO:
        yield (
            f'{percent(metrics["tracked_ratio"])} since the first estimate, after '
            f'{number(metrics["initialisation_s"])} s'
        )


def headline(result: Result) -> str:
    """Return the result in half a line."""
    metrics = result.summary.metrics
    return (
        f'{result.summary.association["pairs"]:,} pairs, '
        f'{percent(metrics["coverage_ratio"])} covered, '
        f'ATE {number(metrics["ate_trans_rmse_m"])} m, {number(metrics["ate_rot_rmse_deg"])} deg'
    )


class Row(NamedTuple):
    """
    One of the main errors.

    :param metric: its name, with ``*`` for the statistic.
    :param values: the seven statistics.
    """

    label: str
    metric: str
    values: list[float]


def rows(result: Result) -> Iterator[Row]:
    """
    Yield the statistics of each of the main errors.

    Displacement and distance stand in for the pose errors where orientations are unknown.
    """
    metrics = result.summary.metrics

    def row(label: str, prefix: str, unit: str) -> Row:
        values = [metrics[f'{prefix}_{statistic}_{unit}'] for statistic in STATISTICS]
        return Row(label, f'{prefix}_*_{unit}', values)

    yield row('ATE position [m]', 'ate_trans', 'm')
    yield row('ATE rotation [deg]', 'ate_rot', 'deg')
    kinds = ('disp', 'dist') if result.summary.pairs.rotations is None else ('trans', 'rot')
    for delta in result.config.rpe_deltas:
        for kind in kinds:
            unit = RPE_KINDS[kind]
            label = f'RPE {delta} {RPE_LABELS[kind]} [{unit}]'
            yield row(label, f'rpe_{delta}_{kind}', unit)


def single_figures(result: Result) -> Iterator[tuple[str, str, float]]:
    """Yield words, metric and value of all known figures that are no statistic of an error."""
    statistics = re.compile(f'_(?:{"|".join(STATISTICS)})_(?:m|deg)$')
    for metric, value in (*result.summary.metrics.items(), *result.live.items()):
        of_alignment = metric.startswith(ALIGNED)
        counted = value or not metric.endswith('_segments')
        if counted and not math.isnan(value) and (of_alignment or not statistics.search(metric)):
            yield in_words(metric), metric, value


def _revisions(metrics: Mapping[str, float]) -> Iterator[str]:
    if not math.isnan(metrics['loop_closure_gain']):
        yield (
            f'as first published: ATE {number(metrics["ate_causal_trans_rmse_m"])} m, '
            f'{number(metrics["ate_causal_rot_rmse_deg"])} deg; loop-closure gain '
            f'{number(metrics["loop_closure_gain"])} (ATE as last revised / as first published)'
        )


def _drift(metrics: Mapping[str, float]) -> Iterator[str]:
    if not math.isnan(metrics['drift_percent']):
        drift = number(metrics['drift_percent'])
        yield f'drift from the first pair to the last: {drift} % of the path'
    for name, value in metrics.items():
        if name.endswith('_trans_percent') and not math.isnan(value):
            prefix = name.removesuffix('_trans_percent')
            rotation = number(metrics[f'{prefix}_rot_deg_per_m'])
            length = prefix.removeprefix('segment_')
            label = 'KITTI drift' if prefix == 'kitti' else f'drift over {length}'
            yield (
                f'{label}: {number(value)} %, {rotation} deg/m '
                f'({metrics[f"{prefix}_segments"]} segments)'
            )
    if not math.isnan(metrics['nees_position_mean']):
        yield (
            f'NEES: position {number(metrics["nees_position_mean"])}, orientation '
            f'{number(metrics["nees_orientation_mean"])} (3 if consistent)'
        )


def described(one: Input) -> str:
    """Return an input with the number and rate of its poses."""
    facts = one.to_dict()
    rate = '' if facts['rate_hz'] is None else f', {facts["rate_hz"]:.4g} Hz'
    return f'{one.source}: {facts["poses"]:,} poses{rate}' + (
        ', positions only' if facts['position_only'] else ''
    )
