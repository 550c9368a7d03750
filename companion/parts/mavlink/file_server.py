"""Serve a few files by MAVLink FTP, read-only and slowly, so that no transfer delays the messages about the pad. No I/O.

    server = FileServer(files)
    server.on_message(received, us)                      # queues the request
    for message, source in server.due(now): ...          # at most one packet each `PERIOD_S` for all senders together

Each client has one session, number 0: MAVSDK's client knows no other, and a repeated request gets the first one's answer.

Source: mavlink.io, "File Transfer Protocol (FTP)".
"""

import struct
import zlib
from collections import Counter, deque
from collections.abc import Callable, Mapping
from enum import IntEnum

from msgspec import Struct, structs

from drivers.mavlink.access import AccessLevel, Source
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from estimator.contracts.time import MonoNs, after

FILE_REQUEST = "FILE_TRANSFER_PROTOCOL"
PERIOD_S = 0.1
"""The shortest time between two packets: at most 2.8 kB/s, half of what a telemetry radio of 57600 baud carries."""
_HEADER = struct.Struct("<HBBBBBBI")
"""Sequence number, session, opcode, size, opcode of the request, end of a burst, padding, offset."""
DATA_MAX = 239
"""The bytes of a packet."""
BURST = 8
"""The packets of a burst: a client that sends nothing for 3.7 s gives up (pymavlink's)."""
WAITING_EACH = 6
"""The requests of one sender that may wait."""
_SENDERS_MAX = 8  # senders whose sessions are kept
_ACK = 128  # opcode of an answer
_NAK = 129  # opcode of a refusal


class Opcode(IntEnum):
    """The requests that are served."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CALC_FILE_CRC32 = 14
    BURST_READ_FILE = 15


class FtpError(IntEnum):
    """The reasons of a refusal."""

    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    EOF = 6
    UNKNOWN_COMMAND = 7
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


_WRITING = range(6, 14)
"""The opcodes that create, write, rename or remove."""
Sender = tuple[Source, int, int]
"""The link and peer of a client, its system and its component."""


class _Request(Struct, frozen=True):
    sender: Sender
    sequence: int
    session: int
    opcode: int
    offset: int
    size: int
    data: bytes
    sent: int = 0
    """The packets of this burst that were sent."""


class _Refused(Exception):
    """A request that is answered by a NAK with this `FtpError`."""


def crc32(data: bytes) -> int:
    """Return the checksum of MAVLink FTP: CRC-32 that begins at 0 and is not inverted at its end."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


