"""Steps from one pose to the next, and from which size on one is a jump."""

from __future__ import annotations

import numpy as np

from vio_eval_ros.core.rotation import lengths, rotate


def step_lengths(positions: np.ndarray) -> np.ndarray:
    """Return the (N - 1,) metres from each of (N, 3) positions to the next."""
    return lengths(np.diff(positions, axis=0))


def distances(positions: np.ndarray) -> np.ndarray:
    """Return the (N,) metres of path from the first of (N, 3) positions to each."""
    start = np.zeros(min(len(positions), 1))
    return np.concatenate([start, np.cumsum(step_lengths(positions))])


def path_of_changed_steps(
    positions: np.ndarray,
    factors: np.ndarray | None = None,
    rotations: np.ndarray | None = None,
) -> np.ndarray:
    """
    Return the path that begins with the same position, after a change of each step.

    :param positions: (N, 3).
    :param factors: (N,) by which the step from each position is stretched.
    :param rotations: (N, 4) quaternions by which it is rotated.
    """
    steps = np.diff(positions, axis=0)
    if factors is not None:
        steps = steps * factors[:-1, None]
    if rotations is not None:
        steps = rotate(rotations[:-1], steps)
    return np.concatenate([positions[:1], positions[:1] + np.cumsum(steps, axis=0)])


def step_errors(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the (N - 1,) metres by which the steps of (N, 3) positions differ as vectors."""
    return step_lengths(estimate - truth)


def jump_limit(sizes: np.ndarray, least: float, times: float, quantile: float) -> float:
    """
    Return the size above which a step is a jump.

    :param sizes: (N,) of all steps, N > 0.
    :param least: smaller ones are none.
    :param times: how many times as large as a ``quantile`` of the sizes a jump is.
    """
    return max(least, times * float(np.quantile(sizes, quantile)))
