"""Sources as one publisher would have sent them; refused where several take turns."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.interleaving import copies, interleaving
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.sources import Source


def of_one_publisher(
    estimate: Source, truth: Source, config: EvaluationConfig
) -> tuple[Source, Source]:
    """
    Return both sides as one publisher would have sent them: without poses that came twice.

    :raises ReadError: in the time that is evaluated, the poses of two or three trajectories take
        turns.
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
    return _once(estimate), _once(truth)


def _once(source: Source) -> Source:
    """Return a source without the second of poses that were published twice."""
    again = copies(source.poses)
    if not again.any():
        return source
    warning = (
        f'{source.spec}: {np.count_nonzero(again)} of {len(again)} poses repeat the one before, '
        'at nearly the same stamp, as of two publishers; they are left out'
    )
    poses = source.poses[np.flatnonzero(~again)]
    return replace(source, poses=poses, warnings=(*source.warnings, warning))


def _within(poses: Poses, begin_ns: int, config: EvaluationConfig) -> Poses:
    """Return the poses in the time that is evaluated, relative to the first ground truth."""
    if not config.start_s and math.isinf(config.end_s):
        return poses
    elapsed_ns = poses.stamps_ns - begin_ns
    inside = elapsed_ns >= nanoseconds(config.start_s)
    if math.isfinite(config.end_s):
        inside &= elapsed_ns <= nanoseconds(config.end_s)
    return poses[np.flatnonzero(inside)]
