"""Short mcap files cut out of a recording, as ROS 2 messages."""

from __future__ import annotations

from io import BytesIO

from mcap.writer import Writer

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.playback import Playback


class Clips:
    """
    A recording from which clips are cut; ``playback`` is open and stays so.

    ``left_out`` has a sentence for each topic that is not in the clips, since it cannot be played
    or its definition is not known.
    """

    def __init__(self, playback: Playback) -> None:
        self._playback = playback
        self.left_out = list(playback.warnings)
        self._types: dict[str, tuple[str, bytes]] = {}
        for topic in playback.topics:
            try:
                text = playback.definition(topic.name)
            except ReadError as error:
                self.left_out.append(str(error))
            else:
                self._types[topic.name] = topic.msgtype, text.encode()

    def cut(self, begin_ns: int, end_ns: int) -> tuple[bytes, int]:
        """
        Return an mcap of the messages recorded from one time to another, and their number.

        :raises ReadError: a recording that is damaged there.
        """
        content, count = BytesIO(), 0
        writer = Writer(content)
        writer.start('ros2', 'vio_eval_ros')
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for log_ns, topic, raw in self._playback.messages(set(self._types), begin_ns, end_ns):
            if topic not in channels:
                msgtype, text = self._types[topic]
                if msgtype not in schemas:
                    schemas[msgtype] = writer.register_schema(msgtype, 'ros2msg', text)
                channels[topic] = writer.register_channel(topic, 'cdr', schemas[msgtype])
            writer.add_message(channels[topic], log_ns, raw, log_ns)
            count += 1
        writer.finish()
        return content.getvalue(), count
