"""The look that figures share: the theme, the lines of systems, one legend."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TYPE_CHECKING

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.figures.systems import System
from vio_eval_ros.rendering.palette import TRUTH
from vio_eval_ros.rendering.text import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: inches of one and of two columns, as IEEE journals have them
WIDTHS = {1: 3.5, 2: 7.16}
#: on a line, of every system after the first
MARKS = 9
#: of a legend
INCHES_PER_LETTER = 0.056
MISSING = "figures need matplotlib: pip install 'vio_eval_ros[plot]'"


def check_installed(formats: Iterable[str]) -> None:
    """
    Check that reports of some formats can be drawn, before anything long is read.

    :raises ConfigError: one is a picture, and matplotlib is not installed.
    """
    from importlib.util import find_spec

    if not {'pdf', 'png', 'svg'}.isdisjoint(formats) and find_spec('matplotlib') is None:
        raise ConfigError(MISSING)


@contextmanager
def theme(file: Path | None = None) -> Iterator[None]:
    """
    Set matplotlib's options for the figures that are drawn inside.

    :param file: a style sheet of matplotlib that is laid over that of this package.
    :raises ConfigError: matplotlib is not installed, or the file has an option it does not know.
    :raises ReadError: the file cannot be read.
    """
    try:
        import matplotlib
    except ImportError:
        raise ConfigError(MISSING) from None
    from importlib.resources import as_file, files

    with as_file(files(__package__).joinpath('paper.mplstyle')) as own:
        options = _options(own)
    options |= {} if file is None else _options(file)
    with matplotlib.rc_context(options):
        yield


def _options(file: Path) -> Any:
    """Return the options of a style sheet; matplotlib itself only logs what is wrong in one."""
    import logging
    from logging.handlers import BufferingHandler

    from matplotlib import rc_params_from_file

    logger, complaints = logging.getLogger('matplotlib'), BufferingHandler(1000)
    logger.addHandler(complaints)
    try:
        options = rc_params_from_file(file, fail_on_error=True, use_default_template=False)
    except OSError as error:
        raise ReadError(file, error.strerror or str(error)) from None
    except ValueError as error:
        raise ConfigError(f'{file}: no style sheet of matplotlib: {error}') from None
    finally:
        logger.removeHandler(complaints)
    if complaints.buffer:
        problem = complaints.buffer[0].getMessage().strip().partition('\n')[0]
        raise ConfigError(f'{file}: no style sheet of matplotlib: {problem}')
    return options


def line_style(system: System, count: int, points: int) -> dict[str, Any]:
    """Return how the line of a system is drawn, one of some systems."""
    colour, dashes, marker = system.look
    style: dict[str, Any] = {'color': colour, 'linestyle': (0, dashes) if dashes else '-'}
    if count > 1:
        every = max(points // MARKS, 1)
        offset = every * (ord(marker) % MARKS) // MARKS
        style |= {'marker': marker, 'markevery': (offset, every), 'markersize': 2.6}
    return style


def plain_name(system: System) -> str:
    """Return the name of a system as matplotlib shows it: a dollar sign begins no formula."""
    return printable(system.name).replace('$', r'\$')


def columns_of(figure: Figure, labels: Sequence[str]) -> int:
    """Return how many columns of a legend fit into a figure."""
    longest = max(map(len, labels))
    fit = int(figure.get_figwidth() / (0.55 + INCHES_PER_LETTER * longest))
    return max(min(fit, len(labels)), 1)


def legend(figure: Figure, systems: Sequence[System], truth: bool = True) -> None:
    """Draw one legend above all axes; a panel of a larger figure has that of the figure."""
    from matplotlib.figure import SubFigure
    from matplotlib.lines import Line2D

    if isinstance(figure, SubFigure):
        return
    lines = [Line2D([], [], color=TRUTH, linewidth=1.4, alpha=0.55, label='ground truth')]
    lines = lines if truth else []
    for system in systems:
        style = line_style(system, len(systems), 1) | {'markevery': 1}
        lines.append(Line2D([], [], label=plain_name(system), **style))
    columns = columns_of(figure, [str(line.get_label()) for line in lines])
    figure.legend(
        handles=lines, loc='outside upper center', ncols=columns,
        columnspacing=1.2, handletextpad=0.5,
    )  # fmt: skip
