"""Figures in space: from above, from three sides, and coloured by error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vio_eval_ros.core.intervals import longest_tracked
from vio_eval_ros.figures.style import legend, line_style, plain_name
from vio_eval_ros.figures.systems import System
from vio_eval_ros.rendering.palette import TRUTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIDES = ('xy', 'xz', 'zy')


def top(figure: Figure, systems: Sequence[System]) -> None:
    """Draw the paths from above."""
    axes = figure.subplots()
    draw_paths(axes, systems, systems[0].run.axes_from_above)
    legend(figure, systems)


def projections(figure: Figure, systems: Sequence[System]) -> None:
    """Draw the paths from three sides."""
    run = systems[0].run
    extent = np.ptp(np.vstack([run.truth, run.estimate]), axis=0)
    # flat sides keep room for their labels
    x, y, z = np.maximum(extent, max(0.3 * float(extent.max()), 1e-6)).tolist()
    grid = figure.add_gridspec(2, 2, width_ratios=[x, z], height_ratios=[y, z])
    for place, names in zip((grid[0, 0], grid[1, 0], grid[0, 1]), SIDES, strict=True):
        draw_paths(figure.add_subplot(place), systems, names)
    legend(figure, systems)


def draw_paths(axes: Axes, systems: Sequence[System], names: str) -> None:
    """Draw truth and estimates along two axes, with equal scales and a scale bar."""
    across, up = ('xyz'.index(name) for name in names)
    outline = _outline(systems[0])
    axes.plot(outline[:, across], outline[:, up], color=TRUTH, linewidth=1.4, alpha=0.55)
    for system in systems:
        line = system.path(system.run.estimate)
        style = line_style(system, len(systems), len(line))
        axes.plot(line[:, across], line[:, up], label=system.name, **style)
    axes.plot(*outline[0, [across, up]], 'o', color=TRUTH, markersize=3.5)
    label_places(axes, systems[0], names)


def label_places(axes: Axes, system: System, names: str) -> None:
    """Label two axes of places, with equal scales and a scale bar."""
    across, up = ('xyz'.index(name) for name in names)
    axes.set_xlabel(system.run.labels[across])
    axes.set_ylabel(system.run.labels[up])
    axes.set_aspect('equal', adjustable='datalim')
    axes.locator_params(nbins=4)
    _scale_bar(axes, np.ptp(system.run.truth[:, across]))


def _outline(system: System) -> np.ndarray:
    """Return (N, 3) places of the truth, also where the estimate has none."""
    run = system.run
    if run.whole is None or len(run.whole) < 2:
        return system.path(run.truth)
    steps = np.diff(run.whole.stamps_ns) / 1e9
    longest = longest_tracked(run.longest_s, float(np.median(steps)))
    holes = np.flatnonzero(steps > longest) + 1
    return np.insert(run.whole.positions - run.origin, holes, np.nan, axis=0)


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
    box = AnchoredOffsetbox(loc='lower right', child=packed, frameon=True, pad=0.2)
    box.patch.set(edgecolor='none', alpha=0.8)
    axes.add_artist(box)


def error_path(figure: Figure, systems: Sequence[System]) -> None:
    """Draw each path in the colours of its errors of translation and of rotation."""
    oriented = any(system.oriented for system in systems)
    grid = figure.subplots(len(systems), 1 + oriented, squeeze=False)
    for row, system in zip(grid, systems, strict=True):
        if len(systems) > 1:
            row[0].set_title(plain_name(system), loc='left')
        _coloured(figure, row[0], system, system.run.errors, 'position error [m]')
        if system.oriented:
            _coloured(figure, row[1], system, system.run.angles, 'rotation error [deg]')
        elif oriented:
            row[1].set_axis_off()


def _coloured(figure: Figure, axes: Axes, system: System, errors: np.ndarray, label: str) -> None:
    from matplotlib.collections import LineCollection

    names = system.run.axes_from_above
    across, up = ('xyz'.index(name) for name in names)
    outline = _outline(system)
    axes.plot(outline[:, across], outline[:, up], color='#b5b9bf', linewidth=0.8)
    chosen = system.chosen
    places = (system.run.estimate - system.run.origin)[chosen][:, [across, up]]
    pieces = np.stack([places[:-1], places[1:]], axis=1)[~system.run.gap_between(chosen)]
    # of two ends the worse one: a line never looks better than the pairs at its ends
    worst = np.maximum(errors[chosen][:-1], errors[chosen][1:])
    lines = LineCollection(list(pieces), linewidths=1.6, rasterized=len(pieces) > 1000)
    lines.set_array(worst[~system.run.gap_between(chosen)])
    lines.set_clim(0.0, max(float(np.nanquantile(errors, 0.95)), 1e-9))
    axes.add_collection(lines)
    axes.autoscale_view()
    bar = figure.colorbar(lines, ax=axes, extend='max', shrink=0.85, aspect=25, pad=0.02)
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]
    label_places(axes, system, names)
