"""A suite is read strictly: what is wrong in it is named, with its line."""

from pathlib import Path
import re
import shutil

import pytest

from vio_eval_ros.comparison.repeated import Rule
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.errors import ConfigError, ReadError, VioEvalError
from vio_eval_ros.scoring.documents import SUITE_REPORTS
from vio_eval_ros.scoring.loading import load_suite, SEQUENCE_KEYS
from vio_eval_ros.scoring.suite import DEFAULT_GATES, RunsGate, Sequence, Suite
from vio_eval_ros.settings import load_yaml

ROOT = Path(__file__).resolve().parents[2]
EUROC = [
    *(f'MH_0{k}' for k in range(1, 6)),
    *(f'V{room}_0{k}' for room in (1, 2) for k in (1, 2, 3)),
]
SUITE = """\
options: {alignment: se3}
gates: {ate_trans_rmse_m: {max: 0.3, warn: 0.2}}
tags: [all]
sequences:
  - name: one
    estimate: runs/one/*.tum
    ground_truth: gt.tum
  - name: two
    estimate: runs/two.tum
    ground_truth: gt.tum
    options: {alignment: sim3}
    gates: {ate_trans_rmse_m: {max: 0.1}, tracked_ratio: {min: 0.5}}
    tags: [hard]
"""


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / 'runs/one').mkdir(parents=True)
    for name in ('one/b.tum', 'one/a.tum', 'two.tum'):
        (tmp_path / 'runs' / name).touch()
    (tmp_path / 'gt.tum').touch()
    return tmp_path


def load(folder: Path, text: str = SUITE, *overrides: str) -> Suite:
    (folder / 'suite.yaml').write_text(text)
    return load_suite(folder / 'suite.yaml', overrides)


def complaint(folder: Path, text: str, *overrides: str) -> str:
    with pytest.raises(VioEvalError) as raised:
        load(folder, text, *overrides)
    assert '\n' not in str(raised.value)
    return str(raised.value)


def one(more: str) -> str:
    """Return a suite with one sequence, and what else is in it, from line 4 on."""
    return f'sequences:\n- name: one\n  estimate: runs/two.tum\n  {more}\n  ground_truth: gt.tum\n'


def limits(suite: Suite, k: int) -> dict[tuple[str, str, str], float]:
    return limits_of(suite.sequences[k])


def limits_of(sequence: Sequence) -> dict[tuple[str, str, str], float]:
    gates = [runs.gate for runs in sequence.gates]
    return {(gate.metric, gate.comparison, gate.severity): gate.limit for gate in gates}


def test_a_glob_is_one_run_a_match_in_order_of_the_names(folder):
    suite = load(folder)
    assert [run.name for run in suite.sequences[0].runs] == ['runs/one/a.tum', 'runs/one/b.tum']
    assert [run.name for run in suite.sequences[1].runs] == ['runs/two.tum']


def test_paths_are_relative_to_the_suite(folder, monkeypatch):
    monkeypatch.chdir('/')
    sequence = load(folder).sequences[0]
    assert sequence.runs[0].estimate == str(folder / 'runs/one/a.tum')
    assert sequence.ground_truth == str(folder / 'gt.tum')


def test_what_a_sequence_says_goes_over_what_the_suite_says(folder):
    suite = load(folder)
    assert [sequence.config.alignment for sequence in suite.sequences] == ['se3', 'sim3']
    assert limits(suite, 0)['ate_trans_rmse_m', '<=', 'fail'] == 0.3
    assert limits(suite, 0)['ate_trans_rmse_m', '<=', 'warn'] == 0.2
    assert limits(suite, 1)['ate_trans_rmse_m', '<=', 'fail'] == 0.1
    assert ('ate_trans_rmse_m', '<=', 'warn') not in limits(suite, 1)
    assert [sequence.tags for sequence in suite.sequences] == [('all',), ('hard',)]


