"""The kinds of hypotheses of a search, quick and likely kinds first: circles of edges, and the strokes of the H."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.vision.camera import Camera
from estimator.vision.detect.blobs import lettering_blobs
from estimator.vision.detect.colour import disc_colour, disc_has_colour, is_coloured
from estimator.vision.detect.edge_circles import EdgeCircle, Radii, edge_circles
from estimator.vision.detect.guesses import Guess, guesses_from
from estimator.vision.detect.paint import PaintMemory
from estimator.vision.detect.plane import Plane
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.strokes import h_markings
from estimator.vision.pad import Pad

U8 = NDArray[np.uint8]

STROKES_WIDTH_PX = 160
"""Approximate width of the frame in which the H's strokes are searched."""
WORK_GUESS = 0.1
"""Work of a guess; see `Kind`."""
_CIRCLES = 12
"""Number of circles of one image."""
_FULL_SIZE, _REDUCED, _LEAST_SIZE = Radii(4.5, 1.22, 5), Radii(5.0, 1.2, 7), Radii(8.5, 1.2, 10)
"""Radii searched at full size, at half and a quarter of it, and at an eighth."""
_BEYOND = 0.4
"""How far beyond the edge of the smallest image centres are looked for, in its widths."""
_WORK_REDUCED, _WORK_FULL_SIZE, _WORK_STROKES, _WORK_COLOUR, _WORK_BLOBS = 4.0, 4.0, 3.0, 1.0, 3.0
FULL_PIXELS = 640 * 360
"""Pixels of the frame that work is counted for."""


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """One kind of hypotheses."""

    work: float
    """Work of looking for them, in the time of one BGR to HSV conversion and one inRange of a frame of 640x360."""
    guesses: Callable[[], list[Guess]]


def kinds(pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane, paint: PaintMemory) -> list[Kind]:
    """Return the kinds of hypotheses, quick and likely kinds first."""
    luminance, colour = _Images(_luminance, pyramid), _Images(lambda px: disc_colour(px, pad), pyramid)
    size = camera.width * camera.height / FULL_PIXELS

    def circles(images: _Images, levels: tuple[int, ...]) -> list[Guess]:
        by_colour = images is colour
        if by_colour and not is_coloured(colour[2]):
            return []
        return guesses_from(_by_rank(images, levels, camera, plane), by_colour, pyramid, camera, pad, plane)

    def strokes() -> list[Guess]:
        level = max(1, round(math.log2(camera.width / STROKES_WIDTH_PX)))
        return h_markings(pyramid[level], 1 << level, camera, pad, plane) if pad.markings.is_h else []

    if pad.markings.is_letter_alone:
        alone = [Kind(_WORK_BLOBS * size, lambda: lettering_blobs(pyramid, camera, pad, plane))]
        return [*alone, Kind(_WORK_STROKES, strokes)] if pad.markings.is_h else alone
    out = [
        Kind(_WORK_REDUCED * size, lambda: circles(luminance, (3, 2, 1))),
        Kind(_WORK_STROKES, strokes),
        Kind(_WORK_FULL_SIZE * size, lambda: circles(luminance, (0,))),
    ]
    if disc_has_colour(pad):
        by_colour = Kind((_WORK_REDUCED + _WORK_COLOUR) * size, lambda: circles(colour, (3, 2, 1)))
        out.insert(0 if paint.dominance(pad) is not None else 2, by_colour)
        out.append(Kind((_WORK_FULL_SIZE + _WORK_COLOUR) * size, lambda: circles(colour, (0,))))
    return out


class _Images:
    """One measure of a frame at full, half, quarter ... size; each is computed on demand."""

    def __init__(self, measure: Callable[[U8], U8], pyramid: Pyramid) -> None:
        self._measure = measure
        self._pyramid = pyramid
        self._made: dict[int, U8] = {}

    def __getitem__(self, level: int) -> U8:
        if level not in self._made:
            self._made[level] = self._measure(self._pyramid[level])
        return self._made[level]


def _luminance(px: U8) -> U8:
    return np.asarray(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), np.uint8)


def _by_rank(images: _Images, levels: tuple[int, ...], camera: Camera, plane: Plane) -> list[EdgeCircle]:
    """Return the circles at several sizes of an image: the most prominent at each size first."""
    found = []
    for level in levels:
        image, least = images[level], level == max(levels) > 0
        radii = _FULL_SIZE if level == 0 else _LEAST_SIZE if least else _REDUCED
        beyond_px = round(_BEYOND * image.shape[1]) if least else 0
        of_level = edge_circles(image, 1 << level, camera, plane, radii, _CIRCLES, beyond_px)
        found += [(rank - circle.support, circle) for rank, circle in enumerate(of_level)]
    return [circle for _, circle in sorted(found, key=lambda of: of[0])]
