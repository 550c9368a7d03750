"""The deck under a vehicle: its outline, and its motion at one instant with the water beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from msgspec import Struct

from estimator.contracts.geometry import F64

Vec = tuple[float, float, float]
Rows = tuple[Vec, Vec, Vec]


@dataclass(frozen=True)
class DeckShape:
    """Outline of the deck around the pad's centre: a rectangle in the hull's axes whose fore end may taper to the stem."""

    fore_m: float
    aft_m: float
    port_m: float
    starboard_m: float
    taper_m: float = 0.0
    """Length over which the fore end tapers as in `sitl.camera.surroundings.Deck.outline`, m; 0 for a square end."""
    pad_yaw_rad: float = 0.0
    """Angle of the arrow from the hull's axis, clockwise from above, rad."""

    def __post_init__(self) -> None:
        sides = (self.fore_m, self.aft_m, self.port_m, self.starboard_m)
        if not all(math.isfinite(s) for s in sides) or self.fore_m + self.aft_m <= 0 or self.port_m + self.starboard_m <= 0:
            raise ValueError(f"a deck needs a length and a width, got fore, aft, port, starboard = {sides}")

    @cached_property
    def turned(self) -> tuple[float, float, float, float]:
        """Cosine and sine of the arrow's angle, and the middle and the half of the width, m."""
        middle, half = 0.5 * (self.starboard_m - self.port_m), 0.5 * (self.starboard_m + self.port_m)
        return math.cos(self.pad_yaw_rad), math.sin(self.pad_yaw_rad), middle, half

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point of the pad's plane (m along the arrow, m to starboard of it) lies on the deck."""
        c, s, middle, half = self.turned
        along = c * x - s * y
        across = s * x + c * y - middle
        fore = self.fore_m
        if self.taper_m > 0.0:
            share = across / half
            fore -= self.taper_m * (share * share) ** 1.1
        return -self.aft_m <= along <= fore and -half <= across <= half


class Ground(Struct):
    """The pad's frame (which is also the deck's) and the water under the vehicle at one instant."""

    p: Vec
    """Position of the pad's centre in ned, m."""
    v: Vec
    """Velocity of the pad's centre in ned, m/s."""
    R: Rows
    """Rows of R_ned_pad."""
    w: Vec
    """Angular velocity in the pad frame, rad/s."""
    sea_z: float = 0.0
    """Height of the water's surface under the vehicle, m down."""
    sea_vz: float = 0.0
    """Velocity of the water's surface under the vehicle, m/s down."""

    @staticmethod
    def of(p_ned: F64, v_ned: F64, R_ned_pad: F64, w_pad: F64, sea_z: float = 0.0, sea_vz: float = 0.0) -> Ground:
        """Return the ground for arrays (3,), (3,), (3, 3), (3,)."""
        a, b, c = R_ned_pad.tolist()
        rows = (tuple(a), tuple(b), tuple(c))
        return Ground(tuple(p_ned.tolist()), tuple(v_ned.tolist()), rows, tuple(w_pad.tolist()), sea_z, sea_vz)

    @staticmethod
    def nowhere() -> Ground:
        """Return a ground without deck or water within reach, for flights that meet neither."""
        far = 1e6
        return Ground((0.0, 0.0, far), (0.0,) * 3, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0,) * 3, far)

    def write_deck(self, deck: Any) -> None:
        """Write the core's `sim_deck`."""
        deck.p, deck.v, deck.R, deck.w = self.p, self.v, (*self.R[0], *self.R[1], *self.R[2]), self.w
