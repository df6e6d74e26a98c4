"""SQLite files as recorders leave them: closed, killed in the middle, of old releases, hostile."""

from pathlib import Path
import shutil
import sqlite3
from stat import S_IRUSR, S_IXUSR

import numpy as np
import pytest

import recorded
from verbs import call, complaint, document
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import sqlite_storage
from vio_eval_ros.recordings.recording import Recording

COUNT = 60


@pytest.fixture
def closed(tmp_path) -> Path:
    """Return an SQLite file that its recorder closed."""
    return recorded.write(tmp_path / 'closed', 'sqlite', recorded.odometry(COUNT)) / 'closed.db3'


def killed(closed: Path, folder: Path, in_file: int) -> Path:
    """Return a copy of a file of which messages from a number on are in the write-ahead log."""
    folder.mkdir()
    source, target = sqlite3.connect(closed), sqlite3.connect(folder / 'live.db3')
    target.execute('PRAGMA journal_mode = WAL')
    target.execute('PRAGMA wal_autocheckpoint = 0')
    for name, sql in source.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'"):
        target.execute(sql)
        rows = source.execute(f'SELECT * FROM {name}').fetchall()
        first = rows[:in_file] if name == 'messages' else rows
        target.executemany(f'INSERT INTO {name} VALUES ({",".join("?" * len(rows[0]))})', first)
    target.commit()
    if in_file:
        target.execute('PRAGMA wal_checkpoint(TRUNCATE)')
    rest = source.execute('SELECT * FROM messages').fetchall()[in_file:]
    target.executemany('INSERT INTO messages VALUES (?, ?, ?, ?)', rest)
    target.commit()
    for suffix in ('', '-wal'):  # as a killed process leaves them: -shm may be missing
        shutil.copy(folder / f'live.db3{suffix}', folder / f'run_0.db3{suffix}')
    source.close()
    target.close()
    (folder / 'live.db3').unlink()
    return folder / 'run_0.db3'


def positions(path: Path) -> list[list[float]]:
    with Recording(path) as opened:
        return opened.read(['/vio/odometry'])[0].poses.positions.tolist()


@pytest.mark.parametrize('in_file', [0, 1, 30, 59])
def test_messages_in_the_write_ahead_log_are_read(tmp_path, closed, in_file):
    path = killed(closed, tmp_path / 'killed', in_file)
    before = {file: file.read_bytes() for file in path.parent.iterdir()}
    for named in (path, path.parent):
        assert positions(named) == positions(closed)
    assert {file: file.read_bytes() for file in path.parent.iterdir()} == before
    with Recording(path) as opened:
        assert opened.paths == (path, path.with_name('run_0.db3-wal'))
        assert [line.partition('run_0.db3: ')[2] for line in opened.warnings] == [
            'its recorder was stopped before it closed the file; read together with run_0.db3-wal'
        ]


def test_a_log_whose_file_is_still_empty_is_read(tmp_path, closed):
    path = killed(closed, tmp_path / 'killed', 0)
    path.write_bytes(b'')
    assert positions(path) == positions(closed)


def test_a_log_is_read_where_nothing_may_be_written(tmp_path, closed):
    path = killed(closed, tmp_path / 'killed', 30)
    path.parent.chmod(S_IRUSR | S_IXUSR)
    try:
        assert positions(path) == positions(closed)
    finally:
        path.parent.chmod(0o700)


def test_an_empty_log_is_none(closed):
    closed.with_name('closed.db3-wal').touch()
    with Recording(closed) as opened:
        assert opened.warnings == []
        assert opened.paths == (closed,)


def test_what_a_log_has_not_committed_is_left_out(tmp_path, closed):
    path = killed(closed, tmp_path / 'killed', 30)
    log = path.with_name('run_0.db3-wal')
    log.write_bytes(log.read_bytes()[:-100])  # its last transaction, cut off
    assert positions(path) == positions(closed)[:30]


def test_a_transaction_that_was_not_finished_is_undone(tmp_path, closed):
    live = tmp_path / 'live.db3'
    shutil.copy(closed, live)
    database = sqlite3.connect(live)
    database.execute('PRAGMA cache_size = 1')  # so that changes reach the file before the commit
    database.execute('UPDATE messages SET data = zeroblob(length(data))')
    path = tmp_path / 'run.db3'
    for suffix in ('', '-journal'):
        shutil.copy(f'{live}{suffix}', f'{path}{suffix}')
    database.close()
    assert path.read_bytes() != closed.read_bytes()
    assert positions(path) == positions(closed)


