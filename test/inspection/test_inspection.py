"""Every fault of a stream is found and named, and a clean recording has none."""

from dataclasses import replace
import json

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from vio_eval_ros.core import rotation
from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.inspection.figures import period_over_time, timeline
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.html_report import html_document
from vio_eval_ros.inspection.inspection import inspect_streams as inspect
from vio_eval_ros.inspection.inspection import InspectedStreams
from vio_eval_ros.inspection.report import json_document, Report
from vio_eval_ros.inspection.text_report import text_document

IMAGE, IMU = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/Imu'
FIRST_NS = 1_403_636_579_763_555_584
Rig = dict[str, SensorStream]


def inspected(rig: Rig, **changed: SensorStream) -> InspectedStreams:
    return inspect(list({**rig, **changed}.values()))


def wrong(inspection: InspectedStreams) -> set[tuple[str, str]]:
    return {(one.name, one.topic) for one in inspection.findings if one.level != 'info'}


def the(inspection: InspectedStreams, name: str) -> Finding:
    (found,) = [one for one in inspection.findings if one.name == name and one.level != 'info']
    return found


def kept(stream: SensorStream, which: np.ndarray) -> SensorStream:
    """Return some messages of a stream, in the order given."""
    return replace(
        stream,
        logged_ns=stream.logged_ns[np.sort(which)],
        stamps_ns=stream.stamps_ns[which],
        numbers=None if stream.numbers is None else stream.numbers[which],
    )


def as_transforms(stream: SensorStream) -> SensorStream:
    """Return poses as the transforms of a TF topic."""
    numbers = stream.numbers
    poses = Poses(stream.stamps_ns, numbers[:, :3], numbers[:, 3:], zero_is_unset=True)
    return replace(
        stream, topic='/tf', kind='other', numbers=None, frames={}, transforms={'map.base': poses}
    )


def without(stream: SensorStream, *lost: int) -> SensorStream:
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


def test_stamps_made_on_arrival_are_reported(rig):
    source, stream = np.random.default_rng(5), rig['cam0']
    stamps_ns = stream.stamps_ns + source.exponential(3e6, len(stream)).astype(np.int64)
    arrived = replace(stream, stamps_ns=stamps_ns, logged_ns=stamps_ns + 100_000)
    jitter = the(inspected(rig, cam0=arrived), 'jitter')
    assert 'stamped on arrival' in jitter.message


@pytest.mark.parametrize(
    ('rate_hz', 'name'), [(30, 'cam0'), (60, 'cam0'), (400, 'imu'), (1000, 'imu')]
)
def test_stamps_in_milliseconds_are_no_jitter(rig, rate_hz, name):
    stream = rig[name]
    count = len(stream)
    stamps_ns = FIRST_NS + np.arange(count) * 10**9 // rate_hz // 10**6 * 10**6
    coarse = replace(stream, stamps_ns=stamps_ns, logged_ns=stamps_ns + 5_000_000)
    assert wrong(inspect([coarse])) == set()


