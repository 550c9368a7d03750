"""Register the known drawing of the pad with a frame, until the model explains every pixel near an edge, and verify it there.

This is maximum likelihood over pose, blur, paints and noise at once (analysis by synthesis): the expected light of a pixel is the
sum of the paints' lights times the coverage of the blurred pixel by each. Blur and neighbouring edges are part of the model, so
they do not bias the pose. Linear unknowns (paints) are eliminated in each linearisation (variable projection: Golub & Pereyra,
SIAM J. Numer. Anal. 10, 1973); robust weights are Tukey's. A near pad uses profiles across the edges, a distant one the whole
disc. The native core does all of it in one call (`estimator/core/vision/look/look.c`).

A camera's tone curve is learnt by looks, on the edges of a pad that is tracked: one number, step by step. Across a blurred edge
light is symmetric, and values are not. What the tone is off leaves near edges that no pose and no blur explains, and displaces
all of them towards the darker paint: that is a wrong range. From time to time a near registration is made again one step beside,
and the step is kept if the rest explains more. Noise alone has no edges, and clipped light no tone: neither is learnt from.

Edges alone do not distinguish a fiducial from itself a quarter turn or a cell aside, where most of them lie on edges again. Its
cells do, as far as the frame resolves them. Where it does not, this many more of the edges have to agree. A letter's edges have
to be clear, as plates and lines have such edges, too.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Feature, Method, Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs
from estimator.core.library import CORE
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, UNCUT
from estimator.vision.detect.pyramid import U8, FrameView, Pyramid
from estimator.vision.detect.template import FRESH, PaintMemory
from estimator.vision.drawing import EdgeKind
from estimator.vision.fiducial import PaintedFiducial
from estimator.vision.native import checked, edge_points, native_lens, native_pose, native_prior, tracker_of
from estimator.vision.pad import Pad
from estimator.vision.pose import Orientation, PadPose


@dataclass(frozen=True, slots=True)
class RegistrationOptions:
    """Options that trade accuracy against time.

    The defaults are for 640x360 frames on one thread.
    """

    coarse: bool = True
    """Approach from the start on a reduced frame first; False for a start good to 1.5 px."""
    coded_px: float = 0.0
    """Sigma of the place of a patch of the frame that a video codec has moved; 0 of a frame that no codec has predicted."""


_SNR_SEEN = 5.0
_LIKENESS_SEEN = 0.4
"""Limit on the likeness: with the white balance off by 20 % and light of 3000 K, white against green and orange against green
stay above 0.8.
"""


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


STEP, _LOWEST, _HIGHEST = 0.1, -10, 4
"""A step of the tone, and the range in steps: from values that are linear light to a gamma of 2.7."""
_UNEXPLAINED_PX, _FAR_OFF_PX, _STRIDE = 0.03, 0.12, 3
"""Displacement of edges from which something is learnt, and from which by so many steps at once: of right tones it is 0.02 and
less, of one step beside 0.04, of two 0.07."""
_LESS = 0.97
"""Factor on what is left over contrast below which a step is kept."""
_EVERY_NS, _RESTS_NS = 300_000_000, 3_000_000_000
"""Time between two trials, and after neither side was better."""
_AGREES, _CLIPPED, _CLIPPED_SHARE = 0.8, 253, 0.01
"""Least share of the edges that agree; value from which light is clipped, and the share of the pad's box that may be."""

_AT_ONCE = MonoNs(0)


@dataclass(frozen=True, slots=True)
class ToneMemory:
    """The tone that was learnt, in steps, and the next trial."""

    steps: int = 0
    way: int = -1
    """The side that is tried next, 1 or -1."""
    failed: int = 0
    """Trials since a step was kept."""
    next_at: MonoNs = _AT_ONCE

    def is_due(self, found: Registration, at: MonoNs) -> bool:
        """Return whether something may be learnt from a registration."""
        return at >= self.next_at and not found.dense and found.edge_rms_px >= _UNEXPLAINED_PX and found.inliers >= _AGREES


SRGB = ToneMemory()


@lru_cache(maxsize=8)
def with_tone(camera: Camera, steps: int) -> Camera:
    """Return a camera with the tone of so many steps from sRGB."""
    return replace(camera, tone=1.0 + STEP * steps)


