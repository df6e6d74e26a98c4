"""Where the reports of a verb go: ``FORMAT:PATH``, or a path whose suffix tells the format."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
import sys
from typing import Any, NamedTuple

from vio_eval_ros.cli.completion import complete, reports
from vio_eval_ros.cli.shell import complain
from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError, VioEvalError
from vio_eval_ros.rendering.files import check_file, write
from vio_eval_ros.rendering.terminal import painted

#: of which format a file is by its suffix; others are named
SUFFIXES = {
    '.json': 'json',
    '.html': 'html',
    '.htm': 'html',
    '.csv': 'csv',
    '.markdown': 'markdown',
    '.mcap': 'mcap',
    '.md': 'markdown',
    '.pdf': 'pdf',
    '.png': 'png',
    '.rrd': 'rerun',
    '.svg': 'svg',
    '.tex': 'latex',
    '.tum': 'tum',
    '.txt': 'text',
    '.xml': 'junit',
    '.yaml': 'kalibr',
    '.yml': 'kalibr',
}
STDOUT = Path('-')


def add_reports(group: Any, formats: Iterable[str]) -> None:
    """Add ``--json`` and ``--report`` to the output group of a parser."""
    group.add_argument(
        '--json', action='store_true', help='print the result as JSON, and nothing else, on stdout'
    )
    action = group.add_argument(
        '--report',
        action='append',
        default=[],
        metavar='[FORMAT:]PATH',
        help=f'write a report; FORMAT is one of {", ".join(formats)}, by default as the suffix '
        'tells; FORMAT:- prints it instead of the summary; may be repeated',
    )
    complete(action, reports(formats))


class Target(NamedTuple):
    """The format of a report, and its file."""

    format: str
    path: Path

    @classmethod
    def parse(cls, text: str, formats: Iterable[str]) -> Target:
        """Return the target that ``FORMAT:PATH`` means, or a path with a suffix that tells."""
        listed = list(formats)
        name, colon, path = text.partition(':')
        if colon and name in listed and path:
            return cls.of(name, Path(path))
        told = SUFFIXES.get(Path(text).suffix.lower(), '')
        near = nearest_name(name, listed) if name not in listed else ''
        if told in listed and not (colon and near):
            return cls.of(told, Path(text))
        raise ConfigError(
            f"'{text}': write FORMAT:PATH, with FORMAT one of {', '.join(listed)}, or a path with "
            f'a suffix that tells the format, such as report.{_example(listed)}{near}'
        )

    @classmethod
    def of(cls, name: str, path: Path) -> Target:
        """Return the target; its folder must exist. A path ``-`` is stdout."""
        if not path.parent.is_dir():
            raise ConfigError(f"'{path}': there is no folder {path.parent}")
        return cls(name, path)

    @property
    def is_printed(self) -> bool:
        """Whether the report goes to stdout."""
        return self.path == STDOUT


def _example(formats: Iterable[str]) -> str:
    """Return a suffix that tells one of the formats."""
    return next(suffix[1:] for suffix, name in SUFFIXES.items() if name in formats)


def show(summary: Callable[[], str], targets: Iterable[Target]) -> None:
    """Print what a verb prints, unless a report takes its place."""
    if not any(target.is_printed for target in targets):
        print(painted(summary()), end='', flush=True)


def check_targets(targets: Sequence[Target], inputs: Sequence[Path], json: bool = False) -> None:
    """
    Check, before anything long is read, that reports can be written and overwrite nothing.

    :param json: whether the result is printed as JSON, so that no report can be printed.
    :raises ConfigError: two reports, or a report and an input, are the same file, or a report is
        in a folder that is an input.
    :raises WriteError: the file of a report cannot be written.
    """
    folders = {path.resolve(): path for path in inputs if path.is_dir()}
    taken = {path.resolve(): f'the input {path}' for path in inputs}
    printed = [f'{target.format}:-' for target in targets if target.is_printed]
    if len(printed) + json > 1:
        raise ConfigError(
            f'only one of {", ".join(["--json"] * json + printed)} can be printed; give the '
            'others a file'
        )
    for target in (target for target in targets if not target.is_printed):
        path = target.path.resolve()
        if path in taken and (path.is_file() or not path.exists()):
            raise ConfigError(f'{target.format}:{target.path} would overwrite {taken[path]}')
        for folder in folders.keys() & set(path.parents):
            raise ConfigError(
                f'{target.format}:{target.path} would be written into the input {folders[folder]}'
            )
        check_file(target.path)
        taken[path] = f'{target.format}:{target.path}'


def written(verb: str, target: Target, render: Callable[[], str | bytes]) -> bool:
    """Return whether a report could be written; one that cannot does not stop the others."""
    try:
        if target.is_printed:
            _print(render())
        else:
            write(target.path, render())
    except VioEvalError as error:
        complain(verb, f'{target.format}: {error}')
        return False
    return True


def _print(content: str | bytes) -> None:
    """Print a report as a file would hold it."""
    sys.stdout.flush()
    sys.stdout.buffer.write(content if isinstance(content, bytes) else content.encode())
    sys.stdout.flush()
