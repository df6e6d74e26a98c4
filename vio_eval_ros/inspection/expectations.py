"""What a user expects of the streams of a recording, in YAML, and whether it is so."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any, NamedTuple

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.inspection.clocks import Clocks
from vio_eval_ros.inspection.inspection import Examined, Inspection
from vio_eval_ros.settings import finite, load_yaml, Section

NODE = 'inspect'
RATE_TOLERANCE = 0.01
UP_AXES = ('+x', '-x', '+y', '-y', '+z', '-z')


def _missing_ratio(one: Examined) -> float:
    return one.timing.missing / (one.timing.count + one.timing.missing)


def _least_drift(clocks: Clocks) -> float:
    """Return how much drift there is for certain: two standard deviations below the figure."""
    return max(abs(clocks.drift_ppm) - 2 * clocks.drift_uncertainty_ppm, 0.0)


#: Limits of a stream: what is limited. ``max_`` and ``min_`` say on which side.
LIMITS: dict[str, Callable[[Examined], float]] = {
    'max_jitter_s': lambda one: one.timing.jitter_p99_s,
    'max_gap_s': lambda one: one.timing.longest_s,
    'max_missing_ratio': _missing_ratio,
    'max_latency_s': lambda one: one.clocks.latency_p99_s if one.clocks else math.nan,
    'max_drift_ppm': lambda one: _least_drift(one.clocks) if one.clocks else math.nan,
    'min_duration_s': lambda one: one.timing.duration_s,
    'min_rotation_rad_s': lambda one: (
        one.inertial.rotation_rms_rad_s[1] if one.inertial else math.nan
    ),
    'min_acceleration_m_s2': lambda one: (
        one.inertial.acceleration_m_s2 if one.inertial else math.nan
    ),
    'min_still_at_begin_s': lambda one: (
        one.inertial.still_at_begin_s if one.inertial else math.nan
    ),
}
STREAM_KEYS = ('topic', 'level', 'rate_hz', 'rate_tolerance', 'frame_id', 'up_axis', *LIMITS)
#: What only recordings have that say when messages were recorded: not EuRoC's folders
OF_CLOCKS = ('max_latency_s', 'max_drift_ppm')
PAIR_LIMITS = ('max_skew_s', 'max_unsynchronised_ratio')
PAIR_KEYS = ('streams', 'level', *PAIR_LIMITS)


class Verdict(NamedTuple):
    """
    Whether an expectation is met.

    :param stream: the name of the stream or pair in the file.
    :param value: NaN where it cannot be told, which fails; None of what is no number.
    :param word: pass, warn or fail.
    :param message: what is expected, and what is there.
    """

    stream: str
    topic: str
    check: str
    value: float | None
    word: str
    message: str

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict for JSON."""
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

        :raises ReadError: no such file, or not YAML.
        :raises ConfigError: what makes no sense, with its line.
        """
        content = load_yaml(path)
        if NODE in content:
            content = content.section(NODE)
            content.expect('ros__parameters')
            content = content.section('ros__parameters')
        content.expect('streams', 'pairs')
        streams, pairs = (_sections(content.section(name)) for name in ('streams', 'pairs'))
        if not streams:
            raise ConfigError(f'{path}: there are no streams to expect; name them under streams')
        for section in streams.values():
            _check_stream(section)
        for section in pairs.values():
            _check_pair(section, streams)
        return cls(streams, pairs)

    def judge(self, inspection: Inspection) -> list[Verdict]:
        """Return what is met and what is not, stream by stream."""
        found = {one.stream.topic: one for one in inspection.streams}
        verdicts: list[Verdict] = []
        for name, section in self.streams.items():
            topic = section['topic']
            fails = [f.name for f in inspection.findings if f.level == 'fail' and f.topic == topic]
            verdicts += _judge(name, section, found.get(topic), fails)
        for name, section in self.pairs.items():
            topics = [self.streams[stream]['topic'] for stream in section['streams']]
            verdicts += _judge_pair(name, section, topics, inspection)
        return verdicts


def _sections(parent: Section) -> dict[str, Section]:
    return {name: parent.section(name) for name in parent}


def _check_stream(section: Section) -> None:
    section.expect(*STREAM_KEYS)
    if not isinstance(section.get('topic'), str):
        raise section.error('topic', 'topic: the name of a topic is expected')
    _check_level(section)
    if section.get('up_axis', UP_AXES[0]) not in UP_AXES:
        raise section.error('up_axis', f'up_axis: one of {", ".join(UP_AXES)} is expected')
    if not isinstance(section.get('frame_id', ''), str):
        raise section.error('frame_id', 'frame_id: the name of a frame is expected')
    _check_numbers(section, ('rate_hz', 'rate_tolerance', *LIMITS))
    if 'rate_tolerance' in section and 'rate_hz' not in section:
        raise section.error('rate_tolerance', 'rate_tolerance: goes with rate_hz')
    if section.get('rate_hz') == 0:
        raise section.error('rate_hz', 'rate_hz: a positive number is expected')


def _check_pair(section: Section, streams: dict[str, Section]) -> None:
    section.expect(*PAIR_KEYS)
    names = section.get('streams')
    if not isinstance(names, list) or len(names) != 2 or names[0] == names[1]:
        raise section.error('streams', 'streams: the names of two streams are expected')
    for name in names:
        if name not in streams:
            raise section.error(
                'streams', f"there is no stream '{name}' above; there are {', '.join(streams)}"
            )
    _check_level(section)
    _check_numbers(section, PAIR_LIMITS)


def _check_level(section: Section) -> None:
    if section.get('level', 'fail') not in ('warn', 'fail'):
        raise section.error('level', "level: 'warn' or 'fail' is expected")


def _check_numbers(section: Section, keys: Sequence[str]) -> None:
    for key in keys:
        if key in section and not finite(section[key]) >= 0:
            raise section.error(key, f'{key}: a number is expected, not negative')


def _judge(
    name: str, section: Section, one: Examined | None, fails: Sequence[str]
) -> Iterator[Verdict]:
    topic, bad = section['topic'], section.get('level', 'fail')

    def verdict(check: str, is_met: bool, message: str, value: float | None = None) -> Verdict:
        return Verdict(name, topic, check, value, 'pass' if is_met else bad, message)

    if one is None:
        yield verdict('topic', False, f'there are no messages on {topic}')
        return
    shown = ', '.join(fails) or 'none'
    yield verdict('findings', not fails, f'no finding that fails is expected, {shown} there is')
    if 'rate_hz' in section:
        wanted, rate = float(section['rate_hz']), one.timing.rate_hz
        tolerance = float(section.get('rate_tolerance', RATE_TOLERANCE))
        yield verdict(
            'rate_hz',
            abs(rate - wanted) <= tolerance * wanted,
            f'{wanted:g} ± {100 * tolerance:g} % is expected, {rate:.6g} it is',
            rate,
        )
    for key, measured in LIMITS.items():
        if key in section and (one.stream.logged_ns is not None or key not in OF_CLOCKS):
            yield verdict(key, *_limited(key, float(section[key]), measured(one)))
    if 'frame_id' in section:
        frames = sorted(one.stream.frames)
        yield verdict(
            'frame_id',
            frames == [section['frame_id']],
            f"'{section['frame_id']}' is expected, {frames} there is",
        )
    if 'up_axis' in section:
        up = one.inertial.up if one.inertial else ''
        message = f'{section["up_axis"]} is expected, {up or "never at rest to tell"} it is'
        yield verdict('up_axis', up == section['up_axis'], message)


def _judge_pair(
    name: str, section: Section, topics: list[str], inspection: Inspection
) -> Iterator[Verdict]:
    bad = section.get('level', 'fail')
    pair = next((p for p in inspection.pairs if {p.first, p.second} == set(topics)), None)
    shown = ', '.join(topics)
    if pair is None:
        message = 'they are no cameras with a time in common'
        yield Verdict(name, shown, 'streams', None, bad, message)
        return
    values = (abs(pair.skew_s), pair.unsynchronised / pair.frames)
    for key, value in zip(PAIR_LIMITS, values, strict=True):
        if key in section:
            is_met, message, _ = _limited(key, float(section[key]), value)
            yield Verdict(name, shown, key, value, 'pass' if is_met else bad, message)


def _limited(key: str, limit: float, value: float) -> tuple[bool, str, float]:
    """Return whether a value keeps its limit, which one that does not exist never does."""
    is_met = value <= limit if key.startswith('max_') else value >= limit
    side = 'at most' if key.startswith('max_') else 'at least'
    shown = 'unknown' if math.isnan(value) else f'{value:.4g}'
    return is_met, f'{side} {limit:g} is expected, {shown} it is', value
