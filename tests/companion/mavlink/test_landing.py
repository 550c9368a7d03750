"""A whole landing through MAVLink alone: the daemon with its eyes and guidance, a pad on a ship, commanded from the ground."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import numpy as np

import companion.settings as settings_of
from companion import rig
from companion.daemon import Daemon, Link
from companion.mavlink.component import Component, ComponentOptions, speaking
from companion.mavlink.outputs import OutputOptions
from companion.mavlink.pilot_operator import PilotTower
from companion.pilot import Outcome
from companion.service import make_pilot
from drivers.mavlink.autopilot import Autopilot, AutopilotOptions, open_autopilot
from drivers.mavlink.dialect import mav
from drivers.mavlink.endpoint import parse_endpoint
from drivers.mavlink.links import LinkOptions
from tests.companion.mavlink.aircraft import TICK_S, Aircraft, VirtualClock, settled
from tests.drivers.fake_ardrone import until

HOST = "127.0.0.1"
FRAME_EVERY = 8
"""Ticks: 12.5 pictures a second."""
SETTINGS = {
    "vehicle": {"kind": "ardrone"},
    "camera": {"file": "sim"},
    "pad": {"file": "thesis"},
    "vision": {"colours": "simulator"},
    "estimator": {"path": "dead_reckoning"},
    "guidance": {"start": "signal", "planner": {"approach_height_m": 1.4, "speed_m_s": 0.6, "slow_floor": 0.3}},
    "service": {"health_period_s": 0.0},
}


async def test_commanded_flown_and_landed_over_mavlink_only() -> None:
    clock = VirtualClock()
    loaded = settings_of.from_mapping(SETTINGS, "test")
    pilot = make_pilot(loaded)
    craft = Aircraft(clock, "demo", height_m=1.8, forward_m=0.3, right_m=-0.2)
    tower = PilotTower(pilot, lambda: component.belief)
    component = Component(ComponentOptions(OutputOptions(pad_radius_m=0.39)), tower, None, healthy=lambda: None, clock=clock)
    options = AutopilotOptions((LinkOptions(parse_endpoint(f"udpin://{HOST}:0")),), period_s=0.02)
    opened: list[Autopilot] = []

    @asynccontextmanager
    async def open_link() -> AsyncIterator[Link]:
        async with open_autopilot(options, clock) as autopilot, speaking(component, autopilot, clock):
            opened.append(autopilot)
            yield autopilot

    daemon = Daemon(
        open_link, pilot, clock, restart=rig.restart(loaded), guidance_rate_hz=50.0, observers=(component,), once=True
    )
    outcomes: list[Outcome | None] = []

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
                await settled(
                    craft.links,
                    autopilot.links,
                    also=lambda: sum(daemon.health.frames.values()) == craft.pictures,
                    over=lambda: bool(outcomes),
                )
                if outcomes:
                    break
    assert outcomes == [Outcome.LANDED]
    landing = craft.body.landing()
    assert landing is not None
    assert landing.on_deck
    assert landing.lateral_m < 0.2
    assert landing.speed_m_s < 0.8

    percents = [m.progress for m in craft.of("COMMAND_ACK") if m.command == mav.MAV_CMD_NAV_LAND]
    assert len(percents) > 3, "the landing reports on"
    assert len(craft.told_off_m) > 100
    assert np.median(craft.told_off_m) < 0.06, "what was told of the pad is where it is"
