"""Where reports go, in which order, and what is said where that fails."""

import json
from pathlib import Path
import sys

import pytest

from vio_eval_ros.comparison.comparison import Comparison
from vio_eval_ros.comparison.matrix import CellRun, default_metrics
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.live.report_folder import ReportFolder
from vio_eval_ros.live.run import LiveRun, RunSetup
from vio_eval_ros.simulation import simulate

CONFIG = EvaluationConfig()


def compare(results) -> Comparison:
    runs = {label: CellRun.of(label, result) for label, result in results.items()}
    return Comparison(runs, tuple(default_metrics(CONFIG)))


@pytest.fixture(scope='module')
def runs() -> dict[str, LiveRun]:
    """Return two runs of different length."""
    flight, found = simulate(duration_s=15.0), {}
    for label, count in (('vins', 300), ('openvins', 200)):
        found[label] = LiveRun(RunSetup(CONFIG, (f'/{label}', '/truth')))
        found[label].add_estimate(flight.estimate[:count])
        found[label].add_ground_truth(flight.ground_truth)
        for _ in found[label].advance():
            pass
    return found


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob('*.html')}


def test_pages_come_last_and_those_of_an_older_report_go_first(runs, tmp_path):
    folder = ReportFolder(str(tmp_path), pytest.fail)
    pages = {'vins/result.html', 'openvins/result.html', 'comparison.html'}
    for _ in range(2):
        written = folder.write(runs, Path(), compare)
        assert names(tmp_path) == set()
        assert (tmp_path / 'vins/result.md').exists()
        assert json.loads((tmp_path / 'comparison.json').read_text())
        assert folder.write_pages(*written, compare) == ''
        assert names(tmp_path) == pages
        assert all((tmp_path / page).read_text().endswith('</html>\n') for page in pages)
    # the next folder takes the place of the first one
    folder.write(runs, Path('run_0001'), compare)
    assert names(tmp_path) == set()


def test_without_plotly_there_is_a_report_and_it_is_said_what_it_lacks(
    runs, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, 'plotly.offline', None)
    folder = ReportFolder(str(tmp_path), pytest.fail)
    written = folder.write({'': runs['vins']}, Path(), compare)
    assert folder.write_pages(*written, compare) == (
        f'{tmp_path}/result.html is not written: an html report needs plotly: '
        "pip install 'vio_eval_ros[report]'"
    )
    assert not folder.unwritten
    assert json.loads((tmp_path / 'result.json').read_text())['association']['pairs'] == 300


def test_a_page_that_cannot_be_written_is_told_as_the_report_would_be(runs, tmp_path):
    complaints: list[str] = []
    folder = ReportFolder(str(tmp_path), complaints.append)
    written = folder.write({'': runs['vins']}, Path(), compare)
    (tmp_path / 'result.html').symlink_to('/dev/full')
    assert folder.write_pages(*written, compare) == ''
    (complaint,) = complaints
    assert 'result.html: cannot write: No space left' in complaint
    assert folder.unwritten == {tmp_path: complaint}
