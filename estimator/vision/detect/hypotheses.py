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

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.library import CORE
from estimator.vision.camera import Camera
from estimator.vision.detect.circles import EdgeCircle, Radii, blob_circles, edge_circles
from estimator.vision.detect.colour import disc_colour, disc_has_colour, is_coloured
from estimator.vision.detect.guesses import MOST, Guess, Outline, guesses_from, guesses_of
from estimator.vision.detect.heading import heading
from estimator.vision.detect.paint import PaintMemory
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.native import checked, image_of, tracker_of
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.regions import covers

_LEVELS = (0, 2)
"""Sizes of the frame that are looked at: for strokes up to some 25 px and 100 px wide."""
_WINDOW_PX = 41
"""Side of the neighbourhood that a pixel is compared with."""
_STANDS_OUT = 7.0
"""Least difference from the neighbourhood's mean, 8-bit."""
_LEAST_AREA_PX = 60.0
_FILLED = 0.3
"""Largest difference of the logarithm of a component's share of its hull from the drawing's."""
_TRIED = 8
"""Largest number of components whose heading is searched."""
_HEADING_PX = 28.0
"""Smallest radius of the pad in the frame that a heading is searched in."""
_HEADINGS, _ASIDE = 16, 0.05
"""Headings that are tried for a component beside the pad's centre, and how far beside it is, in radii of the pad."""
_RASTER, _SILHOUETTES = 401, 3
"""Points along a side by which a drawing's outlines are found, and the most outlines that are looked for."""
Contour = NDArray[np.int32]


class _Silhouette(NamedTuple):
    """The outline of what hangs together in a drawing that has neither disc nor ring."""

    centroid_m: tuple[float, float]
    area_m2: float
    share: float
    """Its share of its convex hull."""


class _Component(NamedTuple):
    contour_px: F64
    """Its outline in the whole frame, (N, 2)."""
    off: float
    """Difference of its share of its hull from the drawing's, by the logarithm."""
    of: _Silhouette


def lettering_blobs(pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane) -> list[Guess]:
    """Return guesses from components of a frame that resemble those of a pad that has neither disc nor ring."""
    found = [c for level in _LEVELS for c in _components(pyramid[level], 1 << level, pad)]
    guesses = []
    for component in sorted(found, key=lambda c: c.off)[: _TRIED if pad.markings.is_letter_alone else 2 * _TRIED]:
        guess = _guess(component, pyramid, camera, pad, plane)
        if guess is not None:
            guesses.append(guess)
    return guesses


def _components(px: U8, step: int, pad: Pad) -> Iterator[_Component]:
    """Yield the components that fill as much of their hull as those of the drawing do and lie within the frame."""
    grey = cv2.cvtColor(px, cv2.COLOR_BGR2GRAY)
    mean = cv2.blur(grey, (_WINDOW_PX, _WINDOW_PX))
    bright = 1 if pad.markings.is_bright else -1
    for sign in (bright,) if pad.ground or pad.markings.is_letter_alone else (bright, -bright):
        mask = np.asarray(sign * (grey.astype(np.int16) - mean) > _STANDS_OUT, np.uint8)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            if len(contour) >= 30:
                yield from _alike(np.asarray(contour, np.int32), step, grey.shape, _silhouettes(pad))


def _alike(contour: Contour, step: int, size: tuple[int, ...], drawn: tuple[_Silhouette, ...]) -> Iterator[_Component]:
    """Yield a component for each one of the drawing that it may be."""
    # A contour runs through the middles of the outermost pixels: half a pixel is missing all around.
    area = cv2.contourArea(contour) + 0.5 * cv2.arcLength(contour, True)
    x, y, wide, high = cv2.boundingRect(contour)
    if area < _LEAST_AREA_PX or x <= 1 or y <= 1 or x + wide >= size[1] - 1 or y + high >= size[0] - 1:
        return
    hull = cv2.convexHull(contour)
    share = area / (cv2.contourArea(hull) + 0.5 * cv2.arcLength(hull, True))
    at = contour.reshape(-1, 2).astype(float)
    centre = at.mean(axis=0)
    outward = (at - centre) * math.sqrt(area / max(cv2.contourArea(contour), 1.0)) + centre
    for silhouette in drawn:
        off = abs(math.log(share / silhouette.share))
        if off < _FILLED:
            yield _Component((outward + 0.5) * step - 0.5, off, silhouette)


