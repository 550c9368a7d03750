"""Trace a picture of a pad into the regions of a pad file.

The picture has one paint a pixel. What is round about the centre becomes disc, rim or ring; all else becomes polygons, with holes
where what lies below shows, of as few corners as the registration measures.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import compress, pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from msgspec import Struct, convert, structs
from numpy.typing import NDArray

from companion.tools.pads.svg import SvgDrawing
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.pad.file import SMALLEST_M, check_polygon, is_simple
from estimator.vision.pad.markings import Rgb
from estimator.vision.pad.rules import SIDES_MOST
from estimator.vision.pad.shapes import PaintedPolygon, Region, borders_of, circle

U8 = NDArray[np.uint8]
_COLOURS_MOST = 16  # colours of a drawing that are distinguished
ACROSS_PX = 3000
"""Extent of what is drawn in a picture that is made of a drawing, px."""
_ROUND = 0.006  # greatest scatter of a circle's radius, over it
_CONCENTRIC = 0.01  # greatest distance of a circle's centre from the pad's, over the radius
_THINNEST = 0.45
"""Least inner radius of a ring over its outer one: what is narrower within is a disc with a hole in it."""
_GAP = 0.2  # bare share of what lies between a ring and an arrowhead that is apart from it
_OTHER = 0.2  # bare share of an arrowhead that is another shape
_LEAST_AREA = 1e-4
"""Least area of a part over that of all that is painted: less is left out."""
_CORNERS_MOST = 60  # corners of a traced outline
_CHANGE_MOST = 0.02
"""Greatest change of a part's area by leaving out corners, over the area."""
_UNLIKE = 1 / 150  # width, in the whole, of the widest difference between a pad and the picture that it is traced from
_SIZE_OFF = 0.005  # greatest difference of sizes that is no reason to scale it
_FIRST_OFF = 0.0012  # first deviation of a traced side over the pad's radius
_GROWS = 1.35  # its growth until the sides are few enough


class Picture(Struct, frozen=True):
    """A pad as pixels: which paint each shows."""

    paint: U8
    """(H, W)."""
    paints: tuple[Rgb, ...]
    px_per_m: float
    ground: int
    """The paint around the pad."""
    thinnest_px: float = 3.0
    """Least width of what is traced."""
    middle: F64 | None = None
    """(2,) px, the pad's; None for that of what is painted."""
    is_known: bool = True
    """True if the colour of the ground is known."""
    size_m: float | None = None
    """The largest extent of the pad; None if the file or a rectangle says the size."""


class _Part(NamedTuple):
    paint: int
    outline: F64
    """(N, 2) px."""
    holes: tuple[F64, ...]
    area: float
    """Area within the outline, px^2."""


class _Circle(NamedTuple):
    centre: F64
    radius: float


