"""Faults of the ship's own reports as data, as when her GNSS jumps."""

from __future__ import annotations

from typing import Annotated

from estimator.contracts.keys import choice, number
from sitl.fault import Fault


class VesselReports(Fault, frozen=True, tag="vessel_reports"):
    """The ship's reports are wrong: a position that jumps shows as a velocity while it does."""

    north_m_s: Annotated[float, number("added to the reported velocity to the north", "m/s", -50.0, 50.0)] = 0.0
    east_m_s: Annotated[float, number("added to the reported velocity to the east", "m/s", -50.0, 50.0)] = 0.0
    heading_deg: Annotated[float, number("added to the reported heading, clockwise", "deg", -180.0, 180.0)] = 0.0
    frozen: Annotated[bool, choice("whether the report at the beginning is repeated")] = False
    silent: Annotated[bool, choice("whether no report arrives")] = False

    def check(self) -> None:
        if not any((self.north_m_s, self.east_m_s, self.heading_deg, self.frozen, self.silent)):
            raise ValueError("nothing says what is wrong with the reports: give north_m_s, heading_deg, frozen or silent")
