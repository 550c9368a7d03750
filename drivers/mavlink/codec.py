"""Bytes to messages and back, for one stream. No I/O; nothing on the wire raises.

Framing is done here instead of by pymavlink's parser: after a damaged frame that one skips as many bytes as the damaged length
field says, and so loses the intact frames behind it. Here the search goes on with the next byte. The dialect has the layout of
each message and the checksum; its own decoder takes half as long again, hundreds of times a second.
"""

import hashlib
import re
import struct
from dataclasses import dataclass
from typing import Any

from drivers.mavlink.dialect import Message, mav, unfit_field
from drivers.mavlink.signing import TICKS_PER_S, Signing

_V1, _V2 = mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2
_MARKER = re.compile(rb"[\xfd\xfe]")
_SIGNED = mav.MAVLINK_IFLAG_SIGNED
_SIGNATURE = mav.MAVLINK_SIGNATURE_BLOCK_LEN
_NEW_STREAM_TICKS = 60 * TICKS_PER_S
"""Time by which a stream may be behind ours when it begins, as the protocol says."""
_SENDERS_MAX = 64
"""Senders of one stream whose losses are counted; a router in front of more of them starts again."""


class Unfit(ValueError):
    """A message whose value does not fit the wire.

    Attributes:
        field: "MESSAGE.field".
    """

    def __init__(self, message: Message, why: Exception) -> None:
        self.field = f"{message.get_type()}.{unfit_field(message)}"
        super().__init__(f"{self.field} does not fit its wire format: {why}")


@dataclass(slots=True)
class CodecCounters:
    """The counters of one stream, or of several together."""

    messages: int = 0
    """Messages that were decoded."""
    old_version: int = 0
    """Decoded messages of MAVLink 1."""
    lost: int = 0
    """Sequence numbers that never arrived."""
    unknown: int = 0
    """Well-formed messages of a number the dialect does not have."""
    damaged: int = 0
    """Times the search for a frame had to go on with the next byte."""
    refused_signature: int = 0
    """Messages that were unsigned, wrongly signed or out of date although a key is set."""
    refused_time: int = 0
    """Refused messages with our key's signature at a time that is refused: long past, or not later than one before."""
    behind_s: float = 0.0
    """Time by which the newest of those lay behind ours, s."""