def test_statements_and_topics_stay_after_each_match(folder):
    text = one('').replace('two.tum', 'one/*.tum?quaternion=wxyz&stamps=ns')
    runs = load(folder, text).sequences[0].runs
    assert runs[0].name == 'runs/one/a.tum?quaternion=wxyz&stamps=ns'
    assert runs[1].estimate == f'{folder}/runs/one/b.tum?quaternion=wxyz&stamps=ns'
    (folder / 'bags').mkdir()
    (folder / 'bags/1.mcap').touch()
    text = one('').replace('runs/two.tum', 'bags/*.mcap:/vio/odometry')
    assert load(folder, text).sequences[0].runs[0].name == 'bags/1.mcap:/vio/odometry'


def test_a_glob_of_recordings_is_one_run_a_recording(folder):
    for name in ('1.mcap', '2.mcap'):
        (folder / name).touch()
    text = (
        'sequences: [{name: a, recording: "*.mcap", estimate: /vio, causal: /first, '
        'ground_truth: /gt}]'
    )
    (sequence,) = load(folder, text).sequences
    assert [run.name for run in sequence.runs] == ['1.mcap:/vio', '2.mcap:/vio']
    assert sequence.runs[1].recording == folder / '2.mcap'
    assert [run.causal for run in sequence.runs] == ['/first', '/first']
    assert sequence.ground_truth == '/gt'
    assert sequence.truth_is_recorded
    assert not load(folder, text.replace('/gt', 'gt.tum')).sequences[0].truth_is_recorded


def test_a_recording_may_be_shared_and_files_may_come_beside_it(folder):
    (folder / 'all.bag').touch()
    text = (
        'sequences: [{name: a, recording: all.bag, estimate: runs/one/*, causal: runs/one/*, '
        'ground_truth: /gt}]'
    )
    (sequence,) = load(folder, text).sequences
    assert [run.recording for run in sequence.runs] == 2 * [folder / 'all.bag']
    assert [run.causal for run in sequence.runs] == [run.estimate for run in sequence.runs]


@pytest.mark.parametrize(
    ('estimate', 'causal'),
    [
        ('est/*.tum', 'first/*_causal.tum'),
        ('est/[!x]*.tum', 'first/?*_causal.tum'),
        ('est/**/*.tum', 'first/**/*_causal.tum'),
        ('es*/*.tum', 'firs*/*_causal.tum'),
    ],
)
def test_runs_are_paired_by_what_their_wildcards_stand_for(folder, estimate, causal):
    # sorted by name 10_causal comes before 1_causal, and 1.tum before 10.tum
    for name in ('1', '2', '10'):
        for path in (f'est/{name}.tum', f'first/{name}_causal.tum'):
            (folder / path).parent.mkdir(exist_ok=True)
            (folder / path).touch()
    (sequence,) = load(
        folder, one(f'causal: {causal}').replace('runs/two.tum', estimate)
    ).sequences
    assert [run.name for run in sequence.runs] == ['est/1.tum', 'est/10.tum', 'est/2.tum']
    for run in sequence.runs:
        assert run.causal == run.estimate.replace('est/', 'first/').replace('.tum', '_causal.tum')


def test_recordings_and_files_beside_them_are_paired_too(folder):
    for name in ('a_1.mcap', 'a_10.mcap', 'est/x1.tum', 'est/x10.tum'):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()
    more = 'recording: a_*.mcap'
    text = one(more).replace('runs/two.tum', 'est/x*.tum').replace('gt.tum', '/gt')
    (sequence,) = load(folder, text).sequences
    assert {run.name: run.recording.name for run in sequence.runs} == {
        'est/x1.tum': 'a_1.mcap', 'est/x10.tum': 'a_10.mcap'
    }  # fmt: skip


