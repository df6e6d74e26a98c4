"""A manifest names all that a result was made of, and makes it again to the last bit."""

from collections.abc import Callable, Iterator
import copy
import hashlib
import json
import os
from pathlib import Path
import shutil
from typing import Any

from jsonschema import Draft202012Validator
import pytest
from referencing import Registry, Resource

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.errors import ConfigError, ReadError, VioEvalError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.scoring import manifest as manifests
from vio_eval_ros.scoring import recorded_manifest
from vio_eval_ros.scoring import stack as stacks
from vio_eval_ros.scoring.baseline import Baseline, definition_sha256
from vio_eval_ros.scoring.loading import load_suite
from vio_eval_ros.scoring.manifest import Manifest, manifest_of_suite
from vio_eval_ros.scoring.recorded_manifest import load_manifest
from vio_eval_ros.scoring.results import RunResult
from vio_eval_ros.scoring.scoring import compare_suite, score_suite
from vio_eval_ros.scoring.stack import Document, Stack
from vio_eval_ros.scoring.suite import RunSpec, Suite
from vio_eval_ros.scoring.verification import Verification, verify
from vio_eval_ros.simulation import simulate, write_recording
from vio_eval_ros.version import __version__

SCHEMAS = {
    name: json.loads(
        (Path(__file__).resolve().parents[2] / f'docs/schema/{name}.json').read_text()
    )
    for name in ('manifest-1', 'result-1')
}
NO_STACK = Stack()
CONFIG = EvaluationConfig(rpe_deltas=('1f',))
FLIGHT = simulate(duration_s=2.0)
SUITE = """
manifest: manifest.json
options: {rpe_deltas: [1f]}
stack: {name: okvis, version: '2.1', commit: 4f2a9c1, config: [vio.yaml]}
calibration: cam.yaml
sequences:
  - name: files
    estimate: runs/*.tum
    ground_truth: gt.tum
  - name: recorded
    recording: flight
    estimate: /vio/odometry
    ground_truth: /ground_truth/pose
    stack: {commit: abcdef0}
  - name: revised
    estimate: runs/a.tum
    causal: runs/b.tum
    ground_truth: gt.tum
"""


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_files(folder: Path) -> None:
    """Write a flight as files: its truth, two estimates, and what belongs to the stack."""
    (folder / 'runs').mkdir(parents=True)
    (folder / 'gt.tum').write_text(tum(FLIGHT.ground_truth))
    for name, seed in (('a', 7), ('b', 7)):
        estimate = simulate(duration_s=2.0, seed=seed).estimate
        (folder / f'runs/{name}.tum').write_text(tum(estimate[: -1 if name == 'b' else None]))
    (folder / 'vio.yaml').write_text('keyframes: 5  # größer\n')
    (folder / 'cam.yaml').write_text('fx: 458.654\n')


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    write_files(tmp_path / 'lab')
    monkeypatch.chdir(tmp_path / 'lab')
    return tmp_path / 'lab'


def manifest_of(
    file: Path,
    estimate: str = 'runs/a.tum',
    truth: str = 'gt.tum',
    stack: Stack = NO_STACK,
    config: EvaluationConfig = CONFIG,
    gates: tuple[Gate, ...] = (),
    **origin: Any,
) -> dict[str, Any]:
    """Score a run, write its manifest, and return what is in that."""
    sources = read_sources([estimate, truth], origin.get('recording'), origin.get('times'))
    result = score_run(*sources, config, gates)
    times = origin.pop('times', None)
    run = RunResult(RunSpec(estimate, estimate, **origin), result)
    manifest = Manifest(file)
    manifest.add_sequence(
        'V1_02', [run], ground_truth=truth, config=config, stack=stack, times=times
    )
    file.write_text(manifest.to_json())
    return json.loads(file.read_text())


def valid(content: dict[str, Any]) -> bool:
    """Return whether a manifest is as its documentation says."""
    result = SCHEMAS['result-1']
    registry = Registry().with_resource(result['$id'], Resource.from_contents(result))
    return Draft202012Validator(SCHEMAS['manifest-1'], registry=registry).is_valid(content)


def the_run(content: dict[str, Any]) -> dict[str, Any]:
    ((run,),) = (sequence['runs'] for sequence in content['sequences'])
    return run


def verified(file: Path, content: dict[str, Any]) -> Verification:
    file.write_text(json.dumps(content))
    return verify(file)


def reproduced(found: Verification) -> bool:
    return found.reproduced == found.runs > 0 and not found.differences


