"""What is saved of a run, and when it is believed."""

from dataclasses import replace
import os
import shutil
import time

import numpy as np
import pytest

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import WriteError
from vio_eval_ros.live.checkpoint import Checkpoint, MOST_AGE_S, Unusable

OPTIONS = {'options': {'alignment': 'se3', 'end_s': float('inf')}}
TYPES = {'estimate': 'nav_msgs/msg/Odometry', 'ground_truth': 'geometry_msgs/msg/PointStamped'}
COLUMNS = ('stamps_ns', 'positions', 'rotations', 'covariances')


def poses(first, count, **columns):
    stamps_ns = np.arange(first, first + count, dtype=np.int64) * 50_000_000
    return Poses(stamps_ns, np.random.default_rng(first).normal(size=(count, 3)), **columns)


@pytest.fixture
def saved(tmp_path):
    """Return a folder with three blocks of two streams."""
    checkpoint = Checkpoint(tmp_path / 'checkpoint', OPTIONS)
    for k in range(3):
        quaternions = np.full((10, 4), 0.5)
        covariances = np.full((10, 2, 3, 3), np.nan)
        estimate = poses(10 * k, 10, rotations=quaternions, covariances=covariances)
        checkpoint.add('estimate', estimate[:4])
        checkpoint.add('estimate', estimate[4:])
        if k != 1:
            checkpoint.add('ground_truth', replace(poses(100 * k, 7), origin=(47.0, 8.0, 400.0)))
        checkpoint.save(2, True, TYPES)
    checkpoint.save(2, True, TYPES)  # nothing has come
    return checkpoint.folder


def assert_same(found, expected):
    for name in COLUMNS:
        one, other = getattr(found, name), getattr(expected, name)
        assert (one is None) == (other is None)
        if one is not None:
            assert one.dtype == other.dtype
            np.testing.assert_array_equal(one, other)


def test_what_was_saved_comes_back_to_the_last_bit(saved):
    assert len(list(saved.iterdir())) == 3
    found = Checkpoint(saved, OPTIONS).resume()
    assert (found.run, found.gates_failed) == (2, True)
    assert {name: stream.msgtype for name, stream in found.streams.items()} == TYPES
    assert_same(
        found.streams['estimate'].poses,
        Poses.concatenate(
            [
                poses(
                    10 * k,
                    10,
                    rotations=np.full((10, 4), 0.5),
                    covariances=np.full((10, 2, 3, 3), np.nan),
                )
                for k in range(3)
            ]
        ),
    )
    truth = found.streams['ground_truth'].poses
    assert_same(truth, Poses.concatenate([poses(0, 7), poses(200, 7)]))
    assert truth.origin == (47.0, 8.0, 400.0)


def test_who_resumes_goes_on_with_the_next_block(saved):
    again = Checkpoint(saved, OPTIONS)
    again.resume()
    again.add('estimate', poses(30, 5))
    again.save(2, True, TYPES)
    assert sorted(path.name for path in saved.iterdir())[-1] == '000004.npz'
    assert len(Checkpoint(saved, OPTIONS).resume().streams['estimate'].poses) == 35


def test_nothing_is_left_of_a_run_that_has_ended(saved):
    ended = Checkpoint(saved, OPTIONS)
    ended.clear()
    assert Checkpoint(saved, OPTIONS).resume() is None
    ended.remove()
    assert not saved.exists()


def damage_bytes(folder):
    path = folder / '000002.npz'
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x40
    path.write_bytes(content)


def cut(folder):
    path = folder / '000003.npz'
    path.write_bytes(path.read_bytes()[:-200])


def empty(folder):
    (folder / '000001.npz').write_bytes(b'')


def rewrite(folder, change):
    path = folder / '000002.npz'
    with np.load(path) as found:
        columns = {name: found[name] for name in found.files}
    np.savez(path, **(columns | change(columns)))


CHANGES = {
    'bytes': damage_bytes,
    'cut': cut,
    'empty': empty,
    'hole': lambda folder: (folder / '000002.npz').unlink(),
    'twice': lambda folder: shutil.copy(folder / '000001.npz', folder / '000002.npz'),
    'shape': lambda f: rewrite(f, lambda c: {'0.positions': c['0.positions'][:, :2]}),
    'rows': lambda f: rewrite(f, lambda c: {'0.rotations': c['0.rotations'][1:]}),
    'type': lambda f: rewrite(f, lambda c: {'0.stamps_ns': c['0.stamps_ns'].astype(float)}),
    'about': lambda f: rewrite(f, lambda c: {'about': np.array('{}')}),
    'no json': lambda f: rewrite(f, lambda c: {'about': np.array('[')}),
    'version': lambda f: rewrite(
        f, lambda c: {'about': np.array(str(c['about']).replace('checkpoint/1', 'checkpoint/9'))}
    ),
    'pickle': lambda f: rewrite(f, lambda c: {'about': np.array([object()], dtype=object)}),
}


@pytest.mark.parametrize('change', CHANGES.values(), ids=CHANGES)
def test_what_is_damaged_is_set_aside_and_never_believed(saved, change):
    change(saved)
    with pytest.raises(
        Unusable, match=r'checkpoint: .*; it is set aside as checkpoint_set_aside_1'
    ):
        Checkpoint(saved, OPTIONS).resume()
    assert list(saved.iterdir()) == []
    assert list((saved.parent / 'checkpoint_set_aside_1').iterdir())
    assert Checkpoint(saved, OPTIONS).resume() is None


def test_other_options_and_other_times_are_other_runs(saved):
    other = {'options': {'alignment': 'sim3', 'end_s': float('inf')}}
    with pytest.raises(Unusable, match='written with other options'):
        Checkpoint(saved, other).resume()
    aside = saved.parent / 'checkpoint_set_aside_1'
    shutil.rmtree(saved)
    shutil.copytree(aside, saved)
    old_s = time.time() - MOST_AGE_S - 1
    for path in saved.iterdir():
        os.utime(path, (old_s, old_s))
    with pytest.raises(Unusable, match=r'it is 60\d s old.*set aside as checkpoint_set_aside_2'):
        Checkpoint(saved, OPTIONS).resume()


def test_what_was_left_half_written_is_removed(saved):
    half = saved / '.000004.npz.abc123'
    half.write_bytes(b'PK')
    found = Checkpoint(saved, OPTIONS).resume()
    assert not half.exists()
    assert len(found.streams['estimate'].poses) == 30


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / 'checkpoint').write_text('')
    with pytest.raises(WriteError):
        Checkpoint(tmp_path / 'checkpoint', OPTIONS)
