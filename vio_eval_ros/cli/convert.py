"""Writes a trajectory in another format, changed on the way if wanted."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
import math
from pathlib import Path
import re

import numpy as np

from vio_eval_ros.cli.shell import Parser, progress, run
from vio_eval_ros.conversion import changes
from vio_eval_ros.conversion.formats import files_of, format_of, FORMATS, Names
from vio_eval_ros.conversion.staging import check_out, staged_path
from vio_eval_ros.core.cleaning import Cleaning
from vio_eval_ros.core.config import ALIGNMENTS, EvaluationConfig
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.orientations import why_positions_only
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError, PASSED
from vio_eval_ros.recordings.agreement.orders import alone
from vio_eval_ros.recordings.sources import check_times, read_sources, Source
from vio_eval_ros.rendering.text import printable
from vio_eval_ros.settings import finite

VERB = 'convert'
#: names that ROS allows: tokens of letters, digits and underscores, which begin with no digit
TOPIC = r'/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*'
EXAMPLES = """
changes, in this order: merge, crop, offset, axes, body, alignment, plane, stamps, fewer poses

examples:
  convert run.mcap:/odom est.tum
  convert V1_02_medium gt.tum --start-s 10 --end-s 60
  convert poses.txt --times times.txt est.bag --topic /vio/odometry
  convert est.txt aligned.tum --align-to gt.txt --alignment sim3
  convert px4.csv est.tum --axes ned --rate-hz 10

