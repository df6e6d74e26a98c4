"""An estimate and its ground truth settle what the file of either leaves open, or it is asked."""

from dataclasses import replace
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from verbs import call, complaint, document
import vio_eval_ros as vio
from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.agreement import settled
from vio_eval_ros.recordings.agreement.orders import alone
from vio_eval_ros.recordings.layouts import Reading
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.simulation import simulate

RUN = simulate(duration_s=20.0)
TRUTH = RUN.ground_truth[::4]
ORDERS = {'xyzw': [0, 1, 2, 3], 'wxyz': [3, 0, 1, 2]}


def write(
    path: Path,
    poses: Trajectory,
    *,
    order: str = 'xyzw',
    stamps: str = '{:.6f}',
    unit: float = 1.0,
    scale: float = 1.0,
    comma: str = ' ',
) -> Path:
    """Write poses with stamps [s] relative to the first truth, times a unit, and no header."""
    seconds = (poses.stamps_ns - TRUTH.stamps_ns[0]) / 1e9 * unit
    rows = np.column_stack([scale * poses.positions, poses.rotations[:, ORDERS[order]]])
    lines = (
        comma.join([stamps.format(t), *(f'{v:.9f}' for v in row)]) + '\n'
        for t, row in zip(seconds, rows, strict=True)
    )
    path.write_text(''.join(lines))
    return path


@pytest.fixture
def files(tmp_path):
    def written(estimate=None, truth=None):
        write(tmp_path / 'est.txt', RUN.estimate, **estimate or {})
        write(tmp_path / 'gt.txt', TRUTH, **truth or {})
        return [
            '--estimate', f'{tmp_path}/est.txt', '--ground-truth', f'{tmp_path}/gt.txt'
        ]  # fmt: skip

    return written


@pytest.fixture
def expected(files):
    return document('replay', *files())['metrics']


def same(found, expected):
    for name in ('ate_trans_rmse_m', 'ate_rot_rmse_deg', 'rpe_1s_trans_rmse_m'):
        assert found[name] == pytest.approx(expected[name], rel=1e-6), name
    return True


# -- the order of quaternions


@pytest.mark.parametrize('comma', [' ', ',', '\t'])
@pytest.mark.parametrize('order', ['xyzw', 'wxyz'])
def test_the_order_of_an_estimate_is_settled_by_the_truth(files, expected, order, comma):
    pair = files({'order': order, 'comma': comma})
    found = document('replay', *pair)
    assert same(found['metrics'], expected)
    said = f'read with quaternion={order}, as the ground truth shows'
    if (order, comma) in [('xyzw', ' '), ('xyzw', '\t')]:  # the rule of TUM
        assert found['warnings'] == []
    else:
        assert said in found['warnings'][0]
        assert f'est.txt?quaternion={order}' in found['warnings'][0]


@pytest.mark.parametrize('alignment', ['none', 'sim3'])
def test_the_order_of_a_truth_is_settled_by_the_estimate(files, alignment):
    meant = document('replay', *files(), '--alignment', alignment)['metrics']
    found = document('replay', *files(None, {'order': 'wxyz'}), '--alignment', alignment)
    assert 'gt.txt: read with quaternion=wxyz, as the estimate shows' in found['warnings'][0]
    assert same(found['metrics'], meant)


@pytest.mark.slow
def test_what_was_settled_is_the_first_line_of_every_verb(files):
    pair = files({'order': 'wxyz'})
    for verb in ('replay', 'diagnose'):
        first = call(verb, *pair).stdout.splitlines()[0]
        assert 'est.txt: read with quaternion=wxyz' in first
    assert 'quaternion=wxyz' in document('diagnose', *pair)['warnings'][0]


def test_two_files_of_another_order_are_not_both_turned_round(files):
    # in one world and without a sensor rotation, both readings agree: the rule of TUM holds
    found = document('replay', *files({'order': 'wxyz'}, {'order': 'wxyz'}))
    assert found['metrics']['ate_trans_rmse_m'] > 0
    assert document('replay', *files({'order': 'xyzw'}, {'order': 'xyzw'}))['warnings'] == []


