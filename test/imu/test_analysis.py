"""Units, motion and doubtful records are recognised, and said."""

import json
import math

import numpy as np
import pytest

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.imu.analysis import analyse
from vio_eval_ros.imu.noise_reports import json_document, kalibr_document, plot, table
from vio_eval_ros.imu.record import AXES, Record
from vio_eval_ros.imu.simulated_noise import EUROC, Noise, NoiseModel, simulate_noise
from vio_eval_ros.simulation.flight import Flight

pytestmark = pytest.mark.needs('allantools')

RATE_HZ = 50.0
BIAS = np.array([0.02, -0.01, 0.005, 0.1, -0.2, 9.81])


def rest(hours=1.0, noise=EUROC, seed=1):
    count = round(hours * 3600 * RATE_HZ)
    return BIAS + simulate_noise(count, RATE_HZ, noise, np.random.default_rng(seed))


def analysed(samples, stated=None, stamps_ns=None, topic='/imu0'):
    record = Record('test')
    period_ns = round(1e9 / RATE_HZ)
    record.add(period_ns * np.arange(len(samples)) if stamps_ns is None else stamps_ns, samples)
    return analyse('rest.bag:/imu0', record.finish(), stated=stated, topic=topic)


@pytest.fixture(scope='module')
def still():
    return analysed(rest())


@pytest.mark.slow
def test_a_record_at_rest_gives_its_noise_without_a_warning(still):
    assert still.warnings == ()
    for name, axis in still.axes.items():
        noise = getattr(EUROC, name.partition('_')[0])
        assert axis.fit.density.value == pytest.approx(noise.density, rel=0.05)
        assert axis.fit.walk.value == pytest.approx(noise.walk, rel=0.25)
    assert still.axes['accel_z'].mean == pytest.approx(9.81, abs=0.5)


@pytest.mark.slow
def test_degrees_and_g_are_recognised_by_magnitude_and_reported(still):
    other = analysed(rest() / np.repeat([np.pi / 180, 9.80665], 3), topic=None)
    assert [unit.name for unit in other.units.values()] == ['deg/s', 'g']
    assert [unit.known for unit in other.units.values()] == ['by magnitude'] * 2
    assert sum('judging by its magnitude' in line for line in other.warnings) == 2
    for name in AXES:
        found, expected = other.axes[name].fit, still.axes[name].fit
        assert found.density.value == pytest.approx(expected.density.value, rel=1e-6)
        assert found.walk.value == pytest.approx(expected.walk.value, rel=1e-6)


@pytest.mark.slow
def test_stated_units_are_not_questioned():
    stated = analysed(rest(), {'gyro': 'deg/s', 'accel': 'm/s2'})
    assert stated.units['gyro'] == ('deg/s', 'stated')
    density = stated.axes['gyro_x'].fit.density.value
    assert density == pytest.approx(EUROC.gyro.density * np.pi / 180, rel=0.05)
    assert not any('magnitude' in line for line in stated.warnings)


@pytest.mark.slow
@pytest.mark.parametrize('density', [2e-6, 1e-5, 1.7e-4, 5e-4])
def test_no_common_gyroscope_in_radians_is_taken_to_be_in_degrees(density):
    noise = NoiseModel(Noise(density, 1e-6), EUROC.accel)
    assert analysed(rest(0.1, noise)).units['gyro'] == ('rad/s', 'by default')


@pytest.mark.parametrize('count', [10, 15, 40])
def test_a_gyroscope_of_less_than_a_second_is_judged_by_its_white_noise_at_one(count):
    noise = NoiseModel(Noise(8e-4, 1e-6), EUROC.accel)
    assert analysed(rest(0.1, noise)[:count]).units['gyro'] == ('rad/s', 'by default')
    degrees = rest(0.1)[:count] / (np.pi / 180)
    assert analysed(degrees, topic=None).units['gyro'] == ('deg/s', 'by magnitude')


def test_a_message_has_the_unit_of_its_type_however_noisy_the_gyroscope():
    noisy = analysed(rest(0.1, NoiseModel(Noise(5e-3, 1e-6), EUROC.accel)))
    assert noisy.units['gyro'] == ('rad/s', 'by default')
    assert any('very noisy for rad/s' in line for line in noisy.warnings)
    in_g = analysed(rest(0.1) / np.repeat([1.0, 9.80665], 3))
    assert in_g.units['accel'] == ('g', 'by magnitude')


