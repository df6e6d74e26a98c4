"""Samples of an IMU that are not measurements: dead, stuck, spikes, cut off at a limit."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import runs, SensorStream, spread
from vio_eval_ros.inspection.finding import are, Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.imu_axes import on_axes, shown
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.saturation import cut_off, saturation_findings
from vio_eval_ros.inspection.stuck import stuck_findings, stuck_runs

#: the most samples that a spike has
SPIKE_SAMPLES = 3
#: deviation of a spike, over the range of the samples around it
SPIKE_RANGES = 10.0
#: samples on either side that are around it: long enough for a shock to ring
SPIKE_SIDE_SAMPLES = 25


class Glitches(NamedTuple):
    """
    What is wrong with the samples of an IMU one by one.

    :param known: (N, 6) the samples, NaN in the axes in which they are not measurements.
    :param stuck: how many repeat the one before, ``spikes`` stand out, ``saturated`` are at a
        limit (which they measured to be at least), and ``not_finite`` are not numbers.
    """

    known: np.ndarray
    stuck: int
    spikes: int
    saturated: int
    not_finite: int
    findings: list[Finding]


def glitches(stream: SensorStream, period_s: float, limits: InspectionLimits) -> Glitches:
    """Return the samples without those that are not measurements, each of which is one fault."""
    assert stream.numbers is not None
    is_finite = stream.is_usable
    known = np.where(is_finite[:, None], stream.numbers, math.nan)
    stuck = stuck_runs(known, limits)
    is_stuck = np.zeros_like(is_finite)
    for one in stuck:
        for begin, end in zip(one.begins.tolist(), one.ends.tolist(), strict=True):
            is_stuck[begin:end] = True
            known[begin + 1 : end, one.axes] = math.nan
    least = on_axes(limits.spike_rate_rad_s, limits.spike_acceleration_m_s2)
    spikes = np.stack([_spikes(known[:, k], least[k]) for k in range(6)], axis=1)
    known[spikes != 0] = math.nan
    saturated = np.stack([cut_off(known[:, k], limits) for k in range(6)], axis=1)
    findings = [
        *_not_finite(stream, is_finite),
        *stuck_findings(stream, stuck, limits),
        *_spike_findings(stream, spikes, period_s, limits),
        *saturation_findings(stream, saturated),
    ]
    return Glitches(
        known=known,
        stuck=int(is_stuck.sum()),
        spikes=int((spikes != 0).any(axis=1).sum()),
        saturated=int(saturated.sum()),
        not_finite=int(np.sum(~is_finite)),
        findings=findings,
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
    harmful = on_axes(limits.spike_angle_rad, limits.spike_speed_m_s)
    begins, ends = runs(is_spike)
    count = int(is_spike.sum())
    yield FINDINGS['spike'].found(
        stream,
        severe=bool((largest * period_s > harmful).any()),
        samples=are(count, 'sample'),
        axes=shown(largest, 'off by'),
        count=count,
        value=float(largest.max()),
        moments=stream.moments(begins, ends - 1),
    )
