"""The frame of the HTML reports: one file that works offline, whatever names it shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.rendering.text import printable

STYLE = """
:root { color-scheme: light dark; --ink: #1f242b; --soft: #5d6671; --line: #e1e5ea;
  --paper: #fff; --card: #f6f7f9; --good: #1a7f4b; --warn: #8f6200; --bad: #c2332b; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e7eb; --soft: #9ba4af; --line: #2e343c;
  --paper: #15181c; --card: #1c2025; --good: #4cc38a; --warn: #e0b03c; --bad: #ff7d72; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem 1.25rem 4rem; max-width: 76rem; background: var(--paper);
  color: var(--ink); font: 15px/1.5 system-ui, sans-serif; overflow-wrap: anywhere; }
h1 { margin: 0; font-size: 1.3rem; line-height: 1.25; font-weight: 650; }
h2 { margin: 2.6rem 0 .7rem; font-size: 1.1rem; font-weight: 650; }
h3 { margin: 1.4rem 0 .4rem; font-size: .95rem; font-weight: 600; }
p { margin: .3rem 0; }
a { color: inherit; text-decoration-color: var(--soft); text-underline-offset: 3px; }
.soft, figcaption { color: var(--soft); font-size: .87rem; }
header { display: flex; flex-wrap: wrap; gap: .6rem 1.5rem; align-items: flex-start;
  justify-content: space-between; padding-bottom: 1rem; border-bottom: 1px solid var(--line); }
header > div { flex: 1 1 20rem; min-width: 0; }
.badge { display: inline-block; padding: .1rem .6rem; border: 1.5px solid; border-radius: 99px;
  font-size: .82rem; font-weight: 650; white-space: nowrap; color: var(--soft); }
header .badge { padding: .3rem 1.1rem; font-size: 1.1rem; }
.pass { color: var(--good); } .warn { color: var(--warn); } .fail { color: var(--bad); }
.tiles { display: grid; gap: .75rem; margin-top: 1.25rem;
  grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); }
.tile { padding: .7rem .9rem; border-radius: 8px; background: var(--card); }
.tile b { display: block; font-size: 1.5rem; line-height: 1.3; font-weight: 600;
  font-variant-numeric: tabular-nums; }
.tile small { color: var(--soft); font-size: .82rem; }
.notes { margin: 1rem 0 0; padding: .7rem 1rem .7rem 2rem; border-radius: 8px;
  background: var(--card); color: var(--ink); border-left: 3px solid var(--warn); }
.notes.fail { border-color: var(--bad); }
.plots { display: grid; gap: 1rem 1.5rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); }
figure { margin: 0; min-width: 0; }
.plot { width: 100%; height: var(--height); }
.ramp { display: inline-block; width: 7rem; height: .6rem; border-radius: 3px; }
.swatch { display: inline-block; width: .9rem; height: .7rem; border-radius: 2px;
  margin: 0 .3rem 0 .8rem; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: .32rem .7rem .32rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 500; font-size: .87rem; }
.number { text-align: right; white-space: nowrap; }
td:last-child, th:last-child { padding-right: 0; }
.number + :not(.number) { padding-left: .8rem; }
.bar { min-width: 3.5rem; width: 8rem; height: .5rem; margin-top: .5rem; border-radius: 4px;
  background: var(--line); overflow: hidden; }
.bar i { display: block; height: 100%; background: currentColor; }
details { border-bottom: 1px solid var(--line); padding: .5rem 0; }
details details { border: 0; }
details h2 { margin: 1.4rem 0 .4rem; font-size: 1rem; }
summary { cursor: pointer; font-weight: 550; }
summary .soft { font-weight: 400; }
details[open] > summary { margin-bottom: .6rem; }
@media (max-width: 40rem) { body { padding: 1rem .9rem 3rem; font-size: 14px; }
  .minor { display: none; }
  .plots .plot { height: min(var(--height), 85vw); }
  .tiles { grid-template-columns: 1fr 1fr; } }
"""

# What is in a folded section is drawn when it is opened, and let go of when it is closed: browsers
# allow a page few 3-D contexts. A pointer over the errors shows where on the path that was.
SCRIPT = """
'use strict';
const ink = () => getComputedStyle(document.body).color;
const options = {responsive: true, displaylogo: false, plotlyServerURL: '',
  modeBarButtonsToRemove: ['select2d', 'lasso2d', 'autoScale2d', 'resetCameraLastSave3d']};
