"""
What is measured, given pairs and an alignment: one class a family, one line in METRICS.

Every family gives flat names ``<metric>_<quantity>_<statistic>_<unit>``; the same names come with
NaN where there is no data. The rotation A = R_g R_eᵀ of each pair (``Pairs.turns``) carries all
orientation errors: the absolute one is the angle between the alignment's R and A, the relative one
from pair i to pair j the angle between A_i and A_j.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Alignment, MIN_EXTENT_M, Moments, solve
from vio_eval_ros.core.angles import AngleMoments
from vio_eval_ros.core.association import Associator, nearest
from vio_eval_ros.core.config import Delta, EvaluationConfig, plain
from vio_eval_ros.core.intervals import longest_tracked, nanoseconds
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.statistics import root_mean_square, statistics
from vio_eval_ros.core.steps import distances
from vio_eval_ros.core.trajectory import as_slice, blocks, PairLog, Pairs, rows

ALWAYS_ALIGNED = ('none', 'posyaw', 'se3', 'sim3')
RPE_KINDS = {'trans': 'm', 'rot': 'deg', 'disp': 'm', 'dist': 'm'}
DELTA_TOLERANCE = 0.1
SEGMENT_STEP = 10
MAX_GAIN = 1.05
KITTI_LENGTHS_M = tuple(range(100, 900, 100))


@dataclass(frozen=True, eq=False)
class Run:
    """
    What metrics are computed from.

    :param log: all pairs so far.
    :param moments: of their positions.
    :param alignment: the chosen one.
    :param associator: where the pairs come from.
    :param warnings: sentences for the user; metrics may add to them.
    :param causal: the metrics of the estimate as first published, where it was revised since.
    """

    log: PairLog
    moments: Moments
    alignment: Alignment
    associator: Associator
    warnings: list[str]
    causal: Mapping[str, float] | None = None

    @property
    def pairs(self) -> Pairs:
        """All pairs that are kept; of more than that, the newest are denser."""
        return self.log.all()

    @cached_property
    def sample(self) -> Pairs:
        """All pairs; of more than can be kept, some, evenly over the run."""
        return self.log.evenly()


class Metric:
    """A family of metrics; a subclass may also keep running values up to date."""

    def __init__(self, config: EvaluationConfig) -> None:
        self.config = config

    def final(self, run: Run) -> dict[str, float]:
        """Return the metrics over all pairs, in one pass."""
        raise NotImplementedError

    def running(self, run: Run) -> dict[str, float]:
        """Return those metrics that can be kept up to date as pairs arrive."""
        return {}


def named(prefix: str, unit: str, errors: np.ndarray) -> dict[str, float]:
    """Return the statistics of (N,) errors under their full names."""
    return {f'{prefix}_{name}_{unit}': value for name, value in statistics(errors).items()}


def position_errors(pairs: Pairs, alignment: Alignment) -> np.ndarray:
    """Return the (N,) metres |s R e + t - g|."""
    errors = np.empty(len(pairs))
    for part in blocks(len(pairs)):
        aligned = alignment.positions(pairs.estimate.positions[part])
        errors[part] = lengths(aligned - pairs.ground_truth.positions[part])
    return errors


def rotation_errors(pairs: Pairs, alignment: Alignment) -> np.ndarray:
    """Return the (N,) degrees of (R R_e)ᵀ R_g; NaN without orientations or a known R."""
    turns = pairs.turns
    if turns is None or not alignment.observable:
        return np.full(len(pairs), math.nan)
    errors = np.empty(len(pairs))
    for part in blocks(len(pairs)):
        errors[part] = rotation.angle_between(turns[part], alignment.rotation)
    return np.degrees(errors)


class Ate(Metric):
    """Absolute errors of position and orientation under the alignment (Sturm et al. 2012)."""

    def __init__(self, config: EvaluationConfig) -> None:
        super().__init__(config)
        self._angles: AngleMoments | None = None

    def final(self, run: Run) -> dict[str, float]:
        """Return all statistics under the chosen alignment, the RMSE under the usual ones."""
        errors = position_errors(run.sample, run.alignment)
        return (
            named('ate_trans', 'm', errors)
            | named('ate_rot', 'deg', rotation_errors(run.sample, run.alignment))
            | self._usual(
                run, lambda alignment: root_mean_square(position_errors(run.sample, alignment))
            )
            | {'ate_extent_ratio': _over_extent(root_mean_square(errors), run.moments)}
        )

    def running(self, run: Run) -> dict[str, float]:
        """Return the RMSE in closed form, at the same cost for any number of pairs."""
        rmse = math.sqrt(run.alignment.mean_square(run.moments))
        return (
            {'ate_trans_rmse_m': rmse, 'ate_rot_rmse_deg': self._rotation_rmse(run)}
            | self._usual(run, lambda alignment: math.sqrt(alignment.mean_square(run.moments)))
            | {'ate_extent_ratio': _over_extent(rmse, run.moments)}
        )

    def _rotation_rmse(self, run: Run) -> float:
        """Return the RMSE of angles; their moments are taken anew where R has turned too far."""
        turn, log = run.alignment.rotation, run.log
        if not run.pairs.oriented:
            return math.nan
        known = self._angles or AngleMoments.of(np.empty((0, 4)), turn)
        new = log.since(known.count).turns
        known = known.merge(AngleMoments.of(new, known.reference))  # type: ignore[arg-type]
        self._angles = known
        if not run.alignment.observable:
            return math.nan
        if not known.holds(turn):
            if log.dropped:  # too far from where the moments were taken, and few pairs are left
                return root_mean_square(rotation_errors(run.sample, run.alignment))
            known = self._angles = AngleMoments.of(run.pairs.turns, turn)  # type: ignore[arg-type]
        return math.degrees(math.sqrt(known.mean_square(turn)))

    def _usual(self, run: Run, rmse: Callable[[Alignment], float]) -> dict[str, float]:
        usual = {mode: solve(mode, run.moments, run.pairs[:1]) for mode in ALWAYS_ALIGNED}
        return {
            f'ate_{mode}_trans_rmse_m': rmse(alignment) for mode, alignment in usual.items()
        } | {'sim3_scale': usual['sim3'].scale}


def _over_extent(rmse: float, moments: Moments) -> float:
    """Return an RMSE over the RMS distance of the ground truth from its mean."""
    square = float(np.trace(moments.truth_scatter)) / max(moments.count, 1)
    return rmse / math.sqrt(square) if square > MIN_EXTENT_M**2 else math.nan


@dataclass(frozen=True, eq=False)
class Motion:
    """
    Relative motions of both sides, from pairs i to pairs j, M of them.

    :param estimate: (M, 3) displacements e_j - e_i, in the estimate's world.
    :param truth: (M, 3) displacements g_j - g_i, in the ground truth's world.
    :param turned: (M, 3) displacements A_i (e_j - e_i): those of an estimate that had the true
        orientation at i; NaN without orientations.
    :param angles: (M,) radians between the relative rotations; NaN without orientations.
    """

    estimate: np.ndarray
    truth: np.ndarray
    turned: np.ndarray
    angles: np.ndarray

    @classmethod
    def between(cls, pairs: Pairs, begin: np.ndarray, end: np.ndarray) -> Motion:
        """Return the relative motions between pairs with these (M,) indices."""
        i, j = as_slice(begin), as_slice(end)
        estimate, truth = pairs.estimate.positions, pairs.ground_truth.positions
        moved = rows(estimate, j) - rows(estimate, i)
        if pairs.turns is None:
            turned, angles = np.full_like(moved, math.nan), np.full(len(moved), math.nan)
        else:
            at_begin = rows(pairs.turns, i)
            turned = rotation.rotate(at_begin, moved)
            angles = rotation.angle_between(rows(pairs.turns, j), at_begin)
        return cls(moved, rows(truth, j) - rows(truth, i), turned, angles)

    def pose_errors(self, scale: float) -> np.ndarray:
        """Return the (M,) metres |E_t| of E = (G_i⁻¹ G_j)⁻¹ (P_i⁻¹ P_j)."""
        return lengths(scale * self.turned - self.truth)

    def errors(self, alignment: Alignment) -> np.ndarray:
        """Return the (4, M) relative errors in the order of RPE_KINDS, in metres and degrees."""
        scale = alignment.scale
        aligned = (scale * self.estimate) @ alignment.matrix.T
        return np.stack(
            [
                self.pose_errors(scale),
                np.degrees(self.angles),
                lengths(aligned - self.truth),
                np.abs(scale * lengths(self.estimate) - lengths(self.truth)),
            ]
        )


def relative_errors(
    pairs: Pairs, begin: np.ndarray, end: np.ndarray, alignment: Alignment
) -> np.ndarray:
    """Return the (4, M) relative errors between pairs with these (M,) indices, as Motion does."""
    errors = np.empty((len(RPE_KINDS), len(begin)))
    for part in blocks(len(begin)):
        errors[:, part] = Motion.between(pairs, begin[part], end[part]).errors(alignment)
    return errors


def progress_along(pairs: Pairs, unit: str) -> np.ndarray:
    """
    Return (N,) how far each pair is from the first, in the unit of a delta.

    Frames are counted over pairs; nanoseconds pass between stamps of the estimate; metres and
    degrees accumulate along the ground truth. NaN for degrees without orientations.
    """
    if unit == 'f':
        return np.arange(len(pairs))
    if unit == 's':
        return pairs.estimate.stamps_ns - pairs.estimate.stamps_ns[:1]
    steps: np.ndarray
    if unit == 'm':
        return distances(pairs.ground_truth.positions)
    else:
        turns = pairs.ground_truth.rotations
        if turns is None:
            return np.full(len(pairs), math.nan)
        steps = np.degrees(rotation.angle_between(turns[1:], turns[:-1]))
    return np.concatenate([np.zeros(min(len(pairs), 1)), np.cumsum(steps)])


@dataclass(frozen=True, eq=False)
class Candidates:
    """
    Which pairs may be a delta apart, in order.

    :param begin: (M,) indices.
    :param end: (M,) indices of what is nearest to a delta further.
    :param target: (M,) where ``end`` should be, along :func:`progress_along`.
    :param usable: (M,) whether it is near enough.
    """

    begin: np.ndarray
    end: np.ndarray
    target: np.ndarray
    usable: np.ndarray


def candidates(along: np.ndarray, delta: Delta, mode: str, origin: float = 0.0) -> Candidates:
    """
    Return from which pair to which a delta leads.

    :param along: (N,) non-decreasing, from :func:`progress_along`.
    :param mode: ``all`` starts at every pair; ``sequential`` goes from mark to mark, every delta
        from ``origin`` on, and takes the pair nearest to each mark.
    """
    step = delta.value * 1e9 if delta.unit == 's' else delta.value
    step = round(step) if delta.unit in 'fs' else step
    if not len(along) or math.isnan(along[-1]):
        nothing = np.empty(0, np.int64)
        return Candidates(nothing, nothing, nothing, nothing.astype(bool))
    target: np.ndarray
    if mode == 'all':
        begin, target = np.arange(len(along)), along + step
        frames = delta.unit == 'f'
        end = target.clip(max=len(along) - 1) if frames else _first_nearest(target, along)
    else:
        reached = (along - origin) / step
        marks = np.unique(np.concatenate([np.floor(reached), np.ceil(reached)]))
        places = marks * step + origin
        poses = _first_nearest(places, along)
        begin, end, target = poses[:-1], poses[1:], places[1:]
    # far above what rounding of coordinates can do to a path that is off by just the tolerance
    tolerance = 0 if delta.unit == 'f' else DELTA_TOLERANCE * step * (1 + 1e-6)
    off = np.abs(along[end] - along[begin] - step)
    return Candidates(begin, end, target, (end > begin) & (off <= tolerance))


def _first_nearest(places: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the first of the indices nearest to each place; ``along`` may stand still."""
    index = nearest(places, along)
    return index if (np.diff(along) > 0).all() else np.searchsorted(along, along[index])