class Codec:
    """One stream in each direction: own sequence numbers, own signing state.

    Args:
        datagrams: what is fed ends with a whole message, so that nothing is kept for later.
        counters: those of several streams together; its own by default.
    """

    def __init__(
        self,
        system: int,
        component: int,
        *,
        datagrams: bool = False,
        signing: Signing | None = None,
        counters: CodecCounters | None = None,
    ) -> None:
        self._mav = mav.MAVLink(None, srcSystem=system, srcComponent=component)
        self._datagrams = datagrams
        self._signing = signing
        self._buffer = bytearray()
        self._sequences: dict[tuple[int, int], int] = {}
        self._spoken: dict[int, int] = {}
        """The next sequence number of each component that messages are sent as."""
        self.counters = counters or CodecCounters()
        if signing is not None:
            self._mav.signing.secret_key = signing.key.secret
            self._mav.signing.link_id = signing.link_id
            self._mav.signing.sign_outgoing = True
            self._mav.signing.timestamp = signing.times.next()

    def restart(self) -> None:
        """Discard a partly received message and restart the sequences, because the stream was interrupted."""
        self._buffer.clear()
        self._sequences.clear()

    def identify(self, system: int, component: int) -> None:
        """Send as another system and component from now on."""
        self._mav.srcSystem, self._mav.srcComponent = system, component

    def pack(self, message: Message, component: int | None = None) -> bytes:
        """Return the message as MAVLink 2 bytes with its sender's next sequence number; signed if a key is set.

        Args:
            component: send as this component of our system; None for the usual one. Each counts its own sequence.

        Raises:
            Unfit: a field does not fit its type on the wire.
        """
        if self._signing is not None:
            self._mav.signing.timestamp = self._signing.times.next()
        usual = self._mav.srcComponent
        speaker = usual if component is None else component
        self._mav.srcComponent, self._mav.seq = speaker, self._spoken.get(speaker, 0)
        try:
            data = bytes(message.pack(self._mav))
        except (struct.error, TypeError, ValueError, OverflowError, AttributeError, IndexError) as why:
            raise Unfit(message, why) from why
        finally:
            self._mav.srcComponent = usual
        self._spoken[speaker] = (self._mav.seq + 1) % 256
        return data

    def feed(self, data: bytes) -> list[Message]:
        """Take the next bytes and return the messages that are complete now, in order."""
        self._buffer += data
        out: list[Message] = []
        start = 0
        buffer = self._buffer
        while True:
            found = _MARKER.search(buffer, start)
            begin = len(buffer) if found is None else found.start()
            if begin > start:
                self.counters.damaged += 1
            start = begin
            if start >= len(buffer):
                break
            length = _frame_length(buffer, start)
            if length is None or start + length > len(buffer):
                if not self._datagrams:
                    break
                start += 1
                self.counters.damaged += 1
                continue
            took, message = self._decode(
                buffer[start : start + length], start + length == len(buffer) or buffer[start + length] in (_V1, _V2)
            )
            start += length if took else 1
            if message is not None:
                out.append(message)
        del buffer[: len(buffer) if self._datagrams else start]
        return out

    def _decode(self, frame: bytearray, ends_well: bool) -> tuple[bool, Message | None]:
        """Return whether the bytes were a frame, and the message that it held."""
        if frame[0] == _V1:
            flags, (sequence, system, component, number), begin = 0, frame[2:6], 6
        else:
            flags, (sequence, system, component), number, begin = frame[2], frame[4:7], int.from_bytes(frame[7:10], "little"), 10
        kind, end = mav.mavlink_map.get(number), len(frame) - 2 - (_SIGNATURE if flags else 0)
        # The checksum of an unknown message cannot be verified, so it is accepted only if another frame, or nothing, follows.
        intact = ends_well if kind is None else _checksum(frame[1:end], kind) == int.from_bytes(frame[end : end + 2], "little")
        if flags & ~_SIGNED or not intact:
            self.counters.damaged += 1
            return False, None
        if kind is None:
            self.counters.unknown += 1
            return True, None
        if self._signing is not None and not self._is_admitted(self._signing, frame):
            self.counters.refused_signature += 1
            self.counters.old_version += frame[0] == _V1
            return True, None
        message = kind(*_values(kind, frame[begin:end]))
        message._signed = self._signing is not None
        message._msgbuf, message._crc = frame, int.from_bytes(frame[end : end + 2], "little")
        header = message._header
        header.incompat_flags, header.mlen = flags, frame[1]
        header.seq, header.srcSystem, header.srcComponent = sequence, system, component
        self._count((system, component), sequence, frame[0])
        return True, message

    def _is_admitted(self, signing: Signing, frame: bytearray) -> bool:
        """Return whether a frame has our key's signature and a time that its stream has not passed."""
        times, now = signing.times, signing.times.now
        if frame[0] == _V1 or not frame[2] or hashlib.sha256(signing.key.secret + frame[:-6]).digest()[:6] != frame[-6:]:
            return False
        stream, time = (frame[-_SIGNATURE], frame[5], frame[6]), int.from_bytes(frame[-12:-6], "little")
        if time <= times.streams.get(stream, now - _NEW_STREAM_TICKS - 1):
            self.counters.refused_time += 1
            self.counters.behind_s = (now - time) / TICKS_PER_S
            return False
        times.streams[stream] = time
        times.note_received(max(now, time))
        times.bound()
        return True

    def _count(self, source: tuple[int, int], sequence: int, marker: int) -> None:
        self.counters.messages += 1
        self.counters.old_version += marker == _V1
        last = self._sequences.get(source)
        if last is not None:
            gap = (sequence - last - 1) % 256
            # A repeat or an older one is no loss of 250 messages.
            self.counters.lost += gap if gap < 200 else 0
        elif len(self._sequences) >= _SENDERS_MAX:
            self._sequences.clear()
        self._sequences[source] = sequence


def _checksum(frame: bytearray, kind: Any) -> int:
    """Return the checksum of a frame without its marker; the seed of its message's kind is its last byte."""
    frame.append(kind.crc_extra)
    return int(mav.x25crc(frame).crc)


def _values(kind: Any, payload: bytearray) -> list[Any]:
    """Return the values of a message's fields in the order of its definition; a sender leaves out zeros at the end."""
    flat, lengths = kind.unpacker.unpack_from(payload.ljust(kind.unpacker.size, b"\0")), kind.lengths
    if len(flat) > len(lengths):
        values, at = [], 0
        for length in lengths:
            values.append(flat[at] if length == 1 else list(flat[at : at + length]))
            at += length
        flat = values
    return [value.rstrip(b"\0") if type(value) is bytes else value for value in [flat[i] for i in kind.orders]]


def _frame_length(buffer: bytearray, start: int) -> int | None:
    """Return the header's length of the frame at `start`, bytes; None while the header is not complete."""
    if len(buffer) - start < 3:
        return None
    if buffer[start] == _V1:
        return 6 + buffer[start + 1] + 2
    return 10 + buffer[start + 1] + 2 + (_SIGNATURE if buffer[start + 2] & _SIGNED else 0)
