"""The simulated run is a credible flight, wrong by a known amount, and the bundled one is it."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.imu.simulated_noise import EUROC, Noise, NoiseModel
from vio_eval_ros.simulation import at_rest, Drift, simulate, SimulatedRun

BUNDLED = Path(__file__).resolve().parents[2] / 'demo' / 'simulated_flight'
NO_DRIFT = Drift(0, 0, 1, 0, 0)
# The last bits of sines and cosines differ between processors and numpy versions.
SAME = {'rtol': 0, 'atol': 1e-12}
NOISELESS = NoiseModel(Noise(0, 0), Noise(0, 0))


@pytest.fixture(scope='module')
def run() -> SimulatedRun:
    """Return the run of the demo."""
    return simulate()


def umeyama(estimate: np.ndarray, truth: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return scale, rotation matrix and residuals [m] of the best similarity transform."""
    e, g = estimate - estimate.mean(axis=0), truth - truth.mean(axis=0)
    u, d, vt = np.linalg.svd(g.T @ e)
    sign = np.array([1, 1, np.linalg.det(u @ vt)])
    turn, scale = (u * sign) @ vt, d @ sign / np.sum(e**2)
    return scale, turn, np.linalg.norm(scale * e @ turn.T - g, axis=1)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def truth_at_estimate(run: SimulatedRun) -> Trajectory:
    truth, stamps = run.ground_truth, run.estimate.stamps_ns
    differences = np.abs(truth.stamps_ns - stamps[:, None])
    assert differences.min(axis=1).max() == 1_300_000  # the camera fires between truth samples
    return truth[differences.argmin(axis=1)]


def read(path: Path) -> dict[str, Trajectory]:
    """Return the poses of the two topics, decoded by rosbags alone."""
    columns: dict[str, list[tuple]] = {'/ground_truth/pose': [], '/vio/odometry': []}
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            uncertain = connection.topic == '/vio/odometry'
            pose = message.pose.pose if uncertain else message.pose
            covariance = message.pose.covariance.reshape(6, 6) if uncertain else np.zeros((6, 6))
            stamp, p, q = message.header.stamp, pose.position, pose.orientation
            columns[connection.topic].append(
                (
                    stamp.sec * 10**9 + stamp.nanosec,
                    (p.x, p.y, p.z),
                    (q.x, q.y, q.z, q.w),
                    (covariance[:3, :3], covariance[3:, 3:]),
                )
            )
    return {
        topic: Trajectory(*map(np.array, zip(*rows, strict=True)))
        for topic, rows in columns.items()
    }


def assert_same(recorded: Trajectory, simulated: Trajectory) -> None:
    np.testing.assert_array_equal(recorded.stamps_ns, simulated.stamps_ns)
    np.testing.assert_allclose(recorded.positions, simulated.positions, **SAME)
    np.testing.assert_allclose(recorded.rotations, simulated.rotations, **SAME)
    if simulated.covariances is not None:
        np.testing.assert_allclose(recorded.covariances, simulated.covariances, **SAME)


def test_the_same_seed_gives_the_same_run(run):
    again = simulate()
    np.testing.assert_array_equal(again.ground_truth.positions, run.ground_truth.positions)
    np.testing.assert_array_equal(again.estimate.rotations, run.estimate.rotations)


@pytest.mark.slow
def test_another_seed_gives_another_flight_and_another_drift(run):
    other = simulate(seed=8)
    assert np.abs(other.ground_truth.positions - run.ground_truth.positions).max() > 0.1
    path = truth_at_estimate(run).positions, truth_at_estimate(other).positions
    drifts = [umeyama(r.estimate.positions, p)[2] for r, p in zip((run, other), path, strict=True)]
    assert rms(drifts[0] - drifts[1]) > 0.01


def test_a_shorter_run_flies_the_same_path(run):
    short = simulate(duration_s=10)
    assert (len(short.ground_truth), len(short.estimate)) == (2000, 200)
    np.testing.assert_allclose(
        short.ground_truth.positions, run.ground_truth.positions[:2000], **SAME
    )


