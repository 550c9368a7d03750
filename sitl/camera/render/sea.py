"""Render the sea: swell from the wave field, ripples, foam, the sun's glitter, the ship's shadow and wake."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from sitl.camera.light import U16, Light, scene_of
from sitl.camera.projection import F32, Lens
from sitl.camera.render.textures import foam, ripples
from sitl.camera.surroundings import Surroundings
from sitl.core.abi import SEA_OUTLINES, SEA_WEIGHTS
from sitl.native import address, render_sea, render_swell, render_water

U8 = NDArray[np.uint8]

_SKY = (214, 200, 186)
"""Colour of the sky at the horizon, BGR."""
_SHADE = 0.5
"""Share of light that a ship's shadow takes from the water."""
_FOAM, _FOAM_AT_REST = (110.0, 130.0), 55.0
"""Brightness of the foam beside and behind a ship under way, and beside one at rest."""
_NOWHERE: F64 = np.empty((0, 2))
_SOFT_M, _SOFT_LEAST = (0.06, 0.10, 0.25), (0.6, 0.6, 0.8)
"""Deviation of the soft edges of a ship's shadow, of the foam beside her and of her wake, m, and the least, in squares of 4 x 4
pixels."""


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
            ship: outlines on the water, (N, 2) m to north and east: none, or the hull at the waterline, its shadow, and its wake
                if it makes way.
            mask: how much of each pixel, (H, W) 0..255, something covers later; None if nothing does.
        """
        lens, (rows, cols) = self._lens, part
        h, w = (rows.stop - rows.start) // 2, (cols.stop - cols.start) // 2
        inverse = lens.plane_at(R_ned_cam.T, -R_ned_cam.T.dot(p_cam_ned))
        if inverse is None or p_cam_ned[2] > 0:
            scene[rows, cols] = self._table[90]
            return
        footprint = 2.0 * -float(p_cam_ned[2]) / lens.camera.fx
        cells = lens.cells(inverse)
        slow = self._slow(R_ned_cam, inverse, t_s)
        outlines, counts, soft_m = _on_water(ship, footprint)
        beside, behind = _FOAM if len(ship) > 2 else (_FOAM_AT_REST, 0.0)
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
                _SHADE, beside, behind,
            ],
            np.float32,
        )  # fmt: skip
        codes = np.zeros((h, w), np.uint8)
        render_sea(
            *scene.shape[:2], address(mask, np.uint8, scene.shape[:2]),
            cols.start // 2, cols.stop // 2, rows.start // 2, rows.stop // 2, address(cells, np.float32), cells.shape[1],
            *(address(texels, np.int16) for texels, _ in layers), address(sizes, np.int32), address(drift, np.float64),
            address(weights, np.float32, (SEA_WEIGHTS,)), address(slow, np.float32),
            address(outlines, np.float64), address(counts, np.int32, (SEA_OUTLINES,)), address(soft_m, np.float32),
            address(codes, np.uint8),
        )  # fmt: skip
        colours = address(self._table, np.uint16, (256, 4))
        render_water(
            scene.shape[1], cols.start, cols.stop, rows.start, rows.stop, address(codes, np.uint8), colours,
            address(mask, np.uint8), address(scene, np.uint16),
        )  # fmt: skip
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


def _on_water(ship: list[F64], footprint_m: float) -> tuple[F64, NDArray[np.int32], F32]:
    """Return the outlines of a ship's shadow, hull and wake for the core.

    Args:
        ship: as in `SeaPainter.paint`.
        footprint_m: size of a square of 2 x 2 pixels on the water.

    Returns:
        Their points (N, 2) m, how many each of them has, and over what width its edge is soft, m.
    """
    outlines = [ship[i] if i < len(ship) else _NOWHERE for i in (1, 0, 2)]
    counts = np.array([len(each) for each in outlines], np.int32)
    # An edge is as soft as a Gaussian of a few centimetres or some pixels; a smooth step is that of this deviation.
    deviations = [max(m, least * 2.0 * footprint_m) for m, least in zip(_SOFT_M, _SOFT_LEAST, strict=True)]
    return np.concatenate(outlines), counts, np.array([math.sqrt(20.0) * 1.4 * d for d in deviations], np.float32)


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
