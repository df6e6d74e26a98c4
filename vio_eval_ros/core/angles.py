"""Moments of rotations: the mean squared angle to any other rotation follows from them."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core.rotation import conjugate, multiply
from vio_eval_ros.core.trajectory import blocks

ORDERS = 5
#: the share of the mean square that may be missing
MAX_TRUNCATION = 1e-10
ROUNDING = 1e-14


def _expansion() -> np.ndarray:
    """
    Return the (ORDERS, 80) coefficients of θ² and its derivatives over their factorials.

    With c = cos(θ/2) and u = 1 - c it is θ² = 4 arccos² c = 8 Σ (2u)ⁿ / (n² C(2n, n)), n >= 1: the
    series of arcsin². For u <= 1 each term is at most half of the one before. Derivatives
    are with respect to c.
    """
    n = np.arange(1, 80)
    series = np.concatenate([[0.0], 8 * np.cumprod(2 * n**2 / (2 * n * (2 * n - 1))) / n**2])
    rows = []
    for order in range(ORDERS):
        binomials = np.array([math.comb(k, order) for k in range(order, 80)], float)
        rows.append((-1) ** order * np.concatenate([series[order:] * binomials, np.zeros(order)]))
    return np.stack(rows)


EXPANSION = _expansion()


@dataclass(frozen=True, eq=False)
class AngleMoments:
    """
    Sums over N rotations that give their mean squared angle to any rotation near a reference.

    For unit quaternions the squared angle is an analytic function of the product c = q·a, and c is
    linear in q. With q = q₀ + d its Taylor series is Σ gₖ(q₀·a) (d·a)ᵏ, so sums of gₖ a⊗...⊗a
    suffice. Near q₀ both q and a are nearly perpendicular to d: five terms are exact to ten digits
    for a q within a few degrees of the reference. All rotations are stored relative to q₀, where
    small angles are small numbers.

    :param count: N.
    :param reference: (4,) unit quaternion q₀.
    :param sums: of gₖ a⊗...⊗a: a number, (4,), (4, 4), (4, 4, 4) and (4, 4, 4, 4).
    :param closest: smallest q₀·a.
    """

    count: int
    reference: np.ndarray
    sums: tuple[np.ndarray, ...]
    closest: float

    @classmethod
    def of(cls, rotations: np.ndarray, reference: np.ndarray) -> AngleMoments:
        """Return the moments of (N, 4) unit quaternions about a reference."""
        sums = tuple(np.zeros((4,) * order) for order in range(ORDERS))
        moments = cls(0, reference, sums, 1.0)
        for rows in blocks(len(rotations)):
            moments = moments.merge(_of_block(rotations[rows], reference))
        return moments

    def merge(self, other: AngleMoments) -> AngleMoments:
        """Return the moments of both sets together; they must share their reference."""
        return AngleMoments(
            self.count + other.count,
            self.reference,
            tuple(a + b for a, b in zip(self.sums, other.sums, strict=True)),
            min(self.closest, other.closest),
        )

    def mean_square(self, rotation: np.ndarray) -> float:
        """Return the mean squared angle [rad²] to a rotation; NaN without rotations."""
        step = self._step(rotation)
        total = self.sums[-1]
        for term in self.sums[-2::-1]:
            total = total @ step + term
        return max(float(total), 0.0) / self.count if self.count else math.nan

    def is_exact_for(self, rotation: np.ndarray) -> bool:
        """Return whether a rotation is near enough to the reference for an exact mean square."""
        step = self._step(rotation)
        length = math.sqrt(step @ step)
        if length > self.closest / 2 + ROUNDING:
            return False
        last = self.sums[-1]
        for _ in range(ORDERS - 1):
            last = last @ step
        # In the series of θ² by c, g₄ is positive and |gₖ₊₁| < |gₖ| / (1 + c), the distance to
        # the branch point: the remainder is smaller than a geometric series after the last term.
        ratio = length / (1 + self.closest)
        remainder = float(last) / max(self.count, 1) * ratio / (1 - ratio)
        return remainder <= MAX_TRUNCATION * self.mean_square(rotation)

    def _step(self, rotation: np.ndarray) -> np.ndarray:
        """Return d, relative to the reference."""
        relative = _relative_to(self.reference, rotation)
        return np.concatenate([relative[:3], [-_one_minus_cosine(relative)]])


def _of_block(rotations: np.ndarray, reference: np.ndarray) -> AngleMoments:
    a = _relative_to(reference, rotations)
    u = _one_minus_cosine(a)
    weights = np.zeros((ORDERS, len(u)))
    for coefficients in EXPANSION.T[::-1]:
        weights *= u
        weights += coefficients[:, None]
    squares = (a[:, :, None] * a[:, None, :]).reshape(-1, 16)
    sums = (
        weights[0].sum(),
        weights[1] @ a,
        (weights[2] @ squares).reshape(4, 4),
        ((a.T * weights[3]) @ squares).reshape(4, 4, 4),
        ((squares.T * weights[4]) @ squares).reshape(4, 4, 4, 4),
    )
    return AngleMoments(len(a), reference, sums, 1 - float(u.max(initial=0.0)))


def _relative_to(reference: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Return rotations relative to a reference; of q and -q, the one with w >= 0."""
    relative = multiply(conjugate(reference), rotations)
    return np.where(relative[..., 3:] < 0, -relative, relative)


def _one_minus_cosine(q: np.ndarray) -> np.ndarray:
    """Return 1 - w = |v|² / (1 + w) for unit quaternions, exact for the smallest angles."""
    return np.asarray(np.sum(q[..., :3] ** 2, axis=-1) / (1 + q[..., 3]))
