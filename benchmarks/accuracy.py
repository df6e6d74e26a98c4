"""
Compares our figures with those of evo and of the KITTI devkit on real runs.

Writes docs/accuracy.md, with --check only tells whether it is up to date; exits with 1 where it
is not, or where a figure differs by more than 1e-6 relative.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
import copy
import json
import math
import os
from pathlib import Path
import sys
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Moments, solve
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.metrics import position_errors
from vio_eval_ros.core.statistics import root_mean_square
from vio_eval_ros.core.trajectory import Pairs, Trajectory
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.recordings.sources import read_sources

try:
    from evo.core import metrics, sync
    from evo.core.metrics import PoseRelation, Unit
    from evo.core.trajectory import PosePath3D, PoseTrajectory3D
    from evo.tools.file_interface import (
        read_euroc_csv_trajectory,
        read_kitti_poses_file,
        read_tum_trajectory_file,
    )
except ImportError:
    sys.exit('evo, to compare with, is not there: pip install evo==1.38.1')

PROJECT = Path(__file__).resolve().parents[1]
DOCUMENT = PROJECT / 'docs' / 'accuracy.md'
# What other tools computed for files whose quaternions had been brought to unit length.
OTHER_TOOLS = PROJECT / 'benchmarks' / 'other_tools.json'
DATA = Path(os.environ.get('VIO_EVAL_ROS_DATA', PROJECT.parent / 'shared' / 'data'))
EVO_DATA = DATA / 'evo_test_data'
V102 = (EVO_DATA / 'V102.txt', DATA / 'gt_euroc/vins_mono_asl_csv/V1_02_medium/data.csv')
FREIBURG = (
    EVO_DATA / 'freiburg1_xyz-rgbdslam_drift.txt',
    EVO_DATA / 'freiburg1_xyz-groundtruth.txt',
)
KITTI = (EVO_DATA / 'KITTI_00_ORB.txt', EVO_DATA / 'KITTI_00_gt.txt')
KITTI_TIMES = EVO_DATA / 'KITTI_00_gt_times.txt'

TOLERANCE = 1e-6
STATISTICS = ('rmse', 'mean', 'median', 'std', 'min', 'max')
# The columns of the large table, by the names of golden.json.
COLUMNS = {
    'ATE none [m]': 'ate_none_trans rmse',
    'se3 [m]': 'ate_se3_trans rmse',
    'sim3 [m]': 'ate_sim3_trans rmse',
    'scale': 'sim3_scale',
    'se3 [deg]': 'ate_se3_rot_deg rmse',
    'RPE 1f [m]': 'rpe_1f_trans rmse',
    '1f [deg]': 'rpe_1f_rot_deg rmse',
    '10f [m]': 'rpe_10f_trans rmse',
    '10f [deg]': 'rpe_10f_rot_deg rmse',
}
# What the KITTI odometry devkit prints for that pair.
DEVKIT = {
    'kitti_trans_percent': '0.6997',
    'kitti_rot_deg_per_m': '0.002533',
    'kitti_segments': '3283',
}

TRANSLATION, ROTATION = PoseRelation.translation_part, PoseRelation.rotation_angle_deg

Numbers = dict[str, float]
Evo = tuple[PosePath3D, PosePath3D]  # the ground truth comes first


class Figure(NamedTuple):
    """A number as another tool has it, as text where only its print is known, and as we do."""

    name: str
    theirs: float | str
    ours: float

    @property
    def difference(self) -> float:
        """The difference relative to theirs; none where ours is the same in print."""
        if isinstance(self.theirs, str):
            decimals = len(self.theirs.partition('.')[2])
            return 0.0 if f'{self.ours:.{decimals}f}' == self.theirs else math.inf
        return abs(self.ours - self.theirs) / abs(self.theirs)


def side_by_side(theirs: Mapping[str, float | str], ours: Numbers) -> list[Figure]:
    """Return all of their numbers with ours of the same name."""
    return [Figure(name, value, ours[name]) for name, value in theirs.items()]


def replayed(pair: Sequence[Any], times: Path | None = None, **options: Any) -> Numbers:
    """Return our metrics and the number of pairs, with options set as evo's are."""
    estimate, truth = read_sources([str(spec) for spec in pair], times=times)
    like_evo = {'max_difference_s': 0.01, 'rpe_pairs': 'sequential', 'rpe_deltas': ['1f']}
    evaluation = Evaluation(EvaluationConfig.from_mapping(like_evo | options))
    evaluation.add_ground_truth(truth.poses)
    evaluation.add_estimate(estimate.poses)
    evaluation.flush()
    summary = evaluation.summary()
    return {'pairs': len(summary.pairs)} | summary.metrics


