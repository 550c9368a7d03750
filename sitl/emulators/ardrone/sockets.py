"""The ports of the drone: they count and pass on, the server decides. Nothing a peer sends raises."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from typing import Any

from estimator.contracts.time import MonoNs, seconds_between

Address = tuple[str, int]

LEASE_S = 10.0
"""Time for which a UDP client is served after its last datagram; every client repeats its request when its stream stops."""
_UNICAST = (b"\x01", b"\x01\x00\x00\x00")
"""The datagrams that request a stream."""


class DatagramPort(asyncio.DatagramProtocol):
    """A UDP port: its clients are sent each datagram until they fall silent.

    Args:
        name: the first word of its counters.
        clients_max: the number of clients; a new one takes the place of the one that was silent longest.
        backlog_max: the number of bytes waiting to be sent beyond which a datagram is dropped.
        take: takes what peers send to a port that sends nothing.
    """

    def __init__(
        self,
        name: str,
        now: Callable[[], MonoNs],
        counters: Counter[str],
        clients_max: int = 1,
        backlog_max: int = 0,
        take: Callable[[bytes, Address], None] | None = None,
    ) -> None:
        self._name = name
        self._now = now
        self._counters = counters
        self._clients_max = clients_max
        self._backlog_max = backlog_max
        self._take = take
        self._clients: dict[Address, MonoNs] = {}
        self._transport: Any = None
        # The loops' datagram transports share no class that has all methods used here.

    @property
    def busy(self) -> bool:
        """True if somebody is served."""
        now = self._now()
        for address in [a for a, received_at in self._clients.items() if seconds_between(received_at, now) > LEASE_S]:
            del self._clients[address]
            self._count("client_expired")
        return bool(self._clients)

    async def listen(self, host: str, port: int, stack: AsyncExitStack) -> int:
        """Listen until the stack closes and return the port in use.

        Raises:
            OSError: the port is taken.
        """
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: self, local_addr=(host, port))
        stack.callback(transport.close)
        return int(transport.get_extra_info("sockname")[1])

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Address) -> None:
        if self._take is not None:
            self._take(data, addr)
            return
        if data not in _UNICAST:
            self._count("request_refused")
            return
        self._count("request")
        if self._clients.pop(addr, None) is None:
            self._count("client")
        self._clients[addr] = self._now()
        while len(self._clients) > self._clients_max:
            del self._clients[next(iter(self._clients))]
            self._count("client_replaced")

    def error_received(self, exc: Exception) -> None:
        self._count("socket_error")

    def received_from(self, host: str) -> None:
        """Commands came from this host: its clients live."""
        for address in self._clients:
            if address[0] == host:
                self._clients[address] = self._now()

    def send(self, datagram: bytes) -> None:
        """Send a datagram to every client, or drop it because those before have not left yet."""
        transport = self._transport
        if not self.busy or transport is None or transport.is_closing():
            return
        if transport.get_write_buffer_size() > self._backlog_max:
            self._count("dropped")
            return
        for address in self._clients:
            transport.sendto(datagram, address)
            self._count("sent")

    def _count(self, what: str) -> None:
        self._counters[f"{self._name}_{what}"] += 1


class StreamPort:
    """A TCP port, whose stream goes one way: what a client sends changes nothing.

    Args:
        name: the first word of its counters.
        clients_max: the number of clients. With one, a new client takes the place of the old, lest its own dead connection lock
            somebody out; with several, one too many is refused.
        backlog_max: the number of bytes waiting to be sent to a client beyond which it is sent nothing.
        buffer: bytes that the kernel may hold for a client; None for the system's own limit.
    """

    def __init__(
        self, name: str, counters: Counter[str], clients_max: int = 1, backlog_max: int = 0, buffer: int | None = None
    ) -> None:
        self._name = name
        self._counters = counters
        self._clients_max = clients_max
        self._backlog_max = backlog_max
        self._buffer = buffer
        self._clients: set[asyncio.WriteTransport] = set()

    @property
    def busy(self) -> bool:
        """True if somebody is served."""
        return bool(self._clients)

    async def listen(self, host: str, port: int, stack: AsyncExitStack) -> int:
        """Listen until the stack closes and return the port in use.

        Raises:
            OSError: the port is taken.
        """
        server = await asyncio.start_server(self._serve, host, port)
        stack.callback(self.drop)
        stack.callback(server.close)
        return int(server.sockets[0].getsockname()[1])

    def received_from(self, host: str) -> None:
        """Commands came from this host, which keeps no connection open."""

    def send(self, data: bytes) -> None:
        """Hand the data over to every client whose backlog allows it."""
        for transport in self._clients:
            if transport.is_closing():
                continue
            if transport.get_write_buffer_size() > self._backlog_max:
                self._count("dropped")
            else:
                transport.write(data)
                self._count("sent")

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        transport = writer.transport
        if self._buffer is not None:
            raw: socket.socket = transport.get_extra_info("socket")
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._buffer)
        if len(self._clients) >= self._clients_max > 1:
            self._count("client_refused")
            transport.abort()
            return
        if len(self._clients) >= self._clients_max:
            self._count("client_replaced")
            self.drop()
        self._count("client")
        self._clients.add(transport)
        try:
            with suppress(OSError):
                while await reader.read(4096):
                    pass
        finally:
            self._clients.discard(transport)
            transport.abort()

    def drop(self) -> None:
        """Cut all connections."""
        for transport in self._clients:
            transport.abort()
        self._clients.clear()

    def _count(self, what: str) -> None:
        self._counters[f"{self._name}_{what}"] += 1
