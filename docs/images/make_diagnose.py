"""
Draws the figures of docs/diagnose.md: each fault, put into a simulated flight, and what shows it.

Prints what ``diagnose`` finds of each, and the numbers of the experiment on time offsets. Needs
matplotlib: ``pip install '.[imu]'``, then ``python docs/images/make_diagnose.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import io
import math
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from PIL import Image

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Alignment, Moments, solve
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.metrics import position_errors
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.diagnosis.conventions import candidates
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.diagnosis.fitting import horizon, relative_rotations, robust_similarity
from vio_eval_ros.simulation import simulate, SimulatedRun
from vio_eval_ros.simulation.faults import inject

FOLDER = Path(__file__).parent
CONFIG = EvaluationConfig()
HEALTHY = simulate(duration_s=60.0)
GREY, BLUE, RED = '#8a919b', '#3f7fc4', '#d1452f'
COLOURS = 48
BLOCKS = 12
Axes = Any


def harmed(name: str, *sizes: float, seed: int = 3) -> SimulatedRun:
    """Return the flight with a fault in it."""
    return inject(HEALTHY, name, sizes, np.random.default_rng(seed))


def said(run: SimulatedRun, name: str) -> str:
    """Return what the diagnosis says of a fault, which it must have found."""
    found = diagnose(run.estimate, run.ground_truth, CONFIG)
    cause = next(cause for cause in found.causes if cause.name == name)
    spread = '' if math.isnan(cause.uncertainty) else f' ± {float(f"{cause.uncertainty:.2g}"):g}'
    value = '' if math.isnan(cause.value) else f'{cause.value:.4g}{spread} {cause.unit}'
    print(f'{name:<24} {value}')
    return name if cause.unit in ('', 'ratio') and not spread else f'{name}: {value}'


def pairs_of(run: SimulatedRun) -> Pairs:
    """Return the estimates with the true pose at each of their stamps."""
    side_by_side = DiagnosedRun(run.estimate, run.ground_truth, CONFIG)
    return side_by_side.pairs(Correction(side_by_side.middle_ns))


def seconds_of(poses: Trajectory) -> np.ndarray:
    """Return (N,) seconds since the flight began."""
    return (poses.stamps_ns - HEALTHY.ground_truth.stamps_ns[0]) / 1e9


def aligned(pairs: Pairs, mode: str = 'se3') -> tuple[Alignment, np.ndarray]:
    """Return an alignment, and the (N, 3) estimated positions under it."""
    alignment = solve(mode, Moments.of(pairs), pairs[:1])
    rotated = rotation.rotate(alignment.rotation, pairs.estimate.positions)
    return alignment, alignment.scale * rotated + alignment.translation


def errors_over_time(axes: Axes, run: SimulatedRun) -> None:
    """Draw how far the positions are off."""
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        pairs = pairs_of(each)
        error = position_errors(pairs, aligned(pairs)[0])
        at = seconds_of(pairs.estimate)
        lost = np.flatnonzero(np.diff(at) > CONFIG.max_gap_s)
        for begin, end in zip(at[lost], at[lost + 1], strict=True):
            axes.axvspan(begin, end, color=GREY, alpha=0.25, lw=0)
        error = np.insert(error, lost + 1, np.nan)
        axes.plot(np.insert(at, lost + 1, np.nan), error, '.-', ms=2, lw=0.8, color=colour)
    axes.set(xlabel='time [s]', ylabel='position error [m]')


# -- clocks ------------------------------------------------------------------------------------


def correlation(axes: Axes, run: SimulatedRun) -> None:
    """Draw the correlation of angular speeds at each lag."""
    lags_s = np.arange(-0.4, 0.4, 0.01)
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        poses = each.estimate
        begin, end = horizon(poses.stamps_ns, 0.1)
        speed = np.linalg.norm(relative_rotations(poses.rotations, begin, end), axis=1)
        truth = DiagnosedRun(poses, each.ground_truth, CONFIG).true_poses
        heights = []
        for lag_s in lags_s:
            then = truth.at(poses.stamps_ns - round(lag_s * 1e9)).rotations
            true_speed = np.linalg.norm(relative_rotations(then, begin, end), axis=1)
            heights.append(np.corrcoef(speed, true_speed)[0, 1])
        axes.plot(1e3 * lags_s, heights, color=colour)
        axes.axvline(1e3 * lags_s[np.argmax(heights)], color=colour, lw=0.8, ls=':')
    axes.set(xlabel='lag [ms]', ylabel='correlation of\nangular speeds')


def offset_along_the_run(axes: Axes, run: SimulatedRun) -> None:
    """Draw the time offset of each part of the run."""
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        parts = np.array_split(np.arange(len(each.estimate)), 8)
        found = [
            diagnose(each.estimate[rows], each.ground_truth, CONFIG).findings['time_offset']
            for rows in parts
        ]
        at = [seconds_of(each.estimate)[rows].mean() for rows in parts]
        values, spreads = ([1e3 * one[key] for one in found] for key in ('value', 'uncertainty'))
        axes.errorbar(at, values, spreads, fmt='o-', ms=3, color=colour)
    axes.set(xlabel='time [s]', ylabel='offset of a part [ms]')


# -- frames ------------------------------------------------------------------------------------


def rotations_of_both(axes: Axes, run: SimulatedRun) -> None:
    """Draw a component of short relative rotations against the true one."""
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        pairs = pairs_of(each)
        begin, end = horizon(pairs.estimate.stamps_ns, 0.25)
        own, true = (
            np.degrees(relative_rotations(side.rotations, begin, end)[:, 0])
            for side in (pairs.estimate, pairs.ground_truth)
        )
        axes.plot(true, own, '.', ms=2, color=colour)
    axes.axline((0, 0), slope=1, color=GREY, lw=0.8)
    axes.set(xlabel='true turn about x in 0.25 s [deg]', ylabel='estimated [deg]')


def moved_by_rotation(axes: Axes, run: SimulatedRun) -> None:
    """Draw what displacements are off in the body's frame, against what a lever arm makes."""
    lever = np.array(diagnose(run.estimate, run.ground_truth, CONFIG).findings['lever_arm_m'])
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        pairs = pairs_of(each)
        begin, end = horizon(pairs.estimate.stamps_ns, 0.5)
        back = rotation.conjugate(pairs.estimate.rotations[begin])
        moved, truly = (
            rotation.rotate(to_body, side.positions[end] - side.positions[begin])
            for side, to_body in (
                (pairs.estimate, back),
                (pairs.ground_truth, rotation.conjugate(pairs.ground_truth.rotations[begin])),
            )
        )
        turn = rotation.multiply(back, pairs.estimate.rotations[end])
        made = rotation.rotate(turn, lever) - lever
        axes.plot(-made[:, 0], (moved - truly)[:, 0], '.', ms=2, color=colour)
    axes.axline((0, 0), slope=1, color=GREY, lw=0.8)
    axes.set(xlabel='(I - R) times lever arm, x [m]', ylabel='displacement error, x [m]')


