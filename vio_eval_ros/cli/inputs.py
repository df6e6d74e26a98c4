"""What verbs compare: an estimate and a ground truth, of a recording or from files."""

from __future__ import annotations

import argparse
from pathlib import Path
import shlex
from typing import Any

from vio_eval_ros.cli.shell import Parser, progress
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.sources import check_times, default_topics, read_sources, Source
from vio_eval_ros.recordings.spec import Spec


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


def add_inputs(parser: Parser) -> None:
    """Add RECORDING, ``--estimate``, ``--ground-truth`` and ``--times``."""

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
        action=_Once,
        metavar='SPEC',
        help='/topic, /tf:PARENT.CHILD, a file, or RECORDING:/topic; append conventions '
        "after '?': quaternion=wxyz, stamps=ns, invert=pose (default: the only one there is)",
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


def sources_of(arguments: argparse.Namespace) -> list[Source]:
    """Return the estimate and the ground truth."""
    recording = arguments.recording
    specs = [arguments.estimate, arguments.ground_truth]
    if None in specs:
        if recording is None:
            raise ConfigError('give a RECORDING, or both --estimate and --ground-truth')
        defaults = default_topics(recording, *specs)
        specs = [
            default if given is None else given
            for given, default in zip(specs, defaults, strict=True)
        ]
    elif recording is not None and all(
        Spec.parse(spec, beside_recording=True).path for spec in specs
    ):
        raise ConfigError(f'{recording} is not used: --estimate and --ground-truth are elsewhere')
    sources = read_sources(specs, recording, arguments.times, progress)
    check_times(arguments.times, sources)
    return sources
