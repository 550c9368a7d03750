"""A UDP socket whose datagrams wait until they are taken, with the instants at which the kernel received them."""

import asyncio
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

from estimator.contracts.errors import Recoverable
from estimator.contracts.time import NS_PER_S, Clock, MonoNs

Taken = Callable[[bytes, MonoNs, Any], None]
"""A function that takes a datagram, the instant of its reception and its sender's address."""
_DATAGRAM_MAX = 1 << 16  # the largest datagram, bytes
_MOST_AT_ONCE = 64
"""The number of datagrams that are taken at once: a flood of them must not keep the event loop."""
_SO_TIMESTAMPNS = 35
"""The option of Linux that gives each datagram the wall time at which it was received (socket(7))."""
_TIMESPEC = struct.Struct("@ll")
_ANCILLARY_MAX = socket.CMSG_SPACE(_TIMESPEC.size)
_TRIES = 3  # readings of the two clocks at most, until the thread was not interrupted between them
_APART_NS = 100_000  # time between two readings from which the thread was interrupted
_WALL_STEP_NS = 1_000_000
"""A wall clock that moved by more than this against the monotonic one between two looks was set meanwhile."""


class WaitingDatagrams:
    """A UDP socket whose datagrams wait in the kernel until `take` passes them to `received`, in order.

    Each comes with the instant at which the kernel received it. Waking the event loop for a datagram takes as long as reading it.

    Args:
        own: the socket, which does not block.
        stamped: by the kernel; otherwise datagrams count as received when they are taken, as in virtual time.
    """

    def __init__(self, own: socket.socket, clock: Clock, received: Taken, *, stamped: bool = True) -> None:
        self._socket = own
        self._clock = clock
        self._received = received
        self._lost: Exception | None = None
        self.refused = 0
        """Number of times that the peer refused: no program listens there."""
        self.taken_at = clock.now()
        """Time when a waiting datagram was last taken."""
        self._wall_ahead_ns: int | None = None
        """The wall clock less the monotonic one at the newest look."""
        with suppress(OSError):  # without it the datagrams count as received when they are taken
            own.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, int(stamped))

    def take(self) -> None:
        """Pass on all datagrams that wait, at most some dozens. Never raises; `check` says what went wrong."""
        if self._lost is not None:
            return
        wall_ns, now = self._clocks()
        wall_was_set = self._wall_ahead_ns is None or abs(wall_ns - now - self._wall_ahead_ns) > _WALL_STEP_NS
        self._wall_ahead_ns = wall_ns - now
        try:
            for _ in range(_MOST_AT_ONCE):
                try:
                    data, ancillary, _, sender = self._socket.recvmsg(_DATAGRAM_MAX, _ANCILLARY_MAX)
                except BlockingIOError:
                    break
                except ConnectionRefusedError:
                    self.refused += 1
                    continue
                seconds, ns = _TIMESPEC.unpack_from(ancillary[0][2]) if ancillary else (0, wall_ns)
                age_ns = 0 if wall_was_set else wall_ns - (seconds * NS_PER_S + ns)
                self._received(data, MonoNs(max(self.taken_at, now - max(0, age_ns))), sender)
        except Exception as why:
            self._lost = why
        self.taken_at = now

    def _clocks(self) -> tuple[int, MonoNs]:
        """Return the wall time and the instant of the same moment, ns.

        The instant is read last: if this thread stood still in between, datagrams count as received later, not earlier.
        """
        for _ in range(_TRIES):
            before, wall_ns, now = self._clock.now(), time.time_ns(), self._clock.now()
            if now - before <= _APART_NS:
                break
        return wall_ns, now

    def check(self) -> None:
        """Check that the socket works.

        Raises:
            Recoverable: it is broken.
            Whatever `received` raised.
        """
        if isinstance(self._lost, OSError):
            raise Recoverable(f"socket: {self._lost}") from self._lost
        if self._lost is not None:
            raise self._lost

    def send(self, data: bytes) -> None:
        """Send now or drop; never blocks.

        Raises:
            Recoverable: the socket is broken; a peer that refuses does not break it, as it may start later.
        """
        self.check()
        try:
            with suppress(BlockingIOError, ConnectionRefusedError):
                self._socket.send(data)
        except OSError as why:
            self._lost = why
            self.check()


@asynccontextmanager
async def open_waiting(
    host: str, port: int, clock: Clock, received: Callable[[bytes, MonoNs], None], *, at_once: bool = False
) -> AsyncIterator[WaitingDatagrams]:
    """Open a socket that talks to one peer only and holds its datagrams, and close it on leaving.

    Args:
        at_once: take each datagram when it arrives.

    Raises:
        OSError: the host is not known or not reachable.
    """
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    family, kind, protocol, _, address = found[0]
    with socket.socket(family, kind, protocol) as connected:
        connected.setblocking(False)
        connected.connect(address)
        waiting = WaitingDatagrams(connected, clock, lambda data, at, sender: received(data, at))
        if at_once:
            loop.add_reader(connected, waiting.take)
        try:
            yield waiting
        finally:
            loop.remove_reader(connected)