def test_runs_that_do_not_belong_together_are_refused(folder):
    for path in ('est/1.tum', 'est/2.tum', 'first/2.tum', 'first/3.tum'):
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).touch()
    text = one('causal: first/*.tum').replace('runs/two.tum', 'est/*.tum')
    assert (
        'line 4: causal: no match corresponds to est/1.tum: wildcards must stand for the same '
        "text in both, here '1'"
    ) in complaint(folder, text)


def test_a_path_with_the_signs_of_a_glob_in_it_is_that_path(folder):
    (folder / 'runs/[old]').mkdir()
    (folder / 'runs/[old]/1.tum').touch()
    text = one('').replace('runs/two.tum', 'runs/[old]/1.tum')
    assert [run.name for run in load(folder, text).sequences[0].runs] == ['runs/[old]/1.tum']


def test_defaults_keep_a_lost_track_from_winning_whatever_else_is_asked(folder):
    for gates in (
        '{}',
        '{tracked_ratio: {max: 1}, ate_extent_ratio: {min: 0}, success_rate: {max: 1}}',
    ):
        sequence = load(folder, one(f'gates: {gates}')).sequences[0]
        assert {RunsGate(gate) for gate in DEFAULT_GATES} <= set(sequence.gates)
        assert {gate.metric for gate in sequence.success_gates} == {
            'tracked_ratio',
            'ate_extent_ratio',
        }
    found = limits(load(folder), 1)
    assert found['tracked_ratio', '>=', 'fail'] == 0.5
    assert found['ate_extent_ratio', '<=', 'fail'] == 0.5


def test_gates_may_be_several_and_of_the_worst_run(folder):
    gates = (
        load(
            folder,
            one('gates: {ate_rot_rmse_deg: [{max: 3}, {max: 5, warn: 4, of: worst}]}'),
        )
        .sequences[0]
        .gates
    )
    assert gates[-3:] == (
        RunsGate(Gate('ate_rot_rmse_deg', '<=', 3.0), 'median'),
        RunsGate(Gate('ate_rot_rmse_deg', '<=', 5.0), 'worst'),
        RunsGate(Gate('ate_rot_rmse_deg', '<=', 4.0, 'warn'), 'worst'),
    )


def test_metrics_are_those_that_the_options_give(folder):
    more = 'options: {rpe_deltas: [5s]}\n  gates: {rpe_5s_trans_rmse_m: {max: 1}}'
    assert limits(load(folder, one(more)), 0)['rpe_5s_trans_rmse_m', '<=', 'fail'] == 1
    more = 'gates: {rpe_5s_trans_rmse_m: {max: 1}}'
    assert "line 4: there is no metric 'rpe_5s_trans_rmse_m' with these options" in complaint(
        folder, one(more)
    )


def test_numbers_with_exponents_are_numbers(folder):
    more = (
        'compare: {ate_trans_rmse_m: {absolute: 1e-3}}\n  gates: {ate_trans_rmse_m: {max: 1e-1}}'
    )
    (sequence,) = load(folder, one(more)).sequences
    assert sequence.rules[0].absolute == 0.001
    assert limits(load(folder, one(more)), 0)['ate_trans_rmse_m', '<=', 'fail'] == 0.1


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        ('', 'sequences: expected a list of at least one'),
        ('sequences: []', 'line 1: sequences: expected a list'),
        ('sequences: {a: b}', 'line 1: sequences: expected a list'),
        ('sequences: [one]', 'line 1: estimate is missing'),
        ('sequences: [1]', 'line 1: sequences: each is a mapping'),
        ('- a', 'expected a file of options, a mapping of names to values'),
        ('sequences: [', 'not valid YAML'),
        ('tags: [a]\nsequence: []', "line 2: there is no 'sequence' here; did you mean"),
    ],
)
def test_what_is_no_suite_is_refused(folder, text, problem):
    assert problem in complaint(folder, text)


BOUNDS = '{max: 0.3, warn: 0.2}'
GLOB = 'runs/one/*.tum'


