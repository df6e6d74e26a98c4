"""What a user expects of the streams of a recording, in YAML, and whether it is so."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any, NamedTuple

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.inspection.cameras import Pair
from vio_eval_ros.inspection.inspection import InspectedStreams
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.measured_stream import Clocks, MeasuredStream
from vio_eval_ros.settings import finite, load_yaml, Section

NODE = 'inspect'
#: standard deviations that are subtracted from a drift before it is compared
DRIFT_DEVIATIONS = 2
UP_AXES = ('+x', '-x', '+y', '-y', '+z', '-z')


def _missing_ratio(one: MeasuredStream) -> float:
    return one.timing.missing / (one.timing.count + one.timing.missing)


def _least_drift(clocks: Clocks) -> float:
    """Return the drift that there is for certain."""
    return max(abs(clocks.drift_ppm) - DRIFT_DEVIATIONS * clocks.drift_uncertainty_ppm, 0.0)


#: What can be expected of a stream: the figure, and its unit. ``max_`` and ``min_`` say on which
#: side of the stated value it must be.
FIGURES: dict[str, tuple[str, Callable[[MeasuredStream], float]]] = {
    'max_jitter_s': ('s', lambda one: one.timing.jitter_p99_s),
    'max_gap_s': ('s', lambda one: one.timing.longest_s),
    'max_missing_ratio': ('', _missing_ratio),
    'max_latency_s': ('s', lambda one: one.clocks.latency_p99_s if one.clocks else math.nan),
    'max_drift_ppm': ('ppm', lambda one: _least_drift(one.clocks) if one.clocks else math.nan),
    'min_duration_s': ('s', lambda one: one.timing.duration_s),
    'min_rotation_rad_s': (
        'rad/s',
        lambda one: one.inertial.rotation_rms_rad_s[1] if one.inertial else math.nan,
    ),
    'min_acceleration_m_s2': (
        'm/s²',
        lambda one: one.inertial.acceleration_m_s2 if one.inertial else math.nan,
    ),
    'min_still_at_begin_s': (
        's',
        lambda one: one.inertial.still_at_begin_s if one.inertial else math.nan,
    ),
}
STREAM_KEYS = ('topic', 'level', 'rate_hz', 'rate_tolerance', 'frame_id', 'up_axis', *FIGURES)
#: What only recordings have that say when messages were recorded: not EuRoC's folders
OF_CLOCKS = ('max_latency_s', 'max_drift_ppm')
PAIR_FIGURES: dict[str, tuple[str, Callable[[Pair], float]]] = {
    'max_skew_s': ('s', lambda pair: abs(pair.skew_s)),
    'max_unsynchronised_ratio': ('', lambda pair: pair.unsynchronised / pair.frames),
}
PAIR_KEYS = ('streams', 'level', *PAIR_FIGURES)


class CheckedExpectation(NamedTuple):
    """
    Whether an expectation is met.

    :param stream: the name of the stream or pair in the file.
    :param value: NaN where it cannot be determined, which fails; None of what is not a number.
    :param word: pass, warn or fail.
    :param message: what was expected, and what was measured.
    """

    stream: str
    topic: str
    check: str
    value: float | None
    word: str
    message: str

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        value = self.value
        known = value is not None and math.isfinite(value)
        return {**self._asdict(), 'value': value if known else None}


@dataclass(frozen=True)
class Expectations:
    """
    What is expected: mappings that the user wrote, checked.

    :param streams: by the name that the file gives them.
    """

    streams: dict[str, Section]
    pairs: dict[str, Section]

    @classmethod
    def load(cls, path: Path) -> Expectations:
        """
        Return the expectations in a file: under ``inspect`` of a ROS parameter file, or plain.

        :raises ReadError: the file does not exist, or is not YAML.
        :raises ConfigError: a key or value makes no sense; with its line.
        """
        content = load_yaml(path)
        if NODE in content:
            content = content.section(NODE)
            content.expect('ros__parameters')
            content = content.section('ros__parameters')
        content.expect('streams', 'pairs')
        streams, pairs = (_sections(content.section(name)) for name in ('streams', 'pairs'))
        if not streams:
            raise ConfigError(f'{path}: expected at least one stream under streams')
        for section in streams.values():
            _check_stream(section)
        for section in pairs.values():
            _check_pair(section, streams)
        return cls(streams, pairs)

    def check(self, inspection: InspectedStreams) -> list[CheckedExpectation]:
        """Return what is met and what is not, stream by stream."""
        found = {one.stream.topic: one for one in inspection.streams}
        checked: list[CheckedExpectation] = []
        for name, section in self.streams.items():
            topic = section['topic']
            failing = [
                one.name
                for one in inspection.findings
                if one.level == 'fail' and one.topic == topic
            ]
            checked += _check_of_stream(
                name, section, found.get(topic), failing, inspection.limits
            )
        for name, section in self.pairs.items():
            topics = [self.streams[stream]['topic'] for stream in section['streams']]
            checked += _check_of_pair(name, section, topics, inspection)
        return checked


def _sections(parent: Section) -> dict[str, Section]:
    return {name: parent.section(name) for name in parent}


def _check_stream(section: Section) -> None:
    section.expect(*STREAM_KEYS)
    if not isinstance(section.get('topic'), str):
        raise section.error('topic', 'topic: expected the name of a topic')
    _check_level(section)
    if section.get('up_axis', UP_AXES[0]) not in UP_AXES:
        raise section.error('up_axis', f'up_axis: expected one of {", ".join(UP_AXES)}')
    if not isinstance(section.get('frame_id', ''), str):
        raise section.error('frame_id', 'frame_id: expected the name of a frame')
    _check_numbers(section, ('rate_hz', 'rate_tolerance', *FIGURES))
    if 'rate_tolerance' in section and 'rate_hz' not in section:
        raise section.error('rate_tolerance', 'rate_tolerance: goes with rate_hz')
    if section.get('rate_hz') == 0:
        raise section.error('rate_hz', 'rate_hz: expected a positive number')


def _check_pair(section: Section, streams: dict[str, Section]) -> None:
    section.expect(*PAIR_KEYS)
    names = section.get('streams')
    if not isinstance(names, list) or len(names) != 2 or names[0] == names[1]:
        raise section.error('streams', 'streams: expected the names of two streams')
    for name in names:
        if name not in streams:
            raise section.error(
                'streams', f"there is no stream '{name}' above; there are {', '.join(streams)}"
            )
    _check_level(section)
    _check_numbers(section, tuple(PAIR_FIGURES))


def _check_level(section: Section) -> None:
    if section.get('level', 'fail') not in ('warn', 'fail'):
        raise section.error('level', "level: expected 'warn' or 'fail'")


def _check_numbers(section: Section, keys: Sequence[str]) -> None:
    for key in keys:
        if key in section and not finite(section[key]) >= 0:
            raise section.error(key, f'{key}: expected a number >= 0')


class _Subject(NamedTuple):
    """A stream or pair that is checked, and what an expectation that is not met means."""

    stream: str
    topic: str
    level: str

    def checked(
        self, check: str, is_met: bool, message: str, value: float | None = None
    ) -> CheckedExpectation:
        word = 'pass' if is_met else self.level
        return CheckedExpectation(
            self.stream, self.topic, check, value=value, word=word, message=message
        )


def _check_of_stream(
    name: str,
    section: Section,
    one: MeasuredStream | None,
    failing: Sequence[str],
    limits: InspectionLimits,
) -> Iterator[CheckedExpectation]:
    topic = section['topic']
    checked = _Subject(name, topic, section.get('level', 'fail')).checked
    if one is None:
        yield checked('topic', False, f'there are no messages on {topic}')
        return
    shown = ', '.join(failing) or 'none'
    yield checked('findings', not failing, f'expected no failing finding, found {shown}')
    if 'rate_hz' in section:
        wanted, rate = float(section['rate_hz']), one.timing.rate_hz
        tolerance = float(section.get('rate_tolerance', limits.rate_tolerance_percent / 100))
        yield checked(
            'rate_hz',
            abs(rate - wanted) <= tolerance * wanted,
            f'expected {wanted:g} Hz ± {100 * tolerance:g} %, measured {rate:.6g} Hz',
            rate,
        )
    for key, (unit, figure) in FIGURES.items():
        if key in section and (one.stream.logged_ns is not None or key not in OF_CLOCKS):
            yield checked(key, *_limited(key, float(section[key]), figure(one), unit))
    if 'frame_id' in section:
        frames = sorted(one.stream.frames)
        shown = ', '.join(f"'{frame}'" for frame in frames) or 'none'
        yield checked(
            'frame_id',
            frames == [section['frame_id']],
            f"expected frame '{section['frame_id']}', found {shown}",
        )
    if 'up_axis' in section:
        up = one.inertial.up if one.inertial else ''
        measured = f'measured {up}' if up else 'cannot be determined: never at rest'
        message = f'expected {section["up_axis"]}, {measured}'
        yield checked('up_axis', up == section['up_axis'], message)


def _check_of_pair(
    name: str, section: Section, topics: list[str], inspection: InspectedStreams
) -> Iterator[CheckedExpectation]:
    checked = _Subject(name, ', '.join(topics), section.get('level', 'fail')).checked
    pair = next((p for p in inspection.pairs if {p.first, p.second} == set(topics)), None)
    if pair is None:
        yield checked('streams', False, 'not two cameras that overlap in time')
        return
    for key, (unit, figure) in PAIR_FIGURES.items():
        if key in section:
            yield checked(key, *_limited(key, float(section[key]), figure(pair), unit))


def _limited(key: str, limit: float, value: float, unit: str) -> tuple[bool, str, float]:
    """Return whether a value keeps its limit, which one that does not exist never does."""
    is_met = value <= limit if key.startswith('max_') else value >= limit
    side = 'at most' if key.startswith('max_') else 'at least'
    unit = f' {unit}' if unit else ''
    measured = 'cannot be determined' if math.isnan(value) else f'measured {value:.4g}{unit}'
    return is_met, f'expected {side} {limit:g}{unit}, {measured}', value
