"""A run as a terminal shows it: the error over time in a line, the paths from above in braille."""

from __future__ import annotations

from collections.abc import Mapping
import math

import numpy as np

from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.terminal import drawn, sparkline
from vio_eval_ros.rendering.text import number, printable
from vio_eval_ros.reports.drawn_run import DrawnRun


def terminal_picture(results: Mapping[str, Result]) -> str:
    """
    Return the pictures of the estimates of one ground truth, by the names of their systems.

    :raises ConfigError: where plotext is not installed.
    """
    runs = {
        name: DrawnRun.of(result)
        for name, result in results.items()
        if not math.isnan(result.summary.metrics['ate_trans_rmse_m'])
    }
    if not runs:
        return '\nnothing can be drawn: the alignment is not determined\n'
    lines = ['']
    for name, run in runs.items():
        of = f'{printable(name)}: ' if len(runs) > 1 else ''
        lines += [
            f'{of}position error from {run.seconds[0]:.1f} to {run.seconds[-1]:.1f} s, '
            f'up to {number(float(np.nanmax(run.errors)))} m',
            sparkline(run.seconds, run.errors),
        ]
    first = next(iter(runs.values()))
    horizontal = ['xyz'.index(axis) for axis in first.axes_from_above]
    paths = {'ground truth': first.truth} | {name: run.estimate for name, run in runs.items()}
    shown = {
        printable(name): (path - first.origin)[np.linspace(0, len(path) - 1, 2000).astype(int)]
        for name, path in paths.items()
    }
    labels = [first.labels[k] for k in horizontal]
    above = drawn({name: path[:, horizontal] for name, path in shown.items()}, labels)
    return '\n'.join([*lines, '', 'from above', above]) + '\n'
