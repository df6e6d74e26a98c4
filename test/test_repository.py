"""What helps people to join: workflows, forms and metadata agree with the package."""

from pathlib import Path
import re
from typing import Any

import pytest
import yaml

from vio_eval_ros.version import __version__

ROOT = Path(__file__).resolve().parents[1]
GITHUB = ROOT / '.github'
README = (ROOT / 'README.md').read_text()
SETUP = (ROOT / 'setup.py').read_text()
FORMS = sorted((GITHUB / 'ISSUE_TEMPLATE').glob('[0-9]*.yml'))
(URL,) = re.findall(r"^URL = '(.*)'$", SETUP, re.MULTILINE)


def workflow(name: str) -> dict[str, Any]:
    """Return the jobs of a workflow."""
    return yaml.safe_load((GITHUB / 'workflows' / f'{name}.yml').read_text())['jobs']


def commands(name: str) -> list[str]:
    """Return every line of shell in a workflow."""
    steps = [step for job in workflow(name).values() for step in job['steps']]
    return [line.strip() for step in steps for line in step.get('run', '').splitlines()]


def test_every_python_that_the_package_names_is_tested():
    tested = workflow('ci')['test']['strategy']['matrix']
    assert tested['python'] == re.findall(r'Python :: (3\.\d+)', SETUP)
    assert f"python_requires='>={tested['python'][0]}'" in SETUP
    assert tested['ubuntu'] == ['22.04', '24.04']


def test_ci_runs_what_the_readme_says():
    run = commands('ci')
    for command in ('make demo', 'make test', 'pip install .'):
        assert command in run
        assert command in README
    for command in re.findall(r'^colcon build .*', README, re.MULTILINE):
        assert command in run


@pytest.mark.parametrize('name', ['ci', 'release'])
def test_every_target_that_a_workflow_makes_exists(name):
    targets = re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    made = [line.split()[-1] for line in commands(name) if line.startswith('make ')]
    assert made
    assert set(made) <= set(targets)


@pytest.mark.parametrize('file', FORMS, ids=lambda file: file.stem)
def test_an_issue_form_asks_what_it_should(file):
    form = yaml.safe_load(file.read_text())
    assert form.keys() <= {'name', 'description', 'labels', 'body'}
    names = [field['id'] for field in form['body']]
    assert len(set(names)) == len(names) > 1
    for field in form['body']:
        assert field['type'] in ('input', 'textarea')
        assert field['attributes'].keys() <= {'label', 'description', 'render'}
        assert field['validations'] == {'required': True}
    assert 'ersion' in file.read_text()


def test_there_is_a_form_for_each_kind_of_issue():
    assert [file.stem for file in FORMS] == ['1-wrong-number', '2-cannot-read', '3-other']
    links = yaml.safe_load((GITHUB / 'ISSUE_TEMPLATE/config.yml').read_text())['contact_links']
    for link in links:
        base, _, path = link['url'].partition('/blob/main/')
        assert base == URL
        assert (ROOT / path).is_file()


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text())
    assert citation['cff-version'] == '1.2.0'
    assert citation['version'] == __version__
    assert citation['repository-code'] == URL
    assert citation['license'] == 'Apache-2.0'
    assert citation.keys() > {'message', 'title', 'authors'}


def test_hooks_run_the_tools_of_the_makefile():
    hooks = yaml.safe_load((ROOT / '.pre-commit-config.yaml').read_text())['repos'][0]['hooks']
    lint = (ROOT / 'Makefile').read_text()
    for hook in hooks:
        tool = Path(hook['entry'].split()[0]).name
        assert re.search(rf'(-m |/bin/){tool}\b', lint)
        assert hook['language'] == 'system'  # nothing is fetched


def test_no_two_files_of_tests_have_the_same_name():
    # launch_testing's plugin of pytest imports them by their names alone
    names = [file.name for file in (ROOT / 'test').rglob('test_*.py')]
    assert sorted(names) == sorted(set(names))


def test_no_file_of_tests_skips_itself_as_a_whole():
    # which ends the run where launch_testing's plugin imports it
    for file in (ROOT / 'test').rglob('test_*.py'):
        assert not re.search(r'^\S.*(importorskip|allow_module_level)', file.read_text(), re.M), (
            file
        )
