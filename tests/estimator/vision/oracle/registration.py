"""Register the known drawing of the pad with a frame, until the model explains every pixel near an edge.

This is maximum likelihood over pose, blur, paints and noise at once (analysis by synthesis): the expected light of a pixel is the
sum of the paints' lights times the coverage of the blurred pixel by each. Blur and neighbouring edges are part of the model, so
they do not bias the pose. Linear unknowns (paints) are eliminated in each linearisation (variable projection: Golub & Pereyra,
SIAM J. Numer. Anal. 10, 1973); robust weights are Tukey's. A near pad uses profiles across the edges, a distant one the whole
disc.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, approach
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.drawing import EdgeKind, edges_of
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import EdgeSupport, Registration, RegistrationOptions
from tests.estimator.vision.oracle import dense
from tests.estimator.vision.oracle import profiles as profiles_
from tests.estimator.vision.oracle.edge_support import arrow_support, beside, dense_support, profile_support
from tests.estimator.vision.oracle.sampling import sample
from tests.estimator.vision.oracle.solver import WEAK_BLUR_PX2, Solver, TiltTarget, depth_in_view, difference, inverse
from tests.estimator.vision.oracle.state import N_POSE, N_STATE, U8, RegistrationState

_NOISE_DOUBTED = 5e-4
"""Limit on the variance of smoothed light over light: four times that of worn paint on a patchy deck. More means an object on the
pad.
"""
_KNOWN_LEAST, _RIGHT_WEIGHT = 1.0, 2.0
"""Information on a sector's place, 1/px^2 over the noise's factor, from which on it counts, and the weight of no displacement."""
_EDGE_DOUBTED_PX = 2.0
"""Sigma of the distant disc's edges in that case: hiding half of the disc moves it this far."""


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
    pose = start
    if options.coarse:
        sigma = SIGMA_TILT_RAD if prior is not None and prior.measured else SIGMA_TILT_FREE_RAD
        pose = approach(Pyramid(px), camera, pad, start, sigma) or start
    state = RegistrationState.of(pose, camera, options.blur_px, depth_in_view(pose, camera))
    solved = _refine(px, camera, pad, state, tilt, options)
    if solved is None:
        return None
    if not (solved.arrow_seen or solved.doubted) and _arrow_is_opposite(px, camera, pad, solved.state, options):
        turned = replace(solved.state, R=solved.state.R @ np.diag([-1.0, -1.0, 1.0]))
        again = _refine(px, camera, pad, turned, tilt, options)
        if again is not None and again.arrow_seen:
            solved = again
    return _result(solved, camera, pad, prior)


def _refine(
    px: U8, camera: Camera, pad: Pad, state: RegistrationState, tilt: TiltTarget | None, options: RegistrationOptions
) -> _Solved | None:
    radius_px = pad.disc_radius_m / state.m_per_px
    small = (2 * radius_px + 8) ** 2 <= options.dense_pixels
    if not small and profiles_.spacing_ok(state, pad):
        solved = _by_profiles(px, camera, pad, state, tilt, options)
        if solved is None or (isinstance(solved, _Solved) and profiles_.spacing_ok(solved.state, pad)):
            return solved
        if isinstance(solved, _Solved):
            state = solved.state
        elif profiles_.spacing_ok(solved, pad):
            return None
    return _dense_fit(px, camera, pad, state, tilt, options)


