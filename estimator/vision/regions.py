"""The shapes that a pad is painted with, in metres from its centre: x along the arrow, y to starboard of it.

Discs, rings, panels and triangles lie about the centre, letters and fiducials have sides along x or y, strokes and polygons
straight ones, the arrowhead points along x. Registration blurs each of these exactly.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.fiducial import PaintedFiducial, signed_area

Letter = Literal["H", "I", "L", "T", "X"]
Part = Literal["disc", "panel", "rim", "ring", "arrow", "triangle", "letter", "fiducial"]
"""Kinds of regions.

A region is the disc or the panel under the markings, a disc's rim, a ring, the pointer beyond it, the pointer around lettering,
lettering, or a fiducial, which registration measures as lettering.
"""
Rectangle = tuple[float, float, float, float]
"""Limits x0, x1, y0, y1, m."""
_TOUCH_M = 1e-6
"""Ends of a side that differ by less along an axis lie in a line along the other."""


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


def outlines_of(region: Region, n: int = 72) -> tuple[F64, ...]:
    """Return closed lines, their corners (N, 2) m each, whose insides together are the region.

    A ring's and a triangle's line goes once around and back within; so do those of a fiducial around its light cells and of a
    polygon around its holes.
    """
    match region:
        case PaintedTriangle():
            return (np.vstack([np.vstack([line, line[:1]]) for line in borders_of(region)]),)
        case PaintedRing():
            outer, inner = (np.vstack([line, line[:1]]) for line in borders_of(region, n))
            return (np.vstack([outer, inner[::-1]]),)
        case PaintedFiducial():
            return region.outlines()
        case PaintedPolygon() if region.holes_m:
            return (_around_holes(region),)
        case _:
            return borders_of(region, n)


def depth_in(region: Region, xy_m: F64) -> F64:
    """Return the signed distances (N,) of points (N, 2) to a region's border, m: positive inside."""
    match region:
        case PaintedDisc():
            return np.asarray(region.radius_m - np.hypot(*xy_m.T))
        case PaintedRing():
            r = np.hypot(*xy_m.T)
            return np.asarray(np.minimum(region.outer_m - r, r - region.inner_m))
        case _:
            return _depth_within(*sides_of(region), xy_m)


def covers(region: Region, xy_m: F64) -> NDArray[np.bool_]:
    """Return whether points (N, 2) m lie in a region."""
    match region:
        case PaintedFiducial():
            return region.covers(xy_m)
        case PaintedPanel():
            return np.asarray((np.abs(xy_m[:, 0]) < 0.5 * region.length_m) & (np.abs(xy_m[:, 1]) < 0.5 * region.width_m))
        case PaintedTriangle() | PaintedStroke() | PaintedPolygon() if is_slanted(region):
            return np.asarray(np.any([_inside(piece, xy_m) for piece in convex_pieces_of(region)], axis=0))
        case PaintedDisc() | PaintedRing():
            return depth_in(region, xy_m) > 0.0
        case _:
            start, end = sides_of(region)
            out = _is_within(start, end, xy_m)
            out[out] = _distance(start, end, xy_m[out]) > 0.0
            return out


def sheet_of(regions: Sequence[Region]) -> Region | None:
    """Return the lowest region if it is the ground of all others: a panel or polygon around a ring or a disc and all else."""
    sheet, *others = regions
    round_ones = any(isinstance(region, PaintedDisc | PaintedRing) for region in others)
    if not round_ones or not (isinstance(sheet, PaintedPanel) or (isinstance(sheet, PaintedPolygon) and not sheet.holes_m)):
        return None
    lines = [line for region in others for line in borders_of(region)]
    return sheet if depth_in(sheet, np.concatenate(lines)).min() > 0.0 else None


def sides_of(region: Region) -> tuple[F64, F64]:
    """Return the starts and the ends, (N, 2) m each, of the straight sides around a region."""
    lines = borders_of(region)
    return np.concatenate(lines), np.concatenate([np.roll(line, -1, axis=0) for line in lines])


