"""Where the reports of a verb go: ``FORMAT:PATH``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vio_eval_ros.cli.completion import complete, reports
from vio_eval_ros.cli.shell import complain
from vio_eval_ros.errors import ConfigError, VioEvalError
from vio_eval_ros.rendering.files import check_file, write


def add_reports(group: Any, formats: Iterable[str]) -> None:
    """Add ``--json`` and ``--report`` to the output group of a parser."""
    group.add_argument(
        '--json', action='store_true', help='print the result as JSON, and nothing else, on stdout'
    )
    action = group.add_argument(
        '--report',
        action='append',
        default=[],
        metavar='FORMAT:PATH',
        help=f'write a report; {", ".join(formats)}; may be repeated',
    )
    complete(action, reports(formats))


class Target(NamedTuple):
    """The format of a report, and its file."""

    format: str
    path: Path

    @classmethod
    def parse(cls, text: str, formats: Iterable[str]) -> Target:
        """Return the target that ``FORMAT:PATH`` means."""
        name, _, path = text.partition(':')
        if name not in formats or not path:
            raise ConfigError(
                f"'{text}': write FORMAT:PATH, with FORMAT one of {', '.join(formats)}"
            )
        return cls.of(name, Path(path))

    @classmethod
    def of(cls, name: str, path: Path) -> Target:
        """Return the target; its folder must exist."""
        if not path.parent.is_dir():
            raise ConfigError(f"'{path}': there is no folder {path.parent}")
        return cls(name, path)


def check_targets(targets: Sequence[Target], inputs: Sequence[Path]) -> None:
    """
    Check, before anything long is read, that reports can be written and overwrite nothing.

    :raises ConfigError: two reports, or a report and an input, are the same file, or a report is
        in a folder that is an input.
    :raises WriteError: the file of a report cannot be written.
    """
    folders = {path.resolve(): path for path in inputs if path.is_dir()}
    taken = {path.resolve(): f'the input {path}' for path in inputs}
    for target in targets:
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
        write(target.path, render())
    except VioEvalError as error:
        complain(verb, f'{target.format}: {error}')
        return False
    return True
