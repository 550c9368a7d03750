"""Register the known drawing of the pad with a frame, until the model explains every pixel near an edge, and verify it there.

This is maximum likelihood over pose, blur, paints and noise at once (analysis by synthesis): the expected light of a pixel is the
sum of the paints' lights times the coverage of the blurred pixel by each. Blur and neighbouring edges are part of the model, so
they do not bias the pose. Linear unknowns (paints) are eliminated in each linearisation (variable projection: Golub & Pereyra,
SIAM J. Numer. Anal. 10, 1973); robust weights are Tukey's. A near pad uses profiles across the edges, a distant one the whole
disc. The native core does all of it in one call (`estimator/core/vision/look/look.c`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.core.library import CORE
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, UNCUT
from estimator.vision.detect.pyramid import U8, FrameView, Pyramid
from estimator.vision.detect.template import FRESH, PaintMemory
from estimator.vision.native import checked, edge_points, native_prior, tracker_of
from estimator.vision.pad.drawing import EdgeKind
from estimator.vision.pad.pad import Pad

_SNR_SEEN = 5.0  # Contrast over its standard deviation above which a kind of edge shows
_LIKENESS_SEEN = 0.4
"""Limit on the likeness: with the white balance off by 20 % and light of 3000 K, white against green and orange against green
stay above 0.8.
"""


@dataclass(frozen=True, slots=True)
class RegistrationOptions:
    """Options that trade accuracy against time.

    The defaults are for 640x360 frames on one thread.
    """

    coarse: bool = True
    """Approach from the start on a reduced frame first; False for a start good to 1.5 px."""
    coded_px: float = 0.0
    """Sigma of the place of a patch of the frame that a video codec has moved; 0 of a frame that no codec has predicted."""


class EdgeSupport(NamedTuple):
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


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A pose, its covariance, and the evidence for it."""

    pose: PadPose
    cov: F64
    """Covariance in `cam`, (6, 6): [t_cam_pad (m), small rotation of the pad (rad)], the prior included."""
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
    dense: bool
    """True for a fit to all pixels of the disc; False for profiles across edges."""
    outline: F64
    """Pixels of the outline's points, (N, 2)."""
    pad: Pad
    record: NDArray[Any]
    """The core's `dl_registered_pad`. The verification in it is empty after `register`."""

    @property
    def blur_px(self) -> float:
        """Standard deviation of the point spread, mean over directions."""
        return math.sqrt(max(0.0, 0.5 * float(self.blur_px2[0] + self.blur_px2[2])))

    @property
    def log_odds(self) -> float:
        """Log-odds that this is the pad, from the frame alone."""
        return float(self.record["log_odds"])

    @property
    def evidence(self) -> F64:
        """The inputs of the verification, in the order of `look_evidence` in the core's header."""
        return np.asarray(self.record["evidence"])

    @property
    def in_level(self) -> NDArray[Any]:
        """The core's `dl_level_sighting`."""
        return np.asarray(self.record["seen"])

    def paint(self) -> PaintMemory:
        """Return what is known of the paints if this is the pad."""
        paint = self.record["paint"]
        return PaintMemory(paint["mean"].reshape(4, 3), paint["var"].reshape(4, 3), float(paint["trust"]))


def register(
    px: U8,
    camera: Camera,
    pad: Pad,
    start: PadPose,
    prior: Orientation | None = None,
    options: RegistrationOptions | None = None,
    cut: F64 = UNCUT,
) -> Registration | None:
    """Refine a rough pose.

    Args:
        px: (H, W, 3) BGR.
        start: off by at most a tenth of the disc's radius and less than a quarter turn with `coarse`; by about 1.5 px without.
        prior: attitude at the exposure and the deck's expected tilt. Without one, the tilt comes from the frame alone.
        cut: the line beyond which something covers the pad, (3,); see `alignment.UNCUT`.

    Returns:
        The registration; None if nothing of the pad is in view at the start, or if the frame does not determine a pose.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    return look(FrameView(Pyramid(px), camera, pad), start, prior, options or RegistrationOptions(), cut=cut, alone=True)


def look(
    view: FrameView,
    start: PadPose,
    prior: Orientation | None,
    options: RegistrationOptions,
    *,
    cut: F64 = UNCUT,
    paint: PaintMemory = FRESH,
    **how: bool,
) -> Registration | None:
    """Register the drawing from a start pose and verify it there; return None if nothing of it is found.

    Args:
        view: the pad as the camera sees it, see `FrameView.as_seen`.
        start, prior, cut: as for `register`.
        paint: what is known of the paints.
        how: `tracked` if a track has confirmed the pad there before, `alone` to verify nothing.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    pyramid, camera, pad = view
    shape, measured = pyramid[0].shape, prior is not None and prior.measured
    if shape != (camera.height, camera.width, 3):
        raise ValueError(f"want a frame of shape {(camera.height, camera.width, 3)}, got {shape}")
    given = CORE.ffi.new("dl_start *", {
        "pose": (start.R_cam_pad.matrix.ravel().tolist(), start.t_cam_pad.tolist()), "prior": native_prior(prior),
        "known": (paint.mean.ravel().tolist(), paint.var.ravel().tolist(), paint.trust), "coarse": options.coarse,
        "coded_px": options.coded_px, "cut": cut.tolist(),
        "sigma_tilt_rad": SIGMA_TILT_RAD if measured else SIGMA_TILT_FREE_RAD, **how,
    })  # fmt: skip
    outline, out = np.empty((edge_points(pad).shown[-1].stop, 2)), np.zeros((), CORE.dtype("dl_registered_pad"))
    if not checked(CORE.lib.dl_look(
        tracker_of(camera, pad), pyramid.native, given, CORE.array("dl_registered_pad", out), CORE.array("double", outline),
        len(outline),
    )):  # fmt: skip
        return None
    out.setflags(write=False)
    outline.setflags(write=False)
    found = out["found"]
    edges = {kind: EdgeSupport(*one) for kind, one in zip(EdgeKind, found["edges"].tolist(), strict=True)}
    return Registration(
        PadPose(Rotation(found["pose"]["R"].reshape(3, 3)), found["pose"]["t"]), found["cov"].reshape(6, 6),
        prior, MappingProxyType(edges),
        not edges[EdgeKind.H].seen if pad.markings.fiducials else bool(found["yaw_ambiguous"]), found["blur_px2"],
        float(found["noise_light"]), float(found["edge_rms_px"]), float(found["visible"]), float(found["inliers"]),
        bool(found["dense"]), outline, pad, out,
    )  # fmt: skip
