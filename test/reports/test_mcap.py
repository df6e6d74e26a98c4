"""The MCAP report is a whole, standard recording, and has the numbers of the result."""

from collections import defaultdict
import dataclasses
import io
import json
import math
from pathlib import Path
import re

from mcap.reader import make_reader, NonSeekingReader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.metrics import position_errors, rotation_errors
from vio_eval_ros.core.series import running_series
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.recordings.sources import read_sources, Source
from vio_eval_ros.reports.documents import json_report
from vio_eval_ros.reports.mcap import mcap_report
from vio_eval_ros.reports.tables import aligned
from vio_eval_ros.simulation import simulate

NODE = '/vio_evaluator'
CONFIG = EvaluationConfig(alignment='sim3', rpe_deltas=('1s', '0.5s'))
FLIGHT = simulate(duration_s=10.0)


def source(name: str, poses: Poses) -> Source:
    return Source(name, 'tum', (), poses)


def scored(estimate: Poses, truth: Poses, config: EvaluationConfig = CONFIG) -> Result:
    """Return the result of two streams, with its series."""
    result = score_run(source('est', estimate), source('gt', truth), config)
    return dataclasses.replace(result, series=list(running_series(config, estimate, truth)))


def without_rotations(poses: Poses) -> Poses:
    return Poses(poses.stamps_ns, poses.positions)


def later(poses: Poses, seconds: float) -> Poses:
    return dataclasses.replace(poses, stamps_ns=poses.stamps_ns + round(seconds * 1e9))


@pytest.fixture(scope='module')
def result() -> Result:
    return scored(FLIGHT.estimate, FLIGHT.ground_truth)


@pytest.fixture(scope='module')
def report(result) -> bytes:
    return mcap_report(result)


