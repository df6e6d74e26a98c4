"""A live run gives what a replay of the same poses gives, whenever it is asked."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.core.series import running_series
from vio_eval_ros.errors import WriteError
from vio_eval_ros.live.run import LiveRun, RunSetup
from vio_eval_ros.recordings.messages import PathRevisions
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.simulation import simulate

SETUP = RunSetup(EvaluationConfig(), ('/estimate', '/ground_truth'))


@pytest.fixture(scope='module')
def flight():
    return simulate(duration_s=12.0)


def live(flight, batch: int, gates=()) -> LiveRun:
    """Return a run that was fed in batches, and looked at after each."""
    run = LiveRun(replace(SETUP, gates=gates))
    for k in range(0, 12 * 20, batch):
        run.add_ground_truth(flight.ground_truth[10 * k : 10 * (k + batch)])
        run.add_estimate(flight.estimate[k : k + batch])
        list(run.advance())
    return run


def final(flight):
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_estimate(flight.estimate)
    evaluation.add_ground_truth(flight.ground_truth)
    evaluation.flush()
    return evaluation.summary()


@pytest.mark.parametrize('batch', [7, 20, 240])
def test_a_live_run_has_the_result_and_the_series_of_its_recording(flight, batch, tmp_path):
    run = live(flight, batch)
    result, summary = run.write(tmp_path), final(flight)
    assert result.summary.metrics == pytest.approx(summary.metrics, rel=0, abs=0, nan_ok=True)
    assert result.summary.association == pytest.approx(summary.association, rel=0, abs=0)
    recorded = list(running_series(EvaluationConfig(), flight.estimate, flight.ground_truth))
    lines = (tmp_path / 'series.csv').read_text().splitlines()
    rows = list(csv.DictReader(lines))
    assert [row.pop('stamp_ns') for row in rows] == [str(stamp_ns) for stamp_ns, _ in recorded]
    for row, (_, expected) in zip(rows, recorded, strict=True):
        values = {name: float(value or 'nan') for name, value in row.items()}
        assert values == pytest.approx(expected, rel=1e-9, nan_ok=True)
    assert [row['pairs'] for row in rows] == [str(values['pairs']) for _, values in recorded]


def path_of(flight, shift_m: float):
    """Return the Path messages of a system that revises its past by ever more."""
    for end in range(10, len(flight.estimate) + 1, 10):
        positions = flight.estimate.positions[:end].copy()
        positions[:, 2] += shift_m * end * np.sin(np.arange(end))
        yield replace(flight.estimate[:end], positions=positions)


def test_a_path_is_scored_as_last_revised_beside_what_it_was_at_first(flight):
    run, path = LiveRun(SETUP), PathRevisions()
    for k, message in enumerate(path_of(flight, 1e-3)):
        run.add_ground_truth(flight.ground_truth[100 * k : 100 * (k + 1)])
        run.add_estimate(path.add(message), path)
        list(run.advance())
    result = run.result()

    final, causal = Evaluation(EvaluationConfig()), Evaluation(EvaluationConfig())
    for evaluation, poses in ((final, path.final()), (causal, path.causal())):
        evaluation.add_estimate(poses)
        evaluation.add_ground_truth(flight.ground_truth)
        evaluation.flush()
    expected = causal.summary().metrics
    metrics = final.summary(expected).metrics
    assert result.summary.metrics == pytest.approx(metrics, rel=0, abs=0, nan_ok=True)
    assert metrics['ate_causal_trans_rmse_m'] == expected['ate_trans_rmse_m']
    assert metrics['loop_closure_gain'] > 1.05
    assert any('loop_closure_gain' in warning for warning in result.summary.warnings)
    # what runs along is what was known at the time
    assert run.evaluation.running()['ate_trans_rmse_m'] < metrics['ate_trans_rmse_m']


def test_a_path_without_stamps_gives_a_result_that_says_so(flight):
    run, path = LiveRun(SETUP), PathRevisions('/path')
    run.add_ground_truth(flight.ground_truth)
    message = replace(flight.estimate, stamps_ns=np.zeros_like(flight.estimate.stamps_ns))
    run.add_estimate(path.add(message), path)
    result = run.result()
    assert result.summary.association['pairs'] == 0
    assert any('no stamps of their own' in warning for warning in result.summary.warnings)


def test_what_was_lost_on_the_way_is_a_warning_of_the_result(flight):
    run = live(flight, 240)
    run.notes = ['estimate: 7 messages lost on /estimate; make it reliable']
    assert run.result().summary.warnings[0] == run.notes[0]


def test_two_trajectories_that_take_turns_are_a_warning(flight):
    run = LiveRun(SETUP)
    mixed = flight.estimate.positions.copy()
    mixed[1::2] += (0.0, 2.0, 0.0)
    run.add_ground_truth(flight.ground_truth)
    run.add_estimate(replace(flight.estimate, positions=mixed))
    list(run.advance())
    run.look(window_s=10.0)
    words = 'estimate: poses of two trajectories, 2 m apart, take turns'
    for told in (run.state().turns, run.result().summary.warnings):
        assert len([line for line in told if line.startswith(words)]) == 1


def test_of_one_trajectory_nothing_is_said_of_turns(flight):
    run = live(flight, 20)
    run.look(window_s=5.0)
    assert run.state().turns == ()
    assert not [line for line in run.result().summary.warnings if 'take turns' in line]


def test_max_pairs_bounds_what_a_run_keeps(flight):
    run = LiveRun(replace(SETUP, max_pairs=100))
    for k in range(0, 240, 20):
        run.add_ground_truth(flight.ground_truth[10 * k : 10 * (k + 20)])
        run.add_estimate(flight.estimate[k : k + 20])
        list(run.advance())
    result = run.result()
    assert len(result.summary.pairs) <= 100
    assert result.summary.association['pairs'] == final(flight).association['pairs']
    assert any('more than max_pairs' in warning for warning in result.summary.warnings)


def test_a_result_asked_for_on_the_way_does_not_change_the_end(flight):
    run = live(flight, 20)
    half = LiveRun(SETUP)
    half.add_ground_truth(flight.ground_truth[:1200])
    half.add_estimate(flight.estimate[:120])
    list(half.advance())
    assert half.result().summary.association['pairs'] == 120
    half.add_ground_truth(flight.ground_truth[1200:])
    half.add_estimate(flight.estimate[120:])
    list(half.advance())
    assert half.result().summary.metrics == pytest.approx(
        run.result().summary.metrics, rel=0, abs=0, nan_ok=True
    )


def test_the_report_of_a_run_can_be_replayed(flight, tmp_path):
    run = live(flight, 20, [Gate.parse('ate_trans_rmse_m<=1e-6')])
    result = run.write(tmp_path / 'runs' / 'run_0001')
    assert result.passed is False
    written = sorted(path.name for path in (tmp_path / 'runs/run_0001').iterdir())
    assert written == [
        'errors.csv',
        'estimate.tum',
        'ground_truth.tum',
        'result.json',
        'result.md',
        'series.csv',
    ]
    folder = tmp_path / 'runs/run_0001'
    sources = read_sources([str(folder / 'estimate.tum'), str(folder / 'ground_truth.tum')])
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_estimate(sources[0].poses)
    evaluation.add_ground_truth(sources[1].poses)
    evaluation.flush()
    # the files have nine decimals
    assert evaluation.summary().metrics['ate_trans_rmse_m'] == pytest.approx(
        result.summary.metrics['ate_trans_rmse_m'], rel=1e-6
    )


def test_a_folder_that_cannot_be_made_is_a_clear_error(flight, tmp_path):
    (tmp_path / 'taken').write_text('')
    with pytest.raises(WriteError, match='taken'):
        live(flight, 240).write(tmp_path / 'taken')


def test_a_disk_that_fills_up_on_the_way_leaves_the_old_report_whole(flight, tmp_path):
    def report() -> dict[str, bytes]:
        return {file.name: file.read_bytes() for file in tmp_path.iterdir() if file.is_file()}

    run = LiveRun(SETUP)
    run.add_ground_truth(flight.ground_truth)
    run.add_estimate(flight.estimate[:100])
    run.write(tmp_path)
    before = report()
    run.add_estimate(flight.estimate[100:])
    (tmp_path / 'series.csv').unlink()
    (tmp_path / 'series.csv').symlink_to('/dev/full')  # not the first of the files
    with pytest.raises(WriteError, match=r'series\.csv: cannot write: No space left'):
        run.write(tmp_path)
    after = report()
    assert after == {name: content for name, content in before.items() if name != 'series.csv'}
    (tmp_path / 'series.csv').unlink()
    run.write(tmp_path)
    assert report()['result.json'] != before['result.json']


def test_a_tracking_reset_is_noticed_with_its_stamp_and_size(flight):
    assert live(flight, 20).largest_jump() is None
    shifted = flight.estimate.positions.copy()
    shifted[100:] += [0, 0, 3]
    run = live(replace(flight, estimate=replace(flight.estimate, positions=shifted)), 20)
    stamp_ns, size_m = run.largest_jump()
    assert stamp_ns == flight.estimate.stamps_ns[100]
    assert size_m == pytest.approx(3, abs=0.2)


def test_the_state_says_what_is_missing(flight):
    run = LiveRun(SETUP)
    assert run.is_empty
    assert run.state().waiting_for == 'no estimate yet, no ground truth yet'
    assert run.state().no_pairs == 'no pairs: the estimate has no usable pose'
    run.add_estimate(flight.estimate)
    state = run.state()
    assert not run.is_empty
    assert state.waiting_for.startswith('estimate spans 1403715524.9 to 1403715536.9 s, no ground')
    assert (state.values, state.alignment, state.largest_jump) == ({}, None, None)


def test_the_state_is_of_the_values_the_window_and_the_association(flight):
    run = live(flight, 20)
    run.look(window_s=3.0)
    state, metrics = run.state(), run.window
    assert state.values['pairs'] == run.evaluation.running()['pairs'] > 200
    assert state.alignment is not None
    assert state.no_pairs == ''
    assert state.ground_truth_moved_m == metrics['path_length_m']
    assert state.estimate_moved_m == pytest.approx(metrics['path_length_m'], rel=0.1)
    assert (state.estimate.used, state.estimate.overflow) == (222, 0)
    assert set(state.estimate.dropped.values()) == {0}
    assert state.number == 1
    again = LiveRun(SETUP, 2, 'reset was called').state()
    assert (again.number, again.began_as) == (2, 'reset was called')


def test_a_run_that_is_diagnosed_has_its_causes_in_the_state(flight):
    run = live(flight, 20)
    run.monitor.problem, run.monitor.pairs = 'ZeroDivisionError: oh', 7
    state = run.state()
    assert (state.diagnosis, state.diagnosed_pairs) == (None, 7)
    assert state.diagnosis_problem == 'ZeroDivisionError: oh'
