"""What users write in YAML: options, gates, suites; with the line of whatever is wrong in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.errors import ConfigError, ReadError

MAX_YAML_BYTES = 1 << 20
PLAIN_TAGS = ('tag:yaml.org,2002:map', 'tag:yaml.org,2002:seq')


class Section(dict[str, Any]):
    """A mapping in a YAML file that knows where its keys stand."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.file = file
        self.lines: dict[str, int] = {}

    def error(self, key: str, problem: object) -> ConfigError:
        """Return the error that something is wrong with the value of a key."""
        line = f'line {self.lines[key]}: ' if key in self.lines else ''
        return ConfigError(f'{self.file}: {line}{problem}')

    def expect(self, *known: str) -> None:
        """
        Check that no key is unknown.

        :raises ConfigError: one is; the message has its line and the nearest key that exists.
        """
        for key in self:
            if key not in known:
                near = nearest_name(key, known) or f'; there are {", ".join(known)}'
                raise self.error(key, f"there is no '{key}' here{near}")

    def section(self, key: str) -> Section:
        """Return the mapping under a key, an empty one where there is none."""
        value = self.get(key)
        if value is None:
            return Section(self.file)
        if not isinstance(value, Section):
            raise self.error(key, f'{key}: a mapping is expected')
        return value


def load_yaml(path: Path) -> Section:
    """
    Return the mapping in a YAML file; nothing but plain data is ever made of it.

    :raises ReadError: no such file, no YAML, a key given twice or an alias (which could repeat a
        part a billion times).
    :raises ConfigError: not a mapping.
    """
    import yaml

    try:
        with path.open(encoding='utf-8') as file:
            text = file.read(MAX_YAML_BYTES + 1)
        if len(text) > MAX_YAML_BYTES:
            raise ReadError(path, 'too large for a file of options')
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        content = None if node is None else _content(path, loader, node, set())
    except OSError as error:
        raise ReadError(path, error.strerror or str(error)) from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ReadError(path, f'not valid YAML: {" ".join(str(error).split())}') from None
    if content is None:
        return Section(path)
    if not isinstance(content, Section):
        raise ConfigError(f'{path}: a mapping of names to values is expected')
    return content


def _content(path: Path, loader: Any, node: Any, seen: set[int], line: int = 1) -> Any:
    """Return what a node of YAML holds: plain values, lists and sections."""
    if id(node) in seen:
        raise ReadError(path, f'line {line}: aliases are not allowed')
    seen.add(id(node))
    if node.id == 'scalar':
        return loader.construct_object(node)
    if node.tag not in PLAIN_TAGS:
        raise ReadError(path, f'line {line}: not valid YAML: {node.tag} is no plain data')
    if node.id == 'sequence':
        return [
            _content(path, loader, item, seen, item.start_mark.line + 1) for item in node.value
        ]
    section = Section(path)
    for name, value in node.value:
        line = name.start_mark.line + 1
        key = _content(path, loader, name, seen, line)
        if not isinstance(key, str):
            raise ReadError(path, f"line {line}: a name is expected, not '{key}'")
        if key in section:
            raise ReadError(path, f"line {line}: '{key}' is there already")
        section.lines[key] = line
        section[key] = _content(path, loader, value, seen, line)
    return section


def options_of(path: Path) -> dict[str, Any]:
    """Return the options in a YAML file: a plain mapping, or a ROS parameter file."""
    values = load_yaml(path)
    nodes = [name for name in ('/**', 'vio_evaluator', '/vio_evaluator') if name in values]
    if not nodes:
        return values
    merged: dict[str, Any] = {}
    for name in nodes:
        node = values[name]
        parameters = node.get('ros__parameters') if isinstance(node, dict) else None
        if not isinstance(parameters, dict):
            raise ConfigError(f'{path}: {name} has no mapping ros__parameters')
        merged |= parameters
    return merged


def gates_of(path: Path) -> list[Gate]:
    """Return the gates in a YAML file; none at all is an error."""
    gates = gates_in(load_yaml(path))
    if not gates:
        raise ConfigError(f'{path}: there are no gates')
    return gates


def gates_in(section: Section) -> list[Gate]:
    """Return the gates of ``{metric: {max: number, min: number, warn: number}}``."""
    gates = []
    for metric, bounds in section.items():
        try:
            gates += Gate.of(metric, bounds)
        except ConfigError as error:
            raise section.error(metric, error) from None
    return gates