def test_every_input_is_named_by_path_and_hash(folder):
    run = the_run(manifest_of(folder / 'manifest.json'))
    assert run['estimate'] == {
        'spec': 'runs/a.tum',
        'files': [{'path': 'runs/a.tum', 'sha256': sha256(folder / 'runs/a.tum')}],
    }
    assert run['ground_truth']['files'] == [{'path': 'gt.tum', 'sha256': sha256(Path('gt.tum'))}]
    assert run['result']['inputs']['estimate']['sha256'] == sha256(folder / 'runs/a.tum')
    assert (run['causal'], run['times'], run['error']) == (None, None, None)


def test_options_tool_and_machine_are_reported(folder):
    content = manifest_of(folder / 'manifest.json')
    assert content['schema'] == 'vio_eval_ros.manifest/1'
    assert content['tool']['name'] == 'vio_eval_ros'
    assert set(content['machine']) == {'platform', 'cpu', 'python', 'numpy'}
    assert all(content['machine'].values())
    (sequence,) = content['sequences']
    assert sequence['name'] == 'V1_02'
    assert EvaluationConfig.from_mapping(sequence['options']) == CONFIG
    assert valid(content)
    the_run(content)['error'] = 'but there is a result'
    assert not valid(content)


def test_it_is_the_same_when_made_twice(folder):
    one, other = (manifest_of(folder / name) for name in ('one.json', 'other.json'))
    assert one == other
    assert Path('one.json').read_bytes() == Path('other.json').read_bytes()


def test_configuration_is_embedded_once_and_what_is_no_short_text_is_hashed(folder, monkeypatch):
    (folder / 'copy.yaml').write_bytes((folder / 'vio.yaml').read_bytes())
    (folder / 'net.onnx').write_bytes(b'\xff\x00')
    (folder / 'long.txt').write_text('word ' * 100)
    monkeypatch.setattr(stacks, 'MAX_TEXT_BYTES', 400)
    names = ['vio.yaml', 'copy.yaml', 'net.onnx', 'long.txt']
    stated = {'name': 'okvis', 'version': '2', 'commit': '4f2a9c1', 'config': names}
    stack = Stack.of(stated, [Path('cam.yaml')])
    content = manifest_of(folder / 'manifest.json', stack=stack)
    (sequence,) = content['sequences']
    assert {key: sequence['stack'][key] for key in ('name', 'version', 'commit')} == {
        'name': 'okvis', 'version': '2', 'commit': '4f2a9c1'
    }  # fmt: skip
    assert sequence['stack']['config'] == [
        {'path': name, 'sha256': sha256(folder / name)} for name in names
    ]
    assert sequence['calibration'] == [{'path': 'cam.yaml', 'sha256': sha256(folder / 'cam.yaml')}]
    assert content['texts'] == {
        sha256(folder / 'vio.yaml'): 'keyframes: 5  # größer\n',
        sha256(folder / 'cam.yaml'): 'fx: 458.654\n',
    }


@pytest.mark.parametrize(
    ('stated', 'problem'),
    [
        ({'comit': 'a'}, "stack: there is no 'comit' here; did you mean 'commit'?"),
        ({'version': 2.1}, "stack: version: '2.1' is not text; put it in quotes"),
        ({'config': {'a': 1}}, 'stack: config: expected a list of files'),
        ({'config': [1]}, 'stack: config: expected a list of files'),
        ({'config': ['nowhere.yaml']}, 'nowhere.yaml: no such file'),
        ({'config': ['runs']}, 'runs: not a file'),
    ],
)
def test_a_stack_that_makes_no_sense_is_an_error(folder, stated, problem):
    with pytest.raises(VioEvalError, match=problem.replace('?', r'\?')):
        Stack.of(stated)


def test_a_result_is_reproduced_from_wherever_it_is_asked_for(folder, monkeypatch):
    manifest_of(folder / 'manifest.json', gates=(Gate('ate_trans_rmse_m', '<=', 1.0),))
    assert verify(Path('manifest.json')) == Verification(1, 1, (), ())
    monkeypatch.chdir('/')
    assert verify(folder / 'manifest.json') == Verification(1, 1, (), ())


def test_what_was_given_relative_may_be_moved_together(folder, tmp_path, monkeypatch):
    (folder / 'results').mkdir()
    content = manifest_of(folder / 'results/manifest.json')
    assert the_run(content)['estimate']['spec'] == '../runs/a.tum'
    monkeypatch.chdir(tmp_path)
    shutil.move(folder, tmp_path / 'archive')
    assert reproduced(verify(tmp_path / 'archive/results/manifest.json'))


