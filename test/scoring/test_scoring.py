"""Verdicts over repeated runs are those that one finds by hand; no run stops the others."""

import faulthandler
import math
from multiprocessing import active_children
import os
import signal

import pytest

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.scoring import scoring
from vio_eval_ros.scoring.baseline import Baseline, definition_sha256
from vio_eval_ros.scoring.loading import load_suite
from vio_eval_ros.scoring.results import SequenceResult, SuiteResult
from vio_eval_ros.scoring.scoring import compare_suite
from vio_eval_ros.simulation import simulate, write_recording

ATE = 'ate_trans_rmse_m'


def verdicts(one: SequenceResult) -> dict[str, str]:
    """Return the word of each gate: its metric, or that and a word."""
    return {
        gate.gate.metric
        + ('' if gate.over == 'median' else f' {gate.over}')
        + ('' if gate.gate.severity == 'fail' else ' warning'): verdict.word
        for gate, verdict in one.verdicts
    }


def baseline_of(result: SuiteResult) -> Baseline:
    return Baseline(
        definition_sha256(), {one.sequence.name: one.recorded for one in result.sequences}
    )


def crash() -> None:
    faulthandler.disable()  # pytest would show where
    os.kill(os.getpid(), signal.SIGSEGV)


def test_a_metric_over_runs_is_reported_as_median_mad_and_range(lab):
    lab.runs('a', 0.1, 0.14, 0.11, 0.2)
    (one,) = lab.score('a').sequences
    # medians of the two in the middle: 0.11, 0.14; deviations 0.025, 0.015, 0.015, 0.075
    assert one.metrics[ATE].to_dict() == pytest.approx(
        {'median': 0.125, 'mad': 0.02, 'min': 0.1, 'max': 0.2, 'n': 4}, abs=1e-9
    )
    assert one.metrics['success_rate'].values == (1.0,)
    assert one.passed


@pytest.mark.parametrize(('limit', 'passes'), [(0.13, True), (0.12, False)])
def test_a_ceiling_is_on_the_median(lab, limit, passes):
    lab.runs('a', 0.1, 0.125, 3.0)
    gates = f'{{{ATE}: {{max: {limit}}}, success_rate: {{min: 0.5}}}}'
    (one,) = lab.score(f'a, gates: {gates}').sequences
    assert verdicts(one)[ATE] == ('pass' if passes else 'fail')
    assert one.passed is passes


def test_a_gate_may_be_on_the_worst_run(lab):
    lab.runs('a', 0.1, 0.1, 0.2)
    gates = f'{{{ATE}: [{{max: 0.15}}, {{max: 0.15, of: worst}}]}}'
    (one,) = lab.score(f'a, gates: {gates}').sequences
    assert verdicts(one)[ATE] == 'pass'
    assert verdicts(one)[f'{ATE} worst'] == 'fail'
    assert not one.passed


def test_the_worst_of_a_floor_is_the_lowest(lab):
    lab.run('a/0.tum', 0.1)
    lab.run('a/1.tum', 0.1, until=0.95)
    (one,) = lab.score('a, gates: {tracked_ratio: {min: 0.97, of: worst}}').sequences
    found = {gate.over: verdict.value for gate, verdict in one.verdicts
             if gate.gate.metric == 'tracked_ratio'}  # fmt: skip
    assert found['worst'] == pytest.approx(0.95, abs=0.01)
    assert not one.passed


def test_no_run_is_worse_than_one_without_a_number(lab):
    lab.runs('a', 0.1, 0.1)
    (lab.folder / 'a/2.tum').write_text('no trajectory')
    gates = f'{{success_rate: {{min: 0.5}}, {ATE}: [{{max: 1}}, {{max: 1, of: worst}}]}}'
    (one,) = lab.score(f'a, gates: {gates}').sequences
    assert verdicts(one)[ATE] == 'pass'
    assert verdicts(one)[f'{ATE} worst'] == 'fail'


def test_a_median_is_of_all_runs_and_not_of_those_that_survived(lab):
    lab.runs('a', 0.1, 0.5, 0.5, 0.5, 0.5)
    for k in (1, 2, 3, 4):
        (lab.folder / f'a/{k}.tum').write_text('')
    gates = f'{{{ATE}: {{max: 0.2}}, success_rate: {{min: 0.2}}}}'
    (one,) = lab.score(f'a, gates: {gates}').sequences
    assert verdicts(one) == {
        'tracked_ratio': 'fail', 'ate_extent_ratio': 'fail', 'success_rate': 'pass', ATE: 'fail'
    }  # fmt: skip
    assert all(math.isnan(verdict.value) for _, verdict in one.verdicts if not verdict.passed)


