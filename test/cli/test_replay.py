"""`replay` as its users run it: arguments in, output and an exit status out."""

import csv
from dataclasses import replace
from functools import partial
import json
from pathlib import Path

import pytest

import verbs
from verbs import shell, start, transcript
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate, write_recording

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'demo' / 'simulated_flight'
V1_02 = 'derived_bags/euroc_V1_02_vins_fusion'
replay, result, complaint = (
    partial(how, 'replay') for how in (verbs.call, verbs.document, verbs.complaint)
)


@pytest.fixture(scope='module')
def flight(tmp_path_factory) -> Path:
    """Return a folder with est.txt and gt.txt of a short simulated flight."""
    folder, run = tmp_path_factory.mktemp('flight'), simulate(duration_s=20.0)
    (folder / 'est.txt').write_text(tum(run.estimate))
    (folder / 'gt.txt').write_text(tum(run.ground_truth))
    return folder


def pair(folder: Path) -> list[str]:
    return ['--estimate', f'{folder}/est.txt', '--ground-truth', f'{folder}/gt.txt']


def test_a_recording_alone_is_scored():
    done = replay(DEMO)
    assert done.returncode == 0, done.stderr
    assert 'ATE position [m]' in done.stdout
    assert 'coverage      99.9 %' in done.stdout


def test_three_recordings_of_one_run_give_the_same_bits(shared_data):
    results = [result(shared_data / (V1_02 + kind)) for kind in ('.bag', '_sqlite3', '_mcap')]
    for one in results[1:]:
        for part in ('metrics', 'association', 'alignment', 'warnings'):
            assert one[part] == results[0][part]
    # evo's figure for all three
    assert results[0]['metrics']['ate_trans_rmse_m'] == pytest.approx(0.093776, abs=1e-6)


def test_the_same_run_from_files_gives_the_numbers_of_its_recording(tmp_path, shared_data):
    source = shared_data / 'gt_euroc/open_vins_tum/V1_02_medium.txt'
    rows = [line for line in source.read_text().splitlines() if not line.startswith('#')]
    (tmp_path / 'gt.txt').write_text('\n'.join(rows[::10]))
    estimate = f'{shared_data}/est_plsl_slam/euroc/V1-02/vins-fusion.csv?quaternion=wxyz&stamps=ns'
    files = result('--estimate', estimate, '--ground-truth', tmp_path / 'gt.txt')
    recording = result(shared_data / f'{V1_02}_mcap')
    assert files['association']['pairs'] == recording['association']['pairs'] == 835
    for name, value in recording['metrics'].items():
        # the recording's stamps went through float64 seconds, 238 ns apart, when it was made
        if value is None:
            assert files['metrics'][name] is None, name
        else:
            assert files['metrics'][name] == pytest.approx(value, rel=1e-5, abs=1e-12), name


@pytest.mark.parametrize(
    'recording', ['bags/evo/tf_example', 'bags/evo/tf_example.bag', 'bags/evo/nav2_turtlebot.mcap']
)
def test_a_transform_of_a_tree_is_scored_against_another(recording, shared_data):
    # base_link is fixed to base_footprint: up to that, both move alike
    found = result(
        shared_data / recording,
        '--estimate',
        '/tf:odom.base_link',
        '--ground-truth',
        '/tf:odom.base_footprint',
    )
    assert found['association']['pairs'] > 100
    assert found['metrics']['ate_trans_rmse_m'] < 0.02
    assert found['metrics']['rpe_1s_rot_rmse_deg'] < 1e-6


def test_nav2_odometry_is_its_transform_and_drifts_against_the_map(shared_data):
    recording = shared_data / 'bags/evo/nav2_turtlebot.mcap'
    odometry = result(
        recording, '--estimate', '/odom', '--ground-truth', '/tf:odom.base_footprint'
    )
    assert odometry['metrics']['ate_none_trans_rmse_m'] < 1e-9
    drift = result(recording, '--estimate', '/odom', '--ground-truth', '/tf:map.base_footprint')
    assert 0.3 < drift['metrics']['ate_trans_rmse_m'] < 0.7
    assert 'left out 28 of 2639 poses' in drift['warnings'][0]


