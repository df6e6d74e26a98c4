"""`replay` of several estimates: one table, and each number that of the estimate alone."""

from dataclasses import replace
from functools import partial
import json
from pathlib import Path
from unittest.mock import patch

import pytest

import verbs
from vio_eval_ros.recordings import sources
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'demo' / 'simulated_flight'
replay, document, complaint = (
    partial(how, 'replay') for how in (verbs.call, verbs.document, verbs.complaint)
)


@pytest.fixture(scope='module')
def flight(tmp_path_factory) -> Path:
    """Return a folder with the truth of a flight, good.txt, poor.txt, and lost.txt of a part."""
    folder, run = tmp_path_factory.mktemp('flight'), simulate(duration_s=20.0)
    (folder / 'gt.txt').write_text(tum(run.ground_truth))
    (folder / 'good.txt').write_text(tum(run.estimate))
    poor = replace(run.estimate, positions=1.2 * run.estimate.positions)
    (folder / 'poor.txt').write_text(tum(poor))
    (folder / 'lost.txt').write_text(tum(run.ground_truth[: len(run.ground_truth) // 4]))
    return folder


def estimates(folder: Path, *names: str) -> list[str]:
    words = [word for name in names for word in ('--estimate', f'{name}={folder}/{name}.txt')]
    return [*words, '--ground-truth', f'{folder}/gt.txt']


def test_one_table_has_every_system_and_marks_best_and_second(flight):
    done = replay(*estimates(flight, 'poor', 'good'))
    assert done.returncode == 0, done.stderr
    table = done.stdout.partition('Is the difference real?')[0]
    lines = {line.split()[0]: line for line in table.splitlines() if line}
    assert lines['system'].split()[1:3] == ['ATE', '[m]']
    assert lines['good'].split()[2] == '*'
    assert lines['poor'].split()[2] == '+'


def test_every_number_is_that_of_the_estimate_alone(flight):
    found = document(*estimates(flight, 'poor', 'good'))
    assert found['schema'] == 'vio_eval_ros.comparison/1'
    for one in found['systems']:
        alone = document(*estimates(flight, one['name']))
        assert alone['schema'] == 'vio_eval_ros.result/1'
        assert one['result'] == alone
        for metric, of in found['matrix']['metrics'].items():
            cell = of['sequences']['']['systems'][one['name']]
            assert cell['value'] == alone['metrics'][metric]


def test_the_metrics_are_chosen(flight):
    done = replay(*estimates(flight, 'poor', 'good'), '--metric', 'sim3_scale', 'coverage_ratio')
    heads = next(line for line in done.stdout.splitlines() if line.startswith('system'))
    assert heads.split() == ['system', 'Sim(3)', 'scale', 'coverage']
    assert "no metric 'ate' with" in complaint(
        *estimates(flight, 'good', 'poor'), '--metric', 'ate'
    )
    told = complaint(*estimates(flight, 'good', 'poor'), '--metric', *['sim3_scale'] * 2)
    assert 'given twice' in told
    assert '--estimate NAME=SPEC' in complaint(
        *estimates(flight, 'good'), '--metric', 'ate_trans_rmse_m'
    )


def test_a_lost_track_with_the_smallest_error_is_not_the_best(flight):
    done = replay(*estimates(flight, 'good', 'lost'))
    assert done.returncode == 0
    lost = next(line for line in done.stdout.splitlines() if line.startswith('lost '))
    assert '†' in lost
    assert '*' not in lost
    assert 'lost: tracked_ratio is 0.2' in done.stdout


@pytest.mark.parametrize(
    ('content', 'problem'),
    [
        (None, 'there is no such file'),
        ('nonsense\n', 'no rows of numbers'),
        (''.join(f'{9e8 + k} {k} {k % 7} 0 0 0 0 1\n' for k in range(99)), 'no pairs'),
    ],
    ids=['missing', 'unreadable', 'no pairs'],
)
def test_a_system_that_cannot_be_scored_has_failed_by_name(flight, tmp_path, content, problem):
    if content is not None:
        (tmp_path / 'bad.txt').write_text(content)
    found = tmp_path / 'found.json'
    done = replay(
        *estimates(flight, 'good'), '--estimate', f'bad={tmp_path}/bad.txt', '--report', found
    )
    assert done.returncode == 1
    assert done.stderr.startswith('replay: bad could not be scored: ')
    assert done.stderr.count('\n') == 1
    assert problem in done.stderr
    row = next(line for line in done.stdout.splitlines() if line.startswith('bad '))
    assert set(row.split()[1:]) == {'failed'}
    bad = json.loads(found.read_text())['systems'][1]
    assert bad['result'] is None
    assert problem in bad['error']


def test_where_none_can_be_scored_it_could_not_be_done(flight):
    told = complaint(
        *('--estimate', 'a=nix', '--estimate', 'b=nothing', '--ground-truth', f'{flight}/gt.txt')
    )
    assert 'no system could be scored: a: ' in told
    assert 'b: ' in told
    told = complaint(
        '--estimate', f'a={flight}/good.txt', '--estimate', 'b=x', '--ground-truth', 'n'
    )
    assert 'n: No such file' in told or "'n'" in told


def test_gates_hold_for_each_system(flight):
    done = replay(*estimates(flight, 'poor', 'good'), '--gate', 'ate_trans_rmse_m<=0.2')
    assert done.returncode == 1
    assert 'fail  poor: ate_trans_rmse_m<=0.2' in done.stdout
    assert 'pass  good: ate_trans_rmse_m<=0.2' in done.stdout


def test_names_come_from_files_where_none_are_given(flight, tmp_path):
    spec = ['--estimate', f'{flight}/good.txt', '--estimate', f'{flight}/poor.txt']
    found = document(*spec, '--ground-truth', f'{flight}/gt.txt')
    assert found['matrix']['systems'] == ['good', 'poor']
    (tmp_path / 'good.txt').write_text((flight / 'good.txt').read_text())
    told = complaint(*estimates(flight, 'good'), '--estimate', f'{tmp_path}/good.txt')
    assert "two estimates are called 'good'" in told
    assert '--estimate NAME=' in told


def test_a_file_with_an_equals_sign_is_a_file(flight, tmp_path):
    (tmp_path / 'a=b.txt').write_text((flight / 'good.txt').read_text())
    truth = ['--ground-truth', f'{flight}/gt.txt']
    found = document('--estimate', 'a=b.txt', *truth, cwd=tmp_path)
    assert found['inputs']['estimate']['source'] == 'a=b.txt'
    found = document('--estimate', 'c=a=b.txt', *truth, cwd=tmp_path)
    assert found['inputs']['estimate']['source'] == 'a=b.txt'
    found = document('--estimate', 'a=b.txt?quaternion=xyzw', *truth, cwd=tmp_path)
    assert found['inputs']['estimate']['source'] == 'a=b.txt?quaternion=xyzw'


def test_a_recording_and_the_truth_are_read_once():
    with patch.object(sources, 'read_sources', wraps=sources.read_sources) as read:
        found = document(
            DEMO, '--estimate', 'odometry=/vio/odometry', '--estimate', 'again=/vio/odometry'
        )
    assert read.call_count == 1
    assert found['matrix']['systems'] == ['odometry', 'again']
    assert (
        found['systems'][0]['result']['inputs']['ground_truth']['source'] == '/ground_truth/pose'
    )


def test_what_is_of_one_estimate_is_refused(flight, tmp_path):
    both = estimates(flight, 'good', 'poor')
    for words in (('--series', f'csv:{tmp_path}/s.csv'), ('--manifest', tmp_path / 'm.json')):
        assert 'of one estimate' in complaint(*both, *words)
    assert 'would overwrite' in complaint(*both, '--report', f'csv:{flight}/poor.txt')


@pytest.mark.parametrize('format', ['json', 'junit', 'markdown', 'html', 'csv', 'latex'])
def test_every_report_names_every_system(flight, tmp_path, format):
    file = tmp_path / 'report'
    done = replay(
        *estimates(flight, 'good', 'poor'),
        '--estimate',
        'no_1=nix',
        '--report',
        f'{format}:{file}',
    )
    assert done.returncode == 1, done.stderr
    text = file.read_text().replace('\\_', '_')
    assert all(name in text for name in ('good', 'poor', 'no_1', 'No such file'))


def test_wrong_usage_of_one_estimate_is_wrong_usage(flight):
    both = estimates(flight, 'good', 'poor')
    assert 'write NAME=SPEC' in complaint(*both, '--estimate', 'a=')
    assert 'quaternion must be' in complaint(*both, '--estimate', 'a=x.txt?quaternion=zyx')
    told = complaint(DEMO, '--estimate', 'a=odom?stamps=never', '--estimate', 'b=/vio/odometry')
    assert 'stamps must be header or recorded' in told


def test_the_same_file_under_two_names_is_pointed_out(flight):
    same = ['--estimate', f'again={flight}/good.txt']
    done = replay(*estimates(flight, 'good', 'poor'), *same)
    assert 'good and again have the same results: are they the same runs?' in done.stdout
