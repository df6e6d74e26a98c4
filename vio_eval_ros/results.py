"""
What the functions of the library return: values that a script and a notebook can show.

Each class has the fields of its base, which knows neither reports nor plots, and adds them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
import json
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING

from vio_eval_ros.comparison.comparison import Comparison as FoundComparison
from vio_eval_ros.comparison.sentences import html_verdicts, text_verdicts
from vio_eval_ros.comparison.tables import html_tables, text_tables
from vio_eval_ros.core.statistics import STATISTICS
from vio_eval_ros.diagnosis.documents import diagnosis_text
from vio_eval_ros.diagnosis.report import Diagnosis as FoundDiagnosis
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result as RunResult
from vio_eval_ros.imu.analysis import Analysis
from vio_eval_ros.imu.noise_reports import table as noise_table
from vio_eval_ros.inspection.report import Report as InspectionReport
from vio_eval_ros.inspection.text_report import text_document
from vio_eval_ros.recordings.sources import indexed, indexed_by_stamp
from vio_eval_ros.rendering.page import Html, html, joined, table, tag, warnings
from vio_eval_ros.rendering.text import number
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.compared import COMPARISON_REPORTS
from vio_eval_ros.reports.tables import pair_errors
from vio_eval_ros.reports.text import headline, rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    import pandas as pd
    import plotly.graph_objects as go

PLOTS = ('path', 'path_3d', 'errors')


class Result(RunResult):
    """
    What an evaluation found; made by :func:`evaluate`.

    ``metrics`` and ``warnings`` are those of ``vio_eval_ros.result/1``; a number that does not
    exist is NaN.
    """

    @property
    def metrics(self) -> Mapping[str, float]:
        """Every metric by its name, NaN where there is no data."""
        return self.summary.metrics

    @property
    def warnings(self) -> Sequence[str]:
        """What one should know before trusting a number, in sentences."""
        return self.summary.warnings

    def errors(self) -> pd.DataFrame:
        """
        Return the errors of each pair, indexed by the stamp of the estimate [ns].

        Columns: ``ground_truth_stamp_ns``, ``ate_trans_m``, ``ate_rot_deg`` (NaN without
        orientations) and ``error_x_m``, ``error_y_m``, ``error_z_m``, in the world of the ground
        truth.
        """
        table = pair_errors(self)
        stamps_ns = table.pop('estimate_stamp_ns')
        return indexed_by_stamp(table, stamps_ns)

    def plot(self, what: str = 'path') -> go.Figure:
        """
        Return a plotly figure.

        :param what: ``path`` (from above, coloured by position error), ``path_3d``, or ``errors``
            (over time).
        :raises ConfigError: plotly is not installed, or there is nothing to draw.
        """
        if what not in PLOTS:
            raise ConfigError(f"plot: '{what}' is not one of {', '.join(PLOTS)}")
        if math.isnan(self.metrics['ate_trans_rmse_m']):
            raise ConfigError('there is nothing to draw: the alignment is not determined')
        try:
            from plotly.graph_objects import Figure as Interactive
        except ImportError:
            raise ConfigError("a plot needs plotly: pip install 'vio_eval_ros[report]'") from None
        from vio_eval_ros.reports import plots
        from vio_eval_ros.reports.drawn_run import DrawnRun

        drawn = DrawnRun.of(self)
        if what == 'errors':
            rmse_m, rmse_deg = self.metrics['ate_trans_rmse_m'], self.metrics['ate_rot_rmse_deg']
            figure = plots.errors_over_time(drawn, rmse_m, rmse_deg)
            title = 'error of each pair; dashed: RMSE'
        else:
            figure = (plots.path_3d if what == 'path_3d' else plots.path_from_above)(drawn)
            title = f'position error 0 (blue) to {drawn.hottest:.3g} m (red); grey: ground truth'
        return Interactive(figure).update_layout(title=title, margin_t=50)

    def figure(
        self, name: str = 'top', columns: int = 1, *, map: str | Path | None = None
    ) -> Figure:
        """
        Return a figure for print, of matplotlib; ``.savefig('top.pdf')`` writes it.

        :param name: one of those that ``vio_eval plot --help`` lists.
        :param columns: of the page that it spans, 1 or 2.
        :param map: the YAML file of a map of map_server in the frame of the ground truth, drawn
            beneath ``top`` and ``projections``.
        :raises ConfigError: matplotlib is not installed, or there is no such figure or nothing to
            draw; the map cannot be read, or lies elsewhere.
        """
        return _figure(name, {'estimate': self}, ['estimate'], columns, map)

    def to_json(self) -> str:
        """Return the result in schema ``vio_eval_ros.result/1``."""
        return str(REPORTS['json'](self))

    def __repr__(self) -> str:
        """Return the result in a line."""
        alignment = self.summary.alignment.mode
        return f'<Result {self.estimate.source}: {headline(self)}, {alignment}>'

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the result in a line, and the statistics as a table."""
        figures = ([label, *map(number, values)] for label, _, values in rows(self))
        sources = f'{self.estimate.source} against {self.ground_truth.source}'
        head = f'{sources}: {headline(self)}, {self.summary.alignment.mode}'
        return joined(
            [
                tag('p', html(head)),
                table(['error', *STATISTICS], figures, range(1, 1 + len(STATISTICS))),
                warnings(self.warnings),
            ]
        )


