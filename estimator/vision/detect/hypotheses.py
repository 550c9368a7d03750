"""The kinds of hypotheses of a search, quick and likely kinds first: circles of edges, outlines of areas, strokes, lettering.

The H is found by its strokes if the disc's outline is out of the frame or occluded. In a plane parallel to the pad it has two
perpendicular directions and strokes of one width. The directions follow from the gradients (four times their angles agree), and
the width from the commonest run of white along either direction. With both known, correlation with the H at one size and two
headings gives its position. All of this runs on a frame a quarter the size, in the native core
(`estimator/core/vision/search/strokes.c`).

A pad of lettering alone has neither circle nor disc. The share that its lettering fills of its convex hull is the same at any
heading, size and tilt, and sorts components out; area and centroid give the place, and the drawing the heading.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.library import CORE
from estimator.vision.detect.colour import disc_colour, disc_has_colour, is_coloured
from estimator.vision.detect.guesses import (
    MOST,
    Circle,
    Guess,
    Outline,
    Plane,
    Radii,
    blob_circles,
    edge_circles,
    guesses_from,
    guesses_of,
    heading,
)
from estimator.vision.detect.pyramid import U8, FrameView, Pyramid
from estimator.vision.detect.template import F32, PaintMemory
from estimator.vision.native import checked, count_work, image_of, tracker_of
from estimator.vision.pad import Pad
from estimator.vision.pose import PadPose
from estimator.vision.regions import Region, covers

_LEVELS = (0, 2)
"""Sizes of the frame that are looked at: for strokes up to some 25 px and 100 px wide."""
_WINDOW_PX, _EDGE_WINDOW_PX = 41, 7
"""Sides of the neighbourhood that a pixel is compared with; the second where a circle's edge is looked for: a ring that is seen
aslant is narrow, and its sheet and what is about that lie near."""
_STANDS_OUT = 7.0
"""Least difference from the neighbourhood's mean, 8-bit."""
_LEAST_AREA_PX, _FEWEST_POINTS = 60.0, 30
_FILLED, _EXACT, _FULL = 0.3, 0.08, 0.03
"""Largest difference of the logarithm of a component's share of its hull from the drawing's; largest of that and of its spread
of what may be a circle aslant, and its least area over the square of its contour's points: of an ellipse .045 and more."""
_OUTLINE_WORK = 50
"""Work of a pixel for a frame's circles aslant, millionths of a floor."""
_TRIED = 8
"""Largest number of components whose heading is searched."""
_HEADINGS, _ASIDE = 16, 0.05
"""Headings that are tried for a component beside the pad's centre, and how far beside it is, in radii of the pad."""
_RASTER, _SILHOUETTES = 401, 3
"""Points along a side by which a drawing's outlines are found, and the most outlines that are looked for."""
_SPREAD, _LEAST_WITHIN = 0.35, 0.02
"""Largest difference of the logarithm of a component's spread from the drawing's; least area of what lies within
the largest outline, as a share of it.

A pad that is cut by the frame's edge has no whole outline there, but often a whole thing in it.
"""
_SMALL_PART, _LEAST_IN_VIEW = 0.25, 0.35
"""Area of an outline, as a share of the largest, below which this share of the pad has to be in view: another's disc is as round
as the dot in a triangle."""
_AS_WIDE, _LEAST_SHORT, _LEAST_SHORT_CIRCLE, _LEAST_TILT, _CIRCLE = 0.85, 0.55, 0.26, 0.2, 0.081
"""Ratio of second moments from which a shape is as wide in all directions; least foreshortening, and that of a circle, which less
resembles; least sine of a tilt that is tried beside none, where the tilt is not known; spread below which a shape is a circle."""
Contour = NDArray[np.int32]


class _Silhouette(NamedTuple):
    """The outline of what hangs together in a drawing that has neither disc nor ring, or of the largest thing in that.

    The latter is a hole or lettering of a second paint.
    """

    centroid_m: tuple[float, float]
    moments_m2: F64
    """Second moments about the centroid over the area, (2, 2)."""
    share: float
    """Its share of its convex hull."""
    spread: float
    """The root of the determinant of its moments over its area: the same however it is seen from afar."""
    bright: bool
    """True if it is brighter than what is about it, on the deck that the file says."""
    part: float
    """Its area over that of the largest outline."""

    @property
    def beside(self) -> float:
        return math.hypot(*self.centroid_m)