def replayed_twice(pair: Sequence[Any], times: Path | None = None) -> Numbers:
    """Return our metrics under se3, and the ATE under origin."""
    origin = replayed(pair, times, alignment='origin')['ate_trans_rmse_m']
    return replayed(pair, times) | {'ate_origin_trans_rmse_m': origin}


def golden_figures(golden: Mapping[str, Any]) -> list[Figure]:
    """Return all that golden.json has of a pair of files, by its names."""
    pair = [f'{DATA}/{golden[side]}' for side in ('estimate', 'ground_truth')]
    ours = {
        mode: replayed(
            pair,
            alignment=mode,
            rpe_deltas=['1f', '10f'],
            max_difference_s=golden['max_difference_s'],
        )
        for mode in ('none', 'se3', 'sim3')
    }
    figures = [
        Figure('pairs', golden['matched'], ours['se3']['pairs']),
        Figure('sim3_scale', golden['sim3_scale'], ours['se3']['sim3_scale']),
    ]
    names = {
        f'ate_{mode}_{theirs}': (mode, f'ate_{mine}')
        for mode in ours
        for theirs, mine in (('trans', 'trans_{}_m'), ('rot_deg', 'rot_{}_deg'))
    } | {
        f'rpe_{delta}_{theirs}': ('se3', f'rpe_{delta}_{mine}')
        for delta in ('1f', '10f')
        for theirs, mine in (
            ('trans', 'trans_{}_m'),
            ('rot_deg', 'rot_{}_deg'),
            ('point', 'dist_{}_m'),
        )
    }
    for theirs, (mode, mine) in names.items():
        figures += [
            Figure(f'{theirs} {name}', golden[theirs][name], ours[mode][mine.format(name)])
            for name in STATISTICS
        ]
    return figures


def evo_ate(pair: Evo, mode: str, relation: PoseRelation = TRANSLATION) -> float:
    """Return evo's ATE under an alignment."""
    truth, estimate = pair[0], copy.deepcopy(pair[1])
    if mode == 'origin':
        estimate.align_origin(truth)
    elif mode != 'none':
        estimate.align(truth, correct_scale=mode == 'sim3')
    metric = metrics.APE(relation)
    metric.process_data((truth, estimate))
    return metric.get_statistic(metrics.StatisticsType.rmse)


def evo_rpe(
    pair: Evo, relation: PoseRelation, delta: float = 1, unit: Unit = Unit.frames, **options: bool
) -> tuple[Numbers, int]:
    """Return the statistics of evo's RPE, and the number of its errors."""
    metric = metrics.RPE(relation, delta, unit, **options)
    metric.process_data(pair)
    return metric.get_all_statistics(), len(metric.error)


