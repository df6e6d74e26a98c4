"""What the shell offers for an argument when Tab is pressed; other arguments get paths."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from typing import Any

Completer = Callable[..., Iterable[str]]


def complete(action: argparse.Action, completer: Completer) -> None:
    """Complete an argument with argcomplete, if that is what runs the parser."""
    action.completer = completer  # type: ignore[attr-defined]


def words(choices: Iterable[str]) -> Completer:
    """Return what offers some words; those with another beginning are left out."""
    return lambda **_: choices


def reports(formats: Iterable[str]) -> Completer:
    """Return what offers a format with its colon, and then paths."""

    def offer(prefix: str, **_: Any) -> list[str]:
        name, colon, path = prefix.partition(':')
        if not colon:
            return [f'{name}:' for name in formats]
        from argcomplete.completers import FilesCompleter

        return [f'{name}:{found}' for found in FilesCompleter()(path)]

    return offer
