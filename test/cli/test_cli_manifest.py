"""Manifests as their users meet them: `--manifest` on two verbs, and `score --verify`."""

import json
from pathlib import Path

import pytest

from verbs import call, complaint, start
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate, write_recording

PAIR = ('--estimate', 'runs/a.tum', '--ground-truth', 'gt.tum')
SUITE = """
stack: {name: okvis, config: [vio.yaml]}
sequences:
  - {name: V1_02, estimate: runs/*.tum, ground_truth: gt.tum}
"""


@pytest.fixture
def lab(tmp_path) -> Path:
    """Return a folder with a flight, two runs on it and what belongs to the stack."""
    folder = tmp_path / 'lab'
    (folder / 'runs').mkdir(parents=True)
    flight = simulate(duration_s=5.0)
    (folder / 'gt.tum').write_text(tum(flight.ground_truth))
    (folder / 'runs/a.tum').write_text(tum(flight.estimate))
    (folder / 'runs/b.tum').write_text(tum(flight.estimate[:-3]))
    (folder / 'vio.yaml').write_text('keyframes: 5\n')
    (folder / 'suite.yaml').write_text(SUITE)
    return folder


def test_a_replay_is_reproduced_and_says_when_it_is_not(lab, tmp_path):
    done = call(
        'replay', *PAIR, '--manifest', 'm.json', '--sequence', 'V1_02', '--stack-name', 'okvis',
        '--stack-version', '2.1', '--stack-commit', '4f2a9c1', '--stack-config', 'vio.yaml',
        '--calibration', 'vio.yaml', '--gate', 'ate_trans_rmse_m<=1', '--json', cwd=lab,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, '')
    content = json.loads((lab / 'm.json').read_text())
    (sequence,) = content['sequences']
    assert sequence['name'] == 'V1_02'
    assert sequence['stack']['commit'] == '4f2a9c1'
    assert list(content['texts'].values()) == ['keyframes: 5\n']
    assert sequence['runs'][0]['result'] == json.loads(done.stdout)

    good = start('score', '--verify', lab / 'm.json', cwd=tmp_path)  # in another process
    assert (good.returncode, good.stderr) == (0, '')
    assert good.stdout == 'reproduced to the last bit: 1 of 1 runs are unchanged\n'

    (lab / 'runs/a.tum').write_bytes((lab / 'runs/b.tum').read_bytes())
    (lab / 'vio.yaml').write_text('keyframes: 7\n')
    bad = call('score', '--verify', 'm.json', cwd=lab)
    assert (bad.returncode, bad.stderr) == (1, '')
    lines = bad.stdout.splitlines()
    assert lines[0] == 'V1_02, runs/a.tum: runs/a.tum has changed'
    assert any(': ate_trans_rmse_m was 0.' in line for line in lines)
    assert lines[-2:] == [
        'note: vio.yaml has changed',
        'not reproduced: 0 of 1 runs are unchanged',
    ]


def test_the_name_of_a_sequence_is_by_default_that_of_its_file(lab):
    assert call('replay', *PAIR, '--manifest', 'm.json', cwd=lab).returncode == 0
    assert json.loads((lab / 'm.json').read_text())['sequences'][0]['name'] == 'gt'


def test_a_suite_writes_its_manifest_where_it_or_the_user_says(lab):
    assert call('score', 'suite.yaml', '--manifest', 'm.json', cwd=lab).returncode == 0
    (lab / 'results').mkdir()
    with (lab / 'suite.yaml').open('a') as file:
        file.write('manifest: results/manifest.json\n')
    assert call('score', 'lab/suite.yaml', cwd=lab.parent).returncode == 0
    for manifest in ('m.json', 'results/manifest.json'):
        done = call('score', '--verify', manifest, cwd=lab)
        assert (done.returncode, done.stderr) == (0, '')
        assert '2 of 2 runs are unchanged' in done.stdout
    content = json.loads((lab / 'results/manifest.json').read_text())
    files = content['sequences'][0]['runs'][0]['estimate']['files']
    assert files[0]['path'] == '../runs/a.tum'


def test_a_suite_has_the_same_manifest_with_any_number_of_processes(lab):
    for jobs, name in ((1, 'one.json'), (2, 'two.json')):
        done = call('score', 'suite.yaml', '--jobs', jobs, '--manifest', name, cwd=lab)
        assert done.returncode == 0, done.stderr
    assert (lab / 'one.json').read_bytes() == (lab / 'two.json').read_bytes()


def test_what_cannot_be_verified_is_one_line_and_status_2(lab):
    assert 'nowhere.json: No such file' in complaint('score', '--verify', 'nowhere.json', cwd=lab)
    (lab / 'm.json').write_text('{"schema": ')
    assert 'is damaged' in complaint('score', '--verify', 'm.json', cwd=lab)
    for rest in (['suite.yaml'], ['--json'], ['--tags', 'a'], ['--manifest', 'x']):
        assert 'cannot be combined' in complaint('score', '--verify', 'm.json', *rest, cwd=lab)
    assert 'give a SUITE.yaml, or a manifest' in complaint('score', cwd=lab)


