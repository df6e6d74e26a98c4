"""What the two inputs are, beside what they say of each other."""

from dataclasses import replace

import numpy as np
import pytest

from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.inputs import interpolated_over_s
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.simulation import simulate

TRUTH = simulate(duration_s=30.0).ground_truth
REAL = [
    'gt_euroc/open_vins_tum/V1_02_medium.txt',
    'gt_euroc/open_vins_tum/MH_05_difficult.txt',
    'gt_euroc/open_vins_tum/V1_01_easy.txt',
    'gt_euroc/vins_mono_asl_csv/V1_02_medium/data.csv',
    'gt_tumvi/open_vins/dataset-room4_512_16.txt',
    'evo_test_data/freiburg1_xyz-groundtruth.txt',
    'est_vins_kavehsgh/ground_truth.tum',
]


def interpolated(step: int, shift_ns: int = 0, digits: int = 17) -> Trajectory:
    """Return straight lines between every k-th true pose, at the rate of the truth."""
    knots = TRUTH[::step]
    stamps_ns = TRUTH.stamps_ns + shift_ns
    stamps_ns = stamps_ns[stamps_ns < knots.stamps_ns[-1]]
    at, known = ((each - TRUTH.stamps_ns[0]) / 1e9 for each in (stamps_ns, knots.stamps_ns))
    points = np.stack([np.interp(at, known, column) for column in knots.positions.T], -1)
    return Trajectory(stamps_ns, points.round(digits))


@pytest.mark.parametrize('step', [5, 10, 20])
@pytest.mark.parametrize('shift_ns', [0, 1_700_000])
def test_straight_lines_between_poses_are_noticed(step, shift_ns):
    found = interpolated_over_s(interpolated(step, shift_ns))
    assert found == pytest.approx(0.005 * step, rel=1e-3)


@pytest.mark.parametrize('step', [10, 20])
def test_they_are_noticed_in_a_file_of_six_digits(step):
    assert interpolated_over_s(interpolated(step, digits=6)) == pytest.approx(0.005 * step)


@pytest.mark.parametrize('digits', [3, 4, 5, 6, 17])
def test_a_flight_is_not_taken_for_lines_however_it_is_written(digits):
    rounded = replace(TRUTH, positions=TRUTH.positions.round(digits))
    assert interpolated_over_s(rounded) is None


def test_what_rests_is_not_taken_for_a_line():
    positions = TRUTH.positions.copy()
    positions[2000:] = positions[2000]
    assert interpolated_over_s(replace(TRUTH, positions=positions)) is None


def test_a_line_without_knots_is_no_interpolation():
    seconds = (TRUTH.stamps_ns - TRUTH.stamps_ns[0]) / 1e9
    line = replace(TRUTH, positions=np.outer(seconds, [1.0, 0.5, 0.0]))
    assert interpolated_over_s(line) is None


@pytest.mark.parametrize('path', REAL)
def test_no_real_ground_truth_is_taken_for_interpolated(shared_data, path):
    spec = f'{shared_data}/{path}'
    (source, _) = read_sources([spec, spec])
    assert interpolated_over_s(clean(source.poses, Cleaning())) is None