@pytest.mark.parametrize('absent', ['gyro', 'accel'])
def test_a_sensor_that_is_on_another_topic_is_not_judged(absent):
    samples = rest(0.1)
    samples[:, :3] = 0.0 if absent == 'gyro' else samples[:, :3]
    samples[:, 3:] = 0.0 if absent == 'accel' else samples[:, 3:]
    found = analysed(samples)
    assert sum('a topic of its own' in line for line in found.warnings) == 1
    assert not any('unit is wrong' in line for line in found.warnings)
    with pytest.raises(ConfigError, match=r'on /imu0; where each sensor has a topic of its own'):
        kalibr_document(found)
    present = 'accel_x' if absent == 'gyro' else 'gyro_x'
    assert found.axes[present].fit.density.value > 0


@pytest.mark.parametrize('seconds', [10, 60])
def test_a_sensor_in_flight_is_refused(seconds):
    times_ns = np.arange(0, seconds * 10**9, round(1e9 / RATE_HZ))
    flown = Flight.random(np.random.default_rng(1)).imu_samples(times_ns)
    with pytest.raises(ReadError, match='was moved or flown in'):
        analysed(flown + rest()[: len(flown)] - BIAS, stamps_ns=times_ns)


def test_three_seconds_at_rest_are_enough_for_a_density():
    found = analysed(rest()[: round(3 * RATE_HZ)])
    assert found.axes['gyro_x'].fit.density.value > 0


def test_what_the_record_is_too_short_to_determine_is_a_warning():
    (warning,) = analysed(rest(0.01)).warnings
    named = 'the random walk of gyro_x, gyro_y, gyro_z'
    assert warning == f'the record is too short to determine {named}'
    (warning,) = (line for line in analysed(rest()[:20]).warnings if 'too short' in line)
    for name in ('white noise density', 'bias instability', 'random walk'):
        assert f'the {name} of any axis' in warning


def moved(begin_s, end_s, axis, by):
    samples = rest()
    samples[round(begin_s * RATE_HZ) : round(end_s * RATE_HZ), axis] += by
    return analysed(samples)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('begin_s', 'end_s', 'axis', 'by', 'told'),
    [
        (2_000, 2_005, 0, 0.5, 'gyro_x changes in 2 of 3,600 seconds, beginning 2,000, 2,005 s'),
        (2_000.5, 2_030, 1, 0.02, 'beginning 2,000, 2,030 s'),
        (1_500, 3_600, 3, 0.17, 'accel_x changes in 1 of 3,600 seconds, beginning 1,500 s'),
        (1_500.5, 3_600, 5, -3.0, 'beginning 1,500 s'),
        (
            40,
            42,
            0,
            np.linspace(0, 0.5, 100),
            'gyro_x changes in 2 of 3,600 seconds, beginning 40 s',
        ),
        (100, 100.1, 4, 1.0, 'accel_y changes in 1 of 3,600 seconds, beginning 100 s'),
    ],
    ids=['turned', 'turned slowly', 'tilted', 'laid down', 'sped up', 'knocked'],
)
def test_motion_is_reported_with_its_time(begin_s, end_s, axis, by, told):
    found = moved(begin_s, end_s, axis, by)
    (warning,) = [line for line in found.warnings if 'not at rest' in line]
    assert told in warning
    assert f'warning: {warning}' in table(found)
    assert warning in json.loads(json_document(found))['warnings']


@pytest.mark.slow
def test_a_movement_too_slow_for_seconds_is_seen_in_tens_of_them():
    samples = rest(noise=NoiseModel(EUROC.gyro, Noise(2e-3, 3e-4)))
    samples[:, 3] += 0.17 * np.clip((np.arange(len(samples)) / RATE_HZ - 2_000) / 60, 0, 1)
    (warning,) = [line for line in analysed(samples).warnings if 'not at rest' in line]
    assert 'accel_x changes in' in warning
    assert 'beginning 2,0' in warning


@pytest.mark.slow
def test_many_movements_are_counted_and_the_first_named():
    samples = rest()
    samples[:: round(10 * RATE_HZ), 0] = 5
    (warning,) = [line for line in analysed(samples).warnings if 'not at rest' in line]
    assert 'beginning 0, 10, 20, 30, 40 s after the start and 355 times more' in warning


@pytest.mark.slow
@pytest.mark.parametrize(
    'noise',
    [
        EUROC,
        NoiseModel(Noise(1.888e-4, 2.557e-6), Noise(1.6e-3, 2.5e-4, 5e-4)),
        NoiseModel(Noise(1.7e-4, 1.3e-5, 5e-5), Noise(2e-3, 0.0, 1e-3)),
        NoiseModel(Noise(1.7e-4, 2e-6, 1e-4), Noise(2e-2, 1e-5)),
    ],
)
@pytest.mark.parametrize('hours', [1 / 3, 2])
def test_no_noise_is_taken_for_movement_vibration_or_resolution(noise, hours):
    told = ' '.join(analysed(rest(hours, noise, 7)).warnings)
    for word in ('at rest', 'Hz', 'constant', 'resolution', 'missing'):
        assert word not in told


