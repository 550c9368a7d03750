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
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, address
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, approach
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.drawing import EdgeKind, edges_of
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register import profiles as profiles_
from estimator.vision.register.edge_support import EdgeSupport, arrow_support, profile_support
from estimator.vision.register.native import Inputs
from estimator.vision.register.sampling import sample
from estimator.vision.register.solver import WEAK_BLUR_PX2, Solver, TiltTarget, depth_in_view, difference, inverse
from estimator.vision.register.state import N_POSE, N_STATE, U8, RegistrationState

_DENSE, _OPPOSITE = CORE.function("register_dense"), CORE.function("register_opposite")
_SOLVED, _STATE, _SUPPORT = places_of("fit_solved"), places_of("fit_state"), size_of("edge_support")


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
    dense_edge_sigma_px: float = 0.01
    """The same where edges merge."""
    edge_sigma_m: float = 0.0
    """Sigma of the painted edges on the pad."""
    gamma: bool = True
    """True if pixel values are sRGB; False if they are linear light."""


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
    """True if no arrowhead resolved the two headings of the H."""
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
    outline_px: tuple[F64, ...]
    """Registered edge points, (N, 2) px for each kind, for display."""

    @property
    def blur_px(self) -> float:
        """Standard deviation of the point spread, mean over directions."""
        return math.sqrt(max(0.0, 0.5 * float(self.blur_px2[0] + self.blur_px2[2])))


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    state: RegistrationState
    H: F64
    """Information of the frame, (9, 9)."""
    cov: F64
    """Covariance in `pad`, (9, 9)."""
    edges: dict[EdgeKind, EdgeSupport]
    noise_light: float
    edge_rms_px: float
    visible: float
    inliers: float
    last_step_px: float
    arrow_seen: bool
    doubted: bool
    """True if something other than the pad is in the way: too much remains unexplained."""
    dense: bool