def test_a_run_without_a_number_counts_as_the_worst_in_the_median(lab):
    lab.runs('a', 0.1, 0.2)
    (lab.folder / 'a/2.tum').write_text('')
    gates = f'{{success_rate: {{min: 0.5}}, {ATE}: {{max: 0.19}}, tracked_ratio: {{min: 0.9}}}}'
    (one,) = lab.score(f'a, gates: {gates}').sequences
    found = {gate.gate.metric: verdict.value for gate, verdict in one.verdicts}
    assert found[ATE] == pytest.approx(0.2)  # of 0.1, 0.2 and worse
    assert one.metrics[ATE].median == pytest.approx(0.15)
    assert verdicts(one)[ATE] == 'fail'
    assert verdicts(one)['tracked_ratio'] == 'pass'


def test_a_warning_stands_beside_a_failure_and_fails_nothing(lab):
    lab.runs('a', 0.1)
    gates = f'{{{ATE}: {{max: 0.3, warn: 0.05}}}}'
    (one,) = lab.score(f'a, gates: {gates}').sequences
    assert (verdicts(one)[ATE], verdicts(one)[f'{ATE} warning']) == ('pass', 'warn')
    assert one.passed


def test_a_lost_track_fails_though_its_error_is_small(lab):
    lab.runs('whole', 0.1)
    lab.run('lost/0.tum', 0.01, until=0.5)
    whole, lost = lab.score('whole', 'lost').sequences
    assert lost.metrics[ATE].median < whole.metrics[ATE].median
    assert verdicts(lost)['tracked_ratio'] == 'fail'
    assert verdicts(lost)['success_rate'] == 'fail'
    assert (whole.passed, lost.passed) == (True, False)


def test_a_diverged_run_fails_without_any_gate_of_the_user(lab):
    # the circle's extent is 1 m: an error of 0.6 m is beyond half of it
    lab.runs('a', 0.6)
    (one,) = lab.score('a').sequences
    assert verdicts(one)['ate_extent_ratio'] == 'fail'
    assert one.metrics['ate_extent_ratio'].median == pytest.approx(0.6, rel=1e-3)


@pytest.mark.parametrize(('least', 'passes'), [(0.5, True), (0.6, False)])
def test_the_success_rate_counts_lost_diverged_and_unreadable_runs(lab, least, passes):
    lab.runs('a', 0.1, 0.1, 0.1, 0.9)
    lab.run('a/4.tum', 0.1, until=0.5)
    (lab.folder / 'a/5.tum').write_text('1 2 3\n')
    (one,) = lab.score(f'a, gates: {{success_rate: {{min: {least}}}}}').sequences
    assert one.metrics['success_rate'].median == 0.5
    assert [run.succeeded(one.sequence) for run in one.runs] == [True] * 3 + [False] * 3
    assert one.metrics[ATE].to_dict()['n'] == 5
    assert one.passed is passes


def test_a_run_that_cannot_be_scored_has_its_reason_and_stops_nothing(lab):
    lab.runs('a', 0.1, 0.1)
    (lab.folder / 'a/1.tum').write_text('')
    lab.run('a/2.tum', 0.1)
    (lab.folder / 'a/3.tum').mkdir()
    result = lab.score('a', 'b, estimate: missing.tum', 'c, estimate: "a/0.tum"')
    a, b, c = result.sequences
    assert [run.result is not None for run in a.runs] == [True, False, True, False]
    assert 'a/1.tum' in a.runs[1].error
    assert 'missing.tum' in b.runs[0].error
    assert '\n' not in a.runs[1].error + b.runs[0].error
    assert (a.passed, b.passed, c.passed) == (False, False, True)
    assert set(verdicts(b).values()) == {'fail'}


def test_a_ground_truth_that_cannot_be_read_fails_all_runs_of_its_sequence(lab):
    lab.runs('a', 0.1, 0.1)
    (lab.folder / 'no.tum').write_text('1 2 3\n')
    suite = lab.suite('a', 'b, estimate: "a/*"')
    suite.write_text(suite.read_text().replace('ground_truth: gt.tum', 'ground_truth: no.tum', 1))
    a, b = scoring.score_suite(load_suite(suite), 2).sequences
    assert all('no.tum' in run.error for run in a.runs)
    assert b.passed


