"""
Poses of the PX4 autopilot, as its messages in ROS and its logs have them.

PX4 counts microseconds from its start, has its world north, east, down (NED) and its body forward,
right, down (FRD), and writes w first. Here the world becomes east, north, up and the body forward,
left, up, as REP 103 has them: a turn of the world alone would change nothing of an evaluation, one
of the body does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vio_eval_ros.core.rotation import multiply

PACKAGE = 'px4_msgs/msg/Vehicle'
# the types that have the same fields
ODOMETRY = tuple(f'{PACKAGE}{name}Odometry' for name in ('', 'Visual', 'Mocap'))
LOCAL_POSITION = tuple(f'{PACKAGE}LocalPosition{name}' for name in ('', 'Groundtruth'))
GLOBAL_POSITION = tuple(f'{PACKAGE}GlobalPosition{name}' for name in ('', 'Groundtruth'))
LATEST_US = 1 << 53  # a later stamp is damaged
NED, FRD = 1, 2  # the values of pose_frame; 0 is unknown
HALF = np.sqrt(0.5)
#: by frame of the world: the quaternion that turns it to point up, and what that does to x y z
UP = {
    NED: (np.array([HALF, HALF, 0.0, 0.0]), (1, 0, 2), (1.0, 1.0, -1.0)),
    FRD: (np.array([1.0, 0.0, 0.0, 0.0]), (0, 1, 2), (1.0, -1.0, -1.0)),
}
BODY = np.array([1.0, 0.0, 0.0, 0.0])  # from forward, left, up to forward, right, down


def stamp_ns(message: Any) -> int:
    """
    Return when the values of a message were measured, since the start of the autopilot.

    A time that no autopilot runs for is damaged; it is 0, as of stamps that were never set.
    """
    measured_us = int(message.timestamp_sample or message.timestamp)
    return measured_us * 1000 if measured_us < LATEST_US else 0


def odometry_numbers(message: Any) -> tuple[float, ...]:
    """Return position, quaternion x y z w and frame of a VehicleOdometry."""
    w, x, y, z = message.q
    if hasattr(message, 'pose_frame'):
        return (*message.position, x, y, z, w, message.pose_frame)
    # before PX4 1.14, where NED was 0
    return message.x, message.y, message.z, x, y, z, w, message.local_frame + 1


def local_position_numbers(message: Any) -> tuple[float, ...]:
    """Return position and frame of a VehicleLocalPosition; NaN where it says that it has none."""
    unknown = np.where(np.logical_and(message.xy_valid, message.z_valid), 0.0, np.nan)
    return message.x + unknown, message.y + unknown, message.z + unknown, NED


def global_position_numbers(message: Any) -> tuple[float, ...]:
    """Return latitude and longitude [deg] and altitude [m] of a VehicleGlobalPosition."""
    return message.lat, message.lon, message.alt


class Upright:
    """Turns numbers whose last column is the frame of the world, so that z points up."""

    origin = None

    def __init__(self) -> None:
        self._frames: set[int] = set()

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        """Return the (N, 3) or (N, 7) numbers of poses."""
        frames = numbers[:, -1].astype(int)
        self._frames |= set(frames.tolist())
        turned = numbers[:, :-1].copy()
        for frame, (turn, order, signs) in UP.items():
            # where the frame is unknown, down is down all the same
            rows = frames == FRD if frame == FRD else frames != FRD
            turned[rows, :3] = numbers[rows][:, order] * signs
            if turned.shape[1] > 3:
                turned[rows, 3:] = multiply(multiply(turn, numbers[rows, 3:7]), BODY)
        return turned

    def notes(self) -> list[str]:
        """Return what has been done, in sentences."""
        found = [
            'PX4 has its world north, east, down and its body forward, right, down; poses are '
            'turned to east, north, up and forward, left, up'
        ]
        if len(self._frames) > 1:
            found.append('its pose_frame changes on the way: its poses are not all in one frame')
        elif self._frames and not self._frames <= UP.keys():
            found.append('its pose_frame is not known; north, east, down is assumed')
        return found