@pytest.mark.slow
def test_a_path_is_scored_as_last_revised_and_as_first_published(revising_recording, tmp_path):
    whole = result(revising_recording, '--series', f'csv:{tmp_path}/series.csv')['metrics']
    first, last = (
        result(revising_recording, '--estimate', f'/slam/path?revision={revision}')['metrics']
        for revision in ('causal', 'final')
    )
    assert whole['ate_trans_rmse_m'] == last['ate_trans_rmse_m'] < first['ate_trans_rmse_m']
    assert whole['ate_causal_trans_rmse_m'] == first['ate_trans_rmse_m']
    assert whole['ate_causal_rot_rmse_deg'] == first['ate_rot_rmse_deg']
    gain = last['ate_trans_rmse_m'] / first['ate_trans_rmse_m']
    assert whole['loop_closure_gain'] == pytest.approx(gain, rel=1e-9)
    assert first['loop_closure_gain'] is None
    *_, row = csv.DictReader((tmp_path / 'series.csv').read_text().splitlines())
    assert float(row['ate_trans_rmse_m']) == first['ate_trans_rmse_m']
    assert 'loop-closure gain' in replay(revising_recording).stdout
    assert replay(revising_recording, '--gate', 'loop_closure_gain<=0.1').returncode == 1


def test_only_a_path_has_revisions():
    assert 'only a Path has revisions' in complaint(
        DEMO, '--estimate', '/vio/odometry?revision=causal'
    )


def test_gates_decide_the_exit_status(flight):
    assert replay(*pair(flight), '--gate', 'ate_trans_rmse_m<=1').returncode == 0
    failed = replay(*pair(flight), '--gate', 'ate_trans_rmse_m<=1e-6')
    assert failed.returncode == 1
    assert 'fail  ate_trans_rmse_m<=1e-06' in failed.stdout
    # 20 s of flight are too short for KITTI's segments: null never passes
    assert replay(*pair(flight), '--gate', 'kitti_trans_percent<=100').returncode == 1


def test_gates_come_from_a_file_too(flight, tmp_path):
    gates = tmp_path / 'gates.yaml'
    gates.write_text('{ate_trans_rmse_m: {max: 1}, coverage_ratio: {min: 0.9}}')
    done = replay(*pair(flight), '--gates', gates, '--json')
    assert done.returncode == 0
    assert [g['passed'] for g in json.loads(done.stdout)['gates']] == [True, True]
    gates.write_text('coverage_ratio: {min: 1.1}')
    assert replay(*pair(flight), '--gates', gates).returncode == 1


def test_flags_override_the_config_file(flight, tmp_path):
    config = tmp_path / 'options.yaml'
    config.write_text('{alignment: sim3, rpe_deltas: [2f], max_difference_s: 0.01}')
    found = result(*pair(flight), '--config', config, '--alignment', 'none')['config']
    assert found['alignment'] == 'none'
    assert found['rpe_deltas'] == ['2f']
    assert found['max_difference_s'] == 0.01


def test_the_default_config_file_is_every_option_at_its_default(flight):
    done = result(*pair(flight), '--config', ROOT / 'config' / 'evaluator.yaml')
    assert done['config'] == EvaluationConfig().to_dict()
    text = (ROOT / 'config' / 'evaluator.yaml').read_text()
    for name in EvaluationConfig().to_dict():
        assert f'    {name}: ' in text


def test_lists_are_space_separated(flight):
    found = result(*pair(flight), '--rpe-deltas', '1f', '10f', '5d', '--segment-lengths-m', 5, 10)
    assert found['config']['rpe_deltas'] == ['1f', '10f', '5d']
    assert found['metrics']['rpe_10f_trans_rmse_m'] > found['metrics']['rpe_1f_trans_rmse_m']
    assert found['metrics']['segment_5m_trans_percent'] > 0
    assert found['metrics']['rpe_5d_pairs'] > 100


