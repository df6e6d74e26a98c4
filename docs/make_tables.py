"""Write the tables of findings, causes and limits into the docs: `make tables`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
import re

from vio_eval_ros.core.glossary import GLOSSARY
from vio_eval_ros.core.limits import Limits
from vio_eval_ros.diagnosis import limits as of_diagnosis
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.inspection import limits as of_inspection
from vio_eval_ros.inspection.finding import FindingKind
from vio_eval_ros.inspection.findings import FINDINGS

DOCS = Path(__file__).parent
#: the subjects of findings, by table
SUBJECTS = {
    'streams': ('streams', 'sensors', 'cameras'),
    'IMU': ('IMU', 'IMU and poses'),
    'poses': ('poses',),
    'calibration': ('calibration',),
}
Changes = Mapping[str, Mapping[str, tuple[float, str]]]


def causes() -> Iterator[str]:
    """Yield the rows of the causes."""
    yield row('cause', 'value', 'how it is measured', 'undone by', 'limits')
    yield '|---|---|---|---|---|'
    for cause in CAUSES.values():
        value = ', '.join(filter(None, (cause.unit, cause.meaning)))
        limits = ', '.join(f'`{name}`' for name in cause.limits)
        yield row(f'`{cause.name}`', value, cause.measured, cause.remedy, limits)


def findings(table: str) -> Iterator[str]:
    """Yield the rows of the findings of some subjects; limits have their defaults."""
    yield row('name', 'level', 'found when', 'what to do')
    yield '|---|---|---|---|'
    for kind in FINDINGS.values():
        if kind.subject in SUBJECTS[table]:
            yield row(f'`{kind.name}`', _level(kind), _filled(kind.when), kind.cure)


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
    return text.format(**of_inspection.InspectionLimits().to_dict())


def metrics() -> Iterator[str]:
    """Yield the rows of the metrics."""
    yield row('metric', 'what it is', 'formula', 'keep in mind')
    yield '|---|---|---|---|'
    for term in GLOSSARY:
        formula = term.formula.replace('|', '\\|')
        yield row(f'`{term.name}`', term.words, formula, term.caveat)


def limits(kind: type[Limits]) -> Iterator[str]:
    """Yield the rows of a family of limits, with their defaults."""
    yield row('limit', 'default', 'meaning', 'source')
    yield '|---|---|---|---|'
    for one in kind.described():
        source = 'chosen' if one.source.startswith('chosen on the ') else one.source
        yield row(f'`{one.name}`', f'{_shown(one.value)} {one.unit}', one.meaning, source)


def profiles(changed: Changes) -> Iterator[str]:
    """Yield the rows of what profiles change."""
    yield row('profile', 'limit', 'value', 'why')
    yield '|---|---|---|---|'
    for profile, changes in changed.items():
        for name, (value, reason) in changes.items():
            yield row(f'`{profile}`', f'`{name}`', _shown(value), reason)


def _shown(value: float) -> str:
    return str(value).lower() if isinstance(value, bool) else f'{value:g}'


def row(*cells: str) -> str:
    """Return a row of a Markdown table."""
    return ''.join(f'| {cell.strip()} ' if cell.strip() else '| ' for cell in cells) + '|'


def tables(document: str) -> dict[str, Iterator[str]]:
    """Return the tables of a document, by the names in their marks."""
    if document == 'inspect.md':
        return {
            **{f'findings: {table}': findings(table) for table in SUBJECTS},
            'limits': limits(of_inspection.InspectionLimits),
            'profiles': profiles(of_inspection.CHANGES),
        }
    if document == 'diagnose.md':
        return {
            'causes': causes(),
            'limits': limits(of_diagnosis.DiagnosisLimits),
            'profiles': profiles(of_diagnosis.CHANGES),
        }
    if document == 'metrics.md':
        return {'metrics': metrics()}
    return {'limits': limits(ImuNoiseLimits)}


def with_tables(document: str, text: str) -> str:
    """Return the text of a document with its tables as the code has them."""
    for name, rows in tables(document).items():
        mark = f'<!-- {name}, by make_tables.py -->\n'
        before, found, after = text.partition(mark)
        if not found:
            raise LookupError(f'{document} has no {mark}')
        rest = re.sub(r'^\n*(\|.*\n)*', '', after)
        text = before + mark + '\n' + '\n'.join(rows) + '\n' + rest
    return text


if __name__ == '__main__':
    for path in (
        DOCS / name for name in ('inspect.md', 'diagnose.md', 'imu_noise.md', 'metrics.md')
    ):
        path.write_text(with_tables(path.name, path.read_text()))
