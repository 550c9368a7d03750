"""Rules for a pad's regions: each edge lies between two known paints and can be distinguished from the others.

The rules of its fiducials: each is read, distinguished from the others, and measured.

Detection knows some of a pad's parts by name: disc or panel, rim, ring, arrowhead, lettering. Their sizes are here too.
"""

import difflib
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from msgspec import Struct

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.core.abi import DL_FIGURE_CUTS, DL_FIGURE_RECTANGLES, DL_FIGURE_SIDES
from estimator.vision.camera import shown
from estimator.vision.fiducial import QUIET_CELLS, PaintedFiducial, cells_apart, dictionary_names, dictionary_of
from estimator.vision.regions import (
    Lettering,
    PaintedArrowhead,
    PaintedDisc,
    PaintedLetter,
    PaintedPanel,
    PaintedPolygon,
    PaintedRing,
    PaintedStroke,
    PaintedTriangle,
    Region,
    apart_m,
    borders_of,
    circle,
    convex_pieces_of,
    depth_in,
    is_slanted,
    part_of,
    reach_of,
    rectangles_of,
    slanted_sides_of,
)
from estimator.vision.srgb import LUMA, linear_light

Rgb = tuple[int, int, int]
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
    letters: tuple[Lettering, ...]
    """The lettering, fiducials among it."""
    upper: tuple[Lettering, ...]
    """Lettering of a second paint, on the other or beside it."""
    upper_on_letters: bool
    """True if it lies on the other."""
    triangle: PaintedTriangle | None
    """The pointer around lettering, of its paint."""
    lettering_m: tuple[float, float]
    """Extent of all lettering and of a triangle along and across the arrow: twice their farthest points."""
    lettering_reach_m: float
    """Distance of their farthest corner from the centre."""
    arrow: PaintedArrowhead | None
    panel: PaintedPanel | None

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
        return bare and isinstance(self.letters[0], PaintedLetter) and self.letters[0].letter in ("H", "X")

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
        return len(self.letters) == 1 and isinstance(self.letters[0], PaintedLetter) and self.letters[0].letter == "H"

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


