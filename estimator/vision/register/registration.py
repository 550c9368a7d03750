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
from types import MappingProxyType

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.core.abi import FIT_ROWS
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, address, start_of
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, UNCUT, approach
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.edge_support import EdgeSupport
from estimator.vision.register.options import RegistrationOptions as RegistrationOptions
from estimator.vision.register.packed import edge_points, fit_options, light_address, packed_lens, packed_prior, scratch_room
from estimator.vision.register.pixels import U8
from estimator.vision.register.shape import pad_shape

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
