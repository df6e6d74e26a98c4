"""A run as a recording of ROS 2 messages, which Foxglove, PlotJuggler and ``replay`` open."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import io
import math
from operator import itemgetter
from typing import Any

import numpy as np

from vio_eval_ros.core.metrics import position_errors, rotation_errors
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.reports.documents import json_report
from vio_eval_ros.reports.tables import aligned
from vio_eval_ros.version import __version__

NODE = '/vio_evaluator'
FRAME = 'world'
WIDTH_M = 0.03
END_NS = (1 << 31) * 10**9  # the stamps of ROS have 31 bits for the seconds

# when a message is logged, its topic below the node's name, and the message
Logged = tuple[int, str, Any]


def mcap_report(result: Result) -> bytes:
    """
    Return an MCAP file of both trajectories, the errors of each pair and the running values.

    Topics that the live node has too have its names and types. Each message is logged at its
    stamp, on the clock of the ground truth; unknown values have no message.

    :raises ConfigError: where the alignment is not determined, or ROS cannot hold the stamps.
    """
    # imported here, since no other report needs them
    from mcap.writer import Writer
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    messages = _messages(result, _Maker(store.types))
    file = io.BytesIO()
    writer = Writer(file)
    writer.start('ros2', f'vio_eval_ros {__version__}')
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for stamp_ns, topic, message in messages:
        kind = message.__msgtype__
        if kind not in schemas:
            definition, _ = store.generate_msgdef(kind, ros_version=2)
            schemas[kind] = writer.register_schema(kind, 'ros2msg', definition.encode())
        if topic not in channels:
            channels[topic] = writer.register_channel(f'{NODE}/{topic}', 'cdr', schemas[kind])
        data = bytes(store.serialize_cdr(message, kind))
        writer.add_message(channels[topic], stamp_ns, data, stamp_ns)
    writer.finish()
    return file.getvalue()


def _messages(result: Result, maker: _Maker) -> list[Logged]:
    """Return all messages in order: paths at the beginning and, with the result, at the end."""
    estimate, truth = aligned(result), result.summary.pairs.ground_truth
    numbers = [*_errors(result), *_running(result)]
    stamps = [*(stamp_ns for stamp_ns, _, _ in numbers), *truth.stamps_ns.tolist()]
    begin_ns, end_ns = min(stamps), max(stamps)
    if not 0 <= begin_ns <= end_ns < END_NS:
        raise ConfigError(
            'an mcap report can hold stamps from 1970 to 2038 only; use a csv report'
        )
    paths = {'estimate_aligned': maker.path(estimate), 'ground_truth_path': maker.path(truth)}
    errors = position_errors(result.summary.pairs, result.summary.alignment)
    during = [
        *maker.poses('estimate_aligned', paths['estimate_aligned'], estimate.rotations is None),
        *maker.poses('ground_truth', paths['ground_truth_path'], truth.rotations is None),
        *maker.numbers(numbers),
    ]
    return [
        *((begin_ns, topic, path) for topic, path in paths.items()),
        (begin_ns, 'error_markers', maker.line(estimate.positions, errors)),
        *sorted(during, key=itemgetter(0)),
        *((end_ns, topic, path) for topic, path in paths.items()),
        (end_ns, 'result', maker.make('std_msgs/String', json_report(result))),
    ]


def _errors(result: Result) -> Iterator[tuple[int, str, float]]:
    """Yield stamp, topic and value of the errors of each pair."""
    pairs, alignment = result.summary.pairs, result.summary.alignment
    position, rotation = position_errors(pairs, alignment), rotation_errors(pairs, alignment)
    columns = pairs.estimate.stamps_ns.tolist(), position.tolist(), rotation.tolist()
    for stamp_ns, metres, degrees in zip(*columns, strict=True):
        yield stamp_ns, 'error/position_m', metres
        yield stamp_ns, 'error/rotation_deg', degrees


def _running(result: Result) -> Iterator[tuple[int, str, float]]:
    """Yield stamp, topic and value of the running metrics."""
    for stamp_ns, values in result.series:
        for name, value in values.items():
            # rpe_0.5s_trans_rmse_m is not a valid name of a topic
            yield stamp_ns, f'metrics/{name.replace(".", "_")}', float(value)


class _Maker:
    """
    Makes ROS messages.

    :param types: the classes of rosbags by the full names of the message types.
    """

    def __init__(self, types: Mapping[str, Any]) -> None:
        self._types = types

    def make(self, kind: str, *fields: Any, **named: Any) -> Any:
        """Return a message of a type, such as ``std_msgs/String``, with all its fields."""
        return self._types[kind.replace('/', '/msg/')](*fields, **named)

    def numbers(self, values: list[tuple[int, str, float]]) -> Iterator[Logged]:
        """Yield a Float64 for each value that is known."""
        for stamp_ns, topic, value in values:
            if not math.isnan(value):
                yield stamp_ns, topic, self.make('std_msgs/Float64', value)

    def path(self, trajectory: Trajectory) -> Any:
        """Return a Path; unknown orientations become the identity, so that it can be drawn."""
        rotations = trajectory.rotations
        if rotations is None:
            rotations = np.tile([0.0, 0.0, 0.0, 1.0], (len(trajectory), 1))
        columns = trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), rotations.tolist()
        poses = [
            self.make('geometry_msgs/PoseStamped', self._header(stamp_ns), self._pose(p, q))
            for stamp_ns, p, q in zip(*columns, strict=True)
        ]
        return self.make('nav_msgs/Path', poses[-1].header, poses)

    def poses(self, topic: str, path: Any, position_only: bool) -> Iterator[Logged]:
        """Yield each pose of a Path by itself; where orientations are unknown, as a point."""
        for pose in path.poses:
            stamp_ns = pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec
            if position_only:
                point = self.make('geometry_msgs/PointStamped', pose.header, pose.pose.position)
                yield stamp_ns, f'{topic}_point', point
            else:
                yield stamp_ns, f'{topic}_pose', pose

    def line(self, positions: np.ndarray, errors: np.ndarray) -> Any:
        """Return a line through (N, 3) positions: green without error, red at 95 % and above."""
        shares = np.clip(errors / max(float(np.percentile(errors, 95)), 1e-9), 0, 1).tolist()
        nothing, empty = np.empty(0, np.uint8), self._header(0)
        marker = self.make(
            'visualization_msgs/Marker',
            header=empty,
            ns='error',
            id=0,
            type=self._types['visualization_msgs/msg/Marker'].LINE_STRIP,
            action=0,
            pose=self._pose([0.0] * 3, [0.0, 0.0, 0.0, 1.0]),
            scale=self.make('geometry_msgs/Vector3', WIDTH_M, 0.0, 0.0),
            color=self.make('std_msgs/ColorRGBA', 0.0, 0.0, 0.0, 0.0),
            lifetime=self.make('builtin_interfaces/Duration', 0, 0),
            frame_locked=False,
            points=[self.make('geometry_msgs/Point', *p) for p in positions.tolist()],
            colors=[self.make('std_msgs/ColorRGBA', s, 1 - s, 0.1, 1.0) for s in shares],
            texture_resource='',
            texture=self.make('sensor_msgs/CompressedImage', empty, '', nothing),
            uv_coordinates=[],
            text='',
            mesh_resource='',
            mesh_file=self.make('visualization_msgs/MeshFile', '', nothing),
            mesh_use_embedded_materials=False,
        )
        return self.make('visualization_msgs/MarkerArray', [marker])

    def _header(self, stamp_ns: int) -> Any:
        time = self.make('builtin_interfaces/Time', *divmod(stamp_ns, 10**9))
        return self.make('std_msgs/Header', time, FRAME)

    def _pose(self, position: list[float], rotation: list[float]) -> Any:
        return self.make(
            'geometry_msgs/Pose',
            self.make('geometry_msgs/Point', *position),
            self.make('geometry_msgs/Quaternion', *rotation),
        )
