"""What RViz and Foxglove are told to show is what the node publishes."""

from collections.abc import Iterator
import importlib.util
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest
import yaml

from ros_domain import private_domain
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names

ROOT = Path(__file__).resolve().parents[1]
RVIZ = yaml.safe_load((ROOT / 'config' / 'vio_eval_ros.rviz').read_text())
FOXGLOVE = json.loads((ROOT / 'config' / 'foxglove.json').read_text())
DISPLAYS = {
    'rviz_default_plugins/Path': 'nav_msgs/msg/Path',
    'rviz_default_plugins/MarkerArray': 'visualization_msgs/msg/MarkerArray',
}
PATHS_AND_ERRORS = {
    '/vio_evaluator/ground_truth_path': 'nav_msgs/msg/Path',
    '/vio_evaluator/estimate_aligned': 'nav_msgs/msg/Path',
    '/vio_evaluator/error_markers': 'visualization_msgs/msg/MarkerArray',
}
LIMIT_S = 30

# prints what the node publishes when all that is expected is there, or a time has passed
LISTING = """
import json, sys, time, rclpy
from rclpy.node import NodeNameNonExistentError
rclpy.init()
node, found, end_s = rclpy.create_node('listing'), {}, time.monotonic() + 15
while not set(sys.argv[1:]) <= found.keys() and time.monotonic() < end_s:
    rclpy.spin_once(node, timeout_sec=0.1)
    try:
        found = dict(node.get_publisher_names_and_types_by_node('vio_evaluator', '/'))
    except NodeNameNonExistentError:
        pass
print(json.dumps(found))
"""


def rviz_topics() -> dict[str, str]:
    """Return the topics that RViz shows and the types that its displays take."""
    displays = RVIZ['Visualization Manager']['Displays']
    return {
        display['Topic']['Value']: DISPLAYS[display['Class']]
        for display in displays
        if 'Topic' in display
    }


def plotted() -> list[str]:
    """Return the names below ~/ of what Foxglove plots."""
    values = [
        path['value']
        for name, panel in FOXGLOVE['configById'].items()
        if name.startswith('Plot!')
        for path in panel['paths']
    ]
    matches = [re.fullmatch(r'/vio_evaluator/((?:metrics|window)/\w+)\.data', v) for v in values]
    assert all(matches), values
    return [match[1] for match in matches]


def foxglove_topics() -> dict[str, str]:
    """Return the topics that Foxglove shows and the types that its panels take."""
    topics = {f'/vio_evaluator/{name}': 'std_msgs/msg/Float64' for name in plotted()}
    for panel in FOXGLOVE['configById'].values():
        topics |= {topic: PATHS_AND_ERRORS[topic] for topic in panel.get('topics', {})}
        if 'topicToRender' in panel:
            topics[panel['topicToRender']] = 'diagnostic_msgs/msg/DiagnosticArray'
    return topics


def panels(node: str | dict) -> Iterator[str]:
    """Yield the names of the panels in a layout, from the first to the last."""
    if isinstance(node, str):
        yield node
        return
    assert node['direction'] in ('row', 'column')
    for side in ('first', 'second'):
        yield from panels(node[side])


def test_rviz_shows_both_paths_and_the_errors():
    assert rviz_topics() == PATHS_AND_ERRORS
    for display in RVIZ['Visualization Manager']['Displays']:
        assert display['Enabled']
        if 'Topic' in display:  # latched, so that RViz may start at any time
            assert display['Topic']['Durability Policy'] == 'Transient Local'
            assert display['Topic']['Reliability Policy'] == 'Reliable'


def test_foxglove_shows_paths_errors_running_metrics_and_diagnostics():
    topics = foxglove_topics()
    assert topics.items() >= PATHS_AND_ERRORS.items()
    assert '/diagnostics' in topics
    assert {name.split('/')[0] for name in plotted()} == {'metrics', 'window'}


def test_every_panel_of_foxglove_is_placed_once():
    placed = list(panels(FOXGLOVE['layout']))
    assert sorted(placed) == sorted(FOXGLOVE['configById'])


def test_panels_are_titled_under_the_keys_that_foxglove_and_lichtblick_read():
    for name, panel in FOXGLOVE['configById'].items():
        assert 'title' not in panel
        if name.startswith('Plot!'):
            assert panel['foxglovePanelTitle'] == panel['lichtblickPanelTitle'] != ''


def test_every_plotted_metric_exists():
    known = metric_names(EvaluationConfig())
    assert {name.split('/')[1] for name in plotted()} <= set(known)


@pytest.fixture(scope='module')
def published() -> dict[str, list[str]]:
    """Return what a running evaluator publishes, with the types."""
    if not importlib.util.find_spec('rclpy'):
        pytest.skip('needs ROS 2: pip install ".[ros]"')
    with private_domain() as variables:
        environment = os.environ | variables
        evaluator = [sys.executable, '-m', 'vio_eval_ros', 'evaluator']
        process = subprocess.Popen(evaluator, env=environment, cwd=ROOT)
        try:
            expected = rviz_topics() | foxglove_topics()
            listing = [sys.executable, '-c', LISTING, *expected]
            done = subprocess.run(
                listing, env=environment, capture_output=True, check=True, timeout=LIMIT_S
            )
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(timeout=LIMIT_S)
    return json.loads(done.stdout)


@pytest.mark.parametrize('layout', [rviz_topics, foxglove_topics])
def test_every_topic_shown_is_published_with_the_type_that_is_shown(published, layout):
    for topic, msgtype in layout().items():
        assert published.get(topic) == [msgtype], topic
