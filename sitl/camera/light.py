"""The light on the scene and the sensor model.

Everything between paint and frame is computed in linear light, because a lens and a sensor add up light and the tone curve
comes last.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.srgb import linear_light
from sitl.camera.projection import F32
from sitl.camera.settings import LightSettings
from sitl.core.abi import (
    DL_CELL_PX,
    DL_COUNTS_BY_EIGHT,
    DL_GAIN_ONE,
    DL_GRAIN_LEVELS,
    DL_LENS_BLOCK,
    DL_LEVELS_BY_EIGHT,
    DL_LEVELS_BY_ONE,
    DL_LIGHT_LEVELS,
    DL_PAD_PAINTS,
    DL_SCENE_ONE,
)
from sitl.core.library import SIM

U8 = NDArray[np.uint8]
I16 = NDArray[np.int16]
U16 = NDArray[np.uint16]
FULL_SCALE = 8192
"""Counts of linear light at the sensor's full scale. Light is kept in int16: steps of a thirteenth of the default read noise, and
clipped before the blur of the lens at four times full scale."""
_GRAIN_STEP = 0.25
"""Deviations from one level of noise to the next."""
_LENS_PX_MOST = 12_000
"""Parts of the frame up to so large are blurred exactly: pads from three metres on. Nearer by edges are so long, and cross pixels
in this many ways, that their aliasing averages out, and the exact blur would cost more than all else."""


class Mast(Struct, frozen=True):
    """A mast whose shadow may fall on deck."""

    height_m: float
    p_m: tuple[float, float]
    """Position of its foot in `pad`, m."""


class Light(LightSettings, frozen=True):
    """The light on the scene, and the optics between it and the sensor."""

    balanced_for_k: float = 6500.0
    """Colour temperature that the camera takes for white."""
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Gains on red, green and blue beyond that: an error of 20 % is (1.2, 1, 1) or the like."""
    vignetting: float = 0.20
    """Share of light lost in the corners of the frame."""
    glare_centre_m: tuple[float, float] = (0.12, 0.08)
    """Centre of the glare spot in `pad`."""
    wear: float = 0.06
    """Standard deviation of the paint's brightness over deck and pad; 0 for perfect paint."""

    @property
    def mast(self) -> Mast | None:
        """The mast whose shadow may fall on deck."""
        return Mast(self.mast_height_m, (self.mast_forward_m, self.mast_right_m)) if self.mast_height_m > 0 else None

    @property
    def to_sun_ned(self) -> F64:
        """Direction (3,) to the sun."""
        e, a = math.radians(self.sun_elevation_deg), math.radians(self.sun_azimuth_deg)
        return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), -math.sin(e)])

    def gains_bgr(self) -> F32:
        """Factors (3,) from paint to the sensor's full scale in blue, green, red."""
        rgb = planck_rgb(self.colour_temperature_k)
        rgb = rgb / planck_rgb(self.balanced_for_k)
        rgb = rgb / rgb[1] * np.array(self.white_balance) * 0.8 * 2.0 ** (self.exposure_ev + self.daylight_ev)
        return np.asarray(rgb[::-1], dtype=np.float32)


class Sensor(Struct, frozen=True):
    """The imager behind the lens."""

    exposure_s: float = 0.008
    psf_sigma_px: float = 0.6
    """Sigma of the Gaussian blur of the lens and the colour filter's interpolation together; the square pixel adds to it."""
    full_well_e: float = 8000.0
    """Electrons at full scale: sets the shot noise."""
    read_noise_e: float = 12.0
    readout_s: float = 0.0
    """Time from the middle of the first row's exposure to that of the last row's; 0 for a global shutter."""


