"""Registration of a large image of the pad: short profiles of whole pixels across the edges.

The paints are estimated along the profiles. Consecutive profiles along an edge form a group with its own two light levels, so
neither uneven light nor the pattern of the surroundings biases an edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad import Pad
from tests.estimator.vision.oracle.dense import TUKEY, median
from tests.estimator.vision.oracle.sampling import KINDS, Profiles
from tests.estimator.vision.oracle.solver import inverse
from tests.estimator.vision.oracle.state import N_STATE, Footprint, RegistrationState

_STILL_OFF_PX = 0.1
_CONTRAST_RATIO = (0.4, 2.5)
"""Limits on a group's contrast relative to its kind's median: shade, sun and wear stay within them, a foreign edge does not."""


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """Weights of the colour channels that separate the two paints of each kind of edge best."""

    mix: F64
    """Channel weights, (KINDS, 3); the contrast between the paints is 1."""
    contrast: F64
    """Light inside minus outside, (KINDS, 3) BGR."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverages:
    """Coverage of the pixels by the paint inside their edge, at a given state."""

    coverage: F64
    """Coverage by the paint inside, (N,)."""
    J: F64
    """Derivative of the coverage by the state, (9, N)."""
    per_px: F64
    """Change of the coverage as the edge moves outward by one px, (N,)."""


@dataclass(frozen=True, slots=True, eq=False)
class ProfileFit:
    """One linearisation."""

    H: F64
    """Information matrix with the light levels eliminated, (9, 9)."""
    g: F64
    """Gradient, (9,)."""
    residual: F64
    """Mixed light minus the model's, (N,)."""
    per_var: F64
    """Inverse of the variance assumed for the residual, (N,)."""
    w: F64
    """Weight of a pixel, (N,): `per_var` times its robust weight; 0 if it does not count."""
    coverages: Coverages
    J: F64
    """Derivative of the model by the state at constant light levels, (9, N)."""
    Jw: F64
    """The same, weighted, (9, N)."""
    sums: F64
    """Sums of weighted derivatives, and of them times coverage, over each group, (2, 9, G)."""
    levels: F64
    """Change of a group's outside light and contrast that best compensates a change of the state, (2, 9, G)."""
    inverse: tuple[F64, F64, F64]
    """Elements of the covariance of a group's outside light and contrast, (G,) each."""
    weight: F64
    """Robust weight, (N,), 0..1, of usable pixels in accepted groups."""
    contrast: F64
    """Contrast of each group in units of its kind's, (G,)."""
    accepted: NDArray[np.bool_]
    """Mask of the groups that count, (G,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Shifts:
    """The displacement of each group's edge."""

    px: F64
    """Distance by which the edge lies outside of its fitted place, (G,)."""
    information: F64
    """Information on that distance, (G,) px^-2."""
    pull: F64
    """Effect on the gradient of a shift of a group by one px, (9, G)."""


def coverages(state: RegistrationState, profiles: Profiles, pad: Pad, fp: Footprint | None = None) -> Coverages:
    """Return the coverage at a state; `fp` is the footprint, if already computed."""
    if fp is None:
        fp = state.footprint(profiles.rays, pad)
    value, d, _ = fp.places.edge_coverages(*profiles.kind_parts)
    steepness = d[0] * d[0]
    steepness += d[1] * d[1]
    steepness *= fp.places.scale2
    np.sqrt(steepness, out=steepness)
    steepness *= state.m_per_px
    return Coverages(value.astype(float), fp.jacobian(d).astype(float), steepness.astype(float))


def channels(profiles: Profiles, coverage: F64) -> Channels:
    """Return the mix of colours of each kind, from all its pixels together."""
    w = profiles.usable
    rows = np.empty((9, len(w)))
    rows[0] = w
    np.multiply(w, coverage, out=rows[1])
    np.multiply(rows[1], coverage, out=rows[2])
    np.multiply(profiles.light, w, out=rows[3:6])
    np.multiply(profiles.light, rows[1], out=rows[6:])
    sums = np.add.reduceat(rows, profiles.starts, axis=1) @ profiles.of_kind
    total = np.maximum(sums[0], 1e-9)
    mean = sums[3:6] / total
    c = (sums[6:] - mean * sums[1]) / np.maximum(sums[2] - sums[1] * sums[1] / total, 1e-9)
    per_var = c / (mean + 0.02)
    norm = (c * per_var).sum(axis=0)
    good = (sums[0] >= 8.0) & (norm >= 1e-6)
    contrast = np.where(good, c, 0.0).T
    mix = np.where(good, per_var / np.maximum(norm, 1e-6), 0.0).T
    if good[EdgeKind.RING]:
        # Arrowhead and ring have one paint. Where there is no arrowhead, a mix of its own would make one out of the ring.
        contrast[EdgeKind.ARROW], mix[EdgeKind.ARROW] = contrast[EdgeKind.RING], mix[EdgeKind.RING]
    return Channels(mix, contrast)


