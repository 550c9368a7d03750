"""Identity of the autopilot over real sockets: several behind one router, ids that are used twice, an id that changes."""

import asyncio
import logging
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.endpoint import Address
from drivers.mavlink import autopilot as autopilot_module
from drivers.mavlink import roster
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.commands import Velocity
from estimator.contracts.errors import Recoverable
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.support.waiting import until

HOST = "127.0.0.1"
AHEAD = Velocity(np.array([1.0, 0.0, 0.0]), 0.0)


class Router(asyncio.DatagramProtocol):
    """Passes datagrams from anybody to one address, and what comes from there to everybody."""

    def __init__(self, to: Address) -> None:
        self._to = to
        self._clients: set[Any] = set()
        self._transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        if addr == self._to:
            for client in self._clients:
                self._transport.sendto(data, client)
        else:
            self._clients.add(addr)
            self._transport.sendto(data, self._to)

    def send(self, data: bytes) -> None:
        """Send as one of its clients."""
        self._transport.sendto(data, self._to)


@asynccontextmanager
async def routed(kind: type[Router] = Router, **options: Any) -> AsyncIterator[tuple[Autopilot, Router, str]]:
    """Yield the service's side, a router in front of it, and the router's address for autopilots."""
    quick = {"silence_s": 0.6, "command_period_s": 0.02, "restart_first_s": 0.02, "restart_most_s": 0.1}
    async with open_autopilot(AutopilotOptions(f"udpin://{HOST}:0", **(quick | options)), SystemClock()) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        local = autopilot.links.all[0].local
        assert local is not None
        loop = asyncio.get_running_loop()
        transport, router = await loop.create_datagram_endpoint(lambda: kind(local), local_addr=(HOST, 0))
        try:
            yield autopilot, router, "udpout://{}:{}".format(*transport.get_extra_info("sockname"))
        finally:
            transport.close()


class Moving(Router):
    """A router that goes on from another port when it is told to."""

    _moved: Any = None

    async def move(self) -> None:
        self._moved, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: _Back(self), local_addr=(HOST, 0))

    def connection_lost(self, exc: Exception | None) -> None:
        if self._moved is not None:
            self._moved.close()

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        if self._moved is None:
            super().datagram_received(data, addr)
        elif addr != self._to:
            self._moved.sendto(data, self._to)

    def back(self, data: bytes) -> None:
        for client in () if self._transport.is_closing() else self._clients:
            self._transport.sendto(data, client)


class _Back(asyncio.DatagramProtocol):
    def __init__(self, router: Moving) -> None:
        self._router = router

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._router.back(data)


def who_names(autopilot: Autopilot) -> dict[str, bool]:
    return {conflict.name: conflict.blocks for conflict in autopilot.id_conflicts}


async def test_commands_follow_an_autopilot_whose_port_moves(caplog: pytest.LogCaptureFixture) -> None:
    """The port moves as by a router's new address; a loss would need a silence of three seconds."""
    flying = MiniatureAutopilot(mode="guided")
    async with routed(Moving, silence_s=3.0) as (autopilot, router, url), flying.talking_to(url):
        assert isinstance(router, Moving)
        await until(lambda: autopilot.attitude is not None and autopilot.condition.flying is True)
        autopilot.command(AHEAD)
        await until(lambda: bool(flying.setpoints))
        await router.move()
        await until(lambda: "moved to another port" in caplog.text)
        before = len(flying.setpoints)
        autopilot.command(AHEAD)
        await until(lambda: len(flying.setpoints) > before)
        assert autopilot.connects == 1
    assert "silent for" not in caplog.text


