"""`inspect` as its users run it: arguments in, output and an exit status out."""

from collections.abc import Iterable, Sequence
import errno
from functools import partial
import json
from pathlib import Path
import shutil
import tempfile
from typing import Any
from unittest.mock import Mock

from mcap.reader import make_reader
from mcap.writer import Writer
import numpy as np
from PIL import Image
import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import yaml

import verbs
from verbs import start
from vio_eval_ros.cli import inspect as verb
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.recordings.recording import Recording

ROOT = Path(__file__).resolve().parents[2]
EUROC = ROOT / 'config' / 'euroc.yaml'
FIRST_NS, SECONDS = 1_403_636_579_763_555_584, 12
IMAGE, IMU = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/Imu'
TF = 'tf2_msgs/msg/TFMessage'
CAMERAS = ('/cam0/image_raw', '/cam1/image_raw')
inspect, complaint, document = (
    partial(how, 'inspect') for how in (verbs.call, verbs.complaint, verbs.document)
)
Timed = tuple[int, str, str, int, Any]  # recorded, topic, type, stamp, what it holds


def flight() -> list[Timed]:
    """Return what EuRoC's rig records: two cameras, an IMU with x up, and transport."""
    source, messages = np.random.default_rng(4), []
    for topic, msgtype, rate_hz in (*((t, IMAGE, 20) for t in CAMERAS), ('/imu0', IMU, 200)):
        count = rate_hz * SECONDS
        stamps_ns = FIRST_NS + np.arange(count) * (10**9 // rate_hz)
        delays_ns = 4_000_000 + source.exponential(1_000_000, count).astype(int)
        logged_ns = np.maximum.accumulate(stamps_ns + delays_ns)  # none overtakes another
        samples = [None] * count if msgtype == IMAGE else felt(count, source)
        columns = logged_ns.tolist(), stamps_ns.tolist(), samples
        messages += [(at, topic, msgtype, ns, one) for at, ns, one in zip(*columns, strict=True)]
    return messages


def felt(count: int, source: np.random.Generator) -> np.ndarray:
    """Return samples of an IMU that stands for two seconds and then is moved about."""
    waves = np.sin(np.arange(count)[:, None] / 40 + np.arange(6)) * np.repeat([0.5, 2.0], 3)
    waves[:400] = 0
    return waves + source.normal(0, 0.01, (count, 6)) + np.array([0, 0, 0, 9.81, 0, 0])


def message_of(types: Any, msgtype: str, stamp_ns: int, content: Any) -> Any:
    time, header = types['builtin_interfaces/msg/Time'], types['std_msgs/msg/Header']
    head = (time(*divmod(stamp_ns or 0, 10**9)), 'frame')
    head = header(7, *head) if 'seq' in header.__dataclass_fields__ else header(*head)
    if msgtype == IMAGE:
        return types[IMAGE](head, 3, 4, 'mono8', 0, 4, np.arange(12, dtype=np.uint8))
    if msgtype == TF:
        store = types['geometry_msgs/msg/TransformStamped'], types['geometry_msgs/msg/Transform']
        vector, turn = (types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Quaternion'))
        still = store[1](vector(0.0, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
        return types[TF]([] if stamp_ns is None else [store[0](head, 'child', still)] * 2)
    vector, none = types['geometry_msgs/msg/Vector3'], np.zeros(9)
    level = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    # a sensor that is not there is NaN here, and in the message zero
    rates, forces = (vector(*np.nan_to_num(part)) for part in (content[:3], content[3:]))
    known = [none - bool(np.isnan(part).any()) for part in (content[:3], content[3:])]
    return types[IMU](head, level, none, rates, known[0], forces, known[1])


def record(path: Path, messages: Iterable[Timed], empty: Sequence[tuple[str, str]] = ()) -> Path:
    """Write messages in the order in which they are recorded, as what the name says."""
    ros1 = path.suffix == '.bag'
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    store.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms', TF))
    plugin = StoragePlugin.SQLITE3 if 'sqlite' in path.name else StoragePlugin.MCAP
    writer = Rosbag1Writer(path) if ros1 else Rosbag2Writer(path, version=9, storage_plugin=plugin)
    with writer:
        connections: dict[str, Any] = {
            topic: writer.add_connection(topic, msgtype, typestore=store)
            for topic, msgtype in empty
        }
        for logged_ns, topic, msgtype, stamp_ns, content in sorted(messages, key=lambda m: m[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=store)
            one = message_of(store.types, msgtype, stamp_ns, content)
            raw = store.serialize_ros1(one, msgtype) if ros1 else store.serialize_cdr(one, msgtype)
            writer.write(connections[topic], logged_ns, raw)
    return path


def folder(path: Path, messages: Iterable[Timed]) -> Path:
    """Write messages as a folder of EuRoC's, whose images are there."""
    names = {'/cam0/image_raw': 'cam0', '/cam1/image_raw': 'cam1', '/imu0': 'imu0'}
    for topic, name in names.items():
        data = path / 'mav0' / name / 'data'
        data.mkdir(parents=True)
        rows = []
        for _, _, msgtype, stamp_ns, content in (m for m in messages if m[1] == topic):
            if msgtype == IMAGE:
                Image.new('L', (4, 3)).save(data / f'{stamp_ns}.png')
            cells = [f'{stamp_ns}.png'] if msgtype == IMAGE else map(repr, map(float, content))
            rows.append(f'{stamp_ns},{",".join(cells)}\n')
        (data.parent / 'data.csv').write_text('#timestamp\n' + ''.join(rows))
    return path


@pytest.fixture(scope='module')
def clean(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp('clean') / 'run', flight())


@pytest.fixture(scope='module')
def harmed(tmp_path_factory) -> Path:
    """Return a recording with a gap of the IMU, frames dropped and a skew of the cameras."""
    path, kept = tmp_path_factory.mktemp('harmed') / 'run', []
    for logged_ns, topic, msgtype, stamp_ns, content in flight():
        seconds = (stamp_ns - FIRST_NS) / 1e9
        if topic == '/imu0' and 5 < seconds < 5.5:
            continue
        if topic == '/cam0/image_raw' and round(seconds * 20) in (100, 101):
            continue
        late_ns = 3_000_000 * (topic == '/cam1/image_raw')
        kept.append((logged_ns + late_ns, topic, msgtype, stamp_ns + late_ns, content))
    return record(path, kept)


def test_a_clean_recording_is_said_to_be_so(clean):
    done = inspect(clean)
    assert done.returncode == 0, done.stderr
    assert 'nothing is wrong with the streams' in done.stdout
    assert done.stderr == ''
    assert start('inspect', clean).stdout == done.stdout  # in an interpreter of its own as well
    found = document(clean)
    assert found['schema'] == 'vio_eval_ros.inspection/1'
    assert found['counts'] == {'info': 0, 'warn': 0, 'fail': 0}
    assert [one['topic'] for one in found['streams']] == [*CAMERAS, '/imu0']
    assert found['imu_to_camera_rate'] == pytest.approx(10)


def test_faults_are_named_worst_first_with_advice(harmed):
    found = document(harmed)
    assert [(one['name'], one['level']) for one in found['findings']] == [
        ('gap', 'fail'),
        ('dropped', 'warn'),
        ('unsynchronised', 'warn'),
        ('camera_skew', 'warn'),
    ]
    assert all(
        one['advice'].lower() == f'{FINDINGS[one["name"]].cure}.'.lower()
        for one in found['findings']
    )
    (gap,) = found['findings'][0]['at']
    assert (gap['begin_ns'] - FIRST_NS, gap['end_ns'] - FIRST_NS) == (5 * 10**9, 55 * 10**8)
    text = inspect(harmed).stdout
    assert text.index('fail  gap /imu0') < text.index('warn  dropped')
    assert 'at 5.00 s' in text
    assert text.splitlines()[2].split()[:2] == ['fail', '/imu0']


@pytest.mark.slow
@pytest.mark.parametrize('name', ['run.bag', 'sqlite', 'folder'])
def test_every_kind_of_recording_gives_the_same_figures(clean, tmp_path, name):
    messages = flight()
    path = tmp_path / name
    other = folder(path, messages) if name == 'folder' else record(path, messages)
    expected, found = document(clean)['streams'], document(other)['streams']
    for one, same in zip(expected, found, strict=True):
        assert same['timing'] == one['timing']
        assert same['inertial'] == one['inertial']
        assert same['clocks'] == (None if name == 'folder' else one['clocks'])


def test_findings_alone_do_not_fail_but_those_asked_for_do(harmed, tmp_path):
    assert inspect(harmed).returncode == 0
    assert inspect(harmed, '--fail-on', 'stuck,jump').returncode == 0
    assert inspect(harmed, '--fail-on', 'stuck,gap').returncode == 1
    short = record(tmp_path / 'run', [m for m in flight() if m[3] - FIRST_NS > 3 * 10**9])
    assert inspect(short, '--fail-on', 'no_still_time').returncode == 1
    assert "there is no finding 'gaps'; did you mean 'gap'?" in complaint(
        harmed, '--fail-on', 'gaps'
    )


def test_limits_and_profile_are_set_by_flags(harmed, tmp_path):
    file = tmp_path / 'limits.yaml'
    file.write_text('inspect: {gap_s: 1, gap_periods: 200}\n')
    found = document(harmed, '--profile', 'car', '--limits', file)
    assert (found['profile'], found['limits']['gap_s']) == ('car', 1)
    assert found['limits']['max_rotation_rad_s'] == 5
    assert found['findings'][0]['name'] == 'dropped'  # what was a gap
    file.write_text('inspect:\n  gap_z: 1\n')
    assert "line 2: there is no 'gap_z' here; did you mean 'gap_s'?" in complaint(
        harmed, '--limits', file
    )


@pytest.mark.slow
def test_expectations_for_euroc_pass_and_fail(clean, harmed):
    found = document(clean, '--expect', EUROC)
    assert {one['word'] for one in found['expectations']} == {'pass'}
    assert len(found['expectations']) == 18
    found = document(harmed, '--expect', EUROC, status=1)
    words = {(one['stream'], one['check']): one['word'] for one in found['expectations']}
    assert words['imu0', 'max_gap_s'] == 'fail'
    assert words['stereo', 'max_skew_s'] == 'warn'
    assert words['cam0', 'rate_hz'] == 'pass'
    assert (
        'fail  imu0 max_gap_s: expected at most 0.05 s, measured 0.5 s'
        in inspect(harmed, '--expect', EUROC).stdout
    )


def test_what_is_expected_must_not_fail_nor_drift(tmp_path):
    stuck = [
        (*m[:4], m[4] if m[1] != '/imu0' or m[3] - FIRST_NS < 9 * 10**9 else np.full(6, 9.0))
        for m in flight()
    ]
    done = inspect(record(tmp_path / 'stuck', stuck), '--expect', EUROC)
    assert done.returncode == 1
    assert 'fail  imu0 findings: expected no failing finding, found stuck' in done.stdout
    assert 'nothing is wrong' not in done.stdout
    drifting = [(at + (at - FIRST_NS) // 10**4, *rest) for at, *rest in flight()]
    words = {
        one['check']: one['word']
        for one in document(record(tmp_path / 'drift', drifting), '--expect', EUROC, status=1)[
            'expectations'
        ]
        if one['stream'] == 'imu0'
    }
    assert [check for check, word in words.items() if word == 'fail'] == ['max_drift_ppm']


def test_a_folder_is_not_judged_by_what_it_does_not_record(tmp_path):
    path = folder(tmp_path / 'euroc', flight())
    checks = {one['check'] for one in document(path, '--expect', EUROC)['expectations']}
    assert 'rate_hz' in checks
    assert 'max_drift_ppm' not in checks


def test_a_camera_that_is_recorded_but_sends_nothing_fails(tmp_path):
    path = tmp_path / 'run'
    record(path, [m for m in flight() if m[1] != CAMERAS[1]], [(CAMERAS[1], IMAGE)])
    found = document(path)
    assert [(one['name'], one['topic']) for one in found['findings']] == [('silent', CAMERAS[1])]
    assert found['silent'] == [{'topic': CAMERAS[1], 'type': IMAGE}]
    page = tmp_path / 'page.html'
    done = inspect(path, '--expect', EUROC, '--report', f'html:{page}', '--fail-on', 'silent')
    assert done.returncode == 1
    assert done.stdout.splitlines()[2].split()[:4] == ['fail', CAMERAS[1], 'Image', '0']
    assert 'the topic was recorded, but has no messages' in page.read_text()


def test_a_stream_that_is_expected_and_missing_fails(clean, tmp_path):
    file = tmp_path / 'expect.yaml'
    file.write_text('streams:\n  lidar: {topic: /points, rate_hz: 10}\n')
    (verdict,) = document(clean, '--expect', file, status=1)['expectations']
    assert verdict['message'] == 'there are no messages on /points'
    file.write_text('streams:\n  lidar: {topic: /points, level: warn}\n')
    (verdict,) = document(clean, '--expect', file)['expectations']
    assert verdict['word'] == 'warn'


def test_expectations_that_make_no_sense_are_reported_with_their_line(clean, tmp_path):
    file = tmp_path / 'expect.yaml'
    file.write_text('streams:\n  cam:\n    topic: /cam0/image_raw\n    rate_hs: 20\n')
    told = complaint(clean, '--expect', file)
    assert told.endswith(
        "expect.yaml: line 4: there is no 'rate_hs' here; did you mean 'rate_hz'?\n"
    )


def test_each_limit_and_name_can_be_expected(clean, tmp_path):
    file = tmp_path / 'expect.yaml'
    imu = {
        'topic': '/imu0', 'rate_hz': 200, 'rate_tolerance': 0.001, 'frame_id': 'frame',
        'up_axis': '+x', 'max_latency_s': 0.02, 'max_drift_ppm': 50, 'max_gap_s': 0.01,
        'min_duration_s': 10, 'min_rotation_rad_s': 0.1, 'min_acceleration_m_s2': 0.5,
        'min_still_at_begin_s': 1,
    }  # fmt: skip
    file.write_text(yaml.safe_dump({'streams': {'imu0': imu}}))
    verdicts = document(clean, '--expect', file)['expectations']
    assert [one['word'] for one in verdicts] == ['pass'] * (len(imu) - 1)
    imu |= {
        'rate_hz': 190, 'frame_id': 'imu', 'up_axis': '-x', 'max_latency_s': 0.001,
        'max_drift_ppm': 0, 'max_gap_s': 0.004, 'min_duration_s': 20, 'min_rotation_rad_s': 1,
        'min_acceleration_m_s2': 5, 'min_still_at_begin_s': 3,
    }  # fmt: skip
    file.write_text(yaml.safe_dump({'streams': {'imu0': imu}}))
    verdicts = document(clean, '--expect', file, status=1)['expectations']
    passed = {one['check'] for one in verdicts if one['word'] == 'pass'}
    assert passed == {'findings', 'max_drift_ppm'}  # there is no drift for certain


@pytest.mark.slow
def test_clips_hold_the_messages_around_each_finding(harmed, tmp_path):
    clips = tmp_path / 'clips'
    done = inspect(harmed, '--clip', clips, '--clip-s', '0.5')
    assert done.returncode == 0, done.stderr
    files = sorted(clips.iterdir())
    assert [file.name for file in files] == [
        '01_gap_imu0.mcap',
        '02_dropped_cam0_image_raw.mcap',
        '03_unsynchronised_cam0_image_raw_cam1_image_raw.mcap',
    ]
    with Recording(files[0]) as clip:
        counts = {topic.name: topic.count for topic in clip.topics}
    # half a second on either side of half a second
    assert counts['/imu0'] == pytest.approx(200, abs=4)
    assert counts['/cam1/image_raw'] == pytest.approx(30, abs=2)
    assert inspect(files[0]).returncode == 0
    (whole,) = harmed.glob('*.mcap')
    with whole.open('rb') as stream:
        original = {m.data for _, _, m in make_reader(stream).iter_messages(['/imu0'])}
    with files[0].open('rb') as stream:
        texts = {schema.name: schema.data for schema, _, _ in make_reader(stream).iter_messages()}
        stream.seek(0)
        got = [m.data for _, c, m in make_reader(stream).iter_messages(['/imu0'])]
    assert b'float64[9] angular_velocity_covariance' in texts[IMU]
    assert original.issuperset(got)


def test_a_clip_of_what_lasts_long_is_its_beginning(tmp_path):
    messages = [m for m in flight() if m[1] != '/imu0' or not 1 < (m[3] - FIRST_NS) / 1e9 < 11]
    assert inspect(record(tmp_path / 'run', messages), '--clip', tmp_path / 'c').returncode == 0
    (clip,) = (tmp_path / 'c').iterdir()
    with Recording(clip) as found:
        counts = {topic.name: topic.count for topic in found.topics}
    # five seconds of it, and one before and behind
    assert counts['/cam0/image_raw'] == pytest.approx(7 * 20, abs=2)


def test_topics_without_a_definition_are_left_out_and_said_to_be(tmp_path):
    path = tmp_path / 'run.mcap'
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2')
        text = store.generate_msgdef(IMU, ros_version=2)[0].encode()
        imu = writer.register_channel('/imu0', 'cdr', writer.register_schema(IMU, 'ros2msg', text))
        schema = writer.register_schema('own_msgs/msg/Thing', 'ros2msg', b'')
        own = writer.register_channel('/own', 'cdr', schema)
        for logged_ns, _, _, stamp_ns, content in (m for m in flight() if m[1] == '/imu0'):
            if not 5 < (stamp_ns - FIRST_NS) / 1e9 < 6:
                one = message_of(store.types, IMU, stamp_ns, content)
                raw = bytes(store.serialize_cdr(one, IMU))
                writer.add_message(imu, logged_ns, raw, logged_ns)
                writer.add_message(own, logged_ns, b'\0\1\0\0', logged_ns)
        writer.finish()
    done = inspect(path, '--clip', tmp_path / 'clips')
    assert done.returncode == 0, done.stderr
    assert 'info  left_out: the recording has no definition of own_msgs/msg/Thing' in done.stdout
    assert 'clips are without a topic: /own: ' in done.stdout
    (clip,) = (tmp_path / 'clips').iterdir()
    with Recording(clip) as found:
        assert [topic.name for topic in found.topics] == ['/imu0']


@pytest.mark.slow
@pytest.mark.parametrize('name', ['run.bag', 'folder'])
def test_clips_of_other_recordings_are_of_ros_2(tmp_path, name):
    messages = [m for m in flight() if not (m[1] == '/imu0' and 5e9 < m[3] - FIRST_NS < 6e9)]
    path = tmp_path / name
    source = folder(path, messages) if name == 'folder' else record(path, messages)
    assert inspect(source, '--clip', tmp_path / 'clips').returncode == 0
    (clip,) = (tmp_path / 'clips').iterdir()
    store = get_typestore(Stores.ROS2_JAZZY)
    with clip.open('rb') as stream:
        rows = list(make_reader(stream).iter_messages(['/cam0/image_raw']))
    assert len(rows) == pytest.approx(60, abs=2)
    image = store.deserialize_cdr(rows[0][2].data, IMAGE)
    assert (image.height, image.width) == (3, 4)


def test_reports_are_written_and_self_contained(harmed, tmp_path, parsed):
    page, found = tmp_path / 'page.html', tmp_path / 'found.json'
    done = inspect(harmed, '--report', f'html:{page}', '--report', f'json:{found}')
    assert done.returncode == 0, done.stderr
    assert json.loads(found.read_text()) == document(harmed)
    content = parsed(page.read_text())
    assert 'silent once, for up to 0.5 s' in content.text
    assert 'at 5.00 s' in content.text
    assert '/cam0/image_raw, /cam1/image_raw: skew 3 ' in content.text
    assert 'motion                 /imu0: rotates' in content.text
    badges = {word for a, word in content.of('span') if a.get('class', '').startswith('badge')}
    assert badges == {'fail', 'warn'}
    assert len(content.figures) == 1 + 3
    assert not [a for a, _ in content.of('script') if 'src' in a]


def test_a_name_cannot_break_the_page_nor_the_terminal(tmp_path, parsed):
    evil = '/<script>alert(1)</script>\x1b[31m'
    messages = [(a, evil, c, d, e) for a, b, c, d, e in flight() if b == '/cam0/image_raw']
    run = record(tmp_path / 'run', messages)
    done = inspect(run, '--report', f'html:{tmp_path / "page.html"}')
    assert done.returncode == 0, done.stderr
    assert '\x1b' not in done.stdout
    assert '<script>alert' not in (tmp_path / 'page.html').read_text()


def test_the_page_draws_in_a_browser(harmed, tmp_path, window):
    page = tmp_path / 'page.html'
    assert inspect(harmed, '--report', f'html:{page}').returncode == 0
    window.open(page.read_text(), 1200)
    window.open(page.read_text(), 390)


CALIBRATION = 'calib/kimera_euroc_sensor_yaml'


def test_published_calibrations_are_right_and_alike(clean, shared_data):
    kalibr = shared_data / 'calib/open_vins_kalibr/euroc_mav'
    found = document(
        clean, '--calibration', shared_data / CALIBRATION,
        kalibr / 'kalibr_imucam_chain.yaml', kalibr / 'kalibr_imu_chain.yaml',
    )  # fmt: skip
    assert found['findings'] == []
    euroc, imucam, imu = found['calibration']['sentences'].values()
    assert imu[0].startswith('imu0: gyroscope_noise_density 0.00016968 rad/s')
    assert euroc[0].startswith('T_BS maps cam0 into the body')
    assert 'cam1 is 110.08 mm from cam0, along +x of cam0, rotated by 0.82 deg' in euroc
    assert 'cam0 is the left camera, cam1 the right' in imucam
    assert any(' by 0 mm and 0 deg' in sentence for sentence in imucam)
    # as EuRoC's is mounted, x of the IMU is up, and so is -y of the camera
    assert any(sentence.startswith('-y of cam0 points up') for sentence in euroc)


def test_a_chain_to_the_camera_is_distinguished_from_one_to_the_imu(clean, shared_data):
    tumvi = shared_data / 'calib/open_vins_kalibr/tum_vi/kalibr_imucam_chain.yaml'
    found = document(clean, '--calibration', tumvi)
    (told,) = found['calibration']['sentences'].values()
    assert told[0].startswith('T_cam_imu maps the IMU into cam0')
    assert found['findings'] == []


def test_a_file_that_is_no_calibration_is_reported(clean, tmp_path):
    file = tmp_path / 'chain.yaml'
    file.write_text('cam0:\n  T_cam_imu: [1, 2]\n')
    told = complaint(clean, '--calibration', file)
    assert 'line 2: T_cam_imu: expected a matrix of 4 rows and 4 columns' in told


def test_what_cannot_be_inspected_is_reported_in_a_line(clean, tmp_path, shared_data):
    assert 'there is no such file' in complaint(tmp_path / 'no.bag')
    assert 'is empty (0 bytes)' in complaint(shared_data / 'bags/rosbag_js/empty-file.bag')
    assert 'there are no messages' in complaint(shared_data / 'bags/rosbag_js/no-messages.bag')
    wbag = shared_data / 'bags/rosbag2/rosbag2_py/mcap/wbag'
    assert 'no topic has messages with a header' in complaint(wbag)
    for file in ('nav2_zstd_truncated60.mcap', 'tf_example_truncated70.bag'):
        assert 'damaged' in complaint(shared_data / 'derived_bags/damaged' / file)
    assert 'there is no folder' in complaint(clean, '--clip', tmp_path / 'no' / 'clips')
    assert 'is in the recording' in complaint(clean, '--clip', clean / 'clips')
    assert 'is not a folder' in complaint(clean, '--clip', EUROC)
    assert 'write FORMAT:PATH' in complaint(clean, '--report', 'png:a')
    assert '--clip-s' in complaint(clean, '--clip-s', '-1')
    assert '--clip-s' in complaint(clean, '--clip-s', '1e300')


@pytest.mark.parametrize(
    ('option', 'target', 'writable', 'problem'),
    [
        ('--report', 'html:{out}', True, 'is a folder; name a file in it'),
        ('--report', 'json:{out}/no/found.json', True, 'there is no folder'),
        ('--report', 'json:{out}/found.json', False, 'cannot write: Permission denied'),
        ('--clip', '{out}/clips', False, 'cannot write: Permission denied'),
    ],
)
def test_what_cannot_be_written_is_refused_before_reading(
    option, target, writable, problem, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(verb, 'inspect_recording', lambda *_, **__: pytest.fail('it was read'))
    if not writable:
        denied = PermissionError(errno.EACCES, 'Permission denied')
        monkeypatch.setattr(tempfile, 'TemporaryFile', Mock(side_effect=denied))
    assert verb.main(['run.mcap', option, target.format(out=tmp_path)]) == 2
    assert problem in capsys.readouterr().err


@pytest.mark.parametrize('name', ['run.bag', 'run'])
def test_transforms_alone_are_inspected_by_the_stamps_of_the_first(tmp_path, name):
    messages = [
        (at, '/tf', TF, stamp_ns, None)
        for at, topic, _, stamp_ns, _ in flight()
        if topic == CAMERAS[0] and not 5 < (stamp_ns - FIRST_NS) / 1e9 < 6
    ]
    empty = (FIRST_NS + 13 * 10**9, '/tf', TF, None, None)
    found = document(record(tmp_path / name, [*messages, empty]))
    (one,) = found['streams']
    assert one['timing']['rate_hz'] == pytest.approx(20, rel=1e-3)
    assert one['timing']['first_ns'] == FIRST_NS
    assert {(f['name'], f['level']) for f in found['findings']} == {
        ('gap', 'info'),
        ('unstamped', 'info'),
    }


def test_a_sensor_that_an_imu_says_not_to_have_is_not_dead(tmp_path):
    gyroscope = [
        (*m[:4], np.append(m[4][:3], [np.nan] * 3)) if m[1] == '/imu0' else m for m in flight()
    ]
    assert inspect(record(tmp_path / 'run', gyroscope), '--fail-on', 'stuck').returncode == 0
    found = document(tmp_path / 'run')
    assert [one['level'] for one in found['findings'] if one['level'] != 'info'] == []


def test_a_recording_that_ends_early_is_damaged(clean, tmp_path):
    copy = shutil.copytree(clean, tmp_path / 'run')
    (file,) = copy.glob('*.mcap')
    file.write_bytes(file.read_bytes()[:-2000])
    assert 'damaged' in complaint(copy)
