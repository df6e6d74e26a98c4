"""The page of an IMU's noise: it draws every axis, and no name breaks out of it."""

import numpy as np
import pytest

from vio_eval_ros.imu.analysis import analyse
from vio_eval_ros.imu.noise_page import html_document
from vio_eval_ros.imu.record import Record
from vio_eval_ros.imu.simulated_noise import EUROC, simulate_noise

HOSTILE = '</script><script>hacked=1</script>.csv'


@pytest.fixture(scope='module')
def analysis():
    pytest.importorskip('allantools')
    record = Record(HOSTILE)
    samples = simulate_noise(60_000, 50.0, EUROC, np.random.default_rng(2))
    record.add(10**18 + np.arange(60_000) * 20_000_000, samples)
    return analyse(HOSTILE, record.finish())


@pytest.mark.slow
def test_both_sensors_are_drawn_with_three_axes_their_intervals_and_fits(parsed, analysis):
    figures = parsed(html_document(analysis)).figures
    assert len(figures) == 2
    for kind, figure in zip(('gyro', 'accel'), figures, strict=True):
        assert len(figure['data']) == 9
        curve = analysis.axes[f'{kind}_x'].curve
        assert figure['data'][1]['x'] == curve.taus_s.tolist()
        assert figure['data'][1]['y'] == curve.deviations.tolist()
        assert figure['layout']['yaxis']['type'] == 'log'


def test_it_has_the_parameters_and_why_one_is_not_known(parsed, analysis):
    text = parsed(html_document(analysis)).text
    assert f'{analysis.axes["gyro_x"].fit.density.value:.4g}' in text
    assert 'x, y, z: bias instability: ' in text
    first, last = analysis.axes['gyro_x'].fit.range_s
    assert f'{first:.3g} to {last:.4g}' in text


@pytest.mark.slow
def test_it_says_when_the_sensor_moved(parsed):
    pytest.importorskip('allantools')
    samples = simulate_noise(60_000, 50.0, EUROC, np.random.default_rng(2))
    samples[30_000:30_250, 0] += 0.5
    record = Record('moved')
    record.add(10**18 + np.arange(60_000) * 20_000_000, samples)
    text = parsed(html_document(analyse('moved', record.finish()))).text
    assert 'gyro_x changes in 2 of 1,200 seconds, beginning 600, 605 s after the start' in text


def test_no_name_breaks_out_of_it(parsed, analysis):
    page = parsed(html_document(analysis))
    assert HOSTILE in page.text
    assert not any('hacked' in text for _, text in page.of('script'))


@pytest.mark.parametrize('width', [400, 1400])
def test_a_browser_draws_it(window, analysis, width):
    window.open(html_document(analysis), width)
    window.check()