def test_an_estimate_that_is_the_truth_is_noticed_under_another_name(lab):
    lab.runs('a', 0.1)
    (lab.folder / 'a/0.tum').write_text('# a copy\n' + (lab.folder / 'gt.tum').read_text())
    lab.runs('b', 0.1)
    a, b = lab.score('a', 'b').sequences
    same = 'the estimate and the ground truth are the same'
    assert same in a.runs[0].result.summary.warnings
    assert same not in b.runs[0].result.summary.warnings


def test_runs_that_share_no_instant_with_the_truth_say_so(lab):
    lab.runs('a', 0.1)
    (one,) = lab.score('a, options: {time_offset_s: 1000}').sequences
    assert 'are the clocks the same?' in one.runs[0].error


@pytest.mark.slow
@pytest.mark.parametrize('jobs', [1, 2, 9])
@pytest.mark.parametrize(
    ('end', 'how'),
    [
        ('os._exit(7)', 'exit status 7'),
        ('os._exit(0)', 'exit status 0'),
        ('os.kill(os.getpid(), signal.SIGKILL)', signal.strsignal(signal.SIGKILL)),
        ('faulthandler.disable(), faulthandler._sigsegv()', signal.strsignal(signal.SIGSEGV)),
    ],
    ids=['exit', 'end', 'kill', 'crash'],
)
def test_a_run_that_kills_its_process_is_the_only_loss(lab, sabotage, jobs, end, how):
    sabotage(f"('a/1' in specs[0] or 'a/2' in specs[0]) and ({end})")
    lab.runs('a', 0.1, 0.1, 0.1, 0.1, 0.1, 0.1)
    (one,) = lab.score('a', jobs=jobs).sequences
    assert [run.result is None for run in one.runs] == [False, True, True, False, False, False]
    assert one.runs[1].error == f'the process that scored it died: {how}'
    assert one.metrics['success_rate'].median == pytest.approx(4 / 6)


@pytest.mark.parametrize(
    'error', ['MemoryError()', "RuntimeError('two' + chr(10) + 'lines')", 'SystemExit(3)']
)
def test_whatever_a_reader_raises_is_the_reason_of_its_run(lab, sabotage, error):
    sabotage(f'raise {error}')
    lab.runs('a', 0.1)
    (one,) = lab.score('a').sequences
    assert one.runs[0].error
    assert '\n' not in one.runs[0].error


def test_no_process_is_left_when_the_scoring_is_given_up(lab):
    lab.runs('a', *[0.1] * 8)
    suite = load_suite(lab.suite('a'))

    def impatient(runs, total):
        yield next(runs)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        scoring.score_suite(suite, 2, impatient)
    assert active_children() == []


def test_the_result_does_not_depend_on_how_many_processes_there_are(lab):
    lab.runs('a', 0.1, 0.12, 0.11)
    lab.runs('b', 0.2)
    (lab.folder / 'b/1.tum').write_text('')
    results = [lab.score('a', 'b', jobs=jobs).to_dict() for jobs in (1, 2, 5)]
    assert results[0] == results[1] == results[2]


def test_the_progress_knows_how_many_runs_there_are(lab):
    lab.runs('a', 0.1, 0.1, 0.1)
    seen = []

    def watch(items, total):
        for item in items:
            seen.append((item[0], total))
            yield item

    scoring.score_suite(load_suite(lab.suite('a')), 2, watch)
    assert sorted(seen) == [(0, 3), (1, 3), (2, 3)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ('off_m', 'word'),
    [(0.05, 'good'), (0.1, 'good'), (0.15, 'plausible'), (0.25, 'suspicious'), (0.35, 'failed')],
)
def test_the_band_shows_how_a_run_compares_with_the_literature(lab, off_m, word):
    # the band is of the aligned error: a run that is too large by so much, everywhere
    lab.runs('a', 0.0)
    truth = (lab.folder / 'gt.tum').read_text().splitlines()
    rows = [line.split() for line in truth[1:]]
    grown = [[r[0], *(repr(float(v) * (1 + off_m)) for v in r[1:4]), *r[4:]] for r in rows]
    (lab.folder / 'a/0.tum').write_text('\n'.join(map(' '.join, grown)))
    (lab.folder / 'bands.yaml').write_text('a: {good: 0.101, plausible: 0.2, failed: 0.3}')
    (one,) = lab.score('a', top='bands: bands.yaml').sequences
    assert one.metrics['ate_se3_trans_rmse_m'].median == pytest.approx(off_m, rel=0.01)
    assert one.band == word


def test_a_run_without_a_figure_is_in_the_band_of_the_failed(lab):
    (lab.folder / 'a').mkdir()
    (lab.folder / 'a/0.tum').write_text('')
    (lab.folder / 'bands.yaml').write_text('a: {good: 1, plausible: 2, failed: 3}')
    (one,) = lab.score('a', top='bands: bands.yaml').sequences
    assert one.band == 'failed'


