"""A sequence as the suite's file has it: what it states itself, over what is stated for all."""

from __future__ import annotations

from collections.abc import Iterator
from glob import escape
from pathlib import Path
import re
from typing import NamedTuple

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.spec import exists
from vio_eval_ros.settings import Section

PLACEHOLDER = re.compile(r'\{(\w*)\}')
PLACEHOLDERS = ('sequence', 'system')


class Entry(NamedTuple):
    """
    The sections that say something of a sequence, or of one system on it.

    :param layers: from the suite, which speaks for all, to the sequence and then the system.
    :param own: what the sequence states itself.
    :param system: its name; empty in a suite of only one.
    """

    layers: tuple[Section, ...]
    own: Section
    system: str = ''

    @property
    def name(self) -> str:
        """The name of the sequence."""
        return self.own.required_text('name')

    @property
    def base(self) -> Path:
        """The folder that paths are relative to."""
        return self.own.file.parent

    def stating(self, key: str) -> Section:
        """Return the innermost section that states a key; the suite where none does."""
        return next((layer for layer in reversed(self.layers) if key in layer), self.layers[0])

    def error(self, key: str, problem: object) -> ConfigError:
        """Return the error for a problem with a key where it is stated, or with its absence."""
        section = self.stating(key)
        return (section if key in section else self.own).error(key, problem)

    def sections(self, key: str) -> Iterator[Section]:
        """Yield the mapping that each layer has under a key, the suite's first."""
        return (layer.section(key) for layer in self.layers)

    def text(self, key: str) -> str | None:
        """Return the text under a key in the innermost layer that has one."""
        found = (layer.text(key) for layer in reversed(self.layers))
        return next((text for text in found if text), None)

    def texts(self, key: str) -> list[str]:
        """Return the texts under a key in the innermost layer that has some."""
        found = (layer.texts(key) for layer in reversed(self.layers))
        return next((texts for texts in found if texts), [])

    def path(self, key: str) -> str | None:
        """
        Return the path or glob under a key, with names in place of {sequence} and {system}.

        :raises ConfigError: something else stands in braces, and there is no file of that name.
        """
        text = self.text(key)
        if text is None or '{' not in text or exists(self.base / text):
            return text
        names = {'sequence': self.name, 'system': self.system}
        for word in PLACEHOLDER.findall(text):
            if word not in names:
                raise self.error(
                    key,
                    f"{key}: '{{{word}}}' stands for nothing; there are {{sequence}} and "
                    f'{{system}}{nearest_name(word, PLACEHOLDERS)}',
                )
            if not names[word]:
                problem = 'stands for nothing: list systems: [{name, estimate}]'
                raise self.error(key, f'{key}: {{{word}}} {problem}')
        return PLACEHOLDER.sub(lambda match: escape(names[match[1]]), text)

    def required_path(self, key: str) -> str:
        """Return the path or glob under a key that must be there."""
        path = self.path(key)
        if not path:
            raise self.error(key, f'{key} is missing')
        return path
