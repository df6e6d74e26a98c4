"""A result as schema vio_eval_ros.result/1 has it."""

import json

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.side import Side
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.simulation import simulate


def test_an_input_without_poses_has_no_stamps_and_no_rate():
    nothing = Input.of('/gone', 'topic', Side(Preparation.of_ground_truth(EvaluationConfig()), 1))
    assert (nothing.poses, nothing.first_stamp_ns, nothing.last_stamp_ns) == (0, None, None)
    assert nothing.rate_hz is None
    assert not any(nothing.dropped.values())


def test_stamps_of_an_input_are_as_recorded():
    config = EvaluationConfig(time_offset_s=1.0)
    evaluation = Evaluation(config)
    evaluation.add_estimate(Poses(np.array([1, 2]) * 10**9, np.ones((2, 3))))
    evaluation.add_ground_truth(Poses(np.array([2, 3]) * 10**9, np.ones((2, 3))))
    evaluation.flush()
    used = Input.of('/est', 'topic', evaluation.associator.estimate, offset_s=1.0)
    assert (used.first_stamp_ns, used.last_stamp_ns) == (10**9, 2 * 10**9)
    assert used.rate_hz == 1
    assert used.position_only


def test_numbers_that_do_not_exist_are_null_and_warnings_a_list():
    run = simulate(duration_s=5.0)
    evaluation = Evaluation(EvaluationConfig(rpe_deltas=('100s',)))
    evaluation.add_estimate(run.estimate)
    evaluation.add_ground_truth(run.ground_truth)
    evaluation.flush()
    associator = evaluation.associator
    result = Result(
        estimate=Input.of('est', 'tum', associator.estimate),
        ground_truth=Input.of('gt', 'tum', associator.ground_truth),
        config=evaluation.config,
        summary=evaluation.summary(),
    )
    found = result.to_dict()
    assert found['metrics']['rpe_100s_trans_rmse_m'] is None
    assert found['warnings'] == ['rpe_100s: no two pairs are 100s apart']
    assert (found['gates'], found['verdict'], found['success']) == ([], None, True)
    json.dumps(found, allow_nan=False)