def markings_of(regions: Sequence[Region], paints: Mapping[str, Rgb], ground: str = "") -> Markings:
    """Return the sizes of the parts that these regions are, on a sheet or deck of a paint if that is known."""
    disc = next((r for r in regions if isinstance(r, PaintedDisc)), None)
    panel = next((r for r in regions if isinstance(r, PaintedPanel)), None)
    rings = {r.part: r for r in regions if isinstance(r, PaintedRing)}
    ring, rim = rings.get("ring"), rings.get("rim")
    arrow = next((r for r in regions if isinstance(r, PaintedArrowhead)), None)
    triangle = next((r for r in regions if isinstance(r, PaintedTriangle)), None)
    letters, upper = layers_of(regions)
    outer = max(reach_of(r)[1] for r in regions)
    corners = np.concatenate([letter.corners() for letter in letters]) if letters else np.zeros((1, 2))
    everything = [corners, *(r.corners() for r in upper), *([] if triangle is None else [triangle.corners()])]
    reach = np.concatenate(everything) if letters or triangle is not None else np.zeros((1, 2))
    leg, bar = _strokes(letters)

    def rgb(region: Region | None) -> Rgb:
        return BARE if region is None else paints[region.paint]

    length, width = (2.0 * np.abs(corners).max(axis=0)).tolist()
    return Markings(
        outer_radius_m=outer,
        field_radius_m=disc.radius_m if disc is not None else 0.0,
        rim_width_m=rim.outer_m - rim.inner_m if rim is not None else 0.0,
        ring_inner_m=ring.inner_m if ring is not None else 0.0,
        ring_outer_m=ring.outer_m if ring is not None else 0.0,
        arrow_tip_m=arrow.tip_m if arrow is not None else 0.0,
        arrow_depth_m=arrow.depth_m if arrow is not None else 0.0,
        arrow_half_base_m=arrow.half_base_m if arrow is not None else 0.0,
        h_length_m=length,
        h_width_m=width,
        leg_width_m=leg,
        bar_width_m=bar,
        colours=Colours(
            paints[ground] if disc is None and panel is None and ground else rgb(disc or panel),
            rgb(ring or arrow),
            rgb(letters[0] if letters else triangle),
            None if rim is None else rgb(rim),
            rgb(upper[0]) if upper else None,
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


def layers_of(regions: Sequence[Region]) -> tuple[tuple[Lettering, ...], tuple[Lettering, ...]]:
    """Return the lettering of the first paint that lettering or a triangle has, and all lettering of other paints."""
    letters = [r for r in regions if isinstance(r, PaintedLetter | PaintedStroke | PaintedPolygon | PaintedFiducial)]
    first = next((r.paint for r in regions if isinstance(r, PaintedTriangle) or r in letters), "")
    return tuple(r for r in letters if r.paint == first), tuple(r for r in letters if r.paint != first)


def _strokes(letters: Sequence[Lettering]) -> tuple[float, float]:
    """Return the least widths of strokes along and across the arrow; a polygon's are its sides'."""
    if len(letters) == 1 and isinstance(letters[0], PaintedLetter):
        return letters[0].stroke_m, letters[0].bar_m or letters[0].stroke_m
    outlines = [line for letter in letters for line in borders_of(letter)]
    least = min((float(np.abs(np.roll(line, -1, axis=0) - line).max(axis=1).min()) for line in outlines), default=0.0)
    return least, least


RECTANGLES_MOST, CUTS_MOST, SIDES_MOST = DL_FIGURE_RECTANGLES, DL_FIGURE_CUTS, DL_FIGURE_SIDES
"""Limits for lettering of one paint: number of rectangles, of their limits along one axis, and of sides of slanted parts."""
_LEAST_CONTRAST = 0.03
"""Least distance of two paints in linear light, full scale 1 in each channel: less drowns in a worn deck's own variation."""
_TOUCH_M = 1e-6
"""Borders nearer than this touch and do not cross."""


def check_regions(regions: Sequence[Region], paints: Mapping[str, Rgb], where: str, ground: str = "") -> None:
    """Check the regions against one another and against their paints, and that of the ground if it is known.

    Raises:
        BadInput: regions cross or hide one another, there is a second one of a part, or a paint does not stand out.
    """
    parts = [part_of(region) for region in regions]
    for part in ("disc", "panel", "rim", "ring", "arrow", "triangle"):
        if parts.count(part) > 1:
            first, second = [i for i, p in enumerate(parts) if p == part][:2]
            raise BadInput(f"{where}: regions[{second}] is a second {part} beside regions[{first}]; a pad has one: take one out")
    letters = [r for r in regions if isinstance(r, PaintedLetter | PaintedStroke | PaintedPolygon | PaintedFiducial)]
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


def _check_letters(regions: Sequence[Region], where: str) -> None:
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
    triangle = [r for r in regions if isinstance(r, PaintedTriangle)]
    for layer, more in ((letters, triangle), (upper, [])):
        rectangles, sides = rectangles_of(layer), len(slanted_sides_of([*layer, *more])[0])
        cuts = max((len({v for r in rectangles for v in r[at : at + 2]}) for at in (0, 2)), default=0)
        if len(rectangles) > RECTANGLES_MOST or cuts > CUTS_MOST or sides > SIDES_MOST:
            raise BadInput(
                f"{where}: the lettering is made of {len(rectangles)} rectangles between {cuts} lines along an axis and of "
                f"shapes with {sides} slanted or other sides; at most {RECTANGLES_MOST} between {CUTS_MOST} and "
                f"{SIDES_MOST} are measured: paint fewer or simpler letters or fiducials"
            )
        _check_slanted(regions, [*layer, *more], where)


def _check_slanted(regions: Sequence[Region], layer: Sequence[Region], where: str) -> None:
    """Check that shapes with slanted sides keep away from others of their paint: what both cover would count twice."""
    for i, region in enumerate(regions):
        for j, other in enumerate(regions[:i]):
            if region not in layer or other not in layer or not (is_slanted(region) or is_slanted(other)):
                continue
            within = depth_in(region, other.corners()).max() > 0.0 or depth_in(other, region.corners()).max() > 0.0  # type: ignore[union-attr]
            if within or apart_m(region, other) <= _TOUCH_M:
                raise BadInput(
                    f"{where}: regions[{i}] ({part_of(region)}) touches regions[{j}] ({part_of(other)}) of the same paint, and "
                    "one of them has slanted sides: draw both as one polygon, or move them apart"
                )


def _check_upper(regions: Sequence[Region], i: int, below: int, where: str) -> None:
    """Check that lettering of a second paint comes above the other, and that all of it lies on the same."""
    letters, upper = layers_of(regions)
    if any(r in letters or isinstance(r, PaintedTriangle) for r in regions[i:]):
        raise BadInput(
            f"{where}: regions[{i}] has the second paint {shown(regions[i].paint)} of lettering, and lettering of the first one "
            "follows: what lies above comes last"
        )
    for j, other in enumerate(regions[:i]):
        if (other in letters or isinstance(other, PaintedTriangle)) and apart_m(regions[i], other) <= _TOUCH_M:
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


def _check_parts(regions: Sequence[Region], letters: Sequence[Lettering], where: str) -> None:
    by = {part_of(region): region for region in regions}
    ring, arrow, disc, rim = by.get("ring"), by.get("arrow"), by.get("disc"), by.get("rim")
    if isinstance(rim, PaintedRing) and not (isinstance(disc, PaintedDisc) and abs(rim.inner_m - disc.radius_m) < _TOUCH_M):
        raise BadInput(f"{where}: the rim's inner_m {rim.inner_m:g} must be the disc's radius_m: a rim lies around a disc")
    if "panel" in by and (other := next((part for part in ("disc", "ring", "arrow") if part in by), None)):
        raise BadInput(
            f"{where}: a panel and a {other} are in regions: unless it comes first and lies around all others, a panel carries "
            f'fiducials and lettering alone; take it out, or write ground = "{by["panel"].paint}" above [paints] if it is around'
        )
    triangle = by.get("triangle")
    if isinstance(triangle, PaintedTriangle):
        if arrow is not None:
            raise BadInput(f"{where}: a triangle and an arrowhead are in regions: each tells the heading; take one out")
        if letters and all(letter.paint != triangle.paint for letter in layers_of(regions)[0]):
            raise BadInput(f"{where}: the triangle must have the lettering's paint, got {shown(triangle.paint)}")
    if not isinstance(ring, PaintedRing):
        return
    if isinstance(triangle, PaintedTriangle) and reach_of(triangle)[1] >= ring.inner_m:
        raise BadInput(
            f"{where}: the triangle must fit inside of the ring, whose inner_m is {ring.inner_m:g}: its corners are "
            f"{reach_of(triangle)[1]:.3g} m from the centre"
        )
    if any(reach_of(letter)[1] >= ring.inner_m for letter in letters):
        raise BadInput(
            f"{where}: the lettering must fit inside of the ring, whose inner_m is {ring.inner_m:g}; a sheet or deck around "
            'it is no region: write its paint above [paints], as ground = "white"'
        )
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
        case PaintedDisc() | PaintedPanel():
            return np.zeros((1, 2))
        case PaintedRing():
            return circle(0.5 * (region.inner_m + region.outer_m), 4)
        case PaintedArrowhead():
            return np.asarray(region.corners().mean(axis=0, keepdims=True))
        case _ if is_slanted(region):
            return np.array([piece.mean(axis=0) for piece in convex_pieces_of(region)])
        case PaintedTriangle():
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


_LEAST_LUMINANCE = 0.1
"""Least luminance of the ground over that of a fiducial, full scale 1: with less, haze and shadows hide the cells."""
_NESTED_MOST = 0.6
"""Largest fiducial within a light cell of another one, in sides of that cell: a larger one makes the cell read as dark."""


def check_marker(region: PaintedFiducial, where: str) -> None:
    """Check the keys of one fiducial.

    Raises:
        BadInput: its dictionary, its id or its turn is not known.
    """
    names = dictionary_names()
    if region.dictionary not in names:
        like = difflib.get_close_matches(region.dictionary.upper(), names, 2, 0.3) or ["DICT_4X4_50", "DICT_APRILTAG_36h11"]
        raise BadInput(
            f"{where}.dictionary {shown(region.dictionary)} is none of OpenCV's aruco module: write for example "
            f"{' or '.join(like)}"
        )
    most = len(dictionary_of(region.dictionary).bytesList) - 1
    if not 0 <= region.id <= most:
        raise BadInput(f"{where}.id must be 0 to {most}, the ids of {region.dictionary}, got {region.id}")
    if region.turn_deg not in (0.0, 90.0, 180.0, 270.0):
        raise BadInput(
            f"{where}.turn_deg must be 0, 90, 180 or 270, got {region.turn_deg:g}: sides are measured along x and y alone; turn "
            "the whole pad on the deck instead"
        )


def check_fiducials(regions: Sequence[Region], paints: Mapping[str, Rgb], where: str) -> None:
    """Check a pad's fiducials against one another and against what they lie on.

    Raises:
        BadInput: one is there twice or cannot be distinguished from another, lies in another's border of light, off the disc or
            panel, or is not darker than it.
    """
    found = {i: region for i, region in enumerate(regions) if isinstance(region, PaintedFiducial)}
    if not found:
        return
    ground = next((r for r in regions if isinstance(r, PaintedDisc | PaintedPanel)), None)
    if ground is None:
        first = next(iter(found))
        raise BadInput(
            f"{where}: regions[{first}] (fiducial) lies on the bare deck, whose light is not known: paint a disc or a panel "
            "below it"
        )
    for i, fiducial in found.items():
        _check_ground(fiducial, ground, paints, f"{where}: regions[{i}]")
    for (i, a), (j, b) in combinations(found.items(), 2):
        _check_distinct(a, b, i, f"{where}: regions[{j}]")
    for i, fiducial in found.items():
        for j, other in enumerate(regions):
            if j != i and part_of(other) in ("letter", "fiducial"):
                _check_quiet(fiducial, other, j, f"{where}: regions[{i}]")


def quiet_square(fiducial: PaintedFiducial) -> F64:
    """Return the limits x0, x1, y0, y1 of a fiducial with the border of light that it needs, m."""
    return fiducial.square(QUIET_CELLS * fiducial.cell_m)


def _check_ground(fiducial: PaintedFiducial, ground: PaintedDisc | PaintedPanel, paints: Mapping[str, Rgb], where: str) -> None:
    x0, x1, y0, y1 = quiet_square(fiducial).tolist()
    inside = float(depth_in(ground, np.array([(x0, y0), (x0, y1), (x1, y0), (x1, y1)])).min())
    if inside < -_TOUCH_M:
        raise BadInput(
            f"{where}: the fiducial of size_m {fiducial.size_m:g} at at_m {list(fiducial.at_m)} needs a border of one cell "
            f"({fiducial.cell_m:.4g} m) on the {part_of(ground)} and lacks {-inside:.3g} m: make the {part_of(ground)} larger or "
            "the fiducial smaller"
        )
    own, under = (float(linear_light(paints[r.paint]) @ LUMA) for r in (fiducial, ground))
    if under - own < _LEAST_LUMINANCE:
        raise BadInput(
            f"{where}.paint {shown(fiducial.paint)} is {under - own:.2f} of luminance darker than {shown(ground.paint)} below "
            f"it, at least {_LEAST_LUMINANCE:g} is needed: paint fiducials dark on light"
        )


def _check_distinct(a: PaintedFiducial, b: PaintedFiducial, first: int, where: str) -> None:
    one, other = a.cells(), b.cells()
    if one.shape != other.shape:
        return
    apart = cells_apart(one, other)
    named = f"{b.dictionary} {b.id}"
    if apart == 0:
        raise BadInput(f"{where} is {named}, which is there already as regions[{first}]: give each fiducial another id")
    corrected = dictionary_of(a.dictionary).maxCorrectionBits + dictionary_of(b.dictionary).maxCorrectionBits
    if a.dictionary != b.dictionary and apart <= corrected:
        raise BadInput(
            f"{where} ({named}) differs from regions[{first}] ({a.dictionary} {a.id}) in {apart} cells and may be read as that "
            "one: take both from one dictionary, or another id"
        )


def _check_quiet(fiducial: PaintedFiducial, other: Region, index: int, where: str) -> None:
    assert isinstance(other, Lettering)
    a = quiet_square(fiducial)
    apart = [(max(a[0], b[0]) - min(a[1], b[1]), max(a[2], b[2]) - min(a[3], b[3])) for b in rectangles_of([other])]
    if all(max(gap) >= -_TOUCH_M for gap in apart):
        return
    if isinstance(other, PaintedFiducial) and _is_nested(other, fiducial):
        return
    raise BadInput(
        f"{where}: regions[{index}] reaches into the fiducial or its border of light, one cell ({fiducial.cell_m:.4g} m) wide: "
        f"move them apart; a fiducial within another one lies in the middle of a light cell and is at most {_NESTED_MOST:g} of it"
    )


def _is_nested(inner: PaintedFiducial, outer: PaintedFiducial) -> bool:
    """Return whether a fiducial lies in one light cell of another."""
    cells, cell_m = outer.cells(), outer.cell_m
    _, x1, y0, _ = outer.square().tolist()
    row, column = int((x1 - inner.at_m[0]) // cell_m), int((inner.at_m[1] - y0) // cell_m)
    if not (0 <= row < len(cells) and 0 <= column < len(cells)) or cells[row, column]:
        return False
    around = np.array([x1 - (row + 1) * cell_m, x1 - row * cell_m, y0 + column * cell_m, y0 + (column + 1) * cell_m])
    clear = (inner.square() - around) * np.array([1.0, -1.0, 1.0, -1.0])
    return bool(clear.min() >= QUIET_CELLS * inner.cell_m - _TOUCH_M and inner.size_m <= _NESTED_MOST * cell_m + _TOUCH_M)
