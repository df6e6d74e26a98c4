"""What is measured of a run, and how much of it healthy runs show."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.rotation import IDENTITY
from vio_eval_ros.core.steps import step_lengths
from vio_eval_ros.diagnosis.breaks import find_breaks, find_gaps, Jump, missing_s
from vio_eval_ros.diagnosis.clocks import fit_lag, Lag, speed_peak
from vio_eval_ros.diagnosis.conventions import candidates, find_convention, Finding
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.correlation import Peak
from vio_eval_ros.diagnosis.fitting import student, T_95
from vio_eval_ros.diagnosis.geometry import Body, fit_body, fit_scale, fit_world, World
from vio_eval_ros.diagnosis.inputs import interpolated_over_s
from vio_eval_ros.diagnosis.run import FEWEST_POSES, IMPROVEMENT, improvement, Run
from vio_eval_ros.errors import NoPairs

# What healthy runs show, with room: beyond these a parameter is suspicious. A stamp within 5 ms
# costs nothing; stereo and IMU know the scale to 1 to 3 %, a calibration the turn of a sensor to
# a few tenths of a degree; gravity is seen to half a degree, while the heading walks by some
# degrees a minute. Positions alone tell the offset less well.
OFFSET_S = 0.005
CLOCK_S = 0.01  # at either end of the run
APART_S = 0.03  # of positions and orientations; published ground truth has up to 24 ms
TURN_DEG = 1.0
LEVER_M = 0.04
TILT_DEG = 1.5
SCALE = math.log(1.03)
SCALE_DRIFT = 0.05  # at either end of the run
YAW_DEG_PER_MIN = 8.0
YAW_DEG = 5.0  # over the run
LOST_RATIO = 0.03

SIDES = ('estimate', 'ground_truth')
CONVENTIONS = tuple(dict.fromkeys(one.name for one in candidates() if one.name))

#: a parameter is told if a fault so many times beyond the healthy could not have hidden
HIDDEN = 2.0
#: the confidence from which on a parameter is a suspect; one that is hardly told has to be beyond
#: the healthy by so many times its uncertainty
SURE, BEYOND_DOUBT = 0.8, 1.5
#: parts of a shorter run are too short to say how uncertain anything is
SHORTEST_S = 5.0
#: a correlation peak that may be believed
PEAK = 0.6
#: relative motions that agree no better than this tell nothing
MISFIT = 0.5
#: no clock gains or loses more; what seems to is no clock
MOST_DRIFT = 0.1
#: a world tilted further was never meant to be upright
UPRIGHT_DEG = 45.0
#: by how much a jump must have made the ATE worse, and how many are tried
LESS_ATE = 0.03
#: the errors from one frame to the next
FRAMES = r'(rotation )?RPE 1f'
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
        """Whether it is beyond what healthy runs show, as far as can be told."""
        return self.confidence >= SURE if self.told else self.beyond_doubt

    @property
    def beyond_doubt(self) -> bool:
        """Whether it is beyond what healthy runs show by much more than its uncertainty."""
        return self.size - self.healthy > BEYOND_DOUBT * self.size_uncertainty

    @property
    def confidence(self) -> float:
        """The probability that the size is beyond what healthy runs show."""
        sigma = self.size_uncertainty / T_95
        if not sigma > 0:
            return 1.0 if self.size > self.healthy else 0.0
        return student((self.size - self.healthy) / sigma)


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
    found = _Found(run, convention)
    found.findings['angular_speed_correlation'] = {
        'offset_s': peak.lag_s,
        'peak': peak.height,
        'next_peak': peak.rival,
    }
    found.clock(lag)
    if len(run.pairs(found.correction)) < FEWEST_POSES:
        raise NoPairs(
            'the two sides have no time in common, and their motions do not tell how far their '
            'clocks are apart: are they of the same run?'
        )
    found.breaks(lag)
    found.gaps()
    drift = found.body(lag)
    found.world()
    found.scale(drift)
    return Measured(found.correction, tuple(found.parameters), found.findings, convention)


class _Found:
    """What has been measured so far, and the correction of what of it is unusual."""

    def __init__(self, run: Run, convention: Finding) -> None:
        self._run = run
        self.correction = Correction(run.middle_ns, convention.convention)
        self.parameters: list[Measurement] = []
        self.findings: dict[str, Any] = {
            'position_only': not run.turning,
            'stamps_far_from_all_others': run.stray,
            'orientations_that_never_change': run.unturned,
            'truth_interpolated_s': interpolated_over_s(run.truth),
        }
        if convention.convention.name:
            self._note(_convention(convention))
        elif not convention.told:
            for name in CONVENTIONS:
                self._note(_untold(_certain(name, math.nan, 'ratio')))

    def _note(self, parameter: Measurement, **undone: Any) -> None:
        """Remember a parameter; where it is unusual, the correction gets what undoes it."""
        if 2 * self._run.half_s < SHORTEST_S and not math.isnan(parameter.uncertainty):
            parameter = _untold(parameter)
        self.parameters.append(parameter)
        if parameter.unusual:
            self.correction = replace(self.correction, **undone)

    def clock(self, lag: Lag) -> None:
        """Offset and drift of the stamps."""
        offset, drift = _clock(self._run, lag)
        agreed_ns, at_first = None, _in_the_beginning(self._run, offset, drift)
        if drift.unusual and at_first.told and not at_first.beyond_doubt:
            offset, agreed_ns = at_first, int(self._run.estimate.stamps_ns[0])
        late_s = _contradicting(self._run, self.correction, lag) if offset.unusual else None
        if late_s is not None:  # positions and orientations are of other moments: which are right?
            offset, drift = (_untold(one) for one in (offset, drift))
        self.findings['positions_late_s'] = late_s
        self._note(offset, offset_s=offset.value)
        self._note(drift, clock_drift=lag.drift, agreed_ns=agreed_ns)

    def breaks(self, lag: Lag) -> None:
        """Outliers, divergence, and the jumps that made the run worse."""
        run = self._run
        corrected = self.correction.apply(run.estimate)
        inside = run.true_poses.inside(corrected.stamps_ns)
        sensor = rotation.from_matrix(lag.turn.T) if _turn(run, lag).told else IDENTITY
        received_ns = run.estimate.stamps_ns[inside]
        found = find_breaks(run.pairs(self.correction), received_ns, sensor)
        outliers = len(found.outliers_ns) / len(run.estimate)
        self._note(_certain('outliers', outliers, 'ratio'), outliers_ns=found.outliers_ns)
        if found.diverged_ns is not None:
            left_s = float(run.estimate.stamps_ns[-1] - found.diverged_ns) / 1e9
            left = _certain('diverged', left_s / (2 * run.half_s), 'ratio')
            self._note(left, diverged_ns=found.diverged_ns)
        harmful = _harmful(run, self.correction, found.jumps)
        largest = max((jump.size_m for jump in harmful), default=0.0) * found.scale
        jump = replace(_certain('jump', largest, 'm'), size=float(len(harmful)))
        self._note(jump, jumps=harmful)
        self.findings['jumps'] = [
            {
                'stamp_ns': jump.stamp_ns,
                'size_m': jump.size_m * found.scale,
                'turn_deg': math.degrees(jump.turn_rad),
                'harmful': jump in harmful,
                'side': SIDES[jump.of_truth],
            }
            for jump in found.jumps
        ]
        self.findings['outlier_poses'] = {
            'stamps_ns': found.outliers_ns.tolist(),
            'median_m': found.outlier_m,
            'side': SIDES[found.truth_is_off],
        }

    def gaps(self) -> None:
        """Intervals without estimate."""
        run = self._run
        punctual = self.correction.only(['time_offset', 'clock_drift']).apply(run.estimate)
        gaps = find_gaps(punctual, run.truth, run.config.max_gap_s)
        duration_s = float(run.truth.stamps_ns[-1] - run.truth.stamps_ns[0]) / 1e9
        missing = missing_s(punctual, run.true_poses, gaps)
        lost = (sum(gap.seconds for gap in gaps) + missing) / duration_s
        self.findings['missing_between_poses_s'] = missing
        self._note(_certain('lost_tracking', lost, 'ratio', LOST_RATIO))
        self.findings['gaps'] = [
            {'begin_ns': gap.begin_ns, 'end_ns': gap.end_ns, 'seconds': gap.seconds}
            for gap in gaps
        ]

    def body(self, lag: Lag) -> Measurement:
        """Turn and lever arm of the sensor; return the drift of the scale, fitted with them."""
        turn, sensor = _turn(self._run, lag), rotation.from_matrix(lag.turn.T)
        pairs = self._run.pairs(self.correction)
        self._note(turn, turn=sensor)
        if not (turn.told or turn.unusual):
            sensor = IDENTITY
        body = fit_body(pairs, sensor)
        length = body.lever_length
        lever = Measurement.of('lever_arm', length.value, 'm', length.uncertainty, LEVER_M)
        drift = _scale_drift(self._run, body)
        late = body.positions_late
        if self.findings['positions_late_s'] is None and late.surely_beyond(APART_S):
            self.findings['positions_late_s'] = late.value
        if self.findings['positions_late_s'] is not None:  # each fits other moments
            lever, drift = _untold(lever), _untold(drift)
        self._note(lever, lever=body.lever)
        self.findings['sensor_rotation_xyzw'] = sensor.tolist()
        self.findings['lever_arm_m'] = body.lever.tolist()
        return drift

    def world(self) -> None:
        """Tilt of the estimate's world, and how its heading runs away."""
        pairs = self._run.pairs(self.correction)
        world = fit_world(pairs)
        tilt, yaw = _world(self._run, world)
        upright = math.degrees(world.tilt_rad.value) < UPRIGHT_DEG
        if not upright:  # and was never meant to be: neither can be told of such a world
            tilt, yaw = _untold(tilt), _untold(yaw)
        self._note(tilt, level=world.level)
        self._note(yaw, yaw_drift=world.yaw_drift.value)
        path_m = float(step_lengths(pairs.ground_truth.positions).sum())
        minutes = float(np.ptp(pairs.estimate.stamps_ns)) / 60e9 if path_m else math.nan
        self.findings['yaw_drift_deg_per_m'] = yaw.value * minutes / (path_m or math.nan)
        self.findings['world_upright'] = upright
        self.findings['level_xyzw'] = world.level.tolist()

    def scale(self, drift: Measurement) -> None:
        """Drift of the scale, and the scale of what is left."""
        self._note(drift, scale_drift=drift.value / 6000)
        scale = _scale(self._run, self.correction)
        self._note(scale, scale=scale.value)


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
    told = lag.misfit < MISFIT and abs(lag.drift) < MOST_DRIFT
    uncertainty = (lag.offset_uncertainty_s, lag.drift_uncertainty) if told else 2 * (math.inf,)
    # what a scale or a heading that drifts makes of positions looks like a clock that does
    if not run.turning:
        uncertainty = uncertainty[0], math.inf
    return [
        Measurement.of(
            'time_offset',
            lag.offset_s if told else 0.0,
            's',
            uncertainty[0],
            OFFSET_S,
        ),
        Measurement.of(
            'clock_drift',
            1e6 * lag.drift if told else 0.0,
            'ppm',
            1e6 * uncertainty[1],
            1e6 * CLOCK_S / run.half_s,
        ),
    ]


