"""The exposure while no pad is tracked: nobody knows which part of the picture to meter, so two exposures take turns.

The first keeps the brightest parts of the picture from clipping, as a lit pad on a dark sea needs it. The second shows what is in
its darkest parts, as a pad in the shade beside the mirrored sun needs it; where the first shows that too, there is no second.
"""

from __future__ import annotations

from msgspec import Struct

from drivers.camera.exposure_law import ExposureRange, ExposureSetting, LawMemory, Metered, step

_DWELL = 8
"""Pictures with one exposure before the other's turn: a quarter of a second at 30 Hz, enough for several looks of the search."""
_APART_EV = 1.0
"""Stops between the two from which on they take turns."""
_FARTHEST_EV = 3.0


class BracketMemory(Struct, frozen=True):
    """What the search remembers from picture to picture."""

    law: LawMemory = LawMemory()
    pictures: int = 0
    """Number of pictures with this exposure."""
    back_to_s: float | None = None
    """Product of time and gain of the first exposure while it is the second's turn, s."""


def search_step(
    memory: BracketMemory, held: ExposureSetting, can: ExposureRange, limit_s: float, brightest: Metered, darkest: Metered
) -> tuple[BracketMemory, ExposureSetting | None]:
    """Return the exposure that the camera is to take; None to leave it. The arguments are those of `step`."""
    pictures = memory.pictures + 1
    if memory.back_to_s is not None:
        if pictures < _DWELL:
            return BracketMemory(memory.law, pictures, memory.back_to_s), step(memory.law, held, can, limit_s, None)[1]
        return BracketMemory(), can.split(memory.back_to_s, limit_s)
    law, wanted = step(memory.law, held, can, limit_s, brightest)
    if wanted is not None or pictures < _DWELL:
        return BracketMemory(law, 0 if wanted is not None else pictures), wanted
    apart_ev = darkest.error_ev
    second = can.split(held.product_s * 2.0 ** min(apart_ev, _FARTHEST_EV), limit_s)
    if apart_ev < _APART_EV or second.product_s < 1.4 * held.product_s:
        return BracketMemory(law), None
    return BracketMemory(law, 0, held.product_s), second
