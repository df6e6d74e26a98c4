"""The frame of the HTML reports: one file that works offline, whatever names it shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from html import escape
from typing import Any

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.rendering.palette import look
from vio_eval_ros.rendering.text import printable


class Html(str):
    """Text that is HTML already."""


def html(content: object) -> Html:
    """Return content as HTML: anything that is not yet HTML is escaped."""
    return content if isinstance(content, Html) else Html(escape(printable(str(content))))


def tag(name: str, *content: object, **attributes: object) -> Html:
    """Return an element; attributes that are None are left out, ``class_`` is called class."""
    shown = ''.join(
        f' {key.rstrip("_").replace("_", "-")}="{html(str(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Html(f'<{name}{shown}>{"".join(map(html, content))}</{name}>')


def joined(parts: Iterable[object]) -> Html:
    """Return the parts, concatenated."""
    return Html(''.join(map(html, parts)))


def table(
    heads: Iterable[object],
    rows: Iterable[Iterable[object]],
    numbers: Iterable[int] = (),
    minor: Iterable[int] = (),
) -> Html:
    """
    Return a table.

    :param numbers: the columns that are right-aligned.
    :param minor: the columns that a narrow window hides.
    """
    right, wide = set(numbers), set(minor)

    def row(kind: str, cells: Iterable[object]) -> Html:
        return tag('tr', *(tag(kind, cell, class_=style(k)) for k, cell in enumerate(cells)))

    def style(k: int) -> str | None:
        return ' '.join(['number'] * (k in right) + ['minor'] * (k in wide)) or None

    return tag(
        'table', tag('thead', row('th', heads)), tag('tbody', *(row('td', r) for r in rows))
    )


def plot(
    figure: Mapping[str, Any],
    height: int,
    label: str,
    caption: object = '',
    shows: str | None = None,
) -> Html:
    """
    Return a plotly figure, which the page draws.

    :param height: in pixels.
    :param label: its description for screen readers.
    :param shows: ``path`` or ``errors``: pointing at the errors of a run shows the place in it.
    """
    import json

    # only a < could end the script element
    content = json.dumps(figure, allow_nan=False, separators=(',', ':')).replace('<', '\\u003c')
    return tag(
        'figure',
        tag('figcaption', caption) if caption else '',
        tag(
            'div',
            class_='plot',
            role='img',
            aria_label=label,
            data_shows=shows,
            style=f'--height:{height}px',
        ),
        Html(f'<script type="application/json">{content}</script>'),
    )


def page(title: str, *body: object, script: str = 'page.js', listens: bool = False) -> str:
    """
    Return a self-contained page.

    Its content security policy lets it run its own three scripts only, and fetch nothing.

    :param script: the asset that draws what is on it, with plots.js.
    :param listens: whether it may ask the server it comes from for more.
    :raises ConfigError: where plotly is not installed.
    """
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise ConfigError(
            "an html report needs plotly: pip install 'vio_eval_ros[report]'"
        ) from None
    scripts = [get_plotlyjs(), _asset('plots.js'), _asset(script)]
    policy = (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; "
        f'script-src {" ".join(map(_source, scripts))}' + ("; connect-src 'self'" * listens)
    )
    return '\n'.join(
        [
            '<!DOCTYPE html>',
            '<html lang="en">',
            '<head>',
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            tag('title', title),
            f'<style>{_asset("page.css")}</style>',
            '</head>',
            '<body>',
            *(html(part) for part in body),
            tag('noscript', tag('p', 'The plots need JavaScript, which is disabled here.')),
            *(f'<script>{script}</script>' for script in scripts),
            '</body>',
            '</html>',
            '',
        ]
    )


@cache
def _asset(name: str) -> str:
    """Return a style sheet or script that is installed beside this module."""
    from importlib.resources import files  # which takes a while

    return files(__package__).joinpath(name).read_text('utf-8')


def _source(script: str) -> str:
    """Return the hash by which a content security policy admits a script."""
    from base64 import b64encode
    from hashlib import sha256

    return f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'"


def badge(word: str, text: str) -> Html:
    """Return a verdict in its colour: pass, warn, fail or none."""
    return tag('span', text, class_=f'badge {word}')


def tiles(headlines: Iterable[tuple[str, str, str]]) -> Html:
    """Return the headline figures: name, value and what it refers to."""
    return tag(
        'div',
        *(
            tag('div', tag('small', name), tag('b', value), tag('small', of), class_='tile')
            for name, value, of in headlines
        ),
        class_='tiles',
    )


def warnings(sentences: Iterable[str], word: str = 'warn') -> Html:
    """Return a list of caveats; nothing where there are none."""
    items = [tag('li', sentence) for sentence in sentences]
    return tag('ul', *items, class_=f'notes {word}') if items else Html()


def swatch(colour: str) -> Html:
    """Return a patch of a colour, for a legend."""
    return tag('span', class_='swatch', style=f'background:{colour}')


def system_swatch(place: int) -> Html:
    """Return a patch of the colour of the system at a place, from 0."""
    return swatch(look(place).colour)
