"""Faults of what the camera sees as data: things on the deck, the light, the lens.

They are drawn into the finished frame, so that each may begin at any time. What they draw has no motion blur of its own.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from estimator.contracts.keys import choice, number, text
from sitl.faults.fault import Fault

_FORWARD, _RIGHT = "place along the pad's arrow from its centre", "place to starboard of the pad's arrow"


class PictureFault(Fault, frozen=True):
    """Something that changes the picture."""


class PadCovered(PictureFault, frozen=True, tag="pad_covered"):
    """A tarpaulin hides part of the pad."""

    fraction: Annotated[float, number("hidden fraction of the pad's diameter, from its edge", "1", 0.05, 1.0)] = 0.5
    from_deg: Annotated[float, number("side from which it is hidden, clockwise from the arrow", "deg", -360.0, 360.0)] = 90.0


class ObjectOnPad(PictureFault, frozen=True, tag="object_on_pad"):
    """Something lies on the pad or beside it."""

    thing: Annotated[Literal["vest", "towel", "lifebuoy"], choice("what lies there")] = "vest"
    forward_m: Annotated[float, number(_FORWARD, "m", -20.0, 20.0)] = 0.0
    right_m: Annotated[float, number(_RIGHT, "m", -20.0, 20.0)] = 0.0
    size_m: Annotated[float, number("its length", "m", 0.05, 5.0)] = 0.5
    turned_deg: Annotated[float, number("its direction, clockwise from the arrow", "deg", -360.0, 360.0)] = 30.0


class OtherPad(PictureFault, frozen=True, tag="other_pad"):
    """Another pad on the deck, beside the right one or in its place."""

    file: Annotated[str, text("a shipped pad (configs/pads)", 40)] = "thesis"
    size: Annotated[float, number("its size over that in the file", "1", 0.1, 5.0)] = 1.0
    forward_m: Annotated[float, number(_FORWARD, "m", -20.0, 20.0)] = 0.0
    right_m: Annotated[float, number(_RIGHT, "m", -20.0, 20.0)] = 0.0
    turned_deg: Annotated[float, number("direction of its arrow, clockwise from that of the pad", "deg", -360.0, 360.0)] = 0.0
    instead: Annotated[bool, choice("whether the right pad is painted over")] = False

    def check(self) -> None:
        if not self.instead and self.forward_m == 0.0 and self.right_m == 0.0:
            raise ValueError("forward_m or right_m must say where the other pad is, or instead must be true")


class Glint(PictureFault, frozen=True, tag="glint"):
    """The sun is mirrored by wet paint on the pad."""

    brightness: Annotated[float, number("light at the middle of the spot, in units of white paint", "1", 0.05, 20.0)] = 3.0
    radius_m: Annotated[float, number("radius at which it has fallen to a half", "m", 0.01, 5.0)] = 0.25
    forward_m: Annotated[float, number(_FORWARD, "m", -20.0, 20.0)] = 0.1
    right_m: Annotated[float, number(_RIGHT, "m", -20.0, 20.0)] = 0.1


class LightFalls(PictureFault, frozen=True, tag="light_falls"):
    """A lamp goes out, or a cloud comes: the light falls to a fraction."""

    fraction: Annotated[float, number("remaining fraction of the light", "1", 0.0001, 1.0)] = 0.1


class WetLens(PictureFault, frozen=True, tag="wet_lens"):
    """Drops stand on the lens; what is behind them is blurred."""

    drops: Annotated[int, number("number of drops, at places drawn by the seed", "1", 1, 200)] = 12
    radius: Annotated[float, number("mean radius over the height of the image", "1", 0.01, 1.0)] = 0.08
    blur_px: Annotated[float, number("standard deviation of the blur behind a drop", "px", 0.5, 60.0)] = 9.0


class FocalLength(PictureFault, frozen=True, tag="focal_length"):
    """The lens has another focal length than the camera's file says."""

    scale: Annotated[float, number("true focal length over that of the file", "1", 0.7, 1.4)] = 1.02

    def check(self) -> None:
        if self.scale == 1.0:
            raise ValueError("scale is 1: nothing would change")


def light_stops(faults: list[tuple[LightFalls, float]]) -> float:
    """Return the change of the light by these faults, in stops."""
    return sum(math.log2(fault.fraction) for fault, _ in faults)
