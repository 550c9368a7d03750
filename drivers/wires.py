"""Open ways for bytes: UDP, TCP and serial ports in the event loop. None of them blocks.

A line that is slow, or stands still, gets what is new: a `SendQueue` is bounded in time. Messages wait in it unpacked, so that
their sequence numbers and signing times are those of the order in which they go. The kernel is given no
more bytes while the oldest of them wait too long, and those for a serial line that stands still are taken back.
Names are looked up on a thread, again for each opening; each of a name's addresses is tried.
"""

import asyncio
import fcntl
import ipaddress
import os
import socket
import struct
import termios
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any, ClassVar, NoReturn

import serial
from msgspec import Struct, field

from drivers.datagrams import WaitingDatagrams
from drivers.device_errors import device_fault
from drivers.endpoint import ONE_PEER, Address, Endpoint
from drivers.reconnect import running_beside
from estimator.contracts.errors import Recoverable
from estimator.contracts.time import Clock, MonoNs, seconds_between

AddressInfo = tuple[Any, Any, int, str, Any]
"""The family, kind, protocol, canonical name and address that `socket.getaddrinfo` returns."""

_asking: dict[tuple[str, int, int], asyncio.Future[list[AddressInfo]]] = {}
"""The look-ups that a thread still makes: one thread each, however many callers wait and however often they retry."""
QUEUE_S = 0.2
"""Age at which a message that waits for its line is dropped: a velocity is flown for 0.25 s."""
_QUEUE_MAX = 512  # messages that wait for a line at most; the oldest is dropped
_SERIAL_S = 0.1  # age of the oldest byte in the kernel's queue of a serial line at which no more is given to it
_TCP_S = 0.5
"""Age of the oldest byte in the kernel's queue of a TCP connection at which no more is given to it: bytes are acknowledged over a
network."""
_STILL_S = 0.3
"""Age of a byte that waits for a serial line at which the line counts as standing still, and the kernel's queue is emptied."""
_PUMP_S = 0.02  # time to the next look at a kernel's queue that takes no more
_CONNECT_TIMEOUT_S = 3.0  # time to resolve a name, and to connect over TCP
SILENT_S = 10.0
"""Silence after which a TCP peer is connected to again, and the name of a UDP peer looked up again: ten heartbeats."""
_REFUSED_S = 2.0
"""Time after which the name of a UDP peer that refuses is looked up again, s."""
_WATCH_S = 0.5  # interval at which a peer's silence is checked


async def resolve(host: str, port: int, timeout_s: float, kind: int = socket.SOCK_STREAM) -> list[AddressInfo]:
    """Return the addresses to connect to, the best first; an address written in numbers needs no look-up.

    Raises:
        Recoverable: there is no such host, or no answer came within `timeout_s`.
    """
    with suppress(ValueError):
        written = ipaddress.ip_address(host)
        if isinstance(written, ipaddress.IPv4Address):
            return [(socket.AF_INET, kind, 0, "", (host, port))]
        if written.scope_id is None:
            return [(socket.AF_INET6, kind, 0, "", (host, port, 0, 0))]
    loop, key = asyncio.get_running_loop(), (host, port, kind)
    found = _asking.get(key)
    if found is None or found.get_loop() is not loop:
        found = _asking[key] = loop.create_future()
        found.add_done_callback(lambda done: done.cancelled() or done.exception())  # no caller may be left to read it
        _ask(key, loop, found)
    try:
        async with asyncio.timeout(timeout_s):
            return await asyncio.shield(found)
    except TimeoutError as why:
        raise Recoverable(f"{host}:{port}: no answer from the resolver within {timeout_s:g} s") from why


