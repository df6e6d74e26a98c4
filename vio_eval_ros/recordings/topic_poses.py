"""The poses of one topic, gathered message by message."""

from __future__ import annotations

from array import array
from dataclasses import replace
from itertools import islice
import math
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings import messages
from vio_eval_ros.recordings.decoder import Blocks, Decoder
from vio_eval_ros.recordings.messages import (
    ArrayConverter,
    Converter,
    Numbers,
    PATH,
    PathRevisions,
)

#: elements of an array that are told apart, and that an error lists
MOST_ELEMENTS, MOST_LISTED = 1000, 20
#: clocks that are set show later times (2001-09-09)
EPOCH_NS = 1_000_000_000_000_000_000
#: what has moved less far stands still [m]
STILL_M = 0.01


class TopicPoses(NamedTuple):
    """
    The poses of a topic or transform.

    :param poses: as last revised, where the topic revises them.
    :param causal: as first published; None where the topic revises nothing.
    :param warnings: what was taken for granted, in sentences.
    :param from_boot: whether the stamps count from the start of a device, unlike those of others.
    """

    poses: Poses
    causal: Poses | None = None
    warnings: tuple[str, ...] = ()
    from_boot: bool = False


def by_recording(source: str) -> str:
    """Return the sentence that says that the time of recording stands for stamps."""
    return (
        f'{source}: each pose has the time at which it was recorded, which is later than it was '
        'measured; `diagnose` finds how much later'
    )


def collector_of(
    decoder: Decoder, element: str | None, recorded: bool
) -> PoseColumns | ElementColumns:
    """
    Return what gathers the poses of a topic.

    :param element: which pose of each message, by name or index; None where none is chosen.
    :param recorded: whether the time of recording takes the place of the stamps.
    :raises UnsupportedMessage: the messages have no pose.
    :raises ConfigError: an element of what has one pose, or times of a Path.
    """
    converter = decoder.converter
    if isinstance(converter, ArrayConverter):
        return ElementColumns(decoder, converter, element, recorded)
    if element is not None:
        raise ConfigError(
            f'{decoder.source}: {decoder.msgtype} has one pose in each message; '
            f'leave out [{element}]'
        )
    return PoseColumns(decoder, converter, recorded)


class PoseColumns:
    """The poses of messages with one each, a block at a time: memory holds columns."""

    def __init__(self, decoder: Decoder, converter: Converter, recorded: bool) -> None:
        self._decoder = decoder
        self._path = PathRevisions(decoder.source) if decoder.msgtype == PATH else None
        if self._path and recorded:
            raise ConfigError(
                f'{decoder.source}: stamps=recorded does not apply to a Path, each message of '
                'which has many poses'
            )
        self._adjust = converter.adjustment() if converter.adjustment else None
        self._converter = converter
        self._last_log_ns = 0
        self._logged = array('q') if recorded or not converter.is_stamped else None
        self._blocks = Blocks(self._decode)
        self._columns: list[tuple[np.ndarray, np.ndarray]] = []

    def add(self, log_ns: int, message: bytes) -> None:
        """Take one message."""
        if self._path:
            self._path.add(messages.poses(*self._decoder.columns([message])))
            return
        self._last_log_ns = log_ns
        if self._logged is not None:
            self._logged.append(log_ns)
        self._blocks.add(message)

    def read(self) -> TopicPoses:
        """Return the poses of all messages."""
        if self._path:
            return TopicPoses(self._path.final(), self._path.causal())
        self._blocks.flush()
        stamps, numbers = map(np.concatenate, zip(*self._columns, strict=True))
        notes = [*self._converter.notes]
        if self._adjust:
            numbers = self._adjust(numbers)
            notes += [f'{self._decoder.source}: {note}' for note in self._adjust.notes()]
        if self._logged is not None:
            stamps = np.array(self._logged, np.int64)
            notes.append(by_recording(self._decoder.source))
        from_boot = self._converter.from_boot and int(stamps[-1]) < EPOCH_NS < self._last_log_ns
        poses = messages.poses(stamps, numbers)
        if self._adjust:
            poses = replace(poses, origin=self._adjust.origin)
        return TopicPoses(poses, warnings=tuple(notes), from_boot=from_boot)

    def _decode(self, block: list[bytes]) -> None:
        self._columns.append(self._decoder.columns(block))


