"""The ship's reports through the whole service: over UDP or MAVLink in, the way to the ship out as setpoints that are flown."""

import asyncio
import itertools
import math
import re
import socket
import time
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from companion.base.mission import State
from companion.parts.metrics import endpoint
from companion.settings.load import from_mapping
from drivers.clock import SystemClock
from drivers.endpoint import parse_endpoint
from drivers.mavlink.links import LinkOptions, open_links
from drivers.nmea.sentences import KNOT_M_S, REFUSED_FOR
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from sitl.emulators.autopilots.stand_in.base import global_position
from tests.companion.ship_flights import HOST, SHIP, SHIP_NED, Flying, flying, rmc, sentence, settings_of
from tests.support.waiting import free_port, until


async def test_the_ship_s_own_mavlink_system_leads_it_there_and_no_other_system() -> None:
    port, clock = free_port(), SystemClock()
    link = LinkOptions(parse_endpoint(f"udpout://{HOST}:{port}"))

    async def send_for(system: int, seconds: float, service: Flying) -> None:
        async with open_links([link], clock, (system, 1)) as links:
            for _ in range(round(seconds / 0.1)):
                boot_ms = clock.now() // 1_000_000 & 0xFFFFFFFF
                links.send(global_position(boot_ms, SHIP_NED, np.array([0.0, 2.0, 0.0]), 90.0))
                await asyncio.sleep(0.1)
                if service.towards_ship():
                    return

    async with flying(settings_of(port), port) as service:
        await send_for(SHIP + 1, 1.0, service)
        assert service.pilot.landing.vessel_counts()["taken"] == 0
        assert "no place from the ship yet" in service.missing()
        await send_for(SHIP, 30.0, service)
        assert service.towards_ship(), (service.pilot.phase, service.pilot.landing.reason, service.pilot.landing.vessel_counts())
        assert service.pilot.state is State.RENDEZVOUS


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
