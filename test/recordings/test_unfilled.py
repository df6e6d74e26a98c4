"""Poses that are written though there is none: held orientations, placeholders, rows of -1."""

from dataclasses import replace

import numpy as np
import pytest

from verbs import call, complaint, document
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.recordings.agreement import settled
from vio_eval_ros.recordings.arrays import source_of
from vio_eval_ros.recordings.publishers import placeholder
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate

RUN = simulate(duration_s=60.0)
COUNT = len(RUN.estimate)
SCATTERED = np.random.default_rng(0).random(COUNT) < 0.1
BLOCK = (np.arange(COUNT) >= 400) & (np.arange(COUNT) < 520)
BLOCKS = (np.arange(COUNT) // 20) % 5 == 4
HEAD, TAIL = np.arange(COUNT) < 100, np.arange(COUNT) >= COUNT - 100
FEW = np.isin(np.arange(COUNT), [100, 300, 301, 700])


@pytest.fixture
def inputs(tmp_path):
    """Return what makes the options that name an estimate and the ground truth."""
    (tmp_path / 'gt.txt').write_text(tum(RUN.ground_truth))

    def written(estimate, name='est.txt'):
        (tmp_path / name).write_text(tum(estimate))
        return ['--estimate', tmp_path / name, '--ground-truth', tmp_path / 'gt.txt']

    return written


def held(which: np.ndarray, value=None):
    rotations = RUN.estimate.rotations.copy()
    rotations[which] = rotations[which][0] if value is None else value
    return replace(RUN.estimate, rotations=rotations)


@pytest.mark.parametrize('value', [(0, 0, 0, 1), None, (0.5, 0.5, 0.5, 0.5)])
def test_orientations_that_are_held_while_the_body_turns_are_said_first(inputs, value):
    first = document('replay', *inputs(held(BLOCK, value)))['warnings'][0]
    assert '120 of 1200 poses' in first
    assert 'repeat the orientation of the one before' in first
    assert 'while the ground truth turns by' in first


def test_several_stretches_of_held_orientations_are_counted_together(inputs):
    first = document('replay', *inputs(held(BLOCKS, (0, 0, 0, 1))))['warnings'][0]
    assert '240 of 1200 poses' in first
    assert '(such as 0 0 0 1)' in first


def test_the_ground_truth_is_looked_at_as_well():
    truth = RUN.ground_truth
    rotations = truth.rotations.copy()
    rotations[3000:6000] = (0, 0, 0, 1)
    sides = (
        source_of('estimate', RUN.estimate),
        source_of('ground_truth', replace(truth, rotations=rotations)),
    )
    estimate, settled_truth = settled(*sides, EvaluationConfig())
    assert not any('orientation' in warning for warning in estimate.warnings)
    assert (
        '3001 of 12000' in settled_truth.warnings[0]
        or '3000 of 12000' in settled_truth.warnings[0]
    )


@pytest.mark.parametrize(
    'which', [np.zeros(COUNT, bool), np.arange(COUNT) < 15, np.arange(COUNT) % 7 == 0]
)
def test_a_healthy_run_and_few_or_scattered_repeats_are_not_mentioned(which):
    rotations = RUN.estimate.rotations.copy()
    rotations[1:][which[1:]] = rotations[:-1][which[1:]]
    estimate = source_of('estimate', replace(RUN.estimate, rotations=rotations))
    sides = settled(estimate, source_of('ground_truth', RUN.ground_truth), EvaluationConfig())
    assert not any('not filled in' in warning for side in sides for warning in side.warnings)


def test_a_body_that_does_not_turn_may_have_one_orientation():
    still = np.tile([0.0, 0, 0, 1], (len(RUN.ground_truth), 1))
    still[:2000] = RUN.ground_truth.rotations[:2000]
    truth = replace(RUN.ground_truth, rotations=still)
    own = np.tile([0.0, 0, 0, 1], (COUNT, 1))
    own[:200] = RUN.estimate.rotations[:200]
    sides = settled(
        source_of('estimate', replace(RUN.estimate, rotations=own)),
        source_of('ground_truth', truth),
        EvaluationConfig(),
    )
    assert not any('not filled in' in warning for side in sides for warning in side.warnings)


def lost(which: np.ndarray, value=(0, 0, 0, 0, 0, 0, 1), offset=(0, 0, 0)):
    positions, rotations = RUN.estimate.positions + offset, RUN.estimate.rotations.copy()
    positions[which], rotations[which] = value[:3], value[3:]
    return replace(RUN.estimate, positions=positions, rotations=rotations)


@pytest.mark.parametrize(
    'which', [BLOCK, BLOCKS, FEW, HEAD, TAIL], ids=['block', 'blocks', 'few', 'head', 'tail']
)
@pytest.mark.parametrize('value', [(0, 0, 0, 0, 0, 0, 1), (9, 9, 9, 0.5, 0.5, 0.5, 0.5)])
def test_placeholders_are_named_first(inputs, which, value):
    first = document('replay', *inputs(lost(which, value, (3, 2, 1))))['warnings'][0]
    shown = ' '.join(f'{number:g}' for number in value)
    assert f'{np.count_nonzero(which)} poses are {shown}, the first at' in first
    assert 'placeholders for lost poses?' in first


def test_scattered_placeholders_are_no_second_publisher(inputs):
    line = complaint('replay', *inputs(lost(SCATTERED)))
    assert f'{np.count_nonzero(SCATTERED)} poses are 0 0 0 0 0 0 1' in line
    assert 'where there is no pose, write none' in line
    assert 'publishers' not in line


def test_what_leaps_to_other_places_or_returns_by_itself_is_no_placeholder():
    assert placeholder(RUN.estimate) is None
    jumped = RUN.estimate.positions.copy()
    jumped[500:] += (5, 0, 0)
    assert placeholder(replace(RUN.estimate, positions=jumped)) is None
    outliers = RUN.estimate.positions.copy()
    outliers[FEW] += np.arange(1, 5)[:, None]
    assert placeholder(replace(RUN.estimate, positions=outliers)) is None


def rows(poses) -> list[str]:
    return [line for line in tum(poses).splitlines() if not line.startswith('#')]


def rewritten(tmp_path, lines):
    (tmp_path / 'est.txt').write_text('\n'.join(lines) + '\n')
    (tmp_path / 'gt.txt').write_text(tum(RUN.ground_truth))
    return ['--estimate', tmp_path / 'est.txt', '--ground-truth', tmp_path / 'gt.txt']


def test_rows_of_minus_one_are_named(tmp_path):
    lines = rows(RUN.estimate)
    for k in (3, 10, 40):
        lines[k] = lines[k].split()[0] + ' -1' * 7
    lines[50:200] = [line.split()[0] + ' -1' * 7 for line in lines[50:200]]
    line = complaint('replay', *rewritten(tmp_path, lines))
    assert 'not of unit length in 153 of 1200 rows, the first in row 4: -1 -1 -1' in line


@pytest.mark.parametrize(
    ('order', 'said'),
    [(slice(None, None, -1), 'fall from the first row to the last'), (None, 'go back in')],
)
def test_stamps_out_of_order_are_named_and_read_where_stated(tmp_path, order, said):
    lines = np.array(rows(RUN.estimate))
    shuffled = lines[order] if order else np.random.default_rng(1).permutation(lines)
    inputs = rewritten(tmp_path, shuffled)
    assert said in complaint('replay', *inputs)
    stated = [inputs[0], f'{inputs[1]}?columns=t,x,y,z,qx,qy,qz,qw', *inputs[2:]]
    right = document('replay', *rewritten(tmp_path, rows(RUN.estimate)))['metrics']
    rewritten(tmp_path, shuffled)
    assert document('replay', *stated)['metrics'] == right


def test_bars_between_columns_are_named(tmp_path):
    lines = [line.replace(' ', '|') for line in rows(RUN.estimate)]
    assert 'columns are separated by |' in complaint('replay', *rewritten(tmp_path, lines))


def test_names_that_are_there_twice_get_advice_without_doubles(tmp_path):
    lines = ['time,x,y,z,x,y,z,w', *(line.replace(' ', ',') for line in rows(RUN.estimate))]
    inputs = rewritten(tmp_path, lines)
    line = complaint('replay', *inputs)
    stated = f'{inputs[1]}?columns=t,x,y,z,qx,qy,qz,qw'
    assert stated.partition('?')[2] in line
    assert call('replay', inputs[0], stated, *inputs[2:]).returncode == 0
