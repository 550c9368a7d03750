"""Colour segmentation: masks of green, orange and white, the green blob that is the disc, and the white on it that is the H.

The limits are those of the thesis (table 4.1) as whole numbers of OpenCV's HSV scale (hue 0..180, the rest 0..255), both ends
included. Masks only select regions. Positions are measured in `Segmentation.light` and in the coverage by paint that `whiteness`
and `orangeness` derive from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.srgb import LINEAR_LIGHT
from estimator.vision.thesis.blobs import Masks, choose_blob

U8 = NDArray[np.uint8]

F32 = NDArray[np.float32]
Triple = tuple[int, int, int]

_ENOUGH = 1500  # Values of a mask that tell as much as all of them
_MOST_COMPONENTS = 6  # White components that are looked at
_FAINT_PX = 24  # Widest disc that may consist only of mixed pixels
_FAINT_SATURATION = 30  # Saturation below which grey is taken for faint paint
_PLAIN = 0.7  # Plausibility above which the strict limits suffice
_MIN_CONTRAST = 5.0  # Smallest contrast between two paints, of 255 in linear light; less is noise
_LINEAR = np.asarray(255.0 * LINEAR_LIGHT, np.float32)
"""Linear light of each of the 256 values. A lens and a sensor add light, and the tone curve comes last; measured in the values
themselves, the edge between dark and bright paint is off by a fifth of a pixel. Source: IEC 61966-2-1."""


class HsvRange(Struct, frozen=True):
    """One box of colours, both ends included, in OpenCV's 8-bit HSV."""

    low: Triple
    high: Triple

    def mask(self, hsv: U8) -> U8:
        """Convert (H, W, 3) HSV to an (H, W) mask of 0 and 255."""
        return np.asarray(cv2.inRange(hsv, self.low, self.high), np.uint8)

    def paler(self) -> HsvRange:
        """Return the limits for pale green, which is paint in shade or mixed at an edge.

        It is half as saturated, half as bright, and slightly different in hue.
        """
        (h0, s0, v0), (h1, s1, v1) = self.low, self.high
        return HsvRange((max(0, h0 - 8), s0 // 2, v0 // 2), (min(180, h1 + 8), s1, v1))

    def darker(self) -> HsvRange:
        """Return the limits for dark orange: half as bright. A paler orange would be wood or skin, another hue the rim."""
        return HsvRange((*self.low[:2], self.low[2] // 2), self.high)

    def faint_to(self, other: HsvRange) -> HsvRange:
        """Return all hues from this range's to the other's, at a quarter of this one's saturation.

        These are paints mixed with each other and the ground, as on a disc only a few pixels wide.
        """
        low, high = min(self.low[0], other.low[0]), max(self.high[0], other.high[0])
        return HsvRange((low, self.low[1] // 4, self.low[2] // 2), (high, 255, 255))

    def duller(self) -> HsvRange:
        """Return the limits for dull white: more saturated by half and darker by a quarter."""
        (h0, s0, v0), (h1, s1, v1) = self.low, self.high
        return HsvRange((h0, s0, v0 * 3 // 4), (h1, min(255, s1 + s1 // 2), v1))


class ColourSet(Struct, frozen=True):
    """The limits of the pad's three paints under one kind of light."""

    name: str
    green: HsvRange
    orange: HsvRange
    white: HsvRange


SIMULATOR = ColourSet(
    "simulator",
    HsvRange((52, 217, 38), (68, 255, 153)),
    HsvRange((10, 217, 76), (26, 255, 255)),
    HsvRange((0, 0, 76), (180, 38, 255)),
)
INDOOR = ColourSet(
    "indoor",
    HsvRange((60, 153, 0), (100, 255, 153)),
    HsvRange((5, 64, 153), (20, 255, 255)),
    HsvRange((0, 0, 217), (180, 76, 255)),
)
OUTDOOR = ColourSet(
    "outdoor",
    HsvRange((60, 0, 0), (110, 128, 153)),
    HsvRange((5, 51, 230), (20, 178, 255)),
    HsvRange((0, 0, 250), (180, 18, 255)),
)
COLOUR_SETS: Mapping[str, ColourSet] = MappingProxyType({s.name: s for s in (SIMULATOR, INDOOR, OUTDOOR)})


class Segmentation(Struct, frozen=True, eq=False):
    """The masks and light of one frame, cropped to the region of interest around the chosen disc.

    Masks are (h, w) of 0 and 255. Adding `origin_px` (u, v), their top-left pixel, gives coordinates in the whole frame.
    """

    size_px: tuple[int, int]
    """Width and height of the whole frame."""
    origin_px: tuple[int, int]
    light: F32
    """Linear light, (h, w, 3) blue, green, red, 0..255."""
    green: U8
    orange: U8
    h: U8
    """Mask of the H: white inside the disc, grown to all pixels that are at least half white, without smaller components."""
    whiteness: F32 | None
    """Coverage by white paint, (h, w): 0 on green, 1 inside the H; None if there is no H to scale by.

    It is computed from the least of blue, green and red, which is nearly zero for green and orange paint.
    """
    hull_px: F64
    """Convex outline of the visible disc, (N, 2) px of the whole frame."""
    touches_border: bool
    """True if the disc reaches the edge of the frame."""
    h_touches_border: bool
    plausibility: float
    """Plausibility, 0..1: the fit of the blob's solidity and of the fractions of white and orange on it to the pad."""

    def orangeness(self) -> F32 | None:
        """Return the (h, w) coverage by orange paint: red minus blue, 0 on green and on white; None if there is no orange."""
        if not self.orange.any():
            return None
        red_less_blue = self.light[:, :, 2] - self.light[:, :, 0]
        # The ring, thin from afar, is pale; the top of the range is the arrowhead.
        return _scaled(np.asarray(red_less_blue, np.float32), self.green, self.orange, 0.95)


def segment(px: U8, colours: ColourSet) -> Segmentation | None:
    """Segment a whole frame; return None if nothing green in it can be the disc.

    Args:
        px: (H, W, 3) BGR.
        colours: limits of the three paints.
    """
    height, width = px.shape[:2]
    hsv = np.asarray(cv2.cvtColor(px, cv2.COLOR_BGR2HSV), np.uint8)
    masks = Masks(*(r.mask(hsv) for r in (colours.green, colours.orange, colours.white)))
    chosen = choose_blob(masks, masks.green)
    if chosen is None or chosen.plausibility < _PLAIN:
        # Shade, or mixing at the edges of a small disc, leaves fragments. Paler paint counts too if that resembles a pad more.
        paler = (colours.green.paler(), colours.orange.darker(), colours.white.duller())
        pale = Masks(*(r.mask(hsv) for r in paler))
        again = choose_blob(pale, masks.green)
        if again is not None and (chosen is None or again.plausibility > chosen.plausibility):
            chosen, masks = again, pale
    if chosen is None and colours.green.low[1] // 4 >= _FAINT_SATURATION:
        faint = colours.green.faint_to(colours.orange).mask(hsv)
        nothing = np.zeros_like(faint)
        chosen = choose_blob(Masks(faint, nothing, nothing), faint, _FAINT_PX)
    if chosen is None:
        return None
    hull, touches = chosen.hull, chosen.touches_border
    u0, v0, w, h = cv2.boundingRect(hull)
    margin = 8 + max(w, h) // 12
    left, top = max(0, u0 - margin), max(0, v0 - margin)
    right, bottom = min(width, u0 + w + margin), min(height, v0 + h + margin)
    roi = np.s_[top:bottom, left:right]
    inside = np.zeros((bottom - top, right - left), np.uint8)
    cv2.fillConvexPoly(inside, hull - (left, top), 255)
    # White of the deck mixes into the disc's edge; the H ends far inside it. erode() does not shrink at the frame's own edge.
    rounds = max(1, round(0.03 * max(w, h)))
    inside = np.asarray(cv2.erode(inside, np.ones((3, 3), np.uint8), iterations=rounds), np.uint8)
    light = np.asarray(cv2.LUT(px[roi], _LINEAR), np.float32)
    h_mask, whiteness = _h_marking(px[roi], masks.white[roi], masks.green[roi], inside, touches)
    if whiteness is None:
        dull = colours.white.duller().mask(hsv[roi])
        h_mask, whiteness = _h_marking(px[roi], dull, masks.green[roi], inside, touches)
    sides = ((left == 0, h_mask[:, 0]), (top == 0, h_mask[0]), (right == width, h_mask[:, -1]), (bottom == height, h_mask[-1]))
    cut = any(at_edge and side.any() for at_edge, side in sides)
    orange = np.asarray(cv2.bitwise_and(masks.orange[roi], inside), np.uint8)
    return Segmentation(
        (width, height), (left, top), light, masks.green[roi], orange, h_mask, whiteness,
        hull.reshape(-1, 2).astype(float), touches, cut, chosen.plausibility,
    )  # fmt: skip


def _h_marking(px: U8, white: U8, green: U8, inside: U8, disc_cut: bool) -> tuple[U8, F32 | None]:
    """Return the mask of the H and the coverage by white paint.

    The limits for white give the seeds, which in poor light are only the brightest parts; the coverage scaled by them gives the
    whole H. It is computed around the seeds, half as far again on every side, and is 0 elsewhere.
    """
    seeds = _largest(np.asarray(cv2.bitwise_and(white, inside), np.uint8), green, disc_cut)
    u, v, w, h = cv2.boundingRect(seeds)
    if w == 0:
        return seeds, None
    reach = max(w, h) // 2
    box = np.s_[max(0, v - reach) : v + h + reach, max(0, u - reach) : u + w + reach]
    blue, green_value, red = cv2.split(px[box])
    least = np.asarray(cv2.LUT(cv2.min(cv2.min(blue, green_value), red), _LINEAR), np.float32)
    near = _scaled(least, green[box], seeds[box], 0.6)
    if near is None:
        return np.zeros_like(seeds), None
    _, bright = cv2.threshold(near, 0.5, 255.0, cv2.THRESH_BINARY)
    half = np.asarray(cv2.bitwise_and(bright.astype(np.uint8), inside[box]), np.uint8)
    whole = _largest(half, green[box], disc_cut)
    if cv2.bitwise_and(whole, seeds[box]).any():
        near *= np.float32(1.0 / max(0.5, _quantile(_under(near, whole), 0.6)))
        _level(near, whole)
        seeds[box] = whole
    coverage = np.zeros(seeds.shape, np.float32)
    coverage[box] = near
    return seeds, coverage


def _level(coverage: F32, h: U8) -> None:
    """Divide, in place, by the local light on the H.

    Across a shadow's edge or worn paint, an edge is at half of the local paint, not at half of the brightest. This is done only
    if the H's strokes are wide enough to have a core without edges.
    """
    core = cv2.erode(h, np.ones((5, 5), np.uint8), borderType=cv2.BORDER_REPLICATE)
    if cv2.countNonZero(core) < 0.3 * cv2.countNonZero(h):
        return
    u, v, w, height = cv2.boundingRect(h)
    # A stroke and a half: the H is seven strokes long, and at least that much of it is in the frame when this matters.
    reach = 2 * max(2, max(w, height) // 9) + 1
    box = np.s_[max(0, v - reach) : v + height + reach, max(0, u - reach) : u + w + reach]
    k = max(1, reach // 8)
    weight = (core[box][::k, ::k] > 0).astype(np.float32)
    window = (2 * (reach // (2 * k)) + 1,) * 2
    near = cv2.boxFilter(weight, -1, window, borderType=cv2.BORDER_REPLICATE)
    light = cv2.boxFilter(coverage[box][::k, ::k] * weight, -1, window, borderType=cv2.BORDER_REPLICATE)
    light = np.where(near > 1e-3, np.maximum(light / np.maximum(near, 1e-3), 0.3), np.float32(1.0))
    rows, columns = coverage[box].shape
    coverage[box] /= cv2.resize(light, (columns, rows), interpolation=cv2.INTER_LINEAR)


def _largest(white: U8, green: U8, disc_cut: bool) -> U8:
    """Return the largest white components; of a cut disc only those surrounded by green."""
    contours, _ = cv2.findContours(white, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = np.zeros_like(white)
    sized = sorted(((cv2.contourArea(c) + 0.5 * len(c), i) for i, c in enumerate(contours)), reverse=True)[:_MOST_COMPONENTS]
    largest = 0.0
    for area, i in sized:
        if area < max(6.0, 0.25 * largest):
            break
        if disc_cut and not _surrounded(np.asarray(contours[i], np.int32), green):
            continue
        largest = max(largest, area)
        cv2.drawContours(out, contours, i, 255, cv2.FILLED)
    return np.asarray(cv2.bitwise_and(out, white), np.uint8)


def _surrounded(contour: NDArray[np.int32], green: U8) -> bool:
    """Return whether green lies outside most of a white component's outline, not counting the frame's edge."""
    height, width = green.shape
    p = contour[:, 0, :].astype(float)
    ahead = np.roll(p, -3, axis=0) - np.roll(p, 3, axis=0)
    outward = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    hits = []
    # The direction of the outward normal depends on the contour's orientation; green is on one side only.
    for sign in (1.0, -1.0):
        q = np.rint(p + 4.0 * sign * outward).astype(int)
        ok = (q[:, 0] >= 0) & (q[:, 0] < width) & (q[:, 1] >= 0) & (q[:, 1] < height)
        hits.append(float(np.mean(green[q[ok, 1], q[ok, 0]] > 0)) if ok.any() else 0.0)
    return max(hits) > 0.6


def _scaled(channel: F32, zero: U8, one: U8, quantile: float) -> F32 | None:
    """Scale the channel so that the median under mask `zero` becomes 0 and the quantile under mask `one` becomes 1."""
    floor_values, top_values = _under(channel, zero), _under(channel, one)
    if floor_values.size == 0 or top_values.size == 0:
        return None
    floor, top = _quantile(floor_values, 0.5), _quantile(top_values, quantile)
    if top - floor < _MIN_CONTRAST:
        return None
    coverage = channel - np.float32(floor)
    coverage *= np.float32(1.0 / (top - floor))
    return coverage


def _quantile(values: F32, fraction: float) -> float:
    k = int(fraction * (values.size - 1))
    return float(np.partition(values, k)[k])


def _under(channel: F32, mask: U8) -> F32:
    """Return the values under a mask; a large mask is thinned to every n-th row and column."""
    step = max(1, int(np.sqrt(cv2.countNonZero(mask) / _ENOUGH)))
    thin = np.s_[::step, ::step]
    return np.asarray(channel[thin][mask[thin] > 0])
