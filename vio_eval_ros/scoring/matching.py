"""Which runs the entries of a sequence mean: globs and topics, paired with each other."""

from __future__ import annotations

from collections.abc import Iterator
from glob import escape, glob, has_magic
from pathlib import Path, PurePath
import re
from typing import NamedTuple

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.scoring.entries import Entry
from vio_eval_ros.scoring.suite import RunSpec

WILDCARD = re.compile(r'\*\*/?|\*|\?|\[!?.[^]]*\]')
WILD = {'**/': '((?:.*/)?)', '**': '(.*)', '*': '([^/]*)'}


class Match(NamedTuple):
    """
    One of the sources that an entry of a suite means.

    :param name: as the suite would name it.
    :param spec: which does not depend on where the tool is started.
    :param is_topic: of the recording of the sequence.
    :param wild: what its wildcards stand for.
    """

    name: str
    spec: str
    is_topic: bool = False
    wild: tuple[str, ...] = ()


class NoMatch(ConfigError):
    """A glob matches nothing; ``problem`` says so without the line of the suite."""

    def __init__(self, entry: Entry, key: str, problem: str) -> None:
        super().__init__(str(entry.error(key, f'{key}: {problem}')))
        self.problem = problem


def runs_of(entry: Entry) -> Iterator[RunSpec]:
    """
    Yield a run for each match of the estimate, or of the recording that it is in.

    A system without any on a sequence has one run that says so, which fails.
    """
    try:
        yield from _runs(entry)
    except NoMatch as error:
        if not entry.system:
            raise
        path = entry.required_path('estimate')
        yield RunSpec(path, str(entry.base / split_spec(path)[0]), problem=error.problem)


def _runs(entry: Entry) -> Iterator[RunSpec]:
    for run in _paired(entry):
        estimate, recording, causal = run['estimate'], run.get('recording'), run.get('causal')
        yield RunSpec(
            f'{run["recording"].name}:{estimate.name}' if estimate.is_topic else estimate.name,
            estimate.spec,
            recording=None if recording is None else Path(recording.spec),
            causal=None if causal is None else causal.spec,
        )


def _paired(entry: Entry) -> Iterator[dict[str, Match]]:
    """Yield, for each run, the match of every key; what matches once serves all runs."""
    optional = (key for key in ('causal', 'recording') if entry.text(key) is not None)
    found = {key: matches(entry, key) for key in ('estimate', *optional)}
    count = max(map(len, found.values()))
    many = [key for key, matched in found.items() if len(matched) == count > 1]
    for key, matched in found.items():
        if len(matched) == 1 and (key == 'recording' or matched[0].is_topic):
            found[key] = matched * count
        elif len(matched) < count:
            raise entry.error(key, f'{key}: {len(matched)} matches for {count} runs')
    for key in many[1:]:
        found[key] = _in_order_of(found[many[0]], entry, key, found[key])
    for run in zip(*found.values(), strict=True):
        yield dict(zip(found, run, strict=True))


def matches(entry: Entry, key: str) -> list[Match]:
    """
    Return what the entry under a key means: a topic, a path, or the matches of a glob by name.

    :raises ConfigError: a glob without a match, or a statement that makes no sense.
    """
    text, base = entry.required_path(key), entry.base
    pattern, rest = split_spec(text)
    if '\0' in text:
        raise entry.error(key, f'{key}: a path cannot contain a zero byte')
    if (base / pattern).exists():
        return [Match(text, _checked(entry, key, f'{base / pattern}{rest}'))]
    paths = sorted(glob(pattern, root_dir=base, recursive=True))
    if not paths and key != 'recording' and entry.text('recording') and text.startswith('/'):
        return [Match(text, _checked(entry, key, text), is_topic=True)]
    if not paths and has_magic(pattern):
        raise NoMatch(entry, key, f"nothing matches '{pattern}' in {base}{nearest(base, pattern)}")
    if not paths and entry.system and key != 'ground_truth':
        raise NoMatch(entry, key, f"there is no '{pattern}' in {base}{nearest(base, pattern)}")
    return [
        Match(
            path + rest,
            _checked(entry, key, f'{base / path}{rest}'),
            wild=_wild(pattern, path),
        )
        for path in paths or [pattern]
    ]


def nearest(base: Path, pattern: str) -> str:
    """Return what may be meant where a path or glob leads nowhere: a folder, or another suffix."""
    folder, parts = base, PurePath(pattern).parts
    for part in parts[: len(parts) - 1]:
        if has_magic(part):
            return ''
        if not (folder / part).exists():
            return nearest_name(part, sorted(one.name for one in folder.iterdir() if one.is_dir()))
        folder /= part
    same = sorted(one.name for one in folder.glob(f'{escape(PurePath(pattern).stem)}.*'))
    return nearest_name(parts[-1], same) if folder.is_dir() and not has_magic(parts[-1]) else ''


def split_spec(text: str) -> tuple[str, str]:
    """Return the path of a spec, and the topic or statements that follow it."""
    match = re.search(r':/|\?(?=[a-z]+=)', text)
    return (text, '') if match is None else (text[: match.start()], text[match.start() :])


def _in_order_of(
    estimates: list[Match], entry: Entry, key: str, others: list[Match]
) -> list[Match]:
    """Return the other matches in the order of the estimates: wildcards stand for the same."""
    by_wild = {match.wild: match for match in others}
    for match in estimates:
        if match.wild not in by_wild:
            raise entry.error(
                key,
                f'{key}: no match corresponds to {match.name}: wildcards must stand for the same '
                f"text in both, here '{' '.join(match.wild)}'",
            )
    return [by_wild[match.wild] for match in estimates]


def _wild(pattern: str, path: str) -> tuple[str, ...]:
    """Return what the wildcards of a glob stand for in a path that it matches."""
    found = re.fullmatch(regular(pattern), path, re.DOTALL)
    return found.groups() if found else (path,)


def regular(pattern: str) -> str:
    """Return a glob as a regular expression, with a group for each wildcard."""
    texts, wildcards = WILDCARD.split(pattern), WILDCARD.findall(pattern)
    groups = [WILD.get(wildcard, '([^/])') for wildcard in wildcards] + ['']
    return ''.join(map(''.join, zip(map(re.escape, texts), groups, strict=True)))


def _checked(entry: Entry, key: str, spec: str) -> str:
    """Return a source spec whose statements are valid."""
    try:
        Spec.parse(spec)
    except ConfigError as error:
        raise entry.error(key, error) from None
    return spec
