"""A rig as it should be: two cameras that are triggered together, an IMU, and poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vio_eval_ros.core.sensor_stream import SensorStream

FIRST_NS = 1_403_636_579_763_555_584
DURATION_S = 30.0
STILL_S = 3.0
KINDS = {
    'sensor_msgs/msg/Image': 'camera',
    'sensor_msgs/msg/Imu': 'imu',
    'geometry_msgs/msg/PoseStamped': 'pose',
}


def stream(
    topic: str, msgtype: str, rate_hz: float, source: np.random.Generator, numbers=None
) -> SensorStream:
    """Return messages whose stamps are off by microseconds, recorded after a random delay."""
    elapsed = np.arange(0, DURATION_S, 1 / rate_hz)
    stamps_ns = FIRST_NS + np.round(elapsed * 1e9).astype(np.int64)
    stamps_ns += source.normal(0, 10_000, len(elapsed)).astype(np.int64)
    delays = 4_000_000 + source.exponential(2_000_000, len(elapsed)).astype(np.int64)
    logged_ns = np.maximum.accumulate(stamps_ns + delays)
    columns = None if numbers is None else numbers(elapsed, source)
    return SensorStream(
        topic, msgtype, KINDS[msgtype], logged_ns, stamps_ns, {'frame': len(elapsed)}, columns
    )


def felt(elapsed: np.ndarray, source: np.random.Generator) -> np.ndarray:
    """Return (N, 6) samples of an IMU that stands still and then is moved about."""
    waves = np.sin(2 * np.pi * np.outer(elapsed, [0.4, 0.7, 0.3, 0.5, 0.9, 0.6]))
    samples = waves * [0.5, 0.4, 0.6, 1.5, 1.0, 2.0] * (elapsed > STILL_S)[:, None]
    samples += source.normal(0, [0.003] * 3 + [0.03] * 3, samples.shape)
    return samples + np.array([0.0, 0.02, 0.08, 0.0, 0.0, 9.81])


def moved(elapsed: np.ndarray, source: np.random.Generator) -> np.ndarray:
    """Return (N, 7) poses on a curve, known to a millimetre."""
    positions = np.stack(
        [3 * np.sin(0.5 * elapsed), 2 * np.cos(0.7 * elapsed), 1 + 0.1 * elapsed], axis=1
    )
    yaw = 0.2 * elapsed
    rotations = np.stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)
    return np.hstack([positions + source.normal(0, 0.001, positions.shape), rotations])


@pytest.fixture
def rig() -> dict[str, SensorStream]:
    """Return the streams of a clean recording, by short names."""
    source = np.random.default_rng(3)
    cam0 = stream('/cam0/image_raw', 'sensor_msgs/msg/Image', 20.0, source)
    return {
        'cam0': cam0,
        'cam1': replace(cam0, topic='/cam1/image_raw'),
        'imu': stream('/imu0', 'sensor_msgs/msg/Imu', 200.0, source, felt),
        'pose': stream('/vicon/pose', 'geometry_msgs/msg/PoseStamped', 100.0, source, moved),
    }
