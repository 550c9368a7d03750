"""Read the bytes of a live stream as they come, with the instant of each read, and cut them into JPEGs."""

from __future__ import annotations

import os
import re
import select
from collections.abc import Iterator
from typing import TypeAlias

import av
from av.container import InputContainer
from av.packet import Packet as AnyPacket
from av.stream import Stream
from msgspec import Struct

from drivers.camera.source import CameraLost
from drivers.camera.videos import (
    MOST_PACKET_BYTES,
)  # fmt: skip
from estimator.contracts.time import Clock, MonoNs, seconds_between

_AT_ONCE = 1 << 16  # bytes that are read at once
_HEAD_MOST = 1024
"""The bytes that may precede a stream's first JPEG: the head of its part."""
_WAITED_S = 0.001  # a read that took longer than this found the buffer empty, and waited
_SOI = b"\xff\xd8\xff"
_MARK = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]", re.DOTALL)
"""A mark that ends coded data: neither a stuffed byte nor a restart."""
_ALONE = frozenset({0x01, *range(0xD0, 0xD8)})
_Pieces: TypeAlias = "Iterator[AnyPacket[Stream]]"


class Arrival(Struct, frozen=True):
    """The instant of a read, and the longest time that its bytes may have lain in the buffer."""

    received_at: MonoNs
    buffered_s: float
    waited: bool
    """True if the reader waited for the bytes."""


class ArrivalClock:
    """Separates bytes that came while the reader waited from those that lay in the buffer."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._emptied_at = clock.now()

    def now(self, asked_at: MonoNs) -> Arrival:
        """Return the arrival of what a read that began at `asked_at` has just returned."""
        now = self._clock.now()
        if waited := seconds_between(asked_at, now) > _WAITED_S:
            self._emptied_at = now
        return Arrival(now, seconds_between(self._emptied_at, now), waited)


class LiveBytes:
    """The bytes of an address (http, https, tcp) or of a named pipe.

    Args:
        silence_s: the time after which a stream without bytes counts as lost.

    Raises:
        FFmpegError, OSError: the address or the pipe cannot be opened.
    """

    def __init__(self, device: str, silence_s: float) -> None:
        self._device, self._silence_s = device, silence_s
        self._pipe: int | None = None
        self._container: InputContainer | None = None
        self._pieces: _Pieces = iter(())
        self._again = b""
        if "://" not in device:
            self._pipe = os.open(device, os.O_RDONLY | os.O_NONBLOCK)
            return
        self._container = av.open(
            device, format="data", options={"raw_packet_size": str(_AT_ONCE)}, timeout=(silence_s, silence_s)
        )
        self._pieces = self._container.demux(self._container.streams[0])

    def next(self) -> bytes:
        """Return the bytes that came since the last call, at least one; none at the end.

        Raises:
            CameraLost: nothing comes.
            FFmpegError: the connection failed.
        """
        if self._again:
            piece, self._again = self._again, b""
            return piece
        if self._pipe is not None:
            if not select.select([self._pipe], [], [], self._silence_s)[0]:
                raise CameraLost("silent", f"{self._device}: nothing was written for {self._silence_s:g} s")
            return os.read(self._pipe, _AT_ONCE)
        return next((bytes(piece) for piece in self._pieces if piece.size), b"")

    def read(self, most: int) -> bytes:
        """Return at most so many bytes; none at the end. FFmpeg calls this."""
        piece = self.next()
        self._again = piece[most:] + self._again
        return piece[:most]

    def holds_jpegs(self) -> bool:
        """Return whether a JPEG begins after at most a head of text; all bytes are given out again."""
        head = b""
        while (begin := head.find(_SOI)) < 0 and len(head) < _HEAD_MOST and (piece := self.next()):
            head += piece
            if not _is_text(head[:_HEAD_MOST].partition(b"\xff")[0]):
                break
        self._again = head + self._again
        return 0 <= begin <= _HEAD_MOST and _is_text(head[:begin])

    def close(self) -> None:
        """Close the connection or the pipe."""
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None
        if self._container is not None:
            self._container.close()


def _is_text(head: bytes) -> bool:
    return all(32 <= letter < 127 or letter in b"\t\r\n" for letter in head)


class JpegSplitter:
    """Cuts bytes into JPEGs, each complete with its end mark; what lies between them is left out."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._at = 0
        self._coded = False
        """True if `_at` is in coded data, which the next mark ends."""
        self._began: Arrival | None = None
        self._before: Arrival | None = None

    def jpegs(self, piece: bytes, arrival: Arrival) -> Iterator[tuple[bytes, Arrival]]:
        """Yield each JPEG that ends with these bytes, and the arrival of its first byte.

        One that has no end mark ends where the next begins, and its decoder refuses it.
        """
        old = len(self._data)
        self._data += piece
        while True:
            if self._began is None:
                begin = self._data.find(_SOI)
                if begin < 0:
                    del self._data[: max(0, len(self._data) - len(_SOI) + 1)]
                    self._before = arrival
                    return
                self._began = self._before if begin < old and self._before is not None else arrival
                del self._data[:begin]
                self._at, self._coded, old = 2, False, 0
            if (end := self._end()) is None:
                if len(self._data) > MOST_PACKET_BYTES:
                    self._data.clear()
                    self._began = None
                return
            began, self._began, self._before = self._began, None, arrival
            jpeg = bytes(self._data[:end])
            del self._data[:end]
            yield jpeg, began

    def _end(self) -> int | None:
        data = self._data
        while self._at + 2 <= len(data):
            if self._coded or data[self._at] != 0xFF:
                found = _MARK.search(data, self._at)
                if found is None:
                    self._at = len(data) - 1
                    return None
                self._at, self._coded = found.start(), False
            mark = data[self._at + 1]
            if mark == 0xD9:
                return self._at + 2
            if mark == 0xD8:
                return self._at
            if mark == 0xFF:
                self._at += 1
            elif mark in _ALONE:
                self._at += 2
            elif self._at + 4 > len(data):
                return None
            else:
                self._coded = mark == 0xDA
                self._at += 2 + int.from_bytes(data[self._at + 2 : self._at + 4], "big")
        return None
