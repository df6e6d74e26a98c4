"""
The pace of an estimate's clock, where it is far from that of the ground truth.

Stamps of the wall clock beside a recording that is played at half or double speed have no lag: the
angular speeds agree once time is stretched. Some seconds of the estimate are stretched by one
pace after the other, and correlated with all of the truth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.intervals import longest_tracked, nanoseconds
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.correlation import correlate
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun

#: of the truth, between samples of the speeds ...
STEP_S = 0.04
#: ... in windows of so many samples, at these shares of the run
WINDOW_SAMPLES, WINDOW_SHARES = 500, (0.25, 0.5, 0.75)
#: paces that are tried, and the factor from one to the next ...
PACES, PACE_FACTOR = (0.1, 10.0), 1.02
#: ... and once the best is known, of a window that is so many times as long
FINE_FACTOR, FINE_STEPS, LONGER = 1.002, 10, 4
#: a correlation that is lower has no pace
TRUSTED_HEIGHT = 0.85
#: the whole truth is searched up to so many samples
MOST_SAMPLES = 1 << 16


class Pace(NamedTuple):
    """
    A pace of the estimate's clock.

    :param ratio: seconds of the estimate to one of the truth.
    :param height: of the correlation under it.
    """

    ratio: float
    height: float

    def undo(self, poses: Trajectory) -> Trajectory:
        """Return the poses with stamps of the pace of the truth; the first keeps its stamp."""
        elapsed = (poses.stamps_ns - poses.stamps_ns[0]) / self.ratio
        return replace(poses, stamps_ns=poses.stamps_ns[0] + np.round(elapsed).astype(np.int64))


def likely_pace(run: DiagnosedRun) -> Pace | None:
    """Return the pace under which parts of the estimate correlate best with the truth, if any."""
    if np.ptp(run.truth.stamps_ns) / 1e9 / STEP_S > MOST_SAMPLES:
        return None
    search = _Search(run)
    count = int(np.log(PACES[1] / PACES[0]) / np.log(PACE_FACTOR)) + 1
    best = search.best(PACES[0] * PACE_FACTOR ** np.arange(count), WINDOW_SAMPLES)
    near = best.ratio * FINE_FACTOR ** np.arange(-FINE_STEPS, FINE_STEPS + 1)
    best = search.best(near, LONGER * WINDOW_SAMPLES)
    return best if best.height > TRUSTED_HEIGHT else None


class _Search:
    """The speeds of the truth, and the poses of the estimate to take those of windows from."""

    def __init__(self, run: DiagnosedRun) -> None:
        interval_s = float(np.median(np.diff(run.estimate.stamps_ns))) / 1e9
        gap_s = longest_tracked(run.config.max_gap_s, interval_s)
        self._stamps_ns = run.estimate.stamps_ns
        self._poses, self._oriented = Interpolator(run.estimate, gap_s), run.oriented
        first_ns, last_ns = run.truth.stamps_ns[[0, -1]].tolist()
        times_ns = np.arange(first_ns, last_ns, nanoseconds(STEP_S))
        self._truth = _speeds(run.true_poses, times_ns, 1.0, run.oriented)

    def best(self, ratios: np.ndarray, samples: int) -> Pace:
        """Return the pace under which a window of so many samples correlates best."""
        return max(
            (
                Pace(ratio, self._height(ratio, share, samples))
                for ratio in ratios.tolist()
                for share in WINDOW_SHARES
            ),
            key=lambda pace: pace.height,
        )

    def _height(self, ratio: float, share: float, samples: int) -> float:
        """Return how well a window about a share of the run correlates with the truth."""
        first_ns, last_ns = self._stamps_ns[[0, -1]].tolist()
        around = ratio * STEP_S * 1e9 * (np.arange(samples) - samples // 2)
        times_ns = np.round(first_ns + share * (last_ns - first_ns) + around).astype(np.int64)
        times_ns = times_ns[(times_ns >= first_ns) & (times_ns <= last_ns)]
        if len(times_ns) < WINDOW_SAMPLES / 2:
            return -1.0
        window = _speeds(self._poses, times_ns, ratio, self._oriented)
        height = correlate(window, self._truth, STEP_S).height
        return height if np.isfinite(height) else -1.0


def _speeds(
    poses: Interpolator, times_ns: np.ndarray, pace: float, by_rotations: bool
) -> np.ndarray:
    """Return (N,) angular or linear speeds at times, NaN where unknown."""
    half = nanoseconds(max(STEP_S * pace, poses.interval_s / 2))
    known = poses.inside(times_ns - half) & poses.inside(times_ns + half)
    before, after = poses.at(times_ns - half), poses.at(times_ns + half)
    if by_rotations:
        assert before.rotations is not None
        assert after.rotations is not None
        speeds = rotation.angle_between(after.rotations, before.rotations)
    else:
        speeds = lengths(after.positions - before.positions)
    return np.where(known, speeds, np.nan)
