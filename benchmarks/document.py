"""The sections of docs/benchmarks.md: each is written anew by the script that measures it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.metadata import version
import os
from pathlib import Path
import platform
import re
from statistics import median
from typing import NamedTuple

DOCUMENT = Path(__file__).resolve().parents[1] / 'docs' / 'benchmarks.md'
SECTIONS = ('Replay', 'Suites', 'Live', 'Play', 'Diagnosis', 'IMU noise')
HEAD = """# Benchmarks

Written by `make bench`: each section by one of `benchmarks/compare.py`, `suite.py`, `live.py`,
`play.py`, `confusion.py` and `imu_noise.py`, which can also be run alone. Figures are medians,
with minimum and maximum in brackets."""


class Target(NamedTuple):
    """What is promised, and what was measured."""

    promise: str
    measured: str
    met: bool


def ranged(values: Sequence[float], digits: int) -> str:
    """Return the median and the range of some values."""
    return f'{median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})'


def targets_table(targets: Sequence[Target]) -> Iterator[str]:
    """Yield the lines of a Markdown table of targets."""
    yield '| target | measured | |'
    yield '|---|---:|---|'
    for promise, measured, met in targets:
        yield f'| {promise} | {measured} | {"met" if met else "**missed**"} |'


def machine(*packages: str) -> str:
    """Return on what was measured, and with which packages."""
    versions = [f'{package} {version(package)}' for package in packages]
    return (
        f'{_processor()}, {os.cpu_count()} cores, {platform.system()}; '
        f'{", ".join([f"Python {platform.python_version()}", *versions])}.'
    )


def write(section: str, lines: Sequence[str]) -> None:
    """Put a section into the document; the others stay as they are."""
    sections = dict(_sections(DOCUMENT.read_text(encoding='utf-8')))
    sections[section] = '\n'.join(lines).strip()
    parts = [f'## {name}\n\n{sections[name]}' for name in SECTIONS if name in sections]
    DOCUMENT.write_text('\n\n'.join([HEAD, *parts]) + '\n', encoding='utf-8')


def _sections(text: str) -> Iterator[tuple[str, str]]:
    for part in text.split('\n## ')[1:]:
        title, _, body = part.partition('\n')
        yield title, body.strip()


def _processor() -> str:
    """Return the name of the processor."""
    try:
        found = re.search(r'model name\s*: (.*)', Path('/proc/cpuinfo').read_text())
    except OSError:
        found = None
    return found[1].strip() if found else platform.processor() or platform.machine()