def test_stamps_are_those_of_euroc(run):
    assert run.ground_truth.stamps_ns.dtype == run.estimate.stamps_ns.dtype == np.int64
    assert set(np.diff(run.ground_truth.stamps_ns)) == {5_000_000}
    assert set(np.diff(run.estimate.stamps_ns)) == {50_000_000}
    assert (len(run.ground_truth), len(run.estimate)) == (12_000, 1_200)


@pytest.mark.parametrize('seed', range(10))
def test_the_flight_is_one_that_a_multirotor_can_fly(seed):
    truth = simulate(seed=seed).ground_truth
    velocities = np.diff(truth.positions, axis=0) * 200
    speeds = np.linalg.norm(velocities, axis=1)
    accelerations = np.diff(velocities, axis=0) * 200
    turn_rates = rotation.angle_between(truth.rotations[1:], truth.rotations[:-1]) * 200
    assert np.linalg.norm(velocities[:, :2], axis=1).min() > 0.3  # a heading at all times
    assert 1 < speeds.mean() < speeds.max() < 2.5
    assert np.linalg.norm(accelerations, axis=1).max() < 3
    assert np.rad2deg(turn_rates).max() < 240
    assert np.abs(truth.positions[:, :2]).max() < 3
    assert 0.4 < truth.positions[:, 2].min() < truth.positions[:, 2].max() < 2.3


def test_the_body_points_along_its_path_and_thrusts_against_gravity(run):
    truth = run.ground_truth
    velocities = (truth.positions[2:] - truth.positions[:-2]) * 100
    thrust = np.diff(truth.positions, n=2, axis=0) * 200**2 + np.array([0, 0, 9.81])
    x, y, z = (rotation.rotate(truth.rotations[1:-1], axis) for axis in np.eye(3))
    np.testing.assert_allclose(
        z, thrust / np.linalg.norm(thrust, axis=1, keepdims=True), atol=1e-4
    )  # differences for derivatives
    np.testing.assert_allclose(np.sum(velocities * y, axis=1), 0, atol=1e-3)
    assert np.sum(velocities * x, axis=1).min() > 0


def test_rotations_are_unit_quaternions(run):
    for trajectory in (run.ground_truth, run.estimate):
        np.testing.assert_allclose(np.linalg.norm(trajectory.rotations, axis=1), 1, atol=1e-14)


@pytest.mark.slow
def test_the_estimate_starts_upright_at_its_own_origin(run):
    assert np.linalg.norm(run.estimate.positions[0]) < 0.02
    forward = rotation.rotate(run.estimate.rotations[0], np.array([1.0, 0, 0]))
    assert abs(np.arctan2(forward[1], forward[0])) < 0.02
    true_up, up = (
        rotation.rotate(rotation.conjugate(t.rotations), np.array([0, 0, 1.0]))
        for t in (truth_at_estimate(run), run.estimate)
    )
    tilt_errors = np.linalg.norm(up - true_up, axis=1)
    assert rms(tilt_errors[:300]) == pytest.approx(rms(tilt_errors[-300:]), rel=0.2)


def test_without_drift_the_estimate_is_the_truth_seen_from_another_origin():
    run = simulate(drift=NO_DRIFT)
    truth = truth_at_estimate(run)
    scale, turn, residuals = umeyama(run.estimate.positions, truth.positions)
    assert rms(residuals) < 1.3e-3 * 2.5  # the path flown between exposure and truth sample
    assert scale == pytest.approx(1, abs=1e-4)
    assert turn[2, 2] == pytest.approx(1, abs=1e-9)
    turned = rotation.multiply(rotation.from_matrix(turn), run.estimate.rotations)
    assert rotation.angle_between(turned, truth.rotations).max() < 1.3e-3 * 4


def test_a_known_scale_error_is_found_again():
    run = simulate(drift=Drift(0, 0, 0.8, 0, 0))
    scale, _, residuals = umeyama(run.estimate.positions, truth_at_estimate(run).positions)
    assert scale == pytest.approx(1 / 0.8, abs=1e-4)
    assert rms(residuals) < 1.3e-3 * 2.5


