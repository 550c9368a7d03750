"""Register the known drawing of the pad with a frame, until the model explains every pixel near an edge.

This is maximum likelihood over pose, blur, paints and noise at once (analysis by synthesis): the expected light of a pixel is the
sum of the paints' lights times the coverage of the blurred pixel by each. Blur and neighbouring edges are part of the model, so
they do not bias the pose. Linear unknowns (paints) are eliminated in each linearisation (variable projection: Golub & Pereyra,
SIAM J. Numer. Anal. 10, 1973); robust weights are Tukey's. A near pad uses profiles across the edges, a distant one the whole
disc.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.core.abi import FIT_ROWS, PROFILE_PIXELS
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, address, start_of
from estimator.core.records import record
from estimator.vision.camera import Camera, ray_map
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, UNCUT, approach
from estimator.vision.detect.pyramid import U8, Pyramid
from estimator.vision.drawing import EdgeKind, edges_of
from estimator.vision.native import packed_camera
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.shape import pad_shape
from estimator.vision.srgb import light_table


@dataclass(frozen=True, slots=True)
class RegistrationOptions:
    """Options that trade accuracy against time.

    The defaults are for 640x360 frames on one thread.
    """

    coarse: bool = True
    """Approach from the start on a reduced frame first; False for a start good to 1.5 px."""
    max_profiles: int = 120
    dense_pixels: int = 1700
    """Largest number of pixels in the disc's image at which it is registered as a whole."""
    blur_px: float = 0.6
    """Initial sigma of the lens' point spread; it is estimated."""
    edge_sigma_px: float = 0.004
    """Smallest sigma of an edge's place in the frame as predicted by drawing, lens and blur model."""
    dense_edge_sigma_px: float = 0.004
    """The same where edges merge."""
    coded_px: float = 0.0
    """Sigma of the place of a patch of the frame that a video codec has moved; 0 of a frame that no codec has predicted."""
    gamma: bool = True
    """True if pixel values are sRGB; False if they are linear light."""


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


_SNR_SEEN = 5.0
_LIKENESS_SEEN = 0.4
"""Limit on the likeness: with the white balance off by 20 % and light of 3000 K, white against green and orange against green
stay above 0.8.
"""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSupport:
    """The support of the frame for one kind of edge."""

    contrast_bgr: F64
    """Linear light inside minus outside, (3,) BGR."""
    snr: float
    """Contrast over its standard deviation, for the best channel mix."""
    in_view: float
    """Fraction of these edges within the frame, 0..1."""
    inliers: float
    """Fraction of those in view that agree with the drawing, 0..1."""
    likeness: float = 1.0
    """Cosine between the contrast and that of the pad file's paints; 1 for the disc, whose surroundings are unknown."""

    @property
    def seen(self) -> bool:
        return self.snr > _SNR_SEEN and self.inliers > 0.5 and self.in_view > 0.0 and self.likeness > _LIKENESS_SEEN


_REGISTER = CORE.function("register_pad")
_AT, _SUPPORT = places_of("registration"), size_of("edge_support")
_AMBIGUOUS = _AT["yaw_ambiguous"]


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A pose, its covariance, and the evidence for it."""

    pose: PadPose
    cov: F64
    """Covariance in `cam`, (6, 6): [t_cam_pad (m), small rotation of the pad (rad)], the prior included."""
    information: F64
    """Information in `cam`, (6, 6), from the frame alone."""
    prior: Orientation | None
    edges: Mapping[EdgeKind, EdgeSupport]
    yaw_ambiguous: bool
    """True if neither an arrowhead nor a fiducial resolved the headings."""
    blur_px2: F64
    """Covariance of the point spread at the pad, (3,) uu, uv, vv, without the pixel's own square."""
    noise_light: float
    """Standard deviation of the residuals in linear light, 1 = full scale."""
    edge_rms_px: float
    """Unexplained displacement of the edges, rms, without the noise."""
    visible: float
    """Fraction of the drawing's edges within the frame."""
    inliers: float
    """Fraction of the visible edges that agree."""
    last_step_px: float
    """Length of the last iteration's step; small if converged."""
    dense: bool
    """True for a fit to all pixels of the disc; False for profiles across edges."""

    @property
    def blur_px(self) -> float:
        """Standard deviation of the point spread, mean over directions."""
        return math.sqrt(max(0.0, 0.5 * float(self.blur_px2[0] + self.blur_px2[2])))


