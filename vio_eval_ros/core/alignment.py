"""
Moments of paired positions: alignments and errors follow from them in closed form.

An alignment takes the estimate into the world of the ground truth: g ≈ s R e + t.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.rotation import IDENTITY
from vio_eval_ros.core.trajectory import blocks, PairLog, Pairs, Trajectory

SCALED_MODES = ('scale', 'sim3')
#: parameters that an alignment has to fit
FREE_PARAMETERS = {'none': 0, 'scale': 1, 'posyaw': 4, 'origin': 6, 'se3': 6, 'sim3': 7}
#: alignments that are not fitted to the pairs, and what they do instead
UNFITTED = {'none': 'fits nothing', 'origin': 'takes the first pair alone'}
COORDINATES = 3
FEWEST_PAIRS = 2
#: second over first singular value, below which positions lie on a line
COLLINEAR_RATIO = 1e-3
MIN_EXTENT_M = 1e-6
MIN_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class Moments:
    """
    Count, mean and centred second moments of N paired positions.

    Moments of two sets merge exactly (Chan, Golub, LeVeque 1979), so a run can be added batch by
    batch or joined from parts. They are centred throughout: at coordinates as large as UTM's, raw
    sums would lose all digits. They are of Q e, g and g - Q e, with Q near the alignment's s R:
    otherwise small errors would be differences of large moments.

    :param count: N.
    :param mean: (9,) mean of Q e, g and g - Q e, metres.
    :param scatter: (9, 9) sum of outer products of the deviations, square metres.
    :param reference: (3, 3) the invertible Q.
    :param total: N, or the sum of the weights of weighted means and sums.
    :param weighted: the same of the pairs whose true positions have a weight, by these weights;
        alignments are fitted to it, errors never depend on it. None where nothing is weighted.
    """

    count: int
    mean: np.ndarray
    scatter: np.ndarray
    reference: np.ndarray
    total: float
    weighted: Moments | None = None

    @classmethod
    def empty(cls, reference: np.ndarray | None = None) -> Moments:
        """Return the moments of no pairs."""
        reference = np.eye(3) if reference is None else reference
        return cls(0, np.zeros(9), np.zeros((9, 9)), reference, 0)

    @classmethod
    def of(cls, pairs: Pairs, reference: np.ndarray | None = None) -> Moments:
        """Return the moments of pairs, about a (3, 3) reference if there is one."""
        moments = cls.empty(reference)
        weights = pairs.ground_truth.weights
        for rows in blocks(len(pairs)):
            block = moments._of_block(
                pairs.estimate.positions[rows],
                pairs.ground_truth.positions[rows],
                None if weights is None else weights[rows],
            )
            moments = moments.merge(block)
        return moments

    def _of_block(
        self, estimate: np.ndarray, truth: np.ndarray, weights: np.ndarray | None
    ) -> Moments:
        rotated = estimate @ self.reference.T
        samples = np.concatenate([rotated, truth, truth - rotated], axis=1)
        weighted = None if weights is None else self._of_weighted(samples, weights)
        mean = samples.mean(axis=0)
        samples -= mean
        # the mean that remains is rounding: subtracting it keeps the sums exact
        remainder = samples.mean(axis=0)
        samples -= remainder
        count, scatter = len(samples), samples.T @ samples
        return Moments(count, mean + remainder, scatter, self.reference, count, weighted)

    def _of_weighted(self, samples: np.ndarray, weights: np.ndarray) -> Moments:
        """Return the weighted moments of (N, 9) samples, without those of no weight."""
        samples, weights = samples[weights > 0], weights[weights > 0]
        if not len(samples):
            return Moments.empty(self.reference)
        mean = np.average(samples, axis=0, weights=weights)
        samples = samples - mean
        remainder = np.average(samples, axis=0, weights=weights)
        samples -= remainder
        scatter = (samples * weights[:, None]).T @ samples
        total = float(weights.sum())
        return Moments(len(samples), mean + remainder, scatter, self.reference, total)

    def merge(self, other: Moments) -> Moments:
        """Return the moments of both sets together; they must share their reference."""
        if not self.count or not other.count:
            return self if self.count else other
        total = self.total + other.total
        step = other.mean - self.mean
        weighted = self.weighted
        if weighted is not None and other.weighted is not None:
            weighted = weighted.merge(other.weighted)
        return Moments(
            self.count + other.count,
            self.mean + step * (other.total / total),
            self.scatter
            + other.scatter
            + np.outer(step, step) * (self.total * other.total / total),
            self.reference,
            total,
            weighted,
        )

    def to_fit(self) -> Moments:
        """Return what an alignment is fitted to, with weights of which the mean is 1."""
        known = self.weighted
        if known is None or not known.count:
            return self if known is None else known
        return replace(
            known, scatter=known.scatter * (known.count / known.total), total=known.count
        )

    @property
    def mean_estimate(self) -> np.ndarray:
        """(3,) metres."""
        return np.linalg.solve(self.reference, self.mean[:3])

    @property
    def mean_truth(self) -> np.ndarray:
        """(3,) metres."""
        return self.mean[3:6]

    @property
    def cross(self) -> np.ndarray:
        """(3, 3) sum of (g - ḡ)(e - ē)ᵀ."""
        return np.linalg.solve(self.reference, self.scatter[:3, 3:6]).T

    @property
    def truth_scatter(self) -> np.ndarray:
        """(3, 3) sum of (g - ḡ)(g - ḡ)ᵀ."""
        return self.scatter[3:6, 3:6]

    @property
    def estimate_scatter(self) -> np.ndarray:
        """(3, 3) sum of (e - ē)(e - ē)ᵀ."""
        inverse = np.linalg.inv(self.reference)
        return inverse @ self.scatter[:3, :3] @ inverse.T


@dataclass(frozen=True, eq=False)
class Alignment:
    """
    The similarity that takes the estimate into the ground truth's world: g ≈ s R e + t.

    :param mode: one of ``ALIGNMENTS`` of the options.
    :param scale: s; NaN where the estimate does not move.
    :param rotation: R as (4,) unit quaternion x y z w; NaN where nothing is determined.
    :param translation: t, (3,) metres; NaN where nothing is determined.
    :param undetermined: why the motion does not determine R, or the pairs determine nothing;
        empty where they do. Rotation errors are NaN where they do not.
    """

    mode: str
    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    undetermined: str = ''

    def positions(self, estimate: np.ndarray) -> np.ndarray:
        """Return (N, 3) positions of the estimate in the ground truth's world."""
        return estimate @ self.linear.T + self.translation

    def apply(self, estimate: Trajectory) -> Trajectory:
        """Return the estimate in the ground truth's world."""
        rotations = estimate.rotations
        if rotations is not None:
            rotations = rotation.multiply(self.rotation, rotations)
        return Trajectory(estimate.stamps_ns, self.positions(estimate.positions), rotations)

    @property
    def observable(self) -> bool:
        """Whether the motion determines R."""
        return not self.undetermined

    def invertible(self) -> Alignment:
        """Return the alignment, with scale 1 where its own is too extreme to divide by."""
        usable = MIN_SCALE < self.scale < 1 / MIN_SCALE
        known = self if self.is_known else replace(self, rotation=IDENTITY)
        return known if usable else replace(known, scale=1.0)

    @property
    def is_known(self) -> bool:
        """Whether there are absolute errors under it."""
        return not math.isnan(self.translation[0])

    @cached_property
    def matrix(self) -> np.ndarray:
        """The (3, 3) rotation matrix."""
        return rotation.to_matrix(self.rotation)

    @cached_property
    def linear(self) -> np.ndarray:
        """The (3, 3) s R."""
        return self.scale * self.matrix

    def mean_square(self, moments: Moments) -> float:
        """
        Return the mean squared distance [m²] of aligned and true positions.

        In closed form: the cost does not depend on the number of pairs.
        """
        if not moments.count:
            return math.nan
        # s R e + t - g = (s R Q⁻¹ - I) Q e - (g - Q e) + t
        similarity = np.hstack(
            [self.linear @ np.linalg.inv(moments.reference) - np.eye(3), 0 * np.eye(3), -np.eye(3)]
        )
        bias = similarity @ moments.mean + self.translation
        spread = np.sum((similarity @ moments.scatter) * similarity) / moments.count
        return float(bias @ bias + max(spread, 0.0))