@pytest.mark.slow
def test_a_value_that_stands_still_for_a_while_is_reported_with_its_time():
    samples = rest()
    samples[90_000:, 1] = samples[90_000, 1]
    assert analysed(samples).warnings == (
        'gyro_y: its value is constant in 1,800 of 3,600 seconds, '
        'beginning 1,800 s after the start',
    )


@pytest.mark.slow
@pytest.mark.parametrize('step', [0.003, 0.01])
def test_a_resolution_that_spoils_the_density_is_reported(step):
    """The noise of a sample is 1.2e-3 rad/s."""
    samples = rest()
    samples[:, 0] = step * np.round(samples[:, 0] / step)
    (warning,) = [line for line in analysed(samples).warnings if 'resolution' in line]
    assert f'gyro_x: its resolution, {step:g} rad/s, is coarser' in warning


@pytest.mark.slow
def test_a_resolution_that_shows_the_noise_is_no_trouble():
    samples = rest()
    samples[:, 0] = 1e-3 * np.round(samples[:, 0] / 1e-3)
    found = analysed(samples)
    assert found.warnings == ()
    assert found.axes['gyro_x'].fit.density.value == pytest.approx(EUROC.gyro.density, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(('hz', 'size'), [(11.5, 0.02), (0.9, 2e-3)])
def test_a_vibration_that_raises_the_density_is_reported_with_its_frequency(hz, size):
    samples = rest()
    samples[:, 0] += size * np.sin(2 * np.pi * hz * np.arange(len(samples)) / RATE_HZ)
    found = analysed(samples)
    (warning,) = [line for line in found.warnings if 'vibration of' in line]
    rise = found.axes['gyro_x'].fit.density.value / EUROC.gyro.density - 1
    assert rise > 0.1
    assert f'gyro_x: a vibration of {hz:.3g} Hz raises its density by ' in warning
    assert float(warning.split()[-2]) == pytest.approx(100 * rise, abs=4)


@pytest.mark.slow
@pytest.mark.parametrize('share', [0.05, 0.1])
def test_random_losses_leave_density_and_walk_as_they_are(share):
    samples = rest(noise=NoiseModel(EUROC.gyro, Noise(2e-3, 3e-3)))
    stamps_ns = 20_000_000 * np.arange(len(samples))
    kept = np.random.default_rng(3).random(len(samples)) > share
    found = analysed(samples[kept], stamps_ns=stamps_ns[kept])
    densities = [
        axis.fit.density.value / getattr(EUROC, name.partition('_')[0]).density
        for name, axis in found.axes.items()
    ]
    assert np.mean(densities) == pytest.approx(1, abs=0.01)
    walks = [found.axes[f'accel_{axis}'].fit.walk.value / EUROC.accel.walk for axis in 'xyz']
    assert np.mean(walks) == pytest.approx(1, abs=0.04)
    (warning,) = found.warnings
    assert warning.startswith(f'{100 * share:.0f}.')
    assert found.signal.duration_s == pytest.approx(3_600, rel=1e-3)


@pytest.mark.parametrize('share', [0.3, 0.6, 0.8])
def test_of_a_record_with_gaps_everywhere_nothing_is_reported(share):
    samples = rest(0.3)
    stamps_ns = 20_000_000 * np.arange(len(samples))
    kept = np.random.default_rng(3).random(len(samples)) > share
    found = analysed(samples[kept], stamps_ns=stamps_ns[kept])
    assert any('too many to determine any noise' in warning for warning in found.warnings)
    for axis in found.axes.values():
        assert np.isnan([axis.fit.density.value, axis.fit.walk.value]).all()
        assert 'of the samples are missing' in axis.fit.density.reason


@pytest.mark.slow
def test_a_rotating_sensor_and_missing_gravity_are_reported():
    samples = rest() - BIAS
    samples[:, 2] += 1.0
    warnings = ' '.join(analysed(samples).warnings)
    assert 'mean angular rate is 1 rad/s' in warnings
    assert 'mean acceleration is' in warnings


@pytest.mark.slow
def test_losses_gaps_and_shared_stamps_are_reported():
    samples = rest(0.2)
    stamps_ns = 20_000_000 * np.arange(len(samples))
    kept = np.flatnonzero(np.arange(len(samples)) % 40 != 7)
    stamps_ns[20_000:] += 10**10
    warnings = ' '.join(analysed(samples[kept], stamps_ns=stamps_ns[kept]).warnings)
    assert '2.5 % of the samples are missing' in warnings
    assert 'cut into 2 segments; gaps: 1, samples lost in them: 500' in warnings
    stamps_ns = 20_000_000 * (np.arange(len(samples)) // 2 * 2)
    assert 'stamps are not those of the sensor' in ' '.join(
        analysed(samples, stamps_ns=stamps_ns).warnings
    )


@pytest.mark.slow
def test_a_stuck_axis_is_null_and_said():
    samples = rest(0.2)
    samples[:, 1] = 0.25
    found = analysed(samples)
    fit = found.axes['gyro_y'].fit
    assert math.isnan(fit.density.value)
    assert 'never changes' in fit.density.reason
    assert json.loads(json_document(found))['axes']['gyro_y']['curve']['deviation'][0] == 0


@pytest.mark.slow
def test_the_json_has_every_parameter_with_its_interval_and_null_for_what_is_not_known(still):
    document = json.loads(json_document(still))
    assert document['schema'] == 'vio_eval_ros.imu_noise/1'
    assert document['input']['rate_hz'] == pytest.approx(50.0)
    assert document['input']['counts']['samples'] == 180_000
    assert list(document['axes']) == list(AXES)
    for name, axis in document['axes'].items():
        for parameter in ('white_noise_density', 'random_walk'):
            found = axis['parameters'][parameter]
            assert found['low'] < found['value'] < found['high']
            assert found['reason'] is None
        assert axis['parameters']['bias_instability']['value'] is None
        assert axis['parameters']['bias_instability']['reason']
        curve = axis['curve']
        assert len({len(values) for values in curve.values()}) == 1
        assert (np.array(curve['low']) < curve['deviation']).all()
        assert (np.array(curve['high']) > curve['deviation']).all()
        largest = document['kalibr'][
            f'{"gyroscope" if name[0] == "g" else "accelerometer"}_random_walk'
        ]
        assert axis['parameters']['random_walk']['value'] <= largest


def test_the_table_has_a_line_for_each_axis_and_a_reason_for_each_null(still):
    lines = table(still).splitlines()
    assert sum(line[:9].strip() in ('x', 'y', 'z') for line in lines) == 6
    assert any(
        line.startswith('null: gyro_x, gyro_y') and 'bias instability' in line for line in lines
    )


def test_kalibr_s_file_has_its_four_figures_rate_and_topic(still):
    import yaml

    text = kalibr_document(still)
    content = yaml.safe_load(text)
    assert content['rostopic'] == '/imu0'
    assert content['update_rate'] == 50.0
    assert content['gyroscope_noise_density'] == max(
        still.axes[f'gyro_{axis}'].fit.density.value for axis in 'xyz'
    )
    assert content['accelerometer_random_walk'] == pytest.approx(3e-3, rel=0.2)
    assert all(isinstance(value, float) for key, value in content.items() if key != 'rostopic')
    assert '5 to 10 times' in text


@pytest.mark.slow
def test_kalibr_s_file_is_not_made_of_guesses():
    noise = NoiseModel(Noise(1.7e-4, 0.0), EUROC.accel)
    with pytest.raises(ConfigError, match=r'gyroscope_random_walk is not known: .*record longer'):
        kalibr_document(analysed(rest(0.2, noise)))


@pytest.mark.slow
def test_the_plot_is_a_png_that_shows_something(still):
    pytest.importorskip('matplotlib')
    image = pytest.importorskip('PIL.Image')
    import io

    png = plot(still)
    with image.open(io.BytesIO(png)) as picture:
        assert picture.size == (1200, 550)
        assert len(set(picture.convert('RGB').resize((60, 30)).tobytes())) > 20


@pytest.mark.slow
def test_a_short_record_still_has_every_document():
    short = analysed(rest(0.0001))
    assert all(math.isnan(axis.fit.density.value) for axis in short.axes.values())
    assert 'too short' in table(short)
    assert json.loads(json_document(short))['kalibr']['gyroscope_noise_density'] is None
    pytest.importorskip('matplotlib')
    assert plot(short).startswith(b'\x89PNG')


@pytest.mark.slow
def test_a_value_that_never_changes_is_no_trouble_to_the_plot(recwarn):
    pytest.importorskip('matplotlib')
    assert plot(analysed(np.ones((1_000, 6)))).startswith(b'\x89PNG')
    assert not recwarn.list
