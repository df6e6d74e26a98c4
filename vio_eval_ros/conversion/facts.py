"""What there is to know of a trajectory by itself, before it is compared with any other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from itertools import pairwise
import math
from typing import Any, TYPE_CHECKING

import numpy as np

from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.intervals import longest_tracked
from vio_eval_ros.core.orientations import why_positions_only
from vio_eval_ros.core.steps import step_lengths
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.rendering.text import number

if TYPE_CHECKING:
    from vio_eval_ros.recordings.recording import Frames

#: an interval that is longer, and three times the usual one, is a gap
GAP_S = 0.5
#: stamps before it are no dates
EPOCH_NS = 10**17
#: clocks whose stamps are as far apart are not one
APART_S = 60.0


@dataclass(frozen=True)
class Facts:
    """
    A trajectory in numbers; NaN where there is none.

    :param poses: usable ones; ``dropped`` counts the others by reason.
    :param rate_hz: one over the median interval.
    :param gaps: intervals longer than 0.5 s and three median ones, and ``longest_gap_s`` of them.
    :param speed_max_m_s: the 99.9th percentile of the steps over their intervals.
    :param first_position_m: x y z, of the first pose; likewise of the last one.
    :param extent_m: of the bounding box, x y z.
    :param frame_ids: the frames that the messages say their poses are in, most often one.
    :param child_frame_ids: likewise, whose poses they are.
    """

    source: str
    kind: str
    poses: int
    first_stamp_ns: int | None
    last_stamp_ns: int | None
    duration_s: float
    rate_hz: float
    gaps: int
    longest_gap_s: float
    path_length_m: float
    speed_mean_m_s: float
    speed_max_m_s: float
    first_position_m: tuple[float, ...]
    last_position_m: tuple[float, ...]
    extent_m: tuple[float, ...]
    frame_ids: tuple[str, ...]
    child_frame_ids: tuple[str, ...]
    position_only: bool
    covariances: bool
    dropped: dict[str, int]
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the facts as JSON has them."""
        values = asdict(self).items()
        return {name: list(v) if isinstance(v, tuple) else v for name, v in values}


def facts_of(source: Source, frames: Frames) -> Facts:
    """Return the facts of a source, as it is read without another side."""
    counts = Cleaning()
    poses = clean(source.poses, counts)
    seconds = np.diff(poses.stamps_ns) / 1e9
    usual = float(np.median(seconds)) if len(seconds) else math.nan
    lost = seconds[seconds > longest_tracked(GAP_S, usual)] if len(seconds) else seconds
    steps = step_lengths(poses.positions)
    duration_s = float(seconds.sum()) if len(seconds) else math.nan
    length = float(steps.sum()) if len(steps) else math.nan
    stamps = poses.stamps_ns
    return Facts(
        source=source.spec,
        kind=source.kind,
        poses=len(poses),
        first_stamp_ns=int(stamps[0]) if len(stamps) else None,
        last_stamp_ns=int(stamps[-1]) if len(stamps) else None,
        duration_s=duration_s,
        rate_hz=1 / usual if usual > 0 else math.nan,
        gaps=len(lost),
        longest_gap_s=float(lost.max()) if len(lost) else math.nan,
        path_length_m=length,
        speed_mean_m_s=length / duration_s if duration_s > 0 else math.nan,
        speed_max_m_s=float(np.quantile(steps / seconds, 0.999)) if len(steps) else math.nan,
        first_position_m=tuple(poses.positions[0].tolist()) if len(poses) else (),
        last_position_m=tuple(poses.positions[-1].tolist()) if len(poses) else (),
        extent_m=tuple(np.ptp(poses.positions, axis=0).tolist()) if len(poses) else (),
        frame_ids=frames.parents,
        child_frame_ids=frames.children,
        position_only=poses.rotations is None or bool(why_positions_only(source.poses)),
        covariances=source.poses.covariances is not None,
        dropped={reason: count for reason, count in counts.dropped.items() if count},
        notes=(*source.warnings, *counts.warnings(source.spec)),
    )


def info_text(facts: Sequence[Facts]) -> list[str]:
    """Return a column for each trajectory, and a sentence on what does not go together."""
    rows = [_column(one) for one in facts]
    names = list(rows[0])
    cells = [[name, *(row[name] for row in rows)] for name in names]
    widths = [max(len(line[k]) for line in cells) for k in range(len(rows) + 1)]
    lines = [
        '  '.join(
            cell.ljust(width) if k < 1 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in cells
    ]
    notes = [note for one in facts for note in one.notes]
    return [*lines, *(f'note: {note}' for note in (*notes, *_apart(facts)))]


def _column(one: Facts) -> dict[str, str]:
    """Return the cells of a trajectory."""
    orientation = 'positions only' if one.position_only else 'poses'
    return {
        '': one.source,
        'kind': f'{one.kind}, {orientation}' + ', covariances' * one.covariances,
        'frames': _frames(one),
        'poses': f'{one.poses:,}',
        'first stamp': _stamp(one.first_stamp_ns),
        'last stamp': _stamp(one.last_stamp_ns),
        'duration [s]': number(one.duration_s),
        'rate [Hz]': number(one.rate_hz),
        'gaps': f'{one.gaps}, up to {number(one.longest_gap_s)} s' if one.gaps else '0',
        'path [m]': number(one.path_length_m),
        'speed, mean and max [m/s]': f'{number(one.speed_mean_m_s)}, {number(one.speed_max_m_s)}',
        'first position [m]': _vector(one.first_position_m),
        'last position [m]': _vector(one.last_position_m),
        'extent x y z [m]': _vector(one.extent_m),
        'dropped': ', '.join(f'{n} {why.replace("_", " ")}' for why, n in one.dropped.items())
        or '0',
    }


def _frames(one: Facts) -> str:
    """Return in which frames the poses are, and of what."""
    parents, children = ', '.join(one.frame_ids), ', '.join(one.child_frame_ids)
    return f'{parents or "?"} -> {children}' if children else parents or '-'


def _vector(values: Sequence[float]) -> str:
    return ' '.join(map(number, values)) or '-'


def _stamp(stamp_ns: int | None) -> str:
    """Return a stamp in seconds, with the date where it is one."""
    if stamp_ns is None:
        return '-'
    seconds, rest = divmod(abs(stamp_ns), 10**9)
    text = f'{"-" * (stamp_ns < 0)}{seconds}.{rest:09d}'
    if stamp_ns < EPOCH_NS:
        return text
    date = datetime.fromtimestamp(stamp_ns // 10**9, timezone.utc)
    return f'{text} ({date:%Y-%m-%d %H:%M:%S})'


def _apart(facts: Sequence[Facts]) -> list[str]:
    """Return a sentence for neighbours that share no time."""
    found = []
    for one, other in pairwise(facts):
        ends = (one.first_stamp_ns, one.last_stamp_ns, other.first_stamp_ns, other.last_stamp_ns)
        begin, end, begins, ends_ = ends
        if begin is None or end is None or begins is None or ends_ is None:
            continue
        apart_s = max(begins - end, begin - ends_) / 1e9
        if apart_s > 0:
            hint = '; their clocks differ?' if apart_s > APART_S else ''
            found.append(
                f'{one.source} and {other.source} share no time: {number(apart_s)} s apart{hint}'
            )
    return found
