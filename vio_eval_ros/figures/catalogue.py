"""Which figures there are, and how they become files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import io
from pathlib import Path
from typing import NamedTuple, TYPE_CHECKING

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.figures.paths import error_path, projections, top
from vio_eval_ros.figures.samples import cumulative, histogram, rpe, segments
from vio_eval_ros.figures.style import theme, WIDTHS
from vio_eval_ros.figures.systems import System, systems_of
from vio_eval_ros.figures.times import error_xyz, errors, rpy, xyz

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ('pdf', 'svg', 'png')
#: so that the same figure is the same file
METADATA = {'pdf': {'CreationDate': None}, 'svg': {'Date': None}, 'png': {}}


class Kind(NamedTuple):
    """
    A figure.

    :param draw: draws the systems into an empty figure.
    :param words: what it shows.
    :param heights: of one and of two columns, as shares of the width.
    """

    draw: Callable[[Figure, Sequence[System]], None]
    words: str
    heights: tuple[float, float]


FIGURES: dict[str, Kind] = {
    'top': Kind(top, 'paths from above', (0.95, 0.6)),
    'projections': Kind(projections, 'paths from three sides', (1.0, 0.75)),
    'xyz': Kind(xyz, 'x, y and z over time', (1.05, 0.55)),
    'rpy': Kind(rpy, 'roll, pitch and yaw over time', (1.05, 0.55)),
    'errors': Kind(errors, 'position and rotation error over time', (0.85, 0.42)),
    'error_xyz': Kind(error_xyz, 'error along each axis, with 3 sigma', (1.05, 0.55)),
    'error_path': Kind(error_path, 'errors as colours along the path', (0.5, 0.42)),
    'histogram': Kind(histogram, 'how often errors of each size are', (0.65, 0.38)),
    'cumulative': Kind(cumulative, 'share of errors up to each size', (0.65, 0.38)),
    'rpe': Kind(rpe, 'relative error over each delta, as boxes', (0.65, 0.38)),
    'segments': Kind(segments, 'drift over lengths of path, as boxes', (0.65, 0.38)),
}


def check_figures(names: Iterable[str]) -> None:
    """
    Check names of figures.

    :raises ConfigError: there is no such figure.
    """
    for name in names:
        if name not in FIGURES:
            near = nearest_name(name, FIGURES) or f'; there are {", ".join(FIGURES)}'
            raise ConfigError(f"there is no figure '{name}'{near}")


def draw(name: str, runs: Mapping[str, Result | Sequence[Result]], columns: int = 1) -> Figure:
    """
    Return a figure; its look is that of the :func:`theme` around the call.

    :param runs: a result, or those of several runs, by the name of the system.
    :param columns: of the page that it spans, 1 or 2.
    :raises ConfigError: there is no such figure, or nothing to draw.
    """
    check_figures([name])
    systems = systems_of(runs)
    from matplotlib.figure import Figure

    kind, width = FIGURES[name], WIDTHS[columns]
    height = kind.heights[columns - 1] * width
    if kind.draw is error_path:
        height *= len(systems)
    figure = Figure(figsize=(width, height), layout='constrained')
    kind.draw(figure, systems)
    return figure


def rendered(
    name: str,
    runs: Mapping[str, Result | Sequence[Result]],
    file_format: str,
    *,
    columns: int = 1,
    style: Path | None = None,
) -> bytes:
    """Return a figure as a file of one of :data:`FORMATS`; the rest as :func:`draw`."""
    return pages([name], runs, file_format, columns=columns, style=style)


def pages(
    names: Sequence[str],
    runs: Mapping[str, Result | Sequence[Result]],
    file_format: str = 'pdf',
    *,
    columns: int = 1,
    style: Path | None = None,
) -> bytes:
    """Return figures as the pages of one PDF, or one figure in another format."""
    content = io.BytesIO()
    with theme(style):
        drawn = [draw(name, runs, columns) for name in names]
        if file_format == 'pdf':
            from matplotlib.backends.backend_pdf import PdfPages

            with PdfPages(content, metadata=METADATA['pdf']) as pdf:
                for figure in drawn:
                    pdf.savefig(figure)
        else:
            drawn[0].savefig(content, format=file_format, metadata=METADATA[file_format])
    return content.getvalue()
