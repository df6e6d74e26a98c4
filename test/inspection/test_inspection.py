"""Every fault of a stream is found and named, and a clean recording has none."""

from dataclasses import replace
import json

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.inspection.documents import json_document, Report, text_document
from vio_eval_ros.inspection.findings import Finding
from vio_eval_ros.inspection.html import period_over_time, timeline
from vio_eval_ros.inspection.inspection import Examined, inspect, Inspection
from vio_eval_ros.inspection.streams import Stream

Rig = dict[str, Stream]


def inspected(rig: Rig, **changed: Stream) -> Inspection:
    return inspect(list({**rig, **changed}.values()))


def wrong(inspection: Inspection) -> set[tuple[str, str]]:
    return {(one.name, one.topic) for one in inspection.findings if one.level != 'info'}


def the(inspection: Inspection, name: str) -> Finding:
    (found,) = [one for one in inspection.findings if one.name == name and one.level != 'info']
    return found


def kept(stream: Stream, which: np.ndarray) -> Stream:
    """Return some messages of a stream, in the order given."""
    return replace(
        stream,
        logged_ns=stream.logged_ns[np.sort(which)],
        stamps_ns=stream.stamps_ns[which],
        numbers=None if stream.numbers is None else stream.numbers[which],
    )


def without(stream: Stream, *lost: int) -> Stream:
    return kept(stream, np.setdiff1d(np.arange(len(stream)), lost))


def test_a_clean_recording_raises_nothing(rig):
    inspection = inspected(rig)
    assert inspection.findings == []
    assert inspection.imu_to_camera == pytest.approx(10, rel=1e-4)
    assert len(inspection.pairs) == 1


@pytest.mark.parametrize('duration_s', [3, 10, 30])
@pytest.mark.parametrize('transport_s', [0.0, 0.001, 0.02])
def test_transport_alone_raises_nothing(rig, duration_s, transport_s):
    source = np.random.default_rng(duration_s)
    late = {}
    for name, stream in rig.items():
        short = kept(
            stream, np.flatnonzero(stream.stamps_ns < stream.stamps_ns[0] + duration_s * 10**9)
        )
        delays = (1e9 * source.exponential(transport_s, len(short))).astype(np.int64)
        late[name] = replace(short, logged_ns=np.maximum.accumulate(short.stamps_ns + delays))
    assert wrong(inspect(list(late.values()))) == set()


def test_figures_are_those_of_the_stream(rig):
    camera = next(e for e in inspected(rig).streams if e.stream.topic == '/cam0/image_raw')
    assert camera.timing.rate_hz == pytest.approx(20, abs=3 * camera.timing.rate_uncertainty_hz)
    assert camera.timing.rate_uncertainty_hz < 1e-4
    assert camera.timing.period_s == pytest.approx(0.05, abs=1e-5)
    assert 0 < camera.timing.jitter_median_s < camera.timing.jitter_p99_s < 1e-4
    assert camera.clocks.offset_s == pytest.approx(0.004, abs=0.0005)
    assert camera.clocks.latency_median_s == pytest.approx(0.0054, abs=0.0005)


@pytest.mark.parametrize('name', ['cam0', 'imu'])
def test_dropped_messages_are_counted_and_timed(rig, name):
    lost = (100, 200, 201, 350)
    stream = rig[name]
    found = the(inspected(rig, **{name: without(stream, *lost)}), 'dropped')
    assert (found.count, found.topic) == (4, stream.topic)
    begins = [moment.begin_ns for moment in found.moments]
    assert begins == [int(stream.stamps_ns[k - 1]) for k in (100, 200, 350)]
    assert found.value == pytest.approx(3 / (20 if name == 'cam0' else 200), abs=1e-3)


def test_many_dropped_frames_leave_the_rate_as_it_is(rig):
    lost = np.random.default_rng(1).choice(np.arange(1, 599), 180, replace=False)
    inspection = inspected(rig, cam0=without(rig['cam0'], *lost))
    camera = next(e for e in inspection.streams if e.stream.topic == '/cam0/image_raw')
    assert camera.timing.rate_hz == pytest.approx(20, rel=1e-4)
    assert camera.timing.missing == 180


def test_a_gap_is_found_with_its_ends(rig):
    found = the(inspected(rig, imu=without(rig['imu'], *range(1000, 1100))), 'gap')
    assert found.level == 'fail'
    (moment,) = found.moments
    assert moment.begin_ns == rig['imu'].stamps_ns[999]
    assert moment.end_ns == rig['imu'].stamps_ns[1100]
    assert found.value == pytest.approx(0.505, abs=1e-3)