def test_every_report_is_written(flight, tmp_path):
    kinds = ('json', 'junit', 'markdown', 'csv', 'tum', 'latex', 'mcap')
    reports = [word for kind in kinds for word in ('--report', f'{kind}:{tmp_path}/out.{kind}')]
    assert replay(*pair(flight), *reports).returncode == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(f'out.{k}' for k in kinds)
    written = json.loads((tmp_path / 'out.json').read_text())
    assert written == result(*pair(flight))
    assert len(written['inputs']['estimate']['sha256']) == 64
    recorded = result(
        tmp_path / 'out.mcap',
        '--estimate',
        '/vio_evaluator/estimate_aligned_pose',
        '--ground-truth',
        '/vio_evaluator/ground_truth_pose',
        '--alignment',
        'none',
    )
    assert recorded['metrics']['ate_trans_rmse_m'] == pytest.approx(
        written['metrics']['ate_trans_rmse_m'], rel=1e-9
    )


def test_a_report_in_the_place_of_a_folder_is_refused_before_reading(flight, tmp_path):
    done = replay(*pair(flight), '--report', f'json:{tmp_path}')
    assert (done.returncode, done.stdout) == (2, '')
    assert f'{tmp_path}: cannot write: it is a folder; name a file in it' in done.stderr


def test_a_report_that_cannot_be_written_does_not_lose_the_result(flight, tmp_path):
    done = replay(
        *pair(flight),
        '--report',
        'json:/dev/full',
        '--report',
        f'csv:{tmp_path}/errors.csv',
    )
    assert done.returncode == 2
    assert 'ATE position' in done.stdout
    assert '/dev/full: cannot write' in done.stderr
    assert (tmp_path / 'errors.csv').exists()


@pytest.mark.parametrize('options', [(), ('--rpe-pairs', 'sequential', '--alignment', 'sim3')])
def test_the_series_ends_with_the_final_result(flight, tmp_path, options):
    path = tmp_path / 'series.csv'
    final = replay(*pair(flight), *options, '--series', f'csv:{path}', '--json')
    assert final.returncode == 0, final.stderr
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == 21
    stamps = [int(row['stamp_ns']) for row in rows]
    assert stamps == sorted(set(stamps))
    assert {stamp % 10**9 for stamp in stamps[:-1]} == {0}
    metrics = json.loads(final.stdout)['metrics']
    names = set(rows[0]) - {'stamp_ns', 'pairs'}
    assert {'ate_trans_rmse_m', 'ate_rot_rmse_deg', 'rpe_1s_trans_rmse_m'} <= names
    for name in names:
        assert float(rows[-1][name]) == pytest.approx(metrics[name], rel=1e-9), name
    counts = [int(row['pairs']) for row in rows]
    assert counts == sorted(counts)
    assert counts[-1] == 400


@pytest.mark.parametrize('name', ['est.txt', 'gt.txt'])
def test_the_series_is_of_the_poses_as_both_sides_settle_them(flight, tmp_path, name):
    files = {'est.txt': flight / 'est.txt', 'gt.txt': flight / 'gt.txt', name: tmp_path / name}
    rows = [line.split() for line in (flight / name).read_text().splitlines() if line[0] != '#']
    files[name].write_text('\n'.join(' '.join([*row[:4], row[7], *row[4:7]]) for row in rows))
    path = tmp_path / 'series.csv'
    found = result(
        '--estimate',
        files['est.txt'],
        '--ground-truth',
        files['gt.txt'],
        '--series',
        f'csv:{path}',
    )
    assert 'quaternion=wxyz' in found['warnings'][0]
    *_, row = csv.DictReader(path.read_text().splitlines())
    rotation = found['metrics']['ate_rot_rmse_deg']
    assert rotation < 10
    assert float(row['ate_rot_rmse_deg']) == pytest.approx(rotation, rel=1e-9)


def test_a_row_of_the_series_is_the_result_of_the_run_up_to_there(flight, tmp_path):
    path = tmp_path / 'series.csv'
    assert replay(*pair(flight), '--series', f'csv:{path}').returncode == 0
    row = list(csv.DictReader(path.read_text().splitlines()))[10]
    first = int((flight / 'gt.txt').read_text().splitlines()[1].split('.')[0])
    assert int(row['stamp_ns']) == (first + 11) * 10**9
    early = tmp_path / 'early'
    early.mkdir()
    for name in ('est.txt', 'gt.txt'):
        lines = (flight / name).read_text().splitlines()
        kept = [line for line in lines if line[0] == '#' or float(line.split()[0]) <= first + 11]
        (early / name).write_text('\n'.join(kept))
    # what only the end decides is not decided yet: the last estimate waits for truth behind it
    metrics = result(*pair(early))['metrics']
    assert float(row['ate_trans_rmse_m']) == pytest.approx(metrics['ate_trans_rmse_m'], rel=1e-2)
    assert float(row['rpe_1s_trans_rmse_m']) == pytest.approx(
        metrics['rpe_1s_trans_rmse_m'], rel=1e-2
    )


