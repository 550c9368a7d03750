"""Faults of the vessel as data: she stops, changes speed, turns, rolls, and meets the wake of another ship.

The motion in the waves stays that of the vessel's course before; what is here comes on top of it.
"""

from __future__ import annotations

from typing import Annotated

from estimator.contracts.keys import number
from sitl.faults.fault import Fault

_OVER = "time until it is steady, and again to go back where `for_s` ends it"


class ShipFault(Fault, frozen=True):
    """Something that the vessel does."""


class ShipSpeed(ShipFault, frozen=True, tag="ship_speed"):
    """The vessel changes her speed; 0 stops her."""

    to_m_s: Annotated[float, number("speed along the heading, through the water", "m/s", 0.0, 15.0)]
    over_s: Annotated[float, number(_OVER, "s", 0.5, 300.0)] = 10.0


class ShipTurn(ShipFault, frozen=True, tag="ship_turn"):
    """The vessel turns, heels outward and loses speed, as in `sitl.vessel.turn`."""

    rate_deg_s: Annotated[float, number("rate of turn, clockwise from above", "deg/s", -30.0, 30.0)]
    over_s: Annotated[float, number(_OVER, "s", 0.5, 300.0)] = 10.0

    def check(self) -> None:
        if self.rate_deg_s == 0.0:
            raise ValueError("rate_deg_s must not be 0: a vessel that keeps her course does not turn")


class DeckRoll(ShipFault, frozen=True, tag="deck_roll"):
    """The deck rolls to one side and to the other, besides what the waves do; it grows over one period and dies in one."""

    roll_deg: Annotated[float, number("amplitude", "deg", 0.1, 30.0)] = 8.0
    period_s: Annotated[float, number("period of the roll", "s", 1.0, 40.0)] = 8.0

    def check(self) -> None:
        if self.for_s is not None and self.for_s < 2.0 * self.period_s:
            raise ValueError(f"for_s must be two periods or more, {2.0 * self.period_s:g} s, for the roll to grow and die in")


class FerryWake(ShipFault, frozen=True, tag="ferry_wake"):
    """The wake of another ship passes: a train of waves that the vessel rides as she rides the sea."""

    height_m: Annotated[float, number("height of the highest wave, trough to crest", "m", 0.05, 3.0)] = 0.5
    period_s: Annotated[float, number("period of the waves", "s", 1.0, 15.0)] = 4.0
    waves: Annotated[float, number("number of waves in the train", "1", 2.0, 30.0)] = 8.0
    from_deg: Annotated[float, number("direction it comes from, clockwise from the bow", "deg", -360.0, 360.0)] = 90.0

    def check(self) -> None:
        if self.for_s is not None:
            raise ValueError("for_s does not go with a wake: it lasts waves x period_s")
