"""What registration gives to the native core: camera, edges, expected tilt, options, as the core reads them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.abi import PROFILE_PIXELS
from estimator.core.interface import places_of, size_of
from estimator.core.library import address
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.drawing import EdgeKind, edges_of
from estimator.vision.native import packed_camera
from estimator.vision.pad import Pad
from estimator.vision.pose import Orientation
from estimator.vision.register.options import RegistrationOptions
from estimator.vision.register.pixels import light_table, ray_map

_CUT, _NOISE = (places_of("fit_options")[name] for name in ("cut", "noise"))
_PRIOR, _PRIOR_WORDS = places_of("tilt_prior"), size_of("tilt_prior")
_LANES = 16
_OUTLINE_STEP = 4
"""Every so many points of the edges are in an outline."""


@dataclass(frozen=True, slots=True, eq=False)
class PackedLens:
    """A camera as the core reads it."""

    words: F64
    """The core's `camera_lens`."""
    rays: F64 | None
    """The rays of all pixels, (H, W, 2), of a lens that distorts."""
    addresses: tuple[int, int]


@lru_cache(maxsize=8)
def packed_lens(camera: Camera) -> PackedLens:
    """Return a camera as the core reads it; the result is cached."""
    words = packed_camera(camera)
    rays = ray_map(camera.lens) if camera.distorted else None
    return PackedLens(words, rays, (address(words), 0 if rays is None else address(rays)))


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """The points of a pad's edges as the core reads them."""

    at: F64
    """Place, normal and distance to the next, (M, 5) m."""
    of: NDArray[np.int32]
    """Kind and piece, (M, 2)."""
    shown: tuple[slice, ...]
    """Where the outline of each kind is among the points that the core returns."""
    addresses: tuple[int, int, int]
    """Their number, and where both arrays begin."""


@lru_cache(maxsize=8)
def edge_points(pad: Pad) -> EdgePoints:
    """Return the points of a pad's edges; the result is cached."""
    edges = edges_of(pad)
    at = np.ascontiguousarray(np.c_[edges.at_m, edges.normal, edges.spacing_m])
    of = np.ascontiguousarray(np.c_[edges.kind, edges.piece], np.int32)
    borders = np.searchsorted(edges.kind[::_OUTLINE_STEP], np.arange(len(EdgeKind) + 1)).tolist()
    shown = tuple(slice(a, b) for a, b in pairwise(borders))
    return EdgePoints(at, of, shown, (len(at), address(at), int(of.ctypes.data)))


@lru_cache(maxsize=2)
def _light(gamma: bool) -> tuple[NDArray[np.float32], int]:
    light = light_table(gamma).astype(np.float32)
    return light, int(light.ctypes.data)


def light_address(gamma: bool) -> int:
    """Return the address of the linear light of a pixel's values, which stays."""
    return _light(gamma)[1]


def fit_options(options: RegistrationOptions, size_sigma_m: float, cut: F64, noise: float) -> F64:
    """Return the core's `fit_options`."""
    words = _uncut(options, size_sigma_m)
    if noise > 0.0 or cut.any():
        words = words.copy()
        words[_CUT], words[_NOISE] = cut, noise
    return words


@lru_cache(maxsize=8)
def _uncut(options: RegistrationOptions, size_sigma_m: float) -> F64:
    return record("fit_options", {
        "max_profiles": options.max_profiles, "dense_pixels": options.dense_pixels, "blur_px": options.blur_px,
        "edge_sigma_px": options.edge_sigma_px, "dense_edge_sigma_px": options.dense_edge_sigma_px,
        "size_sigma_m": size_sigma_m, "coded_px": options.coded_px,
    })  # fmt: skip


def packed_prior(prior: Orientation | None) -> F64:
    """Return the core's `tilt_prior`, which says whether there is one."""
    words = np.zeros(_PRIOR_WORDS)
    if prior is not None:
        words[: _PRIOR["given"].stop].view(np.int64)[:] = True
        words[_PRIOR["roll_rad"]], words[_PRIOR["pitch_rad"]] = prior.roll_rad, prior.pitch_rad
        words[_PRIOR["cov_tilt"]] = prior.cov_tilt.ravel()
        words[_PRIOR["sigma_deck_rad"]] = prior.sigma_deck_rad
    return words


def scratch_room(options: RegistrationOptions, edges: EdgePoints) -> int:
    """Return the length of the rows that the core works on: pixels of a small image, of profiles, or points of edges."""
    most = max(options.dense_pixels, PROFILE_PIXELS * (options.max_profiles + 2), len(edges.at))
    return -(-most // _LANES) * _LANES
