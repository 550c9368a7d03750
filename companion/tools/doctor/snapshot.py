"""The snapshot of a setup: plain data that can be saved, sent to someone else and examined again.

Unknown values are None or absent, and no rule judges them.
"""

from typing import Literal, TypeVar

import msgspec
from msgspec import Struct, field

from companion.settings.remarks import Contradiction
from drivers.log_history import LogHistory
from drivers.mavlink.roster import IdConflict
from estimator.contracts.errors import refused


class LinkSnapshot(Struct, frozen=True):
    """One MAVLink link over the time of the examination."""

    url: str
    down: str | None = None
    """Reason why the link is not open; None if it is."""
    bytes_in: int = 0
    messages: int = 0
    lost: int = 0
    damaged: int = 0
    old_version: int = 0
    refused_signature: int = 0
    signed: bool | None = None
    """True if we sign our messages on it and accept only signed ones."""
    unknown_senders: int = 0
    """Number of messages from senders that are not accepted, and were not later."""
    refused_time: int = 0
    """Number of messages signed with our key whose time was refused."""
    behind_s: float = 0.0
    """Time by which the newest of those lay behind ours, s."""
    refused_datagrams: int = 0
    """Number of datagrams that the other computer refused, because no program listens there."""
    late: int = 0
    """Number of messages that were dropped because the line did not take them in time."""
    text: int = 0
    """Number of bytes that may be of a text."""
    echoed: int = 0
    """Number of our own messages that came back."""
    with_signature: int = 0
    """Number of messages that carry a signature."""


class TimeSyncSnapshot(Struct, frozen=True):
    """The state of clock synchronization by TIMESYNC."""

    locked: bool
    round_trip_s: float | None = None
    jumps: int = 0
    jumped_s: float = 0.0
    """The largest jump of the autopilot's clock, s."""


class AutopilotSnapshot(Struct, frozen=True):
    """The autopilot that was found."""

    stack: Literal["ArduPilot", "ArduPlane", "PX4", "other"]
    system: int
    others: tuple[int, ...] = ()
    """System ids of further autopilots."""
    firmware: tuple[int, int, int] | None = None
    mode: str = "unknown"
    armed: bool | None = None
    flying: bool | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    absent: tuple[str, ...] = ()
    """Requested parameters that this firmware does not have."""
    misspelt: dict[str, str] = field(default_factory=dict)
    """Names in the file or log that are known ones but for a letter or two, each with the known one, which is not there."""
    unread: tuple[str, ...] = ()
    """Lines of a file of parameters that were not, or not wholly, taken, each with its number and the reason."""
    unjudged: tuple[str, ...] = ()
    """Names in a file of parameters that no rule knows."""
    rates_hz: dict[str, float] = field(default_factory=dict)
    """Measured rate of each message, Hz."""
    wanted_hz: dict[str, float] = field(default_factory=dict)
    """Requested rate of each message, Hz."""
    refused: dict[str, int] = field(default_factory=dict)
    """MAV_RESULT of message streams that were refused; -1 for no answer."""
    texts: tuple[str, ...] = ()
    """STATUSTEXTs, oldest first."""
    events: tuple[int, ...] = ()
    """Numbers of EVENTs, oldest first; PX4 uses them where other autopilots send texts."""
    differs: dict[str, tuple[float, float]] = field(default_factory=dict)
    """The parameters that touch modes, time limits, sources of the EKF and loops, and are not what the firmware begins with: each
    with its value and the default."""
    channels: dict[int, dict[str, int]] = field(default_factory=dict)
    """Channels of the transmitter: the newest width, us, in each position in which they stood, the newest position last."""
    precland_enabled: bool | None = None
    precland_healthy: bool | None = None
    """True if SYS_STATUS reports precision landing as enabled by parameter and its backend as running."""


class FoundSystem(Struct, frozen=True):
    """A component that sent HEARTBEATs, whether or not it is the autopilot that is meant."""

    system: int
    component: int
    stack: str
    """ArduPilot, PX4 or other; empty for what is no autopilot, such as a ground station."""
    kind: str
    """Its MAV_TYPE in words, such as "quadrotor" or "gcs"."""
    hovers: bool
    """True if it is the autopilot of a vehicle that can hover."""

    def __str__(self) -> str:
        return f"system {self.system} ({self.stack} {self.kind})" if self.stack else f"system {self.system} ({self.kind})"


class GimbalSnapshot(Struct, frozen=True):
    """The gimbal that the settings name, over the time of the examination, or as the running service has it."""

    device_id: int
    rate_hz: float = 0.0
    """Rate of its reports that were taken, Hz."""
    refused: dict[str, int] = field(default_factory=dict)
    """Reports that were refused, by reason."""