def test_of_two_files_without_a_rule_each_has_its_own_order(files, expected):
    found = document('replay', *files({'order': 'wxyz', 'comma': ','}, {'comma': ','}))
    assert same(found['metrics'], expected)
    assert 'est.txt: read with quaternion=wxyz' in found['warnings'][0]
    assert 'gt.txt: read with quaternion=xyzw' in found['warnings'][1]


def test_what_is_stated_stays_and_is_contradicted(files):
    pair = files({'order': 'wxyz'})
    pair[1] += '?quaternion=xyzw'
    found = document('replay', *pair)
    assert 'quaternion=xyzw is stated, but not as the ground truth shows' in found['warnings'][0]
    assert found['metrics']['ate_rot_rmse_deg'] > 30
    pair[1] = pair[1].replace('xyzw', 'wxyz')
    assert document('replay', *pair)['warnings'] == []


@pytest.mark.parametrize('written', ['xyzw', 'wxyz'])
@pytest.mark.parametrize('said', ['header', 'columns'])
def test_a_wrong_name_turns_no_file_of_the_other_side(files, tmp_path, written, said):
    pair = files({'order': written})
    wrong = ['qx', 'qy', 'qz', 'qw'] if written == 'wxyz' else ['qw', 'qx', 'qy', 'qz']
    names = ['t', 'x', 'y', 'z', *wrong]
    if said == 'header':
        rows = (tmp_path / 'est.txt').read_text()
        (tmp_path / 'est.txt').write_text(f'# {" ".join(names)}\n{rows}')
    else:
        pair[1] += f'?columns={",".join(names)}'
    found = document('replay', *pair)
    first = found['warnings'][0]
    assert 'quaternions is given, but not as the ground truth shows' in first
    pair[1] = first.partition('to read it so, write ')[2]
    assert document('replay', *pair)['metrics']['ate_rot_rmse_deg'] < 10
    assert not any('gt.txt: read with' in one for one in found['warnings'])


def test_a_rule_does_not_give_way_to_what_hardly_fits(files):
    pair = files()
    pair[1] += '?columns=t,y,x,z,qx,qy,qz,qw'  # a mirrored world
    done = call('replay', *pair)
    assert 'gt.txt: read with quaternion=wxyz' not in done.stdout


@pytest.mark.parametrize('side', [0, 1])
def test_arrays_in_another_order_are_pointed_out(side):
    columns = [(p.stamps_ns, p.positions, p.rotations) for p in (RUN.estimate, TRUTH)]
    assert vio.evaluate(*columns).warnings == ()
    stamps_ns, positions, rotations = columns[side]
    columns[side] = (stamps_ns, positions, rotations[:, ORDERS['wxyz']])
    first = vio.evaluate(*columns).warnings[0]
    assert 'quaternion=xyzw is the order of rotations, but not as the' in first


def test_arrays_in_millimetres_are_pointed_out():
    truth = (TRUTH.stamps_ns, 1000 * TRUTH.positions, TRUTH.rotations)
    found = vio.evaluate((RUN.estimate.stamps_ns, RUN.estimate.positions), truth)
    assert 'positions in mm?' in found.warnings[0]


def straight(poses: Trajectory) -> Trajectory:
    return replace(poses, positions=poses.positions * [1.0, 0.0, 0.0])


def test_what_is_not_settled_is_asked_with_both_specs(tmp_path):
    estimate = write(tmp_path / 'est.csv', straight(RUN.estimate), comma=',')
    truth = write(tmp_path / 'gt.txt', straight(TRUTH))
    pair = ['--estimate', estimate, '--ground-truth', truth]
    for verb in ('replay', 'diagnose'):
        said = complaint(verb, *pair)
        assert 'the order of its quaternions is open' in said
        assert f'{estimate}?quaternion=xyzw or {estimate}?quaternion=wxyz' in said
    # a layout with a rule keeps it
    write(tmp_path / 'est.csv', straight(RUN.estimate))
    assert call('replay', *pair).returncode == 0


def planar(poses: Trajectory, turning: bool = True) -> Trajectory:
    """Return the poses of a car that drives in a circle, or straight on."""
    angles = 0.4 * (poses.stamps_ns - TRUTH.stamps_ns[0]) / 1e9
    x, y = (np.sin(angles), 1 - np.cos(angles)) if turning else (angles, 0 * angles)
    noise = np.random.default_rng(len(poses)).normal(scale=0.01, size=(len(poses), 3))
    return replace(
        poses,
        positions=3 * np.column_stack([x, y, 0 * x]) + noise,
        rotations=rotation.about_z(angles if turning else 0 * angles),
    )


