"""The result of one run, from which all reports are made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Summary
from vio_eval_ros.core.gates import Gate, judge, Verdict
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.side import Side
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.result/1'
#: a run is a success if it tracked long enough once it had begun, and did not diverge
SUCCESS_GATES = (Gate('tracked_ratio', '>=', 0.9), Gate('ate_extent_ratio', '<=', 0.5))


@dataclass(frozen=True, eq=False)
class Input:
    """
    One of the two inputs, as the result describes it.

    :param source: what the user named.
    :param kind: tum, euroc, kitti, ros1, rosbag2, mcap or topic.
    :param sha256: of the files, concatenated; None for a live topic or a pipe.
    :param poses: how many were used.
    :param first_stamp_ns: of those, as recorded; None where there are none.
    :param last_stamp_ns: likewise.
    :param rate_hz: of those; None of fewer than two.
    :param position_only: whether some have no orientation.
    :param dropped: the number of poses that were dropped, for each reason.
    :param repaired: the number of poses that were kept, but sorted or normalised.
    :param paths: the files.
    """

    source: str
    kind: str
    sha256: str | None
    poses: int
    first_stamp_ns: int | None
    last_stamp_ns: int | None
    rate_hz: float | None
    position_only: bool
    dropped: Mapping[str, int]
    repaired: Mapping[str, int]
    paths: tuple[Path, ...] = ()

    @classmethod
    def of(
        cls,
        source: str,
        kind: str,
        side: Side,
        *,
        offset_s: float = 0.0,
        sha256: str | None = None,
        paths: tuple[Path, ...] = (),
    ) -> Input:
        """
        Return the input as it was associated up to now.

        :param offset_s: what was added to its stamps.
        """
        offset_ns = nanoseconds(offset_s)
        seconds = (side.last_used_ns - side.first_used_ns) / 1e9
        return cls(
            source=source,
            kind=kind,
            sha256=sha256,
            poses=side.used,
            first_stamp_ns=side.first_used_ns - offset_ns if side.used else None,
            last_stamp_ns=side.last_used_ns - offset_ns if side.used else None,
            rate_hz=(side.used - 1) / seconds if side.used > 1 else None,
            position_only=side.position_only,
            dropped=side.counts.dropped,
            repaired=side.counts.repaired,
            paths=paths,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the description with its counts."""
        return {
            'source': self.source,
            'kind': self.kind,
            'sha256': self.sha256,
            'poses': self.poses,
            'first_stamp_ns': self.first_stamp_ns,
            'last_stamp_ns': self.last_stamp_ns,
            'rate_hz': self.rate_hz,
            'position_only': self.position_only,
            'dropped': dict(self.dropped),
        }


@dataclass(frozen=True, eq=False)
class Result:
    """
    What was compared and how, what was measured, and whether it passed the gates.

    :param series: stamp [ns] and running values of each second, for the reports that show them.
    :param truth: positions of the ground truth, evenly over the run, to draw it also where there
        are no pairs.
    :param assumed: what was taken for granted when the inputs were read; the first warnings.
    :param live: latency, rate and cost, which only a live run has; NaN where unknown.
    """

    estimate: Input
    ground_truth: Input
    config: EvaluationConfig
    summary: Summary
    verdicts: Sequence[Verdict] = ()
    series: Sequence[tuple[int, Mapping[str, float]]] = ()
    truth: Trajectory | None = None
    assumed: tuple[str, ...] = ()
    live: Mapping[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool | None:
        """Whether no gate failed; None where there are none."""
        return all(v.word != 'fail' for v in self.verdicts) if self.verdicts else None

    def to_dict(self) -> dict[str, Any]:
        """Return the result as schema ``vio_eval_ros.result/1`` has it: no NaN, but None."""
        alignment = self.summary.alignment
        is_weighted = self.summary.pairs.ground_truth.weights is not None
        success = judge(SUCCESS_GATES, self.summary.metrics)
        result = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'inputs': {
                'estimate': self.estimate.to_dict(),
                'ground_truth': self.ground_truth.to_dict(),
            },
            'config': self.config.to_dict(),
            'association': self.summary.association,
            'alignment': {
                'mode': alignment.mode,
                'scale': alignment.scale,
                'rotation_xyzw': alignment.rotation.tolist(),
                'translation_m': alignment.translation.tolist(),
                'observable': alignment.observable,
                'weights': 'covariance' if is_weighted else None,
            },
            'metrics': self.summary.metrics,
            'warnings': self.summary.warnings,
            'gates': [verdict.to_dict() for verdict in self.verdicts],
            'success': all(verdict.passed for verdict in success),
            'success_gates': [verdict.to_dict() for verdict in success],
            'verdict': {True: 'pass', False: 'fail', None: None}[self.passed],
        }
        if self.live:
            result['live'] = dict(self.live)
        return {name: without_nan(value) for name, value in result.items()}