def evo_numbers(pair: Evo, modes: Sequence[str] = ('none', 'origin', 'se3', 'sim3')) -> Numbers:
    """Return what evo gives for a pair of trajectories, under our names."""
    truth, estimate = pair
    numbers = {f'ate_{mode}_trans_rmse_m': evo_ate(pair, mode) for mode in modes}
    return {
        'pairs': truth.num_poses,
        **numbers,
        'sim3_scale': copy.deepcopy(estimate).align(truth, correct_scale=True)[2],
        'ate_rot_rmse_deg': evo_ate(pair, 'se3', ROTATION),
        'rpe_1f_trans_rmse_m': evo_rpe(pair, TRANSLATION)[0]['rmse'],
        'rpe_1f_rot_rmse_deg': evo_rpe(pair, ROTATION)[0]['rmse'],
    }


def v102() -> tuple[list[Figure], list[Figure], Numbers]:
    """Return the figures of V102 without its repeated stamps and with them, and evo's of these."""
    estimate = read_tum_trajectory_file(str(V102[0]))
    truth = read_euroc_csv_trajectory(str(V102[1]))
    first = np.unique(estimate.timestamps, return_index=True)[1]
    cleaned = PoseTrajectory3D(
        estimate.positions_xyz[first],
        estimate.orientations_quat_wxyz[first],
        estimate.timestamps[first],
    )
    raw = sync.associate_trajectories(truth, estimate)
    theirs, pairs = evo_numbers(raw), as_ours(raw)
    figures = [Figure('pairs', theirs['pairs'], len(pairs))]
    for mode in ('none', 'origin', 'posyaw', 'se3', 'sim3'):
        name = f'ate_{mode}_trans_rmse_m'
        alignment = solve(mode, Moments.of(pairs), pairs[:1])
        value = searched_posyaw(pairs) if mode == 'posyaw' else theirs[name]
        figures.append(Figure(name, value, root_mean_square(position_errors(pairs, alignment))))
    compared = sync.associate_trajectories(truth, cleaned)
    return side_by_side(evo_numbers(compared), replayed_twice(V102)), figures, theirs


def as_ours(pair: Evo) -> Pairs:
    """Return evo's pairs as ours."""
    truth, estimate = (
        Trajectory(
            np.arange(side.num_poses),
            side.positions_xyz,
            rotation.normalize(np.roll(side.orientations_quat_wxyz, -1, axis=1)),
        )
        for side in pair
    )
    return Pairs.of(estimate, truth)


def searched_posyaw(pairs: Pairs) -> float:
    """Return the smallest ATE over rotations about the vertical, found by trying."""
    estimate, truth = (
        side.positions - side.positions.mean(axis=0)
        for side in (pairs.estimate, pairs.ground_truth)
    )

    def error(yaw: float) -> float:
        turned = rotation.rotate(rotation.from_rotation_vector(np.array([0, 0, yaw])), estimate)
        return math.sqrt(np.sum((turned - truth) ** 2) / len(pairs))

    centre, width = 0.0, math.pi
    while width > 1e-9:
        centre = min(np.linspace(centre - width, centre + width, 41), key=error)
        width /= 10
    return error(centre)


def freiburg() -> list[Figure]:
    """Return the figures of the RGBDSLAM run: deltas, and how stamps are matched."""
    estimate, truth = (read_tum_trajectory_file(str(path)) for path in FREIBURG)
    pair = sync.associate_trajectories(truth, estimate)
    figures = side_by_side(evo_numbers(pair), replayed_twice(FREIBURG))
    for mode, delta in (('sequential', '10f'), ('all', '10f'), ('all', '1m')):
        ours = replayed(FREIBURG, rpe_pairs=mode, rpe_deltas=[delta])
        name, every, path = f'rpe_{delta}_trans_rmse_m', mode == 'all', delta.endswith('m')
        theirs, count = evo_rpe(
            pair,
            TRANSLATION,
            float(delta[:-1]),
            Unit.meters if path else Unit.frames,
            all_pairs=every,
            pairs_from_reference=path,
        )
        figures += [
            Figure(f'{name}, {mode}', theirs['rmse'], ours[name]),
            Figure(f'rpe_{delta}_pairs, {mode}', count, ours[f'rpe_{delta}_pairs']),
        ]
    for remark, theirs, ours in (
        ('within 0.02 s', {'max_diff': 0.02}, {'max_difference_s': 0.02}),
        (
            'interpolated',
            {'sync_method': sync.SyncMethod.interpolation},
            {'association': 'interpolate', 'max_gap_s': 0.02},
        ),
    ):
        pair = sync.associate_trajectories(truth, estimate, **theirs)
        found = replayed(FREIBURG, **ours)
        name = 'ate_se3_trans_rmse_m'
        figures += [
            Figure(f'pairs, {remark}', pair[0].num_poses, found['pairs']),
            Figure(f'{name}, {remark}', evo_ate(pair, 'se3'), found[name]),
        ]
    return figures


