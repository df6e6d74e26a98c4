"""Suites of several systems: listed, or found from the folders; holes stay visible."""

from functools import partial
import json
from pathlib import Path

import pytest

import verbs
from vio_eval_ros.scoring.documents import SUITE_REPORTS
from vio_eval_ros.scoring.loading import load_suite
from vio_eval_ros.scoring.matching import nearest
from vio_eval_ros.scoring.suite import Suite

ATE = 'ate_trans_rmse_m'
score, document, complaint = (
    partial(how, 'score') for how in (verbs.call, verbs.document, verbs.complaint)
)
TEMPLATE = """\
options: {alignment: none, rpe_deltas: [1f]}
estimate: runs/{system}/{sequence}/*.tum
ground_truth: gt.tum
sequences: [one, two]
"""
LISTED = """\
options: {alignment: none, rpe_deltas: [1f]}
ground_truth: gt.tum
sequences: [{name: one}, {name: two}]
systems:
  - {name: good, estimate: 'runs/good/{sequence}/*.tum'}
  - {name: poor, estimate: 'runs/poor/{sequence}/*.tum', options: {alignment: se3}}
"""


@pytest.fixture
def folder(lab) -> Path:
    """Return runs of two systems on two sequences; good is off by 0.1 m, poor by twice that."""
    for sequence in ('one', 'two'):
        lab.runs(f'runs/good/{sequence}', 0.1, 0.11, 0.12)
        lab.runs(f'runs/poor/{sequence}', 0.2, 0.22, 0.24)
    return lab.folder


def write(folder: Path, text: str) -> Path:
    (folder / 'suite.yaml').write_text(text)
    return folder / 'suite.yaml'


def load(folder: Path, text: str, *overrides: str) -> Suite:
    return load_suite(write(folder, text), overrides)


def refusal(folder: Path, text: str) -> str:
    told = complaint(write(folder, text), '--jobs', 1)
    return told.removeprefix(f'score: {folder}/suite.yaml: ').strip()


@pytest.mark.parametrize('text', [TEMPLATE, TEMPLATE + 'systems: [good, poor]\n', LISTED])
def test_a_cell_is_the_runs_of_a_system_on_a_sequence(folder, text):
    suite = load(folder, text)
    assert [(one.name, one.system) for one in suite.sequences] == [
        ('one', 'good'), ('one', 'poor'), ('two', 'good'), ('two', 'poor'),
    ]  # fmt: skip
    assert all(len(one.runs) == 3 for one in suite.sequences)
    assert suite.sequences[1].runs[0].name == 'runs/poor/one/0.tum'
    assert suite.sequences[1].title == 'one/poor'


def test_what_a_system_states_goes_over_what_the_sequence_states(folder):
    text = LISTED.replace('{name: two}', '{name: two, options: {alignment: sim3}}')
    found = {one.title: one.config.alignment for one in load(folder, text).sequences}
    assert found == {
        'one/good': 'none', 'one/poor': 'se3', 'two/good': 'sim3', 'two/poor': 'se3',
    }  # fmt: skip
    changed = load(folder, text, 'systems.poor.options.alignment=posyaw')
    assert changed.sequences[1].config.alignment == 'posyaw'


def test_names_stand_for_themselves_in_templates(folder, lab):
    lab.runs('runs/a[1]*/one', 0.3)
    suite = load(folder, TEMPLATE.replace('[one, two]', '[one]'))
    assert [one.system for one in suite.sequences] == ['a[1]*', 'good', 'poor']
    assert [len(one.runs) for one in suite.sequences] == [1, 3, 3]


def test_systems_of_a_file_name_and_of_two_places_are_found(folder, lab):
    lab.run('flat/vins_one_vins.tum', 0.1)
    lab.run('flat/dso_one_vins.tum', 0.1)
    text = TEMPLATE.replace(
        'runs/{system}/{sequence}/*.tum', 'flat/{system}_{sequence}_{system}.tum'
    )
    suite = load(folder, text.replace('[one, two]', '[one]'))
    assert [one.system for one in suite.sequences] == ['vins']


