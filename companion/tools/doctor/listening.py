"""Listen to the open links of an autopilot: the part of a snapshot for which nothing is requested."""

from typing import Any

from msgspec import Struct, field

from companion.tools.doctor.snapshot import (
    AutopilotSnapshot,
    FoundSystem,
    LinkSnapshot,
    Snapshot,
    TimeSyncSnapshot,
)
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import mav
from drivers.mavlink.links import Link, ReceivedMessage
from drivers.mavlink.rc_channels import FIRST, LAST, POSITIONS, band_of, pulse_us
from drivers.mavlink.requests import RATES_HZ
from drivers.mavlink.vehicle import is_autopilot, stack_of

_PRECLAND_BIT = int(mav.MAV_SYS_STATUS_SENSOR_VISION_POSITION)
"""The SYS_STATUS bit in which ArduCopter reports precision landing."""
_FOUND_MAX = 256  # systems that are noted


class Notes(Struct):
    """Messages on the links that `Autopilot` does not keep."""

    systems: dict[tuple[int, int], FoundSystem] = field(default_factory=dict)
    enabled: bool | None = None
    healthy: bool | None = None
    channels: dict[int, dict[str, int]] = field(default_factory=dict)
    before: dict[int, int | None] = field(default_factory=dict)
    """Position of each channel in the message before: one that is passed on the way is not noted."""

    def on_message(self, received: ReceivedMessage) -> None:
        m, name = received.message, received.message.get_type()
        if name == "HEARTBEAT" and len(self.systems) < _FOUND_MAX:
            stack = "" if m.autopilot == mav.MAV_AUTOPILOT_INVALID else stack_of(m).value
            named = mav.enums["MAV_TYPE"].get(m.type)
            kind = f"type {m.type}" if named is None else named.name.removeprefix("MAV_TYPE_").replace("_", " ").lower()
            self.systems[received.system, received.component] = FoundSystem(
                received.system, received.component, stack, kind, is_autopilot(m, received.component)
            )
        elif name == "SYS_STATUS" and received.component == mav.MAV_COMP_ID_AUTOPILOT1:
            self.enabled = bool(m.onboard_control_sensors_enabled & _PRECLAND_BIT)
            self.healthy = bool(m.onboard_control_sensors_health & _PRECLAND_BIT)
        elif name == "RC_CHANNELS" and received.component == mav.MAV_COMP_ID_AUTOPILOT1:
            for channel in range(FIRST, LAST + 1):
                band = band_of(pulse := pulse_us(m, channel))
                if pulse is not None and band is not None and band == self.before.get(channel):
                    stood = self.channels.setdefault(channel, {})
                    stood.pop(POSITIONS[band], None)
                    stood[POSITIONS[band]] = pulse
                self.before[channel] = band

    def moved(self) -> dict[int, dict[str, int]]:
        """Return the channels that stood in more than one position."""
        return {channel: stood for channel, stood in self.channels.items() if len(stood) > 1}


def snapshot_of(autopilot: Autopilot, notes: Notes, rates: dict[str, float], wanted: int, seconds: float) -> Snapshot:
    """Return the snapshot as it is now, with the links' counters since they were opened first.

    Args:
        rates: rate of each message, Hz.
        wanted: the system id that the settings request; 0 for any.
        seconds: how long was listened.
    """
    found = tuple(notes.systems[ids] for ids in sorted(notes.systems))
    links = tuple(link_snapshot(link) for link in autopilot.links.all)
    identity, sync = autopilot.identity, autopilot.sync
    if identity is None or sync is None:
        return Snapshot(seconds, links, wanted_system=wanted, systems=found, id_conflicts=autopilot.id_conflicts)
    parameters, streams, condition = autopilot.parameters, autopilot.streams, autopilot.condition
    firmware = None if autopilot.version is None else autopilot.version.firmware
    values = {} if parameters is None else dict(sorted(parameters.values.items()))
    return Snapshot(
        seconds,
        links,
        AutopilotSnapshot(
            stack=identity.stack.value,
            system=identity.system,
            others=tuple(sorted({one.system for one in found if one.hovers} - {identity.system})),
            firmware=firmware,
            mode=condition.mode,
            armed=condition.armed,
            flying=condition.flying,
            parameters=values,
            absent=() if parameters is None else tuple(sorted(parameters.absent)),
            rates_hz={name: round(rate, 2) for name, rate in sorted(rates.items())},
            wanted_hz=dict(RATES_HZ[identity.stack]),
            refused={} if streams is None else streams.refused,
            texts=tuple(text for _, _, text in autopilot.texts),
            events=tuple(autopilot.events),
            channels=notes.channels,
            precland_enabled=notes.enabled,
            precland_healthy=notes.healthy,
        ),
        TimeSyncSnapshot(sync.locked, sync.round_trip_s, sync.jumps, sync.jumped_s),
        wanted_system=wanted,
        systems=found,
        id_conflicts=autopilot.id_conflicts,
    )


def link_snapshot(link: Link) -> LinkSnapshot:
    """Return the counters of a link since it was opened first."""
    codec, text = link.counters.codec, link.counters.text
    of_codec = {"behind_s": codec.behind_s, "with_signature": codec.with_signature}
    counted: dict[str, Any] = link.counters.as_dict() | of_codec | {"text": text, "signed": link.signed}
    known = {name: n for name, n in counted.items() if name in LinkSnapshot.__struct_fields__}
    return LinkSnapshot(str(link.endpoint), link.down, **known)
