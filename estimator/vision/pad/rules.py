"""Rules for a pad's regions: each edge lies between two known paints and can be distinguished from the others."""

from collections.abc import Mapping, Sequence

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.core.abi import DL_FIGURE_CUTS, DL_FIGURE_RECTANGLES, DL_FIGURE_SIDES
from estimator.vision.camera.camera import shown
from estimator.vision.pad import shapes
from estimator.vision.pad.fiducial import PaintedFiducial
from estimator.vision.pad.fiducial_rules import check_fiducials
from estimator.vision.pad.geometry import (
    TOUCH_M,
    apart_m,
    convex_pieces_of,
    depth_in,
    is_slanted,
    reach_of,
    rectangles_of,
    slanted_sides_of,
)
from estimator.vision.pad.markings import Rgb, layers_of
from estimator.vision.pad.shapes import part_of
from estimator.vision.srgb import linear_light

RECTANGLES_MOST, CUTS_MOST, SIDES_MOST = DL_FIGURE_RECTANGLES, DL_FIGURE_CUTS, DL_FIGURE_SIDES
"""Limits for lettering of one paint: number of rectangles, of their limits along one axis, and of sides of slanted parts."""
_LEAST_CONTRAST = 0.03
"""Least distance of two paints in linear light, full scale 1 in each channel: less drowns in a worn deck's own variation."""


def check_regions(regions: Sequence[shapes.Region], paints: Mapping[str, Rgb], where: str, ground: str = "") -> None:
    """Check the regions against one another and against their paints, and that of the ground if it is known.

    Raises:
        BadInput: regions cross or hide one another, there is a second one of a part, or a paint does not stand out.
    """
    parts = [part_of(region) for region in regions]
    for part in ("disc", "panel", "rim", "ring", "arrow", "triangle"):
        if parts.count(part) > 1:
            first, second = [i for i, p in enumerate(parts) if p == part][:2]
            raise BadInput(f"{where}: regions[{second}] is a second {part} beside regions[{first}]; a pad has one: take one out")
    letters = [r for r in regions if isinstance(r, shapes.Lettering)]
    if not letters and "ring" not in parts and "disc" not in parts:
        raise BadInput(f"{where}: regions has neither disc, ring nor lettering; a pad needs one of them")
    _check_parts(regions, letters, where)
    _check_letters(regions, where)
    check_fiducials(regions, paints, where)
    upper = layers_of(regions)[1]
    for i, region in enumerate(regions):
        below = _below(regions, i, where)
        if region in upper:
            _check_upper(regions, i, below, where)
        if under := regions[below].paint if below >= 0 else ground:
            _check_contrast(region.paint, under, paints, f"{where}: regions[{i}]")


def _check_letters(regions: Sequence[shapes.Region], where: str) -> None:
    letters, upper = layers_of(regions)
    if len({r.paint for r in upper}) > 1:
        named = ", ".join(sorted({r.paint for r in (*letters, *upper)}))
        raise BadInput(
            f"{where}: the letters, strokes, polygons and fiducials have several paints ({shown(named)}); give them one, and a "
            "second one to those that lie above"
        )
    if upper and any(isinstance(r, PaintedFiducial) for r in (*letters, *upper)):
        raise BadInput(
            f"{where}: fiducials and lettering of a second paint ({shown(upper[0].paint)}) are in regions: give them one"
        )
    triangle = [r for r in regions if isinstance(r, shapes.PaintedTriangle)]
    _check_layer(regions, letters, triangle, where)
    _check_layer(regions, upper, [], where)


def _check_layer(
    regions: Sequence[shapes.Region], layer: Sequence[shapes.Lettering], more: Sequence[shapes.Region], where: str
) -> None:
    """Check that lettering of one paint, with more of that paint, is simple enough to be measured."""
    rectangles, sides = rectangles_of(layer), len(slanted_sides_of([*layer, *more])[0])
    cuts = max((len({v for r in rectangles for v in r[at : at + 2]}) for at in (0, 2)), default=0)
    if len(rectangles) > RECTANGLES_MOST or cuts > CUTS_MOST or sides > SIDES_MOST:
        raise BadInput(
            f"{where}: the lettering is made of {len(rectangles)} rectangles between {cuts} lines along an axis and of "
            f"shapes with {sides} slanted or other sides; at most {RECTANGLES_MOST} between {CUTS_MOST} and "
            f"{SIDES_MOST} are measured: paint fewer or simpler letters or fiducials"
        )
    _check_slanted(regions, [*layer, *more], where)


