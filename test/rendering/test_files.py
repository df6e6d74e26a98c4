"""Whether files can be written, before there is anything to write."""

import os
from pathlib import Path

import pytest

from vio_eval_ros.errors import WriteError
from vio_eval_ros.rendering.files import check_file, check_folder, make_writable


def test_a_file_that_can_be_written_is_neither_made_nor_changed(tmp_path):
    (tmp_path / 'old').write_text('old')
    for name in ('old', 'new'):
        check_file(tmp_path / name)
    assert [file.read_text() for file in tmp_path.iterdir()] == ['old']


def test_a_pipe_or_a_device_is_not_tried(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    check_file(tmp_path / 'pipe')  # would wait for a reader
    check_file(Path('/dev/full'))


def test_a_file_in_the_place_of_a_folder_is_refused(tmp_path):
    with pytest.raises(WriteError, match='it is a folder; name a file in it'):
        check_file(tmp_path)


def test_a_folder_is_created_with_those_above_it(tmp_path):
    with pytest.raises(WriteError, match='cannot write'):
        check_folder(tmp_path / 'one' / 'two')
    make_writable(tmp_path / 'one' / 'two')
    check_folder(tmp_path / 'one' / 'two')


def test_a_folder_in_the_place_of_a_file_is_refused(tmp_path):
    (tmp_path / 'taken').write_text('')
    with pytest.raises(WriteError, match='it is a file, not a folder'):
        make_writable(tmp_path / 'taken')
    with pytest.raises(WriteError, match='cannot write'):
        make_writable(tmp_path / 'taken' / 'below')
