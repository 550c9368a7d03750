"""Drops of water on the lens: when and where they are, and what they do to the light behind them.

A drop on the front glass is far out of focus: it shows as a soft disc with a small, blurred, upside-down picture of what lies
around it. It falls at a random place, stays, then runs off towards the tail with the airflow.
"""

import math

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from sitl.camera.settings import DropSettings

I16 = NDArray[np.int16]

_SHOWN_WIDTHS = 4.0
"""Width of the scene that a drop shows, in its own radii."""
_SPRAY_DROPS = 12
"""Drops of a gust of spray."""
_RADIUS_PX, _STAYS_S = 28.0, 6.0
"""Radius of a drop's blurred disc, and time until a drop has run off, on average; both assumed."""
_CELL_S = 1.5 * _STAYS_S
"""Span of time whose drops are drawn together."""
_RUNS_OFF = 0.7
"""Part of its life after which a drop runs off."""


class Drop(Struct, frozen=True):
    """A drop at one instant, px."""

    x: float
    y: float
    radius: float


class Drops(Struct, frozen=True):
    """The water that falls on a lens: the same at an instant whatever was computed before."""

    settings: DropSettings
    seed: int = 0

    def present(self, t_s: float, width: int, height: int) -> list[Drop]:
        """Return the drops on the lens at an instant of the flight, the oldest first."""
        newest = math.floor(t_s / _CELL_S)
        return [drop for cell in (newest - 1, newest) for drop in self._of_cell(cell, t_s, width, height)]

    def _of_cell(self, cell: int, t_s: float, width: int, height: int) -> list[Drop]:
        """Return the drops that fell in one span of time and are still there."""
        rng = np.random.default_rng([self.seed, 0xD409, cell + 1000])
        rain_per_s, spray_per_s = self.settings.rain_per_minute / 60.0, self.settings.spray_per_minute / 60.0
        single = rng.uniform(0.0, _CELL_S, rng.poisson(rain_per_s * _CELL_S))
        gusts = rng.uniform(0.0, _CELL_S, rng.poisson(spray_per_s * _CELL_S))
        fell_s = cell * _CELL_S + np.concatenate([single, np.repeat(gusts, _SPRAY_DROPS)])
        n = len(fell_s)
        x, y = rng.uniform(-0.05, 1.05, n) * width, rng.uniform(-0.05, 1.05, n) * height
        radius = _RADIUS_PX * np.exp(rng.normal(-0.08, 0.4, n))
        life_s, aside = _STAYS_S * rng.uniform(0.5, 1.5, n), rng.normal(0.0, 0.25, n)
        age = (t_s - fell_s) / life_s
        out = []
        for i in np.nonzero((age >= 0.0) & (age < 1.0))[0]:
            gone = max(0.0, float(age[i]) - _RUNS_OFF) / (1.0 - _RUNS_OFF)
            way = (height + 2.0 * radius[i]) * gone**2
            size = float(radius[i] * (1.0 - 0.35 * gone))
            out.append(Drop(float(x[i] + way * aside[i]), float(y[i] + way), size))
        return out


def wet_lens(light: I16, drops: list[Drop]) -> None:
    """Change linear light (H, W, 3) to what arrives through drops."""
    h, w = light.shape[:2]
    for drop in drops:
        reach = 1.3 * drop.radius
        x0, x1 = max(0, math.floor(drop.x - reach)), min(w, math.ceil(drop.x + reach) + 1)
        y0, y1 = max(0, math.floor(drop.y - reach)), min(h, math.ceil(drop.y + reach) + 1)
        if x1 - x0 < 3 or y1 - y0 < 3:
            continue
        half = 0.5 * _SHOWN_WIDTHS * drop.radius
        cx, cy = min(max(drop.x, 0.0), w - 1.0), min(max(drop.y, 0.0), h - 1.0)
        seen = light[max(0, int(cy - half)) : int(cy + half) + 2, max(0, int(cx - half)) : int(cx + half) + 2]
        coarse = cv2.flip(cv2.resize(seen, (12, 12), interpolation=cv2.INTER_AREA), -1)
        inside = cv2.resize(cv2.GaussianBlur(coarse, (5, 5), 1.1), (x1 - x0, y1 - y0), interpolation=cv2.INTER_CUBIC)
        across = (np.arange(x0, x1, dtype=np.float32) - np.float32(drop.x)) / np.float32(drop.radius)
        down = (np.arange(y0, y1, dtype=np.float32) - np.float32(drop.y)) / np.float32(drop.radius)
        distance = np.sqrt(across[None] ** 2 + down[:, None] ** 2)
        cover = np.clip((np.float32(1.25) - distance) / np.float32(0.55), 0.0, 1.0)
        cover = (cover * cover * (3.0 - 2.0 * cover))[..., None] * np.float32(0.92)
        # The upper rim of a drop mirrors the sky below the drone's hull, the lower one is in its own shadow.
        shade = (1.0 - 0.18 * np.clip(down, -1.0, 1.0))[:, None, None].astype(np.float32)
        part = light[y0:y1, x0:x1]
        part[:] = np.clip(part * (1.0 - cover) + np.maximum(inside, 0) * shade * cover, 0.0, 32767.0)
