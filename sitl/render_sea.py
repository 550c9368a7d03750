"""Render the sea: swell from the wave field, ripples, foam, the sun's glitter, the ship's shadow and wake."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.interface.render import CELL_PX
from sitl.light import U16, Light, scene_of
from sitl.native import address, render_sea, render_water
from sitl.projection import F32, FAR_M, SHIFT, Lens, fixed_point
from sitl.surroundings import Surroundings
from sitl.textures import foam, ripples

U8 = NDArray[np.uint8]

_SKY = (214, 200, 186)
"""Colour of the sky at the horizon, BGR."""


class SeaPainter:
    """Renders the sea's surface through one lens. It lies in the plane of calm water; waves show only by their slope."""

    def __init__(self, lens: Lens, surroundings: Surroundings, light: Light, blend: str) -> None:
        self._lens, self._around = lens, surroundings
        waves = surroundings.waves
        self._swell = waves.longest(24) if waves is not None and float(waves.hs_m[0]) > 0 else None
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
        slow = cv2.resize(self._slow(R_ned_cam, inverse, t_s, rows, cols), (w, h))
        shade, white = self._ship_on_water(footprint, R_ned_cam, p_cam_ned, rows, cols, ship) if ship else (None, None)
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
            [0.6 * self._roughness, 0.8 * self._roughness, self._whitecaps if breaking else 0.0, 120.0 * breaking], np.float32
        )
        codes = np.zeros((h, w), np.uint8)
        render_sea(
            *scene.shape[:2], address(mask, np.uint8, scene.shape[:2]),
            cols.start // 2, cols.stop // 2, rows.start // 2, rows.stop // 2, address(cells, np.float32), cells.shape[1],
            *(address(texels, np.float32) for texels, _ in layers), address(sizes, np.int32), address(drift, np.float64),
            address(weights, np.float32), address(slow, np.float32, (h, w, 2)), address(shade, np.float32, (h, w)),
            address(white, np.float32, (h, w)), address(codes, np.uint8),
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

    def _slow(self, R_ned_cam: F64, inverse: F64, t_s: float, rows: slice, cols: slice) -> F32:
        """Return brightness level and ripple contrast, (R, C, 2), each 16 pixels, from swell, mirrored sky and sun."""
        r, c = (np.arange(part.start // CELL_PX + 1, -(-part.stop // CELL_PX) + 1, 2) for part in (rows, cols))
        coarse = self._lens.coarse[np.ix_(r, c)]
        d = coarse @ R_ned_cam[:, :2].T.astype(np.float32) + R_ned_cam[:, 2].astype(np.float32)
        d /= np.sqrt(1.0 + (coarse * coarse).sum(axis=-1, keepdims=True))
        down = np.clip(d[..., 2], 0.02, 1.0)
        level = 52.0 + 95.0 * (1.0 - down) ** 2
        bisector = self._to_sun.astype(np.float32) - d
        tilt2 = (bisector[..., 0] ** 2 + bisector[..., 1] ** 2) / np.minimum(bisector[..., 2], -0.05) ** 2
        glitter = np.exp(tilt2 * np.float32(-1.0 / (2 * 0.16**2)))
        if self._swell is not None:
            ne = np.clip(cv2.perspectiveTransform(coarse, inverse), -1e4, 1e4)[::2, ::2]
            along = self._swell.slope(ne, t_s)[0] @ np.array([0.75, 0.66])
            level = level + cv2.resize((150.0 * along).astype(np.float32), level.shape[::-1])
        return np.stack([level + 22.0 * glitter, 26.0 + 70.0 * glitter], axis=-1).astype(np.float32)

    def _ship_on_water(
        self, footprint: float, R_ned_cam: F64, p_cam_ned: F64, rows: slice, cols: slice, ship: list[F64]
    ) -> tuple[F32 | None, F32 | None]:
        """Return the share of light that the ship's shadow takes from the water, and the brightness of foam beside and behind it.

        Both are for squares of 2 x 2 pixels; None where there is none in the part of the frame.
        """
        w, h = (cols.stop - cols.start) // 2, (rows.stop - rows.start) // 2
        small = (max(2, w // 2), max(2, h // 2))
        scale = (small[0] / (cols.stop - cols.start), small[1] / (rows.stop - rows.start))

        def mask(points_ned: F64, sigma: float, most: float) -> F32 | None:
            """Return the polygon with a soft edge, `most` inside, a quarter of the part's size."""
            uv = self._lens.outline((points_ned - p_cam_ned) @ R_ned_cam, 4)
            if not len(uv):
                return None
            canvas = np.zeros((small[1], small[0]), np.uint8)
            here = (uv - (cols.start, rows.start)) * scale
            cv2.fillPoly(canvas, [fixed_point(here)], 255, cv2.LINE_8, SHIFT)
            size = 2 * math.ceil(1.7 * sigma) + 1
            soft = cv2.blur(cv2.blur(canvas, (size, size)), (size, size))
            return soft * np.float32(most / 255.0)

        px_per_m = 0.5 / footprint
        shade = mask(ship[1], float(np.clip(0.06 * px_per_m, 0.6, 12.0)), 0.5)
        wash = mask(ship[0], float(np.clip(0.10 * px_per_m, 0.6, 20.0)), 55.0 if len(ship) == 2 else 110.0)
        wake = mask(ship[2], float(np.clip(0.25 * px_per_m, 0.8, 30.0)), 130.0) if len(ship) > 2 else None
        white = wash if wake is None else wake if wash is None else wash + wake
        each = (None if part is None else np.asarray(cv2.resize(part, (w, h)), dtype=np.float32) for part in (shade, white))
        return next(each), next(each)


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