@pytest.mark.parametrize('name', ['cam0', 'imu', 'pose'])
def test_swapped_messages_are_out_of_order(rig, name):
    order = np.arange(len(rig[name]))
    order[[250, 251]] = order[[251, 250]]
    inspection = inspected(rig, **{name: kept(rig[name], order)})
    assert wrong(inspection) == {('out_of_order', rig[name].topic)}
    assert the(inspection, 'out_of_order').count == 1


@pytest.mark.parametrize('name', ['cam0', 'imu'])
@pytest.mark.parametrize('kind', ['normal', 'uniform'])
def test_jitter_of_three_milliseconds_is_found(rig, name, kind):
    source, stream = np.random.default_rng(5), rig[name]
    draw = {
        'normal': source.normal(0, 3e6, len(stream)),
        'uniform': source.uniform(-3e6, 3e6, len(stream)),
    }
    stamps_ns = np.sort(stream.stamps_ns + draw[kind].astype(np.int64))
    found = wrong(inspected(rig, **{name: replace(stream, stamps_ns=stamps_ns)}))
    assert ('jitter', stream.topic) in found
    assert {topic for _, topic in found if ',' not in topic} == {stream.topic}
    assert {name for name, _ in found} <= {'jitter', 'unsynchronised'}


def test_stamps_made_on_arrival_are_told(rig):
    source, stream = np.random.default_rng(5), rig['cam0']
    stamps_ns = stream.stamps_ns + source.exponential(3e6, len(stream)).astype(np.int64)
    arrived = replace(stream, stamps_ns=stamps_ns, logged_ns=stamps_ns + 100_000)
    jitter = the(inspected(rig, cam0=arrived), 'jitter')
    assert 'stamped on arrival' in jitter.message


@pytest.mark.parametrize('ppm', [50, -50, 200])
def test_drift_between_the_clocks_is_measured(rig, ppm):
    stream = rig['imu']
    drift = ((stream.stamps_ns - stream.stamps_ns[0]) * ppm) // 10**6
    inspection = inspected(rig, imu=replace(stream, logged_ns=stream.logged_ns + drift))
    found = the(inspection, 'clock_drift')
    clocks = next(e.clocks for e in inspection.streams if e.stream.topic == '/imu0')
    assert found.topic == '/imu0'
    assert found.value == pytest.approx(ppm, abs=4 * clocks.drift_uncertainty_ppm)
    assert clocks.drift_uncertainty_ppm < 5


def test_the_uncertainty_of_a_drift_is_honest():
    source, misses = np.random.default_rng(7), 0
    for _ in range(100):
        stamps_ns = np.arange(400) * 50_000_000
        logged_ns = stamps_ns + source.exponential(2e6, 400).astype(np.int64)
        stream = Stream(
            '/cam', 'sensor_msgs/msg/Image', np.maximum.accumulate(logged_ns), stamps_ns + 1, {}
        )
        (one,) = inspect([stream]).streams
        misses += abs(one.clocks.drift_ppm) > 1.96 * one.clocks.drift_uncertainty_ppm
    assert misses <= 15  # of 100, where 5 are expected


