"""Select the method whose sighting is used for a frame."""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec.structs import replace

from estimator.contracts.estimates import Method, Sighting
from estimator.contracts.geometry import wrap_pi


def choose(methods: Mapping[Method, Sighting | None], disc_cut: bool) -> Method | None:
    """Choose by the thesis' priorities (section 4.1.5): corners if the disc reaches the frame's edge, else arrow, else ellipse.

    If only the corners have an estimate, it is used even if the whole disc shows; the thesis returned zeros there.

    Args:
        disc_cut: the disc reaches the frame's edge.
    """
    order: tuple[Method, ...] = ("corners", "arrow", "ellipse") if disc_cut else ("arrow", "ellipse", "corners")
    return next((m for m in order if methods.get(m) is not None), None)


def with_heading_of(sighting: Sighting, arrow: Sighting | None) -> Sighting:
    """Resolve a heading that is ambiguous by 180 degrees with an arrow in the same frame; without one return it unchanged.

    The arrow only selects one of the two headings; the two must agree to 20 degrees.
    """
    if not sighting.yaw_ambiguous or sighting.yaw_rad is None or arrow is None or arrow.yaw_rad is None:
        return sighting
    for yaw_rad in (sighting.yaw_rad, wrap_pi(sighting.yaw_rad + math.pi)):
        if abs(wrap_pi(yaw_rad - arrow.yaw_rad)) < math.radians(20.0):
            return replace(sighting, yaw_rad=yaw_rad, yaw_ambiguous=False)
    return sighting