@pytest.mark.parametrize(
    ('arguments', 'problem'),
    [
        (['--stack-name', 'okvis'], 'need --manifest'),
        (['--calibration', 'vio.yaml'], 'need --manifest'),
        (['--sequence', 'V1_02'], 'need --manifest'),
        (['--manifest', 'm.json', '--stack-config', 'no.yaml'], 'no.yaml: no such file'),
        (['--manifest', 'nowhere/m.json'], 'there is no folder nowhere'),
        (['--manifest', 'gt.tum'], 'would overwrite the input gt.tum'),
        (['--manifest', 'm.json', '--report', 'json:m.json'], 'would overwrite'),
    ],
)
def test_a_manifest_that_makes_no_sense_is_one_line_and_status_2(lab, arguments, problem):
    before = sorted(lab.rglob('*'))
    assert problem in complaint('replay', *PAIR, *arguments, cwd=lab)
    assert sorted(lab.rglob('*')) == before


@pytest.mark.parametrize(
    'report',
    [
        '--report=json:flight/metadata.yaml',
        '--report=json:flight/new.json',
        '--report=csv:vio.yaml',
        '--report=csv:gates.yaml',
        '--report=csv:options.yaml',
        '--manifest=flight/flight.mcap',
    ],
)
def test_a_replay_writes_nothing_where_an_input_is(lab, report):
    write_recording(simulate(duration_s=1.0), lab / 'flight')
    (lab / 'gates.yaml').write_text('ate_trans_rmse_m: {max: 1}\n')
    (lab / 'options.yaml').write_text('alignment: se3\n')
    given = ['flight', '--gates', 'gates.yaml', '--config', 'options.yaml', report]
    if 'vio' in report:
        given += ['--manifest', 'm.json', '--stack-config', 'vio.yaml']
    before = {path: path.read_bytes() for path in lab.rglob('*') if path.is_file()}
    assert 'the input' in complaint('replay', *given, cwd=lab)
    assert {path: path.read_bytes() for path in lab.rglob('*') if path.is_file()} == before


@pytest.mark.parametrize(
    ('line', 'problem'),
    [
        ('manifest: nowhere/m.json', 'there is no folder nowhere'),
        ('manifest: suite.yaml', 'would overwrite the input suite.yaml'),
        ('manifest: m.json\ncalibration: no.yaml', 'no.yaml: no such file'),
        ('manifest: m.json\nstack: {version: 2.1}', 'put it in quotes'),
    ],
)
def test_a_suite_with_such_a_manifest_is_not_scored_first(lab, line, problem):
    suite = SUITE.replace('stack: {name: okvis, config: [vio.yaml]}', line)
    (lab / 'suite.yaml').write_text(suite)
    assert problem in complaint('score', 'suite.yaml', cwd=lab)
    assert (lab / 'suite.yaml').read_text() == suite


def test_a_manifest_that_cannot_be_written_does_not_lose_the_result(lab):
    for verb, arguments in (('replay', PAIR), ('score', ['suite.yaml'])):
        done = call(verb, *arguments, '--manifest', '/dev/full', cwd=lab)
        assert done.returncode == 2
        assert 'ATE' in done.stdout
        assert '/dev/full: cannot write' in done.stderr


def test_names_in_a_manifest_cannot_move_the_cursor(lab):
    assert call('replay', *PAIR, '--manifest', 'm.json', cwd=lab).returncode == 0
    content = json.loads((lab / 'm.json').read_text())
    content['sequences'][0]['name'] = 'a\x1b[2J\nb'
    content['machine']['numpy'] = '\x1b]0;title\x07'
    content['sequences'][0]['runs'][0]['result']['metrics']['ate_trans_rmse_m'] = '\x1b[31m'
    (lab / 'm.json').write_text(json.dumps(content))
    done = call('score', '--verify', 'm.json', cwd=lab)
    assert done.returncode == 1
    assert '\x1b' not in done.stdout
    assert '\x07' not in done.stdout
    assert len(done.stdout.splitlines()) == 3


def test_a_real_run_is_reproduced_from_its_recording(shared_data, tmp_path):
    recording = shared_data / 'derived_bags/euroc_V1_02_vins_fusion_sqlite3'
    done = call('replay', recording, '--manifest', 'm.json', '--json', cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    run_of = json.loads((tmp_path / 'm.json').read_text())['sequences'][0]['runs'][0]
    assert run_of['estimate']['spec'] == f'{recording}:/vio/odometry'
    again = call('score', '--verify', 'm.json', cwd=tmp_path)
    assert again.returncode == 0, again.stdout
    assert 'reproduced to the last bit' in again.stdout
