"""What was found out about a set-up. Plain data that can be saved, sent to someone else and examined again.

What could not be found out is None or absent: no rule speaks of what is not known.
"""

from __future__ import annotations

from typing import Literal

import msgspec
from msgspec import Struct, field

from estimator.contracts.errors import BadInput


class LinkSnapshot(Struct, frozen=True):
    """One MAVLink link over the time of the examination."""

    url: str
    down: str | None = None
    """Why it is not open."""
    bytes_in: int = 0
    messages: int = 0
    lost: int = 0
    damaged: int = 0
    old_version: int = 0
    refused_signature: int = 0
    signed: bool | None = None
    """Whether we sign on it and take only what is signed."""
    strangers: int = 0
    """Messages of senders that were not asked for."""


class TimeSyncSnapshot(Struct, frozen=True):
    """TIMESYNC."""

    locked: bool
    round_trip_s: float | None = None
    jumps: int = 0


class AutopilotSnapshot(Struct, frozen=True):
    """The autopilot that was found."""

    stack: Literal["ArduPilot", "PX4", "other"]
    system: int
    others: tuple[int, ...] = ()
    """System ids of further autopilots that fly."""
    firmware: tuple[int, int, int] | None = None
    mode: str = "unknown"
    armed: bool | None = None
    flying: bool | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    absent: tuple[str, ...] = ()
    """Parameters that were asked for and that this firmware does not have."""
    rates_hz: dict[str, float] = field(default_factory=dict)
    """How often each message came."""
    wanted_hz: dict[str, float] = field(default_factory=dict)
    """How often it was asked for."""
    refused: dict[str, int] = field(default_factory=dict)
    """MAV_RESULT of message streams that were refused; -1 for no answer."""
    texts: tuple[str, ...] = ()
    """STATUSTEXTs, oldest first."""
    events: tuple[int, ...] = ()
    """Numbers of EVENTs, oldest first: PX4 says so what others say in texts."""
    precland_enabled: bool | None = None
    precland_healthy: bool | None = None
    """SYS_STATUS: precision landing enabled by parameter, and its backend running."""


class ServiceSnapshot(Struct, frozen=True):
    """The service itself, where it runs or could be asked."""

    camera_fault: str | None = None
    """What is wrong with the camera or pad file."""
    device_fault: str | None = None
    """Why the camera gives no frames."""
    frame_rate_hz: float | None = None
    frame_size: tuple[int, int] | None = None
    """As the device sends them."""
    camera_size: tuple[int, int] | None = None
    """As the camera file says."""
    exposure_to_belief_s: float | None = None
    """Median delay from the exposure until the estimator knew."""
    sends_ranges: bool | None = None
    """Whether DISTANCE_SENSOR is sent."""
    withheld: dict[str, int] = field(default_factory=dict)
    """Targets that were due and not sent, by reason."""
    targets_sent: int | None = None
    broker: str | None = None
    """Address of the MQTT broker that is set."""
    broker_fault: str | None = None
    drone: str | None = None
    """Address of the AR.Drone that is set."""
    drone_fault: str | None = None


class Snapshot(Struct, frozen=True):
    """Everything."""

    seconds: float
    """How long was listened."""
    links: tuple[LinkSnapshot, ...] = ()
    autopilot: AutopilotSnapshot | None = None
    sync: TimeSyncSnapshot | None = None
    service: ServiceSnapshot = ServiceSnapshot()
    moving_pad: bool = True
    """The pad is on something that moves."""


def encode(snapshot: Snapshot) -> bytes:
    """As JSON, for people too."""
    return msgspec.json.format(msgspec.json.encode(snapshot), indent=2) + b"\n"


def decode(data: bytes, where: str) -> Snapshot:
    """The frame in a JSON text.

    Raises:
        BadInput: it holds none; the text says where it is wrong.
    """
    try:
        return msgspec.json.decode(data, type=Snapshot)
    except (msgspec.DecodeError, UnicodeDecodeError) as why:
        raise BadInput(f"{where}: no frame of a set-up: {why}") from why
