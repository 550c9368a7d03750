"""Relay the datagrams between an autopilot program and the daemon, and do to them what a scenario's faults say.

The program sends to the relay as it would to the daemon; the daemon hears the relay and answers it. What passes is MAVLink as
it is on the wire: a datagram that is lost, late, doubled or overtaken meets the daemon's own link.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from estimator.contracts.ports import Clock
from sitl.faults.faulty_streams import InTransit, VehicleStreams

_Address = tuple[str, int]


class FaultyLink:
    """The datagrams under way in both directions.

    Args:
        streams: what becomes of the vehicle's samples and of the service's commands.
    """

    def __init__(self, streams: VehicleStreams, clock: Clock) -> None:
        self._clock = clock
        self._samples: InTransit[bytes] = InTransit(streams.navdata)
        self._commands: InTransit[bytes] = InTransit(streams.commands)
        self._to_daemon: Callable[[bytes], None] | None = None
        self._to_program: Callable[[bytes], None] | None = None
        self.cut = False
        """Whether nothing passes because there is no service: what is under way arrives nowhere."""
        self.muted = False
        """Whether nothing of the daemon's passes, while it hears the program."""
        self.carried: Counter[str] = Counter()
        """Datagrams that came in and that went on: "samples in", "samples out", "commands in", "commands out"."""

    def deliver(self) -> None:
        """Hand on what has arrived by now; call it after each step of the physics."""
        now = self._clock.now()
        for name, stream, send in (
            ("samples out", self._samples, self._to_daemon),
            ("commands out", self._commands, self._to_program),
        ):
            while send is not None and (packet := stream.arrived(now)) is not None:
                if not self.cut:
                    self.carried[name] += 1
                    send(packet[1])

    def from_program(self, data: bytes) -> None:
        """Take a datagram of the program."""
        self.carried["samples in"] += 1
        self._samples.send(lambda: data, self._clock.now())
        self.deliver()

    def from_daemon(self, data: bytes) -> None:
        """Take a datagram of the daemon."""
        if self.cut or self.muted:
            return
        self.carried["commands in"] += 1
        self._commands.send(lambda: data, self._clock.now())
        self.deliver()

    @asynccontextmanager
    async def relaying(self, host: str, program_port: int, daemon_port: int) -> AsyncIterator[None]:
        """Relay between `program_port`, to which the program sends, and the daemon at `daemon_port`, until the context ends.

        Raises:
            OSError: the program's port is in use.
        """
        loop = asyncio.get_running_loop()
        near, program = await loop.create_datagram_endpoint(lambda: _End(self.from_program), local_addr=(host, program_port))
        try:
            far, _ = await loop.create_datagram_endpoint(
                lambda: _End(self.from_daemon), local_addr=(host, 0), remote_addr=(host, daemon_port)
            )
            try:
                self._to_daemon = far.sendto
                self._to_program = lambda data: None if program.peer is None else near.sendto(data, program.peer)
                yield
            finally:
                self._to_daemon = self._to_program = None
                far.close()
        finally:
            near.close()


class _End(asyncio.DatagramProtocol):
    """One socket of the relay; it remembers who spoke last."""

    def __init__(self, take: Callable[[bytes], None]) -> None:
        self._take = take
        self.peer: _Address | None = None

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.peer = addr
        self._take(data)