def test_it_runs_in_an_interpreter_of_its_own(flight):
    done = start('replay', *pair(flight), '--json')
    assert (done.returncode, done.stderr) == (0, '')
    assert json.loads(done.stdout) == result(*pair(flight))


def test_a_pipe_that_closes_is_not_an_error(flight):
    done = shell(f'vio_eval replay {" ".join(pair(flight))} --json | head -c 1')
    assert done.stdout == '{'
    assert done.stderr == ''


def test_nothing_but_json_and_no_progress_bar_in_a_pipe(flight):
    done = replay(*pair(flight), '--json')
    assert done.stderr == ''
    assert json.loads(done.stdout)['schema'] == 'vio_eval_ros.result/1'


@pytest.mark.parametrize(
    ('arguments', 'problem'),
    [
        ((), 'give a RECORDING, or both --estimate and --ground-truth'),
        (('nowhere.bag',), 'there is no such file'),
        (('--alignment', 'se'), "did you mean 'se3'?"),
        (('--rpe-deltas', '1q'), "rpe_deltas: '1q' is not a valid delta"),
        (('--rpe-deltas', '1.5f'), 'whole numbers'),
        (('--max-difference-s', '-1'), 'max_difference_s: -1 is below 0'),
        (('--max-gap-s', 'nan'), 'max_gap_s'),
        (('--time-offset-s', '1e30'), 'more than clocks can differ'),
        (('--start-s', '5', '--end-s', '4'), 'not before end_s'),
        (('--gate', 'ate_trans_rms_m<=1'), "did you mean 'ate_trans_rmse_m'?"),
        (('--gate', 'ate_trans_rmse_m=1'), 'METRIC<=LIMIT'),
        (('--gate', 'ate_trans_rmse_m<=nan'), 'not a finite number'),
        (('--report', 'docx:x'), 'with FORMAT one of json, junit, markdown, '),
        (('--report', 'json:/nowhere/x'), 'there is no folder /nowhere'),
        (('--series', 'json:x'), 'csv'),
        (('--config', 'nowhere.yaml'), 'nowhere.yaml: No such file'),
        (('--estimate-to-body', '1', '2', '3'), 'expected 7 arguments'),
        (('--estimate-to-body', *'0000000'), 'unit quaternion'),
        (('--estimate-to-body', '1e300', *'000001'), 'estimate_to_body: give'),
        (('--nonsense',), "there is no option '--nonsense'"),
    ],
)
def test_wrong_arguments_are_one_line_and_status_2(arguments, problem):
    assert problem in complaint(*arguments)


@pytest.mark.parametrize(
    ('options', 'problem'),
    [
        ('allignment: se3', "unknown option 'allignment'; did you mean 'alignment'?"),
        ('alignment: [se3]', 'is not a word'),
        ('max_gap_s: soon', 'is not a finite number'),
        ('max_gap_s: true', 'is not a finite number'),
        ('rpe_deltas: {a: b}', 'is not a list'),
        ('- a\n- b', 'a mapping'),
        ('a: [', 'not valid YAML'),
        ('!!python/object/apply:os.system [echo hacked]', 'not valid YAML'),
        ('\x00', 'not valid YAML'),
        ('{max_gap_s: 1, max_gap_s: 2}', "line 1: 'max_gap_s' is given twice"),
        ('rpe_deltas: &a [1f]\nsegment_lengths_m: *a', 'line 2: aliases are not allowed'),
        ('max_gap_s: ' + '9' * 400, 'is not a finite number'),
        ('/**: {ros__parameters: 3}', 'no mapping ros__parameters'),
    ],
)
def test_a_wrong_config_file_is_one_line_and_status_2(tmp_path, flight, options, problem):
    config = tmp_path / 'options.yaml'
    config.write_text(options)
    assert problem in complaint(*pair(flight), '--config', config)


