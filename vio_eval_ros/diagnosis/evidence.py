"""What shows a cause in a run: for each, the curves that it bends, as it is and undone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Moments, solve
from vio_eval_ros.core.metrics import position_errors
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.diagnosis.conventions import candidates
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.fitting import horizon, relative_rotations, robust_similarity
from vio_eval_ros.diagnosis.report import Diagnosis
from vio_eval_ros.rendering.figures import extremes

AS_IT_IS, UNDONE, TRUTH = 'as it is', 'with all causes undone', 'ground truth'
#: of a curve, and of a cloud
MOST_POINTS = 2000
#: seconds over which motions are compared
SHORT_S, HALF_S, LONG_S = 0.25, 0.5, 1.0
#: lags that are tried, in steps
LAGS_S = np.arange(-0.5, 0.5001, 0.01)
PARTS = 12


@dataclass(frozen=True, eq=False)
class Curve:
    """
    One curve of a picture.

    :param name: AS_IT_IS, UNDONE, TRUTH, or what it shows.
    :param x: (N,) values, or (N,) names of bars.
    :param y: (N,) values.
    :param kind: ``lines``, ``markers`` or ``bars``.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    kind: str = 'lines'


@dataclass(frozen=True, eq=False)
class Picture:
    """
    What shows a cause.

    :param equal: whether both axes have one scale.
    :param diagonal: whether points should lie on y = x.
    """

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    equal: bool = False
    diagonal: bool = False


