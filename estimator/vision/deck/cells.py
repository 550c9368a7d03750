"""The cells of a pad's surface: the paint of each as the drawing knows it, and the markings that show in them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.abi import DL_TEMPLATE_ONE
from estimator.vision.detect.template import F32, STEP_M, template
from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import linear_light

ACROSS = 48
"""Cells across the disc: 1.6 cm on a pad of 78 cm."""
PAINTS = 3
"""Paints that are compared: lettering, ring and arrowhead, and disc, in the order of `template`."""
_PURE = 0.9  # Least coverage of a cell by one paint at which the drawing knows it, blurred as the frame is
_LEAK = 0.03  # The most light of other paints in such a cell, as a share of its own
_MARK = 0.35  # Least coverage of a cell by a marking that shows in it
_OTHER = 0.05  # Most coverage of such a cell by another marking
_GROUND = 0.9  # Least coverage of a cell of the ground by the ground's paint
_HIDDEN_WHOLLY = 0.25  # Contrast of a whole marking, in parts of that of the drawing, below which it is hidden altogether

_DECK_LIGHT = np.full(3, 0.3)  # Light of the deck about the pad, 1 for white


@lru_cache(maxsize=8)
def cells_of(pad: Pad) -> tuple[F64, NDArray[np.int64]]:
    """Return the cells' centres within the disc, (cells, 3) m, and their numbers in the square of `ACROSS` by `ACROSS`."""
    step = 2.0 * pad.disc_radius_m / ACROSS
    side = (np.arange(ACROSS) + 0.5) * step - pad.disc_radius_m
    x, y = np.meshgrid(side, side, indexing="ij")
    inside = np.flatnonzero(np.hypot(x, y).ravel() < pad.disc_radius_m)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)[inside], inside


@lru_cache(maxsize=16)
def shares_of(pad: Pad, blur: int) -> F32:
    """Return the coverage of each cell by each paint, (cells, 4), at one of `BLURS_M`."""
    maps = template(pad).coverage[blur]
    at = np.rint(cells_of(pad)[0] / STEP_M).astype(int) + len(maps) // 2
    return np.asarray(maps[at[:, 0], at[:, 1]], np.float32) / np.float32(DL_TEMPLATE_ONE)


def nominal_light(pad: Pad) -> F64:
    """Return the light of the compared paints in the drawing, (3, 3) in blue, green, red."""
    colours = pad.markings.colours
    return np.array([linear_light(rgb)[::-1] for rgb in (colours.h, colours.ring, colours.disc)])


@lru_cache(maxsize=16)
def known_paints(pad: Pad, blur: int) -> NDArray[np.int8]:
    """Return the paint of each cell, (cells,), at one of `BLURS_M`; -1 where the drawing does not know it."""
    share = shares_of(pad, blur)
    light = np.linalg.norm([*nominal_light(pad), _DECK_LIGHT], axis=1)
    own = share[:, :PAINTS].argmax(axis=1)
    most = share[np.arange(len(own)), own]
    leak = share @ light - most * light[own]
    return np.where((most >= _PURE) & (leak <= _LEAK * light[own]), own, -1).astype(np.int8)


@dataclass(frozen=True, slots=True, eq=False)
class Marking:
    """Cells in which a marking shows, beside no other one."""

    at: NDArray[np.intp]
    own: F32
    """The marking's coverage of them."""
    way: F32
    """Direction of its light from that of the ground, (3,)."""
    least: float
    """Contrast below which it is hidden altogether, in parts of the ground's light."""


@lru_cache(maxsize=16)
def markings_in(pad: Pad, blur: int) -> tuple[NDArray[np.intp], F32, tuple[Marking, ...]]:
    """Return the cells of the markings' ground, the direction of its light, and the markings, at one of `BLURS_M`."""
    share, nominal = shares_of(pad, blur), nominal_light(pad)
    bright, out = float(np.linalg.norm(nominal[2])), []
    for one in range(PAINTS - 1):
        way = nominal[one] - nominal[2]
        size = float(np.linalg.norm(way))
        at = np.flatnonzero((share[:, one] >= _MARK) & (share[:, 1 - one] <= _OTHER) & (share[:, 3] <= _OTHER))
        if size >= 0.1 * bright:
            out.append(Marking(at, share[at, one], (way / size).astype(np.float32), _HIDDEN_WHOLLY * size / bright))
    return np.flatnonzero(share[:, 2] >= _GROUND), (nominal[2] / bright).astype(np.float32), tuple(out)