@pytest.mark.parametrize('comma', [' ', ','])
@pytest.mark.parametrize('order', ['xyzw', 'wxyz'])
@pytest.mark.parametrize('side', [0, 1])
def test_the_order_of_what_turns_in_a_plane_is_settled_too(tmp_path, side, order, comma):
    names = ['est.txt', 'gt.txt']
    for name, poses in zip(names, (RUN.estimate, TRUTH), strict=True):
        how = {'order': order, 'comma': comma} if name == names[side] else {}
        write(tmp_path / name, planar(poses), **how)
    pair = ['--estimate', tmp_path / names[0], '--ground-truth', tmp_path / names[1]]
    found = document('replay', *pair)
    assert found['metrics']['ate_rot_rmse_deg'] < 2
    open_side = (order, comma) != ('xyzw', ' ')
    said = [w for w in found['warnings'] if f'{names[side]}: read with quaternion={order}' in w]
    assert len(said) == open_side


def swaying(poses: Trajectory) -> Trajectory:
    """Return the poses of what flies in a circle and hardly turns."""
    sway = rotation.about_z(0.002 * np.sin(np.arange(len(poses))))
    return replace(planar(poses), rotations=sway)


def test_a_rule_that_makes_no_sense_is_doubted_where_nothing_turns(tmp_path):
    write(tmp_path / 'est.txt', swaying(RUN.estimate), order='wxyz')
    write(tmp_path / 'gt.txt', swaying(TRUTH))
    pair = ['--estimate', tmp_path / 'est.txt', '--ground-truth', tmp_path / 'gt.txt']
    assert 'the rule of its layout, orientations are' in document('replay', *pair)['warnings'][0]
    write(tmp_path / 'est.txt', swaying(RUN.estimate))
    assert document('replay', *pair)['warnings'] == []


def test_a_truth_of_positions_needs_no_order(tmp_path):
    estimate = write(tmp_path / 'est.csv', RUN.estimate, comma=',')
    sources = read_sources([str(estimate)])
    truth = Source(
        'truth', 'arrays', (), Poses(TRUTH.stamps_ns - TRUTH.stamps_ns[0], TRUTH.positions)
    )
    one, _ = settled(sources[0], truth)
    assert 'which nothing here confirms' in one.warnings[0]
    assert one.readings == ()
    with pytest.raises(ReadError, match='order of its quaternions is open'):
        alone(sources[0])
    (truth,) = read_sources([str(write(tmp_path / 'gt.txt', TRUTH))])
    assert alone(truth).readings == ()


def readings_of(poses: Poses, written: str) -> tuple[Reading, ...]:
    """Return both ways to read quaternions that were written in one order."""
    row = poses.rotations[:, ORDERS[written]]
    return (
        Reading('quaternion=xyzw', replace(poses, rotations=row)),
        Reading('quaternion=wxyz', replace(poses, rotations=np.roll(row, -1, axis=1))),
    )


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    written=st.sampled_from(list(ORDERS)),
    world=st.tuples(*[st.floats(-3, 3)] * 3),
    sensor=st.tuples(*[st.floats(-3, 3)] * 3),
    scale=st.floats(0.2, 90.0),
)
def test_worlds_sensors_and_scales_do_not_matter_to_the_order(written, world, sensor, scale):
    to_world, of_sensor = (rotation.from_rotation_vector(np.array(v)) for v in (world, sensor))
    moved = replace(
        RUN.estimate,
        positions=scale * rotation.rotate(to_world, RUN.estimate.positions) + 5.0,
        rotations=rotation.multiply(
            to_world, rotation.multiply(RUN.estimate.rotations, of_sensor)
        ),
    )
    ways = readings_of(moved, written)
    truth = Source('truth', 'arrays', (), RUN.ground_truth)
    try:
        one, _ = settled(Source('est.csv', 'tum', (), ways[0].poses, readings=ways), truth)
    except ReadError as error:
        assert 'is open' in str(error) or 'positions in' in str(error)  # noqa: PT017
    else:
        assert f'read with quaternion={written}' in one.warnings[0]
        assert np.abs(one.poses.rotations - moved.rotations).max() < 1e-12


