"""
Limits between healthy and not: what a user may hold another opinion on, each in one place.

A family of checks has a frozen dataclass of limits. Its defaults are those of the profile
``drone``; another profile changes the few that depend on the platform. Flags, YAML, node
parameters, JSON and the tables in the docs derive from the dataclass.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import NoneType
from typing import Any, ClassVar, NamedTuple, TypeVar

from vio_eval_ros.core.config import nearest_name, Options
from vio_eval_ros.errors import ConfigError

PROFILES = ('drone', 'car', 'handheld', 'legged', 'indoor_robot')
Kind = TypeVar('Kind', bound='Limits')


def limit(
    default: float, unit: str, meaning: str, source: str, minimum: float | None = 0.0
) -> Any:
    """
    Return the field of a limit.

    :param unit: of the number, such as ``m`` or ``%``; empty for a ratio or a count.
    :param meaning: what is beyond it, in half a sentence.
    :param source: the publication that the number is from, or what it was chosen on.
    """
    metadata = {
        'description': meaning,
        'choices': (),
        'minimum': minimum,
        'unit': unit,
        'source': source,
    }
    return field(default=default, metadata=metadata)


class Described(NamedTuple):
    """A limit as the docs list it."""

    name: str
    value: float
    unit: str
    meaning: str
    source: str


@dataclass(frozen=True)
class Limits(Options):
    """A family of limits; ``ConfigError`` where a value makes no sense."""

    #: profile to the limits that it changes; a profile without an entry has the defaults
    PROFILED: ClassVar[Mapping[str, Mapping[str, float]]] = {}

    @classmethod
    def of(cls: type[Kind], profile: str, stated: Mapping[str, Any] | None = None) -> Kind:
        """
        Return the limits of a profile, with those that are stated in their place.

        :raises ConfigError: there is no such profile or limit, or a value makes no sense.
        """
        if profile not in PROFILES:
            raise ConfigError(
                f"profile: '{profile}' is not one of {', '.join(PROFILES)}"
                + nearest_name(profile, PROFILES)
            )
        if not isinstance(stated, (Mapping, NoneType)):
            raise ConfigError(
                f'limits: expected a mapping of names to numbers, got {type(stated).__name__}'
            )
        names = [item.name for item in fields(cls)]
        for name in stated or ():
            if name not in names:
                raise ConfigError(f"there is no limit '{name}' here{nearest_name(name, names)}")
        return cls.from_mapping({**cls.PROFILED.get(profile, {}), **(stated or {})})

    @classmethod
    def described(cls) -> list[Described]:
        """Return every limit at its default, with unit, meaning and source."""
        return [
            Described(
                item.name,
                item.default,  # type: ignore[arg-type]
                item.metadata['unit'],
                item.metadata['description'],
                item.metadata['source'],
            )
            for item in fields(cls)
        ]

    def to_dict(self) -> dict[str, float]:
        """Return every limit by its name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}