def kitti() -> tuple[list[Figure], dict[str, str]]:
    """Return the figures of ORB-SLAM on KITTI 00, and what the text says of others."""
    estimate, truth = (read_kitti_poses_file(str(path)) for path in KITTI)
    pair = truth, estimate
    along_estimate, along_truth = (
        evo_rpe(
            pair, TRANSLATION, 100, Unit.meters, all_pairs=True, pairs_from_reference=reference
        )
        for reference in (False, True)
    )
    theirs = evo_numbers(pair, ('none', 'se3', 'sim3')) | {
        'rpe_100m_trans_rmse_m': along_truth[0]['rmse'],
        'rpe_100m_trans_mean_m': along_truth[0]['mean'],
        'rpe_100m_pairs': along_truth[1],
    }
    frames = replayed_twice(KITTI, KITTI_TIMES)
    ours = replayed(KITTI, KITTI_TIMES, rpe_pairs='all', rpe_deltas=['100m']) | frames
    origin = Figure('', evo_ate(pair, 'origin'), frames['ate_origin_trans_rmse_m'])
    return side_by_side(theirs | DEVKIT, ours), {
        'kitti_rmse': shown(along_estimate[0]['rmse']),
        'kitti_mean': shown(along_estimate[0]['mean']),
        'kitti_origin': f'{origin.difference:.0e}'.replace('e-0', 'e-'),
    }


def preset_figures() -> dict[str, list[tuple[str, list[Figure]]]]:
    """Return for each tool the names of runs with its figures beside those of its preset."""
    found: dict[str, list[tuple[str, list[Figure]]]] = {}
    for tool, recorded in json.loads(OTHER_TOOLS.read_text(encoding='utf-8')).items():
        config = EvaluationConfig.from_mapping({'as': tool})
        found[tool] = []
        for run in recorded['runs']:
            specs = [str(DATA / run[side]) for side in ('estimate', 'ground_truth')]
            result = score_run(*read_sources(specs), config, hashed=False)
            ours = {'pairs': len(result.summary.pairs)} | result.summary.metrics
            found[tool].append((run['name'], side_by_side(run['figures'], ours)))
    return found


def preset_table(found: Mapping[str, Sequence[tuple[str, list[Figure]]]]) -> str:
    """Return a row for each run of each tool."""
    lines = [
        '| tool | run | ATE [m] | ours | ATE [deg] | ours | figures | largest difference |',
        '|---|---|---:|---:|---:|---:|---:|---:|',
    ]
    for tool, runs in found.items():
        for name, figures in runs:
            by_name = {figure.name: figure for figure in figures}
            ate = [by_name[key] for key in ('ate_trans_rmse_m', 'ate_rot_rmse_deg')]
            numbers = ' | '.join(f'{shown(one.theirs)} | {shown(one.ours)}' for one in ate)
            largest = bound(max(figure.difference for figure in figures))
            lines.append(f'| {tool} | {name} | {numbers} | {len(figures)} | {largest} |')
    return '\n'.join(lines)


def bound(difference: float) -> str:
    """Return a power of ten above a difference: its digits would be those of rounding."""
    above = max(math.floor(math.log10(difference)) + 1, -9) if difference else -9
    return f'< 1e{above}'


