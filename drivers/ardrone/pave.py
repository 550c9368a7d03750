"""The PaVE stream of TCP port 5555: video headers a parser that resynchronizes after damage, and a decoder. No I/O.

A header of 64, 68 or 76 bytes (its own `header_size` field decides) precedes one H.264 access unit. Source: Parrot SDK 2.0.1
`video_encapsulation.h`, checked against captures with 64 and 68-byte headers.

A decoder that lost a unit continues with wrong frames and does not always report it, so after any gap, damage or error everything
is dropped up to the next IDR. `VideoDecoder.newest` blocks for 1-2 ms a frame of 640x360: call it in order from one thread.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.pyav import AccessUnitDecoder, whole

if TYPE_CHECKING:
    from av import VideoFrame

MAGIC = b"PaVE"
_FIXED = struct.Struct("<4sBBHIHHHHIIBBBBQHBBBB2sI12s")
_FIELDS = (
    "version", "codec", "header_size", "payload_size", "encoded_width", "encoded_height", "display_width", "display_height",
    "frame_number", "timestamp_ms", "total_chunks", "chunk_index", "frame_type", "control", "stream_position", "stream_id",
    "total_slices", "slice_index", "sps_size", "pps_size", "padding", "advertised_size", "reserved",
)  # fmt: skip
"""The fields of a header behind its magic, in the order of the wire."""
HEADER_SIZE_MIN = _FIXED.size
HEADER_SIZE_MAX = 256
"""The largest header accepted, bytes."""
PAYLOAD_MAX = 1 << 20
"""The largest payload accepted, bytes; a 720p key frame is below 200 kB, so a larger size means a damaged header."""
CODEC_H264 = 4
"""Codec number of H.264."""
CONTROL_ADVERTISEMENT = 1
"""Bit of a header that announces a frame; no payload follows."""
CONTROL_LAST_FRAME = 2
"""Bit of the last frame of a stream."""
MAX_PIXELS = 1920 * 1088
"""The largest frame decoded: 1080p in whole macroblocks."""


class FrameType(IntEnum):
    """The frame's type, which says what other frames its decoding needs."""

    UNKNOWN = 0
    IDR = 1
    I = 2  # noqa: E741
    P = 3
    HEADERS = 4


@dataclass(frozen=True, slots=True)
class PaveHeader:
    """Every field of the header.

    Raises:
        ValueError: `extension` does not fill `header_size`.
    """

    payload_size: int
    frame_number: int
    timestamp_ms: int
    """The time on the drone's clock, milliseconds, u32."""
    frame_type: int
    version: int = 2
    codec: int = CODEC_H264
    header_size: int = 64
    encoded_width: int = 640
    encoded_height: int = 368
    display_width: int = 640
    display_height: int = 360
    total_chunks: int = 1
    chunk_index: int = 0
    control: int = 0
    stream_position: int = 0
    """The number of bytes of the stream before this frame, without parameter sets."""
    stream_id: int = 1
    total_slices: int = 1
    slice_index: int = 0
    sps_size: int = 0
    """The size of the sequence parameter set inside the payload, bytes; 0 if the payload has none."""
    pps_size: int = 0
    padding: bytes = bytes(2)
    advertised_size: int | None = None
    """The advertised size, bytes; None is packed as `payload_size`, which is what every data frame holds."""
    reserved: bytes = bytes(12)
    extension: bytes = b""
    """The bytes from 64 to `header_size`, which are undocumented."""

    def __post_init__(self) -> None:
        if self.advertised_size is None:
            object.__setattr__(self, "advertised_size", self.payload_size)
        if not self.extension:
            object.__setattr__(self, "extension", bytes(max(0, self.header_size - HEADER_SIZE_MIN)))
        if len(self.extension) != self.header_size - HEADER_SIZE_MIN:
            raise ValueError(f"a header of {self.header_size} bytes cannot hold an extension of {len(self.extension)}")

    @property
    def advertisement(self) -> bool:
        """True if the header announces a frame; no payload follows it then."""
        return bool(self.control & CONTROL_ADVERTISEMENT)

    def pack(self) -> bytes:
        """Return the header's bytes.

        Raises:
            struct.error: a value does not fit its field.
        """
        return _FIXED.pack(MAGIC, *[getattr(self, name) for name in _FIELDS]) + self.extension