class _Track:
    """How often an element of an array was there, and the box that it stayed in."""

    def __init__(self) -> None:
        self.count = 0
        self._low = [math.inf] * 3
        self._high = [-math.inf] * 3

    def add(self, position: Numbers) -> None:
        """Take one position."""
        self.count += 1
        # in plain numbers, since arrays of three are slower; NaN is neither lower nor higher
        self._low = [p if p < low else low for p, low in zip(position, self._low, strict=True)]
        self._high = [
            p if p > high else high for p, high in zip(position, self._high, strict=True)
        ]

    @property
    def extent_m(self) -> float:
        """The diagonal of the box."""
        sides = (high - low for low, high in zip(self._low, self._high, strict=True))
        return math.hypot(*(side for side in sides if math.isfinite(side)))

    def __str__(self) -> str:
        """Return whether it moves."""
        extent = self.extent_m
        return f'moves {extent:.3g} m' if extent > STILL_M else 'stands still'


class ElementColumns:
    """
    The poses of one element of arrays of poses.

    Where none is chosen and there is only one, it is that.
    """

    def __init__(
        self, decoder: Decoder, converter: ArrayConverter, element: str | None, recorded: bool
    ) -> None:
        self._decoder = decoder
        self._converter = converter
        self._element = element
        self._stamp_ns = None if recorded else converter.stamp_ns
        self._messages = 0
        self._lengths: set[int] = set()
        self._tracks: dict[str, _Track] = {}
        self._stamps, self._numbers = array('q'), array('d')

    def add(self, log_ns: int, message: bytes) -> None:
        """Take one message."""
        self._messages += 1
        with self._decoder.reading():
            content = self._decoder.deserialize(message)
            pose = self._pose_in(content)
            if pose is not None:
                self._stamps.append(self._stamp_ns(content) if self._stamp_ns else log_ns)
                self._numbers.extend(pose)

    def _pose_in(self, content: Any) -> Numbers | None:
        """Return the numbers of the element in a message; None where it is not there."""
        pose, count = None, 0
        for name, element in islice(self._converter.elements(content), MOST_ELEMENTS):
            count += 1
            track = self._tracks.get(name)
            if track is None and len(self._tracks) < MOST_ELEMENTS:
                track = self._tracks[name] = _Track()
            if self._element in (None, name):
                numbers = self._converter.numbers(element)
                if track is not None:
                    track.add(numbers[:3])
                if pose is None:  # of two with one name, the first
                    pose = numbers
        if count:
            self._lengths.add(count)
        return pose if self._element is not None or len(self._tracks) == 1 else None

    def read(self) -> TopicPoses:
        """
        Return the poses of the element.

        :raises ReadError: there is no such element, or none is chosen of several.
        """
        source, name = self._decoder.source, self._element
        if not self._tracks:
            raise ReadError(source, 'its messages have no poses')
        if name is None:
            if len(self._tracks) > 1:
                raise ReadError(
                    source, f'has several poses in a message; choose one: {self._listed()}'
                )
            (name,) = self._tracks
        elif name not in self._tracks:
            near = nearest_name(name, self._tracks)
            raise ReadError(source, f'there is no [{name}]{near}; there are: {self._listed()}')
        notes = [*self._converter.notes]
        if self._element is None:
            notes.append(f'{source}: its messages have one pose each, [{name}]')
        count = len(self._stamps)
        if count < self._messages:
            notes.append(f'{source}: [{name}] is in {count} of {self._messages} messages')
        if self._converter.by_index and len(self._lengths) > 1:
            notes.append(
                f'{source}: its messages have {min(self._lengths)} to {max(self._lengths)} poses: '
                f'where one is missing, [{name}] may be another body'
            )
        if self._stamp_ns is None:
            notes.append(by_recording(source))
        numbers = np.array(self._numbers).reshape(count, -1)
        poses = messages.poses(np.array(self._stamps, np.int64), numbers)
        return TopicPoses(poses, warnings=tuple(notes))

    def _listed(self) -> str:
        """Return the elements, those that move farthest first."""
        topic = self._decoder.source.rpartition(':')[2]
        tracks = sorted(self._tracks.items(), key=lambda item: -item[1].extent_m)
        listed = [
            f'{topic}[{name}]' + (f' ({track})' if track.count else '')
            for name, track in tracks[:MOST_LISTED]
        ]
        more = len(tracks) - len(listed)
        return ', '.join(listed) + (f' and {more} more' if more else '')
