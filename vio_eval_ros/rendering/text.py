"""How numbers and names are written as text; light, since every command line imports it."""

from __future__ import annotations

import math
import re

#: what makes a link of bare text
LINK = re.compile(r':(?=//)|(?<=www)\.', re.IGNORECASE)


def number(value: float) -> str:
    """Return a number with four significant digits, a dash for NaN."""
    return '-' if math.isnan(value) else f'{value:.4g}'


def percent(ratio: float) -> str:
    """Return a ratio in percent, a dash for NaN."""
    return '-' if math.isnan(ratio) else f'{100 * ratio:.1f} %'


def printable(text: str) -> str:
    """Return text that cannot move a terminal's cursor, whatever names it contains."""
    return ''.join(c if c.isprintable() else '?' for c in text)


def escaped(text: str) -> str:
    """Return text with nothing in it that Markdown or HTML would interpret."""
    text = ''.join(f'\\{c}' if c in '\\`*_[]<>&|#~$@' else c for c in printable(text))
    return LINK.sub(r'\\\g<0>', text)
