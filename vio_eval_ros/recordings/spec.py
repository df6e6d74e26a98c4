"""
What a user writes to name a source of poses.

::

    /topic                      a topic of the recording given beside it
    /topic[NAME]                an element of an array, by name or index
    /tf:PARENT.CHILD            a transform of that recording
    PATH                        a TUM file, EuRoC data.csv or sequence folder, KITTI poses
    RECORDING:/topic            a topic of another recording
    SPEC?quaternion=wxyz        its conventions, joined by &
"""

from __future__ import annotations

from pathlib import Path
import re
from typing import NamedTuple
from urllib.parse import parse_qsl, quote

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.columns import STATED
from vio_eval_ros.recordings.rows import STAMP_UNITS

RECORDING_SUFFIXES = ('.bag', '.bag.active', '.db3', '.mcap', '.ulg')
ZSTD_SUFFIXES = ('', '.zstd', '.zst')
# a topic without its slash: file names that do not exist mostly have a dot
BARE_TOPIC = r'[A-Za-z]\w*(/\w+)*([:\[].*)?'
#: units of positions, and how many metres each has
LENGTH_UNITS = {'m': 1.0, 'cm': 0.01, 'mm': 0.001, 'km': 1000.0}


class Statement(NamedTuple):
    """
    What may be stated of a source after the name of a convention.

    :param expected: in words.
    :param pattern: as a regular expression.
    """

    expected: str
    pattern: str

    @classmethod
    def one_of(cls, *values: str) -> Statement:
        """Return that it is one of a few values."""
        return cls(' or '.join(values), '|'.join(values))


OF_EITHER = {
    'unit': Statement.one_of(*LENGTH_UNITS),
    'invert': Statement.one_of('pose', 'rotation'),
    'run': Statement('the number of a run, from 1', '[1-9][0-9]{0,3}'),
    'weights': Statement.one_of('covariance'),
}
#: the conventions that mean something of a file, and of a topic
STATEMENTS = {
    'file': {
        'columns': Statement(
            'what each column is, such as t,x,y,z,qx,qy,qz,qw (sec,nsec for t; roll,pitch,yaw or '
            'r11 to r33 for the quaternion; units as in t_ns, x_mm, roll_deg; _ leaves one out)',
            STATED,
        ),
        'quaternion': Statement.one_of('xyzw', 'wxyz'),
        'stamps': Statement.one_of(*STAMP_UNITS),
        'body': Statement('the name of a rigid body', r'(?s:.+)'),
        **OF_EITHER,
    },
    'topic': {
        'stamps': Statement.one_of('header', 'recorded'),
        'revision': Statement.one_of('final', 'causal'),
        **OF_EITHER,
    },
}


class Spec(NamedTuple):
    """
    A source spec in its parts.

    :param path: of a file or recording; None for a topic of the recording given beside it.
    :param topic: a topic or ``/tf:PARENT.CHILD``; None for a file.
    :param statements: the conventions after the question mark, by name.
    """

    path: Path | None
    topic: str | None
    statements: dict[str, str]

    @classmethod
    def parse(cls, text: str, *, beside_recording: bool = False) -> Spec:
        """
        Return the parts.

        :param beside_recording: a recording is given, so that what is not the name of a file may
            be a topic without its leading slash.
        :raises ConfigError: conventions that are unknown or do not apply.
        """
        body, query = _halves(text)
        if not body:
            raise ConfigError(f"'{text}': expected a topic or a file, got nothing")
        stated = parse_qsl(query, keep_blank_values=True)
        statements = dict(stated)
        if len(statements) < len(stated):
            raise ConfigError(f'{text}: a convention is stated twice')
        path, topic = cls._located(body)
        is_bare = beside_recording and topic is None and re.fullmatch(BARE_TOPIC, body)
        if is_bare and not exists(Path(body)):
            path, topic = None, f'/{body}'
        what = 'topic' if topic else 'file'
        for name, value in statements.items():
            _check(text, what, name, value)
        return cls(path, topic, statements)

    @staticmethod
    def _located(body: str) -> tuple[Path | None, str | None]:
        """Return the file or recording, and the topic, that a spec names."""
        for colon in re.finditer(r':(?=/)', body):
            recording = Path(body[: colon.start()])
            if is_recording(recording) or exists(recording):
                return recording, body[colon.end() :]
        for colon in re.finditer(':', body):
            recording = Path(body[: colon.start()])
            if is_recording(recording) and not exists(Path(body)):
                return recording, f'/{body[colon.end() :]}'
        if body.startswith('/') and not exists(Path(body)):
            return None, body
        return Path(body), None


