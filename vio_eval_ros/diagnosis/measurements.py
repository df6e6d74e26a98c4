"""What is measured of a run, and how much of it healthy runs show."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.diagnosis.breaks import Breaks, find_breaks, find_gaps, Jump
from vio_eval_ros.diagnosis.clocks import fit_lag, Lag, speed_peak
from vio_eval_ros.diagnosis.conventions import find_convention, Finding
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.correlation import Peak
from vio_eval_ros.diagnosis.fitting import T_95
from vio_eval_ros.diagnosis.geometry import fit_body, fit_scale, fit_world
from vio_eval_ros.diagnosis.run import Run

# What healthy runs show, with room: beyond these a parameter is suspicious. A stamp within 5 ms
# costs nothing; stereo and IMU know the scale to 1 or 2 %, a calibration the turn of a sensor to
# a few tenths of a degree; gravity is seen to half a degree, while the heading walks by some
# degrees a minute. Positions alone tell the offset less well.
OFFSET_S, OFFSET_OF_POSITIONS_S = 0.005, 0.03
CLOCK_S = 0.01  # at either end of the run
TURN_DEG = 1.0
LEVER_M = 0.05
TILT_DEG = 1.5
SCALE = math.log(1.024)
SCALE_DRIFT = 0.05  # at either end of the run
YAW_DEG_PER_MIN = 8.0
YAW_DEG = 5.0  # over the run
LOST_RATIO = 0.03

#: a parameter is told if a fault so many times beyond the healthy could not have hidden
HIDDEN = 2.0
#: the confidence from which on a parameter is a suspect
SURE = 0.8
#: a correlation peak that may be believed
PEAK = 0.6
#: relative motions that agree no better than this tell nothing
MISFIT = 0.5
#: a world tilted further was never meant to be upright
UPRIGHT_DEG = 45.0
#: by how much a jump must have made the ATE worse, and how many are tried
LESS_ATE = 0.03
MOST_JUMPS = 20
#: offsets closer than this lead to the same minimum
SAME_S = 0.05


@dataclass(frozen=True)
class Measurement:
    """
    One parameter of a run.

    :param name: of the cause that it may be.
    :param value: its size, in its unit.
    :param uncertainty: half the width of the 95 % interval; NaN where it has none, infinite
        where the motion does not tell.
    :param healthy: the largest size that healthy runs show.
    :param size: what is compared with that, where it is not the value itself.
    :param size_uncertainty: likewise.
    """

    name: str
    value: float
    unit: str
    uncertainty: float
    healthy: float
    size: float
    size_uncertainty: float

    @classmethod
    def of(
        cls, name: str, value: float, unit: str, uncertainty: float, healthy: float
    ) -> Measurement:
        """Return a parameter whose size is its absolute value."""
        value, uncertainty = float(value), float(uncertainty)
        return cls(name, value, unit, uncertainty, healthy, abs(value), uncertainty)

    @property
    def told(self) -> bool:
        """Whether a fault of a size that matters would have shown."""
        return not self.size_uncertainty > HIDDEN * self.healthy

    @property
    def unusual(self) -> bool:
        """Whether it is beyond what healthy runs show, and beyond doubt."""
        return self.confidence >= SURE

    @property
    def confidence(self) -> float:
        """The probability that the size is beyond what healthy runs show."""
        sigma = self.size_uncertainty / T_95
        if not sigma > 0:
            return 1.0 if self.size > self.healthy else 0.0
        return 0.5 * (1 + math.erf((self.size - self.healthy) / sigma / math.sqrt(2)))


@dataclass(frozen=True, eq=False)
class Measured:
    """
    All that was measured.

    :param correction: undoes all of it that is unusual.
    :param parameters: in the order in which they were measured.
    :param findings: what else there is to say, by name.
    :param convention: how the poses were written.
    """

    correction: Correction
    parameters: tuple[Measurement, ...]
    findings: dict[str, Any]
    convention: Finding


def measure(run: Run) -> Measured:
    """Return all parameters of a run, each measured with what was found before undone."""
    peak, convention, lag = _lag(run)
    correction = Correction(run.middle_ns, convention.convention)
    parameters = [*_clock(run, lag)]
    offset, drift = parameters
    if offset.unusual:
        correction = replace(correction, offset_s=lag.offset_s)
    if drift.unusual:
        correction = replace(correction, clock_drift=lag.drift)
    if convention.convention.name:
        parameters.append(_convention(convention))

    breaks = _breaks(run, correction)
    correction = replace(
        correction,
        outliers_ns=breaks.outliers_ns,
        diverged_ns=breaks.diverged_ns,
    )
    correction = replace(correction, jumps=_harmful(run, correction, breaks.jumps))
    punctual = correction.only(['time_offset', 'clock_drift']).apply(run.estimate)
    gaps = find_gaps(punctual, run.truth, run.config.max_gap_s)
    parameters += _of_breaks(run, breaks, correction.jumps)
    duration_s = float(run.truth.stamps_ns[-1] - run.truth.stamps_ns[0]) / 1e9
    lost = sum(gap.seconds for gap in gaps) / duration_s
    parameters.append(Measurement.of('lost_tracking', lost, 'ratio', math.nan, LOST_RATIO))

    turn = _turn(run, lag)
    parameters.append(turn)
    sensor = rotation.from_matrix(lag.turn.T)
    if turn.unusual:
        correction = replace(correction, turn=sensor)
    sensor = sensor if turn.told or turn.unusual else rotation.from_matrix(np.eye(3))
    body = fit_body(run.pairs(correction.without('sensor_rotation')), sensor)
    lever = Measurement.of(
        'lever_arm', body.lever_length.value, 'm', body.lever_length.uncertainty, LEVER_M
    )
    parameters.append(lever)
    if lever.unusual:
        correction = replace(correction, lever=body.lever)

    drift = Measurement.of(
        'scale_drift',
        100 * 60 * body.scale_drift.value,
        '%/min',
        100 * 60 * body.scale_drift.uncertainty,
        100 * 60 * SCALE_DRIFT / run.half_s,
    )
    world = fit_world(run.pairs(correction))
    yaw = Measurement.of(
        'yaw_drift',
        60 * math.degrees(world.yaw_drift.value),
        'deg/min',
        60 * math.degrees(world.yaw_drift.uncertainty),
        max(YAW_DEG_PER_MIN, YAW_DEG * 30 / run.half_s),
    )
    tilt = Measurement.of(
        'gravity_tilt',
        math.degrees(world.tilt_rad.value),
        'deg',
        math.degrees(world.tilt_rad.uncertainty),
        TILT_DEG,
    )
    upright = tilt.value < UPRIGHT_DEG
    if not upright:  # and was never meant to be: neither can be told of such a world
        tilt, yaw = (replace(one, size=0.0, size_uncertainty=math.inf) for one in (tilt, yaw))
    if tilt.unusual:
        correction = replace(correction, level=world.level)
    if yaw.unusual:
        correction = replace(correction, yaw_drift=world.yaw_drift.value)
    if drift.unusual:
        correction = replace(correction, scale_drift=body.scale_drift.value)
    scale = _scale(run, correction)
    if scale.unusual:
        correction = replace(correction, scale=scale.value)
    parameters += [scale, drift, tilt, yaw]
    findings = {
        'angular_speed_correlation': {
            'offset_s': peak.lag_s,
            'peak': peak.height,
            'next_peak': peak.rival,
        },
        'position_only': not run.turning,
        'stamps_far_from_all_others': run.stray,
        'world_upright': upright,
        'level_xyzw': world.level.tolist(),
        'sensor_rotation_xyzw': sensor.tolist(),
        'lever_arm_m': body.lever.tolist(),
        'jumps': [
            {
                'stamp_ns': jump.stamp_ns,
                'size_m': jump.size_m / scale.value,
                'harmful': jump in correction.jumps,
            }
            for jump in breaks.jumps
        ],
        'gaps': [
            {'begin_ns': gap.begin_ns, 'end_ns': gap.end_ns, 'seconds': gap.seconds}
            for gap in gaps
        ],
        'outlier_poses': {
            'stamps_ns': breaks.outliers_ns.tolist(),
            'median_m': breaks.outlier_m,
        },
    }
    return Measured(
        correction,
        tuple(parameters),
        findings,
        convention,
    )


def _lag(run: Run) -> tuple[Peak, Finding, Lag]:
    """Return where the angular speeds agree, the convention and the lag, each fit to the next."""
    peak = speed_peak(run.estimate, run.truth, run.gap_s)
    starts = [0.0]
    if peak.height > PEAK:
        starts = [peak.lag_s] if abs(peak.lag_s) < SAME_S else [peak.lag_s, 0.0]
    tried = []
    for start_s in starts:
        convention = find_convention(run.estimate, run.true_poses, start_s)
        meant = convention.convention.undo(run.estimate)
        tried.append((convention, fit_lag(meant, run.true_poses, start_s, run.turning)))
    convention, lag = min(tried, key=lambda one: one[1].misfit)
    return peak, convention, lag


def _clock(run: Run, lag: Lag) -> list[Measurement]:
    told = lag.misfit < MISFIT
    uncertainty = (lag.offset_uncertainty_s, lag.drift_uncertainty) if told else 2 * (math.inf,)
    return [
        Measurement.of(
            'time_offset',
            lag.offset_s if told else 0.0,
            's',
            uncertainty[0],
            OFFSET_S if run.turning else OFFSET_OF_POSITIONS_S,
        ),
        Measurement.of(
            'clock_drift',
            1e6 * lag.drift if told else 0.0,
            'ppm',
            1e6 * uncertainty[1],
            1e6 * CLOCK_S / run.half_s,
        ),
    ]


def _convention(found: Finding) -> Measurement:
    """Return how much worse the poses fit as they were read: 0 as well, 1 not at all."""
    worse = 1 - found.misfit / found.misfit_as_is
    return Measurement.of(found.convention.name, worse, 'ratio', math.nan, 0.0)


def _turn(run: Run, lag: Lag) -> Measurement:
    told = run.turning and lag.misfit < MISFIT
    angle = rotation.angle_between(
        rotation.from_matrix(lag.turn.T), np.array([0.0, 0.0, 0.0, 1.0])
    )
    return Measurement.of(
        'sensor_rotation',
        math.degrees(float(angle)) if told else 0.0,
        'deg',
        math.degrees(lag.turn_uncertainty) if told else math.inf,
        TURN_DEG,
    )


def _scale(run: Run, correction: Correction) -> Measurement:
    scale = fit_scale(run.pairs(correction))
    return Measurement(
        'scale',
        scale.value,
        'ratio',
        scale.uncertainty,
        SCALE,
        abs(math.log(scale.value)),
        scale.uncertainty / scale.value,
    )


def _breaks(run: Run, correction: Correction) -> Breaks:
    corrected = correction.apply(run.estimate)
    inside = run.true_poses.inside(corrected.stamps_ns)
    return find_breaks(run.pairs(correction), run.estimate.stamps_ns[inside])


def _harmful(run: Run, correction: Correction, jumps: tuple[Jump, ...]) -> tuple[Jump, ...]:
    """
    Return the jumps that made the run worse.

    An estimator also steps when it takes back an error; without that step the run were worse.
    """
    harmful: tuple[Jump, ...] = ()
    ate = run.errors(correction).get('ATE [m]', math.nan)
    for jump in sorted(jumps, key=lambda jump: -jump.size_m)[:MOST_JUMPS]:
        tried = tuple(sorted((*harmful, jump), key=lambda jump: jump.stamp_ns))
        without = run.errors(replace(correction, jumps=tried)).get('ATE [m]', math.nan)
        if without < (1 - LESS_ATE) * ate:
            harmful, ate = tried, without
    return harmful


def _of_breaks(run: Run, breaks: Breaks, harmful: tuple[Jump, ...]) -> list[Measurement]:
    largest = max((jump.size_m for jump in harmful), default=0.0)
    parameters = [
        Measurement.of('jump', largest, 'm', math.nan, 0.0),
        Measurement.of(
            'outliers', len(breaks.outliers_ns) / len(run.estimate), 'ratio', math.nan, 0.0
        ),
    ]
    if breaks.diverged_ns is not None:
        left_s = float(run.estimate.stamps_ns[-1] - breaks.diverged_ns) / 1e9
        ratio = left_s / (2 * run.half_s)
        parameters.append(Measurement.of('diverged', ratio, 'ratio', math.nan, 0.0))
    return parameters