def learn_tone(memory: ToneMemory, view: FrameView, found: Registration, orientation: Orientation, at: MonoNs) -> ToneMemory:
    """Return the tone after one more frame in which the pad is sure, found by that of the memory; most change nothing."""
    if not memory.is_due(found, at):
        return memory
    if _is_clipped(view.pyramid[0], found):
        return replace(memory, next_at=MonoNs(at + _EVERY_NS))
    steps = memory.steps + memory.way * (_STRIDE if found.edge_rms_px > _FAR_OFF_PX else 1)
    if not _LOWEST <= steps <= _HIGHEST:
        return replace(memory, way=-memory.way)
    tried = view._replace(camera=with_tone(view.camera, steps)).as_seen()
    other = look(tried, found.pose, orientation, RegistrationOptions(coarse=False), tracked=True)
    if other is not None and _left(other) < _LESS * _left(found):
        return ToneMemory(steps, memory.way, 0, MonoNs(at + _EVERY_NS))
    rests = _RESTS_NS if memory.failed else _EVERY_NS
    return ToneMemory(memory.steps, -memory.way, (memory.failed + 1) % 2, MonoNs(at + rests))


def _left(found: Registration) -> float:
    """Return what is left of the light along the edges, over their contrast."""
    contrast = float(np.linalg.norm([edge.contrast_bgr for edge in found.edges.values()]))
    return found.noise_light / max(contrast, 1e-9)


def _is_clipped(px: U8, found: Registration) -> bool:
    points = found.outline[np.isfinite(found.outline).all(axis=1)]
    if not len(points):
        return True
    height, width = px.shape[:2]
    (left, top), (right, bottom) = (
        np.clip(limit, 0, (width - 1, height - 1)).astype(int) for limit in (points.min(0), points.max(0))
    )
    part = px[top : bottom + 1 : 4, left : right + 1 : 4]
    return bool((part >= _CLIPPED).any(axis=2).mean() > _CLIPPED_SHARE)


_NAMES = [kind.name.lower() for kind in EdgeKind]
_YAW_VAR_MAX = 0.5
"""Variance of the heading from which it counts as unknown, rad^2."""


def sighting_of_look(frame: Frame, found: Registration, confidence: float) -> Sighting:
    """Return the sighting of method "registration".

    Args:
        confidence: how sure it is that this is the pad, 0..1.
    """
    uv, shown = found.outline, edge_points(found.pad).shown
    is_whole = math.isfinite(float(uv.sum()))  # else the lens does not project some points
    features = tuple(
        Feature("point" if name == "h" else "outline", name, part if is_whole else part[np.isfinite(part).all(axis=1)])
        for name, part in zip(_NAMES, (uv[each] for each in shown), strict=True)
        if name != "upper" or found.pad.markings.upper
    )
    return sighting_in_level(frame, found.in_level, found.yaw_ambiguous, confidence, features)


def sighting_of(
    frame: Frame,
    pose: PadPose,
    cov_pose: F64,
    camera: Camera,
    orientation: Orientation,
    ambiguous: bool,
    confidence: float,
) -> Sighting:
    """Return the sighting of a pose in the camera's axes.

    The difference between the deck's tilt in the frame and the attitude's prediction is split between the errors of both, by
    their variances. The covariance holds the attitude's remaining error in position, heading and tilt, correlations included.

    Args:
        cov_pose: (6, 6) covariance of the pad's centre and of a small rotation of the pad, both in `cam`.
        ambiguous: whether the heading may be half a turn off.
        confidence: the sighting's, 0..1.
    """
    out, prior = np.empty((), CORE.dtype("dl_level_sighting")), CORE.ffi.new("dl_tilt_prior *", native_prior(orientation))
    CORE.lib.dl_sighting_in_level(
        CORE.array("dl_lens", native_lens(camera)), CORE.array("double", camera.T_body_cam.t, 3), prior, native_pose(pose),
        CORE.array("double", np.ascontiguousarray(cov_pose, float), 36), CORE.array("dl_level_sighting", out),
    )  # fmt: skip
    return sighting_in_level(frame, out, ambiguous, confidence)


def sighting_in_level(
    frame: Frame, level: NDArray[Any], ambiguous: bool, confidence: float, features: tuple[Feature, ...] = (),
    method: Method = "registration",
) -> Sighting:  # fmt: skip
    """Return the sighting of a pose that the core has brought to level; arguments as for `sighting_of`.

    Args:
        level: the core's `dl_level_sighting`; it becomes read-only.
    """
    level.setflags(write=False)
    d, R_level_pad, cov_pose6, cov = (level[name] for name in ("d", "R_level_pad", "cov_pose", "cov"))
    cov = cov.reshape(4, 4)
    yaw: float | None = wrap_pi(float(level["yaw_rad"]))
    if cov.item(3, 3) > _YAW_VAR_MAX:
        yaw, ambiguous, cov = None, False, cov.copy()
        cov[3, :] = cov[:, 3] = 0.0
        cov[3, 3] = UNKNOWN_YAW_VAR
    pose6 = Pose6(d, Rotation(R_level_pad.reshape(3, 3)), cov_pose6.reshape(6, 6))
    return Sighting(frame.stamp, frame.seq, method, pose6.d_body_pad_level, yaw, ambiguous, cov, confidence, pose6, features)


