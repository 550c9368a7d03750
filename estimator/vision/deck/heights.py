"""The place and the height of corners on a deck, by least squares over the readings of a way down.

A corner z above the deck is seen at q = p + (q - c) z / h for a camera at height h over the place c. It is linear in its place p
and in z, so that weighted sums of its readings are enough. The drone's own shadow is seen at q = c + r + s h: it keeps its size,
r, while its middle, s h, comes nearer.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.deck.clear_deck import median

STANDS_REACH_M = 0.8
"""Distance beyond the disc within which what stands out counts: a rotor and a margin."""
CLUSTER_M = 0.5
"""Distance within which corners are of one thing."""
_SIGMA_PX = 0.3  # Standard deviation of a corner's place on the deck, in the frame's pixels
_SIGMA_M = 0.004  # The same, fixed
_SIGMA_AWAY = 0.003  # The same, in parts of the corner's distance from the pad
_READS = 4  # Least number of readings of a corner
_READS_STANDS = 3  # Least number of readings of one that stands high
_STANDS_M = 0.15  # Least height of what stands out
_STANDS_SIGMAS = 6.0  # The same, in standard deviations
_FLAT_LEAST = 12  # Least number of corners that say what a standard deviation is worth
_FLAT_LOWEST = 0.4  # Least of what it may be worth
_FLAT_HIGHEST = 1.0  # Most of what it may be worth, and what it is with fewer corners
_MAD = 1.4826  # Standard deviation of a normal distribution over its median absolute deviation
_BELOW = 0.8  # Largest height of what stands, in parts of the camera's
_STAYS = 4.0  # Largest mean square that is left of a corner that stands, in variances
_STAYS_PART = 0.3  # What may be left besides of a high one, in parts of what the height explains
_STAYS_M = 0.06  # The most of that
_MOVES_M = 0.12  # Least deviation from the best place and height that is a motion
_MOVES_TIMES = 6.0  # The same, in standard deviations
_OWN = 1.0  # Part that the drone's own shadow leaves of a corner's deviation where it is that
_OWN_M = 0.4  # Largest distance of a part of that shadow from its middle
_OWN_SIGMA_M = 0.3  # Standard deviation that is assumed of that
_HEIGHT_LEAST_M = 0.05  # Least height of the camera that a reading is divided by

SUMS = np.dtype(
    [
        ("weight", "f8"), ("q", "f8", 2), ("a", "f8", 2), ("aq", "f8"), ("aa", "f8"), ("qq", "f8"), ("h_off", "f8", 2),
        ("hh", "f8"), ("off_off", "f8"), ("h", "f8"), ("off", "f8", 2), ("readings", "f8"),
    ]
)  # fmt: skip
"""Weighted sums of a corner's readings: q where it is seen on the deck, off = q - c, a = off / h, and the number of readings."""
COLUMNS = SUMS.itemsize // 8
"""Numbers of one corner's sums."""


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """The best place and height of each corner, and what it is."""

    place: F64
    """(N, 2) m."""
    z: F64
    """(N,) m."""
    stays: NDArray[np.bool_]
    """Its place and height explain it."""
    stands: NDArray[np.bool_]
    moves: NDArray[np.bool_]
    flat: float
    """Spread of most about the deck, in standard deviations."""


def reading_of(q: F64, below: F64, height_m: float, px_m: float) -> F64:
    """Return the sums, (N, COLUMNS), of one reading of corners that are seen at places on the deck, (N, 2) m.

    Args:
        below: place of the camera over the deck, (2,) m.
        height_m: its height.
        px_m: size of the frame's pixels on the deck.
    """
    sigma = np.sqrt((_SIGMA_PX * px_m) ** 2 + _SIGMA_M**2 + (_SIGMA_AWAY * np.hypot(*q.T)) ** 2)
    off = q - below
    a = off / max(height_m, _HEIGHT_LEAST_M)
    out = np.ones(len(q), SUMS)
    out["h"], out["hh"] = height_m, height_m**2
    out["q"], out["a"], out["off"], out["h_off"] = q, a, off, height_m * off
    for name, of, by in (("aq", a, q), ("aa", a, a), ("qq", q, q), ("off_off", off, off)):
        out[name] = (of * by).sum(axis=1)
    sums = out.view(float).reshape(-1, COLUMNS)
    sums *= (1.0 / np.maximum(sigma, 1e-6) ** 2)[:, None]
    out["readings"] = 1.0
    return sums


def heights_of(sums: F64, disc_radius_m: float) -> Heights:
    """Return the best place and height of corners by their sums, (N, COLUMNS), and what they are."""
    of = np.ascontiguousarray(sums).view(SUMS)[:, 0]
    w, reads = of["weight"], of["readings"]
    mean_q, mean_a = of["q"] / w[:, None], of["a"] / w[:, None]
    aa = np.maximum(1e-9, of["aa"] - w * np.square(mean_a).sum(axis=1))
    aq = of["aq"] - w * (mean_a * mean_q).sum(axis=1)
    qq = np.maximum(0.0, of["qq"] - w * np.square(mean_q).sum(axis=1))
    z = aq / aa
    left = np.maximum(0.0, qq - aq * aq / aa)
    own, camera_m = _left_by_own(of), np.sqrt(of["hh"] / w)
    often = (reads >= _READS) & (own > _OWN * left)
    place = mean_q - z[:, None] * mean_a
    freedom = np.maximum(1.0, 2.0 * reads - 3.0)
    # Most corners lie flat: how far their heights are off says what a standard deviation is worth in this approach.
    sure, flat = np.sqrt(aa), _FLAT_HIGHEST
    if np.count_nonzero(often) >= _FLAT_LEAST:
        flat = float(_MAD * median(np.abs(z * sure)[often]))
    # What is high turns and grows on the way down, and its corners are followed less well. On the deck more is left than here, as
    # q = (p - c z/h) / (1 - z/h): glitter that goes its own way would seem to stand just below the camera.
    on_deck = left / np.square(np.clip(1.0 - z / camera_m, 1.0 - _BELOW, 1.0))
    stays = on_deck < _STAYS * freedom + np.minimum(_STAYS_PART * np.maximum(0.0, aq * z), _STAYS_M**2 * w)
    is_high = z > np.maximum(_STANDS_M, float(np.clip(flat, _FLAT_LOWEST, _FLAT_HIGHEST)) * _STANDS_SIGMAS / sure)
    stands = (reads >= _READS_STANDS) & (own > left + _STANDS_SIGMAS**2 * freedom) & is_high & stays
    stands &= (np.hypot(*place.T) < disc_radius_m + STANDS_REACH_M + CLUSTER_M) & (z < _BELOW * camera_m)
    moves = often & (left / w > _MOVES_M**2) & (left > _MOVES_TIMES**2 * freedom) & (z > -_STANDS_M)
    return Heights(place, z, stays, stands, moves, flat)


def _left_by_own(of: NDArray[np.void]) -> F64:
    """Return what the drone's own shadow leaves of each corner's squares, (N,)."""
    hh = np.maximum(of["hh"], 1e-9)
    own = np.maximum(0.0, of["off_off"] - np.square(of["h_off"]).sum(axis=1) / hh)
    aside = of["off"] - (of["h"] / hh)[:, None] * of["h_off"]
    weight = np.maximum(0.0, of["weight"] - of["h"] ** 2 / hh) + _OWN_SIGMA_M**-2
    within = np.hypot(*aside.T) < _OWN_M * weight
    return np.asarray(np.where(within, np.maximum(0.0, own - np.square(aside).sum(axis=1) / weight), own))
