"""The folder of reports: what goes there, and what to say where that fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from vio_eval_ros.errors import VioEvalError, WriteError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.live.run import LiveRun, remove_report
from vio_eval_ros.rendering.files import make_writable


class ReportFolder:
    """
    Writes the reports of runs; a folder that cannot be written is reported, but stops nothing.

    :param folder: for all reports; empty for none.
    :param complain: logs what the user should know.
    """

    def __init__(self, folder: str, complain: Callable[[str], object]) -> None:
        #: why a report could not be written, by its folder
        self.unwritten: dict[Path, str] = {}
        self._folder = folder
        self._complain = complain
        self._interim: Path | None = None  # the report that was asked for before the run's end
        try:  # now there is still time to make room
            if folder:
                make_writable(Path(folder))
        except WriteError as error:
            self._cannot_write(Path(folder), error)

    def move(self, folder: str, name: Path) -> None:
        """
        Write to another folder from now on.

        :param name: of the report of the current run.
        :raises WriteError: where the new folder cannot be written.
        """
        if folder == self._folder:
            return
        if folder:
            make_writable(Path(folder))
        self._forget(name)
        self._folder = folder

    def write(self, run: LiveRun, name: Path) -> tuple[Result, Path] | None:
        """
        Return the result that was written, and where; None where none was.

        :param name: of the folder below it; empty while there is one run.
        """
        if not self._folder:
            return None
        folder = Path(self._folder) / name
        try:
            result = run.write(folder)
        except (VioEvalError, OSError) as error:
            self._cannot_write(folder, error)
            return None
        self._forget(name)
        if name.name and self._interim == Path(self._folder):
            remove_report(self._interim)  # else it would pass for that of the last run
        self._interim = folder
        return result, folder

    def next_run(self) -> None:
        """Go on to the next run."""
        self._interim = None

    def _forget(self, name: Path) -> None:
        """Forget what could not be written."""
        for path in (Path(self._folder), Path(self._folder) / name):
            self.unwritten.pop(path, None)

    def _cannot_write(self, folder: Path, error: Exception) -> None:
        self.unwritten[folder] = str(error)
        self._complain(str(error))
