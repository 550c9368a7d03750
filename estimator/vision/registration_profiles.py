"""Registration of a large picture of the pad: short profiles of whole pixels across the edges, paints found anew along them.

Pixels are taken as they are, never interpolated, each with its exact place on the drawing: their noise stays independent and
no blur is added. Profiles that follow one another along an edge form a group with its own two light levels, so neither
uneven light nor the surroundings' pattern pulls an edge aside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.drawing import EdgeKind, Edges
from estimator.vision.pad import Pad
from estimator.vision.registration_state import N_STATE, U8, State, light_table, pixel_rays
from estimator.vision.registration_whole import TUKEY, median

KINDS = len(EdgeKind)
_IN_GROUP = 6
_MIN_SPACING_PX = 1.3
_STILL_OFF_PX = 0.1
_CONTRAST_RATIO = (0.4, 2.5)
"""Contrast of a group against its kind's median: what shade, sun and wear can do to paint, and a stranger's edge cannot."""


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Pixels across edges, kinds together, groups together."""

    rays: F64
    """(N, 2)."""
    light: F64
    """(3, N) BGR linear light."""
    usable: F64
    """(N,) 0 for a pixel taken twice or one that sees a third paint."""
    samples: int
    """Pixels of a profile: N = profiles * samples."""
    uv_px: F64
    """(P, 2) where the drawing's edge points were expected."""
    kind_parts: tuple[slice, ...]
    """Of the N pixels, for each `EdgeKind`."""
    starts: NDArray[np.intp]
    """(G,) first pixel of each group."""
    sizes: NDArray[np.intp]
    """(G,) pixels of each group."""
    group_kind: NDArray[np.intp]
    """(G,)."""
    in_view: F64
    """(KINDS,) share of each kind's edges that lies in the picture."""


def sample(
    px: U8, camera: Camera, pad: Pad, edges: Edges, state: State, max_profiles: int, half: int, gamma: bool
) -> Profiles | None:
    """Profiles of 2 * half + 1 pixels across the edges in view; None when there are too few to fix anything."""
    R, t = state.R, state.t
    here = edges.at_m @ R[:, :2].T + t
    step = 1e-4
    z = here[:, 2]
    if camera.distorted:
        uv = camera.project(here)
        out = camera.project(here + edges.normal @ R[:, :2].T * step) - uv
    else:
        with np.errstate(all="ignore"):
            per = 1.0 / np.where(z > 0.02, z, np.nan)
            way = edges.normal @ R[:, :2].T
            focal = np.array([camera.fx, camera.fy])
            uv = here[:, :2] * per[:, None] * focal + (camera.cx, camera.cy)
            out = (way[:, :2] - here[:, :2] * (way[:, 2] * per)[:, None]) * (per[:, None] * focal) * step
    margin = half + 1.0
    with np.errstate(invalid="ignore"):
        seen = (uv[:, 0] > margin) & (uv[:, 0] < camera.width - 1 - margin)
        seen &= (uv[:, 1] > margin) & (uv[:, 1] < camera.height - 1 - margin)
    total = np.bincount(edges.kind, minlength=KINDS)
    in_view = np.bincount(edges.kind[seen], minlength=KINDS) / np.maximum(total, 1)
    at = np.nonzero(seen)[0]
    if len(at) < 8:
        return None
    px_per_m = np.hypot(out[at, 0], out[at, 1]) / step
    way_px = np.cumsum(edges.spacing_m[at] * px_per_m)
    spacing = max(_MIN_SPACING_PX, float(way_px[-1]) / max_profiles)
    ticks = np.floor(way_px / spacing)
    at = at[np.diff(ticks, prepend=-1.0) > 0]
    uv, out = uv[at], out[at]

    k = np.arange(-half, half + 1)
    steep = np.abs(out[:, 1]) > np.abs(out[:, 0])
    along = np.where(steep, out[:, 1], out[:, 0])
    per = 1.0 / np.where(np.abs(along) > 1e-9, along, 1e-9)
    u = np.rint(uv[:, :1] + k * (out[:, :1] * per[:, None])).astype(np.intp).ravel()
    v = np.rint(uv[:, 1:] + k * (out[:, 1:] * per[:, None])).astype(np.intp).ravel()
    flat = v * camera.width + u
    owner = np.empty(int(flat.max()) + 1, np.int32)
    mine = np.arange(len(flat), dtype=np.int32)
    owner[flat] = mine
    usable = (owner[flat] == mine).astype(float)
    light = np.ascontiguousarray(light_table(gamma)[px.reshape(-1, 3)[flat]].T)
    rays = pixel_rays(camera, u, v)

    kind, piece = edges.kind[at], edges.piece[at]
    first = np.nonzero(np.diff(piece, prepend=-1))[0]
    rank = np.arange(len(at)) - np.repeat(first, np.diff(first, append=len(at)))
    begins = np.nonzero(rank % _IN_GROUP == 0)[0]
    n = 2 * half + 1
    borders = np.searchsorted(kind, np.arange(KINDS + 1)) * n
    starts = begins * n
    profiles = Profiles(
        rays, light, usable, n, uv, tuple(slice(int(a), int(b)) for a, b in pairwise(borders)),
        starts, np.diff(starts, append=len(flat)), kind[begins], in_view,
    )  # fmt: skip
    profiles.usable[_foreign(state, profiles, pad)] = 0.0
    return profiles