def _guess(component: _Component, pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane) -> Guess | None:
    at = plane.places(camera, component.contour_px).astype(np.float32)
    if not np.isfinite(at).all():
        return None
    of = cv2.moments(at.reshape(-1, 1, 2))
    if abs(of["m00"]) < 1e-9:
        return None
    centre, drawn = np.array([of["m10"], of["m01"]]) / of["m00"], component.of
    flat = plane.pose(centre, math.sqrt(abs(of["m00"])), math.sqrt(drawn.area_m2))
    radius_px = flat.disc_px(camera, pad)
    level = max(0, math.floor(math.log2(max(radius_px, 1.0) / _HEADING_PX)))
    aside = math.hypot(*drawn.centroid_m)
    best: Guess | None = None
    turns = np.linspace(0.0, math.tau, _HEADINGS, endpoint=False).tolist() if aside > _ASIDE * pad.disc_radius_m else [None]
    for turn in turns:
        # A component beside the centre says where that is at each heading; the drawing decides which heading is right.
        pose = flat if turn is None else _beside(flat, drawn.centroid_m, turn)
        seen = heading(pyramid[level], 1 << level, camera, pad, pose)
        if seen is None or (turn is not None and abs(math.remainder(seen.turn_rad - turn, math.tau)) > math.tau / _HEADINGS):
            continue
        if best is None or seen.score > best.score:
            R, t = pose.R_cam_pad.matrix.ravel().tolist(), pose.t_cam_pad.tolist()
            best = Guess(R, t, seen.turn_rad, seen.score, seen.score, plane.known)
    return best


def _beside(flat: PadPose, centroid_m: tuple[float, float], turn: float) -> PadPose:
    """Return the pose of a pad, before it is turned, whose component's centroid lies at a pose's centre."""
    (x, y), c, s = centroid_m, math.cos(turn), math.sin(turn)
    return PadPose(flat.R_cam_pad, flat.t_cam_pad - flat.R_cam_pad.matrix[:, :2] @ np.array([c * x - s * y, s * x + c * y]))


