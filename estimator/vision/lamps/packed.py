"""What the native core is given to find lamps: their pattern, the pairs that a search tries, and the light of pixel values."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.abi import LAMP_PAIRS
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.lamp import Lamp, places_of
from estimator.vision.native import address
from estimator.vision.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT

_FULL = 65535.0


@lru_cache(maxsize=8)
def packed_pattern(pad: Pad, camera: Camera) -> tuple[F64, int]:
    """Return the core's `lamp_pattern` and its address, which stays."""
    places, pairs = places_of(pad.lamps), tried_pairs(pad.lamps)
    words = record("lamp_pattern", {
        "lamps": len(pad.lamps), "pairs": len(pairs), "pair": pairs, "x_m": places[:, 0], "y_m": places[:, 1],
        "radius_m": [lamp.radius_m for lamp in pad.lamps], "size_sigma_m": pad.size_sigma_m, "t_body_cam": camera.T_body_cam.t,
    })  # fmt: skip
    return words, address(words)


def tried_pairs(lamps: Sequence[Lamp]) -> NDArray[np.int64]:
    """Return the pairs of lamps that a search tries, (P, 2): near the pad only the inner lamps are in view.

    They are those that are the farthest apart among all lamps, and as many among the inner half.
    """
    places = places_of(lamps)
    order = np.argsort(np.linalg.norm(places - np.median(places, axis=0), axis=1))
    inner = order[: max(3, len(places) // 2)]
    return np.array([*_farthest(places, range(len(places))), *_farthest(places, inner.tolist())])


def _farthest(places: F64, among: Sequence[int]) -> list[tuple[int, int]]:
    pairs = sorted(combinations(among, 2), key=lambda pair: -float(np.linalg.norm(places[pair[0]] - places[pair[1]])))
    return pairs[: LAMP_PAIRS // 2]


@lru_cache(maxsize=1)
def light_address() -> int:
    """Return the address of the linear light of a pixel's values, full scale 65535, which stays."""
    return int(_LIGHT.ctypes.data)


_LIGHT = np.rint(_FULL * LINEAR_LIGHT).astype(np.uint16)
