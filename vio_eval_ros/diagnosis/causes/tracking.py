"""Times without an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vio_eval_ros.diagnosis.causes.cause import KnownCause
from vio_eval_ros.diagnosis.causes.clocks import CLOCK_DRIFT, TIME_OFFSET
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.gaps import find_gaps, missing_s
from vio_eval_ros.diagnosis.measurement import Measurement


def _evidence(measurement: Measurement, findings: Mapping[str, Any]) -> str:
    """Return how much is lost, and the longest interval."""
    lost = f'{100 * measurement.value:.0f} % of the ground truth has no estimate'
    longest_s = max((gap['seconds'] for gap in findings['gaps']), default=0.0)
    if not longest_s:
        return f'{lost}, some poses at a time'
    if len(findings['gaps']) == 1 and findings['ends_early_s'] >= longest_s:
        ended = f'it ends {longest_s:.1f} s before the truth'
        return f'{lost}: {ended}; it stopped there, or the file is an excerpt'
    return f'{lost}, the longest interval is {longest_s:.1f} s'


LOST_TRACKING = KnownCause(
    name='lost_tracking',
    unit='ratio',
    meaning="share of the truth's duration",
    measured='gaps, an end before that of the truth, a pose that is repeated while the truth '
    'moves on, and poses missing from a regular stream',
    remedy='the estimator',
    evidence=_evidence,
    advice='Of a file that is an excerpt, evaluate its own time (--end-s); otherwise look at the '
    'images of the named intervals: blur, darkness, no texture, dropped frames.',
    limits=('lost_tracking_percent', 'late_start_percent', 'early_end_percent'),
    healthy=lambda limits, half_s: limits.lost_tracking_percent / 100,
)
CAUSES = (LOST_TRACKING,)


def measure(run: Measuring) -> None:
    """Note the intervals without estimate."""
    case = run.run
    punctual = run.correction.only([TIME_OFFSET.name, CLOCK_DRIFT.name]).apply(case.estimate)
    gaps = find_gaps(punctual, case.truth, case.config.max_gap_s, run.limits)
    duration_s = float(case.truth.stamps_ns[-1] - case.truth.stamps_ns[0]) / 1e9
    missing = missing_s(punctual, case.true_poses, gaps)
    lost = (sum(gap.seconds for gap in gaps) + missing) / duration_s
    run.findings['missing_between_poses_s'] = missing
    run.note(LOST_TRACKING, run.counted(LOST_TRACKING, lost))
    late_s = int(punctual.stamps_ns[0] - case.truth.stamps_ns[0]) / 1e9
    run.findings['initialised'] = {'after_s': late_s, 'percent': 100 * late_s / duration_s}
    early_s = int(case.truth.stamps_ns[-1] - punctual.stamps_ns[-1]) / 1e9
    run.findings['ends_early_s'] = max(early_s, 0.0)
    run.findings['gaps'] = [
        {'begin_ns': gap.begin_ns, 'end_ns': gap.end_ns, 'seconds': gap.seconds} for gap in gaps
    ]