def test_a_band_that_is_not_known_is_reported(lab):
    lab.runs('a', 0.1)
    (lab.folder / 'bands.yaml').write_text('a: {good: 1, plausible: 2, failed: 3}')
    result = lab.score('a', top='bands: bands.yaml\nmodality: mono')
    assert result.sequences[0].band is None
    (note,) = result.notes
    assert note == f'a: {lab.folder}/bands.yaml has no limits for mono; not assigned to a band'


def test_poses_of_kitti_have_their_stamps_in_a_file_beside_them(lab):
    (lab.folder / 'a').mkdir()
    stamps = lab.circle.stamps_ns - lab.circle.stamps_ns[0]
    (lab.folder / 'times.txt').write_text('\n'.join(f'{ns / 1e9:.9f}' for ns in stamps))
    for name, off in (('gt.txt', 0.0), ('a/0.txt', 0.1), ('a/1.txt', 0.2)):
        rows = [
            f'1 0 0 {x + off} 0 1 0 {y} 0 0 1 {z}' for x, y, z in lab.circle.positions.tolist()
        ]
        (lab.folder / name).write_text('\n'.join(rows))
    suite = lab.suite('a, estimate: a/*.txt, times: times.txt')
    suite.write_text(suite.read_text().replace('gt.tum', 'gt.txt'))
    (one,) = scoring.score_suite(load_suite(suite), 2).sequences
    assert [run.error for run in one.runs] == ['', '']
    assert one.metrics[ATE].values == pytest.approx((0.1, 0.2))
    lab.runs('b', 0.1)
    (one,) = lab.score('b, times: times.txt').sequences
    assert 'times.txt: these times are not used' in one.runs[0].error


@pytest.fixture
def before(lab) -> Baseline:
    lab.runs('a', 0.10, 0.11, 0.09, 0.105, 0.095)
    return baseline_of(lab.score('a'))


@pytest.mark.slow
def test_a_noisy_candidate_that_is_equal_passes(lab, before):
    lab.runs('a', 0.12, 0.08, 0.115, 0.13, 0.09)
    (one,) = compare_suite(lab.score('a'), before).sequences
    (comparison,) = one.comparisons
    assert comparison.difference == pytest.approx(0.015, abs=1e-9)
    assert comparison.p_value > 0.05
    assert one.passed


def test_a_candidate_that_is_worse_fails_though_it_keeps_its_gates(lab, before):
    lab.runs('a', 0.13, 0.14, 0.12, 0.135, 0.125)
    result = compare_suite(lab.score(f'a, gates: {{{ATE}: {{max: 0.3}}}}'), before)
    (one,) = result.sequences
    assert set(verdicts(one).values()) == {'pass'}
    assert one.comparisons[0].worse
    assert not result.passed


@pytest.mark.slow
def test_what_chance_does_somewhere_in_a_suite_is_not_worse(lab):
    before = (0.10, 0.11, 0.09, 0.105, 0.095)
    noisy = ((0.1, 0.16, 0.07, 0.13, 0.09), (0.08, 0.13, 0.11, 0.15, 0.1))
    for name in 'abcd':
        lab.runs(name, *(noisy[0] if name > 'a' else before))
    baseline = baseline_of(lab.score(*'abcd'))
    for name in 'bcd':
        lab.runs(name, *noisy[1])
    lab.runs('a', 0.12, 0.118, 0.122, 0.119, 0.106)
    result = compare_suite(lab.score(*'abcd'), baseline)
    (found,) = result.sequences[0].comparisons
    assert found.p_value <= 0.02 < found.p_adjusted < 0.1
    assert found.difference > found.allowed
    assert result.passed
    assert any(note.startswith(f'a: {ATE} is worse by itself (p = ') for note in result.notes)
    loose = [f'{name}, compare: {{{ATE}: {{p_adjusted: 1}}}}' for name in 'abcd']
    assert not compare_suite(lab.score(*loose), baseline).passed


def test_the_rule_can_be_set_for_a_sequence(lab, before):
    lab.runs('a', 0.13, 0.14, 0.12, 0.135, 0.125)
    (one,) = compare_suite(
        lab.score(f'a, compare: {{{ATE}: {{relative: 0.5}}}}'), before
    ).sequences
    assert one.passed


def test_a_sequence_that_can_no_longer_be_scored_fails_and_is_compared(lab, before):
    for k in range(5):
        (lab.folder / f'a/{k}.tum').write_text('')
    (one,) = compare_suite(lab.score('a'), before).sequences
    assert not one.passed
    assert one.comparisons[0].worse


