"""Latitude, longitude and altitude in a local frame: x east, y north, z up, in metres."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from vio_eval_ros.errors import ConfigError, ReadError

#: latitude [deg], longitude [deg], height above the ellipsoid [m]
Origin = tuple[float, float, float]
#: the largest latitude and longitude [deg]; some count longitude to 360
LARGEST_DEG = (90.0, 360.0)
LARGEST_RAD = (np.pi / 2, np.pi)
#: what only degrees are: none of many is near zero, they change by less than 50 km make, and the
#: altitude in metres by many times as much
LEAST_PLACES, LEAST_DEG, MOST_DEG, STEEPER = 10, 1.0, 0.5, 20.0


def east_north_up(
    geodetic: np.ndarray, origin: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return positions in the plane that touches the WGS 84 ellipsoid at an origin, and the origin.

    The projection is exact: positions go through earth-centred coordinates. Far from the origin
    the plane leaves the ground, by 8 cm in 1 km and 8 m in 10 km.

    :param geodetic: (N, 3) latitude [deg], longitude [deg], height above the ellipsoid [m]; rows
        that are not finite or beyond the poles become NaN.
    :param origin: (3,) likewise; None for the first row that is a place, NaN where none is.
    :return: (N, 3) metres east, north and up, and (3,) the origin.
    :raises ConfigError: pymap3d is not installed.
    """
    geodetic2enu = _geodetic2enu()
    places = are_places(geodetic)
    positions = np.full(geodetic.shape, np.nan)
    if origin is None:
        origin = geodetic[places.argmax()] if places.any() else np.full(3, np.nan)
    if places.any():
        positions[places] = np.column_stack(geodetic2enu(*geodetic[places].T, *origin))
    return positions, origin


def _geodetic2enu() -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the function of pymap3d."""
    try:
        from pymap3d import geodetic2enu
    except ImportError:
        raise ConfigError(
            'latitude and longitude are made local metres (east, north, up) with pymap3d: pip '
            "install 'vio_eval_ros[geo]'"
        ) from None
    return geodetic2enu  # type: ignore[no-any-return]


class Projection:
    """
    Projects the positions of a stream, part by part, around its first place.

    :raises ConfigError: pymap3d is not installed; at once, not when a first message comes.
    """

    def __init__(self, parts: str = 'messages') -> None:
        _geodetic2enu()
        self._parts = parts
        self._origin: np.ndarray | None = None
        self._count = self._nowhere = 0

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        """
        Return (N, M) numbers with positions [m] for latitude, longitude and height.

        What is no place becomes NaN, and is counted; so does 0, 0, which receivers without a fix
        send.
        """
        is_set = np.any(numbers[:, :2], axis=1, keepdims=True)
        geodetic = np.where(is_set, numbers[:, :3], np.nan)
        positions, origin = east_north_up(geodetic, self._origin)
        if np.isfinite(origin).all():
            self._origin = origin
        self._count += len(numbers)
        self._nowhere += int(np.count_nonzero(~np.isfinite(positions).all(axis=1)))
        return np.hstack([positions, numbers[:, 3:]])

    @property
    def origin(self) -> Origin | None:
        """What the positions are relative to; None before the first place."""
        if self._origin is None:
            return None
        latitude, longitude, height = self._origin.tolist()
        return latitude, longitude, height

    def notes(self) -> list[str]:
        """Return what has been done, in sentences."""
        found = [] if self._origin is None else [projected(self._origin)]
        if self._nowhere:
            found.append(
                f'{self._nowhere} of {self._count} {self._parts} have no fix, or no latitude, '
                'longitude and altitude; they are dropped'
            )
        return found


def of_columns(
    path: Path, geodetic: np.ndarray, unit: str | None, notes: list[str]
) -> tuple[np.ndarray, Origin | None]:
    """
    Return (N, 3) metres east, north and up of the columns of a text file, and their origin.

    :param geodetic: (N, 3) latitude, longitude, height [m].
    :param unit: of latitude and longitude, 'deg' or 'rad'; None where the file does not say it.
    :param notes: takes a sentence on where they are projected.
    :raises ReadError: they are no degrees, or may be radians.
    """
    known = geodetic[np.isfinite(geodetic).all(axis=1), :2]
    if unit == 'rad':
        geodetic = np.hstack([np.degrees(geodetic[:, :2]), geodetic[:, 2:]])
    elif unit is None and len(known) and (np.abs(known) <= LARGEST_RAD).all():
        raise ReadError(
            path,
            'its latitude and longitude may be radians; write the unit behind their names: '
            "'latitude [deg]' or 'latitude [rad]'",
        )
    if not are_places(geodetic).any():
        shown = ', '.join(f'{value:.9g}' for value in geodetic[0])
        raise ReadError(
            path,
            f'no row has a latitude and longitude in degrees with an altitude (the first: {shown})'
            '; convert them to decimal degrees and metres',
        )
    projection = Projection('rows')
    positions = projection(geodetic)
    notes += (f'{path}: {note}' for note in projection.notes())
    return positions, projection.origin


def between_origins(origin: Origin, other: Origin) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what takes metres east, north and up of one origin to those of another.

    Both are planes that touch the ellipsoid, so that it is a rotation and a translation.

    :return: the (3, 3) rotation, and the (3,) translation [m].
    """
    from pymap3d import enu2uvw, geodetic2enu, uvw2enu

    axes = [uvw2enu(*enu2uvw(*axis, *origin[:2]), *other[:2]) for axis in np.eye(3)]
    return np.array(axes, float).T, np.array(geodetic2enu(*origin, *other), float)


def look_like_degrees(positions: np.ndarray) -> bool:
    """
    Return whether (N, 3) positions show what only latitude, longitude and altitude do.

    Far from zero, the first two change by fractions, and the third by much more.
    """
    known = positions[np.isfinite(positions).all(axis=1)]
    if len(known) < LEAST_PLACES:
        return False
    angles, extent = np.abs(known[:, :2]), np.ptp(known, axis=0)
    in_range = (angles.max(axis=0) <= (180.0, 180.0)).all() and angles.min() > LEAST_DEG
    moves_level = 0 < extent[:2].max() < MOST_DEG
    return bool(in_range and moves_level and extent[2] > STEEPER * extent[:2].max())


def are_places(geodetic: np.ndarray) -> np.ndarray:
    """Return which rows of (N, 3) latitude, longitude and height can be places on the earth."""
    in_range = (np.abs(geodetic[:, :2]) <= LARGEST_DEG).all(axis=1)
    return in_range & np.isfinite(geodetic[:, 2])


def projected(origin: np.ndarray) -> str:
    """Return the sentence that says where positions were projected."""
    latitude, longitude, height = origin
    return (
        'latitude and longitude are projected into metres east, north and up of '
        f'{latitude:.7f}, {longitude:.7f}, {height:.3f} m'
    )
