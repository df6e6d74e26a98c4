"""
Whether a stream of poses is several trajectories that take turns, as of two publishers.

The stream is looked at in windows of consecutive poses. What a smooth curve through a window
leaves is put into two or three groups. A window is several trajectories where each group is smooth
by itself and far from the others, and every change from one to another is a leap that no body
makes. A group is smooth where its poses are on the lines between their neighbours in the group,
many times closer than they are to the lines between their neighbours outside. Noise, outliers,
jumps, gaps and oscillations each fail one of these.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.orientations import finite
from vio_eval_ros.core.rotation import lengths, normalize, to_matrix
from vio_eval_ros.core.trajectory import Poses

#: poses in a window; in the longest, a trajectory that has one pose in twenty has enough
WINDOWS = (16, 48, 128)
#: the most poses that are looked at, in windows spread evenly over the stream
MAX_POSES = 1 << 14
#: how many trajectories are tried
COUNTS = (2, 3)
#: poses of a window for each degree of the curve through it, and the highest degree
POSES_PER_DEGREE = 8
MAX_DEGREE = 9
#: iterations of k-means, which begins with points that are far apart
ITERATIONS = 6
#: the fewest poses of a trajectory in a window, and changes from one to another
MIN_POSES = 5
MIN_SWITCHES = 6
#: how many times nearer smooth poses are to the lines of their own group
SMOOTH = 5.0
#: a change from one group to another leaps at least this share of their distance, and what stays
#: in a group moves at most this share of it, both with few exceptions
LEAP = 0.7
STEP = 0.3
MOST = 0.9
#: trajectories are further apart than they move from pose to pose, this many times: less may be
#: one whose stamps are wrong, or whose poses are sent twice
TRAVEL = 1.5
#: the fewest changes and windows in all, and the least share of the windows in which something is
#: aside: of those with outliers or noise, one in twenty looks like several trajectories by chance
MIN_ALL_SWITCHES = 20
MIN_WINDOWS = 3
MIN_SHARE = 0.2
#: a pose comes again within this share of the period, as do at least as many of all
AGAIN_PERIODS = 0.1
AGAIN_SHARE = 0.4
#: two clocks are at least as far apart
CLOCKS_APART_S = 1.0


class Space(NamedTuple):
    """
    What is compared: positions or orientations.

    :param least: the smallest distance of two trajectories; nearer ones do little harm.
    :param acceleration: of one body that swings to and fro instead; no body exceeds it.
    """

    unit: str
    least: float
    acceleration: float


POSITIONS = Space('m', 0.05, 30.0)
ORIENTATIONS = Space('rad', 0.05, 300.0)


@dataclass(frozen=True)
class Interleaving:
    """
    Several trajectories in one stream of poses.

    :param count: how many.
    :param switches: how often one follows another, in the poses that were looked at.
    :param first_ns: the first stamp at which they do, and ``last_ns``, the last.
    :param apart: how far apart they are, the median.
    :param unit: of that distance: m, rad, or s where their clocks differ.
    """

    count: int
    switches: int
    first_ns: int
    last_ns: int
    apart: float
    unit: str

    def __str__(self) -> str:
        """Return what it is, in words."""
        what = {2: 'two', 3: 'three'}[self.count]
        apart = f'{self.apart:.3g} {self.unit}'
        if self.unit == 'rad':
            apart = f'{math.degrees(self.apart):.3g} deg'
        kind = 'clocks' if self.unit == 's' else 'trajectories'
        return (
            f'poses of {what} {kind}, {apart} apart, take turns ({self.switches} times from '
            f'{self.first_ns / 1e9:.2f} to {self.last_ns / 1e9:.2f} s): {what} publishers'
        )


def interleaving(poses: Poses) -> Interleaving | None:
    """
    Return how a stream of poses, as received, is several trajectories; None where it is one.

    Two runs of which one follows the other in the stream do not take turns.
    """
    usable = finite(poses.positions)
    if poses.zero_is_unset:
        usable &= poses.stamps_ns != 0
    arrival = np.flatnonzero(usable)
    stamps_ns = poses.stamps_ns[arrival]
    order = np.argsort(stamps_ns, kind='stable')
    found = _two_clocks(stamps_ns, stamps_ns[order])
    with np.errstate(all='ignore'):
        for size in WINDOWS:
            chosen = arrival[_windows(order, size)]
            found = found or _in_positions(poses, chosen) or _in_orientations(poses, chosen)
    return found


def copies(poses: Poses) -> np.ndarray:
    """
    Return (N,) which poses repeat one that was stamped just before, where every other one does.

    That is what two publishers of one trajectory make. Poses that are held do not count, nor do
    those with the very same stamp, of which cleaning keeps the first.
    """
    again = np.zeros(len(poses), bool)
    order = np.argsort(poses.stamps_ns, kind='stable')
    east = poses.positions[order, 0]
    is_same = east[1:] == east[:-1]
    if np.count_nonzero(is_same) < max(AGAIN_SHARE * len(poses), 1):
        return again
    for column in (poses.positions, poses.rotations):
        if column is not None:
            ordered = column[order]
            is_same &= (ordered[1:] == ordered[:-1]).all(axis=1)
    stamps_ns = poses.stamps_ns[order]
    steps_ns, new_ns = np.diff(stamps_ns), stamps_ns[np.append(True, ~is_same)]
    if len(new_ns) < 2:
        return again
    is_same &= (steps_ns > 0) & (steps_ns < AGAIN_PERIODS * np.median(np.diff(new_ns)))
    if np.count_nonzero(is_same) >= AGAIN_SHARE * len(poses):
        again[order[1:]] = is_same
    return again


def _two_clocks(stamps_ns: np.ndarray, ordered_ns: np.ndarray) -> Interleaving | None:
    """Return how stamps, as received and in order, jump between two spans of time."""
    if len(stamps_ns) < MIN_ALL_SWITCHES or np.array_equal(stamps_ns, ordered_ns):
        return None
    widest = int(np.diff(ordered_ns).argmax())
    begin_ns, end_ns = int(ordered_ns[widest]), int(ordered_ns[widest + 1])
    switched = np.flatnonzero(np.diff(stamps_ns > begin_ns))
    if end_ns - begin_ns < CLOCKS_APART_S * 1e9 or len(switched) < MIN_ALL_SWITCHES:
        return None
    apart_s = float(np.median(np.abs(stamps_ns[switched + 1] - stamps_ns[switched]))) / 1e9
    first_ns, last_ns = int(ordered_ns[0]), int(ordered_ns[-1])
    return Interleaving(2, len(switched), first_ns, last_ns, apart_s, 's')


def _windows(order: np.ndarray, size: int) -> np.ndarray:
    """Return (M, size) of the indices in order, in windows spread evenly."""
    count = len(order) // size
    most = MAX_POSES // size
    chosen = np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(int)
    return np.asarray(order[chosen[:, None] * size + np.arange(size)])


def _in_positions(poses: Poses, chosen: np.ndarray) -> Interleaving | None:
    points = poses.positions[chosen]
    return _in_windows(points, poses.stamps_ns[chosen], chosen, POSITIONS)


def _in_orientations(poses: Poses, chosen: np.ndarray) -> Interleaving | None:
    if poses.rotations is None:
        return None
    rotations = normalize(poses.rotations[chosen])
    known = np.isfinite(rotations).all(axis=(1, 2))
    # no signs to mind; of small rotations the distance is the angle
    points = to_matrix(rotations[known]).reshape(-1, chosen.shape[1], 9) / math.sqrt(2)
    chosen = chosen[known]
    return _in_windows(points, poses.stamps_ns[chosen], chosen, ORIENTATIONS)


@dataclass(frozen=True, eq=False)
class _Windows:
    """
    M windows of N poses.

    :param points: (M, N, D), and ``left``, what the curve through them leaves.
    :param arrival: (M, N) their places in the stream.
    :param stamps_ns: (M, N), not decreasing, and ``seconds``, since the first in the window.
    """

    points: np.ndarray
    left: np.ndarray
    arrival: np.ndarray
    stamps_ns: np.ndarray
    seconds: np.ndarray


def _in_windows(
    points: np.ndarray, stamps_ns: np.ndarray, arrival: np.ndarray, space: Space
) -> Interleaving | None:
    """Return how several trajectories take turns in windows, by the count most of them have."""
    bends = np.count_nonzero(lengths(np.diff(points, 2, axis=1)) > space.least, axis=1)
    which = bends >= MIN_SWITCHES  # of a smooth trajectory, none are
    points, stamps_ns, arrival = points[which], stamps_ns[which], arrival[which]
    if not len(points):
        return None
    seconds = (stamps_ns - stamps_ns[:, :1]) / 1e9
    left = _beside_curve(points, seconds)
    windows = _Windows(points, left, arrival, stamps_ns, seconds)
    found = [_as_trajectories(windows, count, space) for count in COUNTS]
    return max((one for one in found if one), key=lambda one: one.switches, default=None)


def _beside_curve(points: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Return the (M, N, D) differences of points from a polynomial of time through each window."""
    degree = min(1 + points.shape[1] // POSES_PER_DEGREE, MAX_DEGREE)
    times = 2 * seconds / np.maximum(seconds[:, -1:], 1e-9) - 1
    powers = np.polynomial.chebyshev.chebvander(times, degree)
    transposed = powers.swapaxes(1, 2)
    normal = transposed @ powers + 1e-9 * np.eye(degree + 1)  # equal stamps leave it singular
    return np.asarray(points - powers @ np.linalg.solve(normal, transposed @ points))


def _as_trajectories(windows: _Windows, count: int, space: Space) -> Interleaving | None:
    """Return how a number of trajectories take turns, where enough windows show it."""
    groups = _groups(windows.left, count)
    by_group = [_of_group(windows, groups == one) for one in range(count)]
    smooth = np.array([one.is_smooth for one in by_group])
    apart = np.fmin.reduce([one.apart for one in by_group])
    is_far = (apart > space.least) & _is_beyond_motion(windows, groups, apart, space)
    by_arrival = np.take_along_axis(groups, windows.arrival.argsort(axis=1), axis=1)
    switches = np.count_nonzero(np.diff(by_arrival, axis=1), axis=1)
    confirmed = is_far & smooth.all(axis=0) & _are_leaps(windows.left, groups, apart)
    confirmed &= switches >= MIN_SWITCHES
    total, all_switches = int(confirmed.sum()), int(switches[confirmed].sum())
    is_aside = int(np.count_nonzero(is_far & smooth.any(axis=0)))
    if total < max(MIN_WINDOWS, MIN_SHARE * is_aside) or all_switches < MIN_ALL_SWITCHES:
        return None
    stamps_ns = windows.stamps_ns[confirmed]
    first_ns, last_ns = int(stamps_ns.min()), int(stamps_ns.max())
    distance = float(np.median(apart[confirmed]))
    return Interleaving(count, all_switches, first_ns, last_ns, distance, space.unit)


def _groups(left: np.ndarray, count: int) -> np.ndarray:
    """Return the (M, N) groups of points, by k-means from points that are far apart."""
    rows = np.arange(len(left))
    centres = left.mean(axis=1, keepdims=True)
    for _ in range(count):
        farthest = _squares(left, centres).min(axis=2).argmax(axis=1)
        centres = np.concatenate([centres, left[rows, farthest][:, None]], axis=1)
    centres = centres[:, 1:]
    groups = _squares(left, centres).argmin(axis=2)
    for _ in range(ITERATIONS):
        members = (groups[:, :, None] == np.arange(count)).astype(float)
        sums = members.swapaxes(1, 2) @ left
        centres = sums / np.maximum(members.sum(axis=1), 1)[:, :, None]
        groups = _squares(left, centres).argmin(axis=2)
    return np.asarray(groups)


def _squares(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the (M, N, K) squared distances of (M, N, D) points from (M, K, D) centres."""
    difference = points[:, :, None] - centres[:, None]
    return np.asarray(np.einsum('mnkd,mnkd->mnk', difference, difference))


class _Group(NamedTuple):
    """(M,) whether it is smooth, and its distance from the lines between the others."""

    is_smooth: np.ndarray
    apart: np.ndarray


def _of_group(windows: _Windows, members: np.ndarray) -> _Group:
    """Return what (M, N) members of a group are like."""
    off = {}
    # what moves along with the others is smoother without their common motion
    for name in ('points', 'left'):
        for key, among in (('own', members), ('other', ~members)):
            distances = _off_line(getattr(windows, name), windows.seconds, among)
            off[name, key] = _median(distances, members)
    is_smooth = np.zeros(len(members), bool)
    for name in ('points', 'left'):
        is_smooth |= off[name, 'other'] > SMOOTH * off[name, 'own']
    return _Group(is_smooth & (members.sum(axis=1) >= MIN_POSES), off['points', 'other'])


def _off_line(points: np.ndarray, seconds: np.ndarray, among: np.ndarray) -> np.ndarray:
    """
    Return how far points are from the line between their neighbours among some of them.

    :return: (M, N), NaN where there is no neighbour on one side.
    """
    rows, size = np.arange(len(points))[:, None], points.shape[1]
    index = np.arange(size)
    before = np.maximum.accumulate(np.where(among, index, -1), axis=1)
    before = np.concatenate([np.full((len(points), 1), -1), before[:, :-1]], axis=1)
    after = np.minimum.accumulate(np.where(among, index, size)[:, ::-1], axis=1)[:, ::-1]
    after = np.concatenate([after[:, 1:], np.full((len(points), 1), size)], axis=1)
    known = (before >= 0) & (after < size)
    before, after = before.clip(0), after.clip(max=size - 1)
    begin_s, end_s = seconds[rows, before], seconds[rows, after]
    weight = ((seconds - begin_s) / np.maximum(end_s - begin_s, 1e-9))[..., None]
    line = points[rows, before] * (1 - weight) + points[rows, after] * weight
    return np.where(known, lengths(points - line), math.nan)


def _is_beyond_motion(
    windows: _Windows, groups: np.ndarray, apart: np.ndarray, space: Space
) -> np.ndarray:
    """Return (M,) whether one body cannot be on both sides in turn."""
    changed = np.diff(groups, axis=1) != 0
    period_s = _median(np.diff(windows.seconds, axis=1), changed)
    swing = apart / 2 * (math.pi / np.maximum(period_s, 1e-9)) ** 2
    travel = np.median(lengths(np.diff(windows.points - windows.left, axis=1)), axis=1)
    return np.asarray((swing > space.acceleration) & (apart > TRAVEL * travel))


def _are_leaps(left: np.ndarray, groups: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """Return (M,) whether changes of the group are leaps, and there are no others."""
    changed = np.diff(groups, axis=1) != 0
    steps = lengths(np.diff(left, axis=1)) / apart[:, None]
    leaps, stays = changed.sum(axis=1), (~changed).sum(axis=1)
    are_far = (changed & (steps > LEAP)).sum(axis=1) >= MOST * leaps
    are_near = (~changed & (steps < STEP)).sum(axis=1) >= MOST * stays
    return np.asarray(are_far & are_near & (leaps >= MIN_SWITCHES))


def _median(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return the (M,) lower medians of those (M, N) values that are known, NaN without any."""
    known = where & ~np.isnan(values)
    ordered = np.sort(np.where(known, values, math.inf), axis=1)
    count = known.sum(axis=1)
    middle = ordered[np.arange(len(values)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, middle, math.nan)