def _foreign(state: State, profiles: Profiles, pad: Pad) -> NDArray[np.bool_]:
    """(N,) pixels within three sigmas of an edge of another kind."""
    places = state.footprint(profiles.rays, pad).places
    x, y = np.abs(places.x), np.abs(places.y)
    r = np.hypot(x, y)
    clear = 3.0 * state.sigma_px * state.m_per_px
    field = pad.disc_radius_m - pad.rim_width_m
    out = np.zeros(len(r), np.bool_)
    disc, ring, arrow, h = profiles.kind_parts
    out[disc] = r[disc] < pad.ring_outer_m + clear
    tip = (places.x[disc] > 0) & (r[disc] < pad.arrow_tip_m + clear) & (y[disc] < pad.arrow_half_base_m + clear)
    out[disc] |= tip
    if pad.rim_width_m:
        # Where no pixel sees the rim alone, its inner edge is not to be told from its outer one.
        out[disc] |= (r[disc] > pad.disc_radius_m - clear) | (pad.rim_width_m < 2.0 * clear)
    out[ring] = (r[ring] > field - clear) | ((x[ring] < pad.h_length_m / 2 + clear) & (y[ring] < pad.h_width_m / 2 + clear))
    out[arrow] = r[arrow] > field - clear
    out[h] = r[h] > pad.ring_inner_m - clear
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """For each kind the sum of colour channels that tells its two paints apart best, and its noise."""

    mix: F64
    """(KINDS, 3): of light; contrast 1 between the paints."""
    contrast: F64
    """(KINDS, 3) BGR light, inside less outside."""
    var: F64
    """(KINDS, 2) of the mixed light, outside and inside."""


@dataclass(frozen=True, slots=True, eq=False)
class ProfileFit:
    """One linearisation."""

    H: F64
    """(9, 9) information, light levels eliminated."""
    g: F64
    """(9,)."""
    residual: F64
    """(N,) mixed light less the model's."""
    per_var: F64
    """(N,) one over the variance that was taken for it."""
    share: F64
    """(N,) of the paint inside."""
    J: F64
    """(9, N) change of the model with the state, light levels held."""
    levels: F64
    """(2, 9, G) change of a group's light outside and contrast that makes up best for a change of the state."""
    weight: F64
    """(N,) robust weight 0..1, of usable pixels in accepted groups."""
    contrast: F64
    """(G,) of each group in units of its kind's."""
    level: F64
    """(G,) mixed light outside."""
    accepted: NDArray[np.bool_]
    """(G,)."""
    scores: F64
    """(9, N) the gradient's summands."""
    shift: F64
    """(G,) px by which each group's edge lies outside of where the fit has it."""
    shift_information: F64
    """(G,) px^-2."""
    shift_pull: F64
    """(9, G) how a shift of a group by one px pulls at the gradient."""


def shares(state: State, profiles: Profiles, pad: Pad) -> tuple[F64, F64, F64]:
    """(N,) share of the paint inside, (9, N) its change with the state, (N,) its change as the edge moves outward by one px."""
    fp = state.footprint(profiles.rays, pad)
    disc, _, arrow, h = profiles.kind_parts
    n = len(profiles.usable)
    value, d = np.empty(n, np.float32), np.empty((5, n), np.float32)
    round_ = slice(0, arrow.stop)
    radii = np.empty((2, arrow.stop), np.float32)
    radii[:, disc] = ((pad.disc_radius_m - pad.rim_width_m,), (0.0,))
    radii[:, disc.stop :] = ((pad.ring_outer_m,), (pad.ring_inner_m,))
    (outer, d_outer), (inner, d_inner) = fp.part(round_).circles(*radii)
    np.subtract(outer, inner, out=value[round_])
    np.subtract(d_outer, d_inner, out=d[:, round_])
    if arrow.stop > arrow.start:
        head, d_head = fp.part(arrow).arrow((outer[arrow], d_outer[:, arrow]))
        value[arrow] += head
        d[:, arrow] += d_head
    value[h], d[:, h] = fp.part(h).h()
    steepness = np.sqrt(d[0] * d[0] + d[1] * d[1]) * (state.m_per_px * np.sqrt(fp.places.scale2))
    return value.astype(float), fp.jacobian(d).astype(float), steepness.astype(float)