def test_the_parameters_of_the_node_override_those_of_all_nodes(flight, tmp_path):
    config = tmp_path / 'params.yaml'
    config.write_text(
        'vio_evaluator: {ros__parameters: {alignment: sim3}}\n'
        '/**: {ros__parameters: {alignment: se3, max_gap_s: 1.0}}\n'
    )
    found = result(*pair(flight), '--config', config)['config']
    assert (found['alignment'], found['max_gap_s']) == ('sim3', 1.0)


def test_negative_numbers_may_have_exponents(flight):
    found = result(
        *pair(flight), '--time-offset-s', '-1e-3', '--estimate-to-body', 0, 0, '-1e-5', 0, 0, 0, 1
    )
    assert found['config']['time_offset_s'] == -0.001
    assert found['config']['estimate_to_body'][2] == -1e-5


def test_what_would_be_ignored_is_refused(flight, tmp_path):
    assert 'is not used' in complaint('nothere.bag', *pair(flight))
    assert 'nothere: these times are not used' in complaint(*pair(flight), '--times', 'nothere')
    assert 'expected a topic or a file, got nothing' in complaint(DEMO, '--estimate', '')
    empty = tmp_path / 'gates.yaml'
    empty.write_text('')
    assert 'there are no gates' in complaint(*pair(flight), '--gates', empty)


def test_no_report_overwrites_an_input_or_another_report(flight, tmp_path):
    truth = (flight / 'gt.txt').read_bytes()
    told = complaint(*pair(flight), '--report', f'tum:{flight}/gt.txt')
    assert 'would overwrite the input' in told
    assert (flight / 'gt.txt').read_bytes() == truth
    same = [f'--report=csv:{tmp_path}/x', f'--report=json:{tmp_path}/x']
    assert 'would overwrite csv:' in complaint(*pair(flight), *same)


def test_reports_are_written_though_nobody_reads_the_output(flight, tmp_path):
    options = f'{" ".join(pair(flight))} --report json:{tmp_path}/x.json'
    done = shell(f'vio_eval replay {options} > /dev/full')
    assert 'No space left' in done.stderr
    assert 'bug' not in done.stderr
    assert json.loads((tmp_path / 'x.json').read_text())['association']['pairs'] == 400


@pytest.mark.parametrize('alignment', ['sim3', 'scale'])
def test_no_scale_makes_up_for_a_truth_that_stands_still(flight, tmp_path, alignment):
    rows = (flight / 'gt.txt').read_text().splitlines()[1:]
    (tmp_path / 'gt.txt').write_text('\n'.join(f'{row.split()[0]} 0 0 0 0 0 0 1' for row in rows))
    done = replay(
        '--estimate',
        f'{flight}/est.txt',
        '--ground-truth',
        f'{tmp_path}/gt.txt',
        '--alignment',
        alignment,
        '--gate',
        'ate_trans_rmse_m<=0.1',
    )
    assert done.returncode == 1
    assert done.stderr == ''


def test_nobody_has_to_listen_to_stderr(flight):
    for command, status in (
        (f'vio_eval replay {" ".join(pair(flight))} 2>&-', 0),
        ('vio_eval replay --estimate nowhere --ground-truth nowhere 2>/dev/full', 2),
    ):
        done = shell(command)
        assert done.returncode == status, transcript(done)
        assert 'bug' not in done.stdout


def test_names_too_long_for_a_path_are_one_line(flight):
    complaint('--estimate', 'x' * 5000, '--ground-truth', f'{flight}/gt.txt')


LINE = '\n'.join(f'{k} {k} 0 0 0 0 0 1' for k in range(1, 9))


@pytest.mark.parametrize(
    ('estimate', 'problem'),
    [
        ('', 'the file is empty'),
        ('1 2 3\n', '3 columns; a trajectory has 8'),
        ('1 0 0 0 0 0 0 1\nx 0 0 0 0 0 0 1\n', "line 2: 'x' is not a number"),
        (
            '101 0 0 0 0 0 0 1\n',
            'estimate spans 101.0 to 101.0 s, ground truth 1.0 to 8.0 s; are the clocks the same?',
        ),
        ('1.4 0 0 0 0 0 0 1\n', 'the closest stamps are 0.4 s apart'),
        ('1 nan 0 0 0 0 0 1\n', 'no usable pose (dropped: 1 non-finite)'),
    ],
)
def test_files_that_cannot_be_scored_are_one_line_and_status_2(tmp_path, estimate, problem):
    (tmp_path / 'est.txt').write_text(estimate)
    (tmp_path / 'gt.txt').write_text(LINE)
    assert problem in complaint(*pair(tmp_path))


