"""The rules that a pad's regions keep, so that each edge lies between two known paints and can be told apart from the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.core.interface.registration import FIGURE_CUTS, FIGURE_RECTANGLES
from estimator.vision.fiducial import PaintedFiducial
from estimator.vision.file_numbers import shown
from estimator.vision.lamp import Lamp
from estimator.vision.markings import Rgb
from estimator.vision.pad_fiducials import check_fiducials
from estimator.vision.regions import (
    Lettering,
    PaintedArrowhead,
    PaintedDisc,
    PaintedLetter,
    PaintedPanel,
    PaintedPolygon,
    PaintedRing,
    PaintedStroke,
    Region,
    borders_of,
    circle,
    depth_in,
    part_of,
    reach_of,
    rectangles_of,
)
from estimator.vision.srgb import linear_light

RECTANGLES_MOST, CUTS_MOST = FIGURE_RECTANGLES, FIGURE_CUTS
"""The largest numbers of rectangles that the lettering is made of, and of their limits along one axis."""
_LEAST_CONTRAST = 0.03
"""Least distance of two paints in linear light, full scale 1 in each channel: less drowns in a worn deck's own variation."""
_TOUCH_M = 1e-6
"""Borders nearer than this touch and do not cross."""


def check_regions(regions: Sequence[Region], paints: Mapping[str, Rgb], where: str) -> None:
    """Check the regions against one another and against their paints.

    Raises:
        BadInput: regions cross or hide one another, there is a second one of a part, or a paint does not stand out.
    """
    parts = [part_of(region) for region in regions]
    for part in ("disc", "panel", "rim", "ring", "arrow"):
        if parts.count(part) > 1:
            first, second = [i for i, p in enumerate(parts) if p == part][:2]
            raise BadInput(f"{where}: regions[{second}] is a second {part} beside regions[{first}]; a pad has one: take one out")
    letters = [r for r in regions if isinstance(r, PaintedLetter | PaintedStroke | PaintedPolygon | PaintedFiducial)]
    if not letters and "ring" not in parts and "disc" not in parts:
        raise BadInput(f"{where}: regions has neither disc, ring nor lettering; a pad needs one of them")
    _check_letters(letters, where)
    _check_parts(regions, letters, where)
    check_fiducials(regions, paints, where)
    for i, region in enumerate(regions):
        below = _below(regions, i, where)
        if below >= 0:
            _check_contrast(region, regions[below], paints, f"{where}: regions[{i}]")


def lacking_parts(regions: Sequence[Region]) -> list[str]:
    """Return which of disc, ring and lettering a pad lacks.

    A pad with a fiducial, which is told by its bits, and an H or X alone, told by all of its edges at once, lack nothing.

    Verification was fitted on pads that have all three. Without one of them a deck's plates and lines, or another pad, were taken
    for the pad: on 40 of 40 empty decks 37 times for a bare H, 25 for an X, 3 for a ring with an H, 11 for a disc with an H.
    """
    parts = {part_of(region) for region in regions}
    alone = len(regions) == 1 and isinstance(regions[0], PaintedLetter) and regions[0].letter in ("H", "X")
    if alone or "fiducial" in parts:
        return []
    return [name for part, name in (("disc", "disc"), ("ring", "ring"), ("letter", "lettering")) if part not in parts]


def check_for_detection(regions: Sequence[Region], lamps: Sequence[Lamp], where: str) -> None:
    """Check that a pad can be told from what else lies on decks, by its paint or by its lamps.

    Raises:
        BadInput: it has no lamps, and lacks a part that verification needs.
    """
    if not lamps and (lacking := lacking_parts(regions)):
        raise BadInput(
            f"{where}: regions has no {' and no '.join(lacking)}: such a pad is seen where there is none, and cannot be detected "
            "or landed on, only printed, checked and painted; paint a disc, a ring on it and lettering in the ring, a fiducial, "
            "an H or X alone, or add lamps"
        )