def register(
    px: U8,
    camera: Camera,
    pad: Pad,
    start: PadPose,
    prior: Orientation | None = None,
    options: RegistrationOptions | None = None,
    cut: F64 = UNCUT,
    pyramid: Pyramid | None = None,
) -> Registration | None:
    """Refine a rough pose.

    Args:
        px: (H, W, 3) BGR.
        start: off by at most a tenth of the disc's radius and less than a quarter turn with `coarse`; by about 1.5 px without.
        prior: attitude at the exposure and the deck's expected tilt. Without one, the tilt comes from the frame alone.
        cut: the line beyond which something covers the pad, (3,); see `alignment.UNCUT`.
        pyramid: of the same frame, if there is one.

    Returns:
        The registration; None if nothing of the pad is in view at the start, or if the frame does not determine a pose.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    if px.shape != (camera.height, camera.width, 3):
        raise ValueError(f"want a frame of shape {(camera.height, camera.width, 3)}, got {px.shape}")
    options = options if options is not None else RegistrationOptions()
    px = np.ascontiguousarray(px, np.uint8)
    pyramid, pose = pyramid or Pyramid(px), start
    if options.coarse:
        sigma = SIGMA_TILT_RAD if prior is not None and prior.measured else SIGMA_TILT_FREE_RAD
        pose = approach(pyramid, camera, pad, start, sigma) or start
    edges, out = edge_points(pad), np.empty(size_of("registration"))
    outline = np.empty((edges.shown[-1].stop, 2))
    with_prior, of_options = packed_prior(prior), fit_options(options, pad.size_sigma_m, cut, pyramid.noise)
    from_pose = np.concatenate([pose.R_cam_pad.matrix.ravel(), pose.t_cam_pad])
    room = scratch_room(options, edges)
    scratch = np.empty(FIT_ROWS * room, np.float32)
    if not _REGISTER(
        *packed_lens(camera).addresses, int(px.ctypes.data), light_address(options.gamma), address(pad_shape(pad)),
        *edges.addresses, address(with_prior), address(of_options), address(from_pose), room, int(scratch.ctypes.data),
        start_of(out), start_of(outline),
    ):  # fmt: skip
        return None
    return registration_of(out, pad, prior)


def supports(words: F64) -> Mapping[EdgeKind, EdgeSupport]:
    """Return the support of the frame for each kind of edge, from the core's `registration`."""
    each = words[_AT["edges"]].reshape(-1, _SUPPORT)
    return MappingProxyType({k: EdgeSupport(one[:3], *one[3:].tolist()) for k, one in zip(EdgeKind, each, strict=True)})


def is_ambiguous(words: F64, pad: Pad) -> bool:
    """Return whether neither an arrowhead nor a fiducial resolved the headings, from the core's `registration`."""
    if pad.markings.fiducials:
        return not supports(words)[EdgeKind.H].seen
    return bool(words[_AMBIGUOUS].view(np.int64)[0])


def registration_of(words: F64, pad: Pad, prior: Orientation | None) -> Registration:
    """Return the core's `registration` as a value."""
    noise_light, edge_rms_px, visible, inliers, last_step_px = words[_AT["noise_light"].start : _AT["edges"].start].tolist()
    return Registration(
        PadPose(Rotation(words[_AT["R"]].reshape(3, 3)), words[_AT["t"]]), words[_AT["cov"]].reshape(6, 6),
        words[_AT["information"]].reshape(6, 6), prior, supports(words), is_ambiguous(words, pad), words[_AT["blur_px2"]],
        noise_light, edge_rms_px, visible, inliers, last_step_px, bool(words[_AT["dense"]].view(np.int64)[0]),
    )  # fmt: skip
