"""Values of a suite that are set from outside: ``key.key=value``."""

from __future__ import annotations

from typing import Any

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.settings import parse_yaml, Section


def override(top: Section, text: str) -> None:
    """
    Set one value of a suite; ``sequences.NAME.key=value`` reaches into a sequence.

    :raises ConfigError: there is no such place, or the value is not YAML.
    """
    name, equals, given = text.partition('=')
    place = f"--set '{text}'"
    if not equals or not all(name.split('.')):
        raise ConfigError(f'{place}: write KEY=VALUE, such as options.alignment=sim3')
    try:
        value = parse_yaml(given, top.file, place)
    except ReadError as error:
        raise ConfigError(f'{place}: {error.problem.removeprefix(place + ": ")}') from None
    section: Any = top
    key = ''
    while not isinstance(section, Section) or '.' in name:
        if isinstance(section, list):
            section, name = _named(section, key, name, place)
            continue
        key, _, name = name.partition('.')
        section.places[key] = place
        if section.get(key) is None:
            section[key] = Section(top.file, place)
        section = section[key]
        if not isinstance(section, (Section, list)):
            raise ConfigError(f'{place}: {key} is not a mapping')
    section[name] = value
    section.places[name] = place


def _named(listed: list[Any], key: str, name: str, place: str) -> tuple[Section, str]:
    """Return the one of a list that a dotted name begins with, and the rest of that name."""
    names = [str(one.get('name')) for one in listed if isinstance(one, Section)]
    for one in listed:
        if isinstance(one, Section) and name.startswith(f'{one.get("name")}.'):
            return one, name.removeprefix(f'{one.get("name")}.')
    raise ConfigError(f'{place}: write {key}.NAME.KEY=VALUE, with NAME one of {", ".join(names)}')
