"""Messages of an mcap file that are serialised with protobuf, by the definition in the file."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.definitions import Field, Fields, NUMBER, TEXT
from vio_eval_ros.recordings.storage import Channel


def message_class(source: str, channel: Channel) -> tuple[Any, Fields]:
    """
    Return the class of the messages of a channel, and the fields of their types.

    What protobuf raises where the definition is damaged passes through.

    :raises ReadError: protobuf is not installed.
    """
    try:
        from google.protobuf.descriptor import FieldDescriptor
        from google.protobuf.descriptor_pb2 import FileDescriptorSet
        from google.protobuf.descriptor_pool import DescriptorPool
        from google.protobuf.message_factory import GetMessageClass
    except ImportError:
        raise ReadError(
            source, "is not read (protobuf): pip install 'vio_eval_ros[protobuf]'"
        ) from None
    pool = DescriptorPool()
    added: set[str] = set()
    waiting = list(FileDescriptorSet.FromString(channel.definition.data).file)
    while ready := [file for file in waiting if added.issuperset(file.dependency)]:
        for file in ready:
            pool.Add(file)
            added.add(file.name)
        waiting = [file for file in waiting if file.name not in added]
    descriptor = pool.FindMessageTypeByName(channel.msgtype)
    texts = (FieldDescriptor.TYPE_STRING, FieldDescriptor.TYPE_BYTES)
    known = {descriptor.full_name: descriptor}

    @cache
    def fields(name: str) -> Mapping[str, Field]:
        if name not in known:
            return {}
        found = {}
        for field in known[name].fields:
            inner = field.message_type
            if inner is not None:
                known[inner.full_name] = inner
            kind = (
                inner.full_name if inner is not None else TEXT if field.type in texts else NUMBER
            )
            found[field.name] = Field(kind, field.is_repeated)
        return found

    return GetMessageClass(descriptor), fields
