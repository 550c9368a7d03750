"""Render the sea: swell from the wave field, ripples, foam, the sun's glitter, the ship's shadow and wake."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from sitl.light import Light
from sitl.projection import F32, SHIFT, Lens, fixed_point
from sitl.surroundings import Surroundings
from sitl.textures import foam, ripples

U8 = NDArray[np.uint8]
_COARSE = 8
"""Distance, px, between the points at which swell, sky and glitter are computed; they vary slowly."""


class SeaPainter:
    """Renders the sea's surface through one lens. It lies in the plane of calm water; waves show only by their slope."""

    def __init__(self, lens: Lens, surroundings: Surroundings, light: Light) -> None:
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
        self._table = _water_table(surroundings.water)
        self._ripples, self._foam = ripples(surroundings.seed), foam(surroundings.seed)

    def paint(self, R_ned_cam: F64, p_cam_ned: F64, t_s: float, rows: slice, cols: slice, ship: list[F64]) -> U8:
        """Return (h, w, 3) BGR of the part `rows`, `cols` of the frame.

        Args:
            ship: outlines on the water, (N, 3) m ned: none, or the hull at the waterline, its shadow, and its wake if it makes
                way.
        """
        lens = self._lens
        rays = lens.rays[rows, cols]
        h, w = rays.shape[:2]
        plane = np.stack([R_ned_cam[0], R_ned_cam[1], -(R_ned_cam.T @ p_cam_ned)], axis=1)
        inverse = lens.plane_from_ray(plane)
        if inverse is None or p_cam_ned[2] > 0:
            return np.full((h, w, 3), self._table[90, 0], np.uint8)
        # Water has no sharp edges: rendering at half the resolution takes a quarter of the time.
        half = (max(2, w // 2), max(2, h // 2))
        where = _places(np.asarray(cv2.resize(rays, half), dtype=np.float32), inverse)
        footprint = 2.0 * -float(p_cam_ned[2]) / lens.camera.fx
        level, glint = self._slow(rays, R_ned_cam, p_cam_ned, inverse, t_s)
        wind = 1.1 * t_s
        small = self._ripples.read(where, footprint, 0.43, (-0.5 * wind, -0.35 * wind))
        large = self._ripples.read(where, footprint, 1.9, (-0.3 * wind, -0.9 * wind))
        chop = cv2.addWeighted(small, 0.6 * self._roughness, large, 0.8 * self._roughness, 0.0)
        contrasted = cv2.multiply(chop, cv2.resize(glint, half))
        value: F32 = np.asarray(cv2.add(contrasted, cv2.resize(level, half)), dtype=np.float32)
        if math.isfinite(self._whitecaps):
            caps = self._foam.read(where, footprint, 1.0, (-0.4 * wind, -0.4 * wind))
            caps = np.clip((caps + 0.5 * large - np.float32(self._whitecaps)) * np.float32(3.0), 0.0, 1.0)
            value += np.float32(120.0) * caps
        if ship:
            self._ship_on_water(value, where, footprint, R_ned_cam, p_cam_ned, rows, cols, t_s, ship)
        painted = cv2.applyColorMap(cv2.resize(np.clip(value, 0.0, 255.0).astype(np.uint8), (w, h)), self._table)
        below = lens.corner_rays @ R_ned_cam[2, :2] + R_ned_cam[2, 2]
        if below.min() < 0.02:
            down = rays @ R_ned_cam[2, :2].astype(np.float32) + np.float32(R_ned_cam[2, 2])
            painted[down < 0.02] = (214, 200, 186)
        return np.asarray(painted, dtype=np.uint8)

    def _slow(self, rays: F32, R_ned_cam: F64, p_cam_ned: F64, inverse: F64, t_s: float) -> tuple[F32, F32]:
        """Return brightness level and ripple contrast, (h / 8, w / 8) each, from swell, mirrored sky and sun."""
        h, w = rays.shape[:2]
        ch, cw = max(2, h // _COARSE), max(2, w // _COARSE)
        coarse = cv2.resize(rays, (cw, ch), interpolation=cv2.INTER_LINEAR)
        d = np.concatenate([coarse, np.ones((ch, cw, 1), np.float32)], axis=-1) @ R_ned_cam.T.astype(np.float32)
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        down = np.clip(d[..., 2], 0.02, 1.0)
        level = 52.0 + 95.0 * (1.0 - down) ** 2
        bisector = self._to_sun.astype(np.float32) - d
        tilt2 = (bisector[..., 0] ** 2 + bisector[..., 1] ** 2) / np.minimum(bisector[..., 2], -0.05) ** 2
        glitter = np.exp(-tilt2 / (2 * 0.16**2))
        if self._swell is not None:
            ne = np.clip(cv2.perspectiveTransform(coarse, inverse), -1e4, 1e4)[::3, ::3]
            slope = self._swell.slope(ne, t_s)[0]
            along = slope @ np.array([0.75, 0.66])
            level += cv2.resize((150.0 * along).astype(np.float32), (cw, ch))
        return np.asarray(level + 22.0 * glitter, np.float32), np.asarray(26.0 + 70.0 * glitter, np.float32)

    def _ship_on_water(
        self, value: F32, where: F32, footprint: float, R_ned_cam: F64, p_cam_ned: F64, rows: slice, cols: slice, t_s: float,
        ship: list[F64],
    ) -> None:  # fmt: skip
        h, w = value.shape
        small = (max(2, w // 2), max(2, h // 2))
        scale = (small[0] / (cols.stop - cols.start), small[1] / (rows.stop - rows.start))

        def mask(points_ned: F64, sigma: float) -> F32 | None:
            uv = self._lens.outline((points_ned - p_cam_ned) @ R_ned_cam, 4)
            if not len(uv):
                return None
            canvas = np.zeros((small[1], small[0]), np.float32)
            here = (uv - (cols.start, rows.start)) * scale
            cv2.fillPoly(canvas, [fixed_point(here)], 1.0, cv2.LINE_8, SHIFT)
            size = 2 * math.ceil(2.0 * sigma) + 1
            soft = cv2.GaussianBlur(canvas, (size, size), sigma)
            return np.asarray(cv2.resize(soft, (w, h)), dtype=np.float32)

        px_per_m = 0.5 / footprint
        shadow = mask(ship[1], float(np.clip(0.06 * px_per_m, 0.6, 12.0)))
        if shadow is not None:
            value *= 1.0 - np.float32(0.5) * shadow
        streaks = self._foam.read(where, footprint, 0.25, (-0.2 * t_s, 0.1 * t_s))
        streaks = np.clip(streaks * np.float32(0.5) + np.float32(0.35), 0.0, 1.0)
        wash = mask(ship[0], float(np.clip(0.10 * px_per_m, 0.6, 20.0)))
        if wash is not None:
            value += wash * streaks * np.float32(55.0 if len(ship) == 2 else 110.0)
        if len(ship) > 2:
            wake = mask(ship[2], float(np.clip(0.25 * px_per_m, 0.8, 30.0)))
            if wake is not None:
                value += wake * streaks * np.float32(130.0)


def _places(rays: F32, plane_from_ray: F64) -> F32:
    """Return where each ray meets the water, (h, w, 2) m north and east.

    A ray above the horizon gets a meaningless value within 100 km.
    """
    where: F32 = np.asarray(cv2.perspectiveTransform(rays, plane_from_ray), dtype=np.float32)
    return np.clip(where, -1e5, 1e5, out=where)


def _water_table(water: tuple[int, int, int]) -> U8:
    """Return the (256, 1, 3) BGR colours from troughs through mirrored sky to foam."""
    r, g, b = water
    stops = [0, 50, 110, 175, 225, 255]
    red = [0.35 * r, r, 1.9 * r + 12, 138, 208, 240]
    green = [0.45 * g, g, 1.35 * g + 16, 166, 220, 244]
    blue = [0.50 * b, b, 1.30 * b + 18, 178, 222, 244]
    v = np.arange(256)
    table = np.stack([np.interp(v, stops, channel) for channel in (blue, green, red)], axis=-1)
    return np.clip(np.round(table), 0, 255).astype(np.uint8)[:, None]
