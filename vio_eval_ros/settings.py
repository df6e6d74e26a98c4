"""What users write in YAML: options, gates, suites; errors give the line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import partial
import math
from pathlib import Path
import re
from typing import Any
import warnings

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.core.limits import Kind
from vio_eval_ros.errors import ConfigError, ReadError

MAX_YAML_BYTES = 1 << 20
#: the verbs that judge by limits
LIMITED = ('diagnose', 'inspect', 'imu_noise')
#: what stands for names in the paths of a suite
BRACES = re.compile(r'\{(?:sequence|system)\}')
PLAIN_TAGS = ('tag:yaml.org,2002:map', 'tag:yaml.org,2002:seq')


class Section(dict[str, Any]):
    """
    A mapping that a user wrote, and where each of its keys stands.

    :param place: where it begins, such as ``line 3``.
    """

    def __init__(self, file: Path, place: str = '') -> None:
        super().__init__()
        self.file = file
        self.place = place
        self.places: dict[str, str] = {}

    def error(self, key: str, problem: object) -> ConfigError:
        """Return the error for a problem with a key, or with its absence."""
        place = self.places.get(key, self.place)
        return ConfigError(
            f'{self.file}: {place}: {problem}' if place else f'{self.file}: {problem}'
        )

    def expect(self, *known: str) -> None:
        """
        Check that no key is unknown.

        :raises ConfigError: a key is unknown; with its line and the nearest key that exists.
        """
        for key in self:
            if key not in known:
                near = nearest_name(key, known) or f'; there are {", ".join(known)}'
                raise self.error(key, f"there is no '{key}' here{near}")

    def check_each(self, check: Callable[[Mapping[str, Any]], object]) -> None:
        """
        Check each key by itself, so that an error gives its line.

        :param check: raises ``ConfigError`` for a mapping that makes no sense.
        """
        for key, value in self.items():
            try:
                check({key: value})
            except ConfigError as error:
                raise self.error(key, error) from None

    def section(self, key: str) -> Section:
        """Return the mapping under a key, an empty one where there is none."""
        value = self.get(key)
        if value is None:
            return Section(self.file)
        if not isinstance(value, Section):
            raise self.error(key, f'{key}: expected a mapping')
        return value

    def text(self, key: str) -> str | None:
        """Return the text under a key, None where there is none."""
        value = self.get(key)
        if value is not None and not isinstance(value, str):
            raise self.error(key, f'{key}: expected text')
        return value

    def required_text(self, key: str) -> str:
        """Return the text under a key that must be there."""
        text = self.text(key)
        if not text:
            raise self.error(key, f'{key} is missing')
        return text

    def texts(self, key: str) -> list[str]:
        """Return the texts under a key, which has a list of them, or one."""
        value = self.get(key) or []
        texts = [value] if isinstance(value, str) else value
        if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
            raise self.error(key, f'{key}: expected a list of texts')
        return texts


def load_yaml(path: Path, what: str = 'a file of options') -> Section:
    """
    Return the mapping in a YAML file; nothing but plain data is ever made of it.

    OpenCV begins its files with ``%YAML:1.0``, which is not YAML; that line is skipped.

    :param what: the file should be, for errors.
    :raises ReadError: no such file, too large, not YAML, a key given twice or an alias (which
        could repeat a part a billion times).
    :raises ConfigError: not a mapping.
    """
    try:
        with path.open(encoding='utf-8') as file:
            text = file.read(MAX_YAML_BYTES + 1)
    except OSError as error:
        raise ReadError(path, error.strerror or str(error)) from None
    except ValueError as error:
        raise ReadError(path, f'not valid YAML: {error}') from None
    if len(text) > MAX_YAML_BYTES:
        raise ReadError(path, f'too large for {what}')
    if text.startswith('%YAML:'):
        text = '\n' + text.partition('\n')[2]
    content = parse_yaml(text, path)
    if content is None:
        return Section(path)
    if not isinstance(content, Section):
        raise ConfigError(f'{path}: expected {what}, a mapping of names to values')
    content.place = ''
    return content


def parse_yaml(text: str, file: Path, place: str = '') -> Any:
    """
    Return what YAML means: plain values, lists and sections.

    It is YAML 1.1, as in ROS parameter files (yes and on are true, 010 is eight), but for 1e-3,
    which is a number here as it is there.

    :param file: what errors name.
    :param place: what errors name instead of the line.
    :raises ReadError: as :func:`load_yaml`.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MantissaNoDotYAML1_1Warning, YAMLError

    yaml = YAML(typ='safe', pure=True)
    yaml.version = (1, 1)
    seen: set[int] = set()

    def where(node: Any) -> str:
        return place or f'line {node.start_mark.line + 1}'

    def content(node: Any, at: str) -> Any:
        if id(node) in seen:
            raise ReadError(file, f'{at}: aliases are not allowed')
        seen.add(id(node))
        if node.id == 'scalar':
            return yaml.constructor.construct_object(node)
        if node.tag not in PLAIN_TAGS:
            raise ReadError(file, f'{at}: not valid YAML: {node.tag} is not plain data')
        if node.id == 'sequence':
            return [content(item, where(item)) for item in node.value]
        section = Section(file, at)
        for name, value in node.value:
            at = where(name)
            key = content(name, at)
            if not isinstance(key, str):
                raise ReadError(file, f"{at}: expected a name, not '{key}'")
            if key in section:
                raise ReadError(file, f"{at}: '{key}' is given twice")
            section.places[key] = at
            section[key] = content(value, at)
        return section

    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', MantissaNoDotYAML1_1Warning)
            node = yaml.compose(text)
            return None if node is None else content(node, place or 'line 1')
    except (YAMLError, RecursionError, ValueError) as error:
        told = ' '.join(str(error).split())
        if BRACES.search(text):
            told += ": put text that begins with a brace, or has one within {...}, in 'quotes'"
        raise ReadError(file, f'not valid YAML: {told}') from None


def finite(value: Any) -> float:
    """Return a number that a user gave; NaN if it is not a finite number."""
    try:
        number = float('nan' if isinstance(value, bool) else value)
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return number if math.isfinite(number) else math.nan


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


def limits_of(kind: type[Kind], verb: str, profile: str, path: Path | None = None) -> Kind:
    """
    Return the limits of a profile, replaced by those in a YAML file.

    One file serves all verbs: ``{diagnose: {name: number}, inspect: {name: number}}``.

    :param kind: the dataclass of the verb's limits.
    :param path: of the file; None for the profile alone.
    :raises ReadError: the file cannot be read.
    :raises ConfigError: a limit does not exist or makes no sense.
    """
    if path is None:
        return kind.of(profile)
    content = load_yaml(path)
    content.expect(*LIMITED)
    section = content.section(verb)
    section.expect(*(item.name for item in fields(kind)))
    section.check_each(partial(kind.of, profile))
    return kind.of(profile, section)