def _check_slanted(regions: Sequence[shapes.Region], layer: Sequence[shapes.Region], where: str) -> None:
    """Check that shapes with slanted sides keep away from others of their paint: what both cover would count twice."""
    for i, region in enumerate(regions):
        for j, other in enumerate(regions[:i]):
            if region not in layer or other not in layer or not (is_slanted(region) or is_slanted(other)):
                continue
            within = depth_in(region, other.corners()).max() > 0.0 or depth_in(other, region.corners()).max() > 0.0  # type: ignore[union-attr]
            if within or apart_m(region, other) <= TOUCH_M:
                raise BadInput(
                    f"{where}: regions[{i}] ({part_of(region)}) touches regions[{j}] ({part_of(other)}) of the same paint, and "
                    "one of them has slanted sides: draw both as one polygon, or move them apart"
                )


def _check_upper(regions: Sequence[shapes.Region], i: int, below: int, where: str) -> None:
    """Check that lettering of a second paint comes above the other, and that all of it lies on the same."""
    letters, upper = layers_of(regions)
    if any(r in letters or isinstance(r, shapes.PaintedTriangle) for r in regions[i:]):
        raise BadInput(
            f"{where}: regions[{i}] has the second paint {shown(regions[i].paint)} of lettering, and lettering of the first one "
            "follows: what lies above comes last"
        )
    for j, other in enumerate(regions[:i]):
        if (other in letters or isinstance(other, shapes.PaintedTriangle)) and apart_m(regions[i], other) <= TOUCH_M:
            raise BadInput(
                f"{where}: regions[{i}] of the second paint {shown(regions[i].paint)} touches the border of regions[{j}] "
                f"({part_of(other)}): move it wholly on or off"
            )
    on = below >= 0 and regions[below] in letters
    if on != any(depth_in(r, upper[0].corners()).min() > 0.0 for r in letters):
        raise BadInput(
            f"{where}: regions[{i}] of the second paint {shown(regions[i].paint)} lies {'on' if on else 'beside'} the other "
            "lettering, and another region of this paint does not: draw all of them on it, or all beside it"
        )
    if below >= 0 and part_of(regions[below]) not in ("letter", "disc", "panel"):
        raise BadInput(
            f"{where}: regions[{i}] lies on regions[{below}] ({part_of(regions[below])}): lettering lies on a disc, a panel, the "
            "bare deck or other lettering; move it"
        )


def _check_parts(regions: Sequence[shapes.Region], letters: Sequence[shapes.Lettering], where: str) -> None:
    by = {part_of(region): region for region in regions}
    ring, arrow, disc, rim = by.get("ring"), by.get("arrow"), by.get("disc"), by.get("rim")
    if isinstance(rim, shapes.PaintedRing) and not (
        isinstance(disc, shapes.PaintedDisc) and abs(rim.inner_m - disc.radius_m) < TOUCH_M
    ):
        raise BadInput(f"{where}: the rim's inner_m {rim.inner_m:g} must be the disc's radius_m: a rim lies around a disc")
    if "panel" in by and (other := next((part for part in ("disc", "ring", "arrow") if part in by), None)):
        raise BadInput(
            f"{where}: a panel and a {other} are in regions: unless it comes first and lies around all others, a panel carries "
            f'fiducials and lettering alone; take it out, or write ground = "{by["panel"].paint}" above [paints] if it is around'
        )
    triangle = by.get("triangle")
    if isinstance(triangle, shapes.PaintedTriangle):
        if arrow is not None:
            raise BadInput(f"{where}: a triangle and an arrowhead are in regions: each tells the heading; take one out")
        if letters and all(letter.paint != triangle.paint for letter in layers_of(regions)[0]):
            raise BadInput(f"{where}: the triangle must have the lettering's paint, got {shown(triangle.paint)}")
    if isinstance(ring, shapes.PaintedRing):
        _check_in_ring(ring, triangle, arrow, letters, where)


