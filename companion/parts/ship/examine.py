"""Listen to the ship for the doctor."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from msgspec import structs

from companion.parts.ship.options import WiredVessel
from companion.settings.model import Settings
from companion.tools.doctor.gather_service import ship_sources
from companion.tools.doctor.snapshot import ServiceSnapshot
from drivers.endpoint import parse_bus
from drivers.extras import require
from drivers.nmea.sentences import NmeaReader, by_source
from drivers.nmea.ship_bus import BusReader
from drivers.nmea.ship_sensors import ShipSensors
from drivers.nmea.ship_wires import read_bus
from drivers.nmea.transport import SentenceSource, sentences_from
from drivers.one_source import SourceChoice
from estimator.contracts.errors import DecklanderError
from estimator.contracts.time import Clock

_LONGER = 2.5
"""Time of listening to the ship, whose receivers report once a second, against that of counting frames."""


async def examine(snapshot: ServiceSnapshot, settings: Settings, clock: Clock, seconds: float) -> ServiceSnapshot:
    """Listen to her for some seconds as the service does; note her sources, and why one of the ways to her is closed."""
    options = settings.of(WiredVessel)
    choice, faults, taken = SourceChoice(), list[str](), list[object]()
    reader = NmeaReader(options.mmsi, options.nmea_simulated, choice)
    source = SentenceSource(options.nmea_from, lambda lines, at: taken.extend(reader.samples(lines, at)))
    sensors = ShipSensors(options.nmea_simulated, choice)
    seconds *= _LONGER

    async def sentences() -> None:
        async with sentences_from(options.endpoint(), source, clock):
            await clock.sleep(seconds)

    async def bus() -> None:
        address = parse_bus(options.bus)
        if address.signalk is None:
            require(f"vessel.bus {options.bus}", "ship", "nmea2000", "can")
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await read_bus(address, BusReader(sensors), lambda samples: None, clock, lambda: None)

    async def noted(body: Callable[[], Awaitable[None]]) -> None:
        try:
            await body()
        except DecklanderError as why:
            faults.append(str(why))

    # At once, as the service does: a source that rests would seem silent, and another one chosen.
    await asyncio.gather(*[noted(body) for given, body in ((options.nmea, sentences), (options.bus, bus)) if given])
    now = clock.now()
    refused = {f"refused_{why}": float(n) for why, n in (reader.refused + source.refused).items()}
    found = ship_sources({"sentences": by_source(reader.sources, now) | refused, "bus": by_source(sensors.sources, now)})
    if (options.nmea or options.bus) and not found and not faults:
        faults.append(f"nothing of the ship arrives within {seconds:g} s")
    return structs.replace(snapshot, ship_sources=found, ship_fault="; ".join(faults) or None)
