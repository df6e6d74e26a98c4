"""What all figures share."""

import numpy as np
import pytest

from vio_eval_ros.rendering.figures import extremes, label, line_layout, numbers, shortened


def test_extremes_keep_the_outline_of_a_curve():
    values = np.sin(np.linspace(0, 20, 5000))
    values[[1234, 4321]] = 9.0, -9.0
    chosen = extremes(values, 100)
    assert len(chosen) <= 100
    assert (np.diff(chosen) > 0).all()
    assert {1234, 4321} <= set(chosen.tolist())


@pytest.mark.parametrize('count', [0, 1, 100])
def test_extremes_of_few_values_are_all_of_them(count):
    assert extremes(np.zeros(count), 100).tolist() == list(range(count))


def test_a_long_name_is_cut_where_it_says_least():
    assert shortened('abcdef', 6) == 'abcdef'
    assert shortened('abcdefg', 6) == 'abcde…'
    assert shortened('abcdefg', 6, keep_end=True) == '…cdefg'


def test_a_line_for_each_name_has_room_for_the_longest_and_no_markup():
    layout = line_layout(['<b>', 'a name'], xaxis={'title': 'x'})
    assert layout['yaxis']['ticktext'] == ['&lt;b&gt;', 'a name']
    assert layout['yaxis']['range'] == [1.6, -0.6]
    assert layout['margin']['l'] > line_layout(['<b>'])['margin']['l']
    assert layout['xaxis'] == {'title': 'x'}
    assert label('a\x1b<a href="x">') == 'a?&lt;a href=&quot;x&quot;&gt;'


def test_numbers_are_finite_and_rounded_to_their_range():
    values = np.array([0.0, np.nan, 1e5, np.inf, 12.3456789])
    assert numbers(values) == [0, None, 1e5, None, 12]
    assert numbers(values[[0, 4]]) == [0, 12.3457]
