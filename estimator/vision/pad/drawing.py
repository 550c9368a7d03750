"""The pad's drawing for measuring: its edges as points with normals, and the paints that meet there."""

import math
from collections.abc import Sequence
from enum import IntEnum
from functools import lru_cache

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad.fiducial import PaintedFiducial
from estimator.vision.pad.geometry import depth_in, sides_of
from estimator.vision.pad.markings import BARE, Markings, Rgb
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import Lettering, PaintedPanel, PaintedTriangle
from estimator.vision.srgb import LUMA, linear_light

_SPACING_M = 0.004  # Distance between points on an edge
_FIDUCIAL_STEP = 1.0 / 6.0  # Distance between points on the edges of a fiducial, in its cells


class EdgeKind(IntEnum):
    """Kinds of edges, by the paints that meet: the paint inside is named first. A pad may lack some of them."""

    DISC = 0
    """The edge between the disc and the surroundings, or between the disc and its rim if it has one."""
    RING = 1
    """The edges between the ring and the disc, on both sides of the ring."""
    ARROW = 2
    """The edge between the disc and the pointer: the part of the arrowhead beyond the ring, or a triangle around lettering."""
    H = 3
    """The edge between the lettering and the disc."""
    UPPER = 4
    """The edge between lettering of a second paint and what it lies on, the other lettering or the disc."""


class Edges(Struct, frozen=True, eq=False):
    """Points on the edges of a pad. Neighbours of a piece are in order, and the pieces of one kind are contiguous."""

    at_m: F64
    """Positions of the points, (M, 2) m: x along the arrow, y to starboard of it."""
    normal: F64
    """Unit normals, (M, 2), pointing out of the inner paint."""
    kind: NDArray[np.intp]
    """The `EdgeKind` of each point, (M,), ascending."""
    piece: NDArray[np.intp]
    """Index of the piece of each point, (M,), ascending: disc, ring inside, ring outside, the panel's sides, the arrow's two
    sides or the triangle's, the lettering's, the upper lettering's. A piece is one circle, one straight side, or a closed line
    around cells of a fiducial.
    """
    spacing_m: F64
    """Distance between neighbours, (M,)."""
    inside_rgb: NDArray[np.uint8]
    """The paint on the inner side, against the normal, (M, 3) sRGB."""
    bare: NDArray[np.bool_]
    """True if the outer side is the surroundings, whose colour is not known, (M,)."""
    contrast: F64
    """Luminance inside minus outside, (M,), -1..1 of a white surface: positive where the inner paint is the brighter one."""


@lru_cache(maxsize=8)
def edges_of(pad: Pad) -> Edges:
    """Return the edges that a pad is recognised and measured by, every few millimetres; the result is cached.

    They are derived from the pad's regions: for each border the stretches at which two paints meet. The outer edge of a rim is
    left out, as the deck may have its colour, and so is the ring beside the arrowhead, where another edge is too near.
    """
    marks = pad.markings
    pieces = [
        *_circles(marks), *_sides(EdgeKind.DISC, marks.panel), *_arrow_sides(marks), *_sides(EdgeKind.ARROW, marks.triangle),
        *_letter_sides(EdgeKind.H, marks.letters), *_letter_sides(EdgeKind.UPPER, marks.upper),
    ]  # fmt: skip
    paints, count = _paints(marks), [len(at) for _, at, _ in pieces]
    spacing = [float(np.linalg.norm(at[1] - at[0])) if len(at) > 1 else _SPACING_M for _, at, _ in pieces]
    kind = np.repeat([int(kind) for kind, _, _ in pieces], count)
    inside, outside = (np.array([paints[k][side] or BARE for k in EdgeKind], np.uint8)[kind] for side in (0, 1))
    return Edges(
        np.concatenate([at for _, at, _ in pieces]),
        np.concatenate([normal for _, _, normal in pieces]),
        kind,
        np.repeat(np.arange(len(pieces)), count),
        np.repeat(spacing, count),
        inside,
        np.array([paints[k][1] is None for k in EdgeKind])[kind],
        np.asarray((linear_light(inside) - linear_light(outside)) @ LUMA),
    )


def _paints(marks: Markings) -> dict[EdgeKind, tuple[Rgb, Rgb | None]]:
    """Return the paints inside and outside of each kind of edge; None for the surroundings."""
    c = marks.colours
    below = c.disc if marks.has_ground else None
    return {
        EdgeKind.DISC: (c.disc, c.rim),
        EdgeKind.RING: (c.ring, below),
        EdgeKind.ARROW: (c.ring if marks.triangle is None else c.h, below),
        EdgeKind.H: (c.h, below),
        EdgeKind.UPPER: (c.upper or BARE, c.h if marks.upper_on_letters else below),
    }