def _ask(key: tuple[str, int, int], loop: asyncio.AbstractEventLoop, found: asyncio.Future[list[AddressInfo]]) -> None:
    host, port, kind = key

    def settle(addresses: list[AddressInfo], why: str) -> None:
        if _asking.get(key) is found:
            del _asking[key]
        if found.done():
            return
        if addresses:
            found.set_result(addresses)
        else:
            found.set_exception(Recoverable(f"{host}:{port}: {why or 'no address'}"))

    def ask() -> None:
        addresses: list[AddressInfo] = []
        why = ""
        try:
            addresses = list(socket.getaddrinfo(host, port, type=kind))
        except (OSError, UnicodeError) as error:
            why = device_fault(error, "network") if isinstance(error, OSError) else str(error)
        # The loop may have ended in the meantime.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(settle, addresses, why)

    try:
        threading.Thread(target=ask, name="resolve", daemon=True).start()
    except RuntimeError as why:
        settle([], str(why))


Received = Callable[[bytes, MonoNs, Address | None], None]
"""A function that takes received bytes, the instant of their arrival and, on a listening socket, the sender's address."""
Pack = Callable[[], bytes]
"""A function that returns a message's bytes at the instant at which it goes; empty if it cannot."""


class WireCounts(Struct):
    """Message counts of one endpoint over all its openings, and the addresses that were tried in vain."""

    refused: int = 0
    """Datagrams that the other computer refused, because no program listens there."""
    late: int = 0
    """Messages that were dropped because the line did not take them in time, or because a newer one of their kind came."""
    tried: set[Any] = field(default_factory=set)


class SendQueue:
    """The messages that wait for a line: of each named kind the newest, ahead of the others; none older than `QUEUE_S`."""

    def __init__(self, counts: WireCounts) -> None:
        self._counts = counts
        self._newest: dict[str, tuple[MonoNs, Pack]] = {}
        self._others: deque[tuple[MonoNs, Pack]] = deque()

    def put(self, pack: Pack, newest_of: str, now: MonoNs) -> None:
        if newest_of:
            self._counts.late += self._newest.pop(newest_of, None) is not None
            self._newest[newest_of] = now, pack
            return
        self._others.append((now, pack))
        while len(self._others) > _QUEUE_MAX or seconds_between(self._others[0][0], now) > QUEUE_S:
            self._others.popleft()
            self._counts.late += 1

    def take(self, now: MonoNs) -> bytes:
        """Return the bytes of the message that goes next; empty if none waits."""
        while self._newest or self._others:
            at, pack = self._newest.pop(next(iter(self._newest))) if self._newest else self._others.popleft()
            if seconds_between(at, now) > QUEUE_S:
                self._counts.late += 1
            elif data := pack():
                return data
        return b""


class Wire(ABC):
    """An open connection to its endpoint."""

    def __init__(self, clock: Clock, received: Received, counts: WireCounts) -> None:
        self._end: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._clock, self._received, self._counts = clock, received, counts
        self.received_at: MonoNs | None = None
        self.opened_at = clock.now()

    @property
    def local(self) -> Address | None:
        """Address bound on this side, None where there is none."""
        return None

    @abstractmethod
    def send(self, pack: Pack, to: Address | None, newest_of: str = "") -> bool:
        """Send now, or as soon as the line takes it; return whether it went or waits.

        Args:
            to: the peer, for a socket that listens.
            newest_of: of the messages with this name only the newest waits, ahead of all others; empty for one of the others.
        """

    @property
    def quiet_s(self) -> float:
        """The time without a byte, s."""
        return seconds_between(self.received_at or self.opened_at, self._clock.now())

    def _take(self, data: bytes) -> None:
        self.received_at = self._clock.now()
        self._received(data, self.received_at, None)

    def stop(self, why: str) -> None:
        """Make it count as broken."""
        if not self._end.done():
            self._end.set_result(why)

    async def broken(self) -> NoReturn:
        """Wait until it no longer works.

        Raises:
            Recoverable: always, with the reason.
        """
        raise Recoverable(await asyncio.shield(self._end))


