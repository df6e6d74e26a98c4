"""YAML means the same as in ROS parameter files, and whatever is wrong in it has its line."""

from datetime import date

import pytest
import yaml

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.settings import load_yaml, MAX_YAML_BYTES, parse_yaml, Section


@pytest.mark.parametrize(
    ('text', 'value'),
    [
        ('yes', True),
        ('Off', False),
        ('true', True),
        ('~', None),
        ('', None),
        ('010', 8),
        ('0x1f', 31),
        ('1_000', 1000),
        ('-7', -7),
        ('1.5e-3', 0.0015),
        ('.5', 0.5),
        ('.inf', float('inf')),
        ('2026-01-02', date(2026, 1, 2)),
        ("'010'", '010'),
        ('1f', '1f'),
        ('[1, a, [2.0]]', [1, 'a', [2.0]]),
        ('{a: 1, b: {c: no}}', {'a': 1, 'b': {'c': False}}),
        ('a: |\n  two\n  lines\n', {'a': 'two\nlines\n'}),
    ],
)
def test_values_mean_what_yaml_1_1_says(tmp_path, text, value):
    found = parse_yaml(text, tmp_path)
    assert found == value == yaml.safe_load(text)
    assert type(found) in (type(value), Section)


@pytest.mark.parametrize(('text', 'value'), [('1e-3', 0.001), ('-2E5', -2e5), ('1.e+2', 100.0)])
def test_a_number_with_an_exponent_needs_no_point(tmp_path, text, value):
    assert parse_yaml(f'a: {text}', tmp_path) == {'a': value}


@pytest.mark.slow
@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        ('a: 1\nb:\n  a: 1\n  a: 2\n', "line 4: 'a' is given twice"),
        ('a: &x [1]\nb: *x\n', 'line 2: aliases are not allowed'),
        ('a:\n- &x 1\n- *x\n', 'line 2: aliases are not allowed'),
        ('a: 1\nb: !!set {x}\n', 'line 2: not valid YAML: tag:yaml.org,2002:set'),
        ('a: !!python/object:os.system {}\n', 'is not plain data'),
        ('a: !mine 1\n', 'not valid YAML'),
        ('a: 1\n<<: {b: 2}\n', 'not valid YAML'),
        ('a: 1\n2: 3\n', "line 2: expected a name, not '2'"),
        ('a: 1\n---\nb: 2\n', 'not valid YAML'),
        ('a: [1\n', 'not valid YAML'),
        ('a:\t1\n', 'not valid YAML'),
        ('a: 2026-99-99\n', 'not valid YAML'),
        ('[' * 5000, 'not valid YAML'),
        ('#' * (MAX_YAML_BYTES + 1), 'too large for a file of options'),
    ],
)
def test_what_is_more_than_plain_data_is_refused(tmp_path, text, problem):
    path = tmp_path / 'options.yaml'
    path.write_text(text)
    with pytest.raises(ReadError) as caught:
        load_yaml(path)
    assert problem in str(caught.value)
    assert str(caught.value).startswith(f'{path}: ')
    assert '\n' not in str(caught.value)


def test_each_key_knows_its_line(tmp_path):
    path = tmp_path / 'options.yaml'
    path.write_text('\n# a comment\na:\n  b: 1\n\n  c: [2]\n')
    section = load_yaml(path).section('a')
    assert section.places == {'b': 'line 4', 'c': 'line 6'}
    assert str(section.error('c', 'odd')) == f'{path}: line 6: odd'
    assert str(section.error('d', 'lacks')) == f'{path}: line 3: lacks'


def test_a_given_place_stands_for_the_line(tmp_path):
    with pytest.raises(ReadError, match="--set 'a': aliases"):
        parse_yaml('[&x 1, *x]', tmp_path, "--set 'a'")


@pytest.mark.parametrize('separator', ['', '---\n', '\n---\n'])
def test_the_first_line_of_opencv_is_skipped(tmp_path, separator):
    path = tmp_path / 'camera.yaml'
    path.write_text(f'%YAML:1.0\n{separator}a: 1\nb: 2\n')
    section = load_yaml(path)
    assert section == {'a': 1, 'b': 2}
    assert section.places['b'] == f'line {3 + separator.count(chr(10))}'


def test_what_is_not_a_mapping_is_refused(tmp_path):
    path = tmp_path / 'options.yaml'
    path.write_text('[1]')
    with pytest.raises(ConfigError, match='expected a calibration, a mapping of names to values'):
        load_yaml(path, 'a calibration')
    path.write_text('')
    assert load_yaml(path) == {}


def test_what_is_not_text_is_refused(tmp_path):
    path = tmp_path / 'options.yaml'
    path.write_bytes(b'a: \xff')
    with pytest.raises(ReadError, match='not valid YAML'):
        load_yaml(path)
    with pytest.raises(ReadError, match='No such file'):
        load_yaml(tmp_path / 'none.yaml')
