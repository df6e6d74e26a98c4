"""Says why an estimate is bad: names the causes, with evidence, and what corrects them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
import json
import math
from pathlib import Path
import shlex

import numpy as np

from vio_eval_ros.cli.inputs import add_inputs, sources_of
from vio_eval_ros.cli.shell import add_options, config_of, Parser, progress, run
from vio_eval_ros.core.cleaning import clean, Cleaning, LARGEST
from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.diagnosis import Cause, diagnose, Diagnosis, NAMES
from vio_eval_ros.diagnosis.gyroscope import compare, Comparison
from vio_eval_ros.diagnosis.measurements import MISFIT, OFFSET_S, TURN_DEG
from vio_eval_ros.diagnosis.signals import lag_of_signals, SignalLag
from vio_eval_ros.errors import ConfigError, FAILED, PASSED, ReadError
from vio_eval_ros.recordings.imu import read_imu
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.recordings.text import read_text
from vio_eval_ros.rendering.text import number, percent, printable

VERB = 'diagnose'
EXAMPLES = """
examples:
  diagnose run.mcap
  diagnose --estimate est.txt --ground-truth mav0 --apply
  diagnose run.mcap --fail-on time_offset,scale --json
  diagnose run.mcap --imu /imu0
  diagnose --signals imu.csv camera.csv

