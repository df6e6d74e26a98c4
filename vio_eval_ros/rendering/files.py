"""How files are written, whole or not at all, and whether they can be."""

from __future__ import annotations

from collections.abc import Mapping
import os
from pathlib import Path

from vio_eval_ros.errors import WriteError


def check_folder(folder: Path) -> None:
    """
    Check that files can be written into a folder, by a trial file.

    :raises WriteError: they cannot.
    """
    import tempfile

    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise WriteError(folder, error.strerror or str(error)) from None


def check_file(path: Path) -> None:
    """
    Check that a file can be written, before its content is known.

    :raises WriteError: it cannot.
    """
    if path.is_dir():
        raise WriteError(path, 'it is a folder; name a file in it')
    if path.is_file() or not path.exists():  # neither a pipe nor a device
        check_folder(path.resolve().parent)


def make_writable(folder: Path) -> None:
    """
    Create a folder where there is none, and check that files can be written into it.

    :raises WriteError: neither is possible.
    """
    try:
        if folder.exists() and not folder.is_dir():
            raise WriteError(folder, 'it is a file, not a folder')
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(folder, error.strerror or str(error)) from None
    check_folder(folder)


def write(path: Path, content: str | bytes) -> None:
    """
    Write a file so that its path holds either all of it or what was there before.

    :param content: bytes, or text that becomes UTF-8.
    :raises WriteError: where that is not possible.
    """
    write_all({path: content})


def write_all(files: Mapping[Path, str | bytes]) -> None:
    """
    Write files that belong together: none of them changes before all are on the disk.

    :raises WriteError: where that is not possible; its path is the one that could not be written.
    """
    staged: dict[Path, Path] = {}
    path = Path()
    try:
        for path, content in files.items():
            _stage(
                path.resolve(), content.encode() if isinstance(content, str) else content, staged
            )
        for path, temporary in staged.items():
            temporary.replace(path)
    except OSError as error:
        raise WriteError(path, error.strerror or str(error)) from None
    finally:
        for temporary in staged.values():
            temporary.unlink(missing_ok=True)


def _stage(path: Path, data: bytes, staged: dict[Path, Path]) -> None:
    """Write a temporary file beside the one that it will replace, and remember it."""
    import tempfile

    if path.exists() and not path.is_file():
        path.write_bytes(data)  # a pipe or a device; a folder refuses
        return
    with tempfile.NamedTemporaryFile(
        dir=path.parent, prefix=f'.{path.name}.', delete=False
    ) as file:
        staged[path] = Path(file.name)
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    umask = os.umask(0)
    os.umask(umask)
    staged[path].chmod(0o666 & ~umask)