@lru_cache(maxsize=8)
def _silhouettes(pad: Pad) -> tuple[_Silhouette, ...]:
    """Return the outlines of what hangs together in the drawing, the largest first."""
    n = _RASTER
    per_m = (n - 4) / (2.0 * pad.disc_radius_m)
    gx, gy = np.meshgrid(*2 * [(np.arange(n) - 0.5 * (n - 1)) / per_m], indexing="ij")
    at = np.stack([gx.ravel(), gy.ravel()], axis=1)
    painted = np.any([covers(region, at) for region in pad.regions], axis=0).reshape(n, n)
    contours, _ = cv2.findContours(painted.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = []
    for contour in contours:
        area, hull, of = cv2.contourArea(contour), cv2.contourArea(cv2.convexHull(contour)), cv2.moments(contour)
        if area > 0.0 and hull > 0.0:
            # Columns of the raster run along y, rows along x.
            y, x = ((of[m] / of["m00"] - 0.5 * (n - 1)) / per_m for m in ("m10", "m01"))
            out.append(_Silhouette((x, y), area / per_m**2, area / hull))
    return tuple(sorted(out, key=lambda one: -one.area_m2)[:_SILHOUETTES])


MOST_LETTERS = 8
"""Largest number of places of the H."""


def h_markings(px: NDArray[np.uint8], step: int, camera: Camera, pad: Pad, plane: Plane, most: int = MOST_LETTERS) -> list[Guess]:
    """Return the likeliest positions of the H, best first; their headings are known up to 180 degrees.

    A guess's `drawing` is the mean of the marks' mask on the H minus the mean around it, halved, -1..1.

    Args:
        px: the frame, `step` times smaller than the camera's.
    """
    how = CORE.ffi.new("dl_stroke_search *", {
        "step": step, "bright": pad.markings.is_bright, "plane_known": plane.known, "most": most,
        "R_cam_plane": plane.R_cam_plane.ravel().tolist(),
    })  # fmt: skip
    out = np.empty(most, CORE.dtype("search_guess"))
    n = CORE.lib.dl_search_strokes(tracker_of(camera, pad), image_of(px), how, CORE.array("search_guess", out, most))
    return guesses_of(out[: checked(n)])


U8 = NDArray[np.uint8]

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
WORK_GUESS = 0.035
"""Work of a guess; see `Kind`. This and the other amounts of work are means over frames without a pad, on a machine at rest."""
_CIRCLES = 12
"""Number of circles of one image."""
_MORE_CIRCLES, _MORE_GUESSES, _MORE_USUAL = {0: 32, 1: 16}, 60, 50
"""Number of circles of an image at full and at half size where half of the disc may be covered.

Then the largest number of guesses from one size, and their usual number from the full size. Of ten half discs at 10 m the full
size has nine among them, of ten at 15 m six.
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
_WORK_GREEN, _WORK_FULL_SIZE, _WORK_STROKES, _WORK_SMALL_GREEN = 2.2, 3.0, 1.6, 3.2
WORK_COARSE, _WORK_LARGER = 1.5, 0.8
_WORK_LETTERING, _WORK_OUTLINES, _WORK_MORE_OF_HALF = 3.0, 2.2, 0.6
FULL_PIXELS = 640 * 360
"""Pixels of the frame that work is counted for."""


class Kind(NamedTuple):
    """One kind of hypotheses. Each frame has all of them, whether they are looked for or not."""

    work: float
    """Work of looking for them, in the time of one BGR to HSV conversion and one inRange of a frame of 640x360."""
    guesses: Callable[[], list[Guess]]
    usual: int = MOST
    """Number of guesses that there usually are in a frame without a pad."""
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

    @property
    def expected_work(self) -> float:
        """Work of looking for them and of comparing as many as there usually are with the drawing."""
        return self.work + WORK_GUESS * self.usual

    def is_drawn(self, guess: Guess) -> bool:
        """Return whether a guess explains enough of the variance to be tried."""
        return guess.drawing >= (self.least_round if guess.support >= _ROUND else self.least_drawing)

    def clear(self, least: float = _CLEAR_DRAWING) -> Kind:
        """Return the same kind for guesses that explain at least this fraction of the variance: few of them are wrong."""
        return self._replace(least_round=least, least_drawing=least)


def kinds(pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane, paint: PaintMemory) -> list[Kind]:
    """Return the kinds of hypotheses, quick and likely kinds first.

    Kinds whose guesses are often wrong are looked at twice: first for guesses that are clear, and for the others after all kinds.
    Those that only a partly covered pad needs are the last ones.
    """
    luminance, colour = _Images(_luminance, pyramid, _MORE_CIRCLES), _Images(lambda px: disc_colour(px, pad), pyramid, {})
    frame = _Searched(pyramid, camera, pad, plane)
    size = camera.width * camera.height / FULL_PIXELS

    def circles_of_colour(levels: tuple[int, ...], of_ring: bool = False) -> list[Guess]:
        if not is_coloured(colour[2]):
            return []
        of, most = (Outline.RING, _MORE_GUESSES) if of_ring else (Outline.DISC, MOST)
        return frame.guesses(frame.circles(colour, levels, only_bright=not of_ring), of, most)

    any_strokes = Kind(_WORK_STROKES, frame.strokes, usual=0, covered=True)
    strokes = any_strokes.clear(_CLEAR_STROKES)._replace(covered=False)
    if not pad.markings.field_radius_m and not pad.markings.ring_outer_m:
        alone = [Kind(_WORK_LETTERING * size, lambda: lettering_blobs(pyramid, camera, pad, plane))]
        return [*alone, strokes] if pad.markings.is_h else alone
    coarse = Kind(WORK_COARSE * size, lambda: frame.plain(luminance))
    larger = Kind(_WORK_LARGER * size, lambda: frame.guesses_by_edges(luminance, _REDUCED_LEVELS))
    blobs = Kind(_WORK_OUTLINES * size, frame.blobs, exact=True, least_round=_LEAST_ROUND)
    full = Kind(_WORK_FULL_SIZE * size, lambda: frame.guesses(frame.circles(luminance, (0,)), Outline.EDGES))
    green = Kind(_WORK_GREEN * size, lambda: circles_of_colour(_REDUCED_LEVELS), by_colour=True)
    small_green = Kind(_WORK_SMALL_GREEN * size, lambda: circles_of_colour((0,)), by_colour=True)
    out = [coarse, larger, blobs, green, strokes, full, small_green]
    if pad.markings.is_searched_by_parts:
        in_ring = green._replace(guesses=lambda: circles_of_colour(_REDUCED_LEVELS, of_ring=True), covered=True)
        half = Kind(_WORK_MORE_OF_HALF * size, lambda: frame.more(luminance, 1), covered=True)
        more = Kind(_WORK_FULL_SIZE * size, lambda: frame.more(luminance, 0), _MORE_USUAL, covered=True)
        # By its colour half a distant disc is found before all circles of the full size are needed, and without colour not.
        last = [blobs.clear(_CLEAR_AREA), more.clear()]
        last = [any_strokes, *last] if disc_has_colour(pad) else [*last, any_strokes]
        out = [
            coarse, larger.clear(), half.clear(), green.clear(_CLEAR_COLOUR), small_green.clear(_CLEAR_COLOUR), strokes, *last,
            small_green, green, larger, blobs, in_ring, half, more,
            Kind(_WORK_STROKES, frame.beside_strokes, usual=0, covered=True),
        ]  # fmt: skip
    if not disc_has_colour(pad):
        return [kind for kind in out if not kind.by_colour]
    if paint.dominance(pad) is None:
        return out
    return [green, *(kind for kind in out if kind.guesses is not green.guesses)]


@dataclass(frozen=True, slots=True, eq=False)
class _Searched:
    """Images of one frame from which hypotheses are made."""

    pyramid: Pyramid
    camera: Camera
    pad: Pad
    plane: Plane

    def guesses(
        self, circles: list[EdgeCircle], of: Outline, most: int = MOST, rated: dict[int, F64] | None = None
    ) -> list[Guess]:
        """Return guesses from circles."""
        return guesses_from(circles, of, self.pyramid, self.camera, self.pad, self.plane, most, rated)

    def plain(self, images: _Images) -> list[Guess]:
        """Return guesses from the circles of the smallest images that the drawing explains well."""
        guesses = self.guesses_by_edges(images, _COARSE_LEVELS)
        return [guess for guess in guesses if guess.drawing >= _PLAIN_DRAWING]

    def guesses_by_edges(self, images: _Images, levels: tuple[int, ...]) -> list[Guess]:
        """Return guesses from circles of edges at several sizes of an image; those of one size are computed once."""
        circles = self.circles(images, levels)
        return guesses_from(circles, Outline.EDGES, self.pyramid, self.camera, self.pad, self.plane, rated=images.rated)

    def circles(self, images: _Images, levels: tuple[int, ...], only_bright: bool = False) -> list[EdgeCircle]:
        """Return the circles at several sizes of an image: the most prominent at each size first."""
        by_level = {level: self._circles(images, level, only_bright)[:_CIRCLES] for level in levels}
        found = [(rank - one.support, one) for circles in by_level.values() for rank, one in enumerate(circles)]
        return [circle for _, circle in sorted(found, key=lambda of: of[0])]

    def _circles(self, images: _Images, level: int, only_bright: bool) -> list[EdgeCircle]:
        """Return the circles at one size of an image, most prominent first."""
        if (level, only_bright) not in images.circles:
            image, least = images[level], level == _REDUCED_LEVELS[0]
            radii = _FULL_SIZE if level == 0 else _LEAST_SIZE if least else _REDUCED
            beyond_px = round(_BEYOND * image.shape[1]) if least else _MARGIN_PX if level in images.more_circles else 0
            most = images.more_circles.get(level, _CIRCLES)
            images.circles[level, only_bright] = edge_circles(
                image, 1 << level, self.camera, self.plane, radii, most, beyond_px, only_bright=only_bright
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
        return self.guesses(blob_circles(self.pyramid, self.camera, self.plane), Outline.AREA, _MORE_GUESSES)

    def strokes(self) -> list[Guess]:
        """Return guesses from the strokes of the H."""
        level = max(1, round(math.log2(self.camera.width / STROKES_WIDTH_PX)))
        return h_markings(self.pyramid[level], 1 << level, self.camera, self.pad, self.plane) if self.pad.markings.is_h else []

    def beside_strokes(self) -> list[Guess]:
        """Return guesses in which what was taken for one leg of the H is the other: where half of it is covered."""
        apart_m = self.pad.markings.h_width_m - self.pad.markings.leg_width_m
        moved = [_moved(guess, side * apart_m) for guess in self.strokes() for side in (1.0, -1.0)]
        # Beside an H that is seen from near and very aslant the other leg may lie behind the camera.
        return [guess for guess in moved if guess.t_cam_pad[2] > _NEAREST_M]


def _moved(guess: Guess, across_m: float) -> Guess:
    """Return a guess of a pad so far along its own y axis."""
    across = guess.pose.R_cam_pad.matrix[:, 1].tolist()
    return guess._replace(t_cam_pad=[at + across_m * axis for at, axis in zip(guess.t_cam_pad, across, strict=True)])


class _Images:
    """One measure of a frame at full, half, quarter ... size; each is computed on demand."""

    def __init__(self, measure: Callable[[U8], U8], pyramid: Pyramid, more_circles: Mapping[int, int]) -> None:
        self.more_circles = more_circles
        """Sizes at which more circles are looked for than at others, beyond the frame's edge, too; and how many."""
        self.circles: dict[tuple[int, bool], list[EdgeCircle]] = {}
        """Circles by size and by whether only bright ones were looked for, as far as they were."""
        self.rated: dict[int, F64] = {}
        """Guesses from them as circles of edges; see `guesses_from`."""
        self._measure = measure
        self._pyramid = pyramid
        self._made: dict[int, U8] = {}

    def __getitem__(self, level: int) -> U8:
        if level not in self._made:
            self._made[level] = self._measure(self._pyramid[level])
        return self._made[level]


def _luminance(px: U8) -> U8:
    return np.asarray(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), np.uint8)
