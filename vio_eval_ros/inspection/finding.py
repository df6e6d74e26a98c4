"""A finding, and what all findings of one name have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from string import Formatter
from typing import Any

from vio_eval_ros.core.sensor_stream import Moment, SensorStream
from vio_eval_ros.inspection.measured_stream import MeasuredStream

LEVELS = ('info', 'warn', 'fail')


@dataclass(frozen=True)
class FindingKind:
    """
    All that is known of a finding before it is made: an entry of FINDINGS.

    :param subject: what it is found in: streams, sensors, cameras, IMU, poses, calibration.
    :param level: ``fail`` where an estimator will go wrong, ``warn`` where it will be worse,
        ``info`` for what one should know. In streams that no estimator takes, it is ``info``.
    :param when: it is found, for the docs; names of limits in braces.
    :param evidence: the message, by case where there are several; in braces ``count``, ``value``
        and whatever else the detector measures.
    :param cure: what to do about it.
    :param unit: of the value.
    :param in_poses: the level in streams of poses, where it is another one.
    :param severe: when it is ``fail``, though ``level`` is not; for the docs.
    :param minor: when it is ``info``, though ``level`` is not; for the docs.
    :param amended: what the other streams make of it: takes a finding, all findings and all
        streams; returns the finding as it is then.
    """

    name: str
    subject: str
    level: str
    when: str
    evidence: str | Mapping[str, str]
    cure: str
    unit: str = ''
    in_poses: str = ''
    severe: str = ''
    minor: str = ''
    amended: Amendment | None = None

    @property
    def advice(self) -> str:
        """What to do about it, a sentence."""
        return f'{self.cure[0].upper()}{self.cure[1:]}.'

    @property
    def limits(self) -> tuple[str, ...]:
        """The names of the limits that it depends on."""
        text = self.when + self.severe + self.minor
        return tuple(dict.fromkeys(name for _, name, _, _ in Formatter().parse(text) if name))

    def found(
        self,
        where: SensorStream | str,
        case: str = '',
        *,
        severe: bool = False,
        minor: bool = False,
        count: int = 1,
        value: float = math.nan,
        unit: str = '',
        moments: tuple[Moment, ...] = (),
        **measured: object,
    ) -> Finding:
        """
        Return the finding of something that was measured.

        :param where: the stream, or the name of what else it was found in.
        :param case: the key of the evidence, where there are several.
        :param measured: the other fields of the evidence.
        """
        text = self.evidence if isinstance(self.evidence, str) else self.evidence[case]
        unit = unit or self.unit
        return Finding(
            kind=self,
            topic=where if isinstance(where, str) else where.topic,
            level=self._level(where, severe, minor),
            message=text.format(count=count, value=value, unit=unit, **measured),
            count=count,
            value=value,
            unit=unit,
            moments=moments,
        )

    def _level(self, where: SensorStream | str, severe: bool, minor: bool) -> str:
        assert self.severe or not severe, self.name
        assert self.minor or not minor, self.name
        kind = '' if isinstance(where, str) else where.kind
        if minor or kind == 'other':
            return 'info'
        if severe:
            return 'fail'
        return self.in_poses if kind == 'pose' and self.in_poses else self.level


@dataclass(frozen=True)
class Finding:
    """
    Something that was found in a stream.

    :param topic: or what else it was found in; of two cameras both, after a comma.
    :param message: a sentence, with its numbers.
    :param count: how often.
    :param value: the figure that stands for it, in ``unit``; NaN where there is none.
    :param moments: when; of many only the first ones.
    """

    kind: FindingKind
    topic: str
    level: str
    message: str
    count: int = 1
    value: float = math.nan
    unit: str = ''
    moments: tuple[Moment, ...] = ()

    @property
    def name(self) -> str:
        """The key in FINDINGS."""
        return self.kind.name

    @property
    def advice(self) -> str:
        """What to do about it, a sentence."""
        return self.kind.advice

    @property
    def topics(self) -> list[str]:
        """The topic, or both of a pair of cameras."""
        return self.topic.split(', ')

    def __str__(self) -> str:
        """Return it in a line."""
        return f'{self.name}{f" {self.topic}" if self.topic else ""}: {self.message}'

    def to_dict(self) -> dict[str, Any]:
        """Return the finding for JSON."""
        return {
            'name': self.name,
            'topic': self.topic,
            'level': self.level,
            'message': self.message,
            'count': self.count,
            'value': self.value if math.isfinite(self.value) else None,
            'unit': self.unit,
            'advice': self.advice,
            'at': [
                {'begin_ns': moment.begin_ns, 'end_ns': moment.end_ns} for moment in self.moments
            ],
        }


Amendment = Callable[[Finding, Sequence[Finding], Sequence[MeasuredStream]], Finding]


def are(count: int, noun: str) -> str:
    """Return the beginning of a sentence: 1 sample is, 2 samples are."""
    return f'{count} {noun} is' if count == 1 else f'{count} {noun}s are'
