"""Several MAVLink links at once: received messages share one queue; a message is sent to all links, to one, or to one peer.

Each link is kept open alone, with back-off; each peer of a link has its own codec, hence its own sequence numbers. `access`
decides which senders are peers: unknown senders share one codec, and nothing is sent to them.

Handlers refuse a senseless message by value. An exception that still escapes a handler is a bug of this program: `Containment`
counts it and logs it once with its traceback, and the next message is handled as usual.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, TypeVar

from msgspec import Struct, structs

from drivers.endpoint import Address, Endpoint
from drivers.mailbox import Line
from drivers.mavlink.access import Access, AccessLevel, NamedSenders, Source
from drivers.mavlink.codec import Codec, CodecCounters, Unfit
from drivers.mavlink.dialect import Message
from drivers.mavlink.options import LinkLimits
from drivers.mavlink.signing import Signing
from drivers.reconnect import BackOff, reconnect, running_beside
from drivers.wires import SILENT_S, Datagrams, Wire, WireCounts, open_wire
from estimator.contracts.errors import Recoverable, in_words
from estimator.contracts.time import Clock, MonoNs, seconds_between

_log = logging.getLogger(__name__)
_Result = TypeVar("_Result")
_NEWEST_ONLY = frozenset({"SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET", "LANDING_TARGET"})
"""Messages whose newest alone is worth sending over a line that is slow."""
_ECHO_S = 10.0  # time for which a message of ours is recognized when it comes back
_PLACES_MAX = 256  # places of errors, and addresses of senders, that are counted apart
_QUIET_S = 10.0  # shortest time between two log lines about one place
_RECEIVED_MOST = 4096
"""Messages that may wait for the reader of `Links.received` before the oldest are dropped."""


class Containment:
    """Run handlers and contain the exceptions that escape them.

    Args:
        clock: source of the time, which limits how often an error is logged.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._logged: dict[str, MonoNs] = {}
        self.faults: Counter[str] = Counter()
        """Number of errors that escaped a handler, by place."""

    @property
    def total(self) -> int:
        """Number of errors that were contained."""
        return sum(self.faults.values())

    def run(self, place: str, source: str, handler: Callable[[], _Result]) -> _Result | None:
        """Return the handler's result, or None if it raised an exception.

        Args:
            place: what is being done, with the name of the message; errors are counted under it.
            source: sender of the message, for the log.
            handler: the function to run.
        """
        try:
            return handler()
        except Exception as why:
            self.hold(place, source, why)
            return None

    def hold(self, place: str, source: str, why: Exception) -> None:
        """Count an error that escaped a handler, and log it; its arguments are those of `run`."""
        if place not in self.faults and len(self.faults) >= _PLACES_MAX:
            place = "others"
        self.faults[place] += 1
        now, last = self._clock.now(), self._logged.get(place)
        if last is None:
            _log.error("a bug in %s (from %s); the service goes on without this message", place, source, exc_info=why)
        elif seconds_between(last, now) >= _QUIET_S:
            _log.error(
                "a bug in %s (from %s), %d times so far: %s: %s", place, source, self.faults[place], type(why).__name__, why
            )
        else:
            return
        self._logged[place] = now


@dataclass(frozen=True, slots=True)
class LinkOptions:
    """One link: its address, the key that it is signed with, and its limits."""

    endpoint: Endpoint
    signing: Signing | None = None
    limits: LinkLimits = field(default_factory=LinkLimits)


_TEXT = bytes((*b"\t\n\r\x1b", *range(32, 127)))


@dataclass(slots=True)
class LinkCounters:
    """The counters of one link, over all its peers and reconnections."""

    bytes_in: int = 0
    bytes_out: int = 0
    dropped: int = 0
    """Messages not sent because the wire was full or closed, or the link had no peer."""
    unknown_senders: int = 0
    """Messages of senders that were not accepted, and were not later: an autopilot sends before its first HEARTBEAT."""
    restarts: int = 0
    text: int = 0
    """Bytes that may be of a text: nearly all are, where a console is at the other end."""
    echoed: int = 0
    """Messages of ours that came back."""
    wire: WireCounts = field(default_factory=WireCounts)
    codec: CodecCounters = field(default_factory=CodecCounters)

    def as_dict(self) -> dict[str, int]:
        """Flat, for records and telemetry."""
        own = {
            name: getattr(self, name) for name in ("bytes_in", "bytes_out", "dropped", "restarts", "unknown_senders", "echoed")
        }
        of_codec = ("messages", "lost", "unknown", "damaged", "old_version", "refused_signature", "refused_time")
        own |= {"late": self.wire.late, "refused_datagrams": self.wire.refused}
        return own | {name: getattr(self.codec, name) for name in of_codec}


