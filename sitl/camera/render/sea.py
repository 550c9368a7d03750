"""Render the sea: swell from the wave field, ripples, foam, the sun's glitter, the ship's shadow and wake.

Light that is not paint is rendered here, too: lamps, the sun's glint on sea and wet deck, haze, and the mast's shadow. All of it
varies slowly over the frame, except the glint's sparkle, and is computed for cells of 8 x 8 pixels.
"""

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad.lamps import Lamp
from sitl.camera.light import U16, Light, Mast, planck_rgb, scene_of
from sitl.camera.projection import F32, Lens
from sitl.camera.render.deck import foam, ripples, soft_shadow
from sitl.camera.settings import LampSettings
from sitl.camera.surroundings import Surroundings
from sitl.core.library import SIM

U8 = NDArray[np.uint8]

_SKY = (214, 200, 186)
"""Colour of the sky at the horizon, BGR."""
_SHADE = 0.5
"""Share of light that a ship's shadow takes from the water."""
_FOAM = (110.0, 130.0)
"""Brightness of the foam beside and behind a ship under way."""
_FOAM_AT_REST = 55.0  # brightness of the foam beside one at rest
_NOWHERE: F64 = np.empty((0, 2))
_SOFT_M, _SOFT_LEAST = (0.06, 0.10, 0.25), (0.6, 0.6, 0.8)
"""Deviations of soft edges: of a ship's shadow, of the foam beside her and of her wake, m.

Then the least ones, in squares of 4 x 4 pixels.
"""
_AIRLIGHT = 0.55
"""Light of thick haze in daylight, in units of full scale where white paint is 0.8."""
_CONTRAST = -math.log(0.02)
"""Koschmieder's constant: the contrast at the visibility is 2 %. Source: WMO Guide to Instruments (WMO-No. 8), part I, 9.1."""
_SEA_SLOPE = 0.14  # standard deviation of the slopes that mirror the sun: of small waves (Cox & Munk, J. Opt. Soc. Am. 44, 1954)
_DECK_SLOPE = 0.05  # the same of wet paint
_FACET = 0.035
"""Half width, as a slope, of the sun's image in one facet, with the blur of what is smaller than a pixel."""
_RING_M = 0.55  # radius of the ring of small lamps
_RING_LAMP_M = 0.012  # radius of a lamp of it
_FLOOD_AWAY_M = 2.5  # distance of the floodlights from the pad's centre
_FLOOD_HEIGHT_M = 1.5  # their height over the deck
_FLOOD_K = 3200.0  # colour temperature of halogen lamps
_BRIGHTEST = 8.0
"""Largest light of the floodlights, against that in the pad's middle: near their feet it is clipped."""


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
        self._to_sun = light.to_sun_ned
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


class Lamps:
    """Floodlights around the pad, small lamps in a ring around it, and those that the pad itself has.

    Args:
        settings: how many they are, and how bright: the light of all floodlights in the pad's middle, daylight being 1, and that
            of a small lamp, white paint in daylight being 1.
        own: the lamps that the pad's file names.
    """

    def __init__(self, settings: LampSettings, own: Sequence[Lamp] = ()) -> None:
        self.floods = settings.floods
        self._flood_level = settings.flood_level
        around = [math.tau * n / settings.pad_lamps for n in range(settings.pad_lamps)]
        ring = [(_RING_M * np.array([math.cos(a), math.sin(a)]), _RING_LAMP_M, settings.pad_lamps_level) for a in around]
        lit = own if settings.own_level > 0.0 else ()
        self._small = [*ring, *((np.array(lamp.at_m), lamp.radius_m, settings.own_level) for lamp in lit)]

    @property
    def has_small(self) -> bool:
        """True if a lamp is on that the camera sees itself."""
        return bool(self._small)

    def ratios_bgr(self, light: Light) -> F32:
        """Light of the floodlights in the pad's middle against that of the sky, (3,) in blue, green, red."""
        ratio = planck_rgb(_FLOOD_K) / planck_rgb(light.colour_temperature_k)
        ratio = ratio / ratio[1] * self._flood_level * 2.0**-light.daylight_ev
        return np.asarray(ratio[::-1], dtype=np.float32)

    def most_bgr(self, light: Light) -> F32:
        """Largest light on the scene against that of the sky alone, (3,) in blue, green, red."""
        return np.asarray(1.0 + _BRIGHTEST * self.ratios_bgr(light), dtype=np.float32)

    def on_plane(self, lens: Lens, pad_from_ray: F64) -> F32:
        """Return the light of the floodlights on the pad's plane, (H, W), against that in the pad's middle."""
        places = cv2.perspectiveTransform(lens.coarse, pad_from_ray)
        h2, d = _FLOOD_HEIGHT_M**2, _FLOOD_AWAY_M
        total = np.zeros(places.shape[:2])
        for n in range(self.floods):
            a = math.tau * n / self.floods
            away2 = (places[..., 0] - d * math.cos(a)) ** 2 + (places[..., 1] - d * math.sin(a)) ** 2
            total += ((d * d + h2) / (away2 + h2)) ** 1.5
        return lens.spread(np.minimum(total / self.floods, _BRIGHTEST).astype(np.float32))

    def shine(self, light: F32, lens: Lens, R_cam_pad: F64, t_cam_pad: F64) -> None:
        """Add the small lamps' own light to (H, W), white paint in daylight being 1."""
        camera = lens.camera
        for at, radius_m, brightness in self._small:
            point = R_cam_pad[:, :2] @ at + t_cam_pad
            if point[2] <= 0.02:
                continue
            u, v = camera.project(point[None])[0]
            size = max(0.9, radius_m * camera.fx / point[2])
            # Below a pixel a lamp is a point: its light spreads over the pixel, falling with the square of the distance.
            level = brightness * min(1.0, (radius_m * camera.fx / point[2] / 0.9) ** 2)
            for sigma, share in ((size, 1.0), (6.0 * size, 0.02)):
                reach = math.ceil(4.0 * sigma)
                x0, x1 = max(0, math.floor(u) - reach), min(camera.width, math.floor(u) + reach + 2)
                y0, y1 = max(0, math.floor(v) - reach), min(camera.height, math.floor(v) + reach + 2)
                if x1 > x0 and y1 > y0:
                    across = np.exp(-0.5 * ((np.arange(x0, x1) - u) / sigma) ** 2)
                    down = np.exp(-0.5 * ((np.arange(y0, y1) - v) / sigma) ** 2)
                    light[y0:y1, x0:x1] += (share * level * down[:, None] * across).astype(np.float32)


