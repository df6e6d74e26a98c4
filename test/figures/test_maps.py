"""Maps beneath paths."""

import math
from pathlib import Path

import numpy as np
from PIL import Image
import pytest

from verbs import call, complaint
from vio_eval_ros import compare, evaluate
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.figures import maps
from vio_eval_ros.figures.catalogue import draw
from vio_eval_ros.figures.maps import FREE, load_map, OCCUPIED, UNKNOWN
from vio_eval_ros.figures.style import theme
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate

YAML = 'image: m.pgm\nresolution: 0.5\norigin: [-1, 2, {yaw}]\nnegate: 0\n'


def write(folder: Path, text: str = YAML.format(yaw=0), pixels=((0, 254, 205), (254, 254, 0))):
    Image.fromarray(np.array(pixels, np.uint8)).save(folder / 'm.pgm')
    (folder / 'map.yaml').write_text(text)
    return folder / 'map.yaml'


def test_pixels_are_free_occupied_or_unknown(tmp_path):
    found = load_map(write(tmp_path))
    assert found.greys.tolist() == [[OCCUPIED, FREE, UNKNOWN], [FREE, FREE, OCCUPIED]]
    assert found.extent == (0, 1.5, 0, 1)
    negated = load_map(write(tmp_path, YAML.format(yaw=0).replace('negate: 0', 'negate: 1')))
    assert negated.greys[0].tolist() == [FREE, OCCUPIED, OCCUPIED]
    scaled = load_map(write(tmp_path, YAML.format(yaw=0) + 'mode: scale\n'))
    assert (scaled.greys[0, :2] == [OCCUPIED, FREE]).all()
    raw = load_map(write(tmp_path, YAML.format(yaw=0) + 'mode: raw\n', [[0, 100, 255]]))
    assert raw.greys.tolist() == [[FREE, OCCUPIED, UNKNOWN]]


def test_thin_walls_of_large_maps_stay(tmp_path, monkeypatch):
    pixels = np.full((7, 9), 254)
    pixels[:, 4] = 0
    monkeypatch.setattr(maps, 'MOST_DRAWN', 3)
    found = load_map(write(tmp_path, pixels=pixels))
    assert found.greys.tolist() == [[FREE, OCCUPIED, FREE]] * 3
    assert found.extent == (0, 4.5, -1, 3.5)


@pytest.mark.parametrize('yaw', [0.0, math.pi / 2])
def test_a_map_lies_where_its_origin_says_and_does_not_move_the_axes(tmp_path, yaw):
    flight = simulate(duration_s=10.0)
    runs = {'A': evaluate(flight.estimate, flight.ground_truth)}
    x = 20 if yaw else -20
    text = YAML.format(yaw=yaw).replace('[-1, 2,', f'[{x}, -20,')
    beneath = load_map(write(tmp_path, text, np.full((90, 90), 0)))
    with theme():
        for name in ('top', 'projections'):
            plain, figure = draw(name, runs), draw(name, runs, beneath=beneath)
            for one in (plain, figure):
                one.canvas.draw()
            assert figure.axes[0].get_xlim() == plain.axes[0].get_xlim()
            assert [len(axes.images) for axes in figure.axes] == [1] + [0] * (len(figure.axes) - 1)
            (image,) = figure.axes[0].images
            place = image.get_transform() - figure.axes[0].transData
            expected = (-18.5, -20) if not yaw else (20, -18.5)
            assert place.transform((1.5, 0)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        ('[', 'not YAML'),
        ('- 1', 'not a map'),
        ('image: m.pgm', 'resolution: write a number'),
        ('image: m.pgm\nresolution: 0\norigin: [0, 0, 0]', 'is not above 0'),
        ('image: m.pgm\nresolution: 1\norigin: [0, 0]', 'write [x, y, yaw]'),
        ('image: m.pgm\nresolution: 1\norigin: [0, .nan, 0]', 'origin: write a number'),
        ('image: x.pgm\nresolution: 1\norigin: [0, 0, 0]', 'x.pgm: No such file'),
        ('image: map.yaml\nresolution: 1\norigin: [0, 0, 0]', 'not an image'),
        (YAML.format(yaw=0) + 'mode: x', 'write one of trinary'),
        (YAML.format(yaw=0) + 'free_thresh: 0.7', 'free_thresh is not below'),
        ('#' * 70_000, 'too large'),
    ],
)
def test_what_is_no_map_is_one_line(tmp_path, text, problem):
    with pytest.raises(ConfigError) as told:
        load_map(write(tmp_path, text))
    assert problem in str(told.value)
    assert '\n' not in str(told.value)


def test_an_image_with_too_many_pixels_is_refused_before_it_is_read(tmp_path):
    file = write(tmp_path)
    (tmp_path / 'm.pgm').write_bytes(b'P5 12000 12000 255\n')
    with pytest.raises(ConfigError, match='12000 x 12000 pixels are too many'):
        load_map(file)
    (tmp_path / 'm.pgm').write_bytes(b'P5 900000 900000 255\n')
    with pytest.raises(ConfigError, match='too many pixels'):
        load_map(file)
    (tmp_path / 'm.pgm').write_bytes(b'P5 100 100 255\nabc')
    with pytest.raises(ConfigError, match='not an image'):
        load_map(file)


def test_a_map_of_another_place_is_refused(tmp_path):
    flight = simulate(duration_s=10.0)
    runs = {'A': evaluate(flight.estimate, flight.ground_truth)}
    far = load_map(write(tmp_path, YAML.format(yaw=0).replace('[-1, 2', '[-1000, 2')))
    with theme(), pytest.raises(ConfigError, match='nowhere beneath the paths'):
        draw('top', runs, beneath=far)


def test_plot_draws_a_map_and_refuses_one_that_nothing_would_show(tmp_path):
    flight = simulate(duration_s=10.0)
    for name, side in (('est', flight.estimate), ('gt', flight.ground_truth)):
        (tmp_path / name).write_text(tum(side))
    files = ('--estimate', tmp_path / 'est', '--ground-truth', tmp_path / 'gt')
    under_all = YAML.format(yaw=0).replace('[-1, 2, 0]', '[-150, -150, 0]')
    given = (*files, '--map', write(tmp_path, under_all, np.full((600, 600), 0)))
    done = call('plot', *given, '--figure', 'top', '--out', tmp_path / 'a.png')
    assert (done.returncode, done.stderr) == (0, '')
    call('plot', *files, '--figure', 'top', '--out', tmp_path / 'b.png')
    assert (tmp_path / 'a.png').read_bytes() != (tmp_path / 'b.png').read_bytes()
    told = complaint('plot', *given, '--figure', 'errors', '--out', tmp_path / 'c.png')
    assert 'add one to --figure' in told


def test_figures_of_the_library_have_the_map_of_plot(tmp_path):
    flight = simulate(duration_s=10.0)
    under_all = YAML.format(yaw=0).replace('[-1, 2, 0]', '[-150, -150, 0]')
    file = write(tmp_path, under_all, np.full((600, 600), 0))
    result = evaluate(flight.estimate, flight.ground_truth)
    both = compare({'A': flight.estimate, 'B': flight.estimate}, flight.ground_truth)
    for found in (result, both):
        for given in (file, str(file)):
            (image,) = found.figure('top', map=given).axes[0].images
            assert (image.get_array() == load_map(file).greys).all()
        assert not found.figure('top').axes[0].images
        with pytest.raises(ConfigError, match="beneath top and projections, not beneath 'errors'"):
            found.figure('errors', map=file)
        with pytest.raises(ConfigError, match='No such file'):
            found.figure('top', map=tmp_path / 'none.yaml')