def fit(profiles: Profiles, mixed: F64, noise: F64 | None, seen: Coverages) -> ProfileFit:
    """Compute one linearisation.

    Args:
        mixed: (N,) light through `Channels.mix`.
        noise: (KINDS, 3), of which the variance outside and inside; None in the first round.
        seen: coverage at the state.
    """
    s = seen.coverage
    starts, group = profiles.starts, profiles.group
    n = len(s)
    rows = np.empty((5, n))
    if noise is None:
        w = profiles.usable
    else:
        per_var = (noise[:, 1] - noise[:, 0]).take(profiles.kind)
        per_var *= s
        per_var += noise[:, 0].take(profiles.kind)
        np.divide(1.0, per_var, out=per_var)
        w = profiles.usable * per_var
    robust: F64 | None = None
    for round_ in range(2):
        kept = profiles.usable if robust is None else profiles.usable * robust
        rows[0] = w
        np.multiply(w, s, out=rows[1])
        np.multiply(w, mixed, out=rows[2])
        np.multiply(rows[1], s, out=rows[3])
        np.multiply(rows[1], mixed, out=rows[4])
        W, S, Y, SS, SY = np.add.reduceat(rows, starts, axis=1)
        W += 1e-9
        spread = SS - S * S / W
        B = (SY - S * Y / W) / np.maximum(spread, 1e-6 * W)
        A = (Y - B * S) / W
        each_B = B.take(group)
        r = mixed - A.take(group)
        r -= each_B * s
        if round_ == 1:
            break
        if noise is None:
            per_var = (1.0 / _noise(r, s, profiles.usable, profiles)[:, :2].max(axis=1)).take(profiles.kind)
            w = profiles.usable * per_var
        else:
            # The state may still be slightly off; the residuals that this causes at an edge are no outliers.
            aside = np.minimum(np.abs(B), 2.0).take(group)
            aside *= seen.per_px
            aside *= aside
            aside *= TUKEY**2 * _STILL_OFF_PX**2
            aside += TUKEY**2 / per_var
            robust = r * r
            robust /= aside
            np.subtract(1.0, robust, out=robust)
            np.maximum(robust, 0.0, out=robust)
            robust *= robust
            w = w * robust
    n_kept, in_kept, squares_kept = np.add.reduceat(np.stack([kept, kept * s, kept * s * s]), starts, axis=1)
    passed = n_kept * squares_kept - in_kept * in_kept > 0.02 * n_kept * n_kept
    accepted = (_CONTRAST_RATIO[0] < B) & (_CONTRAST_RATIO[1] > B) & passed
    on = accepted.astype(float).take(group)
    weight = profiles.usable * on
    if robust is not None:
        weight *= robust
    J = seen.J * each_B
    weighted = np.empty((2, N_STATE, n))
    w = w * on
    Jw = np.multiply(J, w, out=weighted[0])
    np.multiply(Jw, s, out=weighted[1])
    sums = np.add.reduceat(weighted, starts, axis=2)
    det = 1.0 / np.maximum(W * SS - S * S, 1e-12)
    M00, M01, M11 = SS * det, -S * det, W * det
    levels = np.empty_like(sums)
    np.add(sums[0] * M00, sums[1] * M01, out=levels[0])
    np.add(sums[0] * M01, sums[1] * M11, out=levels[1])
    H = Jw @ J.T
    H -= sums[0] @ levels[0].T
    H -= sums[1] @ levels[1].T
    return ProfileFit(H, Jw @ r, r, per_var, w, seen, J, Jw, sums, levels, (M00, M01, M11), weight, B, accepted)


