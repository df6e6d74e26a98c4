"""``--as TOOL``: the number that another tool gives for the same files."""

import json
import os
from pathlib import Path
import re
import subprocess
import sys

import numpy as np
import pytest

from verbs import complaint, document
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate


@pytest.fixture(scope='module')
def flight(tmp_path_factory) -> list[str]:
    """Return the options that name a flight whose estimate has every second true stamp."""
    folder, run = tmp_path_factory.mktemp('flight'), simulate(duration_s=30.0)
    (folder / 'est.txt').write_text(tum(run.estimate))
    (folder / 'gt.txt').write_text(tum(run.ground_truth))
    return ['--estimate', f'{folder}/est.txt', '--ground-truth', f'{folder}/gt.txt']


def printed_by_evo(command: str, files: list[str], tmp_path: Path) -> dict[str, float]:
    """Return what ``evo_ape tum`` or ``evo_rpe tum`` prints without any flag."""
    done = subprocess.run(
        [Path(sys.executable).parent / command, 'tum', files[3], files[1]],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, 'HOME': str(tmp_path)},
    )
    found = re.findall(r'^\s*(\w+)\t(\S+)$', done.stdout, re.MULTILINE)
    return {name: float(value) for name, value in found}


@pytest.mark.slow
@pytest.mark.parametrize(('command', 'prefix'), [('evo_ape', 'ate'), ('evo_rpe', 'rpe_1f')])
def test_as_evo_gives_what_evo_prints_without_flags(command, prefix, flight, tmp_path):
    theirs = printed_by_evo(command, flight, tmp_path)
    ours = document('replay', *flight, '--as', 'evo')['metrics']
    for statistic in ('rmse', 'mean', 'median', 'std', 'min', 'max'):
        assert ours[f'{prefix}_trans_{statistic}_m'] == pytest.approx(theirs[statistic], abs=6e-7)


def test_as_rpg_measures_over_shares_of_the_path(flight):
    found = document('replay', *flight, '--as', 'rpg')
    lengths = [float(delta[:-1]) for delta in found['config']['rpe_deltas']]
    positions = np.loadtxt(flight[3])[:, 1:4]
    path = np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
    assert lengths == [np.floor(share * path) / 100 for share in (10, 20, 30, 40, 50)]
    assert found['config']['alignment'] == 'sim3'
    assert found['metrics'][f'rpe_{found["config"]["rpe_deltas"][0]}_trans_rmse_m'] > 0


def test_other_options_override_the_preset_on_the_line_and_in_yaml(flight, tmp_path):
    (tmp_path / 'options.yaml').write_text('as: evo\nalignment: posyaw\n')
    config = document('replay', *flight, '--config', tmp_path / 'options.yaml')['config']
    assert (config['alignment'], config['max_difference_s']) == ('posyaw', 0.01)
    config = document('replay', *flight, '--as', 'kitti', '--alignment', 'se3')['config']
    assert (config['alignment'], config['segment_lengths_m'][-1]) == ('se3', 800)


def test_a_suite_is_scored_as_a_tool_does(flight, tmp_path):
    suite = tmp_path / 'suite.yaml'
    suite.write_text(
        f'options: {{as: rpg}}\nsequences:\n  - {{name: a, estimate: {flight[1]}, '
        f'ground_truth: {flight[3]}}}\n'
    )
    run = document('score', suite)['sequences'][0]['runs'][0]
    assert run['metrics'] == document('replay', *flight, '--as', 'rpg')['metrics']
    suite.write_text(suite.read_text().replace('rpg', 'rgp'))
    assert "line 1: as: 'rgp'" in complaint('score', suite)


def test_an_unknown_tool_is_one_line(flight):
    assert "did you mean 'ov_eval'" in complaint('replay', *flight, '--as', 'oveval')


def test_the_series_of_a_run_over_shares_of_the_path_is_written(flight, tmp_path):
    series = tmp_path / 'series.csv'
    document('replay', *flight, '--as', 'rpg', '--series', f'csv:{series}')
    assert json.dumps(series.read_text().splitlines()[0]).count('m_trans_rmse') >= 5
