"""Make a picture of a pad's paint from a photograph of its sheet."""

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.tools.pads.trace import U8, Picture, edge_of, extent_px
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.pad.markings import Rgb

_PHOTO_PX = 700.0
"""Larger side of a rectified photograph, px."""
_SPECK_PX = 9
"""Width of what is not traced in a rectified photograph, px: it is less than a pixel from some metres away."""
_LOST_MOST = 0.02
"""Greatest share of the paint of a photograph that is cut by its edge: creases and shadows along a sheet's edge are less."""
_MARGIN = 0.4
"""Margin of the search around the rectangle of a photograph, in its larger side."""
_SHEET_MARGIN = -0.02
"""Margin of a sheet, all around: its curled edge and what lies beyond are not traced."""


def fault_of(corners_px: F64) -> str | None:
    """Return what is wrong with four corners, (4, 2) px, that shall be a rectangle's; None if nothing is."""
    line, order = corners_px.astype(np.float32), "fore left, fore right, aft right, aft left"
    if not cv2.isContourConvex(line) or cv2.contourArea(line) < 400.0:
        return f"are not those of a rectangle: give {order}"
    if cv2.contourArea(line, oriented=True) < 0.0:
        return f"run against the clock, which would mirror the pad: give {order}"
    return None


def photographed(
    px: U8, corners_px: F64 | None, size_m: tuple[float, float], paints: int, where: str, *, sheet: bool = False
) -> Picture:
    """Return a photograph of a pad as a picture.

    Args:
        corners_px: (4, 2) the corners of a rectangle on the pad's plane: fore left, fore right, aft right, aft left; None for a
            photograph from straight above.
        size_m: the rectangle's width and length; without one the largest extent of what is painted.
        paints: how many paints there are, that of the ground among them.
        sheet: whether the rectangle is the sheet that the pad is printed on, and nothing beyond it is painted.

    Raises:
        BadInput: the corners are no rectangle that a camera sees.
    """
    if corners_px is not None:
        if fault := fault_of(corners_px):
            raise BadInput(f"{where}: --corners {fault}")
        scale = _PHOTO_PX / max(size_m)
        w, h = scale * size_m[0], scale * size_m[1]
        aside = (_SHEET_MARGIN if sheet else _MARGIN) * max(w, h)
        to = np.array([(0, 0), (w, 0), (w, h), (0, h)], np.float32) + np.float32(aside)
        H = cv2.getPerspectiveTransform(corners_px.astype(np.float32), to)
        size = round(w + 2 * aside), round(h + 2 * aside)
        px = np.asarray(cv2.warpPerspective(px, H, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    else:
        shrunk = _PHOTO_PX / max(px.shape[:2])
        px = np.asarray(cv2.resize(px, None, fx=shrunk, fy=shrunk, interpolation=cv2.INTER_AREA), np.uint8)
        scale = aside = 0.0
    smooth = cv2.medianBlur(cv2.bilateralFilter(px, 9, 40.0, 5.0), 5)
    colours = smooth.reshape(-1, 3).astype(np.float32)
    cv2.setRNGSeed(47)
    some = colours[:: max(1, len(colours) // 40_000)]
    until = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 0.2
    _, _, means = cv2.kmeans(some, paints, np.zeros((len(some), 1), np.int32), until, 6, cv2.KMEANS_PP_CENTERS)
    nearest = np.linalg.norm(colours[:, None] - means[None], axis=2).argmin(axis=1).astype(np.uint8).reshape(px.shape[:2])
    image = np.asarray(cv2.medianBlur(nearest, _SPECK_PX), np.uint8)
    rgb: list[Rgb] = [(round(r), round(g), round(b)) for b, g, r in means.tolist()]
    ground = int(np.bincount(edge_of(image)).argmax())
    whole = image.copy()
    _clear_edges(image, ground)
    around = max(0, round(aside))
    inside = np.s_[around : px.shape[0] - around, around : px.shape[1] - around]
    lost = float(np.mean((whole != image)[inside]) / max(1e-9, np.mean((whole != ground)[inside])))
    cut = f" without {-1000.0 * _SHEET_MARGIN * max(size_m):.0f} mm on each side, where sheets curl," if sheet else ""
    if lost > _LOST_MOST:
        edge = "picture" if corners_px is None else "rectangle" if sheet else "picture around the rectangle"
        raise BadInput(
            f"{where}: what is painted reaches the edge of the {edge}{cut} and {100.0 * lost:.0f} % of the paint would be left "
            "out: give a rectangle or picture that reaches further out, leave --sheet away, or give another number of --paints"
        )
    if corners_px is not None and not sheet and any(_surrounds(whole == n, whole != image) for n in range(paints)):
        raise BadInput(
            f"{where}: paint goes around the rectangle of --corners and would be left out: give one that holds all of the pad"
        )
    extent_m = max(size_m) if corners_px is None else None
    scale = scale or max(1.0, extent_px(image != ground)) / max(size_m)
    return Picture(image, tuple(rgb), scale, ground, _SPECK_PX, size_m=extent_m)


def _surrounds(paint: NDArray[np.bool_], cleared: NDArray[np.bool_]) -> bool:
    """Return whether what was cleared of a paint lies around the picture's middle."""
    at, middle = np.argwhere(paint & cleared).astype(np.int32), 0.5 * np.array(paint.shape)
    return len(at) > 0 and cv2.pointPolygonTest(cv2.convexHull(at), middle.tolist(), False) >= 0.0


def _clear_edges(image: U8, ground: int) -> None:
    """Paint what is cut by the picture's edge like the ground: it is no part of the pad."""
    h, w = image.shape
    for column, row in [(c, r) for c in range(w) for r in (0, h - 1)] + [(c, r) for r in range(h) for c in (0, w - 1)]:
        if image[row, column] != ground:
            cv2.floodFill(image, None, (column, row), ground)