class FileServer:
    """The server; see the module's docstring.

    Args:
        files: the bytes of each file by its name in the only directory.
    """

    def __init__(self, files: Mapping[str, bytes]) -> None:
        self._files = files
        self._open: dict[Sender, bytes] = {}
        """The bytes of the file that each client has open."""
        self._waiting: deque[_Request] = deque()
        self._next: MonoNs | None = None
        self.refused: Counter[str] = Counter()
        """The numbers of refused requests, by the name of the reason."""
        self._actions: dict[int, Callable[[_Request], bytes]] = {
            Opcode.NONE: lambda r: b"",
            Opcode.TERMINATE_SESSION: self._terminate,
            Opcode.RESET_SESSIONS: self._reset,
            Opcode.LIST_DIRECTORY: self._list,
            Opcode.OPEN_FILE_RO: self._start,
            Opcode.READ_FILE: self._read,
            Opcode.CALC_FILE_CRC32: lambda r: struct.pack("<I", crc32(self._files[self._named(r)])),
            Opcode.BURST_READ_FILE: self._read,
        }

    def on_message(self, received: ReceivedMessage, us: tuple[int, int]) -> None:
        """Queue a request to us (system, component) of a receiver of telemetry, and ignore every other message.

        A request to all components (pymavlink's command line) is the autopilot's. An answer of another server is ignored too,
        or two servers would answer each other for ever.
        """
        m = received.message
        targets = (0, us[1]) if us[1] == mav.MAV_COMP_ID_AUTOPILOT1 else (us[1],)
        if received.access_level < AccessLevel.PEER or m.target_system != us[0] or m.target_component not in targets:
            return
        payload, sender = bytes(m.payload), (received.source, received.system, received.component)
        sequence, session, opcode, size, _, _, _, offset = _HEADER.unpack_from(payload)
        if opcode >= _ACK:
            return
        if opcode in (Opcode.BURST_READ_FILE, Opcode.RESET_SESSIONS, Opcode.TERMINATE_SESSION):
            self._waiting = deque(r for r in self._waiting if (r.sender, r.opcode) != (sender, Opcode.BURST_READ_FILE))
        if sum(one.sender == sender for one in self._waiting) >= WAITING_EACH or len(self._waiting) >= 4 * WAITING_EACH:
            self.refused["TOO_MANY"] += 1
            return
        self._waiting.append(_Request(sender, sequence, session, opcode, offset, size, payload[_HEADER.size :]))

    def due(self, now: MonoNs) -> list[tuple[Message, Source]]:
        """Return the packet that may be sent now, if any, and its receiver; the clients take turns."""
        if not self._waiting or (self._next is not None and now < self._next):
            return []
        self._next = after(now, PERIOD_S)
        request = self._waiting.popleft()
        source, system, component = request.sender
        payload = list(self._answer(request).ljust(_HEADER.size + DATA_MAX, b"\0"))
        return [(mav.MAVLink_file_transfer_protocol_message(0, system, component, payload), source)]

    def _answer(self, r: _Request) -> bytes:
        opcode, session, last = _ACK, r.session, 0
        try:
            if r.size > DATA_MAX:
                raise _Refused(FtpError.INVALID_DATA_SIZE)
            if r.opcode not in self._actions:
                raise _Refused(FtpError.FILE_PROTECTED if r.opcode in _WRITING else FtpError.UNKNOWN_COMMAND)
            data = self._actions[r.opcode](r)
        except _Refused as why:
            self.refused[why.args[0].name] += 1
            opcode, data = _NAK, bytes(why.args)
        if opcode == _ACK and r.opcode == Opcode.OPEN_FILE_RO:
            session = 0
        if opcode == _ACK and r.opcode == Opcode.BURST_READ_FILE:
            end = r.offset + len(data)
            last = int(end == len(self._open[r.sender]) or r.sent + 1 == BURST)
            if not last:
                self._waiting.append(structs.replace(r, sequence=r.sequence + 1, offset=end, sent=r.sent + 1))
        return _HEADER.pack(r.sequence + 1 & 0xFFFF, session, opcode, len(data), r.opcode, last, 0, r.offset) + data

    def _named(self, r: _Request) -> str:
        """Return the name of the file that a request names; clients put no, one or several slashes before it."""
        name = r.data[: r.size].partition(b"\0")[0].lstrip(b"/").decode("ascii", errors="replace")
        if name not in self._files:
            raise _Refused(FtpError.FILE_NOT_FOUND)
        return name

    def _start(self, r: _Request) -> bytes:
        data = self._files[self._named(r)]
        if r.sender not in self._open and len(self._open) >= _SENDERS_MAX:
            del self._open[next(iter(self._open))]
        self._open[r.sender] = data
        return struct.pack("<I", len(data))

    def _opened(self, r: _Request) -> bytes:
        if r.session != 0 or r.sender not in self._open:
            raise _Refused(FtpError.INVALID_SESSION)
        return self._open[r.sender]

    def _read(self, r: _Request) -> bytes:
        data = self._opened(r)[r.offset : r.offset + (r.size or DATA_MAX)]
        if not data:
            raise _Refused(FtpError.EOF)
        return data

    def _terminate(self, r: _Request) -> bytes:
        self._opened(r)
        return self._reset(r)

    def _reset(self, r: _Request) -> bytes:
        self._open.pop(r.sender, None)
        return b""

    def _list(self, r: _Request) -> bytes:
        if r.data[: r.size].partition(b"\0")[0].strip(b"/.") != b"":
            raise _Refused(FtpError.FILE_NOT_FOUND)
        entries = b""
        for name in [*self._files][r.offset :]:
            entry = f"F{name}\t{len(self._files[name])}\0".encode()
            if len(entries) + len(entry) > DATA_MAX:
                break
            entries += entry
        if not entries:
            raise _Refused(FtpError.EOF)
        return entries