def channels(profiles: Profiles, share: F64) -> Channels:
    """The mix of colours of each kind, from all its pixels together."""
    mix, contrast = np.zeros((KINDS, 3)), np.zeros((KINDS, 3))
    for kind, part in enumerate(profiles.kind_parts):
        s, w = share[part], profiles.usable[part]
        total = float(w.sum())
        if total < 8:
            continue
        light = profiles.light[:, part]
        mean_s, mean = float(w @ s) / total, light @ w / total
        ds = (s - mean_s) * w
        c = (light @ ds) / max(float(ds @ (s - mean_s)), 1e-9)
        per_var = 1.0 / (mean + 0.02)
        norm = float(c * c @ per_var)
        if norm < 1e-6:
            continue
        contrast[kind], mix[kind] = c, c * per_var / norm
    if mix[EdgeKind.RING].any():
        # Arrowhead and ring are one paint; where no arrowhead is, none must be made out of the ring.
        contrast[EdgeKind.ARROW], mix[EdgeKind.ARROW] = contrast[EdgeKind.RING], mix[EdgeKind.RING]
    return Channels(mix, contrast, np.full((KINDS, 2), np.nan))


def fit(
    state: State, profiles: Profiles, pad: Pad, mixed: F64, noise: F64 | None, known: tuple[F64, F64, F64] | None = None
) -> ProfileFit:
    """One linearisation.

    Args:
        mixed: (N,) light through `Channels.mix`.
        noise: (KINDS, 2) variance outside and inside; None at first.
        known: `shares` of this state, where they have been worked out already; changed.
    """
    s, J, per_px = known if known is not None else shares(state, profiles, pad)
    starts, sizes = profiles.starts, profiles.sizes
    n = len(s)
    if noise is None:
        per_var = np.ones(n)
    else:
        per_var = np.empty(n)
        for kind, part in enumerate(profiles.kind_parts):
            per_var[part] = 1.0 / (noise[kind, 0] + (noise[kind, 1] - noise[kind, 0]) * np.clip(s[part], 0.0, 1.0))
    w = profiles.usable * per_var
    robust = np.ones(n)
    for round_ in range(2):
        ws = w * s
        W, S, Y, SS, SY = np.add.reduceat(np.stack([w, ws, w * mixed, ws * s, ws * mixed]), starts, axis=1)
        W = W + 1e-9
        spread = SS - S * S / W
        B = (SY - S * Y / W) / np.maximum(spread, 1e-6 * W)
        A = (Y - B * S) / W
        r = mixed - np.repeat(A, sizes) - np.repeat(B, sizes) * s
        if round_ == 1:
            break
        if noise is None:
            first = _noise(r, s, profiles.usable, profiles)
            for kind, part in enumerate(profiles.kind_parts):
                per_var[part] = 1.0 / float(first[kind].max())
        else:
            # The state may still be off by a little: what that makes of an edge is no outlier.
            aside = _STILL_OFF_PX * np.repeat(np.minimum(np.abs(B), 2.0), sizes) * per_px
            u = np.maximum(1.0 - r * r / (TUKEY**2 * (1.0 / per_var + aside * aside)), 0.0)
            robust = u * u
        w = profiles.usable * per_var * robust
    accepted = (_CONTRAST_RATIO[0] < B) & (_CONTRAST_RATIO[1] > B) & (spread > 0.02 * W)
    on = np.repeat(accepted, sizes)
    w = np.where(on, w, 0.0)
    each_B = np.repeat(B, sizes)
    J *= each_B
    Jw = J * w
    # How much lighter a pixel gets when the edge moves outward by one px.
    per_px = each_B * per_px
    pw = per_px * w
    sums = np.add.reduceat(np.concatenate([Jw, Jw * s, Jw * per_px, np.stack([pw, pw * s, pw * per_px, pw * r])]), starts, axis=1)
    C0, C1, CP = sums[:N_STATE], sums[N_STATE : 2 * N_STATE], sums[2 * N_STATE : 3 * N_STATE]
    p0, p1, pp, pr = sums[3 * N_STATE :]
    det = 1.0 / np.maximum(W * SS - S * S, 1e-12)
    M00, M01, M11 = SS * det, -S * det, W * det
    cross = (C0 * M01) @ C1.T
    H = Jw @ J.T - (C0 * M00) @ C0.T - (C1 * M11) @ C1.T - cross - cross.T
    q0, q1 = M00 * p0 + M01 * p1, M01 * p0 + M11 * p1
    information = np.maximum(pp - p0 * q0 - p1 * q1, 0.0)
    shift = np.where(information > 1e-6, pr / np.maximum(information, 1e-6), 0.0)
    scores = Jw * r
    weight = profiles.usable * robust * on
    pull = CP - C0 * q0 - C1 * q1
    levels = np.stack([C0 * M00 + C1 * M01, C0 * M01 + C1 * M11])
    return ProfileFit(
        H, scores.sum(axis=1), r, per_var, s, J, levels, weight, B, A, accepted, scores, shift, information, pull,
    )  # fmt: skip