def undetermined(mode: str, why: str) -> Alignment:
    """Return the alignment that nothing determines: every error under it is NaN."""
    scale = math.nan if mode in SCALED_MODES else 1.0
    return Alignment(mode, scale, np.full(4, math.nan), np.full(3, math.nan), why)


def solve(mode: str, moments: Moments, first: Pairs, compared: int | None = None) -> Alignment:
    """
    Return the alignment that minimises the mean squared distance within a mode.

    With no more coordinates than parameters an alignment leaves no error, whatever the poses are.
    Nor does a single pair say anything of a trajectory. Then nothing is determined.

    :param mode: none, origin (the first poses coincide), scale (about the origin of the world),
        posyaw (rotation about the vertical only), se3 or sim3.
    :param moments: of the pairs to align on. Where these have weights, the weighted mean squared
        distance is minimised; all pairs count as compared.
    :param first: the first pair of the run, for ``origin``.
    :param compared: how many pairs the alignment is applied to, where that is more.
    """
    count = moments.count if compared is None else compared
    if why := _why_not_redundant(mode, count):
        return undetermined(mode, why)
    fitted = moments.to_fit()
    alignment = _fit(mode, fitted, first)
    if fitted.count < count and not alignment.observable:
        # fitted pairs lie on a line, around which the others may be anywhere
        among = ' in the first align_first_s' * (moments.count < count)
        among += ', counting only pairs with a weight' * (fitted.count < moments.count)
        return undetermined(mode, alignment.undetermined + among)
    return alignment


def _why_not_redundant(mode: str, count: int) -> str:
    """Return why so few pairs leave no errors to measure; empty where they do."""
    if count < FEWEST_PAIRS:
        return 'there is only one pair' if count else 'there are no pairs'
    free = FREE_PARAMETERS[mode]
    if COORDINATES * count <= free:
        return f'{count} pairs are not more than the {free} parameters of {mode} can fit'
    return ''


