"""The recording for Rerun: what is in it, where rerun-sdk is installed."""

import builtins
import os
import subprocess
import sys

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.recordings.arrays import source_of
from vio_eval_ros.reports.rerun import rerun_report
from vio_eval_ros.simulation import simulate


@pytest.fixture(scope='module')
def result():
    run = simulate(duration_s=10.0)
    sides = (source_of('estimate', run.estimate), source_of('ground_truth', run.ground_truth))
    return score_run(*sides, EvaluationConfig())


def test_without_the_library_a_line_says_what_to_install(result, monkeypatch):
    there = builtins.__import__

    def missing(name, *rest):
        if name.partition('.')[0] == 'rerun':
            raise ImportError(name)
        return there(name, *rest)

    monkeypatch.setattr(builtins, '__import__', missing)
    with pytest.raises(ConfigError, match=r"pip install 'vio_eval_ros\[rerun\]'"):
        rerun_report(result)


def test_the_recording_holds_paths_poses_and_errors(result, tmp_path):
    pytest.importorskip('rerun', reason='rerun-sdk is not installed')
    content = rerun_report(result)
    (tmp_path / 'run.rrd').write_bytes(content)
    done = subprocess.run(
        [sys.executable, '-m', 'rerun', 'rrd', 'verify', tmp_path / 'run.rrd'],
        capture_output=True,
        text=True,
        env={**os.environ, 'RERUN_ANALYTICS': '0'},
    )
    assert '1 file verified without error' in done.stdout + done.stderr
    for entity in ('estimate/path', 'ground_truth/body', 'errors/position_m', 'rotation_deg'):
        assert entity.encode() in content