class _More(Enum):
    """The answer of `_examine` when the bytes so far may become a header."""

    NEEDED = 1


def _examine(data: bytes | bytearray, offset: int) -> PaveHeader | _More | None:
    """Return the header at `offset`, `_More` for the beginning of one, or None for anything else."""
    head = data[offset : offset + len(MAGIC)]
    if head != MAGIC[: len(head)]:
        return None
    if len(data) - offset < HEADER_SIZE_MIN:
        return _More.NEEDED
    found = dict(zip(_FIELDS, _FIXED.unpack_from(data, offset)[1:], strict=True))
    plausible = (
        1 <= found["version"] <= 8
        and 1 <= found["codec"] <= 8
        and HEADER_SIZE_MIN <= found["header_size"] <= HEADER_SIZE_MAX
        and found["payload_size"] <= PAYLOAD_MAX
        and found["frame_type"] <= FrameType.HEADERS
        and found["control"] <= (CONTROL_ADVERTISEMENT | CONTROL_LAST_FRAME)
        and found["chunk_index"] <= found["total_chunks"]
        and found["slice_index"] <= found["total_slices"]
        and max(found[name] for name in _FIELDS if name.endswith(("_width", "_height"))) <= 4096
    )
    if not plausible:
        return None
    if len(data) - offset < found["header_size"]:
        return _More.NEEDED
    return PaveHeader(**found, extension=bytes(data[offset + HEADER_SIZE_MIN : offset + found["header_size"]]))


@dataclass(frozen=True, slots=True)
class PaveFrame:
    """One header with its payload."""

    header: PaveHeader
    payload: bytes
    discontinuity: bool
    """True if data before this frame is missing or damaged, or another stream begins: only an IDR may be decoded then."""


class PaveParser:
    """Takes the bytes of the stream as they arrive and returns the frames in order.

    Damage never raises and never costs the next whole frame: a header inside another frame's payload ends that frame, and after
    a frame that is not followed by a header the search goes back into its tail.
    """

    def __init__(self) -> None:
        self._data = bytearray()
        self._at = 0
        """The offset at which the next header is expected."""
        self._floor = 0
        """The offset before which no search may go back: the end of the header of the frame that was returned last."""
        self._clean = True
        self._last: PaveHeader | None = None
        self._searched = 0
        """The offset up to which the unfinished frame was searched for a header inside it."""

    @property
    def pending(self) -> int:
        """The number of bytes of the frame that is not whole yet."""
        return len(self._data) - self._at

    def reset(self) -> None:
        """Discard the unfinished frame, because another connection begins; the next frame is marked as a discontinuity."""
        self._data.clear()
        self._at = self._floor = self._searched = 0
        self._clean = False

    def feed(self, data: bytes) -> list[PaveFrame]:
        """Take the next bytes of the stream and return every frame that they complete."""
        self._data += data
        out: list[PaveFrame] = []
        while self._step(out):
            pass
        keep = self._floor if self._at > self._floor else self._at
        if keep:
            del self._data[:keep]
            self._at -= keep
            self._floor -= keep
            self._searched = max(0, self._searched - keep)
        return out

    def _step(self, out: list[PaveFrame]) -> bool:
        """Advance by one frame or one search; return False when more bytes are needed."""
        header = _examine(self._data, self._at)
        if header is None:
            return self._resync(self._floor if self._floor < self._at else self._at + 1)
        if header is _More.NEEDED:
            return self._overtaken(self._at + 1, len(self._data))
        end = self._at + header.header_size + (0 if header.advertisement else header.payload_size)
        if self._overtaken(self._at + 1, min(end, len(self._data))):
            return True
        if len(self._data) < end:
            return False
        out.append(self._given(header, bytes(self._data[self._at + header.header_size : end])))
        self._floor = self._at + header.header_size
        self._at = self._searched = end
        return True

    def _given(self, header: PaveHeader, payload: bytes) -> PaveFrame:
        continuous = self._clean
        last = self._last
        if last is not None:
            step = (header.frame_number - last.frame_number) & 0xFFFFFFFF
            parts = last.frame_type == FrameType.HEADERS or last.total_chunks > 1 or last.total_slices > 1
            same_stream = header.stream_id == last.stream_id and header.codec == last.codec
            goes_on = same_stream and not last.control & CONTROL_LAST_FRAME
            continuous = continuous and goes_on and (step == 1 or (step == 0 and parts))
        if not header.advertisement:
            self._last = header
            self._clean = True
        return PaveFrame(header, payload, not continuous)

    def _overtaken(self, start: int, end: int) -> bool:
        """Move to a whole header inside the unfinished frame; return whether there is one."""
        at = max(start, self._searched)
        while (at := self._data.find(MAGIC, at, end)) >= 0:
            found = _examine(self._data, at)
            if found is _More.NEEDED:
                self._searched = at
                return False
            if found is not None:
                self._move(at)
                return True
            at += 1
        self._searched = max(start, end - len(MAGIC) + 1)
        return False

    def _resync(self, start: int) -> bool:
        """Go to the next header at or after `start`; if there is none, keep the bytes that may begin one."""
        at = start
        while (at := self._data.find(MAGIC, at)) >= 0:
            found = _examine(self._data, at)
            if found is not None:
                self._move(at)
                return found is not _More.NEEDED
            at += 1
        keep = next((n for n in range(len(MAGIC) - 1, 0, -1) if self._data.endswith(MAGIC[:n])), 0)
        self._move(max(start, len(self._data) - keep))
        return False

    def _move(self, at: int) -> None:
        self._clean = False
        self._at = self._floor = self._searched = at


