"""Which runs the entries of a sequence mean: globs and topics, paired with each other."""

from __future__ import annotations

from collections.abc import Iterator
from glob import glob, has_magic
from pathlib import Path
import re
from typing import NamedTuple

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.scoring.suite import RunSpec
from vio_eval_ros.settings import Section

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


def runs_of(sequence: Section, base: Path) -> Iterator[RunSpec]:
    """Yield a run for each match of the estimate, or of the recording that it is in."""
    for run in _paired(sequence, base):
        estimate, recording, causal = run['estimate'], run.get('recording'), run.get('causal')
        yield RunSpec(
            f'{run["recording"].name}:{estimate.name}' if estimate.is_topic else estimate.name,
            estimate.spec,
            recording=None if recording is None else Path(recording.spec),
            causal=None if causal is None else causal.spec,
        )


def _paired(sequence: Section, base: Path) -> Iterator[dict[str, Match]]:
    """Yield, for each run, the match of every key; what matches once serves all runs."""
    optional = (key for key in ('causal', 'recording') if sequence.get(key) is not None)
    found = {key: matches(sequence, key, base) for key in ('estimate', *optional)}
    count = max(map(len, found.values()))
    many = [key for key, matched in found.items() if len(matched) == count > 1]
    for key, matched in found.items():
        if len(matched) == 1 and (key == 'recording' or matched[0].is_topic):
            found[key] = matched * count
        elif len(matched) < count:
            raise sequence.error(key, f'{key}: {len(matched)} matches for {count} runs')
    for key in many[1:]:
        found[key] = _in_order_of(found[many[0]], sequence, key, found[key])
    for run in zip(*found.values(), strict=True):
        yield dict(zip(found, run, strict=True))


def matches(sequence: Section, key: str, base: Path) -> list[Match]:
    """
    Return what the entry under a key means: a topic, a path, or the matches of a glob by name.

    :param base: the folder that paths are relative to.
    :raises ConfigError: a glob without a match, or a statement that makes no sense.
    """
    text = sequence.required_text(key)
    pattern, rest = split_spec(text)
    if '\0' in text:
        raise sequence.error(key, f'{key}: a path cannot contain a zero byte')
    if (base / pattern).exists():
        return [Match(text, _checked(sequence, key, f'{base / pattern}{rest}'))]
    paths = sorted(glob(pattern, root_dir=base, recursive=True))
    if not paths and key != 'recording' and sequence.get('recording') and text.startswith('/'):
        return [Match(text, _checked(sequence, key, text), is_topic=True)]
    if not paths and has_magic(pattern):
        raise sequence.error(key, f"{key}: nothing matches '{pattern}' in {base}")
    return [
        Match(
            path + rest,
            _checked(sequence, key, f'{base / path}{rest}'),
            wild=_wild(pattern, path),
        )
        for path in paths or [pattern]
    ]


def split_spec(text: str) -> tuple[str, str]:
    """Return the path of a spec, and the topic or statements that follow it."""
    match = re.search(r':/|\?(?=[a-z]+=)', text)
    return (text, '') if match is None else (text[: match.start()], text[match.start() :])


def _in_order_of(
    estimates: list[Match], sequence: Section, key: str, others: list[Match]
) -> list[Match]:
    """Return the other matches in the order of the estimates: wildcards stand for the same."""
    by_wild = {match.wild: match for match in others}
    for match in estimates:
        if match.wild not in by_wild:
            raise sequence.error(
                key,
                f'{key}: no match corresponds to {match.name}: wildcards must stand for the same '
                f"text in both, here '{' '.join(match.wild)}'",
            )
    return [by_wild[match.wild] for match in estimates]


def _wild(pattern: str, path: str) -> tuple[str, ...]:
    """Return what the wildcards of a glob stand for in a path that it matches."""
    texts, wildcards = WILDCARD.split(pattern), WILDCARD.findall(pattern)
    groups = [WILD.get(wildcard, '([^/])') for wildcard in wildcards] + ['']
    regular = ''.join(map(''.join, zip(map(re.escape, texts), groups, strict=True)))
    found = re.fullmatch(regular, path, re.DOTALL)
    return found.groups() if found else (path,)


def _checked(sequence: Section, key: str, spec: str) -> str:
    """Return a source spec whose statements are valid."""
    try:
        Spec.parse(spec)
    except ConfigError as error:
        raise sequence.error(key, error) from None
    return spec
