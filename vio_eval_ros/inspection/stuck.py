"""Samples of an IMU that repeat the one before: in all axes, in one sensor, in one axis."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import runs, SensorStream
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.imu_axes import ACCEL, ALL, AXES, GYRO, named, still_limits
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.saturation import COARSE_LEVELS, cut_off_nearby

#: samples on either side of a run of equal ones that show how often values repeat by chance, as
#: those of coarse sensors do at rest
NEIGHBOUR_SAMPLES = 50
#: probability, in the whole recording, above which a run is one by chance
CHANCE = 1e-3
#: length of a run of a stuck axis, over the longest run by chance, while other axes move
STUCK_AXIS_FACTOR = 5.0


class Stuck(NamedTuple):
    """
    Runs of equal samples.

    :param axes: in which they are equal.
    :param begins: (K,) where each begins, and ``ends``, the index after its end.
    """

    axes: slice
    begins: np.ndarray
    ends: np.ndarray


def stuck_runs(numbers: np.ndarray, limits: InspectionLimits) -> list[Stuck]:
    """
    Return where samples repeat the one before: in all axes, in three, or in one.

    Three axes, or one, can be at rest; they are stuck where the others move meanwhile.
    """
    found: list[Stuck] = []
    for axes, least, others in (
        (ALL, limits.stuck_samples, None),
        (GYRO, limits.stuck_sensor_samples, ACCEL),
        (ACCEL, limits.stuck_sensor_samples, GYRO),
    ):
        if axes is not ALL and not numbers[:, axes].any():
            continue  # it is dead, or not there
        runs_of_all = _repeats(numbers, axes, least, others, still_limits(limits))
        new = [not any(_within(begin, one) for one in found) for begin in runs_of_all.begins]
        found.append(Stuck(axes, runs_of_all.begins[new], runs_of_all.ends[new]))
    found += [
        Stuck(slice(axis, axis + 1), *_stuck_axis(numbers, axis, found, limits))
        for axis in range(6)
        if numbers[:, GYRO if axis < 3 else ACCEL].any()
    ]
    return [one for one in found if len(one.begins)]


def _stuck_axis(
    numbers: np.ndarray, axis: int, wider: list[Stuck], limits: InspectionLimits
) -> tuple[np.ndarray, np.ndarray]:
    """Return the runs of equal samples of one axis that are not part of ``wider`` ones."""
    axes = slice(axis, axis + 1)
    found = _repeats(numbers, axes, limits.stuck_axis_samples, ALL, still_limits(limits))
    if not len(found.begins):
        return found.begins, found.ends
    is_cut = cut_off_nearby(numbers[:, axis], limits)
    is_long = _longer(numbers, axis, is_cut, found, limits)
    new = [
        long and not is_cut[begin] and not any(_within(begin, one) for one in wider)
        for begin, long in zip(found.begins.tolist(), is_long.tolist(), strict=True)
    ]
    return found.begins[new], found.ends[new]


def _within(begin: int, stuck: Stuck) -> bool:
    """Return whether a run begins in another one, which says it already."""
    return bool(((stuck.begins <= begin) & (begin < stuck.ends)).any())


def _repeats(
    numbers: np.ndarray, axes: slice, least: int, others: slice | None, still: np.ndarray
) -> Stuck:
    """Return runs of ``least`` samples that are the same in some axes, by more than chance."""
    is_same = (numbers[1:, axes] == numbers[:-1, axes]).all(axis=1)
    begins, ends = runs(is_same)
    long = ends + 1 - begins >= least
    kept = []
    for begin, end in zip(begins[long].tolist(), ends[long].tolist(), strict=True):
        before = is_same[max(begin - NEIGHBOUR_SAMPLES, 0) : max(begin - 1, 0)]
        after = is_same[end + 1 : end + NEIGHBOUR_SAMPLES]
        share = max((float(part.mean()) for part in (before, after) if len(part)), default=0.0)
        if 0 < share < 1 and (end - begin) * math.log(share) > math.log(CHANCE / len(numbers)):
            continue
        samples = numbers[begin : end + 1]
        if share < 1 and (others is None or _moves(samples, others, still)):
            kept.append((begin, end + 1))
    found = np.array(kept, int).reshape(-1, 2)
    return Stuck(axes, found[:, 0], found[:, 1])


def _longer(
    numbers: np.ndarray, axis: int, is_cut: np.ndarray, found: Stuck, limits: InspectionLimits
) -> np.ndarray:
    """
    Return which runs of an axis are longer than it repeats elsewhere, while the others move.

    Lengths of runs by chance have no gap between them: those of what is stuck follow one.
    """
    least = limits.stuck_axis_samples
    values, others = numbers[:, axis], np.delete(numbers, axis, axis=1)
    count = len(values) // least
    parts = others[: count * least].reshape(count, least, 5)
    moves = (parts.std(axis=1) > np.delete(still_limits(limits), axis)).any(axis=1)
    moved = np.concatenate([[0], np.cumsum(np.repeat(moves, least))])
    moved = np.pad(moved, (0, len(values) + 1 - len(moved)), 'edge')
    firsts, lasts = runs((values[1:] == values[:-1]) & ~is_cut[1:])
    lengths = np.sort(np.append(0, moved[lasts + 1] - moved[firsts]))
    beyond = np.flatnonzero(lengths[1:] > np.maximum(STUCK_AXIS_FACTOR * lengths[:-1], least - 1))
    if not len(beyond):
        return np.zeros(len(found.begins), bool)
    is_long = np.asarray(moved[found.ends] - moved[found.begins] >= lengths[beyond[0] + 1])
    elsewhere = values.copy()
    for begin, end in zip(found.begins[is_long], found.ends[is_long], strict=True):
        elsewhere[begin:end] = math.nan
    elsewhere = elsewhere[~np.isnan(elsewhere)]
    # one so coarse that it has few values can have the same for long
    return is_long & (len(np.unique(elsewhere)) >= min(COARSE_LEVELS, len(elsewhere) / 2))


def _moves(samples: np.ndarray, axes: slice, still: np.ndarray) -> bool:
    """Return whether some axes change by more than they would at rest."""
    return bool((samples.std(axis=0) > still)[axes].any())


def stuck_findings(
    stream: SensorStream, stuck: list[Stuck], limits: InspectionLimits
) -> Iterator[Finding]:
    """Yield sensors that are dead, samples that are stuck, and samples that are sent again."""
    yield from _dead(stream, limits)
    yield from _repeated(stream, stuck)
    yield from _resent(stream, stuck, limits)


def measures(stream: SensorStream) -> dict[str, bool]:
    """Return whether gyroscope and accelerometer measure anything but zero."""
    assert stream.numbers is not None
    return {
        'gyroscope': bool(stream.numbers[:, GYRO].any()),
        'accelerometer': bool(stream.numbers[:, ACCEL].any()),
    }


def _dead(stream: SensorStream, limits: InspectionLimits) -> Iterator[Finding]:
    """Yield a sensor that is zero throughout, and that messages do not say to be absent."""
    has = measures(stream)
    for name in has:
        is_dead = any(has.values()) and not has[name]
        if is_dead and len(stream) >= limits.stuck_sensor_samples and name not in stream.lacks:
            yield FINDINGS['stuck'].found(
                stream, 'zero', severe=True, sensor=name, count=len(stream), value=len(stream)
            )


def _repeated(stream: SensorStream, stuck: list[Stuck]) -> Iterator[Finding]:
    """Yield a finding for all axes, one for each sensor, and one for all single axes."""
    for several in (
        *([one] for one in stuck if len(AXES[one.axes]) > 1),
        [one for one in stuck if len(AXES[one.axes]) == 1],
    ):
        if not several:
            continue
        begins = np.concatenate([one.begins for one in several])
        ends = np.concatenate([one.ends for one in several])
        order = np.argsort(begins, kind='stable')
        begins, ends = begins[order], ends[order]
        is_stuck = np.zeros(len(stream), bool)
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            is_stuck[begin + 1 : end] = True  # the first repeats nothing
        yield FINDINGS['stuck'].found(
            stream,
            'repeated',
            severe=True,
            axes=', '.join(named(one.axes) for one in several),
            count=int(is_stuck.sum()),
            value=int((ends - begins).max()) - 1,
            moments=stream.moments(begins, ends - 1),
        )


def _resent(
    stream: SensorStream, stuck: list[Stuck], limits: InspectionLimits
) -> Iterator[Finding]:
    """Yield that samples come again and again, without those that are stuck."""
    assert stream.numbers is not None
    is_same = (stream.numbers[1:] == stream.numbers[:-1]).all(axis=1)
    for one in stuck:
        if one.axes == ALL:
            for begin, end in zip(one.begins.tolist(), one.ends.tolist(), strict=True):
                is_same[begin:end] = False
    if is_same.any() and is_same.mean() > limits.resent_percent / 100:
        which = np.flatnonzero(is_same)
        yield FINDINGS['stuck'].found(
            stream,
            'resent',
            total=len(stream),
            count=len(which),
            value=float(is_same.mean()),
            unit='ratio',
            moments=stream.moments(which, which + 1),
        )