@dataclass(frozen=True, eq=False)
class Sides:
    """The pairs of a run as it is, and with all causes undone; None where only parts can be."""

    run: DiagnosedRun
    before: Pairs
    after: Pairs | None
    lever_m: np.ndarray

    @classmethod
    def of(cls, run: DiagnosedRun, diagnosis: Diagnosis) -> Sides:
        """Return the sides of a diagnosed run."""
        corrected = run.of(diagnosis.corrected, run.truth)
        undone = all(cause.side == 'estimate' for cause in diagnosis.causes)
        lever = diagnosis.findings.get('lever_arm_m')
        return cls(
            run,
            run.pairs(Correction(run.middle_ns)),
            corrected.pairs(Correction(run.middle_ns)) if undone else None,
            np.zeros(3) if lever is None else np.asarray(lever, float),
        )

    def named(self) -> list[tuple[str, Pairs]]:
        """Return the pairs with the names of their curves."""
        both = [(AS_IT_IS, self.before)]
        return both if self.after is None else [*both, (UNDONE, self.after)]

    def seconds(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Return (N,) seconds since the first pose of the estimate."""
        return np.asarray((stamps_ns - self.run.estimate.stamps_ns[0]) / 1e9)


def pictures(diagnosis: Diagnosis) -> dict[str, Picture]:
    """Return a picture for each cause that has one, by the name of the cause."""
    run = diagnosis.run
    if run is None or not diagnosis.causes:
        return {}
    sides = Sides.of(run, diagnosis)
    found: dict[str, Picture] = {}
    for cause in diagnosis.causes:
        draw = PICTURES.get(cause.name, over_time)
        needs = sides.before.rotations is None and draw in OF_ROTATIONS
        picture = None if needs or len(sides.before) < 3 else draw(sides)
        if picture is not None and not any(picture.title == one.title for one in found.values()):
            found[cause.name] = picture
    return found


def over_time(sides: Sides) -> Picture:
    """Return how far positions are off; a gap leaves a hole."""
    curves = []
    for name, pairs in sides.named():
        error = position_errors(pairs, solve('se3', Moments.of(pairs), pairs[:1]))
        chosen = extremes(error, MOST_POINTS)
        at, error = sides.seconds(pairs.estimate.stamps_ns[chosen]), error[chosen]
        lost = np.flatnonzero(np.diff(at) > max(sides.run.gap_s, 2 * float(np.ptp(at)) / len(at)))
        at, error = (np.insert(each, lost + 1, np.nan) for each in (at, error))
        curves.append(Curve(name, at, error))
    return Picture('Position errors over the run', 'time [s]', 'position error [m]', tuple(curves))


def correlation(sides: Sides) -> Picture | None:
    """Return how well angular speeds agree over lags of the stamps."""
    curves = []
    for name, pairs in sides.named():
        heights = _correlations(sides, pairs.estimate)
        if heights is not None:
            curves.append(Curve(name, 1e3 * LAGS_S, heights))
    title = 'Angular speeds agree best at the offset of the clocks'
    return (
        Picture(title, 'lag of the stamps [ms]', 'correlation', tuple(curves)) if curves else None
    )


def _correlations(sides: Sides, poses: Trajectory) -> np.ndarray | None:
    """Return the correlation of angular speeds at each lag; None where poses are too few."""
    poses = poses[:: max(1, len(poses) // MOST_POINTS)]
    begin, end = horizon(poses.stamps_ns, SHORT_S)
    if len(begin) < 3 or poses.rotations is None:
        return None
    speed = lengths(relative_rotations(poses.rotations, begin, end))
    heights = []
    for lag_s in LAGS_S:
        then = sides.run.true_poses.at(poses.stamps_ns - round(lag_s * 1e9)).rotations
        assert then is not None
        true_speed = lengths(relative_rotations(then, begin, end))
        moving = np.std(speed) > 0 and np.std(true_speed) > 0
        heights.append(np.corrcoef(speed, true_speed)[0, 1] if moving else np.nan)
    return np.array(heights)


def offsets_along(sides: Sides) -> Picture | None:
    """Return at which lag angular speeds agree best, part by part."""
    curves = []
    for name, pairs in sides.named():
        at, best = [], []
        for rows in np.array_split(np.arange(len(pairs)), PARTS):
            heights = _correlations(sides, pairs.estimate[rows])
            if heights is not None and np.isfinite(heights).any():
                at.append(float(sides.seconds(pairs.estimate.stamps_ns[rows]).mean()))
                best.append(1e3 * LAGS_S[np.nanargmax(heights)])
        if at:
            curves.append(Curve(name, np.array(at), np.array(best)))
    title = 'The offset of the clocks along the run'
    return Picture(title, 'time [s]', 'offset of a part [ms]', tuple(curves)) if curves else None


def turns(sides: Sides) -> Picture:
    """Return a component of short relative rotations against the true one."""
    curves = []
    for name, pairs in sides.named():
        begin, end = _motions(pairs, SHORT_S)
        own, true = (
            np.degrees(relative_rotations(_rotations(side), begin, end)[:, 0])
            for side in (pairs.estimate, pairs.ground_truth)
        )
        curves.append(Curve(name, true, own, 'markers'))
    title = 'Short rotations, about the axes of both bodies'
    labels = 'true turn about x in 0.25 s [deg]', 'estimated [deg]'
    return Picture(title, *labels, tuple(curves), equal=True, diagonal=True)


def displaced(sides: Sides) -> Picture:
    """Return what displacements are off in the body's frame, against what the lever arm makes."""
    curves = []
    for name, pairs in sides.named():
        begin, end = _motions(pairs, HALF_S)
        moved, truly = (
            rotation.rotate(
                rotation.conjugate(_rotations(side)[begin]),
                side.positions[end] - side.positions[begin],
            )
            for side in (pairs.estimate, pairs.ground_truth)
        )
        of_estimate = _rotations(pairs.estimate)
        turn = rotation.multiply(rotation.conjugate(of_estimate[begin]), of_estimate[end])
        made = rotation.rotate(turn, sides.lever_m) - sides.lever_m
        curves.append(Curve(name, -made[:, 0], (moved - truly)[:, 0], 'markers'))
    title = 'Displacements against what the lever arm makes of them'
    labels = '(I - R) times the lever arm, x [m]', 'displacement error, x [m]'
    return Picture(title, *labels, tuple(curves), diagonal=True)


def from_the_side(sides: Sides) -> Picture:
    """Return the path from the side, upright as it came."""
    return _view(sides, 'The path from the side, as upright as it came', 'posyaw', (0, 2))


def from_above(sides: Sides) -> Picture:
    """Return the path from above, aligned without scale."""
    return _view(sides, 'The path from above, aligned without scale', 'se3', (0, 1))


def _view(sides: Sides, title: str, mode: str, axes: tuple[int, int]) -> Picture:
    drawn = [(TRUTH, sides.before.ground_truth.positions)]
    for name, pairs in sides.named():
        alignment = solve(mode, Moments.of(pairs), pairs[:1])
        drawn.append((name, alignment.positions(pairs.estimate.positions)))
    curves = []
    for name, positions in drawn:
        x, y = _thinned(positions)[:, list(axes)].T
        curves.append(Curve(name, x, y))
    labels = [f'{"xyz"[k]} [m]' for k in axes]
    return Picture(title, labels[0], labels[1], tuple(curves), equal=True)


def heading(sides: Sides) -> Picture:
    """Return how far the heading is off."""
    curves = []
    for name, pairs in sides.named():
        assert pairs.rotations is not None
        worlds = rotation.multiply(pairs.rotations, rotation.conjugate(pairs.rotations[0]))
        at = _thinned(sides.seconds(pairs.estimate.stamps_ns))
        yaw = np.degrees(rotation.to_rotation_vector(worlds)[:, 2])
        curves.append(Curve(name, at, -_thinned(yaw)))
    return Picture('The heading along the run', 'time [s]', 'heading error [deg]', tuple(curves))


def distances_along(sides: Sides) -> Picture:
    """Return the ratio of the distances moved, part by part."""
    curves = []
    for name, pairs in sides.named():
        begin, end = _motions(pairs, HALF_S)
        own, true = (
            lengths(side.positions[end] - side.positions[begin])
            for side in (pairs.estimate, pairs.ground_truth)
        )
        parts = [rows for rows in np.array_split(np.arange(len(own)), PARTS) if true[rows].any()]
        ratios = np.array([own[rows].sum() / true[rows].sum() for rows in parts])
        at = sides.seconds(pairs.estimate.stamps_ns)[begin]
        curves.append(Curve(name, np.array([at[rows].mean() for rows in parts]), ratios))
    title = 'The scale along the run'
    return Picture(title, 'time [s]', 'estimated over true distance', tuple(curves))


def conventions(sides: Sides) -> Picture:
    """Return what is left of relative motions under each way of reading the orientations."""
    pairs, truth = sides.before, sides.before.ground_truth
    short, long = (_motions(pairs, seconds) for seconds in (SHORT_S, LONG_S))
    labels, of_rotations, of_displacements = [], [], []
    for convention in candidates():
        poses = convention.undo(pairs.estimate)
        rotated = [relative_rotations(_rotations(each), *short) for each in (poses, truth)]
        moved = [each.positions[long[1]] - each.positions[long[0]] for each in (poses, truth)]
        of_rotations.append(robust_similarity(rotated[0], rotated[1], scaled=False).residual)
        of_displacements.append(robust_similarity(moved[0], moved[1], scaled=True).residual)
        detail = convention.detail.split(':')[0].replace(' was read as ', ' as ')
        labels.append(detail or convention.name.partition('_')[2] or 'as it is')
    names = np.array(labels)
    curves = (
        Curve('rotations', names, np.array(of_rotations), 'bars'),
        Curve('displacements', names, np.array(of_displacements), 'bars'),
    )
    title = 'What is left of relative motions, read in each way'
    return Picture(title, 'orientations read as', 'share that is left', curves)


def coordinates(sides: Sides) -> Picture:
    """Return one coordinate of both sides as they came."""
    run = sides.run
    axis = int(np.ptp(run.truth.positions, axis=0).argmax())
    curves = []
    for name, poses in ((TRUTH, run.truth), ('estimate', run.estimate)):
        at = _thinned(sides.seconds(poses.stamps_ns))
        curves.append(Curve(name, at, _thinned(poses.positions[:, axis])))
    title = 'Both sides as they came'
    return Picture(title, 'time [s]', f'{"xyz"[axis]} [m]', tuple(curves))


def _motions(pairs: Pairs, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return from where to where motions of some duration lead, evenly over the run."""
    begin, end = horizon(pairs.estimate.stamps_ns, seconds)
    return _thinned(begin), _thinned(end)


def _thinned(values: np.ndarray) -> np.ndarray:
    return values[:: -(-len(values) // MOST_POINTS) or 1]


def _rotations(poses: Trajectory) -> np.ndarray:
    assert poses.rotations is not None
    return poses.rotations


Draw = Callable[[Sides], Picture | None]
#: those that orientations are needed for
OF_ROTATIONS: tuple[Draw, ...] = (
    correlation, offsets_along, turns, displaced, heading, conventions
)  # fmt: skip
#: of causes that are not listed, the errors over time
PICTURES: dict[str, Draw] = {
    'time_offset': correlation,
    'clock_drift': offsets_along,
    'sensor_rotation': turns,
    'lever_arm': displaced,
    'gravity_tilt': from_the_side,
    'yaw_drift': heading,
    'scale': from_above,
    'scale_drift': distances_along,
    'quaternion_conjugated': conventions,
    'quaternion_order': conventions,
    'pose_inverted': conventions,
    'axes_swapped': conventions,
    'truth_static': coordinates,
    'insufficient_motion': coordinates,
    'swapped_inputs': coordinates,
}