def reach_of(region: Region) -> tuple[float, float]:
    """Return the least and the largest distance of a region's border from the centre, m."""
    match region:
        case PaintedDisc():
            return region.radius_m, region.radius_m
        case PaintedRing():
            return region.inner_m, region.outer_m
        case _:
            far = float(np.hypot(*region.corners().T).max())
            return abs(float(depth_in(region, np.zeros((1, 2)))[0])), far


def is_slanted(region: Region) -> bool:
    """Return whether a region has straight sides that lie neither along x nor along y."""
    match region:
        case PaintedTriangle() | PaintedArrowhead():
            return True
        case PaintedStroke() | PaintedPolygon():
            start, end = sides_of(region)
            return bool(np.any(np.all(np.abs(end - start) > _TOUCH_M, axis=1)))
        case _:
            return False


def slanted_sides_of(regions: Sequence[Region]) -> tuple[F64, F64]:
    """Return the starts and the ends, (N, 2) m each, of all sides of those regions that have slanted ones."""
    sides = [sides_of(region) for region in regions if is_slanted(region)]
    return tuple(np.concatenate([np.empty((0, 2)), *(each[k] for each in sides)]) for k in (0, 1))  # type: ignore[return-value]


def convex_pieces_of(region: Region) -> list[F64]:
    """Return convex polygons of three or four corners, clockwise seen from above, that make up a region with straight sides.

    They do not overlap.
    Source of the cuts of a polygon: Meisters, Polygons have ears, American Mathematical Monthly 82(6), 1975.
    """
    match region:
        case PaintedTriangle():
            outer, inner = region.borders()
            inner = inner[::-1]
            return [np.array([outer[i], outer[j], inner[j], inner[i]]) for i, j in ((0, 1), (1, 2), (2, 0))]
        case PaintedStroke():
            return [region.corners()]
        case PaintedPolygon():
            return _ears(_around_holes(region))
        case _:
            raise TypeError(f"no region of straight sides: {region}")


def _around_holes(region: PaintedPolygon) -> F64:
    """Return one line around a polygon, which goes to each hole and back the same way."""
    line = region.corners()
    for hole in sorted(region.holes(), key=lambda hole: -float(hole[:, 0].max())):
        start, end = sides_of(region)
        ways = np.linalg.norm(line[:, None] - hole[None], axis=2)
        for at in np.argsort(ways, axis=None):
            i, j = divmod(int(at), len(hole))
            if not np.any(_cross(line[[i]], hole[[j]], start, end)):
                break
        line = np.vstack([line[: i + 1], hole[j:], hole[: j + 1], line[i:]])
    return line


