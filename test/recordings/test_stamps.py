"""What stamps show of how they were written: lost zeros, whole seconds, runs at the same time."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from recorded_poses import poses as messages_of
from recorded_poses import STORE
from verbs import complaint, document
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.recordings.stamps import run_starts
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate

RUN = simulate(duration_s=12.0)
START_S = 1_700_000_000


def write(path: Path, stamps: Iterable[str]) -> Path:
    """Write the simulated estimate, as far as there are stamps, with other stamps."""
    rows = tum(RUN.estimate).splitlines()[1:]
    lines = (f'{stamp} {row.split(" ", 1)[1]}\n' for stamp, row in zip(stamps, rows, strict=False))
    path.write_text(''.join(lines))
    return path


def read(spec: object):
    return read_sources([str(spec)])[0]


def poses(stamps_s: Iterable[float]) -> Poses:
    stamps_ns = np.round(np.asarray(list(stamps_s)) * 1e9).astype(np.int64)
    return Poses(stamps_ns, np.zeros((len(stamps_ns), 3)))


@pytest.mark.parametrize(
    ('parts', 'step', 'first'),
    [(10**9, 50_000_000, 3_000_000), (10**6, 50_000, 1), (10**3, 50, 0), (10**9, 4_999_999, 7)],
)
def test_zeros_that_fractions_lost_are_put_back_and_said(tmp_path, parts, step, first):
    ticks = [START_S * parts + first + k * step for k in range(200)]
    digits = len(str(parts)) - 1
    meant = write(tmp_path / 'meant.txt', (f'{t // parts}.{t % parts:0{digits}d}' for t in ticks))
    lost = write(tmp_path / 'lost.txt', (f'{t // parts}.{t % parts}' for t in ticks))
    assert read(lost).stamps_ns.tolist() == read(meant).stamps_ns.tolist()
    assert 'lost their leading zeros' in read(lost).warnings[0]
    assert read(meant).warnings == ()


@pytest.mark.parametrize('step', [0.05, 0.1, 0.0123, 1 / 30])
def test_fractions_that_lost_zeros_at_their_end_are_right(tmp_path, step):
    stamps = [START_S + k * step for k in range(200)]
    stamps[100], stamps[101] = stamps[101], stamps[100]  # one came late
    source = read(write(tmp_path / 'est.txt', map(repr, stamps)))
    assert source.warnings == ()
    assert source.stamps_ns.tolist() == pytest.approx([s * 1e9 for s in stamps], abs=500)


@pytest.mark.parametrize('form', ['{:.0f}', '{:.8g}'])
def test_stamps_in_whole_seconds_are_refused(tmp_path, form):
    path = write(tmp_path / 'est.txt', (form.format(START_S + k / 20) for k in range(200)))
    with pytest.raises(ReadError, match=r'stamp of the pose before.*too few digits'):
        read(path)


def test_the_same_pose_written_twice_is_no_matter_of_digits(tmp_path):
    path = write(tmp_path / 'est.txt', (f'{START_S + k / 20:.3f}' for k in range(100)))
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(''.join(line for line in lines for _ in range(2)))
    assert len(read(path)) == 200


@pytest.mark.parametrize('shift_s', [0.0, 0.01, 3.0, -2.0])
@pytest.mark.parametrize('share', [1.0, 0.4])
def test_a_second_run_over_the_same_time_begins_where_stamps_jump_back(shift_s, share):
    first = np.arange(0.0, 20.0, 0.1)
    second = first[: int(len(first) * share)] + shift_s
    if second[-1] > 1:
        assert run_starts(poses([*first, *second])) == [0, len(first)]
        assert run_starts(poses([*first, *second, *first])) == [0, 200, 200 + len(second)]


def test_a_part_that_is_there_twice_with_other_stamps_is_a_run():
    assert run_starts(poses([*np.arange(10.0, 20.0, 0.1), *np.arange(0.01, 14.0, 0.1)])) == [
        0,
        100,
    ]


def test_a_short_first_run_is_one_too():
    assert run_starts(poses([0, 0.1, 0.2, 0.3, *np.arange(0.02, 20.0, 0.1)])) == [0, 4]


def test_a_clock_that_was_set_back_begins_a_run():
    assert run_starts(poses([*np.arange(0, 10, 0.01), *np.arange(9.5, 20, 0.01)])) == [0, 1000]


@pytest.mark.parametrize(
    'stamps_s',
    [
        np.arange(0.0, 20.0, 0.1),
        [*np.arange(12.0, 20.0, 0.1), *np.arange(0.0, 8.0, 0.1)],  # sessions, the later one first
        [*np.arange(8.0, 12.0, 0.1), *np.arange(14.0, 20.0, 0.1), *np.arange(0.0, 8.0, 0.1)],
        [*np.arange(0, 4, 0.1), *np.arange(8, 12, 0.1), *np.arange(4, 8, 0.1)],  # a part late
        np.arange(200).reshape(-1, 2)[:, ::-1].ravel() / 10,  # each two exchanged
        np.random.default_rng(1).permutation(200) / 10,  # in no order at all
        sorted(np.arange(200) / 10, key=str),  # ordered as text
        [*np.arange(0.0, 10.0, 0.1), 9.05, 9.15, *np.arange(10.0, 20.0, 0.1)],  # two late
    ],
)
def test_sessions_and_late_poses_are_one_run(stamps_s):
    assert run_starts(poses(stamps_s)) == [0]


def test_stamps_that_were_never_set_begin_no_run():
    stamps = np.arange(0.0, 20.0, 0.1) + START_S
    stamps[10:100:10] = 0.0
    unset = Poses(np.int64(stamps * 1e9), np.zeros((200, 3)), zero_is_unset=True)
    assert run_starts(unset) == [0]


@pytest.fixture
def appended(tmp_path) -> Path:
    """Write gt.txt, est.txt, and both.txt: a bad run and then the one of est.txt."""
    (tmp_path / 'gt.txt').write_text(tum(RUN.ground_truth))
    good = tum(RUN.estimate)
    (tmp_path / 'est.txt').write_text(good)
    words = [line.split() for line in good.splitlines()[1:]]
    bad = ''.join(' '.join([w[0], str(2 * float(w[1])), *w[2:]]) + '\n' for w in words)
    (tmp_path / 'both.txt').write_text(bad + good)
    return tmp_path


def inputs(folder: Path, estimate: str) -> list[str]:
    return ['--estimate', f'{folder}/{estimate}', '--ground-truth', f'{folder}/gt.txt']


@pytest.mark.parametrize('verb', ['replay', 'diagnose'])
def test_two_runs_in_one_file_are_refused_with_where_and_how_to_choose(appended, verb):
    said = complaint(verb, *inputs(appended, 'both.txt'))
    count = len(RUN.estimate)
    assert f'at pose {count + 1} of {2 * count} the stamps jump back' in said
    assert '?run=1 or ?run=2' in said
    assert '&run=1 or &run=2' in complaint(verb, *inputs(appended, 'both.txt?quaternion=xyzw'))


def test_a_run_is_chosen_by_its_number(appended):
    alone = document('replay', *inputs(appended, 'est.txt'))
    chosen = document('replay', *inputs(appended, 'both.txt?run=2'))
    assert chosen['metrics'] == alone['metrics']
    first = document('replay', *inputs(appended, 'both.txt?run=1'))
    assert first['metrics']['ate_trans_rmse_m'] > 2 * alone['metrics']['ate_trans_rmse_m']
    assert document('replay', *inputs(appended, 'est.txt?run=1'))['metrics'] == alone['metrics']
    assert 'run=3, but there are 2 runs' in complaint(
        'replay', *inputs(appended, 'both.txt?run=3')
    )
    for number in ('0', '-1', 'two', '1.5'):
        assert 'from 1' in complaint('replay', *inputs(appended, f'both.txt?run={number}'))


def test_a_topic_that_was_published_again_has_runs_too(tmp_path):
    path = tmp_path / 'run'
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(
            '/odom', 'geometry_msgs/msg/PoseStamped', typestore=STORE
        )
        for received, message in enumerate(messages_of(RUN.estimate) * 2):
            raw = STORE.serialize_cdr(message, message.__msgtype__)
            writer.write(connection, START_S * 10**9 + received * 10**8, raw)
    with pytest.raises(ReadError, match='2 runs over the same time'):
        read(f'{path}:/odom')
    assert len(read(f'{path}:/odom?run=2')) == len(RUN.estimate)
    with pytest.raises(ConfigError, match='there are 2 runs'):
        read(f'{path}:/odom?run=4')
