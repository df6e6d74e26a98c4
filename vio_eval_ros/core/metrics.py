"""
The families of metrics: one class each, one line in METRICS.

Every family gives flat names ``<metric>_<quantity>_<statistic>_<unit>``; the same names come with
NaN where there is no data. The rotation A = R_g R_eᵀ of each pair (``Pairs.rotations``) carries
all errors of orientation: the absolute error is the angle between the alignment's R and A.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Alignment, MIN_EXTENT_M, Moments, solve
from vio_eval_ros.core.angles import AngleMoments
from vio_eval_ros.core.config import Delta, EvaluationConfig, plain
from vio_eval_ros.core.intervals import longest_tracked, nanoseconds
from vio_eval_ros.core.metric import Metric, MetricValues, named, Observations
from vio_eval_ros.core.relative import (
    candidates,
    ErrorMoments,
    POSITION_KINDS,
    progress_along,
    relative_errors,
    RelativeMotions,
    RPE_KINDS,
    segment_errors,
)
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.statistics import root_mean_square
from vio_eval_ros.core.trajectory import blocks, Pairs
from vio_eval_ros.errors import ConfigError

ALWAYS_ALIGNED = ('none', 'posyaw', 'se3', 'sim3')
MAX_GAIN = 1.05
#: share of a run that is worth a sentence
MUCH_OF_A_RUN = 0.1
KITTI_LENGTHS_M = tuple(range(100, 900, 100))


def position_errors(pairs: Pairs, alignment: Alignment) -> np.ndarray:
    """Return the (N,) metres |s R e + t - g|."""
    errors = np.empty(len(pairs))
    for part in blocks(len(pairs)):
        aligned = alignment.positions(pairs.estimate.positions[part])
        errors[part] = lengths(aligned - pairs.ground_truth.positions[part])
    return errors


def rotation_errors(pairs: Pairs, alignment: Alignment) -> np.ndarray:
    """Return the (N,) degrees of (R R_e)ᵀ R_g; NaN without orientations or a known R."""
    if pairs.rotations is None or not alignment.observable:
        return np.full(len(pairs), math.nan)
    errors = np.empty(len(pairs))
    for part in blocks(len(pairs)):
        errors[part] = rotation.angle_between(pairs.rotations[part], alignment.rotation)
    return np.degrees(errors)


class Ate(Metric):
    """Absolute errors of position and orientation under the alignment (Sturm et al. 2012)."""

    def __init__(self, config: EvaluationConfig) -> None:
        super().__init__(config)
        self._angles: AngleMoments | None = None

    def final(self, observed: Observations) -> MetricValues:
        """Return all statistics under the chosen alignment, the RMSE under the usual ones."""
        sample, alignment = observed.sample, observed.alignment
        errors = position_errors(sample, alignment)
        return MetricValues(
            named('ate_trans', 'm', errors)
            | named('ate_rot', 'deg', rotation_errors(sample, alignment))
            | _usual_alignments(
                observed, lambda usual: root_mean_square(position_errors(sample, usual))
            )
            | {'ate_extent_ratio': _over_extent(root_mean_square(errors), observed.moments)}
        )

    def running(self, observed: Observations) -> dict[str, float]:
        """Return the RMSE in closed form, at the same cost for any number of pairs."""
        moments = observed.moments
        rmse = math.sqrt(observed.alignment.mean_square(moments))
        return (
            {'ate_trans_rmse_m': rmse, 'ate_rot_rmse_deg': self._rotation_rmse(observed)}
            | _usual_alignments(observed, lambda usual: math.sqrt(usual.mean_square(moments)))
            | {'ate_extent_ratio': _over_extent(rmse, moments)}
        )

    def _rotation_rmse(self, observed: Observations) -> float:
        """Return the RMSE of angles; where R has moved too far, from moments about the new R."""
        aligned, log = observed.alignment.invertible().rotation, observed.log
        known = self._angles or AngleMoments.of(np.empty((0, 4)), aligned)
        new = log.received_since(known.count).rotations
        if new is None:
            return math.nan
        known = known.merge(AngleMoments.of(new, known.reference))
        self._angles = known
        if not observed.alignment.observable or not observed.pairs.oriented:
            return math.nan
        if not known.is_exact_for(aligned):
            if log.dropped:  # too far from where the moments were taken, and few pairs are left
                return root_mean_square(rotation_errors(observed.sample, observed.alignment))
            rotations = observed.pairs.rotations
            assert rotations is not None
            known = self._angles = AngleMoments.of(rotations, aligned)
        return math.degrees(math.sqrt(known.mean_square(aligned)))


def _usual_alignments(
    observed: Observations, rmse: Callable[[Alignment], float]
) -> dict[str, float]:
    """Return the RMSE under the alignments that are always given, and the scale of sim3."""
    first = observed.pairs[:1]
    usual = {mode: solve(mode, observed.moments, first) for mode in ALWAYS_ALIGNED}
    return {f'ate_{mode}_trans_rmse_m': rmse(alignment) for mode, alignment in usual.items()} | {
        'sim3_scale': usual['sim3'].scale
    }


def _over_extent(rmse: float, moments: Moments) -> float:
    """Return an RMSE over the RMS distance of the ground truth from its mean."""
    square = float(np.trace(moments.truth_scatter)) / max(moments.count, 1)
    return rmse / math.sqrt(square) if square > MIN_EXTENT_M**2 else math.nan


class Rpe(Metric):
    """Relative errors over each delta: of pose, rotation, displacement and distance."""

    def __init__(self, config: EvaluationConfig) -> None:
        super().__init__(config)
        self._deltas = [Delta.parse(text) for text in config.rpe_deltas]
        if config.needs_path:
            raise ConfigError(
                'rpe_deltas: a share of the path, such as 10%, is known only once a run is over; '
                'give metres, such as 10m'
            )
        self._running = [RunningRpe(delta, config) for delta in self._deltas]

    def final(self, observed: Observations) -> MetricValues:
        """Return all statistics of the four kinds of error, and how many there are."""
        metrics: dict[str, float] = {}
        warnings: list[str] = []
        pairs = observed.log.since(0)
        gaps = Gaps.between(pairs, self.config)
        for delta in self._deltas:
            found = candidates(progress_along(pairs, delta.unit), delta, self.config)
            begin, end = found.begin[found.usable], found.end[found.usable]
            errors = relative_errors(pairs, begin, end, observed.alignment)
            for (kind, unit), row in zip(RPE_KINDS.items(), errors, strict=True):
                metrics |= named(f'rpe_{delta}_{kind}', unit, row)
            metrics[f'rpe_{delta}_pairs'] = len(begin)
            if not len(begin):
                warnings.append(f'rpe_{delta}: no two pairs are {delta} apart')
            # motions over a time take that time, whatever there is between
            elif delta.unit != 's' and (bridging := gaps.bridged(begin, end)):
                warnings.append(
                    f'rpe_{delta}: {bridging} of {len(begin)} relative motions bridge a gap '
                    f'longer than {gaps.limit_s:g} s'
                )
        return MetricValues(metrics, tuple(warnings))

    def running(self, observed: Observations) -> dict[str, float]:
        """Return the RMSE of the four kinds over the relative motions decided so far."""
        metrics: dict[str, float] = {}
        for series in self._running:
            metrics |= series.update(observed)
        return metrics


class RunningRpe:
    """The RMSE of relative errors over one delta, kept up to date as pairs arrive."""

    def __init__(self, delta: Delta, config: EvaluationConfig) -> None:
        self._delta = delta
        self._config = config
        self._next = 0
        self._mark = 0.0
        self._moments: ErrorMoments | None = None

    def update(self, observed: Observations) -> dict[str, float]:
        """Take in what the pairs since the last call decide; return the values."""
        if self._next < observed.log.first_of_all:  # waited too long for a delta to be over
            self._next, self._mark = observed.log.first_of_all, 0.0
        pairs = observed.log.received_since(self._next)
        along = progress_along(observed.log.since(self._next), self._delta.unit)
        found = candidates(along, self._delta, self._config, self._mark)
        # no pair to come can be nearer to a place that has been reached; the rest may change
        decided = int(np.searchsorted(found.target, along[-1], side='right')) if len(along) else 0
        reference = (
            observed.alignment.invertible() if self._moments is None else self._moments.reference
        )
        parts = []
        for usable in (
            found.usable[:decided].nonzero()[0],
            found.usable[decided:].nonzero()[0] + decided,
        ):
            motion = RelativeMotions.between(pairs, found.begin[usable], found.end[usable])
            parts.append(ErrorMoments.of(motion, reference))
        if parts[0].count:
            self._moments = parts[0] if self._moments is None else self._moments + parts[0]
        if self._config.rpe_pairs == 'all':
            self._next += decided
        elif decided:
            last = found.end[decided - 1]
            self._mark = float(found.target[decided - 1] - along[last])
            self._next += int(last)
        moments = parts[1] if self._moments is None else self._moments + parts[1]
        known = RPE_KINDS if observed.pairs.oriented else POSITION_KINDS
        return {
            f'rpe_{self._delta}_{kind}_rmse_{unit}': moments.rmse(kind, observed.alignment)
            if kind in known
            else math.nan
            for kind, unit in RPE_KINDS.items()
        } | {f'rpe_{self._delta}_pairs': moments.count}


class Segments(Metric):
    """Drift over lengths of path, as the KITTI benchmark measures it (Geiger et al. 2012)."""

    def final(self, observed: Observations) -> MetricValues:
        """Return the mean drift over each length, and the KITTI mean over 100 to 800 m."""
        pairs, scale = observed.log.since(0), observed.alignment.scale
        path = progress_along(pairs, 'm')

        def drift(name: str, lengths_m: tuple[float, ...]) -> dict[str, float]:
            errors = [segment_errors(pairs, scale, path, length) for length in lengths_m]
            position, orientation = np.hstack(errors)
            return {
                f'{name}_trans_percent': 100 * _mean(position),
                f'{name}_rot_deg_per_m': _mean(orientation),
                f'{name}_segments': len(position),
            }

        metrics: dict[str, float] = {}
        warnings = []
        gaps = Gaps.between(pairs, self.config)
        for length in self.config.segment_lengths_m:
            name = f'segment_{plain(length)}m'
            metrics |= drift(name, (length,))
            if len(pairs) and not metrics[f'{name}_segments']:
                warnings.append(
                    f'{name} is null: the path of {path[-1]:.4g} m has no segment of that length'
                )
        metrics |= drift('kitti', KITTI_LENGTHS_M)
        measured = [
            name.removesuffix('_segments')
            for name, count in metrics.items()
            if name.endswith('_segments') and count
        ]
        if gaps.count and measured:
            warnings.append(
                f'{", ".join(measured)}: segments may bridge gaps longer than {gaps.limit_s:g} s'
            )
        return MetricValues(metrics, tuple(warnings))


class PathLength(Metric):
    """How far the ground truth moved, and how far off the estimate ended relative to that."""

    def __init__(self, config: EvaluationConfig) -> None:
        super().__init__(config)
        self._length_m = 0.0
        self._last = 0

    def final(self, observed: Observations) -> MetricValues:
        """
        Return the ground truth's path over the pairs, and the drift at the end in percent of it.

        The drift is the relative error from the first pair to the last: of the pose, or without
        orientations of the displacement.
        """
        pairs, tracking = observed.pairs, observed.tracking
        path = progress_along(pairs, 'm')
        values = _drift(observed, float(path[-1]) if len(path) > 1 else math.nan)
        gaps = Gaps.between(pairs, self.config)
        warnings = []
        if tracking.hole_ratio > MUCH_OF_A_RUN:
            warnings.append(
                'path_length_m and drift_percent are null: for '
                f'{100 * tracking.hole_ratio:.0f} % of the time there is a gap longer than '
                f'{tracking.hole_s:g} s in the ground truth, and its path there is not known'
            )
        elif gaps.count:
            warnings.append(
                f'path_length_m and drift_percent: {gaps.count} gap{"s" * (gaps.count != 1)} '
                f'between pairs longer than {gaps.limit_s:g} s counted as straight lines'
            )
        if not math.isnan(tracking.truth_period_s):
            warnings.append(
                'path_length_m, drift_percent and distances in metres: the ground truth has a '
                f'pose every {tracking.truth_period_s:.3g} s only, and straight lines between '
                'those are shorter than the path'
            )
        return MetricValues(values, tuple(warnings))

    def running(self, observed: Observations) -> dict[str, float]:
        """Return the same, adding only the path since the last call."""
        if observed.log.count < 2:
            return _drift(observed, math.nan)
        self._length_m += float(progress_along(observed.log.since(self._last), 'm')[-1])
        self._last = observed.log.count - 1
        return _drift(observed, self._length_m)


def _drift(observed: Observations, length_m: float) -> dict[str, float]:
    drift = math.nan
    if observed.tracking.hole_ratio > MUCH_OF_A_RUN:
        length_m = math.nan
    if length_m > 0:
        ends = observed.pairs[[0, -1]]
        whole = RelativeMotions.between(ends, np.array([0]), np.array([1]))
        kind = 'trans' if ends.oriented else 'disp'
        errors = dict(zip(RPE_KINDS, whole.errors(observed.alignment)[:, 0], strict=True))
        drift = 100 * float(errors[kind]) / length_m
    return {'path_length_m': length_m, 'drift_percent': drift}


@dataclass(frozen=True, eq=False)
class Gaps:
    """
    Intervals between pairs that are much longer than usual.

    :param limit_s: above which they are.
    :param passed: (N,) how many lie before each pair.
    """

    limit_s: float
    passed: np.ndarray

    @classmethod
    def between(cls, pairs: Pairs, config: EvaluationConfig) -> Gaps:
        """Return the gaps of N pairs."""
        intervals = np.diff(pairs.estimate.stamps_ns)
        if not len(intervals):
            return cls(config.max_gap_s, np.zeros(len(pairs), np.int64))
        gap_ns = nanoseconds(config.max_gap_s)
        limit_ns = longest_tracked(gap_ns, float(np.median(intervals)))
        return cls(limit_ns / 1e9, np.concatenate([[0], np.cumsum(intervals > limit_ns)]))

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.passed[-1]) if len(self.passed) else 0

    def bridged(self, begin: np.ndarray, end: np.ndarray) -> int:
        """Return how many of (M,) motions between pairs bridge a gap."""
        return int(np.count_nonzero(self.passed[end] > self.passed[begin]))


class Nees(Metric):
    """Whether the estimate's own covariance is consistent with its errors: 3 is ideal."""

    def final(self, observed: Observations) -> MetricValues:
        """Return the mean squares of position and orientation errors over their covariance."""
        sample, alignment = observed.sample, observed.alignment
        position = orientation = math.nan
        warnings: list[str] = []
        if sample.deviations is not None and alignment.observable and alignment.scale > 0:
            back = rotation.conjugate(alignment.rotation)
            truth = sample.ground_truth.positions - alignment.translation
            error = rotation.rotate(back, truth) / alignment.scale - sample.estimate.positions
            position = _nees('position', sample, error, warnings)
            if any(self.config.estimate_to_body[:3]):
                warnings.append('nees_position_mean is null: estimate_to_body has a lever arm')
            if sample.rotations is not None:
                error = rotation.to_rotation_vector(rotation.multiply(back, sample.rotations))
                orientation = _nees('orientation', sample, error, warnings)
        values = {'nees_position_mean': position, 'nees_orientation_mean': orientation}
        return MetricValues(values, tuple(warnings))