def _inside(piece: F64, xy_m: F64) -> NDArray[np.bool_]:
    """Return whether points (N, 2) m lie in a convex polygon, clockwise seen from above, or on its border."""
    out, (x, y) = np.ones(len(xy_m), bool), xy_m.T
    for a, b in zip(piece, np.roll(piece, -1, axis=0), strict=True):
        out &= (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= 0.0
    return out


def _ears(line: F64) -> list[F64]:
    """Return triangles that cover a simple polygon, which runs clockwise seen from above."""
    left, out = line, []
    while len(left) > 3:
        around = [np.roll(left, 1 - i, axis=0) for i in range(len(left))]
        # Three corners in a row that turn clockwise about a triangle in which none of the others lies.
        turning = ((i, c[:3], c[3:]) for i, c in enumerate(around) if signed_area(c[:3]) > 0.0)
        ears = (i for i, ear, rest in turning if not np.any(_depth_within(ear, np.roll(ear, -1, axis=0), rest) > 0.0))
        # What has no ear is nearly a line: its flattest corner goes.
        cut = next(ears, None)
        if cut is None:
            cut = min(range(len(left)), key=lambda i: abs(signed_area(around[i][:3])))
        else:
            out.append(around[cut][:3])
        left = np.delete(left, cut, axis=0)
    return [*out, left]


def apart_m(one: Region, other: Region) -> float:
    """Return the least distance of the borders of two regions with straight sides; 0 if they cross."""
    (a, b), (c, d) = sides_of(one), sides_of(other)
    if np.any(_cross(a, b, c, d)):
        return 0.0
    return float(min(_distance(a, b, c).min(), _distance(c, d, a).min()))


def sides_meet(line: F64) -> bool:
    """Return whether two sides of a closed line (N, 2) touch or cross that are not neighbours."""
    start, end = line, np.roll(line, -1, axis=0)
    n = len(line)
    for i in range(n - 2):
        others = np.arange(i + 2, n - 1 if i == 0 else n)
        if len(others) == 0:
            continue
        a, b, c, d = start[[i]], end[[i]], start[others], end[others]
        near = min(_distance(a, b, c).min(), _distance(a, b, d).min(), _distance(c, d, a).min(), _distance(c, d, b).min())
        if near <= _TOUCH_M or np.any(_cross(a, b, c, d)):
            return True
    return False


def _cross(a: F64, b: F64, c: F64, d: F64) -> NDArray[np.bool_]:
    """Return whether sides from a to b, (N, 2), cross sides from c to d, (M, 2): (N, M)."""

    def side(p: F64, q: F64, r: F64) -> F64:
        way, to = (q - p)[:, None, :], r[None, :, :] - p[:, None, :]
        return np.asarray(way[..., 0] * to[..., 1] - way[..., 1] * to[..., 0])

    return np.asarray((side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0).T)


def rectangles_of(letters: Sequence[Lettering]) -> list[Rectangle]:
    """Return rectangles that do not overlap and cover all letters without slanted sides, the largest first."""
    sides = [sides_of(letter) for letter in letters if not is_slanted(letter)]
    if not sides:
        return []
    cuts = sorted({y_m for start, _ in sides for y_m in start[:, 1].tolist()})
    found: list[Rectangle] = []
    open_at: dict[tuple[float, float], Rectangle] = {}
    for y0, y1 in pairwise(cuts):
        merged: list[tuple[float, float]] = []
        for x0, x1 in sorted(span for start, end in sides for span in _spans(start, end, 0.5 * (y0 + y1))):
            if merged and x0 <= merged[-1][1]:
                merged[-1] = merged[-1][0], max(merged[-1][1], x1)
            else:
                merged.append((x0, x1))
        # A rectangle goes on where the next strip has one between the same limits.
        reached = {span: open_at.pop(span, (*span, y0, y1)) for span in merged}
        found += open_at.values()
        open_at = {span: (*rectangle[:3], y1) for span, rectangle in reached.items()}
    found += open_at.values()
    return sorted(found, key=lambda r: -round((r[1] - r[0]) * (r[3] - r[2]), 12))


def _spans(start: F64, end: F64, y: float) -> list[tuple[float, float]]:
    """Return where a line of constant y lies inside of sides along x or y."""
    crossed = (np.minimum(start[:, 1], end[:, 1]) < y) & (np.maximum(start[:, 1], end[:, 1]) > y)
    x = sorted(start[crossed, 0].tolist())
    return list(zip(x[::2], x[1::2], strict=False))


def _distance(start: F64, end: F64, xy_m: F64) -> F64:
    """Return the distances (M,) of points (M, 2) to the nearest of some sides, m."""
    a, b = start[None, :, :], end[None, :, :]
    p, way = xy_m[:, None, :], b - a
    s = np.clip(np.sum((p - a) * way, axis=2) / np.maximum(np.sum(way * way, axis=2), 1e-18), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - s[..., None] * way, axis=2).min(axis=1))


def _depth_within(start: F64, end: F64, xy_m: F64) -> F64:
    away = _distance(start, end, xy_m)
    return np.asarray(np.where(_is_within(start, end, xy_m), away, -away))


def _is_within(start: F64, end: F64, xy_m: F64) -> NDArray[np.bool_]:
    """Return whether points (N, 2) are within sides, by the number of sides to one side of them."""
    a, b = start[None, :, :], end[None, :, :]
    p, way = xy_m[:, None, :], b - a
    above = (a[..., 1] > p[..., 1]) != (b[..., 1] > p[..., 1])
    x = a[..., 0] + (p[..., 1] - a[..., 1]) / np.where(way[..., 1] == 0.0, 1.0, way[..., 1]) * way[..., 0]
    return np.asarray(np.count_nonzero(above & (x > p[..., 0]), axis=1) % 2 == 1)
