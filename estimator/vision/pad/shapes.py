"""The shapes that a pad is painted with, in metres from its centre: x along the arrow, y to starboard of it.

Discs, rings, panels and triangles lie about the centre, letters and fiducials have sides along x or y, strokes and polygons
straight ones, the arrowhead points along x.
"""

import math
from typing import Literal

import numpy as np
from msgspec import Struct

from estimator.contracts.geometry import F64
from estimator.vision.pad.fiducial import PaintedFiducial, signed_area

Letter = Literal["H", "I", "L", "T", "X"]
Part = Literal["disc", "panel", "rim", "ring", "arrow", "triangle", "letter", "fiducial"]
"""Kinds of regions.

A region is the disc or the panel under the markings, a disc's rim, a ring, the pointer beyond it, the pointer around lettering,
lettering, or a fiducial, which registration measures as lettering.
"""


class PaintedDisc(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="disc"):
    """A disc about the centre."""

    paint: str
    radius_m: float


class PaintedPanel(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="panel"):
    """A rectangle about the centre that fiducials are painted on."""

    paint: str
    length_m: float
    """Extent along x."""
    width_m: float
    """Extent along y."""

    def corners(self) -> F64:
        """Return the (4, 2) m outline, clockwise seen from above."""
        x, y = 0.5 * self.length_m, 0.5 * self.width_m
        return np.array([(-x, -y), (x, -y), (x, y), (-x, y)])


class PaintedRing(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="ring"):
    """A ring about the centre."""

    paint: str
    inner_m: float
    outer_m: float
    part: Literal["ring", "rim"] = "ring"
    """A rim lies around the disc and is not measured: the deck around it may have its colour."""


class PaintedArrowhead(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="arrowhead"):
    """A triangle whose apex lies on +x and points outward. It says which of two headings is right."""

    paint: str
    tip_m: float
    """Distance of the apex from the centre."""
    depth_m: float
    half_base_m: float

    def corners(self) -> F64:
        """Return (3, 2) m: apex, starboard base corner, port base corner."""
        base = self.tip_m - self.depth_m
        return np.array([(self.tip_m, 0.0), (base, self.half_base_m), (base, -self.half_base_m)])


class PaintedLetter(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="letter"):
    """A letter about the centre, its upper end towards +x. An X has its arms along x and y, so +x is between two of its ends."""

    paint: str
    letter: Letter
    length_m: float
    """Extent along x."""
    width_m: float
    """Extent along y."""
    stroke_m: float
    """Width of the strokes along x, and of the others if `bar_m` is not given."""
    bar_m: float | None = None
    """Width of the strokes along y."""

    def corners(self) -> F64:
        """Return the (N, 2) m outline, clockwise seen from above."""
        x, y, s, b = 0.5 * self.length_m, 0.5 * self.width_m, self.stroke_m, self.bar_m or self.stroke_m
        inner, leg, bar = y - s, 0.5 * s, 0.5 * b
        match self.letter:
            case "H":
                port = [(x, -y), (x, -inner), (bar, -inner), (bar, inner), (x, inner), (x, y)]
                return np.array([*port, *((-u, -v) for u, v in port)])
            case "X":
                fore = [(x, -leg), (x, leg), (bar, leg), (bar, y), (-bar, y), (-bar, leg)]
                return np.array([*fore, *((-u, -v) for u, v in fore)])
            case "I":
                return np.array([(x, -leg), (x, leg), (-x, leg), (-x, -leg)])
            case "T":
                return np.array([(x, -y), (x, y), (x - b, y), (x - b, leg), (-x, leg), (-x, -leg), (x - b, -leg), (x - b, -y)])
            case _:
                return np.array([(x, -y), (x, s - y), (b - x, s - y), (b - x, y), (-x, y), (-x, -y)])


class PaintedTriangle(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="triangle"):
    """The outline of an equilateral triangle about the centre, its apex on +x. It says which of two headings is right."""

    paint: str
    side_m: float
    """Length of an outer side."""
    stroke_m: float
    """Width of the painted line."""

    def corners(self) -> F64:
        """Return (3, 2) m: the outer corners, clockwise seen from above, from the apex."""
        return self._corners(1.0)

    def borders(self) -> tuple[F64, F64]:
        """Return the outer corners, and the inner ones in the reversed order, (3, 2) m each."""
        return self._corners(1.0), self._corners(1.0 - self.stroke_m / self.inscribed_m())[::-1]

    def inscribed_m(self) -> float:
        """Return the distance of the outer sides from the centre."""
        return self.side_m / math.sqrt(12.0)

    def _corners(self, size: float) -> F64:
        return size * circle(2.0 * self.inscribed_m(), 3)


class PaintedStroke(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="stroke"):
    """A straight stroke with square ends."""

    paint: str
    from_m: tuple[float, float]
    to_m: tuple[float, float]
    width_m: float

    def corners(self) -> F64:
        """Return the (4, 2) m outline, clockwise seen from above."""
        a, b = np.array(self.from_m), np.array(self.to_m)
        along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
        aside = 0.5 * self.width_m * np.array([-along[1], along[0]])
        return np.array([a - aside, b - aside, b + aside, a + aside])


class PaintedPolygon(Struct, frozen=True, forbid_unknown_fields=True, tag_field="shape", tag="polygon"):
    """A polygon with straight sides, and holes in it where what lies below shows."""

    paint: str
    points_m: tuple[tuple[float, float], ...]
    holes_m: tuple[tuple[tuple[float, float], ...], ...] = ()

    def corners(self) -> F64:
        """Return the (N, 2) m outline, clockwise seen from above."""
        points = np.array(self.points_m, dtype=float).reshape(-1, 2)
        return points if signed_area(points) > 0.0 else points[::-1]

    def holes(self) -> tuple[F64, ...]:
        """Return the outlines of the holes, (N, 2) m each, the other way around."""
        lines = (np.array(hole, dtype=float).reshape(-1, 2) for hole in self.holes_m)
        return tuple(line if signed_area(line) < 0.0 else line[::-1] for line in lines)


Region = (
    PaintedDisc
    | PaintedPanel
    | PaintedRing
    | PaintedArrowhead
    | PaintedTriangle
    | PaintedLetter
    | PaintedStroke
    | PaintedPolygon
    | PaintedFiducial
)
Lettering = PaintedLetter | PaintedStroke | PaintedPolygon | PaintedFiducial


def part_of(region: Region) -> Part:
    """Return what detection takes a region for."""
    match region:
        case PaintedDisc():
            return "disc"
        case PaintedPanel():
            return "panel"
        case PaintedRing():
            return region.part
        case PaintedFiducial():
            return "fiducial"
        case PaintedArrowhead():
            return "arrow"
        case PaintedTriangle():
            return "triangle"
        case _:
            return "letter"


def circle(radius_m: float, n: int = 72) -> F64:
    """Return (n, 2) m: points of a circle about the centre, clockwise seen from above, starting at +x."""
    a = np.linspace(0.0, math.tau, n, endpoint=False)
    return np.stack([radius_m * np.cos(a), radius_m * np.sin(a)], axis=1)


def borders_of(region: Region, n: int = 72) -> tuple[F64, ...]:
    """Return the closed lines (N, 2) m around a region; those of a ring have `n` points each."""
    match region:
        case PaintedDisc():
            return (circle(region.radius_m, n),)
        case PaintedRing():
            return circle(region.outer_m, n), circle(region.inner_m, n)
        case PaintedFiducial() | PaintedTriangle():
            return region.borders()
        case PaintedPolygon():
            return region.corners(), *region.holes()
        case _:
            return (region.corners(),)
