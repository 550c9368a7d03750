"""A connected UDP socket in the event loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs

_BUFFER_MAX = 16384
"""The number of bytes waiting to be sent beyond which a datagram is dropped."""


class Datagrams(asyncio.DatagramProtocol):
    """Passes each datagram to `received` with the instant at which it was received; counts the errors that the system reports."""

    def __init__(self, clock: Clock, received: Callable[[bytes, MonoNs], None]) -> None:
        self._clock = clock
        self._received = received
        self._transport: Any = None
        # The loops' datagram transports share no class that has both methods used here.
        self._lost: Exception | None = None
        self.errors = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: object) -> None:
        self._received(data, self._clock.now())

    def error_received(self, exc: Exception) -> None:
        self.errors += 1
        if not isinstance(exc, ConnectionRefusedError):
            self._lost = exc

    def connection_lost(self, exc: Exception | None) -> None:
        self._lost = exc or Recoverable("socket closed")

    def send(self, data: bytes) -> None:
        """Send now or drop; never blocks.

        Raises:
            Recoverable: the socket is broken; a peer that refuses does not break it, as it may start later.
        """
        if self._lost is not None:
            raise Recoverable(f"socket: {self._lost}")
        if self._transport.get_write_buffer_size() < _BUFFER_MAX:
            self._transport.sendto(data)


@asynccontextmanager
async def open_datagrams(
    host: str, port: int, clock: Clock, received: Callable[[bytes, MonoNs], None]
) -> AsyncIterator[Datagrams]:
    """Open a socket that talks to one peer only, and close it on leaving.

    Raises:
        OSError: the host is not known or not reachable.
    """
    loop = asyncio.get_running_loop()
    transport, protocol = await loop.create_datagram_endpoint(lambda: Datagrams(clock, received), remote_addr=(host, port))
    try:
        yield protocol
    finally:
        transport.close()
