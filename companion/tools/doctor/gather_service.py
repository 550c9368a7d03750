"""Take a snapshot of the service itself: its files, camera, broker and drone, and its figures if it is running."""

import asyncio
import ssl
from collections.abc import Mapping

import aiohttp
from msgspec import structs
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.samples import Sample

from companion.base.health import HealthSnapshot
from companion.settings import files
from companion.settings.links import HttpSettings
from companion.settings.load import camera_model, pad_model
from companion.settings.model import Settings
from companion.settings.referenced_files import check_files
from companion.settings.remarks import contradiction, without_effect
from companion.tools.doctor.snapshot import GimbalSnapshot, ServiceSnapshot
from drivers.ardrone.options import ArDroneOptions
from drivers.camera.open_camera import open_camera
from estimator.contracts.errors import BadInput, DecklanderError
from estimator.contracts.time import Clock, seconds_between

_FIRST_FRAME_S = 5.0
"""Longest time until a camera's first frame, seconds."""
_WITHHELD = "withheld_"
_REFUSED = "refused_"
_PLACES = "ship_place"
_SHIP_SOURCES = (("sentences", "refused_"), ("bus", "refused_"), ("mqtt", "ship_reports_"))
"""Parts that read the ship's reports, and the beginning of the names of their counters of refused ones."""
_NOT_REFUSED = {"ship_reports_taken", "refused_other_sentence", "refused_other_message", "refused_other_ship"}
"""Counters among those that are no fault: a ship's network carries many other sentences."""


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


def running_service(settings: Settings, health: HealthSnapshot) -> ServiceSnapshot:
    """Return the snapshot of the service that runs in this process. It reads files, so it belongs on a thread."""
    snapshot = _files(settings)
    rates_hz = {kind: flow.rate_hz for kind, flow in health.flows.items() if flow.rate_hz is not None}
    medians_s = {stage: times.p50_s for stage, times in health.stages.items() if times.p50_s is not None}
    snapshot = _figures(snapshot, settings, health.counters, rates_hz, medians_s)
    if settings.mqtt.transport != "off":
        fault = _fault_of(health, "mqtt")
        snapshot = structs.replace(snapshot, broker=f"{settings.mqtt.host}:{settings.mqtt.port}", broker_fault=fault)
    if isinstance(settings.vehicle, ArDroneOptions):
        drone = f"{settings.vehicle.host}:{settings.vehicle.control_port}"
        snapshot = structs.replace(snapshot, drone=drone, drone_fault=_fault_of(health, "vehicle"))
    return snapshot


def _fault_of(health: HealthSnapshot, name: str) -> str | None:
    part = health.parts.get(name)
    return None if part is None or part.up or not part.last_error else part.last_error


def _files(settings: Settings) -> ServiceSnapshot:
    feet_m = None if isinstance(settings.vehicle, ArDroneOptions) else settings.guidance.cone.feet_below_m
    snapshot = ServiceSnapshot(ship_place=contradiction(settings), without_effect=without_effect(settings), feet_below_m=feet_m)
    try:
        check_files(settings)
    except BadInput as why:
        snapshot = structs.replace(snapshot, files_fault=str(why))
    try:
        model = camera_model(settings)
        pad_model(settings)
    except BadInput as why:
        return structs.replace(snapshot, camera_fault=str(why))
    return structs.replace(snapshot, camera_size=(model.width, model.height))


async def _from_settings(settings: Settings, clock: Clock, seconds: float, timeout_s: float) -> ServiceSnapshot:
    snapshot = _files(settings)
    if snapshot.camera_fault is not None:
        return snapshot
    vehicle = settings.vehicle
    if isinstance(vehicle, ArDroneOptions):
        fault = await _unreachable(vehicle.host, vehicle.control_port, timeout_s)
        snapshot = structs.replace(snapshot, drone=f"{vehicle.host}:{vehicle.control_port}", drone_fault=fault)
    scraped = await _scrape(settings, timeout_s)
    if scraped is not None:
        return _of_metrics(snapshot, settings, scraped)
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
    return _figures(snapshot, settings, counts, rates_hz, medians_s)


def _figures(
    snapshot: ServiceSnapshot,
    settings: Settings,
    counts: Mapping[str, Mapping[str, float]],
    rates_hz: Mapping[str, float],
    medians_s: Mapping[str, float],
) -> ServiceSnapshot:
    """Return the snapshot with a running service's figures: counters by part and name, rates by kind, medians by stage."""
    counted = {name: value for part in counts.values() for name, value in part.items()}
    places = {name: int(value) for name, value in counts.get(_PLACES, {}).items()}
    taken = places.pop("taken", None)
    sent, ranges = counted.get("targets_sent"), counted.get("sends_ranges")
    return structs.replace(
        snapshot,
        frame_rate_hz=rates_hz.get("Frame"),
        exposure_to_belief_s=medians_s.get("exposure_to_belief"),
        targets_sent=None if sent is None else int(sent),
        sends_ranges=None if ranges is None else bool(ranges),
        places_taken=taken,
        gimbal=_gimbal(settings, counts.get("gimbal", {}), rates_hz),
        exposure=dict(counts.get("exposure", {})),
        places_refused=_sources_refused(counts) | {name.replace("_", " "): n for name, n in places.items()},
        withheld={
            name.removeprefix(_WITHHELD).replace("_", " "): int(n) for name, n in counted.items() if name.startswith(_WITHHELD)
        },
    )


def _gimbal(settings: Settings, counts: Mapping[str, float], rates_hz: Mapping[str, float]) -> GimbalSnapshot | None:
    if not settings.camera.gimbal.given:
        return None
    refused = {name.removeprefix(_REFUSED): int(n) for name, n in counts.items() if name.startswith(_REFUSED)}
    return GimbalSnapshot(settings.camera.gimbal.device_id, rates_hz.get("GimbalAttitude", 0.0), refused)


def _sources_refused(counts: Mapping[str, Mapping[str, float]]) -> dict[str, int]:
    """Return the number of sentences and reports of the ship that were refused before they gave a place, by reason."""
    out: dict[str, int] = {}
    for part, prefix in _SHIP_SOURCES:
        for name, value in counts.get(part, {}).items():
            if name.startswith(prefix) and name not in _NOT_REFUSED:
                why = name.removeprefix(prefix).replace("_", " ")
                out[why] = out.get(why, 0) + int(value)
    return out


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
