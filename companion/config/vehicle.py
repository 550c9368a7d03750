"""What a person can set of the vehicle: the tables [vehicle] and [bridge] of the settings file."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Struct

from drivers.mavlink.access import Named, parse_operators
from drivers.mavlink.endpoint import Endpoint, parse_endpoint
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import choice, number, text

_LINKS = "MAVLink links, with commas between: udpin://ADDRESS:PORT, udpout://HOST:PORT, tcp://HOST:PORT, serial:///dev/NAME:BAUD"
_KEY = (
    'file with the key that messages are signed with: a path relative to the settings file, or "credential:NAME"; empty for none'
)
_OPERATORS = (
    "systems that may command without signing, with commas between: SYSTEM or SYSTEM/COMPONENT; beside them whoever is heard "
    "over the autopilot's own link, and whoever signs"
)
_TIME = (
    "file that keeps the times of signed messages, ours and those heard, over restarts, relative to the settings file; empty for "
    "$STATE_DIRECTORY/mavlink-signing-time, or memory alone without that"
)


def endpoints(links: str) -> tuple[Endpoint, ...]:
    """The links that a text names.

    Raises:
        BadInput: one of them is none.
    """
    return tuple(parse_endpoint(url) for url in links.split(",")) if links.strip() else ()


def _checked(links: str, operators: str) -> tuple[tuple[Endpoint, ...], tuple[Named, ...]]:
    try:
        found = endpoints(links)
    except BadInput as why:
        raise ValueError(f"links: {why}") from why
    try:
        return found, parse_operators(operators)
    except BadInput as why:
        raise ValueError(f"operators: {why}") from why


class AutopilotSettings(Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="mavlink"):
    """The vehicle: whatever an ArduPilot or PX4 autopilot flies, over MAVLink (docs/mavlink.md), with a camera beside it."""

    links: Annotated[str, text(_LINKS, 4096)]
    system_id: Annotated[int, number("system id of the autopilot; 0 takes the first that flies", "id", 0, 255)] = 0
    component_id: Annotated[int, number("our own component id; our system id is the autopilot's", "id", 1, 255, "MAVLink")] = 191
    vessel_id: Annotated[int, number("system id under which the ship reports its own position; 0 for none", "id", 0, 255)] = 0
    operators: Annotated[str, text(_OPERATORS, 256, shortest=0)] = ""
    signing_key_file: Annotated[str, text(_KEY, 4096, shortest=0)] = ""
    signing_time_file: Annotated[str, text(_TIME, 4096, shortest=0)] = ""
    silence_s: Annotated[
        float, number("an autopilot not heard for this long is lost; all streams are asked for when it is back", "s", 0.5, 60.0)
    ] = 3.0
    command_period_s: Annotated[
        float, number("how often a velocity setpoint is sent", "s", 0.01, 0.2, "PX4 wants more than 2 Hz")
    ] = 0.04
    command_timeout_s: Annotated[
        float, number("a velocity older than this is flown as standing still", "s", 0.05, 2.0, "twelve commands of guidance")
    ] = 0.25
    landing: Annotated[
        Literal["by stack", "mode", "velocity"],
        choice(
            "the last metre: by the autopilot's own mode, by velocities, or what suits it: mode for ArduPilot, velocity for PX4"
        ),
    ] = "by stack"
    descent_rate_m_s: Annotated[float, number("how fast a landing by velocity sinks", "m/s", 0.05, 2.0)] = 0.4
    take_off_height_m: Annotated[float, number("how high a take-off that we are asked for goes", "m", 0.5, 50.0)] = 3.0
    target_rate_hz: Annotated[
        float, number("LANDING_TARGET messages a second, at least", "Hz", 1.0, 50.0, "10 to 50 suit ArduPilot")
    ] = 25.0
    ranges: Annotated[
        Literal["auto", "on", "off"],
        choice("send DISTANCE_SENSOR; auto where an ArduPilot's parameters say that its rangefinder is a MAVLink one"),
    ] = "auto"
    range_rate_hz: Annotated[float, number("DISTANCE_SENSOR messages a second", "Hz", 1.0, 50.0)] = 20.0
    ground_clearance_m: Annotated[
        float, number("what a rangefinder would read while the vehicle stands; ArduPilot does not arm without", "m", 0.02, 2.0)
    ] = 0.1
    vision_target_estimator: Annotated[bool, choice("PX4 runs its vision target estimator: send TARGET_RELATIVE too")] = False

    def __post_init__(self) -> None:
        if not _checked(self.links, self.operators)[0]:
            raise ValueError("links: there must be one")
        if self.vessel_id and self.vessel_id == self.system_id:
            raise ValueError(f"vessel_id must not be the autopilot's own system_id, found {self.vessel_id}")


class BridgeSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """An AR.Drone shown to ground stations as a MAVLink quadrotor: seen, armed, taken off, held and landed from there."""

    links: Annotated[str, text(f"{_LINKS}; empty for no face", 4096, shortest=0)] = ""
    system_id: Annotated[int, number("system id the drone is shown as", "id", 1, 255)] = 1
    operators: Annotated[str, text(_OPERATORS, 256, shortest=0)] = ""
    signing_key_file: Annotated[str, text(_KEY, 4096, shortest=0)] = ""
    signing_time_file: Annotated[str, text(_TIME, 4096, shortest=0)] = ""

    def __post_init__(self) -> None:
        _checked(self.links, self.operators)


def unsigned(settings: AutopilotSettings | BridgeSettings) -> str | None:
    """Return what is said of links that are not signed, with the fix; None where they are, or there are none."""
    if settings.signing_key_file or not settings.links.strip():
        return None
    return "not signed: decklander keys make FILE; decklander keys install --link URL FILE; then signing_key_file = FILE"