class _Component(NamedTuple):
    contour_px: F64
    """Its outline in the whole frame, (N, 2)."""
    off: float
    """Differences of its share of its hull and of its spread from the drawing's, by the logarithm."""
    of: _Silhouette


def lettering_blobs(view: FrameView, plane: Plane) -> list[Guess]:
    """Return guesses from components of a frame that resemble those of a pad: lettering, or a circle that is seen aslant."""
    levels = (1,) if view.pad.markings.has_circle else _LEVELS
    found = [c for level in levels for c in _components(view.pyramid[level], 1 << level, view.pad)]
    tried = _TRIED if view.pad.markings.is_letter_alone else 2 * _TRIED
    return [guess for component in sorted(found, key=lambda c: c.off)[:tried] for guess in _guesses(component, view, plane)]


def _components(px: U8, step: int, pad: Pad) -> Iterator[_Component]:
    """Yield the components that resemble those of the drawing and lie within the frame."""
    grey, circle = cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), pad.markings.has_circle
    side_px = _EDGE_WINDOW_PX if circle else _WINDOW_PX
    off, either = grey.astype(np.int16) - cv2.blur(grey, (side_px, side_px)), not (pad.ground or pad.markings.is_letter_alone)
    # A sheet's border may lie about a ring. Of all that lies in something, nearly nothing is as exact an ellipse.
    which, most_off, least_full = (cv2.RETR_CCOMP, _EXACT, _FULL) if circle else (cv2.RETR_EXTERNAL, math.inf, 0.0)
    count_work(grey.size * _OUTLINE_WORK * circle)
    for sign in (1, -1):
        contours, tree = cv2.findContours(np.asarray(sign * off > _STANDS_OUT, np.uint8), which, cv2.CHAIN_APPROX_NONE)
        for contour, parent in zip(contours, [] if tree is None else np.reshape(tree, (-1, 4))[:, 3].tolist(), strict=True):
            if len(contour) < _FEWEST_POINTS or cv2.contourArea(contour) < least_full * len(contour) ** 2:
                continue
            # What is dark lies in a hole of what is bright about it.
            hole = circle and parent >= 0
            of = tuple(each for each in _silhouettes(pad) if either or each.bright == ((sign > 0) != hole))
            found = _alike(np.asarray(contour, np.int32), step, grey.shape, of, -0.5 if hole else 0.5)
            yield from (component for component in found if component.off < most_off)


def _alike(
    contour: Contour, step: int, size: tuple[int, ...], drawn: tuple[_Silhouette, ...], beyond_px: float
) -> Iterator[_Component]:
    """Yield a component for each one of the drawing that it may be.

    Args:
        beyond_px: how far its border lies beyond the contour, which runs through the middles of pixels: of what stands out those
            within it, and of a hole those about it.
    """
    area = cv2.contourArea(contour) + beyond_px * cv2.arcLength(contour, True)
    x, y, wide, high = cv2.boundingRect(contour)
    if area < _LEAST_AREA_PX or x <= 1 or y <= 1 or x + wide >= size[1] - 1 or y + high >= size[0] - 1:
        return
    hull = cv2.convexHull(contour)
    share = area / (cv2.contourArea(hull) + beyond_px * cv2.arcLength(hull, True))
    at = contour.reshape(-1, 2).astype(float)
    centre = at.mean(axis=0)
    outward = (at - centre) * math.sqrt(area / max(cv2.contourArea(contour), 1.0)) + centre
    spread = _moments(contour)[2]
    for silhouette in drawn:
        filled, spreads = abs(math.log(share / silhouette.share)), abs(math.log(spread / silhouette.spread))
        if filled < _FILLED and spreads < _SPREAD:
            yield _Component((outward + 0.5) * step - 0.5, filled + spreads, silhouette)


def _moments(contour: Contour | F32) -> tuple[F64, F64, float]:
    """Return a contour's centroid, (2,), its second moments over its area, (2, 2), and its spread."""
    of = cv2.moments(contour)
    area, centre = of["m00"], np.array([of["m10"], of["m01"]])
    second = np.array([[of["mu20"], of["mu11"]], [of["mu11"], of["mu02"]]])
    if abs(area) < 1e-9:
        return centre, second, 1.0
    second = second / area
    return centre / area, second, math.sqrt(max(float(np.linalg.det(second)), 1e-18)) / abs(area)


