"""Take a snapshot of the service from outside: its files, camera, broker, drone and ship, and its figures if it is running."""

import asyncio
import ssl
from collections.abc import Awaitable, Callable
from contextlib import suppress

import aiohttp
from msgspec import structs
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.samples import Sample

from companion.settings import files
from companion.settings.links import HttpSettings
from companion.settings.model import Settings
from companion.settings.vessel import VesselOptions
from companion.tools.doctor.gather_service import figures, files_of, ship_sources
from companion.tools.doctor.snapshot import ServiceSnapshot, ShipSource
from drivers.ardrone.options import ArDroneOptions
from drivers.camera.open_camera import open_camera
from drivers.endpoint import NMEA2000, parse_bus, require_ship
from drivers.nmea.sentences import NmeaReader, by_source
from drivers.nmea.ship_bus import BusReader
from drivers.nmea.ship_sensors import ShipSensors
from drivers.nmea.ship_wires import read_bus
from drivers.nmea.transport import SentenceSource, sentences_from
from drivers.one_source import SourceChoice
from estimator.contracts.errors import DecklanderError
from estimator.contracts.time import Clock, seconds_between

_FIRST_FRAME_S = 5.0
"""Longest time until a camera's first frame, seconds."""
_LONGER = 2.5
"""Time of listening to the ship, whose receivers report once a second, against that of counting frames."""


async def examine_service(
    settings: Settings | None, broker: str | None, clock: Clock, seconds: float = 2.0, timeout_s: float = 2.0
) -> ServiceSnapshot:
    """Check files, broker and drone; read the metrics of a running service, or else count the camera's frames.

    Args:
        broker: HOST:PORT of the broker to check; None for the one in the settings.
        seconds: how long to count the camera's frames.
    """
    snapshot = ServiceSnapshot()
    if settings is not None:
        snapshot = await _from_settings(settings, clock, seconds, timeout_s)
        if broker is None and settings.mqtt.transport != "off":
            broker = f"{settings.mqtt.host}:{settings.mqtt.port}"
    if broker is None:
        return snapshot
    host, _, port = broker.rpartition(":")
    fault = await _unreachable(host or broker, int(port) if host else 1883, timeout_s)
    return structs.replace(snapshot, broker=broker, broker_fault=fault)


async def _from_settings(settings: Settings, clock: Clock, seconds: float, timeout_s: float) -> ServiceSnapshot:
    snapshot = files_of(settings)
    if snapshot.camera_fault is not None:
        return snapshot
    vehicle = settings.vehicle
    if isinstance(vehicle, ArDroneOptions):
        fault = await _unreachable(vehicle.host, vehicle.control_port, timeout_s)
        snapshot = structs.replace(snapshot, drone=f"{vehicle.host}:{vehicle.control_port}", drone_fault=fault)
    scraped = await _scrape(settings, timeout_s)
    if scraped is not None:
        return _of_metrics(snapshot, settings, scraped)
    sources, fault = await listen(settings.vessel, clock, seconds)
    snapshot = structs.replace(snapshot, ship_sources=sources, ship_fault=fault)
    return await _of_camera(snapshot, settings, clock, seconds)


async def _of_camera(snapshot: ServiceSnapshot, settings: Settings, clock: Clock, seconds: float) -> ServiceSnapshot:
    try:
        if settings.camera.source == "vehicle":
            return snapshot
        async with open_camera(settings.camera, snapshot.camera_size, clock) as camera:
            try:
                async with asyncio.timeout(_FIRST_FRAME_S):
                    frame = await camera.frames.get()
            except TimeoutError:
                return structs.replace(snapshot, device_fault=camera.down or camera.damage or "it sends no frame")
            height, width = frame.px.shape[:2]
            began, before = clock.now(), camera.counters.frames
            await clock.sleep(seconds)
            rate_hz = (camera.counters.frames - before) / seconds_between(began, clock.now())
    except DecklanderError as why:
        return structs.replace(snapshot, device_fault=str(why))
    return structs.replace(snapshot, device_fault=camera.damage, frame_size=(width, height), frame_rate_hz=rate_hz)


async def _scrape(settings: Settings, timeout_s: float) -> list[Sample] | None:
    """Return the metrics of the running service; None if nothing answers."""
    http = settings.http
    if http.endpoint == "off":
        return None
    host = "127.0.0.1" if http.host in ("0.0.0.0", "::") else http.host
    token = files.text(http.token_file, "http", "token_file")
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    try:
        async with (
            aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(timeout_s)) as session,
            session.get(f"{http.endpoint}://{host}:{http.port}/metrics", headers=headers, ssl=_our_own(http)) as answer,
        ):
            answer.raise_for_status()
            page = await answer.text()
        return [sample for family in text_string_to_metric_families(page) for sample in family.samples]
    except (OSError, TimeoutError, aiohttp.ClientError, ValueError):
        return None


def _our_own(http: HttpSettings) -> ssl.SSLContext | bool:
    """Return how to check that our own service answers: it has the certificate of the settings, whatever name that is for."""
    if http.endpoint == "http":
        return True
    certificate = files.find(http.certificate_file, "http.certificate_file")
    context = ssl.create_default_context(cafile=certificate)
    context.check_hostname = False
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


def _of_metrics(snapshot: ServiceSnapshot, settings: Settings, scraped: list[Sample]) -> ServiceSnapshot:
    counts: dict[str, dict[str, float]] = {}
    for s in scraped:
        if s.name == "decklander_count":
            counts.setdefault(s.labels["part"], {})[s.labels["name"]] = s.value
    rates_hz = {s.labels["kind"]: s.value for s in scraped if s.name == "decklander_item_rate_hertz"}
    medians_s = {
        s.labels["stage"]: s.value for s in scraped if s.name == "decklander_stage_seconds" and s.labels["quantile"] == "0.5"
    }
    return figures(snapshot, settings, counts, rates_hz, medians_s)


async def listen(options: VesselOptions, clock: Clock, seconds: float) -> tuple[tuple[ShipSource, ...], str | None]:
    """Listen to her for some seconds as the service does; return her sources, and why one of the ways to her is closed."""
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
            require_ship(f"vessel.bus {options.bus}", NMEA2000)
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
    return found, "; ".join(faults) or None


async def _unreachable(host: str, port: int, timeout_s: float) -> str | None:
    """Return why a TCP connection fails; None if it succeeds."""
    try:
        async with asyncio.timeout(timeout_s):
            _, writer = await asyncio.open_connection(host, port)
    except TimeoutError:
        return f"no answer within {timeout_s:g} s"
    except OSError as why:
        return why.strerror or str(why)
    writer.close()
    return None