# -- the unit of stamps


@pytest.mark.parametrize('form', ['{:.0f}', '{:.1f}', '{:.6f}'])
@pytest.mark.parametrize(('name', 'unit'), [('ms', 1e3), ('us', 1e6), ('ns', 1e9)])
@pytest.mark.parametrize('side', [0, 1])
def test_the_unit_of_relative_stamps_is_settled(files, expected, name, unit, form, side):
    if name == 'ms' and form == '{:.0f}':
        form = '{:.2f}'  # whole milliseconds would move the poses
    how = [None, None]
    how[side] = {'unit': unit, 'stamps': form}
    found = document('replay', *files(*how))
    assert found['metrics']['ate_trans_rmse_m'] == pytest.approx(
        expected['ate_trans_rmse_m'], rel=1e-4
    )
    path = ('est.txt', 'gt.txt')[side]
    (said,) = (w for w in found['warnings'] if f'{path}: stamps are read as {name}, as the' in w)
    assert f'{path}?stamps={name}' in said


def test_a_diagnosis_settles_the_unit_of_stamps_too(files):
    first = call('diagnose', *files({'unit': 1e6, 'stamps': '{:.0f}'})).stdout.splitlines()[0]
    assert 'stamps are read as us' in first


def test_a_stated_unit_of_stamps_is_kept(files):
    pair = files({'unit': 1e3})
    pair[1] += '?stamps=s'
    assert document('replay', *pair)['association']['pairs'] == 1
    pair[1] = pair[1].replace('stamps=s', 'stamps=ms')
    assert document('replay', *pair)['warnings'] == []


def test_a_unit_of_stamps_in_stated_columns_is_kept(files):
    pair = files()
    pair[1] += '?columns=t_ms,x,y,z,qx,qy,qz,qw'
    found = document('replay', *pair)
    assert found['association']['pairs'] < 5
    assert not any('stamps are read as' in one for one in found['warnings'])


def test_another_unit_on_another_clock_is_asked(tmp_path, files):
    pair = files({'unit': 1e3})
    late = replace(TRUTH, stamps_ns=TRUTH.stamps_ns + 1_700_000_000 * 10**9)
    write(tmp_path / 'gt.txt', late)
    assert 'est.txt?stamps=ms' in complaint('replay', *pair)


def test_milliseconds_on_both_sides_are_asked(files):
    sparse = {'unit': 1e6, 'stamps': '{:.0f}'}
    said = complaint('replay', *files(sparse, sparse))
    assert 'its stamps are hardly in seconds' in said
    assert 'gt.txt?stamps=s to leave' in said
    assert 'gt.txt?stamps=us' in said


def test_a_short_estimate_of_a_long_truth_is_in_seconds(files, expected):
    long = document('replay', *files(), '--start-s', '5', '--end-s', '7')
    assert not [w for w in long['warnings'] if 'stamps' in w]


@pytest.mark.parametrize('first', [0, 1])
@pytest.mark.parametrize('verb', ['replay', 'diagnose'])
@pytest.mark.parametrize('epoch', [0, 1_700_000_000])
def test_frame_numbers_are_named(tmp_path, files, verb, first, epoch):
    pair = files()
    rows = (tmp_path / 'est.txt').read_text().splitlines()
    lines = (f'{k} {row.split(" ", 1)[1]}\n' for k, row in enumerate(rows, first))
    (tmp_path / 'est.txt').write_text(''.join(lines))
    write(tmp_path / 'gt.txt', replace(TRUTH, stamps_ns=TRUTH.stamps_ns + epoch * 10**9))
    said = complaint(verb, *pair)
    assert f'its stamps {first}, {first + 1}, {first + 2} ... look like frame numbers' in said
    assert '--times' in said


@pytest.mark.parametrize('epoch', [0, 1_700_000_000])
def test_numbers_of_keyframes_are_named(tmp_path, files, epoch):
    pair = files()
    rows = (tmp_path / 'est.txt').read_text().splitlines()
    numbers = np.flatnonzero(np.random.default_rng(1).random(len(rows)) < 0.25)
    lines = (f'{k} {rows[k].split(" ", 1)[1]}\n' for k in numbers)
    (tmp_path / 'est.txt').write_text(''.join(lines))
    write(tmp_path / 'gt.txt', replace(TRUTH, stamps_ns=TRUTH.stamps_ns + epoch * 10**9))
    assert 'look like frame numbers' in complaint('replay', *pair)


