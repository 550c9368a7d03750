"""The ship's reports through the whole service: over UDP in, the way to the ship out as setpoints that are flown."""

import asyncio
import itertools
import math
import re
import socket
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import msgspec
import numpy as np
import pytest
from msgspec import Struct

from companion.base.health import missing_inputs
from companion.base.mission import State
from companion.guidance.pilot import Pilot, make_pilot
from companion.parts.metrics import endpoint
from companion.service.assemble import make_daemon
from companion.service.daemon import Daemon
from companion.settings.load import load
from companion.settings.model import CameraSettings, Settings
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from drivers.nmea.fields import KNOT_M_S
from drivers.ship_reports import REFUSED_FOR
from estimator.contracts.geometry import F64, GeoPoint, moved
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.sensors.sensors import ORIGIN
from tests.support.waiting import free_port, until

HOST = "127.0.0.1"
SHIP_NED = np.array([48.0, 36.0, -2.0])
VELOCITY = 0x05C7
"""The mask of a setpoint that holds a velocity and a rate of turn."""


def settings_of(port: int, **vessel: object) -> Settings:
    """Return settings with an autopilot on a port and these of `[vessel]`."""
    settings = load("sim")
    vehicle = AutopilotOptions(links=f"udpin://{HOST}:{port}", command_period_s=0.02)
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


class Flying(Struct, frozen=True):
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


GARBAGE = {
    b"\x00\xff\x80 no sentence\r\n": "checksum",
    b"$GPRMC,0818": "cut",
    sentence("GPRMC,081836.00,A,9924.0180,N,01012.0660,E,002.9,004.0,211126,,"): "impossible",
    sentence("GPRMC,,V,,,,,,,211126,,"): "no_fix",
    sentence("GPRMC,noon,A,5424.0180,N,01012.0660,E,slow,,,,"): "malformed",
    sentence("AIVDM,1,1,,A,139Lg0?P0O0fdB0O8<01i1NIP000,0", "!"): "other_ship",
    b"$" + b"x" * 4000 + b"\r\n": "too_long",
}
"""Datagrams from the ship that are no place of hers, and what they are counted as."""


async def test_among_garbage_it_flies_astern_of_her_searches_and_waits_level_when_she_falls_silent(caplog):
    """The way of the whole service, from datagrams to a vehicle that moves."""
    port, nmea, speed_m_s = free_port(), free_port(), 2.0
    settings = settings_of(port, nmea=f"{HOST}:{nmea}", age_max_s=2.0)
    way = msgspec.structs.replace(
        settings.guidance.rendezvous, range_m=6.0, reached_m=3.0, speed_m_s=8.0, search_speed_m_s=3.0, lost_s=1.5
    )
    settings = msgspec.structs.replace(settings, guidance=msgspec.structs.replace(settings.guidance, rendezvous=way))
    begun = time.monotonic()

    def ship_s_place() -> F64:
        return np.array([30.0, 20.0 + speed_m_s * (time.monotonic() - begun), 0.0])

    async def tell(wire: socket.socket, enough: Callable[[], bool]) -> None:
        for datagram in itertools.cycle(GARBAGE):
            wire.sendto(datagram, (HOST, nmea))
            wire.sendto(rmc(time.monotonic() - begun, ship_s_place(), speed_m_s / KNOT_M_S), (HOST, nmea))
            await asyncio.sleep(0.15)
            if enough():
                return

    async with flying(settings, port) as service, asyncio.timeout(60):
        fake, pilot = service.fake, service.pilot
        with udp() as ship, udp() as forger:
            await tell(ship, lambda: pilot.state is State.RENDEZVOUS)
            forger.bind(("127.0.0.2", 0))
            forger.sendto(rmc(30.0, np.array([-900.0, 0.0, 0.0])), (HOST, nmea))
            told_m: list[tuple[float, float]] = []

            def arrives() -> bool:
                if output := re.search(r"the vessel is (\d+) m away", pilot.landing.reason):
                    told_m.append((float(output[1]), math.hypot(*(fake.p_ned - ship_s_place())[:2])))
                return pilot.state is State.SEARCH

            await tell(ship, arrives)
            assert max(reported for reported, _ in told_m) - min(reported for reported, _ in told_m) > 5.0
            assert all(reported == pytest.approx(true_m, abs=8.0) for reported, true_m in told_m), told_m
            from_astern = (fake.p_ned - ship_s_place())[:2] - (0.0, -way.range_m)
            assert math.hypot(*from_astern) < way.reached_m + 2.0, "the hold-off point"
            await tell(ship, lambda: math.hypot(*(fake.p_ned - ship_s_place())[:2]) < 2.5)
        assert pilot.state is State.SEARCH
        await until(lambda: pilot.state is State.REFUSED)
        assert "no rendezvous: the ship's newest place is" in pilot.landing.reason
        assert fake.p_ned[2] <= -10.0
        assert all(v[2] <= 0.0 for v in service.setpoints)
        counted = service.counted("sentences")
        assert len(GARBAGE) < service.counted("ship_place")["taken"] <= counted["taken_RMC"]
        metrics = endpoint.text(service.daemon.health.snapshot()).decode()
    for reason in {*GARBAGE.values(), "wrong_sender"}:
        assert counted[f"refused_{reason}"] >= 1
        assert f'name="refused_{reason}",part="sentences"' in metrics
    for reason in set(GARBAGE.values()):
        words = REFUSED_FOR.get(reason, reason.replace("_", " "))
        reported = [line for line in caplog.messages if f"was refused ({words})" in line]
        assert len(reported) == 1, reason
    assert any("are refused, those from" in line for line in caplog.messages)
    assert len([line for line in caplog.messages if line.startswith("rendezvous: the vessel is")]) <= 2, "not at every metre"


def udp() -> socket.socket:
    return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
