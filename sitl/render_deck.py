"""Render the deck: its drawing, edges and side, decals, the drone's shadow, wear and puddles."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from sitl.light import Light
from sitl.projection import F32, SHIFT, Lens, fixed_point
from sitl.surroundings import RGB, Deck, draw_deck
from sitl.textures import grain

U8 = NDArray[np.uint8]


class DeckPainter:
    """Renders a deck through one lens."""

    def __init__(self, lens: Lens, deck: Deck, light: Light) -> None:
        self._lens, self._deck, self._light = lens, deck, light
        self._drawing = draw_deck(deck)
        self._grain = grain(deck.seed)
        outline = deck.outline()
        self._rim = np.concatenate([outline, np.zeros((len(outline), 1))], axis=1)
        c, s = math.cos(deck.pad_yaw_rad), math.sin(deck.pad_yaw_rad)
        self._R_deck_pad = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def rim_pad(self) -> F64:
        """Outline of the deck, (N, 3) m in `pad`."""
        return np.asarray(self._rim @ self._R_deck_pad)

    def mask(self, R_cam_pad: F64, t_cam_pad: F64) -> U8:
        """Return the deck's coverage of each pixel, (H, W), 0..255; OpenCV's drawing antialiases the edges."""
        camera = self._lens.camera
        out = np.zeros((camera.height, camera.width), np.uint8)
        uv = self._lens.outline(self.rim_pad() @ R_cam_pad.T + t_cam_pad, 12)
        if len(uv):
            cv2.fillPoly(out, [fixed_point(uv)], 255, cv2.LINE_AA, SHIFT)
        return out

    def paint(self, rays: F32, pad_from_ray: F64, footprint_m: float) -> U8:
        """Return the paint (h, w, 3) BGR where rays (h, w, 2) meet the deck, by the homography from rays to `pad`."""
        drawing = self._drawing
        level = min(len(drawing.levels) - 1, max(0, round(math.log2(max(footprint_m * drawing.texels_per_m, 1e-3)))))
        image = drawing.levels[level]
        full = drawing.levels[0]
        per_x = image.shape[0] / full.shape[0] * drawing.texels_per_m
        per_y = image.shape[1] / full.shape[1] * drawing.texels_per_m
        x0, y0 = drawing.corner_m
        texel_from_deck = np.array([[0.0, per_y, -per_y * y0 - 0.5], [per_x, 0.0, -per_x * x0 - 0.5], [0.0, 0.0, 1.0]])
        index: F32 = np.asarray(cv2.perspectiveTransform(rays, texel_from_deck @ self.to_deck(pad_from_ray)), dtype=np.float32)
        corners = index[[0, 0, -1, -1], [0, -1, 0, -1]]
        if np.abs(corners).max() > 1e4 or (pad_from_ray[2, :2] @ self._lens.corner_rays.T + pad_from_ray[2, 2]).min() <= 0:
            # Near the horizon texels are far away; OpenCV's border mode would reflect them back one length at a time.
            np.clip(index, -1e4, 1e4, out=index)
        nothing = np.empty(0, np.float32)
        return np.asarray(cv2.remap(image, index, nothing, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), dtype=np.uint8)

    def to_deck(self, pad_from_ray: F64) -> F64:
        """Return the homography from rays to the deck's axes."""
        return np.asarray(self._R_deck_pad @ pad_from_ray)

    def wear(self, rays: F32, pad_from_ray: F64, footprint_m: float) -> tuple[F32 | None, F32 | None]:
        """Return factors on the light from the surface and light added to it, each (h, w) or None, at half resolution."""
        light = self._light
        if light.wear == 0 and light.wetness == 0:
            return None, None
        h, w = rays.shape[:2]
        coarse = cv2.resize(rays, (max(1, w // 2), max(1, h // 2)))
        places: F32 = np.asarray(cv2.perspectiveTransform(coarse, self.to_deck(pad_from_ray)), dtype=np.float32)
        gain = np.ones(places.shape[:2], np.float32)
        if light.wear > 0:
            gain += np.float32(light.wear) * self._grain.read(places, 2.0 * footprint_m)
            np.maximum(gain, np.float32(0.05), out=gain)
        added = None
        if light.wetness > 0:
            puddle = self._grain.read(places, max(2.0 * footprint_m, 0.12), 3.1)
            puddle = np.clip((puddle + np.float32(1.8 * light.wetness - 1.3)) * np.float32(1.8), 0.0, 1.0)
            gain *= np.float32(1.0 - 0.25 * light.wetness) - np.float32(0.2 * light.wetness) * puddle
            added = np.asarray(cv2.resize(np.float32(0.08 * light.wetness) * puddle, (w, h)), dtype=np.float32)
        return np.asarray(cv2.resize(gain, (w, h)), dtype=np.float32), added


def drone_shadow(
    lens: Lens, R_cam_pad: F64, t_cam_pad: F64, R_pad_body: F64, p_body_pad: F64, to_sun_pad: F64
) -> tuple[F32, slice, slice] | None:
    """Return the fraction of sunlight that the drone's shadow takes away, and the part of the frame that it covers.

    The shadow is that of a quadcopter half a metre wide, with four rotors inside guards and a slim hull, cast along the sun onto
    the pad's plane. The width of the sun softens its edge.
    """
    if to_sun_pad[2] > -0.05 or p_body_pad[2] > -0.01:
        return None
    shapes = [np.array([(0.20, -0.05, 0.0), (0.20, 0.05, 0.0), (-0.20, 0.05, 0.0), (-0.20, -0.05, 0.0)])]
    a = np.linspace(0.0, math.tau, 20, endpoint=False)
    for x, y in ((0.14, 0.14), (0.14, -0.14), (-0.14, 0.14), (-0.14, -0.14)):
        shapes.append(np.stack([x + 0.115 * np.cos(a), y + 0.115 * np.sin(a), np.zeros(20)], axis=1))
    cast = []
    for shape in shapes:
        p = shape @ R_pad_body.T + p_body_pad
        cast.append((p - to_sun_pad * (p[:, 2:] / to_sun_pad[2])) @ R_cam_pad.T + t_cam_pad)
    polygons = [uv for uv in lens.outlines(cast) if len(uv)]
    if not polygons:
        return None
    # The sun's disc is half a degree wide: the penumbra is 0.0093 of the distance wide, its standard deviation a quarter of that.
    depth = max(0.05, float(t_cam_pad[2]))
    way = float(-p_body_pad[2] / -to_sun_pad[2])
    sigma = float(np.clip(0.0023 * way * lens.camera.fx / depth, 0.7, 6.0))
    camera = lens.camera
    everything = np.concatenate(polygons)
    margin = 3 * sigma + 2
    low, high = everything.min(axis=0) - margin, everything.max(axis=0) + margin
    x0, y0 = max(0, math.floor(low[0])), max(0, math.floor(low[1]))
    x1, y1 = min(camera.width, math.ceil(high[0])), min(camera.height, math.ceil(high[1]))
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    canvas = np.zeros((y1 - y0, x1 - x0), np.float32)
    for uv in polygons:
        cv2.fillPoly(canvas, [fixed_point(uv - (x0, y0))], 1.0, cv2.LINE_8, SHIFT)
    size = 2 * math.ceil(2.5 * sigma) + 1
    return np.asarray(cv2.GaussianBlur(canvas, (size, size), sigma), np.float32), slice(y0, y1), slice(x0, x1)


def draw(canvas: U8, lens: Lens, points_cam: F64, rgb: RGB) -> None:
    """Fill a polygon (N, 3) m in `cam` on the frame, antialiased by OpenCV's drawing."""
    uv = lens.outline(points_cam, 6)
    if len(uv) >= 3:
        cv2.fillPoly(canvas, [fixed_point(uv)], rgb[::-1], cv2.LINE_AA, SHIFT)
