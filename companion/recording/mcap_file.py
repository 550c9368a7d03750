"""Write one MCAP file. After each flush the file on the disk is a sequence of whole chunks, which can be read as it is."""

import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import msgspec
from mcap.writer import CompressionType, IndexType, Writer

from companion.recording.channels import TOPICS, json_schema, schema_name
from estimator.vision.pad.pad import Pad

CHUNK_BYTES = 4 << 20


@dataclass(frozen=True, slots=True)
class Attachment:
    """A small file that travels with the recording."""

    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True, slots=True)
class About:
    """The metadata and attachments of every file of a recording."""

    metadata: Mapping[str, Mapping[str, str]]
    """The metadata by name: versions, clock, and anything else that describes the flight."""
    attachments: Sequence[Attachment] = ()
    """The settings, camera and pad files."""
    offset_ns: int = 0
    """The offset from the monotonic clock to the viewer's time axis, ns; it is 0 in virtual time."""
    pad: Pad | None = None
    """The pad of the viewer's scene."""


class McapFile:
    """Opens `path` for writing, and writes everything that precedes the first message.

    Raises:
        OSError: the file cannot be made or the disk is full; so do `add`, `flush` and `close`.
    """

    def __init__(self, path: Path, about: About) -> None:
        self.path = path
        self._file = path.open("xb", buffering=0)
        self._buffer = io.BytesIO()
        self._writer = Writer(
            cast(IO[Any], _Counted(self._buffer)),
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            index_types=IndexType.ALL,
        )
        self._encoder = msgspec.json.Encoder()
        self._sequences = dict.fromkeys(TOPICS, 0)
        self.bytes = 0
        """The number of bytes on the disk."""
        try:
            self._begin(about)
        except BaseException:
            self._file.close()
            path.unlink(missing_ok=True)
            raise

    def _begin(self, about: About) -> None:
        self._writer.start(profile="", library="decklander")
        for attachment in about.attachments:
            self._writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        for name, data in about.metadata.items():
            self._writer.add_metadata(name, dict(data))
        self._writer.add_metadata("clock", {"monotonic_to_epoch_ns": str(about.offset_ns)})
        schemas: dict[type[msgspec.Struct], int] = {}
        self._channels: dict[str, int] = {}
        for topic, kind in TOPICS.items():
            if kind not in schemas:
                name = schema_name(kind)
                text = json.dumps(json_schema(kind, name), separators=(",", ":")).encode()
                schemas[kind] = self._writer.register_schema(name, "jsonschema", text)
            self._channels[topic] = self._writer.register_channel(topic, "json", schemas[kind])
        self._spill()

    def add(self, topic: str, at_ns: int, message: msgspec.Struct) -> None:
        """Add one message; it is on the disk after the next `flush`."""
        sequence = self._sequences[topic]
        self._sequences[topic] = sequence + 1
        self._writer.add_message(self._channels[topic], max(0, at_ns), self._encoder.encode(message), max(0, at_ns), sequence)

    @property
    def pending_bytes(self) -> int:
        """The size of the finished chunks that wait for the next flush, bytes."""
        return self._buffer.tell()

    def flush(self) -> None:
        """End the chunk and write it in one piece; if the disk is full, remove the part that was written."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._spill()

    @property
    def removed(self) -> bool:
        """Return whether the file was removed from its folder, so that everything in it is lost when it is closed."""
        return os.fstat(self._file.fileno()).st_nlink == 0

    def sync(self) -> None:
        """Wait until the disk itself has stored the file."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the index and close the file."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._spill()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file without another write: it stays readable up to its last flush."""
        self._file.close()

    def _spill(self) -> None:
        data = self._buffer.getvalue()
        self._buffer.seek(0)
        self._buffer.truncate()
        view = memoryview(data)
        try:
            while view:
                view = view[self._write(view) :]
        except OSError:
            os.ftruncate(self._file.fileno(), self.bytes)
            raise
        self.bytes += len(data)

    def _write(self, data: memoryview) -> int:
        return os.write(self._file.fileno(), data)


class _Counted:
    """The writer's view of the stream: its offsets keep growing although the buffer below is emptied at each flush."""

    def __init__(self, buffer: io.BytesIO) -> None:
        self._buffer = buffer
        self._offset = 0

    def write(self, data: bytes) -> int:
        written = self._buffer.write(data)
        self._offset += written
        return written

    def tell(self) -> int:
        return self._offset

    def flush(self) -> None:
        return None
