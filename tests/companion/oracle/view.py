"""The lean that keeps the pad in the picture of a camera fixed to the body."""

from __future__ import annotations

import math

from companion.guidance.view import FieldOfView
from estimator.contracts.motion import G_M_S2

LEAST_M_S2 = 0.6
"""Lean beside the trim that the view never takes away, m/s^2: without any, the wind would carry the drone off."""
FROM_M = 0.6
"""Below this height the pad leaves the picture anyway, and the lean is left alone."""


def lean_in_view(
    view: FieldOfView, lean: tuple[float, float], trim: tuple[float, float], d_body_pad_level: list[float]
) -> tuple[float, float]:
    """Return the lean, m/s^2 forward and right, cut so that the pad's centre stays in the picture.

    Leaning forward turns the camera astern, so the pad moves towards the picture's forward edge by as much.
    """
    forward, right, down = d_body_pad_level
    if down < FROM_M:
        return lean
    ahead, beside = math.atan2(forward - view.forward_m, down), math.atan2(right - view.right_m, down)
    return (
        _within(lean[0], trim[0], ahead, view.half_forward_rad),
        _within(lean[1], trim[1], beside, view.half_right_rad),
    )


def _within(lean: float, trim: float, bearing_rad: float, half_rad: float) -> float:
    most = G_M_S2 * math.tan(max(0.0, min(1.2, half_rad - bearing_rad)))
    least = -G_M_S2 * math.tan(max(0.0, min(1.2, half_rad + bearing_rad)))
    return min(max(most, trim + LEAST_M_S2), max(min(least, trim - LEAST_M_S2), lean))
