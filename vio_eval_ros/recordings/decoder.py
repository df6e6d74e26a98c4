"""From the raw bytes of a topic to messages and columns of numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import cdr, messages
from vio_eval_ros.recordings.messages import CONVERTERS, PATH
from vio_eval_ros.recordings.storage import Channel, standard_types
from vio_eval_ros.recordings.storage_files import reading

HEADER = 'std_msgs/msg/Header'
BLOCK_BYTES = 4 << 20  # decoded at once; larger blocks are not faster


class Decoder:
    """
    Turns the raw bytes of one topic into messages, or into columns of numbers.

    ``ros1`` says how they are serialised, ``is_standard`` whether their type is defined as in ROS,
    ``is_known`` whether it is defined at all, and ``has_header`` whether they begin with a header.
    """

    def __init__(self, source: str, channel: Channel) -> None:
        if channel.encoding not in ('cdr', 'ros1'):
            raise ReadError(
                source, f'is serialised as {channel.encoding!r}; only cdr and ros1 can be read'
            )
        types = channel.types()
        self.source = source
        self.msgtype = channel.msgtype
        self.ros1 = channel.encoding == 'ros1'
        self._function = types.deserialize_ros1 if self.ros1 else types.deserialize_cdr
        standard = standard_types(self.ros1)
        self.is_standard = self.msgtype in standard.fielddefs and (
            types.hash_rihs01(self.msgtype) == standard.hash_rihs01(self.msgtype)
        )
        self.is_known = self.msgtype in types.fielddefs
        _, fields = types.fielddefs.get(self.msgtype, ((), []))
        self.has_header = bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)

    def deserialize(self, message: bytes) -> Any:
        """Return one message."""
        return self._function(message, self.msgtype)

    def columns(self, block: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps and numbers of the poses in many messages."""
        if self.is_standard:
            fast = (
                cdr.decode_path(block[0], self.ros1)
                if self.msgtype == PATH
                else cdr.decode(self.msgtype, block, self.ros1)
            )
            if fast is not None:
                return fast
        convert = CONVERTERS[self.msgtype]
        with reading(self.source):
            rows = [row for message in block for row in convert(self.deserialize(message))]
        return messages.columns(rows)


class Blocks:
    """
    Gathers messages until there are enough to be decoded at once.

    :param decode: takes each block.
    """

    def __init__(self, decode: Callable[[list[bytes]], None]) -> None:
        self._decode = decode
        self._block: list[bytes] = []
        self._bytes = 0

    def add(self, message: bytes) -> None:
        """Take one message."""
        self._block.append(message)
        self._bytes += len(message)
        if self._bytes > BLOCK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Decode what has been gathered."""
        if self._block:
            self._decode(self._block)
            self._block, self._bytes = [], 0
