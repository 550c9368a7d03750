"""The four ports of the drone as asyncio protocols: they count and pass on, the server decides. Nothing a peer sends raises."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Protocol, cast

from estimator.contracts.time import MonoNs, seconds_between

Address = tuple[str, int]

NAVDATA_CLIENTS_MAX = 8
NAVDATA_LEASE_S = 10.0
"""Time for which a navdata client is served after its last datagram; every client repeats its request when navdata stops."""
CONTROL_CLIENTS_MAX = 8
_BACKLOG_MAX = 1 << 18
_VIDEO_SEND_BUFFER = 1 << 16
"""Bytes the kernel may hold for the video client: about half a second, so that a slow client loses frames, not freshness."""

_UNICAST = (b"\x01", b"\x01\x00\x00\x00")


class _BufferedDatagrams(Protocol):
    """The methods of every event loop's datagram transport; the standard library's own class lacks the last."""

    def is_closing(self) -> bool: ...

    def sendto(self, data: bytes, addr: Address) -> None: ...

    def get_write_buffer_size(self) -> int: ...


class NavdataPort(asyncio.DatagramProtocol):
    """UDP 5554: every client is sent each datagram until it falls silent."""

    def __init__(self, now: Callable[[], MonoNs], counters: Counter[str]) -> None:
        self._now = now
        self._counters = counters
        self._clients: dict[Address, MonoNs] = {}
        self._transport: _BufferedDatagrams | None = None

    @property
    def clients(self) -> tuple[Address, ...]:
        return tuple(self._clients)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(_BufferedDatagrams, transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        if data not in _UNICAST:
            self._counters["navdata_request_refused"] += 1
            return
        self._counters["navdata_request"] += 1
        self._clients.pop(addr, None)
        self._clients[addr] = self._now()
        while len(self._clients) > NAVDATA_CLIENTS_MAX:
            del self._clients[next(iter(self._clients))]
            self._counters["navdata_client_evicted"] += 1

    def error_received(self, exc: Exception) -> None:
        self._counters["navdata_socket_error"] += 1

    def received_from(self, host: str) -> None:
        """Commands came from this host: its navdata clients live."""
        for address in self._clients:
            if address[0] == host:
                self._clients[address] = self._now()

    def send(self, datagram: bytes) -> None:
        """Send a datagram to every client whose lease has not expired."""
        now = self._now()
        for address in [a for a, received_at in self._clients.items() if seconds_between(received_at, now) > NAVDATA_LEASE_S]:
            del self._clients[address]
            self._counters["navdata_client_expired"] += 1
        if self._transport is None or self._transport.is_closing() or self._transport.get_write_buffer_size() > _BACKLOG_MAX:
            self._counters["navdata_not_sent"] += 1
            return
        for address in self._clients:
            self._transport.sendto(datagram, address)
            self._counters["navdata_sent"] += 1


class AtPort(asyncio.DatagramProtocol):
    """UDP 5556."""

    def __init__(self, take: Callable[[bytes, Address], None], counters: Counter[str]) -> None:
        self._take = take
        self._counters = counters

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._take(data, addr)

    def error_received(self, exc: Exception) -> None:
        self._counters["at_socket_error"] += 1


class VideoPort:
    """TCP 5555 of a 2.0: one client; a new one takes the place of the old, lest its own dead connection lock somebody out."""

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._client: _VideoClient | None = None

    @property
    def busy(self) -> bool:
        """True if somebody is watching."""
        return self._client is not None

    async def listen(self, host: str, port: int, stack: AsyncExitStack) -> int:
        """Listen until the stack closes and return the port in use.

        Raises:
            OSError: the port is taken.
        """
        server = await asyncio.get_running_loop().create_server(lambda: _VideoClient(self), host, port)
        stack.callback(self.close)
        stack.callback(server.close)
        return int(server.sockets[0].getsockname()[1])

    def received_from(self, host: str) -> None:
        """Commands came from this host, which keeps no connection open."""

    def send(self, frame: bytes) -> bool:
        """Hand a whole frame over, or drop it because the one before has not left yet."""
        transport = self._client.transport if self._client is not None else None
        if transport is None or transport.is_closing():
            return False
        if transport.get_write_buffer_size() > 0:
            self._counters["video_dropped"] += 1
            return False
        transport.write(frame)
        self._counters["video_sent"] += 1
        return True

    def close(self) -> None:
        if self._client is not None and self._client.transport is not None:
            self._client.transport.abort()

    def _arrived(self, client: _VideoClient) -> None:
        if self._client is not None:
            self._counters["video_client_replaced"] += 1
            self.close()
        self._counters["video_client"] += 1
        self._client = client

    def _left(self, client: _VideoClient) -> None:
        if self._client is client:
            self._client = None


class VideoDatagramPort(asyncio.DatagramProtocol):
    """UDP 5555 of a 1.0: the newest client is sent every picture until it falls silent."""

    def __init__(self, now: Callable[[], MonoNs], counters: Counter[str]) -> None:
        self._now = now
        self._counters = counters
        self._client: tuple[Address, MonoNs] | None = None
        self._transport: _BufferedDatagrams | None = None

    @property
    def busy(self) -> bool:
        """True if somebody is watching."""
        if self._client is not None and seconds_between(self._client[1], self._now()) > NAVDATA_LEASE_S:
            self._client = None
            self._counters["video_client_expired"] += 1
        return self._client is not None

    async def listen(self, host: str, port: int, stack: AsyncExitStack) -> int:
        """Listen until the stack closes and return the port in use.

        Raises:
            OSError: the port is taken.
        """
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: self, local_addr=(host, port))
        stack.callback(transport.close)
        return int(transport.get_extra_info("sockname")[1])

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(_BufferedDatagrams, transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        if data not in _UNICAST:
            self._counters["video_request_refused"] += 1
            return
        if self._client is None or self._client[0] != addr:
            self._counters["video_client"] += 1
        self._client = addr, self._now()

    def error_received(self, exc: Exception) -> None:
        self._counters["video_socket_error"] += 1

    def received_from(self, host: str) -> None:
        """Commands came from this host: its video client lives."""
        if self._client is not None and self._client[0][0] == host:
            self._client = self._client[0], self._now()

    def send(self, picture: bytes) -> bool:
        """Send a picture, or drop it because those before have not left yet."""
        transport = self._transport
        if self._client is None or transport is None or transport.is_closing():
            return False
        if transport.get_write_buffer_size() > 0:
            self._counters["video_dropped"] += 1
            return False
        transport.sendto(picture, self._client[0])
        self._counters["video_sent"] += 1
        return True


class _VideoClient(asyncio.Protocol):
    def __init__(self, port: VideoPort) -> None:
        self._port = port
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        raw: socket.socket = transport.get_extra_info("socket")
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _VIDEO_SEND_BUFFER)
        self._port._arrived(self)

    def data_received(self, data: bytes) -> None:
        # The stream goes one way; a wake-up packet or garbage from the client changes nothing.
        pass

    def connection_lost(self, exc: Exception | None) -> None:
        self._port._left(self)


class ControlPort:
    """TCP 5559: answers go to everybody connected."""

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self._transports: set[asyncio.Transport] = set()

    @property
    def connected(self) -> bool:
        return bool(self._transports)

    def connection(self) -> asyncio.Protocol:
        return _ControlClient(self._transports, self._counters)

    def send(self, answer: bytes) -> None:
        for transport in self._transports:
            if transport.get_write_buffer_size() > _BACKLOG_MAX:
                self._counters["control_not_sent"] += 1
            else:
                transport.write(answer)
                self._counters["control_sent"] += 1

    def close(self) -> None:
        for transport in tuple(self._transports):
            transport.abort()


class _ControlClient(asyncio.Protocol):
    def __init__(self, transports: set[asyncio.Transport], counters: Counter[str]) -> None:
        self._transports = transports
        self._counters = counters
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if len(self._transports) >= CONTROL_CLIENTS_MAX:
            self._counters["control_client_refused"] += 1
            cast(asyncio.Transport, transport).abort()
            return
        self._counters["control_client"] += 1
        self._transport = cast(asyncio.Transport, transport)
        self._transports.add(self._transport)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None:
            self._transports.discard(self._transport)
