"""The settings of the ship: sources and limits of her reports, and the flight to her."""

import ipaddress
import math
from typing import Annotated

from msgspec import Struct

from drivers.endpoint import Endpoint, parse_bus, parse_endpoint
from drivers.relpos import RelposOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import CheckedOptions, choice, number, text, tuning
from estimator.ship_motion import ShipMotionOptions

_WHERE = "ADDRESS:PORT of this computer for UDP, tcp://HOST:PORT or serial:///dev/NAME:BAUD"
_VECTOR = "three numbers with commas between"
_REACH_M = 400.0


class RtkOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Two GNSS receivers that measure the vector from the ship's antenna to the drone's by carrier phase.

    Raises:
        ValueError: an address or a vector that cannot be one, or a number outside its range.
    """

    source: Annotated[
        str, text(f"where the drone's receiver sends UBX NAV-RELPOSNED: {_WHERE}; empty for none", 256, shortest=0, public=True)
    ] = ""
    antenna_m: Annotated[
        str, text(f"the drone's antenna from the body's origin, forward, right, down, m: {_VECTOR}", 64, public=True, page=True)
    ] = "0, 0, 0"
    ship_antenna_m: Annotated[
        str,
        text(
            f"the ship's antenna from the pad's centre, towards the bow, to starboard, down, m: {_VECTOR}",
            64,
            public=True,
            page=True,
        ),
    ] = "0, 0, 0"
    alone: Annotated[
        bool, choice("whether a landing may begin without sight of the pad; otherwise the camera has to have seen it once")
    ] = False
    reverse: Annotated[bool, choice("whether the base is the drone's receiver and the rover the ship's", page=True)] = False
    delay_s: Annotated[float, tuning("least time from the instant of a solution to its arrival", "s", 0.0, 0.5)] = 0.15
    length_max_m: Annotated[float, tuning("length of a baseline beyond which it is refused", "m", 1.0, 10_000.0)] = 300.0
    heading: Annotated[
        str, text("where NAV-RELPOSNED of two antennas on the ship comes from, for her heading: as source", 256, shortest=0)
    ] = ""
    heading_mount_deg: Annotated[
        float, tuning("direction from that base antenna to the rover antenna, clockwise from the bow", "deg", -180.0, 180.0)
    ] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.antenna(), self.ship_antenna()
        for key in ("source", "heading"):
            if getattr(self, key):
                self.endpoint(key)

    def antenna(self) -> tuple[float, float, float]:
        """Return the drone's antenna in the body's axes, m."""
        return _vector("antenna_m", self.antenna_m)

    def ship_antenna(self) -> tuple[float, float, float]:
        """Return the ship's antenna from the pad in the ship's axes, m."""
        return _vector("ship_antenna_m", self.ship_antenna_m)

    def endpoint(self, key: str) -> Endpoint:
        """Return the way by which the messages of `source` or `heading` arrive.

        Raises:
            ValueError: it is none.
        """
        where: str = getattr(self, key)
        try:
            found = parse_endpoint(where if "://" in where else f"udpin://{where}")
            if found.scheme == "udpin":
                ipaddress.ip_address(found.host)
                if "://" in where or not found.port:
                    raise ValueError
        except (BadInput, ValueError):
            raise ValueError(f"{key} must be {_WHERE}, found {where!r}") from None
        if found.scheme == "udpout":
            raise ValueError(f"{key} must be {_WHERE}, found {where!r}")
        return found

    def receiver(self, key: str) -> RelposOptions:
        """Return what the reader of `source` or `heading` has to know."""
        if key == "heading":
            return RelposOptions(self.delay_s, _REACH_M, mount_rad=math.radians(self.heading_mount_deg))
        return RelposOptions(self.delay_s, self.length_max_m, self.reverse, self.antenna(), self.ship_antenna(), self.alone)


def _vector(key: str, written: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in written.split(","))
    except ValueError:
        raise ValueError(f"{key} must be {_VECTOR}, found {written!r}") from None
    if not all(abs(part) <= _REACH_M for part in (x, y, z)):
        raise ValueError(f"{key}: each number must lie in -{_REACH_M:g} to {_REACH_M:g} m, found {written!r}")
    return x, y, z


class ReportLimits(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Limits for the positions that ship and vehicle report.

    Raises:
        ValueError: a number outside its range, or two that do not go together.
    """

    age_max_s: Annotated[
        float,
        tuning("age beyond which a report is refused, and beyond which the newest one tells no place any more", "s", 0.2, 60.0),
    ] = 5.0
    speed_max_m_s: Annotated[float, tuning("speed that no ship of yours reaches; a faster one is refused", "m/s", 1.0, 50.0)] = (
        20.0
    )
    jump_m: Annotated[
        float,
        tuning(
            "how far a report may lie from the place that was carried on to its time, beyond three of the sigmas; a farther one "
            "is refused",
            "m",
            1.0,
            1000.0,
        ),
    ] = 10.0
    forget_s: Annotated[
        float, tuning("time without a report that fits after which the next one is believed alone", "s", 1.0, 600.0)
    ] = 30.0
    acceleration_m_s2: Annotated[
        float, tuning("acceleration by which the ship may leave the course that carries her place on", "m/s^2", 0.01, 5.0)
    ] = 0.2
    sigma_max_m: Annotated[
        float, tuning("horizontal standard deviation of the place beyond which nobody flies to it", "m", 0.5, 200.0)
    ] = 15.0
    pad_forward_m: Annotated[
        float, tuning("the pad from the point that the ship reports, towards her bow", "m", -400.0, 400.0, public=True)
    ] = 0.0
    pad_right_m: Annotated[float, tuning("the same to starboard", "m", -100.0, 100.0, public=True)] = 0.0
    pad_up_m: Annotated[
        float,
        tuning("the same upward; without a reported height (AIS) the pad's height over the sea", "m", -50.0, 50.0, public=True),
    ] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.forget_s < 2.0 * self.age_max_s:
            raise ValueError(f"forget_s ({self.forget_s:g} s) must be at least twice age_max_s ({self.age_max_s:g} s)")

    @property
    def pad_aside_m(self) -> float:
        """The pad's horizontal distance from the point that the ship reports, metres."""
        return math.hypot(self.pad_forward_m, self.pad_right_m)


class RendezvousOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The flight to the ship: to a hold-off point, then a search over her pad until the camera sees it.

    It is level or upward: nothing but sight of the pad brings the drone down.

    Raises:
        ValueError: a number outside its range, or two that do not go together.
    """

    enabled: Annotated[
        bool,
        choice(
            "whether the drone flies to the ship's reported place when a landing is ordered without sight", public=True, page=True
        ),
    ] = False
    bearing_deg: Annotated[
        float,
        tuning(
            "direction of the hold-off point from the pad, clockwise from the bow: 180 is behind",
            "deg",
            -180.0,
            180.0,
            public=True,
        ),
    ] = 180.0
    range_m: Annotated[float, tuning("horizontal distance of the hold-off point from the pad", "m", 1.0, 200.0, public=True)] = (
        8.0
    )
    height_m: Annotated[
        float, tuning("height over the pad to which it climbs, and never descends, above masts", "m", 1.0, 100.0, public=True)
    ] = 6.0
    reached_m: Annotated[float, tuning("distance at which it counts as there", "m", 0.5, 50.0)] = 2.0
    speed_m_s: Annotated[float, tuning("largest speed against the ship on the way", "m/s", 0.2, 15.0, public=True)] = 3.0
    time_s: Annotated[float, tuning("longest time on the way; after it the drone gives up", "s", 5.0, 3600.0)] = 180.0
    lost_s: Annotated[
        float, tuning("time without sight and without a usable place of ship or drone after which it refuses", "s", 1.0, 600.0)
    ] = 10.0
    search_speed_m_s: Annotated[float, tuning("speed against the ship along the search pattern", "m/s", 0.1, 5.0)] = 1.0
    spacing_m: Annotated[
        float,
        tuning(
            "distance of the tracks of the expanding square", "m", 0.3, 100.0, "half the width that the camera sees from height_m"
        ),
    ] = 2.5
    extent_m: Annotated[
        float, tuning("distance from the pad's reported place at which the square begins again", "m", 1.0, 500.0)
    ] = 10.0

    ORDER = ("reached_m < range_m", "spacing_m <= extent_m")


class VesselOptions(ReportLimits, Struct, frozen=True, forbid_unknown_fields=True):
    """The ship's own reports of her place, velocity and heading. An autopilot's link has another source: `vehicle.vessel_id`.

    Raises:
        ValueError: an address that cannot be one, a number outside its range, or two keys that do not go together.
    """

    nmea: Annotated[
        str, text(f"where sentences of NMEA 0183 and AIS come from: {_WHERE}; empty for none", 256, shortest=0, public=True)
    ] = ""
    nmea_from: Annotated[
        str,
        text(
            "by UDP: the sender's address; empty for the first that sends, until it is silent for 30 s",
            64,
            shortest=0,
            public=True,
        ),
    ] = ""
    mmsi: Annotated[
        int, number("MMSI of the ship, whose AIS reports alone are taken; 0 takes none", "1", 0, 999_999_999, public=True)
    ] = 0
    nmea_simulated: Annotated[
        bool, choice("whether sentences that say that they are simulated are taken like a fix: for a rehearsal only")
    ] = False
    bus: Annotated[
        str,
        text(
            "her network, NMEA 2000 or Signal K: can://can0; a gateway at tcp://HOST:PORT or serial:///dev/NAME:BAUD; "
            "signalk://HOST:PORT; empty for none",
            256,
            shortest=0,
            public=True,
        ),
    ] = ""
    mqtt: Annotated[
        bool, choice("whether reports arrive on the topic `vessel`, from whom commands may come (`mqtt.commands`)", public=True)
    ] = False
    motion_sensor: ShipMotionOptions = ShipMotionOptions()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.nmea:
            found = self.endpoint()
            if self.nmea_from and found.scheme != "udpin":
                raise ValueError(f"nmea_from names the sender of sentences by UDP, and nmea is {self.nmea!r}")
        if self.bus:
            parse_bus(self.bus)
        if self.nmea_from:
            ipaddress.ip_address(self.nmea_from)
        if (self.nmea_from or self.mmsi) and not self.nmea:
            raise ValueError("nmea_from and mmsi belong to nmea, which is empty")

    def endpoint(self) -> Endpoint:
        """Return the way by which sentences arrive.

        Raises:
            ValueError: `nmea` is none.
        """
        if "://" not in self.nmea:
            return _parsed(f"udpin://{self.nmea}")
        found = _parsed(self.nmea)
        if found.scheme not in ("tcp", "serial"):
            raise ValueError(f"nmea: write ADDRESS:PORT for sentences by UDP, found {self.nmea!r}")
        return found


def _parsed(url: str) -> Endpoint:
    try:
        found = parse_endpoint(url)
        if found.scheme == "udpin":
            ipaddress.ip_address(found.host)
    except (BadInput, ValueError):
        raise ValueError(
            f"nmea must be ADDRESS:PORT with a numeric address, tcp://HOST:PORT or serial:///dev/NAME:BAUD, found "
            f"{url.removeprefix('udpin://')!r}"
        ) from None
    if not found.port >= 1 or (found.scheme != "serial" and found.port > 65535):
        raise ValueError(f"nmea: the port must lie in 1 to 65535, found {found.port}")
    return found
