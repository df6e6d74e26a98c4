"""Logs of PX4, written here as the ULog format has them."""

import struct

import numpy as np
import pytest

from recorded import numbers, odometry, STEP_NS, write
from verbs import complaint, document
from vio_eval_ros.core.rotation import multiply
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.sources import default_topics, read_sources

pytestmark = pytest.mark.needs('pyulog')

COUNT = 60
BOOT_US = 5_000_000
MOVING = np.array([numbers(k)[0] for k in range(COUNT)])
TURNING = np.array([numbers(k)[1] for k in range(COUNT)])
STAMPS = [BOOT_US * 1000 + k * STEP_NS for k in range(COUNT)]
TOPICS = {
    'vehicle_odometry': (
        'uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q;'
        'uint8_t pose_frame;',
        '<QQ3f4fB',
    ),
    'vehicle_local_position': (
        'uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;bool xy_valid;'
        'bool z_valid;',
        '<QQ3f??',
    ),
    'vehicle_global_position': ('uint64_t timestamp;double lat;double lon;float alt;', '<Qddf'),
    'battery_status': ('uint64_t timestamp;float voltage_v;', '<Qf'),
}


def microseconds(k):
    return BOOT_US + k * STEP_NS // 1000


def odometry_row(k, latency_us=300):
    (x, y, z), up = numbers(k)
    half = np.sqrt(0.5)
    down = multiply(multiply(np.array([half, half, 0, 0]), up), np.array([1.0, 0, 0, 0]))
    us = microseconds(k)
    return us + latency_us, us, y, x, -z, down[3], *down[:3], 1


def local_row(k, valid=True):
    x, y, z = numbers(k)[0]
    return microseconds(k) + 300, microseconds(k), y, x, -z, valid, True


def write_log(path, *streams):
    """Write (name, instance, rows) of TOPICS."""

    def message(kind, content):
        return struct.pack('<HB', len(content), ord(kind)) + content

    parts = [b'ULog\x01\x12\x35\x01' + struct.pack('<Q', BOOT_US), message('B', bytes(40))]
    for name in dict.fromkeys(name for name, _, _ in streams):
        parts.append(message('F', f'{name}:{TOPICS[name][0]}'.encode()))
    for number, (name, instance, _) in enumerate(streams):
        parts.append(message('A', struct.pack('<BH', instance, number) + name.encode()))
    for number, (name, _, rows) in enumerate(streams):
        for row in rows:
            data = struct.pack(TOPICS[name][1], *row)
            parts.append(message('D', struct.pack('<H', number) + data))
    path.write_bytes(b''.join(parts))
    return path


@pytest.fixture
def log(tmp_path):
    return write_log(
        tmp_path / 'flight.ulg',
        ('vehicle_odometry', 0, [odometry_row(k) for k in range(COUNT)]),
        ('vehicle_local_position', 0, [local_row(k, k >= 10) for k in range(COUNT)]),
        ('battery_status', 0, [(BOOT_US, 16.2)]),
    )


def assert_moving(source):
    assert source.kind == 'ulog'
    assert source.stamps_ns.tolist() == STAMPS
    np.testing.assert_allclose(source.positions, MOVING, atol=1e-6)  # float32
    aligned = source.rotations * np.sign((source.rotations * TURNING).sum(axis=1))[:, None]
    np.testing.assert_allclose(aligned, TURNING, atol=1e-6)


def test_odometry_of_a_log_is_turned_upright(log):
    (source,) = read_sources([f'{log}:/vehicle_odometry'])
    assert_moving(source)
    assert 'turned to east, north, up and forward, left, up' in source.warnings[0]
    assert 'count from the boot of the autopilot' in source.warnings[1]


def test_a_log_is_a_recording_of_topics(log):
    first, second = read_sources(['/vehicle_odometry', '/vehicle_local_position'], log)
    assert_moving(first)
    assert second.rotations is None
    assert np.isnan(second.positions[:10]).all()
    found = document(
        'replay',
        log,
        *('--estimate', '/vehicle_odometry', '--ground-truth', '/vehicle_local_position'),
    )
    assert found['association']['pairs'] == 50
    assert found['inputs']['ground_truth']['dropped']['non_finite'] == 10
    assert found['metrics']['ate_trans_rmse_m'] < 1e-5


def test_the_time_of_logging_may_count_instead(log):
    (source,) = read_sources(['/vehicle_odometry?stamps=recorded'], log)
    assert source.stamps_ns.tolist() == [stamp + 300_000 for stamp in STAMPS]