def _in_the_beginning(run: Run, offset: Measurement, drift: Measurement) -> Measurement:
    """Return the offset at the first stamp, at which clocks that drift may have agreed."""
    return Measurement.of(
        offset.name,
        offset.value - 1e-6 * drift.value * run.half_s,
        offset.unit,
        math.hypot(offset.uncertainty, 1e-6 * drift.uncertainty * run.half_s),
        offset.healthy,
    )


def _certain(name: str, value: float, unit: str, healthy: float = 0.0) -> Measurement:
    """Return a parameter that is counted, not estimated."""
    return Measurement.of(name, value, unit, math.nan, healthy)


def _contradicting(run: Run, correction: Correction, lag: Lag) -> float | None:
    """
    Return how much later the positions are than the orientations, if they have not their offset.

    It is not theirs where undoing it harms the positions, which have less than half of it, and
    surely not all.
    """
    if not run.turning or not run.is_worse(replace(correction, offset_s=lag.offset_s), correction):
        return None
    of_positions = fit_lag(correction.apply(run.estimate), run.true_poses, lag.offset_s, False)
    alike_s = math.copysign(1.0, lag.offset_s) * of_positions.offset_s
    known_s = max(alike_s + of_positions.offset_uncertainty_s, 2 * alike_s)
    less = known_s < abs(lag.offset_s)
    return of_positions.offset_s - lag.offset_s if less else None


