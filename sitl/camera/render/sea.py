"""Render the sea: swell from the wave field, ripples, foam, the sun's glitter, the ship's shadow and wake."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from sitl.camera.light import U16, Light, scene_of
from sitl.camera.projection import F32, Lens
from sitl.camera.render.textures import foam, ripples
from sitl.camera.surroundings import Surroundings
from sitl.core.library import SIM

U8 = NDArray[np.uint8]

_SKY = (214, 200, 186)
"""Colour of the sky at the horizon, BGR."""
_SHADE = 0.5
"""Share of light that a ship's shadow takes from the water."""
_FOAM, _FOAM_AT_REST = (110.0, 130.0), 55.0
"""Brightness of the foam beside and behind a ship under way, and beside one at rest."""
_NOWHERE: F64 = np.empty((0, 2))
_SOFT_M, _SOFT_LEAST = (0.06, 0.10, 0.25), (0.6, 0.6, 0.8)
"""Deviations of soft edges: of a ship's shadow, of the foam beside her and of her wake, m.

Then the least ones, in squares of 4 x 4 pixels.
"""


class SeaPainter:
    """Renders the sea's surface through one lens. It lies in the plane of calm water; waves show only by their slope."""

    def __init__(self, lens: Lens, surroundings: Surroundings, light: Light) -> None:
        self._lens, self._around = lens, surroundings
        waves = surroundings.waves
        swell = waves.longest(24) if waves is not None and float(waves.hs_m[0]) > 0 else None
        self._swell = swell.packed() if swell is not None else np.empty(0, SIM.dtype("dl_sim_wave"))
        hs = 0.0 if waves is None else float(waves.hs_m[0])
        self._roughness = 0.55 + 0.45 * math.tanh(hs)
        self._whitecaps = 2.6 - 0.9 * math.tanh((hs - 0.6) / 2.0) if hs > 0.6 else math.inf
        cos_e = math.cos(light.sun_elevation_rad)
        self._to_sun = np.array(
            [cos_e * math.cos(light.sun_azimuth_rad), cos_e * math.sin(light.sun_azimuth_rad), -math.sin(light.sun_elevation_rad)]
        )
        self._table, self._sky = scene_of(_water_table(surroundings.water)), scene_of(_SKY)
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
            _layer(*self._ripples.layer(footprint, 0.43, (-0.5 * wind, -0.35 * wind))),
            _layer(*self._ripples.layer(footprint, 1.9, (-0.3 * wind, -0.9 * wind))),
            _layer(*self._foam.layer(footprint, 1.0, (-0.4 * wind, -0.4 * wind))),
            _layer(*self._foam.layer(footprint, 0.25, (-0.2 * t_s, 0.1 * t_s))),
        ]
        breaking = math.isfinite(self._whitecaps)
        sea = SIM.new(
            "dl_sim_sea_surface",
            weights=(
                0.6 * self._roughness, 0.8 * self._roughness, self._whitecaps if breaking else 0.0, 120.0 * breaking,
                _SHADE, beside, behind,
            ),
            slow=slow, outlines=outlines, outline_points=counts, soft_m=soft_m,
        )  # fmt: skip
        sea.small, sea.large, sea.caps, sea.streaks = (layer[0] for layer in layers)
        codes, (height, width) = np.zeros((h, w), np.uint8), scene.shape[:2]
        covered = SIM.ffi.NULL if mask is None else SIM.array("uint8_t", mask, height * width)
        coded, where = SIM.array("uint8_t", codes), SIM.new("dl_sim_plane_cells", at=cells, columns=cells.shape[1])
        squares = SIM.new(
            "dl_sim_frame_part", w=width, x0=cols.start // 2, x1=cols.stop // 2, y0=rows.start // 2, y1=rows.stop // 2
        )
        SIM.lib.dl_sim_render_sea(height, squares, where, sea, covered, coded)
        pixels = SIM.new("dl_sim_frame_part", w=width, x0=cols.start, x1=cols.stop, y0=rows.start, y1=rows.stop)
        colours, painted = SIM.array("uint16_t", self._table, 256 * 4), SIM.array("uint16_t", scene, 4 * height * width)
        SIM.lib.dl_sim_render_water(pixels, coded, colours, covered, painted)
        below = lens.corner_rays @ R_ned_cam[2, :2] + R_ned_cam[2, 2]
        if below.min() < 0.02:
            down = lens.rays[rows, cols] @ R_ned_cam[2, :2].astype(np.float32) + np.float32(R_ned_cam[2, 2])
            scene[rows, cols][down < 0.02] = self._sky

    def _slow(self, R_ned_cam: F64, inverse: F64, t_s: float) -> F32:
        """Return brightness level and ripple contrast for every second cell of `Lens.coarse`, (R // 2 + 1, C // 2 + 1, 2)."""
        coarse, swell = self._lens.coarse, self._swell
        light = np.empty((coarse.shape[0] // 2 + 1, coarse.shape[1] // 2 + 1, 2), np.float32)
        under = SIM.new(
            "dl_sim_swell", R_ned_cam=R_ned_cam, plane_from_ray=inverse, to_sun=self._to_sun, t_s=t_s,
            waves=swell, harmonics=len(swell),
        )  # fmt: skip
        SIM.lib.dl_sim_render_swell(*coarse.shape[:2], SIM.array("float", coarse), under, SIM.array("float", light))
        return light


def _layer(texels: NDArray[np.int16], drift: Sequence[float]) -> Any:
    """Return a texture for the core; its texels have the first row and column repeated."""
    per_m, shift_x, shift_y = drift
    return SIM.new("dl_sim_sea_layer", texels=texels, n=len(texels) - 1, per_m=per_m, shift_x=shift_x, shift_y=shift_y)


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
