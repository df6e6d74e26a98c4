"""Stamps that are late, and clocks that drift apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any

from vio_eval_ros.core.config import EvaluationConfig, plain
from vio_eval_ros.core.rotation import IDENTITY
from vio_eval_ros.diagnosis.causes.cause import KnownCause
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.correction import Correction, PosesInCorrection
from vio_eval_ros.diagnosis.diagnosed_run import FEWEST_POSES
from vio_eval_ros.diagnosis.geometry import fit_body
from vio_eval_ros.diagnosis.lag import fit_lag
from vio_eval_ros.diagnosis.measurement import Measurement
from vio_eval_ros.errors import NoPairs

#: relative motions that agree no better than this have no lag
LARGEST_RESIDUAL_RATIO = 0.5
#: no clock gains or loses more, in seconds a second: what seems to is not a clock
LARGEST_CLOCK_DRIFT = 0.1
#: no clock is so wrong, but time that is played at another rate is
WRONG_PACE_PPM = 1e4


def _undo_offset(poses: PosesInCorrection, offset_s: float) -> PosesInCorrection:
    """Return the poses with stamps that are earlier by the offset."""
    return replace(poses, late_s=poses.late_s + offset_s)


def _undo_drift(poses: PosesInCorrection, value: tuple[float, int | None]) -> PosesInCorrection:
    """Return the poses with stamps of a clock that does not drift; it was right at a stamp."""
    drift, agreed_ns = value
    agreed_ns = poses.middle_ns if agreed_ns is None else agreed_ns
    return replace(poses, late_s=poses.late_s + drift * ((poses.stamps_ns - agreed_ns) / 1e9))


def _offset_flags(correction: Correction, config: EvaluationConfig) -> tuple[str, ...]:
    """Return the offset to add, on top of what is configured."""
    return '--time-offset-s', plain(config.time_offset_s - correction.value('time_offset', 0.0))


TIME_OFFSET = KnownCause(
    name='time_offset',
    unit='s',
    meaning='positive: the estimate is late; of a clock that drifts in the middle of the run, '
    'unless it was right at the beginning',
    measured='angular speeds are correlated over all lags, then the lag is refined together with '
    'drift and sensor rotation until relative rotations over 0.25 s agree best',
    remedy='`--time-offset-s`',
    evidence=lambda one, findings: (
        f'its stamps are {1e3 * abs(one.value):.1f} ± {1e3 * one.uncertainty:.1f} ms '
        + ('late' if one.value > 0 else 'early')
    ),
    advice='Make both clocks the same (PTP, one recording computer, the stamp of the exposure '
    'and not of the arrival), or correct for it.',
    limits=('time_offset_s',),
    healthy=lambda limits, half_s: limits.time_offset_s,
    undo=_undo_offset,
    undo_order=80,
    flags=_offset_flags,
    may_raise_ate=True,  # positions that contradict it have been asked
)


def _drift_evidence(measurement: Measurement, findings: Mapping[str, Any]) -> str:
    """Return what a clock gains, or its pace where no clock is so wrong."""
    found = f'{measurement.value:.0f} ± {measurement.uncertainty:.0f} ppm'
    if abs(measurement.value) < WRONG_PACE_PPM:
        return f'its clock gains {found} on that of the ground truth'
    pace = 1 / (1 - 1e-6 * measurement.value)
    return (
        f'its time runs at {pace:.4g} times the pace of that of the ground truth ({found}), as '
        'where a recording is played at another rate than that of the clock that stamps the poses'
    )


CLOCK_DRIFT = KnownCause(
    name='clock_drift',
    unit='ppm',
    meaning='positive: the clock of the estimate gains',
    measured='the same fit; where nothing agrees, paces of 0.1 to 10 are tried',
    remedy='synchronised clocks',
    evidence=_drift_evidence,
    advice='Synchronise the two clocks for the whole run (PTP or NTP), and stamp poses with the '
    'time of the data (use_sim_time with a recording that is played): one constant offset cannot '
    'correct it.',
    limits=('clock_drift_s',),
    healthy=lambda limits, half_s: 1e6 * limits.clock_drift_s / half_s,
    undo=_undo_drift,
    undo_order=81,
)
CAUSES = (TIME_OFFSET, CLOCK_DRIFT)


def measure(run: Measuring) -> None:
    """
    Note offset and drift of the stamps.

    :raises NoPairs: with these undone the two sides have no time in common.
    """
    run.findings['angular_speed_correlation'] = {
        'offset_s': run.peak.lag_s,
        'peak': run.peak.height,
        'next_peak': run.peak.rival,
    }
    offset, drift = _offset(run), _drift(run)
    agreed_ns, at_first = None, _offset_at_first(run, offset, drift)
    if drift.unusual and at_first.observable and not at_first.significant:
        offset, agreed_ns = at_first, int(run.run.estimate.stamps_ns[0])
    late_s = _positions_late_s(run) if offset.unusual else None
    if late_s is not None:  # positions and orientations are of other moments: which are right?
        offset, drift = offset.as_unobservable(), drift.as_unobservable()
    run.findings['positions_late_s'] = late_s
    run.note(TIME_OFFSET, offset, offset.value)
    run.note(CLOCK_DRIFT, drift, (run.lag.drift, agreed_ns))
    if len(run.pairs()) < FEWEST_POSES:
        raise NoPairs(
            'the two sides have no time in common, and their motions do not show how far apart '
            'their clocks are: are they from the same run?'
        )


def _agrees(run: Measuring) -> bool:
    """Return whether relative motions agree at the lag, as far as a clock can explain them."""
    lag = run.lag
    return lag.residual < LARGEST_RESIDUAL_RATIO and abs(lag.drift) < LARGEST_CLOCK_DRIFT


def _offset(run: Measuring) -> Measurement:
    if not _agrees(run):
        return run.measured(TIME_OFFSET, 0.0, math.inf)
    offset = run.measured(TIME_OFFSET, run.lag.offset_s, run.lag.offset_uncertainty_s)
    if run.run.oriented or not offset.unusual:
        return offset
    # a point ahead of the body is where the body will be: what does the lever arm leave of it?
    undone = TIME_OFFSET.undone(run.correction, offset.value)
    late = fit_body(run.run.pairs(undone), IDENTITY).positions_late
    if not math.isfinite(late.uncertainty):  # no orientations, no lever arm
        return offset
    return run.measured(
        TIME_OFFSET,
        offset.value + late.value,
        math.hypot(offset.uncertainty, late.uncertainty),
    )


def _drift(run: Measuring) -> Measurement:
    if not _agrees(run):
        return run.measured(CLOCK_DRIFT, 0.0, math.inf)
    # in positions a scale or a heading that drifts looks like a clock that does
    uncertainty = run.lag.drift_uncertainty if run.run.oriented else math.inf
    return run.measured(CLOCK_DRIFT, 1e6 * run.lag.drift, 1e6 * uncertainty)


def _offset_at_first(run: Measuring, offset: Measurement, drift: Measurement) -> Measurement:
    """Return the offset at the first stamp, at which clocks that drift may have agreed."""
    half_s = run.run.half_s
    return run.measured(
        TIME_OFFSET,
        offset.value - 1e-6 * drift.value * half_s,
        math.hypot(offset.uncertainty, 1e-6 * drift.uncertainty * half_s),
    )


def _positions_late_s(run: Measuring) -> float | None:
    """
    Return how much later the positions are than the orientations, if they do not share the offset.

    They do not where undoing it makes the ATE larger, and where they have less than half of it
    and significantly less than all of it.
    """
    lag, correction = run.lag, run.correction
    undone = TIME_OFFSET.undone(correction, lag.offset_s)
    if not run.run.oriented or not run.run.is_worse(
        undone, correction, run.limits.improvement_percent
    ):
        return None
    of_positions = fit_lag(
        correction.apply(run.run.estimate), run.run.true_poses, lag.offset_s, by_rotations=False
    )
    in_its_direction_s = math.copysign(1.0, lag.offset_s) * of_positions.offset_s
    at_most_s = max(in_its_direction_s + of_positions.offset_uncertainty_s, 2 * in_its_direction_s)
    less = at_most_s < abs(lag.offset_s)
    return of_positions.offset_s - lag.offset_s if less else None
