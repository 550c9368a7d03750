"""A person who takes over, as data: what the operator orders, and what he does with the sticks."""

from __future__ import annotations

from typing import Annotated, Literal

from estimator.contracts.keys import choice, number
from sitl.faults.fault import Fault


class OperatorActs(Fault, frozen=True, tag="operator"):
    """A person takes over; after `for_s`, or by order begin, he gives the vehicle back and lets guidance begin again."""

    order: Annotated[
        Literal["hold", "manual", "abort", "land", "begin"],
        choice(
            "hold in place, fly by hand with the sticks below, end the landing and hover, land where the vehicle is, or give it "
            "back and let guidance begin"
        ),
    ] = "hold"
    forward: Annotated[float, number("stick forward, with manual", "1", -1.0, 1.0)] = 0.0
    right: Annotated[float, number("stick to the right, with manual", "1", -1.0, 1.0)] = 0.0
    climb: Annotated[float, number("stick up, with manual", "1", -1.0, 1.0)] = 0.0
    turn: Annotated[float, number("stick clockwise, with manual", "1", -1.0, 1.0)] = 0.0

    def check(self) -> None:
        if self.order != "manual" and any((self.forward, self.right, self.climb, self.turn)):
            raise ValueError(f"forward, right, climb and turn are sticks: they go with order manual, not with {self.order}")
        if self.order in ("abort", "land") and self.for_s is not None:
            raise ValueError(f"for_s does not go with {self.order}, which ends the flight")
        if self.order == "begin" and self.for_s is not None:
            raise ValueError("for_s does not go with begin, after which guidance flies on")
