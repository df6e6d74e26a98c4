"""What verbs compare: an estimate and a ground truth, of a recording or from files."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
import re
import shlex
from typing import Any

from vio_eval_ros.cli.shell import Parser, progress
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.sources import (
    check_times,
    default_topics,
    read_each,
    read_sources,
    Source,
)
from vio_eval_ros.recordings.spec import exists, Spec

#: what can stand before the = of NAME=SPEC
SYSTEM_NAME = r'[^\W_][\w .+()-]*'


class _Once(argparse.Action):
    """Stores a value that must not be given twice: of two estimates one would be left out."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Store the value."""
        if getattr(namespace, self.dest) is not None:
            parser.error(f'{option_string} is given twice; run {parser.prog} once for each')
        setattr(namespace, self.dest, values)


def add_inputs(parser: Parser, several: bool = False) -> None:
    """
    Add RECORDING, ``--estimate``, ``--ground-truth`` and ``--times``.

    :param several: whether there may be many estimates, ``NAME=SPEC``, which are a list then.
    """

    def advise(word: str, arguments: argparse.Namespace) -> str:
        """Return the command that compares two files."""
        if arguments.estimate or arguments.ground_truth:
            return ''
        words = ['--estimate', str(arguments.recording), '--ground-truth', word]
        return f'; to compare two files, write: {parser.prog} {shlex.join(words)}'

    parser.advise = advise
    parser.add_argument(
        'recording',
        nargs='?',
        type=Path,
        metavar='RECORDING',
        help='ROS 1 .bag, rosbag2 folder, .db3 or .mcap',
    )
    parser.add_argument(
        '--estimate',
        **({'action': 'append', 'default': []} if several else {'action': _Once}),
        metavar='[NAME=]SPEC' if several else 'SPEC',
        help='/topic, /tf:PARENT.CHILD, a file, or RECORDING:/topic; append conventions '
        "after '?': quaternion=wxyz, stamps=ns, invert=pose (default: the only one there is)"
        + ('; may be repeated to compare systems, NAME=SPEC each' if several else ''),
    )
    parser.add_argument(
        '--ground-truth', action=_Once, metavar='SPEC', help='the same for the ground truth'
    )
    parser.add_argument(
        '--times',
        type=Path,
        metavar='FILE',
        help='the stamps [s] of poses that have none, such as KITTI pose files, one per line',
    )


def named_estimates(arguments: argparse.Namespace) -> dict[str, str]:
    """
    Return the estimates by the names of their systems; each is ``NAME=SPEC``, or a spec.

    A file of that very name is a spec without a name. Without one, the system has the name of its
    topic, or of its file without the suffix.

    :raises ConfigError: a name is given twice, or a spec states what makes no sense.
    """
    found: dict[str, str] = {}
    for text in arguments.estimate:
        name, equals, spec = text.partition('=')
        is_file = exists(Path(text)) or exists(Path(text.partition('?')[0]))
        if equals and not (name and spec) and not is_file:
            raise ConfigError(f"--estimate '{text}': write NAME=SPEC, or a spec alone")
        if not equals or not re.fullmatch(SYSTEM_NAME, name) or is_file:
            name, spec = '', text
        path, topic, _ = Spec.parse(spec, beside_recording=arguments.recording is not None)
        name = name or topic or (path or Path(spec)).stem
        if name in found:
            raise ConfigError(
                f"two estimates are called '{name}'; give each a name: --estimate NAME={spec}"
            )
        found[name] = spec
    return found


def sources_of(arguments: argparse.Namespace, estimate: str | None) -> list[Source]:
    """Return the estimate and the ground truth."""
    specs = _completed(arguments, [estimate])
    sources = read_sources(specs, arguments.recording, arguments.times, progress)
    check_times(arguments.times, sources)
    return sources


def each_source_of(
    arguments: argparse.Namespace, estimates: Mapping[str, str]
) -> tuple[dict[str, Source | Exception], Source]:
    """Return several estimates by name, or why they cannot be read, and the ground truth."""
    specs = _completed(arguments, list(estimates.values()))
    *found, truth = read_each(specs, arguments.recording, arguments.times, progress)
    if isinstance(truth, Exception):
        raise truth
    read = [one for one in found if isinstance(one, Source)]
    check_times(arguments.times, [*read, truth])
    return dict(zip(estimates, found, strict=True)), truth


def _completed(arguments: argparse.Namespace, estimates: Sequence[str | None]) -> list[str]:
    """Return the specs of the estimates and of the ground truth, missing ones by default."""
    recording, truth = arguments.recording, arguments.ground_truth
    if truth is None or None in estimates:
        if recording is None:
            raise ConfigError('give a RECORDING, or both --estimate and --ground-truth')
        estimate, truth = default_topics(recording, estimates[0], truth)
        estimates = [estimate, *estimates[1:]]
    specs = [*(spec for spec in estimates if spec is not None), truth]
    if recording is not None and all(
        Spec.parse(spec, beside_recording=True).path for spec in specs
    ):
        raise ConfigError(f'{recording} is not used: --estimate and --ground-truth are elsewhere')
    return specs
