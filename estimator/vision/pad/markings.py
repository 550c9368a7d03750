"""The parts of a pad that detection knows by name, and their sizes: disc or panel, rim, ring, arrowhead, lettering."""

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np
from msgspec import Struct

from estimator.contracts.geometry import F64
from estimator.vision.pad import shapes
from estimator.vision.pad.fiducial import PaintedFiducial
from estimator.vision.pad.geometry import depth_in, reach_of

Rgb = tuple[int, int, int]
_Kind = TypeVar("_Kind")
BARE: Rgb = (128, 128, 128)
"""Assumed colour of an unpainted deck, for comparison with a paint."""


class Colours(Struct, frozen=True):
    """Nominal colours of the parts, sRGB 0..255; a bare deck's grey for those that the pad does not have.

    They are a starting point for rendered frames and colour limits. Detection never relies on them alone.
    """

    disc: Rgb
    ring: Rgb
    h: Rgb
    rim: Rgb | None = None
    upper: Rgb | None = None


class Markings(Struct, frozen=True):
    """Sizes of a pad's parts, m; 0 for those of a part that it does not have."""

    outer_radius_m: float
    """Radius of the disc about the centre that holds everything."""
    field_radius_m: float
    """Radius at which the disc's own paint ends."""
    rim_width_m: float
    ring_inner_m: float
    ring_outer_m: float
    arrow_tip_m: float
    arrow_depth_m: float
    arrow_half_base_m: float
    h_length_m: float
    """Extent of the lettering along the arrow: twice its farthest point."""
    h_width_m: float
    """Extent of the lettering across the arrow."""
    leg_width_m: float
    """Width of the strokes along the arrow."""
    bar_width_m: float
    """Width of the strokes across the arrow."""
    colours: Colours
    letters: tuple[shapes.Lettering, ...]
    """The lettering, fiducials among it."""
    upper: tuple[shapes.Lettering, ...]
    """Lettering of a second paint, on the other or beside it."""
    upper_on_letters: bool
    """True if it lies on the other."""
    triangle: shapes.PaintedTriangle | None
    """The pointer around lettering, of its paint."""
    lettering_m: tuple[float, float]
    """Extent of all lettering and of a triangle along and across the arrow: twice their farthest points."""
    lettering_reach_m: float
    """Distance of their farthest corner from the centre."""
    arrow: shapes.PaintedArrowhead | None
    panel: shapes.PaintedPanel | None

    @property
    def has_ground(self) -> bool:
        """True if the markings lie on a disc or a panel and not on the bare deck."""
        return bool(self.field_radius_m) or self.panel is not None

    @property
    def fiducials(self) -> tuple[PaintedFiducial, ...]:
        """The fiducials among the lettering."""
        return tuple(letter for letter in self.letters if isinstance(letter, PaintedFiducial))

    @property
    def is_searched_by_parts(self) -> bool:
        """True if there are a disc, a ring and lettering, which together distinguish a pad from other things on decks."""
        return bool(self.field_radius_m and self.ring_outer_m and self.letters)

    @property
    def has_circle(self) -> bool:
        return bool(self.field_radius_m or self.ring_outer_m)

    @property
    def is_letter_alone(self) -> bool:
        """True if there is nothing but one H or X on the bare deck."""
        others = self.arrow is not None or self.triangle is not None or bool(self.upper)
        bare = not (self.has_ground or self.ring_outer_m or others or len(self.letters) != 1)
        return bare and isinstance(self.letters[0], shapes.PaintedLetter) and self.letters[0].letter in ("H", "X")

    @property
    def is_whole(self) -> bool:
        """True if there are a disc, a ring, an arrowhead and an H: the markings that the thesis' methods measure."""
        return bool(self.field_radius_m and self.ring_outer_m and self.arrow is not None and self.is_h)

    @property
    def is_bright(self) -> bool:
        """True if the lettering is brighter than the disc."""
        return sum(self.colours.h) > sum(self.colours.disc)

    @property
    def is_h(self) -> bool:
        """True if the lettering is an H."""
        return len(self.letters) == 1 and isinstance(self.letters[0], shapes.PaintedLetter) and self.letters[0].letter == "H"

    @property
    def bar_length_m(self) -> float:
        """Length of the H's cross-bar between the legs, across the arrow."""
        return self.h_width_m - 2 * self.leg_width_m

    def h_corners(self) -> F64:
        """Return (N, 3) m: the lettering's corners; for an H 12, clockwise seen from above, from the fore outer one to port."""
        outlines = [letter.corners() for letter in self.letters] or [np.empty((0, 2))]
        return np.pad(np.concatenate(outlines), ((0, 0), (0, 1)))

    def arrowhead(self) -> F64:
        """Return (3, 3) m: the arrowhead's apex, starboard base corner and port base corner; (0, 3) if there is none."""
        return np.pad(np.empty((0, 2)) if self.arrow is None else self.arrow.corners(), ((0, 0), (0, 1)))