def _check_letters(letters: Sequence[Lettering], where: str) -> None:
    named = ", ".join(sorted({r.paint for r in letters}))
    if len({r.paint for r in letters}) > 1:
        raise BadInput(
            f"{where}: the letters, strokes, polygons and fiducials have several paints ({shown(named)}); give them one"
        )
    if not letters:
        return
    rectangles = rectangles_of(letters)
    cuts = max((len({v for r in rectangles for v in r[at : at + 2]}) for at in (0, 2)), default=0)
    if len(rectangles) > RECTANGLES_MOST or cuts > CUTS_MOST:
        raise BadInput(
            f"{where}: the lettering is made of {len(rectangles)} rectangles between {cuts} lines along an axis, and at most "
            f"{RECTANGLES_MOST} between {CUTS_MOST} are measured: paint fewer or simpler letters or fiducials"
        )


def _check_parts(regions: Sequence[Region], letters: Sequence[Lettering], where: str) -> None:
    by = {part_of(region): region for region in regions}
    ring, arrow, disc, rim = by.get("ring"), by.get("arrow"), by.get("disc"), by.get("rim")
    if isinstance(rim, PaintedRing) and not (isinstance(disc, PaintedDisc) and abs(rim.inner_m - disc.radius_m) < _TOUCH_M):
        raise BadInput(f"{where}: the rim's inner_m {rim.inner_m:g} must be the disc's radius_m: a rim lies around a disc")
    if "panel" in by and (other := next((part for part in ("disc", "ring", "arrow") if part in by), None)):
        raise BadInput(
            f"{where}: a panel and a {other} are in regions: a panel carries fiducials and lettering alone; take one out"
        )
    if not isinstance(ring, PaintedRing):
        return
    if any(reach_of(letter)[1] >= ring.inner_m for letter in letters):
        raise BadInput(f"{where}: the lettering must fit inside of the ring, whose inner_m is {ring.inner_m:g}")
    if isinstance(arrow, PaintedArrowhead) and (arrow.tip_m <= ring.outer_m or arrow.paint != ring.paint):
        raise BadInput(
            f"{where}: the arrowhead must have the ring's paint and point beyond it: its tip_m is {arrow.tip_m:g}, the ring's "
            f"outer_m {ring.outer_m:g}"
        )


def _below(regions: Sequence[Region], i: int, where: str) -> int:
    """Return the topmost region that region `i` is painted on, -1 for the surroundings."""
    region, below = regions[i], -1
    line = _samples(region)
    for j in range(i):
        depth = depth_in(regions[j], line)
        inside, outside = bool(np.any(depth > _TOUCH_M)), bool(np.any(depth < -_TOUCH_M))
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
        if not inside and np.all(depth_in(region, np.vstack([_samples(regions[j]), _inner(regions[j])])) > -_TOUCH_M):
            raise BadInput(f"{where}: regions[{i}] hides regions[{j}], which comes before it: the lowest region comes first")
    return below


def _samples(region: Region) -> F64:
    """Return points of a region's borders, (N, 2) m, the corners among them."""
    lines = []
    for border in borders_of(region, 180):
        way = np.roll(border, -1, axis=0) - border
        lines += [border + s * way for s in ((0.0,) if len(border) == 180 else (0.0, 0.2, 0.4, 0.6, 0.8))]
    return np.concatenate(lines)


def _inner(region: Region) -> F64:
    """Return points in the middle of a region, (N, 2) m."""
    match region:
        case PaintedDisc():
            return np.zeros((1, 2))
        case PaintedRing():
            return circle(0.5 * (region.inner_m + region.outer_m), 4)
        case PaintedArrowhead():
            return np.asarray(region.corners().mean(axis=0, keepdims=True))
        case PaintedPanel():
            return np.zeros((1, 2))
        case _:
            return np.array([(0.5 * (x0 + x1), 0.5 * (y0 + y1)) for x0, x1, y0, y1 in rectangles_of([region])])


def _check_contrast(region: Region, below: Region, paints: Mapping[str, Rgb], where: str) -> None:
    own, under = (linear_light(paints[r.paint]) for r in (region, below))
    contrast = float(np.linalg.norm(own - under))
    if contrast < _LEAST_CONTRAST:
        raise BadInput(
            f"{where}.paint {shown(region.paint)} {list(paints[region.paint])} does not stand out from {shown(below.paint)} "
            f"below it: {contrast:.3f} of linear light, at least {_LEAST_CONTRAST:g}: choose a lighter or a darker paint"
        )
