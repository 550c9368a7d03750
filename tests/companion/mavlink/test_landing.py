"""A whole landing through MAVLink alone: the daemon with its eyes and guidance, a pad on a ship, commanded from the ground."""

import asyncio
import math
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import numpy as np
import pytest

import companion.settings.load as settings_of
from companion.base.health import Health
from companion.base.mission import FlightOutcome
from companion.guidance.make_pilot import make_pilot
from companion.parts.mavlink.make import AutopilotPart
from companion.service.daemon import Daemon, DaemonSetup, VehicleLink
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import mav
from drivers.mavlink.options import AutopilotOptions
from sitl.emulators.autopilots.lock_step import LockStepClock
from tests.companion.mavlink.aircraft import TICK_S, Aircraft, wait_until_calm
from tests.support.waiting import until

HOST = "127.0.0.1"
FRAME_EVERY = 8
"""Ticks: 12.5 frames a second."""
SETTINGS = {
    "vehicle": {"kind": "mavlink", "links": f"udpin://{HOST}:0", "command_period_s": 0.02},
    "camera": {"file": "sim"},
    "pad": {"file": "thesis"},
    "vision": {"colours": "simulator"},
    "estimator": {"path": "dead_reckoning"},
    "guidance": {"start": "signal", "mission": "thesis", "thesis": {"approach_height_m": 1.4, "speed_m_s": 0.6}},
    "service": {"health_period_s": 0.0},
}


async def test_commanded_flown_and_landed_over_mavlink_only() -> None:
    clock = LockStepClock()
    loaded = settings_of.from_mapping(SETTINGS, "test")
    pilot = make_pilot(loaded)
    craft = Aircraft(clock, "demo", height_m=1.8, forward_m=0.3, right_m=-0.2)
    crossed: Counter[tuple[str, str]] = Counter()
    health = Health(clock)
    assert isinstance(loaded.vehicle, AutopilotOptions)
    part = AutopilotPart(
        loaded, loaded.vehicle, pilot, health, clock, tap=lambda at, link, way, data, name: crossed.update([(way, name)])
    )
    opened: list[Autopilot] = []

    @asynccontextmanager
    async def open_link() -> AsyncIterator[VehicleLink]:
        async with part.open() as link:
            assert isinstance(link, Autopilot)
            opened.append(link)
            yield link

    daemon = Daemon(
        open_link, pilot, clock, DaemonSetup(loaded.service, 50.0, once=True), observers=(part.component,), health=health
    )
    outcomes: list[FlightOutcome | None] = []

    async def serve() -> None:
        outcomes.append(await daemon.run())

    async with asyncio.TaskGroup() as group:
        group.create_task(serve())
        await until(lambda: bool(opened) and opened[0].links.all[0].local is not None)
        autopilot = opened[0]
        host, port = autopilot.links.all[0].local or ("", 0)
        async with craft.talking_to(f"udpout://{host}:{port}"):
            await until(lambda: craft.links is not None and craft.links.all[0].down is None)
            assert craft.links is not None
            for tick in range(6000):
                clock.advance(TICK_S)
                craft.fly()
                if tick % FRAME_EVERY == 0:
                    autopilot.frames.offer(craft.frame())
                if tick == 300:
                    craft.send(mav.MAVLink_command_long_message(7, 191, mav.MAV_CMD_NAV_LAND, 0, 0, 0, 0, 0, 0, 0, 0))
                await wait_until_calm(
                    craft.links,
                    autopilot.links,
                    also=lambda: sum(daemon.health.frames.values()) == craft.images,
                    over=lambda: bool(outcomes),
                )
                if outcomes:
                    break
    assert outcomes == [FlightOutcome.LANDED]
    landing = craft.body.landing()
    assert landing is not None
    assert landing.on_deck
    assert landing.lateral_m < 0.2
    assert landing.speed_m_s < 0.8
    assert landing.yaw_rad == pytest.approx(math.radians(30.0), abs=0.1), "the heading of the start is kept"

    percents = [m.progress for m in craft.of("COMMAND_ACK") if m.command == mav.MAV_CMD_NAV_LAND]
    assert len(percents) > 3, "the landing reports on"
    assert len(craft.told_off_m) > 100
    assert np.median(craft.told_off_m) < 0.06, "what was told of the pad is where it is"
    assert crossed["in", "ATTITUDE_QUATERNION"] > 1000
    assert crossed["out", "LANDING_TARGET"] == len(craft.of("LANDING_TARGET"))
    assert health.snapshot().counters["mavlink"]["bytes_out"] > 10_000
