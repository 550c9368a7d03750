"""A pad's drawing as the core registers it: regions bounded by circles, rectangles, slanted sides and a wedge."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.abi import DL_NONE, DL_PAD_CONTRASTS, DL_POINTER_MARKS
from estimator.vision.pad.drawing import EdgeKind
from estimator.vision.pad.geometry import rectangles_of, slanted_sides_of
from estimator.vision.pad.markings import Markings
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import Region
from estimator.vision.srgb import linear_light

_STRIPS = 6  # Strips of an arrowhead: few leave steps far finer than the blur
_FAR_M = 1e6  # A distance that no part of a pad has
_H_FIGURE, _POINTER_FIGURE, _PANEL_FIGURE, _UPPER_FIGURE = range(4)


def pad_shape(pad: Pad) -> Mapping[str, Any]:
    """Return the members of the core's `dl_pad_shape`. A kind of edge that the pad lacks has no contrast."""
    marks = pad.markings
    arrow = marks.arrowhead()[:, :2] if marks.triangle is None else marks.triangle.corners()
    ring = (marks.ring_outer_m, marks.ring_inner_m) if marks.ring_outer_m else ()
    h, upper = _region((), _if(_has_lettering(marks), _H_FIGURE)), _region((), _if(bool(marks.upper), _UPPER_FIGURE))
    disc = _region((marks.field_radius_m,) if marks.field_radius_m else (), _if(marks.panel is not None, _PANEL_FIGURE))
    painted = _painted(pad, {"disc": disc, "h": h, "upper": upper}, ring)
    at = dict.fromkeys(("disc", "ring", "h", "upper"), DL_NONE) | {name: index for index, name in enumerate(painted)}
    below = {"disc": DL_NONE, "rim": DL_NONE, "upper": at["h" if marks.upper_on_letters else "disc"]}
    lies_on = [below.get(name, at["disc"]) for name in painted]
    pointer = at["ring"] if marks.arrow is not None else at["h"] if marks.triangle is not None else DL_NONE
    return {
        "contrast_count": len(painted), "pointer_kind": _if(pointer != DL_NONE, EdgeKind.ARROW),
        "pointer_contrast": pointer, "pointer_figure": _POINTER_FIGURE,
        "lies_on": [*lies_on, *[DL_NONE] * (DL_PAD_CONTRASTS - len(lies_on))],
        "contrast_of_kind": (
            at["disc"], _if(bool(ring), at["ring"]), pointer, _if(bool(marks.letters), at["h"]), at["upper"]
        ),
        "paint_of_kind": (EdgeKind.DISC, EdgeKind.RING, _paint_of_pointer(marks), EdgeKind.H, EdgeKind.UPPER),
        "disc_radius_m": pad.disc_radius_m, "half_length_m": 0.5 * marks.lettering_m[0] or pad.disc_radius_m,
        "pointer_clear_m": marks.ring_inner_m if marks.triangle is None else 0.0, "gap_m": _gap(marks),
        "pointer_marks_m": [*arrow, arrow.mean(axis=0)] if len(arrow) else np.zeros((DL_POINTER_MARKS, 2)),
        "nominal": _contrasts(marks), "zones": _zones(pad), "contrasts": list(painted.values()),
        "kinds": [
            disc, _region(ring), _region(ring, has_wedge=marks.arrow is not None) if marks.triangle is None else h, h, upper,
        ],
        "figures": _figures(pad), "wedge": _arrow_wedge(pad),
    }  # fmt: skip


def _if(is_there: bool, index: int) -> int:
    return index if is_there else DL_NONE


def _has_lettering(marks: Markings) -> bool:
    return bool(marks.letters) or marks.triangle is not None


def _painted(pad: Pad, regions: Mapping[str, dict[str, Any]], ring: Sequence[float]) -> dict[str, dict[str, Any]]:
    """Return the regions that have a contrast with what they lie on, in the core's order."""
    marks = pad.markings
    pointer = _if(marks.arrow is not None, _POINTER_FIGURE)
    each = {
        "disc": (marks.has_ground, regions["disc"]),
        "ring": (bool(ring) or marks.arrow is not None, _region(ring, pointer)),
        "h": (_has_lettering(marks), regions["h"]),
        "rim": (bool(marks.rim_width_m), _region((pad.disc_radius_m, marks.field_radius_m))),
        "upper": (bool(marks.upper), regions["upper"]),
    }
    return {name: region for name, (is_there, region) in each.items() if is_there}


