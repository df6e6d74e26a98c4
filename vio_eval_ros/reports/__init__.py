"""Where results go: each report is a function of a Result, and a line in REPORTS."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import os
from pathlib import Path

from vio_eval_ros.errors import WriteError
from vio_eval_ros.reports.documents import json_report, junit_report, markdown_report
from vio_eval_ros.reports.html import html_report
from vio_eval_ros.reports.mcap import mcap_report
from vio_eval_ros.reports.result import Result
from vio_eval_ros.reports.tables import csv_report, latex_report, tum_report

REPORTS: dict[str, Callable[[Result], str | bytes]] = {
    'json': json_report,
    'junit': junit_report,
    'markdown': markdown_report,
    'html': html_report,
    'csv': csv_report,
    'tum': tum_report,
    'latex': latex_report,
    'mcap': mcap_report,
}


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
