"""
The first fit: the lag and the convention under which short relative motions agree.

Motion that repeats itself, in laps or along a figure that is the same from two sides, agrees
under several lags. Of those that explain it equally well the one nearest to zero is taken, and
none where that is not much nearer than the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math

from vio_eval_ros.core import rotation
from vio_eval_ros.diagnosis.conventions import find_convention, FoundConvention
from vio_eval_ros.diagnosis.correlation import Peak
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.lag import fit_lag, Lag, speed_peak

#: a lower peak of the correlation is not trusted
TRUSTED_PEAK = 0.6
#: starts closer than this lead to the same lag
SAME_LAG_S = 0.05
#: most other peaks that are tried, those nearest to zero
MOST_OTHERS = 4
#: residual of a fit that explains the motion as well as the best: at most so many times its ...
EQUAL_RATIO = 1.25
#: ... or larger by this
EQUAL_RESIDUAL = 0.01
#: relative motions that agree no better agree under no lag, and may be at another pace
UNRELATED_RESIDUAL = 0.3
#: of the next lag, the share below which a lag is so much nearer to zero that it is the right one
NEAR_SHARE = 0.25
#: rotation of the sensor that another lag may explain as well
ROTATED_RAD = math.radians(20.0)


@dataclass(frozen=True, eq=False)
class FirstFit:
    """
    A lag, and the convention that was found with it.

    :param others_s: lags that explain the motion equally well, where it is open which is right.
    """

    peak: Peak
    convention: FoundConvention
    lag: Lag
    others_s: tuple[float, ...] = ()

    @property
    def residual(self) -> float:
        """What is left of relative motions, over what there was."""
        return self.lag.residual

    @property
    def is_plain(self) -> bool:
        """Whether it needs no wrong convention, and no large rotation of the sensor."""
        turned = float(rotation.angle(self.lag.sensor)) > ROTATED_RAD
        return not (self.convention.convention.name or turned)


def first_fit(run: DiagnosedRun) -> FirstFit:
    """Return the fit of those that explain the motions best whose lag is nearest to zero."""
    peak = speed_peak(run.estimate, run.truth, run.gap_s)
    tried = [_fit(run, peak, start_s) for start_s in _starts(peak)]
    best = min(one.residual for one in tried)
    limit = max(EQUAL_RATIO * best, best + EQUAL_RESIDUAL)
    equal = [one for one in tried if not one.residual > limit] or tried[:1]
    nearest = min(equal, key=lambda one: abs(one.lag.offset_s))
    others = [one for one in equal if not _is_near(one.lag, nearest.lag.offset_s)]
    confusable = best < UNRELATED_RESIDUAL and any(_is_as_likely(one, nearest) for one in others)
    return FirstFit(
        peak,
        nearest.convention,
        nearest.lag,
        tuple(float(one.lag.offset_s) for one in others) if confusable else (),
    )


def _starts(peak: Peak) -> Iterator[float]:
    """Yield lags to begin with: none, the best, and others that may be the right one."""
    if not peak.height > TRUSTED_PEAK:
        yield 0.0
        return
    yield peak.lag_s
    if abs(peak.lag_s) > SAME_LAG_S:
        yield 0.0
    nearest = sorted((lag_s for lag_s in peak.others_s if abs(lag_s) > SAME_LAG_S), key=abs)
    yield from nearest[:MOST_OTHERS]


def _fit(run: DiagnosedRun, peak: Peak, start_s: float) -> FirstFit:
    """Return the convention at a lag, and the lag under it."""
    found = find_convention(run.estimate, run.true_poses, start_s)
    meant = found.convention.undo(run.estimate)
    return FirstFit(
        peak, found, fit_lag(meant, run.true_poses, start_s, by_rotations=run.oriented)
    )


def _is_near(lag: Lag, offset_s: float) -> bool:
    return abs(lag.offset_s - offset_s) < 2 * SAME_LAG_S


def _is_as_likely(other: FirstFit, nearest: FirstFit) -> bool:
    """Return whether a lag is not much larger than the nearest, or needs less to be wrong."""
    near = abs(nearest.lag.offset_s) < NEAR_SHARE * abs(other.lag.offset_s)
    return not near or (other.is_plain and not nearest.is_plain)
