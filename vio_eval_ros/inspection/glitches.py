"""Samples of an IMU that are no measurements: dead, stuck, spikes, cut off at a limit."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import LARGEST, runs, SensorStream, spread
from vio_eval_ros.inspection.finding import are, Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import InspectionLimits

AXES = ('gyroscope x', 'gyroscope y', 'gyroscope z',
        'accelerometer x', 'accelerometer y', 'accelerometer z')  # fmt: skip
ALL, GYRO, ACCEL = slice(0, 6), slice(0, 3), slice(3, 6)
# Equal samples in a row are by chance where samples this near to them repeat so often that the run
# has more than this probability in the recording: those of coarse sensors do at rest
NEIGHBOUR_SAMPLES, CHANCE = 50, 1e-3
# A single axis is stuck where a run is so many times as long as the longest by chance, of samples
# in which the others move
STUCK_AXIS_FACTOR = 5.0
# An axis is cut off where its extreme comes more often than all values below it within this part
# of the range, and within so many levels. With fewer levels than that, an axis is coarse: its
# extreme comes often anyway
BELOW_RANGE, BELOW_LEVELS, COARSE_LEVELS = 0.02, 6, 50
# Spikes are at most so many samples, and off those around by so many times the range of as many as
# this on either side, in which a shock rings
SPIKE_SAMPLES, SPIKE_RANGES, SPIKE_SIDE_SAMPLES = 3, 10.0, 25


class Stuck(NamedTuple):
    """
    Runs of equal samples.

    :param axes: in which they are equal.
    :param begins: (K,) where each begins, and ``ends``, the index after its end.
    """

    axes: slice
    begins: np.ndarray
    ends: np.ndarray


class Glitches(NamedTuple):
    """
    What is wrong with the samples of an IMU one by one.

    :param known: (N, 6) the samples, NaN in the axes in which they are no measurements.
    :param stuck: how many repeat the one before, ``spikes`` stand out, ``saturated`` are at a
        limit (which they measured to be at least), and ``not_finite`` are no numbers.
    """

    known: np.ndarray
    stuck: int
    spikes: int
    saturated: int
    not_finite: int
    findings: list[Finding]


def glitches(stream: SensorStream, period_s: float, limits: InspectionLimits) -> Glitches:
    """Return the samples without those that are no measurements, each of which is one fault."""
    assert stream.numbers is not None
    is_finite = stream.is_usable
    known = np.where(is_finite[:, None], stream.numbers, math.nan)
    stuck = _stuck(known, limits)
    is_stuck = np.zeros_like(is_finite)
    for one in stuck:
        for begin, end in zip(one.begins.tolist(), one.ends.tolist(), strict=True):
            is_stuck[begin:end] = True
            known[begin + 1 : end, one.axes] = math.nan
    least = _six(limits.spike_rate_rad_s, limits.spike_acceleration_m_s2)
    spikes = np.stack([_spikes(known[:, k], least[k]) for k in range(6)], axis=1)
    known[spikes != 0] = math.nan
    saturated = np.stack([_cut_off(known[:, k], limits) for k in range(6)], axis=1)
    findings = [
        *_dead(stream, limits),
        *_not_finite(stream, is_finite),
        *_stuck_findings(stream, stuck),
        *_resent(stream, stuck, limits),
        *_spike_findings(stream, spikes, period_s, limits),
        *_saturation(stream, saturated),
    ]
    return Glitches(
        known=known,
        stuck=int(is_stuck.sum()),
        spikes=int((spikes != 0).any(axis=1).sum()),
        saturated=int(saturated.sum()),
        not_finite=int(np.sum(~is_finite)),
        findings=findings,
    )


def _six(gyroscope: float, accelerometer: float) -> np.ndarray:
    """Return a limit of each sensor as one of its three axes each."""
    return np.repeat([gyroscope, accelerometer], 3)


def still_limits(limits: InspectionLimits) -> np.ndarray:
    """Return (6,) the spread of samples at rest, rad/s and m/s²."""
    return _six(limits.still_rate_rad_s, limits.still_acceleration_m_s2)


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


def _not_finite(stream: SensorStream, is_finite: np.ndarray) -> Iterator[Finding]:
    which = np.flatnonzero(~is_finite)
    if len(which):
        yield FINDINGS['not_finite'].found(
            stream,
            samples=are(len(which), 'sample'),
            count=len(which),
            moments=stream.moments(which, which),
        )


def _stuck(numbers: np.ndarray, limits: InspectionLimits) -> list[Stuck]:
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
    is_cut = _limited(numbers[:, axis], limits)
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


def _limited(values: np.ndarray, limits: InspectionLimits) -> np.ndarray:
    """Return which of (N,) values are cut off at a limit that others come near to."""
    is_cut = _cut_off(values, limits)
    for limit in np.unique(values[is_cut]):
        off = np.abs(values - limit)
        if not ((off > 0) & (off < BELOW_RANGE * np.nanmax(off))).any():
            is_cut &= values != limit
    return is_cut


def _moves(samples: np.ndarray, axes: slice, still: np.ndarray) -> bool:
    """Return whether some axes change by more than they would at rest."""
    return bool((samples.std(axis=0) > still)[axes].any())


def _named(axes: slice) -> str:
    names = AXES[axes]
    return {1: names[0], 3: f'the {names[0].split()[0]}', 6: 'all six axes'}[len(names)]


def _stuck_findings(stream: SensorStream, stuck: list[Stuck]) -> Iterator[Finding]:
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
            is_stuck[begin:end] = True
        yield FINDINGS['stuck'].found(
            stream,
            'repeated',
            severe=True,
            axes=', '.join(_named(one.axes) for one in several),
            count=int(is_stuck.sum()),
            value=int((ends - begins).max()),
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


def _spikes(values: np.ndarray, limit: float) -> np.ndarray:
    """Return (N,) by how much values stand out from those around; zero where they do not."""
    found = np.zeros(len(values))
    off = np.abs(values - _around(values))
    is_known = ~np.isnan(off)
    if not is_known.any():
        return found
    is_far = off > max(limit, SPIKE_RANGES * spread(off[is_known]))
    begins, ends = runs(is_far)
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        before = values[max(begin - SPIKE_SIDE_SAMPLES, 0) : begin]
        around = np.append(before, values[end:][:SPIKE_SIDE_SAMPLES])
        around = around[~np.isnan(around)]
        if end - begin > SPIKE_SAMPLES or len(around) < SPIKE_SIDE_SAMPLES:
            continue
        off_by = np.abs(values[begin:end] - np.median(around))
        if off_by.min() > max(limit, SPIKE_RANGES * float(np.ptp(around))):
            found[begin:end] = off_by
    return found


def _around(values: np.ndarray) -> np.ndarray:
    """Return the medians of two values before and two after each, outside its spike."""
    near, far = SPIKE_SAMPLES + 1, SPIKE_SAMPLES + 2
    padded = np.pad(values, far, 'edge')
    count = len(values)
    sides = [padded[far + k : far + k + count] for k in (-far, -near, near, far)]
    return np.sort(sides, axis=0)[1:3].mean(axis=0)


def _spike_findings(
    stream: SensorStream, spikes: np.ndarray, period_s: float, limits: InspectionLimits
) -> Iterator[Finding]:
    is_spike = (spikes != 0).any(axis=1)
    if not is_spike.any():
        return
    largest = spikes.max(axis=0)
    harmful = _six(limits.spike_angle_rad, limits.spike_speed_m_s)
    begins, ends = runs(is_spike)
    count = int(is_spike.sum())
    yield FINDINGS['spike'].found(
        stream,
        severe=bool((largest * period_s > harmful).any()),
        samples=are(count, 'sample'),
        axes=_shown(largest, 'off by'),
        count=count,
        value=float(largest.max()),
        moments=stream.moments(begins, ends - 1),
    )


def _cut_off(values: np.ndarray, limits: InspectionLimits) -> np.ndarray:
    """Return which of (N,) values are at a limit of what the axis can measure."""
    is_cut = np.zeros(len(values), bool)
    known = values[np.abs(values) < LARGEST]
    values_there = np.unique(known)
    if len(values_there) < COARSE_LEVELS:
        return is_cut
    # the crest of a smooth motion fills the levels below as well, however coarse they are
    level = float(np.median(np.diff(values_there)))
    width = max(BELOW_RANGE * float(np.ptp(known)), BELOW_LEVELS * level)
    is_fine = len(values_there) > len(known) / 2  # then not even a crest is twice the same
    for side in (1, -1):
        extreme = (side * known).max()
        is_at = side * values == extreme
        below = np.count_nonzero(side * known >= extreme - width) - is_at.sum()
        begins, ends = runs(is_at)
        least = limits.saturation_samples if is_fine else max(limits.saturation_samples, below)
        in_a_row = (ends - begins).max(initial=0)
        if is_at.sum() >= least and in_a_row >= limits.saturation_run_samples:
            is_cut |= is_at
    return is_cut


def _saturation(stream: SensorStream, saturated: np.ndarray) -> Iterator[Finding]:
    assert stream.numbers is not None
    is_cut = np.asarray(saturated.any(axis=1))
    if not is_cut.any():
        return
    begins, ends = runs(is_cut)
    at = np.array(
        [np.abs(stream.numbers[which, k]).max(initial=0) for k, which in enumerate(saturated.T)]
    )
    count = int(is_cut.sum())
    yield FINDINGS['saturation'].found(
        stream,
        samples=are(count, 'sample'),
        axes=_shown(at, 'at'),
        count=count,
        value=float(at.max()),
        moments=stream.moments(begins, ends - 1),
    )


def _shown(figures: np.ndarray, words: str) -> str:
    """Return the figures of those of the six axes where there is one."""
    return ', '.join(
        f'{axis} {words} {figure:.4g} {"rad/s" if axis.startswith("gyro") else "m/s2"}'
        for axis, figure in zip(AXES, figures.tolist(), strict=True)
        if figure
    )
