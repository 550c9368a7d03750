"""The pad's drawing, in metres from its centre: x along the arrow, y to starboard of it, z into the deck."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.file_numbers import finite, shown

LARGEST_M = 20.0
"""Largest radius of a disc. The limit bounds memory: the disc's edges are sampled every few millimetres."""


@dataclass(frozen=True, slots=True)
class Colours:
    """Nominal colours of the paints, sRGB 0..255.

    They are a starting point for rendered frames and colour limits. Detection never relies on them alone.
    """

    disc: tuple[int, int, int]
    ring: tuple[int, int, int]
    h: tuple[int, int, int]
    rim: tuple[int, int, int] | None = None


@dataclass(frozen=True, slots=True)
class Pad:
    """The drawing of the pad: disc, ring, arrowhead and H. All lengths are in metres.

    Raises:
        ValueError: a length is not positive, or the shapes do not fit into one another.
    """

    name: str
    disc_radius_m: float
    rim_width_m: float
    """Width of a differently coloured rim inside the disc's edge; 0 for none."""
    ring_inner_m: float
    ring_outer_m: float
    arrow_tip_m: float
    """Distance of the arrowhead's apex from the centre. The apex points outward."""
    arrow_depth_m: float
    arrow_half_base_m: float
    h_length_m: float
    """Length of the H's legs, along the arrow."""
    h_width_m: float
    """Overall width of the H across the arrow, from outer edge to outer edge."""
    leg_width_m: float
    bar_width_m: float
    """Width of the cross-bar, along the arrow."""
    colours: Colours

    def __post_init__(self) -> None:
        for f in fields(self):
            if f.name.endswith("_m"):
                v = getattr(self, f.name)
                if not math.isfinite(v) or v < 0 or (v == 0 and f.name != "rim_width_m"):
                    raise ValueError(f"{f.name} must be a positive length in metres, got {v!r}")
        if self.disc_radius_m > LARGEST_M or max(self.arrow_half_base_m, self.arrow_depth_m) > self.disc_radius_m:
            raise ValueError(f"disc_radius_m is at most {LARGEST_M:g}, and the arrow lies inside the disc")
        if not self.ring_inner_m < self.ring_outer_m < self.arrow_tip_m < self.disc_radius_m - self.rim_width_m:
            raise ValueError("ring_inner_m < ring_outer_m < arrow_tip_m < disc_radius_m - rim_width_m must hold")
        if math.hypot(self.h_length_m, self.h_width_m) / 2 >= self.ring_inner_m:
            raise ValueError("the H (h_length_m by h_width_m) must fit inside the ring")
        if 2 * self.leg_width_m >= self.h_width_m or self.bar_width_m >= self.h_length_m:
            raise ValueError("leg_width_m or bar_width_m leaves no room in the H")

    @staticmethod
    def from_mapping(data: Mapping[str, Any], where: str = "pad") -> Pad:
        """Build a pad from the keys of a pad file (configs/pads/*.toml).

        Raises:
            BadInput: a key is missing, unknown, of the wrong type or out of range; the text names `where` and the key.
        """
        names = {f.name for f in fields(Pad)}
        if unknown := sorted(set(data) - names):
            raise BadInput(f"{where}: unknown key {unknown[0]!r}; known are {', '.join(sorted(names))}")
        if missing := sorted(names - {"rim_width_m"} - set(data)):
            raise BadInput(f"{where}: key {missing[0]!r} is missing")
        values: dict[str, Any] = {"rim_width_m": 0.0}
        for key, value in data.items():
            if key.endswith("_m"):
                found = finite(value)
                if found is None:
                    raise BadInput(f"{where}: {key} must be a length in metres, got {shown(value)}")
                values[key] = found
        if not isinstance(data["name"], str):
            raise BadInput(f"{where}: name must be text, got {shown(data['name'])}")
        values["name"] = data["name"]
        values["colours"] = _colours(data["colours"], where)
        try:
            return Pad(**values)
        except ValueError as why:
            raise BadInput(f"{where}: {why}") from why

    @property
    def ring_radius_m(self) -> float:
        """Radius of the ring's centre-line."""
        return (self.ring_inner_m + self.ring_outer_m) / 2

    @property
    def bar_length_m(self) -> float:
        """Length of the cross-bar between the legs, across the arrow."""
        return self.h_width_m - 2 * self.leg_width_m

    def h_corners(self) -> F64:
        """Return (12, 3) m: the H's outline, clockwise seen from above, starting at the fore outer corner of the port leg."""
        length, outer, bar = self.h_length_m / 2, self.h_width_m / 2, self.bar_width_m / 2
        inner = outer - self.leg_width_m
        xy = [
            (length, -outer), (length, -inner), (bar, -inner), (bar, inner), (length, inner), (length, outer),
            (-length, outer), (-length, inner), (-bar, inner), (-bar, -inner), (-length, -inner), (-length, -outer),
        ]  # fmt: skip
        return np.array([(x, y, 0.0) for x, y in xy])

    def arrowhead(self) -> F64:
        """Return (3, 3) m: the arrowhead's apex, starboard base corner and port base corner."""
        base = self.arrow_tip_m - self.arrow_depth_m
        return np.array([(self.arrow_tip_m, 0.0, 0.0), (base, self.arrow_half_base_m, 0.0), (base, -self.arrow_half_base_m, 0.0)])

    def circle(self, radius_m: float, n: int = 72) -> F64:
        """Return (n, 3) m: points of a circle about the centre, clockwise seen from above, starting at the arrow."""
        a = np.linspace(0.0, math.tau, n, endpoint=False)
        return np.stack([radius_m * np.cos(a), radius_m * np.sin(a), np.zeros(n)], axis=1)


def _colours(data: object, where: str) -> Colours:
    if not isinstance(data, Mapping):
        raise BadInput(f"{where}: colours must be a table with disc, ring, h and perhaps rim")
    if unknown := sorted(set(data) - {"disc", "ring", "h", "rim"}):
        raise BadInput(f"{where}: unknown key colours.{unknown[0]!r}")
    out: dict[str, tuple[int, int, int]] = {}
    for key in ("disc", "ring", "h", "rim"):
        if key not in data:
            if key == "rim":
                continue
            raise BadInput(f"{where}: key colours.{key} is missing")
        rgb = data[key]
        if not isinstance(rgb, list) or len(rgb) != 3 or not all(type(c) is int and 0 <= c <= 255 for c in rgb):
            raise BadInput(f"{where}: colours.{key} must be three whole numbers 0..255 (red, green, blue), got {shown(rgb)}")
        out[key] = (rgb[0], rgb[1], rgb[2])
    return Colours(out["disc"], out["ring"], out["h"], out.get("rim"))
