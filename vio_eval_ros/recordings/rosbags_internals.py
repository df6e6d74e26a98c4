"""What is used of rosbags beyond its documentation; a test names every part of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys.store import Typestore

__all__ = ['Typestore', 'profiles_in', 'to_cdr']


def profiles_in(metadata: str) -> list[Qos]:
    """Return the QoS profiles that rosbag2 stores with a topic as YAML; none where damaged."""
    try:
        return parse_qos(metadata)
    except Exception:  # anything; what a publisher offered is only a hint, and has a default
        return []


def to_cdr(
    source: Typestore, target: Typestore, msgtype: str, renamed: str
) -> Callable[[bytes], bytes]:
    """
    Return a function from a serialised message of ROS 1 to one of ROS 2.

    A few types have fields in ROS 2 that they do not have in ROS 1; those take their defaults.

    :param source: the definitions of the recording.
    :param target: those of ROS 2.
    :param renamed: the name of the message type in ROS 2.
    """
    if is_same_wireformat(source, target, msgtype, renamed):
        return lambda raw: bytes(target.ros1_to_cdr(raw, renamed))
    migrate = partial(migrate_bytes, source, target, msgtype, renamed, {})
    return lambda raw: bytes(migrate(raw, src_is2=False, dst_is2=True))