def _dense_fit(
    px: U8, camera: Camera, pad: Pad, state: RegistrationState, tilt: TiltTarget | None, options: RegistrationOptions
) -> _Solved | None:
    got = dense.patch(px, camera, pad, state, 1.5 + 3.0 * state.sigma_px, options.dense_pixels, options.gamma, exact=True)
    if got is None:
        return None
    cut, state = got
    solver = Solver(state, tilt, pad, distant=True)
    fit: dense.DenseFit | None = None
    moved = math.inf
    grown = 0.0
    for n in range(12):
        # The pose depends on the blur: it may stop for a step while the blur still changes.
        final = (n >= 1 and moved < 0.02 and grown < 0.04) or n == 11
        fit = dense.fit(state, cut, pad, fit, options.dense_edge_sigma_px, final)
        last, H, g = state, fit.H, fit.g
        if final:
            # These correspond to the robust covariance: by the plain ones the frame would count too much against the prior.
            spread = np.diag(fit.H)
            outward = fit.pull[:, ::2].sum(axis=1) * (pad.size_sigma_m / state.m_per_px)
            meat = fit.meat + _edge_variance_far(fit, options) * (fit.pull @ fit.pull.T) + np.outer(outward, outward)
            H, g = np.split(fit.H @ np.linalg.solve(meat + 1e-9 * np.diag(spread), np.c_[fit.H, fit.g]), [N_STATE], axis=1)
            g = g[:, 0]
        state, moved = solver.step(state, H, g, 1.5, blur_too=n > 0)
        grown = abs(state.sigma_px - last.sigma_px)
        if final:
            turn = np.eye(N_STATE)
            turn[:3, :3] = turn[3:6, 3:6] = state.R.T @ last.R
            H = turn @ H @ turn.T
            break
    assert fit is not None
    if not float(np.diag(fit.H).min()) > 0.0:
        return None
    doubted = min(fit.noise, fit.noise_on_pad) > _NOISE_DOUBTED
    cov = solver.covariance(state, H) + (_doubt(state, pad) if doubted else 0.0)
    arrow = dense.arrow_amplitudes(state, cut, pad, fit)
    seen = arrow is not None and arrow[0] - arrow[1] > max(0.5, 4.0 * arrow[2])
    edges, inliers = dense_support(fit, arrow)
    if doubted:
        inliers *= 0.5
    visible = float(np.mean([e.in_view for e in edges.values()]))
    noise = math.sqrt(fit.noise * 0.5 / dense.NOISE_LEFT)
    state = state.restored(cut.reduced, dense.SMOOTHING_PX2)
    return _Solved(state, H, cov, edges, noise, 0.0, visible, inliers, moved * cut.reduced, seen and not doubted, doubted, True)


def _by_profiles(
    px: U8, camera: Camera, pad: Pad, state: RegistrationState, tilt: TiltTarget | None, options: RegistrationOptions
) -> _Solved | RegistrationState | None:
    """Return the solution; the state alone if hardly an edge agrees with it."""
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
        return state
    judged = fit.weight > 0
    free = int(judged.sum()) - 2 * groups - N_STATE
    scale = float((left * left * fit.per_var) @ judged) / max(free, 1)
    shifts = profiles_.shifts(fit, measured_at)
    tau2, rms = _edge_variance(shifts, fit.accepted, delta, scale, options)
    grow = _growth(fit, measured_at.samples) * scale
    H = fit.H / grow
    cov = solver.covariance(state, H)
    pull = cov @ (shifts.pull / grow)
    size = pad.size_sigma_m / state.m_per_px * (pull @ measured_at.of_kind)
    cov = cov + tau2 * (pull @ pull.T) + size @ size.T
    evidence, inliers = profile_support(fit, measured_at, mix, noise)
    if mix.mix[EdgeKind.RING].any():
        amplitude, sigma = profiles_.arrow_amplitude(state, measured_at, pad, mixed)
        evidence[EdgeKind.ARROW] = arrow_support(
            amplitude, sigma, mix.contrast[EdgeKind.RING], float(measured_at.in_view[EdgeKind.ARROW])
        )
    size2 = (mix.mix * mix.mix).sum(axis=1)
    shown = (noise[:, 2] < 1.0) & (size2 > 0.0)
    noise_light = math.sqrt(float((noise[shown, 2] / size2[shown]).mean())) if shown.any() else 0.0
    visible, arrow = float(measured_at.in_view.mean()), evidence[EdgeKind.ARROW].seen
    return _Solved(state, H, cov, evidence, noise_light, rms, visible, inliers, moved, arrow, False, False)


def _edge_variance(
    shifts: profiles_.Shifts,
    accepted: NDArray[np.bool_],
    delta: F64,
    noise: float,
    options: RegistrationOptions,
) -> tuple[float, float]:
    """Return the variance (px^2) of edges' places that neither noise nor pose explains, and the square root of the measured part.

    Source: DerSimonian & Laird, Meta-analysis in clinical trials, Controlled Clinical Trials 7(3), 1986.
    """
    on = accepted & (shifts.information > 1.0)
    floor = options.edge_sigma_px**2
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