def test_a_step_of_the_clock_is_no_drift(rig):
    stream = rig['imu']
    late = stream.logged_ns + 3_000_000 * (np.arange(len(stream)) > len(stream) // 2)
    assert wrong(inspected(rig, imu=replace(stream, logged_ns=late))) == set()


def test_a_replay_is_no_drift(rig):
    twice = {
        name: replace(s, logged_ns=s.logged_ns[0] + (s.logged_ns - s.logged_ns[0]) // 2)
        for name, s in rig.items()
    }
    inspection = inspect(list(twice.values()))
    assert wrong(inspection) == set()
    assert {one.name for one in inspection.findings} >= {'replayed'}


def test_a_sensor_on_another_clock_is_found(rig):
    stream = rig['imu']
    inspection = inspected(rig, imu=replace(stream, stamps_ns=stream.stamps_ns - 5 * 10**9))
    assert 'clock_offset' in {name for name, _ in wrong(inspection)}
    apart = inspected(rig, imu=replace(stream, stamps_ns=stream.stamps_ns - 3600 * 10**9))
    assert apart.common_ns is None
    assert the(apart, 'no_common_span').level == 'fail'


@pytest.mark.parametrize('skew_ms', [1, 5, -5, 20])
def test_a_constant_skew_is_measured(rig, skew_ms):
    camera = rig['cam1']
    shifted = replace(camera, stamps_ns=camera.stamps_ns + skew_ms * 1_000_000)
    inspection = inspected(rig, cam1=shifted)
    assert wrong(inspection) == {('camera_skew', '/cam0/image_raw, /cam1/image_raw')}
    assert the(inspection, 'camera_skew').value == pytest.approx(skew_ms / 1e3, abs=1e-5)


def test_frames_without_partner_are_counted_on_their_side(rig):
    inspection = inspected(rig, cam1=without(rig['cam1'], 100, 250))
    found = the(inspection, 'unsynchronised')
    assert found.count == 2
    assert '2 of /cam0/image_raw, 0 of /cam1/image_raw' in found.message
    assert [m.begin_ns for m in found.moments] == [
        int(rig['cam0'].stamps_ns[k]) for k in (100, 250)
    ]


def test_cameras_that_run_freely_are_told(rig):
    camera = rig['cam1']
    elapsed = camera.stamps_ns - camera.stamps_ns[0]
    free = replace(camera, stamps_ns=camera.stamps_ns[0] + (elapsed * 1001) // 1000)
    found = the(inspected(rig, cam1=free), 'unsynchronised')
    assert 'run freely' in found.message or found.count > 100


def test_duplicates_are_found(rig):
    order = np.sort(np.append(np.arange(len(rig['imu'])), [500, 501, 900]))
    inspection = inspected(rig, imu=kept(rig['imu'], order))
    assert wrong(inspection) == {('duplicate_stamps', '/imu0')}
    assert the(inspection, 'duplicate_stamps').count == 3


@pytest.mark.parametrize(
    ('name', 'part'), [('late_start', slice(60, None)), ('early_end', slice(0, -60))]
)
def test_streams_that_begin_late_or_end_early_are_found(rig, name, part):
    camera = kept(rig['cam1'], np.arange(len(rig['cam1']))[part])
    inspection = inspected(rig, cam1=camera)
    assert wrong(inspection) == {(name, '/cam1/image_raw')}
    assert the(inspection, name).value == pytest.approx(3, abs=0.1)


def test_stuck_samples_are_found(rig):
    numbers = rig['imu'].numbers.copy()
    numbers[2000:2010] = numbers[2000]
    found = the(inspected(rig, imu=replace(rig['imu'], numbers=numbers)), 'stuck')
    assert (found.count, found.level) == (10, 'fail')
    assert found.moments[0].begin_ns == rig['imu'].stamps_ns[2000]


@pytest.mark.parametrize(('axis', 'limit'), [(0, 0.4), (5, 11.0)])
def test_saturation_is_found_with_its_limit(rig, axis, limit):
    numbers = rig['imu'].numbers.copy()
    numbers[:, axis] = np.minimum(numbers[:, axis], limit)
    found = the(inspected(rig, imu=replace(rig['imu'], numbers=numbers)), 'saturation')
    assert found.value == limit
    assert found.count == np.count_nonzero(numbers[:, axis] == limit)


def test_a_coarse_sensor_is_not_saturated(rig):
    numbers = np.round(rig['imu'].numbers / [0.004] * 1) * 0.004
    numbers += 1e-7 * np.arange(len(numbers))[:, None] % 2  # so that nothing is stuck
    assert 'saturation' not in {
        n for n, _ in wrong(inspected(rig, imu=replace(rig['imu'], numbers=numbers)))
    }


@pytest.mark.parametrize(
    ('scale', 'name'), [((1, 1 / 9.81), 'units'), ((57.3, 1), 'units'), ((1, 1.1), 'gravity')]
)
def test_units_and_gravity_are_checked(rig, scale, name):
    numbers = rig['imu'].numbers * np.repeat(scale, 3)
    found = wrong(inspected(rig, imu=replace(rig['imu'], numbers=numbers)))
    assert found == {(name, '/imu0')}


def test_rest_and_up_are_those_of_the_flight(rig):
    felt = next(e.inertial for e in inspected(rig).streams if e.inertial)
    assert felt.up == '+z'
    assert felt.gravity_m_s2 == pytest.approx(9.81, abs=0.01)
    assert felt.still_at_begin_s == pytest.approx(3, abs=0.3)


def test_an_imu_that_is_not_moved_excites_nothing(rig):
    source = np.random.default_rng(2)
    numbers = source.normal(0, 0.01, rig['imu'].numbers.shape)
    numbers[:, 5] += 9.81
    inspection = inspected(rig, imu=replace(rig['imu'], numbers=numbers))
    assert wrong(inspection) == set()
    assert 'low_excitation' in {one.name for one in inspection.findings}


def test_a_slow_imu_is_pointed_out(rig):
    slow = kept(rig['imu'], np.arange(0, len(rig['imu']), 4))
    assert wrong(inspected(rig, imu=slow)) == {('imu_rate', '/imu0')}


def test_frozen_poses_are_found_unless_at_rest(rig):
    pose = rig['pose']
    numbers = pose.numbers.copy()
    numbers[1000:1050] = numbers[1000]
    found = the(inspected(rig, pose=replace(pose, numbers=numbers)), 'frozen')
    assert found.count == 50
    assert found.moments[0].begin_ns == pose.stamps_ns[1000]
    numbers = pose.numbers.copy()
    numbers[2900:] = numbers[2900]
    assert the(inspected(rig, pose=replace(pose, numbers=numbers)), 'frozen').count == 100
    rest = pose.numbers.copy()
    rest[:500] = rest[500]
    inspection = inspected(rig, pose=replace(pose, numbers=rest))
    assert wrong(inspection) == set()
    assert 'frozen' in {one.name for one in inspection.findings}


def test_jumps_are_found_at_their_pose(rig):
    numbers = rig['pose'].numbers.copy()
    numbers[1500:, 0] += 0.5
    found = the(inspected(rig, pose=replace(rig['pose'], numbers=numbers)), 'jump')
    assert found.value == pytest.approx(0.5, abs=0.05)
    assert [m.end_ns for m in found.moments] == [rig['pose'].stamps_ns[1500]]


def test_implausible_poses_are_found(rig):
    pose = rig['pose']
    fast = replace(pose, numbers=pose.numbers * ([1000] * 3 + [1] * 4))
    assert ('implausible_motion', pose.topic) in wrong(inspected(rig, pose=fast))
    long = replace(pose, numbers=pose.numbers * ([1] * 3 + [2] * 4))
    assert wrong(inspected(rig, pose=long)) == {('quaternion_norm', pose.topic)}
    nan = pose.numbers.copy()
    nan[7] = np.nan
    assert wrong(inspected(rig, pose=replace(pose, numbers=nan))) == {('not_finite', pose.topic)}


def test_headers_are_checked(rig):
    named = replace(rig['cam0'], frames={'cam0': 599, 'camera': 1})
    assert wrong(inspected(rig, cam0=named)) == {('frame_ids', '/cam0/image_raw')}
    stamps_ns = rig['imu'].stamps_ns.copy()
    stamps_ns[3] = 0
    found = wrong(inspected(rig, imu=replace(rig['imu'], stamps_ns=stamps_ns)))
    assert found == {('unstamped', '/imu0'), ('dropped', '/imu0')}
    inspection = inspected(rig, imu=replace(rig['imu'], stamps_ns=0 * stamps_ns))
    assert wrong(inspection) == {('unstamped', '/imu0')}


def test_what_was_left_out_is_told(rig):
    inspection = inspect(list(rig.values()), ['/lidar is serialised as protobuf'])
    assert [one.name for one in inspection.findings] == ['left_out']


@pytest.mark.parametrize('count', [1, 2, 3])
def test_a_few_messages_are_enough_to_say_so(rig, count):
    few = {name: kept(stream, np.arange(count)) for name, stream in rig.items()}
    assert wrong(inspect(list(few.values()))) == set()


TYPES = {
    '/cam0': ('sensor_msgs/msg/Image', None),
    '/cam1': ('sensor_msgs/msg/CompressedImage', None),
    '/imu': ('sensor_msgs/msg/Imu', 6),
    '/point': ('geometry_msgs/msg/PointStamped', 3),
    '/pose': ('geometry_msgs/msg/PoseStamped', 7),
    '/log': ('rcl_interfaces/msg/Log', None),
}
TIMES = st.integers(0, 2**62) | st.integers(0, 50).map(lambda k: k * 10**8)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(TIMES, TIMES), min_size=1, max_size=60), st.integers(0, 2**32 - 1))
def test_no_stamps_and_no_numbers_are_too_strange(times, seed):
    source = np.random.default_rng(seed)
    odd = [0.0, 1.0, np.nan, np.inf, -1e300, 1e-300]
    streams = []
    for topic, (msgtype, width) in TYPES.items():
        some = np.array(times, np.int64)[: source.integers(1, len(times) + 1)]
        numbers = None if width is None else source.choice(odd, (len(some), width))
        streams.append(Stream(topic, msgtype, np.sort(some[:, 0]), some[:, 1], {}, numbers))
    report = Report('odd', inspect(streams))
    assert json.loads(json_document(report))['schema'] == 'vio_eval_ros.inspection/1'
    assert all(topic in text_document(report) for topic in TYPES)
    figures = [timeline(report), *map(period_over_time, filter(has_periods, report.streams()))]
    json.dumps(figures, allow_nan=False)


def has_periods(one: Examined) -> bool:
    return len(one.timing.periods_s) > 0
