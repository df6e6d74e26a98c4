"""What the tests share: where the real recordings are, and a made-up one of a Path."""

from dataclasses import replace
from operator import itemgetter
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.simulation import simulate


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Return the folder of real recordings; skip where it is absent, fail where it is required."""
    beside = Path(__file__).resolve().parents[2] / 'shared' / 'data'
    folder = Path(os.environ.get('VIO_EVAL_ROS_DATA', beside))
    if folder.is_dir():
        return folder
    if os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1':
        pytest.fail(f'{folder} is required here and missing')
    pytest.skip(f'no real recordings at {folder}')


@pytest.fixture(scope='session')
def revising_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """
    Return a rosbag2 of a SLAM that publishes its whole Path twice a second.

    Each message on ``/slam/path`` takes back half of the drift of those before, as a loop closure
    does; ``/ground_truth/pose`` beside it has 200 poses a second.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    flight = simulate(duration_s=15.0)
    types = store.types
    time, header = types['builtin_interfaces/msg/Time'], types['std_msgs/msg/Header']

    def stamped(stamp_ns: int, position: np.ndarray, rotation: np.ndarray) -> Any:
        pose = types['geometry_msgs/msg/Pose'](
            types['geometry_msgs/msg/Point'](*position),
            types['geometry_msgs/msg/Quaternion'](*rotation),
        )
        head = header(time(*divmod(stamp_ns, 10**9)), 'map')
        return types['geometry_msgs/msg/PoseStamped'](head, pose)

    def poses(trajectory: Trajectory) -> list[Any]:
        columns = trajectory.stamps_ns.tolist(), trajectory.positions, trajectory.rotations
        return [stamped(*row) for row in zip(*columns, strict=True)]

    messages = [
        (pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec, '/ground_truth/pose', pose)
        for pose in poses(flight.ground_truth)
    ]
    estimate, drift = flight.estimate, np.linspace(0, 1, len(flight.estimate)) ** 2
    for end in range(10, len(estimate) + 1, 10):
        positions = estimate.positions[:end].copy()
        positions[-10:, 2] += 2 * drift[end - 10 : end]
        positions[:-10, 2] += drift[: end - 10]
        path = poses(replace(estimate[:end], positions=positions))
        message = types['nav_msgs/msg/Path'](path[-1].header, path)
        messages.append((int(estimate.stamps_ns[end - 1]), '/slam/path', message))
    folder = tmp_path_factory.mktemp('slam') / 'recording'
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, message.__msgtype__, typestore=store)
            for topic, message in {topic: message for _, topic, message in messages}.items()
        }
        for received_ns, topic, message in sorted(messages, key=itemgetter(0)):
            raw = store.serialize_cdr(message, message.__msgtype__)
            writer.write(connections[topic], received_ns, raw)
    return folder


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail where everything was skipped, though the real recordings are required."""
    reporter = session.config.pluginmanager.get_plugin('terminalreporter')
    required = os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1'
    if required and reporter is not None and not reporter.stats.get('passed'):
        session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED
