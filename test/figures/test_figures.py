"""Figures show the arrays of results, for every kind of result."""

from dataclasses import replace

from matplotlib.figure import Figure
import numpy as np
import pytest

from verbs import call
from vio_eval_ros import compare, evaluate
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.figures.catalogue import draw, FIGURES, pages
from vio_eval_ros.figures.overview import spread
from vio_eval_ros.figures.style import theme
from vio_eval_ros.figures.systems import systems_of
from vio_eval_ros.rendering.palette import COLOURS, look
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate

UNITS = ('[m]', '[deg]', '[s]', '[%]', '[deg/m]', 'delta', 'sub-trajectory')


@pytest.fixture(scope='module')
def flight():
    """Return a short flight."""
    return simulate(duration_s=30.0)


@pytest.fixture(scope='module')
def result(flight):
    """Return its result."""
    return evaluate(flight.estimate, flight.ground_truth)


@pytest.fixture(scope='module')
def kinds(flight, result):
    """Return results of every kind, by what they are."""
    truth, estimate = flight.ground_truth, flight.estimate
    seconds = (estimate.stamps_ns - estimate.stamps_ns[0]) / 1e9
    covariances = np.tile(np.diag([0.01, 0.04, 0.09]), (len(estimate), 2, 1, 1))
    return {
        'usual': {'VIO': result},
        'positions': {'VIO': evaluate(estimate, replace(truth, rotations=None))},
        'gap': {'VIO': evaluate(estimate[(seconds < 8) | (seconds > 15)], truth)},
        'late': {'VIO': evaluate(estimate[seconds > 12], truth)},
        'covariance': {'VIO': evaluate(replace(estimate, covariances=covariances), truth)},
        'systems': {f'system $_{k}': result for k in range(12)},
        'few pairs': {'VIO': evaluate(estimate[:4], truth, alignment='none')},
    }


KINDS = ('usual', 'positions', 'gap', 'late', 'covariance', 'systems', 'few pairs')
NOT_THERE = {('positions', 'rpy'), ('positions', 'segments')}


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('name', FIGURES)
def test_every_figure_of_every_kind_of_result_has_units(name, kind, kinds):
    with theme():
        if (kind, name) in NOT_THERE:
            with pytest.raises(ConfigError, match='leave this figure out'):
                draw(name, kinds[kind])
            return
        figure = draw(name, kinds[kind])
        figure.canvas.draw()
    shown = [axes for axes in figure.axes if axes.axison]
    labels = [text for axes in shown for text in (axes.get_xlabel(), axes.get_ylabel()) if text]
    assert labels
    assert all(label.endswith(UNITS) for label in labels), labels


def test_one_pair_is_refused(flight):
    with pytest.raises(ConfigError, match='VIO: there is nothing to draw'):
        draw('top', {'VIO': evaluate(flight.estimate[:1], flight.ground_truth)})


def lines(name, runs):
    """Return the lines of each axes of a figure, by label."""
    with theme():
        figure = draw(name, runs)
    return [{line.get_label(): line for line in axes.lines} for axes in figure.axes]


def test_positions_over_time_are_those_of_the_result(result):
    pairs, alignment = result.summary.pairs, result.summary.alignment
    aligned = alignment.positions(pairs.estimate.positions)
    for axis, of in enumerate(lines('xyz', {'VIO': result})):
        assert np.array_equal(of['VIO'].get_ydata(), aligned[:, axis])
        assert np.array_equal(of['ground truth'].get_ydata(), result.truth.positions[:, axis])
        assert np.allclose(of['ground truth'].get_xdata()[[0, -1]], [0.0, 30.0], atol=0.2)


def test_errors_over_time_are_those_of_the_result(result):
    position, rotation = lines('errors', {'VIO': result})
    table = result.errors()
    assert np.array_equal(position['VIO'].get_ydata(), table['ate_trans_m'])
    assert np.allclose(rotation['VIO'].get_ydata(), table['ate_rot_deg'], atol=0, rtol=0)