def register(
    px: U8, camera: Camera, pad: Pad, start: PadPose, prior: Orientation | None = None, options: RegistrationOptions | None = None
) -> Registration | None:
    """Refine a rough pose.

    Args:
        px: (H, W, 3) BGR.
        start: off by at most a tenth of the disc's radius and less than a quarter turn with `coarse`; by about 1.5 px without.
        prior: attitude at the exposure and the deck's expected tilt. Without one, the tilt comes from the frame alone.

    Returns:
        The registration; None if nothing of the pad is in view at the start, or if the frame does not determine a pose.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    if px.shape != (camera.height, camera.width, 3):
        raise ValueError(f"want a frame of shape {(camera.height, camera.width, 3)}, got {px.shape}")
    options = options if options is not None else RegistrationOptions()
    tilt = TiltTarget.of(prior, camera) if prior is not None else None
    inputs = Inputs(px, camera, pad, prior, options)
    pose = start
    if options.coarse:
        sigma = SIGMA_TILT_RAD if prior is not None and prior.measured else SIGMA_TILT_FREE_RAD
        pose = approach(Pyramid(px), camera, pad, start, sigma) or start
    state = RegistrationState.of(pose, camera, options.blur_px, depth_in_view(pose, camera))
    solved = _refine(px, camera, pad, state, tilt, options, inputs)
    if solved is None:
        return None
    if not (solved.arrow_seen or solved.doubted) and _arrow_is_opposite(inputs, camera, pad, solved.state):
        turned = replace(solved.state, R=solved.state.R @ np.diag([-1.0, -1.0, 1.0]))
        again = _refine(px, camera, pad, turned, tilt, options, inputs)
        if again is not None and again.arrow_seen:
            solved = again
    return _result(solved, camera, pad, prior)


def _refine(
    px: U8,
    camera: Camera,
    pad: Pad,
    state: RegistrationState,
    tilt: TiltTarget | None,
    options: RegistrationOptions,
    inputs: Inputs,
) -> _Solved | None:
    radius_px = pad.disc_radius_m / state.m_per_px
    small = (2 * radius_px + 8) ** 2 <= options.dense_pixels
    if not small and profiles_.spacing_ok(state, pad):
        solved = _by_profiles(px, camera, pad, state, tilt, options)
        if solved is None or profiles_.spacing_ok(solved.state, pad):
            return solved
        state = solved.state
    return _dense_fit(inputs, state)


def _dense_fit(inputs: Inputs, state: RegistrationState) -> _Solved | None:
    """Fit all pixels of the disc, a small image of it, in the native core."""
    start, out = _packed(state), np.zeros(size_of("fit_solved"))
    if not _DENSE(*inputs.frame, inputs.prior, inputs.options, address(start), *inputs.room, address(out)):
        return None
    dense, arrow_seen, doubted = out.view(np.int64)[:3].astype(bool).tolist()
    noise_light, edge_rms_px, visible, inliers, last_step_px = out[_SOLVED["noise_light"].start : _SOLVED["state"].start].tolist()
    found = out[_SOLVED["state"]]
    R, t, blur_px2 = (found[_STATE[name]] for name in ("R", "t", "blur_px2"))
    m_per_px, depth_m = found[_STATE["m_per_px"].start :].tolist()
    return _Solved(
        RegistrationState(R.reshape(3, 3), t, blur_px2, m_per_px, depth_m), out[_SOLVED["H"]].reshape(N_STATE, N_STATE),
        out[_SOLVED["cov"]].reshape(N_STATE, N_STATE), _edges(out[_SOLVED["edges"]]), noise_light, edge_rms_px, visible, inliers,
        last_step_px, arrow_seen, doubted, dense,
    )  # fmt: skip


def _packed(state: RegistrationState) -> F64:
    return record("fit_state", {
        "R": state.R, "t": state.t, "blur_px2": state.blur_px2, "m_per_px": state.m_per_px, "depth_m": state.depth_m,
    })  # fmt: skip


def _edges(words: F64) -> dict[EdgeKind, EdgeSupport]:
    return {
        kind: EdgeSupport(each[:3], *each[3:].tolist())
        for kind, each in zip(EdgeKind, words.reshape(-1, _SUPPORT), strict=True)
    }  # fmt: skip


def _by_profiles(
    px: U8, camera: Camera, pad: Pad, state: RegistrationState, tilt: TiltTarget | None, options: RegistrationOptions
) -> _Solved | None:
    edges = edges_of(pad)
    solver = Solver(state, tilt, pad)
    for again in range(3):
        half = min(9, max(3, math.ceil(2.2 * state.sigma_px + 1.2)))
        got = sample(px, camera, pad, edges, state, options.max_profiles, half, options.gamma)
        if got is None:
            return None
        measured_at, fp = got
        seen = profiles_.coverages(state, measured_at, pad, fp)
        mix = profiles_.channels(measured_at, seen.coverage)
        mixed = np.concatenate([mix.mix[k] @ measured_at.light[:, part] for k, part in enumerate(measured_at.kind_parts)])
        before = state
        noise: F64 | None = None
        for n in range(5):
            if n > 0:
                seen = profiles_.coverages(state, measured_at, pad)
            fit = profiles_.fit(measured_at, mixed, noise, seen)
            last = state
            state, moved = solver.step(state, fit.H, fit.g, 2.0)
            delta = difference(last, state)
            left = profiles_.residual_after(fit, measured_at, delta)
            noise = profiles_.noise_of(left, fit, measured_at)
            if n > 0 and moved < 0.08:
                break
        settled = solver.moved_px(state, difference(before, state)) < 1.2 and state.sigma_px < 1.5 * before.sigma_px + 0.3
        if settled or again == 2:
            break
    assert noise is not None
    groups = int(fit.accepted.sum())
    if groups < 3:
        return None
    judged = fit.weight > 0
    free = int(judged.sum()) - 2 * groups - N_STATE
    scale = float((left * left * fit.per_var) @ judged) / max(free, 1)
    shifts = profiles_.shifts(fit, measured_at)
    tau2, rms = _edge_variance(shifts, fit.accepted, delta, scale, state, options)
    grow = _growth(fit, measured_at.samples) * scale
    H = fit.H / grow
    cov = solver.covariance(state, H)
    pull = cov @ (shifts.pull / grow)
    cov = cov + tau2 * (pull @ pull.T)
    evidence, inliers = profile_support(fit, measured_at, mix, noise)
    if mix.mix[EdgeKind.RING].any():
        amplitude, sigma = profiles_.arrow_amplitude(state, measured_at, pad, mixed)
        evidence[EdgeKind.ARROW] = arrow_support(
            amplitude, sigma, mix.contrast[EdgeKind.RING], float(measured_at.in_view[EdgeKind.ARROW])
        )
    size2 = (mix.mix * mix.mix).sum(axis=1)
    shown = (noise.max(axis=1) < 1.0) & (size2 > 0.0)
    noise_light = math.sqrt(float((noise.mean(axis=1)[shown] / size2[shown]).mean())) if shown.any() else 0.0
    visible, arrow = float(measured_at.in_view.mean()), evidence[EdgeKind.ARROW].seen
    return _Solved(state, H, cov, evidence, noise_light, rms, visible, inliers, moved, arrow, False, False)


def _edge_variance(
    shifts: profiles_.Shifts,
    accepted: NDArray[np.bool_],
    delta: F64,
    noise: float,
    state: RegistrationState,
    options: RegistrationOptions,
) -> tuple[float, float]:
    """Return the variance (px^2) of edges' places that neither noise nor pose explains, and the square root of the measured part.

    Source: DerSimonian & Laird, Meta-analysis in clinical trials, Controlled Clinical Trials 7(3), 1986.
    """
    on = accepted & (shifts.information > 1.0)
    floor = options.edge_sigma_px**2 + (options.edge_sigma_m / state.m_per_px) ** 2
    n = int(on.sum())
    if n <= N_STATE:
        return floor, 0.0
    left = shifts.px[on] - (delta @ shifts.pull[:, on]) / shifts.information[on]
    w, shift = shifts.information[on] / noise, np.minimum(np.maximum(left, -2.0), 2.0)
    # Noise contributes n - 9; the rest comes from the drawing.
    excess = float(w @ (shift * shift)) - (n - N_STATE)
    tau2 = max(0.0, excess / (float(w.sum()) * (1.0 - N_STATE / n)))
    return max(floor, tau2), math.sqrt(tau2)


def _growth(fit: profiles_.ProfileFit, samples: int) -> float:
    """Return the factor, at least 1, on the covariance for residuals that the pixels of a profile share, from sums of scores.

    Source: Liang & Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73(1), 1986.
    """
    scores = fit.Jw[:N_POSE] * fit.residual
    per = 1.0 / np.maximum(np.diag(fit.H)[:N_POSE], 1e-300)
    each = scores.reshape(-1, samples) @ np.ones(samples)
    scores *= scores
    each *= each
    alone = float(per @ scores.sum(axis=1))
    together = float(per @ each.reshape(N_POSE, -1).sum(axis=1))
    return max(1.0, together / alone) if alone > 0 else 1.0


@lru_cache(maxsize=8)
def _outline(pad: Pad) -> tuple[F64, tuple[slice, ...]]:
    """Return (M, 3) m points of the edges, and the slice of each kind."""
    edges = edges_of(pad)
    at = edges.at_m[::4]
    borders = np.searchsorted(edges.kind[::4], np.arange(len(EdgeKind) + 1)).tolist()
    return np.c_[at, np.zeros(len(at))], tuple(slice(a, b) for a, b in pairwise(borders))


def _arrow_is_opposite(inputs: Inputs, camera: Camera, pad: Pad, state: RegistrationState) -> bool:
    if not _opposite_in_view(camera, pad, state):
        return False
    at = _packed(state)
    return bool(_OPPOSITE(*inputs.frame, inputs.options, address(at), *inputs.room))


def _opposite_in_view(camera: Camera, pad: Pad, state: RegistrationState) -> bool:
    """Return whether a corner of an arrowhead turned by 180 degrees, or its middle, lies in the frame."""
    corners = -pad.arrowhead()[:, :2]
    at = np.concatenate([corners, corners.mean(axis=0, keepdims=True)]) @ state.R[:, :2].T + state.t
    uv = camera.project(at)
    with np.errstate(invalid="ignore"):
        return bool(((uv > 0.0) & (uv < (camera.width, camera.height))).all(axis=1).any())


def _result(solved: _Solved, camera: Camera, pad: Pad, prior: Orientation | None) -> Registration | None:
    state = solved.state
    cov9, H = solved.cov, solved.H
    if not math.isfinite(float(cov9.sum() + state.t.sum())) or float(state.R[:, 2] @ state.t) <= 0:
        return None
    # The blur is uncertain too, so it is eliminated and not held constant.
    blur = H[6:, 6:] + np.eye(3) * WEAK_BLUR_PX2**-2
    information = H[:6, :6] - H[:6, 6:] @ inverse(blur) @ H[6:, :6]
    pose = state.pose
    T = np.zeros((6, 6))
    T[:3, :3] = T[3:, 3:] = pose.R_cam_pad.matrix
    cov, information = T @ cov9[:6, :6] @ T.T, T @ information @ T.T
    judged = {kind: e.beside(kind, pad) for kind, e in solved.edges.items()}
    points, of_kind = _outline(pad)
    outline = camera.project(pose.points(points))
    turn = pose.R_cam_pad.matrix[:2, :2]
    b = state.blur_px2
    in_image = turn @ np.array([[b[0], b[1]], [b[1], b[2]]]) @ turn.T
    return Registration(
        pose, 0.5 * (cov + cov.T), 0.5 * (information + information.T), prior, MappingProxyType(judged),
        not solved.arrow_seen, np.array([in_image[0, 0] - 1 / 12, in_image[0, 1], in_image[1, 1] - 1 / 12]),
        solved.noise_light, solved.edge_rms_px, solved.visible, solved.inliers, solved.last_step_px, solved.dense,
        tuple(outline[part] for part in of_kind),
    )  # fmt: skip