LETTER_MOST = 2.2
"""Most log-odds of a letter alone: another marking may have the same one."""
_INLIERS = (0.9, 0.7)
"""Share of the edges that agree from which they do not count against a pose, and at which they refute it: 0.98 or more at
right poses.
"""
_INLIERS_TRACKED = (0.5, 0.3)
"""Share of agreeing edges where an estimate led to the place: the drone's own shadow crosses most edges of a near letter."""
_INLIERS_FAR, _SNR_FAR = (0.95, 0.85), (100.0, 50.0)
"""Share of agreeing pixels of a distant letter, and its contrast: 0.97 and 420 or more at right poses from 3 to 14 m in plain
light. A fit that has taken the bare deck for a letter of another size has fewer that agree, or no contrast (68 and less).
"""
_OFF_PX = (0.15, 0.3)
"""Unexplained displacement of edges at which they do not count, and at which they refute a pose.

Right poses have 0.01, other markings 0.27 and more.
"""
_SNR = (20.0, 8.0)
"""Contrast over its deviation at which it does not count, and at which it refutes a pose.

Right poses in plain light have 65 or more.
"""
_VISIBLE = (0.8, 0.7)
"""Share of the edges in view at which it does not count, and at which it refutes a pose.

It holds where no estimate led to the place: an end of a stroke may be of anything.
"""
_REFUTED = -25.0
"""Log-odds of a refuted pose: more than all other evidence together."""


def letter_log_odds(found: Registration, tracked: bool) -> float:
    """Return the log-odds, at most 0, that the edges add to the confidence of a registration.

    From afar edges merge, and a letter resembles what else is small and bright: there it is followed and not found.

    Args:
        tracked: whether a belief led to this place.
    """
    clear = found.edges[EdgeKind.H].snr
    if tracked:
        inliers, least_snr = (_INLIERS_FAR, _SNR_FAR) if found.dense else (_INLIERS_TRACKED, _SNR)
        return _REFUTED * max(_between(-found.inliers, inliers, -1.0), _between(-clear, least_snr, -1.0))
    if found.dense:
        return _REFUTED
    doubts = (
        (found.inliers, _INLIERS, -1.0),
        (found.edge_rms_px, _OFF_PX, 1.0),
        (clear, _SNR, -1.0),
        (found.visible, _VISIBLE, -1.0),
    )
    return _REFUTED * max(_between(sign * value, limits, sign) for value, limits, sign in doubts)


def _between(value: float, limits: tuple[float, float], sign: float = 1.0) -> float:
    good, bad = (sign * limit for limit in limits)
    return min(1.0, max(0.0, (value - good) / (bad - good)))


def nearest_of_four(pose: PadPose, R_level_cam: np.ndarray, yaw_rad: float) -> PadPose:
    """Return the pose of a drawing that looks the same after a quarter turn whose heading is nearest to a given one, rad."""
    x, y, _ = (R_level_cam @ pose.R_cam_pad.matrix)[:, 0].tolist()
    return pose.turned(0.5 * math.pi * round(wrap_pi(-math.atan2(y, x) - yaw_rad) / (0.5 * math.pi)))


_FINE = 8
"""Samples along a cell's side of the drawing whose blur is looked up."""
_BLUR_STEPS = 4.0
"""Steps of the blur that drawings are kept for, by doubling."""
_PIXEL_PX = 0.3
"""Standard deviation of a pixel's own square, px."""
_LEAST_SPAN = 12.0
"""Least difference of light and dark cells in the frame, 8-bit, that is read."""
_READ, _MISREAD = 0.65, 0.35
"""Agreement from which the cells do not count against the pose, and at which they refute it. It is 0.82 or more at right poses
of uncovered pads, half of that if half of them is covered, at most 0.4 a quarter turn off, and about 0 at a random place.
"""
_ENOUGH, _ENOUGH_SHARE = 5.0, 0.25
"""Number of clear cells, and their share of those in view, from which they count in full."""
_EDGES_AGREE, _EDGES_OFF = 0.8, 0.55
"""Share of the edges that agree from which they do not count against a pose whose cells are not resolved, and at which they
refute it: 0.89 or more at right poses of whole pads, 0.5 or less at wrong ones.
"""


