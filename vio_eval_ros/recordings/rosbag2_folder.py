"""The storage files of a rosbag2 folder: what metadata.yaml lists, or what is there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath
import re
from typing import Any, NamedTuple

from ruamel.yaml import YAML

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.spec import storage_suffix
from vio_eval_ros.recordings.storage import rooted
from vio_eval_ros.recordings.storage_files import reading

METADATA = 'metadata.yaml'
MAX_METADATA_BYTES = 1 << 24
NEWEST_VERSION = 9  # of metadata.yaml that is known
# rosbag2 numbers its files from 0; V1_02 is a name
PART = re.compile(
    r'(?P<run>.*?)(_(?P<number>0|[1-9]\d{0,8}))?(?P<suffix>\.(bag|db3|mcap))[^/]*', re.DOTALL
)


class Folder(NamedTuple):
    """
    What a rosbag2 folder consists of.

    :param files: in the order in which they were recorded.
    :param promised: the number of messages of each topic, as metadata.yaml has it.
    :param warnings: what a user should know of the choice of files.
    """

    files: list[Path]
    promised: dict[str, int]
    warnings: list[str]


class Part(NamedTuple):
    """
    A storage file among others: ``run_3.mcap.zstd`` is number 3 of the mcap ``run``.

    Of a compressed file and what was decompressed beside it, the name but not the path is equal.
    """

    run: str
    suffix: str
    number: int | None
    path: Path

    @property
    def name(self) -> tuple[str, str, int | None]:
        """What it is a part of, and which."""
        return self[:3]

    @property
    def place(self) -> int:
        """Its place among the parts of its run."""
        return -1 if self.number is None else self.number


def storage_files(folder: Path) -> Folder:
    """
    Return the storage files of a folder.

    :raises ReadError: a file that is listed is missing, or which ones belong together cannot be
        told.
    """
    metadata = folder / METADATA
    parts = _parts(folder)
    if not metadata.exists():
        return _found(folder, parts, f'has no {METADATA}')
    content = _metadata(metadata)
    if isinstance(content, str):
        return _found(folder, parts, f'its {METADATA} {content}')
    _check_compression(metadata, content)
    listed = [_listed(metadata, str(name), parts) for name in content['relative_file_paths']]
    once = {part.name if (part := _part(path)) else path: path for path in listed}
    files, warnings = _with_unlisted(list(once.values()), parts)
    return Folder(files, _promised(content), warnings)


def _parts(folder: Path) -> list[Part]:
    """Return the storage files in a folder; of one that is compressed too, the decompressed."""
    found: dict[tuple[str, str, int | None], Part] = {}
    for path in sorted(folder.iterdir(), key=lambda path: len(path.name), reverse=True):
        part = _part(path)
        if part and path.is_file():
            found[part.name] = part
    return sorted(found.values(), key=lambda part: (part.run, part.place, part.suffix))


def _part(path: Path) -> Part | None:
    if storage_suffix(path.name) is None or not (match := PART.fullmatch(path.name)):
        return None
    number = match['number']
    return Part(match['run'], match['suffix'], None if number is None else int(number), path)


def _metadata(path: Path) -> dict[str, Any] | str:
    """Return the content of a metadata.yaml, or what is wrong with it."""
    with reading(path):
        if not path.is_file():
            raise ReadError(path, 'is not a file')
        with path.open('rb') as stream:
            data = stream.read(MAX_METADATA_BYTES + 1)
    if not data.strip(b'\0 \r\n'):
        return f'is empty ({len(data)} bytes{" of zeros" if data.strip() else ""})'
    if len(data) > MAX_METADATA_BYTES:
        return 'is larger than 16 MiB'
    try:
        content = YAML(typ='safe', pure=True).load(data)['rosbag2_bagfile_information']
        version = content.get('version')
        names = content.get('relative_file_paths')
    except Exception:  # of damaged YAML, ruamel raises anything
        return 'is damaged or was cut short'
    if isinstance(names, list) and names and all(isinstance(name, str) for name in names):
        return dict(content)
    if isinstance(version, int) and version > NEWEST_VERSION:
        raise ReadError(
            path,
            f'is of version {version}, newer than those that are known (up to {NEWEST_VERSION}), '
            'and lists no relative_file_paths; name a storage file in the folder instead',
        )
    return 'lists no files'


def _check_compression(path: Path, content: dict[str, Any]) -> None:
    mode = str(content.get('compression_mode') or 'none').lower()
    kind = str(content.get('compression_format') or '')
    if mode != 'none' and kind not in ('', 'zstd'):
        raise ReadError(path, f'its files are compressed with {kind!r}; only zstd can be read')


def _listed(metadata: Path, name: str, parts: Sequence[Part]) -> Path:
    """Return a file that is listed, or what it became when it was compressed or decompressed."""
    path = metadata.parent / PurePath(name).name
    if path.exists():
        return path
    wanted = _part(path)
    for part in parts:
        if wanted and part.name == wanted.name:
            return part.path
    there = ', '.join(part.path.name for part in parts)
    raise ReadError(
        path,
        f'there is no such file or folder, but {METADATA} lists it; put it back'
        + (f', or name a file that is there: {there}' if there else ''),
    )


def _with_unlisted(listed: list[Path], parts: Sequence[Part]) -> tuple[list[Path], list[str]]:
    """Return the listed files and those that continue their numbers, in order; and warnings."""
    known = [part for path in listed if (part := _part(path))]
    names = {part.name for part in known}
    others = [part for part in parts if part.name not in names]
    runs = {(part.run, part.suffix) for part in known if part.number is not None}
    numbers = {(part.run, part.number) for part in known}
    more = [
        part
        for part in others
        if part.number is not None
        and (part.run, part.suffix) in runs
        and (part.run, part.number) not in numbers
    ]
    warnings = []
    if more:
        warnings.append(f'{METADATA} does not list {_names(more)}; read all the same')
    if foreign := [part for part in others if part not in more]:
        warnings.append(f'{METADATA} does not list {_names(foreign)}; not read')
    if not more:
        return listed, warnings
    return [part.path for part in sorted([*known, *more], key=lambda part: part.place)], warnings


def _found(folder: Path, parts: Sequence[Part], problem: str) -> Folder:
    """Return the storage files that are there, where they are of one run."""
    if not parts:
        inside = sorted(str(file.parent) for file in folder.glob(f'*/{METADATA}'))
        raise ReadError(
            folder,
            f'is not a rosbag2 folder: {problem}, and there is no .mcap, .db3 or .bag in it'
            + (f'; name a folder in it: {", ".join(inside)}' if inside else ''),
        )
    is_whole = [part.number for part in parts] == [*range(len(parts))]
    if len(parts) > 1 and not (is_whole and len({part.name[:2] for part in parts}) == 1):
        raise ReadError(
            folder,
            f'{problem}, and which of its files belong together is not known; name one of '
            f'{_names(parts)}, or write a {METADATA} with `ros2 bag reindex`',
        )
    return Folder([part.path for part in parts], {}, [f'{problem}; read {_names(parts)}'])


def _promised(content: dict[str, Any]) -> dict[str, int]:
    """Return the number of messages of each topic that metadata states; nothing where unclear."""
    try:
        return {
            rooted(str(entry['topic_metadata']['name'])): int(entry['message_count'])
            for entry in content['topics_with_message_count']
        }
    except (AttributeError, KeyError, TypeError, ValueError):
        return {}


def _names(parts: Iterable[Part]) -> str:
    return ', '.join(part.path.name for part in parts)