def _fit(mode: str, moments: Moments, first: Pairs) -> Alignment:
    """
    Return the alignment of one or more pairs, however few.

    Umeyama (1991), equations 34 to 43, for se3 and sim3; Zhang and Scaramuzza (2018), for posyaw.
    """
    if mode == 'none':
        return Alignment(mode, 1.0, IDENTITY, np.zeros(3))
    if mode == 'origin':
        return _origin(first)
    mean_e, mean_g, cross = moments.mean_estimate, moments.mean_truth, moments.cross
    spread = [float(np.trace(s)) for s in (moments.estimate_scatter, moments.truth_scatter)]
    moves = min(spread) > MIN_EXTENT_M**2
    if mode == 'scale':
        square = spread[0] + moments.count * float(mean_e @ mean_e)
        product = float(np.trace(cross)) + moments.count * float(mean_e @ mean_g)
        scale = (
            product / square if square > 0 and product else math.nan
        )  # NaN for a truth of zeros
        why = '' if moments.count else 'there are no pairs'
        return Alignment(mode, scale, IDENTITY, np.zeros(3), why)
    scale, why = 1.0, _why_undetermined(mode, moments)
    if mode == 'posyaw':
        yaw = math.atan2(cross[1, 0] - cross[0, 1], cross[0, 0] + cross[1, 1])
        q = np.array([0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)])
    else:
        u, d, vt = np.linalg.svd(cross)
        signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
        q = rotation.from_matrix((u * signs) @ vt)
        if mode == 'sim3':
            scale = float(d @ signs) / spread[0] if moves else math.nan
    return Alignment(mode, scale, q, mean_g - scale * rotation.rotate(q, mean_e), why)


def _origin(first: Pairs) -> Alignment:
    """Return the alignment under which the first poses of both coincide."""
    estimate, truth = first.estimate, first.ground_truth
    if estimate.rotations is None or truth.rotations is None:
        return undetermined('origin', 'a first pose has no orientation')
    q = rotation.multiply(truth.rotations[0], rotation.conjugate(estimate.rotations[0]))
    return Alignment(
        'origin',
        1.0,
        q,
        truth.positions[0] - rotation.rotate(q, estimate.positions[0]),
    )


def _why_undetermined(mode: str, moments: Moments) -> str:
    """Return why the motion of both does not determine the rotation; empty where it does."""
    needed = 2 if mode == 'posyaw' else 3
    if moments.count < needed:
        return f'there are fewer than {needed} pairs'
    for name, scatter in (
        ('ground truth', moments.truth_scatter),
        ('estimate', moments.estimate_scatter),
    ):
        spread = np.linalg.eigvalsh(scatter)[::-1].clip(min=0)
        longest, second = np.sqrt(spread[:2])
        if longest < MIN_EXTENT_M:
            return f'the {name} stands still'
        level = math.sqrt(np.trace(scatter[:2, :2]))
        if mode == 'posyaw' and level < COLLINEAR_RATIO * longest:
            return f'the {name} moves straight up or down'
        if mode != 'posyaw' and second < COLLINEAR_RATIO * longest:
            return f'the {name} moves along a line'
    return ''


class Aligner:
    """
    Keeps the alignment of a run up to date, at a cost that does not grow with its pairs.

    :param mode: one of ``ALIGNMENTS`` of the options.
    :param first_ns: fit only pairs up to this long after the first one; 0 fits all.
    """

    def __init__(self, mode: str, first_ns: int) -> None:
        self._mode = mode
        self._first_ns = first_ns
        self._first: Moments | None = None
        #: of all pairs up to the last :meth:`update`
        self.moments = Moments.empty()
        self._referenced = 0

    def update(self, log: PairLog) -> Moments:
        """
        Take in the new pairs of a log; return the moments of all.

        Their reference is an alignment of at least half of the pairs.
        """
        if log.count >= 2 * self._referenced and not log.dropped:
            pairs = log.all()
            reference = np.eye(3)
            if len(pairs):
                reference = _fit('sim3', Moments.of(pairs), pairs[:1]).invertible().linear
            self.moments, self._referenced = Moments.of(pairs, reference), len(pairs)
        else:
            new = Moments.of(log.since(self.moments.count), self.moments.reference)
            self.moments = self.moments.merge(new)
        return self.moments

    def solve(self, log: PairLog, moments: Moments) -> Alignment:
        """Return the alignment of the pairs of a log, of which these are the moments."""
        fitted = self._of_first(log) if self._first_ns else moments
        return solve(self._mode, fitted, log.all()[:1], moments.count)

    def _of_first(self, log: PairLog) -> Moments:
        """Return the moments of the first pairs, which alone are fitted."""
        if self._first is not None:
            return self._first
        pairs = log.evenly()
        stamps = pairs.estimate.stamps_ns
        if not len(stamps):
            return Moments.empty()
        end = int(np.searchsorted(stamps, stamps[0] + self._first_ns, side='right'))
        moments = Moments.of(pairs[:end])
        if end < len(pairs):
            self._first = moments  # no more will come
        return moments
