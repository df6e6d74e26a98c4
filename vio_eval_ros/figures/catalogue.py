"""Which figures there are, and how they become files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import io
from pathlib import Path
from typing import NamedTuple, TYPE_CHECKING

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.figures.maps import Map
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

    :param draw: draws systems into an empty figure; those of MAPPED, on a map.
    :param words: what it shows.
    :param heights: of one and of two columns, as shares of the width.
    """

    draw: Callable[..., None]
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


#: figures that may have a map beneath
MAPPED = ('top', 'projections')


def check_figures(names: Iterable[str]) -> None:
    """
    Check names of figures.

    :raises ConfigError: there is no such figure.
    """
    for name in names:
        if name not in FIGURES:
            near = nearest_name(name, FIGURES) or f'; there are {", ".join(FIGURES)}'
            raise ConfigError(f"there is no figure '{name}'{near}")


class Page(NamedTuple):
    """
    A figure of some size.

    :param width: inches, as ``height``.
    :param fill: draws into the empty figure.
    :param title: at its top; empty for none.
    """

    width: float
    height: float
    fill: Callable[[Figure], None]
    title: str = ''

    def drawn(self) -> Figure:
        """Return the figure; its look is that of the :func:`theme` around the call."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(self.width, self.height), layout='constrained')
        if self.title:
            figure.suptitle(self.title, parse_math=False)
        self.fill(figure)
        return figure


def draw(
    name: str,
    runs: Mapping[str, Result | Sequence[Result]],
    columns: int = 1,
    order: Sequence[str] = (),
    beneath: Map | None = None,
) -> Figure:
    """
    Return a figure; its look is that of the :func:`theme` around the call.

    :param runs: a result, or those of several runs, by the name of the system.
    :param columns: of the page that it spans, 1 or 2.
    :param order: of all systems, also those without a result.
    :param beneath: the paths, in ``top`` and ``projections``.
    :raises ConfigError: there is no such figure, or nothing to draw.
    """
    return _page(name, systems_of(runs, order), columns, beneath).drawn()


def _page(name: str, systems: Sequence[System], columns: int, beneath: Map | None = None) -> Page:
    check_figures([name])
    kind, width = FIGURES[name], WIDTHS[columns]
    height = kind.heights[columns - 1] * width * (len(systems) if name == 'error_path' else 1)
    more = (beneath,) if name in MAPPED else ()
    return Page(width, height, lambda figure: kind.draw(figure, systems, *more))


def pages(
    names: Sequence[str],
    runs: Mapping[str, Result | Sequence[Result]],
    file_format: str = 'pdf',
    *,
    columns: int = 1,
    style: Path | None = None,
    order: Sequence[str] = (),
    beneath: Map | None = None,
) -> bytes:
    """
    Return figures as the pages of one PDF, or one figure in another of :data:`FORMATS`.

    Other parameters are those of :func:`draw`, :func:`theme` and :func:`systems_of`.
    """
    with theme(style):
        systems = systems_of(runs, order)
        return saved([_page(name, systems, columns, beneath) for name in names], file_format)


def saved(content: Sequence[Page], file_format: str) -> bytes:
    """Return pages as a file; only a PDF has more than one."""
    file = io.BytesIO()
    if file_format == 'pdf':
        from matplotlib.backends.backend_pdf import PdfPages

        with PdfPages(file, metadata=METADATA['pdf']) as pdf:
            for page in content:
                pdf.savefig(page.drawn())
    else:
        (page,) = content
        page.drawn().savefig(file, format=file_format, metadata=METADATA[file_format])
    return file.getvalue()
