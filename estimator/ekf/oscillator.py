"""How a deck moves on waves, in one direction: a damped oscillator pushed by the rate of another one like it.

    x'' = -w^2 x - 2 zeta w x' + f'        f'' = -w^2 f - 2 zeta w f' + white noise

One alone has a jump in its acceleration at every instant, which no hull has; pushed by f itself it would wander slowly, where a
sea has no energy (docs/estimator.md). The noise is such that x keeps the standard deviation `sigma`. States: [x, x', f, f'].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64

ORDER = 4


class Transition(NamedTuple):
    """Over some time T: state(t + T) = A state(t) + noise of covariance sigma^2 q."""

    A: F64
    """(..., 4, 4)"""
    q: F64
    """(..., 4, 4), for sigma = 1."""


def stationary(w_rad_s: F64, zeta: F64) -> F64:
    """(..., 4, 4) covariance for sigma = 1, of parameters of any one shape.

    Solution of the Lyapunov equation by hand; docs/estimator.md, section "Waves".
    """
    w, delta = np.asarray(w_rad_s), np.asarray(zeta * w_rad_s)
    w2, force = w * w, 8.0 * delta * delta
    P = np.zeros((*w.shape, 4, 4))
    P[..., 0, 0] = 1.0
    P[..., 1, 1] = w2
    P[..., 2, 2] = force
    P[..., 3, 3] = force * w2
    P[..., 0, 2] = P[..., 2, 0] = 2.0 * delta
    P[..., 1, 3] = P[..., 3, 1] = 2.0 * delta * w2
    return P


def transition(w_rad_s: F64, zeta: F64, dt_s: float, at_rest: F64 | None = None) -> Transition:
    """Exact over `dt_s`, for 0 < zeta < 1.

    The two blocks on the diagonal are the single oscillator's exp(J T), J = K - delta, K^2 = -wd^2; the one above is the integral
    of exp(J (T - s)) B exp(J s), B passing the force's rate on to the acceleration.

    Args:
        at_rest: `stationary(w_rad_s, zeta)` where it is at hand.
    """
    w = np.asarray(w_rad_s)
    delta = zeta * w
    w2, wd2 = w * w, w * w - delta * delta
    wd = np.sqrt(wd2)
    e = np.exp(-delta * dt_s)
    c, s = e * np.cos(wd * dt_s), e * np.sin(wd * dt_s) / wd
    cc, cs, ss = 0.5 * (dt_s * c + s), 0.5 * dt_s * s, 0.5 * (s - dt_s * c) / wd2
    A = np.zeros((*w.shape, 4, 4))
    A[..., 0, 0] = A[..., 2, 2] = c + delta * s
    A[..., 0, 1] = A[..., 2, 3] = s
    A[..., 1, 0] = A[..., 3, 2] = -w2 * s
    A[..., 1, 1] = A[..., 3, 3] = c - delta * s
    # The integral for a force that pushes by itself, [[fa, fb], [fc, fd]], times J: its rate is one J further.
    fa, fb, fc, fd = cs + delta * ss, ss, cc - delta * delta * ss, cs - delta * ss
    A[..., 0, 2], A[..., 0, 3] = -w2 * fb, fa - 2.0 * delta * fb
    A[..., 1, 2], A[..., 1, 3] = -w2 * fd, fc - 2.0 * delta * fd
    P = stationary(w_rad_s, zeta) if at_rest is None else at_rest
    q = P - A @ P @ np.swapaxes(A, -1, -2)
    return Transition(A, 0.5 * (q + np.swapaxes(q, -1, -2)))