def _guesses(component: _Component, view: FrameView, plane: Plane) -> Iterator[Guess]:
    """Yield the poses at which a component is that of the drawing: the best on a plane, and on each that its tilt may be of."""
    pad, rays = view.pad, view.camera.rays(component.contour_px)
    if not np.isfinite(rays).all():
        return
    planes = [[(plane, turn) for turn in _turns(component.of, pad)]]
    if not plane.known:
        towards = np.append(rays.mean(axis=0), 1.0)
        facing = dataclasses.replace(Plane.facing(towards / np.linalg.norm(towards)), known=False)
        seen = _moments(_contour(facing.met_by(rays)))[1]
        turns = _turns(component.of, pad, any_shape=True)
        planes = [[(facing, turn) for turn in _turns(component.of, pad)]]
        planes += [[(p, turn) for turn in turns if (p := _tilted(facing, seen, component.of, turn, way))] for way in (1.0, -1.0)]
    for of in planes:
        found = [_guess(rays, component.of, view, *each) for each in of]
        best = max((guess for guess in found if guess is not None), key=lambda guess: guess.score, default=None)
        if best is not None:
            yield best


def _turns(of: _Silhouette, pad: Pad, *, any_shape: bool = False) -> list[float | None]:
    """Return the headings that a component is looked at in; None where its place, and its shape if that counts, has none."""
    if of.beside > _ASIDE * pad.disc_radius_m:
        return [*np.linspace(0.0, math.tau, _HEADINGS, endpoint=False).tolist()]
    least, most = np.linalg.eigvalsh(of.moments_m2)
    if not any_shape or least >= _AS_WIDE * most:
        return [None]
    # Half a turn leaves second moments as they are.
    return [*np.linspace(0.0, math.pi, _HEADINGS // 2, endpoint=False).tolist()]


def _tilted(facing: Plane, seen: F64, of: _Silhouette, turn: float | None, way: float) -> Plane | None:
    """Return the plane, of the two that a component's second moments allow, in which it is that of the drawing at a heading.

    Seen from afar a plane is foreshortened along one direction alone. Of the matrices that bring the drawing's moments to those
    that are seen one is symmetric and positive, and its axes are that direction and the other.
    """
    c, s = (math.cos(turn), math.sin(turn)) if turn is not None else (1.0, 0.0)
    R = np.array([[c, -s], [s, c]])
    root = _root(R @ of.moments_m2 @ R.T)
    inverse = np.linalg.inv(root)
    (short, long), axes = np.linalg.eigh(inverse @ _root(root @ seen @ root) @ inverse)
    if short < (_LEAST_SHORT_CIRCLE if of.spread < _CIRCLE else _LEAST_SHORT) * long:
        return None
    sine = math.sqrt(max(0.0, 1.0 - (short / long) ** 2))
    if sine < _LEAST_TILT:
        return None
    normal = np.append(way * sine * axes[:, 0], short / long)
    return dataclasses.replace(Plane.facing(facing.R_cam_plane @ normal), known=False)


def _contour(at: F64) -> F32:
    return np.asarray(at, np.float32).reshape(-1, 1, 2)


def _root(of: F64) -> F64:
    """Return the symmetric root of a symmetric positive matrix."""
    values, axes = np.linalg.eigh(of)
    return np.asarray(axes * np.sqrt(np.maximum(values, 0.0)) @ axes.T)


def _guess(rays: F64, of: _Silhouette, view: FrameView, plane: Plane, turn: float | None) -> Guess | None:
    """Return the pose on a plane at which a contour of rays is that of the drawing; None if other headings fit better."""
    at = plane.met_by(rays)
    if not np.isfinite(at).all():
        return None
    centre, moments, _ = _moments(_contour(at))
    seen, drawn = float(np.linalg.det(moments)), float(np.linalg.det(of.moments_m2))
    if not seen > 0.0:
        return None
    flat = plane.pose(centre, seen**0.25, drawn**0.25)
    # A component beside the centre says where that is at each heading; the drawing decides which heading is right.
    aside = of.beside > _ASIDE * view.pad.disc_radius_m
    pose = _beside(flat, of.centroid_m, turn) if turn is not None and aside else flat
    fits = heading(view, pose)
    if (
        fits is None
        or (of.part < _SMALL_PART and fits.in_view < _LEAST_IN_VIEW)
        or (turn is not None and abs(math.remainder(fits.turn_rad - turn, math.tau if aside else math.pi)) > math.tau / _HEADINGS)
    ):
        return None
    R, t = pose.R_cam_pad.matrix.ravel().tolist(), pose.t_cam_pad.tolist()
    return Guess(R, t, fits.turn_rad, fits.score, fits.score, plane.known)


def _beside(flat: PadPose, centroid_m: tuple[float, float], turn: float) -> PadPose:
    """Return the pose of a pad, before it is turned, whose component's centroid lies at a pose's centre."""
    (x, y), c, s = centroid_m, math.cos(turn), math.sin(turn)
    return PadPose(flat.R_cam_pad, flat.t_cam_pad - flat.R_cam_pad.matrix[:, :2] @ np.array([c * x - s * y, s * x + c * y]))


@lru_cache(maxsize=8)
def _silhouettes(pad: Pad) -> tuple[_Silhouette, ...]:
    """Return the outlines of what hangs together in the drawing, the largest first, and of the largest thing within that."""
    marks, whole = pad.markings, _outlines(pad.regions, pad)
    largest = cv2.contourArea(whole[0][0][0])
    out = [_silhouette(*outline, marks.is_bright, largest) for outline, is_hole in whole if not is_hole][:_SILHOUETTES]
    inner, bright = [outline for outline, is_hole in whole if is_hole], not marks.is_bright
    if marks.upper_on_letters and marks.colours.upper is not None:
        inner = [outline for outline, is_hole in _outlines(marks.upper, pad) if not is_hole]
        bright = sum(marks.colours.upper) > sum(marks.colours.h)
    within = [_silhouette(*outline, bright, largest) for outline in inner[:1]]
    return (*out, *(one for one in within if one.part > _LEAST_WITHIN))


def _outlines(regions: Sequence[Region], pad: Pad) -> list[tuple[tuple[Contour, float], bool]]:
    """Return outlines of regions in a raster, with its points per m, and whether they are holes; the largest first."""
    n = _RASTER
    per_m = (n - 4) / (2.0 * pad.disc_radius_m)
    gx, gy = np.meshgrid(*2 * [(np.arange(n) - 0.5 * (n - 1)) / per_m], indexing="ij")
    at = np.stack([gx.ravel(), gy.ravel()], axis=1)
    painted = np.any([covers(region, at) for region in regions], axis=0).reshape(n, n)
    contours, tree = cv2.findContours(painted.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parents = np.reshape(tree, (-1, 4))[:, 3].tolist()
    out = [
        ((np.asarray(contour, np.int32), per_m), parent >= 0)
        for contour, parent in zip(contours, parents, strict=True)
        if cv2.contourArea(contour) > 0.0
    ]
    return sorted(out, key=lambda one: -cv2.contourArea(one[0][0]))


def _silhouette(contour: Contour, per_m: float, bright: bool, largest: float) -> _Silhouette:
    (column, row), second, spread = _moments(contour)
    # Columns of the raster run along y, rows along x.
    centroid = (row - 0.5 * (_RASTER - 1)) / per_m, (column - 0.5 * (_RASTER - 1)) / per_m
    area = cv2.contourArea(contour)
    share = area / cv2.contourArea(cv2.convexHull(contour))
    return _Silhouette(centroid, second[::-1, ::-1] / per_m**2, share, spread, bright, area / largest)


_MOST_LETTERS = 8
"""Largest number of places of the H."""


def h_markings(view: FrameView, level: int, plane: Plane) -> list[Guess]:
    """Return the likeliest positions of the H, best first; their headings are known up to 180 degrees.

    A guess's `drawing` is the mean of the marks' mask on the H minus the mean around it, halved, -1..1.

    Args:
        level: size of the frame that is searched.
    """
    pyramid, camera, pad = view
    how = CORE.ffi.new("dl_stroke_search *", {
        "step": 1 << level, "bright": pad.markings.is_bright, "plane_known": plane.known, "most": _MOST_LETTERS,
        "R_cam_plane": plane.R_cam_plane.ravel().tolist(),
    })  # fmt: skip
    out, guesses = CORE.block("dl_guess", _MOST_LETTERS)
    n = CORE.lib.dl_search_strokes(tracker_of(camera, pad), image_of(pyramid[level]), how, guesses)
    return guesses_of(out.reshape(_MOST_LETTERS, -1)[: checked(n)])


STROKES_WIDTH_PX = 160
"""Approximate width of the frame in which the H's strokes are searched."""
LEAST_DRAWING, _LEAST_ROUND = 0.04, 0.015
"""Smallest fraction of the variance that a guess must explain, and that of one from an area with an ellipse for its outline: of
a pale pad from afar the drawing shows little more than the disc. No guess of another kind with less was the pad in 900 frames.
"""
_CLEAR_DRAWING, _CLEAR_AREA, _CLEAR_COLOUR, _CLEAR_STROKES = 0.2, 0.3, 0.1, 0.55
"""Fraction of the variance that a guess must explain to be tried before the other kinds.

The others are for a guess from an area, for one from the disc's colour, whose guesses are few, and the score of the H's strokes:
half an H has 0.3 to 0.55. Of 920 pads in all lights, half of them partly hidden, 19 in 20 are found by such a guess. Wrong
guesses reach it rarely: one in seventy from the reduced images, one in twenty from circles that may be half covered, and one in
thirty from areas.
"""
_ROUND = 0.8
"""Support at which an area's outline is an ellipse."""
_CIRCLES = 12
"""Number of circles of one image."""
_MORE_CIRCLES, _MORE_GUESSES = {0: 32, 1: 16}, 60
"""Number of circles of an image at full and at half size where half of the disc may be covered, and of guesses from one size.

Of ten half discs at 10 m the full size has nine among them, of ten at 15 m six.
"""
_MARGIN_PX = 8
"""Margin beyond the edge of such an image in which centres are searched, px: half of the disc may be out of the frame."""
_NEAREST_M = 0.05
"""Least distance of a guess along the optical axis."""
_COARSE_LEVELS, _REDUCED_LEVELS = (3, 2), (3, 2, 1)
_PLAIN_DRAWING = 0.3
"""Fraction of the variance that a guess from the smallest images must explain to be tried before the half-size image is searched:
of 112 pads up to 3 m in any light 103 had more, and of 120 frames without a pad one in eight.
"""
_FULL_SIZE, _REDUCED, _LEAST_SIZE = Radii(4.5, 1.22, 5), Radii(5.0, 1.2, 7), Radii(8.5, 1.2, 10)
"""Radii searched at full size, at half and a quarter of it, and at an eighth."""
_BEYOND = 0.4
"""Margin beyond the edge of the smallest image in which centres are searched, in its widths."""
_WORK_GREEN, _WORK_FULL_SIZE, _WORK_STROKES, _WORK_SMALL_GREEN = 2.9, 4.4, 1.9, 4.7
WORK_COARSE, _WORK_LARGER = 2.2, 2.1
_WORK_LETTERING, _WORK_OUTLINES, _WORK_MORE_OF_HALF = 3.7, 3.2, 1.0
_LUMINANCE_WORK, _COLOUR_WORK = 1, 9
"""Work of a pixel in luminance and in the disc's colour, millionths of a floor."""
FULL_PIXELS = 640 * 360
"""Pixels of the frame that work is counted for."""


class Kind(NamedTuple):
    """One kind of hypotheses. Each frame has all of them, whether they are looked for or not."""

    work: float
    """Work of looking for them and of comparing them with the drawing that is usual without a pad, in floors."""
    guesses: Callable[[], list[Guess]]
    covered: bool = False
    """True if guesses may be partly covered pads."""
    exact: bool = False
    """True if guesses are so near to a pose that they are tried beside a candidate without confidence, too."""
    least_round: float = LEAST_DRAWING
    """Smallest fraction of the variance that a guess from a circle with an ellipse for its outline must explain to be tried."""
    least_drawing: float = LEAST_DRAWING
    """Smallest such fraction for any other guess."""
    by_colour: bool = False
    """True if guesses come from the disc's colour."""

    def is_drawn(self, guess: Guess) -> bool:
        """Return whether a guess explains enough of the variance to be tried."""
        return guess.drawing >= (self.least_round if guess.support >= _ROUND else self.least_drawing)

    def clear(self, least: float = _CLEAR_DRAWING) -> Kind:
        """Return the same kind for guesses that explain at least this fraction of the variance: few of them are wrong."""
        return self._replace(least_round=least, least_drawing=least)


def kinds(view: FrameView, plane: Plane, paint: PaintMemory) -> list[Kind]:
    """Return the kinds of hypotheses, quick and likely kinds first.

    Kinds whose guesses are often wrong are looked at twice: first for guesses that are clear, and for the others after all kinds.
    Those that only a partly covered pad needs are the last ones.
    """
    pyramid, camera, pad = view
    luminance = _Images(lambda px: cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), pyramid, _MORE_CIRCLES, _LUMINANCE_WORK)
    colour = _Images(lambda px: disc_colour(px, pad), pyramid, {}, _COLOUR_WORK)
    frame = _Searched(view, plane)
    size = camera.width * camera.height / FULL_PIXELS

    def circles_of_colour(levels: tuple[int, ...], of_ring: bool = False) -> list[Guess]:
        if not is_coloured(colour[2]):
            return []
        of, most = (Outline.RING, _MORE_GUESSES) if of_ring else (Outline.DISC, MOST)
        return frame.guesses(frame.circles(colour, levels, only_bright=not of_ring), of, most)

    any_strokes = Kind(_WORK_STROKES, frame.strokes, covered=True)
    strokes = any_strokes.clear(_CLEAR_STROKES)._replace(covered=False)
    components = Kind(_WORK_LETTERING * size, lambda: lettering_blobs(view, plane), exact=True)
    if not pad.markings.has_circle:
        return [components, strokes] if pad.markings.is_h else [components]
    coarse = Kind(WORK_COARSE * size, lambda: frame.guesses_by_edges(luminance, _COARSE_LEVELS, _PLAIN_DRAWING))
    larger = Kind(_WORK_LARGER * size, lambda: frame.guesses_by_edges(luminance, _REDUCED_LEVELS))
    blobs = Kind(_WORK_OUTLINES * size, frame.blobs, exact=True, least_round=_LEAST_ROUND)
    full = Kind(_WORK_FULL_SIZE * size, lambda: frame.guesses(frame.circles(luminance, (0,)), Outline.EDGES))
    green = Kind(_WORK_GREEN * size, lambda: circles_of_colour(_REDUCED_LEVELS), by_colour=True)
    small_green = Kind(_WORK_SMALL_GREEN * size, lambda: circles_of_colour((0,)), by_colour=True)
    out = [coarse, larger, blobs, green, strokes, full, small_green]
    if pad.markings.is_searched_by_parts:
        in_ring = green._replace(guesses=lambda: circles_of_colour(_REDUCED_LEVELS, of_ring=True), covered=True)
        half = Kind(_WORK_MORE_OF_HALF * size, lambda: frame.more(luminance, 1), covered=True)
        more = Kind((_WORK_FULL_SIZE + 1.0) * size, lambda: frame.more(luminance, 0), covered=True)
        # By its colour half a distant disc is found before all circles of the full size are needed, and without colour not.
        last = [blobs.clear(_CLEAR_AREA), more.clear()]
        last = [any_strokes, *last] if disc_has_colour(pad) else [*last, any_strokes]
        out = [
            coarse, larger.clear(), half.clear(), green.clear(_CLEAR_COLOUR), small_green.clear(_CLEAR_COLOUR), strokes, *last,
            small_green, green, larger, blobs, in_ring, half, more,
            Kind(_WORK_STROKES, frame.beside_strokes, covered=True),
        ]  # fmt: skip
    if not plane.known:
        # A circle that is seen aslant is none to the votes, and what they take for one would end the search.
        out.insert(0, components.clear(_CLEAR_AREA))
    if not disc_has_colour(pad):
        return [kind for kind in out if not kind.by_colour]
    if paint.dominance(pad) is None:
        return out
    return [green, *(kind for kind in out if kind.guesses is not green.guesses)]


@dataclass(frozen=True, slots=True, eq=False)
class _Searched:
    """Images of one frame from which hypotheses are made."""

    view: FrameView
    plane: Plane

    def guesses(self, circles: list[Circle], of: Outline, most: int = MOST, rated: dict[int, U8] | None = None) -> list[Guess]:
        """Return guesses from circles."""
        return guesses_from(circles, of, self.view, self.plane, most, rated)

    def guesses_by_edges(self, images: _Images, levels: tuple[int, ...], least: float = 0.0) -> list[Guess]:
        """Return guesses from circles of edges at several sizes of an image; those of one size are computed once."""
        guesses = self.guesses(self.circles(images, levels), Outline.EDGES, rated=images.rated)
        return [guess for guess in guesses if guess.drawing >= least]

    def circles(self, images: _Images, levels: tuple[int, ...], only_bright: bool = False) -> list[Circle]:
        """Return the circles at several sizes of an image: the most prominent at each size first."""
        by_level = {level: self._circles(images, level, only_bright)[:_CIRCLES] for level in levels}
        found = [(rank - one.support, one) for circles in by_level.values() for rank, one in enumerate(circles)]
        return [circle for _, circle in sorted(found, key=lambda of: of[0])]

    def _circles(self, images: _Images, level: int, only_bright: bool) -> list[Circle]:
        """Return the circles at one size of an image, most prominent first."""
        if (level, only_bright) not in images.circles:
            image, least = images[level], level == _REDUCED_LEVELS[0]
            radii = _FULL_SIZE if level == 0 else _LEAST_SIZE if least else _REDUCED
            beyond_px = round(_BEYOND * image.shape[1]) if least else _MARGIN_PX if level in images.more_circles else 0
            most = images.more_circles.get(level, _CIRCLES)
            images.circles[level, only_bright] = edge_circles(
                image, 1 << level, self.view.camera, self.plane, radii, most, beyond_px, only_bright=only_bright
            )
        return images.circles[level, only_bright]

    def more(self, images: _Images, level: int) -> list[Guess]:
        """Return guesses from more circles of a larger size, those with most edges for their outline's chance first.

        Half a circle is one of them.
        """
        circles = sorted(self._circles(images, level, only_bright=False), key=lambda c: -c.support * math.sqrt(c.radius))
        return self.guesses(circles, Outline.EDGES, _MORE_GUESSES, images.rated)

    def blobs(self) -> list[Guess]:
        """Return guesses from the outlines of what stands out from its surroundings."""
        return self.guesses(blob_circles(self.view.pyramid, self.view.camera, self.plane), Outline.AREA, _MORE_GUESSES)

    def strokes(self) -> list[Guess]:
        """Return guesses from the strokes of the H."""
        level = max(1, round(math.log2(self.view.camera.width / STROKES_WIDTH_PX)))
        return h_markings(self.view, level, self.plane) if self.view.pad.markings.is_h else []

    def beside_strokes(self) -> list[Guess]:
        """Return guesses in which what was taken for one leg of the H is the other: where half of it is covered."""
        apart_m = self.view.pad.markings.h_width_m - self.view.pad.markings.leg_width_m
        moved = [_moved(guess, side * apart_m) for guess in self.strokes() for side in (1.0, -1.0)]
        # Beside an H that is seen from near and very aslant the other leg may lie behind the camera.
        return [guess for guess in moved if guess.t_cam_pad[2] > _NEAREST_M]


def _moved(guess: Guess, across_m: float) -> Guess:
    """Return a guess of a pad so far along its own y axis."""
    across = guess.pose.R_cam_pad.matrix[:, 1].tolist()
    return guess._replace(t_cam_pad=[at + across_m * axis for at, axis in zip(guess.t_cam_pad, across, strict=True)])


class _Images:
    """One measure of a frame at full, half, quarter ... size; each is computed on demand."""

    def __init__(self, measure: Callable[[U8], Any], pyramid: Pyramid, more_circles: Mapping[int, int], work: int) -> None:
        self._work = work
        self.more_circles = more_circles
        """Sizes at which more circles are looked for than at others, beyond the frame's edge, too; and how many."""
        self.circles: dict[tuple[int, bool], list[Circle]] = {}
        """Circles by size and by whether only bright ones were looked for, as far as they were."""
        self.rated: dict[int, U8] = {}
        """Guesses from them as circles of edges; see `guesses_from`."""
        self._measure = measure
        self._pyramid = pyramid
        self._made: dict[int, U8] = {}

    def __getitem__(self, level: int) -> U8:
        if level not in self._made:
            self._made[level] = self._measure(self._pyramid[level])
            count_work(self._made[level].size * self._work)
        return self._made[level]