def through_haze(lens: Lens, normal_cam: F64, distance_m: float, visibility_m: float) -> tuple[F32, F32]:
    """Return the share of light that comes through haze from a plane, (H, W), and the light of the haze itself in daylight.

    Args:
        normal_cam: (3,) the plane's normal, away from the camera.
        distance_m: distance of the camera from the plane.
    """
    coarse = lens.coarse
    along = np.maximum(coarse @ normal_cam[:2].astype(np.float32) + np.float32(normal_cam[2]), np.float32(1e-3))
    way = distance_m * np.sqrt(1.0 + (coarse * coarse).sum(axis=-1)) / along
    share = lens.spread(np.exp(-_CONTRAST / visibility_m * way).astype(np.float32))
    return share, np.float32(_AIRLIGHT / 0.8) * (np.float32(1.0) - share)


def glint(lens: Lens, R_plane_cam: F64, to_sun_plane: F64, places: F32, footprint_m: float, *, sea: bool, t_s: float) -> F32:
    """Return the sun's image in a rough mirror, (H, W): 1 where a facet mirrors the sun into the pixel.

    Args:
        R_plane_cam: (3, 3) axes of the plane, z into it.
        to_sun_plane: (3,) direction to the sun, in the plane's axes.
        places: where the rays meet the plane, (H / 2, W / 2, 2) m.
        footprint_m: size of a pixel on the plane.
        sea: whether the facets are waves or the grain of wet paint.
    """
    coarse = lens.coarse
    d = coarse @ R_plane_cam[:, :2].T.astype(np.float32) + R_plane_cam[:, 2].astype(np.float32)
    d /= np.sqrt(1.0 + (coarse * coarse).sum(axis=-1, keepdims=True))
    bisector = to_sun_plane.astype(np.float32) - d
    slope = lens.spread(bisector[..., :2] / np.minimum(bisector[..., 2:], np.float32(-0.05)))
    h, w = places.shape[:2]
    slope = np.asarray(cv2.resize(slope, (w, h)), dtype=np.float32)
    rough, size = (_SEA_SLOPE, 0.43) if sea else (_DECK_SLOPE, 0.05)
    tile, wind = ripples(0), 1.1 * t_s if sea else 0.0
    facets = [tile.read(places, 2.0 * footprint_m, size, (-0.5 * wind + aside, -0.35 * wind - aside)) for aside in (0.0, 2.7)]
    off2 = sum((slope[..., i] - np.float32(rough) * facets[i]) ** 2 for i in (0, 1))
    spot = np.exp(np.maximum(off2 * np.float32(-0.5 / _FACET**2), np.float32(-30.0)))
    return np.asarray(cv2.resize(spot, (lens.camera.width, lens.camera.height)), dtype=np.float32)


def mast_shadow(lens: Lens, mast: Mast, R_cam_pad: F64, t_cam_pad: F64, to_sun_pad: F64) -> tuple[U8, slice, slice] | None:
    """Return how deep each pixel is in the mast's shadow on the pad's plane, 0..255, and the part of the frame that it covers.

    A pole that tapers, a yard across the arrow at two thirds of the height, and a radar's box on top.
    """
    if to_sun_pad[2] > -0.05:
        return None
    height = mast.height_m
    along = -to_sun_pad[:2] / -to_sun_pad[2]
    side = np.array([-along[1], along[0]]) / max(1e-6, float(np.hypot(*along)))

    def cast(*ends: tuple[F64, float]) -> F64:
        return np.array([np.append(p + along * up, 0.0) for p, up in ends])

    low, high = 0.02 * height + 0.05, 0.008 * height + 0.02
    p, yard, at = np.array(mast.p_m), np.array([0.0, 0.18 * height]), 0.66 * height
    box = max(0.12, 0.05 * height)
    shapes = [
        cast((p + low * side, 0.0), (p + high * side, height), (p - high * side, height), (p - low * side, 0.0)),
        cast((p + yard, at - high), (p + yard, at + high), (p - yard, at + high), (p - yard, at - high)),
        cast(*((p + sign * box * side, height + sign * up) for sign in (1, -1) for up in (-box, box))),
    ]
    away_m = 0.6 * height / -float(to_sun_pad[2])
    return soft_shadow(lens, [shape @ R_cam_pad.T + t_cam_pad for shape in shapes], away_m, float(t_cam_pad[2]))
