"""Bound the connections to an HTTP port: their number, their duration and their bytes.

aiohttp itself waits indefinitely for the first byte of a request. Here each connection has one deadline from its opening to its
end, whatever it does meanwhile, and the newest connection is served: when there are too many, the oldest is closed.
"""

from __future__ import annotations

import asyncio
import ssl
from dataclasses import dataclass, field

from aiohttp import web

from estimator.contracts.errors import Recoverable


@dataclass(slots=True)
class ConnectionLimits:
    """The bounds, and the number of times that each was reached."""

    connections: int = 16
    """The most connections that are open at once."""
    connection_s: float = 5.0
    """The longest duration of a connection."""
    request_bytes: int = 16_384
    """The most bytes that a connection may send in all."""
    evicted: int = 0
    overdue: int = 0
    oversized: int = 0
    open: dict[_Bounded, asyncio.Transport] = field(default_factory=dict)
    """The open connections from the oldest to the newest."""

    def lift(self, transport: asyncio.BaseTransport | None) -> None:
        """Bound this connection no longer: its peer has proven who it is, and whoever admitted it bounds it from here on."""
        for protocol in [protocol for protocol, open_one in self.open.items() if open_one is transport]:
            protocol.lift()

    def counts(self) -> dict[str, float]:
        """Return the counters for health."""
        return {
            "connections_evicted": self.evicted,
            "connections_overdue": self.overdue,
            "connections_oversized": self.oversized,
        }


async def listen(
    runner: web.AppRunner, limits: ConnectionLimits, host: str, port: int, tls: ssl.SSLContext | None = None
) -> asyncio.Server:
    """Serve an application on a port by bounded connections.

    Raises:
        Recoverable: the port is taken, or the address is none of this machine's.
    """
    server = runner.server
    assert server is not None, "the runner is set up"
    try:
        return await asyncio.get_running_loop().create_server(
            lambda: _Bounded(server(), limits), host, port, backlog=limits.connections, ssl=tls
        )
    except OSError as why:
        raise Recoverable(f"HTTP cannot be served on {host}:{port}: {why.strerror or why}") from why


class _Bounded(asyncio.Protocol):
    """One connection: it passes everything to aiohttp's own protocol while the bounds hold."""

    def __init__(self, inner: asyncio.Protocol, limits: ConnectionLimits) -> None:
        self._inner = inner
        self._limits = limits
        self._deadline: asyncio.TimerHandle | None = None
        self._received = 0
        self._lifted = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        limits = self._limits
        while len(limits.open) >= limits.connections:
            limits.evicted += 1
            limits.open.pop(next(iter(limits.open))).abort()
        limits.open[self] = transport
        self._deadline = asyncio.get_running_loop().call_later(limits.connection_s, self._overdue, transport)
        self._inner.connection_made(transport)

    def lift(self) -> None:
        """End the bounds of this connection."""
        self._lifted = True
        if self._deadline is not None:
            self._deadline.cancel()
        self._limits.open.pop(self, None)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._limits.open.pop(self, None)
        self._inner.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._received += len(data)
        if self._received > self._limits.request_bytes and not self._lifted:
            self._limits.oversized += 1
            if (transport := self._limits.open.get(self)) is not None:
                transport.abort()
            return
        self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()

    def _overdue(self, transport: asyncio.Transport) -> None:
        self._limits.overdue += 1
        transport.abort()
