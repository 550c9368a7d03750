"""The table `[vessel]` of a scenario: which ship, its course, and its turn."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from estimator.contracts.keys import number, text
from sitl.vessel.seakeeping import HULLS

EXCLUDES: dict[str, tuple[str, ...]] = {"hull": ("file",), "file": ("hull",)}
"""Keys that take the place of those of a base when a scenario that is built on it says them."""
DEFAULT_HULL = "ferry"


class VesselSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The ship."""

    hull: Annotated[str, text(f"one of {', '.join(HULLS)}; {DEFAULT_HULL} unless said", 40)] | None = None
    file: Annotated[str, text("a shipped vessel (configs/vessels), or a path relative to the scenario file", 200)] | None = None
    heading_deg: Annotated[float, number("heading of the bow, clockwise from north", "deg", -360.0, 360.0)] = 0.0
    speed_m_s: Annotated[float, number("speed along the heading, through the water", "m/s", 0.0, 15.0)] = 0.0
    moored: Annotated[bool, Meta(description="at anchor: wanders slowly in surge, sway and yaw")] = True
    pad_yaw_deg: Annotated[float, number("angle of the pad's arrow from the bow, clockwise from above", "deg", -360.0, 360.0)] = (
        0.0
    )
    turn_rate_deg_s: Annotated[float, number("rate of turn, clockwise from above; 0 keeps the course", "deg/s", -30.0, 30.0)] = (
        0.0
    )
    turn_at_s: Annotated[float, number("time at which the turn begins", "s", 0.0, 36000.0)] = 0.0
    reports_hz: Annotated[
        float, number("rate at which the ship reports her velocity and heading to the service; 0 for never", "Hz", 0.0, 20.0)
    ] = 0.0
    reports_place: Annotated[
        bool,
        Meta(description="whether they also say where she is; without --config the service then flies to her"),
    ] = False
    turn_over_s: Annotated[float, number("time until the turn is steady", "s", 0.5, 300.0, "assumed")] = 10.0

    def __post_init__(self) -> None:
        if self.hull is not None and self.file is not None:
            raise ValueError("hull and file both name a ship: give one")
        if self.hull is not None and self.hull not in HULLS:
            raise ValueError(f"hull must be one of {', '.join(HULLS)}, found {self.hull!r}")
        if self.moored and self.speed_m_s > 0:
            raise ValueError("speed_m_s must be 0 while moored is true")
        if self.reports_place and self.reports_hz == 0.0:
            raise ValueError("reports_place needs reports_hz: a ship that reports nothing does not report her place")
        if self.turn_rate_deg_s != 0.0 and self.speed_m_s == 0.0:
            raise ValueError("turn_rate_deg_s needs speed_m_s: a ship that lies still does not turn")
        if self.turn_rate_deg_s == 0.0 and (self.turn_at_s != 0.0 or self.turn_over_s != 10.0):
            raise ValueError("turn_at_s and turn_over_s belong to a turn: turn_rate_deg_s is 0")
