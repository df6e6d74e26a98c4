"""All that an inspection of a recording found: a value, and its JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import json
from typing import Any

from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.inspection.calibration import Calibration
from vio_eval_ros.inspection.expectations import CheckedExpectation
from vio_eval_ros.inspection.finding import Finding, LEVELS
from vio_eval_ros.inspection.findings import worst_first
from vio_eval_ros.inspection.inspection import InspectedStreams
from vio_eval_ros.inspection.measured_stream import MeasuredStream
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.inspection/1'
WORST_FIRST = ('fail', 'warn', 'pass')


@dataclass(frozen=True, eq=False)
class Report:
    """
    What was found in a recording.

    :param source: what was inspected.
    :param expectations: whether each is met; none where nothing was expected.
    :param profile: the platform whose limits were used.
    """

    source: str
    inspection: InspectedStreams
    expectations: Sequence[CheckedExpectation] = ()
    calibration: Calibration | None = None
    profile: str = PROFILES[0]

    @property
    def findings(self) -> list[Finding]:
        """Those of the streams and of the calibration, worst first."""
        of_calibration = self.calibration.findings if self.calibration else []
        return worst_first([*self.inspection.findings, *of_calibration])

    @property
    def warnings(self) -> list[str]:
        """The findings that make an estimator worse, and the expectations not met; a line each."""
        unmet = [
            f'{one.stream} {one.check}: {one.message}'
            for one in self.expectations
            if one.word != 'pass'
        ]
        return [str(one) for one in self.findings if one.level != 'info'] + unmet

    @property
    def streams(self) -> list[MeasuredStream]:
        """The streams with their figures, the worst first."""
        return sorted(
            self.inspection.streams,
            key=lambda one: WORST_FIRST.index(self.word_of(one.stream.topic)),
        )

    @property
    def word(self) -> str:
        """The worst of all: fail, warn or pass."""
        words = {one.level for one in self.findings} | {one.word for one in self.expectations}
        return next(word for word in WORST_FIRST if word in words or word == 'pass')

    def word_of(self, topic: str) -> str:
        """Return the worst of a topic: fail, warn or pass."""
        words = {one.level for one in self.findings if topic in one.topics}
        words |= {one.word for one in self.expectations if one.topic == topic}
        return next(word for word in WORST_FIRST if word in words or word == 'pass')

    def has_failed(self, names: Iterable[str] = ()) -> bool:
        """Return whether an expectation is not met, or a finding of these names was made."""
        found = {
            finding.name
            for finding in self.findings
            if finding.level != 'info' or finding.kind.level == 'info'
        }
        is_unmet = any(one.word == 'fail' for one in self.expectations)
        return is_unmet or bool(found & set(names))

    def to_dict(self) -> dict[str, Any]:
        """Return all of it in schema ``vio_eval_ros.inspection/1``; NaN is None."""
        inspection = self.inspection
        document = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'recording': self.source,
            'profile': self.profile,
            'limits': inspection.limits.to_dict(),
            'streams': [
                {
                    'topic': one.stream.topic,
                    'type': one.stream.msgtype,
                    'worst': self.word_of(one.stream.topic),
                    **one.to_dict(),
                }
                for one in self.streams
            ],
            'silent': [{'topic': one.topic, 'type': one.msgtype} for one in inspection.silent],
            'pairs': [vars(pair) for pair in inspection.pairs],
            'common_span_ns': inspection.common_ns,
            'imu_to_camera_rate': inspection.imu_to_camera,
            'counts': {
                level: sum(one.level == level for one in self.findings) for level in LEVELS
            },
            'findings': [finding.to_dict() for finding in self.findings],
            'expectations': [one.to_dict() for one in self.expectations],
            'calibration': self.calibration and self.calibration.to_dict(),
        }
        return without_nan(document)


def json_document(report: Report) -> str:
    """Return the report as JSON."""
    return json.dumps(report.to_dict(), indent=2, allow_nan=False) + '\n'
