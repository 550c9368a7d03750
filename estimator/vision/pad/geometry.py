"""Geometry of a pad's regions: what they cover, how deep a point lies in them, their straight sides, and pieces of them.

Registration blurs each of these pieces exactly.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad import shapes
from estimator.vision.pad.fiducial import PaintedFiducial, signed_area

Rectangle = tuple[float, float, float, float]
"""Limits x0, x1, y0, y1, m."""
TOUCH_M = 1e-6
"""Borders nearer than this touch, and ends of a side that differ by less along an axis lie in a line along the other, m."""


def outlines_of(region: shapes.Region, n: int = 72) -> tuple[F64, ...]:
    """Return closed lines, their corners (N, 2) m each, whose insides together are the region.

    A ring's and a triangle's line goes once around and back within; so do those of a fiducial around its light cells and of a
    polygon around its holes.
    """
    match region:
        case shapes.PaintedTriangle():
            return (np.vstack([np.vstack([line, line[:1]]) for line in shapes.borders_of(region)]),)
        case shapes.PaintedRing():
            outer, inner = (np.vstack([line, line[:1]]) for line in shapes.borders_of(region, n))
            return (np.vstack([outer, inner[::-1]]),)
        case PaintedFiducial():
            return region.outlines()
        case shapes.PaintedPolygon() if region.holes_m:
            return (_around_holes(region),)
        case _:
            return shapes.borders_of(region, n)


def depth_in(region: shapes.Region, xy_m: F64) -> F64:
    """Return the signed distances (N,) of points (N, 2) to a region's border, m: positive inside."""
    match region:
        case shapes.PaintedDisc():
            return np.asarray(region.radius_m - np.hypot(*xy_m.T))
        case shapes.PaintedRing():
            r = np.hypot(*xy_m.T)
            return np.asarray(np.minimum(region.outer_m - r, r - region.inner_m))
        case _:
            return _depth_within(*sides_of(region), xy_m)


def covers(region: shapes.Region, xy_m: F64) -> NDArray[np.bool_]:
    """Return whether points (N, 2) m lie in a region."""
    match region:
        case PaintedFiducial():
            return region.covers(xy_m)
        case shapes.PaintedPanel():
            return np.asarray((np.abs(xy_m[:, 0]) < 0.5 * region.length_m) & (np.abs(xy_m[:, 1]) < 0.5 * region.width_m))
        case shapes.PaintedTriangle() | shapes.PaintedStroke() | shapes.PaintedPolygon() if is_slanted(region):
            return np.asarray(np.any([_inside(piece, xy_m) for piece in convex_pieces_of(region)], axis=0))
        case shapes.PaintedDisc() | shapes.PaintedRing():
            return depth_in(region, xy_m) > 0.0
        case _:
            start, end = sides_of(region)
            out = _is_within(start, end, xy_m)
            out[out] = _distance(start, end, xy_m[out]) > 0.0
            return out


def sheet_of(regions: Sequence[shapes.Region]) -> shapes.Region | None:
    """Return the lowest region if it is the ground of all others: a panel or polygon around a ring or a disc and all else."""
    sheet, *others = regions
    round_ones = any(isinstance(region, shapes.PaintedDisc | shapes.PaintedRing) for region in others)
    if not round_ones or not (
        isinstance(sheet, shapes.PaintedPanel) or (isinstance(sheet, shapes.PaintedPolygon) and not sheet.holes_m)
    ):
        return None
    lines = [line for region in others for line in shapes.borders_of(region)]
    return sheet if depth_in(sheet, np.concatenate(lines)).min() > 0.0 else None


def sides_of(region: shapes.Region) -> tuple[F64, F64]:
    """Return the starts and the ends, (N, 2) m each, of the straight sides around a region."""
    lines = shapes.borders_of(region)
    return np.concatenate(lines), np.concatenate([np.roll(line, -1, axis=0) for line in lines])


def reach_of(region: shapes.Region) -> tuple[float, float]:
    """Return the least and the largest distance of a region's border from the centre, m."""
    match region:
        case shapes.PaintedDisc():
            return region.radius_m, region.radius_m
        case shapes.PaintedRing():
            return region.inner_m, region.outer_m
        case _:
            far = float(np.hypot(*region.corners().T).max())
            return abs(float(depth_in(region, np.zeros((1, 2)))[0])), far


def is_slanted(region: shapes.Region) -> bool:
    """Return whether a region has straight sides that lie neither along x nor along y."""
    match region:
        case shapes.PaintedTriangle() | shapes.PaintedArrowhead():
            return True
        case shapes.PaintedStroke() | shapes.PaintedPolygon():
            start, end = sides_of(region)
            return bool(np.any(np.all(np.abs(end - start) > TOUCH_M, axis=1)))
        case _:
            return False


def slanted_sides_of(regions: Sequence[shapes.Region]) -> tuple[F64, F64]:
    """Return the starts and the ends, (N, 2) m each, of all sides of those regions that have slanted ones."""
    sides = [sides_of(region) for region in regions if is_slanted(region)]
    return tuple(np.concatenate([np.empty((0, 2)), *(each[k] for each in sides)]) for k in (0, 1))  # type: ignore[return-value]


def convex_pieces_of(region: shapes.Region) -> list[F64]:
    """Return convex polygons of three or four corners, clockwise seen from above, that make up a region with straight sides.

    They do not overlap.
    Source of the cuts of a polygon: Meisters, Polygons have ears, American Mathematical Monthly 82(6), 1975.
    """
    match region:
        case shapes.PaintedTriangle():
            outer, inner = region.borders()
            inner = inner[::-1]
            return [np.array([outer[i], outer[j], inner[j], inner[i]]) for i, j in ((0, 1), (1, 2), (2, 0))]
        case shapes.PaintedStroke():
            return [region.corners()]
        case shapes.PaintedPolygon():
            return _ears(_around_holes(region))
        case _:
            raise TypeError(f"no region of straight sides: {region}")


def _around_holes(region: shapes.PaintedPolygon) -> F64:
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


def apart_m(one: shapes.Region, other: shapes.Region) -> float:
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
        if near <= TOUCH_M or np.any(_cross(a, b, c, d)):
            return True
    return False


def _cross(a: F64, b: F64, c: F64, d: F64) -> NDArray[np.bool_]:
    """Return whether sides from a to b, (N, 2), cross sides from c to d, (M, 2): (N, M)."""

    def side(p: F64, q: F64, r: F64) -> F64:
        way, to = (q - p)[:, None, :], r[None, :, :] - p[:, None, :]
        return np.asarray(way[..., 0] * to[..., 1] - way[..., 1] * to[..., 0])

    return np.asarray((side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0).T)


def rectangles_of(letters: Sequence[shapes.Lettering]) -> list[Rectangle]:
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