const webgl = Boolean(document.createElement('canvas').getContext('webgl'));
async function draw(box) {
  const {data, layout} = JSON.parse(box.nextElementSibling.textContent);
  if (layout.scene && !webgl) {
    box.textContent = 'The view in 3-D needs WebGL, which this browser does not offer.';
    box.style.height = 'auto';
    return;
  }
  layout.font.color = ink();
  if (innerWidth < 640) {
    layout.dragmode = false;  // there, a drag scrolls the page
    const eye = layout.scene?.camera.eye;
    for (const axis in eye) eye[axis] *= 1.3;
  }
  await Plotly.newPlot(box, data, layout, options);
  if (box.dataset.shows === 'errors') box.on('plotly_hover', event => point(box, event));
}
function point(box, event) {
  const seconds = event.points[0].x;
  for (const path of box.closest('.run').querySelectorAll('.js-plotly-plot[data-shows=path]')) {
    const {x, y, z, customdata} = path.data.find(of => of.customdata), last = path.data.length - 1;
    let k = 0;
    customdata.forEach((at, n) => {
      if (at !== null && Math.abs(at - seconds) < Math.abs(customdata[k] - seconds)) k = n;
    });
    Plotly.restyle(path, {x: [[x[k]]], y: [[y[k]]], ...(z && {z: [[z[k]]]})}, [last]);
  }
}
function show() {
  for (const box of document.querySelectorAll('.plot')) {
    const hidden = box.closest('details:not([open])') !== null;
    if (Boolean(box.drawn) !== hidden) continue;
    box.drawn = !hidden;
    if (hidden) Plotly.purge(box); else draw(box);
  }
}
for (const folded of document.querySelectorAll('details')) {
  folded.addEventListener('toggle', show);
}
function unfold() {
  const named = document.getElementById(location.hash.slice(1));
  if (named?.tagName === 'DETAILS') named.open = true;
}
addEventListener('hashchange', unfold);
unfold();
show();
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
  for (const box of document.querySelectorAll('.js-plotly-plot')) {
    Plotly.relayout(box, {'font.color': ink()});
  }
});
"""


class Html(str):
    """Text that is HTML already."""


def html(content: object) -> Html:
    """Return content as HTML: what is none yet is text, and escaped."""
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
    """Return one part behind the other."""
    return Html(''.join(map(html, parts)))


def table(
    heads: Iterable[object],
    rows: Iterable[Iterable[object]],
    numbers: Iterable[int] = (),
    minor: Iterable[int] = (),
) -> Html:
    """
    Return a table.

    :param numbers: the columns that are aligned at the right.
    :param minor: the columns that a narrow window does not show.
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
    Return a figure of plotly, to be drawn by the page.

    :param height: in pixels.
    :param label: what is said of it to those who do not see it.
    :param shows: ``path`` or ``errors``: pointing at the errors of a run shows the place in it.
    """
    import json

    # nothing in a script can end it but a <
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


def page(title: str, *body: object) -> str:
    """
    Return a page with all that it needs in it.

    It may run its own two scripts only, and fetch nothing, as its content security policy says.

    :raises ConfigError: where plotly is not installed.
    """
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise ConfigError(
            "an html report needs plotly: pip install 'vio_eval_ros[report]'"
        ) from None
    scripts = [get_plotlyjs(), SCRIPT]
    policy = (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; "
        f'script-src {" ".join(map(_source, scripts))}'
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
            f'<style>{STYLE}</style>',
            '</head>',
            '<body>',
            *(html(part) for part in body),
            tag('noscript', tag('p', 'The plots need JavaScript, which is not allowed here.')),
            *(f'<script>{script}</script>' for script in scripts),
            '</body>',
            '</html>',
            '',
        ]
    )


def _source(script: str) -> str:
    """Return by what a content security policy knows a script."""
    from base64 import b64encode
    from hashlib import sha256

    return f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'"


def badge(word: str, text: str) -> Html:
    """Return a verdict in its colour: pass, warn, fail or none."""
    return tag('span', text, class_=f'badge {word}')


def tiles(headlines: Iterable[tuple[str, str, str]]) -> Html:
    """Return the few figures that one wants to see first: name, value, and what it is of."""
    return tag(
        'div',
        *(
            tag('div', tag('small', name), tag('b', value), tag('small', of), class_='tile')
            for name, value, of in headlines
        ),
        class_='tiles',
    )


def warnings(sentences: Iterable[str], word: str = 'warn') -> Html:
    """Return what one should know before trusting a figure; nothing where there is nothing."""
    items = [tag('li', sentence) for sentence in sentences]
    return tag('ul', *items, class_=f'notes {word}') if items else Html()


def swatch(colour: str) -> Html:
    """Return a patch of a colour, for a legend."""
    return tag('span', class_='swatch', style=f'background:{colour}')