exit status: 0 diagnosed, 1 a cause named by --fail-on was found, 2 could not be done
"""
LISTED = 5
SIDES = {'estimate': 'the estimate', 'ground_truth': 'the ground truth'}


def main(argv: list[str] | None = None) -> int:
    """Run the verb; return its exit status."""
    arguments = _parser().parse_args(argv)
    return run(VERB, lambda: _run(arguments))


def _parser() -> Parser:
    parser = Parser(prog=VERB, description=__doc__, epilog=EXAMPLES)
    add_inputs(parser)
    others = parser.add_argument_group('other comparisons')
    others.add_argument(
        '--imu',
        metavar='SPEC',
        help='also compare the estimate with a gyroscope: /topic of RECORDING, '
        'RECORDING:/topic, or a CSV file',
    )
    others.add_argument(
        '--signals',
        nargs=2,
        type=Path,
        metavar='CSV',
        help='only find the lag between two signals, files of time and value',
    )
    output = parser.add_argument_group('output')
    output.add_argument(
        '--json', action='store_true', help='print the diagnosis as JSON, and nothing else'
    )
    output.add_argument(
        '--apply',
        action='store_true',
        help='evaluate with everything corrected, and show the errors before and after',
    )
    output.add_argument(
        '--fail-on',
        metavar='NAME,...',
        help='exit with status 1 where one of these causes is found',
    )
    add_options(parser)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    if arguments.signals:
        return _signals(arguments)
    failing = _failing(arguments.fail_on)
    config = config_of(arguments)
    estimate, truth = sources_of(arguments)
    counts = {'estimate': Cleaning(), 'ground_truth': Cleaning()}
    poses = _cleaned(estimate, counts['estimate'])
    diagnosis = diagnose(poses, _cleaned(truth, counts['ground_truth']), config)
    diagnosis.findings['dropped'] = {side: count.dropped for side, count in counts.items()}
    diagnosis = _stated({'estimate': estimate, 'ground_truth': truth}, diagnosis)
    gyroscope = None if arguments.imu is None else _gyroscope(arguments, poses)
    if arguments.json:
        found = diagnosis.to_dict()
        if gyroscope is not None:
            found['findings']['gyroscope'] = without_nan(vars(gyroscope))
        if arguments.apply:
            found['findings']['errors'] = _errors(diagnosis)
        print(json.dumps(found, indent=2, allow_nan=False))
    else:
        lines = _text(diagnosis, poses, gyroscope)
        if arguments.apply:
            lines += _before_and_after(diagnosis)
        if gyroscope is not None:
            lines += _gyroscope_text(gyroscope)
        print('\n'.join(map(printable, lines)))
    return FAILED if {cause.name for cause in diagnosis.causes} & failing else PASSED


def _failing(listed: str | None) -> set[str]:
    """Return the causes listed by ``--fail-on``."""
    names = set() if listed is None else {name.strip() for name in listed.split(',')}
    for name in names:
        if name not in NAMES:
            near = nearest_name(name, NAMES) or f'; there are {", ".join(NAMES)}'
            raise ConfigError(f"--fail-on: there is no cause '{name}'{near}")
    return names


def _cleaned(source: Source, counts: Cleaning) -> Trajectory:
    return clean(source.poses, counts)


def _stated(sources: dict[str, Source], diagnosis: Diagnosis) -> Diagnosis:
    """
    Return the diagnosis without flags that say no more than how a side was read.

    A topic has the order of its type. What cannot be stated leaves frames that no flag corrects.
    """
    causes, misread = [], set()
    for cause in diagnosis.causes:
        source = sources[cause.side]
        spec = Spec.parse(source.spec)
        order = spec.statements.get('quaternion', 'wxyz' if source.kind == 'euroc' else 'xyzw')
        stated = cause.flags == (f'?quaternion={order}',)
        if cause.name == 'quaternion_order' and (stated or spec.topic):
            misread.add(cause.side)
        kept = cause.side not in misread or cause.flags[:1] == ('--time-offset-s',)
        causes.append(cause if kept else replace(cause, flags=()))
    return replace(diagnosis, causes=tuple(causes))


def _text(diagnosis: Diagnosis, estimate: Trajectory, gyroscope: Comparison | None) -> list[str]:
    """Return what is wrong, one paragraph a cause, and what could not be told."""
    warnings = _warnings(diagnosis) + _disagreements(gyroscope)
    nothing = 'nothing unusual' + ', but for what is below' * bool(warnings)
    ate_m = diagnosis.errors_before.get('ATE [m]', math.nan)
    explained = f'   ATE {number(ate_m)} m: none of it has a cause that is known here.'
    lines = [] if diagnosis.causes else [nothing, explained]
    for number_of, cause in enumerate(diagnosis.causes, 1):
        if number_of > 1:
            lines.append('')
        lines += [
            f'{number_of}. {cause.name}  (confidence {percent(cause.confidence)})',
            f'   {SIDES[cause.side]}: {cause.evidence}.',
        ]
        if math.isfinite(cause.ate_before_m + cause.ate_after_m):
            lines.append(
                f'   ATE {number(cause.ate_before_m)} m as it is'
                + (', with the causes above undone' if number_of > 1 else '')
                + f'; {number(cause.ate_after_m)} m with this one undone.'
            )
        lines += _moments(cause, diagnosis, estimate)
        lines.append(f'   {cause.advice}')
        if cause.flags:
            shown = shlex.join(cause.flags)
            spec = f'behind the spec of {SIDES[cause.side]}'
            where = spec if cause.flags[0].startswith('?') else 'replay'
            lines.append(f'   {where}: {shown}')
    if diagnosis.cannot_tell:
        lines += ['', 'cannot tell, because the motion or the data do not show it: '
                  + ', '.join(diagnosis.cannot_tell)]  # fmt: skip
    return lines + [line for warning in warnings for line in ('', f'warning: {warning}')]


def _warnings(diagnosis: Diagnosis) -> list[str]:
    """Return what to know of these poses that is the fault of neither side alone."""
    findings, warnings = diagnosis.findings, []
    for side, reasons in findings.get('dropped', {}).items():
        said = ', '.join(f'{count} {reason}' for reason, count in reasons.items() if count)
        if said:
            warnings.append(f'{SIDES[side]} has poses that were left out: {said}.')
    for side, count in findings.get('stamps_far_from_all_others', {}).items():
        if count:
            warnings.append(
                f'{SIDES[side]} has poses with stamps far from all others, left out: {count}.'
            )
    for side in findings.get('orientations_that_never_change', []):
        warnings.append(
            f'all orientations of {SIDES[side]} are the same, as if they had never been filled '
            'in: they were left out, and what only orientations tell is not known.'
        )
    if findings.get('positions_late_s') is not None:
        offset, late_s = findings['time_offset'], findings['positions_late_s']
        warnings.append(
            f'by its orientations the estimate is {1e3 * offset["value"]:.1f} ± '
            f'{1e3 * offset["uncertainty"]:.1f} ms late, and its positions are about '
            f'{1e3 * abs(late_s):.0f} ms {"later" if late_s > 0 else "earlier"} than these: one '
            'side takes them from different moments.'
        )
    if findings.get('truth_interpolated_s') is not None:
        knots = f'poses {1e3 * findings["truth_interpolated_s"]:.4g} ms apart'
        warnings.append(
            f'the ground truth was interpolated from {knots}: it cuts corners between them, and '
            'errors of faster motion may be its own. Use the poses it was made from.'
        )
    return warnings


def _moments(cause: Cause, diagnosis: Diagnosis, estimate: Trajectory) -> list[str]:
    """Return when it happened, in seconds of the estimate, of a cause that has moments."""
    begin_ns = int(estimate.stamps_ns[0])

    def at(stamp_ns: int) -> str:
        seconds = (stamp_ns - begin_ns) / 1e9
        where = f'{seconds:.2f} s into the run' if seconds >= 0 else f'{-seconds:.2f} s before it'
        return f'{stamp_ns / 1e9:.3f} ({where})'

    moments = []
    if cause.name == 'jump':
        moments = [
            f'{at(jump["stamp_ns"])}: {jump["size_m"]:.2f} m'
            + f', turned by {jump["turn_deg"]:.1f} deg' * bool(jump['turn_deg'])
            for jump in diagnosis.findings['jumps']
            if jump['harmful']
        ]
    elif cause.name == 'outliers':
        moments = [at(stamp) for stamp in diagnosis.findings['outlier_poses']['stamps_ns']]
    elif cause.name == 'lost_tracking':
        moments = [
            f'{at(gap["begin_ns"])}: {gap["seconds"]:.1f} s' for gap in diagnosis.findings['gaps']
        ]
    more = [f'   and {len(moments) - LISTED} more'] if len(moments) > LISTED else []
    return [f'   at {moment}' for moment in moments[:LISTED]] + more


def _errors(diagnosis: Diagnosis) -> dict[str, dict[str, float | None]]:
    """Return each error before and after, by its name."""
    after = diagnosis.errors_after
    return {
        name: without_nan({'before': value, 'after': after.get(name)})
        for name, value in diagnosis.errors_before.items()
    }


def _before_and_after(diagnosis: Diagnosis) -> list[str]:
    lines = ['', f'{"with all causes undone":<26}{"before":>10}{"after":>10}']
    return lines + [
        f'{name:<26}'
        + ''.join(f'{number(math.nan if v is None else v):>10}' for v in values.values())
        for name, values in _errors(diagnosis).items()
    ]


def _gyroscope(arguments: argparse.Namespace, estimate: Trajectory) -> Comparison:
    """Return how the estimate goes with the gyroscope that was asked for."""
    spec = Spec.parse(arguments.imu)
    path = spec.path or arguments.recording
    if path is None:
        raise ReadError(
            arguments.imu, 'a topic needs a RECORDING, given first or as RECORDING:/topic'
        )
    blocks: list[tuple[np.ndarray, np.ndarray]] = []
    source = read_imu(
        path,
        spec.topic,
        lambda stamps, samples: blocks.append((stamps, samples[:, :3])),
        progress,
        f'--imu {spec.path}:' if spec.path else '--imu ',
    )
    stamps_ns, rates = (np.concatenate(part) for part in zip(*blocks, strict=True))
    if source.units.get('gyro') == 'deg/s':
        rates = np.radians(rates)
    return compare(estimate, stamps_ns, rates)


def _disagreements(found: Comparison | None) -> list[str]:
    """Return what a gyroscope says of the estimate that no healthy one would hear."""
    if found is None:
        return []
    warnings, said = [], []
    if found.degrees:
        warnings.append(
            'the gyroscope has rates some 57 times those of the estimate: they were taken for '
            'deg/s; sensor_msgs/Imu has rad/s.'
        )
    late = 'late' if found.offset_s > 0 else 'early'
    if found.mirrored:
        said.append(
            'its rates fit only with an axis mirrored or two swapped, so that its rotation and '
            'bias below mean nothing'
        )
    elif found.misfit > MISFIT:
        said.append(
            f'relative rotations differ by {percent(found.misfit)} of their size, as if it were '
            'not that of this estimate'
        )
    elif found.turn_deg - TURN_DEG > found.turn_uncertainty_deg:
        said.append(
            f'it is turned by {found.turn_deg:.1f} deg in the tracked frame, as it should be only '
            'where that is another frame than its own'
        )
    if abs(found.offset_s) - OFFSET_S > found.offset_uncertainty_s:
        said.append(f'the estimate is {1e3 * abs(found.offset_s):.1f} ms {late} against it')
    return warnings + [f'the gyroscope disagrees: {"; ".join(said)}.'] * bool(said)


def _gyroscope_text(found: Comparison) -> list[str]:
    late = 'late' if found.offset_s > 0 else 'early'
    quaternion = ' '.join(f'{value:.5f}' for value in found.turn_xyzw)
    return [
        '',
        f'gyroscope     the stamps of the estimate are {1e3 * abs(found.offset_s):.2f} ± '
        f'{1e3 * found.offset_uncertainty_s:.2f} ms {late} against it',
        f'              its rotation in the tracked frame: {found.turn_deg:.2f} ± '
        f'{found.turn_uncertainty_deg:.2f} deg, x y z w {quaternion}',
        f'              its bias: {" ".join(f"{value:.4f}" for value in found.bias_rad_s)} rad/s',
        f'              relative rotations differ by {percent(found.misfit)} of their size',
    ]


def _signals(arguments: argparse.Namespace) -> int:
    """Print the lag between two signals."""
    others = ('recording', 'estimate', 'ground_truth', 'times', 'imu', 'apply', 'fail_on')
    for name in others:
        if getattr(arguments, name) not in (None, False):
            flag = name.upper() if name == 'recording' else f'--{name.replace("_", "-")}'
            raise ConfigError(f'--signals stands alone: leave out {flag}')
    signals = [_signal(path) for path in arguments.signals]
    start_ns = signals[1][0][0]
    seconds = [(stamps_ns - start_ns) / 1e9 for stamps_ns, _, _ in signals]
    found = lag_of_signals(seconds[0], signals[0][1], seconds[1], signals[1][1])
    left_out = [count for _, _, count in signals]
    if arguments.json:
        values = {'schema': 'vio_eval_ros.signal_lag/1'} | without_nan(vars(found))
        print(json.dumps(values | {'left_out': left_out}, indent=2, allow_nan=False))
    else:
        lines = _signals_text(found, arguments.signals)
        lines += [
            f'{count} rows of {path} repeat a stamp or are no finite numbers, and were left out'
            for path, count in zip(arguments.signals, left_out, strict=True)
            if count
        ]
        print('\n'.join(map(printable, lines)))
    return PASSED


def _signals_text(found: SignalLag, paths: Sequence[Path]) -> list[str]:
    late = 'late' if found.offset_s > 0 else 'early'
    lines = [
        f'the stamps of {paths[0]} are {1e3 * abs(found.offset_s):.2f} ± '
        f'{1e3 * found.uncertainty_s:.2f} ms {late} against those of {paths[1]}',
        f'correlation {number(found.sign * found.peak)}, at the next peak '
        f'{number(found.next_peak)}',
    ]
    if found.sign < 0:
        lines.append('the signs are opposite: one signal rises where the other falls')
    if found.ambiguous:
        lines.append(
            'the lag is ambiguous: at another the signals are nearly as alike; the interval is '
            'that of this one only'
        )
    if not found.peak > 0.6:
        lines.append('the signals are hardly alike: do not rely on it')
    return lines


def _signal(path: Path) -> tuple[np.ndarray, np.ndarray, int]:
    """Return stamps [ns], increasing, values, and how many rows of a file are neither."""
    rows = read_text(path).rows
    if rows.values.shape[1] < 2:
        raise ReadError(path, 'a signal has two columns, time and value')
    stamps_ns, first = np.unique(rows.nanoseconds(path, rows.likely_unit), return_index=True)
    values = rows.values[first, 1]
    known = np.abs(values) < LARGEST
    if not known.any():
        raise ReadError(path, 'its second column has no finite value')
    kept = stamps_ns[known]
    return kept, values[known], len(rows.values) - len(kept)
