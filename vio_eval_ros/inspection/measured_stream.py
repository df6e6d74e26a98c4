"""Every figure that is measured in a stream; the keys of ``streams`` in the JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.sensor_stream import SensorStream


@dataclass(frozen=True, eq=False)
class Timing:
    """
    Figures of the distinct times of a stream, sorted; NaN where there are too few.

    :param rate_hz: by the regression of the times on the number of the message, which counts
        those that are missing, and ``rate_uncertainty_hz``, its standard deviation.
    :param period_s: the median, one of the periods, where half of them are like it; of others
        the mean. ``jitter_*_s`` are of the absolute deviations from it, of intervals in which no
        message is missing.
    :param missing: messages that are missing in all of the intervals that are too long.
    :param gaps: how many of these are long.
    :param duplicates: messages with the stamp of another one, or nearly so.
    :param backward: how often a message is earlier than the one before.
    :param times_s: (M,) of what is drawn, seconds since the first, the ends of ``periods_s``.
    """

    count: int
    first_ns: int
    last_ns: int
    rate_hz: float = math.nan
    rate_uncertainty_hz: float = math.nan
    period_s: float = math.nan
    jitter_median_s: float = math.nan
    jitter_p99_s: float = math.nan
    jitter_max_s: float = math.nan
    is_regular: bool = False
    missing: int = 0
    gaps: int = 0
    longest_s: float = math.nan
    duplicates: int = 0
    backward: int = 0
    times_s: np.ndarray = field(default_factory=lambda: np.empty(0), repr=False)
    periods_s: np.ndarray = field(default_factory=lambda: np.empty(0), repr=False)

    @property
    def duration_s(self) -> float:
        """From the first to the last message."""
        return (self.last_ns - self.first_ns) / 1e9

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for JSON, without the columns."""
        figures = {k: v for k, v in vars(self).items() if not isinstance(v, np.ndarray)}
        return {**figures, 'duration_s': self.duration_s}


@dataclass(frozen=True)
class Clocks:
    """
    Log time minus stamp, of the messages of a stream; NaN where it cannot be determined.

    :param latency_median_s: and ``latency_p99_s``: what it is, clocks and transport together.
    :param offset_s: of the lower envelope in the middle of the recording: the difference of the
        clocks and the least time of transport, which no recording can separate.
    :param drift_ppm: by how much faster than the stamps the clock of the recorder runs, and
        ``drift_uncertainty_ppm``, its standard deviation; NaN where it does not run evenly.
    :param jitter_s: standard deviation of transport, robust: the residual above the envelope.
    :param is_steady: whether the difference changes evenly or not at all.
    """

    latency_median_s: float
    latency_p99_s: float
    offset_s: float
    drift_ppm: float = math.nan
    drift_uncertainty_ppm: float = math.nan
    jitter_s: float = math.nan
    is_steady: bool = False


@dataclass(frozen=True)
class Inertial:
    """
    Figures of the samples of an IMU; NaN where they cannot be determined.

    :param rotation_rms_rad_s: of the angular rate about its principal axes, largest first.
    :param acceleration_m_s2: the standard deviation of the length of the specific force, averaged
        over 0.1 s: rotation does not change it, acceleration across the vertical hardly does.
    :param still_s: how long it stands still in all, and ``still_at_begin_s`` at the beginning.
    :param force_m_s2: specific force while still, its median, and ``gravity_m_s2``, its length.
    :param up: the axis that points up then, such as ``+z``; empty where it never stands still.
    :param up_off_deg: the angle between that axis and the vertical.
    :param stuck: samples that repeat one in all axes, in three, or in one that is stuck.
    :param spikes: samples that stand out from those around.
    """

    rotation_rms_rad_s: tuple[float, float, float]
    acceleration_m_s2: float
    still_s: float
    still_at_begin_s: float
    force_m_s2: tuple[float, float, float]
    gravity_m_s2: float
    up: str
    up_off_deg: float
    stuck: int
    spikes: int
    saturated: int
    not_finite: int


@dataclass(frozen=True)
class PoseMotion:
    """
    Figures of a stream of poses; NaN where they cannot be determined.

    :param path_m: length of the path through all positions.
    :param jumps: how often the position steps aside, and ``turns``, the orientation.
    :param frozen: poses that repeat the one before, in runs of five and more.
    """

    path_m: float
    speed_median_m_s: float
    speed_p99_m_s: float
    rotation_p99_rad_s: float
    jumps: int
    turns: int
    frozen: int
    not_finite: int


@dataclass(frozen=True, eq=False)
class MeasuredStream:
    """A stream with its figures; those that its type does not have are None."""

    stream: SensorStream
    timing: Timing
    clocks: Clocks | None = None
    inertial: Inertial | None = None
    motion: PoseMotion | None = None

    @property
    def is_timed(self) -> bool:
        """Whether it has stamps, and enough of them for a period."""
        return self.stream.stamps_ns is not None and math.isfinite(self.timing.period_s)

    def to_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return {
            'frame_ids': dict(self.stream.frames),
            'timing': self.timing.to_dict(),
            'clocks': self.clocks and vars(self.clocks),
            'inertial': self.inertial and vars(self.inertial),
            'motion': self.motion and vars(self.motion),
        }