@pytest.mark.slow
def test_every_number_of_the_table_is_the_median_that_replay_gives(folder):
    found = document(write(folder, LISTED), '--jobs', 1)['matrix']
    assert found['systems'] == ['good', 'poor']
    for sequence, row in found['metrics'][ATE]['sequences'].items():
        for system, cell in row['systems'].items():
            options = ['--alignment', 'se3' if system == 'poor' else 'none']
            estimate = folder / 'runs' / system / sequence / '1.tum'  # the median of three
            alone = verbs.document(
                'replay', '--estimate', estimate, '--ground-truth', folder / 'gt.tum', *options
            )
            assert cell['value'] == alone['metrics'][ATE]
            assert cell['runs'] == cell['successes'] == 3
    assert 'alignment is' in found['notes'][0]


@pytest.mark.slow
def test_the_table_shows_holes_failures_and_what_the_mean_is_over(folder, lab):
    (folder / 'runs/poor/two/0.tum').unlink()
    for k in (1, 2):
        (folder / f'runs/poor/two/{k}.tum').unlink()
    lab.run('runs/good/one/1.tum', 0.11, until=0.5)
    lab.run('runs/lost/one/0.tum', 0.001, until=0.3)
    lab.run('runs/lost/two/0.tum', 0.3)
    done = score(write(folder, TEMPLATE), '--jobs', 1, '--metric', ATE)
    assert done.returncode == 1
    table = done.stdout.partition('\n\n')[0].splitlines()
    rows = {line.split()[0]: line.split()[1:] for line in table}
    assert rows['system'] == ['one', 'two', 'rank']
    assert rows['good'][:3] == ['0.12', '*‡', '0.110']
    assert rows['lost'][:2] == ['0.001', '†']
    assert rows['poor'] == ['0.22', '+', 'missing', '2.50', '+']
    text = done.stdout
    assert 'one, good: 1 of 3 runs: tracked_ratio is 0.4987, not >= 0.9' in text
    assert "poor: no run of two: nothing matches 'runs/poor/two/*.tum' in" in text
    assert 'no mean of ATE [m]: on every sequence some system has failed or no run' in text
    assert text.endswith('fail: 3 of 6 sequences x systems failed\n')


@pytest.mark.parametrize(
    ('template', 'near'),
    [
        ('rusn/{system}/{sequence}.tum', "; did you mean 'runs'?"),
        ('runs/{system}/{sequence}.tun', "; did you mean 'one.tum'?"),
        ('runs/goot/{sequence}.tum', "; did you mean 'good'?"),
    ],
)
def test_a_template_that_leads_nowhere_names_what_may_be_meant(tmp_path, template, near):
    folder = tmp_path / 'runs' / 'good'
    folder.mkdir(parents=True)
    for file in (folder / 'one.tum', tmp_path / 'gt.tum'):
        file.write_text('0 0 0 0 0 0 0 1\n')
    pattern = template.format(system='good', sequence='one')
    assert nearest(tmp_path, pattern) == near
    assert nearest(tmp_path, 'runs/good/two.tum') == ''
    assert nearest(tmp_path, 'runs/good/one.tum/x') == ''


@pytest.mark.slow
@pytest.mark.parametrize('name', SUITE_REPORTS)
def test_every_report_has_every_system_and_the_hole(folder, name):
    for file in (folder / 'runs/poor/two').iterdir():
        file.unlink()
    done = score(write(folder, TEMPLATE), '--jobs', 1, '--report', f'{name}:{folder}/report')
    assert done.returncode == 1
    text = (folder / 'report').read_text()
    assert all(system in text for system in ('good', 'poor'))
    assert any(hole in text for hole in ('missing', 'nothing matches'))


