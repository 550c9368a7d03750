"""Tileable noise, computed once, and its sampling over a plane."""

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from sitl.camera.projection import F32
from sitl.core.abi import DL_TILE_ONE

I16 = NDArray[np.int16]

_NONE = np.empty(0, np.float32)


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
