"""Read the records of an untrusted MCAP file: every announced length is bounded before memory is allocated for it.

An MCAP record announces its own length and those of its parts, and a chunk announces its unpacked size. The library trusts both,
so it reads from a stream that knows where the file ends, and chunks are unpacked here.
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, cast

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import StreamReader, breakup_chunk

from estimator.contracts.errors import BadInput

MAGIC = b"\x89MCAP0\r\n"
MOST_RECORD_BYTES = 128 << 20
MOST_CHUNK_BYTES = 64 << 20
"""The largest size of an unpacked chunk: sixteen times the size of ours."""


def records(stream: IO[bytes], path: Path, cut: dict[Path, str]) -> Iterator[McapRecord]:
    """Yield all records in order; if the file ends early or is damaged, put the reason into `cut` and end the iteration.

    Args:
        stream: the file, open at its beginning.

    Raises:
        BadInput: the file does not even begin like an MCAP file.
    """
    if stream.read(len(MAGIC)) != MAGIC:
        raise BadInput(f"{path}: not an MCAP file")
    stream.seek(0)
    reader = StreamReader(
        cast(IO[bytes], _Ending(stream)), emit_chunks=True, validate_crcs=True, record_size_limit=MOST_RECORD_BYTES
    )
    found = reader.records
    while True:
        try:
            record = next(found, None)
            inner = breakup_chunk(_unpacked(record), validate_crc=True) if isinstance(record, Chunk) else [record]
        # The bytes may come from anywhere, and the library raises whatever its parsing stumbles over.
        except Exception as why:
            cut[path] = str(why) or type(why).__name__
            return
        for one in inner:
            if one is None:
                return
            yield one


def _unpacked(chunk: Chunk) -> Chunk:
    """Return the chunk without compression.

    Raises:
        McapError: it is larger than `MOST_CHUNK_BYTES`, or not of the size that it announces.
    """
    announced = chunk.uncompressed_size
    if announced > MOST_CHUNK_BYTES:
        raise McapError(f"a chunk announces {announced} bytes, at most {MOST_CHUNK_BYTES} are read")
    match chunk.compression:
        case "zstd":
            # Unpack one byte more than announced, so that a chunk that holds more is detected.
            unpacked = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(announced + 1)
        case "lz4":
            unpacked = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=announced + 1)
        case "":
            unpacked = chunk.data
        case other:
            raise McapError(f"chunks are packed with {other[:20]!r}, which is not read")
    if len(unpacked) != announced:
        raise McapError(f"a chunk announces {announced} bytes and does not hold them")
    return replace(chunk, compression="", data=unpacked)


class _Ending:
    """A file that knows where it ends: a read beyond the end allocates no memory for the missing bytes."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._left = os.fstat(stream.fileno()).st_size - stream.tell()

    def read(self, size: int = -1) -> bytes:
        data = self._stream.read(self._left if size < 0 else min(size, self._left))
        self._left -= len(data)
        return data
