"""What is used of the mcap library beyond its documentation; a test names every part of it."""

from __future__ import annotations

from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.records import Chunk, ChunkIndex, Message
from mcap.stream_reader import breakup_chunk

RECORD_HEAD_BYTES = 1 + 8  # opcode and length, in front of every record


def chunk_messages(stream: BinaryIO, index: ChunkIndex) -> list[Message]:
    """
    Return the messages of a chunk in the order of the file, its checksum verified.

    The library's own ``iter_messages`` in that order reads all chunks before it yields.
    """
    stream.seek(index.chunk_start_offset + RECORD_HEAD_BYTES)
    chunk = Chunk.read(ReadDataStream(stream))
    records = breakup_chunk(chunk, validate_crc=True)
    return [record for record in records if isinstance(record, Message)]
