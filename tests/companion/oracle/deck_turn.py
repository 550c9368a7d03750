"""How fast the deck turns: what of the heading's course the body's own turn does not explain.

The heading against the arrow runs with the body's rate less the deck's. An observer of that course with both poles at
`POLE_RAD_S` finds the deck's rate: fed forward, it takes away the error with which a nose would follow a ship that turns, and
unlike an integral it does not wind up while the nose comes round to the arrow.
Source: Luenberger, An introduction to observers, IEEE Trans. Automatic Control 16(6), 1971.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from estimator.contracts.geometry import wrap_pi

POLE_RAD_S = 0.7
"""As slow as a ship begins to turn, and slow enough that the noise of single sightings makes no rate."""
MOST_RAD_S = math.radians(10.0)
"""No ship turns faster."""


class DeckTurn(NamedTuple):
    """The observer's memory."""

    yaw_rad: float
    """Heading against the arrow."""
    rate_rad_s: float = 0.0
    """The deck's, clockwise from above."""


def observed(turn: DeckTurn | None, yaw_rad: float, body_rate_rad_s: float, dt: float) -> DeckTurn:
    """Return the memory after `dt` s.

    Args:
        turn: None to begin.
        yaw_rad: estimated heading against the arrow.
        body_rate_rad_s: the body's turn about its down axis; at the tilts that are flown it is that of its heading.
    """
    if turn is None:
        return DeckTurn(yaw_rad)
    expected = turn.yaw_rad + dt * (body_rate_rad_s - turn.rate_rad_s)
    off = wrap_pi(yaw_rad - expected)
    rate = turn.rate_rad_s - POLE_RAD_S * POLE_RAD_S * dt * off
    return DeckTurn(wrap_pi(expected + 2.0 * POLE_RAD_S * dt * off), min(MOST_RAD_S, max(-MOST_RAD_S, rate)))