def shown(value: float | str) -> str:
    """Return six significant digits, or the text that is known."""
    return value if isinstance(value, str) else f'{value:.6g}'


def table(figures: Sequence[Figure], tool: str) -> str:
    """Return a table of figures."""
    lines = [f'| figure | {tool} | ours | difference |', '|---|---:|---:|---:|']
    for figure in figures:
        printed = isinstance(figure.theirs, str)
        name = figure.name.replace('ate_origin_trans_rmse_m', 'ate_trans_rmse_m under origin')
        lines.append(
            f'| {name} | {shown(figure.theirs)} | {shown(figure.ours)} '
            f'| {"same in print" if printed else bound(figure.difference)} |'
        )
    return '\n'.join(lines)


def golden_table(rows: Sequence[tuple[Mapping[str, Any], list[Figure]]]) -> str:
    """Return a table with two rows a pair: what evo has, and what we have."""
    lines = [
        f'| run | | pairs | {" | ".join(COLUMNS)} | largest difference |',
        '|---|---|---:|' + '---:|' * len(COLUMNS) + '---:|',
    ]
    for golden, figures in rows:
        found = {figure.name: figure for figure in figures}
        chosen = [found[name] for name in ('pairs', *COLUMNS.values())]
        name, _, remark = golden['system'].partition(' (')
        run = f'{golden["sequence"]}: {golden["system"] if len(remark) < 25 else name}'
        largest = bound(max(figure.difference for figure in figures))
        lines += [
            f'| {run} | evo | {" | ".join(shown(f.theirs) for f in chosen)} | {largest} |',
            f'| | ours | {" | ".join(shown(f.ours) for f in chosen)} | |',
        ]
    return '\n'.join(lines)


TEXT = """\
# Accuracy against other tools

Our figures on published runs beside those of evo 1.38.1, of the KITTI odometry
devkit, of rpg_trajectory_evaluation and of OpenVINS' ov_eval. Written
by `python benchmarks/accuracy.py`, which fails where a figure differs by more than 1e-6 relative.
Every difference is relative to the other tool.

## Twenty pairs of files

With `--max-difference-s 0.01 --rpe-pairs sequential --rpe-deltas 1f 10f`, as evo does by default.
For evo, the files were sorted, and rows with NaN and all but the first of equal stamps were
dropped; `replay` does that itself. The table shows root mean squares. The largest difference is
over all {count} numbers of a pair: rmse, mean, median, standard deviation, minimum and maximum of
the ATE of position and rotation under each of the three alignments, and of the RPE of position,
rotation and distance over 1 and 10 frames; the scale; the number of pairs.

{golden}

## EuRoC V1_02, evo's example

Four rows of `V102.txt` repeat the stamp of the row before. evo keeps them and pairs the same true
pose twice: 798 pairs. `replay` keeps the first of equal stamps and counts the others, since a body
is in one place at a time: 794 pairs. Only this cleaning differs, not the arithmetic: on the file
without the four rows evo finds what `replay` finds on the original.

{cleaned}

With the four rows evo's RPE over one frame is {raw_trans} m and {raw_rot} deg. Given
evo's own 798 pairs, our alignments agree as well. evo has no `posyaw`; its column has the smallest
error found by a search over angles.

{as_it_is}

## TUM freiburg1_xyz, RGBDSLAM with artificial drift

Here evo measures metres along the ground truth (`--pairs_from_reference`). To interpolate, evo
needs one true pose within 0.01 s, and `replay` two that are at most `--max-gap-s` apart, here
0.02 s.

{freiburg}

## KITTI 00, ORB-SLAM

{kitti}

Metres are along the ground truth again; along the estimate, its default, evo gives an RMSE of
{kitti_rmse} m and a mean of {kitti_mean} m. The matrices in these files are rotations to about
six digits. evo uses them as they are, `replay` turns them into unit quaternions. Hence the larger
differences, and one of {kitti_origin} in the ATE under `origin`, which depends on a single matrix.

## rpg_trajectory_evaluation and ov_eval

With `--as rpg` and `--as ov_eval`, which are what the tools do by default. Their own code was
run once on these files, and `benchmarks/other_tools.json` has what it computed: statistics of the
ATE of position and rotation, and of the relative errors over 10 to 50 % of the path (rpg) or over
8 to 40 m (ov_eval, medians). Quaternions in the files have few digits; the tools take them as they
are, which changes rotations by up to 4e-5, and `replay` brings them to unit length. The tools were
given files in which that had been done.

{presets}

## Where the definitions differ, and why

- **Equal stamps.** evo keeps all poses; here the first is kept and the others are counted.
- **Association.** In evo each pose of the shorter trajectory is paired with the nearest of the
  other, and two may share one. Here the poses of a pair are each other's nearest, so the pairs
  depend neither on which side is the estimate nor on the order in which poses arrive.
- **Stamps.** Integer nanoseconds here; seconds in float64, as in evo, resolve 238 ns today.
- **Tolerance.** 0.02 s by default, as in the TUM RGB-D scripts, and 0.01 s in evo.
- **RPE pairs.** From every pose by default; in evo each pair starts where the previous one ended.
- **Metres.** Along the ground truth, so that a scale error does not change the delta; along the
  estimate in evo by default. With `--rpe-pairs sequential` pairs end at the poses nearest to the
  multiples of the delta; in evo each starts where the previous one ended, and overshoots add up.
- **Scale.** The RPE uses the scale of the alignment if it has one, so that ATE and RPE describe
  the same estimate; in evo only with `-s`.
- **Straight lines and single points.** evo refuses to align them. Here positions are scored,
  rotation errors are null, and a warning says so.
- **KITTI segments** start at every tenth matched pose (in the devkit at every tenth pose), so a
  run that lost frames has fewer segments."""


