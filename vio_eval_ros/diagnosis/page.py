"""A diagnosis as a page and as Markdown: what the text says, and what shows it in this run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vio_eval_ros.diagnosis.documents import cannot_tell, sentences_of
from vio_eval_ros.diagnosis.evidence import AS_IT_IS, Curve, Picture, pictures, TRUTH, UNDONE
from vio_eval_ros.diagnosis.report import Cause, Diagnosis
from vio_eval_ros.rendering.figures import axis, BLUE, GREY, label, layout, numbers, RED
from vio_eval_ros.rendering.page import (
    badge,
    Html,
    joined,
    page,
    plot,
    swatch,
    table,
    tag,
    warnings,
)
from vio_eval_ros.rendering.text import escaped, number, percent

COLOURS = {AS_IT_IS: RED, UNDONE: BLUE, TRUTH: GREY, 'estimate': RED, 'rotations': RED}
HEIGHT = 340


def diagnosis_html(diagnosis: Diagnosis, title: str, command: str = '') -> str:
    """
    Return a page: each cause with what shows it in this run, and the command that corrects them.

    :param title: names the inputs.
    :param command: that corrects all that flags can correct, where there is one.
    """
    shown = pictures(diagnosis)
    causes = [_cause(cause, diagnosis, shown) for cause in diagnosis.causes]
    found = ', '.join(cause.name for cause in diagnosis.causes)
    state = badge('warn', found) if found else badge('pass', 'nothing unusual')
    corrected = [tag('h2', 'What corrects it'), tag('pre', tag('code', command))]
    told = [tag('p', cannot_tell(diagnosis), class_='soft')]
    return page(
        f'{title}: diagnosis',
        tag('header', tag('div', tag('h1', title), tag('p', 'diagnosis', class_='soft')), state),
        warnings(diagnosis.assumed),
        *causes,
        *corrected * bool(command),
        *_errors(diagnosis),
        *told * bool(diagnosis.cannot_tell),
        warnings(diagnosis.warnings[len(diagnosis.assumed) :]),
        _limits(diagnosis),
    )


def diagnosis_markdown(diagnosis: Diagnosis, title: str, command: str = '') -> str:
    """Return the same as Markdown, without pictures."""
    found = ', '.join(cause.name for cause in diagnosis.causes) or 'nothing unusual'
    lines = [f'### {escaped(title)}: {escaped(found)}', '']
    lines += [f'- ⚠ {escaped(sentence)}' for sentence in diagnosis.assumed]
    for cause in diagnosis.causes:
        lines += ['', f'**{cause.name}** (confidence {percent(cause.confidence)})', '']
        lines += [f'- {escaped(sentence)}' for sentence in sentences_of(cause, diagnosis)]
    if command:
        lines += ['', 'What corrects it:', '', f'    {command}']
    lines += ['', '| error | as it is | with all causes undone |', '|---|---:|---:|']
    lines += [f'| {name} | {before} | {after} |' for name, before, after in _rows(diagnosis)]
    if diagnosis.cannot_tell:
        lines += ['', escaped(cannot_tell(diagnosis))]
    others = diagnosis.warnings[len(diagnosis.assumed) :]
    lines += [''] * bool(others) + [f'- ⚠ {escaped(sentence)}' for sentence in others]
    return '\n'.join(lines) + '\n'


def _cause(cause: Cause, diagnosis: Diagnosis, shown: Mapping[str, Picture]) -> Html:
    """Return a section: what is said of the cause, and what shows it."""
    return tag(
        'section',
        tag('h2', f'{cause.name} ', tag('small', f'confidence {percent(cause.confidence)}')),
        *(tag('p', sentence) for sentence in sentences_of(cause, diagnosis)),
        _picture(shown[cause.name]) if cause.name in shown else '',
    )


def _picture(picture: Picture) -> Html:
    """Return a figure with its legend."""
    legend = joined(
        part for curve in picture.curves for part in (swatch(_colour(curve)), f'{curve.name} ')
    )
    return joined(
        [
            tag('p', f'{picture.title}. ', legend, class_='soft'),
            plot(_figure(picture), HEIGHT, picture.title),
        ]
    )


def _figure(picture: Picture) -> dict[str, Any]:
    bars = any(curve.kind == 'bars' for curve in picture.curves)
    data = [_trace(curve) for curve in picture.curves]
    shapes = []
    if picture.diagonal:
        x = np.concatenate([curve.x for curve in picture.curves])
        (x0, x1), line = (x.min(), x.max()), {'color': GREY, 'width': 1}
        ends = dict.fromkeys(('x0', 'y0'), float(x0)) | dict.fromkeys(('x1', 'y1'), float(x1))
        shapes.append({'type': 'line', **ends, 'line': line})
    equal = {'scaleanchor': 'x'} if picture.equal else {}
    return {
        'data': data,
        'layout': layout(
            xaxis=axis('' if bars else picture.x_label, **({'automargin': True} if bars else {})),
            yaxis=axis(picture.y_label, **equal),
            shapes=shapes,
        ),
    }


def _trace(curve: Curve) -> dict[str, Any]:
    colour = _colour(curve)
    if curve.kind == 'bars':
        names = [label(str(name)) for name in curve.x]
        return {'type': 'bar', 'name': curve.name, 'x': names, 'y': numbers(curve.y),
                'marker': {'color': colour}}  # fmt: skip
    style: dict[str, Any] = {'line': {'color': colour, 'width': 1.4}}
    if curve.kind == 'markers':
        style = {'marker': {'color': colour, 'size': 3}}
    return {
        'type': 'scatter',
        'mode': curve.kind,
        'name': curve.name,
        'x': numbers(curve.x),
        'y': numbers(curve.y),
        **style,
    }


def _colour(curve: Curve) -> str:
    return COLOURS.get(curve.name, BLUE)


def _errors(diagnosis: Diagnosis) -> list[Html]:
    rows = _rows(diagnosis)
    heads = ['error', 'as it is', 'with all causes undone'][: 3 if diagnosis.causes else 2]
    rows = [row[: len(heads)] for row in rows]
    return [tag('h2', 'Errors'), table(heads, rows, numbers=range(1, len(heads)))] if rows else []


def _rows(diagnosis: Diagnosis) -> list[list[str]]:
    return [
        [name, *('-' if value is None else number(value) for value in values.values())]
        for name, values in diagnosis.errors().items()
    ]


def _limits(diagnosis: Diagnosis) -> Html:
    rows = [[name, f'{value:g}'] for name, value in diagnosis.limits.to_dict().items()]
    return tag(
        'details',
        tag('summary', f'Limits of the profile {diagnosis.profile}'),
        table(['limit', 'value'], rows, numbers=(1,)),
    )