def shifts(fit: ProfileFit, profiles: Profiles) -> Shifts:
    """Return the displacement of each group's edge."""
    # This is the change of a pixel's light as the edge moves outward by one px.
    per_px = fit.contrast.take(profiles.group) * fit.coverages.per_px
    rows = np.empty((N_STATE + 4, len(per_px)))
    np.multiply(fit.Jw, per_px, out=rows[:N_STATE])
    pw = np.multiply(per_px, fit.w, out=rows[N_STATE])
    np.multiply(pw, fit.coverages.coverage, out=rows[N_STATE + 1])
    np.multiply(pw, per_px, out=rows[N_STATE + 2])
    np.multiply(pw, fit.residual, out=rows[N_STATE + 3])
    sums = np.add.reduceat(rows, profiles.starts, axis=1)
    p0, p1, pp, pr = sums[N_STATE:]
    M00, M01, M11 = fit.inverse
    q0, q1 = M00 * p0 + M01 * p1, M01 * p0 + M11 * p1
    information = np.maximum(pp - p0 * q0 - p1 * q1, 0.0)
    px = np.where(information > 1e-6, pr / np.maximum(information, 1e-6), 0.0)
    return Shifts(px, information, sums[:N_STATE] - fit.sums[0] * q0 - fit.sums[1] * q1)


def residual_after(fit: ProfileFit, profiles: Profiles, delta: F64) -> F64:
    """Return the (N,) residuals that the linearisation predicts after a step (9,)."""
    a, b = delta @ fit.levels
    left: F64 = b.take(profiles.group)
    left *= fit.coverages.coverage
    left += a.take(profiles.group)
    left += fit.residual
    left -= delta @ fit.J
    return left


def noise_of(left: F64, fit: ProfileFit, profiles: Profiles) -> F64:
    """Return the (KINDS, 3) variance on either side of the edges and its mean, from the remaining residuals (N,)."""
    return _noise(left, fit.coverages.coverage, fit.weight, profiles)


def _noise(r: F64, s: F64, weight: F64, profiles: Profiles) -> F64:
    """Return the (KINDS, 3) variance on either side of the edges and its mean, from residuals."""
    out = np.ones((KINDS, 3))
    for kind, part in enumerate(profiles.kind_parts):
        on = weight[part] > 0.0
        q, at, count = (r[part] * r[part])[on], s[part][on], int(on.sum())
        if count >= 12:
            # Each group spends two of its pixels on its light levels.
            grow = count / max(count - 2 * profiles.groups[kind], 1)
            usual = median(q) / 0.4549
            usually = q[q < 9.0 * usual]
            mean = float(usually.mean()) if len(usually) else usual
            out[kind] = np.maximum(grow * np.append(_line(q, at, usual), mean), 1e-9)
    return out


def _line(q: F64, s: F64, usual: float) -> F64:
    """Return the values at 0 and 1 of the line over coverage that squares of residuals follow, none below a part of the usual."""
    var, least = np.full(2, usual), 0.05 * usual
    for _ in range(2):
        basis = np.stack([1.0 - s, s])
        here = var @ basis
        w = np.where(q < 16.0 * here, here**-2, 0.0)
        A, b = (basis * w) @ basis.T, (basis * w) @ q
        if np.linalg.det(A) > 1e-4 * A[0, 0] * A[1, 1]:
            var = np.linalg.solve(A, b)
            if var[0] < least:
                var = np.array([least, max(least, (b[1] - A[0, 1] * least) / A[1, 1])])
            elif var[1] < least:
                var = np.array([max(least, (b[0] - A[0, 1] * least) / A[0, 0]), least])
    return var


def arrow_amplitude(state: RegistrationState, profiles: Profiles, pad: Pad, mixed: F64) -> tuple[float, float]:
    """Return the amplitude of the arrowhead beyond the ring, and its sigma; 1 is a whole arrowhead, (0, inf) is out of view."""
    part = profiles.kind_parts[EdgeKind.ARROW]
    w = profiles.usable[part]
    free = float(w.sum())
    if free < 12:
        return 0.0, math.inf
    none, n = slice(0, 0), len(w)
    value, _, head = state.footprint(profiles.rays[part], pad).places.edge_coverages(none, none, slice(0, n), slice(n, n))
    columns = np.ones((3, n))
    np.subtract(value, head, out=columns[1])
    columns[2] = head
    weighted, light = columns * w, mixed[part]
    cov = inverse(weighted @ columns.T + 1e-6 * np.eye(3))
    a = cov @ (weighted @ light)
    r = (light - a @ columns) * w
    return float(a[2]), math.sqrt(float(r @ r) / max(1.0, free - 3.0) * float(cov[2, 2]))


def spacing_ok(state: RegistrationState, pad: Pad) -> bool:
    """Return whether edges of different kinds are far enough apart for profiles."""
    gap = min(
        pad.markings.field_radius_m - pad.markings.arrow_tip_m,
        pad.markings.ring_inner_m - math.hypot(pad.markings.h_length_m, pad.markings.h_width_m) / 2,
    )
    return gap > 4.5 * state.sigma_px * state.m_per_px