def _figures(pad: Pad) -> list[dict[str, Any]]:
    """Return the figures of lettering, pointer, panel, and lettering of a second paint."""
    marks, p = pad.markings, pad.markings.panel
    panel = _figure([] if p is None else [(-0.5 * p.length_m, 0.5 * p.length_m, -0.5 * p.width_m, 0.5 * p.width_m)])
    letters, upper = rectangles_of(marks.letters), _figure(rectangles_of(marks.upper), marks.upper)
    if marks.triangle is None:
        return [_figure(letters, marks.letters), _arrow_figure(pad), panel, upper]
    return [_figure(letters, [*marks.letters, marks.triangle]), _figure([], [marks.triangle]), panel, upper]


def _paint_of_pointer(marks: Markings) -> EdgeKind:
    """Return the kind of edges whose paint inside the pointer has."""
    if marks.triangle is not None:
        return EdgeKind.H if marks.letters else EdgeKind.ARROW
    return EdgeKind.RING if marks.ring_outer_m else EdgeKind.ARROW


def _gap(marks: Markings) -> float:
    """Return the least distance between edges of different kinds, m; of a pad with one kind the width of what is painted.

    That between lettering of two paints does not count: pixels that see both are left out one by one.
    """
    if marks.panel is not None:
        # The border around its lettering; of an empty panel half of its shorter side.
        return 0.5 * min(marks.panel.length_m - marks.lettering_m[0], marks.panel.width_m - marks.lettering_m[1])
    parts = []
    if _has_lettering(marks):
        parts.append((0.0, _lettering_reach(marks)))
    if marks.ring_outer_m or marks.arrow is not None:
        begins_m = marks.ring_inner_m or marks.arrow_tip_m - marks.arrow_depth_m
        parts.append((begins_m, marks.arrow_tip_m or marks.ring_outer_m))
    if marks.field_radius_m:
        parts.append((marks.field_radius_m, marks.field_radius_m))
    if len(parts) > 1:
        return min(outer[0] - inner[1] for inner, outer in pairwise(parts))
    widths = (marks.leg_width_m, marks.bar_width_m, 0.0 if marks.triangle is None else marks.triangle.stroke_m)
    return (
        min((width for width in widths if width), default=0.0) or marks.ring_outer_m - marks.ring_inner_m or marks.field_radius_m
    )


def _lettering_reach(marks: Markings) -> float:
    """Return the radius of a circle that holds the lettering, m: of upright lettering that around its box."""
    if marks.triangle is None and not marks.upper:
        return math.hypot(marks.h_length_m, marks.h_width_m) / 2
    return marks.lettering_reach_m


def _region(radii_m: Sequence[float], figure: int = DL_NONE, has_wedge: bool = False) -> dict[str, Any]:
    """Return a region within the first circle and outside of the second, with what else belongs to it."""
    return {
        "circles": len(radii_m), "radius_m": radii_m, "sign": (1.0, -1.0)[: len(radii_m)], "figure": figure,
        "has_wedge": has_wedge,
    }  # fmt: skip


def _figure(rectangles: Sequence[tuple[float, float, float, float]], shapes: Sequence[Region] = ()) -> dict[str, Any]:
    """Return a figure of rectangles (x0, x1, y0, y1) and of those shapes that have slanted sides; none overlap."""
    start, end = slanted_sides_of(shapes)
    if len(start):
        sides = {"sides": len(start), "from_x_m": start[:, 0], "from_y_m": start[:, 1], "to_x_m": end[:, 0], "to_y_m": end[:, 1]}
        return _figure(rectangles) | sides
    if not rectangles:
        return {"rectangles": 0}
    limits = np.array(rectangles)
    x_m, y_m = np.unique(limits[:, :2]), np.unique(limits[:, 2:])
    x, y = np.searchsorted(x_m, limits[:, :2]), np.searchsorted(y_m, limits[:, 2:])
    return {
        "rectangles": len(limits), "x_cuts": len(x_m), "y_cuts": len(y_m), "x_m": x_m, "y_m": y_m,
        "x0": x[:, 0], "x1": x[:, 1], "y0": y[:, 0], "y1": y[:, 1],
    }  # fmt: skip