@pytest.mark.parametrize(
    ('old', 'new', 'problem'),
    [
        ('max: 0.3', 'mx: 0.3', "line 2: there is no 'mx' here; did you mean 'max'?"),
        (
            '_rmse_m: {max: 0.3',
            '_rms_m: {max: 0.3',
            "line 2: there is no metric 'ate_trans_rms_m'",
        ),
        ('_rmse_m: {max: 0.3', '_rms_m: {max: 0.3', "; did you mean 'ate_trans_rmse_m'?"),
        ('alignment: se3', 'alinment: se3', "line 1: unknown option 'alinment'; did you mean"),
        ('alignment: sim3', 'alignment: sim', "line 11: alignment: 'sim' is not one of"),
        ('alignment: se3', 'rpe_deltas: [1q]', "line 1: rpe_deltas: '1q' is not a valid delta"),
        ('alignment: sim3', 'start_s: 5, end_s: 4', 'line 11: start_s: 5 is not before end_s: 4'),
        ('estimate: runs/two', 'estmate: x', "line 9: there is no 'estmate' here; did you mean"),
        ('name: two', 'name: one', "line 8: there are two sequences 'one'"),
        ('name: two', 'name: 2', 'line 8: name: expected text'),
        ('name: two', 'calibration: []', 'line 8: name is missing'),
        (GLOB, '', 'line 6: estimate is missing'),
        ('estimate: runs/one', 'causal: runs/one', 'line 5: estimate is missing'),
        (GLOB, '[a.tum, b.tum]', 'line 6: estimate: expected text'),
        (GLOB, 'none/*.tum', "line 6: estimate: nothing matches 'none/*.tum' in "),
        (GLOB, '"a\\0b"', 'line 6: estimate: a path cannot contain a zero byte'),
        (GLOB, f'{GLOB}?quaternion=zyx', 'line 6: '),
        (
            'ground_truth: gt.tum\n  -',
            'tags: []\n  -',
            'line 5: ground_truth is missing',
        ),
        ('gt.tum', 'runs/one/*', 'line 7: ground_truth: expected one, not 2'),
        ('tags: [hard]', 'tags: [1]', 'line 13: tags: expected a list of texts'),
        ('tags: [hard]', 'tags: a\n    tags: b', "line 14: 'tags' is given twice"),
        (BOUNDS, '0.3', 'line 2: gate ate_trans_rmse_m: give its limits'),
        (BOUNDS, '[]', 'line 2: gate ate_trans_rmse_m: give its limits'),
        (BOUNDS, '{max: low}', "line 2: gate ate_trans_rmse_m: 'low' is not a finite number"),
        (BOUNDS, '{warn: 0.2}', 'line 2: gate ate_trans_rmse_m: warn needs'),
        (BOUNDS, '{max: 0.3, warn: 0.4}', 'line 2: gate ate_trans_rmse_m: warn: 0.4 is beyond'),
        (BOUNDS, '{max: 0.1, min: 0.2}', 'line 2: gate ate_trans_rmse_m: no value is both >= 0.2'),
        ('tracked_ratio: {min: 0.5', 'success_rate: {min: 2', 'no value is both >= 2 and <= 1'),
        ('gt.tum\n    options', 'no.tum\n    options', 'line 10: ground_truth: there is no '),
        ('gt.tum\n    options', '/gt\n    options', 'line 10: ground_truth: there is no /gt'),
        (
            BOUNDS,
            '{max: 0.3, of: best}',
            "line 2: gate ate_trans_rmse_m: 'of' must be median or worst",
        ),
        (f'{{ate_trans_rmse_m: {BOUNDS}}}', '[a]', 'line 2: gates: expected a mapping'),
    ],
)
def test_what_is_wrong_is_named_with_its_line(folder, old, new, problem):
    assert old in SUITE
    assert problem in complaint(folder, SUITE.replace(old, new, 1))


