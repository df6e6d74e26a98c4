"""The page: its style sheet and script are files of the package, wherever that is installed."""

from importlib.resources import files
from pathlib import Path
import subprocess
import sys

import pytest

from vio_eval_ros.rendering.page import page

ROOT = Path(__file__).resolve().parents[2]
ASSETS = ('page.css', 'plots.js', 'page.js', 'live.js')


@pytest.mark.parametrize('name', ASSETS)
def test_a_page_contains_each_asset_as_it_is(name):
    text = files('vio_eval_ros.rendering').joinpath(name).read_text('utf-8')
    assert len(text) > 500
    assert text in page('title', script='live.js' if name == 'live.js' else 'page.js')


def test_no_asset_can_end_the_element_that_it_is_in():
    for name in ASSETS:
        assert '</' not in files('vio_eval_ros.rendering').joinpath(name).read_text('utf-8')


@pytest.mark.slow
def test_assets_are_installed(tmp_path):
    command = [sys.executable, 'setup.py', '-q', 'build', '--build-base', str(tmp_path / 'build')]
    command += ['--build-lib', str(tmp_path / 'lib')]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    installed = tmp_path / 'lib/vio_eval_ros/rendering'
    for name in ASSETS:
        assert (installed / name).read_bytes() == (
            ROOT / 'vio_eval_ros/rendering' / name
        ).read_bytes()
    source = {path.name for path in (ROOT / 'vio_eval_ros/rendering').iterdir() if path.is_file()}
    assert {path.name for path in installed.iterdir()} == source