def _arrow_figure(pad: Pad) -> dict[str, Any]:
    """Return the arrowhead beyond the ring where the blur is not small compared with it, as strips along x.

    A product of blurred sides is valid only while each side is blurred separately. Strips between an arc and a slanted side are
    exact in the limit of many; a few leave steps far finer than the blur.
    """
    if pad.markings.arrow is None:
        return _figure([])
    slope = pad.markings.arrow_half_base_m / pad.markings.arrow_depth_m
    base = pad.markings.arrow_tip_m - pad.markings.arrow_depth_m

    def extent(y: F64) -> tuple[F64, F64]:
        end = pad.markings.arrow_tip_m - np.abs(y) / slope
        return np.maximum(base, np.sqrt(np.maximum(pad.markings.ring_outer_m**2 - y * y, 0.0))), end

    fine = np.linspace(0.0, pad.markings.arrow_half_base_m, 1001)
    begin, end = extent(fine)
    half = float(fine[np.nonzero(end > begin)[0][-1]])
    borders = np.linspace(0.0, half, _STRIPS // 2 + 1)
    inner = borders[:-1, None] + (np.arange(20) + 0.5) / 20 * (borders[1] - borders[0])
    begin, end = (x.mean(axis=1).tolist() for x in extent(inner))
    strips = list(zip(begin, end, borders[:-1].tolist(), borders[1:].tolist(), strict=True))
    return _figure([*strips, *((x0, x1, -y1, -y0) for x0, x1, y0, y1 in strips)])


def _arrow_wedge(pad: Pad) -> dict[str, Any]:
    """Return the arrowhead beyond the ring where the blur is small compared with it: two sides and the base."""
    if pad.markings.arrow is None:
        return {"sides": 0}
    slant = math.hypot(pad.markings.arrow_half_base_m, pad.markings.arrow_depth_m)
    along, aside = pad.markings.arrow_half_base_m / slant, pad.markings.arrow_depth_m / slant
    base = pad.markings.arrow_tip_m - pad.markings.arrow_depth_m
    if math.hypot(base, pad.markings.arrow_half_base_m) <= pad.markings.ring_outer_m:
        # The ring hides the base, and a blurred base would reduce the part beyond the ring. The base is cut where the ring covers
        # it all.
        base = 0.5 * pad.markings.arrow_tip_m
    return {
        "sides": 3, "nx": (along, along, -1.0), "ny": (aside, -aside, 0.0), "beyond_m": pad.markings.ring_outer_m,
        "offset_m": (along * pad.markings.arrow_tip_m, along * pad.markings.arrow_tip_m, -base),
    }  # fmt: skip


def _zones(pad: Pad) -> list[dict[str, Any]]:
    """Return, for each kind of edge, where edges of another kind are."""
    marks = pad.markings
    length, width, field_m = 0.5 * marks.lettering_m[0], 0.5 * marks.lettering_m[1], marks.field_radius_m or _FAR_M
    reach_m, has_lettering = _lettering_reach(marks), _has_lettering(marks)

    def zone(inside: float, outside: float, box: tuple[float, ...] = (_FAR_M,) * 4, radius: float = _FAR_M) -> dict[str, Any]:
        return {
            "inside_m": inside, "outside_m": outside, "thinnest_m": _FAR_M, "box_m": box, "box_radius_m": radius,
            "on_figure": DL_NONE, "beside_figure": DL_NONE,
        }  # fmt: skip

    disc = zone(marks.ring_outer_m or reach_m, _FAR_M)
    if marks.panel is not None:
        disc = zone(-_FAR_M, _FAR_M, (-length, length, -width, width))
    if marks.arrow is not None:
        beside_arrow = (0.0, marks.arrow_tip_m, -marks.arrow_half_base_m, marks.arrow_half_base_m)
        disc = zone(marks.ring_outer_m, _FAR_M, beside_arrow, marks.arrow_tip_m)
    if marks.rim_width_m:
        # If no pixel sees the rim alone, its inner edge cannot be separated from its outer one.
        disc |= {"outside_m": pad.disc_radius_m, "thinnest_m": marks.rim_width_m}
    h = (-length, length, -width, width) if has_lettering else (_FAR_M,) * 4
    beyond_h = _FAR_M if marks.panel is not None else marks.ring_inner_m or (marks.arrow_tip_m - marks.arrow_depth_m) or field_m
    lettering, upper = zone(-_FAR_M, beyond_h), zone(-_FAR_M, beyond_h)
    if marks.upper:
        lettering["beside_figure"] = _UPPER_FIGURE
        upper["on_figure" if marks.upper_on_letters else "beside_figure"] = _H_FIGURE
    ring = zone(-_FAR_M, field_m, h, _FAR_M if marks.triangle is None else reach_m)
    return [disc, ring, zone(-_FAR_M, field_m) if marks.triangle is None else lettering, lettering, upper]


def _contrasts(marks: Markings) -> F64:
    """Return the (5, 3) BGR unit vectors from the paint below to that inside each kind of edge.

    They are zero for the disc's own edge and on a bare deck, whose colour is not known.
    """
    paints = marks.colours
    disc, ring, h, upper = (linear_light(rgb[::-1]) for rgb in (paints.disc, paints.ring, paints.h, paints.upper or paints.h))
    pointer = ring - disc if marks.triangle is None else h - disc
    ways = np.array([np.zeros(3), ring - disc, pointer, h - disc, upper - disc]) * marks.has_ground
    if marks.upper_on_letters:
        ways[EdgeKind.UPPER] = upper - h
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=1), 1e-6)[:, None])