def test_a_clock_from_boot_is_told_apart_from_others_by_diagnosis(log, tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry())
    given = (
        *('--estimate', f'{path}:/vio/odometry'),
        *('--ground-truth', f'{log}:/vehicle_odometry'),
    )
    assert 'ground truth 5.0 to 8.0 s' in complaint('replay', *given)


def test_positions_on_the_earth_are_projected(tmp_path):
    from pymap3d import enu2geodetic

    places = np.column_stack(enu2geodetic(*MOVING.T, 47.4, 8.55, 500.0)).tolist()
    rows = [(microseconds(k), *place) for k, place in enumerate(places)]
    path = write_log(tmp_path / 'flight.ulg', ('vehicle_global_position', 0, rows))
    (source,) = read_sources(['/vehicle_global_position'], path)
    assert source.stamps_ns.tolist() == STAMPS
    moved = source.positions - source.positions[0]
    np.testing.assert_allclose(moved[:, :2], (MOVING - MOVING[0])[:, :2], atol=1e-5)
    np.testing.assert_allclose(moved[:, 2], (MOVING - MOVING[0])[:, 2], atol=1e-4)  # float32


def test_several_instances_are_chosen_by_number(tmp_path):
    rows = [odometry_row(k) for k in range(COUNT)]
    other = [(*row[:2], 0, 0, *row[4:]) for row in rows]
    path = write_log(
        tmp_path / 'flight.ulg', ('vehicle_odometry', 0, other), ('vehicle_odometry', 1, rows)
    )
    assert_moving(read_sources(['/vehicle_odometry[1]'], path)[0])
    with pytest.raises(ReadError, match=r'poses: /vehicle_odometry\[0\] .*/vehicle_odometry\[1\]'):
        read_sources(['/vehicle_odometry'], path)


def test_the_only_instance_may_be_called_by_its_number(log):
    assert_moving(read_sources(['/vehicle_odometry[0]'], log)[0])


def test_unknown_topics_are_answered_with_those_there_are(log):
    with pytest.raises(ReadError) as refused:
        read_sources(['/battery_status'], log)
    assert '/vehicle_odometry (px4_msgs/msg/VehicleOdometry, 60)' in str(refused.value)
    with pytest.raises(ReadError, match='choose topics with --estimate and --ground-truth'):
        default_topics(log)
    assert 'name a topic in it' in complaint(
        'replay', '--estimate', log, '--ground-truth', 'gt.txt'
    )


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        (b'', 'does not begin like a log'),
        (b'ULog\x01\x12\x35', 'damaged'),
        (b'#ROSBAG V2.0\n' + bytes(100), 'does not begin like a log'),
    ],
)
def test_what_is_no_log_is_refused(tmp_path, content, words):
    path = tmp_path / 'flight.ulg'
    path.write_bytes(content)
    with pytest.raises(ReadError, match=words):
        read_sources(['/vehicle_odometry'], path)
    with pytest.raises(ReadError, match='no such file'):
        read_sources(['/vehicle_odometry'], tmp_path / 'missing.ulg')


def test_a_log_that_was_cut_short_is_read_as_far_as_it_goes(log):
    content = log.read_bytes()
    log.write_bytes(content[: len(content) // 2])
    (source,) = read_sources(['/vehicle_odometry'], log)
    assert 0 < len(source) < COUNT


@pytest.mark.parametrize('seed', range(5))
def test_damage_gives_no_traceback(log, seed):
    random = np.random.default_rng(seed)
    content = bytearray(log.read_bytes())
    for at in random.integers(16, len(content), 20):
        content[at] = random.integers(256)
    log.write_bytes(bytes(content))
    for spec in ('/vehicle_odometry', '/vehicle_local_position'):
        try:
            (source,) = read_sources([spec], log)
        except ReadError as error:
            assert str(error)  # noqa: PT017
        else:
            assert len(source) <= COUNT


def test_pyulog_that_is_not_installed_is_named(log, monkeypatch):
    monkeypatch.setitem(__import__('sys').modules, 'pyulog', None)
    with pytest.raises(ReadError, match=r"not read \(ULog\): pip install 'vio_eval_ros\[px4\]'"):
        read_sources(['/vehicle_odometry'], log)


def test_two_streams_of_one_name_are_refused(tmp_path):
    streams = [('vehicle_odometry', 0, [odometry_row(k) for k in range(COUNT)])] * 2
    log = write_log(tmp_path / 'flight.ulg', *streams)
    with pytest.raises(ReadError, match='two streams of the log have this name'):
        read_sources([f'{log}:/vehicle_odometry[0]'])