def drawn(drawing: SvgDrawing, size_m: float | None, where: str, extent: str | None = None) -> Picture:
    """Return a drawing as a picture.

    Args:
        size_m: the largest extent of the drawing or of what lies on its background; None if the file says its own.
        extent: "sheet" for that of the whole drawing, "paint" for that of what lies on its background, which then has the middle.

    Raises:
        BadInput: it paints nothing, or not in plain colours, or its size is not given.
    """
    coarse = 600.0 / max(drawing.width, drawing.height)
    size = math.ceil(coarse * drawing.width), math.ceil(coarse * drawing.height)
    painted = cv2.boundingRect(cv2.extractChannel(drawing.rendered(0.0, 0.0, size, coarse, crisp=False), 3))
    left, top, wide, high = (v / coarse for v in painted)
    if not wide:
        raise BadInput(f"{where}: the drawing paints nothing on its sheet")
    scale, margin = ACROSS_PX / max(wide, high), 20
    aside = margin / scale
    size = math.ceil(wide * scale) + 2 * margin, math.ceil(high * scale) + 2 * margin
    pixels = drawing.rendered(left - aside, top - aside, size, scale, crisp=True).view(np.uint32)[..., 0]
    colours = np.unique(pixels[:, 1:][pixels[:, 1:] != pixels[:, :-1]])
    if len(colours) > _COLOURS_MOST or np.any((colours >> 24 > 0) & (colours >> 24 < 255)):
        raise BadInput(
            f"{where}: it has gradients, filters or half transparent parts, and plain colours alone are read: take them out"
        )
    image: U8 = np.zeros(pixels.shape, np.uint8)
    for k, colour in enumerate(colours.tolist()):
        image[pixels == colour] = k
    paints: list[Rgb] = [(255, 255, 255), *((c >> 16 & 255, c >> 8 & 255, c & 255) for c in colours.tolist()[1:])]
    x, y, across_px, along_px = cv2.boundingRect(image)
    low, high_px = np.array([(x, y), (x + across_px, y + along_px)], float)
    across = float((high_px - low).max())
    fills = bool(np.all(np.abs((high_px - low) / scale - (drawing.width, drawing.height)) < 0.01 * max(wide, high)))
    edge = edge_of(image[y : y + along_px, x : x + across_px])
    ground, middle, known = 0, None, True
    if fills and np.count_nonzero(edge) > 0.998 * len(edge):
        ground, middle = int(np.bincount(edge).argmax()), 0.5 * (low + high_px - 1.0)
        image[image == 0] = ground
        alone = extent_px(image != ground) or across
        if size_m is not None and extent is None and alone < 0.98 * across:
            raise BadInput(
                f"{where}: the sheet is painted up to its edge: --size-mm {1000.0 * size_m:g} may be its size, or that of what "
                f"lies on it, {100.0 * alone / across:.0f} % of that: add --extent sheet or --extent paint"
            )
        if extent == "paint":
            middle, across = None, alone
    elif paints[0] in paints[1:]:
        # White on the bare sheet: either the sheet shows, or what is drawn ends in white, and the colour around is not known.
        white = image == 1 + paints[1:].index(paints[0])
        outside = np.zeros((image.shape[0] + 2, image.shape[1] + 2), np.uint8)
        cv2.floodFill(image, outside, (0, 0), 0, flags=4 | cv2.FLOODFILL_MASK_ONLY)
        around = cv2.dilate(outside[1:-1, 1:-1], np.ones((3, 3), np.uint8)) > 0
        known = bool(np.count_nonzero(around & white) < 0.02 * across)
        if known:
            image[white] = 0
    if size_m is None and drawing.px_mm is None:
        raise BadInput(f"{where}: the drawing has no size in mm or cm: give it with --size-mm, across all that it paints")
    px_per_m = across / size_m if size_m is not None else 1000.0 * scale / (drawing.px_mm or 1.0)
    size_m = size_m if middle is None else None
    return Picture(image, tuple(paints), px_per_m, ground, middle=middle, is_known=known, size_m=size_m)


def edge_of(image: U8) -> U8:
    """Return the pixels of an image's edge."""
    return np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])


