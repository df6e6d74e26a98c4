"""Estimates and ground truths that are frames of a TF tree, live."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import json
import os
from pathlib import Path
import subprocess

import numpy as np
import pytest

from recorded import header, numbers, odometry, pose, Stream, vector, write
from verbs import call, COMMAND
from vio_eval_ros.recordings.playback import Playback

TF = 'tf2_msgs/msg/TFMessage'
TRUTH = '/ground_truth/pose'


@pytest.fixture
def fly(tf2_msgs, graph, evaluator, tmp_path):
    """Return a function that publishes a recording into an evaluator, and ends it."""

    def fly(recording: Path, *parameters: str, still: Sequence[str] = ()) -> None:
        with Playback(recording) as playback:
            known = {topic.name: topic.msgtype for topic in playback.topics}
            topics = {name: kind for name, kind in known.items() if name not in still}
            messages = list(playback.messages(set(topics), playback.first_ns, playback.last_ns))
        quality = [f'qos_overrides.{name}.subscription.reliability:=reliable' for name in topics]
        said = ' '.join(parameters).replace('_frames', '/tf')
        heard = [name for name in topics if name in said]
        heard += [f'{name}_static' for name in heard if f'{name}_static' in topics]
        node = evaluator(
            *parameters,
            f'report_dir:={tmp_path / "live"}',
            *[one for one in quality if any(f'.{name}.' in one for name in heard)],
            reliable=False,
        )
        publishers = {
            name: graph.publisher(name, topics[name], latched=name.endswith('_static'))
            for name in heard
        }
        sent = 0
        for _, name, cdr in messages:
            if name in publishers:
                publishers[name].publish(cdr)
                sent += 1
        graph.wait_until(lambda: node.messages == sent, 'all messages')
        node.stop()

    return fly


def assert_same(
    tmp_path: Path, recording: Path, estimate: str, truth: str, live: str = ''
) -> dict:
    """Check that the live result is that of `replay`, to the last bit; return it."""
    result = json.loads((tmp_path / 'live' / live / 'result.json').read_text())
    done = call('replay', recording, '--estimate', estimate, '--ground-truth', truth, '--json')
    assert done.returncode == 0, done.stderr
    offline = json.loads(done.stdout)
    for part in ('metrics', 'association', 'alignment'):
        assert result[part] == offline[part]
    assert result['association']['pairs'] > 50
    assert result['inputs']['estimate']['source'] == estimate
    return result


def test_a_recorded_tree_live_is_replay_to_the_last_bit(fly, shared_data, tmp_path):
    recording = shared_data / 'derived_bags' / 'euroc_V1_02_vins_fusion_mcap'
    fly(recording, 'estimate:=/tf:odom.imu', f'ground_truth:={TRUTH}')
    assert_same(tmp_path, recording, '/tf:odom.imu', TRUTH)


def test_a_robot_whose_localisation_corrects_its_odometry(fly, shared_data, tmp_path):
    recording = shared_data / 'derived_bags' / 'nav2_turtlebot_variants' / 'nav2_lz4.mcap'
    fly(
        recording,
        'estimate_frames:=[odom, imu_link]',
        'ground_truth:=/tf:map.imu_link',
    )
    result = assert_same(tmp_path, recording, '/tf:odom.imu_link', '/tf:map.imu_link')
    assert any('left out' in line for line in result['warnings'])


def edge(k: int, parent: str, child: str, position, turn=(0.0, 0.0, 0.0, 1.0)) -> Mapping:
    moved = {'translation': vector(position), 'rotation': vector(turn, 'xyzw')}
    return {'header': header(k, parent), 'child_frame_id': child, 'transform': moved}


def tree(tmp_path: Path, namespace: str = '', late: int = 20, slash: str = '') -> Path:
    """Return a recording of a SLAM: corrections that come late, odometry, a sensor, a truth."""
    messages, logged = [], []
    for k in range(200):
        position, turn = numbers(k)
        messages.append({'transforms': [edge(k, f'{slash}odom', f'{slash}base', position, turn)]})
        logged.append(header_ns(k) + 2_000_000)
        if k >= late and k % 5 == 0:
            corrected = [0.01 * (k // 40), 0.0, 0.0]
            messages.append({'transforms': [edge(k, f'{slash}map', f'{slash}odom', corrected)]})
            logged.append(header_ns(k) + 120_000_000)
    fixed = [{'transforms': [edge(0, f'{slash}base', f'{slash}imu', [0.1, 0.0, 0.05])]}]
    truth = [{'header': header(k), 'pose': pose(k)} for k in range(200)]
    return write(
        tmp_path / 'tree',
        'mcap',
        Stream(f'{namespace}/tf', TF, messages, logged_ns=logged),
        Stream(f'{namespace}/tf_static', TF, fixed),
        Stream(TRUTH, 'geometry_msgs/msg/PoseStamped', truth),
        odometry(200),
    )


def header_ns(k: int) -> int:
    stamp = header(k)['stamp']
    return stamp['sec'] * 10**9 + stamp['nanosec']


@pytest.mark.parametrize(
    ('namespace', 'late', 'slash'), [('', 20, ''), ('/robot1', 0, '/'), ('', 120, '/')]
)
def test_chains_live_are_those_of_replay(fly, tmp_path, namespace, late, slash):
    recording = tree(tmp_path, namespace, late, slash)
    frames = f'{namespace}/tf:map.imu'
    fly(recording, f'estimate:={frames}', f'ground_truth:={TRUTH}')
    assert_same(tmp_path, recording, frames, TRUTH)


def test_several_estimates_of_one_tree_and_a_topic(fly, tmp_path):
    recording = tree(tmp_path)
    fly(
        recording,
        "estimates:=['slam:=/tf:map.imu', 'odom:=/tf:odom.imu', 'vio:=/vio/odometry']",
        f'ground_truth:={TRUTH}',
    )
    for name, source in (
        ('slam', '/tf:map.imu'),
        ('odom', '/tf:odom.imu'),
        ('vio', '/vio/odometry'),
    ):
        assert_same(tmp_path, recording, source, TRUTH, live=name)


def test_frames_as_a_truth_of_a_topic(fly, tmp_path):
    recording = tree(tmp_path)
    fly(recording, 'estimate:=/vio/odometry', 'ground_truth_frames:=[map, imu]')
    assert_same(tmp_path, recording, '/vio/odometry', '/tf:map.imu')


def test_a_frame_that_is_not_there_is_named_with_the_nearest(tf2_msgs, graph, evaluator, tmp_path):
    evaluator('estimate:=/tf:map.imuu', f'ground_truth:={TRUTH}', reliable=False)
    with Playback(tree(tmp_path)) as playback:
        messages = list(playback.messages({'/tf'}, playback.first_ns, playback.last_ns))
    publisher = graph.publisher('/tf', TF)
    for _, _, cdr in messages:
        publisher.publish(cdr)
    graph.wait_for('association', 'any', "there is no frame 'imuu'")


def test_time_that_jumps_back_begins_another_run(tf2_msgs, graph, evaluator, tmp_path, short_lag):
    recording = tree(tmp_path)
    node = evaluator(
        'estimate:=/tf:odom.imu',
        f'ground_truth:={TRUTH}',
        f'report_dir:={tmp_path / "live"}',
        *(f'qos_overrides.{n}.subscription.reliability:=reliable' for n in ('/tf', TRUTH)),
        reliable=False,
    )
    topics = {'/tf': TF, '/tf_static': TF, TRUTH: 'geometry_msgs/msg/PoseStamped'}
    publishers = {
        name: graph.publisher(name, kind, latched=name == '/tf_static')
        for name, kind in topics.items()
    }
    sent = 0
    for _ in range(2):
        with Playback(recording) as playback:
            for _, name, cdr in playback.messages(
                set(topics), playback.first_ns, playback.last_ns
            ):
                publishers[name].publish(cdr)
                sent += 1
        graph.wait_until(lambda: node.messages == sent, 'all messages')  # noqa: B023
    node.stop()
    runs = [tmp_path / 'live' / f'run_{k:04d}' / 'result.json' for k in (1, 2)]
    one, other = (json.loads(file.read_text()) for file in runs)
    assert one['association']['pairs'] == other['association']['pairs'] == 200
    assert one['metrics'] == other['metrics']
    assert np.isfinite(one['metrics']['ate_trans_rmse_m'])


def test_without_the_message_package_it_is_one_line(evaluator, monkeypatch):
    import sys

    from vio_eval_ros.errors import ConfigError

    monkeypatch.setitem(sys.modules, 'tf2_msgs', None)
    monkeypatch.setitem(sys.modules, 'tf2_msgs.msg', None)
    with pytest.raises(ConfigError, match='/tf: tf2_msgs/msg/TFMessage needs the ROS package tf2'):
        evaluator('estimate:=/tf:map.imu')


def test_the_alignment_is_a_transform_that_no_input_reads(tf2_msgs, graph, evaluator, tmp_path):
    recording, topics = tree(tmp_path, late=1000), ('/tf', '/tf_static', TRUTH)
    node = evaluator(
        'estimate:=/tf:odom.imu',
        f'ground_truth:={TRUTH}',
        'publish_tf:=true',
        f'report_dir:={tmp_path / "live"}',
        *(f'qos_overrides.{n}.subscription.reliability:=reliable' for n in ('/tf', TRUTH)),
        reliable=False,
    )
    published = graph.listen('/tf', TF)
    kinds = (TF, TF, 'geometry_msgs/msg/PoseStamped')
    publishers = {
        name: graph.publisher(name, kind, latched=name == '/tf_static')
        for name, kind in zip(topics, kinds, strict=True)
    }
    with Playback(recording) as playback:
        for _, name, cdr in playback.messages(set(topics), playback.first_ns, playback.last_ns):
            publishers[name].publish(cdr)
    graph.wait_for('association', 'any', pairs=181)  # the last second is not over

    def found():
        edges = [one for message in published for one in message.transforms]
        return [
            one for one in edges if (one.header.frame_id, one.child_frame_id) == ('map', 'odom')
        ]

    count = len(found())
    last = graph.wait_until(lambda: len(found()) > count + 1 and found()[-1], 'a transform')
    node.stop()
    alignment = json.loads((tmp_path / 'live' / 'result.json').read_text())['alignment']
    place, turn = last.transform.translation, last.transform.rotation
    translation = np.array([place.x, place.y, place.z])
    assert np.linalg.norm(translation) > 0.05
    np.testing.assert_allclose(translation, alignment['translation_m'], atol=0.02)
    rotation = [turn.x, turn.y, turn.z, turn.w]
    np.testing.assert_allclose(rotation, alignment['rotation_xyzw'], atol=0.01)
    assert_same(tmp_path, recording, '/tf:odom.imu', TRUTH)


def test_frames_of_one_name_have_no_transform(tf2_msgs, graph, ros, evaluator, flight):
    node = evaluator('publish_tf:=true')
    estimate, truth = graph.both()
    ros.send(estimate, flight.estimate)
    ros.send(truth, flight.ground_truth)
    graph.wait_for('association', 'OK', pairs=381)
    graph.wait_for('accuracy', 'OK')
    assert node.stop().count('publish_tf: estimate and ground truth are both in map') == 1


def test_transforms_that_nobody_asks_for_do_not_hold_up_a_recording(
    tf2_msgs, environment, graph, tmp_path
):
    paths = os.pathsep.join(filter(None, [tf2_msgs, environment['PYTHONPATH']]))
    process = subprocess.Popen(
        [*COMMAND, 'play', tree(tmp_path), '--rate', '20', '--wait-for-subscribers'],
        env={**os.environ, **environment, 'PYTHONPATH': paths},
        stderr=subprocess.PIPE,
        text=True,
    )
    arrived = graph.listen('/vio/odometry', 'nav_msgs/msg/Odometry')
    graph.listen(TRUTH, 'geometry_msgs/msg/PoseStamped')
    graph.wait_until(lambda: len(arrived) == 200, 'all messages')
    _, said = process.communicate(timeout=60)
    assert process.returncode == 0, said
    assert 'no subscribers of ' in said
    assert '/tf' in said.splitlines()[-1]
    assert 'not installed' not in said