def _edge_variance_far(fit: dense.DenseFit, options: RegistrationOptions) -> float:
    """Return the variance (px^2) of the sectors' places that neither noise nor pose explains."""
    least = options.dense_edge_sigma_px**2
    noise = float((np.diag(fit.meat)[:3] / np.diag(fit.H)[:3]).mean())
    score, known = fit.place[:, fit.place[1] > _KNOWN_LEAST * noise]
    n, free = len(known), len(known) - N_STATE
    if free <= 0:
        return least
    seen = max(0.0, (float((score**2 / known).sum()) - noise * free) / (float(known.sum()) * free / n))
    return free * seen / (_RIGHT_WEIGHT + free) + least


def _doubt(state: RegistrationState, pad: Pad) -> F64:
    """Return the (9, 9) covariance of sectors and strokes that may lie anywhere within some pixels."""
    sigma_m = _EDGE_DOUBTED_PX * state.m_per_px
    out = np.zeros((N_STATE, N_STATE))
    out[0, 0] = out[1, 1] = sigma_m**2 / 4.0
    along = np.append(state.line_of_sight, 1.0) * sigma_m * state.depth_m / pad.disc_radius_m
    out[:3, :3] += np.outer(along, along) / 8.0
    out[5, 5] = (sigma_m / (0.5 * pad.markings.h_length_m)) ** 2
    return out


def _arrow_is_opposite(px: U8, camera: Camera, pad: Pad, state: RegistrationState, options: RegistrationOptions) -> bool:
    if not _opposite_in_view(camera, pad, state):
        return False
    got = dense.patch(px, camera, pad, state, 3.0, options.dense_pixels, options.gamma, exact=True)
    if got is None:
        return False
    cut, coarse = got
    fit = dense.fit(coarse, cut, pad, None, options.dense_edge_sigma_px)
    arrow = dense.arrow_amplitudes(coarse, cut, pad, fit)
    return arrow is not None and arrow[1] - arrow[0] > max(0.5, 4.0 * arrow[2])


def _opposite_in_view(camera: Camera, pad: Pad, state: RegistrationState) -> bool:
    """Return whether a corner of an arrowhead turned by 180 degrees, or its middle, lies in the frame."""
    corners = -pad.markings.arrowhead()[:, :2]
    at = np.concatenate([corners, corners.mean(axis=0, keepdims=True)]) @ state.R[:, :2].T + state.t
    uv = camera.project(at)
    with np.errstate(invalid="ignore"):
        return bool(((uv > 0.0) & (uv < (camera.width, camera.height))).all(axis=1).any())


def _result(solved: _Solved, camera: Camera, pad: Pad, prior: Orientation | None) -> Registration | None:
    state = solved.state
    cov9, H = solved.cov, solved.H
    if not math.isfinite(float(cov9.sum() + state.t.sum())) or float(state.R[:, 2] @ state.t) <= 0:
        return None
    if np.linalg.eigvalsh(cov9[:6, :6])[0] <= 0.0:
        return None
    # The blur is uncertain too, so it is eliminated and not held constant.
    blur = H[6:, 6:] + np.eye(3) * WEAK_BLUR_PX2**-2
    information = H[:6, :6] - H[:6, 6:] @ inverse(blur) @ H[6:, :6]
    pose = state.pose
    T = np.zeros((6, 6))
    T[:3, :3] = T[3:, 3:] = pose.R_cam_pad.matrix
    cov, information = T @ cov9[:6, :6] @ T.T, T @ information @ T.T
    judged = {kind: beside(e, kind, pad) for kind, e in solved.edges.items()}
    turn = pose.R_cam_pad.matrix[:2, :2]
    b = state.blur_px2
    in_image = turn @ np.array([[b[0], b[1]], [b[1], b[2]]]) @ turn.T
    return Registration(
        pose, 0.5 * (cov + cov.T), 0.5 * (information + information.T), prior, MappingProxyType(judged),
        not solved.arrow_seen, np.array([in_image[0, 0] - 1 / 12, in_image[0, 1], in_image[1, 1] - 1 / 12]),
        solved.noise_light, solved.edge_rms_px, solved.visible, solved.inliers, solved.last_step_px, solved.dense,
    )  # fmt: skip