def planck_rgb(kelvin: float) -> NDArray[np.float64]:
    """Return the linear sRGB (3,) of a black body, with its greatest component 1; 6500 K is white to about 1 %.

    Source: Kim et al., US patent 7024034 B2 (2006), cubic fit of the Planckian locus, 1667 to 25000 K; IEC 61966-2-1 for sRGB.
    """
    t = 1000.0 / kelvin
    if kelvin < 4000.0:
        x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    else:
        x = -3.0258469 * t**3 + 2.1070379 * t**2 + 0.2226347 * t + 0.240390
    if kelvin < 2222.0:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif kelvin < 4000.0:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    xyz = np.array([x / y, 1.0, (1.0 - x - y) / y])
    matrix = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    rgb = np.maximum(matrix @ xyz, 0.01)
    return np.asarray(rgb / rgb.max())


def srgb_values(light: NDArray[np.float64]) -> U8:
    """Return the frame's values for linear light 0..1 of full scale; light outside is clipped. Source: IEC 61966-2-1."""
    x = np.clip(light, 0.0, 1.0)
    return np.round(255.0 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)


@lru_cache(maxsize=1)
def _noise_bank() -> U8:
    """Return 4194304 levels of normal noise, always the same; a frame uses a part from a random place on."""
    bank = np.random.default_rng(0x0153).standard_normal(1 << 22, dtype=np.float32)
    levels = np.round(bank * np.float32(1.0 / _GRAIN_STEP)) + DL_GRAIN_LEVELS // 2
    return np.asarray(np.clip(levels, 0, DL_GRAIN_LEVELS - 1), dtype=np.uint8)


def _level_light() -> NDArray[np.float64]:
    """Return the light (DL_LIGHT_LEVELS,) in the middle of each level, 1 at full scale."""
    level = np.arange(DL_LIGHT_LEVELS)
    by_four = DL_LEVELS_BY_ONE + 4 * (level - DL_LEVELS_BY_ONE) + 1.5
    by_eight = DL_COUNTS_BY_EIGHT + 8 * (level - DL_LEVELS_BY_EIGHT) + 3.5
    return np.asarray(np.select([level < DL_LEVELS_BY_ONE, level < DL_LEVELS_BY_EIGHT], [level, by_four], by_eight) / FULL_SCALE)