def test_what_was_given_absolute_stays_where_it_is(folder, tmp_path):
    absolute = str(folder / 'gt.tum')
    content = manifest_of(folder / 'manifest.json', truth=absolute)
    assert the_run(content)['ground_truth']['spec'] == absolute
    shutil.move('manifest.json', tmp_path / 'manifest.json')
    found = verify(tmp_path / 'manifest.json')
    assert found.differences == (f'V1_02, runs/a.tum: {tmp_path}/runs/a.tum is missing',)


def test_a_folder_that_is_a_link_is_left_by_the_way_the_system_goes(folder, tmp_path):
    (tmp_path / 'elsewhere/deep').mkdir(parents=True)
    (folder / 'results').symlink_to(tmp_path / 'elsewhere/deep')
    manifest_of(folder / 'results/manifest.json')
    assert reproduced(verify(folder / 'results/manifest.json'))


def test_topics_statements_and_stamps_of_poses_are_found_again(folder):
    write_recording(FLIGHT, folder / 'flight')
    (folder / 'wxyz.tum').write_text(
        ''.join(
            ' '.join([*row.split()[:4], row.split()[7], *row.split()[4:7]]) + '\n'
            for row in tum(FLIGHT.estimate).splitlines()[1:]
        )
    )
    estimate, truth = 'wxyz.tum?quaternion=wxyz&stamps=s', '/ground_truth/pose'
    content = manifest_of(folder / 'manifest.json', estimate, truth, recording=Path('flight'))
    run = the_run(content)
    assert run['estimate']['spec'] == estimate
    assert run['ground_truth']['spec'] == 'flight:/ground_truth/pose'
    assert run['ground_truth']['files'][0]['path'] == 'flight/flight.mcap'
    assert reproduced(verify(Path('manifest.json')))

    poses = FLIGHT.estimate.positions
    rows = [f'1 0 0 {x} 0 1 0 {y} 0 0 1 {z}' for x, y, z in poses.tolist()]
    (folder / 'kitti.txt').write_text('\n'.join(rows))
    stamps = (FLIGHT.estimate.stamps_ns / 1e9).tolist()
    (folder / 'times.txt').write_text('\n'.join(map(repr, stamps)))
    content = manifest_of(folder / 'm.json', 'kitti.txt', 'gt.tum', times=Path('times.txt'))
    run = the_run(content)
    assert run['times'] == 'times.txt'
    assert [file['path'] for file in run['estimate']['files']] == ['kitti.txt', 'times.txt']
    assert reproduced(verify(Path('m.json')))


@pytest.fixture
def suite(folder) -> Suite:
    write_recording(FLIGHT, folder / 'flight')
    (folder / 'runs/lost.tum').write_text('1 0 0 0 0 0 0 1\n')
    (folder / 'suite.yaml').write_text(SUITE)
    return load_suite(Path('suite.yaml'))


def write_suite(suite: Suite, baseline: Path | None = None) -> dict[str, Any]:
    assert suite.manifest is not None
    finished = manifest_of_suite(suite.manifest, suite, baseline)
    suite.manifest.write_text(finished(score_suite(suite, 1)))
    return json.loads(suite.manifest.read_text())


def test_a_suite_has_a_manifest_of_all_its_runs(folder, suite):
    (folder / 'baseline.json').write_text('{}')
    content = write_suite(suite, folder / 'baseline.json')
    files, recorded, revised = content['sequences']
    assert [run['estimate']['spec'] for run in files['runs']] == [
        'runs/a.tum', 'runs/b.tum', 'runs/lost.tum'
    ]  # fmt: skip
    lost = files['runs'][2]
    assert lost['result'] is None
    assert 'are the clocks the same?' in lost['error']
    assert lost['estimate']['files'][0]['sha256'] == sha256(folder / 'runs/lost.tum')
    assert recorded['runs'][0]['estimate']['spec'] == 'flight:/vio/odometry'
    assert (files['stack']['commit'], recorded['stack']['commit']) == ('4f2a9c1', 'abcdef0')
    assert files['stack']['config'][0]['path'] == 'vio.yaml'
    assert files['calibration'][0]['path'] == 'cam.yaml'
    assert revised['runs'][0]['causal']['files'][0]['sha256'] == sha256(folder / 'runs/b.tum')
    assert content['suite'] == {'path': 'suite.yaml', 'sha256': sha256(folder / 'suite.yaml')}
    assert content['texts'][content['suite']['sha256']] == SUITE
    assert content['baseline']['path'] == str(folder / 'baseline.json')
    assert valid(content)


