"""
What the stamps of one source show of how they were written.

Fractions that lost their zeros, whole seconds, and two runs in one file or topic: each would be
scored without a word, as another trajectory than the one that was recorded.
"""

from __future__ import annotations

import numpy as np

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.rows import Decimals, POWERS, STAMP_UNITS

#: steps back of stamps that show that their fractions lost zeros
FEWEST_FALSE_STEPS = 2
#: poses of each run within the time that both have: fewer are poses that came late
FEWEST_OF_RUN = 3
#: stamps that go back this often are of poses in disorder, not of so many runs
DISORDER_SHARE = 0.1
#: most steps back, the longest ones, at which a run may begin
MOST_STEPS_BACK = 64
#: share of poses with the stamp of another one, above which the stamps were cut
REPEATED_SHARE = 0.3


def padded(stamps: Decimals) -> Decimals | None:
    """
    Return stamps as they were meant, where fractions lost their leading zeros.

    Seconds and nanoseconds printed one after the other, ``"%d.%d"``, make 5.003000000 s into
    5.3000000: fractions of several lengths, none with a zero in front, that go back each second.

    :return: None where the stamps are as they should be.
    """
    digits, decimals = stamps
    most = int(decimals.max(initial=0))
    if most > STAMP_UNITS['s'] or int(decimals.min(initial=most)) == most or (digits < 0).any():
        return None
    whole, fraction = np.divmod(digits, 10**decimals)
    is_padded = (decimals > 1) & (fraction < 10 ** (decimals - 1).clip(min=0))
    if is_padded.any() or _steps_back(digits / POWERS[decimals]) < FEWEST_FALSE_STEPS:
        return None
    meant = whole * 10**most + fraction
    if _steps_back(meant):
        return None
    return Decimals(meant, np.full(len(meant), most))


def _steps_back(stamps: np.ndarray) -> int:
    return int(np.count_nonzero(np.diff(stamps) < 0))


def check_resolution(source: object, poses: Poses) -> None:
    """
    Check that stamps were not cut, such as to whole seconds.

    :raises ReadError: many poses have the stamp of the one before.
    """
    moved = np.diff(poses.positions, axis=0).any(axis=1)
    repeated = int(np.count_nonzero(moved & (np.diff(poses.stamps_ns) == 0)))
    if repeated > REPEATED_SHARE * len(poses):
        raise ReadError(
            source,
            f'{repeated} of {len(poses)} poses have the stamp of the pose before: the stamps were '
            'written with too few digits (whole seconds?); write them with all digits',
        )


def run_starts(poses: Poses) -> list[int]:
    """
    Return the rows at which runs begin, the first one included.

    Where stamps go back and the poses that follow lie in time among those before, this is another
    run over the same time, as where a log was opened to append or a recording was played twice.
    Sessions out of order share no time; poses that came late are few.
    """
    stamps_ns = poses.stamps_ns
    usable = np.isfinite(poses.positions).all(axis=1)
    if poses.zero_is_unset:
        usable &= stamps_ns != 0
    rows = np.flatnonzero(usable)
    stamps_ns = stamps_ns[rows]
    back = np.flatnonzero(np.diff(stamps_ns) < 0) + 1
    starts = [0]
    if len(back) > max(DISORDER_SHARE * len(rows), 1):
        return starts
    if len(back) > MOST_STEPS_BACK:
        longest = np.argsort(stamps_ns[back] - stamps_ns[back - 1], kind='stable')
        back = np.sort(back[longest[:MOST_STEPS_BACK]])
    for row in back.tolist():
        if _share_time(stamps_ns[starts[-1] : row], stamps_ns[row:]):
            starts.append(row)
    return [0, *rows[starts[1:]].tolist()]


def _share_time(before_ns: np.ndarray, after_ns: np.ndarray) -> bool:
    """Return whether two parts of a stream lie in time among each other."""
    first, last = max(after_ns.min(), before_ns.min()), min(before_ns.max(), after_ns.max())
    parts = [part[(part >= first) & (part <= last)] for part in (before_ns, after_ns)]
    fewest = min(map(len, parts))
    order = np.argsort(np.concatenate(parts), kind='stable')
    changes = np.count_nonzero(np.diff(order < len(parts[0])))
    return fewest >= FEWEST_OF_RUN and bool(changes >= fewest)


def run_of(source: str, poses: Poses, stated: str | None) -> Poses:
    """
    Return the poses of one run.

    :param source: spec, for messages.
    :param stated: the number of the run, from 1; None where the user states none.
    :raises ReadError: there are several, and none is stated.
    :raises ConfigError: there is no such run.
    """
    starts = run_starts(poses)
    if stated is not None:
        number = int(stated)
        if number > len(starts):
            known = 'is one run' if len(starts) == 1 else f'are {len(starts)} runs'
            raise ConfigError(f'{source}: run={number}, but there {known}')
        return poses[slice(*[*starts, None][number - 1 : number + 1])]
    if len(starts) > 1:
        second = starts[1]
        seconds = poses.stamps_ns[second - 1 : second + 1] / 1e9
        runs = ' or '.join(f'{"&" if "?" in source else "?"}run={k + 1}' for k in range(2))
        raise ReadError(
            source,
            f'{len(starts)} runs over the same time: at pose {second + 1} of {len(poses)} the '
            f'stamps jump back from {seconds[0]:.3f} to {seconds[1]:.3f} s and a second run '
            f'begins; append {runs} to choose one',
        )
    return poses
