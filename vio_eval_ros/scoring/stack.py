"""The software under test: its name and version, with its configuration and calibration files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.evaluation.recorded import sha256

MAX_TEXT_BYTES = 1 << 20
STACK_KEYS = ('name', 'version', 'commit', 'config')


@dataclass(frozen=True)
class Document:
    """
    A file that explains a run.

    :param text: its content; None where that is not UTF-8, or longer than ``MAX_TEXT_BYTES``.
    """

    path: Path
    sha256: str
    text: str | None

    @classmethod
    def read(cls, path: Path) -> Document:
        """Return the document in a file; ``ReadError`` where it cannot be read."""
        import hashlib

        try:
            if not path.is_file():
                raise ReadError(path, 'not a file' if path.exists() else 'no such file')
            if path.stat().st_size > MAX_TEXT_BYTES:
                return cls(path, str(sha256([path])), None)
            data = path.read_bytes()
        except OSError as error:
            raise ReadError(path, error.strerror or str(error)) from None
        digest = hashlib.sha256(data).hexdigest()
        try:
            return cls(path, digest, data.decode())
        except UnicodeDecodeError:
            return cls(path, digest, None)


@dataclass(frozen=True)
class Stack:
    """The software that produced an estimate, with its configuration and calibration files."""

    name: str | None = None
    version: str | None = None
    commit: str | None = None
    config: tuple[Document, ...] = ()
    calibration: tuple[Document, ...] = ()

    @classmethod
    def of(
        cls, stated: Mapping[str, Any], calibration: Iterable[Path] = (), base: Path = Path()
    ) -> Stack:
        """
        Return the stack of ``{name: text, version: text, commit: text, config: [paths]}``.

        :param base: the folder that paths under ``config`` are relative to.
        """
        check_stack(stated)
        return cls(
            name=stated.get('name'),
            version=stated.get('version'),
            commit=stated.get('commit'),
            config=tuple(Document.read(path) for path in config_paths(stated, base)),
            calibration=tuple(Document.read(path) for path in calibration),
        )


def check_stack(stated: Mapping[str, Any]) -> None:
    """Raise ``ConfigError`` where the description of a stack is invalid; no file is read."""
    for key, value in stated.items():
        if key not in STACK_KEYS:
            near = nearest_name(key, STACK_KEYS) or f'; there are {", ".join(STACK_KEYS)}'
            raise ConfigError(f"stack: there is no '{key}' here{near}")
        if key != 'config' and not isinstance(value, (str, type(None))):
            raise ConfigError(f"stack: {key}: '{value}' is not text; put it in quotes")
    listed = stated.get('config') or []
    paths = [listed] if isinstance(listed, (str, Path)) else listed
    if not isinstance(paths, list) or not all(isinstance(path, (str, Path)) for path in paths):
        raise ConfigError('stack: config: expected a list of files')


def config_paths(stated: Mapping[str, Any], base: Path) -> list[Path]:
    """Return the configuration files of a stack that passed :func:`check_stack`."""
    listed = stated.get('config') or []
    return [base / path for path in ([listed] if isinstance(listed, (str, Path)) else listed)]
