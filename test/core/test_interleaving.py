"""Several trajectories in one stream are recognised, and nothing else is taken for them."""

from dataclasses import replace
import math

import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interleaving import copies, interleaving
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.simulation.faults import FAULTS, inject
from vio_eval_ros.simulation.simulated_run import simulate

START_NS = 1_700_000_000_000_000_000
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
#: sizes of faults that are clearly seen, by unit
SIZES = {'s': 0.3, 'ppm': 5e3, 'factor': 1.5, 'percent': 10.0, 'deg': 30.0, 'm': 1.0}
SIZES |= {'share': 0.1, 'places': 1.0}


def published(rate_hz, seed=0, duration_s=30.0, phase_s=0.0, offset_m=0.0, noise_m=0.0):
    """Return poses on a random smooth curve of some metres, as one publisher sends them."""
    source = np.random.default_rng(seed)
    seconds = np.arange(phase_s, duration_s, 1 / rate_hz)
    rates, phases = source.uniform(0.2, 0.9, (2, 3)), source.uniform(0, 2 * math.pi, (2, 3))
    waves = np.sin(seconds[:, None, None] * rates + phases)
    positions = waves.sum(axis=1) * [2.0, 2.0, 0.7] + [offset_m, 0, 0]
    positions += source.normal(0, 1, positions.shape) * noise_m
    vectors = np.stack([0.1 * np.sin(seconds), 0.1 * np.cos(seconds), 2 * waves[:, 0, 0]], axis=1)
    stamps_ns = START_NS + np.round(seconds * 1e9).astype(np.int64)
    return Poses(stamps_ns, positions, rotation.from_rotation_vector(vectors))


def at_rest(rate_hz, phase_s=0.03):
    poses = published(rate_hz, phase_s=phase_s)
    rest = np.arange(len(poses))[:, None] * [1e-4, 0, 0]
    return replace(poses, positions=rest, rotations=np.tile(IDENTITY, (len(poses), 1)))


def turned(poses, degrees):
    turn = rotation.about_z(np.full(len(poses), math.radians(degrees)))
    return replace(poses, rotations=rotation.multiply(poses.rotations, turn))


def mixed(*parts):
    """Return the poses of several publishers as they arrive: in the order of their stamps."""
    joined = Poses.concatenate(parts)
    return joined[np.argsort(joined.stamps_ns, kind='stable')]


TWO = {
    'turn by turn': (published(10), published(10, seed=9, phase_s=0.05)),
    'one of them at rest': (published(10), at_rest(10, phase_s=0.05)),
    'at equal stamps': (published(10), published(10, seed=9)),
    'in no order': (published(20), published(13, seed=9, phase_s=0.01)),
    'one of them rarely': (published(20), published(3, seed=9, phase_s=0.03)),
    'one in twenty': (published(20, 0, 60), published(1, 0, 60, phase_s=0.03, offset_m=3)),
    'one at rest and rarely': (published(200), at_rest(20)),
    'side by side': (published(10), published(10, phase_s=0.05, offset_m=0.2)),
    'side by side and rarely': (published(20), published(3, phase_s=0.03, offset_m=0.3)),
    'noisy': (published(10, noise_m=0.1), published(10, 3, phase_s=0.02, noise_m=0.1, offset_m=3)),
    'for a while': (published(20, 0, 100), published(20, 9, 20, phase_s=0.01)),
}


@pytest.mark.parametrize('parts', TWO.values(), ids=list(TWO))
def test_two_publishers_are_recognised_by_their_motion(parts):
    found = interleaving(mixed(*parts))
    assert found.count == 2
    assert found.unit == 'm'
    assert found.switches >= 20
    assert 'two publishers' in str(found)
    first_ns = max(part.stamps_ns[0] for part in parts)
    last_ns = min(part.stamps_ns[-1] for part in parts)
    # in windows of poses, which have a few more at either side
    assert first_ns - 7e9 < found.first_ns < found.last_ns < last_ns + 7e9


def test_how_far_apart_two_publishers_are_is_said():
    found = interleaving(mixed(*TWO['side by side']))
    assert found.apart == pytest.approx(0.2, rel=0.1)
    assert str(found).startswith('poses of two trajectories, 0.199 m apart, take turns (')


@pytest.mark.parametrize('rate_hz', [3, 10, 20])
def test_two_orientations_of_one_position_are_recognised(rate_hz):
    found = interleaving(mixed(published(20), turned(published(rate_hz, phase_s=0.02), 60)))
    assert (found.count, found.unit) == (2, 'rad')
    assert math.degrees(found.apart) == pytest.approx(60, rel=0.1)
    assert 'deg apart' in str(found)


def test_three_publishers_are_recognised():
    parts = [published(10, seed, phase_s=0.03 * k) for k, seed in enumerate((0, 9, 19))]
    found = interleaving(mixed(*parts))
    assert found.count == 3
    assert 'three publishers' in str(found)


@pytest.mark.parametrize('offset_s', [37.0, -3600.0, 1.7e9])
def test_two_clocks_are_recognised_by_stamps_that_go_to_and_fro(offset_s):
    one, other = published(10), published(10, phase_s=0.05)
    order = np.argsort(np.concatenate([one.stamps_ns, other.stamps_ns]), kind='stable')
    other = replace(other, stamps_ns=other.stamps_ns + round(offset_s * 1e9))
    found = interleaving(Poses.concatenate([one, other])[order])
    assert (found.count, found.unit) == (2, 's')
    assert found.apart == pytest.approx(abs(offset_s), abs=0.1)
    assert 'poses of two clocks' in str(found)


