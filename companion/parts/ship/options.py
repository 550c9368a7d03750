"""The settings of the ship's wires: keys of the table [vessel], and the table [rtk] of GNSS receivers on ship and drone."""

import ipaddress
import math
from typing import Annotated

from companion.settings.part_table import PartTable
from companion.settings.vessel import VesselOptions
from drivers.endpoint import Endpoint, parse_bus, parse_endpoint
from drivers.relpos import RelposOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import check_ranges, choice, number, text, tuning

WHERE = "ADDRESS:PORT of this computer for UDP, tcp://HOST:PORT or serial:///dev/NAME:BAUD"
"""The ways by which a ship's wire arrives."""
_AIS_PERIOD_S = 10.0
"""Interval of the AIS reports of a ship under way at up to 14 knots (ITU-R M.1371-5, annex 1, table 1)."""
_VECTOR = "three numbers with commas between"
_REACH_M = 400.0  # longest vector between the antennas, and of an arm on board


class WiredVessel(VesselOptions, frozen=True, forbid_unknown_fields=True):
    """The ship's own reports of her place, velocity and heading. An autopilot's link has another source: `vehicle.vessel_id`.

    Raises:
        ValueError: an address that cannot be one, a number outside its range, or two keys that do not go together.
    """

    nmea: Annotated[
        str, text(f"where sentences of NMEA 0183 and AIS come from: {WHERE}; empty for none", 256, shortest=0, public=True)
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

    @property
    def source_keys(self) -> tuple[str, ...]:
        return ("nmea", "bus", *super().source_keys)

    def reported_too_rarely(self, sources: tuple[str, ...]) -> str:
        if sources == ("vessel.nmea",) and self.mmsi and self.age_max_s < _AIS_PERIOD_S:
            return f"AIS reports of a ship under way come every {_AIS_PERIOD_S:g} s"
        return ""


class RtkOptions(PartTable, frozen=True, forbid_unknown_fields=True):
    """Two GNSS receivers that measure the vector from the ship's antenna to the drone's by carrier phase.

    Raises:
        ValueError: an address or a vector that cannot be one, or a number outside its range.
    """

    source: Annotated[
        str, text(f"where the drone's receiver sends UBX NAV-RELPOSNED: {WHERE}; empty for none", 256, shortest=0, public=True)
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
        check_ranges(self)
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
            raise ValueError(f"{key} must be {WHERE}, found {where!r}") from None
        if found.scheme == "udpout":
            raise ValueError(f"{key} must be {WHERE}, found {where!r}")
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
