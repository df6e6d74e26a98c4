"""A recorded run is evaluated to a value: inputs as numbers, warnings in order, why not if not."""

from dataclasses import FrozenInstanceError, replace
import hashlib
import os

import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, NoPairs
from vio_eval_ros.evaluation.recorded import MAX_OUTLINE_POSES, score_run, sha256
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.simulation import simulate

RUN = simulate(duration_s=20.0)
CONFIG = EvaluationConfig(rpe_deltas=('1f',))


def source(poses: Poses, *warnings: str, causal: Poses | None = None) -> Source:
    return Source('somewhere', 'tum', (), poses, warnings, causal)


def test_inputs_are_described_by_numbers_that_nothing_changes_afterwards():
    config = replace(CONFIG, time_offset_s=0.004, start_s=5, end_s=10)
    result = score_run(source(RUN.estimate), source(RUN.ground_truth), config)
    used = result.estimate
    assert (used.poses, used.position_only, used.dropped['cropped']) == (100, False, 300)
    assert used.rate_hz == pytest.approx(20)
    assert used.first_stamp_ns in RUN.estimate.stamps_ns  # as recorded, without the offset
    assert used.last_stamp_ns in RUN.estimate.stamps_ns
    with pytest.raises(FrozenInstanceError):
        used.poses = 0
    with pytest.raises(FrozenInstanceError):
        result.summary.warnings = ()
    assert isinstance(result.summary.warnings, tuple)


def test_warnings_of_sources_come_first_and_once_then_those_of_the_evaluation():
    poses = replace(RUN.estimate, positions=RUN.estimate.positions.copy())
    poses.positions[3] = np.nan
    estimate = source(poses, 'read as ns', 'both')
    truth = source(RUN.ground_truth, 'both', 'of the truth')
    assert score_run(estimate, truth, CONFIG).summary.warnings == (
        'read as ns',
        'both',
        'of the truth',
        'estimate: dropped 1 non-finite',
    )


def test_a_source_compared_with_itself_is_pointed_out_last():
    same = source(RUN.ground_truth, 'first')
    warnings = score_run(same, same, CONFIG).summary.warnings
    assert warnings == ('first', 'the estimate and the ground truth are the same')


def test_gates_are_judged_on_the_metrics():
    gates = [Gate('ate_trans_rmse_m', '<=', 1e-9), Gate('coverage_ratio', '>=', 0.5)]
    result = score_run(source(RUN.estimate), source(RUN.ground_truth), CONFIG, gates)
    assert [verdict.passed for verdict in result.verdicts] == [False, True]
    assert result.passed is False
    assert result.to_dict()['verdict'] == 'fail'


def test_the_causal_estimate_gives_metrics_of_its_own():
    rough = replace(RUN.estimate, positions=RUN.estimate.positions * 1.05)
    truth = source(RUN.ground_truth)
    found = score_run(source(RUN.estimate, causal=rough), truth, CONFIG).summary.metrics
    alone = score_run(source(rough), truth, CONFIG).summary.metrics
    assert found['ate_causal_trans_rmse_m'] == alone['ate_trans_rmse_m']
    assert found['loop_closure_gain'] == found['ate_trans_rmse_m'] / alone['ate_trans_rmse_m']


def test_without_pairs_the_error_gives_both_spans():
    later = replace(RUN.estimate, stamps_ns=RUN.estimate.stamps_ns + 10**12)
    with pytest.raises(
        NoPairs, match=r'estimate spans .* ground truth .* are the clocks the same'
    ):
        score_run(source(later), source(RUN.ground_truth), CONFIG)


def test_the_outline_is_the_body_along_the_ground_truth_that_was_used():
    lever = replace(CONFIG, ground_truth_to_body=(0.3, 0, 0, 0, 0, 0, 1), start_s=5, end_s=10)
    result = score_run(source(RUN.estimate), source(RUN.ground_truth), lever)
    outline, pairs = result.truth, result.summary.pairs.ground_truth
    assert 1 < len(outline) <= MAX_OUTLINE_POSES
    assert outline.stamps_ns[0] >= result.ground_truth.first_stamp_ns
    assert outline.stamps_ns[-1] <= result.ground_truth.last_stamp_ns
    both = np.isin(outline.stamps_ns, pairs.stamps_ns)
    assert both.any()
    there = np.searchsorted(pairs.stamps_ns, outline.stamps_ns[both])
    np.testing.assert_array_equal(outline.positions[both], pairs.positions[there])


@pytest.mark.parametrize('quaternion', [[0, 0, 0, 1], [0, 0, 0, 0]])
def test_positions_with_orientations_that_say_nothing_cannot_be_moved(quaternion):
    filled = np.tile(np.array(quaternion, float), (len(RUN.ground_truth), 1))
    truth = source(replace(RUN.ground_truth, rotations=filled))
    assert score_run(source(RUN.estimate), truth, CONFIG).ground_truth.position_only
    lever = replace(CONFIG, ground_truth_to_body=(0.3, 0, 0, 0, 0, 0, 1))
    with pytest.raises(ConfigError, match=r'ground_truth_to_body: .* leave the option out'):
        score_run(source(RUN.estimate), truth, lever)
    of_estimate = replace(CONFIG, estimate_to_body=(0.3, 0, 0, 0, 0, 0, 1))
    assert score_run(source(RUN.estimate), truth, of_estimate).estimate.poses


def test_files_are_hashed_as_if_they_were_concatenated(tmp_path):
    first, second = tmp_path / 'first', tmp_path / 'second'
    first.write_bytes(b'ab')
    second.write_bytes(b'c')
    assert sha256([first, second]) == hashlib.sha256(b'abc').hexdigest()
    os.mkfifo(tmp_path / 'pipe')
    assert sha256([first, tmp_path / 'pipe']) is None
