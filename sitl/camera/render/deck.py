"""Render the deck: its drawing, edges and side, decals, the drone's shadow, wear and puddles.

The ship beside her deck shows her sides, her shadow on the water and her wake.
"""

import math
from functools import lru_cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from sitl.camera.light import I16, REFLECTED, U16, Light, scene_of
from sitl.camera.projection import F32, SHIFT, Lens, fixed_point
from sitl.camera.surroundings import Deck, draw_deck
from sitl.core.abi import DL_SCENE_ONE, DL_TILE_ONE
from sitl.core.library import SIM

_NONE = np.empty(0, np.float32)
_NEAR_M = 1.2  # half side of the drawing for pictures from near by
_NEAR_PPM = 500.0  # its resolution, pixels a metre


class Tile:
    """A square periodic texture with smaller versions of it for greater distances."""

    def __init__(self, texels: F32, side_m: float) -> None:
        self.side_m = side_m
        self._levels: list[F32] = []
        self._layers: dict[int, I16] = {}
        level = texels
        while level.shape[0] >= 8:
            self._levels.append(np.pad(level, ((0, 1), (0, 1)), mode="wrap"))
            n = level.shape[0] // 2
            level = level.reshape(n, 2, n, 2).mean(axis=(1, 3))

    def level(self, footprint_m: float, stretch: float = 1.0) -> F32:
        """Return the texels, (n + 1, n + 1) with the first row and column repeated, that are of about the size of a pixel.

        Args:
            footprint_m: size of a pixel on the plane.
            stretch: factor on the length of the tile's side.
        """
        return self._levels[self._number(footprint_m, stretch)]

    def _number(self, footprint_m: float, stretch: float) -> int:
        finest = self.side_m * stretch / (self._levels[0].shape[0] - 1)
        return min(len(self._levels) - 1, max(0, round(math.log2(max(footprint_m / finest, 1e-3)))))

    def layer(self, footprint_m: float, stretch: float, shift_m: tuple[float, float]) -> tuple[I16, tuple[float, float, float]]:
        """Return `level` in parts of `DL_TILE_ONE`, for the core, and what turns positions on the plane into periods of the tile.

        Returns:
            The texels, (n + 1, n + 1); then periods a metre, and the shift.
        """
        number, side_m = self._number(footprint_m, stretch), self.side_m * stretch
        if number not in self._layers:
            rounded = np.clip(np.round(DL_TILE_ONE * self._levels[number]), -32767, 32767)
            self._layers[number] = rounded.astype(np.int16)
        return self._layers[number], (1.0 / side_m, shift_m[0] / side_m, shift_m[1] / side_m)

    def read(self, where_m: F32, footprint_m: float, stretch: float = 1.0, shift_m: tuple[float, float] = (0.0, 0.0)) -> F32:
        """Return the texture's values, (H, W), at positions (H, W, 2) m on the plane.

        Args:
            where_m: positions on the plane, m.
            footprint_m: size of a pixel on the plane; texels are averaged to about that size.
            stretch: factor on the length of the tile's side.
            shift_m: offset added to the positions, m.
        """
        side_m, level = self.side_m * stretch, self.level(footprint_m, stretch)
        n = level.shape[0] - 1
        t = where_m * np.float32(1.0 / side_m)
        # As complex numbers: numpy adds a pair to each of many pairs ten times slower.
        t.view(np.complex64)[...] += np.complex64(complex(*shift_m) / side_m)
        t -= np.floor(t)
        t *= np.float32(n)
        return np.asarray(cv2.remap(level, t, _NONE, cv2.INTER_LINEAR), dtype=np.float32)