def test_a_suite_is_reproduced_with_what_never_could_be_scored(folder, suite, monkeypatch):
    write_suite(suite)
    monkeypatch.chdir('/')
    found = verify(folder / 'manifest.json')
    assert (found.runs, found.reproduced, found.differences) == (5, 5, ())
    (note,) = found.notes
    assert note.startswith('files, runs/lost.tum: could not be scored then: no pairs')


def test_a_run_that_could_not_be_scored_and_now_can_is_reported(folder, suite):
    write_suite(suite)
    shutil.copy('runs/b.tum', 'runs/lost.tum')
    found = verify(folder / 'manifest.json')
    assert found.reproduced == 4
    assert found.differences[:2] == (
        f'files, runs/lost.tum: {folder}/runs/lost.tum has changed',
        'files, runs/lost.tum: can be scored now',
    )
    Path('runs/lost.tum').unlink()
    found = verify(folder / 'manifest.json')
    assert found.differences == (f'files, runs/lost.tum: {folder}/runs/lost.tum is missing',)


def test_an_estimate_that_was_missing_and_now_is_there_is_reported(folder, suite):
    suite = load_suite(folder / 'suite.yaml', ['sequences.revised.estimate=runs/no.tum'])
    write_suite(suite)
    assert verify(folder / 'manifest.json').differences == ()
    shutil.copy('runs/b.tum', 'runs/no.tum')
    found = verify(folder / 'manifest.json')
    assert found.differences[0] == 'revised, runs/no.tum: can be scored now'
    assert 'revised: verdict was fail, is pass' in found.differences


def test_a_run_that_killed_its_process_does_so_again_and_stops_nothing(folder, suite, sabotage):
    sabotage("'lost' in specs[0] and os._exit(7)")
    content = write_suite(suite)
    assert content['sequences'][0]['runs'][2]['error'].endswith('died: exit status 7')
    assert verify(folder / 'manifest.json').differences == ()


ATE = 'ate_trans_rmse_m'


@pytest.fixture
def judged(folder, suite) -> dict[str, Any]:
    """Return the manifest of a suite with gates from outside, compared with a baseline."""
    changes = (
        f'sequences.recorded.gates.{ATE}=[{{max: 1, warn: 0.001}}, {{max: 1, of: worst}}]',
        'sequences.files.gates.success_rate.min=0.5',
    )
    suite = load_suite(folder / 'suite.yaml', changes)
    finished = manifest_of_suite(suite.manifest, suite)
    result = score_suite(suite, 1)
    recorded = {'revised': result.sequences[2].recorded}
    result = compare_suite(result, Baseline(definition_sha256(), recorded))
    suite.manifest.write_text(finished(result))
    content = json.loads(suite.manifest.read_text())
    assert content['set'] == list(changes)
    return content


def test_gates_comparisons_and_verdicts_of_a_suite_are_in_its_manifest(judged):
    assert valid(judged)
    assert judged['verdict'] == 'pass'
    files, recorded, revised = judged['sequences']
    assert [one['verdict'] for one in judged['sequences']] == ['pass'] * 3
    (rate,) = (gate for gate in files['gates'] if gate['metric'] == 'success_rate')
    assert (rate['limit'], rate['value'], rate['of']) == (0.5, 2 / 3, 'median')
    ates = [gate for gate in recorded['gates'] if gate['metric'] == ATE]
    assert [(gate['of'], gate['severity'], gate['passed']) for gate in ates] == [
        ('median', 'fail', True), ('median', 'warn', False), ('worst', 'fail', True)
    ]  # fmt: skip
    assert (files['comparisons'], recorded['comparisons']) == (None, None)
    (comparison,) = revised['comparisons']
    assert comparison['rule']['metric'] == ATE
    assert comparison['baseline_values'] == [revised['runs'][0]['result']['metrics'][ATE]]
    assert comparison['found']['difference'] == 0


def test_rules_of_a_manifest_from_before_there_were_suites_judge_alone(folder, judged):
    (comparison,) = judged['sequences'][2]['comparisons']
    assert comparison['rule'].pop('p_adjusted') == 0.015
    (folder / 'manifest.json').write_text(json.dumps(judged))
    ((rule, _),) = load_manifest(folder / 'manifest.json').sequences[2].rules
    assert rule.p_adjusted == 1


@pytest.mark.slow
def test_a_suite_is_judged_again_without_its_file(folder, judged):
    (folder / 'suite.yaml').unlink()
    found = verify(folder / 'manifest.json')
    assert (found.reproduced, found.differences) == (5, ())
    assert f'{folder}/suite.yaml is missing' in found.notes


