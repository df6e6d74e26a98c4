"""``--plot terminal``: the error over time and the paths, without a display."""

import pytest

from verbs import call, complaint
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate


@pytest.fixture(scope='module')
def flight(tmp_path_factory):
    folder, run = tmp_path_factory.mktemp('flight'), simulate(duration_s=20.0)
    (folder / 'est.txt').write_text(tum(run.estimate))
    (folder / 'gt.txt').write_text(tum(run.ground_truth))
    return folder


def test_a_run_is_drawn_below_its_summary(flight):
    done = call(
        'replay', '--estimate', flight / 'est.txt', '--ground-truth', flight / 'gt.txt',
        '--plot', 'terminal',
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.index('ATE position [m]') < done.stdout.index('position error from 0.0 to')
    assert 'from above' in done.stdout
    assert any('⠁' <= c <= '⣿' for c in done.stdout)
    assert max(map(len, done.stdout.split('position error from')[1].splitlines())) <= 80


def test_each_system_has_a_line(flight):
    names = ('--estimate', f'one={flight}/est.txt', '--estimate', f'two={flight}/est.txt')
    done = call('replay', *names, '--ground-truth', flight / 'gt.txt', '--plot', 'terminal')
    assert 'one: position error' in done.stdout
    assert 'two: position error' in done.stdout


def test_it_does_not_mix_with_json(flight):
    inputs = ('--estimate', flight / 'est.txt', '--ground-truth', flight / 'gt.txt')
    assert 'leave out what replaces it' in complaint(
        'replay', *inputs, '--plot', 'terminal', '--json'
    )
