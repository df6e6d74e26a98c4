"""The package installs, builds with colcon, and its verbs are found by both of their names."""

import importlib
from pathlib import Path
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

from vio_eval_ros.__main__ import main, VERBS
from vio_eval_ros.version import __version__

ROOT = Path(__file__).resolve().parents[1]


def run(*command: str | Path, cwd: Path) -> str:
    """Return what a command prints on stdout; fail with all it printed if it fails."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_version_is_the_same_everywhere():
    manifest = ElementTree.parse(ROOT / 'package.xml').findtext('version')
    setup = re.findall(r"version='([\d.]+)',", (ROOT / 'setup.py').read_text())
    assert manifest == __version__
    assert setup == [__version__]  # once, as a literal: what catkin_prepare_release replaces


def test_colcon_takes_it_for_a_ros_package(colcon, workspace):
    listed = run(colcon, 'list', cwd=workspace).split()
    assert listed == ['vio_eval_ros', 'src/vio_eval_ros', '(ros.ament_python)']


@pytest.mark.parametrize('verb', VERBS)
def test_every_verb_runs_from_a_colcon_workspace(installed, verb):
    executable = installed / 'lib' / 'vio_eval_ros' / verb
    setup = installed.parent / 'local_setup.bash'
    printed = run('bash', '-c', f'. {setup} && {executable} --help', cwd=installed)
    assert 'usage' in printed


def test_a_sourced_workspace_imports_the_installed_package(installed):
    setup = installed.parent / 'local_setup.bash'
    where = 'import vio_eval_ros; print(vio_eval_ros.__file__)'
    printed = run('bash', '-c', f'. {setup} && {sys.executable} -c "{where}"', cwd=installed)
    assert Path(printed.strip()).is_relative_to(installed)


def test_every_module_is_installed(installed):
    (package,) = installed.glob('lib/python*/site-packages/vio_eval_ros')
    expected = {
        file.relative_to(ROOT / 'vio_eval_ros') for file in (ROOT / 'vio_eval_ros').rglob('*.py')
    }
    assert {file.relative_to(package) for file in package.rglob('*.py')} == expected
    assert not list(package.parent.glob('test*'))


def test_ros_finds_the_package_and_its_parameters(installed):
    share = installed / 'share'
    assert (share / 'ament_index/resource_index/packages/vio_eval_ros').is_file()
    assert (share / 'vio_eval_ros/package.xml').is_file()
    assert {file.name for file in (share / 'vio_eval_ros/config').glob('*.yaml')} == {
        file.name for file in (ROOT / 'config').glob('*.yaml')
    }


@pytest.mark.parametrize('verb', VERBS)
def test_every_verb_has_a_main(verb):
    module, purpose = VERBS[verb]
    assert callable(importlib.import_module(module).main)
    assert 10 < len(purpose) < 70


@pytest.mark.parametrize('arguments', [['--help'], ['-h']])
def test_help_lists_every_verb_with_its_purpose(capsys, arguments):
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    for verb, (_, purpose) in VERBS.items():
        assert re.search(rf'{verb} +{purpose}', printed)


def test_no_verb_is_a_usage_error_that_lists_them(capsys):
    assert main([]) == 2
    printed = capsys.readouterr()
    assert printed.out == ''
    assert all(verb in printed.err for verb in VERBS)


def test_a_mistyped_verb_gets_the_nearest_name(capsys):
    assert main(['reply']) == 2
    assert "there is no verb 'reply'; did you mean 'replay'?" in capsys.readouterr().err


def test_a_word_like_no_verb_gets_the_list(capsys):
    assert main(['frobnicate']) == 2
    assert 'choose from ' in capsys.readouterr().err


def test_the_exit_status_is_that_of_the_verb(monkeypatch):
    replay = importlib.import_module('vio_eval_ros.cli.replay')
    seen = []
    monkeypatch.setattr(replay, 'main', lambda arguments: seen.append(arguments) or 1)
    assert main(['replay', 'a.bag', '--json']) == 1
    assert seen == [['a.bag', '--json']]


def test_listing_the_verbs_imports_none_of_them():
    code = (
        "import sys, vio_eval_ros.__main__ as m; m.main(['-h']); sys.exit('numpy' in sys.modules)"
    )
    run(sys.executable, '-c', code, cwd=ROOT)
