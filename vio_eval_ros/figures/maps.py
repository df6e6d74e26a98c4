"""A map beneath a path: occupancy grids as the map_server of ROS writes them."""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING
import warnings

import numpy as np

from vio_eval_ros.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MODES = ('trinary', 'scale', 'raw')
#: a map's YAML has ten lines; pixels of an image, and of a side of what is drawn
MOST_BYTES, MOST_PIXELS, MOST_DRAWN = 65_536, 100_000_000, 2000
#: greys of what is free, unknown and occupied
FREE, UNKNOWN, OCCUPIED = 255, 228, 112


@dataclass(frozen=True, eq=False)
class Map:
    """
    A map in the world of the ground truth.

    :param greys: (H, W) uint8, the first row is that of the largest y.
    :param extent: left, right, bottom and top [m] in the frame of the image's lower left corner.
    :param origin: x [m], y [m] and yaw [rad] of that corner.
    """

    greys: np.ndarray
    extent: tuple[float, float, float, float]
    origin: tuple[float, float, float]

    def draw(self, axes: Axes, shift: np.ndarray) -> None:
        """
        Draw the map beneath all else, without a change of the limits of the axes.

        :raises ConfigError: it lies elsewhere than all that is drawn.
        """
        from matplotlib.image import AxesImage
        from matplotlib.transforms import Affine2D, Bbox

        x, y, yaw = self.origin
        image = AxesImage(
            axes, cmap='gray', origin='upper', extent=self.extent, interpolation='nearest'
        )
        image.set_data(self.greys)
        image.set_clim(0, 255)
        image.set_zorder(-1)
        place = Affine2D().rotate(yaw).translate(x - shift[0], y - shift[1])
        left, right, bottom, top = self.extent
        corners = [(left, bottom), (right, bottom), (right, top), (left, top)]
        covered = Bbox.null()
        covered.update_from_data_xy(place.transform(corners))
        if not covered.overlaps(axes.dataLim):
            raise ConfigError(
                'the map is nowhere beneath the paths: its origin must be in the frame of the '
                'ground truth'
            )
        image.set_transform(place + axes.transData)
        axes.add_image(image)
        image.set_clip_path(axes.patch)


def load_map(file: Path) -> Map:
    """
    Return the map of a YAML file of map_server, with the image that it names.

    Modes are those of https://wiki.ros.org/map_server; a pixel of value v is occupied with
    (255 - v) / 255, or v / 255 where ``negate`` is 1.

    :raises ConfigError: the file or its image cannot be read, or is no map.
    """
    import yaml

    try:
        if file.stat().st_size > MOST_BYTES:
            raise ConfigError(f'{file}: too large for the YAML file of a map; give that one')
        found = yaml.safe_load(file.read_text('utf-8'))
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, 'strerror', None) or 'not text; give the YAML file of the map'
        raise ConfigError(f'{file}: {why}') from None
    except (yaml.YAMLError, RecursionError, ValueError):
        raise ConfigError(f'{file}: not YAML; give the YAML file of map_server') from None
    if not isinstance(found, dict) or not isinstance(found.get('image'), str):
        raise ConfigError(f'{file}: not a map: give a YAML file with image, resolution and origin')
    resolution = _number(file, found, 'resolution', None)
    origin = found.get('origin')
    if not isinstance(origin, list) or len(origin) != 3:
        raise ConfigError(f'{file}: origin: write [x, y, yaw]')
    x, y, yaw = (_number(file, {'origin': value}, 'origin', None) for value in origin)
    if resolution <= 0:
        raise ConfigError(f'{file}: resolution: {resolution:g} is not above 0')
    mode = found.get('mode', 'trinary')
    if mode not in MODES:
        raise ConfigError(f'{file}: mode: write one of {", ".join(MODES)}')
    values, alphas = _image(file.parent / found['image'])
    negated = bool(_number(file, found, 'negate', 0))
    limits = [
        _number(file, found, name, usual)
        for name, usual in (('free_thresh', 0.196), ('occupied_thresh', 0.65))
    ]
    if not limits[0] < limits[1]:
        raise ConfigError(f'{file}: free_thresh is not below occupied_thresh')
    greys = _greys(values, alphas, mode, negated, limits)
    height, width = greys.shape
    step = -(-max(height, width) // MOST_DRAWN)
    greys = _reduced(greys, step)
    top = height * resolution
    extent = (
        0.0,
        greys.shape[1] * step * resolution,
        top - greys.shape[0] * step * resolution,
        top,
    )
    return Map(greys, extent, (x, y, yaw))


def _number(file: Path, found: dict[str, Any], name: str, usual: float | None) -> float:
    value = found.get(name, usual)
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f'{file}: {name}: write a number')
    return float(value)


def _image(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the (H, W) mean of the colours, and the opacity, of each pixel, 0 to 255."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', Image.DecompressionBombWarning)
            with Image.open(file, formats=('PPM', 'PNG', 'BMP', 'TIFF', 'JPEG')) as image:
                if image.width * image.height > MOST_PIXELS:
                    raise ConfigError(
                        f'{file}: {image.width} x {image.height} pixels are too many; crop the '
                        f'map to {MOST_PIXELS:,} or fewer'
                    )
                pixels = np.asarray(image.convert('LA'))
    except Image.DecompressionBombError:
        raise ConfigError(f'{file}: too many pixels; crop the map') from None
    except OSError as error:
        why = error.strerror or 'not an image that can be read; give PGM or PNG'
        raise ConfigError(f'{file}: {why}') from None
    except (ValueError, SyntaxError, EOFError):
        raise ConfigError(f'{file}: not an image that can be read; give PGM or PNG') from None
    return pixels[..., 0], pixels[..., 1]


def _greys(
    values: np.ndarray, alphas: np.ndarray, mode: str, negated: bool, limits: list[float]
) -> np.ndarray:
    """Return the (H, W) greys of pixels."""
    levels = np.arange(256.0)
    occupied = levels / 255 if negated else 1 - levels / 255
    free_below, occupied_above = limits
    if mode == 'raw':
        table = np.where(levels <= 100, FREE - levels / 100 * (FREE - OCCUPIED), UNKNOWN)
    elif mode == 'scale':
        share = ((occupied - free_below) / (occupied_above - free_below)).clip(0, 1)
        table = FREE - share * (FREE - OCCUPIED)
    else:
        table = np.full(256, UNKNOWN)
        table[occupied < free_below], table[occupied > occupied_above] = FREE, OCCUPIED
    greys = table.round().astype(np.uint8)[values]
    if mode == 'scale':
        greys[alphas == 0] = UNKNOWN
    return np.asarray(greys)


def _reduced(greys: np.ndarray, step: int) -> np.ndarray:
    """Return the darkest of each block of pixels, so that thin walls stay."""
    if step == 1:
        return greys
    padding = [(0, -length % step) for length in greys.shape]
    padded = np.pad(greys, padding, constant_values=FREE)
    height, width = (length // step for length in padded.shape)
    return np.asarray(padded.reshape(height, step, width, step).min(axis=(1, 3)))