class Rpe(Metric):
    """Relative errors over each delta: of pose, rotation, displacement and distance."""

    def __init__(self, config: EvaluationConfig) -> None:
        super().__init__(config)
        self._deltas = [Delta.parse(text) for text in config.rpe_deltas]
        self._running = [RunningRpe(delta, config.rpe_pairs) for delta in self._deltas]

    def final(self, run: Run) -> dict[str, float]:
        """Return all statistics of the four kinds of error, and how many there are."""
        metrics: dict[str, float] = {}
        pairs = run.log.since(0)
        for delta in self._deltas:
            found = candidates(progress_along(pairs, delta.unit), delta, self.config.rpe_pairs)
            begin, end = found.begin[found.usable], found.end[found.usable]
            errors = relative_errors(pairs, begin, end, run.alignment)
            for (kind, unit), row in zip(RPE_KINDS.items(), errors, strict=True):
                metrics |= named(f'rpe_{delta}_{kind}', unit, row)
            metrics[f'rpe_{delta}_pairs'] = len(begin)
            self._warn(run.warnings, pairs.estimate.stamps_ns, delta, begin, end)
        return metrics

    def running(self, run: Run) -> dict[str, float]:
        """Return the RMSE of the four kinds over the relative motions decided so far."""
        metrics: dict[str, float] = {}
        for series in self._running:
            metrics |= series.update(run)
        return metrics

    def _warn(
        self,
        warnings: list[str],
        stamps_ns: np.ndarray,
        delta: Delta,
        begin: np.ndarray,
        end: np.ndarray,
    ) -> None:
        if not len(begin):
            warnings.append(f'rpe_{delta}: no two pairs are {delta} apart')
        elif delta.unit == 'f':
            intervals = np.diff(stamps_ns)
            limit_ns = longest_tracked(
                nanoseconds(self.config.max_gap_s), float(np.median(intervals))
            )
            gaps = np.concatenate([[0], np.cumsum(intervals > limit_ns)])
            bridging = int(np.count_nonzero(gaps[end] > gaps[begin]))
            if bridging:
                warnings.append(
                    f'rpe_{delta}: {bridging} of {len(begin)} relative motions '
                    f'bridge a gap longer than {limit_ns / 1e9:g} s'
                )


