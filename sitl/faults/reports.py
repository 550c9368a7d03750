"""Faults of the ship's own reports as data, as when her GNSS jumps."""

from __future__ import annotations

from typing import Annotated

from estimator.contracts.keys import choice, number
from sitl.faults.fault import Fault


class VesselReports(Fault, frozen=True, tag="vessel_reports"):
    """The ship's reports are wrong: a position that jumps shows as a velocity while it does."""

    north_m_s: Annotated[float, number("added to the reported velocity to the north", "m/s", -50.0, 50.0)] = 0.0
    east_m_s: Annotated[float, number("added to the reported velocity to the east", "m/s", -50.0, 50.0)] = 0.0
    heading_deg: Annotated[float, number("added to the reported heading, clockwise", "deg", -180.0, 180.0)] = 0.0
    place_north_m: Annotated[float, number("added to the reported place, to the north", "m", -10_000.0, 10_000.0)] = 0.0
    place_east_m: Annotated[float, number("added to the reported place, to the east", "m", -10_000.0, 10_000.0)] = 0.0
    late_s: Annotated[float, number("how much later than before every report arrives", "s", 0.0, 60.0)] = 0.0
    frozen: Annotated[bool, choice("whether the report at the beginning is repeated")] = False
    silent: Annotated[bool, choice("whether no report arrives")] = False

    def check(self) -> None:
        wrong = (self.north_m_s, self.east_m_s, self.heading_deg, self.place_north_m, self.place_east_m, self.late_s)
        if not any((*wrong, self.frozen, self.silent)):
            raise ValueError(
                "nothing says what is wrong with the reports: give north_m_s, heading_deg, place_north_m, late_s, frozen "
                "or silent"
            )
