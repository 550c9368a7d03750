"""Find lettering, and circles that are seen aslant, by the components of a frame.

A pad of lettering alone has neither circle nor disc. The share that its lettering fills of its convex hull is the same at any
heading, size and tilt, and sorts components out; area and centroid give the place, and the drawing the heading.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.guesses import Guess, Plane, heading
from estimator.vision.detect.pyramid import U8, FrameView
from estimator.vision.detect.template import F32
from estimator.vision.native import count_work
from estimator.vision.pad.geometry import covers
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import Region

_LEVELS = (0, 2)  # Sizes of the frame that are looked at: for strokes up to some 25 px and 100 px wide
_WINDOW_PX, _EDGE_WINDOW_PX = 41, 7
"""Sides of the neighbourhood that a pixel is compared with; the second where a circle's edge is looked for: a ring that is seen
aslant is narrow, and its sheet and what is about that lie near."""
_STANDS_OUT = 7.0  # Least difference from the neighbourhood's mean, 8-bit
_LEAST_AREA_PX = 60.0  # Least area of a component
_FEWEST_POINTS = 30  # Fewest points of its contour
_FILLED = 0.3  # Largest difference of the logarithm of a component's share of its hull from the drawing's
_EXACT = 0.08  # Largest of that and of its spread together, of what may be a circle aslant
_FULL = 0.03  # Least area of that over the square of its contour's points: of an ellipse .045 and more
_OUTLINE_WORK = 50  # Work of a pixel for a frame's circles aslant, millionths of a floor
_TRIED = 8  # Largest number of components whose heading is searched
_HEADINGS = 16  # Headings that are tried for a component beside the pad's centre
_ASIDE = 0.05  # Least distance of one that is beside it, in radii of the pad
_RASTER = 401  # Points along a side by which a drawing's outlines are found
_SILHOUETTES = 3  # The most outlines that are looked for
_SPREAD = 0.35  # Largest difference of the logarithm of a component's spread from the drawing's
_LEAST_WITHIN = 0.02
"""Least area of what lies within the largest outline, as a share of it.

A pad that is cut by the frame's edge has no whole outline there, but often a whole thing in it.
"""
_SMALL_PART = 0.25  # Area of an outline, as a share of the largest, below which more of the pad has to be in view
_LEAST_IN_VIEW = 0.35  # Share of the pad that has to be then: another's disc is as round as the dot in a triangle
_AS_WIDE = 0.85  # Ratio of second moments from which a shape is as wide in all directions
_LEAST_SHORT = 0.55  # Least foreshortening of a component
_LEAST_SHORT_CIRCLE = 0.26  # The same of a circle, which less resembles
_LEAST_TILT = 0.2  # Least sine of a tilt that is tried beside none, where the tilt is not known
_CIRCLE = 0.081  # Spread below which a shape is a circle
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
        parents = np.reshape(tree, (-1, 4))[:, 3].tolist() if len(contours) else []
        for contour, parent in zip(contours, parents, strict=True):
            if len(contour) < _FEWEST_POINTS or cv2.contourArea(contour) < least_full * len(contour) ** 2:
                continue
            # What is dark lies in a hole of what is bright about it.
            hole = circle and parent >= 0
            of = tuple(each for each in _silhouettes(pad) if either or each.bright == ((sign > 0) != hole))
            found = _alike(np.asarray(contour, np.int32), step, grey.shape, of, -0.5 if hole else 0.5)
            yield from filter(lambda component: component.off < most_off, found)


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