@pytest.mark.parametrize('rate_hz', [10, 20, 30])
@pytest.mark.parametrize('share', [0.005, 1.0])
def test_jitter_of_three_milliseconds_is_found_at_any_rate(rate_hz, share):
    source = np.random.default_rng(4)
    count = 60 * rate_hz
    late = source.uniform(0, 3e6, count) if share == 1 else 3e6 * (source.random(count) < share)
    stamps_ns = FIRST_NS + np.arange(count) * (10**9 // rate_hz)
    stream = SensorStream('/cam', IMAGE, 'camera', None, stamps_ns + late.astype(np.int64), {})
    assert wrong(inspect([stream])) == {('jitter', '/cam')}


def test_every_third_frame_that_is_lost_is_counted(rig):
    lost = np.arange(2, len(rig['cam0']) - 1, 3)
    inspection = inspect([without(rig['cam0'], *lost)])
    assert the(inspection, 'dropped').count == len(lost)
    assert inspection.streams[0].timing.rate_hz == pytest.approx(20, rel=1e-3)


def test_lost_samples_are_counted_in_spite_of_jitter(rig):
    source, imu = np.random.default_rng(6), rig['imu']
    late = source.uniform(-1e6, 1e6, len(imu)).astype(np.int64)
    lost = 1 + np.flatnonzero(source.random(len(imu) - 2) < 0.02)
    jittered = without(replace(imu, stamps_ns=imu.stamps_ns + late), *lost)
    assert the(inspect([jittered]), 'dropped').count == len(lost)


def test_samples_in_bursts_are_not_missing(rig):
    imu = rig['imu']
    k = np.arange(len(imu))
    stamps_ns = imu.stamps_ns[np.minimum(k // 4 * 4 + 3, len(imu) - 1)] + k % 4 * 100_000
    inspection = inspect([replace(imu, stamps_ns=stamps_ns, logged_ns=stamps_ns + 1000)])
    assert wrong(inspection) == {('jitter', '/imu0')}
    assert inspection.streams[0].timing.rate_hz == pytest.approx(200, rel=1e-3)


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
        stream = SensorStream(
            '/cam', IMAGE, 'camera', np.maximum.accumulate(logged_ns), stamps_ns + 1, {}
        )
        (one,) = inspect([stream]).streams
        misses += abs(one.clocks.drift_ppm) > 1.96 * one.clocks.drift_uncertainty_ppm
    assert misses <= 10  # of 100, where 5 are expected


@pytest.mark.parametrize('ppm', [50, -50])
@pytest.mark.parametrize('kind', ['normal', 'uniform'])
def test_drift_is_found_through_delays_that_are_not_one_sided(rig, kind, ppm):
    source, stream = np.random.default_rng(11), rig['cam0']
    delays = {
        'normal': source.normal(10e6, 1e6, len(stream)),
        'uniform': source.uniform(5e6, 8e6, len(stream)),
    }
    logged = stream.stamps_ns + delays[kind].astype(np.int64)
    drift = ((stream.stamps_ns - stream.stamps_ns[0]) * ppm) // 10**6
    assert wrong(inspect([replace(stream, logged_ns=logged)])) == set()
    found = the(inspect([replace(stream, logged_ns=logged + drift)]), 'clock_drift')
    assert found.value == pytest.approx(ppm, abs=15)


@pytest.mark.parametrize('duration_s', [10, 20, 30])
def test_transport_that_wanders_is_hardly_ever_taken_for_drift(duration_s):
    count, alarms = duration_s * 20, 0
    fade = np.exp(-1 / (20 * 20))
    for seed in range(40):
        source = np.random.default_rng(seed)
        steps = source.normal(0, 0.3e6 * np.sqrt(1 - fade**2), count)
        wander = np.empty(count)
        wander[0] = source.normal(0, 0.3e6)
        for k in range(1, count):
            wander[k] = fade * wander[k - 1] + steps[k]
        stamps_ns = FIRST_NS + np.arange(count) * 50_000_000
        delays = 5e6 + wander + source.exponential(0.5e6, count)
        logged_ns = stamps_ns + delays.astype(np.int64)
        alarms += bool(
            wrong(inspect([SensorStream('/cam', IMAGE, 'camera', logged_ns, stamps_ns, {})]))
        )
    assert alarms <= 2


@pytest.mark.parametrize('step_s', [0.04, 5.0, 3e7])
def test_a_step_of_the_stamps_is_found_at_its_moment(rig, step_s):
    stream = rig['imu']
    stamps_ns = stream.stamps_ns + int(1e9 * step_s) * (np.arange(len(stream)) >= 3000)
    inspection = inspected(rig, imu=replace(stream, stamps_ns=stamps_ns))
    # messages went on: none is missing, and there is no gap
    assert [(one.name, one.level) for one in inspection.findings] == [('clock_step', 'warn')]
    found = the(inspection, 'clock_step')
    assert found.value == pytest.approx(-step_s, abs=0.003)
    assert found.moments[0].end_ns == stamps_ns[3000]
    imu = next(e for e in inspection.streams if e.stream.topic == '/imu0')
    assert imu.timing.missing == 0
    assert imu.timing.rate_hz == pytest.approx(200, rel=1e-4)
    assert np.isnan(imu.clocks.drift_ppm)


def test_a_gap_is_one_though_the_stamps_step_elsewhere(rig):
    stream = without(rig['imu'], *range(1000, 1100))
    stamps_ns = stream.stamps_ns + 5 * 10**9 * (np.arange(len(stream)) >= 3000)
    inspection = inspected(rig, imu=replace(stream, stamps_ns=stamps_ns))
    assert wrong(inspection) == {('clock_step', '/imu0'), ('gap', '/imu0')}
    assert the(inspection, 'gap').value == pytest.approx(0.505, abs=1e-3)


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


def test_a_bad_clock_of_one_sensor_is_no_replay(rig):
    stream = rig['imu']
    elapsed = stream.logged_ns - stream.logged_ns[0]
    fast = replace(stream, logged_ns=stream.logged_ns[0] + elapsed * 1003 // 1000)
    assert wrong(inspected(rig, imu=fast)) >= {('clock_drift', '/imu0')}


def test_a_recorder_whose_clock_stands_still_is_reported(rig):
    still = {name: replace(s, logged_ns=0 * s.stamps_ns + FIRST_NS) for name, s in rig.items()}
    found = {one.name: one.message for one in inspect(list(still.values())).findings}
    assert 'does not advance' in found['replayed']


def stalled(stream: SensorStream, begin_s: float, end_s: float) -> SensorStream:
    """Return the messages, of which those of some seconds are recorded at the end of them."""
    end_ns = stream.logged_ns[0] + round(1e9 * end_s)
    is_held = (stream.logged_ns >= stream.logged_ns[0] + 1e9 * begin_s) & (
        stream.logged_ns < end_ns
    )
    return replace(stream, logged_ns=np.where(is_held, end_ns, stream.logged_ns))


@pytest.mark.parametrize('name', ['cam0', 'imu'])
@pytest.mark.parametrize('ppm', [0, 50])
@pytest.mark.parametrize('duration_s', [8, 30])
def test_a_sensor_that_stalls_and_catches_up_is_reported(rig, name, ppm, duration_s):
    count = len(rig[name]) * duration_s // 30
    stream = kept(rig[name], np.arange(count))
    drift = (stream.stamps_ns - stream.stamps_ns[0]) * ppm // 10**6
    stream = replace(stream, logged_ns=stream.logged_ns + drift)
    inspection = inspected(rig, **{name: stalled(stalled(stream, 2, 4), 6, 7)})
    found = the(inspection, 'late_arrival')
    assert (found.topic, found.level) == (stream.topic, 'warn')
    assert found.value == pytest.approx(2, abs=0.06)
    # those that are late by more than half a second
    assert found.count == pytest.approx(2 * len(stream) / duration_s, abs=2)
    silences_s = [(m.logged_end_ns - m.logged_begin_ns) / 1e9 for m in found.moments]
    assert silences_s == pytest.approx([2, 1], abs=0.06)
    assert wrong(inspection) - {('clock_drift', stream.topic)} == {
        ('late_arrival', stream.topic),
        *{('early_end', stream.topic) for _ in range(duration_s < 30)},
    }


def test_a_recorder_that_stalls_with_all_topics_is_no_fault_of_a_sensor(rig):
    inspection = inspect([stalled(stream, 10, 12) for stream in rig.values()])
    assert {(one.name, one.level) for one in inspection.findings} == {('late_arrival', 'info')}
    assert len(inspection.findings) == len(rig)
    assert 'nothing else was recorded meanwhile' in inspection.findings[0].message


def test_a_stall_stands_out_of_hours_of_drift():
    stamps_ns = FIRST_NS + np.arange(36_000) * 200_000_000
    logged_ns = stamps_ns + 5_000_000 + (stamps_ns - FIRST_NS) // 10_000
    drifting = SensorStream('/cam', IMAGE, 'camera', logged_ns, stamps_ns, {})
    names = {one.name for one in inspect([stalled(drifting, 5000, 5002.5)]).findings}
    assert names == {'clock_drift', 'late_arrival'}


def test_a_replay_that_halts_is_no_stall_of_a_sensor(rig):
    twice = replace(rig['imu'], logged_ns=rig['imu'].logged_ns // 2)
    inspection = inspect([stalled(twice, 5, 6)])
    assert 'replayed' in {one.name for one in inspection.findings}
    assert 'late_arrival' not in {one.name for one in inspection.findings}


@pytest.mark.parametrize('batch_s', [0.02, 0.4, 2.0])
def test_messages_that_are_always_recorded_in_batches_are_not_late(rig, batch_s):
    batch_ns = round(1e9 * batch_s)
    batches = {
        name: replace(s, logged_ns=(s.logged_ns // batch_ns + 1) * batch_ns)
        for name, s in rig.items()
    }
    assert 'late_arrival' not in {one.name for one in inspect(list(batches.values())).findings}


@pytest.mark.parametrize('pace', [0.01, 0.5, 3.0])
def test_a_recording_that_was_converted_haltingly_is_not_late(rig, pace):
    source, halts = np.random.default_rng(8), {}
    for name, stream in rig.items():
        steps_ns = pace * np.diff(stream.logged_ns, prepend=stream.logged_ns[0])
        steps_ns += 1e9 * (source.random(len(stream)) < 0.01)
        logged_ns = FIRST_NS + 10**15 + np.cumsum(steps_ns).astype(np.int64)
        halts[name] = replace(stream, logged_ns=logged_ns)
    assert 'late_arrival' not in {one.name for one in inspect(list(halts.values())).findings}


@pytest.mark.slow
@pytest.mark.parametrize('step_s', [-2, 2])
@pytest.mark.parametrize('duration_s', [8, 30])
@pytest.mark.parametrize('of', ['stamps_ns', 'logged_ns'])
def test_a_clock_that_is_set_makes_nothing_late(rig, of, duration_s, step_s):
    for share in (0.2, 0.7):
        stepped = {}
        for name, stream in rig.items():
            stream = kept(stream, np.arange(len(stream) * duration_s // 30))
            behind = np.arange(len(stream)) >= share * len(stream)
            times_ns = getattr(stream, of) + step_s * 10**9 * behind
            stepped[name] = replace(stream, **{of: times_ns})
        assert 'late_arrival' not in {one.name for one in inspect(list(stepped.values())).findings}


def test_stamps_that_are_wrong_for_a_moment_make_nothing_late(rig):
    stamps_ns = rig['imu'].stamps_ns.copy()
    stamps_ns[[1000, *range(2000, 2100)]] -= 2 * 10**9
    stamps_ns[[3000, 4000]] += 2 * 10**9
    inspection = inspected(rig, imu=replace(rig['imu'], stamps_ns=stamps_ns))
    assert [one.name for one in inspection.findings] == ['wrong_stamp']
    found = inspection.findings[0]
    assert (found.count, found.level) == (103, 'fail')
    assert found.value == pytest.approx(2, abs=1e-4)
    assert [m.begin_ns for m in found.moments][1] == stamps_ns[2000]


@pytest.mark.parametrize(
    ('name', 'off_ns', 'level'),
    [('cam0', 10**12, 'fail'), ('cam0', -(10**12), 'fail'), ('imu', 4_000_000, 'warn'),
     ('imu', -4_000_000, 'warn'), ('pose', 10**12, 'warn')],
)  # fmt: skip
def test_one_wrong_stamp_is_one_fault_and_no_gap(rig, name, off_ns, level):
    stamps_ns = rig[name].stamps_ns.copy()
    stamps_ns[500] += off_ns
    inspection = inspected(rig, **{name: replace(rig[name], stamps_ns=stamps_ns)})
    assert [(one.name, one.level, one.count) for one in inspection.findings] == [
        ('wrong_stamp', level, 1)
    ]
    figures = next(e.timing for e in inspection.streams if e.stream.topic == rig[name].topic)
    assert (figures.missing, figures.backward) == (0, 0)
    assert inspection.findings[0].value == pytest.approx(abs(off_ns) / 1e9, abs=1e-4)


def test_stamps_that_are_often_wrong_are_not_corrected(rig):
    source, stamps_ns = np.random.default_rng(9), rig['imu'].stamps_ns.copy()
    stamps_ns[10:-10:40] += source.integers(3_000_000, 4_900_000, len(stamps_ns[10:-10:40]))
    found = wrong(inspected(rig, imu=replace(rig['imu'], stamps_ns=stamps_ns)))
    assert ('jitter', '/imu0') in found
    assert ('wrong_stamp', '/imu0') not in found


def test_a_frame_that_is_lost_and_one_that_comes_twice_are_no_wrong_stamps(rig):
    twice = np.sort(np.append(np.setdiff1d(np.arange(600), [200]), 203))
    found = wrong(inspect([kept(rig['cam0'], twice)]))
    assert found == {(name, '/cam0/image_raw') for name in ('dropped', 'duplicate_stamps')}


@pytest.mark.parametrize('sign', [1, -1])
def test_a_clock_that_steps_alone_is_not_the_recorders(rig, sign):
    late = sign * 10_000_000 * (np.arange(len(rig['imu'])) > 3000)
    transported = replace(rig['imu'], logged_ns=np.sort(rig['imu'].logged_ns + late))
    found = the(inspected(rig, imu=transported), 'clock_step')
    assert (found.topic, found.level) == ('/imu0', 'warn')
    assert 'that of no other stream' in found.message


def test_a_clock_that_steps_for_all_is_the_recorders(rig):
    stepped = [
        replace(
            s, logged_ns=s.logged_ns + 20_000_000 * (s.stamps_ns > s.stamps_ns[0] + 15 * 10**9)
        )
        for s in rig.values()
    ]
    found = [one for one in inspect(stepped).findings if one.name == 'clock_step']
    assert [one.level for one in found] == ['info'] * len(rig)


def test_stamps_that_are_set_back_by_two_periods_are_found(rig):
    # from the one before to the first of them is one period, backwards
    stamps_ns = rig['imu'].stamps_ns - 10_000_000 * (np.arange(len(rig['imu'])) >= 3000)
    found = the(inspect([replace(rig['imu'], stamps_ns=stamps_ns)]), 'clock_step')
    assert 'most likely that of the stamps' in found.message


@pytest.mark.parametrize('names', [('cam0', 'imu'), ('cam0', 'cam1', 'imu', 'second')])
def test_an_offset_is_whole_however_few_sensors_there_are(rig, names):
    early = replace(rig['imu'], stamps_ns=rig['imu'].stamps_ns - 9 * 10**8)
    rig |= {'imu': early, 'second': replace(early, topic='/imu1')}
    found = [
        one
        for one in inspect([rig[name] for name in names]).findings
        if one.name == 'clock_offset' and one.level == 'warn'
    ]
    assert {one.topic for one in found} == {rig[name].topic for name in names[len(names) // 2 :]}
    assert [one.value for one in found] == pytest.approx([0.9] * len(found), abs=0.01)


def test_a_sensor_on_another_clock_is_found(rig):
    stream = rig['imu']
    inspection = inspected(rig, imu=replace(stream, stamps_ns=stream.stamps_ns - 5 * 10**9))
    assert 'clock_offset' in {name for name, _ in wrong(inspection)}
    apart = inspected(rig, imu=replace(stream, stamps_ns=stream.stamps_ns - 3600 * 10**9))
    assert apart.common_ns is None
    assert the(apart, 'no_common_span').level == 'fail'


@pytest.mark.parametrize(
    ('later_s', 'why'),
    [
        (37, 'TAI is ahead of UTC'),
        (-18, 'GPS time is ahead of UTC'),
        (2 * 3600, 'another time zone'),
        (-7.3e6, ''),
        (9, ''),
    ],
)
@pytest.mark.parametrize('names', [('pose', 'imu', 'cam0'), ('pose', 'other')])
def test_poses_on_another_clock_are_found(rig, names, later_s, why):
    rig['other'] = replace(rig['pose'], topic='/odometry')
    streams = {name: rig[name] for name in names}
    stamps_ns = rig['pose'].stamps_ns + round(later_s * 1e9)
    inspection = inspected(streams, pose=replace(rig['pose'], stamps_ns=stamps_ns))
    found = the(inspection, 'clock_offset')
    assert found.topic == '/vicon/pose'
    assert found.value == pytest.approx(-later_s, abs=0.1)
    assert why in found.message
    assert 'nothing is wrong' not in text_document(Report('run', inspection))


@pytest.mark.parametrize(
    ('later_s', 'level'), [(37, 'warn'), (-18.2, 'warn'), (3600, 'warn'), (-5e7 - 100, 'info')]
)
def test_known_differences_of_clocks_are_told_from_those_of_a_replay(rig, later_s, level):
    pose = rig['pose']
    later = replace(pose, stamps_ns=pose.stamps_ns + round(later_s * 1e9))
    (found,) = [one for one in inspected({'pose': later}).findings if one.name == 'clock_offset']
    assert found.level == level
    side = 'after' if later_s > 0 else 'before'
    assert f'{side} it was recorded' in found.message


@pytest.mark.parametrize('late_s', [0.1, 2.0, 4.5])
def test_an_estimator_may_take_its_time(rig, late_s):
    pose = rig['pose']
    assert (
        wrong(inspected(rig, pose=replace(pose, logged_ns=pose.logged_ns + round(late_s * 1e9))))
        == set()
    )


def test_a_transform_on_another_clock_is_found(rig):
    later_ns = rig['pose'].stamps_ns + 37 * 10**9
    inspection = inspected(rig, tf=as_transforms(replace(rig['pose'], stamps_ns=later_ns)))
    assert wrong(inspection) == {('clock_offset', '/tf')}


@pytest.mark.parametrize('skew_ms', [1, 5, -5, 20])
def test_a_constant_skew_is_measured(rig, skew_ms):
    camera = rig['cam1']
    shifted = replace(camera, stamps_ns=camera.stamps_ns + skew_ms * 1_000_000)
    inspection = inspected(rig, cam1=shifted)
    assert wrong(inspection) == {('camera_skew', '/cam0/image_raw, /cam1/image_raw')}
    assert the(inspection, 'camera_skew').value == pytest.approx(skew_ms / 1e3, abs=1e-5)


def test_a_skew_of_half_a_period_is_one(rig):
    camera = rig['cam1']
    inspection = inspected(rig, cam1=replace(camera, stamps_ns=camera.stamps_ns + 25_000_000))
    assert wrong(inspection) == {('camera_skew', '/cam0/image_raw, /cam1/image_raw')}
    assert abs(the(inspection, 'camera_skew').value) == pytest.approx(0.025, abs=1e-4)


def test_a_skew_that_changes_is_found(rig):
    camera = rig['cam1']
    late = 5_000_000 * (np.arange(len(camera)) > 450)
    found = the(
        inspected(rig, cam1=replace(camera, stamps_ns=camera.stamps_ns + late)), 'unsynchronised'
    )
    assert found.count == pytest.approx(298, abs=2)
    late = np.zeros(len(camera), np.int64)
    late[[100, 200, 300]] = 4_000_000
    found = the(
        inspected(rig, cam1=replace(camera, stamps_ns=camera.stamps_ns + late)), 'unsynchronised'
    )
    assert found.count == 6


def test_cameras_that_drift_apart_are_found_without_times_of_recording(rig):
    first = replace(rig['cam0'], logged_ns=None)
    drift = (first.stamps_ns - first.stamps_ns[0]) * 50 // 10**6
    second = replace(first, topic='/cam1', stamps_ns=first.stamps_ns + drift)
    inspection = inspect([first, second])
    assert wrong(inspection) == {('clock_drift', '/cam0/image_raw, /cam1')}
    assert the(inspection, 'clock_drift').value == pytest.approx(50, abs=1)


def test_frames_without_partner_are_counted_on_their_side(rig):
    inspection = inspected(rig, cam1=without(rig['cam1'], 100, 250))
    found = the(inspection, 'unsynchronised')
    assert found.count == 2
    assert '2 of /cam0/image_raw, 0 of /cam1/image_raw' in found.message
    assert [m.begin_ns for m in found.moments] == [
        int(rig['cam0'].stamps_ns[k]) for k in (100, 250)
    ]


@pytest.mark.parametrize('times', [2, 4])
@pytest.mark.parametrize('name', ['cam0', 'cam1'])
def test_cameras_of_different_rates_are_a_pair(rig, name, times):
    slow = kept(rig[name], np.arange(0, len(rig[name]), times))
    inspection = inspected(rig, **{name: slow})
    (pair,) = inspection.pairs
    assert pair.first == slow.topic
    assert pair.skew_s == pytest.approx(0, abs=1e-5)
    found = the(inspection, 'unsynchronised')
    # between the first and the last frame of the slow one
    assert found.count == pair.unsynchronised == (len(slow) - 1) * (times - 1)
    assert f'the rates are {20 // times} and 20 Hz' in found.message
    assert wrong(inspection) == {('unsynchronised', found.topic)}


def test_frames_without_partner_in_a_row_are_one_time_from_begin_to_end(rig):
    camera = rig['cam1']
    late = 5_000_000 * (np.arange(len(camera)) >= 340)
    report = Report('run', inspected(rig, cam1=replace(camera, stamps_ns=camera.stamps_ns + late)))
    found = the(report.inspection, 'unsynchronised')
    begin_ns, end_ns = found.moments[0].begin_ns, found.moments[0].end_ns
    assert end_ns - begin_ns == pytest.approx(13e9, abs=1e8)
    (line,) = [
        one for one in timeline(report)['data'] if one.get('mode') == 'lines' and any(one['x'])
    ]
    assert max(x for x in line['x'] if x is not None) == pytest.approx(30, abs=0.1)


def test_the_streams_are_all_there_in_a_narrow_window(rig):
    page = str(html_document(Report('run', inspected(rig))))
    table = page[page.index('Streams</h2>') :].partition('</table>')[0]
    assert 'overflow-x:auto' in table
    assert 'minor' not in table


def test_cameras_that_run_freely_are_reported(rig):
    camera = rig['cam1']
    elapsed = camera.stamps_ns - camera.stamps_ns[0]
    free = replace(camera, stamps_ns=camera.stamps_ns[0] + (elapsed * 1001) // 1000)
    found = the(inspected(rig, cam1=free), 'unsynchronised')
    assert 'the cameras run freely and drift by -1e+03 ppm' in found.message or (
        'the cameras run freely and drift by 1e+03 ppm' in found.message
    )
    assert found.value == 1.0


def test_duplicates_are_found(rig):
    order = np.sort(np.append(np.arange(len(rig['imu'])), [500, 501, 900]))
    inspection = inspected(rig, imu=kept(rig['imu'], order))
    assert wrong(inspection) == {('duplicate_stamps', '/imu0')}
    assert the(inspection, 'duplicate_stamps').count == 3


@pytest.mark.parametrize('off_ns', [1, 1000])
def test_frames_that_come_again_with_nearly_the_same_stamp_are_duplicates(rig, off_ns):
    order = np.sort(np.append(np.arange(600), np.arange(100, 120)))
    again = kept(rig['cam0'], order)
    stamps_ns = again.stamps_ns + off_ns * np.append(False, np.diff(order) == 0)
    inspection = inspected(rig, cam0=replace(again, stamps_ns=stamps_ns))
    assert wrong(inspection) == {('duplicate_stamps', '/cam0/image_raw')}
    found = the(inspection, 'duplicate_stamps')
    assert found.count == 20
    assert 'or one that is off by up to' in found.message
    assert found.moments[0].begin_ns == rig['cam0'].stamps_ns[100]


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
    assert (found.count, found.level) == (9, 'fail')  # the first repeats nothing
    assert found.moments[0].begin_ns == rig['imu'].stamps_ns[2000]


@pytest.mark.parametrize(
    ('axes', 'part', 'words'),
    [
        (slice(0, 3), slice(2000, 2200), '199 samples repeat the one before in the gyroscope'),
        (slice(3, 6), slice(2000, 2200), '199 samples repeat the one before in the accelerometer'),
        (slice(1, 2), slice(2000, None), '3999 samples repeat the one before in gyroscope y'),
        (slice(0, 6), slice(2000, None), '3999 samples repeat the one before in all six axes'),
    ],
)
def test_an_imu_that_is_partly_stuck_is_one_fault(rig, axes, part, words):
    numbers = rig['imu'].numbers.copy()
    numbers[part, axes] = numbers[2000, axes]
    inspection = inspected(rig, imu=replace(rig['imu'], numbers=numbers))
    assert wrong(inspection) == {('stuck', '/imu0')}
    assert the(inspection, 'stuck').message.startswith(words)


@pytest.mark.parametrize(
    ('axes', 'begin', 'end', 'words'),
    [
        ([0], 2000, 2200, '199 samples repeat the one before in gyroscope x,'),
        ([5], 1000, 5000, '3999 samples repeat the one before in accelerometer z,'),
        ([0, 2], 2000, 4000, '1999 samples repeat the one before in gyroscope x, gyroscope z,'),
    ],
)
@pytest.mark.parametrize('value', [None, 0.0])
def test_an_axis_that_is_stuck_and_comes_back_is_found(rig, axes, begin, end, words, value):
    numbers = rig['imu'].numbers.copy()
    numbers[begin:end, axes] = numbers[begin, axes] if value is None else value
    inspection = inspected(rig, imu=replace(rig['imu'], numbers=numbers))
    assert wrong(inspection) == {('stuck', '/imu0')}
    found = the(inspection, 'stuck')
    assert found.message.startswith(words)
    assert found.moments[0].begin_ns == rig['imu'].stamps_ns[begin]


@pytest.mark.parametrize('width', [0.01, 0.04])
def test_a_coarse_axis_that_hardly_moves_is_not_stuck(rig, width):
    numbers = rig['imu'].numbers.copy()
    source = np.random.default_rng(5)
    slow = 0.02 * np.sin(np.arange(len(numbers)) / 300) + source.normal(0, 1e-4, len(numbers))
    numbers[:, 0] = np.round(slow / width) * width + width * (np.arange(len(numbers)) == 3000)
    found = wrong(inspected(rig, imu=replace(rig['imu'], numbers=numbers)))
    assert found == set()


def test_samples_that_are_sent_twice_are_warned_of(rig):
    numbers = rig['imu'].numbers.copy()
    numbers[1::2] = numbers[::2]
    found = the(inspected(rig, imu=replace(rig['imu'], numbers=numbers)), 'stuck')
    assert (found.level, found.count) == ('warn', 3000)


@pytest.mark.parametrize('moves', [True, False])
@pytest.mark.parametrize('steps', [(0.004, 0.038), (0.0175, 0.038)])
def test_a_coarse_imu_is_not_stuck(rig, steps, moves):
    numbers = rig['imu'].numbers
    if not moves:
        source = np.random.default_rng(8)
        numbers = source.normal(0, [0.003] * 3 + [0.009] * 3, numbers.shape)
        numbers += [0, 0, 0, 0, 0, 9.81]
    width = np.repeat(steps if moves else (0.004, 0.038), 3)
    coarse = replace(rig['imu'], numbers=np.round(numbers / width) * width)
    assert wrong(inspected(rig, imu=coarse)) == set()


HALVES = {'gyroscope': slice(0, 3), 'accelerometer': slice(3, 6)}


@pytest.mark.parametrize('name', HALVES)
def test_half_an_imu_is_not_judged_by_the_other_half(rig, name):
    numbers = rig['imu'].numbers.copy()
    numbers[:, HALVES[name]] = 0
    half = replace(rig['imu'], numbers=numbers)
    assert wrong(inspected(rig, imu=replace(half, lacks=(name,)))) == set()
    found = the(inspected(rig, imu=half), 'stuck')
    assert found.level == 'fail'
    assert found.message.startswith(f'the {name} is zero throughout')


def test_an_imu_with_a_topic_for_each_sensor_is_whole(rig):
    parts = {}
    for name, axes in HALVES.items():
        numbers = rig['imu'].numbers.copy()
        numbers[:, axes] = 0
        parts[name] = replace(rig['imu'], topic=f'/without_{name}', numbers=numbers)
    assert wrong(inspected({k: s for k, s in rig.items() if k != 'imu'}, **parts)) == set()
    assert ('stuck', '/without_gyroscope') in wrong(inspected(rig, half=parts['gyroscope']))


def test_half_an_imu_is_told_of_by_what_it_measures(rig):
    at_rest = rig['imu'].numbers * 1e-9 + [0, 0, 0, 0, 0, 9.81]
    for name, axes in HALVES.items():
        numbers = at_rest.copy()
        numbers[:, axes] = 0
        half = replace(rig['imu'], numbers=numbers, lacks=(name,))
        shown = text_document(Report('run', inspected(rig, imu=half)))
        assert f'has no {name}' in shown
        assert 'nan' not in shown
        assert 'low_excitation /imu0: it ' in shown


@pytest.mark.parametrize('length', [1, 3])
@pytest.mark.parametrize(
    ('axis', 'size', 'level'), [(4, 500.0, 'fail'), (4, -40.0, 'warn'), (0, 50.0, 'fail')]
)
def test_spikes_are_found_at_their_moment(rig, axis, size, level, length):
    numbers = rig['imu'].numbers.copy()
    for begin in (2000, 5000):
        numbers[begin : begin + length, axis] = size  # which is no limit either
    inspection = inspected(rig, imu=replace(rig['imu'], numbers=numbers))
    assert wrong(inspection) == {('spike', '/imu0')}
    found = the(inspection, 'spike')
    assert (found.count, found.level) == (2 * length, level)
    assert found.value == pytest.approx(abs(size), abs=3)
    begins = [moment.begin_ns for moment in found.moments]
    assert begins == [int(rig['imu'].stamps_ns[k]) for k in (2000, 5000)]


def test_a_shock_that_rings_is_no_spike(rig):
    elapsed = np.arange(20) / 200
    ring = 60 * np.exp(-elapsed / 0.02) * np.cos(2 * np.pi * 40 * elapsed)
    numbers = rig['imu'].numbers.copy()
    numbers[3000:3020, 3:] += np.outer(ring, [0.5, 0.2, 1])
    assert wrong(inspected(rig, imu=replace(rig['imu'], numbers=numbers))) == set()


def held(seed: int, fastest_rad_s: float = 0.1) -> SensorStream:
    """Return an IMU that is turned and moved by hand: both of its sensors are in one motion."""
    source, elapsed = np.random.default_rng(seed), np.arange(0, 60, 0.01)
    waves = [
        np.sin(
            2 * np.pi * np.outer(elapsed, source.uniform(low, high, 3)) + source.uniform(0, 6, 3)
        )
        for low, high in ((0.05, 0.2), (0.3, 0.9))
    ]
    rates, accelerations = fastest_rad_s * waves[0], 0.5 * waves[1]
    attitude = [np.array([0.0, 0.0, 0.0, 1.0])]
    for step in rotation.from_rotation_vector(rates / 100)[:-1]:
        attitude.append(rotation.multiply(attitude[-1], step))
    forces = rotation.rotate(
        rotation.conjugate(np.array(attitude)), accelerations + np.array([0, 0, 9.81])
    )
    numbers = np.hstack([rates, forces])
    numbers += source.normal(0, [0.003] * 3 + [0.03] * 3, numbers.shape)
    stamps_ns = FIRST_NS + np.arange(len(elapsed)) * 10_000_000
    return SensorStream('/imu0', IMU, 'imu', stamps_ns + 4_000_000, stamps_ns, {}, numbers)


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(5))
def test_rates_in_degrees_are_recognised_by_how_gravity_rotates(seed):
    imu = held(seed)
    assert wrong(inspect([imu])) == set()
    degrees = imu.numbers * np.repeat([np.degrees(1), 1], 3)
    # so slow that no rate looks odd by itself
    assert np.median(np.linalg.norm(degrees[:, :3], axis=1)) < 10
    found = the(inspect([replace(imu, numbers=degrees)]), 'units')
    assert 'gravity rotates 57 times slower' in found.message
    fast = held(seed, 1.0)
    fast = replace(fast, numbers=fast.numbers * np.repeat([np.degrees(1), 1], 3))
    assert 'half of the time' in the(inspect([fast]), 'units').message  # and is told once
    bias = replace(imu, numbers=imu.numbers + np.repeat([0.3, 0], 3))
    assert 'units' not in {name for name, _ in wrong(inspect([bias]))}


@pytest.mark.slow
@pytest.mark.parametrize('axis', [0, 1])
@pytest.mark.parametrize('seed', range(3))
def test_a_step_of_the_bias_is_found(seed, axis):
    imu = held(seed)
    numbers = imu.numbers.copy()
    numbers[3200:, axis] += 0.1
    found = the(inspect([replace(imu, numbers=numbers)]), 'bias_step')
    assert found.value == pytest.approx(0.1, rel=0.3)
    assert abs(found.moments[0].begin_ns - imu.stamps_ns[3200]) < 5e9
    # a scale that is off, or a bias that never was zero, is no step
    numbers = imu.numbers * np.repeat([1.02, 1], 3) + np.repeat([0.05, 0], 3)
    assert wrong(inspect([replace(imu, numbers=numbers)])) == set()


def test_a_gap_does_not_hide_a_step_of_the_bias():
    imu = held(1)
    numbers = imu.numbers.copy()
    numbers[3200:, 0] += 0.1
    gap = kept(replace(imu, numbers=numbers), np.r_[0:1000, 1015:6000])
    assert the(inspect([gap]), 'bias_step').value == pytest.approx(0.1, rel=0.3)
    # nor is it one
    assert 'bias_step' not in {n for n, _ in wrong(inspect([kept(imu, np.r_[0:1000, 1015:6000])]))}


def driven(seed: int) -> SensorStream:
    """Return the IMU of a car: it accelerates for seconds, which is not distinct from a tilt."""
    source, elapsed = np.random.default_rng(seed), np.arange(0, 300, 0.02)

    def smooth(over_s: float) -> np.ndarray:
        frequencies = np.fft.rfftfreq(len(elapsed), 0.02)
        kept = np.exp(-0.5 * (2 * np.pi * frequencies * over_s) ** 2)
        values = np.fft.irfft(kept * np.fft.rfft(source.normal(size=len(elapsed))), len(elapsed))
        return values / values.std()

    speed, tips = 8 + 3 * smooth(6), 0.01 * smooth(0.3)
    rate = 0.25 * smooth(2.5) * speed / 8
    columns = [tips, tips, rate, np.gradient(speed, elapsed), speed * rate, 9.81 + 0 * rate]
    numbers = np.stack(columns, axis=1)
    numbers += source.normal(0, [0.003] * 3 + [0.05] * 3, numbers.shape)
    stamps_ns = FIRST_NS + np.arange(len(elapsed)) * 20_000_000
    return SensorStream('/imu0', IMU, 'imu', stamps_ns + 4_000_000, stamps_ns, {}, numbers)


@pytest.mark.slow
def test_a_car_that_accelerates_has_no_step_of_the_bias():
    cars = [driven(seed) for seed in range(40)]
    assert [wrong(inspect([car])) for car in cars] == [set()] * 40
    for car in cars[:5]:
        numbers = car.numbers + 0.3 * np.outer(np.arange(len(car)) > 7000, [1, 0, 0, 0, 0, 0])
        assert the(inspect([replace(car, numbers=numbers)]), 'bias_step').value > 0.2


def test_turning_gravity_is_no_acceleration(rig):
    elapsed = np.arange(len(rig['imu'])) / 200
    roll, pitch = 0.6 * np.sin(1.9 * elapsed), 0.6 * np.sin(1.3 * elapsed + 1)
    force = np.stack(
        [-np.sin(roll), np.cos(roll) * np.sin(pitch), np.cos(roll) * np.cos(pitch)], axis=1
    )
    rates = np.stack([np.gradient(pitch, elapsed), np.gradient(roll, elapsed), 0 * roll], axis=1)
    noise = np.random.default_rng(2).normal(0, [0.003] * 3 + [0.03] * 3, (len(elapsed), 6))
    numbers = np.hstack([rates, 9.81 * force]) + noise
    inspection = inspected(rig, imu=replace(rig['imu'], numbers=numbers))
    felt = next(e.inertial for e in inspection.streams if e.inertial)
    assert felt.acceleration_m_s2 < 0.05
    assert 'low_excitation' in {one.name for one in inspection.findings}


@pytest.mark.parametrize(('axis', 'limit'), [(0, 0.4), (5, 11.0)])
def test_saturation_is_found_with_its_limit(rig, axis, limit):
    numbers = rig['imu'].numbers.copy()
    numbers[:, axis] = np.minimum(numbers[:, axis], limit)
    found = the(inspected(rig, imu=replace(rig['imu'], numbers=numbers)), 'saturation')
    assert found.value == limit
    assert found.count == np.count_nonzero(numbers[:, axis] == limit)


@pytest.mark.parametrize(('axis', 'limit'), [(1, 0.3), (5, 11.0)])
def test_an_axis_that_is_cut_off_until_the_end_is_not_stuck_as_well(rig, axis, limit):
    numbers = rig['imu'].numbers.copy()
    numbers[-200:, axis] += 10  # above the limit throughout
    numbers[:, axis] = np.minimum(numbers[:, axis], limit)
    inspection = inspected(rig, imu=replace(rig['imu'], numbers=numbers))
    assert wrong(inspection) == {('saturation', '/imu0')}


def test_a_coarse_sensor_is_not_saturated(rig):
    numbers = np.round(rig['imu'].numbers / [0.004] * 1) * 0.004
    numbers += 1e-7 * np.arange(len(numbers))[:, None] % 2  # so that nothing is stuck
    assert 'saturation' not in {
        n for n, _ in wrong(inspected(rig, imu=replace(rig['imu'], numbers=numbers)))
    }


def test_other_units_of_acceleration_are_reported(rig):
    for scale in (1000 / 9.81, 100):
        numbers = rig['imu'].numbers * ([1] * 3 + [scale] * 3)
        found = the(inspected(rig, imu=replace(rig['imu'], numbers=numbers)), 'units')
        assert 'in mg or cm/s2' in found.message
    swapped = replace(rig['imu'], numbers=rig['imu'].numbers[:, [3, 4, 5, 0, 1, 2]])
    assert 'exchanged' in the(inspected(rig, imu=swapped), 'units').message


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
    assert found.count == 49
    assert found.moments[0].begin_ns == pose.stamps_ns[1000]
    numbers = pose.numbers.copy()
    numbers[2900:] = numbers[2900]
    assert the(inspected(rig, pose=replace(pose, numbers=numbers)), 'frozen').count == 99
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


def test_a_yaw_that_flips_is_a_jump(rig):
    numbers = rig['pose'].numbers.copy()
    yaw = 2 * np.arctan2(numbers[:, 5], numbers[:, 6]) + np.pi / 2 * (
        np.arange(len(numbers)) >= 900
    )
    numbers[:, 5:] = np.stack([np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)
    found = the(inspected(rig, pose=replace(rig['pose'], numbers=numbers)), 'jump')
    assert (found.value, found.unit) == (pytest.approx(np.pi / 2, abs=0.01), 'rad')
    assert [m.end_ns for m in found.moments] == [rig['pose'].stamps_ns[900]]


def test_poses_that_should_be_regular_are_warned_of(rig):
    pose = rig['pose']
    assert wrong(inspected(rig, pose=without(pose, 100, 101, 300))) == {('dropped', pose.topic)}
    late = np.random.default_rng(3).uniform(-1.2e6, 1.2e6, len(pose)).astype(np.int64)
    late = replace(pose, stamps_ns=pose.stamps_ns + late)
    assert wrong(inspected(rig, pose=late)) == {('jitter', pose.topic)}


def test_implausible_poses_are_found(rig):
    pose = rig['pose']
    fast = replace(pose, numbers=pose.numbers * ([1000] * 3 + [1] * 4))
    assert ('implausible_motion', pose.topic) in wrong(inspected(rig, pose=fast))
    long = replace(pose, numbers=pose.numbers * ([1] * 3 + [2] * 4))
    assert wrong(inspected(rig, pose=long)) == {('quaternion_norm', pose.topic)}
    nan = pose.numbers.copy()
    nan[7] = np.nan
    assert wrong(inspected(rig, pose=replace(pose, numbers=nan))) == {('not_finite', pose.topic)}


@pytest.mark.parametrize('quaternion', [[0, 0, 0, 0], [0, 0, 0, 1], [np.nan] * 4])
def test_poses_that_carry_positions_only_are_called_so(rig, quaternion):
    numbers = rig['pose'].numbers.copy()
    numbers[:, 3:] = quaternion
    inspection = inspected(rig, pose=replace(rig['pose'], numbers=numbers))
    assert not wrong(inspection)
    (found,) = [one for one in inspection.findings if one.name == 'positions_only']
    assert (found.level, found.count) == ('info', len(numbers))
    assert 'normalise' not in found.advice


def test_one_of_something_is_counted_in_the_singular(rig):
    nan = rig['imu'].numbers.copy()
    nan[7] = np.nan
    inspection = inspected(rig, imu=replace(rig['imu'], numbers=nan))
    assert the(inspection, 'not_finite').message == '1 sample is not finite'
    long = rig['pose'].numbers.copy()
    long[9, 3:] *= 2
    inspection = inspected(rig, pose=replace(rig['pose'], numbers=long))
    assert the(inspection, 'quaternion_norm').message.startswith('1 quaternion is not of length 1')


def test_headers_are_checked(rig):
    named = replace(rig['cam0'], frames={'cam0': 599, 'camera': 1})
    assert wrong(inspected(rig, cam0=named)) == {('frame_ids', '/cam0/image_raw')}
    stamps_ns = rig['imu'].stamps_ns.copy()
    stamps_ns[3] = 0
    found = wrong(inspected(rig, imu=replace(rig['imu'], stamps_ns=stamps_ns)))
    assert found == {('unstamped', '/imu0'), ('dropped', '/imu0')}
    inspection = inspected(rig, imu=replace(rig['imu'], stamps_ns=0 * stamps_ns))
    assert wrong(inspection) == {('unstamped', '/imu0')}


def test_poses_that_were_never_stamped_are_said_to_have_a_time_all_the_same(rig):
    never = replace(rig['pose'], stamps_ns=0 * rig['pose'].stamps_ns)
    for stream in (never, as_transforms(never)):
        found = the(inspected({'pose': stream}, imu=rig['imu']), 'unstamped')
        first_s, last_s = stream.logged_ns[0] / 1e9, stream.logged_ns[-1] / 1e9
        assert f'recorded from {first_s:.2f} to {last_s:.2f} s' in found.message
        assert '?stamps=recorded' in found.message
    static = replace(as_transforms(never), topic='/tf_static')
    assert wrong(inspected({'pose': static}, imu=rig['imu'])) == set()


def test_poses_of_two_publishers_are_found(rig):
    pose = rig['pose']
    numbers = pose.numbers.copy()
    numbers[1::2, 0] += 2.0
    mixed = replace(pose, numbers=numbers)
    for stream, name in ((mixed, ''), (as_transforms(mixed), 'map.base: ')):
        inspection = inspected(rig, pose=stream)
        found = the(inspection, 'two_publishers')
        assert found.topic == stream.topic
        assert found.message.startswith(f'{name}poses of two trajectories, 2 m apart, take turns')
        assert found.value == pytest.approx(2.0, rel=0.02)
        (moment,) = found.moments
        assert moment.end_ns - moment.begin_ns > 25e9
    assert 'transforms             /tf: map.base (3000)' in text_document(Report('r', inspection))


def test_poses_that_two_publishers_send_alike_are_told_of(rig):
    pose = rig['pose']
    twice = kept(pose, np.repeat(np.arange(len(pose)), 2))
    late_ns = np.tile([0, 400_000], len(pose))
    twice = replace(
        twice, stamps_ns=twice.stamps_ns + late_ns, logged_ns=twice.logged_ns + late_ns
    )
    found = [one for one in inspected(rig, pose=twice).findings if one.name == 'two_publishers']
    assert [(one.level, one.count) for one in found] == [('info', len(pose))]
    assert found[0].message.startswith('3000 of 6000 poses repeat the one before')


def test_of_many_transforms_the_first_are_listed(rig):
    stream = as_transforms(rig['pose'])
    many = {f'base.wheel_{k:02}': stream.transforms['map.base'][:2] for k in range(25)}
    shown = text_document(Report('run', inspected({'tf': replace(stream, transforms=many)})))
    assert 'base.wheel_19 (2) and 5 more' in shown


def test_simulated_time_may_begin_with_zero(rig):
    first = min(int(stream.stamps_ns.min()) for stream in rig.values())
    simulated = {
        name: replace(
            s, stamps_ns=s.stamps_ns - s.stamps_ns[0] if name == 'imu' else s.stamps_ns - first
        )
        for name, s in rig.items()
    }
    assert simulated['imu'].stamps_ns[0] == 0
    assert wrong(inspect(list(simulated.values()))) == set()


@pytest.mark.parametrize(
    ('name', 'level'), [('cam1', 'fail'), ('imu', 'fail'), ('pose', 'warn'), ('other', 'info')]
)
def test_a_topic_without_messages_is_silent(rig, name, level):
    rig['other'] = replace(rig['cam0'], topic='/info', kind='other')
    inspection = inspected(rig, **{name: kept(rig[name], np.arange(0))})
    (found,) = [one for one in inspection.findings if one.name == 'silent']
    assert (found.topic, found.level) == (rig[name].topic, level)
    shown = text_document(Report('run', inspection))
    assert [line for line in shown.splitlines() if rig[name].topic in line.split()[1:2]]


def test_nothing_is_worse_than_info_in_what_no_estimator_takes(rig):
    drift = (rig['imu'].stamps_ns - rig['imu'].stamps_ns[0]) // 10**4
    late = replace(rig['imu'], logged_ns=rig['imu'].logged_ns + drift, numbers=None)
    late = replace(late, topic='/tf', kind='other')
    latched = replace(kept(late, np.arange(1)), topic='/tf_static')
    found = inspected(rig, tf=late, latched=latched).findings
    assert [(one.name, one.level, one.topic) for one in found] == [('clock_drift', 'info', '/tf')]


def test_what_was_left_out_is_reported(rig):
    inspection = inspect(list(rig.values()), ['/lidar is serialised as protobuf'])
    assert [one.name for one in inspection.findings] == ['left_out']


@pytest.mark.parametrize('count', [1, 2, 3])
def test_a_few_messages_are_enough_to_say_so(rig, count):
    few = {name: kept(stream, np.arange(count)) for name, stream in rig.items()}
    assert wrong(inspect(list(few.values()))) == set()


TYPES = {
    '/cam0': ('sensor_msgs/msg/Image', 'camera', None),
    '/cam1': ('sensor_msgs/msg/CompressedImage', 'camera', None),
    '/imu': ('sensor_msgs/msg/Imu', 'imu', 6),
    '/point': ('geometry_msgs/msg/PointStamped', 'pose', 3),
    '/pose': ('geometry_msgs/msg/PoseStamped', 'pose', 7),
    '/log': ('rcl_interfaces/msg/Log', 'other', None),
}
TIMES = st.integers(0, 2**62) | st.integers(0, 50).map(lambda k: k * 10**8)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(TIMES, TIMES), min_size=1, max_size=60), st.integers(0, 2**32 - 1))
def test_no_stamps_and_no_numbers_are_too_strange(times, seed):
    source = np.random.default_rng(seed)
    odd = [0.0, 1.0, np.nan, np.inf, -1e300, 1e-300]
    streams = []
    for topic, (msgtype, kind, width) in TYPES.items():
        some = np.array(times, np.int64)[: source.integers(1, len(times) + 1)]
        numbers = None if width is None else source.choice(odd, (len(some), width))
        streams.append(
            SensorStream(topic, msgtype, kind, np.sort(some[:, 0]), some[:, 1], {}, numbers)
        )
    report = Report('odd', inspect(streams))
    assert json.loads(json_document(report))['schema'] == 'vio_eval_ros.inspection/1'
    assert all(topic in text_document(report) for topic in TYPES)
    figures = [timeline(report)]
    figures += [period_over_time(e, 0) for e in report.streams if len(e.timing.periods_s)]
    json.dumps(figures, allow_nan=False)


def test_all_plots_begin_where_the_recording_does(rig):
    late = kept(rig['imu'], np.arange(2000, len(rig['imu'])))
    report = Report('run', inspected(rig, imu=without(late, *range(1000, 1100))))
    imu = next(e for e in report.streams if e.stream is late or e.stream.kind == 'imu')
    holes = timeline(report)['data'][1]
    regular, beyond = period_over_time(imu, report.inspection.begin_ns)['data']
    assert regular['x'][0] == pytest.approx(10, abs=0.1)
    assert beyond['x'] == pytest.approx([holes['base'][0] + holes['x'][0]], abs=1e-3)
