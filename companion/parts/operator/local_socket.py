"""The service's local socket: terminals on this computer give orders and fly by hand through it.

The file system says who may connect: the socket belongs to the service's user and is open to that user and root alone. A
connection that closes, or is silent while it has the hand, leads to a hold.
"""

import asyncio
import logging
import os
import socket
import stat
import struct
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from companion.base.orders import OrderSender, OrderSource
from companion.cycle.ports import Assembly
from companion.facts.wire import (
    LINE_MAX,
    OrderRequest,
    RequestRate,
    RequestRefused,
    SticksRequest,
    WatchRequest,
    line_of,
    request_of,
)
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import FlightWatch, PilotOperator
from companion.parts.operator.client import answers, socket_path
from estimator.contracts.errors import Recoverable, unusable
from estimator.contracts.time import Clock

log = logging.getLogger(__name__)

_STATE_S = 0.2  # interval of the state
_CONNECTIONS = 8  # terminals that may be connected at a time
_REQUESTS_EACH_S = 100
"""The number of requests of one connection in a second; sticks come at 20 Hz."""
_UNREAD_BYTES = 64 * 1024
"""A terminal that leaves this much unread is dropped."""


class OperatorSocket(FlightWatch):
    """The observer and the supervised task; see the module's docstring.

    Args:
        path: where the socket is made; its folder is made if it is absent.
    """

    def __init__(self, path: Path, pilot: Pilot, clock: Clock) -> None:
        super().__init__(pilot, clock)
        self.path = path
        self.pilot = pilot
        self.clock = clock
        self.connections: set[_Connection] = set()
        self.counts: Counter[str] = Counter()

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health."""
        return {**self.counts, "connections": len(self.connections), "ignored_sticks": self.pilot.operator.ignored_sticks}

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            Recoverable: the socket cannot be made, or another service has it.
        """
        server = await asyncio.get_running_loop().create_unix_server(lambda: _Connection(self), sock=self._listen())
        log.info("orders of this computer's users on %s", self.path)
        try:
            while True:
                await self.clock.sleep(_STATE_S)
                for connection in [c for c in self.connections if c.watches]:
                    connection.send_state()
        finally:
            server.close()
            for connection in list(self.connections):
                connection.close()
            self.path.unlink(missing_ok=True)

    def _listen(self) -> socket.socket:
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder = self.path.parent.stat()
            if folder.st_uid not in (os.getuid(), 0) or (folder.st_mode & stat.S_IWOTH and not folder.st_mode & stat.S_ISVTX):
                raise Recoverable(f"{self.path.parent} belongs to another user, or everybody may write to it")
            if self.path.exists():
                if answers(self.path):
                    raise Recoverable(f"another service listens at {self.path}")
                self.path.unlink()
            listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listening.setblocking(False)
            before = os.umask(0o177)  # the socket is never open to others, not even for an instant
            try:
                listening.bind(str(self.path))
            finally:
                os.umask(before)
            return listening
        except OSError as why:
            raise Recoverable(f"the local socket cannot be made: {unusable(str(self.path), why)}") from why


class _Connection(asyncio.Protocol):
    """One terminal."""

    def __init__(self, served: OperatorSocket) -> None:
        self._served = served
        self._transport: asyncio.Transport | None = None
        self._buffer = b""
        self._rate = RequestRate(_REQUESTS_EACH_S)
        self._sender = OrderSender(OrderSource.TERMINAL)
        self.watches = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.set_write_buffer_limits(_UNREAD_BYTES)
        self._served.connections.add(self)
        self._served.counts["opened"] += 1
        number, peer = self._served.counts["opened"], _peer(transport.get_extra_info("socket"))
        self._sender = OrderSender(OrderSource.TERMINAL, f"{number} ({peer})")
        if len(self._served.connections) > _CONNECTIONS:
            self._refuse(f"at most {_CONNECTIONS} terminals connect at a time")

    def connection_lost(self, exc: Exception | None) -> None:
        self._served.connections.discard(self)
        arbiter = self._served.pilot.operator
        arbiter.lost(self._sender, self._served.clock.now(), "its terminal closed")

    def pause_writing(self) -> None:
        self.close()

    def data_received(self, data: bytes) -> None:
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            if self._transport is None or self._transport.is_closing():
                return
            self._take(line)
        if len(self._buffer) > LINE_MAX:
            self._refuse(f"a line has at most {LINE_MAX} bytes")

    def close(self) -> None:
        """Close the connection, after what was written is sent."""
        if self._transport is not None:
            self._transport.close()

    def send_state(self) -> None:
        """Send the present state."""
        self._send(line_of(self._served.state(self._sender)))

    def _take(self, line: bytes) -> None:
        now = self._served.clock.now()
        if self._rate.exceeded(now):
            self._refuse(f"more than {_REQUESTS_EACH_S} requests in a second")
            return
        request = request_of(line) if len(line) <= LINE_MAX else f"a line has at most {LINE_MAX} bytes"
        match request:
            case OrderRequest():
                operator = PilotOperator(self._served.pilot, self._sender, self._served.clock)
                self._send(line_of(operator.answer(request)))
            case SticksRequest():
                self._served.pilot.operator.move(self._sender, request.positions, now)
            case WatchRequest():
                self.watches = True
                self.send_state()
            case str():
                self._refuse(request)

    def _send(self, data: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    def _refuse(self, why: str) -> None:
        self._served.counts["refused"] += 1
        self._send(line_of(RequestRefused(text=why)))
        self.close()


def _peer(connected: socket.socket) -> str:
    """Return the process and the user at the other end, as the kernel names them."""
    try:
        pid, uid, _ = struct.unpack("3i", connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
    except OSError:
        return "unknown"
    return f"process {pid}, user {uid}"


def join(service: Assembly) -> None:
    """Add the socket, if the settings want one."""
    if (path := socket_path(service.settings)) is not None:
        terminals = OperatorSocket(path, service.pilot, service.clock)
        service.observers.append(terminals)
        service.add("operator", terminals)
