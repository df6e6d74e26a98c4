"""Write the tables of causes and limits into diagnose.md: `python docs/make_diagnose.py`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import re

from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.limits import CHANGES, DiagnosisLimits

DOCUMENT = Path(__file__).parent / 'diagnose.md'


def causes() -> Iterator[str]:
    """Yield the rows of the causes."""
    yield '| cause | value | how it is measured | undone by | limits |'
    yield '|---|---|---|---|---|'
    for cause in CAUSES.values():
        value = ', '.join(filter(None, (cause.unit, cause.meaning)))
        limits = ', '.join(f'`{name}`' for name in cause.limits)
        yield f'| `{cause.name}` | {value} | {cause.measured} | {cause.remedy} | {limits} |'


def limits() -> Iterator[str]:
    """Yield the rows of the limits, with their defaults."""
    yield '| limit | default | meaning | source |'
    yield '|---|---|---|---|'
    for one in DiagnosisLimits.described():
        source = 'chosen' if one.source.startswith('chosen on') else one.source
        yield f'| `{one.name}` | {_shown(one.value)} {one.unit} | {one.meaning} | {source} |'


def profiles() -> Iterator[str]:
    """Yield the rows of what profiles change."""
    yield '| profile | limit | value | why |'
    yield '|---|---|---|---|'
    for profile, changes in CHANGES.items():
        for name, (value, reason) in changes.items():
            yield f'| `{profile}` | `{name}` | {_shown(value)} | {reason} |'


def _shown(value: float) -> str:
    return str(value).lower() if isinstance(value, bool) else f'{value:g}'


def with_tables(text: str) -> str:
    """Return a document with its tables as the code has them."""
    for name, rows in {'causes': causes(), 'limits': limits(), 'profiles': profiles()}.items():
        mark = f'<!-- {name}, by make_diagnose.py -->\n'
        before, found, after = text.partition(mark)
        if not found:
            raise LookupError(f'{DOCUMENT} has no {mark}')
        rest = re.sub(r'^\n*(\|.*\n)*', '', after)
        text = (
            before
            + mark
            + '\n'
            + '\n'.join(row.replace(' |  |', ' | |') for row in rows)
            + '\n'
            + rest
        )
    return text


if __name__ == '__main__':
    DOCUMENT.write_text(with_tables(DOCUMENT.read_text()))
