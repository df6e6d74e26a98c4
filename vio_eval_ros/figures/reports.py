"""Pictures as reports of the verbs: an overview of systems, and of a suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.figures.catalogue import FORMATS, Page, saved
from vio_eval_ros.figures.overview import overview, Runs, spread
from vio_eval_ros.figures.style import theme, WIDTHS
from vio_eval_ros.figures.systems import systems_of

#: inches
TALL, LOW = 8.6, 3.2


def overview_picture(
    file_format: str, results: Mapping[str, Result], order: Sequence[str] = ()
) -> bytes:
    """
    Return one page with several figures.

    :param results: by system.
    :param order: of all systems, also those without a result.
    :raises ConfigError: matplotlib is not installed, or there is nothing to draw.
    """
    with theme():
        return saved([_overview(results, order)], file_format)


def suite_picture(
    values: Mapping[str, Runs],
    label: str,
    results: Mapping[str, Mapping[str, Result]],
    file_format: str,
) -> bytes:
    """
    Return the spread of the runs of a suite; as PDF with an overview of each sequence.

    :param values: by sequence and system, those of the runs.
    :param results: likewise, one that is drawn.
    """
    order = list(dict.fromkeys(name for of in values.values() for name in of))
    pages = [Page(WIDTHS[2], LOW, partial(spread, values=values, label=label))]
    if file_format == 'pdf':
        pages += [_overview(of, order, sequence) for sequence, of in results.items() if of]
    with theme():
        return saved(pages, file_format)


def _overview(results: Mapping[str, Result], order: Sequence[str], title: str = '') -> Page:
    systems = systems_of(results, order)
    return Page(WIDTHS[2], TALL, partial(overview, systems=systems), title)


__all__ = ['FORMATS', 'overview_picture', 'suite_picture']
