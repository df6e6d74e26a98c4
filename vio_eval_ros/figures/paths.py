"""Figures in space: from above, from three sides, and coloured by error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.figures.maps import Map
from vio_eval_ros.figures.style import legend, line_style, plain_name
from vio_eval_ros.figures.systems import System
from vio_eval_ros.rendering.palette import TRUTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

SIDES = ('xy', 'xz', 'zy')


def top(figure: Figure, systems: Sequence[System], beneath: Map | None = None) -> None:
    """Draw the paths from above, on a map if there is one."""
    axes = figure.subplots()
    names = systems[0].run.axes_from_above
    draw_paths(axes, systems, names)
    if beneath is not None:
        if names != 'xy':
            raise ConfigError(
                f'top: a map lies in x and y, but this run is seen in {names[0]} and {names[1]}; '
                'draw projections instead'
            )
        beneath.draw(axes, systems[0].run.origin)
    legend(figure, systems)


def projections(figure: Figure, systems: Sequence[System], beneath: Map | None = None) -> None:
    """Draw the paths from three sides, x and y on a map if there is one."""
    run = systems[0].run
    extent = np.ptp(np.vstack([run.truth, run.estimate]), axis=0)
    # flat sides keep room for their labels
    x, y, z = np.maximum(extent, max(0.3 * float(extent.max()), 1e-6)).tolist()
    grid = figure.add_gridspec(2, 2, width_ratios=[x, z], height_ratios=[y, z])
    for place, names in zip((grid[0, 0], grid[1, 0], grid[0, 1]), SIDES, strict=True):
        axes = figure.add_subplot(place)
        draw_paths(axes, systems, names)
        if beneath is not None and names == 'xy':
            beneath.draw(axes, run.origin)
    legend(figure, systems)


def draw_paths(axes: Axes, systems: Sequence[System], names: str) -> None:
    """Draw truth and estimates along two axes, with equal scales."""
    across, up = ('xyz'.index(name) for name in names)
    outline = systems[0].outline.y
    axes.plot(outline[:, across], outline[:, up], color=TRUTH, linewidth=1.4, alpha=0.55)
    for system in systems:
        line = system.path(system.run.estimate)
        style = line_style(system, len(systems), len(line))
        axes.plot(line[:, across], line[:, up], label=system.name, **style)
    axes.plot(*outline[0, [across, up]], 'o', color=TRUTH, markersize=3.5)
    label_places(axes, systems[0], names)


def label_places(axes: Axes, system: System, names: str) -> None:
    """Label two axes of places, with equal scales and, seen from above, a scale bar."""
    across, up = ('xyz'.index(name) for name in names)
    axes.set_xlabel(system.run.labels[across])
    axes.set_ylabel(system.run.labels[up])
    axes.set_aspect('equal', adjustable='datalim')
    axes.locator_params(nbins=4)
    if names == system.run.axes_from_above:
        _scale_bar(axes, float(np.ptp(system.run.truth[:, across])))


def _scale_bar(axes: Axes, extent: float) -> None:
    """Draw a bar of a round length, about a fifth of the extent [m]."""
    if not extent > 0:
        return
    from matplotlib.offsetbox import AnchoredOffsetbox, AuxTransformBox, TextArea, VPacker
    from matplotlib.patches import Rectangle

    decade = 10.0 ** np.floor(np.log10(extent / 4))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= extent / 4)
    bar = AuxTransformBox(axes.transData)
    bar.add_artist(Rectangle((0, 0), length, 0, edgecolor=TRUTH, linewidth=1.5, fill=False))
    text = TextArea(f'{length:g} m', textprops={'size': 6, 'color': TRUTH})
    packed = VPacker(children=[bar, text], align='center', pad=0, sep=1.5)
    # above the axes, where it hides nothing
    box = AnchoredOffsetbox(
        loc='lower right', child=packed, frameon=False, pad=0.1, borderpad=0.1,
        bbox_to_anchor=(1.0, 1.0), bbox_transform=axes.transAxes,
    )  # fmt: skip
    axes.add_artist(box)


def error_path(figure: Figure, systems: Sequence[System]) -> None:
    """Draw each path in the colours of its errors of translation and of rotation."""
    oriented = any(system.oriented for system in systems)
    grid = figure.subplots(len(systems), 1 + oriented, squeeze=False)
    labelled: list[LineCollection] = []
    # the same colour is the same error in all of them
    hottest = [
        max(_hottest(getattr(system.run, kind)) for system in systems)
        for kind in ('errors', 'angles')
    ]
    for row, system in zip(grid, systems, strict=True):
        if len(systems) > 1:
            row[0].set_title(plain_name(system), loc='left')
        drawn = [_coloured(row[0], system, system.run.errors, hottest[0])]
        if system.oriented:
            drawn.append(_coloured(row[1], system, system.run.angles, hottest[1]))
            labelled = drawn
        elif oriented:
            row[1].set_axis_off()
        else:
            labelled = drawn
    for k, lines in enumerate(labelled):
        bar = figure.colorbar(
            lines, ax=list(grid[:, k]), location='bottom', extend='max', shrink=0.9, aspect=30
        )
        bar.set_label(('position error [m]', 'rotation error [deg]')[k])
        bar.outline.set_linewidth(0.4)  # type: ignore[operator]


def _hottest(errors: np.ndarray) -> float:
    """Return the error with the last colour: the 95th percentile, as in the HTML report."""
    known = errors[np.isfinite(errors)]
    return max(float(np.quantile(known, 0.95)), 1e-9) if len(known) else 1e-9


def _coloured(axes: Axes, system: System, errors: np.ndarray, hottest: float) -> LineCollection:
    """Draw one path; return what has its colours."""
    from matplotlib.collections import LineCollection

    names = system.run.axes_from_above
    across, up = ('xyz'.index(name) for name in names)
    outline = system.outline.y
    axes.plot(outline[:, across], outline[:, up], color='#b5b9bf', linewidth=0.8)
    chosen = system.chosen
    places = (system.run.estimate - system.run.origin)[chosen][:, [across, up]]
    pieces = np.stack([places[:-1], places[1:]], axis=1)[~system.run.gap_between(chosen)]
    # of two ends the worse one: a line never looks better than the pairs at its ends
    worst = np.maximum(errors[chosen][:-1], errors[chosen][1:])
    lines = LineCollection(list(pieces), linewidths=1.6, rasterized=len(pieces) > 1000)
    lines.set_array(worst[~system.run.gap_between(chosen)])
    lines.set_clim(0.0, hottest)
    axes.add_collection(lines)
    axes.autoscale_view()
    label_places(axes, system, names)
    return lines
