"""Faults of frames and of the link behind real sockets: what a client of the simulated drone sees of them."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import ExitStack
from typing import cast

import pytest

from drivers.ardrone import at
from drivers.ardrone.navdata import ControlState
from drivers.clock import SystemClock
from sitl.emulators.ardrone.server import ArDroneServer, Ports
from sitl.faults.kinds import FrameStream, LinkLost
from sitl.world.world import World
from tests.sitl.ardrone.peer import Peer, Watcher
from tests.sitl.ardrone.point_mass import PointMass

HOST = "127.0.0.1"
FLY = at.Ref(at.REF_BASE | at.REF_TAKE_OFF)


@pytest.fixture
def world() -> PointMass:
    return PointMass(SystemClock().now())


@pytest.fixture
async def server(world: PointMass) -> AsyncIterator[ArDroneServer]:
    async with ArDroneServer(cast(World, world), HOST, Ports(0, 0, 0, 0)) as server:
        yield server


async def test_wrong_stamps_late_frames_and_a_lost_link_reach_the_wire(server: ArDroneServer, world: PointMass) -> None:
    with ExitStack() as stack:
        peer = Peer(HOST, server.ports)
        stack.callback(peer.close)
        watcher = Watcher(HOST, server.ports)
        stack.callback(watcher.close)
        await meets_every_fault(server, world, peer, watcher)


async def meets_every_fault(server: ArDroneServer, world: PointMass, peer: Peer, watcher: Watcher) -> None:
    peer.ask()
    await peer.configure("general:navdata_demo", "FALSE")
    true_ms = (await watcher.frame()).header.timestamp_ms
    world.stamp_error_s = 5.0
    async with asyncio.timeout(60):
        while (ahead_ms := (await watcher.frame()).header.timestamp_ms) < true_ms + 4000:
            pass
    world.stamp_error_s = 0.0
    world.failing.now = [FrameStream(at_s=0.0, delay_s=0.4)]
    async with asyncio.timeout(60):
        while (frame := (await watcher.frame()).header).timestamp_ms >= ahead_ms - 1000 or frame.timestamp_ms < true_ms:
            pass
    while server._drone_clock.milliseconds(server._clock.now()) - (await watcher.frame()).header.timestamp_ms < 400:
        pass
    numbers = [(await watcher.frame()).header.frame_number for _ in range(4)]
    world.failing.now = []
    numbers += [(await watcher.frame()).header.frame_number for _ in range(12)]
    assert numbers == sorted(numbers), "what follows a late frame waits behind it"
    world.failing.now = [LinkLost(at_s=0.0)]
    await asyncio.sleep(0.1)
    measured_at, sent = server.drone.state.counters["at_taken"], server.counters["navdata_sent"]
    peer.say(FLY)
    await asyncio.sleep(0.2)
    assert (server.drone.state.counters["at_taken"], server.counters["navdata_sent"]) == (measured_at, sent)
    world.failing.now = []
    peer.ask()  # on a busy machine its lease has run out meanwhile
    peer.say(FLY)
    await peer.until(lambda n: n.control_state is ControlState.HOVERING)