def cells_log_odds(px: NDArray[np.uint8], camera: Camera, pad: Pad, found: Registration) -> float:
    """Return the log-odds, at most 0, that the cells of a pad's fiducials add to the confidence of a registration.

    Args:
        px: (H, W, 3) BGR, the registered frame.
    """
    read = read_cells(px, camera, pad, found.pose, found.blur_px)
    resolved = min(1.0, read.clear / max(_ENOUGH, _ENOUGH_SHARE * read.in_view))
    misread = min(1.0, max(0.0, (_READ - read.agreement) / (_READ - _MISREAD)))
    off = min(1.0, max(0.0, (_EDGES_AGREE - found.inliers) / (_EDGES_AGREE - _EDGES_OFF)))
    return _REFUTED * (resolved * misread + (1.0 - resolved) * off)


class ReadCells(NamedTuple):
    """The bits of a pad's fiducials as read in a frame."""

    agreement: float
    """Agreement: 1 if they are as drawn, 0 by chance; 1 if none is read."""
    clear: float
    """Number of resolved features: each counts by the square of its contrast in the blurred drawing."""
    in_view: int


def read_cells(px: NDArray[np.uint8], camera: Camera, pad: Pad, pose: PadPose, blur_px: float) -> ReadCells:
    """Read the bits of a pad's fiducials at a pose; arguments as for `cells_log_odds`.

    Args:
        blur_px: standard deviation of the point spread at the pad.
    """
    px_per_m = camera.fx / max(float(pose.t_cam_pad[2]), 1e-3)
    blur_m = math.hypot(blur_px, _PIXEL_PX) / px_per_m
    drawn = [_drawn(fiducial, _step_of(blur_m / fiducial.cell_m)) for fiducial in pad.markings.fiducials]
    p_pad, light, own = (np.concatenate(part) for part in zip(*drawn, strict=True))
    p_cam = pose.points(np.pad(p_pad, ((0, 0), (0, 1))))
    uv = camera.project(p_cam)
    seen = (p_cam[:, 2] > 0.01) & np.all((uv > 1.0) & (uv < (camera.width - 2.0, camera.height - 2.0)), axis=1)
    bits = own[seen]
    if not bits.any():
        return ReadCells(1.0, 0.0, 0)
    at = uv[seen].astype(np.float32)
    shown = cv2.remap(px, at[:, :1], at[:, 1:], cv2.INTER_LINEAR).reshape(-1, 3).mean(axis=1)
    dark, bright = np.percentile(shown, (10.0, 90.0)).tolist()
    expected = (2.0 * light[seen] - 1.0)[bits]
    clear = max(float(expected @ expected), 1e-6)
    if bright - dark < _LEAST_SPAN:
        return ReadCells(0.0, clear, len(expected))
    read = np.clip(2.0 * (shown[bits] - dark) / (bright - dark) - 1.0, -1.0, 1.0)
    return ReadCells(float(expected @ read) / clear, clear, len(expected))


def _step_of(blur_cells: float) -> int:
    return round(_BLUR_STEPS * math.log2(max(blur_cells, 0.02)))


@lru_cache(maxsize=512)
def _drawn(fiducial: PaintedFiducial, step: int) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Return the middles of a fiducial's cells and of those around it, (N, 2) m, how light they are seen, 0..1, and its bits.

    Which are its bits is (N,): its border and what lies around are the same for all fiducials.

    Args:
        step: of the blur in cells, by `_step_of`.
    """
    cells = np.pad(fiducial.cells(), 1)
    n, blur_cells = len(cells), 2.0 ** (step / _BLUR_STEPS)
    around = np.pad(~cells, 2, constant_values=True).astype(np.float32)
    fine = np.asarray(np.kron(around, np.ones((_FINE, _FINE), np.float32)), np.float32)
    blurred = cv2.GaussianBlur(fine, (0, 0), _FINE * min(blur_cells, 2.0), borderType=cv2.BORDER_REPLICATE)
    middle = slice(2 * _FINE + _FINE // 2, (2 + n) * _FINE, _FINE)
    light = np.asarray(blurred[middle, middle], float)
    index = np.arange(n) - 0.5 * (n - 1)
    x, y = np.meshgrid(fiducial.at_m[0] - index * fiducial.cell_m, fiducial.at_m[1] + index * fiducial.cell_m, indexing="ij")
    own = np.zeros((n, n), bool)
    own[2:-2, 2:-2] = True
    return np.stack([x.ravel(), y.ravel()], axis=1), light.ravel(), own.ravel()