def traced(picture: Picture, name: str, where: str) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return a pad file's keys, and remarks on what was left out.

    Raises:
        BadInput: nothing is painted, or it is made of what a pad file cannot say.
    """
    parts, _ = _parts(picture, picture.paint != picture.ground)
    if not parts:
        raise BadInput(f"{where}: nothing is painted: all of it has one colour")
    centre, is_round = _middle(picture, parts)
    m = 1.0 / picture.px_per_m
    regions = _rounds(picture, centre) if is_round else []
    # The border of a circle is a staircase in the picture: what is as thin beside it is no part.
    back, nib = _painted(picture, regions, centre), np.ones((round(picture.thinnest_px) + 2,) * 2)
    rest, specks = _parts(picture, (picture.paint != back) & (cv2.morphologyEx(back, cv2.MORPH_GRADIENT, nib) == 0))
    ring = next((region for region in regions if region["shape"] == "ring" and region.get("part") is None), None)
    beyond = [bool(ring) and float(np.hypot(*(p.outline - centre).T).min()) > (ring or {})["outer_m"] / m for p in rest]
    for part in compress(rest, beyond):
        arrow = _arrowhead(picture, part, centre, *regions)
        if arrow is None or sum(beyond) > 1:
            raise BadInput(
                f"{where}: {_described(picture, centre, part.area, part.outline.mean(axis=0))} lies beyond the ring, where "
                "nothing is read but one arrowhead of the ring's paint that points up: take it out, or the ring"
            )
        regions.append(arrow)
    radius_px = max(float(np.hypot(*(p.outline - centre).T).max()) for p in parts)
    regions += _lettering([p for p, out in zip(rest, beyond, strict=True) if not out], centre, m, radius_px, where)
    if not picture.is_known and any(region["paint"] == picture.ground for region in regions):
        raise BadInput(f"{where}: holes show the sheet, whose colour the drawing does not say: draw a background behind it")
    back = _painted(picture, regions, centre)
    area, at = _unlike(picture, back)
    if area > 4.0 * _LEAST_AREA * np.count_nonzero(picture.paint != picture.ground):
        raise BadInput(
            f"{where}: {_described(picture, centre, area, at)} is lost in the pad's regions ({len(regions)}): draw fewer and "
            "simpler parts, none finer than a hundredth of the whole"
        )
    remarks = list[str]()
    if specks:
        all_mm2 = 1e6 * m * m * sum(p.area for p in specks)
        largest = _described(picture, centre, specks[0].area, specks[0].outline.mean(axis=0))
        remarks.append(f"left out as too fine to be traced: {len(specks)} in all, {all_mm2:.0f} mm2; the largest: {largest}")
    if picture.size_m is not None:
        size_m = m * extent_px(back != picture.ground)
        if abs(size_m / picture.size_m - 1.0) > _SIZE_OFF:
            scaled = structs.replace(picture, px_per_m=picture.px_per_m * size_m / picture.size_m)
            keys, remarks_of_it = traced(scaled, name, where)
            given = f"{1000.0 * picture.size_m:g} mm of --size-mm are now across what was traced: with what was left out "
            return keys, (*remarks_of_it, f"{given}it would be {1000.0 * size_m:.0f} mm")
    used = list(dict.fromkeys([region["paint"] for region in regions] + [picture.ground] * picture.is_known))
    names = dict(zip(used, _names([picture.paints[i] for i in used]), strict=True))
    for region in regions:
        region |= {key: round(v, 5) for key, v in region.items() if isinstance(v, float)} | {"paint": names[region["paint"]]}
    ground = {"ground": names[picture.ground]} if picture.is_known else {}
    paints = {names[i]: list(picture.paints[i]) for i in used}
    return {"name": name, **ground, "paints": paints, "regions": regions}, tuple(remarks)


def _middle(picture: Picture, parts: Sequence[_Part]) -> tuple[F64, bool]:
    """Return the pad's centre, px, and whether the largest part is round about it."""
    low, high = (f(np.concatenate([p.outline for p in parts]), axis=0) for f in (np.min, np.max))
    centre = 0.5 * (low + high) if picture.middle is None else picture.middle
    found, line = _circle(parts[0].outline, 0.5, whole=False), parts[0].outline.astype(np.float32)
    if found is None:
        return centre, False
    beyond = [p for p in parts[1:] if cv2.pointPolygonTest(line, p.outline[0].tolist(), False) < 0]
    # An arrowhead beyond a ring on the bare ground is no reason for another centre.
    if not beyond or (len(beyond) == 1 and parts[0].holes and beyond[0].paint == parts[0].paint):
        return found.centre, True
    return centre, _is_about(found, centre)


def _rounds(picture: Picture, centre: F64) -> list[dict[str, Any]]:
    """Return what is round about the centre: a disc with a rim or without, and a ring; further circles are left to polygons."""
    m, found = 1.0 / picture.px_per_m, list[float]()
    for part in _parts(picture, np.ones(picture.paint.shape, bool))[0]:
        circles = [_circle(line, side, whole=False) for line, side in ((part.outline, 0.5), *((h, -0.5) for h in part.holes))]
        found += [c.radius for c in circles if c and _is_about(c, centre)]
    found.sort(reverse=True)
    apart = [i for i, r in enumerate(found) if i == 0 or found[i - 1] - r > picture.thinnest_px]
    edges = [float(np.mean(found[i:j])) for i, j in zip(apart, [*apart[1:], len(found)], strict=True)] + [0.0]
    around = list[tuple[int, float]]()
    for outer, inner in pairwise(edges):
        right, aft = np.rint(centre + circle(outer - 0.1 * min(outer - inner, 0.3 * outer), 720)).astype(int).T
        paint = int(np.bincount(picture.paint[aft, right]).argmax())
        if paint != (around[-1][0] if around else picture.ground):
            around.append((paint, outer * m))
    if not around:
        return []
    around += [(-1, 0.0)] * 3
    (first, radius), (second, inner), (third, within), *_ = around
    regions, rest = [{"shape": "disc", "paint": first, "radius_m": radius}], around
    if inner > _THINNEST * radius and second == picture.ground:
        return [{"shape": "ring", "paint": first, "inner_m": inner, "outer_m": radius}]
    if inner > _THINNEST * radius and not (third == first and within > _THINNEST * inner):
        rim = {"shape": "ring", "paint": first, "inner_m": inner, "outer_m": radius, "part": "rim"}
        regions, rest = [{"shape": "disc", "paint": second, "radius_m": inner}, rim], around[1:]
    (below, _), (paint, outer), (under, hole), *_ = rest
    if under == below and hole > _THINNEST * outer:
        regions.append({"shape": "ring", "paint": paint, "inner_m": hole, "outer_m": outer})
    return regions


