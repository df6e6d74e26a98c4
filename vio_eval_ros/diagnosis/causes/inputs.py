"""Inputs that nothing can be measured of: sides that rest or were exchanged."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from vio_eval_ros.diagnosis.causes.cause import KnownCause
from vio_eval_ros.diagnosis.measurement import Measurement

STATIC_LIMITS = ('still_m', 'still_deg', 'moving_m', 'clearly_moving_m')


def _frozen(measurement: Measurement, findings: Mapping[str, Any]) -> str:
    """Return evidence: for how long the truth rests, or that it always does."""
    if math.isnan(measurement.value):
        return 'it moves, while the ground truth does not'
    share = f'{100 * measurement.value:.0f} %'
    return f'it moves on while the ground truth repeats one position for {share} of its poses'


def _resting(measurement: Measurement, findings: Mapping[str, Any]) -> str:
    """Return evidence: which sides rest."""
    truth = 'neither does' if findings['truth_rests'] else 'unlike'
    return f'it does not move, {truth} the ground truth'


TRUTH_STATIC = KnownCause(
    name='truth_static',
    unit='ratio',
    meaning='share of the poses, where not all',
    measured='the truth stays within its noise, or repeats one position while the estimate moves '
    'on as before; the rest is diagnosed',
    remedy='another recording',
    evidence=_frozen,
    advice='Check that the ground truth was recorded: the right topic, and the tracker seeing '
    'its markers.',
    limits=(*STATIC_LIMITS, 'frozen_s', 'frozen_percent'),
    comes_first=True,
)
INSUFFICIENT_MOTION = KnownCause(
    name='insufficient_motion',
    unit='',
    meaning='',
    measured='the estimate does not move, whether the truth does or not',
    remedy='another recording',
    evidence=_resting,
    advice='Record a run with translation and with rotation about two axes; this one cannot be '
    'diagnosed.',
    limits=STATIC_LIMITS,
    comes_first=True,
)
SWAPPED_INPUTS = KnownCause(
    name='swapped_inputs',
    unit='',
    meaning='',
    measured='the truth begins at its origin, and has the lower rate or heads along its x axis; '
    'the estimate does neither',
    remedy='exchange them',
    evidence=lambda measurement, findings: (
        'it begins away from its origin, while the ground truth begins there and has the lower '
        'rate or the heading of its x axis, as an estimate does'
    ),
    advice='Exchange --estimate and --ground-truth.',
    comes_first=True,
)
CAUSES = (TRUTH_STATIC, INSUFFICIENT_MOTION, SWAPPED_INPUTS)
