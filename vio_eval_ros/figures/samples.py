"""Figures of how errors are spread: histogram, cumulative curve, and boxes by length."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.figures.style import legend, line_style
from vio_eval_ros.figures.systems import MOST_POINTS, System
from vio_eval_ros.reports.plots import relative_samples, segment_samples, usual_lengths

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 30
Samples = list[tuple[str, dict[str, np.ndarray]]]
KINDS = (('errors', 'position error [m]'), ('angles', 'rotation error [deg]'))


def histogram(figure: Figure, systems: Sequence[System]) -> None:
    """Draw how often errors of each size are, as a share of the pairs."""

    def draw(axes: Axes, system: System, values: np.ndarray, edges: np.ndarray) -> None:
        counts, _ = np.histogram(values, edges)
        style = line_style(system, len(systems), len(edges))
        for name in ('marker', 'markevery', 'markersize'):
            style.pop(name, None)
        axes.stairs(100 * counts / len(values), edges, label=system.name, **style)

    _of_errors(figure, systems, draw, 'share of the pairs [%]')


def cumulative(figure: Figure, systems: Sequence[System]) -> None:
    """Draw which share of the errors is no larger than each size."""

    def draw(axes: Axes, system: System, values: np.ndarray, _: np.ndarray) -> None:
        ordered = np.sort(values)
        share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
        chosen = np.unique(
            np.linspace(0, len(ordered) - 1, min(len(ordered), MOST_POINTS)).round().astype(int)
        )
        style = line_style(system, len(systems), len(chosen))
        axes.plot(ordered[chosen], share[chosen], label=system.name, **style)

    _of_errors(figure, systems, draw, 'share of the pairs [%]')


def _of_errors(
    figure: Figure,
    systems: Sequence[System],
    draw: Callable[[Axes, System, np.ndarray, np.ndarray], None],
    label: str,
) -> None:
    oriented = any(system.oriented for system in systems)
    row = figure.subplots(1, 1 + oriented, sharey=True, squeeze=False)[0]
    for axes, (kind, title) in zip(row, KINDS, strict=False):
        found = {system: getattr(system.run, kind) for system in systems}
        found = {system: v[np.isfinite(v)] for system, v in found.items()}
        found = {system: values for system, values in found.items() if len(values)}
        edges = np.linspace(0, max(v.max() for v in found.values()) or 1.0, BINS + 1)
        for system, values in found.items():
            draw(axes, system, values, edges)
        axes.set_xlabel(title)
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
    row[0].set_ylabel(label)
    if len(systems) > 1:
        legend(figure, systems, truth=False)


def rpe(figure: Figure, systems: Sequence[System]) -> None:
    """Draw boxes of the relative error over each delta, grouped by system."""
    _boxes(figure, systems, relative_samples, 'rpe', 'delta')


def segments(figure: Figure, systems: Sequence[System]) -> None:
    """Draw boxes of the drift over lengths of path, grouped by system."""
    first = systems[0].result
    given = first.config.segment_lengths_m
    lengths = given or usual_lengths(first.summary.metrics['path_length_m'])

    def samples(result: Result) -> Samples:
        return segment_samples(result, lengths)

    _boxes(figure, systems, samples, 'segments', 'sub-trajectory')


def _boxes(
    figure: Figure,
    systems: Sequence[System],
    samples: Callable[[Result], Samples],
    name: str,
    label: str,
) -> None:
    found = {system: dict(samples(system.result)) for system in systems}
    titles = list(dict.fromkeys(title for of in found.values() for title in of))
    if not titles:
        raise ConfigError(
            f'{name}: there is nothing to draw; the run is too short for it or has no '
            'orientations: leave this figure out'
        )
    row = figure.subplots(1, len(titles), squeeze=False)[0]
    for axes, title in zip(row, titles, strict=True):
        _grouped(axes, {system: of.get(title, {}) for system, of in found.items()})
        axes.set_ylabel(f'RPE, {title}' if name == 'rpe' else title)
        axes.set_xlabel(label)
    if len(systems) > 1:
        legend(figure, systems, truth=False)


def _grouped(axes: Axes, found: Mapping[System, Mapping[str, np.ndarray]]) -> None:
    """Draw the boxes of each system beside each other, in groups of one delta or length."""
    groups = list(dict.fromkeys(group for of in found.values() for group in of))
    width = 0.8 / len(found)
    for place, (system, of) in enumerate(found.items()):
        offset = (place - (len(found) - 1) / 2) * width
        at = [groups.index(group) + offset for group in of]
        colour = system.look.colour
        drawn = axes.boxplot(
            [values[np.isfinite(values)] for values in of.values()],
            positions=at, widths=0.75 * width, whis=(5, 95), showfliers=False,
            patch_artist=True, manage_ticks=False,
            boxprops={'facecolor': f'{colour}55', 'edgecolor': colour, 'linewidth': 0.7},
            medianprops={'color': 'black', 'linewidth': 0.9},
            whiskerprops={'color': colour, 'linewidth': 0.7},
            capprops={'color': colour, 'linewidth': 0.7},
        )  # fmt: skip
        medians = [float(line.get_ydata()[0]) for line in drawn['medians']]  # type: ignore[index]
        if len(found) > 1:
            axes.plot(at, medians, system.look.marker, color=colour, markersize=2.2)
    axes.set_xticks(range(len(groups)), groups)
    axes.set_xlim(-0.6, len(groups) - 0.4)
    axes.set_ylim(bottom=0)
    axes.grid(visible=False, axis='x')