# -- worlds and scale --------------------------------------------------------------------------


def side_view(axes: Axes, run: SimulatedRun) -> None:
    """Draw the path from the side, upright as it came; heading and origin are taken out."""
    axes.plot(*HEALTHY.ground_truth.positions[::4, [0, 2]].T, color=GREY, lw=1)
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        _, positions = aligned(pairs_of(each), 'posyaw')
        axes.plot(*positions[:, [0, 2]].T, color=colour, lw=0.8)
    axes.set(xlabel='x [m]', ylabel='z [m]')


def heading(axes: Axes, run: SimulatedRun) -> None:
    """Draw how far the heading is off."""
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        pairs = pairs_of(each)
        worlds = rotation.multiply(pairs.rotations, rotation.conjugate(pairs.rotations[0]))
        yaw = np.degrees(rotation.to_rotation_vector(worlds)[:, 2])
        axes.plot(seconds_of(pairs.estimate), -yaw, color=colour, lw=0.8)
    axes.set(xlabel='time [s]', ylabel='heading error [deg]')


def top_view(axes: Axes, run: SimulatedRun) -> None:
    """Draw the path from above, aligned without scale."""
    axes.plot(*HEALTHY.ground_truth.positions[::4, :2].T, color=GREY, lw=1)
    axes.plot(*aligned(pairs_of(run))[1][:, :2].T, color=RED, lw=0.8)
    axes.set(xlabel='x [m]', ylabel='y [m]')


def scale_along_the_run(axes: Axes, run: SimulatedRun) -> None:
    """Draw the ratio of the distances moved, part by part."""
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        pairs = pairs_of(each)
        begin, end = horizon(pairs.estimate.stamps_ns, 0.5)
        own, true = (
            np.linalg.norm(side.positions[end] - side.positions[begin], axis=1)
            for side in (pairs.estimate, pairs.ground_truth)
        )
        parts = np.array_split(np.arange(len(own)), BLOCKS)
        ratios = [own[rows].sum() / true[rows].sum() for rows in parts]
        at = [seconds_of(pairs.estimate)[begin][rows].mean() for rows in parts]
        axes.plot(at, ratios, 'o-', ms=3, color=colour)
    axes.set(xlabel='time [s]', ylabel='estimated over\ntrue distance')


