"""A diagnosis as text."""

from __future__ import annotations

from collections.abc import Sequence
import math
import shlex

from vio_eval_ros.diagnosis.diagnosed_run import ATE
from vio_eval_ros.diagnosis.gyroscope import GyroscopeComparison
from vio_eval_ros.diagnosis.report import Cause, Diagnosis
from vio_eval_ros.diagnosis.signals import SignalLag
from vio_eval_ros.diagnosis.warnings import late_or_early, SIDE_NAMES
from vio_eval_ros.rendering.text import number, percent

#: moments that are listed of a cause
LISTED = 5
#: a lower correlation of signals is not to be relied on
RELIABLE_CORRELATION = 0.6


def diagnosis_text(diagnosis: Diagnosis, errors: bool = False, command: str = '') -> list[str]:
    """
    Return the lines of a diagnosis: what was assumed, causes, what cannot be told, warnings.

    :param errors: whether to list the errors before and after all causes are undone.
    :param command: that corrects all that flags can correct, where there is one.
    """
    lines = [line for sentence in diagnosis.assumed for line in (f'warning: {sentence}', '')]
    others = diagnosis.warnings[len(diagnosis.assumed) :]
    lines += _causes(diagnosis) if diagnosis.causes else _no_causes(diagnosis, others)
    if command:
        lines += ['', f'corrected by: {command}']
    if diagnosis.cannot_tell:
        lines += ['', cannot_tell(diagnosis)]
    lines += [line for warning in others for line in ('', f'warning: {warning}')]
    if errors:
        lines += _before_and_after(diagnosis)
    if diagnosis.gyroscope is not None:
        lines += _gyroscope(diagnosis.gyroscope)
    return lines


def cannot_tell(diagnosis: Diagnosis) -> str:
    """Return which causes this run cannot show."""
    names = ', '.join(diagnosis.cannot_tell)
    return f'cannot tell, because the motion or the data do not show it: {names}'


def _no_causes(diagnosis: Diagnosis, others: Sequence[str]) -> list[str]:
    """Return that nothing is unusual, and the ATE that has no explanation."""
    ate_m = diagnosis.errors_before.get(ATE, math.nan)
    return [
        'nothing unusual' + ', apart from the warnings below' * bool(others),
        f'   ATE {number(ate_m)} m: no known cause explains it.',
    ]


def _causes(diagnosis: Diagnosis) -> list[str]:
    """Return one paragraph a cause."""
    lines = []
    for place, cause in enumerate(diagnosis.causes, 1):
        if place > 1:
            lines.append('')
        lines.append(f'{place}. {cause.name}  (confidence {percent(cause.confidence)})')
        lines += [f'   {sentence}' for sentence in sentences_of(cause, diagnosis)]
    return lines


def sentences_of(cause: Cause, diagnosis: Diagnosis) -> list[str]:
    """Return what there is to say of a cause: evidence, ATE, moments, advice, flags."""
    lines = [f'{SIDE_NAMES[cause.side]}: {cause.evidence}.']
    if math.isfinite(cause.ate_before_m + cause.ate_after_m):
        first = cause is diagnosis.causes[0]
        lines.append(
            f'ATE {number(cause.ate_before_m)} m as it is'
            + ('' if first else ', with the causes above undone')
            + f'; {number(cause.ate_after_m)} m with this one undone.'
        )
    return [*lines, *_moments(cause, diagnosis), cause.advice, *_flags(cause)]


def _flags(cause: Cause) -> list[str]:
    """Return where to put the flags that correct a cause, if there are any."""
    if not cause.flags:
        return []
    appended = cause.flags[0].startswith('?')
    where = f'append to the spec of {SIDE_NAMES[cause.side]}' if appended else 'replay'
    return [f'{where}: {shlex.join(cause.flags)}']


def _moments(cause: Cause, diagnosis: Diagnosis) -> list[str]:
    """Return when it happened, in seconds of the estimate, of a cause that has moments."""
    findings = diagnosis.findings

    def at(stamp_ns: int) -> str:
        seconds = (stamp_ns - diagnosis.begin_ns) / 1e9
        where = f'{seconds:.2f} s into the run' if seconds >= 0 else f'{-seconds:.2f} s before it'
        return f'{stamp_ns / 1e9:.3f} ({where})'

    moments = []
    if cause.name == 'jump':
        moments = [
            f'{at(jump["stamp_ns"])}: {jump["size_m"]:.2f} m'
            + f', rotated by {jump["turn_deg"]:.1f} deg' * bool(jump['turn_deg'])
            for jump in findings['jumps']
            if jump['harmful']
        ]
    elif cause.name == 'outliers':
        moments = [at(stamp) for stamp in findings['outlier_poses']['stamps_ns']]
    elif cause.name == 'lost_tracking':
        moments = [f'{at(gap["begin_ns"])}: {gap["seconds"]:.1f} s' for gap in findings['gaps']]
    more = [f'and {len(moments) - LISTED} more'] if len(moments) > LISTED else []
    return [f'at {moment}' for moment in moments[:LISTED]] + more


def _before_and_after(diagnosis: Diagnosis) -> list[str]:
    """Return the table of errors."""
    lines = ['', f'{"with all causes undone":<26}{"before":>10}{"after":>10}']
    return lines + [
        f'{name:<26}'
        + ''.join(f'{number(math.nan if v is None else v):>10}' for v in values.values())
        for name, values in diagnosis.errors().items()
    ]


def _gyroscope(found: GyroscopeComparison) -> list[str]:
    """Return how a gyroscope agrees with the estimate."""
    quaternion = ' '.join(f'{value:.5f}' for value in found.turn_xyzw)
    return [
        '',
        f'gyroscope     the stamps of the estimate are {1e3 * abs(found.offset_s):.2f} ± '
        f'{1e3 * found.offset_uncertainty_s:.2f} ms {late_or_early(found.offset_s)} with respect '
        'to it',
        f'              its rotation in the tracked frame: {found.turn_deg:.2f} ± '
        f'{found.turn_uncertainty_deg:.2f} deg, x y z w {quaternion}',
        f'              its bias: {" ".join(f"{value:.4f}" for value in found.bias_rad_s)} rad/s',
        f'              relative rotations differ by {percent(found.misfit)} of their size',
    ]


def signals_text(found: SignalLag, names: Sequence[object], left_out: Sequence[int]) -> list[str]:
    """
    Return the lines of a lag between two signals.

    :param names: of the two.
    :param left_out: how many rows of each could not be used.
    """
    lines = [
        f'the stamps of {names[0]} are {1e3 * abs(found.offset_s):.2f} ± '
        f'{1e3 * found.uncertainty_s:.2f} ms {late_or_early(found.offset_s)} with respect to '
        f'those of {names[1]}',
        f'correlation {number(found.sign * found.peak)}, at the next peak '
        f'{number(found.next_peak)}',
    ]
    if found.sign < 0:
        lines.append('the signs are opposite: one signal rises where the other falls')
    if found.ambiguous:
        lines.append(
            'the lag is ambiguous: at another one the signals agree nearly as well; the interval '
            'is that of this one only'
        )
    if not found.peak > RELIABLE_CORRELATION:
        lines.append('the signals hardly correlate: do not rely on it')
    return lines + [
        f'{count} rows of {name} repeat a stamp or are not finite numbers, and were left out'
        for name, count in zip(names, left_out, strict=True)
        if count
    ]