def gate_that_would_fail(content: dict[str, Any]) -> None:
    for gate in content['sequences'][0]['gates']:
        if gate['metric'] == 'success_rate':
            gate['limit'] = 0.9


def better_baseline(content: dict[str, Any]) -> None:
    (comparison,) = content['sequences'][2]['comparisons']
    comparison['baseline_values'] = [comparison['baseline_values'][0] / 2]


@pytest.mark.slow
@pytest.mark.parametrize(
    ('tamper', 'lines'),
    [
        (
            lambda c: c.update(verdict='fail'),
            ['suite: verdict was fail, is pass'],
        ),
        (
            gate_that_would_fail,
            [
                'files: gates.2.passed was True, is False',
                'files: verdict was pass, is fail',
                'suite: verdict was pass, is fail',
            ],
        ),
        (
            better_baseline,
            [
                'revised: comparisons.0.found.worse was False, is True',
                'revised: verdict was pass, is fail',
                'suite: verdict was pass, is fail',
            ],
        ),
    ],
    ids=['verdict', 'gate', 'baseline'],
)
def test_a_verdict_that_does_not_follow_is_reported(folder, judged, tamper, lines):
    tamper(judged)
    found = verified(folder / 'manifest.json', judged)
    assert found.reproduced == 5
    assert [line for line in found.differences if line in lines] == lines


def test_a_run_that_is_gone_is_missed_by_the_verdict_too(folder, judged):
    (folder / 'runs/b.tum').unlink()
    found = verify(folder / 'manifest.json')
    assert 'files: verdict was pass, is fail' in found.differences
    assert any('files: gates.' in line and '.value was' in line for line in found.differences)


def without_verdict(content: dict[str, Any], *names: str) -> None:
    for name in names:
        del content[name]
    for sequence in content['sequences'][bool(names) - 1 :]:
        del sequence['gates'], sequence['comparisons'], sequence['verdict']


@pytest.mark.slow
@pytest.mark.parametrize(
    'harm',
    [
        without_verdict,  # of the last sequence
        lambda c: without_verdict(c, 'verdict'),
        lambda c: without_verdict(c, 'suite'),
        lambda c: c.update(verdict=None),
        lambda c: c.update(verdict='maybe'),
        lambda c: c.pop('verdict'),
        lambda c: c['sequences'][1].update(verdict=None),
        lambda c: c['sequences'][1].update(gates=[]),
        lambda c: c['sequences'][0]['runs'][0]['estimate'].update(files=[]),
        lambda c: c['sequences'][0]['runs'][0]['result'].update(config={}),
        lambda c: c['sequences'][0]['runs'][0]['result'].update(inputs={}),
        lambda c: c['sequences'][0]['runs'][0]['result']['inputs'].update(estimate={}),
        lambda c: c['sequences'][0]['runs'][0]['result'].update(association={}),
        lambda c: c['sequences'][0]['runs'][0]['result'].update(alignment={}),
        lambda c: c['sequences'][0]['runs'][2].update(error=None),
    ],
)
def test_what_was_taken_out_of_a_manifest_is_missed(folder, judged, harm):
    harm(judged)
    with pytest.raises(ReadError, match='is not a manifest, or is damaged'):
        verified(folder / 'manifest.json', judged)
    assert not valid(judged)


@pytest.mark.parametrize('part', ['association', 'alignment', 'metrics', 'config'])
def test_a_value_that_was_taken_out_is_missed(folder, part):
    content = manifest_of(folder / 'manifest.json')
    name = next(iter(the_run(content)['result'][part]))
    del the_run(content)['result'][part][name]
    found = verified(folder / 'manifest.json', content)
    assert len(found.differences) == 1
    assert f'{name} was absent, is ' in found.differences[0]


def test_warnings_are_compared_without_the_folders_in_them(folder, monkeypatch):
    rows = [line.split() for line in Path('runs/a.tum').read_text().splitlines()[1:]]
    nanoseconds = [[row[0].replace('.', ''), *row[1:]] for row in rows]
    Path('runs/ns.tum').write_text('\n'.join(map(' '.join, nanoseconds)))
    content = manifest_of(folder / 'manifest.json', 'runs/ns.tum')
    warnings = the_run(content)['result']['warnings']
    assert warnings[0] == 'runs/ns.tum: stamps are read as ns, not s, by their size'
    monkeypatch.chdir('/')
    assert reproduced(verify(folder / 'manifest.json'))
    del warnings[0]
    found = verified(folder / 'manifest.json', content)
    assert any('warnings.' in line for line in found.differences)


