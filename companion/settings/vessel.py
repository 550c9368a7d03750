"""The section [vessel] of the settings: sources of the ship's place, and limits of its reports."""

import ipaddress
from typing import Annotated

from msgspec import Struct

from companion.settings.rendezvous import ReportLimits
from drivers.endpoint import Endpoint, parse_endpoint
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import choice, number, text


class VesselOptions(ReportLimits, Struct, frozen=True, forbid_unknown_fields=True):
    """The ship's own reports of her place, velocity and heading. An autopilot's link has another source: `vehicle.vessel_id`.

    Raises:
        ValueError: an address that cannot be one, a number outside its range, or two keys that do not go together.
    """

    nmea: Annotated[
        str,
        text(
            "where sentences of NMEA 0183 and AIS come from: ADDRESS:PORT of this computer for UDP, as 127.0.0.1:10110; "
            "tcp://HOST:PORT to connect to; serial:///dev/NAME:BAUD; empty for none",
            256,
            shortest=0,
            public=True,
        ),
    ] = ""
    nmea_from: Annotated[
        str,
        text(
            "by UDP: the address that they must come from, whatever the port; empty for the first that sends, until it is "
            "silent for 30 s",
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
    mqtt: Annotated[
        bool, choice("whether reports arrive on the topic `vessel`, from whom commands may come (`mqtt.commands`)", public=True)
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.nmea:
            found = self.endpoint()
            if self.nmea_from and found.scheme != "udpin":
                raise ValueError(f"nmea_from names the sender of sentences by UDP, and nmea is {self.nmea!r}")
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