UNREADABLE = "unreadable"
"""Name of what has no source, as it could not be read."""


class ShipSource(Struct):
    """The reports of one kind by one source on the ship, as `INGGA`."""

    name: str = ""
    used: int = 0
    rate_hz: float = 0.0
    unused: dict[str, int] = field(default_factory=dict)
    """Reports that were not used, by reason."""


class ServiceSnapshot(Struct, frozen=True):
    """The service itself, as far as it runs or could be queried."""

    files_fault: str | None = None
    """Reason why a key, password or certificate of the settings cannot be used."""
    without_effect: tuple[str, ...] = ()
    """Lines about settings that have no effect beside others."""
    beyond_sound: tuple[str, ...] = ()
    """Lines about limits that are wider than their own meaning allows."""
    lens_assumed: tuple[str, ...] = ()
    """Lines about a lens that was not measured."""
    camera_fault: str | None = None
    """Description of the fault of the camera or pad file."""
    device_fault: str | None = None
    """Reason why the camera sends no frames."""
    frame_rate_hz: float | None = None
    frame_size: tuple[int, int] | None = None
    """Size of the frames that the device sends, px."""
    camera_size: tuple[int, int] | None = None
    """Size of the frames in the camera file, px."""
    exposure_to_belief_s: float | None = None
    """Median delay from the exposure until the estimator has used the frame, seconds."""
    leads: bool = False
    """True if the running service has the autopilot's own landing led by targets alone."""
    sends_ranges: bool | None = None
    """True if DISTANCE_SENSOR is sent."""
    withheld: dict[str, int] = field(default_factory=dict)
    """Targets that were due and not sent, by reason."""
    targets_sent: int | None = None
    broker: str | None = None
    """Address of the MQTT broker in the settings."""
    broker_fault: str | None = None
    drone: str | None = None
    """Address of the AR.Drone in the settings."""
    drone_fault: str | None = None
    feet_below_m: float | None = None
    """Distance of an autopilot's feet below it by the settings, m; None for an AR.Drone."""
    switch: tuple[str, ...] = ()
    """Orders of the low, the middle and the high position of the transmitter's switch; empty without one."""
    switch_channel: int = 0
    ship_place: Contradiction | None = None
    """Contradiction in the settings about the ship's place."""
    places_refused: dict[str, int] = field(default_factory=dict)
    """Reports of the ship that the running service refused, by reason."""
    gimbal: GimbalSnapshot | None = None
    """The camera's gimbal; None if no service runs, or the camera has none."""
    exposure: dict[str, float] = field(default_factory=dict)
    """The counters of the exposure that the running service drives; empty where it does not."""
    ship_sources: tuple[ShipSource, ...] = ()
    """The ship's reports that arrive at the running service, or at this examination."""
    ship_fault: str | None = None
    """Reason why the ship cannot be listened to."""
    places_taken: int | None = None
    """Places of the ship that the running service took; None if no service runs, or none are expected."""


class Snapshot(Struct, frozen=True):
    """The complete snapshot of a setup."""

    seconds: float
    """Duration of the examination, seconds."""
    links: tuple[LinkSnapshot, ...] = ()
    autopilot: AutopilotSnapshot | None = None
    sync: TimeSyncSnapshot | None = None
    service: ServiceSnapshot = ServiceSnapshot()
    wanted_system: int = 0
    """System id of the autopilot that was requested; 0 for any."""
    systems: tuple[FoundSystem, ...] = ()
    """Everything that sent HEARTBEATs."""
    log: LogHistory | None = None
    """Events of the flight log that was examined; None for a setup that was examined itself."""
    ship_speed_m_s: float | None = None
    """Greatest speed of the ship over the ground, m/s; None if it was not reported."""
    moving_pad: bool = True
    """True if the pad is on something that moves."""
    gimbal: GimbalSnapshot | None = None
    """The camera's gimbal; None if the settings name none, or no link was examined."""
    id_conflicts: tuple[IdConflict, ...] = ()


_File = TypeVar("_File", bound=Struct)


def encode(written: Struct) -> bytes:
    """Return a snapshot, or another file of the doctor's, as readable JSON."""
    return msgspec.json.format(msgspec.json.encode(written), indent=2) + b"\n"


def decode(data: bytes, where: str, kind: type[_File], named: str) -> _File:
    """Return the snapshot, or another file of the doctor's, in a JSON text.

    Raises:
        BadInput: the text holds none; the message names the place.
    """
    with refused(f"{where}: no {named}", msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return msgspec.json.decode(data, type=kind)