def unit_decoder() -> AccessUnitDecoder:
    """Return a new decoder. Nothing needs one before the first frame, so `VideoDecoder` makes it when a video begins."""
    return AccessUnitDecoder("the video of an AR.Drone", MAX_PIXELS, err_detect="explode")


@dataclass(frozen=True, slots=True, eq=False)
class DecodedImage:
    """A decoded frame and the index of its unit in the batch."""

    index: int
    px: NDArray[np.uint8]
    """The pixels, (H, W, 3) BGR."""


class VideoDecoder:
    """Takes access units and returns the newest frame."""

    def __init__(self) -> None:
        self._codec: AccessUnitDecoder | None = None

    def newest(self, batch: Sequence[PaveFrame]) -> DecodedImage | None:
        """Decode a batch in order and convert only its newest frame; units before the batch's last IDR are not even decoded."""
        start = max((i for i, f in enumerate(batch) if _entry(f)), default=0)
        seen: tuple[int, VideoFrame] | None = None
        for index in range(start, len(batch)):
            image = self._decode(batch[index])
            if image is not None:
                seen = index, image
        if seen is None:
            return None
        return DecodedImage(seen[0], np.asarray(seen[1].to_ndarray(format="bgr24"), dtype=np.uint8))

    def _decode(self, unit: PaveFrame) -> VideoFrame | None:
        header = unit.header
        if header.advertisement or not unit.payload:
            return None
        if unit.discontinuity or not _is_whole(header):
            self._codec = None
        if self._codec is None:
            if not _entry(unit):
                return None
            self._codec = unit_decoder()
        images = self._codec.decode(unit.payload)
        image = whole(images, (header.display_width, header.display_height))
        if image is None and (images or header.frame_type != FrameType.HEADERS):
            self._codec = None
        return image


def _is_whole(header: PaveHeader) -> bool:
    """Return whether a unit is H.264 and not a part of a frame."""
    return header.codec == CODEC_H264 and header.total_chunks <= 1 and header.total_slices <= 1


def _entry(unit: PaveFrame) -> bool:
    header = unit.header
    return header.frame_type == FrameType.IDR and _is_whole(header) and not header.advertisement and bool(unit.payload)