class Datagrams(Wire):
    """A UDP socket; its datagrams are read all at one wake-up of the loop, or wait for `take`."""

    def __init__(
        self, clock: Clock, received: Received, counts: WireCounts, own: socket.socket, listening: bool, waits: bool
    ) -> None:
        super().__init__(clock, received, counts)
        self._own, self._listening, self._loop = own, listening, asyncio.get_running_loop()
        self._waiting = WaitingDatagrams(own, clock, self._datagram, stamped=waits)
        self.refused_at: MonoNs | None = None
        """Time when the other side last refused; None since its last message."""
        if not waits:
            self._loop.add_reader(own, self.take)

    @property
    def local(self) -> Address | None:
        host, port = self._own.getsockname()[:2]
        return str(host), int(port)

    def close(self) -> None:
        self._loop.remove_reader(self._own)
        self._own.close()

    def take(self) -> None:
        """Process what waits in the socket."""
        if self._end.done():
            return
        refused = self._waiting.refused
        self._waiting.take()
        if self._waiting.refused > refused:
            self._refused(self._waiting.refused - refused)
        try:
            self._waiting.check()
        except Exception as why:
            self.stop(str(why))

    def _datagram(self, data: bytes, received_at: MonoNs, sender: tuple[Any, ...]) -> None:
        self.refused_at, self.received_at = None, received_at
        self._received(data, received_at, (sender[0], sender[1]) if self._listening else None)

    def _refused(self, times: int) -> None:
        """Count what a peer that is not there yet refuses; it may come."""
        self._counts.refused += times
        self.refused_at = self._clock.now()

    def send(self, pack: Pack, to: Address | None, newest_of: str = "") -> bool:
        if self._end.done() or (to is None) is self._listening or not (data := pack()):
            return False
        try:
            self._own.send(data) if to is None else self._own.sendto(data, to)
        except BlockingIOError:  # the kernel takes datagrams at once, unless the device has stopped
            self._counts.late += 1
            return False
        except ConnectionRefusedError:
            self._refused(1)
        except OSError as why:
            if not self._listening:
                self.stop(device_fault(why, "network"))
        return True


class _Paced(Wire):
    """A stream that is given no more than it takes in time."""

    _KERNEL_S: ClassVar[float]

    def __init__(self, clock: Clock, received: Received, counts: WireCounts) -> None:
        super().__init__(clock, received, counts)
        self._queue = SendQueue(counts)
        self._written: deque[tuple[MonoNs, int]] = deque()
        """Time when bytes were given to the kernel, and their number with all those before."""
        self._total = 0
        self._timer: asyncio.TimerHandle | None = None

    def send(self, pack: Pack, to: Address | None, newest_of: str = "") -> bool:
        if self._end.done():
            return False
        self._queue.put(pack, newest_of, self._clock.now())
        self._pump()
        return True

    def _pump(self) -> None:
        """Write what waits, until the line takes no more."""
        self._forget_timer()
        while not self._end.done():
            now = self._clock.now()
            if not self._takes_more(now):
                self._timer = asyncio.get_running_loop().call_later(_PUMP_S, self._pump)
                return
            data = self._queue.take(now)
            if not data:
                return
            self._total += len(data)
            self._written.append((now, self._total))
            self._write(data)

    def _takes_more(self, now: MonoNs) -> bool:
        gone = self._total - self._unsent()
        while self._written and self._written[0][1] <= gone:
            self._written.popleft()
        return not self._written or seconds_between(self._written[0][0], now) <= self._KERNEL_S

    def _forget_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    @abstractmethod
    def _write(self, data: bytes) -> None:
        """Give bytes to the kernel."""

    @abstractmethod
    def _unsent(self) -> int:
        """Return the number of bytes that were written and have not left, or were not acknowledged."""


def _in_kernel(fd: int) -> int:
    """Return the bytes in a port's or a connection's own queue; 0 where the system does not say."""
    with suppress(OSError):
        return int(struct.unpack("i", fcntl.ioctl(fd, termios.TIOCOUTQ, bytes(4)))[0])
    return 0


