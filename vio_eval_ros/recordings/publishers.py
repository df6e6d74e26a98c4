"""Refuses sources in which poses of several publishers take turns."""

from __future__ import annotations

import math

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.interleaving import interleaving
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.sources import Source


def refuse_mixed(estimate: Source, truth: Source, config: EvaluationConfig) -> None:
    """
    Check that each side is one trajectory, in the time that is evaluated.

    :raises ReadError: the poses of two or three trajectories take turns in it.
    """
    true_ns = truth.poses.stamps_ns
    if truth.poses.zero_is_unset:
        true_ns = true_ns[true_ns != 0]
    begin_ns = int(true_ns.min()) if len(true_ns) else 0
    for source, offset_s in ((truth, 0.0), (estimate, config.time_offset_s)):
        found = interleaving(_within(source.poses, begin_ns - nanoseconds(offset_s), config))
        if found is not None:
            raise ReadError(
                source.spec,
                f'{found}; name a topic that only one of them publishes, or record each on a '
                'topic of its own; --start-s and --end-s choose a time without them',
            )


def _within(poses: Poses, begin_ns: int, config: EvaluationConfig) -> Poses:
    """Return the poses in the time that is evaluated, relative to the first ground truth."""
    if not config.start_s and math.isinf(config.end_s):
        return poses
    elapsed_ns = poses.stamps_ns - begin_ns
    inside = elapsed_ns >= nanoseconds(config.start_s)
    if math.isfinite(config.end_s):
        inside &= elapsed_ns <= nanoseconds(config.end_s)
    return poses[np.flatnonzero(inside)]