@pytest.mark.slow
@pytest.mark.parametrize(
    'damage',
    [
        lambda one: one.update(gates=None),
        lambda one: one.pop('comparisons'),
        lambda one: one['gates'][0].update(of='best'),
        lambda one: one['comparisons'][0].update(baseline_values=[None]),
        lambda one: one['comparisons'][0].update(baseline_values=3),
        lambda one: one['comparisons'][0]['rule'].update(metric='path_length_m'),
        lambda one: one.update(runs=[]),
    ],
)
def test_a_damaged_judgement_is_one_line(folder, judged, damage):
    damage(judged['sequences'][2])
    with pytest.raises(ReadError, match='is not a manifest, or is damaged'):
        verified(folder / 'manifest.json', judged)


def test_a_suite_named_by_an_absolute_path_has_relative_paths_all_the_same(folder, suite):
    relative = write_suite(suite)
    absolute = write_suite(load_suite(folder / 'suite.yaml'))
    for one, other in zip(relative['sequences'], absolute['sequences'], strict=True):
        for key in ('estimate', 'ground_truth', 'causal'):
            assert one['runs'][0][key] == other['runs'][0][key]
        assert one['stack'] == other['stack']


def test_the_revision_of_a_run_is_compared_too(folder, suite):
    write_suite(suite)
    rows = (folder / 'runs/b.tum').read_text().splitlines()
    (folder / 'runs/b.tum').write_text('\n'.join(rows[:-5]))
    found = verify(folder / 'manifest.json')
    assert (found.runs, found.reproduced) == (5, 3)
    changed = [line for line in found.differences if line.startswith('revised, runs/a.tum: ')]
    assert changed[0].endswith('runs/b.tum has changed')
    assert any('ate_causal_trans_rmse_m was' in line for line in changed)


def test_a_changed_estimate_is_reported_with_what_came_of_it(folder):
    manifest_of(folder / 'manifest.json')
    rows = (folder / 'runs/a.tum').read_text().splitlines()
    (folder / 'runs/a.tum').write_text('\n'.join(rows[:-10]))
    found = verify(folder / 'manifest.json')
    assert found.reproduced == 0
    assert found.differences[0] == f'V1_02, runs/a.tum: {folder}/runs/a.tum has changed'
    assert any(
        'inputs.estimate.poses was 40, is 30 (-10, 25 % change)' in line
        for line in found.differences
    )
    assert any(': ate_trans_rmse_m was ' in line for line in found.differences)
    assert 'values differ, most of all ' in found.differences[-1]


def test_a_missing_truth_is_reported_and_nothing_is_scored_without_it(folder):
    manifest_of(folder / 'manifest.json')
    (folder / 'gt.tum').unlink()
    found = verify(folder / 'manifest.json')
    assert found.differences == (f'V1_02, runs/a.tum: {folder}/gt.tum is missing',)


def test_a_changed_configuration_is_a_note_since_its_text_is_kept(folder):
    stack = Stack.of({'config': ['vio.yaml', 'cam.yaml']})
    manifest_of(folder / 'manifest.json', stack=stack)
    (folder / 'vio.yaml').write_text('keyframes: 7\n')
    (folder / 'cam.yaml').unlink()
    found = verify(folder / 'manifest.json')
    assert reproduced(found)
    assert found.notes == (
        f'{folder}/vio.yaml has changed',
        f'{folder}/cam.yaml is missing',
    )


def test_other_versions_are_noted(folder):
    content = manifest_of(folder / 'manifest.json')
    content['tool']['version'] = '0.0.7'
    content['machine']['numpy'] = '1.26.4'
    found = verified(folder / 'manifest.json', content)
    assert reproduced(found)
    assert f'vio_eval_ros was 0.0.7, is {__version__}' in found.notes
    assert any(note.startswith('numpy was 1.26.4, is ') for note in found.notes)


def test_metrics_that_differ_are_reported_with_how_much_in_the_order_of_the_result(folder):
    content = manifest_of(folder / 'manifest.json')
    metrics = the_run(content)['result']['metrics']
    before = metrics['ate_trans_rmse_m']
    metrics['ate_trans_rmse_m'] = before / 2
    metrics['ate_trans_max_m'] *= 1 + 1e-15  # the last bits
    metrics['kitti_trans_percent'] = 3.5
    found = verified(folder / 'manifest.json', content)
    assert [line.split(': ')[1].split()[0] for line in found.differences] == [
        'ate_trans_rmse_m', 'ate_trans_max_m', 'kitti_trans_percent'
    ]  # fmt: skip
    assert found.differences[2].endswith('was 3.5, is None')
    assert found.differences[0].endswith(
        f'was {before / 2}, is {before} (+{before / 2:.2g}, 50 % change)'
    )
    assert found.reproduced == 0


