"""Which systems a suite compares: those that it lists, or the folders that a template finds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from glob import escape, glob
import re

from vio_eval_ros.scoring.entries import Entry, PLACEHOLDER
from vio_eval_ros.scoring.matching import regular, split_spec
from vio_eval_ros.settings import Section

#: where the runs of a system are
PLACES = ('estimate', 'recording')
SYSTEM = '(?P<system>[^/]+)'


def with_systems(top: Section, sequences: Sequence[Entry], keys: Sequence[str]) -> list[Entry]:
    """
    Return an entry for each system on each sequence; the sequences themselves without systems.

    :param keys: what a system may state.
    :raises ConfigError: the systems make no sense, or none is found.
    """
    systems = named(top, 'systems', keys) if 'systems' in top else _found(top, sequences)
    if not systems:
        return list(sequences)
    for name, section in systems.items():
        if '/' in name:
            raise section.error('name', f"the name of a system has no '/' in it, as in '{name}'")
    entries = [
        Entry((*one.layers, section), one.own, name)
        for one in sequences
        for name, section in systems.items()
    ]
    _check(entries)
    return entries


def named(top: Section, key: str, keys: Sequence[str]) -> dict[str, Section]:
    """
    Return the sections of a list by their names; a name alone stands for a section with no more.

    :param keys: what a section may state.
    """
    listed = top.get(key)
    if not isinstance(listed, list) or not listed:
        raise top.error(key, f'{key}: expected a list of at least one')
    found: dict[str, Section] = {}
    for item in listed:
        section = item
        if isinstance(item, str):
            section = Section(top.file, top.places.get(key, ''))
            section['name'] = item
        if not isinstance(section, Section):
            raise top.error(key, f'{key}: each is a mapping with name, estimate...')
        section.expect(*keys)
        name = section.required_text('name')
        if name in found:
            raise section.error('name', f"there are two {key} '{name}'")
        found[name] = section
    return found


def _found(top: Section, sequences: Sequence[Entry]) -> dict[str, Section]:
    """Return the systems that stand in place of {system} in paths; none without a template."""
    templates = [
        (entry, key, text)
        for entry in sequences
        for key in PLACES
        if '{system}' in (text := entry.text(key) or '')
    ]
    names = {name for template in templates for name in _names(*template)}
    if templates and not names:
        entry, key, text = templates[0]
        raise entry.error(
            key,
            f"{key}: nothing matches '{text}' in {entry.base} for any sequence; without such "
            'folders, list systems: [NAME, ...]',
        )
    return {name: Section(top.file) for name in sorted(names)}


def _names(entry: Entry, key: str, text: str) -> Iterator[str]:
    """Yield what {system} stands for in the paths of a sequence that match a template."""
    Entry(entry.layers, entry.own, 'any').path(key)  # nothing else may stand in braces
    pieces = PLACEHOLDER.split(split_spec(text)[0])
    pattern, expected = pieces[0], regular(pieces[0])
    for word, piece in zip(pieces[1::2], pieces[2::2], strict=True):
        if word == 'sequence':
            pattern, expected = pattern + escape(entry.name), expected + re.escape(entry.name)
        else:
            again = '(?P<system>' in expected
            pattern, expected = pattern + '*', expected + ('(?P=system)' if again else SYSTEM)
        pattern, expected = pattern + piece, expected + regular(piece)
    for path in glob(pattern, root_dir=entry.base, recursive=True):
        if match := re.fullmatch(expected, path, re.DOTALL):
            yield match['system']


def _check(entries: Sequence[Entry]) -> None:
    """Raise ``ConfigError`` where two cells would be the same runs without anybody saying so."""
    seen: dict[tuple[str | None, ...], Entry] = {}
    for entry in entries:
        own, system = entry.own, entry.layers[-1]
        if 'estimate' in own and 'estimate' in system:
            raise own.error('estimate', 'estimate: the systems say where theirs are; leave it out')
        first = seen.setdefault(tuple(entry.path(key) for key in PLACES), entry)
        # a system that states its own files may compare them under other options
        stated = any(entry.stating(key) is system for key in PLACES)
        same = 'sequence' if first.name != entry.name else 'system'
        if first is not entry and entry.text('estimate') and not (stated and same == 'system'):
            problem = f'without {{{same}}} in it, every {same} would be the same runs'
            raise entry.error('estimate', f'estimate: {problem}')
