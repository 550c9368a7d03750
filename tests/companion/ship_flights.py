"""The service beside a fake autopilot in the air, and what a ship tells it of her place."""

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import msgspec
import numpy as np

from companion.base.health import missing_inputs
from companion.base.mission import State
from companion.guidance.make_pilot import make_pilot
from companion.guidance.pilot import Pilot
from companion.service.assemble import make_daemon
from companion.service.daemon import Daemon
from companion.settings.load import load
from companion.settings.model import CameraSettings, Settings
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from estimator.contracts.geodesy import GeoPoint, moved
from estimator.contracts.geometry import F64
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.sensors.sensors import ORIGIN
from tests.support.waiting import until

HOST = "127.0.0.1"
SHIP_NED = np.array([48.0, 36.0, -2.0])
SHIP = 42
VELOCITY = 0x05C7
"""The mask of a setpoint that holds a velocity and a rate of turn."""


def settings_of(port: int, **vessel: object) -> Settings:
    """Return settings with an autopilot on a port; the ship reports over its link unless `[vessel]` is given."""
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


def sentence(body: str, start: str = "$") -> bytes:
    """Return a sentence with its checksum."""
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"{start}{body}*{check:02X}\r\n".encode()


def place_of(p_ned: F64) -> GeoPoint:
    """Return the place of a point of the simulated world, (3,) m."""
    return moved(ORIGIN, p_ned)


def rmc(at_s: float, p_ned: F64 = SHIP_NED, speed_kn: float = 4.0) -> bytes:
    """Return the ship's sentence at a time of the minute, s; she sails to the east."""
    at = place_of(p_ned)

    def part(angle_rad: float, width: int, letters: str) -> str:
        minutes = abs(math.degrees(angle_rad)) * 60.0
        return f"{int(minutes // 60):0{width}d}{minutes % 60.0:08.5f},{letters[angle_rad < 0.0]}"

    place = f"{part(at.latitude_rad, 2, 'NS')},{part(at.longitude_rad, 3, 'EW')}"
    return sentence(f"GPRMC,0818{at_s % 60.0:05.2f},A,{place},{speed_kn:05.1f},090.0,130926,,")


@dataclass(frozen=True)
class Flying:
    """The running service and its autopilot."""

    daemon: Daemon
    pilot: Pilot
    fake: MiniatureAutopilot

    def missing(self) -> tuple[str, ...]:
        return missing_inputs(self.daemon.health.snapshot())

    def counted(self, part: str) -> dict[str, float]:
        return dict(self.daemon.health.snapshot().counters.get(part, {}))

    @property
    def setpoints(self) -> list[F64]:
        """The commanded velocities, (3,) m/s in ned, oldest first."""
        return [np.array([m.vx, m.vy, m.vz]) for m in self.fake.of("SET_POSITION_TARGET_LOCAL_NED") if m.type_mask == VELOCITY]

    def towards_ship(self) -> bool:
        """Return whether the newest setpoint leads to the ship, with her velocity on top, and not down."""
        asked = self.setpoints
        return bool(asked) and asked[-1][2] <= 0.0 and asked[-1][0] > 0.8 and asked[-1][1] > 2.0


@asynccontextmanager
async def flying(settings: Settings, port: int) -> AsyncIterator[Flying]:
    """Yield the service with an autopilot in the air, 10 m up at the origin, and a landing ordered."""
    pilot = make_pilot(settings)
    daemon = make_daemon(settings, pilot)
    fake = MiniatureAutopilot(Stack.ARDUPILOT, mode="guided")
    fake.armed, fake.landed_state, fake.p_ned = True, 2, np.array([0.0, 0.0, -10.0])
    running = asyncio.create_task(daemon.run())
    try:
        async with fake.talking_to(f"udpout://{HOST}:{port}"):
            await until(lambda: pilot.state is not State.STANDBY)
            pilot.begin()
            yield Flying(daemon, pilot, fake)
    finally:
        daemon.stop()
        await running