async def test_of_two_with_one_id_the_first_is_listened_to_and_nobody_commanded(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    flying = MiniatureAutopilot(mode="guided")
    standing = MiniatureAutopilot(epoch_ns=900_000_000_000, armed=False, landed_state=1)
    async with routed() as (autopilot, _, url), AsyncExitStack() as stack:
        await stack.enter_async_context(flying.talking_to(url))
        await until(lambda: autopilot.attitude is not None and autopilot.condition.flying is True)
        autopilot.command(AHEAD)
        await until(lambda: bool(flying.setpoints))
        standing.intervals = dict(flying.intervals)  # its count alone, near the other's by chance, tells nobody apart
        time.sleep(0.7)  # noqa: ASYNC251 - the whole process stands still, which is no silence of the autopilot
        await stack.enter_async_context(standing.talking_to(url))
        await until(lambda: who_names(autopilot) == {"autopilot-id-twice": True})
        with pytest.raises(Recoverable, match=r"two autopilots have one id.*vehicle\.system_id"):
            autopilot.command(AHEAD)
        autopilot.links.send(mav.MAVLink_statustext_message(6, b"all setpoints before have arrived"))
        await until(lambda: bool(flying.of("STATUSTEXT")))
        sent, asked = len(flying.setpoints), flying.commands[511] + len(flying.of("PARAM_REQUEST_READ"))
        flights = set()
        for _ in range(40):
            await asyncio.sleep(0.02)
            flights.add(autopilot.condition.flying)
        assert flights == {True}
        assert len(flying.setpoints) == sent
        assert flying.commands[511] + len(flying.of("PARAM_REQUEST_READ")) <= asked + 10
        assert autopilot.connected
    assert sum("two autopilots have one id" in line for line in caplog.messages) == 1
    assert sum("connected again" in line for line in caplog.messages) == 0


async def test_of_two_that_fly_the_chosen_one_is_commanded() -> None:
    one, other = MiniatureAutopilot(system=1, mode="guided"), MiniatureAutopilot(system=2, mode="guided")
    async with routed() as (autopilot, _, url), one.talking_to(url), other.talking_to(url):
        await until(lambda: who_names(autopilot) == {"several-autopilots": True})
        with pytest.raises(Recoverable, match=r"system 1 .* system 2 .*vehicle\.system_id \(1 or 2\)"):
            autopilot.command(AHEAD)
        await asyncio.sleep(0.1)
        assert not one.setpoints
        assert not other.setpoints
    async with routed(system_id=2) as (autopilot, _, url), one.talking_to(url), other.talking_to(url):
        await until(lambda: autopilot.attitude is not None)
        assert autopilot.identity is not None
        assert autopilot.identity.system == 2
        autopilot.command(AHEAD)
        await until(lambda: bool(other.setpoints))
        assert not autopilot.id_conflicts


async def test_another_program_with_our_ids_is_named_and_an_echo_is_none() -> None:
    fake = MiniatureAutopilot()
    async with routed() as (autopilot, router, url), fake.talking_to(url):
        await until(lambda: autopilot.connected and autopilot.links.identity == (7, 191))
        sent = [m for m in fake.messages if m.get_srcComponent() == 191]
        for message in sent[:5]:
            router.send(bytes(message.get_msgbuf()))
        await asyncio.sleep(0.3)
        assert not autopilot.id_conflicts, "what comes back is our own"
        codec = Codec(7, 191, datagrams=True)
        codec._spoken[191] = 100
        for _ in range(4):
            router.send(codec.pack(mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)))
        await until(lambda: who_names(autopilot) == {"component-id-twice": False})
        autopilot.command(AHEAD)  # it is clear who is meant


async def test_requests_are_few_however_often_an_autopilot_boots(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(roster, "_REBOOT_S", 0.02)
    monkeypatch.setattr(autopilot_module, "_AGAIN_S", 0.3)
    fake = MiniatureAutopilot()
    async with routed() as (autopilot, _, url), fake.talking_to(url):
        await until(lambda: autopilot.streams is not None and autopilot.streams.settled)
        asked, rounds, began_s = fake.commands[511], autopilot.connects, fake.now_s
        for _ in range(12):
            fake.epoch_ns -= 3_000_000_000
            await asyncio.sleep(0.05)
        assert autopilot.boot_clock is not None
        assert autopilot.boot_clock.restarts >= 4
        begun = autopilot.connects - rounds
        assert 0 < begun <= 1 + (fake.now_s - began_s) / 0.3
        assert asked < fake.commands[511] <= asked + begun * 12