def markings_of(regions: Sequence[shapes.Region], paints: Mapping[str, Rgb], ground: str = "") -> Markings:
    """Return the sizes of the parts that these regions are, on a sheet or deck of a paint if that is known."""
    disc, panel = _first(regions, shapes.PaintedDisc), _first(regions, shapes.PaintedPanel)
    arrow, triangle = _first(regions, shapes.PaintedArrowhead), _first(regions, shapes.PaintedTriangle)
    rings = {r.part: r for r in regions if isinstance(r, shapes.PaintedRing)}
    ring, rim = rings.get("ring"), rings.get("rim")
    letters, upper = layers_of(regions)
    corners = np.concatenate([letter.corners() for letter in letters]) if letters else np.zeros((1, 2))
    others = [*upper, *([] if triangle is None else [triangle])]
    reach = np.concatenate([corners, *(r.corners() for r in others)]) if letters or triangle is not None else np.zeros((1, 2))
    length, width = (2.0 * np.abs(corners).max(axis=0)).tolist()
    leg, bar = _strokes(letters)
    bare = paints.get(ground, BARE)

    def rgb(*some: shapes.Region | None) -> Rgb | None:
        return next((paints[region.paint] for region in some if region is not None), None)

    return Markings(
        outer_radius_m=max(reach_of(r)[1] for r in regions),
        field_radius_m=_size(disc, "radius_m"),
        rim_width_m=_size(rim, "outer_m") - _size(rim, "inner_m"),
        ring_inner_m=_size(ring, "inner_m"),
        ring_outer_m=_size(ring, "outer_m"),
        arrow_tip_m=_size(arrow, "tip_m"),
        arrow_depth_m=_size(arrow, "depth_m"),
        arrow_half_base_m=_size(arrow, "half_base_m"),
        h_length_m=length,
        h_width_m=width,
        leg_width_m=leg,
        bar_width_m=bar,
        colours=Colours(
            disc=rgb(disc, panel) or bare,
            ring=rgb(ring, arrow) or BARE,
            h=rgb(*letters[:1], triangle) or BARE,
            rim=rgb(rim),
            upper=rgb(*upper[:1]),
        ),
        letters=letters,
        upper=upper,
        upper_on_letters=bool(upper) and any(depth_in(r, upper[0].corners()).min() > 0.0 for r in letters),
        triangle=triangle,
        lettering_m=(2.0 * float(np.abs(reach[:, 0]).max()), 2.0 * float(np.abs(reach[:, 1]).max())),
        lettering_reach_m=float(np.hypot(*reach.T).max()),
        arrow=arrow,
        panel=panel,
    )


def _first(regions: Sequence[shapes.Region], kind: type[_Kind]) -> _Kind | None:
    return next((region for region in regions if isinstance(region, kind)), None)


def _size(region: shapes.Region | None, name: str) -> float:
    return 0.0 if region is None else float(getattr(region, name))


def layers_of(regions: Sequence[shapes.Region]) -> tuple[tuple[shapes.Lettering, ...], tuple[shapes.Lettering, ...]]:
    """Return the lettering of the first paint that lettering or a triangle has, and all lettering of other paints."""
    letters = [r for r in regions if isinstance(r, shapes.Lettering)]
    first = next((r.paint for r in regions if isinstance(r, shapes.PaintedTriangle) or r in letters), "")
    return tuple(r for r in letters if r.paint == first), tuple(r for r in letters if r.paint != first)


def _strokes(letters: Sequence[shapes.Lettering]) -> tuple[float, float]:
    """Return the least widths of strokes along and across the arrow; a polygon's are its sides'."""
    if len(letters) == 1 and isinstance(letters[0], shapes.PaintedLetter):
        return letters[0].stroke_m, letters[0].bar_m or letters[0].stroke_m
    outlines = [line for letter in letters for line in shapes.borders_of(letter)]
    least = min((float(np.abs(np.roll(line, -1, axis=0) - line).max(axis=1).min()) for line in outlines), default=0.0)
    return least, least