def test_the_first_of_many_differences_are_reported_and_the_largest(folder):
    content = manifest_of(folder / 'manifest.json')
    metrics = the_run(content)['result']['metrics']
    numbers = [name for name, value in metrics.items() if isinstance(value, float) and value]
    for name in numbers:
        metrics[name] *= 10 if name == 'path_length_m' else 2
    found = verified(folder / 'manifest.json', content)
    assert len(found.differences) == 21
    assert f': {len(numbers)} of ' in found.differences[-1]
    assert 'values differ, most of all path_length_m, which was ' in found.differences[-1]
    assert found.differences[-1].endswith(', 90 % change)')


def test_other_options_are_reported(folder):
    content = manifest_of(folder / 'manifest.json')
    content['sequences'][0]['options']['alignment'] = 'none'
    found = verified(folder / 'manifest.json', content)
    assert any('config.alignment was se3, is none' in line for line in found.differences)


def test_gates_are_judged_again(folder):
    gates = (Gate('ate_trans_rmse_m', '<=', 1e-6),)
    content = manifest_of(folder / 'manifest.json', gates=gates)
    assert the_run(content)['result']['verdict'] == 'fail'
    assert reproduced(verify(folder / 'manifest.json'))
    the_run(content)['result']['verdict'] = 'pass'
    found = verified(folder / 'manifest.json', content)
    assert found.differences == ('V1_02, runs/a.tum: verdict was pass, is fail',)
    the_run(content)['result']['gates'][0]['metric'] = 'ate_of_old'
    found = verified(folder / 'manifest.json', content)
    assert "can no longer be scored: gate 'ate_of_old<=1e-06'" in found.differences[0]


def test_a_later_version_may_know_more_metrics_but_not_fewer(folder):
    content = manifest_of(folder / 'manifest.json')
    content['tool']['version'] = '0.0.7'
    metrics = the_run(content)['result']['metrics']
    del metrics['ate_trans_rmse_m']
    assert reproduced(verified(folder / 'manifest.json', content))
    metrics['ate_of_old'] = 1.0
    found = verified(folder / 'manifest.json', content)
    assert found.differences == ('V1_02, runs/a.tum: ate_of_old was 1.0, is absent',)


def test_a_file_that_is_scored_though_it_is_not_listed_does_not_pass(folder):
    content = manifest_of(folder / 'manifest.json')
    the_run(content)['estimate']['spec'] = 'runs/b.tum'
    found = verified(folder / 'manifest.json', content)
    assert any('inputs.estimate.sha256 was' in line for line in found.differences)


def nothing(content: dict[str, Any]) -> None:
    content['sequences'] = []


def other_text(content: dict[str, Any]) -> None:
    content['texts'] = {'0' * 64: 'what it was not'}


def unknown_option(content: dict[str, Any]) -> None:
    content['sequences'][0]['options']['alignement'] = 'se3'


def huge_limit(content: dict[str, Any]) -> None:
    gate = {'metric': 'a', 'comparison': '<=', 'limit': 10**400, 'severity': 'fail'}
    the_run(content)['result']['gates'] = [gate]


@pytest.mark.parametrize(
    ('damage', 'problem'),
    [
        (lambda c: c.update(schema='vio_eval_ros.manifest/2'), 'has the schema vio_eval_ros.man'),
        (lambda c: c.pop('sequences'), "damaged ('sequences' is missing)"),
        (
            lambda c: the_run(c).update(estimate=None),
            'damaged (a field has the wrong type)',
        ),
        (
            lambda c: the_run(c)['result'].pop('metrics'),
            "damaged ('metrics' is missing)",
        ),
        (nothing, 'contains no result that could be reproduced'),
        (lambda c: the_run(c)['result'].update(metrics={}), 'a result has no metrics'),
        (other_text, 'damaged (text 000000000000 has changed)'),
        (unknown_option, "unknown option 'alignement'; did you mean 'alignment'?"),
        (huge_limit, 'damaged (a field has the wrong type)'),
    ],
)
def test_a_damaged_manifest_is_one_line(folder, damage: Callable[[dict], None], problem):
    content = manifest_of(folder / 'manifest.json')
    damage(content)
    with pytest.raises(ReadError) as caught:
        verified(folder / 'manifest.json', content)
    assert problem in str(caught.value)
    assert str(caught.value).count('\n') == 0
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    'text', ['', '[]', 'null', '{', '{"schema": NaN}', '\x00', '{"schema": 1}', '[' * 100_000]
)
def test_what_is_no_manifest_is_one_line(folder, text):
    Path('manifest.json').write_text(text)
    with pytest.raises(ReadError, match=r'not a manifest, or is damaged|has the schema'):
        verify(Path('manifest.json'))
    with pytest.raises(ReadError, match='No such file'):
        verify(Path('nowhere.json'))