def document() -> tuple[str, list[Figure]]:
    """Return the text, and the figures that do not agree."""
    pairs = json.loads((DATA / 'golden.json').read_text(encoding='utf-8'))
    golden = [(pair, golden_figures(pair)) for pair in pairs]
    (cleaned, as_it_is, raw), fr1, (kitti_00, remarks) = v102(), freiburg(), kitti()
    presets = preset_figures()
    text = TEXT.format(
        count=len(golden[0][1]),
        golden=golden_table(golden),
        cleaned=table(cleaned, 'evo'),
        as_it_is=table(as_it_is, 'evo, search'),
        freiburg=table(fr1, 'evo'),
        kitti=table(kitti_00, 'evo, devkit'),
        presets=preset_table(presets),
        raw_trans=shown(raw['rpe_1f_trans_rmse_m']),
        raw_rot=shown(raw['rpe_1f_rot_rmse_deg']),
        **remarks,
    )
    figures = [*cleaned, *as_it_is, *fr1, *kitti_00]
    figures += [figure for _, of_pair in golden for figure in of_pair]
    figures += [figure for runs in presets.values() for _, of_run in runs for figure in of_run]
    return text, [figure for figure in figures if not figure.difference <= TOLERANCE]


def main() -> int:
    """Write or check the document; return 1 where something is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--check', action='store_true', help='write nothing')
    check = parser.parse_args().check
    text, wrong = document()
    for figure in wrong:
        print(f'{figure.name}: {figure.theirs} is not {figure.ours}', file=sys.stderr)
    if check and (not DOCUMENT.exists() or DOCUMENT.read_text(encoding='utf-8') != text):
        print('docs/accuracy.md is out of date: run benchmarks/accuracy.py', file=sys.stderr)
        return 1
    if not check:
        DOCUMENT.write_text(text, encoding='utf-8')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())
