"""Which streams the evaluator listens to, as its parameters name them."""

from __future__ import annotations

from collections.abc import Sequence
import re
from typing import NamedTuple

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.options import NodeConfig

#: the name of the ground truth among the streams of the node
GROUND_TRUTH = 'ground_truth'
#: what may stand in the name of a topic
LABEL = '[A-Za-z][A-Za-z0-9_]*'


class InputName(NamedTuple):
    """
    A stream of poses.

    :param topic: as written; what has no leading slash is relative, and may be remapped.
    :param frames: 'PARENT.CHILD' of a TF topic; empty for others.
    :param label: what the estimate is called beside others; empty where there is only one.
    """

    topic: str
    frames: str = ''
    label: str = ''

    @property
    def key(self) -> str:
        """The name of an estimate among the streams of the node."""
        return f'estimate {self.label}' if self.label else 'estimate'

    @classmethod
    def parse(cls, text: str, label: str = '') -> InputName:
        """Return the stream that ``/topic`` or ``/tf:PARENT.CHILD`` means."""
        topic, colon, frames = text.partition(':')
        if not topic or (colon and '.' not in frames):
            raise ConfigError(f"'{text}': write a topic, or /tf:PARENT.CHILD for two frames")
        return cls(topic, frames, label)


def estimates_of(settings: NodeConfig) -> list[InputName]:
    """
    Return the estimates that the parameters name; ``estimate``, to be remapped, where none do.

    :raises ConfigError: what cannot be understood, or contradicts itself.
    """
    if not settings.estimates:
        return [_one('estimate', settings.estimate, settings.estimate_frames)]
    if settings.estimate or settings.estimate_frames:
        raise ConfigError('estimates: it takes the place of estimate and estimate_frames')
    found = []
    for text in settings.estimates:
        label, assigned, stream = text.partition(':=')
        if not assigned or not re.fullmatch(LABEL, label):
            raise ConfigError(
                f"estimates: '{text}': write NAME:=TOPIC, where NAME has letters, digits and _"
            )
        found.append(_named('estimates', stream, label))
    for k, one in enumerate(found):
        for other in found[:k]:
            if other.label == one.label or other[:2] == one[:2]:
                what = one.label if other.label == one.label else ':'.join(filter(None, one[:2]))
                raise ConfigError(f'estimates: {what} is there twice')
    return found


def ground_truth_of(settings: NodeConfig) -> InputName:
    """
    Return the ground truth that the parameters name; likewise.

    :raises ConfigError: likewise.
    """
    return _one(GROUND_TRUTH, settings.ground_truth, settings.ground_truth_frames)


def _one(name: str, text: str, frames: Sequence[str]) -> InputName:
    if not frames:
        return _named(name, text or name)
    if text:
        raise ConfigError(f'{name}_frames: set it or {name}, not both')
    if len(frames) != 2 or not all(frames):
        raise ConfigError(f'{name}_frames: expected two frames, such as [map, base_link]')
    return InputName('/tf', '.'.join(frame.lstrip('/') for frame in frames))


def _named(parameter: str, text: str, label: str = '') -> InputName:
    try:
        return InputName.parse(text, label)
    except ConfigError as error:
        raise ConfigError(f'{parameter}: {error}') from None