@pytest.mark.slow
def test_baselines_and_manifests_are_by_sequence_and_system(folder):
    suite, baseline, manifest = (
        write(folder, TEMPLATE), folder / 'baseline.json', folder / 'manifest.json',
    )  # fmt: skip
    first = score(suite, '--jobs', 1, '--record-baseline', baseline, '--manifest', manifest)
    assert first.returncode == 0, first.stdout
    recorded = json.loads(baseline.read_text())['sequences']
    assert list(recorded) == ['one/good', 'one/poor', 'two/good', 'two/poor']
    assert recorded['two/poor']['metrics'][ATE]['values'][0] == pytest.approx(0.2)
    again = score(suite, '--jobs', 1, '--baseline', baseline)
    assert again.returncode == 0, again.stdout
    assert verbs.call('score', '--verify', manifest).returncode == 0


@pytest.mark.parametrize(
    ('change', 'problem'),
    [
        (('{system}', '{sistem}'), "line 2: estimate: '{sistem}' stands for nothing; there are"),
        (('{system}', '{sistem}'), "did you mean 'system'?"),
        (('{sequence}', '{sequense}'), "did you mean 'sequence'?"),
        (('gt.tum', 'gt/{sequence}.tum'), 'line 3: ground_truth: there is no'),
        (('gt.tum', 'gt/{gt}.tum'), "line 3: ground_truth: '{gt}' stands for nothing"),
        (('runs/', 'ruins/'), "nothing matches 'ruins/{system}/{sequence}/*.tum' in"),
        (('/{sequence}/', '/one/'), 'without {sequence} in it, every sequence would be the same'),
        (('[one, two]', '[one, one]'), "there are two sequences 'one'"),
        (('sequences:', 'systems: [good, good]\nsequences:'), "there are two systems 'good'"),
        (('sequences:', 'systems: []\nsequences:'), 'systems: expected a list of at least one'),
        (('sequences:', 'systems: [a/b]\nsequences:'), "has no '/' in it, as in 'a/b'"),
        (
            ('sequences:', 'systems: [{nam: a}]\nsequences:'),
            "there is no 'nam' here; did you mean",
        ),
        (('sequences:', 'system: [good]\nsequences:'), "no 'system' here; did you mean"),
    ],
)
def test_what_makes_no_sense_is_one_line(folder, change, problem):
    assert problem in refusal(folder, TEMPLATE.replace(*change))


def test_systems_that_would_be_the_same_runs_are_refused(folder):
    same = TEMPLATE.replace('{system}', 'good') + 'systems: [good, poor]\n'
    assert 'without {system} in it, every system would be the same' in refusal(folder, same)
    twice = LISTED.replace('{name: one}', '{name: one, estimate: runs/good/one/*.tum}')
    assert 'the systems say where theirs are' in refusal(folder, twice)


def test_a_system_may_have_the_files_of_another_under_other_options(folder):
    same = LISTED.replace('runs/poor', 'runs/good')
    assert [one.runs[0].name for one in load(folder, same).sequences[:2]] == [
        'runs/good/one/0.tum', 'runs/good/one/0.tum',
    ]  # fmt: skip
    inherited = LISTED.replace("good, estimate: 'runs/good/{sequence}/*.tum'", 'good')
    suite = load(folder, 'estimate: runs/good/{sequence}/*.tum\n' + inherited)
    assert suite.sequences[0].runs[0].name == 'runs/good/one/0.tum'


def test_a_system_in_braces_needs_systems(folder):
    text = TEMPLATE.replace('{system}', 'good').replace('gt.tum', 'gt{system}.tum')
    assert '{system} stands for nothing: list systems' in refusal(folder, text)


def test_metrics_are_chosen_where_there_are_systems(folder, lab):
    told = complaint(lab.suite('one, estimate: runs/good/one/*.tum'), '--metric', ATE)
    assert '--metric is for suites that compare systems' in told
    assert "no metric 'ate'" in complaint(write(folder, TEMPLATE), '--metric', 'ate')


@pytest.mark.slow
def test_one_system_alone_has_a_table_without_best(folder):
    text = TEMPLATE + 'systems: [good]\n'
    done = score(write(folder, text), '--jobs', 1)
    assert done.returncode == 0
    assert 'only one system: nothing to compare it with' in done.stdout
    assert ' *' not in done.stdout