# -- conventions -------------------------------------------------------------------------------


def residuals(axes: Axes, run: SimulatedRun) -> None:
    """Draw what is left of relative rotations and of displacements, read in each way."""
    pairs = pairs_of(run)
    short, long = (horizon(pairs.estimate.stamps_ns, seconds) for seconds in (0.25, 1.0))
    truth = pairs.ground_truth
    labels, of_rotations, of_displacements = [], [], []
    for convention in candidates():
        poses = convention.undo(pairs.estimate)
        rotated = (relative_rotations(side.rotations, *short) for side in (poses, truth))
        displaced = (side.positions[long[1]] - side.positions[long[0]] for side in (poses, truth))
        of_rotations.append(robust_similarity(*rotated, scaled=False).residual)
        of_displacements.append(robust_similarity(*displaced, scaled=True).residual)
        detail = convention.detail.split(':')[0].replace(' was read as ', ' as ')
        labels.append(detail or convention.name.partition('_')[2] or 'as it is')
    at = np.arange(len(labels))
    axes.barh(at - 0.2, of_rotations, 0.4, color=RED, label='rotations')
    axes.barh(at + 0.2, of_displacements, 0.4, color=BLUE, label='displacements')
    axes.set_yticks(at, labels, fontsize=7)
    axes.invert_yaxis()
    axes.set(xlabel='what is left of relative motions', xlim=(0, 1.3))
    axes.legend(fontsize=7, loc='upper right')


# -- inputs ------------------------------------------------------------------------------------


def both_over_time(axes: Axes, run: SimulatedRun) -> None:
    """Draw one coordinate of both sides."""
    for poses, colour in ((run.ground_truth, GREY), (run.estimate, RED)):
        axes.plot(seconds_of(poses), poses.positions[:, 0], color=colour, lw=1)
    axes.set(xlabel='time [s]', ylabel='x [m]')


def curvature(axes: Axes, run: SimulatedRun) -> None:
    """Draw how far each true position is from the middle of its neighbours."""
    for each, colour in ((HEALTHY, BLUE), (run, RED)):
        points = each.ground_truth.positions[:61]
        off = np.linalg.norm((points[2:] + points[:-2]) / 2 - points[1:-1], axis=1)
        at_ms = 1e3 * seconds_of(each.ground_truth)[1:60]
        axes.semilogy(at_ms, off + 1e-16, '.-', ms=4, lw=0.6, color=colour)
    axes.set(xlabel='time [ms]', ylabel='from the middle of\nits neighbours [m]')


def interpolated() -> SimulatedRun:
    """Return the flight with a truth of straight lines between poses 50 ms apart."""
    truth = HEALTHY.ground_truth
    knots = truth[::10]
    inside = truth[truth.stamps_ns <= knots.stamps_ns[-1]]
    points = [
        np.interp(seconds_of(inside), seconds_of(knots), column) for column in knots.positions.T
    ]
    run = replace(HEALTHY, ground_truth=replace(inside, positions=np.stack(points, -1)))
    found = diagnose(run.estimate, run.ground_truth, CONFIG).findings['truth_interpolated_s']
    print(f'{"interpolated truth":<24} from poses {found:.4g} s apart')
    return run


def exchanged(axes: Axes, run: SimulatedRun) -> None:
    """Draw where both sides begin."""
    sides = ((run.ground_truth, GREY, 'ground truth'), (run.estimate, RED, 'estimate'))
    for poses, colour, label in sides:
        early = poses[seconds_of(poses) < 3.0]
        axes.plot(*early.positions[:, :2].T, '.-', ms=3, lw=0.6, color=colour, label=label)
        axes.plot(*early.positions[0, :2], 'o', ms=7, mfc='none', color=colour)
    axes.axhline(0, color=GREY, lw=0.5)
    axes.axvline(0, color=GREY, lw=0.5)
    axes.set(xlabel='x [m]', ylabel='y [m], first 3 s')


# -- the geometry of a time offset ---------------------------------------------------------------


