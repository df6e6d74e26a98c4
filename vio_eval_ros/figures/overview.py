"""Pictures of a whole evaluation: one that holds several figures, and the spread of runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TYPE_CHECKING

import numpy as np

from vio_eval_ros.figures.paths import top
from vio_eval_ros.figures.samples import cumulative, histogram, rpe
from vio_eval_ros.figures.style import legend
from vio_eval_ros.figures.systems import System
from vio_eval_ros.figures.times import errors, rpy, xyz
from vio_eval_ros.rendering.palette import look
from vio_eval_ros.rendering.text import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: values of the runs of a system; NaN where a run has none
Runs = Mapping[str, np.ndarray]


def overview(figure: Figure, systems: Sequence[System]) -> None:
    """Draw paths, errors, positions, attitudes and relative errors, with one legend."""
    has_attitudes = any(system.run.attitudes is not None for system in systems)
    has_rpe = any(system.has_relative_errors for system in systems)
    drawn = [
        top,
        errors,
        xyz,
        rpy if has_attitudes else histogram,
        cumulative,
        *([rpe] if has_rpe else []),
    ]
    panels: Any = figure.subfigures(3, 2, height_ratios=[1.1, 1.2, 0.9])
    for draw, panel in zip(drawn, panels.flat, strict=False):
        draw(panel, systems)
    legend(figure, systems)


def spread(figure: Figure, values: Mapping[str, Runs], label: str) -> None:
    """
    Draw the value of each run, with the median of each system, grouped by sequence.

    :param values: by sequence and system, (N,) values of runs; NaN of a run that failed.
    :param label: of the values, with their unit.
    """
    axes = figure.subplots()
    names = list(dict.fromkeys(name for of in values.values() for name in of))
    width = 0.8 / len(names)
    for place, name in enumerate(names):
        colour, _, marker = look(place)
        for group, of in enumerate(values.values()):
            runs = of.get(name, np.empty(0))
            at, known = group + (place - (len(names) - 1) / 2) * width, runs[np.isfinite(runs)]
            shift = np.linspace(-0.25, 0.25, len(known)) * width if len(known) > 1 else 0.0
            axes.plot(at + shift + 0 * known, known, marker, color=colour, label=name)
            if len(known) > 1:
                median = float(np.median(known))
                axes.hlines(median, at - 0.4 * width, at + 0.4 * width, color=colour)
            if words := _lacking(of, name):
                axes.annotate(
                    words, (at, 0.98), xycoords=('data', 'axes fraction'), color=colour, size=6,
                    rotation=90, ha='center', va='top',
                )  # fmt: skip
    axes.set_xticks(range(len(values)), [printable(name) for name in values])
    axes.set_xlim(-0.6, len(values) - 0.4)
    axes.set_ylabel(label)
    axes.grid(visible=False, axis='x')
    found = np.concatenate(
        [runs[np.isfinite(runs)] for of in values.values() for runs in of.values()]
    )
    if len(found) and found.min() > 0 and found.max() > 20 * found.min():
        axes.set_yscale('log')
    else:
        axes.set_ylim(bottom=0)
    if len(names) > 1:
        _names(figure, names)


def _lacking(of: Runs, name: str) -> str:
    """Return what to write in the place of values of a system; empty where all are there."""
    if name not in of or not len(of[name]):
        return 'no run'
    failed = int(np.isnan(of[name]).sum())
    return '' if not failed else f'{failed} failed' if len(of[name]) > 1 else 'failed'


def _names(figure: Figure, names: Sequence[str]) -> None:
    """Draw a legend of markers."""
    from matplotlib.lines import Line2D

    from vio_eval_ros.figures.style import columns_of

    marks = [
        Line2D([], [], linestyle='', color=look(k).colour, marker=look(k).marker,
               label=printable(name).replace('$', r'\$'))
        for k, name in enumerate(names)
    ]  # fmt: skip
    figure.legend(handles=marks, loc='outside upper center', ncols=columns_of(figure, names))
