"""A sequence as the suite's file has it: what it states itself, over what is stated for all."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from vio_eval_ros.settings import Section


class Entry(NamedTuple):
    """
    The sections that say something of a sequence.

    :param layers: from the suite, which speaks for all of them, to the sequence itself.
    """

    layers: tuple[Section, ...]

    @property
    def own(self) -> Section:
        """What the sequence states itself."""
        return self.layers[-1]

    @property
    def name(self) -> str:
        """The name of the sequence."""
        return self.own.required_text('name')

    def stating(self, key: str) -> Section:
        """Return the innermost section that states a key; the suite where none does."""
        return next((layer for layer in reversed(self.layers) if key in layer), self.layers[0])

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