def _check_in_ring(
    ring: shapes.PaintedRing,
    triangle: shapes.Region | None,
    arrow: shapes.Region | None,
    letters: Sequence[shapes.Lettering],
    where: str,
) -> None:
    """Check that a triangle and lettering lie in the ring, and that an arrowhead points beyond it."""
    if isinstance(triangle, shapes.PaintedTriangle) and reach_of(triangle)[1] >= ring.inner_m:
        raise BadInput(
            f"{where}: the triangle must fit inside of the ring, whose inner_m is {ring.inner_m:g}: its corners are "
            f"{reach_of(triangle)[1]:.3g} m from the centre"
        )
    if any(reach_of(letter)[1] >= ring.inner_m for letter in letters):
        raise BadInput(
            f"{where}: the lettering must fit inside of the ring, whose inner_m is {ring.inner_m:g}; a sheet or deck around "
            'it is no region: write its paint above [paints], as ground = "white"'
        )
    if isinstance(arrow, shapes.PaintedArrowhead) and (arrow.tip_m <= ring.outer_m or arrow.paint != ring.paint):
        raise BadInput(
            f"{where}: the arrowhead must have the ring's paint and point beyond it: its tip_m is {arrow.tip_m:g}, the ring's "
            f"outer_m {ring.outer_m:g}"
        )


def _below(regions: Sequence[shapes.Region], i: int, where: str) -> int:
    """Return the topmost region that region `i` is painted on, -1 for the surroundings."""
    region, below = regions[i], -1
    line = _samples(region)
    for j in range(i):
        depth = depth_in(regions[j], line)
        inside, outside = bool(np.any(depth > TOUCH_M)), bool(np.any(depth < -TOUCH_M))
        same = regions[j].paint == region.paint
        if inside and outside and not same:
            raise BadInput(
                f"{where}: regions[{i}] ({part_of(region)}) crosses the border of regions[{j}] ({part_of(regions[j])}), and its "
                "surroundings change on the way: move it wholly on or off, or give both one paint"
            )
        if inside and not outside and same:
            raise BadInput(
                f"{where}: regions[{i}] lies in regions[{j}], which has the same paint {shown(region.paint)}: it cannot be seen; "
                "take it out or change its paint"
            )
        if inside and not outside:
            below = j
        if not inside and np.all(depth_in(region, np.vstack([_samples(regions[j]), _inner(regions[j])])) > -TOUCH_M):
            raise BadInput(f"{where}: regions[{i}] hides regions[{j}], which comes before it: the lowest region comes first")
    return below


def _samples(region: shapes.Region) -> F64:
    """Return points of a region's borders, (N, 2) m, the corners among them."""
    lines = []
    for border in shapes.borders_of(region, 180):
        way = np.roll(border, -1, axis=0) - border
        lines += [border + s * way for s in ((0.0,) if len(border) == 180 else (0.0, 0.2, 0.4, 0.6, 0.8))]
    return np.concatenate(lines)


def _inner(region: shapes.Region) -> F64:
    """Return points in the middle of a region, (N, 2) m."""
    match region:
        case shapes.PaintedDisc() | shapes.PaintedPanel():
            return np.zeros((1, 2))
        case shapes.PaintedRing():
            return shapes.circle(0.5 * (region.inner_m + region.outer_m), 4)
        case shapes.PaintedArrowhead():
            return np.asarray(region.corners().mean(axis=0, keepdims=True))
        case _ if is_slanted(region):
            return np.array([piece.mean(axis=0) for piece in convex_pieces_of(region)])
        case shapes.PaintedTriangle():
            raise AssertionError("a triangle has slanted sides")
        case _:
            return np.array([(0.5 * (x0 + x1), 0.5 * (y0 + y1)) for x0, x1, y0, y1 in rectangles_of([region])])


def _check_contrast(paint: str, below: str, paints: Mapping[str, Rgb], where: str) -> None:
    contrast = float(np.linalg.norm(linear_light(paints[paint]) - linear_light(paints[below])))
    if contrast < _LEAST_CONTRAST:
        raise BadInput(
            f"{where}.paint {shown(paint)} {list(paints[paint])} does not stand out from {shown(below)} "
            f"below it: {contrast:.3f} of linear light, at least {_LEAST_CONTRAST:g}: choose a lighter or a darker paint"
        )