def test_a_publisher_that_sends_twice_is_one():
    poses = published(20)
    twice = poses[np.repeat(np.arange(len(poses)), 2)]
    assert interleaving(twice) is None
    late_ns = np.tile([0, 1_000_000], len(poses))
    assert interleaving(replace(twice, stamps_ns=twice.stamps_ns + late_ns)) is None
    as_new_ns = START_NS + 50_000_000 * np.arange(len(twice))
    assert interleaving(replace(twice, stamps_ns=as_new_ns)) is None


def test_copies_are_told_from_poses_that_are_held():
    poses = published(20)
    twice = poses[np.repeat(np.arange(len(poses)), 2)]
    late_ns = np.tile([0, 1_000_000], len(poses))
    again = copies(replace(twice, stamps_ns=twice.stamps_ns + late_ns))
    assert np.array_equal(again, late_ns > 0)
    assert not copies(twice).any()
    assert not copies(poses).any()
    held = np.arange(len(poses)) // 5 * 5
    assert not copies(replace(poses[held], stamps_ns=poses.stamps_ns)).any()
    assert not copies(poses[np.zeros(len(poses), int)]).any()
    assert not copies(replace(poses[held * 0], stamps_ns=poses.stamps_ns)).any()
    assert not copies(poses[:1]).any()
    assert not copies(poses[:0]).any()


def test_two_runs_one_after_the_other_do_not_take_turns():
    one, other = published(10), published(10, seed=9)
    assert interleaving(Poses.concatenate([one, other])) is None
    later = replace(other, stamps_ns=other.stamps_ns + 3_600_000_000_000)
    assert interleaving(Poses.concatenate([later, one])) is None


@pytest.mark.slow
@pytest.mark.parametrize('rate_hz', [5, 20, 100])
@pytest.mark.parametrize('axes', [1, 2, 3])
def test_noise_and_outliers_are_not_a_second_trajectory(rate_hz, axes):
    poses, source = published(rate_hz, duration_s=60), np.random.default_rng(rate_hz + axes)
    on_axes = np.arange(3) < axes
    for size in (0.02, 0.1, 0.3, 1.0):
        for noise in (
            source.normal(0, size, (len(poses), 3)),
            source.uniform(-2 * size, 2 * size, (len(poses), 3)),
            source.standard_t(2, (len(poses), 3)) * size,
        ):
            noisy = replace(poses, positions=poses.positions + noise * on_axes)
            assert interleaving(noisy) is None
        for share in (0.01, 0.05, 0.1, 0.3):
            is_outlier = source.random(len(poses)) < share
            off = source.normal(0, 3 * size, (len(poses), 3)) * on_axes * is_outlier[:, None]
            assert interleaving(replace(poses, positions=poses.positions + off)) is None


@pytest.mark.slow
@pytest.mark.parametrize('rate_hz', [5, 20, 100])
def test_jumps_gaps_and_oscillations_are_not_a_second_trajectory(rate_hz):
    poses, source = published(rate_hz, duration_s=60), np.random.default_rng(rate_hz)
    seconds = (poses.stamps_ns - START_NS) / 1e9
    for count in (2, 10, 30):
        part = np.sort(source.integers(0, count, len(poses)))
        off = source.normal(0, 1, (count, 3))[part]
        assert interleaving(replace(poses, positions=poses.positions + off)) is None
    for share in (0.1, 0.5, 0.9):
        assert interleaving(poses[source.random(len(poses)) > share]) is None
    for rate, size in ((0.5, 0.3), (1.0, 0.1), (2.0, 0.1), (3.0, 0.05)):
        sway = size * np.sin(2 * math.pi * rate * seconds)[:, None] * [0, 0.5, 1]
        assert interleaving(replace(poses, positions=poses.positions + sway)) is None
        corrected = size * ((rate * seconds) % 1)[:, None] * [1, 0.5, 0]
        assert interleaving(replace(poses, positions=poses.positions + corrected)) is None
    held = np.arange(len(poses)) // 5 * 5
    assert interleaving(replace(poses[held], stamps_ns=poses.stamps_ns)) is None
    for period_s, radius in ((2, 0.1), (5, 1), (8, 5), (20, 5)):
        angle = 2 * math.pi * seconds / period_s
        circle = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        round_and_round = replace(poses, positions=circle, rotations=rotation.about_z(angle))
        assert interleaving(round_and_round) is None


@pytest.mark.slow
@pytest.mark.parametrize('name', FAULTS)
def test_no_fault_of_a_simulated_run_is_a_second_publisher(name):
    for seed in range(3):
        run = simulate(30, seed)
        for times in (0.3, 1.0, 3.0):
            sizes = [
                SIZES[unit] * (times if unit != 'places' else 1) for unit in FAULTS[name].units
            ]
            faulty = inject(run, name, tuple(sizes), np.random.default_rng(seed))
            assert interleaving(faulty.ground_truth) is None
            for every in (1, 4, 20):  # keyframes as well
                assert interleaving(faulty.estimate[::every]) is None


def test_what_is_no_pose_is_left_out():
    poses = mixed(*TWO['turn by turn'])
    positions = poses.positions.copy()
    positions[::7] = math.nan
    assert interleaving(replace(poses, positions=positions)).count == 2
    assert interleaving(replace(poses, positions=np.full_like(positions, math.inf))) is None
    assert interleaving(replace(poses, stamps_ns=0 * poses.stamps_ns, zero_is_unset=True)) is None
    assert interleaving(replace(poses, rotations=0 * poses.rotations)).count == 2
    assert interleaving(replace(poses, rotations=None)).count == 2
    assert interleaving(poses[:0]) is None
    assert interleaving(poses[:5]) is None


@pytest.mark.slow
def test_a_long_stream_is_looked_at_in_parts():
    found = interleaving(mixed(published(500, 0, 600), published(500, 9, 600, phase_s=1e-3)))
    assert found.count == 2
    assert found.last_ns - found.first_ns > 500e9