def residual_after(fit: ProfileFit, profiles: Profiles, delta: F64) -> F64:
    """(N,) what the linearisation expects to be left of the residuals after a step (9,)."""
    a, b = delta @ fit.levels
    return np.asarray(fit.residual - delta @ fit.J + np.repeat(a, profiles.sizes) + np.repeat(b, profiles.sizes) * fit.share)


def noise_after(fit: ProfileFit, profiles: Profiles, delta: F64) -> F64:
    """(KINDS, 2) variance on either side of the edges once a step (9,) has been made."""
    return _noise(residual_after(fit, profiles, delta), fit.share, fit.weight, profiles)


def _noise(r: F64, s: F64, weight: F64, profiles: Profiles) -> F64:
    """(KINDS, 2) variance on either side of the edges, from residuals."""
    out = np.empty((KINDS, 2))
    for kind, part in enumerate(profiles.kind_parts):
        q, inside, w = r[part] ** 2, np.clip(s[part], 0.0, 1.0), weight[part] > 0
        count = int(w.sum())
        if count < 12:
            out[kind] = 1.0
            continue
        q, inside = q[w], inside[w]
        # Each group has spent two of its pixels on its light levels.
        spent = 2 * int((profiles.group_kind == kind).sum())
        robust_var = median(q) / 0.4549
        good = q < 9.0 * robust_var
        q, inside = q[good], inside[good]
        grow = count / max(count - spent, 1)
        for side, share in enumerate((1.0 - inside, inside)):
            total = float(share.sum())
            out[kind, side] = grow * max(float(q @ share) / total, 0.05 * robust_var) if total > 4 else grow * robust_var
    return np.maximum(out, 1e-9)


def arrow_amplitude(state: State, profiles: Profiles, pad: Pad, mixed: F64) -> tuple[float, float]:
    """How much of an arrowhead there is beside the ring's stroke, and its sigma; 1 is a whole one, (0, inf) when out of view."""
    part = profiles.kind_parts[EdgeKind.ARROW]
    w = profiles.usable[part]
    if float(w.sum()) < 12:
        return 0.0, math.inf
    b = state.footprint(profiles.rays[part], pad).places
    outer, inner = b.circles(pad.ring_outer_m, pad.ring_inner_m)
    ring = (outer[0] - inner[0]).astype(float)
    arrow = b.arrow(outer)[0].astype(float)
    columns = np.stack([np.ones_like(ring), ring, arrow])
    M = (columns * w) @ columns.T + 1e-6 * np.eye(3)
    a = np.linalg.solve(M, (columns * w) @ mixed[part])
    r = (mixed[part] - a @ columns) * w
    var = float(r @ r) / max(1.0, float(w.sum()) - 3.0) * float(np.linalg.inv(M)[2, 2])
    return float(a[2]), math.sqrt(var)


def spacing_ok(state: State, pad: Pad) -> bool:
    """Whether edges of different kinds are far enough apart for profiles."""
    gap = min(
        pad.disc_radius_m - pad.rim_width_m - pad.arrow_tip_m, pad.ring_inner_m - math.hypot(pad.h_length_m, pad.h_width_m) / 2
    )
    return gap > 4.5 * state.sigma_px * state.m_per_px
