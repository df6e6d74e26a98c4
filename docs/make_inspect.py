"""Write the tables of findings and limits into inspect.md: `python docs/make_inspect.py`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import re

from vio_eval_ros.inspection.finding import FindingKind
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import CHANGES, InspectionLimits

DOCUMENT = Path(__file__).parent / 'inspect.md'
#: the subjects of findings, by table
SUBJECTS = {
    'streams': ('streams', 'sensors', 'cameras'),
    'IMU': ('IMU', 'IMU and poses'),
    'poses': ('poses',),
    'calibration': ('calibration',),
}


def findings(table: str) -> Iterator[str]:
    """Yield the rows of the findings of some subjects; limits have their defaults."""
    yield '| name | level | found when | what to do |'
    yield '|---|---|---|---|'
    for kind in FINDINGS.values():
        if kind.subject in SUBJECTS[table]:
            when = _filled(kind.when)
            yield f'| `{kind.name}` | {_level(kind)} | {when} | {kind.cure} |'


def _level(kind: FindingKind) -> str:
    parts = [kind.level]
    if kind.in_poses:
        parts.append(f'{kind.in_poses} in poses')
    if kind.severe:
        parts.append(f'fail: {_filled(kind.severe)}')
    if kind.minor:
        parts.append(f'info: {_filled(kind.minor)}')
    return '; '.join(parts)


def _filled(text: str) -> str:
    return text.format(**InspectionLimits().to_dict())


def limits() -> Iterator[str]:
    """Yield the rows of the limits, with their defaults."""
    yield '| limit | default | meaning | source |'
    yield '|---|---|---|---|'
    for one in InspectionLimits.described():
        value = f'{one.value:g} {one.unit}'.strip()
        source = 'chosen' if one.source.startswith('chosen on') else one.source
        yield f'| `{one.name}` | {value} | {one.meaning} | {source} |'


def profiles() -> Iterator[str]:
    """Yield the rows of what profiles change."""
    yield '| profile | limit | value | why |'
    yield '|---|---|---|---|'
    for profile, changes in CHANGES.items():
        for name, (value, reason) in changes.items():
            yield f'| `{profile}` | `{name}` | {value:g} | {reason} |'


def with_tables(text: str) -> str:
    """Return a document with its tables as the code has them."""
    tables = {f'findings: {table}': findings(table) for table in SUBJECTS}
    tables |= {'limits': limits(), 'profiles': profiles()}
    for name, rows in tables.items():
        mark = f'<!-- {name}, by make_inspect.py -->\n'
        before, found, after = text.partition(mark)
        if not found:
            raise LookupError(f'{DOCUMENT} has no {mark}')
        rest = re.sub(r'^\n*(\|.*\n)*', '', after)
        text = before + mark + '\n' + '\n'.join(rows) + '\n' + rest
    return text


if __name__ == '__main__':
    DOCUMENT.write_text(with_tables(DOCUMENT.read_text()))
