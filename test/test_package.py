"""The package installs, builds with colcon, and its verbs are found by both of their names."""

import importlib
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import xml.etree.ElementTree as ElementTree
import zipfile

import pytest

from vio_eval_ros.__main__ import main, VERBS
from vio_eval_ros.version import __version__

ROOT = Path(__file__).resolve().parents[1]
# nothing is fetched: the build takes setuptools from the environment of the tests
INSTALL = ('-m', 'pip', 'install', '--quiet', '--no-deps', '--no-build-isolation')


def run(*command: str | Path, cwd: Path) -> str:
    """Return what a command prints on stdout; fail with all it printed if it fails."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def new_environment(folder: Path) -> set[str]:
    """Create an environment that sees the packages of this one; return its own programs."""
    venv.create(folder, with_pip=False)
    (site,) = folder.glob('lib/python*/site-packages')
    (site / 'packages_of_the_tests.pth').write_text(f'{sysconfig.get_path("purelib")}\n')
    return {file.name for file in (folder / 'bin').iterdir()}


@pytest.fixture(scope='module')
def linked(colcon, workspace, tmp_path_factory) -> Path:
    """Return the folder into which colcon installed the package with links to its sources."""
    folder = tmp_path_factory.mktemp('linked')
    shutil.copytree(workspace / 'src', folder / 'src')
    run(colcon, '--log-base', 'log', 'build', '--symlink-install', cwd=folder)
    return folder / 'install' / 'vio_eval_ros'


@pytest.fixture(scope='module')
def distributions(workspace, tmp_path_factory) -> Path:
    """Return a folder with what a release uploads: the sources, and a wheel built from them."""
    folder, source = tmp_path_factory.mktemp('dist'), tmp_path_factory.mktemp('source')
    shutil.copytree(workspace / 'src' / 'vio_eval_ros', source, dirs_exist_ok=True)
    run(sys.executable, '-m', 'build', '--no-isolation', '--outdir', folder, source, cwd=folder)
    return folder


@pytest.fixture
def wheel(distributions) -> Path:
    """Return the wheel of a release."""
    (wheel,) = distributions.glob('vio_eval_ros-*.whl')
    return wheel


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
    assert printed.startswith(f'usage: {verb} ')


def test_colcon_installs_the_verbs_and_puts_none_on_the_path(installed, linked):
    for prefix in (installed, linked):
        assert {file.name for file in (prefix / 'lib' / 'vio_eval_ros').iterdir()} == set(VERBS)
        assert not (prefix / 'bin').exists()


def test_verbs_run_from_a_workspace_that_links_to_its_sources(linked):
    setup = linked.parent / 'local_setup.bash'
    executable = linked / 'lib' / 'vio_eval_ros' / 'replay'
    printed = run('bash', '-c', f'. {setup} && {executable} --help', cwd=linked)
    assert printed.startswith('usage: replay ')


@pytest.mark.slow
def test_pip_installs_one_command(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if '.data/scripts/' in name]
    environment = tmp_path / 'environment'
    before = new_environment(environment)
    run(environment / 'bin/python', *INSTALL, wheel, cwd=tmp_path)
    assert {file.name for file in (environment / 'bin').iterdir()} - before == {'vio_eval'}
    printed = run(environment / 'bin/vio_eval', '--help', cwd=tmp_path)
    assert printed.startswith('usage: vio_eval VERB ...')
    printed = run(environment / 'bin/vio_eval', 'replay', '--help', cwd=tmp_path)
    assert printed.startswith('usage: vio_eval replay ')
    assert '\n  vio_eval replay run.mcap ' in printed


@pytest.mark.slow
def test_an_editable_install_has_the_same_command(workspace, tmp_path):
    environment, source = tmp_path / 'environment', tmp_path / 'source'
    shutil.copytree(workspace / 'src' / 'vio_eval_ros', source)
    before = new_environment(environment)
    run(environment / 'bin/python', *INSTALL, '--editable', source, cwd=tmp_path)
    assert {file.name for file in (environment / 'bin').iterdir()} - before == {'vio_eval'}


@pytest.mark.slow
def test_the_package_index_takes_what_is_uploaded(distributions):
    files = sorted(distributions.iterdir())
    assert [file.name.partition('-')[2] for file in files] == [
        f'{__version__}-py3-none-any.whl',
        f'{__version__}.tar.gz',
    ]
    printed = run(sys.executable, '-m', 'twine', 'check', '--strict', *files, cwd=ROOT)
    assert printed.count('PASSED') == 2


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
    assert (share / 'vio_eval_ros/config/../docs/schema/options.json').is_file()


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


def test_help_names_the_command_as_it_was_called():
    printed = run(sys.executable, '-m', 'vio_eval_ros', '--help', cwd=ROOT)
    assert printed.startswith('usage: python -m vio_eval_ros VERB ...')
    printed = run(sys.executable, '-m', 'vio_eval_ros', 'play', '--help', cwd=ROOT)
    assert printed.startswith('usage: python -m vio_eval_ros play ')


def test_help_whose_reader_stops_early_is_not_an_error():
    script = f'set -o pipefail; {sys.executable} -m vio_eval_ros --help | head -n 0'
    done = subprocess.run(
        ['bash', '-c', script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, '')


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


def test_the_version_is_printed(capsys):
    assert main(['--version']) == 0
    assert capsys.readouterr().out == f'vio_eval {__version__}\n'


def without(module: str, verb: str, *arguments: object, **variables: str) -> str:
    """Return what a verb says on stderr, with status 2, where a module is not installed."""
    code = f'import sys; sys.modules[{module!r}] = None; import vio_eval_ros.__main__ as m; '
    code += f'sys.argv[0] = {verb!r}; sys.exit(m.{verb}())'
    done = subprocess.run(
        [sys.executable, '-c', code, *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stdout + done.stderr
    assert done.stdout == ''
    return done.stderr


@pytest.mark.parametrize(
    ('module', 'package'),
    [
        ('numpy', 'numpy'),
        ('rosbags', 'rosbags'),
        ('mcap', 'mcap'),
        ('ruamel', 'ruamel.yaml'),
    ],
)
def test_a_package_that_is_not_installed_is_named(module, package):
    config = ('--config', ROOT / 'config' / 'euroc.yaml')
    said = without(module, 'replay', ROOT / 'demo' / 'simulated_flight', *config)
    assert said.startswith(
        f'replay: the Python package {package} is missing: pip install {package};'
    )
    assert said.endswith('rosdep install --from-paths src --ignore-src\n')
    assert said.count('\n') == 1


@pytest.mark.parametrize('verb', ['evaluator', 'play'])
def test_an_old_release_of_ros_is_one_line(verb):
    recording = [ROOT / 'demo' / 'simulated_flight'] if verb == 'play' else []
    said = without('rclpy.event_handler', verb, *recording, ROS_DISTRO='humble')
    assert said.startswith(f'{verb}: ROS 2 Humble is too old: evaluator and play need Jazzy or')
    assert said.count('\n') == 1
    assert 'ROS 2 is missing (' in without('rclpy', verb, *recording, ROS_DISTRO='jazzy')
    said = without('rosbags', verb, *recording, ROS_DISTRO='jazzy')
    assert 'the Python package rosbags is missing' in said
