"""Where stamps were never set, the time of recording may take their place, when asked for."""

import pytest

from recorded import KINDS, LATENCY_NS, odometry, pose, stamp, STEP_NS, Stream, transform, write
from verbs import complaint, document
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.sources import read_sources

TRUTH = '/vicon/pose'
POSE = 'geometry_msgs/msg/PoseStamped'
TF = 'tf2_msgs/msg/TFMessage'
TF_DEFINITION = {TF: 'geometry_msgs/TransformStamped[] transforms'}


def unstamped(count=60):
    return Stream(TRUTH, POSE, [{'pose': pose(k)} for k in range(count)])


def transforms(count=60):
    messages = [
        {
            'transforms': [
                {
                    'header': {'frame_id': 'odom'},
                    'child_frame_id': 'base_link',
                    'transform': transform(k),
                }
            ]
        }
        for k in range(count)
    ]
    return Stream('/tf', TF, messages, TF_DEFINITION)


@pytest.fixture(params=KINDS)
def path(request, tmp_path):
    return write(tmp_path / 'run', request.param, odometry(), unstamped(), transforms())


@pytest.mark.parametrize('spec', [TRUTH, '/tf:odom.base_link'])
def test_stamps_that_were_never_set_are_refused_with_what_to_write(path, spec):
    with pytest.raises(ReadError) as refused:
        read_sources([spec], path)
    assert 'the stamp of every message is 0: it was never set' in str(refused.value)
    assert str(refused.value).endswith(f'write {spec}?stamps=recorded')


@pytest.mark.parametrize('spec', [TRUTH, '/tf:odom.base_link'])
def test_the_time_of_recording_takes_the_place_of_stamps(path, spec):
    (source,) = read_sources([f'{spec}?stamps=recorded'], path)
    assert source.stamps_ns.tolist() == [stamp(k) + LATENCY_NS for k in range(60)]
    assert any('the time at which it was recorded' in line for line in source.warnings)
    found = document(
        'replay', path, '--estimate', '/vio/odometry', '--ground-truth', f'{spec}?stamps=recorded'
    )
    assert found['association']['pairs'] == 60
    assert any('the time at which it was recorded' in line for line in found['warnings'])


def test_stamps_that_are_sound_can_be_replaced_too(path):
    by_header, recorded, stated = read_sources(
        ['/vio/odometry', '/vio/odometry?stamps=recorded', '/vio/odometry?stamps=header'], path
    )
    assert set(recorded.stamps_ns - by_header.stamps_ns) == {LATENCY_NS}
    assert recorded.positions.tolist() == by_header.positions.tolist()
    assert stated.stamps_ns.tolist() == by_header.stamps_ns.tolist()
    assert not by_header.warnings
    assert not stated.warnings


def test_the_only_pair_of_a_recording_is_refused_alike(tmp_path):
    path = write(tmp_path / 'run', 'mcap', odometry(), unstamped())
    assert f'write {TRUTH}?stamps=recorded' in complaint('replay', path)
    assert f'write {TRUTH}?stamps=recorded' in complaint('diagnose', path)


def test_stamps_that_never_change_are_no_stamps(tmp_path):
    same = {'stamp': {'sec': 1_700_000_000, 'nanosec': 0}}
    messages = [{'header': same, 'pose': pose(k)} for k in range(9)]
    path = write(tmp_path / 'run', 'mcap', Stream(TRUTH, POSE, messages))
    with pytest.raises(
        ReadError, match=r'every message is the same, 1700000000.000 s; .*recorded'
    ):
        read_sources([TRUTH], path)


def test_a_few_stamps_of_zero_are_dropped_as_ever(tmp_path):
    late = [{'sec': 0, 'nanosec': 0}] * 5 + [{'sec': 1, 'nanosec': k} for k in range(9)]
    messages = [{'header': {'stamp': when}, 'pose': pose(k)} for k, when in enumerate(late)]
    path = write(tmp_path / 'run', 'mcap', Stream(TRUTH, POSE, messages))
    (source,) = read_sources([TRUTH], path)
    assert (len(source), source.poses.zero_is_unset) == (14, True)


def test_messages_recorded_at_one_time_have_no_time_either(tmp_path):
    stream = unstamped(9)._replace(logged_ns=[stamp(0)] * 9)
    path = write(tmp_path / 'run', 'mcap', stream)
    with pytest.raises(ReadError, match='all its messages were recorded at the same time'):
        read_sources([f'{TRUTH}?stamps=recorded'], path)


def test_a_path_has_many_stamps_in_each_message(tmp_path):
    messages = [{'poses': [{'pose': pose(k)}]} for k in range(3)]
    path = write(tmp_path / 'run', 'mcap', Stream('/path', 'nav_msgs/msg/Path', messages))
    with pytest.raises(ConfigError, match='stamps=recorded does not apply to a Path'):
        read_sources(['/path?stamps=recorded'], path)


def test_units_are_stated_of_files_and_clocks_of_topics(tmp_path):
    with pytest.raises(ConfigError, match=r"stamps must be header or recorded, not 's'"):
        read_sources(['/topic?stamps=s'], tmp_path)
    with pytest.raises(ConfigError, match=r"stamps must be s or ms or us or ns, not 'recorded'"):
        read_sources(['est.txt?stamps=recorded'])


def test_two_readings_of_one_transform_do_not_meet(tmp_path):
    moving = transforms()
    for k, message in enumerate(moving.messages):
        message['transforms'][0]['header']['stamp'] = {'sec': 5, 'nanosec': k * STEP_NS // 1000}
    path = write(tmp_path / 'run', 'mcap', moving)
    spec = '/tf:odom.base_link'
    stamped, recorded = read_sources([spec, f'{spec}?stamps=recorded'], path)
    assert stamped.stamps_ns[0] == 5_000_000_000
    assert recorded.stamps_ns[0] == stamp(0) + LATENCY_NS
