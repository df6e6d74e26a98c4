"""Storage files: which kind one is, how it is opened, and what is said where that fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
from pathlib import Path
import stat
import struct
from textwrap import shorten
from typing import NamedTuple

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import mcap_storage, ros1_storage, sqlite_storage
from vio_eval_ros.recordings.compression import decompressed_file, OTHERS, ZSTD_MAGIC
from vio_eval_ros.recordings.spec import storage_suffix
from vio_eval_ros.recordings.storage import RefusedError, Storage

ACTIVE = '.active'  # behind the name of a ROS 1 bag while it is recorded


class FileKind(NamedTuple):
    """A kind of storage file: how it begins, its suffix, its name, how to read and repair it."""

    magic: bytes
    suffix: str
    name: str
    repair: str
    storage: Callable[[Path, ExitStack], Storage]


FILE_KINDS = {
    'ros1': FileKind(
        ros1_storage.MAGIC, '.bag', 'a ROS 1 bag', '`rosbag reindex`', ros1_storage.Ros1Storage
    ),
    'rosbag2': FileKind(
        sqlite_storage.MAGIC,
        '.db3',
        'an SQLite recording',
        '`sqlite3 FILE .recover`',
        sqlite_storage.SqliteStorage,
    ),
    'mcap': FileKind(
        mcap_storage.MAGIC, '.mcap', 'an mcap file', '`mcap recover`', mcap_storage.McapStorage
    ),
}
# What the errors of Python itself mean, whose own words are those of a programmer.
IN_WORDS: dict[type[Exception], str] = {
    struct.error: 'a number ends behind the end of its record',
    IndexError: 'a record is too short',
    EOFError: 'it ends in the middle of a record',
    UnicodeError: 'what should be text is none',
    MemoryError: 'it states a length that no memory has',
    OverflowError: 'it states a number that is too large',
    LookupError: 'it refers to something that is not in it',
    **dict.fromkeys(
        (AssertionError, AttributeError, RecursionError, TypeError),
        'a record of it makes no sense',
    ),
}
EXPECTED = 'expected .bag, .db3, .mcap, one of them with .zstd, or a rosbag2 folder'


class StorageFile(NamedTuple):
    """An open storage file: its path as the user knows it, its kind, and what is in it."""

    path: Path
    kind: str
    storage: Storage


def open_file(path: Path, stack: ExitStack) -> StorageFile:
    """
    Return an open storage file, decompressed where it is compressed; the stack closes it.

    :raises ReadError: it cannot be read; the message says why and what to do.
    """
    with reading(path):
        if not stat.S_ISREG(path.stat().st_mode):  # reading a pipe may never end
            raise ReadError(path, 'is neither a file nor a folder')
        begin = _begin(path)
        content = decompressed_file(path, stack) if begin.startswith(ZSTD_MAGIC) else path
        if not begin and sqlite_storage.journals(path):
            begin = sqlite_storage.MAGIC  # the journal has it all
        kind = _identified(path, begin if content is path else _begin(content))
        return StorageFile(path, kind, FILE_KINDS[kind].storage(content, stack))


def _begin(path: Path) -> bytes:
    with path.open('rb') as stream:
        return stream.read(100)


def _identified(path: Path, begin: bytes) -> str:
    """Return the kind of a storage file by its content and its suffix, which must agree."""
    if not begin:
        raise ReadError(path, 'is empty (0 bytes)')
    if begin.startswith(b'version https://git-lfs'):
        raise ReadError(path, 'is a Git LFS pointer, not the recording; run `git lfs pull`')
    for magic, command in OTHERS.items():
        if begin.startswith(magic):
            raise ReadError(path, f'is compressed; decompress it first: {command} {path.name}')
    suffix = (storage_suffix(path.name) or '').removesuffix(ACTIVE)
    named = next((kind for kind, one in FILE_KINDS.items() if one.suffix == suffix), None)
    found = next((kind for kind, one in FILE_KINDS.items() if begin.startswith(one.magic)), None)
    if found and found != named:
        right = FILE_KINDS[found]
        raise ReadError(path, f'is {right.name}; rename it to end in {right.suffix}')
    if not named:
        raise ReadError(path, f'is not a recording ({EXPECTED})')
    if not found:
        name = FILE_KINDS[named].name
        raise ReadError(path, f'does not begin like {name}; it is damaged or something else')
    return found


def unreadable(source: object, error: Exception) -> ReadError:
    """
    Return the error for the user when reading the bytes of a source failed.

    Recordings come from anywhere, and on damaged ones the libraries raise nearly anything:
    struct.error, KeyError, AssertionError, UnicodeDecodeError, zstd's and SQLite's errors, and
    MemoryError where a damaged length is absurd. So Exception is caught around each call of
    theirs, and only there.
    """
    if isinstance(error, ReadError):
        return error
    if isinstance(error, RefusedError):
        return ReadError(source, str(error))
    if isinstance(error, FileNotFoundError):
        return ReadError(error.filename or source, 'there is no such file or folder')
    if isinstance(error, PermissionError):
        return ReadError(source, 'there is no permission to read it')
    # some quote all that they could not read
    quoted = shorten(str(error), 300, placeholder=' ...')
    reason = next((words for kind, words in IN_WORDS.items() if isinstance(error, kind)), quoted)
    if isinstance(error, KeyError) and isinstance(error.args[0], str):
        reason = f'no entry {quoted}'
    repairs = [one.repair for one in FILE_KINDS.values() if str(source).endswith(one.suffix)]
    rescue = f'; {repairs[0]} may save what is left' if repairs else ''
    because = f' ({reason})' if reason else ''
    return ReadError(source, f'is damaged or was cut short{because}{rescue}')


@contextmanager
def reading(source: object) -> Iterator[None]:
    """Turn what libraries raise while they read a source into a ``ReadError``."""
    try:
        yield
    except Exception as error:
        raise unreadable(source, error) from error