def test_a_part_of_a_run_in_milliseconds_is_recognised(tmp_path, files):
    pair = files()
    write(tmp_path / 'est.txt', RUN.estimate[150:250], unit=1e3)
    assert 'stamps are read as ms' in document('replay', *pair)['warnings'][0]


def test_a_truth_in_whole_seconds_of_an_estimate_that_is_wrong_is_no_count(tmp_path, files):
    pair = files()
    wrong = replace(RUN.estimate, positions=RUN.estimate.positions[::-1].copy() ** 2)
    write(tmp_path / 'est.txt', wrong)
    write(tmp_path / 'gt.txt', RUN.ground_truth[::200], stamps='{:.0f}')
    assert not [w for w in document('replay', *pair)['warnings'] if 'frame' in w]


def test_frame_numbers_on_both_sides_are_said(tmp_path):
    for name, poses in (('est.txt', RUN.ground_truth), ('gt.txt', RUN.ground_truth)):
        counted = replace(
            poses, stamps_ns=TRUTH.stamps_ns[0] + np.arange(len(poses), dtype=np.int64) * 10**9
        )
        write(tmp_path / name, counted[:500], stamps='{:.0f}')
    pair = ['--estimate', tmp_path / 'est.txt', '--ground-truth', tmp_path / 'gt.txt']
    assert 'frame numbers' in document('replay', *pair)['warnings'][0]


def test_a_truth_of_one_pose_a_second_is_no_count(tmp_path, files):
    pair = files()
    write(tmp_path / 'gt.txt', RUN.ground_truth[::200], stamps='{:.0f}')
    assert not [w for w in document('replay', *pair)['warnings'] if 'stamps' in w]


# -- the unit of positions


@pytest.mark.parametrize(('unit', 'scale'), [('mm', 1000.0), ('cm', 100.0)])
@pytest.mark.parametrize('side', [0, 1])
def test_positions_in_another_unit_are_refused_with_what_to_write(
    files, expected, unit, scale, side
):
    how = [None, None]
    how[side] = {'scale': scale}
    pair = files(*how)
    for verb in ('replay', 'diagnose'):
        said = complaint(verb, *pair)
        assert f'positions in {unit}?' in said
        assert f'{pair[2 * side + 1]}?unit={unit}' in said
    pair[2 * side + 1] += f'?unit={unit}'
    found = document('replay', *pair)
    assert found['metrics']['ate_trans_rmse_m'] == pytest.approx(
        expected['ate_trans_rmse_m'], rel=1e-6
    )
    assert found['warnings'] == []


def test_a_scale_that_is_fitted_or_stated_is_only_said(files):
    pair = files({'scale': 1000.0})
    found = document('replay', *pair, '--alignment', 'sim3')
    assert 'positions in mm?' in found['warnings'][0]
    pair[1] += '?unit=m'
    assert 'positions in mm?' in document('replay', *pair)['warnings'][0]


def test_millimetres_on_both_sides_are_said(files):
    pair = files({'scale': 1000.0}, {'scale': 1000.0})
    assert (
        'positions in mm? Then append ?unit=mm to both' in document('replay', *pair)['warnings'][0]
    )
    pair[1], pair[3] = f'{pair[1]}?unit=mm', f'{pair[3]}?unit=mm'
    assert not [w for w in document('replay', *pair)['warnings'] if 'mm' in w]


@pytest.mark.parametrize('scale', [0.3, 7.0, 95.0, 1 / 90, 0.02, 1 / 900, 800.0])
def test_the_scale_of_a_monocular_estimate_is_no_unit(files, scale):
    found = document('replay', *files({'scale': scale}))
    assert not [w for w in found['warnings'] if 'positions in' in w]


def test_an_estimate_of_another_path_has_no_unit(tmp_path, files):
    pair = files()
    other = simulate(duration_s=20.0, seed=9).estimate
    noise = np.random.default_rng(1).normal(size=other.positions.shape)
    wild = replace(other, stamps_ns=RUN.estimate.stamps_ns[: len(other)], positions=900 * noise)
    write(tmp_path / 'est.txt', wild)
    assert call('replay', *pair).returncode == 0
