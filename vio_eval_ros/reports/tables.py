"""Reports in tables: every pair as CSV and TUM files, the statistics for LaTeX."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math

import numpy as np

from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.metrics import position_errors, rotation_errors
from vio_eval_ros.core.statistics import STATISTICS
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.text import number
from vio_eval_ros.rendering.tum import formatted, tum
from vio_eval_ros.reports.text import rows


def pair_errors(result: Result) -> dict[str, np.ndarray]:
    """
    Return the errors of the N pairs in columns, under the alignment of the result.

    Stamps are int64 nanoseconds as recorded, without the time offset; ``error_x_m`` and so on are
    the aligned estimate minus the ground truth, in the world of the ground truth. Rotation errors
    are NaN where they are not known.
    """
    pairs, alignment = result.summary.pairs, result.summary.alignment
    difference = alignment.positions(pairs.estimate.positions) - pairs.ground_truth.positions
    return {
        'estimate_stamp_ns': pairs.estimate.stamps_ns - nanoseconds(result.config.time_offset_s),
        'ground_truth_stamp_ns': pairs.ground_truth.stamps_ns,
        'ate_trans_m': position_errors(pairs, alignment),
        'ate_rot_deg': rotation_errors(pairs, alignment),
        **{f'error_{axis}_m': difference[:, k] for k, axis in enumerate('xyz')},
    }


def csv_report(result: Result) -> str:
    """Return the stamps, as recorded, and errors of each pair; unknown values are empty."""
    columns = pair_errors(result)
    estimate, truth, *errors = columns.values()
    table = formatted(np.column_stack(errors), '%.9g,%.9g,%.9g,%.9g,%.9g').replace('nan', '')
    stamps = zip(estimate.tolist(), truth.tolist(), table.splitlines(), strict=True)
    return ''.join([','.join(columns), '\n', *(f'{e},{t},{row}\n' for e, t, row in stamps)])


def tum_report(result: Result) -> str:
    """Return the associated estimate, aligned to the ground truth, as a TUM file."""
    return tum(aligned(result))


def latex_report(result: Result) -> str:
    """Return the statistics of the errors as a LaTeX table (booktabs)."""
    from tabulate import tabulate

    table = [[label, *map(number, values)] for label, _, values in rows(result)]
    sides = ('left', *['right'] * len(STATISTICS))
    heads = ['error', *STATISTICS]
    text = tabulate(table, heads, 'latex_booktabs', colalign=sides, disable_numparse=True)
    return text + '\n'


def aligned(result: Result) -> Trajectory:
    """
    Return the associated estimate in the world of the ground truth.

    :raises ConfigError: where there is none, since the alignment is not determined.
    """
    trajectory = result.summary.alignment.apply(result.summary.pairs.estimate)
    if math.isnan(trajectory.positions.sum()):
        raise ConfigError('there is no aligned trajectory: the alignment is not determined')
    return trajectory


def series_csv(rows: Iterable[tuple[int, Mapping[str, float]]]) -> str:
    """Return stamps and running values as CSV, a line per row; unknown values are empty."""
    lines: list[str] = []
    for stamp_ns, values in rows:
        if not lines:
            lines.append(','.join(['stamp_ns', *values]))
        numbers = ('' if math.isnan(value) else repr(value) for value in values.values())
        lines.append(','.join([str(stamp_ns), *numbers]))
    return '\n'.join(lines) + '\n'
