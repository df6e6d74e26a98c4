"""What to know of two sides that is not a cause."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vio_eval_ros.diagnosis.causes.clocks import LARGEST_RESIDUAL_RATIO
from vio_eval_ros.diagnosis.gyroscope import GyroscopeComparison
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.rendering.text import percent

SIDE_NAMES = {'estimate': 'the estimate', 'ground_truth': 'the ground truth'}


def warnings_of(
    findings: Mapping[str, Any], gyroscope: GyroscopeComparison | None, limits: DiagnosisLimits
) -> list[str]:
    """Return what the findings and a gyroscope warn of, as sentences."""
    return [
        *_left_out(findings),
        *_repetition(findings),
        *_initialisation(findings, limits),
        *_contradictions(findings),
        *_interpolation(findings),
        *([] if gyroscope is None else _disagreements(gyroscope, limits)),
    ]


def _left_out(findings: Mapping[str, Any]) -> list[str]:
    """Return which poses and orientations of the sides were not used."""
    warnings = []
    for side, reasons in findings.get('dropped', {}).items():
        said = ', '.join(f'{count} {reason}' for reason, count in reasons.items() if count)
        if said:
            warnings.append(f'{SIDE_NAMES[side]} has poses that were left out: {said}.')
    for side, count in findings.get('stamps_far_from_all_others', {}).items():
        if count:
            warnings.append(
                f'{SIDE_NAMES[side]} has poses with stamps far from all others, left out: {count}.'
            )
    for what, said in (('never_change', 'the same'), ('are_unusable', 'zero or not a number')):
        warnings += [
            f'all orientations of {SIDE_NAMES[side]} are {said}, as if they had never been '
            'filled in: they were left out, and what only orientations show cannot be determined.'
            for side in findings.get(f'orientations_that_{what}', [])
        ]
    return warnings


def _repetition(findings: Mapping[str, Any]) -> list[str]:
    """Return that several offsets explain the motion equally well, where they do."""
    offsets_s = findings.get('equally_likely_offsets_s')
    if offsets_s is None:
        return []
    said = ', '.join(f'{offset_s:.3f}' for offset_s in offsets_s)
    return [
        f'the motion repeats itself: the estimate may be late by {said} s equally well, and '
        'nothing else can be told before that is known. State it with --time-offset-s, which is '
        f'added to its stamps ({-offsets_s[0]:.3f} for the first).'
    ]


def _initialisation(findings: Mapping[str, Any], limits: DiagnosisLimits) -> list[str]:
    """Return after how long the estimate begins, where that is long."""
    initialised = findings.get('initialised', {'percent': 0.0})
    if not initialised['percent'] > limits.late_start_percent:
        return []
    return [
        f'the estimate initialised after {initialised["after_s"]:.1f} s, '
        f'{initialised["percent"]:.0f} % of the ground truth: it says nothing of that time.'
    ]


def _contradictions(findings: Mapping[str, Any]) -> list[str]:
    """Return that positions and orientations have different offsets, where they do."""
    late_s = findings.get('positions_late_s')
    if late_s is None:
        return []
    offset = findings['time_offset']
    return [
        f'by its orientations the estimate is {1e3 * offset["value"]:.1f} ± '
        f'{1e3 * offset["uncertainty"]:.1f} ms late, and its positions are about '
        f'{1e3 * abs(late_s):.0f} ms {"later" if late_s > 0 else "earlier"} than these: one side '
        'takes them from different moments.'
    ]


def _interpolation(findings: Mapping[str, Any]) -> list[str]:
    """Return that the truth was interpolated, where it was."""
    interval_s = findings.get('truth_interpolated_s')
    if interval_s is None:
        return []
    return [
        f'the ground truth was interpolated from poses {1e3 * interval_s:.4g} ms apart: it cuts '
        'corners between them, and errors of faster motion may be its own. Use the poses it was '
        'made from.'
    ]


def _disagreements(found: GyroscopeComparison, limits: DiagnosisLimits) -> list[str]:
    """Return how a gyroscope disagrees with the estimate beyond what is healthy."""
    warnings, said = [], []
    if found.degrees:
        warnings.append(
            'the gyroscope has rates some 57 times those of the estimate: they were taken for '
            'deg/s; sensor_msgs/Imu has rad/s.'
        )
    if found.mirrored:
        said.append(
            'its rates agree only with an axis mirrored or two swapped, so that its rotation and '
            'bias below mean nothing'
        )
    elif found.misfit > LARGEST_RESIDUAL_RATIO:
        said.append(
            f'relative rotations differ by {percent(found.misfit)} of their size, as if it '
            'belonged to another run'
        )
    elif found.turn_deg - limits.sensor_rotation_deg > found.turn_uncertainty_deg:
        said.append(
            f'it is rotated by {found.turn_deg:.1f} deg in the tracked frame, which is right only '
            'if the tracked frame is not that of the IMU'
        )
    if abs(found.offset_s) - limits.time_offset_s > found.offset_uncertainty_s:
        said.append(
            f'the estimate is {1e3 * abs(found.offset_s):.1f} ms '
            f'{late_or_early(found.offset_s)} with respect to it'
        )
    return warnings + [f'the gyroscope disagrees: {"; ".join(said)}.'] * bool(said)


def late_or_early(offset_s: float) -> str:
    """Return the word for the sign of an offset."""
    return 'late' if offset_s > 0 else 'early'
