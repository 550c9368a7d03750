"""The kinds of hypotheses of a search, quick and likely kinds first: circles of edges, outlines of areas, strokes, lettering.

The H is found by its strokes if the disc's outline is out of the frame or occluded. In a plane parallel to the pad it has two
perpendicular directions and strokes of one width. The directions follow from the gradients (four times their angles agree), and
the width from the commonest run of white along either direction. With both known, correlation with the H at one size and two
headings gives its position. All of this runs on a frame a quarter the size, in the native core
(`estimator/core/vision/search/strokes.c`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2

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
)
from estimator.vision.detect.lettering import lettering_blobs
from estimator.vision.detect.pyramid import U8, FrameView, Pyramid
from estimator.vision.detect.template import PaintMemory
from estimator.vision.native import checked, count_work, image_of, tracker_of

_MOST_LETTERS = 8  # Largest number of places of the H

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
_ROUND = 0.8  # Support at which an area's outline is an ellipse
_CIRCLES = 12  # Number of circles of one image
_MORE_CIRCLES, _MORE_GUESSES = {0: 32, 1: 16}, 60
"""Number of circles of an image at full and at half size where half of the disc may be covered, and of guesses from one size.

Of ten half discs at 10 m the full size has nine among them, of ten at 15 m six.
"""
_MARGIN_PX = 8
"""Margin beyond the edge of such an image in which centres are searched, px: half of the disc may be out of the frame."""
_NEAREST_M = 0.05  # Least distance of a guess along the optical axis
_COARSE_LEVELS, _REDUCED_LEVELS = (3, 2), (3, 2, 1)
_PLAIN_DRAWING = 0.3
"""Fraction of the variance that a guess from the smallest images must explain to be tried before the half-size image is searched:
of 112 pads up to 3 m in any light 103 had more, and of 120 frames without a pad one in eight.
"""
_FULL_SIZE, _REDUCED, _LEAST_SIZE = Radii(4.5, 1.22, 5), Radii(5.0, 1.2, 7), Radii(8.5, 1.2, 10)
"""Radii searched at full size, at half and a quarter of it, and at an eighth."""
_BEYOND = 0.4  # Margin beyond the edge of the smallest image in which centres are searched, in its widths
_WORK_GREEN = 2.9  # Work, in floors, of circles of the disc's colour at reduced sizes (see `Kind.work`)
_WORK_SMALL_GREEN = 4.7  # The same at full size
_WORK_FULL_SIZE = 4.4  # Of circles in luminance at full size
_WORK_LARGER = 2.1  # Of those at reduced sizes beside the coarse ones
WORK_COARSE = 2.2
"""Work of circles at the smallest sizes, which come first."""
_WORK_STROKES = 1.9  # Of the H's strokes
_WORK_LETTERING = 3.7  # Of components that may be lettering
_WORK_OUTLINES = 3.2  # Of outlines of areas
_WORK_MORE_OF_HALF = 1.0  # Of more circles at half size


_LUMINANCE_WORK, _COLOUR_WORK = 1, 9
"""Work of a pixel in luminance and in the disc's colour, millionths of a floor."""
FULL_PIXELS = 640 * 360
"""Pixels of the frame that work is counted for."""


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
