"""What the tests share: real recordings, made-up ones, and the package as colcon installs it."""

from collections.abc import Iterable
from dataclasses import replace
from operator import itemgetter
import os
from pathlib import Path
import shutil
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.simulation import simulate

ROOT = Path(__file__).resolve().parents[1]
STORE = get_typestore(Stores.ROS2_JAZZY)
# What is in a clone and matters for building: no environments, no results of earlier builds.
NOT_COPIED = shutil.ignore_patterns('.*', 'build', 'install', 'log', '*.egg-info', '__pycache__')


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
def colcon() -> str:
    beside_python = Path(sys.executable).parent
    found = shutil.which('colcon', path=f'{beside_python}{os.pathsep}{os.environ["PATH"]}')
    if found:
        return found
    if os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1':
        pytest.fail('colcon is required here and missing')
    pytest.skip('colcon is not installed')


@pytest.fixture(scope='session')
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a colcon workspace with a copy of the package in ``src``."""
    folder = tmp_path_factory.mktemp('workspace')
    shutil.copytree(ROOT, folder / 'src' / 'vio_eval_ros', ignore=NOT_COPIED)
    return folder


@pytest.fixture(scope='session')
def installed(colcon: str, workspace: Path) -> Path:
    """Return the folder into which colcon installed the package."""
    command = [colcon, '--log-base', 'log', 'build']
    done = subprocess.run(command, cwd=workspace, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return workspace / 'install' / 'vio_eval_ros'


def stamped(cls: str, stamp_ns: int, *content: Any) -> Any:
    """Return a message that begins with a header."""
    time = STORE.types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9))
    return STORE.types[cls](STORE.types['std_msgs/msg/Header'](time, 'map'), *content)


def poses(trajectory: Trajectory) -> list[Any]:
    """Return a PoseStamped for each pose."""
    geometry = 'geometry_msgs/msg/'
    point, quaternion, pose = (
        STORE.types[geometry + name] for name in ('Point', 'Quaternion', 'Pose')
    )
    columns = trajectory.stamps_ns.tolist(), trajectory.positions, trajectory.rotations
    return [
        stamped(f'{geometry}PoseStamped', stamp_ns, pose(point(*p), quaternion(*q)))
        for stamp_ns, p, q in zip(*columns, strict=True)
    ]


def record(folder: Path, messages: Iterable[tuple[str, Any]]) -> Path:
    """Write messages, each received at its stamp, as a rosbag2."""
    received = sorted(
        ((m.header.stamp.sec * 10**9 + m.header.stamp.nanosec, topic, m) for topic, m in messages),
        key=itemgetter(0),
    )
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=STORE)
            for topic, msgtype in {topic: m.__msgtype__ for _, topic, m in received}.items()
        }
        for received_ns, topic, message in received:
            raw = STORE.serialize_cdr(message, message.__msgtype__)
            writer.write(connections[topic], received_ns, raw)
    return folder


@pytest.fixture(scope='session')
def revising_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """
    Return a rosbag2 of a SLAM that publishes its whole Path twice a second.

    Each message on ``/slam/path`` takes back half of the drift of those before, as a loop closure
    does; ``/ground_truth/pose`` beside it has 200 poses a second.
    """
    flight = simulate(duration_s=15.0)
    messages = [('/ground_truth/pose', pose) for pose in poses(flight.ground_truth)]
    estimate, drift = flight.estimate, np.linspace(0, 1, len(flight.estimate)) ** 2
    for end in range(10, len(estimate) + 1, 10):
        positions = estimate.positions[:end].copy()
        positions[-10:, 2] += 2 * drift[end - 10 : end]
        positions[:-10, 2] += drift[: end - 10]
        path = poses(replace(estimate[:end], positions=positions))
        stamp_ns = int(estimate.stamps_ns[end - 1])
        messages.append(('/slam/path', stamped('nav_msgs/msg/Path', stamp_ns, path)))
    return record(tmp_path_factory.mktemp('slam') / 'recording', messages)


@pytest.fixture(scope='session')
def leica_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a rosbag2 with poses on ``/vio/pose`` and positions on ``/leica/position``."""
    flight, point = simulate(duration_s=15.0), STORE.types['geometry_msgs/msg/Point']
    messages = [('/vio/pose', pose) for pose in poses(flight.estimate)]
    truth = flight.ground_truth[::10]
    messages += [
        ('/leica/position', stamped('geometry_msgs/msg/PointStamped', stamp_ns, point(*p)))
        for stamp_ns, p in zip(truth.stamps_ns.tolist(), truth.positions, strict=True)
    ]
    return record(tmp_path_factory.mktemp('leica') / 'recording', messages)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail where everything was skipped, though the real recordings are required."""
    reporter = session.config.pluginmanager.get_plugin('terminalreporter')
    required = os.environ.get('VIO_EVAL_ROS_REQUIRE_DATA') == '1'
    if required and reporter is not None and not reporter.stats.get('passed'):
        session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED
