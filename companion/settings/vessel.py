"""The section [vessel] of the settings: who tells where the ship is, and what of it is believed."""

import ipaddress
from typing import Annotated

from msgspec import Struct

from companion.settings.rendezvous import ReportLimits
from estimator.contracts.keys import choice, number, text


class VesselOptions(ReportLimits, Struct, frozen=True, forbid_unknown_fields=True):
    """The ship's own reports of her place, velocity and heading. An autopilot's link has another source: `vehicle.vessel_id`.

    Raises:
        ValueError: an address that cannot be one, a number outside its range, or two keys that do not go together.
    """

    nmea: Annotated[
        str,
        text(
            "ADDRESS:PORT of this computer on which sentences of NMEA 0183 and AIS arrive by UDP, as 127.0.0.1:10110; empty for "
            "none",
            64,
            shortest=0,
            public=True,
        ),
    ] = ""
    nmea_from: Annotated[
        str,
        text(
            "the address that they must come from; empty for the first that is heard, until it is silent for 30 s",
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
            self.address()
        if self.nmea_from:
            ipaddress.ip_address(self.nmea_from)
        if (self.nmea_from or self.mmsi) and not self.nmea:
            raise ValueError("nmea_from and mmsi belong to nmea, which is empty")

    def address(self) -> tuple[str, int]:
        """Return the address and port on which sentences arrive.

        Raises:
            ValueError: `nmea` is none.
        """
        host, _, port = self.nmea.rpartition(":")
        try:
            ipaddress.ip_address(host.strip("[]"))
            number_of = int(port)
        except ValueError:
            raise ValueError(f"nmea must be ADDRESS:PORT with a numeric address, found {self.nmea!r}") from None
        if not 1 <= number_of <= 65535:
            raise ValueError(f"nmea: the port must lie in 1 to 65535, found {number_of}")
        return host.strip("[]"), number_of