def _untold(parameter: Measurement) -> Measurement:
    """Return a parameter that was measured, but from which nothing follows."""
    return replace(parameter, size=0.0, size_uncertainty=math.inf)


def _convention(found: Finding) -> Measurement:
    """Return how much worse the poses fit as they were read: 0 as well, 1 not at all."""
    worse = 1 - found.misfit / found.misfit_as_is
    return _certain(found.convention.name, worse, 'ratio')


def _turn(run: Run, lag: Lag) -> Measurement:
    told = run.turning and lag.misfit < MISFIT
    angle = rotation.angle(rotation.from_matrix(lag.turn.T))
    return Measurement.of(
        'sensor_rotation',
        math.degrees(float(angle)) if told else 0.0,
        'deg',
        math.degrees(lag.turn_uncertainty) if told else math.inf,
        TURN_DEG,
    )


def _scale_drift(run: Run, body: Body) -> Measurement:
    """Return the drift of the scale in its unit."""
    return Measurement.of(
        'scale_drift',
        100 * 60 * body.scale_drift.value,
        '%/min',
        100 * 60 * body.scale_drift.uncertainty,
        100 * 60 * SCALE_DRIFT / run.half_s,
    )


def _world(run: Run, world: World) -> tuple[Measurement, Measurement]:
    """Return tilt and yaw drift in their units."""
    return (
        Measurement.of(
            'gravity_tilt',
            math.degrees(world.tilt_rad.value),
            'deg',
            math.degrees(world.tilt_rad.uncertainty),
            TILT_DEG,
        ),
        Measurement.of(
            'yaw_drift',
            60 * math.degrees(world.yaw_drift.value),
            'deg/min',
            60 * math.degrees(world.yaw_drift.uncertainty),
            max(YAW_DEG_PER_MIN, YAW_DEG * 30 / run.half_s),
        ),
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
        -math.log1p(-scale.uncertainty / scale.value)
        if scale.uncertainty < scale.value
        else math.inf,
    )


def _harmful(run: Run, correction: Correction, jumps: tuple[Jump, ...]) -> tuple[Jump, ...]:
    """
    Return the jumps that made the run worse.

    An estimator also steps when it takes back an error; without that step the run were worse. One
    that is clearly no such step is harmful by what it does to the motions from frame to frame.
    """
    harmful: tuple[Jump, ...] = ()
    errors = run.errors(correction)
    for jump in sorted(jumps, key=lambda jump: -jump.size_m - jump.turn_rad)[:MOST_JUMPS]:
        tried = tuple(sorted((*harmful, jump), key=lambda jump: jump.stamp_ns))
        without = run.errors(replace(correction, jumps=tried))
        _, ate, less = improvement(errors, without, 'ATE')
        _, step, smoother = improvement(errors, without, FRAMES)
        if less < (1 - LESS_ATE) * ate or (jump.clear and smoother <= (1 - IMPROVEMENT) * step):
            harmful, errors = tried, without
    return harmful