class ReceivedMessage(Struct, frozen=True, eq=False):
    """One message and where it came from."""

    message: Message
    link: int
    """Number of the link, in the order given."""
    received_at: MonoNs
    system: int
    component: int
    peer: Address | None = None
    """Address of the sender on a listening socket; None elsewhere."""
    access_level: AccessLevel = AccessLevel.UNKNOWN
    """The rights of its sender."""

    @property
    def source(self) -> Source:
        """The link and the peer it came from."""
        return self.link, self.peer

    @property
    def place(self) -> str:
        """The name under which an error in its handler is counted."""
        return f"the handling of {self.message.get_type()}"

    @property
    def source_text(self) -> str:
        """Its sender as text for the log."""
        peer = "" if self.peer is None else f", {self.peer[0]}:{self.peer[1]}"
        return f"system {self.system}, component {self.component}, link {self.link}{peer}"


@dataclass(slots=True)
class _Peer:
    codec: Codec
    received_at: MonoNs


class Link:
    """One endpoint, its peers and its counters."""

    def __init__(self, number: int, options: LinkOptions, links: Links, clock: Clock) -> None:
        self.endpoint = options.endpoint
        self.counters = LinkCounters()
        self.down: str | None = "not opened yet"
        """Reason why it is not open; None while it is."""
        self.signed = options.signing is not None
        """True if nothing crosses it without a signature."""
        self._asked_for = options.endpoint.scheme != "udpin"
        self._number = number
        self._o = options
        self._links = links
        self._clock = clock
        self._wire: Wire | None = None
        self._peers: dict[Address | None, _Peer] = {}
        self._before: Counter[Address | None] = Counter()
        """Messages of senders that are no peers yet, by address."""
        self._unknown_codec: Codec | None = None

    @property
    def local(self) -> Address | None:
        """The address bound on this side, None for TCP, serial and while closed."""
        return None if self._wire is None else self._wire.local

    @property
    def peers(self) -> int:
        """The number of peers that messages are sent to."""
        return len(self._peers)

    def send(self, message: Message, component: int | None = None, only: Source | None = None) -> bool:
        """Send a message to every peer of this link, or to one; return whether it was sent to any."""
        went = False
        self._forget_silent()
        for address, peer in self._peers.items():
            if only is None or only[1] == address:
                went |= self._transmit(peer.codec, address, message, component)
        self.counters.dropped += not went
        return went

    def _transmit(self, codec: Codec, address: Address | None, message: Message, component: int | None) -> bool:
        """Send a message to one peer; return whether it was sent."""
        if self._wire is None:
            return False
        name, pack = message.get_type(), partial(self._pack, codec, message, component)
        return self._wire.send(pack, address, name if name in _NEWEST_ONLY else "")

    def forward(self, message: Message) -> None:
        """Pass on another sender's message as it is."""
        if self._wire is not None:
            self._wire.send(partial(bytes, message.get_msgbuf()), None)

    def _pack(self, codec: Codec, message: Message, component: int | None) -> bytes:
        """Return the bytes of a message that goes now; empty if a value of it does not fit the wire."""
        try:
            data = codec.pack(message, component)
        except Unfit as why:
            self._links.refuse(why)
            return b""
        self.counters.bytes_out += len(data)
        self._links.note_sent(message)
        self._links.notify_tap(self._clock.now(), self.endpoint, "out", data, message)
        return data

    def admit(self, address: Address | None, received_at: MonoNs) -> None:
        """Send to this peer from now on."""
        if address in self._peers:
            return
        self.counters.unknown_senders -= self._before.pop(address, 0)
        self._forget_silent()
        if len(self._peers) >= self._o.limits.peers_max:
            chosen = self._links.access.autopilot
            others = [a for a in self._peers if chosen is None or (self._number, a) != chosen[0]]
            del self._peers[min(others or self._peers, key=lambda a: self._peers[a].received_at)]
        self._peers[address] = _Peer(self._codec(), received_at)

    def dismiss(self, address: Address | None) -> None:
        """Send nothing more to this peer, unless the link's own address names it."""
        if not self._asked_for:
            self._peers.pop(address, None)

    async def reconnect(self) -> None:
        """Open the link, and open it again whenever it broke. It never returns."""
        first_s, longest_s = self._o.limits.restart_first_s, self._o.limits.restart_most_s
        # A connection that opens and stays silent is no recovery.
        back_off = BackOff(first_s, longest_s, healthy_after_s=max(longest_s, SILENT_S + 2.0 if self._asked_for else 0.0))
        await reconnect(f"MAVLink {self.endpoint}", self._run, back_off, self._clock, self._failed, (Recoverable,))

    def _failed(self, why: BaseException) -> None:
        self.down = in_words(why)
        self.counters.restarts += 1

    def identify(self, system: int, component: int) -> None:
        for peer in self._peers.values():
            peer.codec.identify(system, component)

    async def _run(self) -> None:
        waits = self._links.waits
        async with open_wire(self._o.endpoint, self._clock, self._received, self.counters.wire, waits=waits) as wire:
            self._wire, self.down = wire, None
            if self._asked_for:
                peer = self._peers.setdefault(None, _Peer(self._codec(), self._clock.now()))
                peer.codec.restart()
            self._links.opened[self._number] += 1
            try:
                await wire.broken()
            finally:
                self._wire = None

    def _codec(self) -> Codec:
        datagrams = self._o.endpoint.scheme in ("udpin", "udpout")
        return Codec(*self._links.identity, datagrams=datagrams, signing=self._o.signing, counters=self.counters.codec)

    def _received(self, data: bytes, received_at: MonoNs, address: Address | None) -> None:
        self.counters.bytes_in += len(data)
        self.counters.text += len(data) - len(data.translate(None, _TEXT))
        peer = self._peers.get(address)
        if peer is not None:
            peer.received_at = received_at
        try:
            for message in self._codec_for(peer).feed(data):
                self._hand_on(message, received_at, address)
        except Exception as why:
            self._links.contained.hold("the MAVLink codec", f"{self.endpoint}", why)

    def _codec_for(self, peer: _Peer | None) -> Codec:
        """Return the peer's codec; unknown_senders share one, whose datagrams have nothing to do with each other."""
        if peer is not None:
            return peer.codec
        if self._unknown_codec is None:
            self._unknown_codec = self._codec()
        self._unknown_codec.restart()
        return self._unknown_codec

    def _hand_on(self, message: Message, received_at: MonoNs, address: Address | None) -> None:
        ids = (message.get_srcSystem(), message.get_srcComponent())
        source = (self._number, address)
        access, line = self._links.access, self._links.received
        if ids[0] == 0:
            access.refused["no system id"] += 1
            return
        level = access.level(source, ids, received_at, asked_for=self._asked_for, signed=self.signed)
        received = ReceivedMessage(message, self._number, received_at, *ids, address, level)
        self.counters.echoed += ids == self._links.identity and self._links.sent_by_us(received)
        if level is AccessLevel.UNKNOWN and self._links.follows(received):
            level = access.level(source, ids, received_at, asked_for=self._asked_for, signed=self.signed)
            received = structs.replace(received, access_level=level)
        if level is AccessLevel.UNKNOWN:
            self.counters.unknown_senders += 1
            if address in self._before or len(self._before) < _PLACES_MAX:
                self._before[address] += 1
            access.refuse_unknown(ids, address, received_at)
            # A flood from unknown senders may fill half of the queue, and never pushes out messages of known ones.
            if message.get_type() == "HEARTBEAT" and 2 * len(line) < line.capacity:
                line.offer(received)
            return
        if level >= AccessLevel.PEER and address not in self._peers:
            self.admit(address, received_at)
        self._links.notify_tap(received_at, self.endpoint, "in", message.get_msgbuf(), message)
        line.offer(received)

    def _forget_silent(self) -> None:
        if not self._asked_for:
            now = self._clock.now()
            silent_s = self._o.limits.peer_timeout_s
            for address in [a for a, p in self._peers.items() if seconds_between(p.received_at, now) > silent_s]:
                del self._peers[address]


