"""The ship's reports through the whole service: over UDP or MAVLink in, the way to the ship out as setpoints."""

from __future__ import annotations

import asyncio
import math
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import msgspec
import numpy as np
import pytest

from companion.config.model import CameraSettings, Settings
from companion.config.settings import from_mapping, load
from companion.guidance.mission import State
from companion.runtime.make_pilot import make_pilot
from companion.runtime.missing_inputs import missing_inputs
from companion.runtime.pilot import Pilot
from companion.runtime.service import make_daemon
from drivers.clock import SystemClock
from drivers.mavlink.endpoint import parse_endpoint
from drivers.mavlink.links import LinkOptions, open_links
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from estimator.contracts.errors import BadInput
from estimator.contracts.geodesy import moved
from sitl.gnss import ORIGIN
from sitl.testing.fake_ardrone import until
from sitl.testing.fake_autopilot import FakeAutopilot, global_position

HOST = "127.0.0.1"
SHIP_NED = np.array([48.0, 36.0, -2.0])
SHIP = 42


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def settings_of(port: int, **vessel: object) -> Settings:
    settings = load("sim")
    vehicle = AutopilotOptions(links=f"udpin://{HOST}:{port}", command_period_s=0.02, vessel_id=0 if vessel else SHIP)
    rendezvous = msgspec.structs.replace(settings.guidance.rendezvous, enabled=True)
    return msgspec.structs.replace(
        settings,
        vehicle=vehicle,
        camera=CameraSettings(settings.camera.file),
        guidance=msgspec.structs.replace(settings.guidance, rendezvous=rendezvous, controller="pid"),
        vessel=msgspec.structs.replace(settings.vessel, **vessel),
        operator=msgspec.structs.replace(settings.operator, socket="off"),
    )


def sentence(body: str) -> bytes:
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"${body}*{check:02X}\r\n".encode()


def rmc(second: int) -> bytes:
    at = moved(ORIGIN, SHIP_NED)

    def part(angle_rad: float, width: int, letters: str) -> str:
        minutes = abs(math.degrees(angle_rad)) * 60.0
        return f"{int(minutes // 60):0{width}d}{minutes % 60.0:07.4f},{letters[angle_rad < 0.0]}"

    place = f"{part(at.latitude_rad, 2, 'NS')},{part(at.longitude_rad, 3, 'EW')}"
    return sentence(f"GPRMC,0818{second % 60:02d}.00,A,{place},004.0,090.0,130926,,")


@asynccontextmanager
async def flying(settings: Settings, port: int) -> AsyncIterator[tuple[Pilot, FakeAutopilot, Callable[[], tuple[str, ...]]]]:
    """The service with an autopilot in the air, 10 m up at the origin, and a landing ordered."""
    pilot = make_pilot(settings)
    daemon = make_daemon(settings, pilot)
    fake = FakeAutopilot(Stack.ARDUPILOT, mode="guided")
    fake.armed, fake.landed_state, fake.p_ned = True, 2, np.array([0.0, 0.0, -10.0])
    running = asyncio.create_task(daemon.run())
    try:
        async with fake.talking_to(f"udpout://{HOST}:{port}"):
            await until(lambda: pilot.state is not State.STANDBY)
            pilot.begin()
            yield pilot, fake, lambda: missing_inputs(daemon.health.snapshot())
    finally:
        daemon.stop()
        await running


def towards_ship(fake: FakeAutopilot) -> bool:
    """Whether the newest setpoint leads to the ship, with her velocity on top, and not down."""
    asked = fake.of("SET_POSITION_TARGET_LOCAL_NED")
    return bool(asked) and asked[-1].vz <= 0.0 and asked[-1].vx > 0.8 and asked[-1].vy > 2.0


async def test_sentences_over_udp_lead_the_drone_to_the_ship() -> None:
    port, nmea = free_port(), free_port()
    async with flying(settings_of(port, nmea=f"{HOST}:{nmea}"), port) as (pilot, fake, missing):
        assert "no place from the ship yet" in missing()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ship:
            for tenth in range(300):
                if tenth % 10 == 0:
                    ship.sendto(rmc(tenth // 10) + sentence("HEHDT,090.0,T"), (HOST, nmea))
                await asyncio.sleep(0.1)
                if towards_ship(fake):
                    break
        assert towards_ship(fake), (pilot.phase, pilot.reason, pilot.vessel_counts())
        assert pilot.state is State.RENDEZVOUS
        assert not [words for words in missing() if "ship" in words]
        assert pilot.vessel_counts()["taken"] >= 1


async def test_the_ship_s_own_mavlink_system_leads_it_there_and_no_other_system() -> None:
    port, clock = free_port(), SystemClock()
    link = LinkOptions(parse_endpoint(f"udpout://{HOST}:{port}"))

    async def send_for(system: int, seconds: float, fake: FakeAutopilot) -> None:
        async with open_links([link], clock, (system, 1)) as links:
            for _ in range(round(seconds / 0.1)):
                boot_ms = clock.now() // 1_000_000 & 0xFFFFFFFF
                links.send(global_position(boot_ms, SHIP_NED, np.array([0.0, 2.0, 0.0]), 90.0))
                await asyncio.sleep(0.1)
                if towards_ship(fake):
                    return

    async with flying(settings_of(port), port) as (pilot, fake, missing):
        await send_for(SHIP + 1, 1.0, fake)
        assert pilot.vessel_counts()["taken"] == 0
        assert "no place from the ship yet" in missing()
        await send_for(SHIP, 30.0, fake)
        assert towards_ship(fake), (pilot.phase, pilot.reason, pilot.vessel_counts())
        assert pilot.state is State.RENDEZVOUS


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"nmea": "10110"}, "nmea must be ADDRESS:PORT"),
        ({"nmea": "ship.local:10110"}, "nmea must be ADDRESS:PORT"),
        ({"nmea": "127.0.0.1:0"}, "the port must lie in 1 to 65535"),
        ({"mmsi": 211234560}, "belong to nmea"),
        ({"age_max_s": 20.0}, "forget_s"),
    ],
)
def test_a_source_that_cannot_be_is_refused(table: dict[str, object], said: str) -> None:
    data = {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}, "vessel": table}
    with pytest.raises(BadInput, match=said):
        from_mapping(data, "mine.toml")
