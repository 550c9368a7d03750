"""The way of sentences: by UDP, TCP or a serial port, in whole lines.

By UDP an address counts and not a port: several programs of one computer may send, each line from a port of its own (a shell
loop). Sentences that are cut between datagrams are put together for each port alone, so that programs do not mix.
"""

import ipaddress
import logging
import re
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from drivers.endpoint import Address, Endpoint
from drivers.nmea.motion import EM_SYNC, em3000_records
from drivers.wires import Wire, open_wire
from estimator.contracts.errors import Recoverable, refused
from estimator.contracts.time import Clock, MonoNs, seconds_between

DATAGRAM_MAX = 65_535
"""The largest datagram, bytes."""
LINES_MAX = 800
"""Sentences that are given on at once."""
_log = logging.getLogger(__name__)

HELD_S = 30.0
"""Silence after which another sender is listened to, unless the settings name one."""
_CUT_S = 2.0
"""Age at which the begin of a sentence waits no longer for its end."""
_CUT_MAX = 512
"""Bytes of a sentence without its end; NMEA 0183 allows 82, and a TAG block before them."""
_SENDERS_MAX = 16  # senders whose begun lines are kept
_BEGINS = (b"$", b"!", b"\\", b":")
_TAG = re.compile(rb"\\[^\\]+\\")
_ENDS = re.compile(rb"((\\[^\\]*\\)?[^\\]*\*[0-9A-Fa-f]{2}|:[0-9A-Fa-f]{6}[-\w ]{18})\s*")
"""A sentence that needs no line end behind it: it ends with its checksum, after its TAG block if it has one, or is a TSS1."""


class SentenceJoiner:
    """Returns the whole lines of what arrives in pieces, for each sender alone."""

    def __init__(self) -> None:
        self._begun: dict[Address | None, tuple[MonoNs, bytes]] = {}
        self.cut = 0
        """The number of sentences whose end or begin never came."""

    def lines(self, data: bytes, sender: Address | None, now: MonoNs) -> list[bytes]:
        """Return the lines that are complete now; a whole sentence needs no line end behind it."""
        at, begun = self._begun.pop(sender, (now, b""))
        another = data.startswith((b"$", b"!")) and not _TAG.fullmatch(begun)
        if begun and (another or seconds_between(at, now) > _CUT_S):
            self.cut += 1
            begun = b""
        *lines, rest = (begun + data).replace(b"\r", b"\n").split(b"\n")
        if _ENDS.fullmatch(rest):
            lines.append(rest)
        elif rest:
            self._keep(rest, sender, now)
        whole = [line for line in lines if line.strip()]
        if whole and not begun and not whole[0].startswith(_BEGINS) and _ENDS.fullmatch(whole[0]):
            self.cut += 1  # the end of a sentence whose begin was not received
            del whole[0]
        return whole

    def _keep(self, rest: bytes, sender: Address | None, now: MonoNs) -> None:
        if len(rest) > _CUT_MAX or not rest.startswith(_BEGINS):
            self.cut += 1
            return
        self._begun[sender] = now, rest
        if len(self._begun) > _SENDERS_MAX:
            del self._begun[next(iter(self._begun))]
            self.cut += 1


class SentenceSource:
    """Passes whole lines of the ship's sender on, with the instant at which they arrived.

    Args:
        sender: the address that datagrams must come from; empty for the first that is received.
        received: takes lines, with line feeds between, at most as many as a reader takes at once.
    """

    def __init__(self, sender: str, received: Callable[[bytes, MonoNs], None]) -> None:
        self._sender = sender
        self._received = received
        self._held: tuple[str, MonoNs] | None = None
        self._joiner = SentenceJoiner()
        self._records = b""
        """The begin of a binary record in a stream."""
        self._refused: Counter[str] = Counter()

    @property
    def refused(self) -> Counter[str]:
        """The number of datagrams of other senders or too long, and of sentences that were cut for good."""
        return self._refused + Counter(cut=self._joiner.cut)

    def take(self, data: bytes, now: MonoNs, sender: Address | None) -> None:
        """Take what arrived; `sender` is None where there is only one."""
        if sender is not None and not self._listens_to(sender, now):
            return
        if sender is not None and len(data) > DATAGRAM_MAX:
            self._refused["too_long"] += 1
            return
        begun = self._records if sender is None else b""
        if begun or EM_SYNC in data:
            records, rest = em3000_records(begun + data)
            self._records = rest if sender is None else self._records
            if records:
                self._received(b"".join(records), now)
            if records or (rest and sender is None):
                return
        lines = self._joiner.lines(data, sender, now)
        for first in range(0, len(lines), LINES_MAX):
            self._received(b"\n".join(lines[first : first + LINES_MAX]), now)

    def _listens_to(self, sender: Address, now: MonoNs) -> bool:
        address = _plain(sender[0])
        listened_to = self._sender
        if not listened_to and self._held is not None and seconds_between(self._held[1], now) <= HELD_S:
            listened_to = self._held[0]
        if listened_to and address != _plain(listened_to):
            if not self._refused["wrong_sender"]:
                _log.warning(
                    "sentences from %s are refused, those from %s are taken (vessel.nmea_from chooses); the next ones are "
                    "counted only",
                    address,
                    listened_to,
                )
            self._refused["wrong_sender"] += 1
            return False
        self._held = address, now
        return True


def _plain(address: str) -> str:
    """Return an address in one form: a socket for IPv6 writes those of IPv4 in its own."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return address
    return str(getattr(found, "ipv4_mapped", None) or found)


@asynccontextmanager
async def sentences_from(endpoint: Endpoint, source: SentenceSource, clock: Clock) -> AsyncIterator[Wire]:
    """Open the way by which sentences arrive, and close it on leaving.

    Raises:
        Recoverable: it cannot be opened: the address is not of this computer, another program has it, none listens there, or
            there is no such device.
    """
    with refused(f"vessel.nmea {endpoint}", Recoverable, by=Recoverable):
        async with open_wire(endpoint, clock, source.take) as wire:
            yield wire