_SECRET = frozenset({"SETUP_SIGNING"})
"""Messages that carry a key in clear: no tap, and so no recording, sees them."""

Tap = Callable[[MonoNs, str, Literal["in", "out"], bytes, str], None]
"""Called with every message that crosses a link: when, the link's address, which way, its bytes, its name. It must be quick."""


class Links:
    """All links. See `open_links`.

    Args:
        made_of: class of each link; another one than `Link` carries messages in a simulation.
    """

    def __init__(
        self,
        options: Sequence[LinkOptions],
        clock: Clock,
        identity: tuple[int, int],
        access: NamedSenders | None = None,
        *,
        waits: bool = False,
        made_of: type[Link] = Link,
    ) -> None:
        self.waits = waits
        """True if datagrams wait in their sockets for a reader that takes them often."""
        self.access = Access(access or NamedSenders())
        self._clock = clock
        self._sent: dict[tuple[int, int], MonoNs] = {}
        """Time when a message of each number and sequence number was last sent."""
        self.identity = identity
        """(system, component) that messages are sent as."""
        self.tap: Tap | None = None
        self.follows: Callable[[ReceivedMessage], bool] = lambda received: False
        """Binds the autopilot to the sender of a message with its ids, and returns True, where it goes on from there."""
        self.contained = Containment(clock)
        """Holds the errors of whoever handles what came in."""
        self.unfit: Counter[str] = Counter()
        """Messages of ours that were not sent since a value does not fit the wire, by "MESSAGE.field"."""
        self.received: Line[ReceivedMessage] = Line(_RECEIVED_MOST)
        self.opened = [0 for _ in options]
        """Number of times that each link was opened; it grows when the link comes back."""
        self.all = tuple(made_of(number, one, self, clock) for number, one in enumerate(options))

    def notify_tap(
        self, at: MonoNs, endpoint: Endpoint, way: Literal["in", "out"], data: bytes | bytearray, message: Message
    ) -> None:
        """Hand a message that crossed a link to the tap; none that carries a key."""
        if self.tap is None:
            return
        name = message.get_type()
        if name not in _SECRET:
            try:
                self.tap(at, str(endpoint), way, bytes(data), name)
            except Exception as why:
                self.contained.hold(f"the tap of {name}", str(endpoint), why)

    def refuse(self, why: Unfit) -> None:
        """Count a message of ours that does not fit the wire, and log each field once."""
        if why.field not in self.unfit:
            _log.error("MAVLink: not sent: %s", why)
        self.unfit[why.field] += 1

    def note_sent(self, message: Message) -> None:
        """Note a message that goes, so that it is known when a router sends it back."""
        self._sent[message.get_msgId(), message.get_seq()] = self._clock.now()

    def sent_by_us(self, received: ReceivedMessage) -> bool:
        """Return whether a message with our own ids is one that was sent here lately and came back."""
        at = self._sent.get((received.message.get_msgId(), received.message.get_seq()))
        return at is not None and seconds_between(at, received.received_at) < _ECHO_S

    def waiting(self) -> list[ReceivedMessage]:
        """Take all messages that wait, those in the sockets included."""
        for link in self.all:
            if isinstance(link._wire, Datagrams):
                link._wire.take()
        return self.received.waiting()

    def identify(self, system: int, component: int) -> None:
        """Send as another system and component from now on."""
        self.identity = (system, component)
        for link in self.all:
            link.identify(system, component)

    def send(self, message: Message, to: int | Source | None = None, *, component: int | None = None) -> bool:
        """Send a message to every peer of every link, of link `to`, or to the peer `to`; return whether it was sent to any.

        It never blocks, and no value in the message makes it raise.

        Args:
            component: send as this component of our system instead of the usual one.
        """
        if isinstance(to, tuple):
            return self.all[to[0]].send(message, component, to)
        sent = [link.send(message, component) for link in (self.all if to is None else (self.all[to],))]
        return any(sent)

    def bind_autopilot(self, received: ReceivedMessage) -> None:
        """Hold the autopilot to the peer that this message came from; what comes over it may command from now on."""
        before = self.access.autopilot
        self.access.autopilot = (received.source, (received.system, received.component))
        if before is not None and before[0] != received.source:
            self.all[before[0][0]].dismiss(before[0][1])
        self.all[received.link].admit(received.peer, received.received_at)


@asynccontextmanager
async def open_links(
    options: Sequence[LinkOptions],
    clock: Clock,
    identity: tuple[int, int],
    access: NamedSenders | None = None,
    *,
    waits: bool = False,
) -> AsyncIterator[Links]:
    """Open every link and keep it open; it does not wait for a peer. On leaving all are closed.

    Args:
        identity: (system, component) to send as; `Links.identify` changes it.
        access: who is known before anything is received; None for no sender.
        waits: let datagrams wait until `Links.waiting`; otherwise they are processed when they arrive.
    """
    async with kept_open(Links(options, clock, identity, access, waits=waits), options) as links:
        yield links


@asynccontextmanager
async def kept_open(links: Links, options: Sequence[LinkOptions]) -> AsyncIterator[Links]:
    """Open links that were made of these options, and keep them open; see `open_links`."""
    async with running_beside([(f"mavlink-{link.endpoint}", link.reconnect()) for link in links.all]):
        try:
            yield links
        finally:
            links.received.fail(Recoverable("the MAVLink links are closed"))
            for times in {id(one.signing.times): one.signing.times for one in options if one.signing is not None}.values():
                times.close()
