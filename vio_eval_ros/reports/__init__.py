"""Where results go: each report is a function from a Result to text, and a line in REPORTS."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path

from vio_eval_ros.errors import WriteError
from vio_eval_ros.reports.documents import json_report, junit_report, markdown_report
from vio_eval_ros.reports.result import Result
from vio_eval_ros.reports.tables import csv_report, tum_report

REPORTS: dict[str, Callable[[Result], str]] = {
    'json': json_report,
    'junit': junit_report,
    'markdown': markdown_report,
    'csv': csv_report,
    'tum': tum_report,
}


def write(path: Path, text: str) -> None:
    """
    Write a file so that its path holds either all of it or what was there before.

    :raises WriteError: where that is not possible.
    """
    import tempfile

    temporary = None
    path = path.resolve()
    try:
        if path.exists() and not path.is_file():
            path.write_text(text, encoding='utf-8')  # a pipe or a device; a folder refuses
            return
        with tempfile.NamedTemporaryFile(
            'w',
            dir=path.parent,
            prefix=f'.{path.name}.',
            encoding='utf-8',
            newline='\n',
            delete=False,
        ) as file:
            temporary = Path(file.name)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise WriteError(path, error.strerror or str(error)) from None