def test_a_truncated_manifest_is_one_line(folder):
    manifest_of(folder / 'manifest.json')
    whole = Path('manifest.json').read_bytes()
    for length in (10, len(whole) // 2, len(whole) - 3):
        Path('manifest.json').write_bytes(whole[:length])
        with pytest.raises(ReadError, match='is damaged'):
            verify(Path('manifest.json'))


def test_a_manifest_that_is_too_large_is_neither_read_nor_written(folder, monkeypatch):
    manifest_of(folder / 'manifest.json')
    monkeypatch.setattr(recorded_manifest, 'MAX_BYTES', 1 << 10)
    with pytest.raises(ReadError, match='is larger than 0 MiB'):
        verify(Path('manifest.json'))
    monkeypatch.setattr(manifests, 'MAX_BYTES', 1 << 10)
    with pytest.raises(ConfigError, match='would be larger'):
        manifest_of(folder / 'manifest.json')


@pytest.mark.parametrize('special', ['/dev/zero', 'pipe', '/dev/full', 'x' * 5000, 'nul\x00'])
def test_only_files_are_ever_read(folder, special):
    os.mkfifo('pipe')
    content = manifest_of(folder / 'manifest.json')
    for part in ('listed', 'unlisted'):
        changed = copy.deepcopy(content)
        the_run(changed)['estimate']['spec'] = special
        listed = [{'path': special, 'sha256': None}]
        if part == 'listed':
            the_run(changed)['estimate']['files'] = listed
        found = verified(folder / 'manifest.json', changed)
        assert found.reproduced == 0
        assert 'is missing' in found.differences[0] or 'no such file' in found.differences[0]


def nodes(value: Any, path: tuple = ()) -> Iterator[tuple]:
    """Yield the way to each value in a manifest, not going into the numbers of a result."""
    if path:
        yield path
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in ('config', 'metrics', 'association', 'alignment', 'options'):
                yield from nodes(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from nodes(item, (*path, index))


def outcome(file: Path, content: dict[str, Any]) -> str:
    """Return the error of a verification, or nothing."""
    try:
        assert verified(file, content).runs == 1
    except ReadError as error:
        return str(error)
    return ''


@pytest.mark.slow
def test_nothing_in_a_manifest_gives_any_other_error(folder):
    stack = Stack.of({'config': ['vio.yaml']}, [Path('cam.yaml')])
    gates = (Gate('ate_trans_rmse_m', '<=', 1.0),)
    content = manifest_of(folder / 'manifest.json', stack=stack, gates=gates)
    ways = list(nodes(content))
    assert len(ways) > 60
    refused = 0
    for way in ways:
        for value in (None, 5, -1.5, True, 'word', '', [], {}, [{}], {'a': 1}, [5]):
            changed = copy.deepcopy(content)
            part: Any = changed
            for key in way[:-1]:
                part = part[key]
            part[way[-1]] = value
            told = outcome(folder / 'manifest.json', changed)
            assert '\n' not in told, way
            refused += 'damaged' in told
    assert refused > 100


@pytest.mark.slow
def test_nothing_in_a_judgement_gives_any_other_error(folder, judged):
    judged['sequences'] = judged['sequences'][2:]
    ways = [way for way in nodes(judged) if way[2:3] and way[2] in ('gates', 'comparisons')]
    assert len(ways) > 40
    for way in ways:
        for value in (None, 5, 'word', [], {}, [5]):
            changed = copy.deepcopy(judged)
            part: Any = changed
            for key in way[:-1]:
                part = part[key]
            part[way[-1]] = value
            assert '\n' not in outcome(folder / 'manifest.json', changed), way


def test_a_document_that_is_read_is_whole(folder):
    document = Document.read(Path('vio.yaml'))
    assert document.sha256 == sha256(folder / 'vio.yaml')
    assert document.text == (folder / 'vio.yaml').read_text()
