"""From the raw bytes of a topic to messages and columns of numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, cached_property
import json
from types import SimpleNamespace
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from vio_eval_ros.errors import ReadError, UnsupportedMessage
from vio_eval_ros.recordings import cdr, messages
from vio_eval_ros.recordings.definitions import converter_of, Field, Fields, NUMBER, TEXT
from vio_eval_ros.recordings.messages import ArrayConverter, Converter, CONVERTERS, PATH
from vio_eval_ros.recordings.rosbags_internals import Typestore
from vio_eval_ros.recordings.storage import Channel, standard_types
from vio_eval_ros.recordings.storage_files import reading
from vio_eval_ros.recordings.transforms import as_transforms, FOXGLOVE_TF

HEADER = 'std_msgs/msg/Header'
BLOCK_BYTES = 4 << 20  # decoded at once; larger blocks are not faster


class Decoder:
    """
    Turns the raw bytes of one topic into messages, or into columns of numbers.

    ``is_ros`` says whether they are serialised as in ROS, ``ros1`` whether as in ROS 1,
    ``is_standard`` whether their type is defined as in ROS, ``is_known`` whether it is defined at
    all, and ``has_header`` whether they begin with a header.

    :raises ReadError: another serialisation, a definition that is damaged.
    """

    def __init__(self, source: str, channel: Channel) -> None:
        self.source = source
        self.msgtype = channel.msgtype
        self.is_ros = channel.encoding in ('cdr', 'ros1')
        self.ros1 = channel.encoding == 'ros1'
        self.is_standard = self.has_header = self.is_known = False
        self._fields: Fields = lambda name: {}
        self._function: Callable[[bytes], Any]
        if self.is_ros:
            self._of_ros(channel)
        elif channel.encoding == 'json':
            self._function = _from_json
        elif channel.encoding == 'protobuf':
            from vio_eval_ros.recordings.protobuf import message_class

            kind, self._fields = message_class(source, channel)
            self.is_known = True
            self._function = kind.FromString
        else:
            raise ReadError(
                source,
                f'is not read ({channel.encoding or "no encoding"}); what is read is cdr, ros1, '
                'json and protobuf',
            )

    def _of_ros(self, channel: Channel) -> None:
        types = channel.types()
        function = types.deserialize_ros1 if self.ros1 else types.deserialize_cdr
        self._function = lambda message: function(message, self.msgtype)
        standard = standard_types(ros1=self.ros1)
        self.is_standard = self.msgtype in standard.fielddefs and (
            types.hash_rihs01(self.msgtype) == standard.hash_rihs01(self.msgtype)
        )
        self.is_known = self.msgtype in types.fielddefs
        _, fields = types.fielddefs.get(self.msgtype, ((), []))
        self.has_header = bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)
        # a definition that nests its types asks for the fields of each of them again and again
        self._fields = cache(lambda name: _fields_of(types, name))

    @cached_property
    def converter(self) -> Converter | ArrayConverter:
        """
        How the poses in the messages are read.

        :raises UnsupportedMessage: they have none, or it is not known where.
        """
        if self.is_ros and not self.is_known:
            raise UnsupportedMessage(
                self.source,
                f'{self.msgtype} is not read: the recording has no definition of it; where '
                f'{self.msgtype.partition("/")[0]} is installed, `ros2 bag convert` to mcap adds '
                'it',
            )
        if self.msgtype in CONVERTERS:
            return CONVERTERS[self.msgtype]
        if not self.is_known:
            raise UnsupportedMessage(
                self.source,
                f'{self.msgtype} is not read (json): in JSON only foxglove.PoseInFrame, '
                'foxglove.FrameTransform and message types of ROS are; publish it as one of them',
            )
        try:
            return converter_of(self.source, self.msgtype, self._fields)
        except UnsupportedMessage:
            if not self.is_standard:
                raise
        raise UnsupportedMessage(self.source, f'{self.msgtype} carries no pose that can be scored')

    def deserialize(self, message: bytes) -> Any:
        """Return one message."""
        content = self._function(message)
        return as_transforms(content) if self.msgtype in FOXGLOVE_TF else content

    def columns(self, block: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps and numbers of the poses in many messages that have one each."""
        if self.is_standard:
            fast = (
                cdr.decode_path(block[0], self.ros1)
                if self.msgtype == PATH
                else cdr.decode(self.msgtype, block, self.ros1)
            )
            if fast is not None:
                return fast
        converter = self.converter
        assert isinstance(converter, Converter)
        with self.reading():
            return messages.columns(
                [row for message in block for row in converter.rows(self.deserialize(message))]
            )

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Turn what goes wrong while messages are converted into a ``ReadError``."""
        with reading(self.source):
            try:
                yield
            except AttributeError as error:
                raise ReadError(
                    self.source,
                    f'{self.msgtype} is not read: here it is defined otherwise than usual '
                    f"(without '{error.name}')",
                ) from None


def _from_json(message: bytes) -> Any:
    """Return JSON with its objects' members as attributes."""
    return json.loads(message, object_hook=lambda members: SimpleNamespace(**members))


def _fields_of(types: Typestore, msgtype: str) -> Mapping[str, Field]:
    """Return the fields of a message type of ROS; none where it is not known."""
    return {name: _field(kind) for name, kind in types.fielddefs.get(msgtype, ((), ()))[1]}


def _field(kind: Any) -> Field:
    node, argument = kind
    if node == Nodetype.NAME:
        return Field(argument)
    if node == Nodetype.BASE:
        return Field(TEXT if argument[0] in ('string', 'wstring') else NUMBER)
    return Field(_field(argument[0]).type, is_list=True)


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