class Comparison(FoundComparison):
    """
    What several estimates of one ground truth are worth; made by :func:`compare`.

    ``runs`` has each system by its name, ``unscored`` why one has no result, ``matrix`` the
    values that are compared with the best and second of each metric.
    """

    @property
    def results(self) -> Mapping[str, Result]:
        """The result of each system that could be scored, as of :func:`evaluate`."""
        return {name: _face(result) for name, result in super().results.items()}

    def to_dataframe(self) -> pd.DataFrame:
        """
        Return the compared metrics in columns, with a row for each system; NaN where unknown.

        :raises ConfigError: pandas is not installed.
        """
        (sequence,) = self.matrix.sequences
        columns = {
            metric: [self.matrix.cell(sequence, name).value(metric) for name in self.runs]
            for metric in self.chosen
        }
        return indexed(columns, list(self.runs), 'system')

    def figure(
        self, name: str = 'top', columns: int = 1, *, map: str | Path | None = None
    ) -> Figure:
        """Return a figure of all systems with a result, as :meth:`Result.figure` does of one."""
        return _figure(name, self.results, list(self.runs), columns, map)

    def to_json(self) -> str:
        """Return the comparison in schema ``vio_eval_ros.comparison/1``."""
        return COMPARISON_REPORTS['json'](self)

    def to_latex(self, siunitx: bool = False) -> str:
        """Return the table for LaTeX (booktabs), with the columns of siunitx where so wanted."""
        return COMPARISON_REPORTS['siunitx' if siunitx else 'latex'](self)

    def __str__(self) -> str:
        """Return the table, as the command line prints it."""
        return (text_tables(self.matrix) + text_verdicts(self.matrix)).rstrip('\n')

    def __repr__(self) -> str:
        """Return the systems in a line."""
        unscored = f', {len(self.unscored)} could not be scored' if self.unscored else ''
        return f'<Comparison of {len(self.runs)} systems: {", ".join(self.runs)}{unscored}>'

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the table."""
        return joined([html_tables(self.matrix), html_verdicts(self.matrix)])


def _figure(
    name: str,
    results: Mapping[str, RunResult],
    order: Sequence[str],
    columns: int,
    map: str | Path | None,
) -> Figure:
    """Return a figure in the theme of the package."""
    from vio_eval_ros.figures.catalogue import draw, MAPPED
    from vio_eval_ros.figures.maps import load_map
    from vio_eval_ros.figures.style import theme

    if columns not in (1, 2):
        raise ConfigError(f'columns: must be 1 or 2, not {columns}')
    if map is not None and name not in MAPPED:
        raise ConfigError(f"map: is drawn beneath {' and '.join(MAPPED)}, not beneath '{name}'")
    beneath = None if map is None else load_map(Path(map))
    with theme():
        figure = draw(name, results, columns, order, beneath)
        figure.canvas.draw()  # what is laid out only when drawn takes the theme of now
    return figure


def _face(result: RunResult) -> Result:
    """Return a result with what the library adds to it."""
    return Result(**{item.name: getattr(result, item.name) for item in fields(result)})


class Diagnosis(FoundDiagnosis):
    """What is wrong with an estimate; made by :func:`diagnose`."""

    def to_json(self) -> str:
        """Return the diagnosis in schema ``vio_eval_ros.diagnosis/1``."""
        return _json(self.to_dict())

    def __repr__(self) -> str:
        """Return the causes in a line."""
        names = ', '.join(cause.name for cause in self.causes)
        return f'<Diagnosis: {names or "nothing unusual"}>'

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the text of the command line."""
        return _preformatted('\n'.join(diagnosis_text(self)))


class Inspection(InspectionReport):
    """What is wrong with the streams of a recording; made by :func:`inspect`."""

    def to_json(self) -> str:
        """Return the inspection in schema ``vio_eval_ros.inspection/1``."""
        return _json(self.to_dict())

    def __repr__(self) -> str:
        """Return the findings in a line."""
        names = ', '.join(dict.fromkeys(finding.name for finding in self.findings))
        return f'<Inspection {self.source}: {len(self.streams)} streams, {names or "no findings"}>'

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the text of the command line."""
        return _preformatted(text_document(self))


class ImuNoise(Analysis):
    """The noise of an IMU; made by :func:`imu_noise`."""

    def to_json(self) -> str:
        """Return the noise in schema ``vio_eval_ros.imu_noise/1``."""
        return _json(self.to_dict())

    def __repr__(self) -> str:
        """Return the length of the record and the noise densities in a line."""
        gyro, accel = (self.largest(kind, 'density') for kind in ('gyro', 'accel'))
        shown = [number(math.nan if value is None else value) for value in (gyro, accel)]
        return (
            f'<ImuNoise {self.source}: {self.signal.duration_s:.4g} s, {shown[0]} rad/s/sqrt(Hz), '
            f'{shown[1]} m/s2/sqrt(Hz)>'
        )

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the text of the command line."""
        return _preformatted(noise_table(self))


def _json(content: dict[str, Any]) -> str:
    return json.dumps(content, indent=2, allow_nan=False) + '\n'


def _preformatted(text: str) -> str:
    return tag('pre', Html('\n'.join(map(html, text.splitlines()))))
