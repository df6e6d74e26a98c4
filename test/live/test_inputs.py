"""How parameters name the streams of the evaluator."""

import pytest

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.inputs import estimates_of, ground_truth_of, InputName
from vio_eval_ros.live.options import NodeConfig


def test_without_parameters_there_are_two_topics_to_be_remapped():
    settings = NodeConfig()
    assert estimates_of(settings) == [InputName('estimate')]
    assert ground_truth_of(settings) == InputName('ground_truth')


@pytest.mark.parametrize(
    ('given', 'meant'),
    [
        ({'estimate': '/odom'}, InputName('/odom')),
        ({'estimate': '/tf:map.base_link'}, InputName('/tf', 'map.base_link')),
        ({'estimate': '/robot1/tf:odom.base'}, InputName('/robot1/tf', 'odom.base')),
        ({'estimate_frames': ('/map', 'base_link')}, InputName('/tf', 'map.base_link')),
    ],
)
def test_a_stream_is_a_topic_or_two_frames(given, meant):
    assert estimates_of(NodeConfig(**given)) == [meant]
    as_truth = {name.replace('estimate', 'ground_truth'): value for name, value in given.items()}
    assert ground_truth_of(NodeConfig(**as_truth)) == meant


def test_several_estimates_have_names():
    found = estimates_of(NodeConfig(estimates=('vins:=/vio/odometry', 'x:=/tf:map.base')))
    assert found == [
        InputName('/vio/odometry', label='vins'),
        InputName('/tf', 'map.base', label='x'),
    ]


@pytest.mark.parametrize(
    ('given', 'why'),
    [
        ({'estimate': '/tf:map'}, "estimate: '/tf:map': write a topic, or /tf:PARENT.CHILD"),
        ({'estimate': ':map.b'}, "estimate: ':map.b': write a topic"),
        ({'estimate_frames': ('map',)}, 'estimate_frames: expected two frames'),
        ({'estimate_frames': ('map', '')}, 'estimate_frames: expected two frames'),
        ({'estimate': '/a', 'estimate_frames': ('m', 'b')}, 'estimate_frames: set it or estimate'),
        ({'estimates': ('/a',)}, "estimates: '/a': write NAME:=TOPIC"),
        ({'estimates': ('a b:=/a',)}, "estimates: 'a b:=/a': write NAME:=TOPIC"),
        ({'estimates': ('a:=',)}, "estimates: '': write a topic"),
        ({'estimates': ('a:=/x', 'a:=/y')}, 'estimates: a is there twice'),
        ({'estimates': ('a:=/x', 'b:=/x')}, 'estimates: /x is there twice'),
        ({'estimates': ('a:=/tf:m.b', 'b:=/tf:m.b')}, 'estimates: /tf:m.b is there twice'),
        ({'estimates': ('a:=/x',), 'estimate': '/y'}, 'estimates: it takes the place of estimate'),
    ],
)
def test_what_makes_no_sense_is_refused(given, why):
    with pytest.raises(ConfigError) as caught:
        estimates_of(NodeConfig(**given))
    assert str(caught.value).startswith(why)