def _nees(name: str, sample: Pairs, errors: np.ndarray, warnings: list[str]) -> float:
    """Return the mean of |L⁻¹ e|² over the pairs with a positive definite covariance L Lᵀ."""
    block = ('position', 'orientation').index(name)
    deviations = sample.deviations_or_nan()[:, block].astype(float)
    usable = ~np.isnan(deviations[:, 0])
    unusable = len(usable) - int(np.count_nonzero(usable))
    if 0 < unusable < len(usable):
        warnings.append(
            f'nees_{name}: left out {unusable} of {len(usable)} covariances, which are not '
            'positive definite'
        )
    (xx, yx, yy, zx, zy, zz), e = deviations[usable].T, errors[usable].T
    x = e[0] / xx
    y = (e[1] - yx * x) / yy
    z = (e[2] - zx * x - zy * y) / zz
    return _mean(x**2 + y**2 + z**2)


class Coverage(Metric):
    """How much of the run was evaluated at all: the condition of every other number."""

    def final(self, observed: Observations) -> MetricValues:
        """Return the shares that were tracked and paired, and when the estimate began."""
        found = observed.tracking
        warnings = []
        if math.isnan(found.coverage_ratio) and observed.log.count:
            warnings.append('coverage_ratio is null: the ground truth has fewer than two poses')
        if found.tracked_ratio - found.coverage_ratio > MUCH_OF_A_RUN:
            warnings.append(
                f'the estimate begins {found.initialisation_s:.3g} s after the ground truth: '
                f'coverage_ratio is over all of it, tracked_ratio from then on'
            )
        return MetricValues(self.running(observed), tuple(warnings))

    def running(self, observed: Observations) -> dict[str, float]:
        """Return the same over the run so far."""
        return observed.tracking.ratios()


class Revisions(Metric):
    """What a system gained by revising its past, as a loop closure does."""

    def final(self, observed: Observations) -> MetricValues:
        """Return the ATE as first published, and the loop-closure gain: final over causal ATE."""
        causal = observed.causal or {}
        before = causal.get('ate_trans_rmse_m', math.nan)
        gain = math.nan
        if before > 0:
            errors = position_errors(observed.sample, observed.alignment)
            gain = root_mean_square(errors) / before
        values = {
            'ate_causal_trans_rmse_m': before,
            'ate_causal_rot_rmse_deg': causal.get('ate_rot_rmse_deg', math.nan),
            'loop_closure_gain': gain,
        }
        if gain > MAX_GAIN:
            return MetricValues(
                values,
                (
                    'loop_closure_gain: revising its past multiplied the error of the estimate '
                    f'by {gain:.3g}',
                ),
            )
        return MetricValues(values)


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else math.nan


METRICS: dict[str, Callable[[EvaluationConfig], Metric]] = {
    'ate': Ate,
    'rpe': Rpe,
    'segments': Segments,
    'path': PathLength,
    'nees': Nees,
    'coverage': Coverage,
    'revisions': Revisions,
}
