"""The pad's drawing as the native core reads it: regions bounded by circles, rectangles and a wedge.

The core knows no pad: what it registers is this data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.interface.registration import PAD_CONTRASTS, POINTER_MARKS
from estimator.core.records import record
from estimator.vision.drawing import EdgeKind
from estimator.vision.markings import Markings
from estimator.vision.pad import Pad
from estimator.vision.regions import PaintedPanel, rectangles_of
from estimator.vision.srgb import linear_light

_STRIPS = 6
_FAR_M = 1e6
_SURROUNDINGS = _NONE = -1
_H_FIGURE, _ARROW_FIGURE, _PANEL_FIGURE, _NO_FIGURE = 0, 1, 2, -1


@lru_cache(maxsize=8)
def pad_shape(pad: Pad) -> F64:
    """Return the words of the core's `pad_shape`; the result is cached. A kind of edge that the pad lacks has no contrast."""
    marks, arrow = pad.markings, pad.markings.arrowhead()[:, :2]
    field_m, ring = marks.field_radius_m, (marks.ring_outer_m, marks.ring_inner_m) if marks.ring_outer_m else ()
    disc = _region((field_m,) if field_m else (), _NO_FIGURE if marks.panel is None else _PANEL_FIGURE)
    h = _region((), _H_FIGURE if marks.letters else _NO_FIGURE)
    painted: dict[str, dict[str, Any]] = {}
    if marks.has_ground:
        painted["disc"] = disc
    if ring or marks.arrow is not None:
        painted["ring"] = _region(ring, _ARROW_FIGURE if marks.arrow is not None else _NO_FIGURE)
    if marks.letters:
        painted["h"] = h
    if marks.rim_width_m:
        painted["rim"] = _region((pad.disc_radius_m, field_m))
    at = {name: index for index, name in enumerate(painted)}
    below = {"disc": _SURROUNDINGS, "rim": _SURROUNDINGS}
    lies_on = [below.get(name, at.get("disc", _SURROUNDINGS)) for name in painted]
    pointer = at["ring"] if marks.arrow is not None else _NONE
    return record("pad_shape", {
        "contrast_count": len(painted), "pointer_kind": EdgeKind.ARROW if marks.arrow is not None else _NONE,
        "pointer_contrast": pointer, "pointer_figure": _ARROW_FIGURE,
        "lies_on": [*lies_on, *[_SURROUNDINGS] * (PAD_CONTRASTS - len(lies_on))],
        "contrast_of_kind": (at.get("disc", _NONE), at.get("ring", _NONE) if ring else _NONE, pointer, at.get("h", _NONE)),
        "paint_of_kind": (EdgeKind.DISC, EdgeKind.RING, EdgeKind.RING if ring else EdgeKind.ARROW, EdgeKind.H),
        "disc_radius_m": pad.disc_radius_m, "half_length_m": 0.5 * marks.h_length_m or pad.disc_radius_m,
        "pointer_clear_m": marks.ring_inner_m, "gap_m": _gap(marks),
        "pointer_marks_m": [*arrow, arrow.mean(axis=0)] if len(arrow) else np.zeros((POINTER_MARKS, 2)),
        "nominal": _contrasts(marks), "zones": _zones(pad), "contrasts": list(painted.values()),
        "kinds": [disc, _region(ring), _region(ring, has_wedge=marks.arrow is not None), h],
        "figures": [_figure(rectangles_of(marks.letters)), _arrow_figure(pad), _panel_figure(marks)], "wedge": _arrow_wedge(pad),
    })  # fmt: skip


def _gap(marks: Markings) -> float:
    """Return the least distance between edges of different kinds, m; of a pad with one kind the width of what is painted."""
    if marks.panel is not None:
        return _panel_margin(marks.panel, marks)
    around = [
        (0.0, math.hypot(marks.h_length_m, marks.h_width_m) / 2) if marks.letters else None,
        (marks.ring_inner_m or marks.arrow_tip_m - marks.arrow_depth_m, marks.arrow_tip_m or marks.ring_outer_m)
        if marks.ring_outer_m or marks.arrow is not None
        else None,
        (marks.field_radius_m, marks.field_radius_m) if marks.field_radius_m else None,
    ]
    parts = [part for part in around if part is not None]
    if len(parts) > 1:
        return min(outer[0] - inner[1] for inner, outer in pairwise(parts))
    return min(marks.leg_width_m, marks.bar_width_m) or marks.ring_outer_m - marks.ring_inner_m or marks.field_radius_m


