"""Samples of an IMU that are no measurements: dead, stuck, spikes, cut off at a limit."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import LARGEST, runs, SensorStream, spread
from vio_eval_ros.inspection.findings import are, Finding

AXES = ('gyroscope x', 'gyroscope y', 'gyroscope z',
        'accelerometer x', 'accelerometer y', 'accelerometer z')  # fmt: skip
ALL, GYRO, ACCEL = slice(0, 6), slice(0, 3), slice(3, 6)
# The spread of samples at rest, rad/s and m/s²
STILL_LIMITS = np.array([0.02] * 3 + [0.15] * 3)
# Samples in a row that are the same: of all six axes, of three of them, of one. More where samples
# just before or behind repeat as well, as those of coarse sensors do at rest
STUCK_SAMPLES, STUCK_HALF, STUCK_AXIS, AROUND, BY_CHANCE = 5, 10, 50, 50, 1e-3
# A single axis is stuck for so many times what it usually repeats, of samples while others move
LONGER = 5.0
REPEATED = 0.1
# An axis is cut off where its extreme comes this often, and that many times in a row, and more
# often than all values within 2 % of the range, and some levels, below it; of a coarse axis that
# says nothing
CUT_OFF, CUT_OFF_IN_A_ROW, BELOW, LEVELS_BELOW, COARSE = 5, 3, 0.02, 6, 50
# Spikes: up to three samples that are off those around by so many times the range of the 25 on
# either side, in which a shock rings, and by what noise is not; bad where the speed or the angle
# that is integrated of one is off by this
SPIKE_SAMPLES, SPIKE_RANGES, SPIKE_SIDE = 3, 10.0, 25
SPIKE_LIMITS = np.array([1.0] * 3 + [5.0] * 3)
SPIKE_HARM = np.array([0.1] * 3 + [0.5] * 3)

# axes, where each run of samples begins, and the index behind its end
Stuck = tuple[slice, np.ndarray, np.ndarray]


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


def glitches(stream: SensorStream, period_s: float) -> Glitches:
    """Return the samples without those that are no measurements, each of which is one fault."""
    assert stream.numbers is not None
    is_finite = stream.is_usable
    known = np.where(is_finite[:, None], stream.numbers, math.nan)
    stuck = _stuck(known)
    is_stuck = np.zeros_like(is_finite)
    for axes, begins, ends in stuck:
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            is_stuck[begin:end] = True
            known[begin + 1 : end, axes] = math.nan
    spikes = np.stack([_spikes(known[:, k], SPIKE_LIMITS[k]) for k in range(6)], axis=1)
    known[spikes != 0] = math.nan
    saturated = np.stack([_cut_off(known[:, k]) for k in range(6)], axis=1)
    findings = [
        *_dead(stream),
        *_not_finite(stream, is_finite),
        *_stuck_findings(stream, stuck),
        *_spike_findings(stream, spikes, period_s),
        *_saturation(stream, saturated),
    ]
    return Glitches(
        known,
        int(is_stuck.sum()),
        int((spikes != 0).any(axis=1).sum()),
        int(saturated.sum()),
        int(np.sum(~is_finite)),
        findings,
    )


def measures(stream: SensorStream) -> dict[str, bool]:
    """Return whether gyroscope and accelerometer measure anything but zero."""
    assert stream.numbers is not None
    return {
        'gyroscope': bool(stream.numbers[:, GYRO].any()),
        'accelerometer': bool(stream.numbers[:, ACCEL].any()),
    }


def _dead(stream: SensorStream) -> Iterator[Finding]:
    """Yield a sensor that is zero throughout, and that messages do not say to be absent."""
    has = measures(stream)
    for name in has:
        is_dead = any(has.values()) and not has[name] and len(stream) >= STUCK_HALF
        if is_dead and name not in stream.lacks:
            yield Finding(
                'stuck', stream.topic, 'fail',
                f'the {name} is zero throughout; where there is none, its covariance begins '
                'with -1',
                len(stream), len(stream), 'samples',
            )  # fmt: skip


def _not_finite(stream: SensorStream, is_finite: np.ndarray) -> Iterator[Finding]:
    if not is_finite.all():
        which = np.flatnonzero(~is_finite)
        yield Finding(
            'not_finite', stream.topic, 'fail', f'{are(len(which), "sample")} not finite',
            len(which), moments=stream.moments(which, which),
        )  # fmt: skip


def _stuck(numbers: np.ndarray) -> list[Stuck]:
    """
    Return where samples repeat the one before: in all axes, in three, or in one.

    Three axes, or one, can be at rest; they are stuck where the others move meanwhile.
    """
    found: list[Stuck] = []
    for axes, least in ((ALL, STUCK_SAMPLES), (GYRO, STUCK_HALF), (ACCEL, STUCK_HALF)):
        others = None if axes is ALL else ACCEL if axes is GYRO else GYRO
        if axes is not ALL and not numbers[:, axes].any():
            continue  # it is dead, or not there
        begins, ends = _repeats(numbers, axes, least, others)
        new = [not any(_within(begin, one) for one in found) for begin in begins.tolist()]
        found.append((axes, begins[new], ends[new]))
    wider = [*found]
    for axis in range(6):
        axes = slice(axis, axis + 1)
        if not numbers[:, GYRO if axis < 3 else ACCEL].any():
            continue
        begins, ends = _repeats(numbers, axes, STUCK_AXIS, ALL)
        if not len(begins):
            continue
        is_cut = _limited(numbers[:, axis])
        is_long = _longer(numbers, axis, is_cut, begins, ends)
        new = [
            long and not is_cut[begin] and not any(_within(begin, one) for one in wider)
            for begin, long in zip(begins.tolist(), is_long.tolist(), strict=True)
        ]
        found.append((axes, begins[new], ends[new]))
    return [one for one in found if len(one[1])]


def _within(begin: int, stuck: Stuck) -> bool:
    """Return whether a run begins in another one, which says it already."""
    return bool(((stuck[1] <= begin) & (begin < stuck[2])).any())


def _repeats(
    numbers: np.ndarray, axes: slice, least: int, others: slice | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return runs of samples that are the same in some axes, by more than chance."""
    is_same = (numbers[1:, axes] == numbers[:-1, axes]).all(axis=1)
    begins, ends = runs(is_same)
    long = ends + 1 - begins >= least
    kept = []
    for begin, end in zip(begins[long].tolist(), ends[long].tolist(), strict=True):
        before = is_same[max(begin - AROUND, 0) : max(begin - 1, 0)]
        behind = is_same[end + 1 : end + AROUND]
        often = max((float(part.mean()) for part in (before, behind) if len(part)), default=0.0)
        if 0 < often < 1 and (end - begin) * math.log(often) > math.log(BY_CHANCE / len(numbers)):
            continue
        if often < 1 and (others is None or _moves(numbers[begin : end + 1], others)):
            kept.append((begin, end + 1))
    found = np.array(kept, int).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _longer(
    numbers: np.ndarray, axis: int, is_cut: np.ndarray, begins: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """
    Return which runs of an axis are longer than it repeats elsewhere, while the others move.

    Lengths of runs by chance have no gap between them: those of what is stuck are behind one.
    """
    values, others = numbers[:, axis], np.delete(numbers, axis, axis=1)
    count = len(values) // STUCK_AXIS
    parts = others[: count * STUCK_AXIS].reshape(count, STUCK_AXIS, 5)
    moves = (parts.std(axis=1) > np.delete(STILL_LIMITS, axis)).any(axis=1)
    moved = np.concatenate([[0], np.cumsum(np.repeat(moves, STUCK_AXIS))])
    moved = np.pad(moved, (0, len(values) + 1 - len(moved)), 'edge')
    firsts, lasts = runs((values[1:] == values[:-1]) & ~is_cut[1:])
    lengths = np.sort(np.append(0, moved[lasts + 1] - moved[firsts]))
    behind = np.flatnonzero(lengths[1:] > np.maximum(LONGER * lengths[:-1], STUCK_AXIS - 1))
    if not len(behind):
        return np.zeros(len(begins), bool)
    is_long = np.asarray(moved[ends] - moved[begins] >= lengths[behind[0] + 1])
    elsewhere = values.copy()
    for begin, end in zip(begins[is_long].tolist(), ends[is_long].tolist(), strict=True):
        elsewhere[begin:end] = math.nan
    elsewhere = elsewhere[~np.isnan(elsewhere)]
    # one so coarse that it has few values can have the same for long
    return is_long & (len(np.unique(elsewhere)) >= min(COARSE, len(elsewhere) / 2))


def _limited(values: np.ndarray) -> np.ndarray:
    """Return which of (N,) values are cut off, where that is no value that others are far from."""
    is_cut = _cut_off(values)
    for limit in np.unique(values[is_cut]):
        off = np.abs(values - limit)
        if not ((off > 0) & (off < BELOW * np.nanmax(off))).any():
            is_cut &= values != limit
    return is_cut


def _moves(samples: np.ndarray, axes: slice) -> bool:
    """Return whether some axes change by more than they would at rest."""
    return bool((samples.std(axis=0) > STILL_LIMITS)[axes].any())


def _named(axes: slice) -> str:
    names = AXES[axes]
    return {1: names[0], 3: f'the {names[0].split()[0]}', 6: 'all six axes'}[len(names)]


def _stuck_findings(stream: SensorStream, stuck: list[Stuck]) -> Iterator[Finding]:
    for several in (
        *([one] for one in stuck if len(AXES[one[0]]) > 1),
        [one for one in stuck if len(AXES[one[0]]) == 1],
    ):
        if not several:
            continue
        begins, ends = (np.concatenate([one[k] for one in several]) for k in (1, 2))
        order = np.argsort(begins, kind='stable')
        begins, ends = begins[order], ends[order]
        is_stuck = np.zeros(len(stream), bool)
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            is_stuck[begin:end] = True
        count, longest = int(is_stuck.sum()), int((ends - begins).max())
        yield Finding(
            'stuck', stream.topic, 'fail',
            f'{count} samples repeat the one before in '
            f'{", ".join(_named(axes) for axes, _, _ in several)}, up to {longest} in a row',
            count, longest, 'samples', stream.moments(begins, ends - 1),
        )  # fmt: skip
    assert stream.numbers is not None
    is_same = (stream.numbers[1:] == stream.numbers[:-1]).all(axis=1)
    for axes, begins, ends in stuck:
        if axes is ALL:
            for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
                is_same[begin:end] = False
    if is_same.any() and is_same.mean() > REPEATED:
        which = np.flatnonzero(is_same)
        yield Finding(
            'stuck', stream.topic, 'warn',
            f'{len(which)} of {len(stream)} samples are those before: a slower sensor, sent again',
            len(which), float(is_same.mean()), 'ratio', stream.moments(which, which + 1),
        )  # fmt: skip


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
        around = np.append(values[max(begin - SPIKE_SIDE, 0) : begin], values[end:][:SPIKE_SIDE])
        around = around[~np.isnan(around)]
        if end - begin > SPIKE_SAMPLES or len(around) < SPIKE_SIDE:
            continue
        off_by = np.abs(values[begin:end] - np.median(around))
        if off_by.min() > max(limit, SPIKE_RANGES * float(np.ptp(around))):
            found[begin:end] = off_by
    return found


def _around(values: np.ndarray) -> np.ndarray:
    """Return the medians of two values before and two behind each, which its spike is not in."""
    near, far = SPIKE_SAMPLES + 1, SPIKE_SAMPLES + 2
    padded = np.pad(values, far, 'edge')
    count = len(values)
    sides = [padded[far + k : far + k + count] for k in (-far, -near, near, far)]
    return np.sort(sides, axis=0)[1:3].mean(axis=0)


def _spike_findings(
    stream: SensorStream, spikes: np.ndarray, period_s: float
) -> Iterator[Finding]:
    is_spike = (spikes != 0).any(axis=1)
    if not is_spike.any():
        return
    largest = spikes.max(axis=0)
    harm = largest * period_s > SPIKE_HARM
    begins, ends = runs(is_spike)
    yield Finding(
        'spike', stream.topic, 'fail' if harm.any() else 'warn',
        f'{are(int(is_spike.sum()), "sample")} unlike those before and behind: '
        f'{_shown(largest, "off by")}',
        int(is_spike.sum()), float(largest.max()), '', stream.moments(begins, ends - 1),
    )  # fmt: skip


def _cut_off(values: np.ndarray) -> np.ndarray:
    """Return which of (N,) values are at a limit of what the axis can measure."""
    is_cut = np.zeros(len(values), bool)
    known = values[np.abs(values) < LARGEST]
    values_there = np.unique(known)
    if len(values_there) < COARSE:
        return is_cut
    # the crest of a smooth motion fills the levels below as well, however coarse they are
    width = max(
        BELOW * float(np.ptp(known)), LEVELS_BELOW * float(np.median(np.diff(values_there)))
    )
    is_fine = len(values_there) > len(known) / 2  # then not even a crest is twice the same
    for side in (1, -1):
        extreme = (side * known).max()
        is_at = side * values == extreme
        below = np.count_nonzero(side * known >= extreme - width) - is_at.sum()
        begins, ends = runs(is_at)
        if (
            is_at.sum() >= (CUT_OFF if is_fine else max(CUT_OFF, below))
            and (ends - begins).max(initial=0) >= CUT_OFF_IN_A_ROW
        ):
            is_cut |= is_at
    return is_cut


def _saturation(stream: SensorStream, saturated: np.ndarray) -> Iterator[Finding]:
    assert stream.numbers is not None
    is_cut = saturated.any(axis=1)
    if not is_cut.any():
        return
    begins, ends = runs(is_cut)
    limits = np.array(
        [np.abs(stream.numbers[which, k]).max(initial=0) for k, which in enumerate(saturated.T)]
    )
    yield Finding(
        'saturation', stream.topic, 'fail',
        f'{are(int(is_cut.sum()), "sample")} cut off at a limit: {_shown(limits, "at")}',
        int(is_cut.sum()), float(limits.max()), '', stream.moments(begins, ends - 1),
    )  # fmt: skip


def _shown(figures: np.ndarray, words: str) -> str:
    """Return the figures of those of the six axes where there is one."""
    return ', '.join(
        f'{axis} {words} {figure:.4g} {"rad/s" if axis.startswith("gyro") else "m/s2"}'
        for axis, figure in zip(AXES, figures.tolist(), strict=True)
        if figure
    )