def with_statement(text: str, statement: str) -> str:
    """
    Return a spec with one more statement, which takes the place of an earlier one of its name.

    The value of the statement is given as it is meant, and :func:`quoted` here.
    What is inverted once more is not inverted. The order of a quaternion that columns state is
    changed in these.
    """
    body, query = _halves(text)
    name, _, value = statement.partition('=')
    stated = dict(parse_qsl(query, keep_blank_values=True))
    if name == 'quaternion' and 'columns' in stated:
        order = iter(value)
        stated['columns'] = re.sub(r'\bq[wxyz]\b', lambda _: f'q{next(order)}', stated['columns'])
    elif name == 'invert' and stated.get(name) == value:
        del stated[name]
    else:
        stated[name] = value
    joined = '&'.join(f'{name}={quoted(value)}' for name, value in stated.items())
    return f'{body}?{joined}' if joined else body


def quoted(value: str) -> str:
    """Return what is stated as it is written in a spec, where some characters have a meaning."""
    return re.sub('[%&+#?]', lambda found: quote(found[0]), value)


def _halves(text: str) -> tuple[str, str]:
    """Return what a spec names and what it states of it; files may have ? in their names."""
    marks = [mark.start() for mark in re.finditer(r'\?', text)]
    ends = [len(text), *reversed(marks)]
    end = next((end for end in ends if exists(Path(text[:end]))), min(ends))
    return text[:end], text[end + 1 :]


def _check(text: str, what: str, name: str, value: str) -> None:
    """Raise ``ConfigError`` unless a convention may be stated so of a 'file' or a 'topic'."""
    known = list(dict.fromkeys(name for names in STATEMENTS.values() for name in names))
    if name not in known:
        raise ConfigError(
            f"{text}: '{name}' is not a convention of a source (expected "
            f'{", ".join(known)}){nearest_name(name, known)}'
        )
    statement = STATEMENTS[what].get(name)
    if statement is None:
        raise ConfigError(f'{text}: {name} does not apply to a {what}')
    if not re.fullmatch(statement.pattern, value):
        raise ConfigError(f"{text}: {name} must be {statement.expected}, not '{value}'")


def storage_suffix(name: str) -> str | None:
    """Return which of ``RECORDING_SUFFIXES`` a name has, compressed or not; None without one."""
    for suffix in RECORDING_SUFFIXES:
        if any(name.endswith(f'{suffix}{packed}') for packed in ZSTD_SUFFIXES):
            return suffix
    return None


def is_recording(path: Path) -> bool:
    """Return whether a path is a recording by its name, or by what is in the folder."""
    try:
        if not path.is_dir():
            return storage_suffix(path.name) is not None
        return (path / 'metadata.yaml').exists() or (
            not (path / 'mav0').is_dir()  # EuRoC's folders may have their bag in them
            and any(storage_suffix(file.name) and file.is_file() for file in path.iterdir())
        )
    except (OSError, ValueError):  # such as a name that is too long
        return False


def exists(path: Path) -> bool:
    """Return whether there is such a file; False for what cannot be a path."""
    try:
        return path.exists()
    except (OSError, ValueError):  # such as a name that is too long
        return False
