"""Take a snapshot of the service itself: its files, and its figures."""

from collections.abc import Mapping

from msgspec import structs

from companion.base.health import HealthSnapshot
from companion.settings.load import camera_model, lens_assumed
from companion.settings.model import Settings
from companion.settings.referenced_files import check_files
from companion.settings.remarks import contradiction, without_effect
from companion.settings.sound import beyond_sound
from companion.tools.doctor.snapshot import UNREADABLE, GimbalSnapshot, ServiceSnapshot, ShipSource
from estimator.contracts.errors import BadInput

_WITHHELD = "withheld_"
_REFUSED = "refused_"
_PLACES = "ship_place"
_SHIP_SOURCES = (("sentences", "refused_"), ("bus", "refused_"), ("mqtt", "ship_reports_"))
"""Parts that read the ship's reports, and the beginning of the names of their counters of refused ones."""
_NOT_REFUSED = {
    "ship_reports_taken",
    "refused_other_receiver",
    "refused_other_sentence",
    "refused_other_message",
    "refused_other_ship",
}
"""Counters among those that are no fault: a ship's network carries many other sentences."""
_READERS = ("sentences", "bus")
"""Parts of the service that read the ship's reports."""
_NAMELESS = ("checksum", "cut", "wrong_sender", "too_long", "torn")
"""Reasons for which a report has no source."""


def running_service(settings: Settings, health: HealthSnapshot) -> ServiceSnapshot:
    """Return the snapshot of the service that runs in this process. It reads files, so it belongs on a thread."""
    snapshot = files_of(settings)
    rates_hz = {kind: flow.rate_hz for kind, flow in health.flows.items() if flow.rate_hz is not None}
    medians_s = {stage: times.p50_s for stage, times in health.stages.items() if times.p50_s is not None}
    snapshot = figures(snapshot, settings, health.counters, rates_hz, medians_s)
    for host, port in servers_of(settings):
        snapshot = structs.replace(snapshot, broker=f"{host}:{port}", broker_fault=_fault_of(health, "mqtt"))
    if (probe := settings.vehicle.probe) is not None:
        snapshot = structs.replace(snapshot, drone=f"{probe[0]}:{probe[1]}", drone_fault=_fault_of(health, "vehicle"))
    return snapshot


def servers_of(settings: Settings) -> list[tuple[str, int]]:
    """Return host and port of the servers that capabilities connect to."""
    return [table.server for table in settings.part_tables() if table.server is not None]


def _fault_of(health: HealthSnapshot, name: str) -> str | None:
    part = health.parts.get(name)
    return None if part is None or part.up or not part.last_error else part.last_error


def files_of(settings: Settings) -> ServiceSnapshot:
    """Return the snapshot of the files that settings name. It reads them, so it belongs on a thread."""
    feet_m = None if settings.vehicle.has_default_feet else settings.guidance.cone.feet_below_m
    snapshot = ServiceSnapshot(ship_place=contradiction(settings), without_effect=without_effect(settings), feet_below_m=feet_m)
    if (switch := settings.operator.switch).channel and feet_m is not None:
        orders = (switch.low, switch.middle, switch.high)
        snapshot = structs.replace(snapshot, switch=orders, switch_channel=switch.channel)
    try:
        check_files(settings)
    except BadInput as why:
        snapshot = structs.replace(snapshot, files_fault=str(why))
    try:
        model = camera_model(settings)
        wide = beyond_sound(settings)
    except BadInput as why:
        return structs.replace(snapshot, camera_fault=str(why))
    return structs.replace(snapshot, camera_size=(model.width, model.height), beyond_sound=wide, lens_assumed=lens_assumed(model))


def figures(
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
        leads=bool(counted.get("leads")),
        sends_ranges=None if ranges is None else bool(ranges),
        places_taken=taken if settings.guidance.rendezvous.enabled else None,
        ship_sources=ship_sources(counts),
        gimbal=_gimbal(settings, counts.get("gimbal", {}), rates_hz),
        exposure=dict(counts.get("exposure", {})),
        places_refused=_sources_refused(counts) | {name.replace("_", " "): n for name, n in places.items()},
        withheld={
            name.removeprefix(_WITHHELD).replace("_", " "): int(n) for name, n in counted.items() if name.startswith(_WITHHELD)
        },
    )


def ship_sources(counts: Mapping[str, Mapping[str, float]]) -> tuple[ShipSource, ...]:
    """Return her sources by the counters of the parts that read them, in order of their names."""
    found: dict[str, ShipSource] = {}
    for name, value in ((name, value) for part in _READERS for name, value in counts.get(part, {}).items()):
        word, _, of = name.partition(" ")
        if name.removeprefix("refused_") in _NAMELESS:
            word, of = "unused", f"{UNREADABLE} {name.removeprefix('refused_')}"
        if word == "unused":
            of, _, why = of.rpartition(" ")
            unused = found.setdefault(of, ShipSource()).unused
            unused[why] = unused.get(why, 0) + int(value)
        elif word == "used":
            found.setdefault(of, ShipSource()).used = int(value)
        elif word == "rate_hz":
            found.setdefault(of, ShipSource()).rate_hz = value
    for name, source in found.items():
        source.name = name
    return tuple(found[name] for name in sorted(found))


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