def _arrowhead(picture: Picture, part: _Part, centre: F64, *below: dict[str, Any]) -> dict[str, Any] | None:
    """Return the arrowhead that a part beyond a ring is, the last region below it; None if it is none that points up."""
    # The filters of a photograph round corners off: the sides say where they are.
    corners = cv2.minEnclosingTriangle(part.outline.astype(np.float32))[1][:, 0]
    y, x = ((corners - centre) * (1.0, -1.0) / picture.px_per_m).T.tolist()
    left, tip, right = np.argsort(y).tolist()
    base, half, ring, m = 0.5 * (x[left] + x[right]), 0.5 * (y[right] - y[left]), below[-1], 1.0 / picture.px_per_m
    off = max(abs(y[tip]), abs(y[left] + y[right]), abs(x[left] - x[right]))
    if part.paint != ring["paint"] or off > max(2.4 * picture.thinnest_px * m, 0.1 * half) or x[tip] <= base:
        return None
    # An outline goes through the middles of pixels, and what is level ends half a pixel beyond.
    depths = [x[tip] - base + 0.5 * m, x[tip] - 0.5 * (ring["inner_m"] + ring["outer_m"])]
    sizes = [{"tip_m": x[tip], "depth_m": depth, "half_base_m": half / (x[tip] - base) * depth} for depth in depths]
    both = [{"shape": "arrowhead", "paint": part.paint, **of} for of in sizes]
    bare, apart, joined = (_painted(picture, [*below, *more], centre) for more in ((), both[:1], both[1:]))
    # The ring hides where it begins if all between them is painted: a gap that the filters close shows at its ends.
    bared, between = picture.paint != part.paint, joined != apart
    is_joined = int(np.count_nonzero(between & bared) < _GAP * np.count_nonzero(between))
    return both[is_joined] if np.count_nonzero(((apart, joined)[is_joined] != bare) & bared) < _OTHER * part.area else None


def _painted(picture: Picture, regions: Sequence[dict[str, Any]], centre: F64) -> U8:
    """Return regions as the pixels of a picture."""
    back = np.full_like(picture.paint, picture.ground)
    for region in regions:
        lines = borders_of(convert({**region, "paint": ""}, Region), 720)
        px = [np.rint(16.0 * (centre + picture.px_per_m * line[:, ::-1] * (1.0, -1.0))).astype(np.int32) for line in lines]
        cv2.fillPoly(back, px, region["paint"], cv2.LINE_8, 4)
    return back


def extent_px(mask: NDArray[np.bool_]) -> float:
    """Return the larger side of the box around what a mask has, px."""
    return float(max(cv2.boundingRect(mask.astype(np.uint8))[2:]))


def _unlike(picture: Picture, back: U8) -> tuple[float, F64]:
    """Return area, px^2, and place of the largest connected difference that is more than a strip along a border."""
    wide = round(max(picture.thinnest_px, _UNLIKE * extent_px(picture.paint != picture.ground)))
    nib = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (wide, wide))
    opened = cv2.morphologyEx((picture.paint != back).astype(np.uint8), cv2.MORPH_OPEN, nib)
    _, _, stats, places = cv2.connectedComponentsWithStats(opened)
    largest = 1 + int(stats[1:, -1].argmax()) if len(stats) > 1 else 0
    return float(stats[largest, -1]) if largest else 0.0, places[largest]


