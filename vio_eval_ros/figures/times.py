"""Figures over time: position, attitude and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TYPE_CHECKING

import numpy as np

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.figures.style import legend, line_style
from vio_eval_ros.figures.systems import System
from vio_eval_ros.rendering.palette import TRUTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TIME = 'time [s]'
MOST_MARKS = 50
GAP = '#dcdfe3'
TRUTH_STYLE: dict[str, Any] = {
    'color': TRUTH, 'linewidth': 1.8, 'alpha': 0.55, 'label': 'ground truth',
}  # fmt: skip


def xyz(figure: Figure, systems: Sequence[System]) -> None:
    """Draw x, y and z over time, with the truth."""
    rows = figure.subplots(3, 1, sharex=True)
    longest = max(systems, key=lambda system: system.tracked_s)
    seconds, truth = longest.outline
    for axes, column in zip(rows, truth.T, strict=True):
        axes.plot(seconds, column, **TRUTH_STYLE)
    for system in systems:
        _three(rows, system, system.run.estimate - longest.run.origin, len(systems))
    for axes, label in zip(rows, longest.run.labels, strict=True):
        axes.set_ylabel(label)
    _finish(figure, rows, systems)


def rpy(figure: Figure, systems: Sequence[System]) -> None:
    """Draw roll, pitch and yaw over time, with the truth."""
    oriented = [system for system in systems if system.run.attitudes is not None]
    if not oriented:
        raise ConfigError('rpy: there are no orientations to draw; leave this figure out')
    rows = figure.subplots(3, 1, sharex=True)
    longest = max(oriented, key=lambda system: system.tracked_s)
    shared, _ = np.asarray(longest.run.attitudes)
    _three(rows, longest, shared, None)
    for system in oriented:
        truth, estimate = np.asarray(system.run.attitudes)
        # each was unwrapped by itself, from where it begins
        at = [np.interp(system.run.seconds, longest.run.seconds, column) for column in shared.T]
        turns = np.round((np.stack(at, axis=1) - truth) / 360.0)
        _three(rows, system, estimate + 360.0 * turns, len(systems))
    for axes, label in zip(rows, ('roll [deg]', 'pitch [deg]', 'yaw [deg]'), strict=True):
        axes.set_ylabel(label)
    _finish(figure, rows, oriented)


def _three(rows: Sequence[Axes], system: System, values: np.ndarray, count: int | None) -> None:
    """Draw the (N, 3) values of a system; as the truth where no count of systems is given."""
    for axes, column in zip(rows, values.T, strict=True):
        curve = system.run.over_time(column)
        if count is None:
            axes.plot(*curve, **TRUTH_STYLE)
        else:
            axes.plot(*curve, label=system.name, **line_style(system, count, len(curve.x)))


def errors(figure: Figure, systems: Sequence[System]) -> None:
    """Draw the errors of position and rotation over time; gaps, jumps and start are marked."""
    oriented = any(system.oriented for system in systems)
    rows = list(figure.subplots(1 + oriented, 1, sharex=True, squeeze=False)[:, 0])
    for system in systems:
        curve = system.run.over_time(system.run.errors)
        style = line_style(system, len(systems), len(curve.x))
        rows[0].plot(*curve, label=system.name, **style)
        at = [k for k, _ in system.run.jumps[:MOST_MARKS]]
        rows[0].plot(
            system.run.seconds[at], system.run.errors[at], 'D', label='jump', markersize=4.5,
            markerfacecolor='none', markeredgecolor='black', markeredgewidth=0.7,
        )  # fmt: skip
        if system.oriented:
            rows[1].plot(*system.run.over_time(system.run.angles), label=system.name, **style)
    rows[0].set_ylabel('position error [m]')
    if oriented:
        rows[1].set_ylabel('rotation error [deg]')
    for axes in rows:
        axes.set_ylim(bottom=0)
    _marks(rows, systems)
    _finish(figure, rows, systems, truth=False)


def error_xyz(figure: Figure, systems: Sequence[System]) -> None:
    """Draw the error along x, y and z over time, with three sigma of the estimate's covariance."""
    rows = figure.subplots(3, 1, sharex=True)
    for system in systems:
        _three(rows, system, system.run.estimate - system.run.truth, len(systems))
        sigma = system.run.three_sigma
        if sigma is None:
            continue
        for axes, column in zip(rows, sigma.T, strict=True):
            time, bound = system.run.over_time(column)
            axes.fill_between(
                time, -bound, bound, color=system.look.colour, alpha=0.18, linewidth=0,
                label='3 sigma',
            )  # fmt: skip
    for axes, name in zip(rows, 'xyz', strict=True):
        axes.set_ylabel(f'{name} error [m]')
    _marks(rows, systems)
    _finish(figure, rows, systems, truth=False)


def _marks(rows: Sequence[Axes], systems: Sequence[System]) -> None:
    """Shade the gaps of a single system, and say where an estimate begins late."""
    if len(systems) > 1:  # the lines themselves are interrupted
        return
    run = systems[0].run
    longest = sorted(run.gaps, key=lambda gap: gap[0] - gap[1])[:MOST_MARKS]
    for begin, end in longest:
        for axes in rows:
            axes.axvspan(begin, end, color=GAP, linewidth=0, zorder=0)
        words = 'initialisation' if end == run.seconds[0] else 'no pairs'
        if end - begin > 0.08 * run.end:
            rows[0].annotate(
                words, ((begin + end) / 2, 0.94), xycoords=('data', 'axes fraction'),
                ha='center', va='top', size=6, color=TRUTH,
            )  # fmt: skip


def _finish(
    figure: Figure, rows: Sequence[Axes], systems: Sequence[System], truth: bool = True
) -> None:
    for axes in rows:
        axes.margins(x=0)
        axes.locator_params(axis='y', nbins=5)
    rows[-1].set_xlim(0.0, max(system.run.end for system in systems) or None)
    rows[-1].set_xlabel(TIME)
    figure.align_ylabels(rows)
    if truth or len(systems) > 1:
        legend(figure, systems, truth)
