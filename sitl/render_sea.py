"""Render the sea: swell from the wave field, ripples, foam, the sun's glitter, the ship's shadow and wake."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.interface.render import SEA_WEIGHTS
from sitl.light import U16, Light, scene_of
from sitl.native import address, render_sea, render_swell, render_water
from sitl.projection import F32, FAR_M, SHIFT, Lens, fixed_point
from sitl.surroundings import Surroundings
from sitl.textures import foam, ripples

U8 = NDArray[np.uint8]

_SKY = (214, 200, 186)
"""Colour of the sky at the horizon, BGR."""
_SHADE = 0.5
"""Share of light that a ship's shadow takes from the water."""
_FOAM, _FOAM_AT_REST = (110.0, 130.0), 55.0
"""Brightness of the foam beside and behind a ship under way, and beside one at rest."""
_OPEN = None, None, 0.0
"""What no ship does to the water."""


class SeaPainter:
    """Renders the sea's surface through one lens. It lies in the plane of calm water; waves show only by their slope."""

    def __init__(self, lens: Lens, surroundings: Surroundings, light: Light, blend: str) -> None:
        self._lens, self._around = lens, surroundings
        waves = surroundings.waves
        swell = waves.longest(24) if waves is not None and float(waves.hs_m[0]) > 0 else None
        self._swell = swell.packed() if swell is not None else np.empty((0, 5))
        hs = 0.0 if waves is None else float(waves.hs_m[0])
        self._roughness = 0.55 + 0.45 * math.tanh(hs)
        self._whitecaps = 2.6 - 0.9 * math.tanh((hs - 0.6) / 2.0) if hs > 0.6 else math.inf
        cos_e = math.cos(light.sun_elevation_rad)
        self._to_sun = np.array(
            [cos_e * math.cos(light.sun_azimuth_rad), cos_e * math.sin(light.sun_azimuth_rad), -math.sin(light.sun_elevation_rad)]
        )
        self._table, self._sky = scene_of(_water_table(surroundings.water), blend), scene_of(_SKY, blend)
        self._ripples, self._foam = ripples(surroundings.seed), foam(surroundings.seed)

    def paint(
        self, scene: U16, R_ned_cam: F64, p_cam_ned: F64, t_s: float, part: tuple[slice, slice], ship: list[F64], mask: U8 | None
    ) -> None:
        """Paint a part of a scene (H, W, 4).

        Args:
            part: rows and columns, which begin and end at even numbers.
            ship: outlines on the water, (N, 3) m ned: none, or the hull at the waterline, its shadow, and its wake if it makes
                way.
            mask: how much of each pixel, (H, W) 0..255, something covers later; None if nothing does.
        """
        lens, (rows, cols) = self._lens, part
        h, w = (rows.stop - rows.start) // 2, (cols.stop - cols.start) // 2
        plane = np.stack([R_ned_cam[0], R_ned_cam[1], -(R_ned_cam.T @ p_cam_ned)], axis=1)
        inverse = lens.plane_from_ray(plane)
        if inverse is None or p_cam_ned[2] > 0:
            scene[rows, cols] = self._table[90]
            return
        footprint = 2.0 * -float(p_cam_ned[2]) / lens.camera.fx
        cells = np.clip(cv2.perspectiveTransform(lens.coarse, inverse), -FAR_M, FAR_M)
        slow = self._slow(R_ned_cam, inverse, t_s)
        beside = self._ship_on_water(footprint, R_ned_cam, p_cam_ned, rows, cols, ship) if ship else _OPEN
        shade, white, brightest = beside
        wind = 1.1 * t_s
        # Ripples of two sizes, whitecaps, and the streaks of foam beside the ship.
        layers = [
            self._ripples.layer(footprint, 0.43, (-0.5 * wind, -0.35 * wind)),
            self._ripples.layer(footprint, 1.9, (-0.3 * wind, -0.9 * wind)),
            self._foam.layer(footprint, 1.0, (-0.4 * wind, -0.4 * wind)),
            self._foam.layer(footprint, 0.25, (-0.2 * t_s, 0.1 * t_s)),
        ]
        drift = np.array([where for _, where in layers])
        sizes = np.array([len(texels) - 1 for texels, _ in layers], np.int32)
        breaking = math.isfinite(self._whitecaps)
        weights = np.array(
            [
                0.6 * self._roughness, 0.8 * self._roughness, self._whitecaps if breaking else 0.0, 120.0 * breaking,
                _SHADE, brightest,
            ],
            np.float32,
        )  # fmt: skip
        codes = np.zeros((h, w), np.uint8)
        render_sea(
            *scene.shape[:2], address(mask, np.uint8, scene.shape[:2]),
            cols.start // 2, cols.stop // 2, rows.start // 2, rows.stop // 2, address(cells, np.float32), cells.shape[1],
            *(address(texels, np.float32) for texels, _ in layers), address(sizes, np.int32), address(drift, np.float64),
            address(weights, np.float32, (len(SEA_WEIGHTS),)), address(slow, np.float32),
            address(shade, np.uint8, (h, w)), address(white, np.uint8, (h, w)), address(codes, np.uint8),
        )  # fmt: skip
        colours = address(self._table, np.uint16, (256, 4))
        render_water(
            scene.shape[1],
            cols.start,
            cols.stop,
            rows.start,
            rows.stop,
            address(codes, np.uint8),
            colours,
            address(scene, np.uint16),
        )
        below = lens.corner_rays @ R_ned_cam[2, :2] + R_ned_cam[2, 2]
        if below.min() < 0.02:
            down = lens.rays[rows, cols] @ R_ned_cam[2, :2].astype(np.float32) + np.float32(R_ned_cam[2, 2])
            scene[rows, cols][down < 0.02] = self._sky

    def _slow(self, R_ned_cam: F64, inverse: F64, t_s: float) -> F32:
        """Return brightness level and ripple contrast for every second cell of `Lens.coarse`, (R // 2 + 1, C // 2 + 1, 2)."""
        coarse, swell = self._lens.coarse, self._swell
        light = np.empty((coarse.shape[0] // 2 + 1, coarse.shape[1] // 2 + 1, 2), np.float32)
        R, plane = np.ascontiguousarray(R_ned_cam), np.ascontiguousarray(inverse)
        render_swell(
            *coarse.shape[:2], address(coarse, np.float32), address(R, np.float64), address(plane, np.float64),
            address(self._to_sun, np.float64), t_s, len(swell), address(swell, np.float64), address(light, np.float32),
        )  # fmt: skip
        return light

    def _ship_on_water(
        self, footprint: float, R_ned_cam: F64, p_cam_ned: F64, rows: slice, cols: slice, ship: list[F64]
    ) -> tuple[U8 | None, U8 | None, float]:
        """Return what the ship does to the water: the share of `_SHADE` that its shadow takes, and the foam beside and behind it.

        Both are parts of 255 for squares of 2 x 2 pixels, None where there is none in the part of the frame. Last comes the
        brightness of full foam.
        """
        w, h = (cols.stop - cols.start) // 2, (rows.stop - rows.start) // 2
        small = (max(2, w // 2), max(2, h // 2))
        scale = (small[0] / (cols.stop - cols.start), small[1] / (rows.stop - rows.start))

        def mask(points_ned: F64, sigma: float) -> U8 | None:
            """Return the polygon with a soft edge, 255 inside, a quarter of the part's size."""
            uv = self._lens.outline((points_ned - p_cam_ned) @ R_ned_cam, 4)
            if not len(uv):
                return None
            canvas = np.zeros((small[1], small[0]), np.uint8)
            here = (uv - (cols.start, rows.start)) * scale
            cv2.fillPoly(canvas, [fixed_point(here)], 255, cv2.LINE_8, SHIFT)
            size = 2 * math.ceil(1.7 * sigma) + 1
            return np.asarray(cv2.blur(cv2.blur(canvas, (size, size)), (size, size)), dtype=np.uint8)

        px_per_m = 0.5 / footprint
        shade = mask(ship[1], float(np.clip(0.06 * px_per_m, 0.6, 12.0)))
        wash = mask(ship[0], float(np.clip(0.10 * px_per_m, 0.6, 20.0)))
        wake = mask(ship[2], float(np.clip(0.25 * px_per_m, 0.8, 30.0))) if len(ship) > 2 else None
        beside, behind = _FOAM if len(ship) > 2 else (_FOAM_AT_REST, 0.0)
        white, brightest = wash, beside + behind
        if wake is not None:
            share = beside / brightest
            first = wash if wash is not None else np.zeros_like(wake)
            white = np.asarray(cv2.addWeighted(first, share, wake, 1.0 - share, 0.0), dtype=np.uint8)
        else:
            brightest = beside
        each = [None if part is None else np.asarray(cv2.resize(part, (w, h)), dtype=np.uint8) for part in (shade, white)]
        return each[0], each[1], brightest


def _water_table(water: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Return the (256, 3) BGR colours from troughs through mirrored sky to foam."""
    r, g, b = water
    stops = [0, 50, 110, 175, 225, 255]
    red = [0.35 * r, r, 1.9 * r + 12, 138, 208, 240]
    green = [0.45 * g, g, 1.35 * g + 16, 166, 220, 244]
    blue = [0.50 * b, b, 1.30 * b + 18, 178, 222, 244]
    v = np.arange(256)
    table = np.stack([np.interp(v, stops, channel) for channel in (blue, green, red)], axis=-1)
    return np.clip(np.round(table), 0, 255).astype(np.uint8)