def test_the_demo_is_as_accurate_as_a_good_stereo_vio(run):
    truth = truth_at_estimate(run)
    scale, turn, _ = umeyama(run.estimate.positions, truth.positions)
    _, _, residuals = umeyama(run.estimate.positions * scale, truth.positions)
    turned = rotation.multiply(rotation.from_matrix(turn), run.estimate.rotations)
    angles = np.rad2deg(rotation.angle_between(turned, truth.rotations))
    assert 0.06 < rms(residuals) < 0.09
    assert 1 < rms(angles) < 2
    assert scale == pytest.approx(1.01, abs=0.003)


@pytest.mark.slow
def test_the_bundled_recording_is_the_simulated_run(run):
    recorded = read(BUNDLED)
    assert_same(recorded['/ground_truth/pose'], run.ground_truth)
    assert_same(recorded['/vio/odometry'], run.estimate)


def test_the_bundled_recording_is_small():
    assert sum(file.stat().st_size for file in BUNDLED.iterdir()) < 1_500_000


def integrated(truth: Trajectory, samples: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rotations by strapdown integration from the first true pose."""
    start = truth.positions[:4]
    velocity = np.array([-11, 18, -9, 2]) @ start / (6 * dt)  # the derivative of a cubic
    position, turn, gravity = start[0], truth.rotations[0], np.array([0, 0, 9.81])
    positions, rotations = [position], [turn]
    for now, then in pairwise(samples):
        step = (now[:3] + then[:3]) / 2 * dt
        turned = rotation.multiply(turn, rotation.from_rotation_vector(step))
        before = rotation.rotate(turn, now[3:]) - gravity
        after = rotation.rotate(turned, then[3:]) - gravity
        position = position + velocity * dt + (2 * before + after) * dt**2 / 6
        velocity, turn = velocity + (before + after) / 2 * dt, rotation.normalize(turned)
        positions.append(position)
        rotations.append(turn)
    return np.array(positions), np.array(rotations)


@pytest.mark.slow
@pytest.mark.parametrize('seed', [7, 8])
def test_what_the_imu_feels_integrates_to_the_flight(seed):
    run = simulate(duration_s=20, seed=seed, imu_noise=NOISELESS)
    np.testing.assert_array_equal(run.imu.stamps_ns, run.ground_truth.stamps_ns)
    positions, rotations = integrated(run.ground_truth, run.imu.samples, 0.005)
    apart = rotation.angle_between(rotations, run.ground_truth.rotations)
    # steps of 5 ms leave that much; gravity taken 1 mm/s² wrong would leave 0.2 m
    assert np.rad2deg(apart).max() < 0.01
    assert np.linalg.norm(positions - run.ground_truth.positions, axis=1).max() < 0.02


def test_the_imu_adds_its_noise_and_changes_nothing_else(run):
    quiet, noisy = (simulate(imu_noise=noise) for noise in (NOISELESS, EUROC))
    noise = np.diff(noisy.imu.samples - quiet.imu.samples, axis=0).std(axis=0) / np.sqrt(2 * 200)
    np.testing.assert_allclose(noise, [1.6968e-4] * 3 + [2e-3] * 3, rtol=0.03)
    np.testing.assert_array_equal(noisy.estimate.positions, run.estimate.positions)
    np.testing.assert_array_equal(noisy.ground_truth.rotations, run.ground_truth.rotations)
    assert run.imu is None


def test_an_imu_at_rest_feels_gravity_alone():
    rest = at_rest(10, 7, NOISELESS)
    assert rest.imu.samples.shape == (2000, 6)
    assert (rest.imu.samples == [0, 0, 0, 0, 0, 9.81]).all()
    assert (len(rest.ground_truth), len(rest.estimate)) == (0, 0)


def test_a_scale_may_grow_along_the_run():
    run = simulate(drift=Drift(0, 0, 0.9, 0, 0, scale_drift=0.2))
    truth = truth_at_estimate(run)
    scales = []
    for part in (slice(0, 200), slice(-200, None)):
        steps = [np.diff(poses.positions[part], axis=0) for poses in (run.estimate, truth)]
        lengths = [np.linalg.norm(step, axis=1).sum() for step in steps]
        scales.append(lengths[0] / lengths[1])
    assert scales == pytest.approx([0.9 + 0.2 / 12, 1.1 - 0.2 / 12], abs=2e-3)


def test_a_run_too_short_for_two_estimates_is_refused():
    with pytest.raises(ConfigError, match='too short'):
        simulate(duration_s=0.05)
