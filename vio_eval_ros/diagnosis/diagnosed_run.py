"""One run to be diagnosed: its poses side by side, and its errors under a correction."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
import math
import re

import numpy as np

from vio_eval_ros.core.alignment import Moments, solve
from vio_eval_ros.core.config import Delta, EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.intervals import longest_tracked
from vio_eval_ros.core.metrics import position_errors, rotation_errors
from vio_eval_ros.core.orientations import why_positions_only
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.relative import candidates, progress_along, relative_errors
from vio_eval_ros.core.statistics import root_mean_square
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.errors import NoPairs

ATE = 'ATE [m]'
EACH_FRAME = EvaluationConfig()
FEWEST_POSES = 20
#: smaller errors, in m or deg, cannot be reduced
SMALLEST_ERROR = 1e-6
#: a curve through true poses that are further apart misses the motion between them
LONGEST_CURVE_S = 0.25
#: stamps are kept within so many durations of nine tenths of the run
STAMP_REACH = 10


class DiagnosedRun:
    """
    An estimate and its truth on one clock and of one body, as far as that is known.

    :param config: the options that have been applied.
    :param quick: whether to leave out what takes seconds.
    :raises NoPairs: where one side has too few poses.
    """

    def __init__(
        self,
        estimate: Trajectory,
        truth: Trajectory,
        config: EvaluationConfig,
        quick: bool = False,
    ) -> None:
        self.config, self.quick = config, quick
        received = {'estimate': estimate, 'ground_truth': truth}
        sides = {name: _together(poses) for name, poses in received.items()}
        #: how many poses of each side have stamps far from all others, and are left out
        self.stray = {name: len(received[name]) - len(poses) for name, poses in sides.items()}
        #: the sides whose orientations are one constant that stands for none, and are left out
        self.constant_orientations = [
            name for name, poses in sides.items() if why_positions_only(poses)
        ]
        self.estimate, self.truth = (
            replace(poses, rotations=None) if name in self.constant_orientations else poses
            for name, poses in sides.items()
        )
        for name, side in (('estimate', self.estimate), ('ground truth', self.truth)):
            if len(side) < FEWEST_POSES:
                raise NoPairs(
                    f'the {name} has {len(side)} usable poses; a diagnosis needs at least '
                    f'{FEWEST_POSES}'
                )
        self.oriented = self.estimate.rotations is not None and self.truth.rotations is not None
        stamps_ns = self.estimate.stamps_ns
        self.middle_ns = int(stamps_ns[0] + stamps_ns[-1]) // 2
        self.half_s = float(stamps_ns[-1] - stamps_ns[0]) / 2e9

    @classmethod
    def received(
        cls,
        estimate: Trajectory,
        truth: Trajectory,
        config: EvaluationConfig,
        quick: bool = False,
    ) -> DiagnosedRun:
        """Return the run of two streams as they came: shifted, moved to the body and cropped."""
        truth = Preparation.of_ground_truth(config).apply(truth)
        estimate = Preparation.of_estimate(config).apply(estimate)
        if len(truth) and (config.start_s or math.isfinite(config.end_s)):
            elapsed_s = (truth.stamps_ns - _together(truth).stamps_ns[0]) / 1e9
            truth = truth[(elapsed_s >= config.start_s) & (elapsed_s <= config.end_s)]
        return cls(estimate, truth, config, quick)

    def of(self, estimate: Trajectory, truth: Trajectory) -> DiagnosedRun:
        """Return this run of other poses, made from its own."""
        run = DiagnosedRun(estimate, truth, self.config, self.quick)
        run.stray, run.constant_orientations = self.stray, self.constant_orientations
        return run

    @cached_property
    def gap_s(self) -> float:
        """Over longer intervals the truth is not interpolated."""
        interval_s = float(np.median(np.diff(self.truth.stamps_ns))) / 1e9
        return longest_tracked(self.config.max_gap_s, interval_s)

    @cached_property
    def true_poses(self) -> Interpolator:
        """The truth at any stamp."""
        return Interpolator(self.truth, self.gap_s)

    def pairs(self, correction: Correction) -> Pairs:
        """Return the corrected estimate with the true pose at every stamp that has one."""
        corrected = correction.apply(self.estimate)
        corrected = corrected[self.true_poses.inside(corrected.stamps_ns)]
        return Pairs.of(corrected, self.true_poses.at(corrected.stamps_ns))

    def compared(self, correction: Correction) -> Pairs:
        """Return the pairs, or where true poses are far apart, the estimate at their stamps."""
        if self.true_poses.interval_s < LONGEST_CURVE_S or len(self.estimate) < len(self.truth):
            return self.pairs(correction)
        estimated = Interpolator(correction.apply(self.estimate), self.config.max_gap_s)
        truth = self.truth[estimated.inside(self.truth.stamps_ns)]
        return Pairs.of(estimated.at(truth.stamps_ns), truth)

    def errors(self, correction: Correction) -> dict[str, float]:
        """Return the root mean square of every kind of error that undoing a cause may reduce."""
        pairs = self.compared(correction)
        if len(pairs) < FEWEST_POSES:
            return {}
        moments = Moments.of(pairs)
        aligned, levelled = (solve(mode, moments, pairs[:1]) for mode in ('se3', 'posyaw'))
        errors = {
            ATE: position_errors(pairs, aligned),
            'posyaw ATE [m]': position_errors(pairs, levelled),
            'rotation ATE [deg]': rotation_errors(pairs, aligned),
        }
        for delta in (Delta(1, 'f'), Delta(1, 's')):
            apart = candidates(progress_along(pairs, delta.unit), delta, EACH_FRAME)
            begin, end = apart.begin[apart.usable], apart.end[apart.usable]
            pose, angle, displacement, _ = relative_errors(pairs, begin, end, aligned)
            errors[f'RPE {delta} [m]'] = displacement if pairs.rotations is None else pose
            errors[f'rotation RPE {delta} [deg]'] = angle
        return {name: root_mean_square(each) for name, each in errors.items()}

    def is_worse(self, correction: Correction, than: Correction, percent: float) -> bool:
        """Return whether one correction leaves an ATE that is larger by some percent."""
        ates = [self.errors(one).get(ATE, math.nan) for one in (correction, than)]
        return bool(ates[0] > (1 + percent / 100) * ates[1])

    def ate_m(self, correction: Correction) -> float:
        """Return the ATE of the corrected estimate as ``replay`` gives it; NaN without pairs."""
        # offset, frames and crop have been applied
        config = EvaluationConfig(
            association=self.config.association,
            max_difference_s=self.config.max_difference_s,
            max_gap_s=self.config.max_gap_s,
            alignment=self.config.alignment,
            align_first_s=self.config.align_first_s,
            rpe_deltas=(),
        )
        evaluation = Evaluation(config)
        evaluation.add_ground_truth(self.truth)
        evaluation.add_estimate(correction.apply(self.estimate))
        evaluation.flush()
        return evaluation.running()['ate_trans_rmse_m']


def _together(poses: Trajectory) -> Trajectory:
    """Return the poses without those whose stamps are far from nearly all, such as zero."""
    if len(poses) < FEWEST_POSES:
        return poses
    early, late = poses.stamps_ns[[len(poses) // 20, -1 - len(poses) // 20]]
    reach = STAMP_REACH * (late - early)
    near = (poses.stamps_ns > early - reach) & (poses.stamps_ns < late + reach)
    return poses if near.all() else poses[near]


def improvement(
    before: dict[str, float], after: dict[str, float], kinds: str = ''
) -> tuple[str, float, float]:
    """
    Return the error that is reduced by the largest share, and its values before and after.

    :param kinds: a regular expression that the beginnings of the errors' names must match.
    """
    if after and not before:
        return 'share of poses without a partner [ratio]', 1.0, 0.0
    known = [
        name
        for name in before
        if re.match(kinds, name)
        and before[name] > SMALLEST_ERROR
        and math.isfinite(after.get(name, math.nan))
    ]
    best = min(known, key=lambda name: after[name] / before[name], default='')
    return (best, before[best], after[best]) if best else ('no error', 1.0, 1.0)
