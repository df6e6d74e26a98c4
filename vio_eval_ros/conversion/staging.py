"""Files and folders that are written completely or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import tempfile

from vio_eval_ros.errors import ConfigError, WriteError


def check_out(path: Path) -> None:
    """Raise ``ConfigError`` where nothing can be written to a path."""
    if path.exists():
        raise ConfigError(f'{path}: exists already; remove it or choose another name')
    if not path.parent.is_dir():
        raise ConfigError(f'{path}: there is no folder {path.parent}')


@contextmanager
def staged_path(path: Path) -> Iterator[Path]:
    """
    Yield a path to write to in a temporary folder; what is there in the end gets its place.

    :raises WriteError: the system does not let it be written.
    """
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f'.{path.name}.') as folder:
            yield Path(folder, path.name)
            for staged in sorted(Path(folder).iterdir()):
                staged.replace(path.parent / staged.name)
    except OSError as error:
        raise WriteError(path, error.strerror or str(error)) from None
