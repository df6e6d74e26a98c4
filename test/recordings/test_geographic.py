"""Places on the earth become metres east, north and up."""

from pathlib import Path
import sys

import numpy as np
import pytest

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.geographic import east_north_up, of_columns, projected
from vio_eval_ros.recordings.messages import adjustment_of
from vio_eval_ros.recordings.sources import read_sources, Source

# WGS 84: semi-major axis and squared eccentricity
AXIS_M, ECCENTRICITY2 = 6378137.0, 6.69437999014e-3
MUNICH = np.array([48.137, 11.575, 520.0])


def earth_centred(latitude: float, longitude: float, height: float) -> np.ndarray:
    """Return a place in earth-centred coordinates [m]; Hofmann-Wellenhof, GPS, eq. 10.3."""
    phi, lam = np.radians([latitude, longitude])
    normal = AXIS_M / np.sqrt(1 - ECCENTRICITY2 * np.sin(phi) ** 2)
    out = (normal + height) * np.cos(phi)
    up = (normal * (1 - ECCENTRICITY2) + height) * np.sin(phi)
    return np.array([out * np.cos(lam), out * np.sin(lam), up])


def test_distances_are_those_of_earth_centred_coordinates():
    places = MUNICH + np.random.default_rng(1).normal(0, [0.02, 0.02, 50], (50, 3))
    positions, origin = east_north_up(places)
    centred = np.array([earth_centred(*place) for place in places])
    np.testing.assert_array_equal(origin, places[0])
    for axis in (positions, centred):
        axis -= axis[7]
    np.testing.assert_allclose(
        np.linalg.norm(positions, axis=1), np.linalg.norm(centred, axis=1), rtol=1e-9, atol=1e-8
    )


def test_axes_are_east_north_and_up():
    steps = MUNICH + np.array([[0, 0, 0], [0, 1e-5, 0], [1e-5, 0, 0], [0, 0, 1.0]])
    positions, _ = east_north_up(steps)
    np.testing.assert_allclose(positions[0], 0, atol=1e-9)
    assert np.argmax(positions[1:], axis=1).tolist() == [0, 1, 2]
    sine2 = np.sin(np.radians(MUNICH[0])) ** 2
    normal = AXIS_M / np.sqrt(1 - ECCENTRICITY2 * sine2)
    meridian = normal * (1 - ECCENTRICITY2) / (1 - ECCENTRICITY2 * sine2)
    radii = (normal + 520) * np.sqrt(1 - sine2), meridian + 520
    expected = [*np.radians(1e-5) * np.array(radii), 1.0]
    np.testing.assert_allclose(positions[1:].max(axis=1), expected, rtol=1e-6)


def test_the_origin_is_the_first_place_or_the_one_that_is_given():
    places = np.array([[np.nan, 11, 520], [91, 11, 520], [48.137, 11.575, np.nan], MUNICH])
    positions, origin = east_north_up(places)
    np.testing.assert_array_equal(origin, MUNICH)
    assert np.isnan(positions[:3]).all()
    np.testing.assert_allclose(positions[3], 0, atol=1e-9)
    moved, origin = east_north_up(places, MUNICH - [0, 0, 2])
    np.testing.assert_array_equal(origin, MUNICH - [0, 0, 2])
    np.testing.assert_allclose(moved[3], [0, 0, 2], atol=1e-8)
    assert '48.1370000, 11.5750000, 518.000 m' in projected(origin)


@pytest.mark.parametrize('places', [np.empty((0, 3)), np.full((3, 3), np.nan)])
def test_without_a_place_there_are_no_positions(places: np.ndarray):
    positions, origin = east_north_up(places)
    assert positions.shape == places.shape
    assert np.isnan(positions).all()
    assert np.isnan(origin).all()


def test_without_the_library_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, 'pymap3d', None)
    with pytest.raises(ConfigError, match=r"pip install 'vio_eval_ros\[geo\]'"):
        east_north_up(MUNICH[None])
    with pytest.raises(ConfigError, match='pymap3d'):
        adjustment_of('sensor_msgs/msg/NavSatFix')


def test_columns_in_degrees_or_radians_are_projected_and_it_is_said():
    notes: list[str] = []
    places = MUNICH + np.arange(5)[:, None] * [1e-5, 0, 0]
    degrees, _ = of_columns(Path('gt.csv'), places, 'deg', notes)
    assert notes[0].startswith('gt.csv: latitude and longitude are projected into metres east')
    radians = np.hstack([np.radians(places[:, :2]), places[:, 2:]])
    np.testing.assert_allclose(
        of_columns(Path('gt.csv'), radians, 'rad', [])[0], degrees, atol=1e-6
    )
    np.testing.assert_array_equal(of_columns(Path('gt.csv'), places, None, [])[0], degrees)
    with pytest.raises(ReadError, match=r"may be radians; .* 'latitude \[deg\]'"):
        of_columns(Path('gt.csv'), radians, None, [])
    with pytest.raises(ReadError, match='no row has a latitude and longitude in degrees'):
        of_columns(Path('gt.csv'), places * [1e7, 1e7, 1], None, [])


