"""Places on the earth become metres east, north and up."""

import sys

import numpy as np
import pytest

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.geographic import east_north_up, projected

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