class _Stream(_Paced, asyncio.Protocol):
    _KERNEL_S = _TCP_S

    def __init__(self, clock: Clock, received: Received, counts: WireCounts) -> None:
        super().__init__(clock, received, counts)
        self._transport: asyncio.WriteTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.WriteTransport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._take(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._forget_timer()
        self.stop(str(exc or "the other side closed the connection"))

    def _write(self, data: bytes) -> None:
        assert self._transport is not None
        self._transport.write(data)

    def _unsent(self) -> int:
        assert self._transport is not None
        return self._transport.get_write_buffer_size() + _in_kernel(self._transport.get_extra_info("socket").fileno())


class _Serial(_Paced):
    """A serial port's file descriptor, read and written when the loop says that it is ready."""

    _KERNEL_S = _SERIAL_S

    def __init__(self, port: serial.Serial, clock: Clock, received: Received, counts: WireCounts) -> None:
        super().__init__(clock, received, counts)
        self._fd: int = port.fileno()
        os.set_blocking(self._fd, False)
        self._loop = asyncio.get_running_loop()
        self._rest = bytearray()
        """The bytes that the kernel did not take yet of the message that goes."""
        self._loop.add_reader(self._fd, self._readable)

    def close(self) -> None:
        self._forget_timer()
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, 4096)
        except BlockingIOError:
            return
        except OSError as why:
            self._fail(device_fault(why, "serial port"))
            return
        if data:
            self._take(data)
        else:
            self._fail("the device is gone")

    def _writable(self) -> None:
        self._flush()
        if not self._rest:
            self._pump()

    def _takes_more(self, now: MonoNs) -> bool:
        takes_more = super()._takes_more(now)
        if not takes_more and seconds_between(self._written[0][0], now) > _STILL_S:
            # The frame that is cut in two costs less than old ones would.
            with suppress(OSError, termios.error):
                termios.tcflush(self._fd, termios.TCOFLUSH)
            self._counts.late += len(self._written)
            self._written.clear()
            self._rest.clear()
            self._loop.remove_writer(self._fd)
            return True
        return takes_more and not self._rest

    def _unsent(self) -> int:
        return len(self._rest) + _in_kernel(self._fd)

    def _write(self, data: bytes) -> None:
        self._rest += data
        self._flush()

    def _flush(self) -> None:
        try:
            sent = os.write(self._fd, self._rest) if self._rest else 0
        except BlockingIOError:
            sent = 0
        except OSError as why:
            self._fail(device_fault(why, "serial port"))
            return
        del self._rest[:sent]
        if self._rest:
            self._loop.add_writer(self._fd, self._writable)
        else:
            self._loop.remove_writer(self._fd)

    def _fail(self, why: str) -> None:
        self.close()
        self.stop(why)


@asynccontextmanager
async def open_wire(
    endpoint: Endpoint, clock: Clock, received: Received, counts: WireCounts | None = None, *, waits: bool = False
) -> AsyncIterator[Wire]:
    """Open what the endpoint names; closed on leaving.

    Args:
        counts: the endpoint's own, over all its openings.
        waits: let datagrams wait for `Wire.take`, stamped by the kernel; otherwise each is processed when it arrives.

    Raises:
        Recoverable: it cannot be opened now (no such device yet, no listener, port in use, no such name).
    """
    counts = WireCounts() if counts is None else counts
    if endpoint.scheme == "serial":
        try:
            port = serial.Serial(endpoint.host, endpoint.port, timeout=0, exclusive=True)
        except (OSError, serial.SerialException) as why:
            raise Recoverable(f"{endpoint.host}: {device_fault(why, 'serial port')}") from why
        line = _Serial(port, clock, received, counts)
        try:
            yield line
        finally:
            line.close()
            port.close()
        return
    opened, transport, address = await _open_socket(endpoint, clock, received, counts, waits)
    watch = [] if endpoint.scheme == "udpin" else [(f"watch-{endpoint}", _watch(endpoint, opened, address, clock))]
    try:
        async with running_beside(watch):
            yield opened
    finally:
        transport.close()
        if opened.received_at is not None:
            counts.tried.clear()