@pytest.mark.parametrize(
    ('more', 'problem'),
    [
        ('compare: {ate: {relative: 0.1}}', "there is no metric 'ate' with these options"),
        ('compare: {ate_trans_rmse_m: {relativ: 0.1}}', "did you mean 'relative'?"),
        ('compare: {ate_trans_rmse_m: {relative: -1}}', "relative: '-1' is not a finite number"),
        ('compare: {ate_trans_rmse_m: {mad: .inf}}', "mad: 'inf' is not a finite number >= 0"),
        ('compare: {ate_trans_rmse_m: {p: 2}}', "p: '2' is not a number from 0 to 1"),
        ('compare: {ate_trans_rmse_m: 0.1}', 'expected any of relative, absolute, mad, p'),
        ('compare: {sim3_scale: {relative: 0.1}}', 'neither a higher nor a lower value is worse'),
        (
            'modality: lidar',
            'modality must be one of mono, stereo, mono-inertial, stereo-inertial',
        ),
        ('recording: "*.mcap"', "recording: nothing matches '*.mcap'"),
        ('recording: runs/two.tum', 'recording: not needed, since no topic is named'),
        ('stack: {comit: 4f2a9c1}', "stack: there is no 'comit' here; did you mean 'commit'?"),
        ('stack: {version: 2.1}', "stack: version: '2.1' is not text; put it in quotes"),
        ('stack: {config: {a: b}}', 'stack: config: expected a list of files'),
        ('stack: okvis', 'stack: expected a mapping'),
    ],
)
def test_what_is_wrong_in_a_sequence_is_named_with_its_line(folder, more, problem):
    found = complaint(folder, one(more))
    assert 'suite.yaml: line 4: ' in found
    assert problem in found


def test_a_stack_that_the_suite_states_is_checked_where_a_sequence_has_its_own(folder):
    text = one('stack: {name: okvis}') + 'stack:\n  nam: vins\n'
    assert "suite.yaml: line 7: stack: there is no 'nam' here" in complaint(folder, text)


def test_as_many_causal_estimates_are_needed_as_final_ones(folder):
    problem = 'line 3: estimate: 1 matches for 2 runs'
    assert problem in complaint(folder, one('causal: runs/one/*'))


def test_a_file_of_bands_that_is_not_there_is_named(folder):
    found = complaint(folder, one('bands: none.yaml'))
    assert f'suite.yaml: line 4: bands: there is no file {folder}/none.yaml' in found


@pytest.mark.parametrize(
    ('bands', 'problem'),
    [
        ('two: {good: 1, plausible: 2, failed: 3}', "bands.yaml has no sequence 'one'"),
        ('one: {good: 1, plausible: 2}', 'bands.yaml: line 1: one: good, plausible and failed'),
        ('one: {good: 2, plausible: 1, failed: 3}', 'numbers in rising order'),
        ('one: {good: true, plausible: 1, failed: 3}', 'numbers in rising order'),
        ('one: {god: 1, plausible: 2}', "line 1: there is no 'god' here; did you mean 'good'?"),
        ('one: {mono: {good: 1, plausible: 2, faild: 3}}', "line 1: there is no 'faild' here"),
        ('one: 3', 'line 1: one: expected a mapping'),
    ],
)
def test_what_is_wrong_in_the_bands_is_named_with_its_line(folder, bands, problem):
    (folder / 'bands.yaml').write_text(bands)
    assert problem in complaint(folder, one('bands: bands.yaml\n  modality: mono'))


def test_the_band_of_a_modality_goes_over_that_of_the_sequence(folder):
    (folder / 'bands.yaml').write_text(
        'one: {good: 1, plausible: 2, failed: 3, mono: {good: 4, plausible: 5, failed: 1e1}}'
    )
    for more, good, failed in (('modality: mono', 4, 10), ('tags: []', 1, 3)):
        (sequence,) = load(folder, one(f'bands: bands.yaml\n  {more}')).sequences
        assert sequence.band is not None
        assert (sequence.band['good'], sequence.band['failed']) == (good, failed)


