"""Which method speaks for the frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from estimator.contracts.estimates import Method, Sighting
from estimator.contracts.geometry import wrap_pi


def choose(methods: Mapping[Method, Sighting | None], disc_cut: bool) -> Method | None:
    """The thesis' priorities (section 4.1.5): corners where the disc reaches the frame's edge, else arrow, else ellipse.

    Where only the corners have an estimate it is taken although the whole disc shows: the thesis had none there and said zeros.

    Args:
        disc_cut: the disc reaches the frame's edge.
    """
    order: tuple[Method, ...] = ("corners", "arrow", "ellipse") if disc_cut else ("arrow", "ellipse", "corners")
    return next((m for m in order if methods.get(m) is not None), None)


def with_heading_of(sighting: Sighting, arrow: Sighting | None) -> Sighting:
    """A heading known up to 180 degrees, settled by an arrow seen in the same frame; unchanged where there is none.

    The arrow decides only which of the two it is; the two must agree to 20 degrees.
    """
    if not sighting.yaw_ambiguous or sighting.yaw_rad is None or arrow is None or arrow.yaw_rad is None:
        return sighting
    for yaw_rad in (sighting.yaw_rad, wrap_pi(sighting.yaw_rad + math.pi)):
        if abs(wrap_pi(yaw_rad - arrow.yaw_rad)) < math.radians(20.0):
            return replace(sighting, yaw_rad=yaw_rad, yaw_ambiguous=False)
    return sighting
