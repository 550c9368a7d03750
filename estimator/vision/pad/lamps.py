"""The lamps of a pad for nights: the rules that their pattern keeps, and how well they measure.

A dark frame shows nothing else, so the pattern says how the pad is turned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import Camera

FEWEST = 5
"""Least number of lamps of a pad that has any: with four in view it could not be distinguished from four other lights."""
MOST = 40
"""Largest number of lamps."""
_WIDTH_LEAST = 0.2
"""Least extent of the lamps across their longest line, as a part of that: of a row of lamps the far side is not distinguished."""
_ALIKE = 0.25  # Part of the distance between two lamps by which a turned pattern must miss a lamp, or the pattern looks the same

CENTRE_PX = 0.1
"""Assumed standard deviation of the centre of a lamp's spot."""
_RESOLVED_PX = 3.0  # Least distance of two lamps that are two spots


class Lamp(Struct, frozen=True, forbid_unknown_fields=True):
    """A lamp that shines upwards from the pad."""

    at_m: tuple[float, float]
    """Its place: along the arrow and to starboard, from the pad's centre."""
    radius_m: Annotated[float, Meta(ge=0.001, le=0.2)] = 0.012
    """Radius of what shines."""


def places_of(lamps: Sequence[Lamp]) -> F64:
    """Return the places of lamps, (N, 2) m."""
    return np.array([lamp.at_m for lamp in lamps], dtype=float).reshape(-1, 2)


def check_lamps(lamps: Sequence[Lamp], where: str) -> None:
    """Check that lamps make a pattern that can be distinguished from any other heading of it.

    Raises:
        BadInput: too few, two in one place, all in a line, or a pattern that looks the same after a turn.
    """
    if not lamps:
        return
    if len(lamps) < FEWEST:
        raise BadInput(f"{where}: lamps has {len(lamps)}: fewer than {FEWEST} are taken for any lights on a deck: add some")
    for (i, a), (j, b) in combinations(enumerate(lamps), 2):
        if math.dist(a.at_m, b.at_m) < a.radius_m + b.radius_m:
            raise BadInput(f"{where}: lamps[{j}] at {list(b.at_m)} touches lamps[{i}] at {list(a.at_m)}: take one out")
    places = places_of(lamps)
    long, wide = np.linalg.svd(places - places.mean(axis=0), compute_uv=False).tolist()
    if wide < _WIDTH_LEAST * long:
        raise BadInput(f"{where}: the lamps lie in a line: place some of them beside it")
    for n in range(2, len(lamps) + 1):
        if _looks_alike(places, math.tau / n):
            raise BadInput(
                f"{where}: the lamps look the same after a turn by {360 / n:g} degrees: leave one out, or move one, so that "
                "their heading is known"
            )


def _looks_alike(places: F64, angle_rad: float) -> bool:
    """Return whether each lamp lies near another one's place after a turn about the pad's centre."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned = places @ np.array([[c, s], [-s, c]])
    off = np.linalg.norm(turned[:, None] - places[None], axis=2).min(axis=1)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    nearest = float(apart[~np.eye(len(places), dtype=bool)].min())
    return bool(np.all(off < _ALIKE * nearest))


@dataclass(frozen=True, slots=True)
class LampAccuracy:
    """The Cramer-Rao bound of one frame from straight above, its tilt known."""

    height_m: float
    lamps: int
    """Number of lamps in view."""
    spots: int
    """Number of spots that they make in the frame."""
    lateral_m: float
    """Standard deviation along the worse direction."""
    range_m: float
    yaw_rad: float
    """All three are infinite with fewer than two spots."""


def lamp_accuracy(lamps: tuple[Lamp, ...], camera: Camera, height_m: float) -> LampAccuracy:
    """Return the accuracy of one frame at a height over the pad's centre, by spots whose centres are known to `CENTRE_PX`."""
    focal_px = 0.5 * (camera.fx + camera.fy)
    places = places_of(lamps)
    uv = focal_px / height_m * places
    # The top of the frame is ahead: x of the pad is up, y to the right.
    seen = (np.abs(uv[:, 0]) < 0.5 * camera.height) & (np.abs(uv[:, 1]) < 0.5 * camera.width)
    spots = _resolved(uv[seen])
    if len(spots) < 2:
        return LampAccuracy(height_m, int(seen.sum()), len(spots), math.inf, math.inf, math.inf)
    scale, none = focal_px / height_m, np.zeros(len(spots))
    along = np.stack([none + scale, none, -spots[:, 0] / height_m, -spots[:, 1]], axis=1)
    across = np.stack([none, none + scale, -spots[:, 1] / height_m, spots[:, 0]], axis=1)
    J = np.concatenate([along, across])
    cov = np.linalg.inv(J.T @ J) * CENTRE_PX**2
    lateral_m = math.sqrt(float(np.linalg.eigvalsh(cov[:2, :2])[-1]))
    return LampAccuracy(height_m, int(seen.sum()), len(spots), lateral_m, math.sqrt(cov[2, 2]), math.sqrt(cov[3, 3]))


def _resolved(uv: F64) -> F64:
    """Return the middles of the spots that lamps at these places make, (S, 2) px: those nearer than can be resolved are one."""
    spots: list[list[F64]] = []
    for place in uv:
        near = next((spot for spot in spots if any(np.linalg.norm(place - other) < _RESOLVED_PX for other in spot)), None)
        if near is None:
            spots.append([place])
        else:
            near.append(place)
    return np.array([np.mean(spot, axis=0) for spot in spots]).reshape(-1, 2)