async def _open_socket(
    endpoint: Endpoint, clock: Clock, received: Received, counts: WireCounts, waits: bool
) -> tuple[Datagrams | _Stream, Datagrams | asyncio.BaseTransport, Any]:
    """Return what is open to the first of the host's addresses that can be opened, those first that were not tried in vain.

    Raises:
        Recoverable: none can.
    """
    loop, reasons = asyncio.get_running_loop(), []
    kind = socket.SOCK_STREAM if endpoint.scheme == "tcp" else socket.SOCK_DGRAM
    found = await resolve(endpoint.host, endpoint.port, _CONNECT_TIMEOUT_S, kind)
    if all(one[4] in counts.tried for one in found):
        counts.tried.clear()
    for family, _, protocol, _, address in (one for one in found if one[4] not in counts.tried):
        made = socket.socket(family, kind, protocol)
        made.setblocking(False)
        counts.tried.add(address)
        try:
            if endpoint.scheme == "tcp":
                async with asyncio.timeout(_CONNECT_TIMEOUT_S):
                    await loop.sock_connect(made, address)
                made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                stream, wire = await loop.create_connection(lambda: _Stream(clock, received, counts), sock=made)
                return wire, stream, address
            listening = endpoint.scheme == "udpin"
            (made.bind if listening else made.connect)(address)
            datagrams = Datagrams(clock, received, counts, made, listening, waits)
            return datagrams, datagrams, address
        except (OSError, TimeoutError) as why:
            made.close()
            # Linux forbids a socket that did not ask for it to be connected to the address of all in a network.
            shared = isinstance(why, PermissionError) and endpoint.scheme == "udpout"
            fault = f"it is a broadcast address, and a link has one peer: {ONE_PEER}" if shared else device_fault(why, "network")
            reasons.append(f"{address[0]}: {fault or 'no answer'}")
        except BaseException:
            made.close()
            raise
    raise Recoverable("; ".join(reasons))


async def _watch(endpoint: Endpoint, wire: Datagrams | _Stream, address: Any, clock: Clock) -> None:
    """Break a wire whose peer has been silent for `SILENT_S`, and for UDP only if there is another way to it."""
    looked_at = clock.now()
    while True:
        await clock.sleep(_WATCH_S)
        refused = isinstance(wire, Datagrams) and wire.refused_at is not None
        most_s = _REFUSED_S if refused else SILENT_S
        if wire.quiet_s <= most_s or seconds_between(looked_at, clock.now()) <= most_s:
            continue
        looked_at = clock.now()
        what = f"{address[0]} refuses: nothing listens there" if refused else f"not a byte of {address[0]} for {SILENT_S:.0f} s"
        if isinstance(wire, _Stream):
            wire.stop(what)
            return
        with suppress(Recoverable, OSError):
            found = await resolve(endpoint.host, endpoint.port, _CONNECT_TIMEOUT_S, socket.SOCK_DGRAM)
            others = [str(one[4][0]) for one in found if one[4] != address]
            if others:
                wire.stop(f"{what}; {endpoint.host} is {', '.join(others)} {'now' if len(others) == len(found) else 'too'}")
                return
            if wire.local is not None and source_towards(found[0][4]) != wire.local[0]:
                wire.stop(f"{what}; this computer's own address has changed")
                return


def source_towards(place: tuple[Any, ...]) -> str:
    """Return this computer's address towards another; nothing is sent.

    Raises:
        OSError: there is no way to it.
    """
    with socket.socket(socket.AF_INET6 if ":" in place[0] else socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(place)
        return str(probe.getsockname()[0])
