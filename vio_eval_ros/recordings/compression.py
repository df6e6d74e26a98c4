"""Files and messages that are compressed with zstd, decompressed within limits."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
import shutil
import sys
from tempfile import TemporaryDirectory

from vio_eval_ros.recordings.storage import RefusedError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
# how other compressed files begin, and what decompresses them
OTHERS = {
    b'\x1f\x8b': 'gunzip',
    b'BZh': 'bunzip2',
    b'\xfd7zXZ\0': 'unxz',
    b'\x04\x22\x4d\x18': 'unlz4',
    b'PK\3\4': 'unzip',
}
MAX_FILE_BYTES = 64 << 30
MAX_MESSAGE_BYTES = 1 << 30
BLOCK_BYTES = 1 << 20


def decompressed_file(path: Path, stack: ExitStack) -> Path:
    """
    Return the file in a compressed one, in a temporary folder that the stack deletes.

    :raises RefusedError: larger than ``MAX_FILE_BYTES`` or than the room there is.
    """
    folder = Path(stack.enter_context(TemporaryDirectory(prefix='vio_eval_ros_')))
    limit = min(MAX_FILE_BYTES, shutil.disk_usage(folder).free * 9 // 10)
    target, size = folder / path.stem, 0
    with zstd.open(path, 'rb') as source, target.open('xb') as output:
        while block := _next(source):
            size += len(block)
            if size > limit:
                raise RefusedError(
                    f'is larger than {limit / 2**30:.3g} GiB when decompressed, too large for '
                    f'{folder.parent}; decompress it first: zstd -d FILE'
                )
            output.write(block)
    return target


def _next(source: zstd.ZstdFile) -> bytes:
    try:
        return source.read(BLOCK_BYTES)
    except zstd.ZstdError as error:
        if 'memory' not in str(error):
            raise
        raise RefusedError(
            'was compressed with a window of more than 128 MiB; decompress it first: '
            'zstd -d --long=31 FILE'
        ) from error


def decompressed_message(raw: bytes) -> bytes:
    """
    Return the message in a compressed one.

    :raises RefusedError: it is cut off or larger than ``MAX_MESSAGE_BYTES``.
    """
    decompressor = zstd.ZstdDecompressor()
    message = decompressor.decompress(raw, max_length=MAX_MESSAGE_BYTES)
    if not decompressor.eof:
        raise RefusedError('has a compressed message that is cut off or larger than 1 GiB')
    return message
