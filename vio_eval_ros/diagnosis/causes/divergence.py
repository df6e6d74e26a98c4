"""Estimates that leave for good; measured with the other breaks."""

from __future__ import annotations

from dataclasses import replace

from vio_eval_ros.diagnosis.causes.cause import KnownCause, POSITION_ERRORS, template
from vio_eval_ros.diagnosis.correction import PosesInCorrection


def _cut_off(poses: PosesInCorrection, first_ns: int) -> PosesInCorrection:
    """Return the poses before the one received with this stamp."""
    return replace(poses, kept=poses.kept & (poses.stamps_ns < first_ns))


DIVERGED = KnownCause(
    name='diverged',
    unit='ratio',
    meaning='share of the run',
    measured='an error that never comes back, beyond the extent of the truth or five times the '
    'drift over as long elsewhere in the run',
    remedy='the estimator',
    evidence=template(
        'it leaves and never comes back, for the last {percent:.0f} % of the run',
        percent=lambda value: 100 * value,
    ),
    advice='Look at what comes just before: lost features, saturated IMU, or noise parameters '
    'that are too small.',
    advice_without_imu='Look at what comes just before: lost features, blur, or a moving scene.',
    limits=('diverged_m',),
    undo=_cut_off,
    undo_order=91,
    acts_on=POSITION_ERRORS,
)
CAUSES = (DIVERGED,)
