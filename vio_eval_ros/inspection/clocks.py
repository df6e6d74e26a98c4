"""The clock of the stamps against the clock of the recorder: latency, offset, drift, jitter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np

from vio_eval_ros.inspection.findings import Finding
from vio_eval_ros.inspection.streams import spread, Stream

WINDOWS, LEAST_WINDOWS, MESSAGES_A_WINDOW = 64, 8, 8
LEAST_S = 5.0
# A drift is told where it is more than this, certain, and matters at the end of the recording
DRIFT_PPM, DRIFT_TOTAL_S, DEVIATIONS = 10.0, 0.0002, 4.0
# No quartz drifts as much
REPLAYED_PPM = 1000.0
# What a message may take from sensor to disk, and how early a clock may be without a word
LATEST_S, EARLIEST_S = 1.0, -0.001


@dataclass(frozen=True)
class Clocks:
    """
    Log time minus stamp, of the messages of a stream; NaN where it cannot be told.

    :param latency_median_s: and ``latency_p99_s``: what it is, clocks and transport together.
    :param offset_s: of the lower envelope in the middle of the recording: the difference of the
        clocks and the least time of transport, which no recording can tell apart.
    :param drift_ppm: by how much faster than the stamps the clock of the recorder runs, and
        ``drift_uncertainty_ppm``, its standard deviation.
    :param jitter_s: standard deviation of transport, robust: what is left above the envelope.
    """

    latency_median_s: float
    latency_p99_s: float
    offset_s: float
    drift_ppm: float = math.nan
    drift_uncertainty_ppm: float = math.nan
    jitter_s: float = math.nan
    is_steady: bool = False


def clocks(stream: Stream) -> tuple[Clocks | None, list[Finding]]:
    """Return how the clocks of a stream compare; None where it has but one."""
    if stream.logged_ns is None or stream.stamps_ns is None:
        return None, []
    latencies_ns = stream.logged_ns - stream.stamps_ns
    # differences of years have no nanoseconds left in floating point
    first_ns = int(latencies_ns[0])
    latencies = (latencies_ns - first_ns) / 1e9
    median, p99 = (first_ns / 1e9 + np.quantile(latencies, [0.5, 0.99])).tolist()
    low = first_ns / 1e9 + float(latencies.min())
    figures = _drift(stream, latencies, first_ns / 1e9) or (low,)
    found = Clocks(median, p99, *figures)
    return found, list(_findings(stream, found))


def _drift(
    stream: Stream, latencies: np.ndarray, base_s: float
) -> tuple[float, float, float, float, bool] | None:
    """
    Return offset, drift, its deviation, jitter and whether both halves agree; None if too short.

    Transport can only delay, so the least latency of each of up to 64 windows follows the clocks.
    A line is laid through these by the median of all slopes (Theil and Sen); its uncertainty is
    that of least squares with the spread of what is left, enlarged where neighbours err alike.
    """
    assert stream.stamps_ns is not None
    order = np.argsort(stream.stamps_ns, kind='stable')
    count = min(WINDOWS, len(order) // MESSAGES_A_WINDOW)
    seconds = (stream.stamps_ns[order] - stream.stamps_ns[order[0]]) / 1e9
    if count < LEAST_WINDOWS or seconds[-1] < LEAST_S:
        return None
    latencies = latencies[order]
    edges = np.linspace(0, len(order), count + 1).astype(int)
    lowest = np.array([a + latencies[a:b].argmin() for a, b in pairwise(edges.tolist())])
    x, y = seconds[lowest], latencies[lowest]
    middle = seconds[-1] / 2
    slope = theil_sen(x, y)
    height = float(np.median(y - slope * (x - middle)))
    rest = y - slope * (x - middle) - height
    half = count // 2
    halves = [theil_sen(x[:half], y[:half]), theil_sen(x[half:], y[half:])]
    is_steady = all(slope * part > 0 and 0.3 < part / slope < 3 for part in halves)
    alike = min(max(_autocorrelation(rest), 0.0), 0.9)
    # no better than the clocks resolve
    noise = max(spread(rest), 1e-7) * math.sqrt((1 + alike) / (1 - alike))
    uncertainty = noise / (math.sqrt(count) * float(np.std(x)))
    jitter = spread(latencies - slope * (seconds - middle))
    return base_s + height, 1e6 * slope, 1e6 * uncertainty, jitter, is_steady


def theil_sen(x: np.ndarray, y: np.ndarray) -> float:
    """Return the median of the slopes between all pairs of points of distinct x."""
    i, j = np.triu_indices(len(x), 1)
    apart = x[j] > x[i]
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart])) if apart.any() else 0.0


def _autocorrelation(rest: np.ndarray) -> float:
    square = float(rest @ rest)
    return float(rest[1:] @ rest[:-1]) / square if square else 0.0


def _findings(stream: Stream, found: Clocks) -> Iterator[Finding]:
    duration_s = float(np.ptp(stream.times_ns)) / 1e9
    drift, uncertainty = found.drift_ppm, found.drift_uncertainty_ppm
    if abs(drift) > REPLAYED_PPM:
        yield Finding(
            'replayed', stream.topic, 'info',
            f'the stamps run at {1 / (1 + drift / 1e6):.4g} times the speed of the clock of the '
            'recorder, as in a simulation or a replay',
            value=drift, unit='ppm',
        )  # fmt: skip
        return
    total_s = abs(drift) * duration_s / 1e6
    if (
        abs(drift) > max(DRIFT_PPM, DEVIATIONS * uncertainty)
        and total_s > DRIFT_TOTAL_S
        and found.is_steady
    ):
        yield Finding(
            'clock_drift', stream.topic, 'warn',
            f'the clock of the recorder gains {drift:.1f} ± {1.96 * uncertainty:.1g} ppm on that '
            f'of the stamps, {1e3 * total_s:.3g} ms over the recording',
            value=drift, unit='ppm',
        )  # fmt: skip
    if not EARLIEST_S <= found.offset_s <= LATEST_S:
        early = found.offset_s < 0
        yield Finding(
            'clock_offset', stream.topic, 'info',
            f'stamped {abs(found.offset_s):.4g} s {"after" if early else "before"} it was '
            'recorded, at least: the two clocks differ',
            value=found.offset_s, unit='s',
        )  # fmt: skip