_Piece = tuple[EdgeKind, F64, F64]


def _circles(marks: Markings) -> list[_Piece]:
    """Return the disc's edge and the ring's two."""
    pieces: list[_Piece] = []
    beside_arrow = math.atan2(1.25 * marks.arrow_half_base_m, marks.ring_inner_m)
    for kind, radius, sign, gap in (
        (EdgeKind.DISC, marks.field_radius_m, 1.0, 0.0),
        (EdgeKind.RING, marks.ring_inner_m, -1.0, beside_arrow),
        (EdgeKind.RING, marks.ring_outer_m, 1.0, beside_arrow),
    ):
        if radius > 0.0:
            n = math.ceil((math.tau - 2 * gap) * radius / (1.5 * _SPACING_M))
            a = gap + (np.arange(n) + 0.5) / n * (math.tau - 2 * gap)
            normal = np.stack([np.cos(a), np.sin(a)], axis=1)
            pieces.append((kind, radius * normal, sign * normal))
    return pieces


def _arrow_sides(marks: Markings) -> list[_Piece]:
    """Return the arrowhead's two slanted sides, from the apex to where the ring covers them."""
    corners = marks.arrowhead()[:, :2]
    pieces: list[_Piece] = []
    for i in range(1, len(corners)):
        a, b = corners[0], _until_circle(corners[0], corners[i], marks.ring_outer_m)
        along = (b - a) / np.linalg.norm(b - a)
        normal = np.array([along[1], -along[0]])
        pieces.append((EdgeKind.ARROW, *_along(a, b, normal if normal @ a > 0 else -normal)))
    return pieces


def _sides(kind: EdgeKind, region: PaintedPanel | PaintedTriangle | None) -> list[_Piece]:
    """Return the straight sides of a panel, or the outer and the inner ones of a triangle around the lettering."""
    return [] if region is None else [(kind, *_side(a, b)) for a, b in zip(*sides_of(region), strict=True)]


def _letter_sides(kind: EdgeKind, letters: Sequence[Lettering]) -> list[_Piece]:
    """Return the sides of lettering of one paint without what lies inside another letter or stroke."""
    pieces: list[_Piece] = []
    for letter in letters:
        if isinstance(letter, PaintedFiducial):
            pieces += [(kind, *_around(line, _FIDUCIAL_STEP * letter.cell_m)) for line in letter.borders()]
            continue
        for a, b in zip(*sides_of(letter), strict=True):
            at, normal = _side(a, b)
            free = np.ones(len(at), bool)
            for other in letters:
                if other is not letter:
                    free &= depth_in(other, at) < 1e-9
            borders = np.flatnonzero(np.diff(np.r_[False, free, False]))
            pieces += [(kind, at[i:j], normal[i:j]) for i, j in borders.reshape(-1, 2).tolist()]
    return pieces


def _around(line: F64, spacing_m: float) -> tuple[F64, F64]:
    """Return points and normals all around a closed line whose inside is to the right of its direction seen from above."""
    sides = [_side(a, b, spacing_m) for a, b in zip(line, np.roll(line, -1, axis=0), strict=True)]
    return np.concatenate([at for at, _ in sides]), np.concatenate([normal for _, normal in sides])


def _side(a: F64, b: F64, spacing_m: float = _SPACING_M) -> tuple[F64, F64]:
    """Return points and normals of a straight side.

    Corners run clockwise seen from above with z into the deck, from x to y, so outside is to the left of the direction of travel.
    """
    along = (b - a) / np.linalg.norm(b - a)
    return _along(a, b, np.array([along[1], -along[0]]), spacing_m)


def _until_circle(start: F64, end: F64, radius: float) -> F64:
    """Return where the segment from outside the circle meets it; `end` if it does not."""
    way = end - start
    a, b, c = way @ way, start @ way, start @ start - radius**2
    disc = b * b - a * c
    if disc <= 0:
        return end
    s = (-b - math.sqrt(disc)) / a
    return start + way * s if 0 < s < 1 else end


def _along(a: F64, b: F64, normal: F64, spacing_m: float = _SPACING_M) -> tuple[F64, F64]:
    n = max(2, round(float(np.linalg.norm(b - a)) / spacing_m))
    at = a + (b - a) * ((np.arange(n) + 0.5) / n)[:, None]
    return at, np.broadcast_to(normal, at.shape)