def test_there_is_no_band_for_sensors_of_which_the_file_knows_nothing(folder):
    (folder / 'bands.yaml').write_text('one: {good: 1, plausible: 2, failed: 3}')
    (sequence,) = load(folder, one('bands: bands.yaml\n  modality: stereo')).sequences
    assert sequence.band is None


def test_values_are_set_from_outside(folder):
    suite = load(
        folder,
        SUITE,
        'options.alignment=posyaw',
        'options.rpe_deltas=[1f, 5s]',
        'sequences.two.gates={rpe_5s_trans_rmse_m: {max: 1}}',
        'sequences.two.tags=[easy, new]',
        'sequences.one.compare.ate_trans_rmse_m.relative=0.5',
    )
    assert [sequence.config.alignment for sequence in suite.sequences] == ['posyaw', 'sim3']
    assert suite.sequences[0].config.rpe_deltas == ('1f', '5s')
    assert limits(suite, 1)['rpe_5s_trans_rmse_m', '<=', 'fail'] == 1
    assert limits(suite, 1)['ate_trans_rmse_m', '<=', 'fail'] == 0.3
    assert suite.sequences[1].tags == ('easy', 'new')
    assert suite.sequences[0].rules[0].relative == 0.5


def test_a_name_with_a_dot_can_be_set_too(folder):
    text = SUITE.replace('name: two', 'name: V1.02')
    suite = load(folder, text, 'sequences.V1.02.options.alignment=none')
    assert suite.sequences[1].config.alignment == 'none'


@pytest.mark.parametrize(
    ('override', 'problem'),
    [
        ('options.alignment', 'write KEY=VALUE'),
        ('=se3', 'write KEY=VALUE'),
        ('options..alignment=se3', 'write KEY=VALUE'),
        ('options.alignment=[', "--set 'options.alignment=[': not valid YAML"),
        ('options.alignment=!!python/object:os.system x', 'not valid YAML'),
        ('options.alignment=se', "--set 'options.alignment=se': alignment: 'se' is not one of"),
        ('options.alinment=se3', "--set 'options.alinment=se3': unknown option 'alinment'; did"),
        ('option.alignment=se3', "--set 'option.alignment=se3': there is no 'option' here; did"),
        ('options.alignment.x=se3', 'alignment is not a mapping'),
        ('sequences.three.tags=[a]', 'NAME one of one, two'),
        ('sequences.two=3', 'NAME one of one, two'),
        ('sequences.two.name=one', "--set 'sequences.two.name=one': there are two sequences"),
        ('gates.ate_trans_rmse_m.max=low', "'low' is not a finite number"),
        ('gates={a: {max: 1}, a: {max: 2}}', "2}}': 'a' is given twice"),
    ],
)
def test_what_cannot_be_set_is_named_with_the_option(folder, override, problem):
    found = complaint(folder, SUITE, override)
    assert problem in found
    assert 'line' not in found.partition(problem)[0]


@pytest.mark.parametrize(
    ('tags', 'names'), [(['hard'], ['two']), (['hard', 'all'], ['one', 'two']), (['one'], ['one'])]
)
def test_tags_and_names_choose_sequences(folder, tags, names):
    load(folder)
    suite = load_suite(folder / 'suite.yaml', tags=tags)
    assert [sequence.name for sequence in suite.sequences] == names


def test_a_tag_that_no_sequence_has_is_an_error(folder):
    load(folder)
    with pytest.raises(ConfigError, match="no sequence has the tag 'hrd'; did you mean 'hard'"):
        load_suite(folder / 'suite.yaml', tags=['hard', 'hrd'])


def test_runs_of_sequences_that_were_not_chosen_need_not_be_there(folder):
    with pytest.raises(ConfigError, match='nothing matches'):
        load(folder, SUITE.replace(GLOB, 'none/*'))
    (sequence,) = load_suite(folder / 'suite.yaml', tags=['hard']).sequences
    assert sequence.name == 'two'


