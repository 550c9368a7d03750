"""A client for tests: plain sockets, the wire formats of the driver, nothing of the driver's own behaviour."""

import asyncio
import select
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from drivers.ardrone import at, navdata, pave
from drivers.ardrone.navdata import Navdata, NavdataState
from drivers.ardrone.options import ArDroneOptions
from sitl.emulators.ardrone.server import Ports

ASK = b"\x01\x00\x00\x00"


class Peer:
    """Commands on one socket, navdata on another."""

    def __init__(self, host: str, ports: Ports) -> None:
        self.host, self.ports = host, ports
        self.sequence = 0
        self.commands = udp()
        self.navdata = udp()

    def say(self, *commands: at.AtCommand) -> None:
        datagram = b""
        for command in commands:
            self.sequence += 1
            datagram += at.encode(self.sequence, command)
        self.commands.sendto(datagram, (self.host, self.ports.at))

    def ask(self, request: bytes = ASK) -> None:
        self.navdata.sendto(request, (self.host, self.ports.navdata))

    async def on_message(self) -> Navdata:
        loop = asyncio.get_running_loop()
        async with asyncio.timeout(60):
            received_at = navdata.decode(await loop.sock_recv(self.navdata, 4096))
        assert isinstance(received_at, Navdata), received_at
        return received_at

    def waiting(self) -> bool:
        """Return whether a datagram lies in the socket unread."""
        return bool(select.select([self.navdata], [], [], 0)[0])

    async def until(self, done: Callable[[Navdata], bool], timeout_s: float = 60.0) -> Navdata:
        """Return the first datagram that satisfies `done`."""
        async with asyncio.timeout(timeout_s):
            while True:
                received_at = await self.on_message()
                if done(received_at):
                    return received_at

    async def configure(self, key: str, value: str) -> None:
        """Configure the drone with the whole handshake, after a request for navdata."""
        self.say(at.Ctrl(at.CTRL_ACK))
        await self.until(lambda n: not n.state & NavdataState.COMMAND_ACK)
        self.say(at.Config(key, value))
        await self.until(lambda n: bool(n.state & NavdataState.COMMAND_ACK))
        self.say(at.Ctrl(at.CTRL_ACK))
        await self.until(lambda n: not n.state & NavdataState.COMMAND_ACK)

    @asynccontextmanager
    async def talking(self, *commands: at.AtCommand, period_s: float = 0.03) -> AsyncIterator[None]:
        """Say the same again and again, as a client keeps its drone in the air."""

        async def talk() -> None:
            while True:
                self.say(*commands)
                await asyncio.sleep(period_s)

        async with asyncio.TaskGroup() as group:
            task = group.create_task(talk())
            try:
                yield
            finally:
                task.cancel()

    def close(self) -> None:
        self.commands.close()
        self.navdata.close()


class Watcher:
    """A video client on a plain socket."""

    def __init__(self, host: str, ports: Ports, receive_buffer: int | None = None) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if receive_buffer is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.connect((host, ports.video))
        self.socket.setblocking(False)
        self.parser = pave.PaveParser()
        self._ready: list[pave.PaveFrame] = []

    async def frame(self) -> pave.PaveFrame:
        loop = asyncio.get_running_loop()
        async with asyncio.timeout(60):
            while not self._ready:
                data = await loop.sock_recv(self.socket, 1 << 16)
                if not data:
                    raise EOFError("the drone closed the video connection")
                self._ready = self.parser.feed(data)
        return self._ready.pop(0)

    def close(self) -> None:
        self.socket.close()


def options_for(ports: Ports, **over: Any) -> ArDroneOptions:
    """Return the driver's options that lead to a simulated drone on loopback."""
    found = {f"{name}_port": getattr(ports, name) for name in ("navdata", "video", "at", "control")}
    return ArDroneOptions("127.0.0.1", **(found | over))


def udp() -> socket.socket:
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.setblocking(False)
    s.bind(("127.0.0.1", 0))
    return s