def test_one_run_that_survived_is_not_compared_with_five(lab, before):
    for k in (1, 2, 3, 4):
        (lab.folder / f'a/{k}.tum').write_text('')
    (one,) = compare_suite(lab.score('a, gates: {success_rate: {min: 0}}'), before).sequences
    (comparison,) = one.comparisons
    assert comparison.worse
    assert comparison.missing == 4


def test_more_runs_are_needed_for_a_p_than_there_are(lab, before):
    lab.runs('a', 0.13, 0.14, 0.12, 0.135, 0.125)
    result = compare_suite(lab.score(f'a, compare: {{{ATE}: {{p: 0.001}}}}'), before)
    assert result.passed
    assert result.notes == (
        f'a: 5 and 5 runs cannot show that {ATE} is worse with p <= 0.001; the smallest possible '
        'p is 0.004',
    )


def test_a_mean_that_says_the_opposite_of_the_median_is_reported(lab):
    lab.runs('a', 0.1, 0.1, 0.1, 0.49)
    before = baseline_of(lab.score('a'))
    lab.runs('a', 0.12, 0.12, 0.12, 0.12)
    result = compare_suite(lab.score('a'), before)
    assert result.passed
    (note,) = result.notes
    assert note.startswith(f'a: the median of {ATE} is worse than allowed, but its trimmed mean')


@pytest.mark.slow
def test_missing_and_new_sequences_are_named(lab, before):
    lab.runs('b', 0.1)
    result = compare_suite(lab.score('b'), before)
    assert result.notes == ('b: not in the baseline', 'a: in the baseline, but not scored')
    assert result.sequences[0].comparisons is None
    assert result.passed


def test_a_metric_that_the_baseline_lacks_is_reported(lab, before):
    recorded = before.sequences['a']
    del recorded.metrics[ATE]
    result = compare_suite(lab.score('a'), before)
    assert result.notes == (f'a: no {ATE} in the baseline',)


@pytest.mark.slow
def test_too_few_runs_to_compare_are_reported(lab, before):
    lab.runs('b', 0.1)
    few = baseline_of(lab.score('b'))
    notes = compare_suite(lab.score('b'), few).notes
    assert notes[0].startswith('b: 1 and 1 runs are too few for a test of significance')


@pytest.mark.slow
def test_another_ground_truth_is_another_condition(lab, before):
    with (lab.folder / 'gt.tum').open('a') as file:
        file.write('# corrected\n')
    with pytest.raises(ConfigError, match='a: the ground truth has changed'):
        compare_suite(lab.score('a'), before)
    result = compare_suite(lab.score('a'), before, ['ground_truth'])
    assert result.notes == ('accepted difference: a: the ground truth has changed',)


@pytest.mark.slow
def test_a_truth_that_is_read_otherwise_is_another_condition(lab, before):
    suite = lab.suite('a')
    suite.write_text(suite.read_text().replace('gt.tum', '"gt.tum?invert=rotation"'))
    result = scoring.score_suite(load_suite(suite), 2)
    problem = r"a: the ground truth was the whole file, now '\?invert=rotation'"
    with pytest.raises(ConfigError, match=problem):
        compare_suite(result, before)
    assert (
        compare_suite(result, before, ['ground_truth']).notes[0].startswith('accepted difference')
    )


def test_another_topic_of_the_same_recording_is_another_truth(lab):
    write_recording(simulate(duration_s=3.0), lab.folder / 'flight')

    def score(truth: str) -> SuiteResult:
        suite = lab.suite('a, recording: flight, estimate: /vio/odometry')
        suite.write_text(suite.read_text().replace('gt.tum', truth))
        return scoring.score_suite(load_suite(suite), 1)

    before = baseline_of(score('/ground_truth/pose'))
    with pytest.raises(ConfigError, match="was '/ground_truth/pose', now '/vio/odometry'"):
        compare_suite(score('/vio/odometry'), before)


def test_a_truth_that_every_recording_brings_is_no_other_truth(lab, leica_recording):
    text = 'a, recording: {}, estimate: /vio/pose, options: {{alignment: se3}}'
    suite = lab.suite(text.format(leica_recording))
    suite.write_text(suite.read_text().replace('gt.tum', '/leica/position'))
    result = scoring.score_suite(load_suite(suite), 1)
    (one,) = result.sequences
    assert one.runs[0].error == ''
    assert one.recorded.ground_truth_sha256 is None
    assert compare_suite(result, baseline_of(result)).sequences[0].comparisons[0].worse is False