def test_the_log_of_another_file_is_refused(tmp_path, closed):
    path = killed(closed, tmp_path / 'killed', 30)
    other = recorded.write(tmp_path / 'other', 'sqlite', recorded.odometry(5)) / 'other.db3'
    with sqlite3.connect(other) as database:
        database.execute('PRAGMA journal_mode = WAL')
        database.execute('CREATE TABLE more (name TEXT)')
    database.close()
    shutil.copy(other, path)
    with pytest.raises(ReadError, match=r'with run_0\.db3-wal, which may be that of another file'):
        Recording(path)


def test_a_copy_for_which_there_is_no_room_says_what_to_do(tmp_path, closed, monkeypatch):
    path = killed(closed, tmp_path / 'killed', 30)
    full = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(sqlite_storage.shutil, 'disk_usage', lambda _: full)
    with pytest.raises(ReadError, match=r'run_0.db3: has run_0.db3-wal beside it.*TMPDIR'):
        Recording(path)


def test_every_verb_reads_the_log(tmp_path, closed):
    path = killed(closed, tmp_path / 'killed', 30)
    specs = ('--estimate', '/vio/odometry', '--ground-truth', f'{closed}:/vio/odometry')
    result = document('replay', path, *specs)
    assert result['association']['pairs'] == COUNT
    assert any('run_0.db3-wal' in warning for warning in result['warnings'])
    inspected = call('inspect', path)
    assert f'{COUNT}' in inspected.stdout
    assert 'unfinished' in inspected.stdout or 'run_0.db3-wal' in inspected.stdout


@pytest.mark.parametrize('name', ['what?immutable=0', 'a#b', '100%41', "it's", 'Ünï', 'a b'])
def test_a_folder_may_have_any_name(tmp_path, closed, name):
    (tmp_path / name).mkdir()
    path = shutil.copy(closed, tmp_path / name / 'run.db3')
    assert positions(path) == positions(closed)


def test_types_of_the_first_releases_are_spelled_without_msg(closed):
    with sqlite3.connect(closed) as database:
        database.execute("UPDATE topics SET type = 'nav_msgs/Odometry'")
        database.execute('DROP TABLE message_definitions')
    database.close()
    with Recording(closed) as opened:
        assert [topic.msgtype for topic in opened.topics] == ['nav_msgs/msg/Odometry']
    assert len(positions(closed)) == COUNT


def test_a_damaged_definition_or_offer_of_another_topic_is_no_damage(closed):
    with sqlite3.connect(closed) as database:
        qos = '[{depth: {, history'
        service = ('/plan/_service_event', 'my_msgs/srv/Plan_Event', 'cdr', qos, '')
        database.execute('INSERT INTO topics VALUES (77, ?, ?, ?, ?, ?)', service)
        text = 'Request<= [] !!'
        row = ('my_msgs/srv/Plan_Event', 'ros2msg', text, '')
        database.execute('INSERT INTO message_definitions VALUES (77, ?, ?, ?, ?)', row)
        database.execute('INSERT INTO messages VALUES (7777, 77, ?, ?)', (recorded.stamp(3), b'x'))
    database.close()
    assert len(positions(closed)) == COUNT
    inspected = call('inspect', closed)
    assert '/plan/_service_event' in inspected.stdout
    assert inspected.returncode in (0, 1)


def test_messages_come_as_they_were_inserted_and_in_the_order_of_time(closed):
    with sqlite3.connect(closed) as database:
        database.execute('UPDATE messages SET timestamp = 7 WHERE id = 30')
    database.close()
    with Recording(closed) as opened:
        written = [log_ns for log_ns, _, _ in opened.as_written({'/vio/odometry'})]
        ordered = [log_ns for log_ns, _, _ in opened.messages({'/vio/odometry'})]
    assert written.index(7) == 29
    assert ordered == sorted(written)
    assert np.all(np.diff(ordered) >= 0)


@pytest.mark.parametrize(
    'sql',
    [
        'DROP TABLE messages',
        # a view may never end
        'DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION '
        "ALL SELECT id FROM n) SELECT id, 1 AS topic_id, 1 AS timestamp, x'00' AS data FROM n",
    ],
)
def test_a_database_of_something_else_is_refused(closed, sql):
    database = sqlite3.connect(closed)
    database.executescript(sql)
    database.close()
    problem = complaint('replay', closed)
    assert 'is an SQLite file, but not a recording of ROS 2' in problem
