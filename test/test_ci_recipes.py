"""The CI recipes do what they say: their commands are read from the document and run as given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.scoring.baseline import Baseline
from vio_eval_ros.simulation import Drift, simulate
from vio_eval_ros.version import __version__

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = (ROOT / 'docs/ci.md').read_text()
ACTION = yaml.safe_load((ROOT / 'action.yml').read_text())
OURS = f'OWNER/vio_eval_ros@{__version__}'
BLOCKS = re.findall(r'```(yaml|bash)\n(.*?)```', DOCUMENT, re.DOTALL)
RECIPES = {
    text.splitlines()[0]: yaml.safe_load(text) for language, text in BLOCKS if language == 'yaml'
}
STEPS = '# .github/workflows/accuracy.yml'
ACTION_STEPS = f'{STEPS}, with the action'
OF_MAIN = '# .github/workflows/accuracy-of-main.yml'
RECORD = '# .github/workflows/record-baseline.yml'
GITLAB = '# .gitlab-ci.yml'
LFS = '# in place of the checkout above'
# What commands of the recipes would change on this machine is only written down by these: the
# package is not installed from its repository, and Git LFS fetches nothing. All else is run.
STAND_INS = {
    'pip': 'echo "pip $*" >> "$STOOD_IN"',
    'git': 'echo "git $*" >> "$STOOD_IN"',
    'python': (
        'if [ "$1 $2" = "-m pip" ]; then shift 2; echo "pip $*" >> "$STOOD_IN"; exit; fi\n'
        f'exec {shlex.quote(sys.executable)} "$@"'
    ),
}
RECORD_SH = 'mkdir -p runs && cp -r "$VERSIONS/$VERSION"/. runs/'
SUITE = """
options: {rpe_deltas: [1f]}
gates: {ate_trans_rmse_m: {max: 0.5}}
sequences:
- {name: V1_02, estimate: 'runs/V1_02/*.tum', ground_truth: gt.tum}
"""
STATUS = {'good': 0, 'worse': 1, 'nothing': 2}


@dataclass
class Server:
    """
    A build server at work in a folder: runs steps as GitHub does, and jobs as GitLab does.

    :param version: of the stack, of which ``ci/record.sh`` gets the runs.
    """

    folder: Path
    version: str
    ref: str = 'refs/heads/main'
    event: str = 'push'
    output: str = ''
    uploaded: list[str] = field(default_factory=list)
    saved: list[str] = field(default_factory=list)

    @property
    def summary(self) -> str:
        return self._text('summary')

    @property
    def verdict(self) -> str:
        # of an output that is written twice, the later value counts
        return self._text('outputs').splitlines()[-1]

    @property
    def stood_in(self) -> list[str]:
        """What was asked of the stand-ins."""
        return self._text('stood_in').splitlines()

    def _text(self, name: str) -> str:
        file = self.folder.parent / name
        return file.read_text() if file.exists() else ''

    def bash(self, script: str, env: Mapping[str, str], *options: str) -> int:
        """Run a script; return its exit status."""
        file = self.folder.parent / 'script.sh'
        file.write_text(script)
        environment = {name: value for name, value in os.environ.items() if name != 'BASH_ENV'} | {
            'PATH': f'{self.folder.parent / "bin"}{os.pathsep}{os.environ["PATH"]}',
            'PYTHONPATH': str(ROOT),
            'VERSIONS': str(self.folder.parent / 'versions'),
            'VERSION': self.version,
            'STOOD_IN': str(self.folder.parent / 'stood_in'),
            'GITHUB_STEP_SUMMARY': str(self.folder.parent / 'summary'),
            'GITHUB_OUTPUT': str(self.folder.parent / 'outputs'),
            'GITHUB_ACTION_PATH': str(ROOT),
            'GITHUB_EVENT_NAME': self.event,
        }
        done = subprocess.run(
            ['bash', '--noprofile', '--norc', *options, str(file)],
            cwd=self.folder,
            env=environment | dict(env),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
            timeout=120,
        )
        self.output += done.stdout
        return done.returncode

    def run(self, steps: list[dict[str, Any]], inputs: Mapping[str, str] | None = None) -> int:
        """Run the steps of a job or an action of GitHub; return the first status that is not 0."""
        inputs, failed = inputs or {}, 0
        for step in steps:
            if not self._wanted(step.get('if', 'success()'), inputs, failed):
                continue
            if 'run' in step:
                assert '${{' not in step['run']
                env = {name: filled(text, inputs) for name, text in step.get('env', {}).items()}
                options = ['-eo', 'pipefail'] if step.get('shell') == 'bash' else ['-e']
                status = self.bash(step['run'], env, *options)
            else:
                status = self._use(step['uses'], step.get('with', {}))
            failed = failed or status
        return failed

    def _wanted(self, condition: str, inputs: Mapping[str, str], failed: int) -> bool:
        summary = self.folder / 'accuracy/score.md'
        return {
            'success()': not failed,
            'always()': True,
            "always() && hashFiles('accuracy/score.md') != ''": summary.exists(),
            "github.ref == 'refs/heads/main'": not failed and self.ref == 'refs/heads/main',
            "inputs.python-version != ''": not failed and inputs.get('python-version') != '',
        }[condition]

    def _use(self, action: str, given: dict[str, str]) -> int:
        """Do what an action would do, as far as it can be seen."""
        if action == OURS:
            known = {name: one.get('default') for name, one in ACTION['inputs'].items()}
            assert given.keys() <= known.keys()
            return self.run(ACTION['runs']['steps'], known | given)
        name = action.partition('@')[0].removeprefix('actions/')
        if name == 'upload-artifact':
            assert (self.folder / given['path']).exists()
            self.uploaded.append(given['path'])
        elif name == 'cache/save':
            assert (self.folder / given['path']).is_file()
            self.saved.append(given['key'])
        else:
            assert name in ('checkout', 'setup-python', 'cache', 'cache/restore'), action
        return 0

    def run_gitlab(self, job: dict[str, Any]) -> int:
        """Run a job of GitLab, which puts its lines together into one script."""
        script = '\n'.join(job['script'])
        return self.bash(script, {'CI_PROJECT_DIR': str(self.folder)}, '-eo', 'pipefail')


def filled(text: str, inputs: Mapping[str, str]) -> str:
    """Return a value that may be an input."""
    found = re.fullmatch(r'\$\{\{ inputs\.([\w-]+) \}\}', text)
    assert found or '${{' not in text
    return inputs[found[1]] if found else text


@pytest.fixture(scope='module')
def versions(tmp_path_factory) -> Path:
    """Return a folder with five runs each of a stack that is good, and of one that got worse."""
    folder, usual = tmp_path_factory.mktemp('versions'), Drift()
    for version, factor in (('good', 1.0), ('worse', 1.4)):
        (folder / version / 'V1_02').mkdir(parents=True)
        for k, spread in enumerate((1.0, 1.1, 0.9, 1.05, 0.95)):
            error = factor * spread
            drift = Drift(
                error * usual.position_walk, error * usual.yaw_walk, 1 - 0.01 * error, 0, 0
            )
            run = simulate(duration_s=5.0, drift=drift)
            (folder / version / f'V1_02/{k}.tum').write_text(tum(run.estimate))
    (folder / 'nothing').mkdir()
    (folder / 'gt.tum').write_text(tum(run.ground_truth))
    return folder


@pytest.fixture(scope='module')
def baseline(versions, tmp_path_factory) -> str:
    """Return the baseline of the good version, as the commands in the document record it."""
    server = repository(tmp_path_factory.mktemp('baseline'), versions, 'good')
    (script,) = [text for language, text in BLOCKS if language == 'bash']
    assert server.bash(script, {}, '-e') == 0, server.output
    recorded = Baseline.load(server.folder / 'baseline.json').sequences
    assert len(recorded['V1_02'].metrics['ate_trans_rmse_m']) == 5
    return (server.folder / 'baseline.json').read_text()


def repository(folder: Path, versions: Path, version: str, baseline: str | None = None) -> Server:
    """Return a server with a repository checked out that has what the document asks for."""
    checkout = folder / 'checkout'
    (checkout / 'ci').mkdir(parents=True)
    (folder / 'bin').mkdir()
    (folder / 'versions').symlink_to(versions)
    programs = {folder / 'bin' / name: script for name, script in STAND_INS.items()}
    for file, script in {**programs, checkout / 'ci/record.sh': RECORD_SH}.items():
        file.write_text(f'#!/bin/sh\n{script}\n')
        file.chmod(0o755)
    (checkout / 'suite.yaml').write_text(SUITE)
    shutil.copy(versions / 'gt.tum', checkout)
    if baseline is not None:
        (checkout / 'baseline.json').write_text(baseline)
    return Server(checkout, version)


@pytest.fixture(params=STATUS)
def server(request, tmp_path, versions, baseline) -> Server:
    return repository(tmp_path, versions, request.param, baseline)


@pytest.fixture
def good(tmp_path, versions, baseline) -> Server:
    return repository(tmp_path, versions, 'good', baseline)


def steps_of(name: str) -> list[dict[str, Any]]:
    (job,) = RECIPES[name]['jobs'].values()
    return job['steps']


def check_reports(server: Server) -> None:
    """Check that all that is published is there, and says what was found."""
    reports = server.folder / 'accuracy'
    if server.version == 'nothing':
        assert list(reports.iterdir()) == []
        assert 'nothing matches' in server.output
        return
    verdict = 'fail' if STATUS[server.version] else 'pass'
    assert json.loads((reports / 'score.json').read_text())['verdict'] == verdict
    cases = list(ElementTree.parse(reports / 'score.xml').iter('testcase'))
    failed = [case.get('name') for case in cases if case.find('failure') is not None]
    assert failed == (['ate_trans_rmse_m against the baseline'] if verdict == 'fail' else [])
    assert '<html' in (reports / 'score.html').read_text()[:100]


def test_every_command_of_the_document_is_one_that_is_run_here():
    languages = set(re.findall(r'```(\w*)\n', DOCUMENT)) - {''}
    assert languages == {'yaml', 'bash'}
    assert set(RECIPES) == {STEPS, ACTION_STEPS, OF_MAIN, RECORD, GITLAB, LFS}
    assert len(BLOCKS) == len(RECIPES) + 1


def test_the_steps_of_github_give_the_verdict_and_publish_the_reports(server):
    assert server.run(steps_of(STEPS)) == STATUS[server.version], server.output
    check_reports(server)
    (install,) = server.stood_in
    assert install.startswith('pip install vio_eval_ros[report] @ git+https://')
    assert install.endswith(f'@{__version__}')
    assert server.uploaded == ['accuracy']
    assert (r'| V1\_02 | 5 |' in server.summary) is (server.version != 'nothing')


def test_the_action_gives_the_verdict_and_publishes_the_reports(server):
    assert server.run(steps_of(ACTION_STEPS)) == STATUS[server.version], server.output
    check_reports(server)
    word = {0: 'pass', 1: 'fail', 2: 'error'}[STATUS[server.version]]
    assert server.verdict == f'verdict={word}'
    assert server.stood_in == [f'pip install --quiet {ROOT}[report]']
    assert (r'| V1\_02 | 5 |' in server.summary) is (server.version != 'nothing')
    manifest = server.folder / 'accuracy/manifest.json'
    assert manifest.exists() is (server.version != 'nothing')


def test_the_job_of_gitlab_gives_the_verdict_and_publishes_the_reports(server):
    job = RECIPES[GITLAB]['accuracy']
    assert server.run_gitlab(job) == STATUS[server.version], server.output
    check_reports(server)
    assert job['artifacts']['when'] == 'always'
    assert job['artifacts']['reports']['junit'] == 'accuracy/score.xml'
    assert job['artifacts']['paths'] == ['accuracy/']


def test_a_baseline_is_recorded_on_demand(tmp_path, versions, baseline):
    server = repository(tmp_path, versions, 'good')
    assert server.run(steps_of(RECORD)) == 0, server.output
    assert server.uploaded == ['baseline.json']
    assert (server.folder / 'baseline.json').read_text() == baseline


def test_main_records_its_baseline_and_branches_are_compared_with_it(tmp_path, versions, baseline):
    server = repository(tmp_path, versions, 'good')
    assert server.run(steps_of(OF_MAIN)) == 0, server.output
    assert server.saved == ['baseline-${{ github.run_id }}-${{ github.run_attempt }}']
    assert (server.folder / 'baseline.json').read_text() == baseline
    server.ref, server.version = 'refs/pull/1/merge', 'worse'
    assert server.run(steps_of(OF_MAIN)) == 1, server.output
    assert len(server.saved) == 1
    assert (server.folder / 'baseline.json').read_text() == baseline
    assert server.summary.count('### vio_eval_ros') == 2
    server.ref = 'refs/heads/main'  # what got worse is not the next baseline
    assert server.run(steps_of(OF_MAIN)) == 1
    assert len(server.saved) == 1


@pytest.mark.parametrize('change', ['worse', 'options'])
def test_a_main_that_fails_by_its_baseline_is_freed_by_hand(tmp_path, versions, baseline, change):
    server = repository(tmp_path, versions, 'good', baseline)
    if change == 'options':
        suite = server.folder / 'suite.yaml'
        text = suite.read_text().replace('{rpe_deltas', '{alignment: posyaw, rpe_deltas')
        suite.write_text(text)
    else:
        server.version = 'worse'
    assert server.run(steps_of(OF_MAIN)) == (1 if change == 'worse' else 2), server.output
    assert server.saved == []
    assert 'workflow_dispatch' in RECIPES[OF_MAIN][True]  # YAML's on
    server.event = 'workflow_dispatch'
    assert server.run(steps_of(OF_MAIN)) == 0, server.output
    assert len(server.saved) == 1
    server.event = 'push'
    assert server.run(steps_of(OF_MAIN)) == 0, server.output


def test_recordings_come_from_git_lfs(good):
    assert good.run(RECIPES[LFS]['steps']) == 0
    assert good.stood_in == ['git lfs pull']


def test_workflows_may_only_read_the_repository():
    for name in (STEPS, ACTION_STEPS, OF_MAIN, RECORD):
        assert RECIPES[name]['permissions'] == {'contents': 'read'}


def test_no_input_of_the_action_is_pasted_into_a_script():
    for step in ACTION['runs']['steps']:
        assert '${{' not in step.get('run', '')
        assert step.get('shell', 'bash') == 'bash'


def test_the_inputs_and_outputs_of_the_action_are_documented():
    for name, one in ACTION['inputs'].items():
        default = f'`{one["default"]}`' if one.get('default') else 'none'
        shown = '' if one.get('required') else f' {default}'
        assert f'| `{name}` |{shown} |' in DOCUMENT, name
    assert list(ACTION['outputs']) == ['verdict']


def act(server: Server, **given: str) -> int:
    """Run the action with inputs, of which the underscores are dashes."""
    inputs = {name.replace('_', '-'): text for name, text in given.items()}
    return server.run([{'uses': OURS, 'with': inputs}])


@pytest.mark.parametrize(
    'name',
    [
        '$(touch hacked) `touch hacked`; touch hacked #.yaml',
        '"; touch hacked; "\'; touch hacked\n touch hacked.yaml',
        '--record-baseline=hacked',
        '-h',
        '${{ github.token }}.yaml',
        '*',
    ],
)
def test_a_hostile_input_is_a_name_and_nothing_else(good, name):
    assert good.bash(RECORD_SH, {}) == 0
    (good.folder / 'suite.yaml').rename(good.folder / name)
    (good.folder / 'baseline.json').rename(good.folder / f'b{name}')
    before = {*good.folder.iterdir(), good.folder / f'r{name}'}
    arguments = f'--set sequences.V1_02.tags=[a]\n\n  --tags={"a" if name == "*" else "V1_02"}'
    status = act(good, suite=name, baseline=f'b{name}', report_dir=f'r{name}', arguments=arguments)
    assert status == 0, good.output
    assert good.verdict == 'verdict=pass'
    assert set(good.folder.iterdir()) == before
    assert {file.name for file in (good.folder / f'r{name}').iterdir()} == {
        f'score.{kind}' for kind in ('json', 'xml', 'md', 'html')
    }


def test_an_argument_is_one_line_whatever_is_in_it(good):
    assert good.bash(RECORD_SH, {}) == 0
    hostile = '--set=sequences.V1_02.tags=[$(touch hacked); touch hacked && `touch hacked` *]'
    assert act(good, suite='suite.yaml', arguments=hostile) == 0, good.output
    assert not (good.folder / 'hacked').exists()
    result = json.loads((good.folder / 'accuracy/score.json').read_text())
    assert result['sequences'][0]['tags'] == [hostile.partition('[')[2][:-1]]


def test_what_is_printed_is_no_command_to_the_runner(good):
    assert good.bash(RECORD_SH, {}) == 0
    name = '::error::hacked'
    for _ in range(2):
        act(good, suite='suite.yaml', arguments=f"--set=sequences.V1_02.name='{name}'")
    lines = good.output.splitlines()
    tokens = [line.removeprefix('::stop-commands::') for line in lines if '::stop' in line]
    assert len(set(tokens)) == 2
    listening = True
    for line in lines:
        if line in [f'::stop-commands::{token}' for token in tokens]:
            listening = False
        elif line in [f'::{token}::' for token in tokens]:
            listening = True
        else:
            assert not (listening and line.startswith('::')), line
    assert any(line.startswith(name) for line in lines)


def test_reports_of_an_earlier_run_are_not_taken_for_those_of_this(good):
    assert good.bash(RECORD_SH, {}) == 0
    assert act(good, suite='suite.yaml') == 0
    assert good.summary.count('### vio_eval_ros') == 1
    assert act(good, suite='nowhere.yaml') == 2
    assert good.verdict == 'verdict=error'
    assert good.summary.count('### vio_eval_ros') == 1
    assert list((good.folder / 'accuracy').iterdir()) == []


def test_a_folder_of_the_name_of_the_package_is_not_the_package(good):
    assert good.bash(RECORD_SH, {}) == 0
    (good.folder / 'vio_eval_ros').mkdir()
    (good.folder / 'vio_eval_ros/__main__.py').write_text('raise SystemExit(7)')
    assert act(good, suite='suite.yaml') == 0, good.output


def test_the_python_of_the_workspace_may_be_kept():
    condition = ACTION['runs']['steps'][0]['if']
    nowhere = Server(Path('nowhere'), 'good')
    assert nowhere._wanted(condition, {'python-version': '3.12'}, 0)
    assert not nowhere._wanted(condition, {'python-version': ''}, 0)


def test_a_folder_that_cannot_be_made_is_an_error_and_no_verdict_of_yesterday(good):
    assert act(good, suite='suite.yaml', report_dir='/proc/x') != 0
    assert good.verdict == 'verdict=error'