@dataclass(frozen=True, eq=False)
class ErrorMoments:
    """
    Second moments of relative motions, from which their RMSE follows under any alignment.

    The alignment of a run that goes on still changes. Hence (Q x, y - Q x) is kept where the error
    is |s R x - y|, with Q near s R, so that small errors are not differences of large sums.

    :param products: for each kind the (2k, 2k) sum of outer products, k = 3 or 1.
    :param angles: sum of squared angles [rad²].
    :param reference: has Q.
    """

    count: int
    products: dict[str, np.ndarray]
    angles: float
    reference: Alignment

    @classmethod
    def of(cls, motion: Motion, reference: Alignment) -> ErrorMoments:
        """Return the moments of M motions about a reference."""
        far, far_truth = lengths(motion.estimate)[:, None], lengths(motion.truth)[:, None]
        compared = {
            'trans': (reference.scale * motion.turned, motion.truth),
            'disp': (motion.estimate @ reference.linear.T, motion.truth),
            'dist': (reference.scale * far, far_truth),
        }
        products = {}
        for kind, (own, true) in compared.items():
            samples = np.hstack([own, true - own])
            products[kind] = samples.T @ samples
        angles = float(motion.angles @ motion.angles)
        return cls(len(motion.angles), products, angles, reference)

    def __add__(self, other: ErrorMoments) -> ErrorMoments:
        """Return the moments of both; they must share their reference."""
        products = {kind: self.products[kind] + other.products[kind] for kind in self.products}
        angles = self.angles + other.angles
        return ErrorMoments(self.count + other.count, products, angles, self.reference)

    def rmse(self, kind: str, alignment: Alignment) -> float:
        """Return the root of the mean squared error of a kind, in its unit."""
        if not self.count:
            return math.nan
        if kind == 'rot':
            return math.degrees(math.sqrt(self.angles / self.count))
        unit = np.eye(len(self.products[kind]) // 2)
        turn = alignment.matrix @ self.reference.matrix.T if kind == 'disp' else unit
        similarity = np.hstack([alignment.scale / self.reference.scale * turn - unit, -unit])
        square = float(np.sum((similarity @ self.products[kind]) * similarity))
        return math.sqrt(max(square, 0.0) / self.count)


class RunningRpe:
    """The RMSE of relative errors over one delta, kept up to date as pairs arrive."""

    def __init__(self, delta: Delta, mode: str) -> None:
        self._delta = delta
        self._mode = mode
        self._next = 0
        self._mark = 0.0
        self._moments: ErrorMoments | None = None

    def update(self, run: Run) -> dict[str, float]:
        """Take in what the pairs since the last call decide; return the values."""
        if self._next < run.log.first_of_all:  # waited too long for a delta to be over
            self._next, self._mark = run.log.first_of_all, 0.0
        pairs = run.log.since(self._next)
        along = progress_along(pairs, self._delta.unit)
        found = candidates(along, self._delta, self._mode, self._mark)
        # no pair to come can be nearer to a place that has been reached; the rest may change
        decided = int(np.searchsorted(found.target, along[-1], side='right')) if len(along) else 0
        reference = run.alignment.near() if self._moments is None else self._moments.reference
        parts = []
        for usable in (
            found.usable[:decided].nonzero()[0],
            found.usable[decided:].nonzero()[0] + decided,
        ):
            motion = Motion.between(pairs, found.begin[usable], found.end[usable])
            parts.append(ErrorMoments.of(motion, reference))
        if parts[0].count:
            self._moments = parts[0] if self._moments is None else self._moments + parts[0]
        if self._mode == 'all':
            self._next += decided
        elif decided:
            last = found.end[decided - 1]
            self._mark = float(found.target[decided - 1] - along[last])
            self._next += int(last)
        moments = parts[1] if self._moments is None else self._moments + parts[1]
        return {
            f'rpe_{self._delta}_{kind}_rmse_{unit}': moments.rmse(kind, run.alignment)
            for kind, unit in RPE_KINDS.items()
        } | {f'rpe_{self._delta}_pairs': moments.count}


def segment_errors(pairs: Pairs, scale: float, path: np.ndarray, length_m: float) -> np.ndarray:
    """
    Return the (2, M) relative errors per metre over segments of a length, in metres and degrees.

    A segment begins at every tenth pair, and ends with the first that is further than its length.

    :param path: (N,) metres from the first pair, as :func:`progress_along` gives them.
    """
    begin = np.arange(0, len(path), SEGMENT_STEP)
    end = np.searchsorted(path, path[begin] + length_m, side='right')
    inside = end < len(path)
    begin, end = begin[inside], end[inside]
    errors = np.empty((2, len(begin)))
    for part in blocks(len(begin)):
        motion = Motion.between(pairs, begin[part], end[part])
        errors[0, part] = motion.pose_errors(scale)
        errors[1, part] = np.degrees(motion.angles)
    return errors / length_m


class Segments(Metric):
    """Drift over lengths of path, as the KITTI benchmark takes it (Geiger et al. 2012)."""

    def final(self, run: Run) -> dict[str, float]:
        """Return the mean drift over each length, and the KITTI mean over 100 to 800 m."""
        pairs, scale = run.log.since(0), run.alignment.scale
        path = progress_along(pairs, 'm')
        metrics: dict[str, float] = {}
        for length in self.config.segment_lengths_m:
            name = f'segment_{plain(length)}m'
            metrics |= self._drift(name, pairs, scale, path, (length,))
            if len(pairs) and not metrics[f'{name}_segments']:
                run.warnings.append(
                    f'{name} is null: there is no segment as long in {path[-1]:.4g} m of path'
                )
        return metrics | self._drift('kitti', pairs, scale, path, KITTI_LENGTHS_M)

    def _drift(
        self, name: str, pairs: Pairs, scale: float, path: np.ndarray, over: tuple[float, ...]
    ) -> dict[str, float]:
        drift, turn = np.hstack([segment_errors(pairs, scale, path, length) for length in over])
        return {
            f'{name}_trans_percent': 100 * _mean(drift),
            f'{name}_rot_deg_per_m': _mean(turn),
            f'{name}_segments': len(drift),
        }


class Path(Metric):
    """How far the run went, and how far off it ended for that."""

    def __init__(self, config: EvaluationConfig) -> None:
        super().__init__(config)
        self._length_m = 0.0
        self._last = 0

    def final(self, run: Run) -> dict[str, float]:
        """
        Return the ground truth's path over the pairs, and the drift at the end in percent of it.

        The drift is the relative pose error from the first pair to the last.
        """
        path = progress_along(run.pairs, 'm')
        return self._metrics(run, float(path[-1]) if len(path) else math.nan)

    def running(self, run: Run) -> dict[str, float]:
        """Return the same, adding only the path since the last call."""
        if not run.log.count:
            return self._metrics(run, math.nan)
        self._length_m += float(progress_along(run.log.since(self._last), 'm')[-1])
        self._last = run.log.count - 1
        return self._metrics(run, self._length_m)

    def _metrics(self, run: Run, length_m: float) -> dict[str, float]:
        drift = math.nan
        if length_m > 0:
            whole = Motion.between(run.pairs[[0, -1]], np.array([0]), np.array([1]))
            drift = 100 * float(whole.pose_errors(run.alignment.scale)[0]) / length_m
        return {'path_length_m': length_m, 'drift_percent': drift}


class Nees(Metric):
    """Whether the estimate's own covariance fits its errors: 3 is consistent."""

    def final(self, run: Run) -> dict[str, float]:
        """Return the mean squares of position and orientation errors over their covariance."""
        estimate, turns = run.sample.estimate, run.sample.turns
        position = orientation = math.nan
        if (
            run.sample.deviations is not None
            and run.alignment.observable
            and run.alignment.scale > 0
        ):
            back = rotation.conjugate(run.alignment.rotation)
            truth = run.sample.ground_truth.positions - run.alignment.translation
            error = rotation.rotate(back, truth) / run.alignment.scale - estimate.positions
            position = self._mean('position', run, error, 0)
            if any(self.config.estimate_to_body[:3]):
                run.warnings.append('nees_position_mean is null: estimate_to_body has a lever arm')
            if turns is not None:
                error = rotation.to_rotation_vector(rotation.multiply(back, turns))
                orientation = self._mean('orientation', run, error, 1)
        return {'nees_position_mean': position, 'nees_orientation_mean': orientation}

    def _mean(self, name: str, run: Run, errors: np.ndarray, block: int) -> float:
        """Return the mean of |L⁻¹ e|² over the pairs with a positive definite covariance L Lᵀ."""
        deviations = run.sample.deviations_or_nan()[:, block].astype(float)
        usable = ~np.isnan(deviations[:, 0])
        unusable = len(usable) - int(np.count_nonzero(usable))
        if 0 < unusable < len(usable):
            run.warnings.append(
                f'nees_{name}: {unusable} of {len(usable)} covariances are not positive definite '
                'and left out'
            )
        (xx, yx, yy, zx, zy, zz), e = deviations[usable].T, errors[usable].T
        x = e[0] / xx
        y = (e[1] - yx * x) / yy
        z = (e[2] - zx * x - zy * y) / zz
        return _mean(x**2 + y**2 + z**2)


class Coverage(Metric):
    """How much of the run was evaluated at all: the condition of every other number."""

    def final(self, run: Run) -> dict[str, float]:
        """Return the share of the time that was tracked, and of the estimates that were paired."""
        settled = run.associator.estimate.settled
        coverage = run.associator.coverage_ratio()
        if math.isnan(coverage) and run.log.count:
            run.warnings.append(
                'coverage_ratio is null: no two poses of the ground truth are within max_gap_s '
                f'({self.config.max_gap_s:g} s)'
            )
        return {
            'coverage_ratio': coverage,
            'matched_ratio': run.log.count / settled if settled else math.nan,
        }

    running = final


class Revisions(Metric):
    """What a system made better by revising its past, as a loop closure does."""

    def final(self, run: Run) -> dict[str, float]:
        """Return the ATE as first published, and the loop-closure gain: final over causal ATE."""
        causal = run.causal or {}
        before = causal.get('ate_trans_rmse_m', math.nan)
        gain = math.nan
        if before > 0:
            gain = root_mean_square(position_errors(run.sample, run.alignment)) / before
        if gain > MAX_GAIN:
            run.warnings.append(
                f'loop_closure_gain: revising its past made the estimate {gain:.3g} times as wrong'
            )
        return {
            'ate_causal_trans_rmse_m': before,
            'ate_causal_rot_rmse_deg': causal.get('ate_rot_rmse_deg', math.nan),
            'loop_closure_gain': gain,
        }


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else math.nan


METRICS: dict[str, Callable[[EvaluationConfig], Metric]] = {
    'ate': Ate,
    'rpe': Rpe,
    'segments': Segments,
    'path': Path,
    'nees': Nees,
    'coverage': Coverage,
    'revisions': Revisions,
}
