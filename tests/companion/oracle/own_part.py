"""The lean that a vehicle adds by itself to the one that is asked for: the trim of its own velocity loop, one axis at a time.

A vehicle that takes velocities with an acceleration fed forward cancels wind by an integral of its own. Its tilt is the asked one
behind its response, plus that integral:
    tilt = response(asked - own) + own'
What of the reported tilt the response does not explain is own' - own; a slow mean of it carries `own` to own', so that the tilt
becomes the one that the law wants, whatever the vehicle does beside it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.settings.response import TiltResponse

FLOWN_S, HOVERED_S = 0.7, 2.0
"""Time constants of the mean: while the law steers, and while the vehicle holds by itself and all of its lean is its own, s."""
MOST_M_S2 = 3.0


class OwnPart(NamedTuple):
    """The memory of one axis."""

    own: float
    """The vehicle's own part, m/s^2."""
    lean: float
    """Tilt that the response explains, m/s^2."""
    rate: float = 0.0
    """Its rate, m/s^3."""


def begun(lean: float) -> OwnPart:
    """Return the memory where somebody else steered until now: all of the reported lean is the vehicle's own."""
    return OwnPart(lean, lean)


def flown(part: OwnPart, lean: float, lag: float, dt: float, tilt: TiltResponse) -> OwnPart:
    """Return the memory after `dt` s of a law that steers.

    Args:
        lean: reported tilt, m/s^2.
        lag: the rotors' state by the commands that have arrived, m/s^2.
    """
    w = tilt.frequency_rad_s
    rate = part.rate + dt * (w * w * (lag - part.lean) - 2.0 * tilt.damping * w * part.rate)
    explained = part.lean + dt * rate
    own = part.own + (1.0 - math.exp(-dt / FLOWN_S)) * (lean - explained)
    return OwnPart(min(MOST_M_S2, max(-MOST_M_S2, own)), explained, rate)


def hovered(part: OwnPart, lean: float, dt: float) -> OwnPart:
    """Return the memory after `dt` s in which the vehicle held by itself."""
    own = part.own + (1.0 - math.exp(-dt / HOVERED_S)) * (lean - part.own)
    return OwnPart(min(MOST_M_S2, max(-MOST_M_S2, own)), lean)