def test_angles_do_not_jump_and_are_the_same_turns_for_all_systems(flight):
    whole = evaluate(flight.estimate, flight.ground_truth)
    late = evaluate(flight.estimate[len(flight.estimate) // 2 :], flight.ground_truth)
    for of in lines('rpy', {'A': whole, 'B': late}):
        one, other = of['A'], of['B']
        assert np.abs(np.diff(one.get_ydata())).max() < 90
        at = np.interp(other.get_xdata(), one.get_xdata(), one.get_ydata())
        assert np.abs(other.get_ydata() - at).max() < 20


def test_a_gap_is_not_bridged(kinds):
    for of in lines('xyz', kinds['gap']):
        assert np.isnan(of['VIO'].get_ydata()).sum() == 1


def test_long_runs_keep_their_peaks():
    stamps = np.arange(200_000) * 5_000_000
    truth = np.stack([np.cos(stamps / 1e10), np.sin(stamps / 1e10), stamps / 1e12], axis=1)
    estimate = truth.copy()
    estimate[77_777] += 3.0
    runs = {'VIO': evaluate((stamps, estimate, None), (stamps, truth, None))}
    ((of),) = lines('errors', runs)
    assert len(of['VIO'].get_ydata()) < 10_000
    assert of['VIO'].get_ydata().max() == runs['VIO'].errors()['ate_trans_m'].max()


def test_bounds_are_three_standard_deviations_in_the_world_of_the_truth(kinds, flight):
    (system,) = systems_of(kinds['covariance'])
    axes = system.result.summary.alignment.linear
    covariance = axes @ np.diag([0.01, 0.04, 0.09]) @ axes.T
    assert np.allclose(system.run.three_sigma, 3 * np.sqrt(np.diag(covariance)), rtol=1e-5)


def test_a_system_has_its_colour_in_every_figure(result):
    runs = {'A': result, 'B': result}
    for name in ('top', 'xyz', 'errors', 'cumulative'):
        assert lines(name, runs)[0]['B'].get_color() == COLOURS[1]


def test_files_are_the_same_each_time_and_embed_their_fonts(result):
    runs = {'VIO': result}
    for form, begin in (('pdf', b'%PDF'), ('svg', b'<?xml'), ('png', b'\x89PNG')):
        content = pages(['errors'], runs, form)
        assert content.startswith(begin)
        assert content == pages(['errors'], runs, form)
    document = pages(['errors', 'rpe'], runs)
    assert b'/FontFile2' in document
    assert document.count(b'/Type /Page ') == 2


@pytest.fixture(scope='module')
def files(flight, tmp_path_factory):
    """Return the options that name an estimate and a truth."""
    folder = tmp_path_factory.mktemp('run')
    for name, side in (('est', flight.estimate), ('gt', flight.ground_truth)):
        (folder / name).write_text(tum(side))
    return ['--estimate', folder / 'est', '--ground-truth', folder / 'gt']


def test_plot_writes_a_file_for_each_figure(files, tmp_path):
    done = call('plot', *files, '--out', tmp_path / 'new', '--format', 'svg')
    assert (done.returncode, done.stderr) == (0, '')
    assert sorted(f.name for f in (tmp_path / 'new').iterdir()) == [
        'errors.svg',
        'top.svg',
        'xyz.svg',
    ]


def test_plot_writes_pages_of_one_file_in_a_theme(files, tmp_path):
    theme_file = tmp_path / 'big.mplstyle'
    theme_file.write_text('font.size: 20\n')
    out = tmp_path / 'all.pdf'
    done = call(
        'plot', *files, '--out', out, '--figure', 'rpe', 'histogram', '--theme', theme_file
    )
    assert (done.returncode, done.stderr) == (0, '')
    assert out.read_bytes().count(b'/Type /Page ') == 2


@pytest.mark.parametrize(
    ('options', 'problem'),
    [
        (['--figure', 'erors'], "there is no figure 'erors'; did you mean 'errors'?"),
        (['--out', 'a.png'], 'one figure per .png file'),
        (['--out', 'a.jpg'], 'a file that ends in .pdf, .svg, .png'),
        (['--theme', 'missing'], 'missing: No such file'),
        (['--theme', 'unknown.mplstyle'], 'unknown.mplstyle: no style sheet of matplotlib'),
        (['--theme', 'bad.mplstyle'], 'bad.mplstyle: no style sheet of matplotlib'),
    ],
)
def test_what_plot_cannot_do_is_one_line(options, problem, files, tmp_path):
    (tmp_path / 'unknown.mplstyle').write_text('font.sise: 8\n')
    (tmp_path / 'bad.mplstyle').write_text('font.size: large-ish\n')
    done = call('plot', *files, '--out', 'figures', *options, cwd=tmp_path)
    assert done.returncode == 2
    assert problem in done.stderr
    assert done.stderr.count('\n') == 1


@pytest.mark.slow
@pytest.mark.parametrize('form', ['png', 'svg', 'pdf'])
@pytest.mark.parametrize('verb', ['replay', 'diagnose'])
def test_verbs_write_an_overview(verb, form, files, tmp_path):
    out = tmp_path / f'overview.{form}'
    done = call(verb, *files, '--report', out)
    assert (done.returncode, done.stderr) == (0, '')
    assert out.stat().st_size > 10_000


@pytest.mark.slow
def test_a_suite_has_the_spread_of_its_runs_and_a_page_for_each_sequence(files, tmp_path):
    for sequence in ('one', 'two'):
        (tmp_path / f'{sequence}.txt').write_text(files[1].read_text())
    suite = tmp_path / 'suite.yaml'
    suite.write_text(
        f'ground_truth: {files[3]}\n'
        'sequences: [one, two]\n'
        'systems:\n'
        "  - {name: missing, estimate: 'none/{sequence}.txt'}\n"
        "  - {name: VIO, estimate: '{sequence}.txt'}\n"
    )
    out = tmp_path / 'suite.pdf'
    assert call('score', suite, '--report', out, '--jobs', 1).returncode == 1
    assert out.read_bytes().count(b'/Type /Page ') == 3


def test_a_system_keeps_its_look_where_another_has_no_result(result):
    (system,) = systems_of({'B': result}, ['A', 'B'])
    assert system.look == look(1)


def test_a_run_that_failed_is_not_a_gap():
    figure = Figure()
    values = {'V1': {'A': np.array([0.1, np.nan]), 'B': np.array([np.nan]), 'C': np.empty(0)}}
    spread(figure, values, 'ATE [m]')
    assert [text.get_text() for text in figure.axes[0].texts] == ['1 failed', 'failed', 'no run']


def test_the_library_gives_figures(flight, result):
    figure = result.figure('errors', columns=2)
    assert figure.get_figwidth() == pytest.approx(7.16)
    both = compare({'A': flight.estimate, 'B': flight.estimate}, flight.ground_truth)
    drawn = {line.get_label() for line in both.figure('xyz').axes[0].lines}
    assert drawn == {'ground truth', 'A', 'B'}
    with pytest.raises(ConfigError, match="no figure 'erors'; did you mean 'errors'"):
        result.figure('erors')
