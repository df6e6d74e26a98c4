"""Where results go: each report is a function of a Result, and a line in REPORTS."""

from __future__ import annotations

from collections.abc import Callable

from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.reports.documents import json_report, junit_report, markdown_report
from vio_eval_ros.reports.html import html_report
from vio_eval_ros.reports.mcap import mcap_report
from vio_eval_ros.reports.rerun import rerun_report
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
    'rerun': rerun_report,
}
