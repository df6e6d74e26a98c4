"""
The look of each system, the same in every picture, by its place among the systems.

Colours are those of Okabe and Ito (https://jfly.uni-koeln.de/color/) and of Paul Tol's muted
scheme (https://personal.sron.nl/~pault/), in an order in which neighbours also differ in
lightness. Dashes and markers tell systems apart where the print is grey.
"""

from __future__ import annotations

from typing import NamedTuple


class Look(NamedTuple):
    """
    How a system is drawn.

    :param colour: as ``#rrggbb``.
    :param dashes: lengths of dash and gap, in widths of the line; empty for a solid line.
    :param marker: as matplotlib names it.
    """

    colour: str
    dashes: tuple[float, ...]
    marker: str


TRUTH = '#3b3f45'
COLOURS = (
    '#0072B2', '#E69F00', '#882255', '#56B4E9', '#117733',
    '#CC79A7', '#D55E00', '#332288', '#44AA99', '#999933',
)  # fmt: skip
DASHES: tuple[tuple[float, ...], ...] = ((), (5.0, 1.5), (6.0, 1.5, 1.0, 1.5), (2.5, 1.0))
MARKERS = 'os^DvPX*<>'


def look(place: int) -> Look:
    """Return how the system at a place, from 0, is drawn."""
    return Look(
        COLOURS[place % len(COLOURS)],
        DASHES[place % len(DASHES)],
        MARKERS[place % len(MARKERS)],
    )