def _described(picture: Picture, centre: F64, area_px2: float, at: F64) -> str:
    """Return a part of a picture in words: its paint, its area, and its place on the pad."""
    m = 1000.0 / picture.px_per_m
    right, aft = (m * (at - centre)).tolist()
    paint = picture.paints[int(picture.paint[tuple(np.rint(at).astype(int)[::-1])])]
    return f"{area_px2 * m * m:.0f} mm2 of {_names([paint])[0]} {-aft:.0f} mm fore and {right:.0f} mm right of the centre"


def _names(colours: Sequence[Rgb]) -> list[str]:
    """Return a name for each colour."""
    out: list[str] = []
    for r, g, b in colours:
        high, low = max(r, g, b), min(r, g, b)
        if high - low < 40:
            name = "black" if high < 85 else "white" if low > 170 else "grey"
        else:
            hue = cv2.cvtColor(np.array([[[b, g, r]]], np.uint8), cv2.COLOR_BGR2HSV)[0, 0, 0]
            limits = {8: "red", 22: "orange", 35: "yellow", 85: "green", 130: "blue", 170: "violet", 181: "red"}
            name = next(n for limit, n in limits.items() if hue < limit)
        out.append(name if name not in out else f"{name}_{len(out)}")
    return out


def _parts(picture: Picture, shown: NDArray[np.bool_]) -> tuple[list[_Part], list[_Part]]:
    """Return what hangs together of one paint in a mask, the largest outline first, with its holes; and what is too fine."""
    found: tuple[list[_Part], list[_Part]] = [], []
    least = max(4.0, _LEAST_AREA * int(np.count_nonzero(picture.paint != picture.ground)))
    for paint in range(len(picture.paints)):
        mask = ((picture.paint == paint) & shown).astype(np.uint8)
        contours, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        for i, contour in enumerate(contours):
            if tree[0][i][3] >= 0:
                continue
            inner = [contours[child] for child in np.flatnonzero(tree[0][:, 3] == i)]
            holes = [hole.reshape(-1, 2).astype(float) for hole in inner if _is_thick(hole, least, picture.thinnest_px)]
            part = _Part(paint, contour.reshape(-1, 2).astype(float), tuple(holes), float(cv2.contourArea(contour)))
            found[not _is_thick(contour, least, picture.thinnest_px)].append(part)
    for parts in found:
        parts.sort(key=lambda part: -part.area)
    return found


def _is_thick(contour: NDArray[Any], least_px2: float, thinnest_px: float) -> bool:
    area = cv2.contourArea(contour)
    return area >= least_px2 and 2.0 * area >= thinnest_px * cv2.arcLength(contour, True)


def _circle(line: F64, beyond_px: float, *, whole: bool = True) -> _Circle | None:
    """Return the circle that a line of border pixels follows, or most of it if it need not be whole; None if it follows none."""
    kept, off = line, np.empty(0)
    while len(kept) >= max(30.0, 0.7 * len(line)):
        A = np.c_[2.0 * kept, np.ones(len(kept))]
        x, y, c = np.linalg.lstsq(A, np.sum(kept**2, axis=1), rcond=None)[0].tolist()
        centre = np.array([x, y])
        radius = math.sqrt(max(0.0, c + x * x + y * y))
        off = np.abs(np.hypot(*(kept - centre).T) - radius)
        limit = max(0.45, _ROUND * radius)
        # All of it has to be there: an arc has such a scatter, too. An arrowhead may stand before a fifth of it.
        turns = np.histogram(np.arctan2(*(kept - centre).T), bins=24, range=(-math.pi, math.pi))[0]
        if radius >= 8.0 and np.sqrt(np.mean(off**2)) <= limit and (whole or off.max() <= 3.0 * limit):
            return _Circle(centre, radius + beyond_px) if np.count_nonzero(turns) >= (24 if whole else 20) else None
        if whole:
            return None
        kept = kept[off < np.quantile(off, 0.95)]
    return None


def _is_about(of: _Circle, centre: F64) -> bool:
    return float(np.hypot(*(of.centre - centre))) < max(2.0, _CONCENTRIC * of.radius)