@lru_cache(maxsize=16)
def _noisy(well: float, read_noise_e: float) -> U8 | None:
    """Return the values of the frame (DL_LIGHT_LEVELS, DL_GRAIN_LEVELS) by light and noise, or None if noise is less than a step.

    Noise is added to light transformed by g(L) = 2 F (sqrt(L / F + r^2) - r), whose slope is one over the standard deviation
    where the variance is L / F + r^2: its own deviation is one at every light. Source: Anscombe, The transformation of Poisson,
    binomial and negative-binomial data, Biometrika 35, 1948.
    """
    read = read_noise_e / well
    light = _level_light()
    deviation = np.sqrt(light / well + read**2)
    if not deviation.max() > 0.5 / FULL_SCALE:
        return None
    even = 2.0 * well * (deviation - read) if math.isfinite(well) else light / read
    # Rounding to levels adds a twelfth of a step squared to the variance (Sheppard, Proc. London Math. Soc. 29, 1897).
    step = _GRAIN_STEP / math.sqrt(1.0 + _GRAIN_STEP**2 / 12.0)
    g = even[:, None] + step * (np.arange(DL_GRAIN_LEVELS) - DL_GRAIN_LEVELS // 2)
    back = g * (g / (4.0 * well) + read) if math.isfinite(well) else g * read
    # Below the vertex of the parabola, some read noise under black, everything is black.
    return srgb_values(np.where(g < -2.0 * well * read, 0.0, back))


@lru_cache(maxsize=1)
def _clean() -> U8:
    """Return (65536,) the value of the frame by the count of light, without noise."""
    return srgb_values(np.arange(65536) / FULL_SCALE)


@lru_cache(maxsize=16)
def _taps(sigma_px: float) -> U16:
    """Return a Gaussian's weights from its middle outwards, (radius + 1,), parts of 65536; radius 0 is no blur."""
    if sigma_px < 0.05:
        return np.zeros(1, np.uint16)
    radius = math.ceil(3.0 * sigma_px)
    taps = np.round(65536.0 * cv2.getGaussianKernel(2 * radius + 1, sigma_px)[radius:, 0])
    taps[0] = min(65535.0, 65536.0 - 2.0 * taps[1:].sum())
    return np.asarray(taps, dtype=np.uint16)


REFLECTED = np.round(DL_SCENE_ONE * linear_light(np.arange(256)).astype(np.float32)).astype(np.uint16)
"""Reflected light of each paint value, (256,), parts of `DL_SCENE_ONE`."""


def scene_of(bgr: U8 | Sequence[int]) -> U16:
    """Return pixels of a scene (..., 4), without wear, for paint values (..., 3) in blue, green, red."""
    light = REFLECTED[np.asarray(bgr, dtype=np.intp)]
    return np.concatenate([light, np.full((*light.shape[:-1], 1), DL_SCENE_ONE, np.uint16)], axis=-1)


class PadInImage(Struct, frozen=True, eq=False):
    """The pad in one frame."""

    kinds: U8
    """(H, W) paint of each pixel in the order of `dl_sim_paint`, or `DL_PAD_EDGE` where there are several."""
    edges: NDArray[np.int32]
    """(N,) numbers of the pixels that edges touch, by bands of `DL_CELL_PX` rows from the top of the frame to its bottom."""
    shares: F32
    """(N, 6) coverage of these by the paints in the order of `dl_sim_paint`; each row sums to 1."""
    fine: int = 1
    """Each of these is divided into `fine` x `fine` parts."""
    parts: F32 | None = None
    """(N, 6, fine * fine) coverage of these parts, row by row; None if they are not divided."""


class PadBlur(Struct, frozen=True, eq=False):
    """Difference between the lens' blur of the pad's edges and a blur of pixels, in a part of the frame."""

    window: NDArray[np.int32]
    """(4,) first column and row of the part, and their numbers."""
    added: I16
    """(rows, 3, columns) light to add to the blurred one, in counts."""

    def under(self, gains: I16) -> PadBlur:
        """Return the same under a light that differs by factors (H, W, 3), parts of `DL_GAIN_ONE`."""
        x, y, columns, rows = self.window.tolist()
        here = gains[y : y + rows, x : x + columns].transpose(0, 2, 1) * np.float32(1.0 / DL_GAIN_ONE)
        return PadBlur(self.window, np.asarray(np.round(self.added * here), dtype=np.int16))


@lru_cache(maxsize=64)
def _lens_kernels(sigma_px: float, fine: int) -> tuple[F32, F32]:
    """Return the kernel of the lens and the square pixel on parts of pixels (fine, 2 reach + 1), and `_taps` (2, 2 reach + 1).

    The first row of the latter is for sums over parts, the second is negative.

    Parts are squares, as are the steps of the kernel: the variance of both is taken off the Gaussian's.
    """
    half = _taps(sigma_px) / 65536.0
    sampled = np.concatenate([[0.0], half[:0:-1], half, [0.0]])
    reach = len(half)
    s = math.sqrt(max(sigma_px**2 - 1.0 / (6 * fine**2), 1e-6))
    x = (np.arange((2 * reach + 1) * fine + 1) / fine - reach - 0.5) / s
    below = np.array([[0.5 * math.erfc(-(v + a) * math.sqrt(0.5)) for v in x] for a in (0.5 / s, -0.5 / s)])
    z = x + np.array([[0.5 / s], [-0.5 / s]])
    whole = z * below + np.exp(-0.5 * z**2) / math.sqrt(math.tau)
    exact = np.diff(s * (whole[0] - whole[1]))
    exact = (exact / exact.sum()).reshape(-1, fine).T
    return np.ascontiguousarray(exact, np.float32), np.stack([sampled / fine, -sampled]).astype(np.float32)


class Development:
    """The sensor model: it turns paint values into light and light into the frame, for one light and one sensor."""

    def __init__(self, light: Light, sensor: Sensor, most_bgr: F32 | None = None) -> None:
        self.sensor = sensor
        self.gains_bgr = light.gains_bgr()
        self.lifted_bgr: F32 = np.ones(3, np.float32)
        """Factors by which `exposure` holds more than the light of the sky, where lamps add to it."""
        if most_bgr is not None:
            self.lifted_bgr = np.maximum(np.minimum(most_bgr, 3.9 / np.maximum(self.gains_bgr, 1e-6)), 1e-3).astype(np.float32)
        gains = self.gains_bgr * self.lifted_bgr * np.float32(FULL_SCALE / DL_SCENE_ONE)
        self._exposure: F32 = np.append(gains, np.float32(0.0)).astype(np.float32)
        self._noisy = _noisy(sensor.full_well_e, sensor.read_noise_e)
        self._clean = _clean()
        self._taps = _taps(sensor.psf_sigma_px)
        self._room: U16 | None = None
        self._room_width = 0

    def expose(
        self, scene: U16, gain: I16, pad: PadInImage | None = None, pad_scene: U16 | None = None, room: I16 | None = None
    ) -> I16:
        """Return the light of a scene, (H, W, 3) in counts.

        Args:
            scene: (H, W, 4) what blue, green and red reflect, and the wear of the paint, parts of `DL_SCENE_ONE`.
            gain: (H, W) factors on the light, parts of `DL_GAIN_ONE`.
            pad: the pad on top of the scene, if it is in the frame.
            pad_scene: (6, 4) the pad's paints, as pixels of a scene, if there is a pad.
            room: (H, W, 3) room for the result; a new one if it is None.
        """
        h, w = gain.shape
        light = np.empty((h, w, 3), np.int16) if room is None else room
        seen, out = self._seen(scene, gain, pad, pad_scene), SIM.array("int16_t", light, 3 * h * w)
        SIM.lib.dl_sim_render_expose(seen, out)
        SIM.lib.dl_sim_render_mix(seen, out)
        return light

    def image(self, scene: U16, gain: I16, pad: PadInImage | None, pad_scene: U16 | None, rng: np.random.Generator) -> U8:
        """Return `sensor_image` of the light that `expose` returns, which is not kept."""
        h, w = gain.shape
        frame = np.empty((h, w, 3), np.uint8)
        blur = self.pad_blur(scene, gain, pad, pad_scene)
        seen, tone = self._seen(scene, gain, pad, pad_scene), self._tone(frame.size, rng)
        _hold(SIM.lib.dl_sim_render_image(seen, self._lens(w, blur), tone, SIM.array("uint8_t", frame)))
        return frame

    def pad_blur(self, scene: U16, gain: I16, pad: PadInImage | None, pad_scene: U16 | None) -> PadBlur | None:
        """Return what the exact blur of the pad's edges adds; None if they are too many, too coarse, or not blurred at all."""
        if pad is None or pad.parts is None or not len(pad.edges) or len(self._taps) == 1:
            return None
        h, w = gain.shape
        exact, sampled = _lens_kernels(self.sensor.psf_sigma_px, pad.fine)
        reach = sampled.shape[1] // 2
        rows, columns = np.divmod(pad.edges, w)
        x0, y0 = max(0, int(columns.min()) - reach), max(0, int(rows.min()) - reach)
        wide, high = min(w, int(columns.max()) + reach + 1) - x0, min(h, int(rows.max()) + reach + 1) - y0
        if wide * high > _LENS_PX_MOST:
            return None
        window, added = np.array([x0, y0, wide, high], np.int32), np.empty((high, 3, wide), np.int16)
        blocks = -(-wide // DL_LENS_BLOCK)
        places = np.empty(high * blocks * (DL_LENS_BLOCK + 1), np.int32)
        room = np.empty((pad.fine + 1) * (DL_LENS_BLOCK * blocks * (high + 1) + 2 * reach), np.float32)
        kernels = SIM.new(
            "dl_sim_lens_kernels", reach=reach, exact=exact, sampled=sampled,
            floats=room.size, numbers=places.size, room=room, places=places,
        )  # fmt: skip
        seen, where = self._seen(scene, gain, pad, pad_scene), SIM.array("int32_t", window)
        _hold(SIM.lib.dl_sim_render_pad_lens(seen, where, kernels, SIM.array("int16_t", added)))
        return PadBlur(window, added)

    def _seen(self, scene: U16, gain: I16, pad: PadInImage | None, pad_scene: U16 | None) -> Any:
        """Return the core's view of a scene.

        Raises:
            ValueError: arrays whose shapes do not meet.
        """
        h, w = gain.shape
        if scene.shape != (h, w, 4):
            raise ValueError(f"a scene of {scene.shape} under factors of {gain.shape}")
        if pad_scene is not None and pad_scene.shape != (DL_PAD_PAINTS, 4):
            raise ValueError(f"paints of {pad_scene.shape}")
        seen = SIM.new("dl_sim_lit_scene", h=h, w=w, scene=scene, gain=gain, exposure=self._exposure, pad_scene=pad_scene)
        if pad is not None:
            edges = len(pad.edges)
            if pad.kinds.shape != (h, w) or pad.shares.shape != (edges, DL_PAD_PAINTS):
                raise ValueError(f"a pad of {pad.kinds.shape}, shares {pad.shares.shape}, in a frame of {(h, w)}")
            SIM.fill(seen, edges=edges, fine=pad.fine, kinds=pad.kinds, where=pad.edges, shares=pad.shares, parts=pad.parts)
        return seen

    def blur(self, light: I16, pad: PadBlur | None = None) -> I16:
        """Return the light (H, W, 3) after the blur of the lens."""
        h, w = light.shape[:2]
        blurred = np.empty_like(light)
        _hold(SIM.lib.dl_sim_render_blur(h, w, SIM.array("int16_t", light), self._lens(w, pad), SIM.array("int16_t", blurred)))
        return blurred

    def sensor_image(self, light: I16, rng: np.random.Generator, pad: PadBlur | None = None) -> U8:
        """Return the frame of eight bits: blur the light (H, W, 3), add shot and read noise and apply the tone curve.

        One number is drawn from `rng`.
        """
        h, w = light.shape[:2]
        frame = np.empty((h, w, 3), np.uint8)
        lens, tone = self._lens(w, pad), self._tone(frame.size, rng)
        _hold(SIM.lib.dl_sim_render_frame(h, w, SIM.array("int16_t", light), lens, tone, SIM.array("uint8_t", frame)))
        return frame

    def _tone(self, size: int, rng: np.random.Generator) -> Any:
        """Return the core's view of the sensor for a frame of this many values: noise, and tone curve."""
        if self._noisy is None:
            return SIM.new("dl_sim_sensor_tone", codes=self._clean)
        bank = _noise_bank()
        start = int(rng.integers(bank.size - size))
        return SIM.new("dl_sim_sensor_tone", noise=bank[start : start + size], codes=self._noisy)

    def _lens(self, width: int, pad: PadBlur | None) -> Any:
        """Return the core's view of the lens: weights of the blur, what the pad's edges add, and room for rows."""
        radius, values = len(self._taps) - 1, 3 * width
        if self._room is None or self._room_width != width:
            self._room = np.zeros((2 * radius + 4 + DL_CELL_PX) * values + 6 * radius + 1, np.uint16)
            self._room_width = width
        lens = SIM.new("dl_sim_lens_blur", radius=radius, numbers=self._room.size, taps=self._taps, scratch=self._room)
        if pad is not None:
            SIM.fill(lens, window=pad.window, added=pad.added)
        return lens


def _hold(has_room: bool) -> None:
    """Raise if the core had no room for its work."""
    if not has_room:
        raise ValueError("the core has no room for a frame of this size")


def counts(light: F32) -> I16:
    """Return light of 1 at full scale in counts, clipped to what is kept."""
    return np.asarray(np.round(np.clip(light * np.float32(FULL_SCALE), 0.0, 32767.0)), dtype=np.int16)