@pytest.mark.parametrize(
    ('estimate', 'warning'),
    [
        (LINE, 'moves along a line'),
        ('1 1e300 0 0 0 0 0 1\n' + LINE.partition('\n')[2], 'dropped 1 non-finite'),
        ('\n'.join(reversed(LINE.splitlines())), '7 stamps went backwards'),
    ],
)
def test_what_can_hardly_be_scored_is_scored_with_a_warning(tmp_path, estimate, warning):
    (tmp_path / 'est.txt').write_text(estimate)
    (tmp_path / 'gt.txt').write_text(LINE)
    found = result(*pair(tmp_path))
    assert any(warning in text for text in found['warnings'])
    assert found['metrics']['ate_rot_rmse_deg'] is None
    assert found['alignment']['observable'] is False
    assert found['metrics']['ate_trans_rmse_m'] >= 0


@pytest.mark.parametrize('alignment', ['none', 'se3', 'sim3'])
def test_a_single_pair_passes_no_gate(tmp_path, alignment):
    (tmp_path / 'est.txt').write_text('1 5 0 0 0 0 0 1\n')
    (tmp_path / 'gt.txt').write_text(LINE)
    gate = ['--gate', 'ate_trans_rmse_m<=0.1', '--alignment', alignment]
    found = result(*pair(tmp_path), *gate, status=1)
    assert found['metrics']['ate_trans_rmse_m'] is None
    assert any('absolute errors are null' in text for text in found['warnings'])


def test_every_damaged_recording_is_one_line_and_status_2(shared_data):
    damaged = [
        path
        for folder in ('derived_bags/damaged', 'bags/mcap_lfs_pointers')
        for path in sorted((shared_data / folder).rglob('*'))
        if path.is_file()
    ]
    assert len(damaged) >= 6
    for path in damaged:
        assert path.name in complaint(path)


def test_topics_that_cannot_be_scored_are_explained(shared_data):
    recording = shared_data / f'{V1_02}.bag'
    listed = complaint(recording, '--estimate', '/odom', '--ground-truth', '/ground_truth/pose')
    assert '/vio/odometry (nav_msgs/msg/Odometry, 845)' in listed
    turtle = shared_data / 'bags/rosbag_js/example-bz2.bag'
    refused = complaint(turtle, '--estimate', '/turtle1/pose', '--ground-truth', '/turtle2/pose')
    assert 'turtlesim/msg/Pose is not read: no field of it has a position' in refused


def test_a_large_estimate_of_another_clock_is_reported_with_both_spans(flight):
    told = complaint(*pair(flight), '--time-offset-s', '1000')
    assert 'estimate spans 14037' in told
    assert 'are the clocks the same? `diagnose` measures the --time-offset-s' in told


@pytest.mark.parametrize('apart_s', [-37, 25, 3600, 8e6])
def test_the_offset_that_the_motions_show_is_the_one_to_write(flight, apart_s):
    run = simulate(duration_s=20.0)
    late = replace(run.estimate, stamps_ns=run.estimate.stamps_ns + int(apart_s * 1e9))
    (flight / 'late.txt').write_text(tum(late))
    late_pair = ['--estimate', f'{flight}/late.txt', *pair(flight)[2:]]
    told = complaint(*late_pair)
    flag, seconds = told.split()[-2:]
    assert flag == '--time-offset-s'
    assert float(seconds) == pytest.approx(-apart_s, abs=0.05)
    assert result(*late_pair, flag, seconds)['association']['pairs'] > 300


def test_a_recording_with_spaces_in_its_path_is_scored(tmp_path):
    folder = tmp_path / 'my runs'
    folder.mkdir()
    write_recording(simulate(duration_s=2.0), folder / 'run 1.bag')
    assert result(folder / 'run 1.bag')['association']['pairs'] == 40
