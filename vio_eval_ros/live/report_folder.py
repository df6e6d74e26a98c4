"""The folder of reports: what goes there, and what to say where that fails."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from vio_eval_ros.comparison.comparison import Comparison
from vio_eval_ros.errors import ConfigError, VioEvalError, WriteError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.live.run import LiveRun, PAGE, remove_report
from vio_eval_ros.rendering.files import make_writable, write, write_all
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.compared import COMPARISON_REPORTS

COMPARISON_FILES = {
    'json': 'comparison.json',
    'markdown': 'comparison.md',
    'csv': 'comparison.csv',
}
COMPARISON_PAGE = 'comparison.html'
Compare = Callable[[Mapping[str, Result]], Comparison]


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

    def write(
        self, runs: Mapping[str, LiveRun], name: Path, compare: Compare
    ) -> tuple[dict[str, Result], Path] | None:
        """
        Return the results that were written, and where; None where none were.

        :param runs: of one estimate, or of several by their names: then each has a folder of its
            own, beside their comparison.
        :param name: of the folder below it; empty while there is one run.
        """
        if not self._folder:
            return None
        folder = Path(self._folder) / name
        try:
            results = {label: run.write(folder / label) for label, run in runs.items()}
            if len(results) > 1:
                found = compare(results)
                write_all(
                    {
                        folder / file: COMPARISON_REPORTS[kind](found)
                        for kind, file in COMPARISON_FILES.items()
                    }
                )
                (folder / COMPARISON_PAGE).unlink(missing_ok=True)  # of another report
        except (VioEvalError, OSError) as error:
            self._cannot_write(folder, error)
            return None
        self._forget(name)
        if name.name and self._interim == Path(self._folder):
            self._remove_interim(runs)  # else it would pass for that of the last run
        self._interim = folder
        return results, folder

    def write_pages(self, results: Mapping[str, Result], folder: Path, compare: Compare) -> str:
        """Add the pages to the reports in a folder; return why there are none, or ''."""
        try:
            for label, result in results.items():
                write(folder / label / PAGE, REPORTS['html'](result))
            if len(results) > 1:
                write(folder / COMPARISON_PAGE, COMPARISON_REPORTS['html'](compare(results)))
        except ConfigError as error:  # plotly is not installed
            return f'{folder / PAGE} is not written: {error}'
        except (VioEvalError, OSError) as error:
            self._cannot_write(folder, error)
        return ''

    def _remove_interim(self, labels: Iterable[str]) -> None:
        for label in labels:
            remove_report(Path(self._folder) / label)
        for file in (*COMPARISON_FILES.values(), COMPARISON_PAGE):
            with suppress(OSError):
                (Path(self._folder) / file).unlink()

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
