"""Bytes to messages and back, for one stream. No I/O; nothing on the wire raises.

Framing is done here instead of by pymavlink's parser: after a damaged frame that one skips as many bytes as the damaged length
field says, and so loses the intact frames behind it. Here the search goes on with the next byte. Decoding, checksums and
signatures are the dialect's.
"""

import hashlib
import re
import struct
from dataclasses import dataclass

from drivers.mavlink.dialect import Message, mav, unfit_field
from drivers.mavlink.signing import TICKS_PER_S, Signing

_V1, _V2 = mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2
_MARKER = re.compile(rb"[\xfd\xfe]")
_SIGNED = mav.MAVLINK_IFLAG_SIGNED
_SIGNATURE = mav.MAVLINK_SIGNATURE_BLOCK_LEN
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
    with_signature: int = 0
    """Decoded messages that carry a signature, which is checked only if a key is set."""
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
            self._mav.signing.secret_key = signing.key().secret
            self._mav.signing.link_id = signing.link_id
            self._mav.signing.sign_outgoing = True
            self._mav.signing.stream_timestamps = signing.times.streams
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
        if frame[0] == _V2 and frame[2] & ~_SIGNED:
            self.counters.damaged += 1
            return False, None
        signing = self._mav.signing
        if self._signing is not None:
            signing.timestamp = self._signing.times.now
        stream, newest = self._stream_time(frame)
        refused_before = signing.badsig_count + signing.reject_count
        try:
            message = self._mav.decode(frame)
        except mav.MAVError as why:
            if stream is not None and signing.secret_key is not None:
                # A forged time must not shut the true sender out: the dialect notes it before it checks the signature.
                if newest is None:
                    signing.stream_timestamps.pop(stream, None)
                else:
                    signing.stream_timestamps[stream] = newest
            if signing.badsig_count + signing.reject_count > refused_before or "signature" in str(why).lower():
                self.counters.refused_signature += 1
                self._note_refused(frame)
                self.counters.old_version += frame[0] == _V1
                return True, None
            self.counters.damaged += 1
            return False, None
        if message.get_type().startswith("UNKNOWN_"):
            # Its checksum cannot be verified, so it is accepted only if another frame, or nothing, follows.
            if not ends_well:
                self.counters.damaged += 1
                return False, None
            self.counters.unknown += 1
            return True, None
        if self._signing is not None:
            self._signing.times.note_received(signing.timestamp)
            self._signing.times.bound()
        self._count(message, frame)
        return True, message

    def _note_refused(self, frame: bytearray) -> None:
        """Take the key's file's new key where it is the message's; of one with the right signature count that its time is not."""
        if self._signing is None or frame[0] != _V2 or not frame[2] & _SIGNED:
            return
        secret = self._signing.key().secret
        if hashlib.sha256(secret + frame[:-6]).digest()[:6] != frame[-6:]:
            return
        if secret != self._mav.signing.secret_key:
            self._mav.signing.secret_key = secret
            return
        self.counters.refused_time += 1
        self.counters.behind_s = (self._signing.times.now - int.from_bytes(frame[-12:-6], "little")) / TICKS_PER_S

    def _count(self, message: Message, frame: bytearray) -> None:
        self.counters.messages += 1
        self.counters.old_version += frame[0] == _V1
        self.counters.with_signature += frame[0] == _V2 and bool(frame[2] & _SIGNED)
        source = (message.get_srcSystem(), message.get_srcComponent())
        sequence = message.get_seq()
        last = self._sequences.get(source)
        if last is not None:
            gap = (sequence - last - 1) % 256
            # A repeat or an older one is no loss of 250 messages.
            self.counters.lost += gap if gap < 200 else 0
        elif len(self._sequences) >= _SENDERS_MAX:
            self._sequences.clear()
        self._sequences[source] = sequence

    def _stream_time(self, frame: bytearray) -> tuple[tuple[int, int, int] | None, int | None]:
        if frame[0] != _V2 or not frame[2] & _SIGNED:
            return None, None
        stream = (frame[-_SIGNATURE], frame[5], frame[6])
        return stream, self._mav.signing.stream_timestamps.get(stream)


def _frame_length(buffer: bytearray, start: int) -> int | None:
    """Return the header's length of the frame at `start`, bytes; None while the header is not complete."""
    if len(buffer) - start < 3:
        return None
    if buffer[start] == _V1:
        return 6 + buffer[start + 1] + 2
    return 10 + buffer[start + 1] + 2 + (_SIGNATURE if buffer[start + 2] & _SIGNED else 0)