exit status: 0 done, 2 could not be done
"""


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run(VERB, lambda: _convert(arguments))


def _parser() -> Parser:
    parser = Parser(prog=VERB, description=__doc__, epilog=EXAMPLES)
    parser.add_argument(
        'specs', nargs='+', metavar='IN', help='a file, or RECORDING:/topic; several are merged'
    )
    parser.add_argument('out', type=Path, metavar='OUT', help='file or folder to write')
    kinds = ', '.join(f'{one.suffixes[0]} {name}' for name, one in FORMATS.items() if one.suffixes)
    parser.add_argument(
        '--format',
        choices=FORMATS,
        help=f'of OUT (default: by its suffix: {kinds}; without a suffix a rosbag2 folder)',
    )
    parser.add_argument('--times', type=Path, metavar='FILE', help='the stamps [s] of KITTI poses')
    parser.add_argument(
        '--force', action='store_true', help='replace OUT where it exists and is a file'
    )
    names = parser.add_argument_group('names in recordings')
    for name, default in Names()._asdict().items():
        names.add_argument(f'--{name}', help=f'(default: {default})')
    changed = parser.add_argument_group('changes')
    changed.add_argument('--start-s', metavar='S', help='leave out what is earlier than the first')
    changed.add_argument('--end-s', metavar='S', help='and what is later, likewise')
    changed.add_argument('--time-offset-s', metavar='S', help='added to the stamps')
    changed.add_argument(
        '--axes',
        choices=changes.AXES,
        help='make x forward or east, y left or north, z up: of north, east, down with a body of '
        "forward, right, down, or of a camera's optical axes",
    )
    changed.add_argument(
        '--to-body',
        nargs=7,
        metavar=('X', 'Y', 'Z', 'QX', 'QY', 'QZ', 'QW'),
        help='pose of the body in the frame that is tracked: write the body',
    )
    changed.add_argument('--align-to', metavar='SPEC', help='align as replay would, all of it')
    changed.add_argument('--alignment', choices=ALIGNMENTS, help='with --align-to (default: se3)')
    changed.add_argument('--plane', choices=changes.PLANES, help='project to a plane of the world')
    changed.add_argument(
        '--resample-to', metavar='SPEC', help='interpolate at the stamps of another trajectory'
    )
    changed.add_argument('--max-gap-s', metavar='S', help='over which it does (default: 0.5)')
    changed.add_argument('--every', metavar='N', help='keep every N-th pose')
    changed.add_argument('--rate-hz', metavar='HZ', help='keep at most so many poses a second')
    changed.add_argument(
        '--min-distance-m', metavar='M', help='keep what moved so far since the last one kept'
    )
    changed.add_argument('--min-angle-deg', metavar='DEG', help='or turned so far')
    return parser


def _convert(arguments: argparse.Namespace) -> int:
    kind = format_of(arguments.out, arguments.format)
    names = _names(arguments, kind)
    inputs = [*arguments.specs]
    others = [spec for spec in (arguments.align_to, arguments.resample_to) if spec]
    _check_out(arguments, kind)
    notes: list[str] = []
    sources = read_sources([*inputs, *others], None, arguments.times, progress)
    check_times(arguments.times, sources)
    sources = [*map(alone, sources[: len(inputs)]), *sources[len(inputs) :]]
    read = dict(zip([*range(len(inputs)), *others], sources, strict=True))
    used = [path for source in sources for path in source.paths]
    used += [arguments.times] if arguments.times else []
    taken = {path.resolve() for path in used}
    for path in files_of(arguments.out, kind):
        if path.resolve() in taken:
            raise ConfigError(f'{path} is an input; write to another file')
    parts = [_in_order(read[k], notes) for k in range(len(inputs))]
    if not any(map(len, parts)):
        raise ConfigError('; '.join(['there is no pose to write', *notes]))
    poses = _changed(arguments, parts, sources[0], read, notes)
    if poses.covariances is not None and not FORMATS[kind].has_covariances:
        notes.append(f'covariances are left out: {kind} has none')
    elif poses.covariances is not None and poses.rotations is None:
        notes.append('covariances are left out: messages with positions only have none')
    with staged_path(arguments.out) as path:
        FORMATS[kind].write(poses, path, names)
    kept = 'positions only' if poses.rotations is None else 'poses'
    lines = [*notes, f'{arguments.out} ({kind}): {len(poses):,} {kept}']
    print('\n'.join(map(printable, lines)))
    return PASSED


def _names(arguments: argparse.Namespace, kind: str) -> Names:
    """Return what a recording calls the trajectory."""
    stated = {name: getattr(arguments, name) for name in Names._fields}
    stated = {name: text for name, text in stated.items() if text is not None}
    if stated and not FORMATS[kind].has_covariances:
        raise ConfigError(f'--{next(iter(stated))}: {kind} files have no such name')
    names = Names(**stated)
    if not re.fullmatch(TOPIC, names.topic):
        raise ConfigError(f"--topic: '{names.topic}' is no name of a topic, such as /pose")
    return names


def _check_out(arguments: argparse.Namespace, kind: str) -> None:
    """Refuse to write where something is, unless that is a file and may be replaced."""
    for path in files_of(arguments.out, kind):
        if path.is_file() and not arguments.force:
            raise ConfigError(f'{path}: exists already; --force replaces it')
        if not path.is_file():
            check_out(path)


def _in_order(source: Source, notes: list[str]) -> Trajectory:
    """Return the usable poses of a source; what is left out or assumed goes to the notes."""
    counts = Cleaning()
    poses = changes.in_order(source.poses, counts)
    notes += [*source.warnings, *counts.warnings(source.spec)]
    if source.poses.rotations is not None and poses.rotations is None:
        notes.append(f'{source.spec}: orientations left out: {why_positions_only(source.poses)}')
    return poses


def _changed(
    arguments: argparse.Namespace,
    parts: list[Trajectory],
    first: Source,
    read: dict[int | str, Source],
    notes: list[str],
) -> Trajectory:
    """Return the poses after all changes, in the order that the help gives."""
    poses = parts[0]
    if len(parts) > 1:
        poses, dropped = changes.merged(parts)
        notes.append(f'merged {len(parts)} trajectories; {dropped} poses had a stamp twice')
        notes += dict.fromkeys(line for part in parts for line in _lost('merging', part, poses))
    for what, change in _changes(arguments, first, read):
        before, poses = poses, change(poses)
        if len(poses) != len(before):
            notes.append(f'{what}: {len(before):,} poses became {len(poses):,}')
        if not len(poses):
            raise ConfigError(f'{what}: none of {len(before):,} poses is left{_span(before)}')
        notes += _lost(what, before, poses)
    return poses


def _lost(what: str, before: Trajectory, after: Trajectory) -> Iterator[str]:
    """Yield which columns a change left out."""
    for name, column in (('orientations', 'rotations'), ('covariances', 'covariances')):
        if getattr(before, column) is not None and getattr(after, column) is None:
            yield f'{what}: {name} are left out'


def _changes(
    arguments: argparse.Namespace, first: Source, read: dict[int | str, Source]
) -> Iterator[tuple[str, Callable[[Trajectory], Trajectory]]]:
    """Yield each change that is asked for, with its name."""
    start_s = _number(arguments, 'start_s', 0.0, 0.0)
    end_s = _number(arguments, 'end_s', math.inf, 0.0)
    if not start_s < end_s:
        raise ConfigError(f'--start-s: {start_s:g} is not before --end-s: {end_s:g}')
    if start_s or math.isfinite(end_s):
        yield '--start-s, --end-s', lambda poses: changes.cropped(poses, start_s, end_s)
    if arguments.time_offset_s is not None:
        offset_s = EvaluationConfig(time_offset_s=arguments.time_offset_s).time_offset_s
        offset_ns = nanoseconds(offset_s)
        yield (
            '--time-offset-s',
            lambda poses: replace(poses, stamps_ns=poses.stamps_ns + offset_ns),
        )
    if arguments.axes:
        yield '--axes', lambda poses: changes.turned(poses, arguments.axes)
    if arguments.to_body is not None:
        config = EvaluationConfig.from_mapping({'estimate_to_body': arguments.to_body})
        yield '--to-body', Preparation.of_estimate(config).apply
    if arguments.align_to:
        yield '--align-to', lambda poses: _aligned(arguments, poses, first, read)
    elif arguments.alignment:
        raise ConfigError('--alignment needs --align-to SPEC')
    if arguments.plane:
        yield '--plane', lambda poses: changes.on_plane(poses, arguments.plane)
    if arguments.resample_to:
        stamps_ns = read[arguments.resample_to].stamps_ns
        max_gap_s = _number(arguments, 'max_gap_s', 0.5, 0.0)
        yield '--resample-to', lambda poses: _resampled(poses, stamps_ns, max_gap_s)
    elif arguments.max_gap_s is not None:
        raise ConfigError('--max-gap-s needs --resample-to SPEC')
    if arguments.every is not None:
        count = _number(arguments, 'every', 1.0, 1.0)
        if not count.is_integer():
            raise ConfigError('--every: expected a whole number')
        yield '--every', lambda poses: changes.every(poses, int(count))
    if arguments.rate_hz is not None:
        rate_hz = _number(arguments, 'rate_hz', 0.0, 1e-6)
        yield '--rate-hz', lambda poses: changes.at_rate(poses, rate_hz)
    if arguments.min_distance_m is not None or arguments.min_angle_deg is not None:
        distance_m = _number(arguments, 'min_distance_m', math.inf, 0.0)
        angle_deg = _number(arguments, 'min_angle_deg', math.inf, 0.0)
        yield (
            '--min-distance-m, --min-angle-deg',
            lambda poses: changes.after_motion(poses, distance_m, angle_deg),
        )


def _aligned(
    arguments: argparse.Namespace,
    poses: Trajectory,
    first: Source,
    read: dict[int | str, Source],
) -> Trajectory:
    """Return the poses in the world of another trajectory, under the alignment that replay has."""
    # few conversions are aligned, and an evaluation takes a while to import
    from vio_eval_ros.evaluation.recorded import score_run

    config = EvaluationConfig(alignment=arguments.alignment or 'se3')
    estimate = replace(first, poses=poses, causal=None, readings=())
    alignment = score_run(
        estimate, read[arguments.align_to], config, hashed=False
    ).summary.alignment
    aligned = alignment.apply(poses)
    if not np.isfinite(aligned.positions).all():
        raise ConfigError(f'--align-to {arguments.align_to}: {alignment.undetermined}')
    if not alignment.observable:
        return replace(aligned, rotations=None)
    return aligned


def _span(poses: Trajectory) -> str:
    """Return the time from which nothing is left."""
    first, last = poses.stamps_ns[0] / 1e9, poses.stamps_ns[-1] / 1e9
    return f'; they last {last - first:.3f} s, from {first:.3f} to {last:.3f} s'


def _resampled(poses: Trajectory, stamps_ns: np.ndarray, max_gap_s: float) -> Trajectory:
    if len(poses) < 2:
        raise ConfigError('--resample-to: fewer than two poses cannot be interpolated')
    return changes.resampled(poses, stamps_ns, max_gap_s)


def _number(
    arguments: argparse.Namespace, name: str, default: float, least: float = -math.inf
) -> float:
    """Return the number that an option has."""
    text = getattr(arguments, name)
    if text is None:
        return default
    value = finite(text)
    if not value >= least:
        wanted = 'a number' if least == -math.inf else f'a number >= {least:g}'
        raise ConfigError(f"--{name.replace('_', '-')}: expected {wanted}, not '{text}'")
    return value
