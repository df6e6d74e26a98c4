"""The pages of a diagnosis: what shows each cause, and the one command that corrects them."""

from pathlib import Path
import shlex

import numpy as np
import pytest

from verbs import call, complaint, document
from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.command import correcting_command
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.diagnosis.evidence import AS_IT_IS, PICTURES, pictures, UNDONE
from vio_eval_ros.diagnosis.page import diagnosis_html, diagnosis_markdown
from vio_eval_ros.diagnosis.report import Cause
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate
from vio_eval_ros.simulation.faults import inject

CONFIG = EvaluationConfig()
FAULTS = {
    'time_offset': (0.08,),
    'clock_drift': (1500.0,),
    'sensor_rotation': (20.0,),
    'lever_arm': (0.2,),
    'gravity_tilt': (5.0,),
    'yaw_drift': (20.0,),
    'scale': (1.2,),
    'scale_drift': (30.0,),
    'jump': (1.0,),
    'quaternion_conjugated': (),
    'truth_static': (),
}


@pytest.fixture(scope='module')
def healthy():
    return simulate(duration_s=40.0)


def harmed(run, *names: str):
    for name in names:
        run = inject(run, name, FAULTS[name], np.random.default_rng(3))
    return run


def diagnosed(run):
    poses, truth = (clean(side, Cleaning()) for side in (run.estimate, run.ground_truth))
    return diagnose(poses, truth, CONFIG)


@pytest.mark.slow
@pytest.mark.parametrize('name', FAULTS)
def test_each_cause_is_shown_by_what_it_bends(name, healthy):
    found = diagnosed(harmed(healthy, name))
    assert name in [cause.name for cause in found.causes]
    picture = pictures(found)[name]
    for curve in picture.curves:
        assert len(curve.x) == len(curve.y) > 2
    curves = {curve.name: curve for curve in picture.curves}
    if name in ('time_offset', 'yaw_drift', 'jump', 'lever_arm'):
        before, after = (curves[key] for key in (AS_IT_IS, UNDONE))
        if name == 'time_offset':  # the estimate is late, and no longer once that is undone
            assert before.x[before.y.argmax()] == pytest.approx(80, abs=10)
            assert after.x[after.y.argmax()] == pytest.approx(0, abs=10)
        else:
            assert np.nanstd(after.y) < np.nanstd(before.y) / 2


def test_pictures_are_of_known_causes():
    assert set(PICTURES) <= set(CAUSES)


@pytest.mark.slow
def test_a_page_and_markdown_have_all_that_the_text_says(healthy):
    found = diagnosed(harmed(healthy, 'time_offset', 'scale'))
    command = "replay --estimate '<b>.txt' --time-offset-s -0.08"
    page = diagnosis_html(found, '<i>est</i> against gt', command)
    text = diagnosis_markdown(found, '<i>est</i> against gt', command)
    for each in found.causes:
        assert each.advice.split("'")[0] in page
        assert each.name in page
    assert '<i>est' not in page
    assert '<b>.txt' not in page
    assert page.count('class="plot"') == len(found.causes)
    assert command in text
    for name, values in found.errors().items():
        assert f'| {name} | {values["before"]:.4g} |' in text


def test_nothing_unusual_has_no_picture(healthy):
    found = diagnosed(healthy)
    assert not found.causes
    assert pictures(found) == {}
    assert 'nothing unusual' in diagnosis_html(found, 'est')
    assert 'nothing unusual' in diagnosis_markdown(found, 'est')


def cause(name: str, *flags: str, side: str = 'estimate') -> Cause:
    return Cause(name, 1.0, 1.0, 'm', 0.1, 1.0, 0.5, 'evidence', 'advice', flags, side)


def test_one_command_has_all_flags_and_what_was_given():
    causes = [
        cause('time_offset', '--time-offset-s', '-0.05'),
        cause('quaternion_order', '?quaternion=wxyz'),
        cause('pose_inverted', '?invert=pose', side='ground_truth'),
        cause('jump'),
        cause('scale', '--alignment', 'sim3'),
    ]
    specs = {'estimate': 'my est.txt', 'ground_truth': 'gt.txt?stamps=ns'}
    given = EvaluationConfig(alignment='posyaw', max_difference_s=0.01, rpe_deltas=['1s'])
    command = correcting_command(causes, specs, given, ['--times', 't.txt'])
    assert shlex.split(command) == [
        'replay', '--times', 't.txt', '--estimate', 'my est.txt?quaternion=wxyz',
        '--ground-truth', 'gt.txt?stamps=ns&invert=pose', '--max-difference-s', '0.01',
        '--alignment', 'sim3', '--rpe-deltas', '1s', '--time-offset-s', '-0.05',
    ]  # fmt: skip


def test_where_no_flag_helps_there_is_no_command():
    specs = {'estimate': 'run.mcap:/odom', 'ground_truth': 'gt.txt'}
    causes = [cause('jump'), cause('quaternion_order', '?quaternion=wxyz')]
    assert correcting_command(causes, specs, CONFIG) == ''


@pytest.mark.slow
def test_the_command_that_is_printed_gives_the_error_that_is_promised(healthy, tmp_path):
    run = harmed(healthy, 'time_offset', 'lever_arm', 'sensor_rotation')
    files = {'est.txt': run.estimate, 'gt.txt': run.ground_truth}
    for name, poses in files.items():
        (tmp_path / name).write_text(tum(poses))
    inputs = ['--estimate', tmp_path / 'est.txt', '--ground-truth', tmp_path / 'gt.txt']
    done = call('diagnose', *inputs, '--apply')
    line = next(one for one in done.stdout.splitlines() if one.startswith('corrected by: '))
    words = shlex.split(line.removeprefix('corrected by: '))
    corrected = document(*words[words.index('replay') :])['metrics']
    promised = document('diagnose', *inputs, '--apply')['findings']['errors']
    assert corrected['ate_trans_rmse_m'] == pytest.approx(promised['ATE [m]']['after'], rel=0.02)
    assert corrected['ate_rot_rmse_deg'] == pytest.approx(
        promised['rotation ATE [deg]']['after'], rel=0.02
    )


@pytest.mark.slow
def test_reports_are_written_beside_the_text(healthy, tmp_path):
    (tmp_path / 'est.txt').write_text(tum(harmed(healthy, 'jump').estimate))
    (tmp_path / 'gt.txt').write_text(tum(healthy.ground_truth))
    inputs = ['--estimate', tmp_path / 'est.txt', '--ground-truth', tmp_path / 'gt.txt']
    reports = [f'{tmp_path}/d.html', f'markdown:{tmp_path}/d.md', f'{tmp_path}/d.json']
    done = call('diagnose', *inputs, *(word for each in reports for word in ('--report', each)))
    assert done.returncode == 0, done.stderr
    assert 'jump' in done.stdout
    assert 'Position errors over the run' in Path(tmp_path / 'd.html').read_text()
    assert '**jump**' in (tmp_path / 'd.md').read_text()
    assert call('diagnose', *inputs, '--report', 'markdown:-').stdout.startswith('###')
    assert 'would overwrite' in complaint('diagnose', *inputs, '--report', f'json:{inputs[1]}')
    assert '--signals stands alone' in complaint(
        'diagnose', '--signals', inputs[1], inputs[3], '--report', f'{tmp_path}/d.html'
    )
