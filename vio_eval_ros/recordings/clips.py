"""Small mcaps cut out of a recording, as ROS 2 messages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import tempfile
from typing import BinaryIO

from mcap.writer import Writer
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from vio_eval_ros.errors import WriteError
from vio_eval_ros.recordings.playback import _Converted, HEADER, Playback
from vio_eval_ros.recordings.storage import standard_types

NEW_FILES = 0o666


class Clips:
    """
    A recording from which clips are cut; ``playback`` is open and stays so.

    What is left out of a playback is left out of clips.
    """

    def __init__(self, playback: Playback) -> None:
        self._playback = playback
        self._texts = {
            topic.name: self._definition(topic.name, topic.msgtype) for topic in playback.topics
        }

    def cut(self, begin_ns: int, end_ns: int, path: Path) -> int:
        """
        Write the messages recorded from one time to another, both included; return how many.

        :raises ReadError: a recording that is damaged there.
        :raises WriteError: where the file cannot be written; it appears whole or not at all.
        """
        types = {topic.name: topic.msgtype for topic in self._playback.topics}
        messages = self._playback.messages(set(types), begin_ns, end_ns)
        count = 0
        with _whole_file(path) as stream:
            writer = Writer(stream)
            writer.start('ros2', 'vio_eval_ros')
            schemas: dict[str, int] = {}
            channels: dict[str, int] = {}
            for count, (log_ns, topic, raw) in enumerate(messages, 1):  # noqa: B007
                if topic not in channels:
                    msgtype = types[topic]
                    if msgtype not in schemas:
                        text = self._texts[topic].encode()
                        schemas[msgtype] = writer.register_schema(msgtype, 'ros2msg', text)
                    channels[topic] = writer.register_channel(topic, 'cdr', schemas[msgtype])
                writer.add_message(channels[topic], log_ns, raw, log_ns)
            writer.finish()
        return count

    def _definition(self, topic: str, msgtype: str) -> str:
        """Return the definition of a message type, as ROS 2 writes it."""
        for source in self._playback._sources:
            if isinstance(source, _Converted):
                for channel in source._storage.channels:
                    if channel.topic == topic:
                        types = source._storage.types(channel.msgtype)
                        return _text(types, msgtype, channel.encoding == 'ros1')
        return _text(standard_types(ros1=False), msgtype, False)


def _text(types: Typestore, msgtype: str, ros1: bool) -> str:
    standard = standard_types(ros1=False)
    if ros1 and msgtype in standard.fielddefs:
        types = standard
    elif ros1:
        types = get_typestore(Stores.EMPTY)
        types.register({**types.fielddefs, HEADER: standard.fielddefs[HEADER]})
    return types.generate_msgdef(msgtype, ros_version=2)[0]


@contextmanager
def _whole_file(path: Path) -> Iterator[BinaryIO]:
    """Yield a stream whose content becomes that of the file once all of it has been written."""
    temporary: Path | None = None
    try:
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=f'.{path.name}.', delete=False
        ) as file:
            temporary = Path(file.name)
            yield file  # type: ignore[misc]
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(NEW_FILES & ~umask)
        temporary.replace(path)
        temporary = None
    except OSError as error:
        raise WriteError(path, error.strerror or str(error)) from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
