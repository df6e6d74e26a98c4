"""The flags ``--profile`` and ``--limits``: what counts as healthy."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from vio_eval_ros.core.limits import Kind, PROFILES
from vio_eval_ros.settings import limits_of


def add_limits(group: Any) -> None:
    """Add ``--profile`` and ``--limits`` to a group of a parser."""
    group.add_argument(
        '--profile',
        choices=PROFILES,
        default=PROFILES[0],
        help='the platform, where what counts as healthy depends on it (default: %(default)s)',
    )
    group.add_argument(
        '--limits',
        type=Path,
        metavar='FILE',
        help='YAML file of limits to replace, under the name of the verb: {VERB: {NAME: number}}',
    )


def chosen_limits(arguments: argparse.Namespace, verb: str, kind: type[Kind]) -> Kind:
    """
    Return the limits that the command line chooses.

    :raises ConfigError: a limit does not exist or makes no sense; ReadError: an unreadable file.
    """
    return limits_of(kind, verb, arguments.profile, arguments.limits)