@pytest.fixture
def euroc(tmp_path) -> Path:
    """Return the suite of EuRoC's sequences, in a folder that has a run of each."""
    for name in ('gates/euroc.yaml', 'suites/euroc.yaml'):
        (tmp_path / name).parent.mkdir()
        shutil.copy(ROOT / 'config' / name, tmp_path / name)
    for name in EUROC:
        for folder in ('runs', 'gt'):
            (tmp_path / 'suites' / folder / name).mkdir(parents=True)
        (tmp_path / 'suites/runs' / name / '0.tum').touch()
    return tmp_path / 'suites/euroc.yaml'


def test_the_suite_of_euroc_has_its_eleven_sequences(euroc):
    suite = load_suite(euroc)
    assert [sequence.name for sequence in suite.sequences] == EUROC
    easy = load_suite(euroc, tags=['easy'])
    assert [sequence.name for sequence in easy.sequences] == ['MH_01', 'MH_02', 'V1_01', 'V2_01']
    assert suite.sequences[6].ground_truth == str(euroc.parent / 'gt/V1_02')


def test_the_bands_of_euroc_are_those_of_the_gates_of_the_live_node(euroc):
    for sequence in load_suite(euroc).sequences:
        live = load_yaml(ROOT / f'config/gates/euroc_{sequence.name}.yaml')['ate_trans_rmse_m']
        assert sequence.band is not None
        assert (sequence.band['good'], sequence.band['plausible']) == (live['warn'], live['max'])
        assert limits_of(sequence)['ate_trans_rmse_m', '<=', 'fail'] == live['max']


def test_a_monocular_system_on_euroc_is_good_with_more(euroc):
    for stereo, mono in zip(
        load_suite(euroc).sequences,
        load_suite(euroc, ['modality=mono-inertial']).sequences,
        strict=True,
    ):
        if stereo.name == 'V2_03':  # which the paper leaves out
            assert mono.band is None
            continue
        assert mono.band['good'] >= stereo.band['good']
        assert mono.band['plausible'] >= stereo.band['plausible']
        assert mono.band['failed'] == stereo.band['failed']


@pytest.mark.parametrize('modality', ['mono', 'stereo'])
def test_nothing_is_said_of_systems_on_euroc_that_have_no_imu(euroc, modality):
    for sequence in load_suite(euroc, [f'modality={modality}']).sequences:
        assert sequence.band is None


DOCUMENT = (ROOT / 'docs/scoring.md').read_text()


def test_every_key_and_report_is_documented():
    for key in ('sequences', 'manifest', *SEQUENCE_KEYS):
        assert f'`{key}`' in DOCUMENT, key
    for key, default in Rule('ate_trans_rmse_m')._asdict().items():
        assert key == 'metric' or f'| `{key}` | {default:g} |' in DOCUMENT, key
    for gate in DEFAULT_GATES:
        bound = 'max' if gate.comparison == '<=' else 'min'
        assert f'| `{gate.metric}` | `{{{bound}: {gate.limit}}}` |' in DOCUMENT
    for kind in SUITE_REPORTS:
        assert f'| `{kind}` |' in DOCUMENT


@pytest.mark.parametrize('example', re.findall(r'```yaml\n(.*?)```', DOCUMENT, re.DOTALL))
def test_the_examples_of_the_documents_load(folder, example):
    truths = ('gt/V1_02/data.csv', 'gt/MH_05/data.csv')
    for path in ('runs/V1_02/0.tum', 'bags/MH_05_1.mcap', *truths):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).touch()
    assert load(folder, example if 'sequences:' in example else example + one('tags: []'))


def test_a_suite_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ReadError, match=r'suite\.yaml: No such file'):
        load_suite(tmp_path / 'suite.yaml')
    with pytest.raises(ReadError, match='Is a directory'):
        load_suite(tmp_path)