def test_rows_without_a_fix_are_counted():
    places = np.vstack([np.zeros((2, 3)), np.tile(MUNICH, (3, 1))])
    notes: list[str] = []
    positions, _ = of_columns(Path('gt.csv'), places, None, notes)
    assert np.isnan(positions[:2]).all()
    assert '2 of 5 rows have no fix' in notes[1]


COUNT = 30
TIMES = np.arange(COUNT) / 10
PLACES = MUNICH + np.column_stack([1e-6 * TIMES**2, 3e-6 * TIMES, 2 * np.sin(TIMES)])
TURN = np.tile([0.5, 0.5, 0.5, 0.5], (COUNT, 1))


def read(folder: Path, header: str, *columns: np.ndarray, statements: str = '') -> Source:
    """Return what is read of a text file with stamps and some columns."""
    table = np.column_stack([1.7e9 + TIMES, *columns])
    path = folder / 'gt.csv'
    np.savetxt(path, table, '%.12f', ',', header=header, comments='')
    return read_sources([f'{path}{statements}'])[0]


@pytest.mark.parametrize(
    'header',
    [
        'time,latitude,longitude,altitude',
        'timestamp,lat,lon,alt',
        'timestamp,Latitude [deg],Longitude [deg],Height [m]',
        't,gps_lat,gps_lon,gps_alt',
        't,lat_deg,lng_deg,elevation',
        'stamp,field.latitude,field.longitude,field.altitude',
        '# time latitude longitude altitude',
    ],
)
def test_a_header_names_latitude_and_longitude_in_many_ways(tmp_path, header):
    source = read(tmp_path, header, PLACES)
    np.testing.assert_allclose(source.positions, east_north_up(PLACES)[0], atol=1e-5)
    assert source.rotations is None
    assert 'projected into metres east, north and up of 48.1370000' in source.warnings[0]


def test_columns_may_be_in_any_order_radians_or_stated(tmp_path):
    expected = east_north_up(PLACES)[0]
    swapped = read(tmp_path, 'time,lon,lat,alt', PLACES[:, [1, 0, 2]])
    np.testing.assert_allclose(swapped.positions, expected, atol=1e-5)
    radians = np.radians(PLACES[:, :2])
    source = read(tmp_path, 'time,lat [rad],lon [rad],alt', radians, PLACES[:, 2])
    np.testing.assert_allclose(source.positions, expected, atol=1e-4)
    source = read(tmp_path, 'a,b,c,d', PLACES, statements='?columns=t,lat,lon,alt')
    np.testing.assert_allclose(source.positions, expected, atol=1e-5)


def test_orientations_beside_latitude_and_longitude(tmp_path):
    source = read(tmp_path, 't,lat,lon,alt,qx,qy,qz,qw', PLACES, TURN)
    np.testing.assert_allclose(source.rotations, TURN)
    assert 'those in east, north, up' in ' '.join(source.warnings)
    source = read(tmp_path, 't,lat,lon,alt,roll,pitch,yaw', PLACES, TURN[:, :3])
    assert source.rotations is None
    assert 'not known whether they count from north or from east' in ' '.join(source.warnings)


@pytest.mark.parametrize(
    ('header', 'columns', 'problem'),
    [
        ('t,lat,lon', PLACES[:, :2], 'but no altitude'),
        ('t,lat,lon,alt', np.radians(PLACES), 'may be radians'),
        ('t,lat,lon,alt', PLACES * [1e7, 1e7, 1], 'in degrees with an altitude'),
        ('t,x,y,z', PLACES, r'columns 2 3 4 look like latitude.*append \?columns=t,lat,lon,alt'),
        ('# no names', np.hstack([PLACES, TURN]), r'columns 2 3 4 look like latitude'),
        ('t,x,y,z,qx,qy,qz,qw', np.hstack([PLACES, TURN]), 'lat,lon,alt,qx,qy,qz,qw'),
    ],
)
def test_what_may_be_no_degrees_or_no_metres_is_asked(tmp_path, header, columns, problem):
    with pytest.raises(ReadError, match=problem):
        read(tmp_path, header, columns)


def test_metres_that_are_stated_are_not_questioned(tmp_path):
    source = read(tmp_path, 't,x,y,z', PLACES, statements='?unit=m')
    np.testing.assert_allclose(source.positions, PLACES)


@pytest.mark.parametrize('scale', [1e-3, 1.0, 1e3])
def test_usual_trajectories_do_not_look_like_degrees(tmp_path, scale):
    paths = [[np.cos(TIMES), np.sin(TIMES), TIMES], [TIMES, 0 * TIMES, 0 * TIMES]]
    for path in paths:
        positions = np.column_stack(path) * scale + [40, 11, 500]
        source = read(tmp_path, 't,x,y,z', positions)
        np.testing.assert_allclose(source.positions, positions)
