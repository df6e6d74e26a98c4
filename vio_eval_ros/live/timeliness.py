"""
How late the poses of an estimate arrive, and what that costs whoever steers by them.

The clock of the arrivals is that of the node: the system's, or ``/clock`` with ``use_sim_time``.
Where the stamps are of another clock, nothing of this is known.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.trajectory import Poses

#: median latencies outside of this are those of two different clocks
LATENCIES_S = (-0.1, 60.0)
#: fewest poses of which there is a rate
MIN_POSES = 2
MEDIAN, P99 = 'latency_median_s', 'latency_p99_s'
HELD, PROPAGATED = 'held_trans_rmse_m', 'propagated_trans_rmse_m'
REAL_TIME_FACTOR = 'real_time_factor'
#: those that there are also of the last seconds
RECENT = (MEDIAN, P99, REAL_TIME_FACTOR)
NAMES = (MEDIAN, P99, HELD, PROPAGATED, REAL_TIME_FACTOR)


class Arrivals(NamedTuple):
    """
    Poses and when they arrived.

    :param poses: (N,), in order of arrival.
    :param received_ns: (N,) int64, by the clock of the system.
    :param twists: (N, 6) linear [m/s] and angular [rad/s] velocity of the body, in its frame;
        None where the messages have none.
    """

    poses: Poses
    received_ns: np.ndarray
    twists: np.ndarray | None = None


class ClockRelation:
    """What the clock of the node showed at times of the system's."""

    def __init__(self) -> None:
        self._known: deque[tuple[int, int]] = deque(maxlen=100)

    def note(self, system_ns: int, node_ns: int) -> None:
        """Note what both clocks show now."""
        self._known.append((system_ns, node_ns))

    def node_ns(self, system_ns: np.ndarray) -> np.ndarray:
        """Return what the clock of the node showed at these times, within those noted."""
        if not self._known:
            return system_ns
        system, node = np.array(self._known, np.int64).T
        # relative to the first, since float64 does not hold nanoseconds since 1970
        passed = np.interp(system_ns - system[0], system - system[0], node - node[0])
        return node[0] + np.rint(passed).astype(np.int64)


class Timeliness:
    """
    Latency, rate, and the error of the pose that was there when it was needed, of a run.

    :param most: how many poses of each side are kept; the oldest are given up.
    """

    def __init__(self, config: EvaluationConfig, most: int | None) -> None:
        self._preparation = Preparation.of_estimate(config)
        self._truth_preparation = Preparation.of_ground_truth(config)
        self._offset_ns = round(config.time_offset_s * 1e9)
        self._most = most
        self._arrivals: deque[tuple[Arrivals, np.ndarray]] = deque()
        self._truth: deque[Poses] = deque()

    def add_estimate(self, arrivals: Arrivals, node_ns: np.ndarray) -> None:
        """
        Add poses of the estimate.

        :param node_ns: (N,) when they arrived by the clock of the node.
        """
        self._arrivals.append((arrivals, node_ns))
        kept = sum(len(node_ns) for _, node_ns in self._arrivals)
        while self._most and len(self._arrivals) > 1 and kept > self._most:
            kept -= len(self._arrivals.popleft()[1])

    def add_ground_truth(self, poses: Poses) -> None:
        """Add poses of the ground truth."""
        self._truth.append(poses)
        kept = sum(map(len, self._truth))
        while self._most and len(self._truth) > 1 and kept > self._most:
            kept -= len(self._truth.popleft())

    def recent(self, seconds: float) -> dict[str, float]:
        """Return latency and rate of what has arrived in the last seconds."""
        found, length = [], 0.0
        for arrivals, node_ns in reversed(self._arrivals):
            found.append((arrivals, node_ns))
            length = (self._arrivals[-1][0].received_ns[-1] - arrivals.received_ns[0]) / 1e9
            if length >= seconds:
                break
        return self._of_clocks(found[::-1])

    def metrics(self, alignment: Alignment) -> dict[str, float]:
        """
        Return all metrics of the run; NaN where there is no data.

        :param alignment: takes the estimate into the world of the ground truth.
        """
        found = dict.fromkeys(NAMES, np.nan) | self._of_clocks(self._arrivals)
        if not np.isnan(found[MEDIAN]) and alignment.is_known and self._truth:
            found |= self._of_whoever_steers(alignment)
        return found

    def _of_clocks(self, batches: Sequence[tuple[Arrivals, np.ndarray]]) -> dict[str, float]:
        """Return latency and real-time factor."""
        found = dict.fromkeys(RECENT, np.nan)
        if not batches:
            return found
        stamps_ns = np.concatenate([one.poses.stamps_ns for one, _ in batches])
        received_ns = np.concatenate([one.received_ns for one, _ in batches])
        late_s = np.concatenate([node for _, node in batches]) - stamps_ns - self._offset_ns
        late_s = late_s / 1e9
        median_s = float(np.median(late_s))
        if LATENCIES_S[0] <= median_s <= LATENCIES_S[1]:
            found[MEDIAN], found[P99] = median_s, float(np.percentile(late_s, 99))
        took_ns = int(received_ns[-1] - received_ns[0])
        if len(stamps_ns) >= MIN_POSES and took_ns > 0:
            found[REAL_TIME_FACTOR] = float(stamps_ns[-1] - stamps_ns[0]) / took_ns
        return found

    def _of_whoever_steers(self, alignment: Alignment) -> dict[str, float]:
        """Return the error at each true pose of the estimate that had arrived last by then."""
        truth = self._truth_preparation.apply(Poses.concatenate(self._truth))
        stamps_ns = np.concatenate([one.poses.stamps_ns for one, _ in self._arrivals])
        # who steers goes by the newest pose, never by an older one that came late
        newest_ns = np.maximum.accumulate(stamps_ns)
        is_newer = np.concatenate([[True], stamps_ns[1:] > newest_ns[:-1]])
        poses = Poses.concatenate([one.poses for one, _ in self._arrivals])[is_newer]
        body = self._preparation.apply(poses)
        rows = np.searchsorted(poses.stamps_ns, body.stamps_ns - self._offset_ns)
        arrived_ns = np.concatenate([node_ns for _, node_ns in self._arrivals])
        arrived_ns = np.maximum.accumulate(arrived_ns[is_newer][rows])
        if not len(arrived_ns):
            return {}
        steered = (truth.stamps_ns >= arrived_ns[0]) & (truth.stamps_ns <= arrived_ns[-1])
        truth = truth[steered]
        last = np.searchsorted(arrived_ns, truth.stamps_ns, side='right') - 1
        held = body.positions[last]
        found = {HELD: _rmse(alignment.positions(held) - truth.positions)}
        twists = [one.twists for one, _ in self._arrivals if one.twists is not None]
        if len(twists) == len(self._arrivals) and body.rotations is not None:
            ages_s = (truth.stamps_ns - body.stamps_ns[last]) / 1e9
            twist = np.concatenate(twists)[is_newer][rows][last]
            moved = held + _motion(body.rotations[last], twist, ages_s)
            if twist.any() and not self._preparation.moves:
                found[PROPAGATED] = _rmse(alignment.positions(moved) - truth.positions)
        return found


def _rmse(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else float('nan')


def _motion(rotations: np.ndarray, twists: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Return how far (N, 3) bodies move at a constant twist, by the orientation half-way."""
    half_way = rotation.from_rotation_vector(twists[:, 3:] * seconds[:, None] / 2)
    velocities = rotation.rotate(rotation.multiply(rotations, half_way), twists[:, :3])
    return velocities * seconds[:, None]
