"""Places on the earth on both sides: one origin, whatever each began with."""

import numpy as np
import pytest

from verbs import document
from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.recordings.agreement.origins import with_one_origin
from vio_eval_ros.recordings.geographic import between_origins, east_north_up
from vio_eval_ros.recordings.sources import read_sources, Source

SECONDS = np.arange(400) / 10
#: a drive of some hundred metres near Zurich, and how far off the estimate is [deg]
PLACES = np.stack(
    [
        47.37 + 1e-3 * np.sin(SECONDS / 9),
        8.54 + 2e-3 * np.cos(SECONDS / 7),
        430 + 3 * np.sin(SECONDS),
    ],
    axis=1,
)
OFF = 1e-6
SHIFT = np.array([OFF, 0, 0])


@pytest.fixture
def inputs(tmp_path):
    """Return the options that name two files of fixes, of which the estimate begins later."""
    for name, places, begin in (('gt.csv', PLACES, 0), ('est.csv', PLACES + SHIFT, 150)):
        rows = [
            f'{1.6e9 + t:.3f},{lat:.10f},{lon:.10f},{height:.4f}'
            for t, (lat, lon, height) in zip(SECONDS[begin:], places[begin:], strict=True)
        ]
        (tmp_path / name).write_text(
            '\n'.join(['timestamp,latitude [deg],longitude [deg],altitude', *rows]) + '\n'
        )
    return ['--estimate', tmp_path / 'est.csv', '--ground-truth', tmp_path / 'gt.csv']


@pytest.mark.parametrize('alignment', ['none', 'scale'])
def test_an_alignment_without_translation_does_not_count_the_first_fixes(inputs, alignment):
    found = document('replay', *inputs, '--alignment', alignment)
    assert found['metrics']['ate_trans_rmse_m'] == pytest.approx(OFF * 111_190, rel=0.01)
    assert 'made relative to the origin of the ground truth' in found['warnings'][0]


def test_no_other_error_changes(inputs):
    metrics = document('replay', *inputs)['metrics']
    assert metrics['ate_trans_rmse_m'] < 1e-3
    assert metrics['ate_none_trans_rmse_m'] == pytest.approx(OFF * 111_190, rel=0.01)


def test_positions_and_orientations_turn_with_the_plane():
    here, there = (47.0, 8.0, 400.0), (46.5, 9.5, 1200.0)
    positions, _ = east_north_up(PLACES, np.array(here))
    expected, _ = east_north_up(PLACES, np.array(there))
    matrix, translation = between_origins(here, there)
    assert positions @ matrix.T + translation == pytest.approx(expected, abs=1e-5)
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)
    stamps_ns = np.arange(len(PLACES))
    rotations = np.tile([0.0, 0, 0, 1], (len(PLACES), 1))
    covariances = np.tile(np.diag([1.0, 2.0, 3.0]), (len(PLACES), 2, 1, 1))
    one = Poses(stamps_ns, positions, rotations, covariances, origin=here)
    other = Poses(stamps_ns, expected, rotations, origin=there)
    sides = [Source(name, 'arrays', (), poses) for name, poses in (('e', one), ('g', other))]
    moved, truth = with_one_origin((sides[0], sides[1]), EvaluationConfig())
    assert moved.poses.positions == pytest.approx(expected, abs=1e-5)
    assert rotation.to_matrix(moved.poses.rotations[0]) == pytest.approx(matrix, abs=1e-12)
    turned = matrix @ np.diag([1.0, 2.0, 3.0]) @ matrix.T
    assert moved.poses.covariances[0, 1] == pytest.approx(turned, abs=1e-12)
    assert truth is sides[1]
    assert with_one_origin((sides[1], sides[1]), EvaluationConfig()) == (sides[1], sides[1])


def test_one_side_that_is_not_on_the_earth_leaves_the_other_alone(inputs, tmp_path):
    (fixes,) = read_sources([str(inputs[1])])
    assert fixes.poses.origin == pytest.approx(
        (*PLACES[150, :2] + [OFF, 0], PLACES[150, 2]), abs=1e-4
    )
    local = Source('g', 'arrays', (), Poses(fixes.poses.stamps_ns, fixes.poses.positions))
    assert with_one_origin((fixes, local), EvaluationConfig()) == (fixes, local)
    for alignment in ('none', 'scale'):
        config = EvaluationConfig(alignment=alignment)
        for sides in ((fixes, local), (local, fixes)):
            note = with_one_origin(sides, config)[0].warnings[0]
            assert 'relative to latitude 47.' in note
            assert '--alignment se3' in note