def offset_experiment(figure: Figure) -> None:
    """Draw errors against rates for offsets of several sizes, and print the slopes."""
    left, right = figure.subplots(1, 2)
    print('\n| put in [ms] | rotation over angular rate [ms] | position over velocity [ms] | '
          'diagnose [ms] |\n|---:|---:|---:|---:|')  # fmt: skip
    for offset_ms, colour in ((20, '#86b63c'), (50, BLUE), (100, RED)):
        run = harmed('time_offset', offset_ms / 1e3)
        pairs = pairs_of(run)
        alignment, positions = aligned(pairs)
        truth = DiagnosedRun(run.estimate, run.ground_truth, CONFIG).true_poses
        stamps_ns = pairs.estimate.stamps_ns
        before, after = (truth.at(stamps_ns + step) for step in (-5_000_000, 5_000_000))
        between = rotation.multiply(rotation.conjugate(before.rotations), after.rotations)
        rates = rotation.to_rotation_vector(between) / 0.01
        velocities = (after.positions - before.positions) / 0.01
        own = rotation.multiply(alignment.rotation, pairs.estimate.rotations)
        apart = rotation.multiply(rotation.conjugate(own), pairs.ground_truth.rotations)
        rotated = rotation.to_rotation_vector(apart)
        moved = pairs.ground_truth.positions - positions
        slopes = []
        for axes, error, rate in (
            (left, np.degrees(rotated), np.degrees(rates)),
            (right, moved, velocities),
        ):
            slopes.append(1e3 * float(np.sum(error * rate) / np.sum(rate * rate)))
            axes.plot(rate[:, 0], error[:, 0], '.', ms=2, color=colour)
            axes.axline((0, 0), slope=offset_ms / 1e3, color=colour, lw=1)
        found = diagnose(run.estimate, run.ground_truth, CONFIG).findings['time_offset']
        print(f'| {offset_ms} | {slopes[0]:.1f} | {slopes[1]:.1f} | '
              f'{1e3 * found["value"]:.2f} ± {1e3 * found["uncertainty"]:.2f} |')  # fmt: skip
    left.set(xlabel='angular rate about x [deg/s]', ylabel='rotation error about x [deg]')
    right.set(xlabel='velocity along x [m/s]', ylabel='position error along x [m]')
    figure.suptitle('errors of stamps that are 20, 50, 100 ms late; lines: rate × offset', size=9)


Panel = tuple[str, tuple[float, ...], Callable[[Axes, SimulatedRun], None]]
SHEETS: dict[str, list[Panel]] = {
    'clocks': [
        ('time_offset', (0.08,), correlation),
        ('clock_drift', (1500.0,), offset_along_the_run),
    ],
    'frames': [
        ('sensor_rotation', (20.0,), rotations_of_both),
        ('lever_arm', (0.2,), moved_by_rotation),
    ],
    'world': [('gravity_tilt', (5.0,), side_view), ('yaw_drift', (20.0,), heading)],
    'scale': [('scale', (1.2,), top_view), ('scale_drift', (30.0,), scale_along_the_run)],
    'breaks': [
        ('jump', (1.0,), errors_over_time),
        ('outliers', (0.01, 1.5), errors_over_time),
        ('lost_tracking', (0.2,), errors_over_time),
        ('diverged', (0.2, 20.0), errors_over_time),
    ],
    'conventions': [
        ('quaternion_conjugated', (), residuals),
        ('quaternion_order', (1.0,), residuals),
        ('pose_inverted', (), residuals),
        ('axes_swapped', (), residuals),
    ],
    'inputs': [
        ('truth_static', (), both_over_time),
        ('insufficient_motion', (), both_over_time),
        ('swapped_inputs', (), exchanged),
    ],
}


def sheet(name: str, panels: list[Panel]) -> None:
    """Draw some faults side by side."""
    more = [('interpolated truth', curvature)] if name == 'inputs' else []
    rows = (len(panels) + len(more)) // 2
    figure = new_figure(rows)
    places = figure.subplots(rows, 2, squeeze=False).ravel()
    for axes, (fault, sizes, draw) in zip(places, panels, strict=False):
        run = harmed(fault, *sizes)
        draw(axes, run)
        axes.set_title(said(run, fault), fontsize=9)
    for axes, (title, draw_more) in zip(places[len(panels) :], more, strict=True):
        draw_more(axes, interpolated())
        axes.set_title(title, fontsize=9)
    save(figure, name)


def new_figure(rows: int) -> Figure:
    """Return a figure that is as wide as a page of text."""
    figure = Figure(figsize=(8, 2.5 * rows), layout='constrained')
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, name: str) -> None:
    """Write a figure, with quiet grids."""
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        axes.tick_params(labelsize=7)
        for label in (axes.xaxis.label, axes.yaxis.label):
            label.set_fontsize(8)
    png = io.BytesIO()
    figure.savefig(png, dpi=90)
    # a palette is a third of the bytes
    image = Image.open(png).convert('RGB').quantize(COLOURS, dither=Image.Dither.NONE)
    image.save(FOLDER / f'diagnose_{name}.png', optimize=True)


def main() -> None:
    """Draw all of them."""
    for name, panels in SHEETS.items():
        sheet(name, panels)
    figure = new_figure(1)
    offset_experiment(figure)
    save(figure, 'offset')


if __name__ == '__main__':
    main()
