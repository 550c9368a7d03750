"""Open ways for bytes: UDP, TCP and serial ports in the event loop. None of them blocks; a full one drops and says so."""

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, NoReturn, Protocol

import serial

from drivers.mavlink.endpoint import Address, Endpoint
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs

Received = Callable[[bytes, MonoNs, Address | None], None]
"""A function that takes received bytes, the instant of their arrival and, on a listening socket, the sender's address."""

_WAITING_MAX = 16_384
"""Bytes waiting to be sent beyond which a message is dropped instead; 0.2 s at 921600 bit/s."""
_CONNECT_TIMEOUT_S = 3.0


class Wire(Protocol):
    """The interface of an open connection to its endpoint."""

    @property
    def local(self) -> Address | None:
        """Address bound on this side, None where there is none."""
        ...

    def send(self, data: bytes, to: Address | None) -> bool:
        """Send now or drop; whether it went. `to` is for a socket that listens."""
        ...

    async def broken(self) -> NoReturn:
        """Wait until it no longer works.

        Raises:
            Recoverable: always, with the reason.
        """
        ...


class _Breakable:
    def __init__(self) -> None:
        self._end: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def _break(self, why: str) -> None:
        if not self._end.done():
            self._end.set_result(why)

    async def broken(self) -> NoReturn:
        raise Recoverable(await asyncio.shield(self._end))


class _Datagrams(_Breakable, asyncio.DatagramProtocol):
    def __init__(self, clock: Clock, received: Received, listening: bool) -> None:
        super().__init__()
        self._clock = clock
        self._received = received
        self._listening = listening
        self._transport: Any = None  # the loops' datagram transports share no class that has both methods used here

    @property
    def local(self) -> Address | None:
        host, port = self._transport.get_extra_info("sockname")[:2]
        return str(host), int(port)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._received(data, self._clock.now(), (addr[0], addr[1]) if self._listening else None)

    def error_received(self, exc: Exception) -> None:
        # A peer that is not there yet refuses; it may come.
        if not isinstance(exc, ConnectionRefusedError) and not self._listening:
            self._break(str(exc))

    def connection_lost(self, exc: Exception | None) -> None:
        self._break(str(exc or "socket closed"))

    def send(self, data: bytes, to: Address | None) -> bool:
        if self._end.done() or self._transport.get_write_buffer_size() > _WAITING_MAX or (to is None) is self._listening:
            return False
        self._transport.sendto(data, to)
        return True


class _Stream(_Breakable, asyncio.Protocol):
    def __init__(self, clock: Clock, received: Received) -> None:
        super().__init__()
        self._clock = clock
        self._received = received
        self._transport: asyncio.WriteTransport | None = None

    @property
    def local(self) -> Address | None:
        return None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.WriteTransport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._received(data, self._clock.now(), None)

    def connection_lost(self, exc: Exception | None) -> None:
        self._break(str(exc or "the other side closed the connection"))

    def send(self, data: bytes, to: Address | None) -> bool:
        if self._end.done() or self._transport is None or self._transport.get_write_buffer_size() > _WAITING_MAX:
            return False
        self._transport.write(data)
        return True


class _Serial(_Breakable):
    """A serial port's file descriptor, read and written when the loop says that it is ready."""

    def __init__(self, port: serial.Serial, clock: Clock, received: Received) -> None:
        super().__init__()
        self._fd: int = port.fileno()
        os.set_blocking(self._fd, False)
        self._loop = asyncio.get_running_loop()
        self._clock = clock
        self._received = received
        self._waiting = bytearray()
        self._loop.add_reader(self._fd, self._readable)

    @property
    def local(self) -> Address | None:
        return None

    def close(self) -> None:
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)

    def send(self, data: bytes, to: Address | None) -> bool:
        if self._end.done() or len(self._waiting) + len(data) > _WAITING_MAX:
            return False
        self._waiting += data
        self._writable()
        return True

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, 4096)
        except BlockingIOError:
            return
        except OSError as why:
            self._stop(why.strerror or str(why))
            return
        if data:
            self._received(data, self._clock.now(), None)
        else:
            self._stop("the device is gone")

    def _writable(self) -> None:
        try:
            sent = os.write(self._fd, self._waiting) if self._waiting else 0
        except BlockingIOError:
            sent = 0
        except OSError as why:
            self._stop(why.strerror or str(why))
            return
        del self._waiting[:sent]
        if self._waiting:
            self._loop.add_writer(self._fd, self._writable)
        else:
            self._loop.remove_writer(self._fd)

    def _stop(self, why: str) -> None:
        self.close()
        self._break(why)


@asynccontextmanager
async def open_wire(endpoint: Endpoint, clock: Clock, received: Received) -> AsyncIterator[Wire]:
    """Open what the endpoint names; closed on leaving.

    Raises:
        Recoverable: it cannot be opened now (no such device yet, nobody listens, port in use).
    """
    loop = asyncio.get_running_loop()
    address = (endpoint.host, endpoint.port)
    try:
        if endpoint.scheme == "serial":
            port = serial.Serial(endpoint.host, endpoint.port, timeout=0, exclusive=True)
        elif endpoint.scheme == "tcp":
            async with asyncio.timeout(_CONNECT_TIMEOUT_S):
                stream, wire = await loop.create_connection(lambda: _Stream(clock, received), *address)
        elif endpoint.scheme == "udpin":
            datagrams, socket = await loop.create_datagram_endpoint(lambda: _Datagrams(clock, received, True), local_addr=address)
        else:
            datagrams, socket = await loop.create_datagram_endpoint(
                lambda: _Datagrams(clock, received, False), remote_addr=address
            )
    except (OSError, TimeoutError, serial.SerialException) as why:
        raise Recoverable(str(why) or "no answer") from why
    if endpoint.scheme == "serial":
        line = _Serial(port, clock, received)
        try:
            yield line
        finally:
            line.close()
            port.close()
    elif endpoint.scheme == "tcp":
        try:
            yield wire
        finally:
            stream.close()
    else:
        try:
            yield socket
        finally:
            datagrams.close()