def _periodic_noise(seed: int, n: int, spectrum: F32) -> F32:
    """Return (n, n) Gaussian noise of mean 0, standard deviation 1 and the given amplitude spectrum."""
    white = np.random.default_rng(seed).standard_normal((n, n))
    # Of a real field half of the wave numbers say all; each stands for its opposite as well.
    half, opposite = (side.astype(float)[:, : n // 2 + 1] for side in (spectrum, np.roll(spectrum[::-1, ::-1], 1, (0, 1))))
    field = np.fft.irfft2(np.fft.rfft2(white) * (0.5 * (half + opposite)), (n, n))
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


def _wave_numbers(n: int) -> tuple[F32, F32]:
    f = (np.fft.fftfreq(n) * n).astype(np.float32)
    return np.meshgrid(f, f)


@lru_cache(maxsize=4)
def ripples(seed: int) -> Tile:
    """Return small wind waves along the tile's diagonal: mean 0, about -4 to 2, side 7 m."""
    n = 512
    fx, fy = _wave_numbers(n)
    f = np.hypot(fx, fy)
    along = np.cos(np.arctan2(fy, fx) - 0.8) ** 2
    band = np.exp(-((np.log(np.maximum(f, 1e-3) / 13.0) / 0.85) ** 2))
    a = _periodic_noise(seed, n, np.asarray(band * (0.25 + along), dtype=np.float32))
    b = _periodic_noise(seed + 1, n, np.asarray(np.exp(-((np.log(np.maximum(f, 1e-3) / 55.0) / 0.6) ** 2)), dtype=np.float32))
    ridge = 1.0 - np.abs(a) * 0.9
    field = 0.55 * a + 0.5 * ridge + 0.22 * b * (0.6 + 0.4 * np.clip(a, -1, 2))
    return Tile(np.asarray(field - field.mean(), dtype=np.float32), 7.0)


@lru_cache(maxsize=4)
def foam(seed: int) -> Tile:
    """Return streaky patches of foam: mean 0, standard deviation about 1.1, side 19 m."""
    n = 512
    fx, fy = _wave_numbers(n)
    f = np.maximum(np.hypot(fx * 1.8, fy), 0.5)
    patches = _periodic_noise(seed + 2, n, np.asarray(f**-1.3 * (f > 2.0), dtype=np.float32))
    bubbles = _periodic_noise(seed + 3, n, np.asarray(f**-0.6, dtype=np.float32))
    return Tile(np.asarray(patches + 0.45 * bubbles, dtype=np.float32), 19.0)


@lru_cache(maxsize=4)
def grain(seed: int) -> Tile:
    """Return scuffs and grit on paint: mean 0, standard deviation 1, side 2.3 m."""
    n = 1024
    fx, fy = _wave_numbers(n)
    f = np.maximum(np.hypot(fx, fy), 1.0)
    return Tile(_periodic_noise(seed + 4, n, np.asarray(f**-0.75 * (f > 1.5), dtype=np.float32)), 2.3)


U8 = NDArray[np.uint8]


class WornDrawing(Struct, frozen=True, eq=False):
    """A deck's drawing with the wear of its paint as fourth channel, in several resolutions."""

    levels: tuple[tuple[U16, F64], ...]
    """Drawings as pixels of a scene, and the homographies from the deck's axes to texels. The first covers the pad's
    surroundings, the others all of the deck, each one coarser than the one before."""
    texels_per_m: float
    """Resolution of the second level; each one after it has half of that of the one before."""


@lru_cache(maxsize=4)
def worn(deck: Deck, wear: float) -> WornDrawing:
    """Return the drawing of a deck whose paint's brightness has the standard deviation `wear`."""
    drawing = draw_deck(deck)
    whole = _with_wear(drawing.paint, drawing.corner_m, drawing.texels_per_m, deck.seed, wear)
    levels = [whole]
    while min(levels[-1].shape[:2]) >= 32:
        levels.append(np.asarray(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint16))
    (x0, y0), ppm = drawing.corner_m, drawing.texels_per_m
    placed = []
    for level in levels:
        per_x, per_y = (level.shape[i] / whole.shape[i] * ppm for i in (0, 1))
        placed.append((level, np.array([[0.0, per_y, -per_y * y0 - 0.5], [per_x, 0.0, -per_x * x0 - 0.5], [0.0, 0.0, 1.0]])))
    side = round(2 * _NEAR_M * _NEAR_PPM)
    near_from_deck = np.array([[0.0, 1.0, _NEAR_M], [1.0, 0.0, _NEAR_M], [0.0, 0.0, 1.0 / _NEAR_PPM]]) * _NEAR_PPM
    near_from_deck[:2, 2] -= 0.5
    whole_from_near = (placed[0][1] @ np.linalg.inv(near_from_deck))[:2]
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    paint = cv2.warpAffine(drawing.paint, whole_from_near, (side, side), flags=flags, borderMode=cv2.BORDER_REFLECT)
    near = _with_wear(np.asarray(paint, dtype=np.uint8), (-_NEAR_M, -_NEAR_M), _NEAR_PPM, deck.seed, wear)
    return WornDrawing(((near, near_from_deck), *placed), ppm)


def _with_wear(paint: U8, corner_m: tuple[float, float], texels_per_m: float, seed: int, wear: float) -> U16:
    """Return a drawing as pixels of a scene: paint wears in patches of two texels or more."""
    h, w = paint.shape[:2]
    rows, cols = (h + 1) // 2, (w + 1) // 2
    step = 2.0 / texels_per_m
    y, x = np.meshgrid(corner_m[1] + (np.arange(cols) + 0.5) * step, corner_m[0] + (np.arange(rows) + 0.5) * step)
    gain = 1.0 + wear * grain(seed).read(np.stack([x, y], axis=-1).astype(np.float32), step)
    each = cv2.resize(np.clip(gain, 0.05, 64000.0 / DL_SCENE_ONE).astype(np.float32), (2 * cols, 2 * rows))[:h, :w]
    light = [np.round(channel * each).astype(np.uint16) for channel in (*cv2.split(cv2.LUT(paint, REFLECTED)), DL_SCENE_ONE)]
    return np.asarray(cv2.merge(light), np.uint16)


class DeckPainter:
    """Renders a deck through one lens."""

    def __init__(self, lens: Lens, deck: Deck, light: Light) -> None:
        self._lens, self._deck, self._light = lens, deck, light
        self._drawing = worn(deck, light.wear)
        self._grain = grain(deck.seed)
        outline = deck.outline()
        self._rim = np.concatenate([outline, np.zeros((len(outline), 1))], axis=1)
        self._side = np.roll(outline, -1, axis=0) - outline
        self._border = np.c_[lens.border_rays, np.ones(len(lens.border_rays))]
        self._corners = np.c_[lens.corner_rays, np.ones(4)]
        # The distance of a point of the deck from each of its sides, times the side's length.
        corner, (along, across) = outline, self._side.T
        self._inwards = np.stack([-across, along, across * corner[:, 0] - along * corner[:, 1]])
        c, s = math.cos(deck.pad_yaw_rad), math.sin(deck.pad_yaw_rad)
        self._R_deck_pad = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.rim_pad: F64 = self._rim @ self._R_deck_pad
        """Outline of the deck, (N, 3) m in `pad`."""
        self._mask = np.empty((lens.camera.height, lens.camera.width), np.uint8)

    def fills(self, pad_from_ray: F64) -> bool:
        """Return whether the deck certainly covers all of the frame; near its edges the answer may be False even so."""
        q = self._border.dot(self._R_deck_pad.dot(pad_from_ray).T)
        return bool(q[:, 2].min() > 0 and q.dot(self._inwards).min() > 0)

    def mask(self, R_cam_pad: F64, t_cam_pad: F64) -> U8:
        """Return the deck's coverage of each pixel, (H, W) 0..255, until the next one. OpenCV's drawing antialiases edges."""
        out = self._mask
        out.fill(0)
        uv = self._lens.outline(self.rim_pad.dot(R_cam_pad.T) + t_cam_pad, 12)
        if len(uv):
            cv2.fillPoly(out, [fixed_point(uv)], 255, cv2.LINE_AA, SHIFT)
        return out

    def paint(self, scene: U16, part: tuple[slice, slice], pad_from_ray: F64, footprint_m: float, mask: U8 | None = None) -> None:
        """Put the deck on a scene (H, W, 4) where the rays of a part of the frame meet it.

        Args:
            scene: what lies around the deck.
            part: rows and columns.
            pad_from_ray: homography from rays to `pad`.
            footprint_m: size of a pixel on the deck.
            mask: coverage of each pixel by the deck, (H, W) 0..255; None where it covers all.
        """
        drawing = self._drawing
        deck_from_ray = self._R_deck_pad.dot(pad_from_ray)
        # A texel of up to 1.7 pixels: finer ones cost more memory traffic than they show.
        whole = max(0, round(math.log2(max(footprint_m * drawing.texels_per_m, 1e-3)) + 0.25))
        level = 1 + min(len(drawing.levels) - 2, whole)
        if whole == 0 and footprint_m * _NEAR_PPM < 0.75 and self._near(deck_from_ray):
            level = 0
        image, texel_from_deck = drawing.levels[level]
        cells = self._lens.cells(texel_from_deck.dot(deck_from_ray))
        rows, columns = part
        h, w = scene.shape[:2]
        place = SIM.new("dl_sim_frame_part", w=w, x0=columns.start, x1=columns.stop, y0=rows.start, y1=rows.stop)
        where = SIM.new("dl_sim_plane_cells", at=cells, columns=cells.shape[1])
        drawn = SIM.new("dl_sim_drawing", texels=image, h=image.shape[0], w=image.shape[1])
        covered = SIM.ffi.NULL if mask is None else SIM.array("uint8_t", mask, h * w)
        SIM.lib.dl_sim_render_deck(place, where, drawn, covered, SIM.array("uint16_t", scene, 4 * h * w))

    def _near(self, deck_from_ray: F64) -> bool:
        """Return whether all of the frame shows the pad's surroundings."""
        q = (self._corners @ deck_from_ray.T).tolist()
        return all(z > 0 and max(abs(x), abs(y)) < _NEAR_M * z for x, y, z in q)

    def wet(self, part: tuple[slice, slice], pad_from_ray: F64, footprint_m: float) -> tuple[F32, F32] | None:
        """Return the factors of a wet deck on its light, and the sky's light that its puddles mirror, (h, w) each.

        Returns:
            None on a dry deck.
        """
        wetness = self._light.wetness
        if wetness == 0:
            return None
        places = self._lens.meet(self._R_deck_pad @ pad_from_ray, part)
        h, w = places.shape[:2]
        coarse: F32 = np.asarray(cv2.resize(places, (max(1, w // 2), max(1, h // 2))), dtype=np.float32)
        puddle = self._grain.read(coarse, max(2.0 * footprint_m, 0.12), 3.1)
        puddle = np.clip((puddle + np.float32(1.8 * wetness - 1.3)) * np.float32(1.8), 0.0, 1.0)
        puddle = np.asarray(cv2.resize(puddle, (w, h)), dtype=np.float32)
        gain = np.float32(1.0 - 0.25 * wetness) - np.float32(0.2 * wetness) * puddle
        return gain, np.float32(0.08 * wetness) * puddle


Part = tuple[slice, slice]
"""Rows and columns of a frame."""


def bounds(mask: U8) -> tuple[Part, Part]:
    """Return the part of the frame that a mask (H, W) covers, in part at least, and the part around what it covers altogether.

    A part without pixels ends at zero.
    """
    found = np.empty((2, 4), np.int32)
    SIM.lib.dl_sim_render_bounds(*mask.shape, SIM.array("uint8_t", mask), *(SIM.array("int32_t", each) for each in found))
    covered, around = ((slice(y0, y1), slice(x0, x1)) for x0, x1, y0, y1 in found.tolist())
    return covered, around


_DRONE = {"rotor_at_m": 0.14, "rotor_radius_m": 0.115, "half_length_m": 0.20, "half_width_m": 0.05}
"""The drone's shape."""


def drone_shadow(
    gain: I16,
    lens: Lens,
    pad_from_ray: F64,
    cam_from_pad: tuple[F64, F64],
    pad_from_body: tuple[F64, F64],
    to_sun_pad: F64,
    share: float,
    mask: U8 | None,
) -> Part | None:
    """Take the drone's shadow off factors (H, W) on the light; return the part of the frame that it can darken.

    The shadow is that of a quadcopter half a metre wide, with four rotors inside guards and a slim hull, cast along the sun onto
    the pad's plane. The width of the sun softens its edge.

    Args:
        cam_from_pad: rotation (3, 3) of the pad and its centre (3,) m in `cam`.
        pad_from_body: the same of the body in `pad`.
        share: of the light, that is missing in the full shadow.
        mask: how much of each pixel, (H, W) 0..255, can be in shadow; None for all.
    """
    R_pad_body, p_body_pad = pad_from_body
    if to_sun_pad[2] > -0.05 or p_body_pad[2] > -0.01:
        return None
    # A point of the body's plane falls onto the pad's plane along the sun.
    slant = to_sun_pad[:2] / to_sun_pad[2]
    (a, b), (c, d) = (R_pad_body[:2, :2] - slant[:, None] * R_pad_body[2, :2]).tolist()
    u, v = (p_body_pad[:2] - slant * p_body_pad[2]).tolist()
    det = a * d - b * c
    if abs(det) < 1e-3:
        return None
    body_from_pad = np.array([[d, -b, b * v - d * u], [-c, a, c * u - a * v], [0.0, 0.0, det]]) / det
    depth_m = max(0.05, float(cam_from_pad[1][2]))
    sigma_px = _penumbra_px(lens, float(p_body_pad[2] / to_sun_pad[2]), depth_m)
    # Limited, for far from the shadow sums of very large and small numbers would be wrong.
    cells = lens.cells(body_from_pad.dot(pad_from_ray), 8.0)
    # A smooth step has the deviation of a Gaussian edge if it is so much wider.
    soft_m = math.sqrt(20.0) * sigma_px * depth_m / lens.camera.fx
    part, shade = np.empty(4, np.int32), SIM.new("dl_sim_drone_shade", **_DRONE, soft_m=soft_m, share=share)
    covered = SIM.ffi.NULL if mask is None else SIM.array("uint8_t", mask, gain.size)
    where = SIM.new("dl_sim_plane_cells", at=cells, columns=cells.shape[1])
    SIM.lib.dl_sim_render_shadow(*gain.shape, where, shade, covered, SIM.array("int16_t", gain), SIM.array("int32_t", part))
    x0, x1, y0, y1 = part.tolist()
    return slice(y0, y1), slice(x0, x1)


def _penumbra_px(lens: Lens, away_m: float, depth_m: float) -> float:
    """Return the standard deviation of a shadow's edge, for what casts it so far away, at a distance from the camera.

    The sun's disc is half a degree wide: the penumbra is 0.0093 of the distance wide, its standard deviation a quarter of that.
    """
    return min(6.0, max(0.7, 0.0023 * away_m * lens.camera.fx / max(0.05, depth_m)))


def _part_of(lens: Lens, outlines: list[F64], sigma_px: float) -> tuple[slice, slice] | None:
    """Return the rows and columns of the frame that blurred outlines (N, 2) px touch, or None if there are too few."""
    outlines = [uv for uv in outlines if len(uv)]
    if not outlines:
        return None
    everything = np.concatenate(outlines)
    margin = 3 * sigma_px + 2
    low, high = everything.min(axis=0) - margin, everything.max(axis=0) + margin
    x0, y0 = max(0, math.floor(low[0])), max(0, math.floor(low[1]))
    x1, y1 = min(lens.camera.width, math.ceil(high[0])), min(lens.camera.height, math.ceil(high[1]))
    return None if x1 - x0 < 2 or y1 - y0 < 2 else (slice(y0, y1), slice(x0, x1))


def soft_shadow(lens: Lens, polygons_cam: list[F64], away_m: float, depth_m: float) -> tuple[U8, slice, slice] | None:
    """Return how deep each pixel is in a shadow, 0..255, and the part of the frame that it covers, or None outside the frame.

    Args:
        polygons_cam: outlines (N, 3) m of the full shadow.
        away_m: distance of what casts it, along the sun.
        depth_m: distance of the shadow from the camera, along the axis.
    """
    polygons = [uv for uv in map(lens.outline, polygons_cam) if len(uv)]
    sigma = _penumbra_px(lens, away_m, depth_m)
    part = _part_of(lens, polygons, sigma)
    if part is None:
        return None
    (y0, y1), (x0, x1) = ((side.start, side.stop) for side in part)
    # A blurred shape needs no more resolution than its blur.
    coarser = 4 if sigma >= 2.4 else 2 if sigma >= 0.9 else 1
    size = (max(2, (x1 - x0) // coarser), max(2, (y1 - y0) // coarser))
    scale = np.array([size[0] / (x1 - x0), size[1] / (y1 - y0)])
    canvas = np.zeros(size[::-1], np.uint8)
    for uv in polygons:
        line = cv2.LINE_AA if coarser > 1 else cv2.LINE_8
        cv2.fillPoly(canvas, [fixed_point((uv - (x0, y0) + 0.5) * scale - 0.5)], 255, line, SHIFT)
    width = 2 * math.ceil(2.5 * sigma / coarser) + 1
    soft = cv2.GaussianBlur(canvas, (width, width), sigma / coarser)
    return np.asarray(cv2.resize(soft, (x1 - x0, y1 - y0)), np.uint8), *part


def draw(scene: U16, lens: Lens, points_cam: F64, colour: U16) -> None:
    """Fill a polygon (N, 3) m in `cam` on a scene (H, W, 4), antialiased by OpenCV's drawing."""
    uv = lens.outline(points_cam, 6)
    if len(uv) < 3:
        return
    h, w = scene.shape[:2]
    x0, y0 = (int(np.clip(math.floor(low) - 1, 0, most)) for low, most in zip(uv.min(axis=0), (w, h), strict=True))
    x1, y1 = (int(np.clip(math.ceil(high) + 2, 0, most)) for high, most in zip(uv.max(axis=0), (w, h), strict=True))
    if x1 <= x0 or y1 <= y0:
        return
    mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
    cv2.fillPoly(mask, [fixed_point(uv - (x0, y0))], 255, cv2.LINE_AA, SHIFT)
    place = SIM.new("dl_sim_frame_part", w=w, x0=x0, x1=x1, y0=y0, y1=y1)
    SIM.lib.dl_sim_render_fill(place, SIM.array("uint8_t", mask), SIM.array("uint16_t", colour, 4), SIM.array("uint16_t", scene))


_SIDE = (74, 58, 46)
"""Paint of the hull's sides, BGR."""


def on_water(deck: Deck, rim_ned: F64, R_ned_pad: F64, to_sun: F64, wake_speed_m_s: float) -> list[F64]:
    """Return the outlines on calm water, (N, 2) m to north and east: the hull, its shadow, and the wake of a ship under way."""
    line = rim_ned[:, :2]
    cast = line - to_sun[:2] * (np.minimum(rim_ned[:, 2:], 0.0) / to_sun[2])
    hull = cv2.convexHull(np.concatenate([line, cast]).astype(np.float32))[:, 0].astype(float)
    out = [line, hull]
    speed = wake_speed_m_s
    if speed > 0.2:
        yaw = deck.pad_yaw_rad
        ahead = R_ned_pad.dot(np.array([math.cos(yaw), -math.sin(yaw), 0.0]))[:2]
        ahead = ahead / max(1e-6, math.hypot(*ahead.tolist()))
        side = np.array([-ahead[1], ahead[0]])
        stern = (line[0] + line[-1]) / 2.0
        long, half = 3.0 * speed + 2.0 * deck.length_m, deck.width_m / 2
        end = stern - long * ahead
        out.append(
            np.array([stern - 0.8 * half * side, stern + 0.8 * half * side, end + 1.9 * half * side, end - 1.9 * half * side])
        )
    return out


def hull_side(scene: U16, lens: Lens, rim_ned: F64, R_ned_cam: F64, p_cam_ned: F64) -> None:
    """Paint the sides of the hull between the deck's rim, (N, 3) m, and the waterline below it, where the camera sees them."""
    x, y = (rim_ned - p_cam_ned)[:, :2].T
    along_x, along_y = np.concatenate([x[1:], x[:1]]) - x, np.concatenate([y[1:], y[:1]]) - y
    # The camera is outside of a side that runs clockwise around it; a rim below the water shows the other face.
    outside = (x * along_y - y * along_x) * rim_ned[:, 2] > 0
    if not outside.any():
        return
    for i in np.nonzero(outside)[0]:
        quad = rim_ned[[i, (i + 1) % len(rim_ned), (i + 1) % len(rim_ned), i]]
        quad[2:, 2] = 0.0
        draw(scene, lens, (quad - p_cam_ned) @ R_ned_cam, scene_of(_SIDE))