def _lettering(parts: Sequence[_Part], centre: F64, m: float, radius_px: float, where: str) -> Iterator[dict[str, Any]]:
    """Yield the parts beside disc and rings as polygons: those of the paint with the largest area, then those of a second."""
    layers = sorted({p.paint for p in parts}, key=lambda paint: -sum(p.area for p in parts if p.paint == paint))
    if len(layers) > 2:
        raise BadInput(f"{where}: {len(layers)} paints lie on the ground or the disc, and at most two are measured: use fewer")
    for layer in layers:
        own = [p for p in parts if p.paint == layer]
        others = [p for p in parts if p.paint != layer]
        off = _FIRST_OFF * radius_px
        while True:
            made = [(_corners(p.outline, off), [_corners(h, off) for h in p.holes if not _is_filled(h, others)]) for p in own]
            sides = sum(len(line) + sum(map(len, holes)) for line, holes in made)
            longest = max(max([len(line), *map(len, holes)]) for line, holes in made)
            if sides <= SIDES_MOST and longest <= _CORNERS_MOST:
                break
            off *= _GROWS
            if off > 0.2 * radius_px:
                raise BadInput(f"{where}: the lettering has too many parts ({len(own)}): draw fewer or simpler ones")
        for line, holes in made:
            outline_m, *holes_m = (_on_pad(of, centre, m) for of in (line, *holes))
            fore, right = 1000.0 * np.mean(outline_m, axis=0)
            cure = f"draw the part {fore:.0f} mm fore and {right:.0f} mm right of the centre without what is finer than 1 mm"
            check_polygon(PaintedPolygon("", outline_m, tuple(holes_m)), f"{where}: {cure}: its region")
            region: dict[str, Any] = {"shape": "polygon", "paint": layer, "points_m": outline_m}
            yield region | ({"holes_m": holes_m} if holes else {})


def _is_filled(hole: F64, others: Sequence[_Part]) -> bool:
    """Return whether a hole is where another part lies on this one."""
    area = cv2.contourArea(hole.astype(np.float32))
    return any(
        abs(part.area / max(area, 1.0) - 1.0) < 0.1 and np.abs(part.outline.mean(0) - hole.mean(0)).max() < 3.0
        for part in others
        if not part.holes
    )


def _corners(line: F64, off_px: float) -> F64:
    """Return the corners of an outline, (N, 2) px; a circle's are those of a polygon of its area."""
    found = _circle(line, 0.0)
    if found is not None:
        n = int(np.clip(math.pi / math.acos(max(0.5, 1.0 - min(0.5, off_px / found.radius))), 6, 32))
        return found.centre + circle(found.radius * math.sqrt(math.tau / (n * math.sin(math.tau / n))), n)
    corners = np.asarray(cv2.approxPolyDP(line.astype(np.float32), off_px, True).reshape(-1, 2), float)
    # A side that nearly lies along an axis does so.
    for axis in (0, 1):
        for i in range(len(corners)):
            j = (i + 1) % len(corners)
            if abs(corners[i, axis] - corners[j, axis]) < 1.6 and abs(corners[i, 1 - axis] - corners[j, 1 - axis]) > 5.0:
                corners[i, axis] = corners[j, axis] = 0.5 * (corners[i, axis] + corners[j, axis])
    return corners


def _on_pad(line: F64, centre: F64, m: float) -> tuple[tuple[float, float], ...]:
    """Return px as places on the pad, up in the picture along the arrow, without corners that make the line touch itself."""
    drawn_at = at = np.round((centre - line)[:, ::-1] * (m, -m), 5) + 0.0
    while len(at) > 3 and not is_simple(at):
        side = np.roll(at, -1, axis=0) - at
        before = np.roll(side, 1, axis=0)
        changes = np.abs(before[:, 0] * side[:, 1] - before[:, 1] * side[:, 0])
        short = np.hypot(*side.T) < SMALLEST_M
        order = np.argsort(np.where(short | np.roll(short, 1) | ~short.any(), changes, np.inf)).tolist()
        at = np.delete(at, next((i for i in order if is_simple(np.delete(at, i, 0))), order[0]), 0)
    area, kept = (cv2.contourArea(of.astype(np.float32)) for of in (drawn_at, at))
    return tuple((x, y) for x, y in (at if abs(kept - area) <= _CHANGE_MOST * area else drawn_at).tolist())