@pytest.fixture(scope='module')
def recording(report, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp('mcap') / 'run.mcap'
    path.write_bytes(report)
    return path


def read(report: bytes) -> dict[str, list]:
    """Return log time and message of each topic, decoded by the schemas in the file alone."""
    found, stores = defaultdict(list), {}
    reader = make_reader(io.BytesIO(report), validate_crcs=True)
    for schema, channel, message in reader.iter_messages():
        if schema.id not in stores:
            stores[schema.id] = get_typestore(Stores.EMPTY)
            stores[schema.id].register(get_types_from_msg(schema.data.decode(), schema.name))
        decoded = stores[schema.id].deserialize_cdr(message.data, schema.name)
        found[channel.topic].append((message.log_time, decoded))
    return found


@pytest.fixture(scope='module')
def messages(report) -> dict[str, list]:
    return read(report)


def stamp_ns(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def columns(poses) -> np.ndarray:
    parts = [(pose.pose.position, pose.pose.orientation) for pose in poses]
    return np.array([[p.x, p.y, p.z, q.x, q.y, q.z, q.w] for p, q in parts])


def test_the_file_is_what_the_specification_asks_for(report):
    reader = make_reader(io.BytesIO(report), validate_crcs=True)
    header, summary = reader.get_header(), reader.get_summary()
    assert (header.profile, header.library.split()[0]) == ('ros2', 'vio_eval_ros')
    assert {schema.encoding for schema in summary.schemas.values()} == {'ros2msg'}
    assert {channel.message_encoding for channel in summary.channels.values()} == {'cdr'}
    assert {s.name for s in summary.schemas.values()} == {
        'geometry_msgs/msg/PoseStamped',
        'nav_msgs/msg/Path',
        'std_msgs/msg/Float64',
        'std_msgs/msg/String',
        'visualization_msgs/msg/MarkerArray',
    }
    topics = [channel.topic for channel in summary.channels.values()]
    assert len(set(topics)) == len(topics)
    for topic in topics:  # ROS allows no other characters in a name
        assert topic.startswith(f'{NODE}/')
        assert topic.replace('/', '').replace('_', '').isalnum()
    listed = list(NonSeekingReader(io.BytesIO(report), validate_crcs=True).iter_messages())
    assert summary.statistics.message_count == len(listed)
    assert summary.statistics.channel_count == len(topics)
    times = [message.log_time for _, _, message in listed]
    assert summary.statistics.message_start_time == min(times)
    assert summary.statistics.message_end_time == max(times)


def test_messages_are_in_order_and_every_chunk_is_indexed(report):
    # front to back, as they lie in the file
    reader = NonSeekingReader(io.BytesIO(report), validate_crcs=True)
    times = [m.log_time for _, _, m in reader.iter_messages(log_time_order=False)]
    assert times == sorted(times)
    chunks = [
        record
        for record in StreamReader(
            io.BytesIO(report), emit_chunks=True, validate_crcs=True
        ).records
        if isinstance(record, Chunk)
    ]
    summary = make_reader(io.BytesIO(report)).get_summary()
    assert len(chunks) == len(summary.chunk_indexes) > 0
    for chunk, index in zip(chunks, summary.chunk_indexes, strict=True):
        assert chunk.uncompressed_crc
        assert chunk.message_start_time == index.message_start_time


def test_a_damaged_file_is_noticed(report):
    damaged = bytearray(report)
    damaged[len(damaged) // 2] ^= 1
    with pytest.raises(Exception, match=r'CRC|crc|[Cc]orrupt|decompress'):
        read(bytes(damaged))


def test_the_errors_of_every_pair_are_logged_at_their_stamps(result, messages):
    pairs, alignment = result.summary.pairs, result.summary.alignment
    for name, errors in (
        ('position_m', position_errors(pairs, alignment)),
        ('rotation_deg', rotation_errors(pairs, alignment)),
    ):
        logged = messages[f'{NODE}/error/{name}']
        assert [time for time, _ in logged] == pairs.estimate.stamps_ns.tolist()
        assert [message.data for _, message in logged] == errors.tolist()
    rmse = math.sqrt(np.mean([m.data**2 for _, m in messages[f'{NODE}/error/position_m']]))
    assert rmse == pytest.approx(result.summary.metrics['ate_trans_rmse_m'], rel=1e-12)


def test_the_trajectories_are_logged_pose_by_pose_and_as_whole_paths(result, messages):
    truth = result.summary.pairs.ground_truth
    for name, path, trajectory in (
        ('estimate_aligned_pose', 'estimate_aligned', aligned(result)),
        ('ground_truth_pose', 'ground_truth_path', truth),
    ):
        logged = messages[f'{NODE}/{name}']
        expected = np.hstack([trajectory.positions, trajectory.rotations])
        stamps = trajectory.stamps_ns.tolist()
        assert [time for time, _ in logged] == stamps
        assert [stamp_ns(message) for _, message in logged] == stamps
        assert np.array_equal(columns([message for _, message in logged]), expected)
        (first, whole), (last, again) = messages[f'{NODE}/{path}']
        assert first <= stamps[0]
        assert last >= stamps[-1]
        assert [stamp_ns(pose) for pose in whole.poses] == stamps
        assert np.array_equal(columns(whole.poses), expected)
        assert np.array_equal(columns(again.poses), expected)
        assert whole.header.frame_id == whole.poses[0].header.frame_id == 'world'


def test_running_values_are_those_of_the_series_and_end_with_the_result(result, messages):
    for name in ('ate_trans_rmse_m', 'rpe_0.5s_rot_rmse_deg', 'pairs', 'sim3_scale'):
        logged = messages[f'{NODE}/metrics/{name.replace(".", "_")}']
        expected = [
            (time, values[name]) for time, values in result.series if not math.isnan(values[name])
        ]
        assert [(time, message.data) for time, message in logged] == expected
        assert len(expected) > 5
    last = messages[f'{NODE}/metrics/ate_trans_rmse_m'][-1][1].data
    assert last == result.summary.metrics['ate_trans_rmse_m']


def test_what_is_unknown_has_no_message(result, messages):
    first = result.series[0][1]
    assert math.isnan(first['rpe_1s_trans_rmse_m'])  # the first second has no two such poses
    assert len(messages[f'{NODE}/metrics/rpe_1s_trans_rmse_m']) == len(result.series) - 1
    numbers = [topic for topic in messages if '/metrics/' in topic or '/error/' in topic]
    assert len(numbers) > 20
    assert not any(math.isnan(m.data) for topic in numbers for _, m in messages[topic])


def test_markers_are_green_where_the_error_is_small_and_red_where_it_is_large(result, messages):
    ((time, array),) = messages[f'{NODE}/error_markers']
    (marker,) = array.markers
    assert time == min(log_time for logged in messages.values() for log_time, _ in logged)
    assert marker.type == marker.LINE_STRIP
    assert marker.pose.orientation.w == 1
    errors = position_errors(result.summary.pairs, result.summary.alignment)
    assert len(marker.points) == len(marker.colors) == len(errors)
    points = np.array([[p.x, p.y, p.z] for p in marker.points])
    assert np.array_equal(points, aligned(result).positions)
    best, worst = marker.colors[errors.argmin()], marker.colors[errors.argmax()]
    assert (worst.r, worst.g, worst.a) == (1, 0, 1)
    assert best.g > 0.9 > 0.1 > best.r


def test_the_result_is_in_the_recording(result, messages):
    ((time, message),) = messages[f'{NODE}/result']
    assert json.loads(message.data) == json.loads(json_report(result))
    assert time == max(log_time for logged in messages.values() for log_time, _ in logged)


def test_rosbags_reads_it_too(recording, result):
    with AnyReader([recording], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        wanted = [c for c in reader.connections if c.topic == f'{NODE}/error/position_m']
        logged = [
            (time, reader.deserialize(raw, connection.msgtype).data)
            for connection, time, raw in reader.messages(wanted)
        ]
    pairs, alignment = result.summary.pairs, result.summary.alignment
    errors = position_errors(pairs, alignment).tolist()
    assert logged == list(zip(pairs.estimate.stamps_ns.tolist(), errors, strict=True))
    assert counts[f'{NODE}/ground_truth_path'] == 2


@pytest.mark.parametrize(
    ('estimate', 'truth'),
    [
        ('estimate_aligned_pose', 'ground_truth_pose'),
        ('estimate_aligned', 'ground_truth_path'),
    ],
)
def test_the_recording_is_scored_as_the_run_was(recording, result, estimate, truth):
    sources = read_sources([f'{NODE}/{estimate}', f'{NODE}/{truth}'], recording)
    again = score_run(*sources, EvaluationConfig(alignment='none', rpe_deltas=('1s',)))
    assert len(again.summary.pairs) == len(result.summary.pairs)
    for name in ('ate_trans_rmse_m', 'ate_trans_max_m', 'ate_rot_rmse_deg', 'rpe_1s_rot_rmse_deg'):
        # the alignment was applied before the errors were taken, not with them
        assert again.summary.metrics[name] == pytest.approx(
            result.summary.metrics[name], rel=1e-9
        ), name


def test_positions_alone_are_logged_as_points_and_not_with_made_up_orientations(tmp_path):
    result = scored(FLIGHT.estimate, without_rotations(FLIGHT.ground_truth))
    messages = read(mcap_report(result))
    assert f'{NODE}/ground_truth_pose' not in messages
    assert f'{NODE}/error/rotation_deg' not in messages
    assert f'{NODE}/metrics/ate_rot_rmse_deg' not in messages
    points = np.array(
        [[m.point.x, m.point.y, m.point.z] for _, m in messages[f'{NODE}/ground_truth_point']]
    )
    assert np.array_equal(points, result.summary.pairs.ground_truth.positions)
    assert messages[f'{NODE}/ground_truth_path'][0][1].poses[0].pose.orientation.w == 1
    (tmp_path / 'run.mcap').write_bytes(mcap_report(result))
    sources = read_sources(
        [f'{NODE}/estimate_aligned_pose', f'{NODE}/ground_truth_point'], tmp_path / 'run.mcap'
    )
    again = score_run(*sources, EvaluationConfig(alignment='none'))
    assert math.isnan(again.summary.metrics['ate_rot_rmse_deg'])
    assert again.summary.metrics['ate_trans_rmse_m'] == pytest.approx(
        result.summary.metrics['ate_trans_rmse_m'], rel=1e-9
    )


def test_all_is_on_the_clock_of_the_ground_truth():
    config = dataclasses.replace(CONFIG, time_offset_s=-100.0)
    shifted = scored(later(FLIGHT.estimate, 100), FLIGHT.ground_truth, config)
    plain = read(mcap_report(scored(FLIGHT.estimate, FLIGHT.ground_truth)))
    for topic, logged in read(mcap_report(shifted)).items():
        assert [time for time, _ in logged] == [time for time, _ in plain[topic]], topic


def test_it_is_the_same_when_made_twice(result, report):
    assert mcap_report(result) == report


def test_the_layout_of_the_live_node_shows_it(messages):
    layout = (Path(__file__).resolve().parents[2] / 'config/foxglove.json').read_text()
    shown = set(re.findall(rf'"({NODE}/[a-z_/]+?)(?:\.data)?"', layout))
    live = {topic for topic in shown if '/window/' in topic}
    assert len(shown - live) >= 4
    assert shown - live <= set(messages)


def test_a_result_without_a_series_has_all_but_running_values(result, messages):
    topics = set(read(mcap_report(dataclasses.replace(result, series=()))))
    assert topics == {topic for topic in messages if '/metrics/' not in topic}


@pytest.mark.parametrize('seconds', [-2_000_000_000, 1_000_000_000])
def test_stamps_that_ros_cannot_hold_are_refused(seconds):
    streams = later(FLIGHT.estimate, seconds), later(FLIGHT.ground_truth, seconds)
    with pytest.raises(ConfigError, match='from 1970 to 2038 only; use a csv report'):
        mcap_report(scored(*streams))


def test_an_alignment_that_is_not_determined_is_refused():
    flight = without_rotations(FLIGHT.estimate)
    result = scored(flight, FLIGHT.ground_truth, EvaluationConfig(alignment='origin'))
    with pytest.raises(ConfigError, match='there is no aligned trajectory'):
        mcap_report(result)