def _panel_margin(panel: PaintedPanel, marks: Markings) -> float:
    """Return the least width of a panel's border around its lettering, m; of an empty panel half of its shorter side."""
    return 0.5 * min(panel.length_m - marks.h_length_m, panel.width_m - marks.h_width_m)


def _panel_figure(marks: Markings) -> dict[str, Any]:
    """Return the panel as one rectangle."""
    if marks.panel is None:
        return _figure([])
    x, y = 0.5 * marks.panel.length_m, 0.5 * marks.panel.width_m
    return _figure([(-x, x, -y, y)])


def _region(radii_m: Sequence[float], figure: int = _NO_FIGURE, has_wedge: bool = False) -> dict[str, Any]:
    """Return a region within the first circle and outside of the second, with what else belongs to it."""
    return {
        "circles": len(radii_m), "radius_m": radii_m, "sign": (1.0, -1.0)[: len(radii_m)], "figure": figure,
        "has_wedge": has_wedge,
    }  # fmt: skip


def _figure(rectangles: Sequence[tuple[float, float, float, float]]) -> dict[str, Any]:
    """Return a figure of rectangles (x0, x1, y0, y1) that do not overlap."""
    if not rectangles:
        return {"rectangles": 0}
    sides = np.array(rectangles)
    x_m, y_m = np.unique(sides[:, :2]), np.unique(sides[:, 2:])
    x, y = np.searchsorted(x_m, sides[:, :2]), np.searchsorted(y_m, sides[:, 2:])
    return {
        "rectangles": len(sides), "x_cuts": len(x_m), "y_cuts": len(y_m), "x_m": x_m, "y_m": y_m,
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
    length, width, field_m = 0.5 * marks.h_length_m, 0.5 * marks.h_width_m, marks.field_radius_m or _FAR_M

    def zone(inside: float, outside: float, box: tuple[float, ...] = (_FAR_M,) * 4, radius: float = _FAR_M) -> dict[str, Any]:
        return {"inside_m": inside, "outside_m": outside, "thinnest_m": _FAR_M, "box_m": box, "box_radius_m": radius}

    disc = zone(marks.ring_outer_m or math.hypot(length, width), _FAR_M)
    if marks.panel is not None:
        disc = zone(-_FAR_M, _FAR_M, (-length, length, -width, width))
    if marks.arrow is not None:
        beside_arrow = (0.0, marks.arrow_tip_m, -marks.arrow_half_base_m, marks.arrow_half_base_m)
        disc = zone(marks.ring_outer_m, _FAR_M, beside_arrow, marks.arrow_tip_m)
    if marks.rim_width_m:
        # If no pixel sees the rim alone, its inner edge cannot be separated from its outer one.
        disc |= {"outside_m": pad.disc_radius_m, "thinnest_m": marks.rim_width_m}
    h = (-length, length, -width, width) if marks.letters else (_FAR_M,) * 4
    beyond_h = _FAR_M if marks.panel is not None else marks.ring_inner_m or (marks.arrow_tip_m - marks.arrow_depth_m) or field_m
    return [disc, zone(-_FAR_M, field_m, h), zone(-_FAR_M, field_m), zone(-_FAR_M, beyond_h)]


def _contrasts(marks: Markings) -> F64:
    """Return the (4, 3) BGR unit vectors from the disc's paint to that inside each kind of edge.

    They are zero for the disc's own edge and on a bare deck, whose colour is not known.
    """
    paints = marks.colours
    disc, ring, h = (linear_light(rgb[::-1]) for rgb in (paints.disc, paints.ring, paints.h))
    ways = np.array([np.zeros(3), ring - disc, ring - disc, h - disc]) * marks.has_ground
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=1), 1e-6)[:, None])
